//! Views of the scenes: what the figures show and where the receivers of table 1 lie.

use super::{Case, workload::receiver_at};
use umbrage_aomask::RasterCamera;
use umbrage_geom::{Ray, glam::Vec3};

/// A pinhole camera.
#[derive(Clone, Copy, Debug)]
pub struct View {
    pub eye: Vec3,
    forward: Vec3,
    right: Vec3,
    up: Vec3,
    pub size: [u32; 2],
}

impl View {
    /// A camera at `eye` that looks at `target`; the image's width is seen under about 75 degrees.
    pub fn new(eye: Vec3, target: Vec3, size: [u32; 2]) -> Self {
        let forward = (target - eye).normalize();
        let across = if forward.y.abs() > 0.99 { Vec3::X } else { Vec3::Y };
        let right = forward.cross(across).normalize();
        let up = right.cross(forward);
        let half = 0.77;
        let aspect = size[1] as f32 / size[0] as f32;
        Self { eye, forward, right: right * half, up: up * (half * aspect), size }
    }

    /// The ray through the middle of pixel (`x`, `y`).
    pub fn ray(&self, x: u32, y: u32) -> Ray {
        let u = (x as f32 + 0.5) / self.size[0] as f32 * 2.0 - 1.0;
        let v = 1.0 - (y as f32 + 0.5) / self.size[1] as f32 * 2.0;
        Ray::new(self.eye, self.forward + self.right * u + self.up * v)
    }

    /// The same with another number of pixels.
    pub fn resized(self, size: [u32; 2]) -> Self {
        let aspect = |size: [u32; 2]| size[1] as f32 / size[0] as f32;
        Self { up: self.up * (aspect(size) / aspect(self.size)), size, ..self }
    }

    /// As `umbrage-aomask` wants it.
    pub fn raster(&self) -> RasterCamera {
        let [eye, forward, right, up] = [self.eye, self.forward, self.right, self.up].map(|v| v.to_array());
        RasterCamera::new(eye, forward, right, up).expect("a proper camera")
    }

    /// The surface behind each pixel, row by row: receiver point and normal, `None` where nothing is seen.
    pub fn pixels(&self, case: &Case) -> Vec<Option<(Vec3, Vec3)>> {
        let [width, height] = self.size;
        let pixels = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
        pixels
            .map(|(x, y)| {
                let ray = self.ray(x, y);
                let hit = case.ours.bvh().closest_hit(&ray)?;
                receiver_at(&case.mesh, &ray, hit.prim_index as usize, hit.t)
            })
            .collect()
    }

    /// All surfaces seen.
    pub fn surfaces(&self, case: &Case) -> (Vec<Vec3>, Vec<Vec3>) {
        self.pixels(case).into_iter().flatten().unzip()
    }
}

/// Representative views of a scene, 512 x 384.
pub fn views(case: &Case) -> Vec<View> {
    let size = [512, 384];
    let bounds = case.mesh.bounds();
    let (center, extent) = (bounds.center(), bounds.size());
    let at = |x: f32, y: f32, z: f32| center + extent * Vec3::new(x, y, z);
    match case.name {
        // Inside: along the nave both ways, and up from the floor.
        "sibenik" => vec![
            View::new(at(-0.35, -0.25, 0.0), at(0.3, -0.2, 0.05), size),
            View::new(at(0.3, -0.1, 0.1), at(-0.3, -0.3, -0.1), size),
            View::new(at(0.0, -0.35, -0.1), at(0.2, 0.1, 0.1), size),
        ],
        _ => [(0.6, 0.5, 0.7), (-0.8, 0.25, 0.5), (0.1, 0.8, -0.6)]
            .map(|(x, y, z)| View::new(center + Vec3::new(x, y, z) * (0.8 * extent.length()), center, size))
            .into(),
    }
}
