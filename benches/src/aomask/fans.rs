//! Part `fans`: soft shadows, all rays of a receiver to an area light together.

use super::{Case, Options, measure, passes, workload};
use crate::{
    entry::{ALPHA, Answer, Entry},
    rows::{Output, Row, median, paired_speedup},
};
use anyhow::Result;
use rayon::{ThreadPool, ThreadPoolBuilder};
use serde_json::{Value, json};
use umbrage_accel::Bvh;
use umbrage_aomask::{BackEnd, exact::fans::FanCall};
use umbrage_geom::{
    OpticalDepth, Ray,
    glam::{Vec2, Vec3},
    sampling::{combine, stratified},
};

/// Rays of a receiver to the light.
const PER_FAN: [u32; 2] = [16, 64];

/// Rows of our own rays, of fans and of peers: opaque triangles, and all semi-transparent.
pub fn rows(case: &Case, options: &Options, output: &mut Output) -> Result<()> {
    for per_fan in PER_FAN {
        let rays = shadow_rays(case, per_fan, options.quick);
        let (ours, peers) = (&case.ours, &case.peers);
        let mut entries = ours.any_hit(&rays);
        for back_end in back_ends() {
            let answers = vec![false; rays.len()];
            entries.push(Box::new(Fans::new(case, &rays, per_fan, back_end, answers)?));
        }
        entries.extend(peers.iter().flat_map(|peer| peer.any_hit(&rays)));
        let params = json!({ "part": "fans", "rays": per_fan });
        write(case, &measure::of_fastest(entries, passes(options)), &params, output)?;
        let opacity = OpticalDepth::from_opacity(ALPHA);
        let mut entries = ours.transmittance(&rays, opacity);
        for back_end in back_ends() {
            let answers = vec![OpticalDepth::CLEAR; rays.len()];
            entries.push(Box::new(Fans::new(case, &rays, per_fan, back_end, answers)?));
        }
        entries.extend(peers.iter().flat_map(|peer| peer.transmittance(&rays, opacity)));
        let params =
            json!({ "part": "fans", "rays": per_fan, "alpha": (f64::from(ALPHA) * 1e3).round() / 1e3 });
        write(case, &measure::of_fastest(entries, passes(options)), &params, output)?;
    }
    Ok(())
}

fn back_ends() -> impl Iterator<Item = BackEnd> {
    BackEnd::ALL.into_iter().filter(|b| *b != BackEnd::Scalar && b.is_supported())
}

/// Stratified rays to a square light above the scene, half its size, neighbours on the light together.
fn shadow_rays(case: &Case, per_fan: u32, quick: bool) -> Vec<Ray> {
    let receivers =
        workload::surface_of(&case.mesh, if quick { 1 << 17 } else { 1 << 18 } / per_fan as usize);
    let bounds = case.mesh.bounds();
    let (center, size) = (bounds.center(), bounds.diagonal());
    let middle = center + Vec3::new(0.3, 1.0, 0.2) * size;
    let side = f64::from(per_fan).sqrt() as f32;
    let cell = |p: &Vec2| {
        let [x, y] = [(p.x * side) as u32, (p.y * side) as u32];
        (0..4).fold(0, |key, bit| key | (x >> bit & 1) << (2 * bit) | (y >> bit & 1) << (2 * bit + 1))
    };
    let rays = |(i, &point): (usize, &Vec3)| {
        let mut samples = stratified(per_fan, combine(1, i as u32));
        samples.sort_by_key(cell);
        samples.into_iter().map(move |p| {
            let at = (p - 0.5) * 0.5 * size;
            Ray::between(point, middle + Vec3::new(at.x, 0.0, at.y))
        })
    };
    receivers.points.iter().enumerate().flat_map(rays).collect()
}

/// Rows against our own rays and against each peer.
fn write<A: Answer>(
    case: &Case,
    best: &[measure::Measured<'_, A>],
    params: &Value,
    output: &mut Output,
) -> Result<()> {
    let of_method = |name: &str| best.iter().find(|m| m.entry.method() == name);
    let rays = of_method("rays").expect("always measured");
    for method in best {
        let name = method.entry.method();
        let count = method.answers.len();
        let different = method.answers.iter().zip(&rays.answers).filter(|(a, b)| a != b).count();
        let mean = method.answers.iter().map(|a| a.occlusion()).sum::<f64>() / count as f64;
        let mut params = params.clone();
        params["mode"] = json!(method.entry.mode());
        let time_s = median(&method.times);
        let row = Row {
            suite: "aomask",
            scene: case.name.into(),
            method: name.into(),
            params,
            time_s,
            build_s: method.entry.build_s(),
            mrays_s: count as f64 / time_s * 1e-6,
            rmse: 0.0,
            bias: 0.0,
            bytes: method.entry.bytes(),
            counters: json!({ "different_bits": different, "mean_occlusion": mean }),
            baseline: "rays",
            speedup: paired_speedup(&rays.times, &method.times),
        };
        output.row(&row)?;
        let own = ["rays", "fans"].contains(&name);
        for peer in case.peers.iter().filter(|_| own) {
            if let Some(theirs) = of_method(peer.name()) {
                let speedup = paired_speedup(&theirs.times, &method.times);
                let mut row = Row { baseline: peer.name(), speedup, ..row.clone() };
                row.params["peer_mode"] = json!(theirs.entry.mode());
                output.row(&row)?;
            }
        }
    }
    Ok(())
}

/// Fans of `umbrage-aomask`.
struct Fans<'a, A> {
    case: &'a Case,
    rays: &'a [Ray],
    per_fan: usize,
    back_end: BackEnd,
    answers: Vec<A>,
    /// For runs on one thread.
    one: ThreadPool,
}

impl<'a, A> Fans<'a, A> {
    fn new(
        case: &'a Case,
        rays: &'a [Ray],
        per_fan: u32,
        back_end: BackEnd,
        answers: Vec<A>,
    ) -> Result<Self> {
        let one = ThreadPoolBuilder::new().num_threads(1).build()?;
        Ok(Self { case, rays, per_fan: per_fan as usize, back_end, answers, one })
    }
}

/// What is asked of a fan.
trait FanAnswer: Answer {
    fn ask(bvh: &Bvh, rays: &[Ray], per_fan: usize, back_end: BackEnd, answers: &mut [Self]);
}

impl FanAnswer for bool {
    fn ask(bvh: &Bvh, rays: &[Ray], per_fan: usize, back_end: BackEnd, answers: &mut [Self]) {
        let call = FanCall::new(bvh, rays, per_fan).with_back_end(back_end);
        call.any_hits(answers).expect("valid fans");
    }
}

impl FanAnswer for OpticalDepth {
    fn ask(bvh: &Bvh, rays: &[Ray], per_fan: usize, back_end: BackEnd, answers: &mut [Self]) {
        let opacity = Self::from_opacity(ALPHA);
        let call = FanCall::new(bvh, rays, per_fan).with_back_end(back_end);
        call.transmittances(|_| opacity, answers).expect("valid fans");
    }
}

impl<A: FanAnswer> Entry<A> for Fans<'_, A> {
    fn method(&self) -> &'static str {
        "fans"
    }

    fn mode(&self) -> String {
        format!("{:?}", self.back_end).to_lowercase()
    }

    fn build_s(&self) -> f64 {
        self.case.ours.build_s
    }

    fn bytes(&self) -> usize {
        self.case.ours.bvh().bytes()
    }

    fn run(&mut self, pool: Option<&ThreadPool>) {
        let Self { case, rays, per_fan, back_end, answers, one } = self;
        let bvh = case.ours.bvh();
        pool.unwrap_or(one).install(|| A::ask(bvh, rays, *per_fan, *back_end, answers));
    }

    fn answers(&self) -> Vec<A> {
        self.answers.clone()
    }
}
