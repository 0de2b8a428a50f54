//! Time to the same error: figures 1, 7 and 8, by kind of receiver.

use super::case::{Case, Kind, Workload};
use crate::{
    entry::{ALPHA, Entry},
    peer::Peer,
    rows::{Output, Row, Timed, alternate, median, note},
};
use anyhow::Result;
use serde_json::{Value, json};
use umbrage_geom::{OpticalDepth, Ray};
use umbrage_occlusion::prefilter::{ConeRay, PrefilterOptions, Prefiltered, Query};

/// Errors at which times are compared.
const TARGETS: [f64; 4] = [0.05, 0.04, 0.03, 0.02];

/// Rays a receiver of exact methods.
const EXACT_RAYS: [u32; 7] = [1, 4, 9, 16, 32, 64, 128];

/// Rays a receiver of prefiltered ones.
const RAYS: [u32; 7] = [1, 2, 4, 8, 16, 32, 64];

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

/// Time and error of one setting in each pass.
struct Measured {
    method: (&'static str, usize),
    rays: u32,
    rmse: f64,
    bias: f64,
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
        let curve: Vec<&Measured> = all.iter().filter(|m| m.method == (method_name(method), curve)).collect();
        time_to(&curve, target, pass)
    });
    times.min_by(f64::total_cmp)
}

/// The static name of a method.
fn method_name(name: &str) -> &'static str {
    ["bvh", "stochastic", "prefilter", "embree"].into_iter().find(|&n| n == name).unwrap_or("")
}

/// Rows of one scene.
pub fn run(case: &Case, peers: &[Box<dyn Peer>], passes: usize, output: &mut Output) -> Result<()> {
    let options = PrefilterOptions::default();
    let (scene, build_s) = case.prefiltered(&options)?;
    let bytes = scene.bytes();
    let thresholds =
        if let Workload::Shadow = case.source.workload { [0.05f32, 0.1, 0.2] } else { [0.1, 0.3, 0.6] };
    for kind in Kind::ALL {
        note(&format!("{} {}", case.source.name, kind.name()));
        let all = measure(case, &scene, kind, &thresholds, peers, passes);
        let count = case.receivers.iter().filter(|r| kind.holds(r)).count();
        let finest =
            all.iter().filter(|m| m.method.0 == "prefilter").min_by(|a, b| a.rmse.total_cmp(&b.rmse));
        let floor = finest.map_or(f64::NAN, |m| m.rmse);
        for target in TARGETS {
            for (method, baseline) in [
                ("prefilter", "bvh"),
                ("stochastic", "bvh"),
                ("prefilter", "stochastic"),
                ("prefilter", "embree"),
            ] {
                let pairs: Vec<(f64, f64)> = (0..passes)
                    .filter_map(|pass| {
                        let base = best_time(&all, baseline, target, pass)?;
                        Some((base, best_time(&all, method, target, pass)?))
                    })
                    .collect();
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
                    bytes: bytes.hierarchy + bytes.opacities + bytes.triangle_opacities,
                    counters: json!({ "receivers": count, "floor_rmse": floor }),
                    baseline: if baseline == "embree" { "embree" } else { "equal-rmse" },
                    speedup: median(&ratios),
                })?;
            }
        }
        for m in &all {
            let settings = json!({
                "figure": "curve", "receivers": kind.name(), "rays": m.rays,
                "t": if m.method.0 == "prefilter" { json!(round(thresholds[m.method.1])) } else { Value::Null },
            });
            let at_same_rays = all.iter().find(|e| e.method.0 == "bvh" && e.rays == m.rays);
            output.row(&Row {
                suite: "prefilter",
                scene: case.source.name.into(),
                method: m.method.0.into(),
                params: settings,
                time_s: median(&m.times),
                build_s: if m.method.0 == "prefilter" { build_s } else { case.bvh_build_s },
                mrays_s: (count as u32 * m.rays) as f64 / median(&m.times) * 1e-6,
                rmse: m.rmse,
                bias: m.bias,
                bytes: 0,
                counters: json!({}),
                baseline: "bvh",
                speedup: at_same_rays.map_or(f64::NAN, |e| crate::rows::paired_speedup(&e.times, &m.times)),
            })?;
        }
    }
    Ok(())
}

/// A number as people write it.
pub fn round(x: f32) -> f64 {
    (f64::from(x) * 1e4).round() / 1e4
}

/// All settings on the receivers of one kind.
fn measure(
    case: &Case,
    scene: &Prefiltered,
    kind: Kind,
    thresholds: &[f32],
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
            for (curve, &t) in thresholds.iter().enumerate() {
                let query = Query::new(t).expect("above 0");
                let way = Way::Prefiltered(scene, query);
                points.push(point(case, kind, ("prefilter", curve), *rays, cones, plain, way));
            }
        }
    }
    let mut timed: Vec<&mut dyn Timed> = points.iter_mut().map(|p| p as &mut dyn Timed).collect();
    let times = alternate(passes, &mut timed);
    let measured = points.iter().zip(times).map(|(point, times)| {
        let (rmse, bias) = case.errors(point.kind, point.rays, &point.passed);
        Measured { method: point.method, rays: point.rays, rmse, bias, times }
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
