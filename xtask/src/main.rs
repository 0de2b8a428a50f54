//! Tasks of the workspace: `cargo xtask ci`, `golden`, `bench`, `tables`, `report`, `peers`, `pictures`.

mod peers;
mod pictures;
mod report;
mod tables;

use anyhow::{Context, Result, bail};
use clap::{Parser, Subcommand};
use std::{
    path::{Path, PathBuf},
    process::Command,
    time::Instant,
};

/// Tasks of the Umbrage workspace.
#[derive(Parser)]
#[command(name = "cargo xtask")]
struct Arguments {
    #[command(subcommand)]
    task: Task,
}

#[derive(Subcommand)]
enum Task {
    /// Everything that must pass before a change lands: format, lints, tests, golden images, docs.
    Ci,
    /// Renders small fixed scenes and compares them with the stored images; a failing run leaves pictures of the
    /// difference in target/golden.
    Golden {
        /// Store what is rendered now.
        #[arg(long)]
        bless: bool,
    },
    /// Runs a benchmark suite, prints a table and writes one JSON object a line.
    Bench {
        /// Suite: anyhit, aomask, methods, prefilter, reyes, stability or volumetric.
        suite: String,
        /// Same rows, smaller sizes, within three minutes once built.
        #[arg(long)]
        quick: bool,
        /// Where to write the rows.
        #[arg(long, value_name = "FILE")]
        json: Option<PathBuf>,
        /// Another ray caster to measure against: embree, see `cargo xtask peers`.
        #[arg(long = "peer", value_name = "NAME")]
        peers: Vec<String>,
        /// Threads of the rows on several threads; 1 leaves them out.
        #[arg(long, value_name = "N")]
        threads: Option<usize>,
        /// Only scenes whose name contains this.
        #[arg(long, value_name = "TEXT")]
        only: Option<String>,
        /// Only this part of suite aomask, prefilter or volumetric.
        #[arg(long, value_name = "NAME")]
        part: Option<String>,
        /// Only figures of suite reyes whose name contains this.
        #[arg(long, value_name = "TEXT")]
        figure: Option<String>,
        /// Pixels along a side of the images of suite reyes.
        #[arg(long, value_name = "N")]
        size: Option<u32>,
        /// Folder for plots of suites aomask, prefilter and reyes, beside rows.
        #[arg(long, value_name = "FOLDER")]
        plots: Option<PathBuf>,
        /// Folder for pictures; suites aomask, prefilter, reyes and volumetric.
        #[arg(long, value_name = "FOLDER")]
        pictures: Option<PathBuf>,
    },
    /// Writes the tables of the docs from docs/results.
    Tables {
        /// Only says which tables differ from their data, and fails if one does.
        #[arg(long)]
        check: bool,
    },
    /// Writes one page with all results: tables, plots and pictures of the docs, which needs no other file.
    Report {
        /// Where to write it.
        #[arg(short, long, value_name = "FILE.html", default_value = "target/report.html")]
        output: PathBuf,
        /// Opens it in a browser without a screen, at the widths of a desktop and a phone, and keeps screenshots beside it.
        #[arg(long)]
        open: bool,
    },
    /// Says how to install the libraries that `bench --peer` needs, and whether they are found.
    Peers,
    /// Renders the pictures of the docs again, into docs/images.
    Pictures {
        /// Only those whose name contains this.
        only: Option<String>,
    },
}

fn main() -> Result<()> {
    let arguments = Arguments::parse();
    match arguments.task {
        Task::Ci => ci(),
        Task::Golden { bless } => golden(bless),
        Task::Bench { suite, quick, json, peers, threads, only, part, figure, size, plots, pictures } => {
            let pictures = pictures.map(|folder| folder.display().to_string());
            let options = [
                ("--threads", threads.map(|n| n.to_string())),
                ("--only", only),
                ("--part", part),
                ("--figure", figure),
                ("--size", size.map(|n| n.to_string())),
                ("--plots", plots.map(|folder| folder.display().to_string())),
                ("--pictures", pictures),
            ];
            let given = options.into_iter().filter_map(|(name, value)| Some([name.to_owned(), value?]));
            let rest: Vec<String> = given.flatten().collect();
            bench(&suite, quick, json.as_deref(), &peers, &rest)
        }
        Task::Tables { check } => tables::run(root(), check),
        Task::Report { output, open } => report::run(root(), &output, open),
        Task::Peers => {
            peers::print();
            Ok(())
        }
        Task::Pictures { only } => pictures::run_all(only.as_deref()),
    }
}

/// The workspace's root.
fn root() -> &'static Path {
    Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/.."))
}

/// A `cargo` command in the root, run by the cargo that runs this.
fn cargo(arguments: &[&str]) -> Command {
    let mut command = Command::new(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()));
    command.args(arguments).current_dir(root());
    command
}

fn run(command: &mut Command) -> Result<()> {
    let shown = format!("{command:?}").replace('"', "");
    eprintln!("> {shown}");
    let start = Instant::now();
    let status = command.status().with_context(|| shown.clone())?;
    if !status.success() {
        bail!("{shown}: {status}");
    }
    eprintln!("  {:.0} s", start.elapsed().as_secs_f64());
    Ok(())
}

fn ci() -> Result<()> {
    tables::run(root(), true)?;
    run(&mut cargo(&["fmt", "--all", "--check"]))?;
    run(&mut cargo(&["clippy", "--workspace", "--all-targets", "--locked", "--", "-D", "warnings"]))?;
    let without_threads =
        ["clippy", "-p", "umbrage-accel", "--no-default-features", "--locked", "--", "-D", "warnings"];
    run(&mut cargo(&without_threads))?;
    // Golden images and doc tests are among the tests.
    run(&mut cargo(&["test", "--workspace", "--locked"]))?;
    run(cargo(&["doc", "--workspace", "--no-deps", "--locked"]).env("RUSTDOCFLAGS", "-D warnings"))
}

fn golden(bless: bool) -> Result<()> {
    let mut command =
        cargo(&["test", "-p", "umbrage-tests", "--test", "golden", "--locked", "--", "--nocapture"]);
    if bless {
        command.env("UMBRAGE_BLESS", "1");
    }
    run(&mut command)
}

/// Runs a suite with the features of its `peers`; `rest` is passed on.
fn bench(suite: &str, quick: bool, json: Option<&Path>, peers: &[String], rest: &[String]) -> Result<()> {
    let mut command = cargo(&["run", "--release", "--locked", "-p", "umbrage-benches", "--bin", "suite"]);
    for peer in peers {
        command.args(["--features", peer]);
    }
    command.args(["--", suite]);
    if quick {
        command.arg("--quick");
    }
    if let Some(path) = json {
        command.arg("--json").arg(std::path::absolute(path)?);
    }
    command.args(peers.iter().flat_map(|peer| ["--peer", peer])).args(rest);
    run(&mut command)
}
