//! Frames by Embree's subdivision geometry at the tessellation that comes as near to the limit surface as ours.

use super::{
    Options,
    frame::{Caster, Frame, Method, Reference, Setting, Shadows, cast, render},
    scenes::Scene,
};
use crate::{
    embree::surface::{EmbreeSurface, Shadows as Packets},
    rows::{Output, Row, median, paired_speedup},
};
use anyhow::{Context, Result};
use serde_json::json;
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

impl Rule {
    /// From coarse to fine.
    fn all() -> [Vec<Self>; 2] {
        let uniform = [1, 2, 3, 4, 5, 6, 8, 10, 12, 16, 20, 24, 32, 48, 64, 96, 128, 256, 512];
        let pixels = [32.0, 16.0, 12.0, 8.0, 6.0, 4.0, 3.0, 2.0, 1.5, 1.0, 0.75, 0.5];
        [uniform.map(|n| Self::Uniform(n as f32)).to_vec(), pixels.map(Self::Pixels).to_vec()]
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

impl Caster for (EmbreeSurface, Packets) {
    fn closest_hit(&self, ray: &Ray) -> Option<(f32, Vec3)> {
        self.0.closest_hit(ray)
    }

    fn count_blocked(&mut self, rays: &[Ray]) -> usize {
        self.0.count_blocked(rays, self.1)
    }
}

/// A frame by Embree.
fn frame(scene: &Scene, setting: &Setting, rule: Rule, packets: Packets) -> Result<Frame> {
    let levels = rule.levels(scene, setting);
    let start = Instant::now();
    let mut caster = (EmbreeSurface::new(&scene.control, &levels)?, packets);
    let build_s = start.elapsed().as_secs_f64();
    let (image, rays, hits) = cast(setting, &mut caster);
    let seconds = start.elapsed().as_secs_f64() - build_s;
    let bytes = caster.0.peak_bytes();
    Ok(Frame { image, seconds, build_s, rays, hits, bytes, ..Frame::default() })
}

/// The coarsest setting of each rule whose image is as near to `truth` as `rmse`, or the finest: errors fall with rates.
fn equal_rmse(scene: &Scene, setting: &Setting, truth: &[f32], rmse: f64) -> Result<Vec<Rule>> {
    let mut found = Vec::new();
    for rules in Rule::all() {
        let (mut low, mut high) = (0, rules.len() - 1);
        while low < high {
            let middle = (low + high) / 2;
            if frame(scene, setting, rules[middle], Packets::Single)?.rmse(truth) <= rmse {
                high = middle;
            } else {
                low = middle + 1;
            }
        }
        found.push(rules[low]);
    }
    Ok(found)
}

/// Rows of ours with baseline `embree`, whole frames with all that they build, and of Embree itself.
pub fn run(scene: &Scene, options: &Options, reference: &Reference, output: &mut Output) -> Result<()> {
    let lights = scene.lights();
    let view = scene.view(false, options.size);
    let setting = Setting { view, lights: &lights, strata: [2, 2], shadows: Shadows::FromPixel };
    let truth = reference.render(&setting);
    const PASSES: usize = 3;
    for pixels in PIXELS {
        let method = Method::once("once", pixels);
        let rmse = render(scene, &setting, &method)?.rmse(&truth);
        // The fastest way to trace each tessellation, by a small image.
        let small = Setting { view: scene.view(false, options.size / 4), ..setting };
        let mut peers = Vec::new();
        for rule in equal_rmse(scene, &setting, &truth, rmse)? {
            let times =
                Packets::ALL.map(|packets| frame(scene, &small, rule, packets).map(|f| (f.seconds, packets)));
            let times = times.into_iter().collect::<Result<Vec<_>>>()?;
            let fastest = times.into_iter().min_by(|a, b| a.0.total_cmp(&b.0));
            peers.push((rule, fastest.context("there are ways to trace")?.1));
        }
        let mut own = Vec::new();
        let mut theirs: Vec<Vec<Frame>> = peers.iter().map(|_| Vec::new()).collect();
        for _ in 0..PASSES {
            own.push(render(scene, &setting, &method)?);
            for ((rule, packets), frames) in peers.iter().zip(&mut theirs) {
                frames.push(frame(scene, &setting, *rule, *packets)?);
            }
        }
        for ((rule, packets), frames) in peers.iter().zip(&theirs) {
            let params = json!({
                "figure": NAME, "pixels": pixels, "size": options.size, "lights": lights.len(), "samples": 4,
                "peer_level": format!("{rule:?}"), "peer_mode": format!("{packets:?}"),
            });
            output.row(&row(scene, method.name, params.clone(), &own, frames, &truth))?;
            output.row(&row(scene, "embree", params, frames, frames, &truth))?;
        }
    }
    Ok(())
}

fn row(
    scene: &Scene,
    method: &str,
    params: serde_json::Value,
    own: &[Frame],
    peer: &[Frame],
    truth: &[f32],
) -> Row {
    let times = |frames: &[Frame]| frames.iter().map(|f| f.build_s + f.seconds).collect::<Vec<_>>();
    let (time_s, last, last_peer) = (median(&times(own)), &own[own.len() - 1], &peer[peer.len() - 1]);
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
            "peer_bytes": last_peer.bytes, "peer_build_s": last_peer.build_s, "peer_rmse": last_peer.rmse(truth),
            "bytes_ratio": last.bytes as f64 / last_peer.bytes as f64,
            "micropolygons": last.micropolygons, "hits": last.hits,
        }),
        baseline: "embree",
        speedup: paired_speedup(&times(peer), &times(own)),
    }
}
