//! Scenes and shadow rays as in [Djeu11], section 3.7.2: a mesh on a ground plane under five area lights on a ring.

use crate::scenes;
use anyhow::Result;
use std::{f32::consts::TAU, path::Path};
use umbrage_accel::{BuildOptions, Bvh};
use umbrage_geom::{
    Aabb, Ray, TriangleMesh,
    glam::{Affine3A, Vec2, Vec3},
    offset_origin,
    sampling::RandomStream,
};
use umbrage_occlusion::volumetric::Object;

/// A mesh with what casts light on it.
pub struct Scene {
    pub name: String,
    pub mesh: TriangleMesh,
    /// The parts of the mesh, each an object.
    pub objects: Vec<Object>,
    eye: Vec3,
    look: Vec3,
    pub lights: Vec<Light>,
}

/// A horizontal square; a point if its size is 0.
#[derive(Clone, Copy)]
pub struct Light {
    center: Vec3,
    size: f32,
}

impl Light {
    pub fn bounds(&self) -> Aabb {
        let half = Vec3::new(0.5, 0.0, 0.5) * self.size;
        Aabb { min: self.center - half, max: self.center + half }
    }
}

/// The rays of one receiver to one light.
#[derive(Clone, Copy)]
pub struct Fan {
    pub light: u32,
    /// Pixel of the receiver.
    pub pixel: u32,
    pub start: u32,
    pub end: u32,
}

/// All shadow rays of an image.
pub struct Shadows {
    pub rays: Vec<Ray>,
    pub fans: Vec<Fan>,
    /// Width and height of the image, pixels.
    pub side: u32,
}

/// Moves and scales so that the diagonal is `size` and the middle of the base is at `at`.
fn place(mesh: &TriangleMesh, at: Vec3, size: f32, angle: f32) -> TriangleMesh {
    let bounds = mesh.bounds();
    let base = Vec3::new(bounds.center().x, bounds.min.y, bounds.center().z);
    let map = Affine3A::from_translation(at)
        * Affine3A::from_rotation_y(angle)
        * Affine3A::from_scale(Vec3::splat(size / bounds.diagonal()))
        * Affine3A::from_translation(-base);
    let positions = mesh.positions.iter().map(|&p| map.transform_point3(p.into()).into()).collect();
    TriangleMesh { positions, triangles: mesh.triangles.clone(), ..TriangleMesh::default() }
}

/// Joins meshes, each an object, and a ground plane of half size `extent` at height `y`.
fn join(parts: &[TriangleMesh], extent: f32, y: f32) -> (TriangleMesh, Vec<Object>) {
    let mut mesh = TriangleMesh::default();
    let mut objects = Vec::new();
    let e = extent;
    let ground = TriangleMesh {
        positions: vec![[-e, y, -e], [e, y, -e], [e, y, e], [-e, y, e]],
        triangles: vec![[0, 2, 1], [0, 3, 2]],
        ..TriangleMesh::default()
    };
    for part in parts.iter().chain([&ground]) {
        let start = mesh.triangles.len() as u32;
        mesh.append(part);
        objects.push(Object { triangles: start..mesh.triangles.len() as u32, opaque: true });
    }
    mesh.objects.clear();
    (mesh, objects)
}

/// Five square lights on a ring.
fn ring(extent: f32) -> Vec<Light> {
    let light = |i: u32| {
        let angle = 0.3 + i as f32 * TAU / 5.0;
        let center = Vec3::new(angle.cos() * 1.2, 0.7, angle.sin() * 1.2) * extent;
        Light { center, size: 0.25 * extent }
    };
    (0..5).map(light).collect()
}

/// One object on the ground.
pub fn single(name: &str, mesh: &TriangleMesh) -> Scene {
    let placed = place(mesh, Vec3::ZERO, 1.0, 0.0);
    let (mesh, objects) = join(&[placed], 2.0, -0.0005);
    let (eye, look) = (Vec3::new(0.35, 0.75, 1.15), Vec3::new(0.0, 0.22, 0.0));
    Scene { name: name.into(), mesh, objects, eye, look, lights: ring(1.0) }
}

/// 36 objects on the ground, with `leaves` small squares above them.
pub fn many(name: &str, folder: &Path, leaves: u32) -> Result<Scene> {
    let names = [
        "bunny_6k",
        "spot",
        "cow",
        "fertility",
        "goathead",
        "rocker_arm",
        "skull_10k",
        "bunny_60k",
        "torus_4608",
        "armadillo_86k",
        "fandisk",
        "sphere_1280",
    ];
    let mut random = RandomStream::new(7, 0);
    let meshes: Vec<TriangleMesh> = names
        .iter()
        .map(|name| Ok(umbrage_scene::read_mesh(&folder.join("closed").join(name).with_extension("obj"))?))
        .collect::<Result<_>>()?;
    let mut parts = Vec::new();
    for k in 0..36 {
        let (x, z) = ((k % 6) as f32 - 2.5, (k / 6) as f32 - 2.5);
        let at = Vec3::new(x * 0.9 + 0.3 * random.next_unit(), 0.0, z * 0.9 + 0.3 * random.next_unit());
        parts.push(place(&meshes[k % 12], at, 0.5 + 0.5 * random.next_unit(), TAU * random.next_unit()));
    }
    if leaves > 0 {
        let mut cloud = TriangleMesh::default();
        for _ in 0..leaves {
            let mut unit = || random.next_unit() - 0.5;
            let center = Vec3::new(unit() * 6.5, 1.5 + unit(), unit() * 6.5);
            let (u, v) = (Vec3::new(unit(), unit(), unit()) * 0.04, Vec3::new(unit(), unit(), unit()) * 0.04);
            let first = cloud.positions.len() as u32;
            cloud.positions.extend(
                [center - u - v, center + u - v, center + u + v, center - u + v].map(|p| p.to_array()),
            );
            cloud.triangles.extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
        }
        parts.push(cloud);
    }
    let (mesh, objects) = join(&parts, 6.0, -0.001);
    let eye = Vec3::new(2.0, if leaves > 0 { 0.9 } else { 3.0 }, -5.0);
    Ok(Scene { name: name.into(), mesh, objects, eye, look: Vec3::new(0.0, 0.2, 0.0), lights: ring(3.0) })
}

impl Scene {
    /// Shadow rays of an image of `side` x `side` pixels, `per_light` to each light that the surface faces; of tiles of
    /// 16 x 16 pixels, one in `step`.
    pub fn shadows(&self, side: u32, per_light: u32, step: u32) -> Result<Shadows> {
        let bvh = Bvh::build(&self.mesh.positions, &self.mesh.triangles, &BuildOptions::default())?;
        let forward = (self.look - self.eye).normalize();
        let right = forward.cross(Vec3::Y).normalize();
        let up = right.cross(forward);
        let tiles = side / 16;
        let mut shadows = Shadows { rays: Vec::new(), fans: Vec::new(), side };
        // Scattered by a stride without common factor.
        let chosen = (0..tiles * tiles / step)
            .map(|i| i.wrapping_mul(2_654_435_769) >> 7)
            .map(|i| i % (tiles * tiles));
        for tile in chosen {
            for place in 0..256 {
                let (x, y) = (tile % tiles * 16 + place % 16, tile / tiles * 16 + place / 16);
                let offset = |i: u32| 0.55 * ((i as f32 + 0.5) / side as f32 - 0.5);
                let ray = Ray::new(self.eye, forward + right * offset(x) - up * offset(y));
                let Some(hit) = bvh.closest_hit(&ray) else { continue };
                let [a, b, c] = self.mesh.triangle(hit.prim_index as usize).map(Vec3::from);
                let normal = (b - a).cross(c - a).normalize_or_zero();
                let normal = if normal.dot(ray.direction) > 0.0 { -normal } else { normal };
                let point = a + (b - a) * hit.u + (c - a) * hit.v;
                let magnitude = a.abs().max(b.abs()).max(c.abs()).max_element();
                let receiver = offset_origin(point, normal, normal, magnitude);
                self.add_fans(&mut shadows, receiver, normal, y * side + x, per_light);
            }
        }
        Ok(shadows)
    }

    /// Rays from one receiver to every light that it faces.
    fn add_fans(&self, shadows: &mut Shadows, receiver: Vec3, normal: Vec3, pixel: u32, per_light: u32) {
        let mut random = RandomStream::new(99, pixel);
        let columns = if per_light >= 4 { 5 } else { 1 };
        for (light, shape) in self.lights.iter().enumerate() {
            if normal.dot(shape.center - receiver) <= 0.0 {
                continue;
            }
            let start = shadows.rays.len() as u32;
            for k in 0..per_light {
                let cell = Vec2::new((k % columns) as f32, (k / columns) as f32);
                let jitter = Vec2::new(random.next_unit(), random.next_unit());
                let rows = per_light.div_ceil(columns);
                let at = ((cell + jitter) / Vec2::new(columns as f32, rows as f32) - 0.5) * shape.size;
                shadows.rays.push(Ray::between(receiver, shape.center + Vec3::new(at.x, 0.0, at.y)));
            }
            shadows.fans.push(Fan { light: light as u32, pixel, start, end: shadows.rays.len() as u32 });
        }
    }
}

/// A closed mesh by name: a file of the folder, else a generator.
pub fn closed_mesh(name: &str, quick: bool) -> Result<Option<TriangleMesh>> {
    let generated = |triangles| scenes::generated(name, triangles).map(Some);
    match name {
        "dragonish" => generated(if quick { 100_000 } else { 870_000 }),
        _ => match scenes::mesh_folder() {
            Some(folder) => {
                Ok(Some(umbrage_scene::read_mesh(&folder.join("closed").join(name).with_extension("obj"))?))
            }
            None => Ok(None),
        },
    }
}
