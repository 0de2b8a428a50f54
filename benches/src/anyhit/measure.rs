//! One workload: passes of all entry points in turn, checks of their answers, rows.

use super::workloads::{Case, Workload};
use crate::{
    entry::{Answer, Entry, OnThreads},
    peer::Peer,
    rows::{Output, Row, Timed, alternate, median, paired_speedup},
};
use anyhow::Result;
use rayon::{ThreadPool, prelude::*};
use serde_json::{Value, json};

/// Triangle tests by brute force that a workload may spend on checking answers.
const BRUTE_TESTS: usize = 20_000_000;
/// Triangle tests by brute force that a row may spend on rays where a peer answers differently.
const PEER_TESTS: usize = 200_000_000;

/// What entries are measured on.
pub struct Setting<'a> {
    pub case: &'a Case,
    pub workload: &'a Workload,
    pub peers: &'a [Box<dyn Peer>],
    /// Time of our quick build, seconds.
    pub fast_build_s: f64,
    pub passes: usize,
    /// Threads for a second set of rows.
    pub pool: Option<&'a ThreadPool>,
}

/// Passes over all entries that pick the fastest of each method.
pub const CHOOSING_PASSES: usize = 2;

/// An entry after its passes.
pub struct Measured<'e, A> {
    pub entry: Box<dyn Entry<A> + 'e>,
    times: Vec<f64>,
    answers: Vec<A>,
    /// Most answers in which another entry of the method differs.
    spread: usize,
}

/// Exact answers of every `step`-th ray.
struct Truth<A> {
    step: usize,
    answers: Vec<A>,
}

impl Setting<'_> {
    /// Rows on one thread, then those on several: `bvh` and the peers, each by its fastest entry on one thread.
    pub fn run<A: Answer>(&self, entries: Vec<Box<dyn Entry<A> + '_>>, output: &mut Output) -> Result<()> {
        let truth = self.truth();
        let best = fastest(measure(entries, CHOOSING_PASSES, None));
        let best = self.again(best, None);
        self.rows(&best, &truth, 1, output)?;
        if let Some(pool) = self.pool {
            let contends = |name: &str| name == "bvh" || self.peers.iter().any(|peer| peer.name() == name);
            let best = best.into_iter().filter(|m| contends(m.entry.method())).collect();
            self.rows(&self.again(best, Some(pool)), &truth, pool.current_num_threads(), output)?;
        }
        Ok(())
    }

    /// The passes that count.
    fn again<'e, A: Answer>(
        &self,
        best: Vec<Measured<'e, A>>,
        pool: Option<&ThreadPool>,
    ) -> Vec<Measured<'e, A>> {
        let (entries, spreads): (Vec<_>, Vec<_>) = best.into_iter().map(|m| (m.entry, m.spread)).unzip();
        let with_spreads = measure(entries, self.passes, pool).into_iter().zip(spreads);
        with_spreads.map(|(m, spread)| Measured { spread, ..m }).collect()
    }

    fn truth<A: Answer>(&self) -> Truth<A> {
        let rays = &self.workload.rays;
        let checked = (BRUTE_TESTS / self.case.mesh.triangles.len()).clamp(4, rays.len());
        let step = rays.len().div_ceil(checked);
        let answers = rays.par_iter().step_by(step).map(|ray| A::brute(&self.case.mesh, ray)).collect();
        Truth { step, answers }
    }

    /// A row for each method against `bvh`, and one for `bvh` against each peer.
    fn rows<A: Answer>(
        &self,
        best: &[Measured<A>],
        truth: &Truth<A>,
        threads: usize,
        output: &mut Output,
    ) -> Result<()> {
        let of_method = |name: &str| best.iter().find(|m| m.entry.method() == name);
        let bvh = of_method("bvh").expect("it is always measured");
        for method in best {
            let row = self.row(method, bvh, truth, threads);
            let peers = self.peers.iter().filter(|_| method.entry.method() == "bvh");
            let against: Vec<Row> = peers
                .filter_map(|peer| Some(self.against(&row, bvh, peer.as_ref(), of_method(peer.name())?)))
                .collect();
            output.row(&row)?;
            against.iter().try_for_each(|row| output.row(row))?;
        }
        Ok(())
    }

    fn row<A: Answer>(
        &self,
        method: &Measured<A>,
        baseline: &Measured<A>,
        truth: &Truth<A>,
        threads: usize,
    ) -> Row {
        let rays = self.workload.rays.len();
        let against_brute =
            method.answers.iter().step_by(truth.step).zip(&truth.answers).filter(|(a, b)| a != b);
        let against_baseline = method.answers.iter().zip(&baseline.answers).filter(|(a, b)| a != b);
        let occlusion = |m: &Measured<A>| m.answers.iter().map(|a| a.occlusion()).sum::<f64>() / rays as f64;
        let squares = against_baseline
            .clone()
            .chain(against_brute.clone())
            .fold(0.0, |sum, (a, b)| sum + (a.occlusion() - b.occlusion()).powi(2));
        let mut counters = method.entry.counters();
        counters["triangles"] = json!(self.case.mesh.triangles.len());
        counters["hits"] = json!(method.answers.iter().filter(|a| a.occlusion() > 0.0).count());
        counters["brute_checked"] = json!(truth.answers.len());
        counters["different_bits"] =
            json!(against_brute.count().max(against_baseline.count()).max(method.spread));
        let time_s = median(&method.times);
        let mut params = self.workload.params.clone();
        params["rays"] = json!(rays);
        params["threads"] = json!(threads);
        params["mode"] = json!(method.entry.mode());
        Row {
            suite: "anyhit",
            scene: self.case.name.clone(),
            method: method.entry.method().into(),
            params,
            time_s,
            build_s: method.entry.build_s(),
            mrays_s: rays as f64 / time_s * 1e-6,
            rmse: (squares / rays as f64).sqrt(),
            bias: occlusion(method) - occlusion(baseline),
            bytes: method.entry.bytes(),
            counters,
            baseline: "bvh",
            speedup: paired_speedup(&baseline.times, &method.times),
        }
    }

    /// The row of `bvh`, now against `peer`.
    fn against<A: Answer>(&self, row: &Row, bvh: &Measured<A>, peer: &dyn Peer, theirs: &Measured<A>) -> Row {
        let mut row = Row { baseline: peer.name(), ..row.clone() };
        row.speedup = paired_speedup(&theirs.times, &bvh.times);
        row.params["peer_mode"] = json!(theirs.entry.mode());
        let builds = peer.builds();
        for (key, value) in [
            ("build_s", json!(row.build_s)),
            ("fast_build_s", json!(self.fast_build_s)),
            ("bytes", json!(row.bytes)),
            ("peer_build_high_s", json!(builds.high_s)),
            ("peer_build_medium_s", json!(builds.medium_s)),
            ("peer_bytes", json!(builds.high_bytes)),
            ("peer_bytes_medium", json!(builds.medium_bytes)),
        ] {
            row.counters[key] = value;
        }
        self.explain(&bvh.answers, &theirs.answers, &mut row.counters);
        row
    }

    /// Counts rays answered differently and, by brute force on as many as affordable, who is wrong about them.
    fn explain<A: Answer>(&self, ours: &[A], theirs: &[A], counters: &mut Value) {
        let different: Vec<usize> = (0..ours.len()).filter(|&i| ours[i] != theirs[i]).collect();
        let affordable = (PEER_TESTS / self.case.mesh.triangles.len()).max(8);
        let step = different.len().div_ceil(affordable).max(1);
        let checked: Vec<usize> = different.iter().copied().step_by(step).collect();
        let wrong: Vec<[bool; 2]> = checked
            .par_iter()
            .map(|&i| {
                let truth = A::brute(&self.case.mesh, &self.workload.rays[i]);
                [ours[i] != truth, theirs[i] != truth]
            })
            .collect();
        counters["different_from_peer"] = json!(different.len());
        counters["peer_checked"] = json!(checked.len());
        counters["peer_wrong"] = json!(wrong.iter().filter(|wrong| wrong[1]).count());
        let own_wrong = wrong.iter().filter(|wrong| wrong[0]).count() as u64;
        counters["different_bits"] = json!(counters["different_bits"].as_u64().unwrap_or(0) + own_wrong);
    }
}

/// Times all entries in turn.
pub fn measure<'e, A: Answer>(
    entries: Vec<Box<dyn Entry<A> + 'e>>,
    passes: usize,
    pool: Option<&ThreadPool>,
) -> Vec<Measured<'e, A>> {
    let mut runs: Vec<_> =
        entries.into_iter().map(|entry| OnThreads { entry, pool, answers: None }).collect();
    let mut timed: Vec<&mut dyn Timed> = runs.iter_mut().map(|run| run as &mut dyn Timed).collect();
    let times = alternate(passes, &mut timed);
    let all = runs.into_iter().zip(times);
    all.map(|(run, times)| {
        let answers = run.answers.expect("it has run");
        Measured { entry: run.entry, times, answers, spread: 0 }
    })
    .collect()
}

/// The entry with the smallest time of each method, methods in order of their first entry.
pub fn fastest<A: Answer>(measured: Vec<Measured<A>>) -> Vec<Measured<A>> {
    let smallest = |m: &Measured<A>| m.times.iter().copied().fold(f64::INFINITY, f64::min);
    let mut best: Vec<Measured<A>> = Vec::new();
    for mut m in measured {
        let Some(known) = best.iter_mut().find(|known| known.entry.method() == m.entry.method()) else {
            best.push(m);
            continue;
        };
        let different = m.answers.iter().zip(&known.answers).filter(|(a, b)| a != b).count();
        let spread = different.max(known.spread);
        if smallest(&m) < smallest(known) {
            std::mem::swap(&mut m, known);
        }
        known.spread = spread;
    }
    best
}
