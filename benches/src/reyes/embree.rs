//! Frames by Embree's subdivision geometry at the tessellation that comes as near to the limit surface as ours.

use super::{
    Options,
    frame::{Cast, Caster, Frame, Method, Reference, Setting, Shadows, cast, render},
    scenes::Scene,
};
use crate::{
    embree::surface::{Call, EmbreeSurface},
    rows::{Output, Row, median, paired_speedup},
};
use anyhow::{Context, Result, ensure};
use serde_json::{Value, json};
use std::time::Instant;
use umbrage_geom::{Ray, glam::Vec3};

/// Name of the figure.
pub const NAME: &str = "embree";

/// Edges of our micropolygons.
const PIXELS: [f32; 2] = [2.0, 1.0];

/// How Embree divides edges.
#[derive(Clone, Copy, Debug)]
enum Rule {
    /// All alike.
    Uniform(f32),
    /// By their length in pixels.
    Pixels(f32),
}

/// A sequence of rules from coarse to fine.
#[derive(Clone, Copy, Debug)]
enum Family {
    Uniform,
    Pixels,
}

impl Family {
    /// Index of the finest rule.
    fn last(self) -> u32 {
        match self {
            Self::Uniform => 1023,
            Self::Pixels => 140,
        }
    }

    /// Every integer level, or lengths from 32 pixels down, each a twentieth shorter than the one before.
    fn rule(self, index: u32) -> Rule {
        match self {
            Self::Uniform => Rule::Uniform((index + 1) as f32),
            Self::Pixels => Rule::Pixels(32.0 * 0.95f32.powi(index as i32)),
        }
    }

    /// An index whose edges are about half as long.
    fn finer(self, index: u32) -> u32 {
        match self {
            Self::Uniform => 2 * index + 1,
            Self::Pixels => index + 14,
        }
        .min(self.last())
    }
}

impl Rule {
    fn name(self) -> String {
        match self {
            Self::Uniform(level) => format!("level {level}"),
            Self::Pixels(pixels) => format!("{pixels:.2} pixels"),
        }
    }

    /// Levels of all edges.
    fn levels(self, scene: &Scene, setting: &Setting) -> Vec<f32> {
        let control = &scene.control;
        let Self::Pixels(pixels) = self else {
            let Self::Uniform(level) = self else { return Vec::new() };
            return vec![level; control.corners.len()];
        };
        let (_, differential) = setting.view.ray(0, 0);
        let pixel = differential.d_direction[0].length();
        let mut levels = Vec::with_capacity(control.corners.len());
        for face in control.faces() {
            for i in 0..face.len() {
                let [a, b] =
                    [face[i], face[(i + 1) % face.len()]].map(|v| Vec3::from(control.positions[v as usize]));
                let distance = (0.5 * (a + b)).distance(setting.view.eye);
                // Embree takes no more than 4096.
                levels.push((a.distance(b) / (distance * pixel * pixels)).ceil().clamp(1.0, 4096.0));
            }
        }
        levels
    }
}

/// A surface, the call for camera rays and that for shadow rays.
type Calls = [Call; 2];

impl Caster for (EmbreeSurface, Calls) {
    fn closest_hits(&mut self, rays: &[Ray], hits: &mut Vec<Option<(f32, Vec3)>>) -> f64 {
        self.0.closest_hits(rays, self.1[0], hits)
    }

    fn any_hits(&mut self, rays: &[Ray], _: usize, blocked: &mut Vec<bool>) -> f64 {
        self.0.any_hits(rays, self.1[1], blocked)
    }
}

/// A frame by Embree.
fn frame(scene: &Scene, setting: &Setting, rule: Rule, calls: Calls) -> Result<Frame> {
    let levels = rule.levels(scene, setting);
    let start = Instant::now();
    let mut caster = (EmbreeSurface::new(&scene.control, &levels)?, calls);
    let build_s = start.elapsed().as_secs_f64();
    let Cast { image, rays, hits, traced_s, seconds } = cast(setting, &mut caster);
    let bytes = caster.0.peak_bytes();
    Ok(Frame { image, seconds, traced_s, build_s, rays, hits, bytes, ..Frame::default() })
}

/// Neighbouring rules of a family whose errors lie around `rmse`: the first above it, the second not.
fn around(
    scene: &Scene,
    setting: &Setting,
    truth: &[f32],
    rmse: f64,
    family: Family,
) -> Result<[(Rule, f64); 2]> {
    let error = |index| -> Result<f64> {
        Ok(frame(scene, setting, family.rule(index), [Call::SINGLE; 2])?.rmse(truth))
    };
    let (mut low, mut high) = ((0, error(0)?), (0, f64::INFINITY));
    ensure!(low.1 > rmse, "{family:?}: the coarsest tessellation is near enough");
    while high.1 > rmse {
        ensure!(low.0 < family.last(), "{family:?}: the finest tessellation is not near enough");
        let index = family.finer(low.0);
        high = (index, error(index)?);
        if high.1 > rmse {
            low = high;
        }
    }
    while high.0 - low.0 > 1 {
        let middle = (low.0 + high.0) / 2;
        let found = (middle, error(middle)?);
        if found.1 > rmse {
            low = found;
        } else {
            high = found;
        }
    }
    Ok([low, high].map(|(index, error)| (family.rule(index), error)))
}

/// The calls that cast the rays of a frame fastest.
fn fastest(scene: &Scene, setting: &Setting, rule: Rule) -> Result<Calls> {
    let frames = Call::all().into_iter().map(|call| Ok((call, frame(scene, setting, rule, [call; 2])?)));
    let frames = frames.collect::<Result<Vec<_>>>()?;
    let best = |kind: usize| {
        let times = frames.iter().map(|(call, frame)| (*call, frame.traced_s[kind]));
        times.min_by(|a, b| a.1.total_cmp(&b.1)).context("there are calls").map(|(call, _)| call)
    };
    Ok([best(0)?, best(1)?])
}

/// A family's rules around our error, and what they take.
struct Peer {
    rules: [(Rule, f64); 2],
    calls: Calls,
    frames: [Vec<Frame>; 2],
}

/// Building and casting; rays are made and converted outside.
fn times(frames: &[Frame]) -> Vec<f64> {
    frames.iter().map(|f| f.build_s + f.traced_s[0] + f.traced_s[1]).collect()
}

impl Peer {
    /// How far `rmse` is from the first rule's error to the second's, in logarithms.
    fn weight(&self, rmse: f64) -> f64 {
        let [coarse, fine] = self.rules.map(|(_, error)| error.ln());
        ((rmse.ln() - coarse) / (fine - coarse)).clamp(0.0, 1.0)
    }

    /// A positive quantity of the two rules at `rmse`: the straight line between them in logarithms.
    fn between(&self, rmse: f64, values: [f64; 2]) -> f64 {
        let weight = self.weight(rmse);
        (values[0].ln() * (1.0 - weight) + values[1].ln() * weight).exp()
    }

    /// Time of each pass at `rmse`.
    fn times(&self, rmse: f64) -> Vec<f64> {
        let [coarse, fine] = [0, 1].map(|i| times(&self.frames[i]));
        coarse.into_iter().zip(fine).map(|(coarse, fine)| self.between(rmse, [coarse, fine])).collect()
    }

    fn bytes(&self, rmse: f64) -> f64 {
        let bytes = [0, 1].map(|i| self.frames[i].iter().map(|f| f.bytes).max().unwrap_or(0) as f64);
        self.between(rmse, bytes)
    }
}

/// Rows of ours with baseline `embree`, whole frames with all that they build, and of Embree's two tessellations whose errors lie
/// around ours.
pub fn run(scene: &Scene, options: &Options, reference: &Reference, output: &mut Output) -> Result<()> {
    let lights = scene.lights();
    let view = scene.view(false, options.size);
    let setting = Setting { view, lights: &lights, strata: [2, 2], shadows: Shadows::FromPixel };
    let truth = reference.render(&setting);
    const PASSES: usize = 3;
    for pixels in PIXELS {
        let method = Method::once("once", pixels);
        let rmse = render(scene, &setting, &method)?.rmse(&truth);
        // The fastest calls, by a small image.
        let small = Setting { view: scene.view(false, options.size / 4), ..setting };
        let mut peers = Vec::new();
        for family in [Family::Uniform, Family::Pixels] {
            let rules = around(scene, &setting, &truth, rmse, family)?;
            let calls = fastest(scene, &small, rules[1].0)?;
            peers.push(Peer { rules, calls, frames: Default::default() });
        }
        let mut own = Vec::new();
        for _ in 0..PASSES {
            own.push(render(scene, &setting, &method)?);
            for peer in &mut peers {
                for i in [0, 1] {
                    peer.frames[i].push(frame(scene, &setting, peer.rules[i].0, peer.calls)?);
                }
            }
        }
        for peer in &peers {
            let params = |rules: Value| {
                json!({
                    "figure": NAME, "pixels": pixels, "size": options.size, "lights": lights.len(), "samples": 4,
                    "peer_rules": rules, "peer_calls": peer.calls.map(Call::name),
                })
            };
            let names = peer.rules.map(|(rule, _)| rule.name());
            let mut ours = row(scene, method.name, params(json!(names)), &own, &truth);
            let theirs = peer.times(ours.rmse);
            ours.speedup = paired_speedup(&theirs, &times(&own));
            ours.counters["peer_time_s"] = json!(median(&theirs));
            ours.counters["peer_bytes"] = json!(peer.bytes(ours.rmse));
            ours.counters["bytes_ratio"] = json!(ours.bytes as f64 / peer.bytes(ours.rmse));
            ours.counters["peer_rmse"] = json!(peer.rules.map(|(_, error)| error));
            output.row(&ours)?;
            for (frames, name) in peer.frames.iter().zip(names) {
                output.row(&row(scene, "embree", params(json!([name])), frames, &truth))?;
            }
        }
    }
    Ok(())
}

fn row(scene: &Scene, method: &str, params: Value, frames: &[Frame], truth: &[f32]) -> Row {
    let (time_s, last) = (median(&times(frames)), &frames[frames.len() - 1]);
    let bias: f64 =
        last.image.iter().zip(truth).map(|(a, b)| f64::from(a - b)).sum::<f64>() / truth.len() as f64;
    Row {
        suite: "reyes",
        scene: scene.name.into(),
        method: method.into(),
        params,
        time_s,
        build_s: last.build_s,
        mrays_s: last.rays as f64 / time_s * 1e-6,
        rmse: last.rmse(truth),
        bias,
        bytes: last.bytes,
        counters: json!({
            "camera_s": last.traced_s[0], "shadow_s": last.traced_s[1],
            "micropolygons": last.micropolygons, "hits": last.hits,
        }),
        baseline: "embree",
        speedup: 1.0,
    }
}
