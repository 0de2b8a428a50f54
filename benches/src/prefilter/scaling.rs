//! Figure 9: time against subdivision.

use super::{
    case::{Case, Kind, SOURCES, Source},
    targets::round,
};
use crate::{
    plot::{self, Series},
    rows::{Output, Row, Timed, alternate, median, paired_speedup},
};
use anyhow::Result;
use serde_json::{Value, json};
use std::path::Path;
use umbrage_accel::Counters;
use umbrage_geom::Ray;
use umbrage_occlusion::prefilter::{ConeQuery, PrefilterOptions, Prefiltered};
use umbrage_scene::generate::{Parameters, generate};

/// Rays a receiver.
const RAYS: u32 = 16;
const PASSES: usize = 5;

/// Who answers: exact rays without a query.
struct MethodSetting {
    method: &'static str,
    query: Option<ConeQuery>,
}

/// The default, and attempts to depend less on the number of triangles: rays end however near nodes are, or sooner.
fn settings(case: &Case) -> Result<[MethodSetting; 4]> {
    let default = case.query();
    let sooner = ConeQuery::new(0.25 * default.threshold())?;
    Ok([
        MethodSetting { method: "bvh", query: None },
        MethodSetting { method: "prefilter", query: Some(default) },
        MethodSetting { method: "prefilter-any-angle", query: Some(default.with_widest(1e3)?) },
        MethodSetting { method: "prefilter-sooner", query: Some(sooner.with_widest(1e3)?) },
    ])
}

/// The bush, subdivided linearly, opaque and semi-opaque.
pub fn run(
    triangles: usize,
    levels: u32,
    width: u32,
    plots: Option<&Path>,
    output: &mut Output,
) -> Result<()> {
    let mut series: Vec<Series> = Vec::new();
    for level in 0..=levels {
        let parameters =
            Parameters { triangles: Some(triangles), level: Some(level), ..Parameters::default() };
        let mesh = generate("bush", &parameters)?.mesh;
        for alpha in [1.0f32, 0.85] {
            let source = Source { alpha, ..SOURCES[0] };
            let case = Case::new(source, mesh.clone(), width)?;
            let (scene, build_s) = case.prefiltered(&PrefilterOptions::default())?;
            for kind in [Kind::Ground, Kind::Whole] {
                measure(&case, (&scene, build_s), kind, level, &mut series, output)?;
            }
        }
    }
    if let Some(folder) = plots {
        let title = "Figure 9: the bush, subdivided, 16 rays at T = 0.2";
        series.retain(|s| s.name.starts_with("bvh") || s.name.starts_with("prefilter,"));
        plot::save(folder, "prefilter-scaling.svg", title, ["triangles", "nanoseconds a ray"], &series)?;
    }
    Ok(())
}

/// Rows of all settings for receivers of one kind; their times go to `series`.
fn measure(
    case: &Case,
    (scene, build_s): (&Prefiltered, f64),
    kind: Kind,
    level: u32,
    series: &mut Vec<Series>,
    output: &mut Output,
) -> Result<()> {
    let cones = case.rays(kind, RAYS, 5);
    let plain: Vec<Ray> = cones.iter().map(|c| c.ray).collect();
    let settings = settings(case)?;
    let mut answers = vec![vec![0.0; cones.len()]; settings.len()];
    let mut jobs: Vec<_> = settings
        .iter()
        .zip(&mut answers)
        .map(|(way, passed)| {
            let (plain, cones) = (&plain, &cones);
            let mut scratch = Default::default();
            move || match &way.query {
                None => case.exact(plain, passed, &mut scratch),
                Some(query) => scene.transmittances_with(cones, query, passed, &mut ()),
            }
        })
        .collect();
    let mut timed: Vec<&mut dyn Timed> = jobs.iter_mut().map(|job| job as &mut dyn Timed).collect();
    let passes = alternate(PASSES, &mut timed);
    let opacity = if case.source.alpha < 1.0 { "semi-opaque" } else { "opaque" };
    for ((way, passed), own) in settings.iter().zip(&answers).zip(&passes) {
        let (rmse, bias) = case.errors(kind, RAYS, passed);
        let time_s = median(own);
        let name = format!("{}, {opacity}, {}", way.method, kind.name());
        let point = [case.opacity.len() as f64, time_s / cones.len() as f64 * 1e9];
        let at = series.iter().position(|s| s.name == name).unwrap_or_else(|| {
            series.push(Series { name, points: Vec::new(), filled: way.query.is_some() });
            series.len() - 1
        });
        series[at].points.push(point);
        let per_ray = |count: u64| count as f64 / cones.len() as f64;
        let work: Option<[f64; 2]> = way.query.as_ref().map(|query| {
            let (mut counters, mut again) = (Counters::default(), vec![0.0; cones.len()]);
            scene.transmittances_with(&cones, query, &mut again, &mut counters);
            [per_ray(counters.nodes), per_ray(counters.triangle_tests)]
        });
        output.row(&Row {
            suite: "prefilter",
            scene: "bush".into(),
            method: way.method.into(),
            params: json!({
                "figure": "9", "level": level, "alpha": round(case.source.alpha), "receivers": kind.name(),
                "triangles": case.opacity.len(), "rays": RAYS,
                "t": way.query.as_ref().map_or(Value::Null, |query| json!(round(query.threshold()))),
            }),
            time_s,
            build_s: if way.query.is_some() { build_s } else { case.bvh_build_s },
            mrays_s: cones.len() as f64 / time_s * 1e-6,
            rmse,
            bias,
            bytes: 0,
            counters: json!({
                "time_over_level_0": point[1] / series[at].points[0][1],
                "nodes": work.map(|w| w[0]),
                "triangle_tests": work.map(|w| w[1]),
            }),
            baseline: "bvh",
            speedup: paired_speedup(&passes[0], own),
        })?;
    }
    Ok(())
}
