//! The suites of `cargo xtask bench`: a table for people, one JSON object a line for scripts.

mod anyhit;
mod aomask;
#[cfg(feature = "embree")]
mod embree;
mod entry;
mod memory;
mod methods;
mod peer;
mod plot;
mod prefilter;
mod reyes;
mod rows;
mod scenes;
mod stability;
mod volumetric;

use anyhow::{Context, Result, bail};
use clap::Parser;
use std::path::PathBuf;

/// Benchmark suites of Umbrage.
#[derive(Parser)]
struct Arguments {
    /// Suite: anyhit, aomask, methods, prefilter, reyes, stability, volumetric.
    suite: String,
    /// Same rows, smaller sizes.
    #[arg(long)]
    quick: bool,
    /// Where to write one JSON object a line.
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
    /// Ray casters of others to measure against.
    #[arg(long = "peer", value_enum, value_name = "NAME")]
    peers: Vec<peer::PeerName>,
    /// Threads of the rows on several threads; 1 leaves them out.
    #[arg(long, value_name = "N", default_value_t = 2)]
    threads: usize,
    /// Only scenes whose name contains this.
    #[arg(long, value_name = "TEXT")]
    only: Option<String>,
    /// Only this part of a suite; aomask: targets, mask, fans, prefilter, far-bounds, bits, table1, table2, figure5, figure6,
    /// figure7; prefilter: targets, fig1, rules, tables, fig4, fig5, fig6, fig9, fig10, bias, refit, control, forest;
    /// volumetric: wide, kd, ambient.
    #[arg(long, value_name = "NAME")]
    part: Option<String>,
    /// Pixels along a side of the images of suite reyes: 96 if quick, else 1024.
    #[arg(long, value_name = "N")]
    size: Option<u32>,
    /// Only figures of suite reyes whose name contains this.
    #[arg(long, value_name = "TEXT")]
    figure: Option<String>,
    /// Folder for plots of suites aomask (figure 6), prefilter and reyes, beside rows.
    #[arg(long, value_name = "FOLDER")]
    plots: Option<PathBuf>,
    /// Folder for pictures; suites aomask, prefilter (figures 1, 4, 6, 7 and 8), reyes and volumetric.
    #[arg(long, value_name = "FOLDER")]
    pictures: Option<PathBuf>,
}

fn main() -> Result<()> {
    let arguments = Arguments::parse();
    let file = match &arguments.json {
        // Opened first: a path that can't be written should fail before minutes of work.
        Some(path) => Some(std::fs::File::create(path).with_context(|| path.display().to_string())?),
        None => None,
    };
    let mut output = rows::Output::new(file);
    match arguments.suite.as_str() {
        "anyhit" => {
            let Arguments { quick, peers, threads, only, part, .. } = arguments;
            anyhit::run(&anyhit::Options { quick, peers, threads, only, part }, &mut output)
        }
        "aomask" => {
            let Arguments { quick, peers, only, part, plots, pictures, .. } = arguments;
            let images = pictures;
            aomask::run(&aomask::Options { quick, peers, only, part, images, plots }, &mut output)
        }
        "methods" => {
            let Arguments { quick, only, .. } = arguments;
            methods::run(&methods::Options { quick, only }, &mut output)
        }
        "prefilter" => {
            let Arguments { quick, peers, only, part, plots, pictures, .. } = arguments;
            prefilter::run(&prefilter::Options { quick, peers, only, part, plots, pictures }, &mut output)
        }
        "stability" => {
            let Arguments { quick, peers, only, .. } = arguments;
            stability::run(&stability::Options { quick, peers, only }, &mut output)
        }
        "volumetric" => {
            let Arguments { quick, peers, only, part, pictures, .. } = arguments;
            volumetric::run(&volumetric::Options { quick, peers, only, part, pictures }, &mut output)
        }
        "reyes" => {
            let Arguments { quick, peers, only, size, figure, plots, pictures, .. } = arguments;
            let size = size.unwrap_or(if quick { 96 } else { 1024 });
            reyes::run(&reyes::Options { quick, only, size, figure, peers, plots, pictures }, &mut output)
        }
        other => bail!(
            "unknown suite '{other}', expected anyhit, aomask, methods, prefilter, reyes, stability or volumetric"
        ),
    }
}
