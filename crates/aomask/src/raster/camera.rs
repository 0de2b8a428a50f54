//! The pinhole camera whose picture holds the receivers.

use crate::MaskError;
use umbrage_geom::glam::{DMat3, DVec3, Vec3};

/// A pinhole: pixel (`x`, `y`) of a `width` x `height` image is looked at along `forward + u * right + v * up`, where `u` goes
/// from -1 at the left to 1 at the right edge of the image and `v` from 1 at the top to -1.
#[derive(Clone, Copy, Debug)]
pub struct RasterCamera {
    eye: DVec3,
    /// Rows that give `u * depth`, `v * depth` and `depth` of a point relative to the eye.
    rows: [DVec3; 3],
}

/// Where a point is seen.
#[derive(Clone, Copy, Debug)]
pub(super) struct Projected {
    /// `u * depth` and `v * depth`.
    pub(super) uv: [f64; 2],
    /// Along `forward`, in units of its length.
    pub(super) depth: f64,
}

impl RasterCamera {
    /// A camera at `eye`, world units.
    ///
    /// # Errors
    /// [`MaskError::Camera`] if something is not finite, or the three vectors don't span space.
    pub fn new(eye: [f32; 3], forward: [f32; 3], right: [f32; 3], up: [f32; 3]) -> Result<Self, MaskError> {
        let [eye, forward, right, up] = [eye, forward, right, up].map(|v| Vec3::from(v).as_dvec3());
        let inverse = DMat3::from_cols(right, up, forward).inverse();
        let rows = [0, 1, 2].map(|i| inverse.row(i));
        if !eye.is_finite() || rows.iter().any(|row| !row.is_finite() || *row == DVec3::ZERO) {
            return Err(MaskError::Camera);
        }
        Ok(Self { eye, rows })
    }

    pub(super) fn eye(&self) -> DVec3 {
        self.eye
    }

    pub(super) fn project(&self, point: DVec3) -> Projected {
        let [u, v, depth] = self.rows.map(|row| row.dot(point - self.eye));
        Projected { uv: [u, v], depth }
    }

    /// How much a step of length 1 may change the depth.
    pub(super) fn depth_per_length(&self) -> f64 {
        self.rows[2].length()
    }

    /// Interval of `u` (`axis` 0) or `v` (1) that a sphere in front of the eye covers; `None` if it reaches behind it.
    pub(super) fn sphere(&self, center: DVec3, radius: f64, axis: usize) -> Option<[f64; 2]> {
        // Planes `x = u w` through the eye touch the sphere: (X - u W) . c = +-radius |X - u W|.
        let (x, w, c) = (self.rows[axis], self.rows[2], center - self.eye);
        let (xc, wc, r2) = (x.dot(c), w.dot(c), radius * radius);
        let quadratic = wc * wc - r2 * w.length_squared();
        let linear = xc * wc - r2 * x.dot(w);
        let constant = xc * xc - r2 * x.length_squared();
        if wc <= 0.0 || quadratic <= 1e-9 * wc * wc {
            return None;
        }
        let root = (linear * linear - quadratic * constant).max(0.0).sqrt();
        Some([(linear - root) / quadratic, (linear + root) / quadratic])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_and_spheres_project() {
        let camera =
            RasterCamera::new([1.0, 2.0, 3.0], [0.0, 0.0, -2.0], [1.0, 0.0, 0.0], [0.0, 0.5, 0.0]).unwrap();
        let p = camera.project(DVec3::new(1.0 + 0.5 * 3.0, 2.0 - 0.25 * 1.5, 3.0 - 6.0));
        assert!((p.depth - 3.0).abs() < 1e-12 && (p.uv[0] / p.depth - 0.5).abs() < 1e-12);
        assert!((p.uv[1] / p.depth + 0.25).abs() < 1e-12);
        let center = DVec3::new(1.5, 2.0, -7.0);
        let [low, high] = camera.sphere(center, 2.0, 0).unwrap();
        let (mut least, mut greatest) = (f64::MAX, f64::MIN);
        for i in 0..2000 {
            let angle = f64::from(i) * 0.0031416;
            // The widest points lie in the plane of eye, centre and axis.
            let p = camera.project(center + DVec3::new(angle.cos(), 0.0, angle.sin()) * 2.0);
            least = least.min(p.uv[0] / p.depth);
            greatest = greatest.max(p.uv[0] / p.depth);
        }
        assert!(
            (low - least).abs() < 1e-4 && (high - greatest).abs() < 1e-4,
            "{low} {least} {high} {greatest}"
        );
        assert!(camera.sphere(DVec3::new(1.0, 2.0, 2.0), 1.5, 1).is_none());
        let flat = RasterCamera::new([0.0; 3], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0], [0.0, 1.0, 0.0]);
        assert!(matches!(flat, Err(MaskError::Camera)));
    }
}
