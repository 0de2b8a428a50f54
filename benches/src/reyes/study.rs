//! The head-to-head study that section 6.12 of the dissertation misses: rates by boxes, by final approach and by edges,
//! with and without cracks.

use super::{
    Options, cracks,
    figures::{CACHE_BYTES, row},
    frame::{Frame, Method, Once, Reference, Setting, Shadows, render},
    scenes::Scene,
};
use crate::{
    plot::{self, Series},
    rows::{Output, Row},
};
use anyhow::Result;
use serde_json::json;
use std::time::Instant;
use umbrage_reyes::{Borders, FootprintRule, PatchBounds, Rates, SurfaceOptions, TraceOptions, published};

const MAX_LEVEL: u8 = 9;

/// Pixels along a side of images at most: fourteen methods take minutes.
const MAX_STUDY_SIDE: u32 = 512;

fn methods() -> Vec<Method> {
    let tight = SurfaceOptions::default().with_tree_bytes(CACHE_BYTES);
    let hull = tight.with_bounds(PatchBounds::Hull).with_tight_levels(0);
    let room = |options: TraceOptions| options.with_max_level(MAX_LEVEL).with_cache_bytes(CACHE_BYTES);
    let trace = room(TraceOptions::default());
    let published = |rule| room(published::trace_options(rule));
    let method = Method::new;
    let equal = trace.with_rates(Rates::Equal);
    vec![
        method("entry", hull, published(FootprintRule::Entry)),
        method("final-approach", hull, published(FootprintRule::FinalApproach)),
        method("exact-final-approach", hull, published(FootprintRule::ExactFinalApproach)),
        method("entry-tight", tight, published(FootprintRule::Entry)),
        method("entry-stitched", tight, equal),
        method("final-approach-stitched", tight, trace.with_footprint(FootprintRule::FinalApproach)),
        method("edges", tight, equal.with_footprint(FootprintRule::Edges)),
        method("edges-projected", tight, equal.with_footprint(FootprintRule::ProjectedEdges)),
        method("diagsplit", tight, equal.with_footprint(FootprintRule::DiagSplit)),
        method("default-open", tight, trace.with_borders(Borders::Open)),
        method("default", tight, trace),
        method("default-occluders", tight, trace.with_occluder_cells(64)),
        Method::once("once", 1.0),
        Method { once: Some(Once { pixels: 1.0, bend: Some(0.0) }), ..Method::once("once-even", 1.0) },
    ]
}

/// Rows of all methods for one scene: a normal view with 5 lights, a close view, and random views for cracks.
pub fn run(scene: &Scene, options: &Options, reference: &Reference, output: &mut Output) -> Result<()> {
    let options = &Options { size: options.size.min(MAX_STUDY_SIDE), ..options.clone() };
    // Two views of 512 pixels a side have half a million rays.
    let views = if options.quick || options.size > 128 { 2 } else { 5 };
    let passes = options.passes();
    let lights = scene.lights();
    let methods = methods();
    for (name, close, shadows, lit) in [
        ("study normal", false, Shadows::FromPixel, true),
        ("study close", true, Shadows::FromPixel, false),
        ("study point", false, Shadows::FromPoint, true),
        ("study deferred", false, Shadows::Deferred, true),
        ("study backward", false, Shadows::Backward, true),
    ] {
        if !options.wants(name) {
            continue;
        }
        let size = options.size_for(shadows);
        let lights = if lit { &lights[..] } else { &[] };
        let setting = Setting { view: scene.view(close, size), lights, strata: [2, 2], shadows };
        let truth = reference.render(&setting);
        // Rates without end near the point take minutes at full size.
        let chosen = methods.iter().filter(|m| shadows == Shadows::FromPixel || !m.name.contains("exact"));
        // Rates chosen once don't depend on how shadow rays are traced.
        let chosen = chosen.filter(|m| shadows == Shadows::FromPixel || m.once.is_none());
        let chosen: Vec<&Method> = chosen.collect();
        let mut frames: Vec<Vec<Frame>> = chosen.iter().map(|_| Vec::new()).collect();
        for _ in 0..passes {
            for (method, frames) in chosen.iter().zip(&mut frames) {
                frames.push(render(scene, &setting, method)?);
            }
        }
        let mut points = Vec::new();
        for (method, own) in chosen.iter().zip(&frames) {
            let params = json!({
                "figure": name, "size": size, "lights": lights.len(), "samples": 4,
                "shadows": format!("{shadows:?}"),
            });
            let mut row = row(scene, method, own, &frames[0], params, &truth);
            if name == "study close" {
                let found = cracks::count(scene, method, reference, views, size)?;
                add_found(&mut row, &found);
            }
            points.push(Series {
                name: format!("{} ({:.1} MB)", method.name, row.bytes as f64 * 1e-6),
                points: vec![[row.time_s + row.build_s, row.rmse]],
                filled: method.trace.borders != Borders::Open || method.trace.footprint.is_by_edges(),
            });
            output.row(&row)?;
        }
        if let Some(folder) = options.plots.as_ref().filter(|_| name == "study normal") {
            let title = format!("{}, {size} x {size}, 5 lights; open circles may have cracks", scene.name);
            let labels = ["time of the frame, seconds", "RMSE from the limit surface"];
            plot::save(folder, &format!("reyes-{}-study.svg", scene.name), &title, labels, &points)?;
        }
    }
    Ok(())
}

fn add_found(row: &mut Row, found: &cracks::Found) {
    row.counters["crack_pixels"] = json!(found.cracks);
    row.counters["crack_rays"] = json!(found.rays);
    row.counters["depth_error_mean"] = json!(found.mean_error);
    row.counters["depth_error_max"] = json!(found.max_error);
    row.counters["foreshortened"] = json!(found.failures);
}

/// Figures 6.21 to 6.24: pixels with cracks over random views.
pub fn cracks(scene: &Scene, options: &Options, reference: &Reference, output: &mut Output) -> Result<()> {
    const NAME: &str = "6.14 cracks";
    if !options.wants(NAME) {
        return Ok(());
    }
    // A view of 1024 x 1024 pixels of each scene makes four million rays.
    let views = if options.quick || options.size >= 1024 { 1 } else { 5 };
    for method in methods().iter().filter(|m| ["entry", "default-open", "default", "once"].contains(&m.name))
    {
        let start = Instant::now();
        let found = cracks::count(scene, method, reference, views, options.size)?;
        let time_s = start.elapsed().as_secs_f64();
        let mut row = Row {
            suite: "reyes",
            scene: scene.name.into(),
            method: method.name.into(),
            params: json!({ "figure": NAME, "size": options.size, "views": views }),
            time_s,
            build_s: 0.0,
            mrays_s: found.rays as f64 / time_s * 1e-6,
            rmse: 0.0,
            bias: 0.0,
            bytes: 0,
            counters: json!({ "published": "7 pixels of 4.2 million with entry footprints" }),
            baseline: "entry",
            speedup: 1.0,
        };
        add_found(&mut row, &found);
        output.row(&row)?;
    }
    Ok(())
}
