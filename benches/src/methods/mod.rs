//! Suite `methods`: every method of `umbrage-query`, as `render` and `bake` call it, on an opaque mesh, on semi-transparent foliage and
//! on instances that are kept apart.
//!
//! Rows come from [`ShadowMethod::ALL`] and [`AoMethod::ALL`], so that a new method has its rows without being named here. Methods
//! that can't do a scene are named with the reason.

mod scenes;

use crate::rows::{Output, Row, Timed, alternate, median, note, paired_speedup};
use anyhow::Result;
use rayon::prelude::*;
use scenes::Case;
use serde_json::json;
use std::time::Instant;
use umbrage_aomask::{Outputs, Pattern, PatternOptions, Receiver};
use umbrage_geom::sampling::combine;
use umbrage_query::{
    Answers, AoMethod, Engine, Exactness, LightRay, Occluders, QueryError, ShadowMethod, Sky, engine,
};

/// What to run.
pub struct Options {
    pub quick: bool,
    pub only: Option<String>,
}

/// Rays of a receiver, to a light or into the sky.
const RAYS: u32 = 64;

/// A method that answers all receivers of a case.
struct MethodRun<'a> {
    name: &'static str,
    exactness: Exactness,
    engine: Box<dyn Engine + 'a>,
    build_s: f64,
    /// Of what was made for it beside the wide BVH.
    bytes: usize,
    work: Workload<'a>,
    /// By receiver: mean of what passes.
    open: Vec<f32>,
    failed: Option<QueryError>,
}

/// What a method is asked.
#[derive(Clone, Copy)]
enum Workload<'a> {
    /// [`RAYS`] rays a receiver, to the light or the sky.
    Rays(&'a [LightRay], Option<usize>),
    Receivers(&'a [Receiver]),
}

impl MethodRun<'_> {
    fn answer(&mut self) -> Result<(), QueryError> {
        let engine = &*self.engine;
        match self.work {
            Workload::Receivers(receivers) => {
                engine.sky(receivers, Outputs::new(&mut self.open), &mut |_| true)?;
            }
            Workload::Rays(rays, light) => {
                let rays = rays.chunks(RAYS as usize);
                self.open = rays
                    .map(|rays| {
                        let mut passed = [1.0; RAYS as usize];
                        engine.transmittances(rays, light, &mut passed, None)?;
                        Ok(passed.iter().map(|&x| f64::from(x)).sum::<f64>() as f32 / RAYS as f32)
                    })
                    .collect::<Result<_, QueryError>>()?;
            }
        }
        Ok(())
    }
}

impl Timed for MethodRun<'_> {
    fn run(&mut self) {
        if let Err(error) = self.answer() {
            self.failed = Some(error);
        }
    }
}

pub fn run(options: &Options, output: &mut Output) -> Result<()> {
    let one = rayon::ThreadPoolBuilder::new().num_threads(1).build()?;
    for (name, scene) in scenes::all(options.quick)? {
        if options.only.as_ref().is_some_and(|only| !name.contains(only.as_str())) {
            continue;
        }
        note(&format!("preparing {name}"));
        let case = Case::new(&scene, if options.quick { 2_000 } else { 20_000 })?;
        one.install(|| measure(name, &case, options, output))?;
    }
    Ok(())
}

fn measure(scene: &str, case: &Case, options: &Options, output: &mut Output) -> Result<()> {
    let occluders = &case.occluders;
    let rays = case.shadow_rays(RAYS);
    let mut asked = Vec::new();
    for &method in ShadowMethod::ALL {
        let work = Workload::Rays(&rays, Some(0));
        let make = || engine::shadows(method, occluders, &mut |_| true);
        asked.extend(ask((scene, occluders), method.name(), method.exactness(), make, |_| work)?);
    }
    measure_all(scene, "shadows", &mut asked, options, output)?;
    let sky = Sky::new(PatternOptions::default().with_rays(RAYS), 0.1 * occluders.diagonal());
    let pattern = Pattern::new(&sky.pattern)?;
    let (receivers, rays) = case.sky(&pattern, sky.radius)?;
    let mut asked = Vec::new();
    for &method in AoMethod::ALL {
        let work = |engine: &dyn Engine| match engine.answers() {
            Answers::Rays => Workload::Rays(&rays, None),
            Answers::Receivers | Answers::Images => Workload::Receivers(&receivers),
        };
        let make = || engine::sky(method, occluders, &sky, &mut |_| true);
        asked.extend(ask((scene, occluders), method.name(), method.exactness(), make, work)?);
    }
    measure_all(scene, "ao", &mut asked, options, output)
}

/// Makes a method ready; `None`, with a line that says why, if it can't do the scene.
fn ask<'a>(
    (scene, occluders): (&str, &Occluders),
    name: &'static str,
    exactness: Exactness,
    make: impl FnOnce() -> Result<Box<dyn Engine + 'a>, QueryError>,
    work: impl FnOnce(&dyn Engine) -> Workload<'a>,
) -> Result<Option<MethodRun<'a>>> {
    let (start, before) = (Instant::now(), held(occluders));
    match make() {
        Ok(engine) => {
            let (build_s, work) = (start.elapsed().as_secs_f64(), work(&*engine));
            let bytes = held(occluders) - before;
            let count = match work {
                Workload::Rays(rays, _) => rays.len() / RAYS as usize,
                Workload::Receivers(receivers) => receivers.len(),
            };
            let open = vec![1.0; count];
            Ok(Some(MethodRun { name, exactness, engine, build_s, bytes, work, open, failed: None }))
        }
        Err(QueryError::Unsupported { reason, .. }) => {
            println!("{scene:<12} {name:<13} no row: {reason}");
            Ok(None)
        }
        Err(other) => Err(other.into()),
    }
}

/// Times all methods in turn; the first is the exact baseline.
fn measure_all(
    scene: &str,
    work: &str,
    asked: &mut [MethodRun<'_>],
    options: &Options,
    output: &mut Output,
) -> Result<()> {
    let passes = if options.quick { 3 } else { 9 };
    let mut timed: Vec<&mut dyn Timed> = asked.iter_mut().map(|asked| asked as &mut dyn Timed).collect();
    let times = alternate(passes, &mut timed);
    for asked in asked.iter_mut() {
        if let Some(error) = asked.failed.take() {
            return Err(error.into());
        }
    }
    let Some(baseline) = asked.first() else { return Ok(()) };
    let count = baseline.open.len();
    for (asked, own) in asked.iter().zip(&times) {
        let differences = || asked.open.iter().zip(&baseline.open).map(|(a, b)| f64::from(a - b));
        let different = asked.open.iter().zip(&baseline.open).filter(|(a, b)| a != b).count();
        let time_s = median(own);
        let mut counters = json!({
            "different_receivers": different,
            "mean_difference": differences().sum::<f64>() / count as f64,
            "rms_difference": (differences().map(|e| e * e).sum::<f64>() / count as f64).sqrt(),
        });
        if asked.exactness == Exactness::Exact {
            counters["different_bits"] = json!(different);
        }
        output.row(&Row {
            suite: "methods",
            scene: scene.into(),
            method: asked.name.into(),
            params: json!({ "work": work, "rays": RAYS, "receivers": count }),
            time_s,
            build_s: asked.build_s,
            mrays_s: (count * RAYS as usize) as f64 / time_s * 1e-6,
            rmse: f64::NAN,
            bias: f64::NAN,
            bytes: asked.bytes,
            counters,
            baseline: baseline.name,
            speedup: paired_speedup(&times[0], own),
        })?;
    }
    Ok(())
}

impl Case {
    /// Receivers of the sky, and their rays as single ones.
    fn sky(&self, pattern: &Pattern, radius: f32) -> Result<(Vec<Receiver>, Vec<LightRay>)> {
        let receivers = self
            .places
            .par_iter()
            .enumerate()
            .map(|(i, &(point, normal))| {
                Receiver::new(i, point.to_array(), normal.to_array(), combine(i as u32, 1))
            })
            .collect::<Result<Vec<_>, _>>()?;
        let rays = receivers.iter().flat_map(|receiver| {
            let directions = pattern.directions(pattern.member_of(receiver));
            let rays = pattern.rays_of(receiver, radius).zip(directions);
            rays.map(|(ray, &d)| LightRay::new(ray, pattern.solid_angle(d)))
        });
        let rays = rays.collect();
        Ok((receivers, rays))
    }
}

/// Bytes of all structures that were made so far.
fn held(occluders: &Occluders) -> usize {
    occluders.structures().into_iter().filter_map(|(_, made)| made?.bytes).sum()
}
