//! `umbrage merge`

use super::is_mesh;
use anyhow::Result;
use std::{path::PathBuf, process::ExitCode};
use umbrage::{bake::baked, image};

/// Joins the parts that `--shard` made, of a picture or of a bake, in any order.
///
/// The result has the bits of a run without shards.
#[derive(clap::Args)]
pub struct MergeArguments {
    /// File to write: .exr or .png from parts of a picture; from parts of a bake what the bake itself could write.
    output: PathBuf,
    /// All parts.
    #[arg(required = true)]
    parts: Vec<PathBuf>,
}

pub fn run(arguments: &MergeArguments) -> Result<ExitCode> {
    let MergeArguments { output, parts } = arguments;
    if parts.first().is_some_and(|part| is_mesh(part)) {
        baked::merge(parts)?.write(output)?;
    } else {
        image::check_writable(output)?;
        let merged = image::merge(parts)?;
        image::write(output, &merged.film, merged.exposure)?;
    }
    Ok(ExitCode::SUCCESS)
}
