//! Part `choices` of suite `anyhit`: what an exact predicate costs, and what widths, orders and spatial splits are worth.
//!
//! One plain walk of a single ray over trees that differ in one thing ([`tree`], [`walk`]), so that nothing else decides; and
//! the library itself on rays that are not valid.

mod tree;
mod walk;

use self::{
    tree::{Order, Tree},
    walk::{Answers, Exact, Leaves, Question, Woop},
};
use super::workloads::{self, Case, Workload};
use crate::rows::{Output, Row, Timed, alternate, median, note, paired_speedup};
use anyhow::Result;
use serde_json::{Value, json};
use umbrage_accel::{BuildOptions, Bvh};
use umbrage_geom::{OpticalDepth, Ray, simd::Avx2};

/// A scene and what its rows ask.
const SCENES: [&str; 6] = ["bunny_60k", "sibenik", "hairball", "city", "cathedral", "bush"];

/// Opacity of a triangle where some are opaque, others hardly: every eighth lets nothing through.
fn mixed_opacity(prim: u32) -> f32 {
    if prim.is_multiple_of(8) { 1.0 } else { 0.3 }
}

/// Runs the part.
pub fn run(quick: bool, only: Option<&str>, output: &mut Output) -> Result<()> {
    let Some(avx2) = Avx2::detect() else {
        eprintln!("no AVX2: part choices is skipped");
        return Ok(());
    };
    let asked = |name: &str| SCENES.contains(&name) && only.is_none_or(|only| name.contains(only));
    for source in workloads::sources(quick).into_iter().filter(|source| asked(&source.name)) {
        note(&format!("preparing {}", source.name));
        let case = source.load()?;
        let passes = if quick { 5 } else { 11 };
        for workload in workloads::workloads(&case, true) {
            let ambient = workload.params["radius"] == 0.1;
            let shadow = workload.params["workload"] == "shadow";
            if !workload.transparent && (ambient || shadow) {
                let part = Part { case: &case, workload: &workload, passes };
                part.walks(avx2, output)?;
                if ambient {
                    part.invalid_rays(output)?;
                }
            }
        }
    }
    Ok(())
}

/// One scene and its rays.
struct Part<'a> {
    case: &'a Case,
    workload: &'a Workload,
    passes: usize,
}

/// A walk under measurement.
struct Variant<'a> {
    name: &'static str,
    /// The variant it is compared to.
    baseline: &'static str,
    leaves: usize,
    bytes: usize,
    pass: Box<dyn FnMut() -> Answers + 'a>,
    answers: Answers,
}

impl Timed for Variant<'_> {
    fn run(&mut self) {
        self.answers = (self.pass)();
    }
}

fn variant<'a, const W: usize, L: Leaves>(
    (name, baseline): (&'static str, &'static str),
    tree: &'a Tree<W>,
    question: Question,
    near_first: bool,
    rays: &'a [Ray],
    leaves: L,
) -> Variant<'a> {
    let pass = Box::new(move || walk::answer(tree, rays, leaves, question, near_first));
    Variant {
        name,
        baseline,
        leaves: tree.leaves.len(),
        bytes: tree.bytes(),
        pass,
        answers: Answers::default(),
    }
}

impl Part<'_> {
    /// Rows of the plain walk.
    fn walks(&self, avx2: Avx2, output: &mut Output) -> Result<()> {
        let (mesh, rays) = (&self.case.mesh, &self.workload.rays[..]);
        let opaque = |_| 1.0;
        let wide = Tree::<8>::build(mesh, Order::BoxArea, &opaque, false)?;
        let narrow = Tree::<4>::build(mesh, Order::BoxArea, &opaque, false)?;
        let split = Tree::<8>::build(mesh, Order::BoxArea, &opaque, true)?;
        let surface = Tree::<8>::build(mesh, Order::TriangleArea, &opaque, false)?;
        let likely = Tree::<8>::build(mesh, Order::Termination, &opaque, false)?;
        let likely_mixed = Tree::<8>::build(mesh, Order::Termination, &mixed_opacity, false)?;
        let sum = Question::Mixed([0, 1].map(|prim| OpticalDepth::from_opacity(mixed_opacity(prim))));
        let any = Question::AnyHit;
        let exact = Exact(avx2);
        let variants = vec![
            variant(("exact", "exact"), &wide, any, false, rays, exact),
            variant(("woop", "exact"), &wide, any, false, rays, Woop),
            variant(("4-wide", "exact"), &narrow, any, false, rays, exact),
            variant(("splits", "exact"), &split, any, false, rays, exact),
            variant(("order-near", "exact"), &wide, any, true, rays, exact),
            variant(("order-sato", "exact"), &surface, any, false, rays, exact),
            variant(("order-rtsah", "exact"), &likely, any, false, rays, exact),
            variant(("mixed", "mixed"), &wide, sum, false, rays, exact),
            variant(("mixed-near", "mixed"), &wide, sum, true, rays, exact),
            variant(("mixed-sato", "mixed"), &surface, sum, false, rays, exact),
            variant(("mixed-rtsah", "mixed"), &likely, sum, false, rays, exact),
            variant(("mixed-rtsah-a", "mixed"), &likely_mixed, sum, false, rays, exact),
        ];
        self.measure(variants, output)
    }

    fn measure(&self, mut variants: Vec<Variant>, output: &mut Output) -> Result<()> {
        let mut timed: Vec<&mut dyn Timed> = variants.iter_mut().map(|v| v as &mut dyn Timed).collect();
        let times = alternate(self.passes, &mut timed);
        for (variant, time) in variants.iter().zip(&times) {
            let base = variants.iter().position(|v| v.name == variant.baseline).expect("named above");
            let answers = &variant.answers;
            let different = answers.hits.iter().zip(&variants[base].answers.hits).filter(|(a, b)| a != b);
            let counters = json!({
                "different_bits": different.count(),
                "leaves": variant.leaves,
                "nodes": answers.nodes,
                "leaf_tests": answers.leaf_tests,
                "triangles": self.case.mesh.triangles.len(),
            });
            let speedup = paired_speedup(&times[base], time);
            output.row(&self.row(
                variant.name,
                variant.baseline,
                (time, speedup),
                variant.bytes,
                counters,
            ))?;
        }
        Ok(())
    }

    fn row(
        &self,
        method: &str,
        baseline: &'static str,
        (times, speedup): (&[f64], f64),
        bytes: usize,
        counters: Value,
    ) -> Row {
        let rays = self.workload.rays.len();
        let mut params = self.workload.params.clone();
        params["rays"] = json!(rays);
        let time_s = median(times);
        Row {
            suite: "anyhit",
            scene: self.case.name.clone(),
            method: method.into(),
            params,
            time_s,
            build_s: 0.0,
            mrays_s: rays as f64 / time_s * 1e-6,
            rmse: 0.0,
            bias: 0.0,
            bytes,
            counters,
            baseline,
            speedup,
        }
    }

    /// The library on the same rays with a coordinate that is not a number, or infinite, beside the rays themselves.
    fn invalid_rays(&self, output: &mut Output) -> Result<()> {
        let mesh = &self.case.mesh;
        let bvh = Bvh::build(&mesh.positions, &mesh.triangles, &BuildOptions::default())?;
        let rays = &self.workload.rays[..];
        let with = |change: fn(&mut Ray)| -> Vec<Ray> {
            let mut rays = rays.to_vec();
            rays.iter_mut().for_each(change);
            rays
        };
        let nan = with(|ray| ray.direction.y = f32::NAN);
        let infinite = with(|ray| ray.origin.x = f32::INFINITY);
        let endless = with(|ray| ray.direction.z = f32::NEG_INFINITY);
        let sets =
            [("rays", rays), ("nan", &nan[..]), ("infinite", &infinite[..]), ("endless", &endless[..])];
        for slice in [true, false] {
            let mut hits = vec![vec![false; rays.len()]; sets.len()];
            let mut passes: Vec<_> = hits
                .iter_mut()
                .zip(sets)
                .map(|(hits, (_, rays))| {
                    let bvh = &bvh;
                    move || {
                        if slice {
                            bvh.any_hits_with(rays, hits, &mut ());
                        } else {
                            hits.iter_mut().zip(rays).for_each(|(hit, ray)| *hit = bvh.any_hit(ray));
                        }
                    }
                })
                .collect();
            let mut timed: Vec<&mut dyn Timed> =
                passes.iter_mut().map(|pass| pass as &mut dyn Timed).collect();
            let times = alternate(self.passes, &mut timed);
            drop(passes);
            for (i, (name, _)) in sets.iter().enumerate() {
                let speedup = paired_speedup(&times[0], &times[i]);
                let method = format!("{}-{name}", if slice { "slice" } else { "single" });
                let baseline = if slice { "slice-rays" } else { "single-rays" };
                let answered = hits[i].iter().filter(|hit| **hit).count();
                // Every hit of a ray that is not valid would be wrong.
                let counters =
                    json!({ "hits": answered, "different_bits": if i > 0 { answered } else { 0 } });
                output.row(&self.row(&method, baseline, (&times[i], speedup), bvh.bytes(), counters))?;
            }
        }
        Ok(())
    }
}
