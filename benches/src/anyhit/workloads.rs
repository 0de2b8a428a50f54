//! Meshes and rays of the suite.

use crate::{entry::ALPHA, scenes};
use anyhow::Result;
use serde_json::{Value, json};
use std::path::PathBuf;
use umbrage_geom::{Ray, TriangleMesh};

/// Where a mesh comes from.
pub struct Source {
    pub name: String,
    kind: Kind,
}

enum Kind {
    File(PathBuf),
    /// About so many triangles.
    Generated(usize),
}

/// A mesh under test.
pub struct Case {
    pub name: String,
    pub mesh: TriangleMesh,
}

/// Rays under test.
pub struct Workload {
    /// What rows say about it.
    pub params: Value,
    pub rays: Vec<Ray>,
    /// Triangles dim instead of blocking.
    pub transparent: bool,
    /// Also measured on several threads.
    pub on_threads: bool,
}

const QUICK_MESHES: [&str; 3] = ["bunny_60k", "armadillo_86k", "rocker_arm"];
const MORE_MESHES: [&str; 10] = [
    "bunny_6k",
    "cow",
    "dragon_871k",
    "fandisk",
    "fertility",
    "goathead",
    "skull_10k",
    "sphere_1280",
    "spot",
    "torus_4608",
];
const GENERATED: [(&str, usize); 6] = [
    ("hairball", 2_880_000),
    ("city", 879_000),
    ("cathedral", 77_000),
    ("bush", 500_000),
    ("bamboo", 5_200_000),
    ("dragonish", 870_000),
];
/// Most triangles of a generated mesh in the quick form.
const QUICK_TRIANGLES: usize = 300_000;

/// All meshes of the suite.
pub fn sources(quick: bool) -> Vec<Source> {
    let mut sources = Vec::new();
    match scenes::mesh_folder() {
        None => {
            eprintln!("no folder ../shared/meshes and no UMBRAGE_MESHES: rows of real meshes are skipped")
        }
        Some(folder) => {
            let more = if quick { &[][..] } else { &MORE_MESHES[..] };
            sources.extend(QUICK_MESHES.iter().chain(more).map(|name| {
                let path = folder.join("closed").join(name).with_extension("obj");
                Source { name: (*name).into(), kind: Kind::File(path) }
            }));
            let kind = Kind::File(folder.join("scenes/sibenik.obj"));
            sources.push(Source { name: "sibenik".into(), kind });
        }
    }
    sources.extend(GENERATED.iter().map(|&(name, triangles)| {
        let triangles = if quick { triangles.min(QUICK_TRIANGLES) } else { triangles };
        Source { name: name.into(), kind: Kind::Generated(triangles) }
    }));
    sources
}

impl Source {
    /// Reads or generates the mesh.
    pub fn load(&self) -> Result<Case> {
        let mesh = match &self.kind {
            Kind::File(path) => umbrage_scene::read_mesh(path)?,
            Kind::Generated(triangles) => scenes::generated(&self.name, *triangles)?,
        };
        Ok(Case { name: self.name.clone(), mesh })
    }
}

/// All workloads over a mesh: opaque ones first, then the same with semi-transparent triangles (in the quick form two of them).
pub fn workloads(case: &Case, quick: bool) -> Vec<Workload> {
    let bounds = case.mesh.bounds();
    let receivers = scenes::receivers(&case.mesh, if quick { 3_000 } else { 12_000 }, 1);
    // In the quick form two scenes stand for all on several threads.
    let threaded = !quick || ["bunny_60k", "hairball"].contains(&case.name.as_str());
    let opaque = |params: Value, rays, on_threads| Workload { params, rays, transparent: false, on_threads };
    let mut workloads = Vec::new();
    for radius in [Some(0.01f32), Some(0.03), Some(0.1), None] {
        let length = radius.map_or(f32::INFINITY, |r| r * bounds.diagonal());
        let params =
            json!({ "workload": "ao", "radius": radius.map(|r| (f64::from(r) * 1e3).round() / 1e3) });
        let rays = scenes::ambient_rays(&receivers, 16, length);
        workloads.push(opaque(params, rays, threaded && (!quick || radius == Some(0.1))));
    }
    let rays = scenes::shadow_rays(&receivers, &bounds, 16);
    workloads.push(opaque(json!({ "workload": "shadow" }), rays, threaded && !quick));
    let rays = scenes::camera_rays(&bounds, if quick { 256 } else { 512 });
    workloads.push(opaque(json!({ "workload": "camera" }), rays, threaded && !quick));
    let dimming: Vec<Workload> = workloads
        .iter()
        .filter(|workload| {
            !quick || workload.params["workload"] == "shadow" || workload.params["radius"] == 0.1
        })
        .map(|workload| {
            let mut params = workload.params.clone();
            params["alpha"] = json!((f64::from(ALPHA) * 1e3).round() / 1e3);
            Workload { params, rays: workload.rays.clone(), transparent: true, on_threads: false }
        })
        .collect();
    workloads.extend(dimming);
    workloads
}
