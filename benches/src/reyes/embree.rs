//! Frames by Embree's subdivision geometry at the tessellation that comes as near to the limit surface as ours.

use super::{
    Options,
    frame::{Frame, Reference, Setting, Shadows, jitter},
    scenes::Scene,
};
use crate::{
    embree::surface::{EmbreeSurface, Shadows as Packets},
    rows::{Output, Row, median, paired_speedup},
};
use anyhow::{Context, Result};
use serde_json::json;
use std::{sync::Arc, time::Instant};
use umbrage_geom::{Ray, glam::Vec3, offset_origin};
use umbrage_reyes::{RatedSurface, Surface, SurfaceOptions};

/// Name of the figure.
pub const NAME: &str = "embree";

/// Edges of our micropolygons.
const PIXELS: [f32; 2] = [4.0, 2.0];

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
        let uniform = [1, 2, 3, 4, 5, 6, 8, 10, 12, 16, 20, 24, 32, 48, 64, 96, 128, 192, 256];
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

/// Something that rays are traced against.
trait Caster {
    /// `t` and unit normal of the closest micropolygon.
    fn closest_hit(&self, ray: &Ray) -> Option<(f32, Vec3)>;

    /// How many of `rays` are blocked.
    fn count_blocked(&mut self, rays: &[Ray]) -> usize;
}

impl Caster for RatedSurface {
    fn closest_hit(&self, ray: &Ray) -> Option<(f32, Vec3)> {
        let hit = self.closest_hit(ray)?;
        let [a, b, c] = self.corners(&hit).map(Vec3::from);
        Some((hit.hit.t, (b - a).cross(c - a).normalize_or_zero()))
    }

    fn count_blocked(&mut self, rays: &[Ray]) -> usize {
        rays.iter().filter(|ray| self.any_hit(ray)).count()
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

/// Renders as [`frame::render`](super::frame::render) does, with shadow rays from micropolygons. Returns image, rays, hits.
fn trace(setting: &Setting, caster: &mut impl Caster) -> (Vec<f32>, usize, usize) {
    let size = setting.view.size;
    let samples = setting.strata[0] * setting.strata[1];
    let most = samples as usize * setting.lights.len();
    let mut image = vec![1f32; (size * size) as usize];
    let mut shadow_rays = Vec::with_capacity(most);
    let (mut rays, mut hits) = (0, 0);
    // Hits are as exact as `t` is.
    let magnitude = 8.0 * setting.view.eye.abs().max_element();
    for (x, y) in setting.view.pixels() {
        let (ray, _) = setting.view.ray(x, y);
        rays += 1;
        let Some((t, normal)) = caster.closest_hit(&ray) else { continue };
        hits += 1;
        let point = ray.at(t);
        shadow_rays.clear();
        for (l, light) in setting.lights.iter().enumerate() {
            for i in 0..samples {
                let (target, _) = light.sample(i, setting.strata, jitter(x, y, l, i));
                let origin = offset_origin(point, normal, target - point, magnitude);
                shadow_rays.push(Ray::between(origin, target));
            }
        }
        rays += shadow_rays.len();
        let blocked = caster.count_blocked(&shadow_rays);
        image[(y * size + x) as usize] = 1.0 - blocked as f32 / most as f32;
    }
    (image, rays, hits)
}

/// A frame by Embree.
fn frame(scene: &Scene, setting: &Setting, rule: Rule, packets: Packets) -> Result<Frame> {
    let levels = rule.levels(scene, setting);
    let start = Instant::now();
    let mut caster = (EmbreeSurface::new(&scene.control, &levels)?, packets);
    let build_s = start.elapsed().as_secs_f64();
    let (image, rays, hits) = trace(setting, &mut caster);
    let seconds = start.elapsed().as_secs_f64() - build_s;
    let bytes = caster.0.peak_bytes();
    Ok(Frame { image, seconds, build_s, rays, hits, bytes, ..Frame::default() })
}

/// A frame by ours, at edges of so many pixels.
fn rated(scene: &Scene, setting: &Setting, pixels: f32) -> Result<Frame> {
    let start = Instant::now();
    // Nothing of the trees of patches is needed once a patch is made.
    let options = SurfaceOptions::default().with_tight_levels(0).with_tree_bytes(0);
    let surface = Arc::new(Surface::build(&scene.control, &options)?);
    let (_, differential) = setting.view.ray(0, 0);
    let width = differential.d_direction[0].length() * pixels;
    let mut caster = RatedSurface::for_eye(Arc::clone(&surface), setting.view.eye, width, 10)?;
    let build_s = start.elapsed().as_secs_f64();
    let (image, rays, hits) = trace(setting, &mut caster);
    let seconds = start.elapsed().as_secs_f64() - build_s;
    let counts = surface.counts();
    let micropolygons = caster.micropolygons();
    let bytes = surface.bytes() + caster.bytes();
    Ok(Frame {
        image,
        seconds,
        build_s,
        rays,
        hits,
        bound: counts.bound,
        split: counts.split,
        dice: surface.patch_count() as u64,
        micropolygons,
        bytes,
    })
}

/// The coarsest setting of each rule whose image is as near to `truth` as `rmse`, or the nearest.
fn equal_rmse(scene: &Scene, setting: &Setting, truth: &[f32], rmse: f64) -> Result<Vec<(Rule, f64)>> {
    let mut found = Vec::new();
    for rules in Rule::all() {
        let mut nearest: Option<(Rule, f64)> = None;
        for rule in rules {
            let own = frame(scene, setting, rule, Packets::Single)?.rmse(truth);
            if nearest.is_none_or(|(_, least)| own < least) {
                nearest = Some((rule, own));
            }
            if own <= rmse {
                break;
            }
        }
        found.extend(nearest);
    }
    Ok(found)
}

/// Rows of ours with baseline `embree`, whole frames with all that they build, and of Embree itself.
pub fn run(scene: &Scene, options: &Options, reference: &Reference, output: &mut Output) -> Result<()> {
    let lights = scene.lights();
    let view = scene.view(false, options.size);
    let setting = Setting { view, lights: &lights, strata: [2, 2], shadows: Shadows::FromPixel };
    let truth = reference.render(&setting);
    for pixels in [8.0, 4.0, 3.0, 2.0, 1.5, 1.0] {
        let f = rated(scene, &setting, pixels)?;
        println!(
            "{pixels} rmse {:.2e} bytes {} time {:.3} build {:.3} made {} {}",
            f.rmse(&truth),
            f.bytes,
            f.seconds,
            f.build_s,
            f.dice,
            f.micropolygons
        );
    }
    for r in Rule::all() {
        for r in r {
            let f = frame(scene, &setting, r, Packets::Single)?;
            println!(
                "{r:?} rmse {:.2e} bytes {} time {:.3} build {:.3}",
                f.rmse(&truth),
                f.bytes,
                f.seconds,
                f.build_s
            );
            if f.bytes > 60_000_000 {
                break;
            }
        }
    }
    if true {
        return Ok(());
    }
    let passes = if options.quick { 3 } else { 5 };
    for pixels in PIXELS {
        let rmse = rated(scene, &setting, pixels)?.rmse(&truth);
        let rules = equal_rmse(scene, &setting, &truth, rmse)?;
        // The fastest way to trace each tessellation.
        let mut peers = Vec::new();
        for (rule, _) in rules {
            let mut times = Vec::new();
            for packets in Packets::ALL {
                times.push((frame(scene, &setting, rule, packets)?.seconds, packets));
            }
            let fastest = times.into_iter().min_by(|a, b| a.0.total_cmp(&b.0));
            peers.push((rule, fastest.context("there are ways to trace")?.1));
        }
        let mut own = Vec::new();
        let mut theirs: Vec<Vec<Frame>> = peers.iter().map(|_| Vec::new()).collect();
        for _ in 0..passes {
            own.push(rated(scene, &setting, pixels)?);
            for ((rule, packets), frames) in peers.iter().zip(&mut theirs) {
                frames.push(frame(scene, &setting, *rule, *packets)?);
            }
        }
        for ((rule, packets), frames) in peers.iter().zip(&theirs) {
            let params = json!({
                "figure": NAME, "pixels": pixels, "size": options.size, "lights": lights.len(), "samples": 4,
                "peer_level": format!("{rule:?}"), "peer_mode": format!("{packets:?}"),
            });
            output.row(&row(scene, "rated", params.clone(), &own, frames, &truth))?;
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
