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

    /// The smallest width between two parameters: at entry if the ray diverges, at exit if it converges, or between; NaN for a
    /// NaN differential.
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

#[cfg(test)]
mod tests {
    use super::*;
    use umbrage_geom::glam::DVec3;

    const H: f32 = 1e-3;

    /// Directions and points of three neighbouring rays that leave a sphere of radius 2, mirrored or refracted exactly.
    fn traced(bend: impl Fn(DVec3, DVec3) -> DVec3, dx: f64, dy: f64) -> (DVec3, DVec3) {
        let origin = DVec3::new(0.3, 0.2, 6.0);
        let d = DVec3::new(-0.02 + dx, 0.05 + dy, -1.0).normalize();
        let (b, c) = (origin.dot(d), origin.length_squared() - 4.0);
        let p = origin + (-b - (b * b - c).sqrt()) * d;
        (p, bend(d, p / 2.0))
    }

    fn mirrored(d: DVec3, n: DVec3) -> DVec3 {
        d - 2.0 * d.dot(n) * n
    }

    fn refracted(d: DVec3, n: DVec3) -> DVec3 {
        let eta = 1.0 / 1.5;
        let along = d.dot(n);
        eta * d - (eta * along + (1.0 - eta * eta * (1.0 - along * along)).sqrt()) * n
    }

    #[test]
    fn differentials_are_those_of_neighbouring_rays() {
        // Normalized directions change by their part across the ray.
        let d = DVec3::new(-0.02, 0.05, -1.0);
        let unit = d.normalize();
        let across = |e: DVec3| ((e - unit * e.dot(unit)) / d.length() * f64::from(H)).as_vec3();
        let start = camera_differential(across(DVec3::X), across(DVec3::Y));
        let ray = Ray::new([0.3, 0.2, 6.0], unit.as_vec3());
        let (p, _) = traced(mirrored, 0.0, 0.0);
        let normal = (p / 2.0).as_vec3();
        let t = (p - DVec3::new(0.3, 0.2, 6.0)).length() as f32;
        let on_surface = start.transfer(&ray, t, normal);
        let d_normal = on_surface.d_origin.map(|d| d / 2.0);
        let reflection = reflect(&on_surface, ray.direction, normal, d_normal);
        let (direction, refraction) =
            refract(&on_surface, ray.direction, normal, d_normal, 1.0 / 1.5).expect("into the denser medium");
        assert!(direction.as_dvec3().abs_diff_eq(traced(refracted, 0.0, 0.0).1, 1e-6));
        let check = |bend: fn(DVec3, DVec3) -> DVec3, ours: &RayDifferential| {
            for (i, (dx, dy)) in [(H, 0.0), (0.0, H)].into_iter().enumerate() {
                let (p0, d0) = traced(bend, 0.0, 0.0);
                let (p1, d1) = traced(bend, dx.into(), dy.into());
                assert!((p1 - p0).as_vec3().distance(ours.d_origin[i]) < 0.01 * H, "origin {i}");
                assert!((d1 - d0).as_vec3().distance(ours.d_direction[i]) < 0.02 * H, "direction {i}");
            }
        };
        check(mirrored, &reflection);
        check(refracted, &refraction);
    }

    #[test]
    fn total_reflection_has_no_refracted_ray() {
        let d = Vec3::new(0.9, 0.0, -0.19f32.sqrt());
        let flat = RayDifferential::default();
        assert!(refract(&flat, d, Vec3::Z, [Vec3::ZERO; 2], 1.5).is_none());
        assert!(refract(&flat, d, Vec3::Z, [Vec3::ZERO; 2], f32::NAN).is_none());
        assert!(refract(&flat, d, Vec3::Z, [Vec3::ZERO; 2], 1.0 / 1.5).is_some());
    }

    #[test]
    fn widths_are_least_at_entry_exit_or_focus() {
        let ray = Ray::new([0.0; 3], [0.0, 0.0, 1.0]);
        let width = |from: f32, slope: f32| {
            let d = RayDifferential {
                d_origin: [Vec3::X * from, Vec3::Y * 10.0],
                d_direction: [Vec3::X * slope, Vec3::ZERO],
            };
            Width::new(&ray, &d, 1.0).least(2.0, 4.0)
        };
        assert_eq!(width(0.0, 1.0), 2.0);
        assert_eq!(width(6.0, -1.0), 2.0);
        assert_eq!(width(3.0, -1.0), 0.0);
        assert_eq!(width(1.0, 0.0), 1.0);
        assert!(width(f32::NAN, 0.0).is_nan());
        // Shadow rays: as wide as the pixel at the point, as the stratum at the light, and backwards.
        let (point, light) = ([Vec3::X * 0.5, Vec3::Y], [Vec3::X * 2.0, Vec3::Y * 3.0]);
        let there = light_differential(point, light);
        let back = light_differential(light, point);
        for t in [0.0, 0.25, 1.0] {
            assert_eq!(there.footprint(t), back.footprint(1.0 - t));
        }
        assert_eq!(there.footprint(1.0), light);
    }
}
