//! The four scenes of the dissertation, their cameras and lights.

use crate::scenes::mesh_folder;
use anyhow::Result;
use umbrage_geom::{
    Aabb, PolygonMesh, Ray, RayDifferential,
    glam::{Vec2, Vec3},
    sampling::{hash, unit},
};
use umbrage_reyes::{camera_differential, light_differential};
use umbrage_scene::read_polygons;

/// A control mesh with the camera's direction and what a close view looks at.
pub struct Scene {
    pub name: &'static str,
    pub control: PolygonMesh,
    /// Patches in table 6.2 of the dissertation.
    pub published_patches: u32,
    /// From the middle of the object to the camera, for the normal view.
    towards: Vec3,
    up: Vec3,
    /// What the close view looks at, in halves of the box from its middle.
    detail: Vec3,
}

/// A pinhole camera of `size` x `size` pixels. Directions are not normalized.
#[derive(Clone, Copy)]
pub struct View {
    pub eye: Vec3,
    corner: Vec3,
    right: Vec3,
    down: Vec3,
    pub size: u32,
}

/// A rectangle of light.
#[derive(Clone, Copy)]
pub struct Light {
    corner: Vec3,
    sides: [Vec3; 2],
}

/// The cube whose surface is nearly a sphere: all 8 control points belong to each of its 6 patches.
fn cube() -> PolygonMesh {
    let side = |i: u32, bit: u32| if i >> bit & 1 == 1 { 1.0 } else { -1.0 };
    let faces: [[u32; 4]; 6] =
        [[1, 3, 7, 5], [0, 4, 6, 2], [2, 6, 7, 3], [0, 1, 5, 4], [4, 5, 7, 6], [0, 2, 3, 1]];
    PolygonMesh {
        positions: (0..8).map(|i| [side(i, 0), side(i, 1), side(i, 2)]).collect(),
        face_sizes: vec![4; 6],
        corners: faces.concat(),
        ..PolygonMesh::default()
    }
}

/// All scenes whose files are there.
pub fn all() -> Result<Vec<Scene>> {
    let mut scenes = Vec::new();
    let characters = [
        ("monsterfrog", "monsterfrog.obj", 1292, [0.5, 0.45, 1.0], [0.0, 0.5, 0.8]),
        ("bigguy", "bigguy.obj", 1450, [0.35, 0.3, 1.0], [0.05, 0.55, 0.5]),
        ("killeroo", "killeroo_requad.obj", 3042, [0.9, 0.25, -0.5], [0.0, 0.6, -0.75]),
    ];
    let folder = mesh_folder();
    for (name, file, published_patches, towards, detail) in characters {
        let Some(path) = folder.as_ref().map(|f| f.join("subdivision").join(file)) else { continue };
        let control = read_polygons(&path)?;
        let (towards, up, detail) = (towards.into(), Vec3::Y, detail.into());
        scenes.push(Scene { name, control, published_patches, towards, up, detail });
    }
    let (towards, detail) = (Vec3::new(0.5, 0.4, 1.0), Vec3::new(0.3, 0.3, 0.6));
    let (control, published_patches, up) = (cube(), 6, Vec3::Y);
    scenes.push(Scene { name: "sphere", control, published_patches, towards, up, detail });
    Ok(scenes)
}

impl Scene {
    fn bounds(&self) -> Aabb {
        Aabb::from_points(&self.control.positions)
    }

    /// The whole object comfortably framed, or a close view of a detail.
    pub fn view(&self, close: bool, size: u32) -> View {
        let bounds = self.bounds();
        let towards = self.towards.normalize();
        let (target, distance) = if close {
            (bounds.center() + 0.5 * bounds.size() * self.detail, 0.32 * bounds.diagonal())
        } else {
            (bounds.center(), 1.25 * bounds.diagonal())
        };
        View::new(target + towards * distance, target, self.up, 0.8, size)
    }

    /// A view of the whole object from a direction and distance that depend on `seed`.
    pub fn random_view(&self, seed: u32, size: u32) -> View {
        let bounds = self.bounds();
        let random = |k: u32| unit(hash(seed ^ k << 20));
        let z = 2.0 * random(1) - 1.0;
        let (sine, cosine) = (std::f32::consts::TAU * random(2)).sin_cos();
        let towards = Vec3::new(cosine, 0.0, sine) * (1.0 - z * z).sqrt() + Vec3::Y * z;
        let distance = (0.5 + random(3)) * bounds.diagonal();
        let up = if z.abs() > 0.9 { Vec3::X } else { Vec3::Y };
        View::new(bounds.center() + towards * distance, bounds.center(), up, 0.8, size)
    }

    /// Five square lights on a ring above the object.
    pub fn lights(&self) -> Vec<Light> {
        let bounds = self.bounds();
        let (center, size) = (bounds.center(), bounds.diagonal());
        (0..5)
            .map(|i| {
                let (sine, cosine) = (std::f32::consts::TAU * (i as f32 + 0.3) / 5.0).sin_cos();
                let middle = center + size * Vec3::new(0.8 * cosine, 0.9, 0.8 * sine);
                let (a, b) = (center - middle).normalize().any_orthonormal_pair();
                let side = 0.3 * size;
                Light { corner: middle - 0.5 * side * (a + b), sides: [a * side, b * side] }
            })
            .collect()
    }
}

impl View {
    /// `width`: of the image at distance 1.
    fn new(eye: Vec3, target: Vec3, up: Vec3, width: f32, size: u32) -> Self {
        let forward = (target - eye).normalize();
        let right = forward.cross(up).normalize();
        let down = forward.cross(right);
        let pixel = width / size as f32;
        let corner = forward - 0.5 * width * (right + down);
        Self { eye, corner, right: right * pixel, down: down * pixel, size }
    }

    /// The ray through the middle of a pixel, and how it changes from pixel to pixel.
    pub fn ray(&self, x: u32, y: u32) -> (Ray, RayDifferential) {
        let direction = self.corner + self.right * (x as f32 + 0.5) + self.down * (y as f32 + 0.5);
        (Ray::new(self.eye, direction), camera_differential(self.right, self.down))
    }

    /// Pixels in tiles of 16 x 16.
    pub fn pixels(&self) -> impl Iterator<Item = (u32, u32)> {
        let (size, tiles) = (self.size, self.size.div_ceil(16));
        (0..tiles * tiles)
            .flat_map(move |tile| {
                (0..256).map(move |i| (tile % tiles * 16 + i % 16, tile / tiles * 16 + i / 16))
            })
            .filter(move |&(x, y)| x < size && y < size)
    }
}

impl Light {
    /// A point in stratum `i` of `strata[0]` x `strata[1]`, and the strata's sides.
    pub fn sample(&self, i: u32, strata: [u32; 2], jitter: Vec2) -> (Vec3, [Vec3; 2]) {
        let steps = [self.sides[0] / strata[0] as f32, self.sides[1] / strata[1] as f32];
        let (x, y) = ((i % strata[0]) as f32 + jitter.x, (i / strata[0]) as f32 + jitter.y);
        (self.corner + steps[0] * x + steps[1] * y, steps)
    }
}

/// The shadow ray from `point` to `light`, which diverges from `d_point` to the sides of a stratum.
pub fn shadow(point: Vec3, light: Vec3, d_point: [Vec3; 2], strata: [Vec3; 2]) -> (Ray, RayDifferential) {
    (Ray::between(point, light), light_differential(d_point, strata))
}
