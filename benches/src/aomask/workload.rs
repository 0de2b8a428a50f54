//! Scenes, receivers and their rays.

use super::{Case, camera::View};
use crate::scenes::{self, Receivers};
use anyhow::Result;
use serde_json::Value;
use std::path::PathBuf;
use umbrage_aomask::{MaskOptions, Pattern, Receiver, Sides};
use umbrage_geom::{Ray, TriangleMesh, glam::Vec3, morton, offset_origin};

/// Receivers that stay together: neighbours, as in a bake of the whole scene.
const RUN_RECEIVERS: usize = 32;
/// Receivers of the whole scene that runs are taken from.
const SURFACE_RECEIVERS: usize = 1 << 17;
/// Most triangles of a generated mesh in the quick form.
const QUICK_TRIANGLES: usize = 300_000;

/// Where a mesh comes from.
pub enum Source {
    File(PathBuf),
    Generated(&'static str, usize),
}

impl Source {
    /// The scene that the suite calls `name`; `None` where its file is missing.
    pub fn find(name: &'static str, quick: bool) -> Option<Self> {
        let generated = |triangles: usize| {
            Some(Self::Generated(name, if quick { triangles.min(QUICK_TRIANGLES) } else { triangles }))
        };
        let file = |path: &str| Some(Self::File(super::meshes()?.join(path)));
        match name {
            "bunny" => file("closed/bunny_60k.obj"),
            "armadillo" => file("closed/armadillo_86k.obj"),
            "dragon" => file("closed/dragon_871k.obj"),
            "sibenik" => file("scenes/sibenik.obj"),
            "city" => generated(879_000),
            "bush" => generated(500_000),
            _ => generated(2_880_000),
        }
    }

    /// Reads or generates the mesh.
    pub fn load(&self) -> Result<TriangleMesh> {
        match self {
            Self::File(path) => Ok(umbrage_scene::read_mesh(path)?),
            Self::Generated(name, triangles) => scenes::generated(name, *triangles),
        }
    }
}

/// Receivers and all their rays.
pub struct Workload {
    pub points: Vec<[f32; 3]>,
    pub normals: Vec<[f32; 3]>,
    pub pattern: Pattern,
    pub options: MaskOptions,
    /// Receiver by receiver, in the pattern's order.
    pub rays: Vec<Ray>,
    pub params: Value,
}

impl Workload {
    /// Rays of length `radius`, world units, from all receivers.
    pub fn new(receivers: Receivers, pattern: &Pattern, radius: f32, params: Value) -> Self {
        let options = MaskOptions::default().with_radius(radius);
        let list = |v: &[Vec3]| v.iter().map(Vec3::to_array).collect::<Vec<_>>();
        let (points, normals) = (list(&receivers.points), list(&receivers.normals));
        let mut rays = Vec::with_capacity(points.len() * pattern.len());
        for (i, (&point, &normal)) in points.iter().zip(&normals).enumerate() {
            let seed = Receiver::seed_of(point, normal, options.seed);
            let receiver = Receiver::new(i, point, normal, seed);
            rays.extend(pattern.rays_of(&receiver.expect("points of a mesh with area"), radius));
        }
        Self { points, normals, pattern: pattern.clone(), options, rays, params }
    }

    /// The same where `sides` of triangles block.
    pub fn with_sides(self, sides: Sides) -> Self {
        Self { options: self.options.with_sides(sides), ..self }
    }
}

/// Receivers for about a quarter of a million rays, half as many in the quick form.
fn count(rays: u32, quick: bool) -> usize {
    ((if quick { 1 << 17 } else { 1 << 18 }) / rays as usize).next_multiple_of(RUN_RECEIVERS)
}

/// Runs of neighbours out of a dense set over the whole surface.
pub fn surface(mesh: &TriangleMesh, rays: u32, quick: bool) -> Receivers {
    surface_of(mesh, count(rays, quick))
}

/// About `count` receivers in runs of neighbours out of a dense set over the whole surface.
pub fn surface_of(mesh: &TriangleMesh, count: usize) -> Receivers {
    thin(scenes::receivers(mesh, SURFACE_RECEIVERS, 1), count)
}

/// Runs of neighbours out of what `cameras` see.
pub fn seen(case: &Case, cameras: &[View], rays: u32, quick: bool) -> Receivers {
    let mut all = Receivers { points: Vec::new(), normals: Vec::new() };
    for camera in cameras {
        let (points, normals) = camera.surfaces(case);
        all.points.extend(points);
        all.normals.extend(normals);
    }
    let order = morton::order(&all.points.iter().map(|p| p.to_array()).collect::<Vec<_>>());
    let pick = |v: &[Vec3]| order.iter().map(|&i| v[i as usize]).collect();
    thin(Receivers { points: pick(&all.points), normals: pick(&all.normals) }, count(rays, quick))
}

/// About `count` receivers in evenly spaced runs.
fn thin(receivers: Receivers, count: usize) -> Receivers {
    let runs = receivers.points.len() / RUN_RECEIVERS;
    let wanted = (count / RUN_RECEIVERS).clamp(1, runs.max(1));
    let pick = |v: &[Vec3]| {
        let run = |i: usize| {
            let start = i * runs / wanted * RUN_RECEIVERS;
            v[start..v.len().min(start + RUN_RECEIVERS)].iter().copied()
        };
        (0..wanted).flat_map(run).collect()
    };
    Receivers { points: pick(&receivers.points), normals: pick(&receivers.normals) }
}

/// The point and normal that rays start from where a camera ray hit triangle `index` of `mesh`, on the camera's side.
pub fn receiver_at(mesh: &TriangleMesh, ray: &Ray, index: usize, t: f32) -> Option<(Vec3, Vec3)> {
    let [a, b, c] = mesh.triangle(index).map(Vec3::from);
    let normal = (b - a).as_dvec3().cross((c - a).as_dvec3()).normalize_or_zero().as_vec3();
    let normal = if normal.dot(ray.direction) > 0.0 { -normal } else { normal };
    // Put back into the plane, since `t` is rounded.
    let hit = ray.origin.as_dvec3() + ray.direction.as_dvec3() * f64::from(t);
    let height = (hit - a.as_dvec3()).dot(normal.as_dvec3());
    let point = (hit - normal.as_dvec3() * height).as_vec3();
    let magnitude = a.abs().max(b.abs()).max(c.abs()).max_element().max(point.abs().max_element());
    (normal != Vec3::ZERO).then(|| (offset_origin(point, normal, normal, magnitude), normal))
}
