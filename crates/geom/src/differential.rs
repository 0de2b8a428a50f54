//! Ray differentials: how a ray changes from one sample to its neighbours.

use crate::Ray;
use glam::Vec3;

/// First derivatives of a ray with respect to two image (or light sample) coordinates, one unit = one sample.
///
/// # Source
/// Igehy, Tracing Ray Differentials, SIGGRAPH 1999, section 3.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RayDifferential {
    /// Change of the origin along x and along y.
    pub d_origin: [Vec3; 2],
    /// Change of the direction along x and along y.
    pub d_direction: [Vec3; 2],
}

impl RayDifferential {
    /// Differentials of a ray whose neighbours are `right` (one step in x) and `down` (one step in y).
    pub fn from_neighbours(ray: &Ray, right: &Ray, down: &Ray) -> Self {
        Self {
            d_origin: [right.origin - ray.origin, down.origin - ray.origin],
            d_direction: [right.direction - ray.direction, down.direction - ray.direction],
        }
    }

    /// Edges of the footprint at parameter `t`: how far the neighbours' points at the same `t` lie away.
    pub fn footprint(&self, t: f32) -> [Vec3; 2] {
        [0, 1].map(|i| self.d_origin[i] + t * self.d_direction[i])
    }

    /// The differentials after travelling to a surface with unit `normal` at parameter `t`: both neighbours are carried
    /// on to the tangent plane (Igehy 1999, equations 10 to 12). Origins become points on the surface.
    #[must_use]
    pub fn transfer(&self, ray: &Ray, t: f32, normal: Vec3) -> Self {
        let along = ray.direction.dot(normal);
        let d_origin = self.footprint(t).map(|d| {
            if along.abs() < f32::MIN_POSITIVE { d } else { d - d.dot(normal) / along * ray.direction }
        });
        Self { d_origin, d_direction: self.d_direction }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn transfer_lands_on_the_plane() {
        let ray = Ray::new([0.0, 0.0, 0.0], [0.3, 0.1, -1.0]);
        let right = Ray::new([0.0, 0.0, 0.0], [0.301, 0.1, -1.0]);
        let down = Ray::new([0.0, 0.0, 0.0], [0.3, 0.101, -1.0]);
        let d = RayDifferential::from_neighbours(&ray, &right, &down);
        let normal = Vec3::new(0.6, 0.0, 0.8);
        let t = 2.0;
        let on_plane = d.transfer(&ray, t, normal);
        for edge in on_plane.d_origin {
            assert!(edge.dot(normal).abs() < 1e-6);
        }
        // The neighbour's own hit of the plane through the same point, to first order.
        let t_right = ray.at(t).dot(normal) / right.direction.dot(normal);
        let exact = right.at(t_right) - ray.at(t);
        assert!((exact - on_plane.d_origin[0]).length() < 1e-5);
    }
}
