//! `umbrage render`

use super::{Interrupted, is_mesh, methods, progress::Bar, thread_pool};
use anyhow::{Context, Result, ensure};
use serde_json::json;
use std::{
    path::{Path, PathBuf},
    process::ExitCode,
    str::FromStr,
    time::Instant,
};
use umbrage::{
    image::{self, ColorMap, Fingerprint, Part, Shard, names},
    query::{AoMethod, BuildCost, Occluders, Selection, ShadowMethod, SurfaceMode, subdivide},
    render::{MethodUsed, RenderError, RenderOptions, Rendered, TILE, check_settings, render},
};
use umbrage_scene::{ByteSize, Ground, Scene, Settings};

/// Renders a scene with soft shadows and ambient occlusion.
///
/// SCENE is a scene file (.toml), or a mesh (.obj, .ply, .gltf, .glb), which gets a camera, a light and a ground.
#[derive(clap::Args)]
pub struct RenderArguments {
    /// Scene file, or a mesh.
    scene: PathBuf,
    /// Image to write: .exr (layers beauty, shadow, ao, normal, depth, cost) or .png; default is the scene's name with
    /// .png.
    #[arg(short, long)]
    output: Option<PathBuf>,
    /// SCENE is an .obj control mesh of a Catmull-Clark surface, with its tags for creases and boundaries: micropolygons of about
    /// so many pixels.
    #[arg(long, value_name = "PIXELS", num_args = 0..=1, require_equals = true, default_missing_value = "1")]
    subdivide: Option<f32>,
    /// How rays to lights are answered.
    #[arg(long, value_name = "METHOD", value_parser = methods::parser::<ShadowMethod>())]
    shadows: Option<Selection<ShadowMethod>>,
    /// How the openness of the sky is answered.
    #[arg(long, value_name = "METHOD", value_parser = methods::parser::<AoMethod>())]
    ao: Option<Selection<AoMethod>>,
    /// How subdivision surfaces are traced.
    #[arg(long, value_name = "MODE", value_parser = methods::modes::<SurfaceMode>())]
    surfaces: Option<SurfaceMode>,
    /// Memory for grids of each control mesh with --surfaces footprint, such as 64MiB. The image does not depend on it.
    #[arg(long, value_name = "SIZE")]
    grid_cache: Option<ByteSize>,
    /// Camera samples a pixel.
    #[arg(long, value_name = "N")]
    spp: Option<u32>,
    /// Choose the samples of lights and sky so that the layers shadow and ao have about this root mean square error. The scene's
    /// numbers of samples are not used then. For exact methods.
    #[arg(long, value_name = "E")]
    target_error: Option<f32>,
    /// Image size in pixels.
    #[arg(long, value_name = "WxH")]
    size: Option<Size>,
    /// Threads; default is one for each core. The image does not depend on it.
    #[arg(long, value_name = "N")]
    threads: Option<usize>,
    /// Render only part I of N, to an .exr that `umbrage merge` joins with the others.
    #[arg(long, value_name = "I/N")]
    shard: Option<Shard>,
    /// Write times, counts and methods as JSON.
    #[arg(long, value_name = "FILE.json")]
    stats: Option<PathBuf>,
    /// Write the work done for each pixel in false colours.
    #[arg(long, value_name = "FILE.png")]
    heatmap: Option<PathBuf>,
}

#[derive(Clone, Copy)]
struct Size {
    width: u32,
    height: u32,
}

impl FromStr for Size {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let parts = text.split_once(['x', 'X']).and_then(|(w, h)| Some((w.parse().ok()?, h.parse().ok()?)));
        match parts {
            Some((width, height)) if width > 0 && height > 0 => Ok(Self { width, height }),
            _ => Err("expected WIDTHxHEIGHT, both at least 1".into()),
        }
    }
}

pub fn run(arguments: &RenderArguments) -> Result<ExitCode> {
    let mut bar = Bar::new("rendering")?;
    let output = arguments.output.clone().unwrap_or_else(|| {
        PathBuf::from(arguments.scene.with_extension("png").file_name().unwrap_or("out.png".as_ref()))
    });
    check_outputs(arguments, &output)?;
    let start = Instant::now();
    let scene = match arguments.subdivide {
        Some(pixels) => load_surface(arguments, pixels, &mut bar)?,
        None => {
            let mut scene = load(&arguments.scene)?;
            override_settings(&mut scene.settings, arguments);
            subdivide::refine(&mut scene, &mut |_| bar.report(0.0))
                .map_err(interrupted)
                .with_context(|| arguments.scene.display().to_string())?;
            scene
        }
    };
    check_settings(&scene.settings).with_context(|| arguments.scene.display().to_string())?;
    let is_footprint = scene.settings.surfaces == SurfaceMode::Footprint.name();
    ensure!(arguments.grid_cache.is_none() || is_footprint, "--grid-cache needs --surfaces footprint");
    let load_s = start.elapsed().as_secs_f64();
    bar.check()?;
    let pool = thread_pool(arguments.threads)?;
    pool.install(|| render_and_write(arguments, &output, &scene, bar, load_s))?;
    Ok(ExitCode::SUCCESS)
}

/// Finds out now rather than after the work that a file can't be written.
fn check_outputs(arguments: &RenderArguments, output: &Path) -> Result<()> {
    match arguments.shard {
        Some(_) => image::check_part_writable(output)?,
        None => drop(image::check_writable(output)?),
    }
    if let Some(path) = &arguments.stats {
        umbrage_scene::check_writable(path)?;
    }
    if let Some(path) = &arguments.heatmap {
        let format = image::check_writable(path)?;
        anyhow::ensure!(format == image::Format::Png, "{}: a heat map is written as .png", path.display());
    }
    Ok(())
}

/// Reads a scene file, or puts a mesh into a scene of its own.
pub(super) fn load(path: &Path) -> Result<Scene> {
    if is_mesh(path) {
        let name = path.file_stem().unwrap_or_default().to_string_lossy();
        let mesh = umbrage_scene::read_mesh(path)?;
        Ok(Scene::around_mesh(&name, mesh, Ground::Below).with_context(|| path.display().to_string())?)
    } else {
        Ok(Scene::load(path)?)
    }
}

/// Reads a control mesh and puts its surface into a scene.
fn load_surface(arguments: &RenderArguments, pixels: f32, bar: &mut Bar) -> Result<Scene> {
    let path = &arguments.scene;
    let name = path.file_stem().unwrap_or_default().to_string_lossy();
    let control = umbrage_scene::read_polygons(path)?;
    let settings = |settings: &mut Settings| override_settings(settings, arguments);
    subdivide::scene_around(&name, &control, pixels, settings, &mut |_| bar.report(0.0))
        .map_err(interrupted)
        .with_context(|| path.display().to_string())
}

fn override_settings(settings: &mut Settings, arguments: &RenderArguments) {
    if let Some(size) = arguments.size {
        (settings.width, settings.height) = (size.width, size.height);
    }
    settings.spp = arguments.spp.unwrap_or(settings.spp);
    if let Some(method) = arguments.shadows {
        settings.shadows = method.to_string();
    }
    if let Some(mode) = arguments.surfaces {
        settings.surfaces = mode.to_string();
    }
    if let Some(size) = arguments.grid_cache {
        settings.grid_cache = size;
    }
    if let Some(method) = arguments.ao {
        settings.ao = method.to_string();
    }
}

fn render_and_write(
    arguments: &RenderArguments,
    output: &Path,
    scene: &Scene,
    mut bar: Bar,
    load_s: f64,
) -> Result<()> {
    let start = Instant::now();
    let source = || arguments.scene.display().to_string();
    let occluders =
        Occluders::of_scene(scene, &mut |_| bar.report(0.0)).map_err(interrupted).with_context(source)?;
    let build_s = start.elapsed().as_secs_f64();
    bar.check()?;
    let is_exr = image::Format::of(output)? == image::Format::Exr;
    let count_cost = is_exr || arguments.heatmap.is_some() || arguments.stats.is_some();
    let options = RenderOptions::default()
        .with_shard(arguments.shard.unwrap_or(Shard::WHOLE))
        .with_count_cost(count_cost)
        .with_target_error(arguments.target_error);
    let start = Instant::now();
    let rendered = render(scene, &occluders, &options, &mut |f| bar.report(f)).map_err(interrupted)?;
    let render_s = start.elapsed().as_secs_f64();
    bar.check()?;
    let exposure = scene.settings.exposure;
    match arguments.shard {
        None => image::write(output, &rendered.film, exposure)?,
        Some(shard) => {
            let mut fingerprint = Fingerprint::default();
            fingerprint.scene(scene);
            fingerprint.words(arguments.target_error.map(f32::to_bits));
            let part = Part { shard, tile_size: TILE, fingerprint: fingerprint.finish(), exposure };
            image::write_part(output, &rendered.film, &part)?;
        }
    }
    if let Some(path) = &arguments.heatmap {
        image::write_heat_map(path, &rendered.film, names::COST, ColorMap::Viridis, None)?;
    }
    if let Some(path) = &arguments.stats {
        let times = [load_s, build_s, render_s];
        write_stats(path, arguments, scene, &occluders, &rendered, times)?;
    }
    bar.finish();
    Ok(())
}

/// What a cancelled call means to the user.
fn interrupted(error: impl Into<RenderError>) -> anyhow::Error {
    match error.into() {
        RenderError::Cancelled => Interrupted.into(),
        other => other.into(),
    }
}

/// The keys are documented in `docs/command-line.md`; scripts depend on them.
fn write_stats(
    path: &Path,
    arguments: &RenderArguments,
    scene: &Scene,
    occluders: &Occluders,
    rendered: &Rendered,
    [load_s, build_s, render_s]: [f64; 3],
) -> Result<()> {
    let settings = &scene.settings;
    let rays = rendered.rays;
    let [shadow_samples, ao_samples] = rendered
        .samples
        .map_or([settings.shadow_samples, settings.ao_samples], |samples| [samples.shadow, samples.ao]);
    let total = rays.camera + rays.shadow + rays.ambient;
    let (structure_bytes, geometry_bytes) = occluders.bytes();
    let method = |used: MethodUsed| json!({ "method": used.name, "reason": used.reason });
    let made =
        |made: BuildCost| json!({ "build_s": made.time.map(|time| time.as_secs_f64()), "bytes": made.bytes });
    let structures: serde_json::Map<_, _> = occluders
        .structures()
        .into_iter()
        .map(|(structure, how)| (structure.name().into(), json!(how.map(made))))
        .collect();
    let stats = json!({
        "umbrage": env!("CARGO_PKG_VERSION"),
        "scene": arguments.scene.display().to_string(),
        "shard": arguments.shard.map(|s| s.to_string()),
        "width": settings.width,
        "height": settings.height,
        "spp": settings.spp,
        "shadow_samples": shadow_samples,
        "ao_samples": ao_samples,
        "target_error": arguments.target_error,
        "estimated_error": rendered.samples.map(|samples| json!({
            "shadow": samples.shadow_error,
            "ao": samples.ao_error,
        })),
        "seed": settings.seed,
        "shadows": method(rendered.shadows),
        "ao": method(rendered.ao),
        "triangles": occluders.triangle_count(),
        "instanced": occluders.is_instanced(),
        "structure_bytes": structure_bytes,
        "geometry_bytes": geometry_bytes,
        "structures": structures,
        "surfaces": occluders.surface_work().map(|work| json!({
            "mode": settings.surfaces,
            "grid_cache": settings.grid_cache.bytes(),
            "patches": work.patches,
            "grids": work.grids,
            "micropolygons": work.micropolygons,
            "evicted": work.evicted,
            "bytes": work.bytes,
        })),
        "threads": rayon::current_num_threads(),
        "load_s": load_s,
        "build_s": build_s,
        "render_s": render_s,
        "rays": rays,
        "mrays_s": total as f64 / render_s * 1e-6,
        "counters": rendered.counters.map(|c| json!({
            "nodes": c.nodes,
            "box_tests": c.box_tests,
            "triangle_tests": c.triangle_tests,
        })),
        "occluders": rendered.occluders.map(|o| json!({
            "objects": o.objects,
            "prepared": o.prepared,
            "generators": o.generators,
            "boxes": o.boxes,
        })),
    });
    super::tools::write_json(path, &stats)
}
