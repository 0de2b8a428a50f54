//! The suites of `cargo xtask bench`: a table for people, one JSON object a line for scripts.

mod anyhit;
mod aomask;
#[cfg(feature = "embree")]
mod embree;
mod entry;
mod peer;
mod rows;
mod scenes;
mod stability;

use anyhow::{Context, Result, bail};
use clap::Parser;
use std::path::PathBuf;

/// Benchmark suites of Umbrage.
#[derive(Parser)]
struct Arguments {
    /// Suite: anyhit, aomask, stability.
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
    /// Only this part of the suite aomask: targets, table1, mask.
    #[arg(long, value_name = "NAME")]
    part: Option<String>,
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
            let Arguments { quick, peers, threads, only, .. } = arguments;
            anyhit::run(&anyhit::Options { quick, peers, threads, only }, &mut output)
        }
        "aomask" => {
            let Arguments { quick, peers, only, part, .. } = arguments;
            aomask::run(&aomask::Options { quick, peers, only, part }, &mut output)
        }
        "stability" => {
            let Arguments { quick, peers, only, .. } = arguments;
            stability::run(&stability::Options { quick, peers, only }, &mut output)
        }
        other => bail!("unknown suite '{other}', expected anyhit, aomask or stability"),
    }
}
