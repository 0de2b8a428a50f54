//! `umbrage study`

use super::{
    Interrupted, is_mesh,
    progress::Bar,
    sizes::{RadiusArgument, SizeArgument},
    thread_pool, tools,
};
use anyhow::{Context, Result, ensure};
use std::{
    io::Write,
    path::{Path, PathBuf},
    process::ExitCode,
    time::Duration,
};
use umbrage::{
    bake::VAxis,
    query::{SurfaceMode, subdivide},
    study::{Per, Study, StudyError, StudyOptions, Subject, html, run as run_study, table},
};
use umbrage_scene::{Ground, Scene, Settings, read_mesh, write_atomically};

/// Measures time against error of every method that fits a mesh or a scene.
///
/// Asks how open the sky is and how much of each light arrives, by every method over a range of rays and thresholds, and holds the
/// answers against independent random rays. Prints a table with the settings to use for errors of 0.05, 0.02 and 0.01.
#[derive(clap::Args)]
pub struct StudyArguments {
    /// Mesh (.obj, .ply, .gltf, .glb), or scene (.toml).
    input: PathBuf,
    /// Page to write: one .html file with plots, tables and pictures that needs nothing else.
    #[arg(short, long, value_name = "FILE.html")]
    output: Option<PathBuf>,
    /// Write all rows as comma-separated values.
    #[arg(long, value_name = "FILE.csv")]
    csv: Option<PathBuf>,
    /// Write all rows as JSON, one object a line.
    #[arg(long, value_name = "FILE.jsonl")]
    json: Option<PathBuf>,
    /// About how long it may take, as in 90s or 5min.
    #[arg(long, value_name = "TIME", default_value = "60s", value_parser = humantime::parse_duration)]
    budget: Duration,
    /// Which points ask; default is vertex for a mesh, camera for a scene.
    #[arg(long, value_enum)]
    per: Option<PerArgument>,
    /// Image size for --per texel.
    #[arg(long, value_name = "N or WxH", default_value = "1024")]
    size: SizeArgument,
    /// How many points ask.
    #[arg(long, value_name = "N", default_value_t = 2000)]
    receivers: usize,
    /// How far occluders count for the sky: world units, a fraction of the diagonal as in 10%, or inf; may be given several times.
    #[arg(long, value_name = "R", default_values = ["inf", "10%"])]
    radius: Vec<RadiusArgument>,
    /// Only these methods; may be given several times.
    #[arg(long, value_name = "METHOD")]
    method: Vec<String>,
    /// INPUT is an .obj control mesh of a Catmull-Clark surface: camera rays over it are measured too.
    #[arg(long)]
    subdivide: bool,
    /// Put a large ground plane under a mesh.
    #[arg(long)]
    ground: bool,
    /// Leave the pictures out of the page.
    #[arg(long)]
    no_pictures: bool,
    /// Seed of all random choices.
    #[arg(long, default_value_t = 0)]
    seed: u32,
    /// Threads; default is one for each core.
    #[arg(long, value_name = "N")]
    threads: Option<usize>,
}

#[derive(Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum PerArgument {
    /// Vertices, with smooth normals.
    Vertex,
    /// Texels that the texture coordinates cover.
    Texel,
    /// Points that the camera sees.
    Camera,
}

pub fn run(arguments: &StudyArguments) -> Result<ExitCode> {
    let mut bar = Bar::new("studying")?;
    let options = arguments.options();
    options.validate()?;
    if let Some(path) = &arguments.output {
        let extension = path.extension().and_then(|e| e.to_str()).unwrap_or("").to_ascii_lowercase();
        ensure!(
            ["html", "htm"].contains(&extension.as_str()),
            "{}: a page is written as .html",
            path.display()
        );
    }
    for path in arguments.output.iter().chain(&arguments.csv).chain(&arguments.json) {
        umbrage_scene::check_writable(path)?;
    }
    let pool = thread_pool(arguments.threads)?;
    let study = pool.install(|| -> Result<Study> {
        let subject = arguments.subject(&mut bar)?;
        let study = run_study(&subject, &options, &mut |f| bar.report(f)).map_err(interrupted);
        study.with_context(|| arguments.input.display().to_string())
    })?;
    let study = Study {
        machine: umbrage::study::Machine {
            commit: option_env!("UMBRAGE_COMMIT").map(str::to_owned),
            ..study.machine
        },
        ..study
    };
    bar.check()?;
    let write = |path: &Option<PathBuf>, text: &dyn Fn() -> Result<String>| -> Result<()> {
        if let Some(path) = path {
            let text = text()?;
            write_atomically(path, |out| out.write_all(text.as_bytes()))?;
        }
        Ok(())
    };
    write(&arguments.output, &|| Ok(html(&study)?))?;
    write(&arguments.csv, &|| Ok(table::csv(&study)))?;
    write(&arguments.json, &|| Ok(table::json_lines(&study)))?;
    bar.finish();
    tools::print_line(table::text(&study).trim_end())?;
    Ok(ExitCode::SUCCESS)
}

impl StudyArguments {
    fn options(&self) -> StudyOptions {
        let by_input = if is_mesh(&self.input) { PerArgument::Vertex } else { PerArgument::Camera };
        let per = match self.per.unwrap_or(by_input) {
            PerArgument::Vertex => Per::Vertex,
            PerArgument::Camera => Per::Camera,
            PerArgument::Texel => Per::Texel { size: self.size.0, v_axis: VAxis::of_file(&self.input) },
        };
        StudyOptions::default()
            .with_per(per)
            .with_receivers(self.receivers)
            .with_radii(self.radius.iter().map(|radius| radius.0).collect())
            .with_budget(self.budget)
            .with_methods(self.method.clone())
            .with_pictures(self.output.is_some() && !self.no_pictures)
            .with_seed(self.seed)
    }

    fn subject(&self, bar: &mut Bar) -> Result<Subject> {
        let path = &self.input;
        let source = || path.display().to_string();
        let name = name_of(path);
        let ground = if self.ground { Ground::Below } else { Ground::Absent };
        let mut report = |_| bar.report(0.0);
        if self.subdivide {
            let control = umbrage_scene::read_polygons(path)?;
            // Traced as such, so that the scene keeps the control mesh.
            let keep = |settings: &mut Settings| settings.surfaces = SurfaceMode::Once.name().into();
            let scene = subdivide::scene_around(&name, &control, 1.0, keep, &mut report);
            let scene = scene.map_err(|error| interrupted(error.into())).with_context(source)?;
            return Subject::of_scene(&name, scene, &mut report).map_err(interrupted).with_context(source);
        }
        if is_mesh(path) {
            let mesh = read_mesh(path)?;
            return Subject::of_mesh(&name, mesh, ground, &mut report)
                .map_err(interrupted)
                .with_context(source);
        }
        ensure!(!self.ground, "--ground is for meshes: a scene has its own");
        let scene = Scene::load(path)?;
        Subject::of_scene(&name, scene, &mut report).map_err(interrupted).with_context(source)
    }
}

fn name_of(path: &Path) -> String {
    path.file_stem().unwrap_or_default().to_string_lossy().into_owned()
}

/// What a cancelled call means to the user.
fn interrupted(error: StudyError) -> anyhow::Error {
    match error {
        StudyError::Cancelled => Interrupted.into(),
        other => other.into(),
    }
}
