//! `umbrage inspect`, `umbrage compare` and `umbrage scenes`

use super::is_mesh;
use anyhow::{Context, Result};
use serde::Serialize;
use std::{
    io::Write,
    path::{Path, PathBuf},
    process::ExitCode,
};
use umbrage::{
    image::compare::{
        CompareOptions, DifferencePicture, compare as compare_films, read_two, write_difference,
    },
    inspect::{inspect_mesh_for_methods, inspect_scene_for_methods},
    query::SceneKind,
};
use umbrage_scene::{Scene, generate, read_mesh, write_atomically};

/// Shows bounds, counts, memory, what is wrong with the triangles of a mesh or scene, and which methods fit it.
#[derive(clap::Args)]
pub struct InspectArguments {
    /// Mesh (.obj, .ply, .gltf, .glb) or scene (.toml).
    input: PathBuf,
    /// Print JSON.
    #[arg(long)]
    json: bool,
}

/// Shows how much two images of the same size differ.
///
/// Exit code 1 if an error threshold is given and exceeded.
#[derive(clap::Args)]
pub struct CompareArguments {
    /// First image, .exr or .png: the reference.
    a: PathBuf,
    /// Second image, of the same type.
    b: PathBuf,
    /// Print JSON.
    #[arg(long)]
    json: bool,
    /// Compare only this layer.
    #[arg(long)]
    layer: Option<String>,
    /// Stops of brightness before FLIP looks at the images.
    #[arg(long, default_value_t = 0.0, allow_negative_numbers = true)]
    exposure: f32,
    /// Write a picture of FLIP at each pixel.
    #[arg(long, value_name = "FILE.png")]
    difference: Option<PathBuf>,
    /// Write a picture of signed differences instead of FLIP.
    #[arg(long, requires = "difference")]
    signed: bool,
    /// Fail, with exit code 1, if the RMSE is larger.
    #[arg(long, value_name = "RMSE")]
    max_rmse: Option<f64>,
}

/// Lists the procedural generators with their parameters.
#[derive(clap::Args)]
pub struct ScenesArguments {
    /// Show only this generator.
    name: Option<String>,
    /// Print JSON.
    #[arg(long)]
    json: bool,
}

pub fn inspect(arguments: &InspectArguments) -> Result<ExitCode> {
    if is_mesh(&arguments.input) {
        print(&inspect_mesh_for_methods(&read_mesh(&arguments.input)?), arguments.json)
    } else {
        let mut scene = Scene::load(&arguments.input)?;
        let kind = SceneKind::of_scene(&scene);
        // Nothing is written, so Ctrl-C may end the process itself.
        umbrage::query::subdivide::refine_all(&mut scene, &mut |_| true)
            .with_context(|| arguments.input.display().to_string())?;
        print(&inspect_scene_for_methods(&scene, &kind), arguments.json)
    }
}

pub fn compare(arguments: &CompareArguments) -> Result<ExitCode> {
    let CompareArguments { a, b, .. } = arguments;
    let mut options = CompareOptions::default().with_exposure(arguments.exposure);
    options.layer.clone_from(&arguments.layer);
    let [film_a, film_b] = read_two(a, b)?;
    let comparison = compare_films(&film_a, &film_b, &options)?;
    if let Some(path) = &arguments.difference {
        let picture = if arguments.signed { DifferencePicture::Signed } else { DifferencePicture::Flip };
        write_difference(path, &film_a, &film_b, &options, picture)?;
    }
    print(&comparison, arguments.json)?;
    let exceeded = arguments.max_rmse.is_some_and(|limit| comparison.main.rmse > limit);
    Ok(if exceeded { ExitCode::FAILURE } else { ExitCode::SUCCESS })
}

pub fn scenes(arguments: &ScenesArguments) -> Result<ExitCode> {
    let wanted: Vec<_> = generate::generators()
        .iter()
        .filter(|g| arguments.name.as_ref().is_none_or(|name| name == g.name))
        .collect();
    if let Some(name) = arguments.name.as_ref().filter(|_| wanted.is_empty()) {
        let known: Vec<_> = generate::generators().iter().map(|g| g.name).collect();
        anyhow::bail!("unknown generator '{name}', expected one of {}", known.join(", "));
    }
    if arguments.json {
        let list: Vec<_> = wanted.iter().map(|g| describe(g)).collect();
        print_line(&serde_json::to_string_pretty(&list)?)?;
        return Ok(ExitCode::SUCCESS);
    }
    for generator in wanted {
        print_line(&format!(
            "{:<12} {:>9} triangles{}  {}",
            generator.name,
            generator.default_triangles,
            if generator.closed { ", closed" } else { "" },
            generator.summary
        ))?;
        for p in generator.parameters {
            print_line(&format!(
                "    {:<12} {} (default {}, {})",
                p.name,
                p.meaning,
                p.default_text(),
                p.range_text()
            ))?;
        }
    }
    print_line("\nScene files that ship with Umbrage are in the folder scenes.")?;
    Ok(ExitCode::SUCCESS)
}

fn describe(generator: &generate::GeneratorInfo) -> serde_json::Value {
    let parameters: Vec<_> = generator
        .parameters
        .iter()
        .map(|p| {
            serde_json::json!({ "name": p.name, "default": p.default_text(), "range": p.range_text(), "meaning": p.meaning })
        })
        .collect();
    serde_json::json!({
        "name": generator.name,
        "summary": generator.summary,
        "closed": generator.closed,
        "default_triangles": generator.default_triangles,
        "parameters": parameters,
    })
}

fn print<T: Serialize + std::fmt::Display>(report: &T, json: bool) -> Result<ExitCode> {
    print_line(&if json { serde_json::to_string_pretty(report)? } else { report.to_string() })?;
    Ok(ExitCode::SUCCESS)
}

/// Prints a line; a reader that has seen enough (`| head`) is no error.
pub(super) fn print_line(text: &str) -> Result<()> {
    match writeln!(std::io::stdout(), "{text}") {
        Err(error) if error.kind() != std::io::ErrorKind::BrokenPipe => Err(error.into()),
        _ => Ok(()),
    }
}

/// Writes indented JSON, atomically.
pub(super) fn write_json(path: &Path, value: &serde_json::Value) -> Result<()> {
    write_atomically(path, |w| {
        serde_json::to_writer_pretty(&mut *w, value)?;
        writeln!(w)
    })?;
    Ok(())
}
