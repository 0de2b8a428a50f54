//! Scenes and shadow rays as in Djeu11, section 3.7.2: a mesh on a ground plane under five area lights on a ring.

use crate::scenes;
use anyhow::Result;
use std::{f32::consts::TAU, ops::Range, path::Path};
use umbrage_accel::{BuildOptions, Bvh};
use umbrage_geom::{
    Aabb, MeshObject, Ray, TriangleMesh,
    glam::{Affine3A, Vec2, Vec3},
    offset_origin,
    sampling::RandomStream,
};
use umbrage_occlusion::volumetric::Object;
use umbrage_query::Occluders;
use umbrage_scene::{Camera, Instance, Material, NamedMesh, Settings};

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

/// A horizontal square; a point if its size is 0, to which one ray a receiver goes.
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

/// A point that is shaded.
struct Receiver {
    point: Vec3,
    normal: Vec3,
    pixel: u32,
}

/// All shadow rays of an image, tile by tile: those to area lights light by light, then receiver by receiver; those to points the
/// other way round. So rays that share an origin follow each other.
pub struct Shadows {
    pub rays: Vec<Ray>,
    pub fans: Vec<Fan>,
    /// Width and height of the image, pixels.
    pub side: u32,
}

/// Scales so that the diagonal is `size`, turns, and moves the middle of the base to `at`.
fn placing(mesh: &TriangleMesh, at: Vec3, size: f32, angle: f32) -> Affine3A {
    let bounds = mesh.bounds();
    let base = Vec3::new(bounds.center().x, bounds.min.y, bounds.center().z);
    Affine3A::from_translation(at)
        * Affine3A::from_rotation_y(angle)
        * Affine3A::from_scale(Vec3::splat(size / bounds.diagonal()))
        * Affine3A::from_translation(-base)
}

fn moved(mesh: &TriangleMesh, map: &Affine3A) -> TriangleMesh {
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

/// Five square lights on a ring above and behind what is looked at, so that shadows fall together, towards the camera.
///
/// The dissertation doesn't say where its lights are; in its images about 40 % of the shadow rays are occluded (section 4.8.2), which
/// lights all around the mesh can't reach: their shadows lie apart, and most of the ground sees four of them.
fn ring(center: Vec3, radius: f32, size: f32) -> Vec<Light> {
    let light = |i: u32| {
        let angle = 0.3 + i as f32 * TAU / 5.0;
        Light { center: center + Vec3::new(angle.cos(), 0.0, angle.sin()) * radius, size }
    };
    (0..5).map(light).collect()
}

/// `count` point lights spread over the sky.
fn points(count: u32, center: Vec3, radius: f32) -> Vec<Light> {
    let light = |i: u32| {
        let height = 0.25 + 0.7 * (i as f32 + 0.5) / count as f32;
        let (angle, across) = (i as f32 * 2.399_963, (1.0 - height * height).sqrt());
        Light {
            center: center + Vec3::new(angle.cos() * across, height, angle.sin() * across) * radius,
            size: 0.0,
        }
    };
    (0..count).map(light).collect()
}

/// The generator `stage` as it is, under point lights.
pub fn stage(name: &str, triangles: usize, lights: u32) -> Result<Scene> {
    let mesh = scenes::generated("stage", triangles)?;
    let objects = mesh.objects_or_whole();
    let objects = objects.iter().map(|o| Object { triangles: o.triangles.clone(), opaque: o.opacity == 1.0 });
    let objects = objects.collect();
    let bounds = mesh.bounds();
    let size = 0.5 * bounds.diagonal();
    // The characters, not the ground's full width.
    let look = Vec3::new(bounds.center().x, bounds.min.y + 0.15 * size, bounds.center().z);
    let eye = look + Vec3::new(0.35, 0.4, 1.0) * size;
    let lights = points(lights, look, 1.5 * size);
    Ok(Scene { name: name.into(), mesh, objects, eye, look, lights })
}

/// One object on the ground under point lights.
pub fn single_points(name: &str, mesh: &TriangleMesh, lights: u32) -> Scene {
    let scene = single(name, mesh);
    Scene { lights: points(lights, Vec3::ZERO, 2.0), ..scene }
}

/// One object on the ground.
pub fn single(name: &str, mesh: &TriangleMesh) -> Scene {
    let placed = moved(mesh, &placing(mesh, Vec3::ZERO, 1.0, 0.0));
    // Mesh and shadow fill the image.
    let look = Vec3::new(0.0, 0.2 * placed.bounds().max.y, 0.0);
    let eye = look + Vec3::new(0.3, 0.75, 0.95).normalize() * 1.1;
    let lights = ring(Vec3::new(-0.2, 1.0, -0.55), 0.35, 0.25);
    let (mesh, objects) = join(&[placed], 2.0, -0.0005);
    Scene { name: name.into(), mesh, objects, eye, look, lights }
}

/// Meshes that are placed on the ground, each three times.
const CROWD: [&str; 12] = [
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

/// Meshes, and maps with the mesh that each is for.
pub struct Crowd {
    pub meshes: Vec<TriangleMesh>,
    pub maps: Vec<(usize, Affine3A)>,
}

/// The meshes of `CROWD` in 36 places.
pub fn crowd(folder: &Path, random: &mut RandomStream) -> Result<Crowd> {
    let read =
        |name: &&str| umbrage_scene::read_mesh(&folder.join("closed").join(name).with_extension("obj"));
    let meshes: Vec<TriangleMesh> = CROWD.iter().map(read).collect::<Result<_, _>>()?;
    let map = |k: usize| {
        let (x, z) = ((k % 6) as f32 - 2.5, (k / 6) as f32 - 2.5);
        let at = Vec3::new(x * 0.9 + 0.3 * random.next_unit(), 0.0, z * 0.9 + 0.3 * random.next_unit());
        let mesh = k % meshes.len();
        (mesh, placing(&meshes[mesh], at, 0.5 + 0.5 * random.next_unit(), TAU * random.next_unit()))
    };
    let maps = (0..36).map(map).collect();
    Ok(Crowd { meshes, maps })
}

/// 36 objects on the ground, with `leaves` small squares above them.
pub fn many(name: &str, folder: &Path, leaves: u32) -> Result<Scene> {
    let mut random = RandomStream::new(7, 0);
    let Crowd { meshes, maps } = crowd(folder, &mut random)?;
    let mut parts: Vec<TriangleMesh> = maps.iter().map(|(mesh, map)| moved(&meshes[*mesh], map)).collect();
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
    let lights = ring(Vec3::new(-0.6, 1.6, -4.2), 1.0, 0.75);
    let eye = Vec3::new(2.0, if leaves > 0 { 0.9 } else { 3.0 }, 5.0);
    Ok(Scene { name: name.into(), mesh, objects, eye, look: Vec3::new(0.0, 0.2, 0.0), lights })
}

impl Shadows {
    /// Rays that are answered by one call, with their light: a fan, or if `together` all of a tile to one area light, and all
    /// of the image to points.
    pub fn runs(&self, together: bool) -> impl Iterator<Item = (Option<usize>, Range<usize>)> {
        let points = self.rays.len() == self.fans.len();
        let same = move |a: &Fan, b: &Fan| together && (points || a.light == b.light);
        self.fans.chunk_by(same).map(move |fans| {
            let light = (!together || !points).then_some(fans[0].light as usize);
            (light, fans[0].start as usize..fans[fans.len() - 1].end as usize)
        })
    }
}

impl Scene {
    /// What the renderer traces.
    pub fn occluders(&self) -> Result<Occluders> {
        let mut mesh = self.mesh.clone();
        let object =
            |o: &Object| MeshObject { name: String::new(), triangles: o.triangles.clone(), opacity: 1.0 };
        mesh.objects = self.objects.iter().map(object).collect();
        let material = Material { name: "matter".into(), albedo: [0.7; 3], opacity: 1.0 };
        let instance = Instance {
            name: self.name.clone(),
            mesh: 0,
            world_from_object: Affine3A::IDENTITY,
            materials: vec![0; mesh.objects.len()],
        };
        let camera = Camera {
            position: self.eye.to_array(),
            target: self.look.to_array(),
            up: [0.0, 1.0, 0.0],
            fov: 44.0,
            lens_radius: 0.0,
            focus_distance: None,
        };
        let scene = umbrage_scene::Scene {
            camera,
            meshes: vec![NamedMesh::new(self.name.clone(), mesh)],
            instances: vec![instance],
            materials: vec![material],
            lights: Vec::new(),
            ambient: None,
            background: [0.0; 3],
            settings: Settings::default(),
        };
        Ok(Occluders::of_scene(&scene, &mut |_| true)?)
    }

    /// Shadow rays of an image of `side` x `side` pixels, `per_light` to each light that the surface faces; of tiles of
    /// 16 x 16 pixels, one in `step`. There are `step` such parts of the image, and this is number `part`.
    pub fn shadows(&self, bvh: &Bvh, side: u32, per_light: u32, step: u32, part: u32) -> Shadows {
        let tiles = side / 16;
        let mut shadows = Shadows { rays: Vec::new(), fans: Vec::new(), side };
        let count = tiles * tiles / step;
        // Scattered by a stride that has no factor in common with the number of tiles.
        let chosen = (part * count..(part + 1) * count).map(|i| i.wrapping_mul(1_597) % (tiles * tiles));
        let mut receivers = Vec::new();
        for tile in chosen {
            receivers.clear();
            for place in 0..256 {
                let (x, y) = (tile % tiles * 16 + place % 16, tile / tiles * 16 + place / 16);
                let ray = self.camera_ray(x, y, side);
                let Some(hit) = bvh.closest_hit(&ray) else { continue };
                let [a, b, c] = self.mesh.triangle(hit.prim_index as usize).map(Vec3::from);
                let normal = (b - a).cross(c - a).normalize_or_zero();
                let normal = if normal.dot(ray.direction) > 0.0 { -normal } else { normal };
                let point = a + (b - a) * hit.u + (c - a) * hit.v;
                let magnitude = a.abs().max(b.abs()).max(c.abs()).max_element();
                let point = offset_origin(point, normal, normal, magnitude);
                receivers.push(Receiver { point, normal, pixel: y * side + x });
            }
            let count = self.lights.len();
            if self.lights.iter().all(|light| light.size == 0.0) {
                for receiver in &receivers {
                    (0..count).for_each(|light| self.add_fan(&mut shadows, receiver, light, per_light));
                }
            } else {
                for light in 0..count {
                    receivers
                        .iter()
                        .for_each(|receiver| self.add_fan(&mut shadows, receiver, light, per_light));
                }
            }
        }
        shadows
    }

    /// Shadow rays of such an image, if all of it sees all lights: what is known before there is one.
    pub fn ray_count(&self, side: u32, per_light: u32) -> f64 {
        let of = |light: &Light| if light.size == 0.0 { 1.0 } else { f64::from(per_light) };
        f64::from(side) * f64::from(side) * self.lights.iter().map(of).sum::<f64>()
    }

    /// The ray through the middle of a pixel.
    fn camera_ray(&self, x: u32, y: u32, side: u32) -> Ray {
        let forward = (self.look - self.eye).normalize();
        let right = forward.cross(Vec3::Y).normalize();
        let up = right.cross(forward);
        let offset = |i: u32| 0.8 * ((i as f32 + 0.5) / side as f32 - 0.5);
        Ray::new(self.eye, forward + right * offset(x) - up * offset(y))
    }

    /// Normals of what each pixel sees of `mesh`.
    pub fn first_normals(&self, mesh: &TriangleMesh, side: u32) -> Result<Vec<Option<Vec3>>> {
        let bvh = Bvh::build(&mesh.positions, &mesh.triangles, &BuildOptions::default())?;
        let normal = |i: u32| {
            let hit = bvh.closest_hit(&self.camera_ray(i % side, i / side, side))?;
            let [a, b, c] = mesh.triangle(hit.prim_index as usize).map(Vec3::from);
            Some((b - a).cross(c - a).normalize_or_zero())
        };
        Ok((0..side * side).map(normal).collect())
    }

    /// Rays from a receiver to a light, if it faces it.
    fn add_fan(&self, shadows: &mut Shadows, receiver: &Receiver, light: usize, per_light: u32) {
        let &Receiver { point, normal, pixel } = receiver;
        let shape = self.lights[light];
        if normal.dot(shape.center - point) <= 0.0 {
            return;
        }
        let mut random = RandomStream::new(99 + light as u32, pixel);
        let columns = per_light.min(5);
        let start = shadows.rays.len() as u32;
        let per_light = if shape.size == 0.0 { 1 } else { per_light };
        for k in 0..per_light {
            let cell = Vec2::new((k % columns) as f32, (k / columns) as f32);
            let jitter = Vec2::new(random.next_unit(), random.next_unit());
            let rows = per_light.div_ceil(columns);
            let at = ((cell + jitter) / Vec2::new(columns as f32, rows as f32) - 0.5) * shape.size;
            shadows.rays.push(Ray::between(point, shape.center + Vec3::new(at.x, 0.0, at.y)));
        }
        shadows.fans.push(Fan { light: light as u32, pixel, start, end: shadows.rays.len() as u32 });
    }
}

/// A closed mesh by name: a file of the folder, else a generator.
pub fn closed_mesh(name: &str, quick: bool) -> Result<Option<TriangleMesh>> {
    let generated = |triangles| scenes::generated(name, triangles).map(Some);
    match name {
        "dragonish" => generated(if quick { 100_000 } else { 870_000 }),
        "knots" | "blob" => generated(if quick { 30_000 } else { 120_000 }),
        _ => match scenes::mesh_folder() {
            Some(folder) => {
                Ok(Some(umbrage_scene::read_mesh(&folder.join("closed").join(name).with_extension("obj"))?))
            }
            None => Ok(None),
        },
    }
}
