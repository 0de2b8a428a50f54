//! Suite `aomask`: ambient occlusion, all rays of a receiver at once, against single rays and peers.
//!
//! Here: which scenes, radii and numbers of rays; parts under the names of `[Laine10]` (`table1`, ..) and `targets`, the grid
//! that this project's own targets refer to. Not here: receivers and rays (`workload.rs`), the methods (`methods.rs`), rows
//! (`measure.rs`).

mod bits;
mod camera;
mod exact;
mod fans;
mod far_bounds;
mod figures;
mod fronts;
mod measure;
mod methods;
mod picture;
mod prefilter;
mod truth;
mod workload;

use crate::{
    anyhit::ours::Ours,
    peer::{self, Peer, PeerName},
    rows::{Output, note},
    scenes,
};
use anyhow::{Result, bail};
use picture::Picture;
use rayon::{ThreadPool, ThreadPoolBuilder};
use serde_json::{Value, json};
use std::path::PathBuf;
use umbrage_accel::BuildQuality;
use umbrage_aomask::{Pattern, PatternOptions, Points, Sides};
use umbrage_geom::TriangleMesh;
use workload::{Source, Workload};

/// What to run.
#[derive(Clone, Debug)]
pub struct Options {
    /// Smaller meshes, fewer rays and passes.
    pub quick: bool,
    pub peers: Vec<PeerName>,
    /// Only scenes whose name contains this.
    pub only: Option<String>,
    /// Only this part.
    pub part: Option<String>,
    /// Where to write the pictures of figures 5 and 7.
    pub images: Option<PathBuf>,
    /// Where to write the plots of figure 6.
    pub plots: Option<PathBuf>,
}

/// Parts of the suite.
pub const PARTS: [&str; 14] = [
    "truth",
    "target-error",
    "patterns",
    "targets",
    "mask",
    "fans",
    "prefilter",
    "far-bounds",
    "bits",
    "table1",
    "table2",
    "figure5",
    "figure6",
    "figure7",
];

/// A part with scenes of its own.
type Run = fn(&Options, &mut Output) -> Result<()>;

/// Parts with scenes of their own, only when asked for.
const OF_TRUTH: [(&str, Run); 3] =
    [("truth", truth::truth), ("target-error", truth::target_error), ("patterns", truth::patterns)];

/// Numbers of rays and radii, as fractions of the diagonal, of the targets.
const TARGET_RAYS: [u32; 3] = [128, 256, 1024];
const TARGET_RADII: [f64; 3] = [0.01, 0.03, 0.1];
const TARGET_SCENES: [&str; 7] = ["bunny", "armadillo", "dragon", "sibenik", "city", "bush", "hairball"];

/// A scene of table 1.
struct Table1 {
    scene: &'static str,
    /// World units in sibenik, fractions of the diagonal elsewhere, where the paper's units are unknown.
    radii: [f64; 2],
    /// The paper's million rays a second on a GeForce GTX 480, by radius, 128 or 1024 rays, and [`TABLE1_METHODS`].
    mrays_s: [[[f64; 3]; 2]; 2],
}

const TABLE1: [Table1; 3] = [
    Table1 {
        scene: "sibenik",
        radii: [0.75, 2.25],
        mrays_s: [
            [[1874.0, 2251.0, 323.0], [2149.0, 2498.0, 323.0]],
            [[323.0, 649.0, 261.0], [328.0, 585.0, 260.0]],
        ],
    },
    Table1 {
        scene: "city",
        radii: [0.01, 0.03],
        mrays_s: [
            [[670.0, 3007.0, 272.0], [2076.0, 4181.0, 273.0]],
            [[339.0, 1285.0, 241.0], [493.0, 1467.0, 242.0]],
        ],
    },
    Table1 {
        scene: "hairball",
        radii: [0.01, 0.03],
        mrays_s: [[[128.0, 795.0, 52.0], [112.0, 1320.0, 43.0]], [[32.0, 145.0, 27.0], [36.0, 156.0, 23.0]]],
    },
];
/// Which sides of triangles block, the published ones first, and what rows call them.
const SIDES: [(Sides, &str); 2] = [(Sides::Front, "front"), (Sides::Both, "both")];
/// Order of methods in [`Table1::mrays_s`].
const TABLE1_METHODS: [&str; 3] = ["mask-raster", "mask-table", "rays"];

/// A scene with everything built on it.
pub struct Case {
    pub name: &'static str,
    pub mesh: TriangleMesh,
    pub ours: Ours,
    pub peers: Vec<Box<dyn Peer>>,
    /// Time to build [`Self::ours`] and the peers is measured on this one thread, and so is everything else.
    pub one: ThreadPool,
}

/// Runs the suite.
pub fn run(options: &Options, output: &mut Output) -> Result<()> {
    if let Some(part) = options.part.as_ref().filter(|part| !PARTS.contains(&part.as_str())) {
        bail!("unknown part '{part}', expected one of {}", PARTS.join(", "));
    }
    if let Some((_, run)) = OF_TRUTH.into_iter().find(|(part, _)| options.part.as_deref() == Some(part)) {
        run(options, output)?;
        return output.geomeans(&["part", "rays", "radius", "target", "target_rmse", "against"]);
    }
    // Scenes of its own too.
    if options.part.as_deref() == Some("far-bounds") {
        return far_bounds::rows(options, output);
    }
    let wanted = |part: &str| options.part.as_ref().is_none_or(|p| p == part);
    for name in TARGET_SCENES {
        if !options.only.as_ref().is_none_or(|only| name.contains(only.as_str())) {
            continue;
        }
        let Some(source) = Source::find(name, options.quick) else { continue };
        note(&format!("preparing {name}"));
        let case = Case::build(name, source, &options.peers)?;
        if wanted("targets") {
            targets(&case, options, output)?;
        }
        // The rows of `mask` in `targets` once more: only when asked for.
        if options.part.as_deref() == Some("mask") {
            exact(&case, options, output)?;
        }
        if wanted("fans") {
            fans::rows(&case, options, output)?;
        }
        if wanted("prefilter") {
            prefilter::rows(&case, options, output)?;
        }
        if options.part.as_deref() == Some("bits") {
            bits::rows(&case, options, output)?;
        }
        if wanted("table1") {
            table1(&case, options, output)?;
        }
        for (part, run) in figures::PARTS {
            if wanted(part) {
                run(&case, options, output)?;
            }
        }
    }
    output.geomeans(&["part", "rays", "alpha", "sides"])
}

impl Case {
    fn build(name: &'static str, source: Source, peers: &[PeerName]) -> Result<Self> {
        let mesh = source.load()?;
        let one = ThreadPoolBuilder::new().num_threads(1).build()?;
        let ours = one.install(|| Ours::build("rays", &mesh, BuildQuality::High, false))?;
        let peers = peers.iter().map(|&name| peer::open(name, &mesh)).collect::<Result<_>>()?;
        Ok(Self { name, mesh, ours, peers, one })
    }
}

/// The rays that all methods of tables have, and with them those that they are compared with.
fn table_pattern(rays: u32) -> Result<Pattern> {
    Ok(Pattern::new(&PatternOptions::default().with_points(Points::Middles).with_rays(rays))?)
}

/// The grid of the targets.
fn targets(case: &Case, options: &Options, output: &mut Output) -> Result<()> {
    let diagonal = f64::from(case.mesh.bounds().diagonal());
    for rays in TARGET_RAYS {
        let pattern = Pattern::new(&PatternOptions::default().with_rays(rays))?;
        for radius in TARGET_RADII {
            let params = json!({ "part": "targets", "rays": rays, "radius": radius });
            let points = workload::surface(&case.mesh, rays, options.quick);
            let length = (radius * diagonal) as f32;
            let workload = Workload::new(points.clone(), &pattern, length, params.clone());
            exact::rows(case, &workload, passes(options), output)?;
            // Tables have one set of rays for all receivers.
            let workload = Workload::new(points, &table_pattern(rays)?, length, params);
            measure::table_rows(case, &workload, passes(options), output)?;
        }
    }
    Ok(())
}

/// The grid of the targets with method `mask` alone.
fn exact(case: &Case, options: &Options, output: &mut Output) -> Result<()> {
    let diagonal = f64::from(case.mesh.bounds().diagonal());
    for rays in TARGET_RAYS {
        let pattern = Pattern::new(&PatternOptions::default().with_rays(rays))?;
        for radius in TARGET_RADII {
            let params = json!({ "part": "mask", "rays": rays, "radius": radius });
            let points = workload::surface(&case.mesh, rays, options.quick);
            let workload = Workload::new(points, &pattern, (radius * diagonal) as f32, params);
            exact::rows(case, &workload, passes(options), output)?;
        }
    }
    Ok(())
}

/// `[Laine10]`, table 1: what a camera sees, two radii, 128 and 1024 rays; triangles one-sided as published, then two-sided.
fn table1(case: &Case, options: &Options, output: &mut Output) -> Result<()> {
    let Some(table) = TABLE1.iter().find(|table| table.scene == case.name) else { return Ok(()) };
    let unit = if case.name == "sibenik" { 1.0 } else { f64::from(case.mesh.bounds().diagonal()) };
    for (sides, side_name) in SIDES {
        for (radius, paper) in table.radii.iter().zip(table.mrays_s) {
            for (rays, paper) in [128, 1024].into_iter().zip(paper) {
                let pattern = table_pattern(rays)?;
                let params = json!({ "part": "table1", "rays": rays, "radius": radius, "sides": side_name });
                let points = workload::seen(case, &camera::views(case), rays, options.quick);
                let length = (radius * unit) as f32;
                let workload = Workload::new(points, &pattern, length, params.clone()).with_sides(sides);
                let figures = |method: &str| -> Value {
                    let known = TABLE1_METHODS.iter().position(|&m| m == method);
                    known.map_or(json!({}), |i| json!({ "paper_mrays_s": paper[i] }))
                };
                measure::rows(case, &workload, passes(options), output, |row| figures(&row.method))?;
                let picture = Picture::new(case, options.quick);
                let (tables, passes) = (picture::tables(case, &pattern)?, picture_passes(options));
                let mut row =
                    picture::raster_row(case, &picture, &tables, &workload.options, passes, params)?;
                measure::add_counters(&mut row, &|row| figures(&row.method));
                output.row(&row)?;
            }
        }
    }
    Ok(())
}

fn passes(options: &Options) -> usize {
    if options.quick { 3 } else { 5 }
}

/// Passes over whole pictures, which take seconds each.
fn picture_passes(options: &Options) -> usize {
    if options.quick { 3 } else { 1 }
}

/// The folder of real meshes, with a word if there is none.
fn meshes() -> Option<PathBuf> {
    let folder = scenes::mesh_folder();
    if folder.is_none() {
        eprintln!("no folder ../shared/meshes and no UMBRAGE_MESHES: rows of real meshes are skipped");
    }
    folder
}
