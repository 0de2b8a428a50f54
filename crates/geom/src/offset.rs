//! Origins moved off a surface by a bound on their own rounding error.

use glam::Vec3;

/// Moves `point`, which was rounded from a point of a triangle with the given unit `normal`, to the side of `direction`.
///
/// `magnitude` is the largest absolute coordinate that took part in computing the point (at least the point's own): the
/// point lies within a few units in the last place of it from the triangle's plane, and the shift along the normal is
/// larger than that error, so a ray that leaves to the side of `direction` can't hit the triangle it started on.
/// It grows with the coordinates, not with the scene, and costs nothing at the triangle's own scale.
///
/// # Source
/// The idea of Pharr et al., Physically Based Rendering, 4th edition, section 6.8.6, with one bound for all axes.
#[inline]
pub fn offset_origin(point: Vec3, normal: Vec3, direction: Vec3, magnitude: f32) -> Vec3 {
    // Barycentric interpolation costs at most gamma(7) = 7 * 2^-24 per axis, sqrt(3) of that along the normal; the
    // normal's own rounding and the rounding of the result add less than that again.
    let shift = magnitude.max(point.abs().max_element()) * (32.0 * 0.5 * f32::EPSILON) + f32::MIN_POSITIVE;
    let side = 1f32.copysign(direction.dot(normal));
    point + normal * (side * shift)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Ray, segment_hits_triangle};
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(3000))]
        #[test]
        fn offset_rays_leave_their_triangle(
            tri in prop::array::uniform3(prop::array::uniform3(-1f32..1.0)),
            at in prop::array::uniform3(-1e3f32..1e3), scale in prop::sample::select(vec![1e-6f32, 1.0, 1e6]),
            (u, v) in (0f32..1.0, 0f32..1.0), dir in prop::array::uniform3(-1f32..1.0),
        ) {
            let [a, b, c] = tri.map(|p| (Vec3::from(p) + Vec3::from(at)) * scale);
            let (u, v) = if u + v > 1.0 { (1.0 - u, 1.0 - v) } else { (u, v) };
            let n = (b - a).as_dvec3().cross((c - a).as_dvec3());
            prop_assume!(n.length() > 0.0);
            let normal = n.normalize().as_vec3();
            let p = a * (1.0 - u - v) + b * u + c * v;
            let magnitude = a.abs().max(b.abs()).max(c.abs()).max_element();
            let direction = Vec3::from(dir);
            prop_assume!(direction.normalize_or_zero().dot(normal).abs() > 1e-3);
            let ray = Ray::new(offset_origin(p, normal, direction, magnitude), direction);
            prop_assert!(!segment_hits_triangle(&ray, [a.into(), b.into(), c.into()]));
        }
    }

    /// Where all coordinates are 0, or so small that their product with an epsilon vanishes, the shift still doesn't.
    #[test]
    fn points_at_the_origin_are_moved_too() {
        for size in [1.0, 1e-30, 1e-38, 1e-44] {
            let triangle = [[0.0, 0.0, 0.0], [size, 0.0, 0.0], [0.0, size, 0.0]];
            for direction in [Vec3::Z, Vec3::NEG_Z, Vec3::new(0.5, 0.25, 1e-3)] {
                for magnitude in [0.0, size] {
                    let origin = offset_origin(Vec3::ZERO, Vec3::Z, direction, magnitude);
                    assert_eq!(origin.z.is_sign_negative(), direction.z.is_sign_negative());
                    assert!(origin.z.abs() >= f32::MIN_POSITIVE, "{size}: {origin}");
                    assert!(!segment_hits_triangle(&Ray::new(origin, direction), triangle));
                }
            }
        }
    }
}
