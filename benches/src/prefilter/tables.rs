//! Tables 1 and 2 (build times, memory), refit, and the forest.

use super::case::{Case, Kind};
use crate::rows::{Output, Row, Timed, alternate, median, paired_speedup};
use anyhow::Result;
use serde_json::json;
use std::{sync::Arc, time::Instant};
use umbrage_accel::{BuildOptions, Bvh, InstancedBvh, Placement};
use umbrage_geom::{
    OpticalDepth, Ray, TriangleMesh,
    glam::{Affine3A, Quat, Vec3},
    sampling::RandomStream,
};
use umbrage_occlusion::prefilter::{
    ConeQuery, ConeRay, PrefilterOptions, Prefiltered, PrefilteredInstances, published::Storage,
};
use umbrage_scene::generate::{Parameters, generate};

/// Seconds that `job` takes.
fn timed<T>(job: impl FnOnce() -> Result<T>) -> Result<(T, f64)> {
    let start = Instant::now();
    let result = job()?;
    Ok((result, start.elapsed().as_secs_f64()))
}

/// Table 1 and table 2.
pub fn run(case: &Case, output: &mut Output) -> Result<()> {
    let triangles = case.mesh.positions.len() * 12 + case.mesh.triangles.len() * 12;
    for storage in Storage::ALL {
        let options = PrefilterOptions::default().with_storage(storage);
        let (mut scene, build_s) = case.prefiltered(&options)?;
        // A refit measures all opacities again, and moves boxes, which takes little.
        let ((), pass_s) = timed(|| Ok(scene.refit(&case.mesh.positions, &mut |_| true)?))?;
        let bytes = scene.bytes();
        let held = bytes.hierarchy + bytes.triangle_opacities;
        output.row(&Row {
            suite: "prefilter",
            scene: case.source.name.into(),
            method: "prefilter".into(),
            params: json!({ "table": "1, 2", "storage": storage.name(), "triangles": case.opacity.len() }),
            time_s: pass_s,
            build_s,
            mrays_s: 0.0,
            rmse: 0.0,
            bias: 0.0,
            bytes: held + bytes.opacities,
            counters: json!({
                "opacity_pass_s": pass_s, "hierarchy_s": build_s - pass_s, "bvh_build_s": case.bvh_build_s,
                "pass_over_bvh_build": pass_s / case.bvh_build_s, "hierarchy_bytes": held,
                "opacity_bytes": bytes.opacities, "triangle_bytes": triangles,
                "overhead": bytes.opacities as f64 / (held + triangles) as f64,
                "bvh_bytes": case.bvh.bytes(), "may_stop": scene.stop_share(),
            }),
            baseline: "bvh",
            speedup: case.bvh_build_s / pass_s,
        })?;
    }
    Ok(())
}

/// Time and error of a refit against those of a rebuild, after the scene has swayed.
pub fn refit(case: &Case, output: &mut Output) -> Result<()> {
    let low = case.mesh.bounds().min.y;
    let size = case.mesh.bounds().size().y;
    let ground = case.mesh.positions.len() - 4;
    let sway = |p: &[f32; 3]| {
        let up = (p[1] - low) / size;
        [p[0] + 0.2 * size * up * up, p[1], p[2] + 0.1 * size * up * up]
    };
    let mut positions: Vec<[f32; 3]> = case.mesh.positions[..ground].iter().map(sway).collect();
    let triangles = case.mesh.triangles[..case.mesh.triangles.len() - 2].to_vec();
    let moved = Case::new(case.source, TriangleMesh::new(positions.clone(), triangles)?, 40)?;
    positions.extend_from_slice(&moved.mesh.positions[ground..]);
    let (mut kept, _) = case.prefiltered(&PrefilterOptions::default())?;
    let ((), refit_s) = timed(|| Ok(kept.refit(&positions, &mut |_| true)?))?;
    let (fresh, rebuild_s) = moved.prefiltered(&PrefilterOptions::default())?;
    let cones = moved.rays(Kind::Whole, 16, 5);
    let query = moved.query();
    let mut answers = [vec![0.0; cones.len()], vec![0.0; cones.len()]];
    let [a, b] = &mut answers;
    let (mut of_kept, mut of_fresh) = (
        || kept.transmittances_with(&cones, &query, a, &mut ()),
        || fresh.transmittances_with(&cones, &query, b, &mut ()),
    );
    let times = alternate(3, &mut [&mut of_kept as &mut dyn Timed, &mut of_fresh]);
    for (name, i, own) in [("refit", 0, refit_s), ("rebuild", 1, rebuild_s)] {
        let (rmse, bias) = moved.errors(Kind::Whole, 16, &answers[i]);
        output.row(&Row {
            suite: "prefilter",
            scene: case.source.name.into(),
            method: name.into(),
            params: json!({ "motion": "sway", "rays": 16, "triangles": case.opacity.len() }),
            time_s: median(&times[i]),
            build_s: own,
            mrays_s: cones.len() as f64 / median(&times[i]) * 1e-6,
            rmse,
            bias,
            bytes: 0,
            counters: json!({ "rebuild_over_own": rebuild_s / own }),
            baseline: "rebuild",
            speedup: paired_speedup(&times[1], &times[i]),
        })?;
    }
    Ok(())
}

/// Thousands of instances of one bush, more than 10^9 triangles in all.
pub fn forest(quick: bool, output: &mut Output) -> Result<()> {
    let (triangles, side) = if quick { (100_000, 20) } else { (500_000, 50) };
    let parameters = Parameters { triangles: Some(triangles), ..Parameters::default() };
    let mesh = generate("bush", &parameters)?.mesh;
    let mut random = RandomStream::new(1, 3);
    let placements: Vec<Placement> = (0..side * side)
        .map(|i| {
            let mut jitter = || (random.next_unit() - 0.5) * 0.8;
            let place =
                Vec3::new((i % side) as f32 * 2.1 + jitter(), 0.0, (i / side) as f32 * 2.1 + jitter());
            let scale = Vec3::splat(1.0 + 0.5 * jitter());
            let turn = Quat::from_rotation_y(8.0 * jitter());
            Placement {
                bvh: 0,
                world_from_object: Affine3A::from_scale_rotation_translation(scale, turn, place),
            }
        })
        .collect();
    let (bvh, bvh_s) = timed(|| Ok(Bvh::build(&mesh.positions, &mesh.triangles, &BuildOptions::default())?))?;
    let top = InstancedBvh::build(vec![Arc::new(bvh)], &placements)?;
    let (scene, build_s) = timed(|| {
        let options = PrefilterOptions::default();
        Ok(Prefiltered::build(&mesh.positions, &mesh.triangles, &[0.85], &options, &mut |_| true)?)
    })?;
    let instances = PrefilteredInstances::new(&top, vec![Arc::new(scene)], &vec![0; placements.len()])?;
    // Receivers on the ground between the bushes, a square light high above the middle.
    let (extent, rays) = (side as f32 * 2.1, 16u32);
    let mut point = || Vec3::new(random.next_unit() * extent, 1e-3, random.next_unit() * extent);
    let receivers: Vec<Vec3> = (0..if quick { 150 } else { 600 }).map(|_| point()).collect();
    let light = |s: umbrage_geom::glam::Vec2| {
        Vec3::new((0.4 + 0.2 * s.x) * extent, 0.6 * extent, (0.4 + 0.2 * s.y) * extent)
    };
    let fans = |rays: u32, seed: u32| -> Vec<ConeRay> {
        let of = |(i, &p): (usize, &Vec3)| {
            let toward = light(umbrage_geom::glam::Vec2::splat(0.5)) - p;
            let angle = (0.2 * extent).powi(2) * toward.normalize().y / toward.length_squared();
            umbrage_geom::sampling::stratified(rays, umbrage_geom::sampling::combine(seed, i as u32))
                .into_iter()
                .map(move |s| ConeRay { ray: Ray::between(p, light(s)), solid_angle: angle / rays as f32 })
                .collect::<Vec<_>>()
        };
        receivers.iter().enumerate().flat_map(of).collect()
    };
    let depth = OpticalDepth::from_opacity(0.85);
    let exact = |ray: &ConeRay| top.transmittance(&ray.ray, |_, _| depth).transmittance();
    let mean = |passed: Vec<f32>, rays: u32| -> Vec<f64> {
        let of = |c: &[f32]| c.iter().map(|&x| f64::from(x)).sum::<f64>() / f64::from(rays);
        passed.chunks(rays as usize).map(of).collect()
    };
    let truth = mean(fans(256, 7).iter().map(exact).collect(), 256);
    let cones = fans(rays, 5);
    let query = ConeQuery::new(0.2)?;
    let (mut a, mut b) = (Vec::new(), Vec::new());
    let (mut of_exact, mut of_own) = (
        || a = cones.iter().map(exact).collect::<Vec<f32>>(),
        || b = cones.iter().map(|ray| instances.transmittance(ray, &query)).collect::<Vec<f32>>(),
    );
    let times = alternate(3, &mut [&mut of_exact as &mut dyn Timed, &mut of_own]);
    for (i, (method, answers)) in [("bvh", a), ("prefilter", b)].into_iter().enumerate() {
        let errors: Vec<f64> = mean(answers, rays).iter().zip(&truth).map(|(x, t)| x - t).collect();
        let count = errors.len() as f64;
        output.row(&Row {
            suite: "prefilter",
            scene: "forest".into(),
            method: method.into(),
            params: json!({
                "instances": placements.len(), "effective_triangles": placements.len() * mesh.triangles.len(),
                "rays": rays,
            }),
            time_s: median(&times[i]),
            build_s: if i == 0 { bvh_s } else { build_s },
            mrays_s: cones.len() as f64 / median(&times[i]) * 1e-6,
            rmse: (errors.iter().map(|e| e * e).sum::<f64>() / count).sqrt(),
            bias: errors.iter().sum::<f64>() / count,
            bytes: top.bytes() + mesh.bytes() + if i == 1 { instances.bytes() } else { 0 },
            counters: json!({ "mean_visibility": truth.iter().sum::<f64>() / count }),
            baseline: "bvh",
            speedup: paired_speedup(&times[0], &times[i]),
        })?;
    }
    Ok(())
}
