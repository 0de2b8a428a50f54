//! Suite `anyhit`: is there an occluder, for the rays that rendering and baking ask about.
//!
//! Method `bvh` is what every user gets: the default build and the best instructions of the machine. Its variants
//! `bvh-scalar` (no SIMD) and `bvh-fast` (the quick build) stand beside it; all are measured against `bvh`.

use crate::{
    rows::{Output, Row, alternate, median, note, paired_speedup},
    scenes,
};
use anyhow::Result;
use serde_json::json;
use std::time::Instant;
use umbrage_accel::{BackEnd, BuildOptions, BuildQuality, Bvh, Counters, brute};
use umbrage_geom::{Ray, TriangleMesh};

/// Triangle tests by brute force that a row may spend on checking answers.
const BRUTE_TESTS: usize = 20_000_000;

struct Case {
    name: String,
    mesh: TriangleMesh,
}

struct Workload {
    params: serde_json::Value,
    rays: Vec<Ray>,
}

struct Method {
    name: &'static str,
    bvh: Bvh,
    build_s: f64,
    hits: Vec<bool>,
}

/// Runs the suite.
pub fn run(quick: bool, output: &mut Output) -> Result<()> {
    for case in cases(quick)? {
        run_case(&case, quick, output)?;
    }
    Ok(())
}

fn cases(quick: bool) -> Result<Vec<Case>> {
    let mut cases = Vec::new();
    match scenes::mesh_folder() {
        None => {
            eprintln!("no folder ../shared/meshes and no UMBRAGE_MESHES: rows of real meshes are skipped")
        }
        Some(folder) => {
            let names: &[&str] = if quick {
                &["bunny_60k", "armadillo_86k"]
            } else {
                &["bunny_60k", "armadillo_86k", "dragon_871k"]
            };
            for name in names {
                let mesh = umbrage_scene::read_mesh(&folder.join("closed").join(name).with_extension("obj"))?;
                cases.push(Case { name: (*name).into(), mesh });
            }
            let mesh = umbrage_scene::read_mesh(&folder.join("scenes/sibenik.obj"))?;
            cases.push(Case { name: "sibenik".into(), mesh });
        }
    }
    let generated: [(&str, usize); 6] = [
        ("hairball", 2_880_000),
        ("city", 879_000),
        ("cathedral", 77_000),
        ("bush", 500_000),
        ("bamboo", 5_200_000),
        ("dragonish", 870_000),
    ];
    for (name, triangles) in generated {
        let triangles = if quick { triangles.min(300_000) } else { triangles };
        note(&format!("generating {name}"));
        cases.push(Case { name: name.into(), mesh: scenes::generated(name, triangles)? });
    }
    Ok(cases)
}

fn workloads(case: &Case, quick: bool) -> Vec<Workload> {
    let bounds = case.mesh.bounds();
    let receivers = scenes::receivers(&case.mesh, if quick { 4_000 } else { 40_000 }, 1);
    let mut workloads = Vec::new();
    for radius in [Some(0.01), Some(0.03), Some(0.1), None] {
        let length = radius.map_or(f32::INFINITY, |r: f32| r * bounds.diagonal());
        workloads.push(Workload {
            params: json!({ "workload": "ao", "radius": radius.map(|r| (f64::from(r) * 1e3).round() / 1e3) }),
            rays: scenes::ambient_rays(&receivers, 16, length),
        });
    }
    workloads.push(Workload {
        params: json!({ "workload": "shadow" }),
        rays: scenes::shadow_rays(&receivers, &bounds, 16),
    });
    workloads.push(Workload {
        params: json!({ "workload": "camera" }),
        rays: scenes::camera_rays(&bounds, if quick { 256 } else { 1024 }),
    });
    workloads
}

fn build(name: &'static str, mesh: &TriangleMesh, quality: BuildQuality, scalar: bool) -> Result<Method> {
    let options = BuildOptions::default().with_quality(quality);
    let start = Instant::now();
    let bvh = Bvh::build(&mesh.positions, &mesh.triangles, &options)?;
    let build_s = start.elapsed().as_secs_f64();
    let bvh = if scalar { bvh.with_back_end(BackEnd::Scalar)? } else { bvh };
    Ok(Method { name, bvh, build_s, hits: Vec::new() })
}

fn run_case(case: &Case, quick: bool, output: &mut Output) -> Result<()> {
    let high = BuildOptions::default().quality;
    let mut methods = [
        build("bvh", &case.mesh, high, false)?,
        build("bvh-scalar", &case.mesh, high, true)?,
        build("bvh-fast", &case.mesh, BuildQuality::Fast, false)?,
    ];
    for workload in workloads(case, quick) {
        let rays = &workload.rays;
        // Single thread: rays in the caller's order, one after the other.
        let mut runs: Vec<_> = methods
            .iter_mut()
            .map(|method| {
                method.hits.resize(rays.len(), false);
                || rays.iter().zip(&mut method.hits).for_each(|(ray, hit)| *hit = method.bvh.any_hit(ray))
            })
            .collect();
        let mut runs: Vec<&mut dyn FnMut()> = runs.iter_mut().map(|run| run as &mut dyn FnMut()).collect();
        let times = alternate(if quick { 5 } else { 9 }, &mut runs);
        let truth = brute_force(&case.mesh, rays);
        for (method, own_times) in methods.iter().zip(&times) {
            output.row(&row(case, &workload, method, own_times, &times[0], &methods[0], &truth))?;
        }
    }
    Ok(())
}

/// Answers of every `step`-th ray by testing every triangle.
fn brute_force(mesh: &TriangleMesh, rays: &[Ray]) -> (usize, Vec<bool>) {
    let checked = (BRUTE_TESTS / mesh.triangles.len()).clamp(4, rays.len());
    let step = rays.len().div_ceil(checked);
    let hits = rays.iter().step_by(step).map(|ray| brute::any_hit(&mesh.positions, &mesh.triangles, ray));
    (step, hits.collect())
}

fn row(
    case: &Case,
    workload: &Workload,
    method: &Method,
    times: &[f64],
    baseline_times: &[f64],
    baseline: &Method,
    (step, truth): &(usize, Vec<bool>),
) -> Row {
    let mut counters = Counters::default();
    workload.rays.iter().for_each(|ray| {
        method.bvh.any_hit_with(ray, &mut counters);
    });
    let rays = workload.rays.len();
    let against_brute = method.hits.iter().step_by(*step).zip(truth).filter(|(a, b)| a != b).count();
    let against_baseline = method.hits.iter().zip(&baseline.hits).filter(|(a, b)| a != b).count();
    let different = against_brute.max(against_baseline);
    let share = |n: usize| n as f64 / rays as f64;
    let hits = method.hits.iter().filter(|&&hit| hit).count();
    let baseline_hits = baseline.hits.iter().filter(|&&hit| hit).count();
    let time_s = median(times);
    let mut params = workload.params.clone();
    params["rays"] = json!(rays);
    params["threads"] = json!(1);
    Row {
        suite: "anyhit",
        scene: case.name.clone(),
        method: method.name.into(),
        params,
        time_s,
        build_s: method.build_s,
        mrays_s: rays as f64 / time_s * 1e-6,
        rmse: share(different).sqrt(),
        bias: share(hits) - share(baseline_hits),
        bytes: method.bvh.bytes(),
        counters: json!({
            "triangles": case.mesh.triangles.len(),
            "hits": hits,
            "nodes": counters.nodes,
            "box_tests": counters.box_tests,
            "triangle_tests": counters.triangle_tests,
            "brute_checked": truth.len(),
            "different_bits": different,
        }),
        baseline: "bvh",
        speedup: paired_speedup(baseline_times, times),
    }
}
