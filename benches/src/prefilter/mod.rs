//! Suite `prefilter`: the tables and figures of Lacewell et al. 2008 on our scenes, and what goes past them.

mod case;
mod figures;
mod pictures;
mod scaling;
mod showcase;
mod tables;
mod targets;

use crate::{
    peer::{self, PeerName},
    rows::{Output, note},
};
use anyhow::{Result, bail};
use case::{Case, SOURCES};
use std::path::PathBuf;

/// What to run.
pub struct Options {
    pub quick: bool,
    pub peers: Vec<PeerName>,
    /// Only scenes whose name contains this.
    pub only: Option<String>,
    /// Only one part of the suite.
    pub part: Option<String>,
    /// Folder for plots of figures 1, 5, 7, 8 and 9.
    pub plots: Option<PathBuf>,
    /// Folder for pictures of figures 1, 4, 6, 7 and 8.
    pub pictures: Option<PathBuf>,
}

/// Parts of the suite, in order.
pub const PARTS: [&str; 13] = [
    "targets", "fig1", "rules", "tables", "fig4", "fig5", "fig6", "fig9", "fig10", "bias", "refit",
    "control", "forest",
];

/// Most triangles in the quick form.
const QUICK_TRIANGLES: usize = 300_000;

/// Pixels across of the images of figures 1, 4, 6, 7 and 8.
const FIGURE_WIDTH: u32 = 256;

/// Runs the suite.
///
/// # Errors
/// An unknown part, scenes that can't be made, or a file that can't be written.
pub fn run(options: &Options, output: &mut Output) -> Result<()> {
    if let Some(part) = &options.part
        && !PARTS.contains(&part.as_str())
    {
        bail!("unknown part '{part}', expected one of {}", PARTS.join(", "));
    }
    let wants = |part: &str| options.part.as_ref().is_none_or(|p| p == part);
    let plots = options.plots.as_deref();
    let named = |name: &str| options.only.as_ref().is_none_or(|only| name.contains(only.as_str()));
    let (width, passes) = if options.quick { (48, 3) } else { (64, 5) };
    let (figure_width, figure_passes) = if options.quick { (96, 2) } else { (FIGURE_WIDTH, 3) };
    let by_size = [
        &["targets", "fig1"][..],
        &["rules", "tables", "fig4", "fig5", "fig6", "fig10", "bias", "refit", "control"],
    ];
    let [large, small] = by_size.map(|parts| parts.iter().any(|part| wants(part)));
    if large || small {
        for source in SOURCES.into_iter().filter(|s| named(s.name)) {
            let triangles =
                if options.quick { source.triangles.min(QUICK_TRIANGLES) } else { source.triangles };
            note(&format!("{}: {triangles} triangles", source.name));
            let mut case = Case::generate(source, triangles, if large { figure_width } else { width })?;
            if wants("targets") {
                let peers =
                    options.peers.iter().map(|&p| peer::open(p, &case.mesh)).collect::<Result<Vec<_>>>()?;
                targets::run(&case, &peers, figure_passes, plots, output)?;
            }
            if wants("fig1") {
                showcase::run(&case, figure_passes, options.pictures.as_deref(), output)?;
            }
            if !small {
                continue;
            }
            if large {
                case.resize(width);
            }
            if wants("rules") {
                targets::rules(&case, passes, output)?;
            }
            if wants("tables") {
                tables::run(&case, output)?;
            }
            if let (true, Some(folder)) = (wants("fig4"), &options.pictures) {
                pictures::run(&case, figure_width, folder)?;
            }
            if wants("fig5") && source.name == "bush" {
                figures::variance(&case, if options.quick { 5_000 } else { 50_000 }, plots, output)?;
            }
            if wants("fig6") {
                figures::convergence(&case, output)?;
            }
            if wants("fig10") {
                figures::storage(&case, output)?;
            }
            if wants("bias") {
                figures::bias(&case, output)?;
            }
            if wants("refit") {
                tables::refit(&case, output)?;
            }
            if wants("control") {
                figures::control(&case, output)?;
            }
        }
    }
    if wants("fig10") && named("particles") {
        figures::particles(if options.quick { 50_000 } else { 200_000 }, width, output)?;
    }
    if wants("fig9") && named("bush") {
        scaling::run(
            if options.quick { 60_000 } else { 500_000 },
            if options.quick { 2 } else { 3 },
            width,
            plots,
            output,
        )?;
    }
    if wants("forest") && named("forest") {
        tables::forest(options.quick, output)?;
    }
    Ok(())
}
