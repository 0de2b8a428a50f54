//! Primary rays: a pinhole, or a thin lens.

use umbrage_aomask::RasterCamera;
use umbrage_geom::{Ray, RayDifferential, glam::Vec3};
use umbrage_scene as scene;

/// A camera ready to make rays for an image of a certain size.
#[derive(Clone, Debug)]
pub struct CameraRays {
    position: Vec3,
    /// From the lens to the upper left corner of the plane of focus.
    corner: Vec3,
    /// One pixel to the right in the plane of focus.
    step_x: Vec3,
    /// One pixel down.
    step_y: Vec3,
    /// The lens' axes, as long as its radius; zero for a pinhole.
    lens: [Vec3; 2],
}

impl CameraRays {
    /// The camera that `description` means for `width` x `height` pixels.
    pub fn new(description: &scene::Camera, width: u32, height: u32) -> Self {
        let position = Vec3::from(description.position);
        let view = Vec3::from(description.target).as_dvec3() - position.as_dvec3();
        let forward = view.normalize();
        let right = forward.cross(Vec3::from(description.up).as_dvec3()).normalize();
        let down = forward.cross(right);
        let focus = description.focus_distance.map_or(view.length(), f64::from);
        let half_height = (f64::from(description.fov).to_radians() * 0.5).tan() * focus;
        let pixel = 2.0 * half_height / f64::from(height);
        let half_width = pixel * f64::from(width) * 0.5;
        let lens_radius = f64::from(description.lens_radius);
        Self {
            position,
            corner: (forward * focus - right * half_width - down * half_height).as_vec3(),
            step_x: (right * pixel).as_vec3(),
            step_y: (down * pixel).as_vec3(),
            lens: [(right * lens_radius).as_vec3(), (down * lens_radius).as_vec3()],
        }
    }

    /// The same pinhole for rasterization; `None` with a lens.
    pub fn raster(&self, width: u32, height: u32) -> Option<RasterCamera> {
        if self.lens != [Vec3::ZERO; 2] {
            return None;
        }
        let (right, down) = (self.step_x * (0.5 * width as f32), self.step_y * (0.5 * height as f32));
        let forward = self.corner + right + down;
        let [eye, forward, right, up] = [self.position, forward, right, -down].map(|v| v.to_array());
        RasterCamera::new(eye, forward, right, up).ok()
    }

    /// The ray through the image point (`x`, `y`), in pixels from the upper left corner, and through the point `lens` of
    /// the unit disc. Its direction has unit length.
    pub fn ray(&self, x: f32, y: f32, lens: [f32; 2]) -> Ray {
        let shift = self.lens[0] * lens[0] + self.lens[1] * lens[1];
        let direction = self.corner + self.step_x * x + self.step_y * y - shift;
        Ray::new(self.position + shift, direction.normalize())
    }

    /// Differentials of [`Self::ray`] for steps of one pixel.
    pub fn differential(&self, x: f32, y: f32, lens: [f32; 2]) -> RayDifferential {
        let ray = self.ray(x, y, lens);
        RayDifferential::from_neighbours(&ray, &self.ray(x + 1.0, y, lens), &self.ray(x, y + 1.0, lens))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn description() -> scene::Camera {
        scene::Camera {
            position: [0.0, 0.0, 5.0],
            target: [0.0; 3],
            up: [0.0, 1.0, 0.0],
            fov: 90.0,
            lens_radius: 0.0,
            focus_distance: None,
        }
    }

    #[test]
    fn image_corners_are_where_the_field_of_view_ends() {
        let camera = CameraRays::new(&description(), 200, 100);
        let middle = camera.ray(100.0, 50.0, [0.0; 2]);
        assert!((middle.direction - Vec3::NEG_Z).length() < 1e-6);
        let top_left = camera.ray(0.0, 0.0, [0.0; 2]);
        assert!((top_left.direction - Vec3::new(-2.0, 1.0, -1.0).normalize()).length() < 1e-6);
    }

    #[test]
    fn a_lens_keeps_the_plane_of_focus_sharp() {
        let camera = CameraRays::new(&scene::Camera { lens_radius: 0.5, ..description() }, 100, 100);
        let sharp = CameraRays::new(&description(), 100, 100).ray(30.0, 70.0, [0.0; 2]);
        let target = sharp.at(sharp.origin.z / -sharp.direction.z);
        for lens in [[1.0, 0.0], [0.0, -1.0], [0.6, 0.5]] {
            let ray = camera.ray(30.0, 70.0, lens);
            assert!((ray.at(ray.origin.z / -ray.direction.z) - target).length() < 1e-5);
        }
    }
}
