//! Parts `truth`, `target-error` and `patterns`: bias and RMSE against the unbiased reference, apart from each other.
//!
//! Receivers are random points of the whole surface. Every error is against `umbrage_reference`: independent random rays that start at
//! the same points, decided by the exact predicate, whose own standard error is in the counters. `rmse` leaves out what the reference
//! itself errs by.

use super::Options;
use crate::{
    rows::{Output, Row, Timed, alternate, median, note, paired_speedup},
    scenes,
};
use anyhow::Result;
use serde_json::{Value, json};
use std::{f64::consts::TAU, path::PathBuf};
use umbrage_aomask::{
    MaskCall, MaskOptions, Outputs, Pattern, PatternOptions, Receiver, exact::adaptive::Spent, published,
};
use umbrage_geom::{
    Falloff, TriangleMesh,
    glam::{Vec2, Vec3},
    sampling::{RandomStream, combine, concentric_disc, sobol_2d},
};
use umbrage_query::{Answers, AoMethod, Engine, Ground, Occluders, Sky, engine};
use umbrage_reference::{Question, Reference};

/// Scenes: closed, open, rooms, foliage.
const SCENES: [(&str, &str); 8] = [
    ("bunny", "closed/bunny_60k.obj"),
    ("cow", "closed/cow.obj"),
    ("bunny-open", "open/stanford_bunny_69k.obj"),
    ("teapot", "open/teapot.obj"),
    ("sibenik", "scenes/sibenik.obj"),
    ("sponza", "scenes/crytek_sponza_part.obj"),
    ("bush", ""),
    ("hairball", ""),
];

/// Scenes on which sets of directions are compared.
const PATTERN_SCENES: [&str; 6] = ["bunny", "cow", "teapot", "sibenik", "bush", "hairball"];

/// Triangles of generated scenes.
const GENERATED_TRIANGLES: usize = 100_000;

/// Of the diagonal.
const RADII: [f32; 2] = [f32::INFINITY, 0.1];

const RAYS: [u32; 6] = [32, 64, 128, 256, 512, 1024];
const TARGETS: [f32; 3] = [0.05, 0.02, 0.01];

/// Errors at which times of `mask` and `rays` are compared.
const EQUAL_RMSE: [f64; 2] = [0.01, 0.005];

/// Receivers of a scene, random rays of the reference for each, and passes.
fn sizes(options: &Options) -> (usize, u32, usize) {
    if options.quick { (1000, 4096, 1) } else { (3000, 16_384, 3) }
}

/// A scene and a radius with the answer.
struct Case {
    name: &'static str,
    occluders: Occluders,
    mesh: TriangleMesh,
    receivers: Vec<Receiver>,
    /// Of the diagonal.
    radius: f32,
    reference: Reference,
}

impl Case {
    /// All cases of the scenes that are wanted.
    fn each(options: &Options, only: &[&str], mut run: impl FnMut(&Self) -> Result<()>) -> Result<()> {
        let (count, rays, _) = sizes(options);
        for (name, path) in SCENES {
            let wanted = options.only.as_ref().is_none_or(|only| name.contains(only.as_str()));
            if !wanted || !only.contains(&name) {
                continue;
            }
            let mesh = if path.is_empty() {
                scenes::generated(name, GENERATED_TRIANGLES)?
            } else {
                let Some(folder) = super::meshes() else { continue };
                let path: PathBuf = folder.join(path);
                umbrage_scene::read_mesh(&path)?
            };
            let points = random_points(&mesh, count);
            for radius in RADII {
                note(&format!("reference of {name}, radius {radius}"));
                let question = Question {
                    mesh: &mesh,
                    depths: &[],
                    points: &points.0,
                    normals: &points.1,
                    radius: radius * mesh.bounds().diagonal(),
                    falloff: &Falloff::Constant,
                };
                let receiver = |(i, (&p, &n))| Receiver::new(i, p, n, Receiver::seed_of(p, n, 0));
                let all = points.0.iter().zip(&points.1).enumerate().map(receiver);
                run(&Self {
                    name,
                    occluders: Occluders::of_meshes(&[&mesh], Ground::Absent, &mut |_| true)?,
                    receivers: all.collect::<Result<_, _>>()?,
                    radius,
                    reference: question.cached(rays, 1)?,
                    mesh: mesh.clone(),
                })?;
            }
        }
        Ok(())
    }

    fn length(&self) -> f32 {
        self.radius * self.mesh.bounds().diagonal()
    }

    fn params(&self, part: &str) -> Value {
        let radius = self.radius.is_finite().then_some((f64::from(self.radius) * 1e6).round() / 1e6);
        json!({ "part": part, "radius": radius })
    }

    /// A row of answers `ao`; times, speedup and baseline are the caller's.
    fn row(&self, method: &str, params: Value, ao: &[f32]) -> Row {
        let ao = || ao.iter().map(|&x| f64::from(x));
        let Reference { ao: truth, .. } = &self.reference;
        let counters = json!({
            "receivers": truth.len(),
            "reference_standard_error": self.reference.standard_error(),
            "reference_standard_error_of_mean": self.reference.standard_error_of_mean(),
            "mean_ao": truth.iter().sum::<f64>() / truth.len() as f64,
            "largest_error": ao().zip(truth).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max),
        });
        Row {
            suite: "aomask",
            scene: self.name.into(),
            method: method.into(),
            params,
            time_s: 0.0,
            build_s: 0.0,
            mrays_s: 0.0,
            rmse: self.reference.rmse(ao()),
            bias: self.reference.bias(ao()),
            bytes: 0,
            counters,
            baseline: "rays",
            speedup: 1.0,
        }
    }
}

/// Random points of the surface in Morton order, moved off it, with its normals.
fn random_points(mesh: &TriangleMesh, count: usize) -> (Vec<[f32; 3]>, Vec<[f32; 3]>) {
    let scenes::Receivers { points, normals } = scenes::receivers(mesh, count, 1);
    let list = |v: Vec<Vec3>| v.into_iter().map(|v| v.to_array()).collect::<Vec<_>>();
    (list(points), list(normals))
}

/// Seeds of receivers over which biases are averaged, so that noise of single answers doesn't hide them.
const BIAS_SEEDS: u32 = 8;

/// A method with a number of rays, its answers.
struct MethodRun<'a> {
    name: &'static str,
    rays: u32,
    case: &'a Case,
    receivers: Vec<Receiver>,
    engine: Box<dyn Engine + 'a>,
    pattern: Pattern,
    ao: Vec<f32>,
    spent: Spent,
}

impl MethodRun<'_> {
    /// Mean bias over seeds of the receivers, and its standard error by their spread.
    fn mean_bias(&mut self) -> (f64, f64) {
        let mut biases = Vec::new();
        for seed in 0..BIAS_SEEDS {
            let reseeded = |r: &Receiver| r.with_seed(combine(r.seed(), seed));
            self.receivers = self.case.receivers.iter().map(reseeded).collect();
            self.run();
            biases.push(self.case.reference.bias(self.ao.iter().map(|&x| f64::from(x))));
        }
        let n = f64::from(BIAS_SEEDS);
        let mean = biases.iter().sum::<f64>() / n;
        let spread = biases.iter().map(|b| (b - mean).powi(2)).sum::<f64>() / (n - 1.0);
        (mean, (spread / n).sqrt())
    }
}

impl Timed for MethodRun<'_> {
    fn run(&mut self) {
        let Self { case, receivers, engine, pattern, ao, spent, .. } = self;
        if engine.answers() == Answers::Rays {
            engine::openness_by_rays(&**engine, (pattern, case.length()), receivers, ao, &mut |_| true)
                .expect("it answers rays");
            return;
        }
        let outputs = Outputs::new(ao);
        *spent = engine.sky(receivers, outputs, &mut |_| true).expect("it answers receivers");
    }
}

/// Every ambient method by rays and radius, and the published pattern of rays.
pub fn truth(options: &Options, output: &mut Output) -> Result<()> {
    Case::each(options, &SCENES.map(|(name, _)| name), |case| {
        let mut curves: Vec<(&str, Vec<[f64; 2]>)> = Vec::new();
        for rays in RAYS {
            let plain = PatternOptions::default().with_rays(rays);
            // Every method that answers receivers or rays, and the published rays.
            let all = AoMethod::ALL.iter().filter(|&&method| method != AoMethod::MaskRaster);
            let mut methods: Vec<_> = all.map(|&method| (method.name(), method, plain.clone())).collect();
            methods.push(("mask:relaxed", AoMethod::Mask, published::relaxed(rays)));
            let asked =
                |(name, method, options): (&'static str, AoMethod, PatternOptions)| -> Result<MethodRun> {
                    let sky = Sky::new(options.clone(), case.length());
                    let engine = engine::sky(method, &case.occluders, &sky, &mut |_| true)?;
                    let pattern = Pattern::new(&options)?;
                    let ao = vec![0.0; case.receivers.len()];
                    let receivers = case.receivers.clone();
                    Ok(MethodRun {
                        name,
                        rays,
                        case,
                        receivers,
                        engine,
                        pattern,
                        ao,
                        spent: Spent::default(),
                    })
                };
            let mut runs = methods.into_iter().map(asked).collect::<Result<Vec<_>>>()?;
            let mut timed: Vec<&mut dyn Timed> = runs.iter_mut().map(|run| run as &mut dyn Timed).collect();
            let times = alternate(sizes(options).2, &mut timed);
            for (run, own) in runs.iter_mut().zip(&times) {
                let mut params = case.params("truth");
                params["rays"] = json!(run.rays);
                let mut row = case.row(run.name, params, &run.ao);
                row.time_s = median(own);
                row.mrays_s = (case.receivers.len() * run.rays as usize) as f64 / row.time_s * 1e-6;
                row.speedup = paired_speedup(&times[0], own);
                let (bias, error) = run.mean_bias();
                row.bias = bias;
                row.counters["bias_seeds"] = json!(BIAS_SEEDS);
                row.counters["bias_standard_error"] =
                    json!(error.hypot(case.reference.standard_error_of_mean()));
                output.row(&row)?;
                let point = [row.rmse, row.time_s];
                match curves.iter_mut().find(|(name, _)| *name == run.name) {
                    Some((_, curve)) => curve.push(point),
                    None => curves.push((run.name, vec![point])),
                }
            }
        }
        equal_rmse(case, &curves, output)
    })
}

/// Time for an RMSE, by straight lines in logarithms; `None` outside of what was measured.
fn time_for(curve: &[[f64; 2]], rmse: f64) -> Option<f64> {
    let pair = curve.windows(2).find(|pair| pair[0][0] >= rmse && rmse >= pair[1][0])?;
    let [[e0, t0], [e1, t1]] = [pair[0], pair[1]];
    let share = if e0 == e1 { 0.0 } else { (e0 / rmse).ln() / (e0 / e1).ln() };
    Some((t0.ln() + share * (t1 / t0).ln()).exp())
}

/// Rows with baseline `equal-rmse`: how much sooner `mask` has the error of single rays, and of the published pattern.
fn equal_rmse(case: &Case, curves: &[(&str, Vec<[f64; 2]>)], output: &mut Output) -> Result<()> {
    let of = |name: &str| &curves.iter().find(|(known, _)| *known == name).expect("always measured").1;
    for rmse in EQUAL_RMSE {
        for against in ["rays", "mask:relaxed"] {
            let times = [time_for(of(against), rmse), time_for(of("mask"), rmse)];
            let [Some(theirs), Some(ours)] = times else { continue };
            let mut params = case.params("truth");
            params["target_rmse"] = json!(rmse);
            params["against"] = json!(against);
            let mut row = case.row("mask", params, &[]);
            (row.time_s, row.speedup, row.baseline) = (ours, theirs / ours, "equal-rmse");
            (row.rmse, row.bias) = (rmse, 0.0);
            output.row(&row)?;
        }
    }
    Ok(())
}

/// What `--target-error` gives.
pub fn target_error(options: &Options, output: &mut Output) -> Result<()> {
    Case::each(options, &SCENES.map(|(name, _)| name), |case| {
        for target in TARGETS {
            let pattern = PatternOptions::default().with_rays(Pattern::MAX_MASK_RAYS);
            let sky = Sky::new(pattern.clone(), case.length()).with_target_error(Some(target));
            let engine = engine::sky(AoMethod::Mask, &case.occluders, &sky, &mut |_| true)?;
            let (ao, pattern) = (vec![0.0; case.receivers.len()], Pattern::new(&pattern)?);
            let (receivers, spent) = (case.receivers.clone(), Spent::default());
            let mut run = MethodRun { name: "mask", rays: 0, case, receivers, engine, pattern, ao, spent };
            let times = alternate(1, &mut [&mut run]);
            let mut params = case.params("target-error");
            params["target"] = json!((f64::from(target) * 1e4).round() / 1e4);
            let mut row = case.row("mask", params, &run.ao);
            row.time_s = times[0][0];
            row.mrays_s = run.spent.rays as f64 / row.time_s * 1e-6;
            row.counters["rmse_over_target"] = json!(row.rmse / f64::from(target));
            row.counters["estimated_error"] = json!(run.spent.estimated_error);
            row.counters["rays_a_receiver"] = json!(run.spent.rays as f64 / case.receivers.len() as f64);
            row.counters["receivers_by_rays"] = json!(run.spent.receivers);
            output.row(&row)?;
        }
        Ok(())
    })
}

/// A set of directions under comparison.
struct Candidate {
    name: &'static str,
    make: fn(u32) -> Result<Pattern>,
}

const CANDIDATES: [Candidate; 6] = [
    Candidate { name: "spiral", make: |rays| Ok(Pattern::new(&PatternOptions::default().with_rays(rays))?) },
    Candidate { name: "relaxed", make: |rays| Ok(Pattern::new(&published::relaxed(rays))?) },
    Candidate { name: "relaxed-rings", make: relaxed_rings },
    Candidate { name: "sobol-polar", make: sobol_polar },
    Candidate { name: "sobol-rings", make: |rays| in_rings(&disc(rays, |i| sobol_2d(i, 0, 3))) },
    Candidate { name: "lattice-rings", make: |rays| in_rings(&disc(rays, |i| lattice(i, rays))) },
];

/// Members of a candidate's family.
const MEMBERS: u32 = 64;

fn disc(rays: u32, square: impl Fn(u32) -> Vec2) -> Vec<Vec2> {
    (0..rays).map(|i| concentric_disc(square(i))).collect()
}

/// A lattice of rank 1 by the golden section.
fn lattice(i: u32, n: u32) -> Vec2 {
    let turns = f64::from(i) * 0.618_033_988_749_894_9;
    Vec2::new((i as f32 + 0.5) / n as f32, turns.fract() as f32)
}

fn relaxed_rings(rays: u32) -> Result<Pattern> {
    let relaxed = Pattern::new(&published::relaxed(rays))?;
    in_rings(&relaxed.directions(0).iter().map(|d| d.truncate()).collect::<Vec<_>>())
}

/// Points of the disc, sorted by distance from its middle, each moved into its ring of equal area at random.
fn in_rings(points: &[Vec2]) -> Result<Pattern> {
    let mut points = points.to_vec();
    points.sort_by(|a, b| b.length_squared().total_cmp(&a.length_squared()));
    let mut random = RandomStream::new(5, 5);
    let member = |_| {
        let place = |(ring, p): (usize, &Vec2)| {
            let z2 = ((ring as f32 + random.next_unit()) / points.len() as f32).max(1e-6);
            (p.normalize_or(Vec2::X) * (1.0 - z2).max(0.0).sqrt()).extend(z2.sqrt())
        };
        points.iter().enumerate().map(place).collect()
    };
    Ok(Pattern::from_directions((0..MEMBERS).map(member).collect(), &PatternOptions::default())?)
}

/// Owen-scrambled Sobol points, one coordinate the area of the disc, the other the azimuth.
fn sobol_polar(rays: u32) -> Result<Pattern> {
    let member = |seed: u32| {
        let place = |i| {
            let square = sobol_2d(i, 0, seed);
            let (sin, cos) = (f64::from(square.y) * TAU).sin_cos();
            let z2 = square.x.max(1e-6);
            (Vec2::new(cos as f32, sin as f32) * (1.0 - z2).sqrt()).extend(z2.sqrt())
        };
        (0..rays).map(place).collect()
    };
    Ok(Pattern::from_directions((0..MEMBERS).map(member).collect(), &PatternOptions::default())?)
}

/// Exact masks by every candidate.
pub fn patterns(options: &Options, output: &mut Output) -> Result<()> {
    Case::each(options, &PATTERN_SCENES, |case| {
        for rays in [32, 64, 256, 1024] {
            let patterns: Vec<Pattern> =
                CANDIDATES.iter().map(|candidate| (candidate.make)(rays)).collect::<Result<_>>()?;
            let mut answers = vec![vec![0.0; case.receivers.len()]; patterns.len()];
            let bvh = case.occluders.flat().expect("one mesh");
            let mask_options = MaskOptions::default().with_radius(case.length());
            let mut runs: Vec<_> = patterns
                .iter()
                .zip(&mut answers)
                .map(|(pattern, ao)| {
                    let (receivers, options) = (&case.receivers, &mask_options);
                    move || {
                        let call = MaskCall::new(bvh, pattern, receivers, options);
                        call.answer(Outputs::new(ao), &mut |_| true).expect("valid arguments");
                    }
                })
                .collect();
            let mut timed: Vec<&mut dyn Timed> = runs.iter_mut().map(|run| run as &mut dyn Timed).collect();
            let times = alternate(sizes(options).2.max(3), &mut timed);
            drop(runs);
            let relaxed = CANDIDATES.iter().position(|c| c.name == "relaxed").expect("it is one");
            for ((candidate, ao), own) in CANDIDATES.iter().zip(&answers).zip(&times) {
                let mut params = case.params("patterns");
                params["rays"] = json!(rays);
                let mut row = case.row(candidate.name, params, ao);
                row.time_s = median(own);
                row.mrays_s = (case.receivers.len() * rays as usize) as f64 / row.time_s * 1e-6;
                (row.baseline, row.speedup) = ("relaxed", paired_speedup(&times[relaxed], own));
                output.row(&row)?;
            }
        }
        Ok(())
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use umbrage_geom::morton;

    #[test]
    fn times_are_interpolated_in_logarithms() {
        let curve = [[0.1, 1.0], [0.01, 100.0]];
        assert!((time_for(&curve, 0.0316228).unwrap() - 10.0).abs() < 1e-3);
        assert_eq!(time_for(&curve, 0.2), None);
    }

    #[test]
    fn points_are_in_morton_order_and_candidates_are_patterns() {
        let mesh = scenes::generated("blob", 500).unwrap();
        let (points, normals) = random_points(&mesh, 100);
        assert_eq!(points.len(), normals.len());
        let order = morton::order(&points);
        assert!(order.iter().enumerate().all(|(i, &k)| i == k as usize));
        for candidate in CANDIDATES {
            assert_eq!((candidate.make)(32).unwrap().len(), 32, "{}", candidate.name);
        }
    }
}
