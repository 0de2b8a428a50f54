//! Suite `volumetric`: opaque cells inside closed meshes, Djeu11, chapters 3 and 4, and solid boxes in wide hierarchies.

mod ambient;
mod instances;
mod methods;
mod pictures;
mod scene;
mod tables;

use self::{
    methods::{Call, Caster, Run, Structures, Tally, kd_casters, of_renderer, wide_casters},
    scene::{Scene, Shadows},
    tables::Tables,
};
use crate::{
    anyhit::measure::{CHOOSING_PASSES, fastest, measure as heats},
    entry::{Entry, OnThreads},
    peer::{self, Peer, PeerName},
    rows::{Output, Row, Timed, alternate, median, note, paired_speedup},
    scenes,
};
use anyhow::{Result, bail};
use serde_json::json;
use std::path::PathBuf;
use umbrage_accel::brute;
use umbrage_geom::Ray;

/// What to run.
#[derive(Clone, Debug)]
pub struct Options {
    /// Smaller meshes, fewer rays and passes.
    pub quick: bool,
    /// Ray casters of others to measure against.
    pub peers: Vec<PeerName>,
    /// Only scenes whose name contains this.
    pub only: Option<String>,
    /// Only one of [`PARTS`].
    pub part: Option<String>,
    /// Where pictures go, if they are wanted.
    pub pictures: Option<PathBuf>,
}

/// Parts of the suite: what walks the wide hierarchy, what walks a kd-tree, and, only when asked for, ambient rays.
const PARTS: [&str; 3] = ["wide", "kd", "ambient"];

/// Closed meshes under area lights; the rest are generators.
const CLOSED_MESHES: [&str; 9] = [
    "bunny_60k",
    "armadillo_86k",
    "dragon_871k",
    "dragonish",
    "knots",
    "spot",
    "rocker_arm",
    "blob",
    "fertility",
];
/// Of these, in the quick form; in the full one, work is counted over their whole images, and timed over a thirty-second part.
const QUICK_MESHES: usize = 3;

/// Width and height of images, and rays to each area light (Djeu11, section 3.7.2).
const SIDE: u32 = 1024;
const PER_LIGHT: u32 = 20;

/// One image's rays under the clock.
pub struct Case<'a> {
    pub scene: &'a Scene,
    pub shadows: &'a Shadows,
    pub structures: &'a Structures,
}

pub fn run(options: &Options, output: &mut Output) -> Result<()> {
    if let Some(part) = options.part.as_ref().filter(|part| !PARTS.contains(&part.as_str())) {
        bail!("unknown part '{part}', expected one of {}", PARTS.join(", "));
    }
    if options.part.as_deref() == Some("ambient") {
        return ambient::rows(options, output);
    }
    let mut tables = Tables::default();
    let wanted = |name: &str| options.only.as_ref().is_none_or(|only| name.contains(only.as_str()));
    for (i, name) in CLOSED_MESHES.into_iter().enumerate() {
        let in_quick = i < QUICK_MESHES || ["dragonish", "knots"].contains(&name);
        if !wanted(name) || (options.quick && !in_quick) {
            continue;
        }
        match scene::closed_mesh(name, options.quick)? {
            Some(mesh) => measure(&scene::single(name, &mesh), options, &mut tables, output)?,
            None => eprintln!("no folder of meshes: {name} is skipped"),
        }
    }
    if let Some(folder) = scenes::mesh_folder() {
        for (name, leaves) in [("36-meshes", 0), ("36-meshes-leaves", 200_000)] {
            if wanted(name) && (!options.quick || leaves == 0) {
                measure(&scene::many(name, &folder, leaves)?, options, &mut tables, output)?;
            }
        }
        if wanted(instances::NAME) && options.part.as_ref().is_none_or(|part| part == "wide") {
            instances::measure(&folder, options, output)?;
        }
    }
    for lights in [1, 17] {
        let name = format!("blob-{lights}-points");
        if wanted(&name) {
            let mesh = scenes::generated("blob", 8_000)?;
            measure(&scene::single_points(&name, &mesh, lights), options, &mut tables, output)?;
        }
    }
    for lights in [1, 17, 26] {
        let name = format!("stage-{lights}-points");
        if wanted(&name) && (!options.quick || lights == 17) {
            let triangles = if options.quick { 100_000 } else { 450_000 };
            measure(&scene::stage(&name, triangles, lights)?, options, &mut tables, output)?;
        }
    }
    tables.print();
    Ok(())
}

/// A peer's fastest way to answer the rays.
type Best<'a> = Box<dyn Entry<bool> + 'a>;

fn best_of<'a>(peer: &'a dyn Peer, rays: &'a [Ray]) -> Option<Best<'a>> {
    let all = fastest(heats(peer.any_hit(rays), CHOOSING_PASSES, None));
    let name = peer.name();
    all.into_iter().map(|m| m.entry).find(|entry| entry.method() == name)
}

/// Rows of one scene.
fn measure(scene: &Scene, options: &Options, tables: &mut Tables, output: &mut Output) -> Result<()> {
    note(&format!("preparing {}", scene.name));
    let count = scene.ray_count(SIDE, PER_LIGHT);
    let fans = count / (f64::from(SIDE) * f64::from(SIDE) * scene.lights.len().max(1) as f64);
    let structures = Structures::build(scene, count, fans)?;
    let step = if options.quick { 128 } else { 32 };
    let part = |part| scene.shadows(&structures.bvh, SIDE, PER_LIGHT, step, part);
    let shadows = part(0);
    let case = Case { scene, shadows: &shadows, structures: &structures };
    let part_wanted = |part: &str| options.part.as_ref().is_none_or(|wanted| wanted == part);
    let occluders = scene.occluders()?;
    let renderer = of_renderer(&occluders)?;
    let mut casters = Vec::new();
    if part_wanted("wide") {
        casters.extend(wide_casters(&structures));
    }
    if part_wanted("kd") {
        casters.extend(kd_casters(&structures, &renderer));
    }
    // Short ones need more passes for a median that means something.
    let passes = (8_000_000 / shadows.rays.len().max(1)).clamp(3, 25);
    let peers: Vec<Box<dyn Peer>> =
        options.peers.iter().map(|&name| peer::open(name, &scene.mesh)).collect::<Result<_>>()?;
    let rivals: Vec<Best> = peers.iter().filter_map(|peer| best_of(peer.as_ref(), &shadows.rays)).collect();
    let modes: Vec<(&str, String)> = rivals.iter().map(|rival| (rival.method(), rival.mode())).collect();
    let (times, answers) = case.time(&casters, rivals, passes);
    let wrong = brute_differences(scene, &shadows, &answers[0]);
    let mut tallies: Vec<(Tally, usize)> = casters.iter().map(|caster| (caster.tally(), 0)).collect();
    let whole = !options.quick
        && options.part.is_none()
        && CLOSED_MESHES[..QUICK_MESHES].contains(&scene.name.as_str());
    for index in 0..if whole { step } else { 1 } {
        let other = (index > 0).then(|| part(index));
        let shadows = other.as_ref().unwrap_or(&shadows);
        for (caster, (tally, rays)) in casters.iter().zip(&mut tallies) {
            if index == 0 || caster.counts_images() {
                caster.count(scene, shadows, tally);
                *rays += shadows.rays.len();
            }
        }
    }
    for (i, caster) in casters.iter().enumerate() {
        let (counted, mut counters) = caster.report(scene, &tallies[i].0, tallies[i].1);
        let differences =
            |other: usize| answers[i].iter().zip(&answers[other]).filter(|(a, b)| a != b).count();
        counters["different_bits"] = json!(differences(0) + wrong);
        let of = |method: &str, call: Call| casters.iter().position(|c| c.method == method && c.call == call);
        // Single rays against single rays, packets against packets.
        let baseline = if caster.method.starts_with("kd") { "kd" } else { "bvh" };
        let against = of(baseline, caster.call).expect("every call has its baseline");
        if let Some(single) = of(&caster.method, Call::Single).filter(|_| caster.call != Call::Single) {
            counters["speedup_over_single"] = json!(paired_speedup(&times[single], &times[i]));
        }
        let time_s = median(&times[i]);
        let row = Row {
            suite: "volumetric",
            scene: scene.name.clone(),
            method: caster.method.clone(),
            params: json!({ "call": caster.call.name(), "rays": shadows.rays.len() }),
            time_s,
            build_s: caster.build_s,
            mrays_s: shadows.rays.len() as f64 / time_s * 1e-6,
            rmse: 0.0,
            bias: 0.0,
            bytes: caster.bytes,
            counters,
            baseline,
            speedup: paired_speedup(&times[against], &times[i]),
        };
        output.row(&row)?;
        for (k, (peer, mode)) in modes.iter().enumerate() {
            let theirs = casters.len() + k;
            let mut row = Row { baseline: peer, ..row.clone() };
            row.speedup = paired_speedup(&times[theirs], &times[i]);
            row.params["peer_mode"] = json!(mode);
            row.counters["different_from_peer"] = json!(differences(theirs));
            output.row(&row)?;
        }
        tables.add(row, counted);
    }
    tables.add_scene(&case, &casters, &answers[0], passes);
    if let Some(folder) = &options.pictures {
        pictures::write(folder, &case)?;
    }
    Ok(())
}

impl Case<'_> {
    /// Times of all casters, and of what peers have, in turn; and their answers.
    pub fn time(
        &self,
        casters: &[Caster],
        rivals: Vec<Best>,
        passes: usize,
    ) -> (Vec<Vec<f64>>, Vec<Vec<bool>>) {
        let hits = vec![false; self.shadows.rays.len()];
        let (scene, shadows) = (self.scene, self.shadows);
        let mut runs: Vec<Run> =
            casters.iter().map(|caster| Run { caster, scene, shadows, hits: hits.clone() }).collect();
        let mut others: Vec<_> =
            rivals.into_iter().map(|entry| OnThreads { entry, pool: None, answers: None }).collect();
        let own = runs.iter_mut().map(|run| run as &mut dyn Timed);
        let mut timed: Vec<&mut dyn Timed> =
            own.chain(others.iter_mut().map(|other| other as &mut dyn Timed)).collect();
        let times = alternate(passes, &mut timed);
        let theirs = others.into_iter().map(|other| other.answers.unwrap_or_default());
        (times, runs.into_iter().map(|run| run.hits).chain(theirs).collect())
    }
}

/// Wrong answers among as many rays as 20 million triangle tests allow.
fn brute_differences(scene: &Scene, shadows: &Shadows, answers: &[bool]) -> usize {
    let (positions, triangles) = (&scene.mesh.positions, &scene.mesh.triangles);
    let count = (20_000_000 / triangles.len()).clamp(1, shadows.rays.len());
    let step = shadows.rays.len() / count;
    (0..count)
        .filter(|i| brute::any_hit(positions, triangles, &shadows.rays[i * step]) != answers[i * step])
        .count()
}
