//! Suite `anyhit`: is there an occluder, for the rays that rendering and baking ask about.
//!
//! Method `bvh` is what every user gets: the default build and the best instructions of the machine, by the faster of its
//! entry points. Its variants `bvh-scalar` (no SIMD) and `bvh-fast` (the quick build) stand beside it; all are measured
//! against `bvh`, and `bvh` against each peer asked for.

pub mod measure;
pub mod ours;
mod workloads;

use self::{measure::Setting, ours::Ours, workloads::Case};
use crate::{
    entry::{ALPHA, Entry},
    peer::{self, Peer, PeerName},
    rows::{Output, note},
};
use anyhow::{Result, bail};
use rayon::{ThreadPool, ThreadPoolBuilder};
use umbrage_accel::{BuildOptions, BuildQuality};
use umbrage_geom::{OpticalDepth, Ray};

/// What to run.
#[derive(Clone, Debug)]
pub struct Options {
    /// Smaller meshes, fewer rays and passes.
    pub quick: bool,
    pub peers: Vec<PeerName>,
    /// Threads of the rows on several threads; 1 leaves them out.
    pub threads: usize,
    /// Only scenes whose name contains this.
    pub only: Option<String>,
    /// Part asked for; the suite has none.
    pub part: Option<String>,
}

/// Runs the suite.
///
/// # Errors
/// If there is no such part, or a mesh can't be had.
pub fn run(options: &Options, output: &mut Output) -> Result<()> {
    if let Some(part) = &options.part {
        bail!("unknown part '{part}': suite anyhit has no parts");
    }
    let pool = |threads: usize| ThreadPoolBuilder::new().num_threads(threads).build();
    let one = pool(1)?;
    let many = if options.threads > 1 { Some(pool(options.threads)?) } else { None };
    for source in workloads::sources(options.quick) {
        if options.only.as_ref().is_none_or(|only| source.name.contains(only.as_str())) {
            note(&format!("preparing {}", source.name));
            run_case(&source.load()?, options, &one, many.as_ref(), output)?;
        }
    }
    output.geomeans(&["threads", "alpha"])
}

fn run_case(
    case: &Case,
    options: &Options,
    one: &ThreadPool,
    many: Option<&ThreadPool>,
    output: &mut Output,
) -> Result<()> {
    let high = BuildOptions::default().quality;
    // Builds are compared on one thread.
    let ours = one.install(|| -> Result<_> {
        Ok([
            Ours::build("bvh", &case.mesh, high, false)?,
            Ours::build("bvh-scalar", &case.mesh, high, true)?,
            Ours::build("bvh-fast", &case.mesh, BuildQuality::Fast, false)?,
        ])
    })?;
    let peers: Vec<Box<dyn Peer>> =
        options.peers.iter().map(|&name| peer::open(name, &case.mesh)).collect::<Result<_>>()?;
    for workload in workloads::workloads(case, options.quick) {
        let setting = Setting {
            case,
            workload: &workload,
            peers: &peers,
            fast_build_s: ours[2].build_s,
            passes: if options.quick { 5 } else { 7 },
            pool: many.filter(|_| workload.on_threads),
        };
        if workload.transparent {
            setting.run(depth_entries(&ours, &peers, &workload.rays), output)?;
        } else {
            setting.run(hit_entries(&ours, &peers, &workload.rays), output)?;
        }
    }
    Ok(())
}

fn hit_entries<'a>(
    ours: &'a [Ours],
    peers: &'a [Box<dyn Peer>],
    rays: &'a [Ray],
) -> Vec<Box<dyn Entry<bool> + 'a>> {
    let own = ours.iter().flat_map(|method| method.any_hit(rays));
    own.chain(peers.iter().flat_map(|peer| peer.any_hit(rays))).collect()
}

fn depth_entries<'a>(
    ours: &'a [Ours],
    peers: &'a [Box<dyn Peer>],
    rays: &'a [Ray],
) -> Vec<Box<dyn Entry<OpticalDepth> + 'a>> {
    let opacity = OpticalDepth::from_opacity(ALPHA);
    // What SIMD is worth, the opaque rows show.
    let own =
        ours.iter().filter(|method| !method.scalar).flat_map(|method| method.transmittance(rays, opacity));
    own.chain(peers.iter().flat_map(|peer| peer.transmittance(rays, opacity))).collect()
}
