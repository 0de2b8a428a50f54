//! Ray differentials through camera, mirrors, glass and lights (Igehy 1999), and the footprint of a ray.

use umbrage_geom::{
    Aabb, Ray, RayDifferential,
    glam::{DVec3, Vec3},
};

/// Differentials of the ray that `eye`, a pinhole camera, sends through an image point, in direction `direction`.
///
/// `right` and `down` are how the direction, not normalized, changes from a pixel to its neighbours.
pub fn camera_differential(right: impl Into<Vec3>, down: impl Into<Vec3>) -> RayDifferential {
    RayDifferential { d_origin: [Vec3::ZERO; 2], d_direction: [right.into(), down.into()] }
}

/// Differentials after reflection at the surface that [`RayDifferential::transfer`] has carried them to
/// (Igehy 1999, equations 13 to 15).
///
/// `d_normal` is the change of the unit normal from the point to those of the neighbours: the surface's curvature times
/// `d_origin`, zero on a plane. `direction` is the ray's before reflection.
pub fn reflect(
    differential: &RayDifferential,
    direction: Vec3,
    normal: Vec3,
    d_normal: [Vec3; 2],
) -> RayDifferential {
    let d_direction = [0, 1].map(|i| {
        let (d, dn) = (differential.d_direction[i], d_normal[i]);
        let change = d.dot(normal) + direction.dot(dn);
        d - 2.0 * (direction.dot(normal) * dn + change * normal)
    });
    RayDifferential { d_direction, ..*differential }
}

/// Direction and differentials after refraction (Igehy 1999, equations 16 to 19), `None` for total reflection.
///
/// `direction` has unit length; `normal` is on its side, `direction . normal < 0`; `eta` is the refractive index before
/// the surface over that behind it. `d_normal` as for [`reflect`].
pub fn refract(
    differential: &RayDifferential,
    direction: Vec3,
    normal: Vec3,
    d_normal: [Vec3; 2],
    eta: f32,
) -> Option<(Vec3, RayDifferential)> {
    let along = direction.dot(normal);
    let inside = 1.0 - eta * eta * (1.0 - along * along);
    if inside.is_nan() || inside <= 0.0 {
        return None;
    }
    // The refracted ray's component along the normal.
    let out = -inside.sqrt();
    let mu = eta * along - out;
    let slope = eta - eta * eta * along / out;
    let d_direction = [0, 1].map(|i| {
        let (d, dn) = (differential.d_direction[i], d_normal[i]);
        let change = d.dot(normal) + direction.dot(dn);
        eta * d - (mu * dn + slope * change * normal)
    });
    Some((eta * direction - mu * normal, RayDifferential { d_direction, ..*differential }))
}

/// Differentials of the shadow ray [`Ray::between`] a point, whose neighbours lie `d_point` away, and a point of a light,
/// whose neighbours lie `d_light` away: `t` runs from 0 at the point to 1 at the light.
///
/// The neighbours of a light sample are those of neighbouring strata, so that footprints cover the light between them.
/// Zero `d_point` makes rays that diverge from the point; swapping the arguments, rays traced from the light.
pub fn light_differential(d_point: [Vec3; 2], d_light: [Vec3; 2]) -> RayDifferential {
    RayDifferential { d_origin: d_point, d_direction: [0, 1].map(|i| d_light[i] - d_point[i]) }
}

/// The width of a ray at any distance: the shorter edge of its footprint.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Width {
    /// `|a + b t|^2` of each edge of the footprint as `c[0] + 2 c[1] t + c[2] t^2`.
    squares: [[f64; 3]; 2],
    origin: DVec3,
    inverse: DVec3,
    ends: [f64; 2],
}

impl Width {
    /// Of `ray`, with edges scaled by `scale`.
    pub(crate) fn new(ray: &Ray, differential: &RayDifferential, scale: f64) -> Self {
        let squares = [0, 1].map(|i| {
            let a = differential.d_origin[i].as_dvec3() * scale;
            let b = differential.d_direction[i].as_dvec3() * scale;
            [a.length_squared(), a.dot(b), b.length_squared()]
        });
        Self {
            squares,
            origin: ray.origin.as_dvec3(),
            inverse: ray.direction.as_dvec3().recip(),
            ends: [ray.tnear.into(), ray.tfar.into()],
        }
    }

    /// At parameter `t`; NaN for a NaN differential.
    pub(crate) fn at(&self, t: f64) -> f64 {
        self.least(t, t)
    }

    /// The smallest width between two parameters: at entry if the ray diverges, at exit if it converges, or between.
    pub(crate) fn least(&self, from: f64, to: f64) -> f64 {
        let mut least = f64::INFINITY;
        for [a, b, c] in self.squares {
            let t = if c > 0.0 { (-b / c).clamp(from, to.max(from)) } else { from };
            let square = a + t * (2.0 * b + t * c);
            if square.is_nan() {
                return f64::NAN;
            }
            least = least.min(square.max(0.0));
        }
        least.sqrt()
    }

    /// Where the segment is inside `aabb`, roughly: callers have found that it enters.
    pub(crate) fn interval(&self, aabb: &Aabb) -> [f64; 2] {
        let (low, high) = (
            (aabb.min.as_dvec3() - self.origin) * self.inverse,
            (aabb.max.as_dvec3() - self.origin) * self.inverse,
        );
        let [mut t0, mut t1] = self.ends;
        for axis in 0..3 {
            // `max` and `min` drop NaN.
            t0 = t0.max(low[axis].min(high[axis]));
            t1 = t1.min(low[axis].max(high[axis]));
        }
        [t0, t1.max(t0)]
    }
}
