//! Passes of all methods over one workload, and their rows.

use super::{Case, fronts, methods::Tables, picture::Picture, workload::Workload};
use crate::{
    entry::{Entry, OnThreads},
    rows::{Output, Row, Timed, alternate, median, paired_speedup},
};
use anyhow::Result;
use serde_json::{Value, json};
use std::time::Instant;
use umbrage_aomask::{MaskOptions, Pattern, Sides, published::NodeMasks};
use umbrage_geom::Ray;

/// Passes that pick the fastest entry of each method.
const CHOOSING_PASSES: usize = 1;

/// A method's fastest entry after its passes.
pub struct Measured<'e, A> {
    pub entry: Box<dyn Entry<A> + 'e>,
    pub times: Vec<f64>,
    pub answers: Vec<A>,
}

/// Rows of all methods against `rays`, which are returned, and of the mask methods against each peer. `extra` gives more
/// counters of a row.
pub fn rows(
    case: &Case,
    workload: &Workload,
    passes: usize,
    output: &mut Output,
    extra: impl Fn(&Row) -> Value,
) -> Result<Vec<Row>> {
    let circle = Tables::build(workload, NodeMasks::Circle, &case.one)?;
    let silhouette = Tables::build(workload, NodeMasks::Silhouette, &case.one)?;
    let (mut entries, theirs) = single_rays(case, workload)?;
    for tables in [&circle, &silhouette] {
        entries.push(tables.entry(case, workload)?);
    }
    entries.extend(super::exact::entries(case, workload)?);
    entries.extend(theirs);
    rows_of(entries, case, workload, passes, output, extra)
}

/// Rows of `mask-table` against our own rays and those of peers, all over the one set of rays that tables have.
pub fn table_rows(case: &Case, workload: &Workload, passes: usize, output: &mut Output) -> Result<()> {
    let circle = Tables::build(workload, NodeMasks::Circle, &case.one)?;
    let silhouette = Tables::build(workload, NodeMasks::Silhouette, &case.one)?;
    let (mut entries, theirs) = single_rays(case, workload)?;
    for tables in [&circle, &silhouette] {
        entries.push(tables.entry(case, workload)?);
    }
    entries.extend(theirs);
    rows_of(entries, case, workload, passes, output, |_| json!({ "rays_of": "tables" })).map(drop)
}

/// Entries that answer rays one by one or as batches, where both sides of triangles block or fronts only.
type Entries<'a> = Vec<Box<dyn Entry<bool> + 'a>>;

/// Our own single rays, and those of peers.
pub fn single_rays<'a>(case: &'a Case, workload: &'a Workload) -> Result<(Entries<'a>, Entries<'a>)> {
    let rays = &workload.rays[..];
    if workload.options.sides == Sides::Both {
        let theirs = case.peers.iter().flat_map(|peer| peer.any_hit(rays)).collect();
        return Ok((case.ours.any_hit(rays), theirs));
    }
    let theirs: Vec<Entries> = case.peers.iter().map(|peer| peer.front_hit(rays)).collect::<Result<_>>()?;
    Ok((fronts::entries(&case.ours, rays), theirs.into_iter().flatten().collect()))
}

/// Rows of the fastest of `entries` of each method.
pub fn rows_of(
    entries: Vec<Box<dyn Entry<bool> + '_>>,
    case: &Case,
    workload: &Workload,
    passes: usize,
    output: &mut Output,
    extra: impl Fn(&Row) -> Value,
) -> Result<Vec<Row>> {
    let best = of_fastest(entries, passes);
    let of_method = |name: &str| best.iter().find(|m| m.entry.method() == name);
    let rays = of_method("rays").expect("always measured");
    let mut rows = Vec::new();
    for method in &best {
        let mut row = row(case, workload, method, rays);
        add_counters(&mut row, &extra);
        output.row(&row)?;
        for peer in &case.peers {
            if let Some(theirs) = of_method(peer.name()).filter(|_| row.method.starts_with("mask")) {
                let mut row = Row { baseline: peer.name(), ..row.clone() };
                row.speedup = paired_speedup(&theirs.times, &method.times);
                row.params["peer_mode"] = json!(theirs.entry.mode());
                output.row(&row)?;
            }
        }
        rows.push(row);
    }
    Ok(rows)
}

fn row(case: &Case, workload: &Workload, method: &Measured<bool>, rays: &Measured<bool>) -> Row {
    let count = workload.rays.len();
    let per_receiver = workload.pattern.len();
    let name = method.entry.method();
    let mut counters = method.entry.counters();
    counters["triangles"] = json!(case.mesh.triangles.len());
    counters["receivers"] = json!(workload.points.len());
    let different = method.answers.iter().zip(&rays.answers).filter(|(a, b)| a != b).count();
    // The table method is approximate by design; its bits are an error, not a failure.
    counters[if name == "mask-table" { "approximate_bits" } else { "different_bits" }] = json!(different);
    let exact: Vec<f64> = ao(&rays.answers, per_receiver).collect();
    let differences: Vec<f64> = ao(&method.answers, per_receiver).zip(&exact).map(|(a, b)| a - b).collect();
    put_differences(&mut counters, &differences);
    counters["mean_ao"] = json!(exact.iter().sum::<f64>() / exact.len() as f64);
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
        rmse: f64::NAN,
        bias: f64::NAN,
        bytes: method.entry.bytes(),
        counters,
        baseline: "rays",
        speedup: paired_speedup(&rays.times, &method.times),
    }
}

/// Puts into counters how far answers are from those of the same rays cast one by one: agreement, not error.
pub fn put_differences(counters: &mut Value, differences: &[f64]) {
    let count = differences.len().max(1) as f64;
    let mean = |f: fn(f64) -> f64| differences.iter().map(|&e| f(e)).sum::<f64>() / count;
    counters["mean_abs_difference_from_rays"] = json!(mean(f64::abs));
    counters["rms_difference_from_rays"] = json!(mean(|e| e * e).sqrt());
    counters["mean_difference_from_rays"] = json!(mean(|e| e));
    counters["receivers_compared"] = json!(differences.len());
}

/// Adds to the counters of a row what `extra` says of it.
pub fn add_counters(row: &mut Row, extra: &impl Fn(&Row) -> Value) {
    let more = extra(row);
    more.as_object().into_iter().flatten().for_each(|(key, value)| row.counters[key] = value.clone());
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
    let best = fastest(measure(entries, CHOOSING_PASSES));
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
    cast(case, &rays, options.sides, &mut hits);
    rays.len() as f64 / start.elapsed().as_secs_f64()
}

/// Casts rays one by one, those of one origin as a batch.
pub fn cast(case: &Case, rays: &[Ray], sides: Sides, hits: &mut [bool]) {
    match sides {
        Sides::Both => case.ours.bvh().any_hits_with(rays, hits, &mut ()),
        Sides::Front | Sides::FrontFirst => fronts::front_hits(case.ours.bvh(), rays, hits),
    }
}
