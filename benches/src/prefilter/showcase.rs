//! Figures 1, 7 and 8 with the paper's numbers of rays: exact rays, prefiltered ones, and exact ones as quiet as these.

use super::{
    case::{Case, Kind},
    pictures,
    targets::round,
};
use crate::rows::{Output, Row, Timed, alternate, median, paired_speedup};
use anyhow::Result;
use serde_json::json;
use std::path::Path;
use umbrage_geom::Ray;
use umbrage_occlusion::prefilter::{ConeRay, PrefilterOptions};

/// A figure: rays a receiver and the seconds that the paper's pictures took.
struct Figure {
    scene: &'static str,
    name: &'static str,
    rays: [u32; 3],
    seconds: [f64; 3],
}

const FIGURES: [Figure; 3] = [
    Figure { scene: "bush", name: "1", rays: [4, 9, 25], seconds: [112.0, 74.0, 704.0] },
    Figure { scene: "tentacles", name: "7", rays: [9, 9, 36], seconds: [106.0, 66.0, 420.0] },
    Figure { scene: "bamboo", name: "8", rays: [9, 9, 49], seconds: [64.0, 87.0, 339.0] },
];
/// What makes the panels a, b and c.
const METHODS: [&str; 3] = ["bvh", "prefilter", "bvh"];

/// Rows of the three panels, and, with a folder, the pictures.
pub fn run(case: &Case, passes: usize, folder: Option<&Path>, output: &mut Output) -> Result<()> {
    let Some(figure) = FIGURES.iter().find(|f| f.scene == case.source.name) else { return Ok(()) };
    let (scene, build_s) = case.prefiltered(&PrefilterOptions::default())?;
    let query = case.query();
    let cones: Vec<Vec<ConeRay>> = figure.rays.iter().map(|&rays| case.rays(Kind::Whole, rays, 5)).collect();
    let plain: Vec<Vec<Ray>> = cones.iter().map(|cones| cones.iter().map(|c| c.ray).collect()).collect();
    let mut answers: Vec<Vec<f32>> = cones.iter().map(|cones| vec![0.0; cones.len()]).collect();
    let [a, b, c] = &mut answers[..] else { unreachable!("three panels") };
    let mut scratch = [Default::default(), Default::default()];
    let [first, last] = &mut scratch;
    let mut few = || case.exact(&plain[0], a, first);
    let mut own = || scene.transmittances_with(&cones[1], &query, b, &mut ());
    let mut many = || case.exact(&plain[2], c, last);
    let times = alternate(passes, &mut [&mut few as &mut dyn Timed, &mut own, &mut many]);
    for (i, panel) in ["a", "b", "c"].into_iter().enumerate() {
        let (rmse, bias) = case.errors(Kind::Whole, figure.rays[i], &answers[i]);
        let time_s = median(&times[i]);
        output.row(&Row {
            suite: "prefilter",
            scene: case.source.name.into(),
            method: METHODS[i].into(),
            params: json!({
                "figure": format!("{} ({panel})", figure.name), "rays": figure.rays[i],
                "triangles": case.opacity.len(), "size": case.size(),
                "t": (METHODS[i] == "prefilter").then(|| round(query.threshold())),
            }),
            time_s,
            build_s: if i == 1 { build_s } else { case.bvh_build_s },
            mrays_s: cones[i].len() as f64 / time_s * 1e-6,
            rmse,
            bias,
            bytes: 0,
            counters: json!({
                "published_s": figure.seconds[i],
                "published_speedup": figure.seconds[1] / figure.seconds[i],
                "reference_rmse": case.reference_rmse,
            }),
            baseline: "prefilter",
            speedup: paired_speedup(&times[1], &times[i]),
        })?;
    }
    match folder {
        Some(folder) => pictures::panels(case, &answers, folder),
        None => Ok(()),
    }
}
