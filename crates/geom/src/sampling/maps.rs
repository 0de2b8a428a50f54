//! Maps from the half-open unit square that keep areas in proportion: uniform points in, uniform (or cosine-weighted)
//! points out, neighbours staying neighbours.

use super::trig::sin_cos_octant;
use glam::{Vec2, Vec3};
use std::f32::consts::FRAC_PI_4;

/// Uniform point of the open unit disc.
///
/// The radius is at most `1 - 2^-21`, so that [`cosine_hemisphere`] never lies in the tangent plane, whatever the rounding;
/// the area lost is 1e-6 of the disc.
///
/// # Source
/// Shirley and Chiu, A Low Distortion Map Between Disk and Square, 1997.
#[inline]
pub fn concentric_disc(square: Vec2) -> Vec2 {
    const RADIUS: f32 = 1.0 - 4.0 * f32::EPSILON;
    let p = 2.0 * square - Vec2::ONE;
    if p == Vec2::ZERO {
        return Vec2::ZERO;
    }
    if p.x.abs() > p.y.abs() {
        let (sin, cos) = sin_cos_octant(FRAC_PI_4 * (p.y / p.x));
        Vec2::new(cos, sin) * (p.x * RADIUS)
    } else {
        let (sin, cos) = sin_cos_octant(FRAC_PI_4 * (p.x / p.y));
        Vec2::new(sin, cos) * (p.y * RADIUS)
    }
}

/// Lifts a point of the open unit disc onto the unit hemisphere `z > 0`: uniform points become cosine-weighted directions
/// with density `z / pi` (Malley's method). Points outside the disc give `z = 0`.
#[inline]
pub fn lift(disc: Vec2) -> Vec3 {
    disc.extend((1.0 - disc.x * disc.x - disc.y * disc.y).max(0.0).sqrt())
}

/// Cosine-weighted direction around the z axis, density `z / pi` per steradian; `z` is at least 5e-4.
#[inline]
pub fn cosine_hemisphere(square: Vec2) -> Vec3 {
    lift(concentric_disc(square))
}

/// Uniform direction with `z > 0`, density `1 / (2 pi)` per steradian.
#[inline]
pub fn uniform_hemisphere(square: Vec2) -> Vec3 {
    let disc = concentric_disc(square);
    let r2 = disc.length_squared();
    // z = 1 - r^2, so the distance from the axis is r sqrt(2 - r^2).
    (disc * (2.0 - r2).sqrt()).extend(1.0 - r2)
}

/// Uniform direction, density `1 / (4 pi)` per steradian.
#[inline]
pub fn uniform_sphere(square: Vec2) -> Vec3 {
    // The lower and upper half of the square go to the lower and upper hemisphere.
    let y = 2.0 * square.y;
    if y < 1.0 {
        let d = uniform_hemisphere(Vec2::new(square.x, y));
        Vec3::new(d.x, d.y, -d.z)
    } else {
        uniform_hemisphere(Vec2::new(square.x, y - 1.0))
    }
}

/// Uniform point of a triangle as the barycentric weights of its second and third corner, each at least 0, sum below 1.
///
/// # Source
/// Heitz, A Low-Distortion Map Between Triangle and Square, 2019.
#[inline]
pub fn triangle(square: Vec2) -> Vec2 {
    let Vec2 { x, y } = square;
    if y > x { Vec2::new(0.5 * x, y - 0.5 * x) } else { Vec2::new(x - 0.5 * y, 0.5 * y) }
}

/// Uniform point of the parallelogram with edges `u` and `v` from `corner`.
#[inline]
pub fn parallelogram(corner: Vec3, u: Vec3, v: Vec3, square: Vec2) -> Vec3 {
    corner + u * square.x + v * square.y
}
