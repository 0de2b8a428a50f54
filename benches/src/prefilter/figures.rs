//! Figures 5 (variance), 6 (convergence), 10 (forms of storage), the causes of bias, and error control.

use super::{
    case::{Case, Kind, Source, Workload},
    targets::round,
};
use crate::{
    plot::{self, Series},
    rows::{Output, Row},
};
use anyhow::Result;
use serde_json::{Value, json};
use std::{path::Path, time::Instant};
use umbrage_accel::Statistics;
use umbrage_geom::{Ray, sampling::RandomStream};
use umbrage_occlusion::prefilter::{
    ConeQuery, ConeRay, PrefilterOptions, Prefiltered,
    published::{Blend, CellSampling, Correlation, Published, SegmentEnds, Storage},
};
use umbrage_scene::generate::{ParameterValue, Parameters, generate};

/// A row of error alone.
fn error_row(case: &Case, method: &str, params: Value, (rmse, bias): (f64, f64), counters: Value) -> Row {
    Row {
        suite: "prefilter",
        scene: case.source.name.into(),
        method: method.into(),
        params,
        time_s: 0.0,
        build_s: 0.0,
        mrays_s: 0.0,
        rmse,
        bias,
        bytes: 0,
        counters,
        baseline: "bvh",
        speedup: 1.0,
    }
}

/// Answers of all receivers.
fn answers(scene: &Prefiltered, cones: &[ConeRay], query: &ConeQuery) -> Vec<f32> {
    let mut passed = vec![0.0; cones.len()];
    scene.transmittances(cones, query, &mut passed);
    passed
}

/// Figure 5: variance of the mean of `M` jittered samples of one receiver's view of the light, over `trials`.
pub fn variance(case: &Case, trials: u32, plots: Option<&Path>, output: &mut Output) -> Result<()> {
    const SIDE: u32 = 256;
    let (scene, _) = case.prefiltered(&PrefilterOptions::default())?;
    let Some((receiver, solid_angle)) = case.half_shadow() else { return Ok(()) };
    let mut cones = Vec::new();
    case.fan(receiver, SIDE * SIDE, 1, &mut cones);
    // Each ray of a picture stands for a hundredth of the light, as samples would.
    cones.iter_mut().for_each(|c| c.solid_angle = solid_angle);
    let mut series = Vec::new();
    for (name, query) in
        [("bvh", ConeQuery::EXACT), ("prefilter", ConeQuery::new(2.0)?), ("prefilter", ConeQuery::new(0.1)?)]
    {
        let image = answers(&scene, &cones, &query);
        let mean = image.iter().map(|&x| f64::from(x)).sum::<f64>() / image.len() as f64;
        let mut points = Vec::new();
        for samples in [1u32, 4, 9, 16, 25, 36, 49, 64, 81, 100] {
            let grid = samples.isqrt();
            let mut random = RandomStream::new(samples, 5);
            let mut squares = 0.0;
            for _ in 0..trials {
                let mut sum = 0.0;
                for cell in 0..samples {
                    let mut place = |k: u32| {
                        let at = (k as f32 + random.next_unit()) / grid as f32 * SIDE as f32;
                        (at as u32).min(SIDE - 1)
                    };
                    let (x, y) = (place(cell % grid), place(cell / grid));
                    sum += f64::from(image[(y * SIDE + x) as usize]);
                }
                squares += (sum / f64::from(samples) - mean).powi(2);
            }
            let t = query.threshold();
            let params = json!({
                "figure": "5", "samples": samples, "trials": trials,
                "t": if t.is_finite() { json!(round(t)) } else { Value::Null },
            });
            let variance = squares / f64::from(trials);
            points.push([f64::from(samples), variance]);
            let counters = json!({ "variance": variance, "mean": mean });
            output.row(&error_row(case, name, params, (variance.sqrt(), 0.0), counters))?;
        }
        let t = query.threshold();
        let name = if t.is_finite() { format!("T = {t}") } else { "exact".into() };
        series.push(Series { name, points, filled: true });
    }
    if let Some(folder) = plots {
        let file = format!("prefilter-variance-{}.svg", case.source.name);
        let labels = ["samples", "variance of their mean"];
        plot::save(folder, &file, "Figure 5: one receiver's view of the light", labels, &series)?;
    }
    Ok(())
}

/// Levels at which rays end: the root's children are on level 1.
pub struct Levels {
    of_node: Vec<u32>,
    count: usize,
    ends: u64,
    sum: u64,
}

impl Levels {
    pub fn new(scene: &Prefiltered) -> Self {
        let levels = scene.levels();
        let mut of_node = vec![0; levels.iter().map(Vec::len).sum()];
        for (level, nodes) in levels.iter().enumerate() {
            nodes.iter().for_each(|&node| of_node[node as usize] = level as u32 + 1);
        }
        Self { of_node, count: levels.len(), ends: 0, sum: 0 }
    }

    /// Forgets what was counted.
    pub fn restart(&mut self) {
        (self.ends, self.sum) = (0, 0);
    }

    /// Mean level, over the number of levels; `None` if no ray ended at a node.
    pub fn mean(&self) -> Option<f32> {
        (self.ends > 0).then(|| self.sum as f32 / self.ends as f32 / self.count as f32)
    }
}

impl Statistics for Levels {
    fn ended_at_node(&mut self, node: u32, slots: u32) {
        let ends = u64::from(slots.count_ones());
        self.ends += ends;
        self.sum += ends * u64::from(self.of_node[node as usize]);
    }
}

/// Figure 6: 4, 16 and 64 rays at T = 0.2, with the levels at which they end.
pub fn convergence(case: &Case, output: &mut Output) -> Result<()> {
    let (scene, _) = case.prefiltered(&PrefilterOptions::default())?;
    for rays in [4, 16, 64] {
        let cones = case.rays(Kind::Whole, rays, 5);
        let mut passed = vec![0.0; cones.len()];
        let mut levels = Levels::new(&scene);
        scene.transmittances_with(&cones, &ConeQuery::new(0.2)?, &mut passed, &mut levels);
        let counters = json!({
            "ends_a_ray": levels.ends as f64 / cones.len() as f64,
            "mean_level": levels.sum as f64 / levels.ends.max(1) as f64, "levels": levels.count,
        });
        let params = json!({ "figure": "6", "rays": rays, "t": 0.2 });
        output.row(&error_row(
            case,
            "prefilter",
            params,
            case.errors(Kind::Whole, rays, &passed),
            counters,
        ))?;
    }
    Ok(())
}

/// Figure 10: every form of storage.
pub fn storage(case: &Case, output: &mut Output) -> Result<()> {
    let cones = case.rays(Kind::Whole, 16, 5);
    for storage in Storage::ALL {
        let (scene, _) = case.prefiltered(&PrefilterOptions::default().with_storage(storage))?;
        let errors = case.errors(Kind::Whole, 16, &answers(&scene, &cones, &case.query()));
        let params = json!({ "figure": "10", "storage": storage.name(), "rays": 16 });
        let counters = json!({ "opacity_bytes": scene.bytes().opacities });
        output.row(&error_row(case, "prefilter", params, errors, counters))?;
    }
    Ok(())
}

/// Figure 10, last rows: flat particles that all face one way, with finer cube maps.
pub fn particles(triangles: usize, width: u32, output: &mut Output) -> Result<()> {
    for mode in ["transmit", "block"] {
        let values = [("mode".to_owned(), ParameterValue::Text(mode.into()))].into();
        let parameters = Parameters { triangles: Some(triangles), values, ..Parameters::default() };
        let mesh = generate("particles", &parameters)?.mesh;
        let source = Source {
            name: if mode == "block" { "particles-block" } else { "particles-transmit" },
            generator: "particles",
            triangles,
            alpha: 1.0,
            workload: Workload::Shadow,
            distance: 1.0,
        };
        let case = Case::new(source, mesh, width)?;
        let cones = case.rays(Kind::Ground, 16, 5);
        for (storage, directions) in [
            (Storage::CubeU8, 3),
            (Storage::CubeU8, 12),
            (Storage::Harmonics4, 12),
            (Storage::Harmonics2, 12),
            (Storage::Average, 12),
            (Storage::SphereArea, 3),
        ] {
            let options = PrefilterOptions::default().with_storage(storage).with_directions(directions);
            let (scene, _) = case.prefiltered(&options)?;
            let errors = case.errors(Kind::Ground, 16, &answers(&scene, &cones, &case.query()));
            let params = json!({
                "figure": "10", "storage": storage.name(), "directions": directions, "rays": 16,
                "receivers": "ground",
            });
            let counters = json!({ "mean_visibility": case.mean_visibility() });
            output.row(&error_row(&case, "prefilter", params, errors, counters))?;
        }
    }
    Ok(())
}

/// Bias as published and with each remedy taken back; and that of Algorithm 1 itself, on a smaller scene.
pub fn bias(case: &Case, output: &mut Output) -> Result<()> {
    let default = PrefilterOptions::default();
    let height = |k| default.with_correlation(Correlation::Height(k));
    let query = case.query();
    let whole = query.with_ends(SegmentEnds::Whole);
    // Variants of the query share what was built.
    let variants = [
        (
            default,
            vec![
                ("default", query),
                ("whole crossings", whole),
                ("any angle", query.with_widest(1e3)?),
                ("no blending", query.with_blend(Blend::None)),
            ],
        ),
        (default.with_sampling(CellSampling::Center), vec![("centre directions", query)]),
        (default.with_directions(4), vec![("N_C = 4", query)]),
        (default.with_directions(6), vec![("N_C = 6", query)]),
        (height(0.0), vec![("K = 0", query)]),
        (height(5.0), vec![("K = 5", query)]),
        (default.with_storage(Storage::Average), vec![("no directions", query)]),
        (
            height(5.0).with_sampling(CellSampling::Center),
            vec![("as published, K = 5", whole.with_widest(1e3)?)],
        ),
    ];
    let cones = [4, 16].map(|rays| (rays, case.rays(Kind::Whole, rays, 5)));
    for (options, queries) in &variants {
        let (scene, _) = case.prefiltered(options)?;
        for ((name, query), (rays, cones)) in queries.iter().flat_map(|q| cones.iter().map(move |c| (q, c))) {
            let (rmse, bias) = case.errors(Kind::Whole, *rays, &answers(&scene, cones, query));
            let relative = bias / case.mean_visibility();
            let params = json!({ "variant": name, "rays": rays });
            let counters = json!({ "relative_bias": relative, "mean_visibility": case.mean_visibility() });
            output.row(&error_row(case, "prefilter", params, (rmse, bias), counters))?;
        }
    }
    let small = Case::generate(case.source, 30_000, 40)?;
    let (positions, triangles) = (&small.mesh.positions, &small.mesh.triangles);
    let (scene, _) = small.prefiltered(&default)?;
    let cones = small.rays(Kind::Whole, 16, 5);
    let start = Instant::now();
    let published = Published::build(positions, triangles, small.source.alpha, 5.0, 3)?;
    let build_s = start.elapsed().as_secs_f64();
    let threshold = query.threshold();
    let start = Instant::now();
    let passed: Vec<f32> =
        cones.iter().map(|cone| published.transmittance(cone, threshold)).collect::<Result<_, _>>()?;
    let published_s = start.elapsed().as_secs_f64();
    let start = Instant::now();
    let mut own = vec![0.0; cones.len()];
    scene.transmittances_with(&cones, &query, &mut own, &mut ());
    let own_s = start.elapsed().as_secs_f64();
    for (method, passed, time_s) in [("algorithm 1, K = 5", passed, published_s), ("prefilter", own, own_s)] {
        let errors = small.errors(Kind::Whole, 16, &passed);
        let params = json!({ "variant": "30,000 triangles", "rays": 16, "t": round(threshold) });
        let counters = json!({ "relative_bias": errors.1 / small.mean_visibility() });
        let row = error_row(&small, method, params, errors, counters);
        let mrays_s = cones.len() as f64 / time_s * 1e-6;
        output.row(&Row { time_s, build_s, mrays_s, speedup: published_s / time_s, ..row })?;
    }
    Ok(())
}

/// Targets, the plans that a pilot makes for them, and the errors that come of it on all receivers.
pub fn control(case: &Case, output: &mut Output) -> Result<()> {
    let (scene, _) = case.prefiltered(&PrefilterOptions::default())?;
    let count = case.receivers.len();
    let pilot = 192.min(count);
    for target in [0.05f32, 0.03, 0.02] {
        let spread = |i: usize| i * count / pilot;
        let start = Instant::now();
        let plan = scene.plan(target, pilot, |i, rays, seed, out| case.fan(spread(i), rays, seed, out))?;
        let build_s = start.elapsed().as_secs_f64();
        let cones = case.rays(Kind::Whole, plan.rays, 5);
        let mut passed = vec![0.0; cones.len()];
        let start = Instant::now();
        scene.transmittances_with(&cones, &plan.query, &mut passed, &mut ());
        let time_s = start.elapsed().as_secs_f64();
        let plain: Vec<Ray> = cones.iter().map(|c| c.ray).collect();
        let start = Instant::now();
        case.exact(&plain, &mut vec![0.0; plain.len()], &mut Default::default());
        let exact_s = start.elapsed().as_secs_f64();
        let t = plan.query.threshold();
        let params = json!({
            "target_rmse": round(target), "rays": plan.rays,
            "t": if t.is_finite() { json!(round(t)) } else { Value::Null },
        });
        let counters = json!({ "pilot_error": plan.error });
        let errors = case.errors(Kind::Whole, plan.rays, &passed);
        let row = error_row(case, "plan", params, errors, counters);
        let mrays_s = cones.len() as f64 / time_s * 1e-6;
        output.row(&Row { time_s, build_s, mrays_s, speedup: exact_s / time_s, ..row })?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::{super::case::SOURCES, *};

    #[test]
    fn scenes_have_receivers_of_both_kinds() -> Result<()> {
        for source in SOURCES {
            let case = Case::generate(source, 5_000, 16)?;
            for kind in [Kind::Ground, Kind::Foliage] {
                assert!(case.receivers.iter().any(|r| kind.holds(r)), "{}", source.name);
            }
            let exact = case.errors(Kind::Whole, 1, &vec![0.0; case.receivers.len()]);
            assert!((exact.1 + case.mean_visibility()).abs() < 1e-9);
        }
        Ok(())
    }
}
