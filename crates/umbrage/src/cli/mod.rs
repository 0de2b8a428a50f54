//! The command line of `umbrage`.
//!
//! Exit codes: 0 done, 1 the threshold of `compare` exceeded, 2 bad input or usage, 130 interrupted.

mod bake;
mod merge;
mod methods;
mod progress;
mod render;
mod sizes;
mod study;
mod tools;

use anyhow::Result;
use clap::{Parser, Subcommand};
use std::{fmt, path::Path, process::ExitCode};
use umbrage_geom::simd::BackEnd;

/// How much of the light between here and there is blocked: shadows, ambient occlusion and transmittance.
#[derive(Parser)]
#[command(name = "umbrage", version, about)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    Render(render::RenderArguments),
    Bake(bake::BakeArguments),
    Study(study::StudyArguments),
    Merge(merge::MergeArguments),
    Inspect(tools::InspectArguments),
    Compare(tools::CompareArguments),
    Scenes(tools::ScenesArguments),
}

/// The user asked to stop.
#[derive(Debug)]
pub(crate) struct Interrupted;

impl fmt::Display for Interrupted {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("interrupted, nothing written")
    }
}

impl std::error::Error for Interrupted {}

/// Runs the program with the process's arguments.
pub fn run() -> ExitCode {
    let command = Arguments::parse().command;
    let result = BackEnd::forced().map_err(anyhow::Error::from).and_then(|_| match command {
        Command::Render(arguments) => render::run(&arguments),
        Command::Bake(arguments) => bake::run(&arguments),
        Command::Study(arguments) => study::run(&arguments),
        Command::Merge(arguments) => merge::run(&arguments),
        Command::Inspect(arguments) => tools::inspect(&arguments),
        Command::Compare(arguments) => tools::compare(&arguments),
        Command::Scenes(arguments) => tools::scenes(&arguments),
    });
    match result {
        Ok(code) => code,
        Err(error) => {
            // One line: causes after their consequences.
            let text = format!("{error:#}").replace('\n', " ");
            eprintln!("umbrage: {text}");
            ExitCode::from(if error.is::<Interrupted>() { 130 } else { 2 })
        }
    }
}

/// A pool with the wanted number of threads; 0 means one for each core.
fn thread_pool(threads: Option<usize>) -> Result<rayon::ThreadPool> {
    let threads = threads.unwrap_or(0);
    anyhow::ensure!(threads <= 4096, "--threads {threads} is more than 4096");
    Ok(rayon::ThreadPoolBuilder::new().num_threads(threads).build()?)
}

/// Whether the path names a mesh file rather than a scene file.
fn is_mesh(path: &Path) -> bool {
    let extension = path.extension().and_then(|e| e.to_str()).unwrap_or("").to_ascii_lowercase();
    ["obj", "ply", "gltf", "glb"].contains(&extension.as_str())
}
