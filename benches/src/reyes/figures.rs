//! The dissertation's figures: entry footprints against final approach.

use super::{
    Options,
    frame::{Frame, Method, Reference, Setting, Shadows, render},
    scenes::Scene,
};
use crate::rows::{Output, Row, median, paired_speedup};
use anyhow::Result;
use serde_json::{Value, json};
use std::time::Instant;
use umbrage_reyes::{FootprintRule, PatchBounds, Surface, SurfaceOptions, TraceOptions, published};

/// One measurement of all methods.
struct Figure {
    name: &'static str,
    close: bool,
    strata: Option<[u32; 2]>,
    shadows: Shadows,
    tight: u32,
    /// What the dissertation found, for the note in rows.
    published: &'static str,
}

const NORMAL: &str =
    "10 to 20 % fewer operations on the characters, more on the sphere; no gain in time but on the sphere";

const FIGURES: [Figure; 9] = [
    figure("6.9, 6.18 (0), 6.19", false, Some([2, 2]), 0, NORMAL),
    figure("6.13 normal", false, None, 0, "reduction near 0, exactly 0 on the sphere"),
    figure("6.13 close", true, None, 0, "more than in the normal view everywhere, most on the sphere"),
    figure("6.15 (8)", false, Some([4, 2]), 0, "a slightly larger reduction than with 4 samples"),
    figure("6.18 (1)", false, Some([2, 2]), 1, "reductions shrink as bounds tighten"),
    figure("6.18 (2)", false, Some([2, 2]), 2, "reductions shrink as bounds tighten"),
    figure("6.18 (3)", false, Some([2, 2]), 3, "some reduction is left"),
    Figure { shadows: Shadows::FromPoint, ..figure("6.9 (point)", false, Some([2, 2]), 0, NORMAL) },
    Figure {
        shadows: Shadows::Backward,
        ..figure("6.9 (backward)", false, Some([2, 2]), 0, "proposed in 6.15, not measured")
    },
];

const fn figure(
    name: &'static str,
    close: bool,
    strata: Option<[u32; 2]>,
    tight: u32,
    published: &'static str,
) -> Figure {
    Figure { name, close, strata, shadows: Shadows::FromPixel, tight, published }
}

/// Finest rate: a shadow ray that starts without width would ask for any.
fn max_level(shadows: Shadows) -> u8 {
    if shadows == Shadows::FromPixel { 12 } else { 9 }
}

/// Bytes of trees and of grids: everything that is made is kept, so that operations are those of the method and not of a cache.
pub const CACHE_BYTES: usize = 6 << 30;

fn methods(tight: u32, shadows: Shadows) -> [Method; 4] {
    let surface = SurfaceOptions::default()
        .with_bounds(PatchBounds::Hull)
        .with_tight_levels(tight)
        .with_tree_bytes(CACHE_BYTES);
    let trace = |trace: TraceOptions| trace.with_max_level(max_level(shadows)).with_cache_bytes(CACHE_BYTES);
    let published = |name, rule| Method::new(name, surface, trace(published::trace_options(rule)));
    [
        published("entry", FootprintRule::Entry),
        published("final-approach", FootprintRule::FinalApproach),
        published("exact-final-approach", FootprintRule::ExactFinalApproach),
        Method::new(
            "default",
            SurfaceOptions::default().with_tree_bytes(CACHE_BYTES),
            trace(TraceOptions::default()),
        ),
    ]
}

/// Table 6.2: how many patches a scene has. The time is that of making them.
pub fn patches(scene: &Scene, options: &Options, output: &mut Output) -> Result<()> {
    const NAME: &str = "6.2 patches";
    if !options.wants(NAME) {
        return Ok(());
    }
    let start = Instant::now();
    let surface = Surface::build(&scene.control, &SurfaceOptions::default().with_tight_levels(0))?;
    let time_s = start.elapsed().as_secs_f64();
    let count = surface.patch_count();
    let regular = (0..count as u32).filter(|&p| surface.bicubic(p).is_some()).count();
    let control = &scene.control;
    output.row(&Row {
        suite: "reyes",
        scene: scene.name.into(),
        method: "patches".into(),
        params: json!({ "figure": NAME }),
        time_s,
        build_s: time_s,
        mrays_s: 0.0,
        rmse: 0.0,
        bias: 0.0,
        bytes: surface.bytes(),
        counters: json!({
            "patches": count, "regular": regular, "published": scene.published_patches,
            "faces": control.face_sizes.len(), "vertices": control.positions.len(),
            "quadrilaterals": control.face_sizes.iter().filter(|&&n| n == 4).count(),
        }),
        baseline: "patches",
        speedup: 1.0,
    })
}

/// Rows of all figures for one scene.
pub fn run(scene: &Scene, options: &Options, reference: &Reference, output: &mut Output) -> Result<()> {
    let passes = options.passes();
    for figure in FIGURES.iter().filter(|figure| options.wants(figure.name)) {
        let size = options.size_for(figure.shadows);
        let lights = if figure.strata.is_some() { scene.lights() } else { Vec::new() };
        let setting = Setting {
            view: scene.view(figure.close, size),
            lights: &lights,
            strata: figure.strata.unwrap_or([1, 1]),
            shadows: figure.shadows,
        };
        let truth = reference.render(&setting);
        // Rows beside those of figure 6.9 have the two that the dissertation compares.
        let count = if ["6.15", "6.18"].contains(&&figure.name[..4]) { 2 } else { 4 };
        let methods = &methods(figure.tight, figure.shadows)[..count];
        let mut frames: Vec<Vec<Frame>> = methods.iter().map(|_| Vec::new()).collect();
        for _ in 0..passes {
            for (method, frames) in methods.iter().zip(&mut frames) {
                frames.push(render(scene, &setting, method)?);
            }
        }
        for (method, own) in methods.iter().zip(&frames) {
            let params = json!({
                "figure": figure.name, "size": size, "lights": lights.len(),
                "samples": setting.strata[0] * setting.strata[1], "shadows": format!("{:?}", figure.shadows),
                "tight_bounds": figure.tight,
            });
            let mut row = row(scene, method, own, &frames[0], params, &truth);
            row.counters["published"] = json!(figure.published);
            output.row(&row)?;
        }
    }
    Ok(())
}

/// The row of a method's frames against those of entry footprints.
pub fn row(
    scene: &Scene,
    method: &Method,
    own: &[Frame],
    entry: &[Frame],
    params: Value,
    truth: &[f32],
) -> Row {
    let times = |frames: &[Frame]| frames.iter().map(|f| f.seconds).collect::<Vec<_>>();
    let (time_s, last) = (median(&times(own)), &own[own.len() - 1]);
    let entry_operations = entry[0].operations() as f64;
    let bias: f64 =
        last.image.iter().zip(truth).map(|(a, b)| f64::from(a - b)).sum::<f64>() / truth.len() as f64;
    Row {
        suite: "reyes",
        scene: scene.name.into(),
        method: method.name.into(),
        params,
        time_s,
        build_s: last.build_s,
        mrays_s: last.rays as f64 / time_s * 1e-6,
        rmse: last.rmse(truth),
        bias,
        bytes: last.bytes,
        counters: json!({
            "bound": last.bound, "split": last.split, "dice": last.dice,
            "micropolygons": last.micropolygons, "operations": last.operations(),
            "reduction_percent": 100.0 * (1.0 - last.operations() as f64 / entry_operations),
            "hits": last.hits,
        }),
        baseline: "entry",
        speedup: paired_speedup(&times(entry), &times(own)),
    }
}
