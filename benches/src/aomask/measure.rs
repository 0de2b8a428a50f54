//! Passes of all methods over one workload, and their rows.

use super::{Case, methods::Tables, picture::Picture, workload::Workload};
use crate::{
    entry::{Entry, OnThreads},
    rows::{Output, Row, Timed, alternate, median, paired_speedup},
};
use anyhow::Result;
use serde_json::{Value, json};
use std::time::Instant;
use umbrage_aomask::{MaskOptions, NodeMasks, Pattern};
use umbrage_geom::Ray;

/// Passes that pick the fastest entry of each method.
const HEATS: usize = 1;

/// A method's fastest entry after its passes.
pub struct Measured<'e, A> {
    pub entry: Box<dyn Entry<A> + 'e>,
    pub times: Vec<f64>,
    pub answers: Vec<A>,
}

/// Rows of all methods against `rays`, and of the mask methods against each peer. `extra` gives more counters by method.
pub fn rows(
    case: &Case,
    workload: &Workload,
    passes: usize,
    output: &mut Output,
    extra: impl Fn(&str) -> Value,
) -> Result<()> {
    let circle = Tables::build(workload, NodeMasks::Circle, &case.one)?;
    let silhouette = Tables::build(workload, NodeMasks::Silhouette, &case.one)?;
    let mut entries = case.ours.any_hit(&workload.rays);
    for tables in [&circle, &silhouette] {
        entries.push(tables.entry(case, workload)?);
    }
    entries.extend(super::exact::entries(case, workload)?);
    entries.extend(case.peers.iter().flat_map(|peer| peer.any_hit(&workload.rays)));
    rows_of(entries, case, workload, passes, output, extra)
}

/// Rows of the fastest of `entries` of each method.
pub fn rows_of(
    entries: Vec<Box<dyn Entry<bool> + '_>>,
    case: &Case,
    workload: &Workload,
    passes: usize,
    output: &mut Output,
    extra: impl Fn(&str) -> Value,
) -> Result<()> {
    let best = of_fastest(entries, passes);
    let of_method = |name: &str| best.iter().find(|m| m.entry.method() == name);
    let rays = of_method("rays").expect("always measured");
    for method in &best {
        let row = row(case, workload, method, rays, &extra);
        output.row(&row)?;
        for peer in &case.peers {
            if let Some(theirs) = of_method(peer.name()).filter(|_| row.method.starts_with("mask")) {
                let mut row = Row { baseline: peer.name(), ..row.clone() };
                row.speedup = paired_speedup(&theirs.times, &method.times);
                row.params["peer_mode"] = json!(theirs.entry.mode());
                output.row(&row)?;
            }
        }
    }
    Ok(())
}

fn row(
    case: &Case,
    workload: &Workload,
    method: &Measured<bool>,
    rays: &Measured<bool>,
    extra: &impl Fn(&str) -> Value,
) -> Row {
    let count = workload.rays.len();
    let per_receiver = workload.pattern.len();
    let name = method.entry.method();
    let mut counters = method.entry.counters();
    counters["triangles"] = json!(case.mesh.triangles.len());
    counters["receivers"] = json!(workload.points.len());
    let different = method.answers.iter().zip(&rays.answers).filter(|(a, b)| a != b).count();
    // The table method is approximate by design; its bits are an error, not a failure.
    counters[if name == "mask-table" { "approximate_bits" } else { "different_bits" }] = json!(different);
    let errors: Vec<f64> =
        ao(&method.answers, per_receiver).zip(ao(&rays.answers, per_receiver)).map(|(a, b)| a - b).collect();
    let mean = |f: fn(f64) -> f64| errors.iter().map(|&e| f(e)).sum::<f64>() / errors.len() as f64;
    counters["mean_abs_error"] = json!(mean(f64::abs));
    counters["mean_ao"] = json!(ao(&rays.answers, per_receiver).sum::<f64>() / errors.len() as f64);
    if let Some(map) = extra(name).as_object() {
        map.iter().for_each(|(key, value)| counters[key] = value.clone());
    }
    let time_s = median(&method.times);
    let mut params = workload.params.clone();
    params["mode"] = json!(method.entry.mode());
    Row {
        suite: "aomask",
        scene: case.name.into(),
        method: name.into(),
        params,
        time_s,
        build_s: method.entry.build_s(),
        mrays_s: count as f64 / time_s * 1e-6,
        rmse: mean(|e| e * e).sqrt(),
        bias: mean(|e| e),
        bytes: method.entry.bytes(),
        counters,
        baseline: "rays",
        speedup: paired_speedup(&rays.times, &method.times),
    }
}

/// Ambient occlusion (1 is open) of each receiver.
fn ao(answers: &[bool], per_receiver: usize) -> impl Iterator<Item = f64> + '_ {
    answers
        .chunks(per_receiver)
        .map(move |rays| rays.iter().filter(|&&blocked| !blocked).count() as f64 / per_receiver as f64)
}

/// Times all entries in turn on this thread.
fn measure<'e, A>(entries: Vec<Box<dyn Entry<A> + 'e>>, passes: usize) -> Vec<Measured<'e, A>> {
    let mut runs: Vec<_> =
        entries.into_iter().map(|entry| OnThreads { entry, pool: None, answers: None }).collect();
    let mut timed: Vec<&mut dyn Timed> = runs.iter_mut().map(|run| run as &mut dyn Timed).collect();
    let times = alternate(passes, &mut timed);
    runs.into_iter()
        .zip(times)
        .map(|(run, times)| Measured { entry: run.entry, times, answers: run.answers.expect("it has run") })
        .collect()
}

/// Passes of the fastest of `entries` of each method.
pub fn of_fastest<A>(entries: Vec<Box<dyn Entry<A> + '_>>, passes: usize) -> Vec<Measured<'_, A>> {
    let best = fastest(measure(entries, HEATS));
    measure(best.into_iter().map(|m| m.entry).collect(), passes)
}

/// The entry with the smallest time of each method, methods in order of their first entry.
fn fastest<A>(measured: Vec<Measured<'_, A>>) -> Vec<Measured<'_, A>> {
    let smallest = |m: &Measured<A>| m.times.iter().copied().fold(f64::INFINITY, f64::min);
    let mut best: Vec<Measured<A>> = Vec::new();
    for m in measured {
        match best.iter_mut().find(|known| known.entry.method() == m.entry.method()) {
            None => best.push(m),
            Some(known) if smallest(&m) < smallest(known) => *known = m,
            Some(_) => {}
        }
    }
    best
}

/// Rays a second of exact single rays from every `stride`-th receiver of a picture, rays made beforehand.
pub fn rays_per_second(
    case: &Case,
    picture: &Picture,
    pattern: &Pattern,
    options: &MaskOptions,
    stride: usize,
) -> f64 {
    let receivers = (0..picture.points.len()).step_by(stride).filter_map(|i| picture.receiver(i, options));
    // About a million rays are enough.
    let most = (1usize << 20).div_ceil(pattern.len());
    let rays: Vec<Ray> =
        receivers.take(most).flat_map(|receiver| pattern.rays_of(&receiver, options.radius)).collect();
    let mut hits = vec![false; rays.len()];
    let start = Instant::now();
    case.ours.bvh().any_hits_with(&rays, &mut hits, &mut ());
    rays.len() as f64 / start.elapsed().as_secs_f64()
}
