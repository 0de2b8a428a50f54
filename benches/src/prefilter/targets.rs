//! Time to the same error: figures 1, 7 and 8, by kind of receiver.

use super::case::{Case, Kind, Workload};
use crate::{
    entry::{ALPHA, Entry},
    peer::Peer,
    plot::{self, Series},
    rows::{Output, Row, Timed, alternate, median, note},
};
use anyhow::Result;
use serde_json::json;
use std::path::Path;
use umbrage_geom::{OpticalDepth, Ray};
use umbrage_occlusion::prefilter::{ConeRay, Correlation, PrefilterOptions, Prefiltered, Query};

/// Errors at which times are compared.
const TARGETS: [f64; 4] = [0.05, 0.04, 0.03, 0.02];

/// Rays a receiver of exact methods.
const EXACT_RAYS: [u32; 7] = [1, 4, 9, 16, 32, 64, 128];

/// Rays a receiver of prefiltered ones.
const RAYS: [u32; 7] = [1, 2, 4, 8, 16, 32, 64];

/// Attempts to be better than the default: nodes end rays however near they are, or only from twice and four times as far;
/// every node from the fifth level on, and every node, may end rays, whatever surface it is part of.
const FAR_2: &str = "prefilter-far-2";
const FAR_4: &str = "prefilter-far-4";
const ANY_ANGLE: &str = "prefilter-any-angle";
const HEIGHT_5: &str = "prefilter-height-5";
const HEIGHT_0: &str = "prefilter-height-0";

/// How a curve's points are computed.
enum Way<'a> {
    Exact,
    Stochastic,
    Prefiltered(&'a Prefiltered, Query),
    /// The entry of the peer that was fastest in a heat.
    Peer(Box<dyn Entry<bool> + 'a>),
    PeerAlpha(Box<dyn Entry<OpticalDepth> + 'a>),
}

/// One setting: some rays a receiver, answered in one way.
struct Point<'a> {
    case: &'a Case,
    kind: Kind,
    /// Name of the method, and which of its curves.
    method: (&'static str, usize),
    rays: u32,
    cones: &'a [ConeRay],
    plain: &'a [Ray],
    way: Way<'a>,
    passed: Vec<f32>,
    scratch: (Vec<bool>, Vec<OpticalDepth>),
}

impl Timed for Point<'_> {
    fn prepare(&mut self) {
        match &mut self.way {
            Way::Peer(entry) => entry.prepare(),
            Way::PeerAlpha(entry) => entry.prepare(),
            _ => {}
        }
    }

    fn run(&mut self) {
        let Self { case, plain, passed, scratch, .. } = self;
        match &mut self.way {
            Way::Exact => case.exact(plain, passed, scratch),
            Way::Stochastic => case.stochastic(plain, passed, scratch),
            Way::Prefiltered(scene, query) => scene.transmittances_with(self.cones, query, passed, &mut ()),
            Way::Peer(entry) => entry.run(None),
            Way::PeerAlpha(entry) => entry.run(None),
        }
    }

    fn finish(&mut self) {
        match &self.way {
            Way::Peer(entry) => {
                self.passed = entry.answers().iter().map(|&hit| f32::from(u8::from(!hit))).collect();
            }
            Way::PeerAlpha(entry) => {
                self.passed = entry.answers().iter().map(|depth| depth.transmittance()).collect();
            }
            _ => {}
        }
    }
}

/// Prefiltered rays with one setting, whatever their number.
struct Curve<'a> {
    method: (&'static str, usize),
    scene: &'a Prefiltered,
    query: Query,
}

/// The threshold of a method's curve; `None` of exact ones.
fn threshold(curves: &[Curve<'_>], method: (&str, usize)) -> Option<f32> {
    curves.iter().find(|c| c.method == method).map(|c| c.query.threshold())
}

/// Time and error of one setting in each pass.
struct Measured {
    method: (&'static str, usize),
    rays: u32,
    rmse: f64,
    bias: f64,
    /// Visibility over all rays.
    mean: f64,
    times: Vec<f64>,
}

/// Time to reach `target` in pass `pass`, by interpolation between settings of one curve; `None` if it is never reached.
fn time_to(curve: &[&Measured], target: f64, pass: usize) -> Option<f64> {
    let first = curve.first()?;
    if first.rmse <= target {
        return Some(first.times[pass]);
    }
    curve.windows(2).find_map(|pair| {
        let [a, b] = [pair[0], pair[1]];
        (a.rmse > target && b.rmse <= target).then(|| {
            let part = (target.ln() - a.rmse.ln()) / (b.rmse.ln() - a.rmse.ln());
            (a.times[pass].ln() + part * (b.times[pass].ln() - a.times[pass].ln())).exp()
        })
    })
}

/// The fastest of a method's curves.
fn best_time(all: &[Measured], method: &str, target: f64, pass: usize) -> Option<f64> {
    let curves = all.iter().filter(|m| m.method.0 == method).map(|m| m.method.1).max()?;
    let times = (0..=curves).filter_map(|curve| {
        let curve: Vec<&Measured> = all.iter().filter(|m| m.method == (method, curve)).collect();
        time_to(&curve, target, pass)
    });
    times.min_by(f64::total_cmp)
}

/// Rows of one scene.
pub fn run(
    case: &Case,
    peers: &[Box<dyn Peer>],
    passes: usize,
    plots: Option<&Path>,
    output: &mut Output,
) -> Result<()> {
    let options = PrefilterOptions::default();
    let (scene, build_s) = case.prefiltered(&options)?;
    let bytes = scene.bytes();
    let bytes = bytes.hierarchy + bytes.opacities + bytes.triangle_opacities;
    let thresholds =
        if let Workload::Shadow = case.source.workload { [0.05f32, 0.1, 0.2] } else { [0.1, 0.3, 0.6] };
    let height = |k| case.prefiltered(&options.with_correlation(Correlation::Height(k)));
    let (height_0, height_5) = (height(0.0)?.0, height(5.0)?.0);
    let mut curves = Vec::new();
    for (curve, t) in thresholds.into_iter().enumerate() {
        curves.push(Curve { method: ("prefilter", curve), scene: &scene, query: Query::new(t)? });
    }
    let query = case.query();
    for (name, scene, query) in [
        (ANY_ANGLE, &scene, query.with_widest(1e3)),
        (FAR_2, &scene, query.with_widest(0.5 * Query::WIDEST)),
        (FAR_4, &scene, query.with_widest(0.25 * Query::WIDEST)),
        (HEIGHT_5, &height_5, query),
        (HEIGHT_0, &height_0, query),
    ] {
        curves.push(Curve { method: (name, 0), scene, query });
    }
    for kind in Kind::ALL {
        note(&format!("{} {}", case.source.name, kind.name()));
        let all = measure(case, kind, &curves, peers, passes);
        let count = case.receivers.iter().filter(|r| kind.holds(r)).count();
        if let (Some(folder), Kind::Whole) = (plots, kind) {
            plot_curves(case, &all, &curves, count, folder)?;
        }
        equal_error_rows(case, kind, &all, count, (build_s, bytes), output)?;
        curve_rows(case, kind, &all, &curves, count, build_s, output)?;
    }
    Ok(())
}

/// Rows of the time to an error, of one method against another.
fn equal_error_rows(
    case: &Case,
    kind: Kind,
    all: &[Measured],
    count: usize,
    (build_s, bytes): (f64, usize),
    output: &mut Output,
) -> Result<()> {
    let errors = all.iter().filter(|m| m.method.0 == "prefilter").map(|m| m.rmse);
    let floor = errors.min_by(f64::total_cmp).unwrap_or(f64::NAN);
    for target in TARGETS {
        for (method, baseline) in [
            ("prefilter", "bvh"),
            ("stochastic", "bvh"),
            ("prefilter", "stochastic"),
            ("prefilter", "embree"),
            (ANY_ANGLE, "bvh"),
            (FAR_2, "bvh"),
            (FAR_4, "bvh"),
            (HEIGHT_5, "bvh"),
            (HEIGHT_0, "bvh"),
        ] {
            let in_pass =
                |pass| Some((best_time(all, baseline, target, pass)?, best_time(all, method, target, pass)?));
            let pairs: Vec<(f64, f64)> = (0..all[0].times.len()).filter_map(in_pass).collect();
            if pairs.is_empty() {
                continue;
            }
            let ratios: Vec<f64> = pairs.iter().map(|(base, own)| base / own).collect();
            let times: Vec<f64> = pairs.iter().map(|p| p.1).collect();
            output.row(&Row {
                suite: "prefilter",
                scene: case.source.name.into(),
                method: method.into(),
                params: json!({
                    "figure": "1, 7, 8", "receivers": kind.name(), "alpha": round(case.source.alpha),
                    "triangles": case.opacity.len(), "target_rmse": target, "against": baseline,
                }),
                time_s: median(&times),
                build_s,
                mrays_s: 0.0,
                rmse: target,
                bias: 0.0,
                bytes,
                counters: json!({ "receivers": count, "floor_rmse": floor }),
                baseline: if baseline == "embree" { "embree" } else { "equal-rmse" },
                speedup: median(&ratios),
            })?;
        }
    }
    Ok(())
}

/// Rows of all settings.
fn curve_rows(
    case: &Case,
    kind: Kind,
    all: &[Measured],
    curves: &[Curve<'_>],
    count: usize,
    build_s: f64,
    output: &mut Output,
) -> Result<()> {
    for m in all {
        let at_same_rays = all.iter().find(|e| e.method.0 == "bvh" && e.rays == m.rays);
        output.row(&Row {
            suite: "prefilter",
            scene: case.source.name.into(),
            method: m.method.0.into(),
            params: json!({
                "figure": "curve", "receivers": kind.name(), "rays": m.rays,
                "t": threshold(curves, m.method).map(round),
            }),
            time_s: median(&m.times),
            build_s: if m.method.0.starts_with("prefilter") { build_s } else { case.bvh_build_s },
            mrays_s: (count as u32 * m.rays) as f64 / median(&m.times) * 1e-6,
            rmse: m.rmse,
            bias: m.bias,
            bytes: 0,
            counters: json!({
                // What sampling can't have done: the same rays, over the mean that the reference has.
                "relative_bias_of_same_rays": at_same_rays.map(|e| (m.mean - e.mean) / (m.mean - m.bias)),
            }),
            baseline: "bvh",
            speedup: at_same_rays.map_or(f64::NAN, |e| crate::rows::paired_speedup(&e.times, &m.times)),
        })?;
    }
    Ok(())
}

/// Figures 1, 7, 8: error against time a receiver, one line a method and threshold.
fn plot_curves(
    case: &Case,
    all: &[Measured],
    curves: &[Curve<'_>],
    count: usize,
    folder: &Path,
) -> Result<()> {
    let mut series: Vec<((&str, usize), Series)> = Vec::new();
    for m in all {
        let point = [median(&m.times) / count as f64 * 1e6, m.rmse];
        if let Some((_, own)) = series.iter_mut().find(|(method, _)| *method == m.method) {
            own.points.push(point);
            continue;
        }
        let t = threshold(curves, m.method);
        let name = t.map_or(m.method.0.into(), |t| format!("{}, T = {t}", m.method.0));
        series.push((m.method, Series { name, points: vec![point], filled: t.is_some() }));
    }
    let series: Vec<Series> = series.into_iter().map(|(_, series)| series).collect();
    let name = case.source.name;
    let title = format!("{name}, {} triangles, whole image", case.opacity.len());
    let labels = ["microseconds a receiver", "RMSE of visibility"];
    plot::save(folder, &format!("prefilter-error-{name}.svg"), &title, labels, &series)
}

/// A number as people write it.
pub fn round(x: f32) -> f64 {
    (f64::from(x) * 1e4).round() / 1e4
}

/// All settings on the receivers of one kind.
fn measure(
    case: &Case,
    kind: Kind,
    curves: &[Curve<'_>],
    peers: &[Box<dyn Peer>],
    passes: usize,
) -> Vec<Measured> {
    let counts: Vec<u32> = {
        let mut counts: Vec<u32> = EXACT_RAYS.iter().chain(&RAYS).copied().collect();
        counts.sort_unstable();
        counts.dedup();
        counts
    };
    let sets: Vec<(u32, Vec<ConeRay>, Vec<Ray>)> = counts
        .iter()
        .map(|&rays| {
            let cones = case.rays(kind, rays, 5);
            let plain = cones.iter().map(|c| c.ray).collect();
            (rays, cones, plain)
        })
        .collect();
    let mut points: Vec<Point> = Vec::new();
    for (rays, cones, plain) in &sets {
        points.extend(exact_points(case, kind, *rays, cones, plain, peers));
        if RAYS.contains(rays) {
            for curve in curves {
                let way = Way::Prefiltered(curve.scene, curve.query);
                points.push(point(case, kind, curve.method, *rays, cones, plain, way));
            }
        }
    }
    let mut timed: Vec<&mut dyn Timed> = points.iter_mut().map(|p| p as &mut dyn Timed).collect();
    let times = alternate(passes, &mut timed);
    let measured = points.iter().zip(times).map(|(point, times)| {
        let (rmse, bias) = case.errors(point.kind, point.rays, &point.passed);
        let mean = point.passed.iter().map(|&x| f64::from(x)).sum::<f64>() / point.passed.len() as f64;
        Measured { method: point.method, rays: point.rays, rmse, bias, mean, times }
    });
    measured.collect()
}

fn point<'a>(
    case: &'a Case,
    kind: Kind,
    method: (&'static str, usize),
    rays: u32,
    cones: &'a [ConeRay],
    plain: &'a [Ray],
    way: Way<'a>,
) -> Point<'a> {
    let passed = vec![1.0; cones.len()];
    Point { case, kind, method, rays, cones, plain, way, passed, scratch: Default::default() }
}

/// Our exact rays, stochastic opacity, and the fastest entry of each peer.
fn exact_points<'a>(
    case: &'a Case,
    kind: Kind,
    rays: u32,
    cones: &'a [ConeRay],
    plain: &'a [Ray],
    peers: &'a [Box<dyn Peer>],
) -> Vec<Point<'a>> {
    if !EXACT_RAYS.contains(&rays) {
        return Vec::new();
    }
    let mut points = vec![point(case, kind, ("bvh", 0), rays, cones, plain, Way::Exact)];
    if case.source.alpha < 1.0 {
        points.push(point(case, kind, ("stochastic", 0), rays, cones, plain, Way::Stochastic));
    }
    for peer in peers {
        let way = if case.source.alpha < 1.0 {
            Way::PeerAlpha(fastest(peer.transmittance(plain, OpticalDepth::from_opacity(ALPHA))))
        } else {
            Way::Peer(fastest(peer.any_hit(plain)))
        };
        points.push(point(case, kind, ("embree", 0), rays, cones, plain, way));
    }
    points
}

/// The fastest in two passes.
fn fastest<'a, A>(mut entries: Vec<Box<dyn Entry<A> + 'a>>) -> Box<dyn Entry<A> + 'a> {
    let times: Vec<f64> = entries
        .iter_mut()
        .map(|entry| {
            let mut best = f64::INFINITY;
            for _ in 0..2 {
                entry.prepare();
                let start = std::time::Instant::now();
                entry.run(None);
                best = best.min(start.elapsed().as_secs_f64());
            }
            best
        })
        .collect();
    let at = times.iter().enumerate().min_by(|a, b| a.1.total_cmp(b.1)).map_or(0, |(i, _)| i);
    entries.swap_remove(at)
}
