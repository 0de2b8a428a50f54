//! Time to the same error: figures 1, 7 and 8 by kind of receiver, one threshold a curve; and other rules for who may end rays.

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
use umbrage_occlusion::prefilter::{
    ConeQuery, ConeRay, PrefilterOptions, Prefiltered, published::Correlation,
};

/// Errors at which times are compared.
const TARGETS: [f64; 4] = [0.05, 0.04, 0.03, 0.02];

/// Rays a receiver of exact methods.
const EXACT_RAYS: [u32; 7] = [1, 4, 9, 16, 32, 64, 128];

/// Rays a receiver of prefiltered ones.
const RAYS: [u32; 6] = [2, 4, 8, 16, 32, 64];

/// Rays a receiver by which the fastest call of a peer is chosen.
const CHOOSING_RAYS: u32 = 9;

/// The default threshold, and other rules beside it: nodes end rays however near they are, or only from twice and four times as
/// far; every node from the fifth level on, and every node, may end rays, whatever surface it is part of.
const PREFILTER: &str = "prefilter";
const FAR_2: &str = "prefilter-far-2";
const FAR_4: &str = "prefilter-far-4";
const ANY_ANGLE: &str = "prefilter-any-angle";
const HEIGHT_5: &str = "prefilter-height-5";
const HEIGHT_0: &str = "prefilter-height-0";

/// How a curve's points are computed.
enum Solver<'a> {
    Exact,
    Stochastic,
    Prefiltered(&'a Prefiltered, ConeQuery),
    /// The entry of the peer that was fastest in a heat.
    Peer(Box<dyn Entry<bool> + 'a>),
    PeerAlpha(Box<dyn Entry<OpticalDepth> + 'a>),
}

/// Points of one line of a plot: a method, and of prefiltered ones the index of the only threshold that they share.
type CurveName = (&'static str, usize);

/// One setting: some rays a receiver, answered in one solver.
struct Point<'a> {
    case: &'a Case,
    kind: Kind,
    method: CurveName,
    rays: u32,
    cones: &'a [ConeRay],
    plain: &'a [Ray],
    solver: Solver<'a>,
    passed: Vec<f32>,
    scratch: (Vec<bool>, Vec<OpticalDepth>),
}

impl Timed for Point<'_> {
    fn prepare(&mut self) {
        match &mut self.solver {
            Solver::Peer(entry) => entry.prepare(),
            Solver::PeerAlpha(entry) => entry.prepare(),
            _ => {}
        }
    }

    fn run(&mut self) {
        let Self { case, plain, passed, scratch, .. } = self;
        match &mut self.solver {
            Solver::Exact => case.exact(plain, passed, scratch),
            Solver::Stochastic => case.stochastic(plain, passed, scratch),
            Solver::Prefiltered(scene, query) => {
                scene.transmittances_with(self.cones, query, passed, &mut ())
            }
            Solver::Peer(entry) => entry.run(None),
            Solver::PeerAlpha(entry) => entry.run(None),
        }
    }

    fn finish(&mut self) {
        match &self.solver {
            Solver::Peer(entry) => {
                self.passed = entry.answers().iter().map(|&hit| f32::from(u8::from(!hit))).collect();
            }
            Solver::PeerAlpha(entry) => {
                self.passed = entry.answers().iter().map(|depth| depth.transmittance()).collect();
            }
            _ => {}
        }
    }
}

/// Prefiltered rays with one setting, whatever their number.
struct Curve<'a> {
    method: CurveName,
    scene: &'a Prefiltered,
    query: ConeQuery,
}

/// The threshold of a method's curve; `None` of exact ones.
fn threshold(curves: &[Curve<'_>], method: CurveName) -> Option<f32> {
    curves.iter().find(|c| c.method == method).map(|c| c.query.threshold())
}

/// Time and error of one setting in each pass.
struct Measured {
    method: CurveName,
    rays: u32,
    rmse: f64,
    bias: f64,
    /// Visibility over all rays.
    mean: f64,
    times: Vec<f64>,
}

/// Time that the curve `name` takes to reach `target` in pass `pass`, interpolated between its settings; `None` if it never
/// does.
fn time_to(all: &[Measured], name: CurveName, target: f64, pass: usize) -> Option<f64> {
    let curve: Vec<&Measured> = all.iter().filter(|m| m.method == name).collect();
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

/// What the rows of a measurement share.
struct Setting<'a> {
    case: &'a Case,
    /// `params.figure` of rows of time to an error.
    figure: &'static str,
    kind: Kind,
    curves: &'a [Curve<'a>],
    passes: usize,
    build_s: f64,
    bytes: usize,
}

/// Time to an error, one threshold a curve, by kind of receiver.
pub fn run(
    case: &Case,
    peers: &[Box<dyn Peer>],
    passes: usize,
    plots: Option<&Path>,
    output: &mut Output,
) -> Result<()> {
    let (scene, build_s) = case.prefiltered(&PrefilterOptions::default())?;
    let thresholds =
        if let Workload::Shadow = case.source.workload { [0.05f32, 0.1, 0.2] } else { [0.1, 0.3, 0.6] };
    let mut curves = Vec::new();
    for (i, t) in thresholds.into_iter().enumerate() {
        curves.push(Curve { method: (PREFILTER, i), scene: &scene, query: ConeQuery::new(t)? });
    }
    let figure = "1, 7, 8";
    let bytes = bytes(&scene);
    for kind in Kind::ALL {
        let setting = Setting { case, figure, kind, curves: &curves, passes, build_s, bytes };
        let all = setting.measure(peers);
        if let (Some(folder), Kind::Whole) = (plots, kind) {
            setting.plot(&all, folder)?;
        }
        setting.rows(&all, output)?;
    }
    Ok(())
}

/// Other rules for who may end rays than the default, at the renderer's threshold, on the whole image.
pub fn rules(case: &Case, passes: usize, output: &mut Output) -> Result<()> {
    let options = PrefilterOptions::default();
    let (scene, build_s) = case.prefiltered(&options)?;
    let height = |k| case.prefiltered(&options.with_correlation(Correlation::Height(k)));
    let (height_0, height_5) = (height(0.0)?.0, height(5.0)?.0);
    let query = case.query();
    let curves = [
        (PREFILTER, &scene, query),
        (ANY_ANGLE, &scene, query.with_widest(1e3)?),
        (FAR_2, &scene, query.with_widest(0.5 * ConeQuery::WIDEST)?),
        (FAR_4, &scene, query.with_widest(0.25 * ConeQuery::WIDEST)?),
        (HEIGHT_5, &height_5, query),
        (HEIGHT_0, &height_0, query),
    ]
    .map(|(name, scene, query)| Curve { method: (name, 0), scene, query });
    let (figure, kind, bytes) = ("rules", Kind::Whole, bytes(&scene));
    let setting = Setting { case, figure, kind, curves: &curves, passes, build_s, bytes };
    let all = setting.measure(&[]);
    setting.rows(&all, output)
}

/// Bytes beside the triangles.
fn bytes(scene: &Prefiltered) -> usize {
    let bytes = scene.bytes();
    bytes.hierarchy + bytes.opacities + bytes.triangle_opacities
}

impl Setting<'_> {
    /// Receivers of the kind.
    fn receivers(&self) -> usize {
        self.case.receivers.iter().filter(|r| self.kind.holds(r)).count()
    }

    fn rows(&self, all: &[Measured], output: &mut Output) -> Result<()> {
        let exact: Vec<CurveName> = ["bvh", "stochastic", "embree"].iter().map(|&name| (name, 0)).collect();
        for curve in self.curves {
            for &baseline in &exact {
                self.equal_error_rows(all, curve.method, baseline, output)?;
            }
        }
        self.equal_error_rows(all, ("stochastic", 0), ("bvh", 0), output)?;
        self.curve_rows(all, output)
    }

    /// Rows of the time to an error, of one curve against another.
    fn equal_error_rows(
        &self,
        all: &[Measured],
        method: CurveName,
        baseline: CurveName,
        output: &mut Output,
    ) -> Result<()> {
        let case = self.case;
        let errors = all.iter().filter(|m| m.method == method).map(|m| m.rmse);
        let floor = errors.min_by(f64::total_cmp).unwrap_or(f64::NAN);
        for target in TARGETS {
            let in_pass =
                |pass| Some((time_to(all, baseline, target, pass)?, time_to(all, method, target, pass)?));
            let pairs: Vec<(f64, f64)> = (0..all[0].times.len()).filter_map(in_pass).collect();
            if pairs.is_empty() {
                continue;
            }
            let ratios: Vec<f64> = pairs.iter().map(|(base, own)| base / own).collect();
            let times: Vec<f64> = pairs.iter().map(|p| p.1).collect();
            output.row(&Row {
                suite: "prefilter",
                scene: case.source.name.into(),
                method: method.0.into(),
                params: json!({
                    "figure": self.figure, "receivers": self.kind.name(), "alpha": round(case.source.alpha),
                    "triangles": case.opacity.len(), "size": case.size(), "target_rmse": target,
                    "t": threshold(self.curves, method).map(round), "against": baseline.0,
                }),
                time_s: median(&times),
                build_s: self.build_s,
                mrays_s: 0.0,
                rmse: target,
                bias: 0.0,
                bytes: self.bytes,
                counters: json!({
                    "receivers": self.receivers(), "floor_rmse": floor, "reference_rmse": case.reference_rmse,
                }),
                baseline: if baseline.0 == "embree" { "embree" } else { "equal-rmse" },
                speedup: median(&ratios),
            })?;
        }
        Ok(())
    }

    /// Rows of all settings.
    fn curve_rows(&self, all: &[Measured], output: &mut Output) -> Result<()> {
        let case = self.case;
        for m in all {
            let at_same_rays = all.iter().find(|e| e.method.0 == "bvh" && e.rays == m.rays);
            output.row(&Row {
                suite: "prefilter",
                scene: case.source.name.into(),
                method: m.method.0.into(),
                params: json!({
                    "figure": "curve", "of": self.figure, "receivers": self.kind.name(), "size": case.size(),
                    "rays": m.rays, "t": threshold(self.curves, m.method).map(round),
                }),
                time_s: median(&m.times),
                build_s: if m.method.0.starts_with(PREFILTER) { self.build_s } else { case.bvh_build_s },
                mrays_s: (self.receivers() as u32 * m.rays) as f64 / median(&m.times) * 1e-6,
                rmse: m.rmse,
                bias: m.bias,
                bytes: 0,
                counters: json!({
                    // What sampling can't have done: the same rays, over the mean that the reference has.
                    "relative_bias_of_same_rays": at_same_rays.map(|e| (m.mean - e.mean) / (m.mean - m.bias)),
                    "reference_rmse": case.reference_rmse,
                }),
                baseline: "bvh",
                speedup: at_same_rays.map_or(f64::NAN, |e| crate::rows::paired_speedup(&e.times, &m.times)),
            })?;
        }
        Ok(())
    }

    /// Figures 1, 7, 8: error against time a receiver, one line a method and threshold.
    fn plot(&self, all: &[Measured], folder: &Path) -> Result<()> {
        let count = self.receivers();
        let mut series: Vec<(CurveName, Series)> = Vec::new();
        for m in all {
            let point = [median(&m.times) / count as f64 * 1e6, m.rmse];
            if let Some((_, own)) = series.iter_mut().find(|(method, _)| *method == m.method) {
                own.points.push(point);
                continue;
            }
            let t = threshold(self.curves, m.method);
            let name = t.map_or(m.method.0.into(), |t| format!("{}, T = {t}", m.method.0));
            series.push((m.method, Series { name, points: vec![point], filled: t.is_some() }));
        }
        let series: Vec<Series> = series.into_iter().map(|(_, series)| series).collect();
        let (name, size) = (self.case.source.name, self.case.size());
        let title = format!("{name}, {} triangles, {size} pixels", self.case.opacity.len());
        let labels = ["microseconds a receiver", "RMSE of visibility"];
        plot::save(folder, &format!("prefilter-error-{name}.svg"), &title, labels, &series)
    }

    /// All settings on the receivers of the kind.
    fn measure(&self, peers: &[Box<dyn Peer>]) -> Vec<Measured> {
        let Self { case, kind, .. } = *self;
        note(&format!("{} {}", case.source.name, kind.name()));
        let mut counts: Vec<u32> = EXACT_RAYS.iter().chain(&RAYS).copied().collect();
        counts.sort_unstable();
        counts.dedup();
        let sets: Vec<(u32, Vec<ConeRay>, Vec<Ray>)> = counts
            .into_iter()
            .map(|rays| {
                let cones = case.rays(kind, rays, 5);
                let plain = cones.iter().map(|c| c.ray).collect();
                (rays, cones, plain)
            })
            .collect();
        let heat = sets.iter().find(|set| set.0 == CHOOSING_RAYS).map_or(&[][..], |set| &set.2);
        let modes: Vec<String> = peers.iter().map(|peer| fastest_mode(case, peer.as_ref(), heat)).collect();
        let mut points: Vec<Point> = Vec::new();
        for (rays, cones, plain) in &sets {
            let point = |method, solver| {
                let (passed, scratch) = (vec![1.0; cones.len()], Default::default());
                Point { case, kind, method, rays: *rays, cones, plain, solver, passed, scratch }
            };
            if EXACT_RAYS.contains(rays) {
                points.push(point(("bvh", 0), Solver::Exact));
                if case.source.alpha < 1.0 {
                    points.push(point(("stochastic", 0), Solver::Stochastic));
                }
                for (peer, mode) in peers.iter().zip(&modes) {
                    points.extend(
                        peer_solver(case, peer.as_ref(), plain, mode)
                            .map(|solver| point(("embree", 0), solver)),
                    );
                }
            }
            if RAYS.contains(rays) {
                for curve in self.curves {
                    points.push(point(curve.method, Solver::Prefiltered(curve.scene, curve.query)));
                }
            }
        }
        let mut timed: Vec<&mut dyn Timed> = points.iter_mut().map(|p| p as &mut dyn Timed).collect();
        let times = alternate(self.passes, &mut timed);
        let measured = points.iter().zip(times).map(|(point, times)| {
            let (rmse, bias) = case.errors(point.kind, point.rays, &point.passed);
            let mean = point.passed.iter().map(|&x| f64::from(x)).sum::<f64>() / point.passed.len() as f64;
            Measured { method: point.method, rays: point.rays, rmse, bias, mean, times }
        });
        measured.collect()
    }
}

/// The call of a peer called `mode`.
fn peer_solver<'a>(case: &Case, peer: &'a dyn Peer, rays: &'a [Ray], mode: &str) -> Option<Solver<'a>> {
    if case.source.alpha < 1.0 {
        let entries = peer.transmittance(rays, OpticalDepth::from_opacity(ALPHA));
        entries.into_iter().find(|entry| entry.mode() == mode).map(Solver::PeerAlpha)
    } else {
        let entries = peer.any_hit(rays);
        entries.into_iter().find(|e| e.method() == peer.name() && e.mode() == mode).map(Solver::Peer)
    }
}

/// The peer's fastest call on `rays`.
fn fastest_mode(case: &Case, peer: &dyn Peer, rays: &[Ray]) -> String {
    if case.source.alpha < 1.0 {
        fastest(peer.transmittance(rays, OpticalDepth::from_opacity(ALPHA)))
    } else {
        fastest(peer.any_hit(rays).into_iter().filter(|e| e.method() == peer.name()).collect())
    }
}

/// A number as people write it.
pub fn round(x: f32) -> f64 {
    (f64::from(x) * 1e4).round() / 1e4
}

/// The mode of the fastest in two passes.
fn fastest<A>(mut entries: Vec<Box<dyn Entry<A> + '_>>) -> String {
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
    entries.get(at).map_or_else(String::new, |entry| entry.mode())
}
