//! The suites of `cargo xtask bench`: a table for people, one JSON object a line for scripts.

mod anyhit;
mod rows;
mod scenes;

use anyhow::{Context, Result, bail};
use clap::Parser;
use std::path::PathBuf;

/// Benchmark suites of Umbrage.
#[derive(Parser)]
struct Arguments {
    /// Suite: anyhit.
    suite: String,
    /// Same rows, smaller sizes.
    #[arg(long)]
    quick: bool,
    /// Where to write one JSON object a line.
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
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
        "anyhit" => anyhit::run(arguments.quick, &mut output),
        other => bail!("unknown suite '{other}', expected anyhit"),
    }
}
