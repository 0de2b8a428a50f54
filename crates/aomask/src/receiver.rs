//! A point that asks for its ambient occlusion.

use crate::MaskError;
use umbrage_geom::{glam::Vec3, mesh::MAX_COORDINATE, sampling::combine};

/// A point with a normal, checked.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Receiver {
    point: Vec3,
    normal: Vec3,
    seed: u32,
    sample: u32,
    face: Option<Vec3>,
}

/// Least height of a ray above the plane of [`Receiver::face`], as a cosine.
const LEAST_HEIGHT: f32 = 5e-4;

impl Receiver {
    /// A receiver at `point` (world units; rays start exactly there, so points on a surface are moved off it first, see
    /// [`umbrage_geom::offset_origin`]) that looks along `normal`, of any length but 0. `seed` chooses the jitter; `index`
    /// is what errors name.
    ///
    /// # Errors
    /// [`MaskError::Point`], [`MaskError::Normal`].
    pub fn new(index: usize, point: [f32; 3], normal: [f32; 3], seed: u32) -> Result<Self, MaskError> {
        // Comparisons with NaN are false.
        if !point.iter().all(|x| x.abs() <= MAX_COORDINATE) {
            return Err(MaskError::Point { index, point });
        }
        let n = Vec3::from(normal);
        if !n.is_finite() || n == Vec3::ZERO {
            return Err(MaskError::Normal { index, normal });
        }
        // In f64 no finite length overflows or vanishes.
        Ok(Self {
            point: point.into(),
            normal: n.as_dvec3().normalize().as_vec3(),
            seed,
            sample: 0,
            face: None,
        })
    }

    /// Receivers at `points` (world units, see [`Self::new`]) that look along `normals`, each with the seed
    /// [`Self::seed_of`] its point and normal with `seed`.
    ///
    /// # Errors
    /// [`MaskError::Length`], [`MaskError::Point`], [`MaskError::Normal`].
    pub fn from_slices(points: &[[f32; 3]], normals: &[[f32; 3]], seed: u32) -> Result<Vec<Self>, MaskError> {
        if points.len() != normals.len() {
            let (actual, expected) = (normals.len(), points.len());
            return Err(MaskError::Length { what: "normals", actual, expected, points: expected });
        }
        let receiver = |(i, (&point, &normal)): (usize, (&[f32; 3], &[f32; 3]))| {
            Self::new(i, point, normal, Self::seed_of(point, normal, seed))
        };
        points.iter().zip(normals).enumerate().map(receiver).collect()
    }

    /// Where rays start, world units.
    #[inline]
    pub fn point(&self) -> Vec3 {
        self.point
    }

    /// Unit normal.
    #[inline]
    pub fn normal(&self) -> Vec3 {
        self.normal
    }

    /// One of several samples of the same receiver, 0 unless said otherwise: members and turns of successive samples are spread
    /// evenly, so that the mean over samples has less error than that of unrelated seeds.
    #[must_use]
    pub fn with_sample(self, sample: u32) -> Self {
        Self { sample, ..self }
    }

    /// The receiver lies on a surface with the unit normal `face` that is not its own normal: rays that would lead below the
    /// surface are mirrored at it ([`crate::Pattern::rays_of`]), so that a surface never darkens itself. Only methods that cast
    /// the pattern's rays do so; tables take all rays as they are.
    #[must_use]
    pub fn with_face(self, face: [f32; 3]) -> Self {
        let face = Vec3::from(face);
        Self { face: (face != self.normal).then_some(face), ..self }
    }

    /// What [`Self::with_face`] set, unless it is the normal.
    #[inline]
    pub fn face(&self) -> Option<Vec3> {
        self.face
    }

    /// `direction`, mirrored at the plane of [`Self::face`] if it leads below.
    #[inline]
    pub(crate) fn above(&self, direction: Vec3) -> Vec3 {
        let Some(face) = self.face else { return direction };
        let height = direction.dot(face);
        if height < LEAST_HEIGHT {
            (direction + face * (height.abs().max(LEAST_HEIGHT) - height)).normalize()
        } else {
            direction
        }
    }

    /// The same point and normal under another seed.
    #[must_use]
    pub fn with_seed(self, seed: u32) -> Self {
        Self { seed, ..self }
    }

    /// Number of the sample.
    #[inline]
    pub fn sample(&self) -> u32 {
        self.sample
    }

    /// A seed for a point with a normal: the same place with the same normal has the same seed, whatever its index, so that
    /// duplicated vertices get the same rays. `seed` makes all of them different.
    pub fn seed_of(point: [f32; 3], normal: [f32; 3], seed: u32) -> u32 {
        // Adding 0 makes both zeros one.
        point.iter().chain(&normal).fold(seed, |seed, x| combine(seed, (x + 0.0).to_bits()))
    }

    /// What chooses the member and the turn of the pattern.
    #[inline]
    pub fn seed(&self) -> u32 {
        self.seed
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bad_receivers_are_named() {
        let up = [0.0, 0.0, 1.0];
        for bad in [f32::NAN, f32::INFINITY, 1e25] {
            let point = [0.0, bad, 0.0];
            assert!(matches!(Receiver::new(3, point, up, 0), Err(MaskError::Point { index: 3, .. })));
        }
        for bad in [[0.0; 3], [f32::NAN, 0.0, 1.0], [0.0, f32::NEG_INFINITY, 0.0]] {
            assert!(matches!(Receiver::new(4, [0.0; 3], bad, 0), Err(MaskError::Normal { index: 4, .. })));
        }
        for length in [1e-45, 1e-20, 3e38] {
            let receiver = Receiver::new(0, [0.0; 3], [0.0, 0.0, -length], 0).unwrap();
            assert_eq!(receiver.normal(), Vec3::NEG_Z);
        }
    }
}
