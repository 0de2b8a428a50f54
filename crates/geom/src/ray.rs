//! Rays as open segments.

use glam::Vec3;

/// The open segment `origin + t * direction`, `tnear < t < tfar`.
///
/// Plain data, any bit pattern may be stored; queries treat a ray that is not [valid](Self::is_valid) as a miss.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(C)]
pub struct Ray {
    /// Where `t` is 0, world units.
    pub origin: Vec3,
    /// World units travelled while `t` grows by 1; any length but 0.
    pub direction: Vec3,
    /// Start of the segment, itself excluded; at least 0.
    pub tnear: f32,
    /// End of the segment, itself excluded; may be infinite.
    pub tfar: f32,
}

impl Ray {
    /// The half line from `origin`, itself excluded.
    pub fn new(origin: impl Into<Vec3>, direction: impl Into<Vec3>) -> Self {
        Self { origin: origin.into(), direction: direction.into(), tnear: 0.0, tfar: f32::INFINITY }
    }

    /// The open segment between two points: `t` runs from 0 to 1.
    pub fn between(from: impl Into<Vec3>, to: impl Into<Vec3>) -> Self {
        let origin = from.into();
        Self { origin, direction: to.into() - origin, tnear: 0.0, tfar: 1.0 }
    }

    /// The same ray ending before `tfar`.
    #[must_use]
    pub fn with_tfar(self, tfar: f32) -> Self {
        Self { tfar, ..self }
    }

    /// The point at parameter `t`, rounded.
    #[inline]
    pub fn at(&self, t: f32) -> Vec3 {
        self.origin + t * self.direction
    }

    /// Origin and direction are finite, the direction is not zero, and `0 <= tnear < tfar`.
    #[inline]
    pub fn is_valid(&self) -> bool {
        self.origin.is_finite()
            && self.direction.is_finite()
            && self.direction != Vec3::ZERO
            && self.tnear >= 0.0
            && self.tnear < self.tfar
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_proper_segments_are_valid() {
        let ray = Ray::new([0.0; 3], [0.0, 0.0, 1e-45]);
        assert!(ray.is_valid());
        assert!(!Ray::new([f32::NAN, 0.0, 0.0], [0.0, 0.0, 1.0]).is_valid());
        assert!(!Ray::new([0.0; 3], [0.0, f32::INFINITY, 1.0]).is_valid());
        assert!(!Ray::new([0.0; 3], [0.0; 3]).is_valid());
        assert!(!ray.with_tfar(0.0).is_valid());
        assert!(!ray.with_tfar(f32::NAN).is_valid());
        assert!(!Ray { tnear: -1.0, ..ray }.is_valid());
    }
}
