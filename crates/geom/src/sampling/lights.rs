//! Points on lights as a receiver sees them, with their density per solid angle.
//!
//! Here: directions and densities. Not here: radiance, which side of a light emits, whether it is visible.
//!
//! Every sample function returns `None`, never a NaN or an infinite density, when the light has no solid angle: zero area,
//! a receiver in the plane of a flat light, a size or distance that is not finite, or a solid angle below 1e-36. Work is
//! done in `f64` with plain arithmetic and square roots, so the bits are the same on every machine.

use super::maps::{concentric_disc, parallelogram, uniform_sphere};
use super::trig::sin_cos;
use glam::{DVec3, Vec2, Vec3};
use std::f64::consts::PI;

/// Below this many steradians a light counts as invisible: its density would not fit into `f32`.
pub(super) const SMALLEST_SOLID_ANGLE: f64 = 1e-36;

/// A point of a light, seen from a receiver.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LightSample {
    /// The point, world units, rounded.
    pub point: Vec3,
    /// Unit vector from the receiver to the point.
    pub direction: Vec3,
    /// From the receiver to the point, world units.
    pub distance: f32,
    /// Probability density per steradian, finite and above 0.
    pub pdf: f32,
}

impl LightSample {
    /// From the vector that leads from the receiver to the point.
    pub(super) fn new(receiver: Vec3, to_point: DVec3, pdf: f64) -> Option<Self> {
        let distance = to_point.length();
        let sample = Self {
            point: (receiver.as_dvec3() + to_point).as_vec3(),
            direction: (to_point / distance).as_vec3(),
            distance: distance as f32,
            pdf: pdf as f32,
        };
        let usable = sample.point.is_finite()
            && sample.direction.is_finite()
            && sample.distance > 0.0
            && sample.distance.is_finite()
            && sample.pdf > 0.0
            && sample.pdf.is_finite();
        usable.then_some(sample)
    }
}

/// Density per steradian of a point chosen uniformly on a flat light of `area` with unit `normal`, seen along `to_point`.
fn area_sample(receiver: Vec3, point: DVec3, normal: DVec3, area: f64) -> Option<LightSample> {
    let to_point = point - receiver.as_dvec3();
    let squared = to_point.length_squared();
    let facing = to_point.dot(normal).abs();
    // cos = facing / distance, and pdf = distance^2 / (cos * area). A light seen edge-on has no density at all.
    if facing <= 1e-12 * squared.sqrt() {
        return None;
    }
    LightSample::new(receiver, to_point, squared * squared.sqrt() / (facing * area))
}

/// A uniform point of the disc around `center` with the given `normal` (any length but 0) and `radius` (world units).
///
/// Uniform by area, not by solid angle: the density varies over a disc that is near.
pub fn disc_light(
    receiver: Vec3,
    center: Vec3,
    normal: Vec3,
    radius: f32,
    square: Vec2,
) -> Option<LightSample> {
    let normal = normal.as_dvec3().try_normalize()?;
    let radius = f64::from(radius.max(0.0));
    let (tangent, bitangent) = basis(normal);
    let disc = concentric_disc(square).as_dvec2() * radius;
    let point = center.as_dvec3() + tangent * disc.x + bitangent * disc.y;
    area_sample(receiver, point, normal, PI * radius * radius)
}

/// A uniform point of the parallelogram with edges `u` and `v` from `corner`, uniform by area.
///
/// For right angles [`SphericalRectangle`](super::SphericalRectangle) does better.
pub fn parallelogram_light(
    receiver: Vec3,
    corner: Vec3,
    u: Vec3,
    v: Vec3,
    square: Vec2,
) -> Option<LightSample> {
    let cross = u.as_dvec3().cross(v.as_dvec3());
    let normal = cross.try_normalize()?;
    area_sample(receiver, parallelogram(corner, u, v, square).as_dvec3(), normal, cross.length())
}

/// Directions around an axis, uniform by solid angle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cone {
    axis: DVec3,
    tangent: DVec3,
    bitangent: DVec3,
    /// 1 minus the cosine of the half angle, kept because the cosine itself loses narrow cones.
    width: f64,
}

impl Cone {
    /// The cone around `axis` (any length but 0) with `half_angle` radians from the axis to the rim, in `[0, pi]`; other
    /// values are clamped, NaN counts as 0. `None` if the axis is zero or not finite.
    pub fn new(axis: Vec3, half_angle: f32) -> Option<Self> {
        let half_angle = f64::from(half_angle).clamp(0.0, PI);
        let (sin, _) = sin_cos(0.5 * if half_angle.is_nan() { 0.0 } else { half_angle });
        Self::from_width(axis.as_dvec3(), 2.0 * sin * sin)
    }

    fn from_width(axis: DVec3, width: f64) -> Option<Self> {
        let axis = axis.try_normalize()?;
        let (tangent, bitangent) = basis(axis);
        Some(Self { axis, tangent, bitangent, width })
    }

    /// Steradians, `2 pi (1 - cos)`; 0 for a single direction.
    pub fn solid_angle(&self) -> f32 {
        (2.0 * PI * self.width) as f32
    }

    /// A uniform unit vector of the cone, density `1 / solid_angle`; the axis if the half angle is 0.
    pub fn sample(&self, square: Vec2) -> Vec3 {
        self.direction(square).as_vec3()
    }

    fn direction(&self, square: Vec2) -> DVec3 {
        let disc = concentric_disc(square).as_dvec2();
        // 1 - cos is uniform in [0, width]: r^2 of a disc point is uniform in [0, 1].
        let lowered = disc.length_squared() * self.width;
        let sine_over_r = (self.width * (2.0 - lowered)).sqrt();
        self.tangent * (disc.x * sine_over_r)
            + self.bitangent * (disc.y * sine_over_r)
            + self.axis * (1.0 - lowered)
    }
}

/// Where the receiver is with regard to a sphere.
#[derive(Clone, Copy, Debug, PartialEq)]
enum View {
    Outside(Cone),
    Inside,
    Invisible,
}

/// A sphere as a receiver sees it, sampled uniformly by solid angle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SphereLight {
    receiver: Vec3,
    to_center: DVec3,
    radius: f64,
    view: View,
}

impl SphereLight {
    /// The sphere around `center` with `radius` (world units) seen from `receiver`.
    ///
    /// From outside that is the visible cap, precise for spheres of any size and distance. A receiver inside or on the
    /// sphere sees it in all directions. A radius of 0 or less, or anything not finite, has no solid angle.
    pub fn new(receiver: Vec3, center: Vec3, radius: f32) -> Self {
        let to_center = center.as_dvec3() - receiver.as_dvec3();
        let radius = f64::from(radius);
        let squared = to_center.length_squared();
        let view = if !(radius > 0.0 && radius.is_finite() && squared.is_finite()) {
            View::Invisible
        } else if squared <= radius * radius {
            View::Inside
        } else {
            // 1 - cos = s^2 / (1 + sqrt(1 - s^2)) with s the sine of the half angle, free of cancellation.
            let sine2 = radius * radius / squared;
            let width = sine2 / (1.0 + (1.0 - sine2).sqrt());
            match Cone::from_width(to_center, width) {
                Some(cone) if 2.0 * PI * width >= SMALLEST_SOLID_ANGLE => View::Outside(cone),
                _ => View::Invisible,
            }
        };
        Self { receiver, to_center, radius, view }
    }

    /// Steradians; `4 pi` from inside, 0 if invisible.
    pub fn solid_angle(&self) -> f32 {
        match &self.view {
            View::Outside(cone) => cone.solid_angle(),
            View::Inside => (4.0 * PI) as f32,
            View::Invisible => 0.0,
        }
    }

    /// Whether the receiver is in the sphere or on it, where light emitted outwards can't be seen.
    pub fn is_inside(&self) -> bool {
        self.view == View::Inside
    }

    /// A point of the side that faces the receiver, uniform by solid angle; from inside, where a uniform direction leaves
    /// the sphere (`None` if that is at once, for receivers on the sphere that look outwards).
    pub fn sample(&self, square: Vec2) -> Option<LightSample> {
        let (direction, pdf) = match &self.view {
            View::Outside(cone) => (cone.direction(square), 1.0 / (2.0 * PI * cone.width)),
            View::Inside => (uniform_sphere(square).as_dvec3(), 1.0 / (4.0 * PI)),
            View::Invisible => return None,
        };
        let middle = self.to_center.dot(direction);
        // The distance of the ray from the centre, as a cross product: no cancellation for far, small spheres.
        let passing2 = self.to_center.cross(direction).length_squared();
        let half_chord = (self.radius * self.radius - passing2).max(0.0).sqrt();
        let distance = if self.is_inside() { middle + half_chord } else { middle - half_chord };
        LightSample::new(self.receiver, direction * distance, pdf)
    }
}

/// Two unit vectors that complete `normal` (Duff et al. 2017, as [`Frame`](crate::Frame) in `f32`).
pub(super) fn basis(normal: DVec3) -> (DVec3, DVec3) {
    let sign = 1f64.copysign(normal.z);
    let a = -1.0 / (sign + normal.z);
    let b = normal.x * normal.y * a;
    (
        DVec3::new(1.0 + sign * normal.x * normal.x * a, sign * b, -sign * normal.x),
        DVec3::new(b, sign + normal.y * normal.y * a, -normal.y),
    )
}
