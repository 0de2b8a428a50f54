//! Suite `stability`: geometry and rays on which floating-point ray casters fail.
//!
//! Every scene is shot at with rays of several aims (`rays.rs`): at vertices, edges and fans, along surfaces and axes, with
//! denormal directions, from exactly on the surface. `leaks` are rays from inside a closed surface that hit nothing;
//! `self_shadow`, rays that hit the convex surface they left (the triangle they left where the mesh isn't exactly convex);
//! `disagreements`, differences from exact integer arithmetic on a sample: rays as a whole plus, for methods with a test of
//! one triangle, that test. `different_bits` compares the hierarchy with a loop over all triangles, `miscounted` the count of
//! crossings with the winding number (Moeller-Trumbore: its parity). All must be 0 for `umbrage`.
//!
//! The truth is Umbrage's definition: open segment, closed triangle. A peer that counts a hit at the very start of a segment
//! has it in `self_shadow` and `disagreements` for rays that start exactly on a surface (aims `outward`, `passing`).
//!
//! Times are processor seconds of one pass, one ray after the other, ray generation left out. Methods run in turn, not
//! alternately, and Moeller-Trumbore is a loop over all triangles on fewer rays; `speedup` compares rays per second with
//! those of `umbrage` (baseline `bvh`, its hierarchy). It says what a row cost; speed is suite `anyhit`'s subject.

mod casters;
mod check;
mod oracle;
mod rays;
mod scenes;

use crate::{
    peer::{self, PeerName},
    rows::{Output, Row, note},
};
use anyhow::{Result, ensure};
use casters::{Caster, MoellerTrumbore, Other, Umbrage};
use check::{Counts, Sample, Threading};
use oracle::Oracle;
use rays::{Aim, Target};
use serde_json::json;

/// How much work goes into each scene.
struct Effort {
    /// Rays of a method with a hierarchy.
    rays: usize,
    /// Triangle tests of a method without.
    brute_tests: usize,
    /// Points inside that rays start from.
    origins: usize,
    /// Most rays answered exactly, and most triangle tests for that.
    sample: usize,
    sample_tests: usize,
}

const QUICK: Effort =
    Effort { rays: 40_000, brute_tests: 60_000_000, origins: 200, sample: 1500, sample_tests: 6_000_000 };

const FULL: Effort = Effort {
    rays: 3_000_000,
    brute_tests: 200_000_000,
    origins: 2000,
    sample: 20_000,
    sample_tests: 80_000_000,
};

/// What to run.
pub struct Options {
    /// Fewer rays, smaller meshes.
    pub quick: bool,
    /// Methods of others.
    pub peers: Vec<PeerName>,
    /// Only scenes whose name contains this.
    pub only: Option<String>,
}

/// Runs the suite.
///
/// # Errors
/// If a mesh can't be read or a row not written, and at the end if any row of `umbrage` isn't all zeros.
pub fn run(options: &Options, output: &mut Output) -> Result<()> {
    let effort = if options.quick { &QUICK } else { &FULL };
    let mut summary = Vec::new();
    for scene in scenes::all(options.quick)? {
        if options.only.as_ref().is_some_and(|only| !scene.name.contains(only)) {
            continue;
        }
        note(&format!("{} {}", scene.name, scene.case));
        summary.extend(run_scene(&scene, effort, &options.peers, output)?);
    }
    print_summary(&summary);
    let faults: usize = summary.iter().filter(|line| line.method == "umbrage").map(Line::faults).sum();
    ensure!(faults == 0, "umbrage has {faults} wrong answers, see above");
    Ok(())
}

fn run_scene(
    scene: &scenes::Scene,
    effort: &Effort,
    peers: &[PeerName],
    output: &mut Output,
) -> Result<Vec<Line>> {
    let oracle = Oracle::new(&scene.mesh);
    let small = scene.mesh.triangles.len() <= 2000;
    let target = Target::new(&oracle, scene.lattice, small && oracle.is_convex(), effort.origins);
    let umbrage = Umbrage::new(&scene.mesh)?;
    let plain = MoellerTrumbore { mesh: &scene.mesh };
    let opened = peers.iter().map(|&name| peer::open(name, &scene.mesh)).collect::<Result<Vec<_>>>()?;
    let others: Vec<_> = opened.iter().flat_map(|peer| Other::all(peer.as_ref())).collect();
    let mut casters = vec![Threading::Any(&umbrage), Threading::Any(&plain)];
    casters.extend(others.iter().map(|other| Threading::One(other)));
    let triangles = scene.mesh.triangles.len();
    let answered = check::answer(&target, &oracle, effort.sample.min(effort.sample_tests / triangles));
    let mut lines = Vec::new();
    let mut umbrage_rate = None;
    for method in &casters {
        let caster = method.caster();
        let sample = check::compare(method, &answered);
        let brute = caster.bytes() == 0;
        let rays = if brute { effort.rays.min(effort.brute_tests / triangles) } else { effort.rays };
        let counts = check::shoot_many(&target, method, rays);
        let rate = counts.rays as f64 / counts.seconds;
        let speedup = rate / *umbrage_rate.get_or_insert(rate);
        output.row(&row(scene, &target, caster, &counts, &sample, speedup))?;
        lines.push(Line { scene: scene.name, case: scene.case, method: caster.name(), counts, sample });
    }
    Ok(lines)
}

fn row(
    scene: &scenes::Scene,
    target: &Target,
    caster: &dyn Caster,
    counts: &Counts,
    sample: &Sample,
    speedup: f64,
) -> Row {
    let share = |n: f64| n / sample.rays as f64;
    let (false_hits, false_misses) = (sample.false_hits as f64, sample.false_misses as f64);
    Row {
        suite: "stability",
        scene: scene.name.into(),
        method: caster.name().into(),
        params: json!({ "case": scene.case, "rays": counts.rays, "threads": 1 }),
        time_s: counts.seconds,
        build_s: caster.build_s(),
        mrays_s: counts.rays as f64 / counts.seconds * 1e-6,
        rmse: share(false_hits + false_misses).sqrt(),
        bias: share(false_hits - false_misses),
        bytes: caster.bytes(),
        counters: check::counters(target, counts, sample),
        baseline: "bvh",
        speedup,
    }
}

/// A line of the summary.
struct Line {
    scene: &'static str,
    case: &'static str,
    method: &'static str,
    counts: Counts,
    sample: Sample,
}

impl Line {
    /// What should be 0.
    fn faults(&self) -> usize {
        let Sample { miscounted, brute_differences, .. } = self.sample;
        self.counts.leak_count()
            + self.counts.self_shadow
            + self.sample.disagreements()
            + miscounted.unwrap_or(0)
            + brute_differences.unwrap_or(0)
    }
}

fn print_summary(lines: &[Line]) {
    println!(
        "\n{:<13} {:<13} {:<16} {:>9} {:>7} {:>8} {:>11} {:>6} {:>6} {:>11} {:>8} {:>9}",
        "scene",
        "case",
        "method",
        "rays",
        "leaks",
        "denormal",
        "self-shadow",
        "wrong",
        "of",
        "wrong pairs",
        "of",
        "miscounts"
    );
    let shown = |n: Option<usize>| n.map_or("-".into(), |n| n.to_string());
    for Line { scene, case, method, counts, sample } in lines {
        // Apart, since a method that knows no denormal numbers misses with all of them.
        let denormal = counts.leaks.get(Aim::Denormal.name()).copied();
        println!(
            "{scene:<13} {case:<13} {method:<16} {:>9} {:>7} {:>8} {:>11} {:>6} {:>6} {:>11} {:>8} {:>9}",
            counts.rays,
            counts.leak_count() - denormal.unwrap_or(0),
            shown(denormal),
            shown((counts.leaving > 0).then_some(counts.self_shadow)),
            sample.false_hits + sample.false_misses,
            sample.rays,
            shown(sample.wrong_pairs),
            sample.pairs,
            shown(sample.miscounted),
        );
    }
}
