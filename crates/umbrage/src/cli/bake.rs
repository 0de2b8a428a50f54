//! `umbrage bake`

use super::{
    Interrupted, is_mesh, methods,
    progress::Bar,
    sizes::{RadiusArgument, SizeArgument},
    thread_pool,
};
use anyhow::{Context, Result, ensure};
use serde_json::json;
use std::{io::Write, path::PathBuf, process::ExitCode, time::Instant};
use umbrage::{
    bake::baked::{BakeTarget, Baked, check_part_extension},
    bake::{Bake, BakeError, BakeOptions, NormalSource, Receivers, TexelMap, VAxis, blocks},
    image::{Fingerprint, Shard, ShardError},
    query::{AoMethod, Ground, Occluders, SceneKind, Selection, View, engine, plan, subdivide},
    reyes::SurfaceError,
};
use umbrage_aomask::Sides;
use umbrage_aomask::exact::adaptive::Spent;
use umbrage_geom::{Falloff, TriangleMesh};
use umbrage_scene::{PointCloud, Scene, read_mesh, read_points};

/// Bakes ambient occlusion on to a mesh, an image or points.
///
/// The result is called ao: 1 is open, 0 fully occluded.
#[derive(clap::Args)]
pub struct BakeArguments {
    /// Mesh (.obj, .ply, .gltf, .glb), or a scene (.toml), whose instances are baked as one mesh in world space.
    mesh: PathBuf,
    /// File to write: .ply or .obj with vertex colours, .png or .exr with --per texel, .ply with --points.
    #[arg(short, long)]
    output: PathBuf,
    /// MESH is an .obj control mesh of a Catmull-Clark surface, with its tags for creases and boundaries: its faces are cut into
    /// 2^LEVEL x 2^LEVEL cells on the surface, whose vertices are baked.
    #[arg(long, value_name = "LEVEL", num_args = 0..=1, require_equals = true, default_missing_value = "3")]
    subdivide: Option<u8>,
    /// How occlusion is computed.
    #[arg(long, value_name = "METHOD", default_value = "auto", value_parser = methods::parser::<AoMethod>())]
    method: Selection<AoMethod>,
    /// Rays from each receiver.
    #[arg(long, value_name = "N", default_value_t = 256)]
    rays: u32,
    /// How far occluders count: world units, a fraction of the diagonal as in 10%, or inf.
    #[arg(long, value_name = "R", default_value = "inf")]
    radius: RadiusArgument,
    /// How occluders fade with distance: constant, linear, quadratic, exponential, or weights from 0 to the radius as in
    /// 1,0.8,0.3,0.
    #[arg(long, default_value = "constant")]
    falloff: Falloff,
    /// What is baked.
    #[arg(long, value_enum, default_value = "vertex")]
    per: Per,
    /// Bake at the points of this PLY (x y z nx ny nz); MESH only occludes.
    #[arg(long, value_name = "FILE.ply")]
    points: Option<PathBuf>,
    /// Image size for --per texel.
    #[arg(long, value_name = "N or WxH", default_value = "1024")]
    size: SizeArgument,
    /// Texels by which charts grow over their seams.
    #[arg(long, value_name = "N", default_value_t = 4)]
    dilate: u32,
    /// Which sides of occluders block.
    #[arg(long, value_enum, default_value = "both")]
    sides: SidesArgument,
    /// Where normals come from.
    #[arg(long, value_enum, default_value = "smooth")]
    normals: Normals,
    /// Add a large ground plane under the lowest point.
    #[arg(long)]
    ground: bool,
    /// A mesh that only occludes; may be given several times.
    #[arg(long, value_name = "MESH")]
    occluder: Vec<PathBuf>,
    /// Distance by which rays start above the surface, world units.
    #[arg(long, value_name = "D", default_value_t = 0.0)]
    bias: f32,
    /// Seed of all random choices.
    #[arg(long, default_value_t = 0)]
    seed: u32,
    /// Threads; default is one for each core. The result does not depend on it.
    #[arg(long, value_name = "N")]
    threads: Option<usize>,
    /// Bake only part I of N, to a .ply that `umbrage merge` joins with the others.
    #[arg(long, value_name = "I/N")]
    shard: Option<Shard>,
    /// Write all rays and whether they were blocked, for checks against other ray casters: 36 bytes a ray, little-endian
    /// floats origin, tnear, direction, tfar, then 1 or 0 as an integer. Only for methods with masks.
    #[arg(long, value_name = "FILE")]
    dump_rays: Option<PathBuf>,
    /// Give vertices, texels or points as many rays, up to --rays, as it takes until the expected root mean square error of ao is 0.8 E.
    /// With --method mask.
    #[arg(long, value_name = "E")]
    target_error: Option<f32>,
    /// Also write bent normals, the mean directions of free rays. Only for methods with masks.
    #[arg(long)]
    bent_normals: bool,
    /// Write times and counts as JSON.
    #[arg(long, value_name = "FILE.json")]
    stats: Option<PathBuf>,
}

/// Whether `method` answers by masks.
fn has_masks(method: AoMethod) -> bool {
    method.needs().mask_rays
}

#[derive(Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Per {
    /// Every vertex of the mesh.
    Vertex,
    /// Every texel that the mesh's texture coordinates cover.
    Texel,
}

#[derive(Clone, Copy, clap::ValueEnum)]
enum SidesArgument {
    /// Front and back.
    Both,
    /// Only fronts, from which corners run counter-clockwise.
    Front,
    /// Only fronts that a ray meets before any back; opaque occluders only.
    FrontFirst,
}

#[derive(Clone, Copy, clap::ValueEnum)]
enum Normals {
    /// Of triangles.
    Geometric,
    /// Mean over a vertex's triangles.
    Smooth,
    /// As the file gives them.
    File,
}

impl BakeArguments {
    fn options(&self) -> BakeOptions {
        let sides = match self.sides {
            SidesArgument::Both => Sides::Both,
            SidesArgument::Front => Sides::Front,
            SidesArgument::FrontFirst => Sides::FrontFirst,
        };
        let options = BakeOptions::default()
            .with_method(plan::sky_of_one_mesh(self.method, self.rays))
            .with_rays(self.rays)
            .with_radius(self.radius.0)
            .with_falloff(self.falloff.clone())
            .with_sides(sides)
            .with_bias(self.bias)
            .with_seed(self.seed);
        match self.target_error {
            Some(target) => options.with_target_error(target),
            None => options,
        }
    }

    fn normal_source(&self) -> NormalSource {
        match self.normals {
            Normals::Geometric => NormalSource::Geometric,
            Normals::Smooth => NormalSource::Smooth,
            Normals::File => NormalSource::File,
        }
    }
}

/// What the arguments name, read.
struct Input {
    mesh: TriangleMesh,
    occluders: Vec<TriangleMesh>,
    points: Option<PointCloud>,
}

pub fn run(arguments: &BakeArguments) -> Result<ExitCode> {
    let mut bar = Bar::new("baking")?;
    let options = arguments.options();
    options.validate()?;
    ensure!(
        arguments.points.is_none() || arguments.per == Per::Vertex,
        "--points and --per texel exclude each other"
    );
    let method = options.method;
    // Occluders are one mesh; whether they are opaque isn't known yet.
    method.check(&SceneKind {
        opaque: true,
        instances_apart: false,
        surfaces: false,
        view: View::NoCamera,
    })?;
    for (given, name) in
        [(arguments.dump_rays.is_some(), "--dump-rays"), (arguments.bent_normals, "--bent-normals")]
    {
        ensure!(
            !given || has_masks(method),
            "{name} needs a method with masks: --method mask, mask-prefilter or mask-table, with a multiple of 8 rays up to 1024"
        );
    }
    ensure!(
        arguments.target_error.is_none() || arguments.shard.is_none(),
        "--target-error and --shard exclude each other: rays depend on the receivers around"
    );
    ensure!(
        !arguments.bent_normals || arguments.shard.is_none(),
        "--bent-normals and --shard exclude each other: parts hold only ao"
    );
    for path in std::iter::once(&arguments.output).chain(&arguments.stats).chain(&arguments.dump_rays) {
        umbrage_scene::check_writable(path)?;
    }
    if arguments.shard.is_some() {
        check_part_extension(&arguments.output)?;
    }
    let start = Instant::now();
    let input = read(arguments, &mut bar)?;
    let load_s = start.elapsed().as_secs_f64();
    let pool = thread_pool(arguments.threads)?;
    pool.install(|| bake_and_write(arguments, &options, input, bar, load_s))?;
    Ok(ExitCode::SUCCESS)
}

fn read(arguments: &BakeArguments, bar: &mut Bar) -> Result<Input> {
    let source = || arguments.mesh.display().to_string();
    let mesh = if let Some(level) = arguments.subdivide {
        let control = umbrage_scene::read_polygons(&arguments.mesh)?;
        subdivide::mesh_at_level(&control, level, &mut |_| bar.report(0.0))
            .map_err(surface_interrupted)
            .with_context(source)?
    } else if is_mesh(&arguments.mesh) {
        read_mesh(&arguments.mesh)?
    } else {
        let mut scene = Scene::load(&arguments.mesh)?;
        subdivide::refine_all(&mut scene, &mut |_| bar.report(0.0))
            .map_err(interrupted)
            .with_context(source)?;
        scene.flatten()
    };
    let occluders = arguments.occluder.iter().map(|path| read_mesh(path)).collect::<Result<_, _>>()?;
    let points = arguments.points.as_ref().map(|path| read_points(path)).transpose()?;
    Ok(Input { mesh, occluders, points })
}

/// Where to bake, and how to write it down.
fn receivers(arguments: &BakeArguments, input: &Input) -> Result<(Receivers, BakeTarget)> {
    let (mesh, normals) = (&input.mesh, arguments.normal_source());
    if let Some(points) = &input.points {
        let target =
            BakeTarget::Points { positions: points.positions.clone(), normals: points.normals.clone() };
        return Ok((Receivers::from_points(&points.positions, &points.normals)?, target));
    }
    match arguments.per {
        Per::Vertex => {
            // Colours that the mesh had give way to those that are baked.
            let plain = TriangleMesh { vertex_colors: Vec::new(), ..mesh.clone() };
            Ok((Receivers::vertices(mesh, normals)?, BakeTarget::Vertices(plain)))
        }
        Per::Texel => {
            let [width, height] = arguments.size.0;
            let map = TexelMap::new(mesh, width, height, VAxis::of_file(&arguments.mesh))?;
            let receivers = map.receivers(mesh, normals)?;
            let covered = map.covered();
            let at = (0..width * height)
                .filter(|&i| covered[i as usize])
                .map(|i| [i % width, i / width])
                .collect();
            Ok((receivers, BakeTarget::Texels { width, height, at, dilate: arguments.dilate }))
        }
    }
}

fn bake_and_write(
    arguments: &BakeArguments,
    options: &BakeOptions,
    input: Input,
    mut bar: Bar,
    load_s: f64,
) -> Result<()> {
    let source = || arguments.mesh.display().to_string();
    let (receivers, target) = receivers(arguments, &input).with_context(source)?;
    if arguments.shard.is_none() {
        target.check_extension(&arguments.output)?;
    }
    let shard = arguments.shard.unwrap_or(Shard::WHOLE);
    let parts = blocks(receivers.len());
    if shard.count() as usize > parts {
        return Err(ShardError::TooMany { shards: shard.count(), tiles: parts as u32 }.into());
    }
    let start = Instant::now();
    let ground = if arguments.ground { Ground::Below } else { Ground::Absent };
    let meshes: Vec<&TriangleMesh> = std::iter::once(&input.mesh).chain(&input.occluders).collect();
    let occluders = Occluders::of_meshes(&meshes, ground, &mut |_| bar.report(0.0))
        .map_err(interrupted)
        .with_context(source)?;
    engine::prepare_sky(options.method, &occluders, &mut |_| bar.report(0.0))
        .map_err(interrupted)
        .with_context(source)?;
    let build_s = start.elapsed().as_secs_f64();
    bar.check()?;
    let start = Instant::now();
    let mut ao = vec![f32::NAN; receivers.len()];
    let mut report = |f| bar.report(f);
    let mut bent = arguments.bent_normals.then(|| vec![[0.0; 3]; receivers.len()]);
    let mut run = |dump: Option<&mut dyn Write>| {
        let mut call = Bake::new(&occluders, &receivers, options).with_shard(shard);
        if let Some(out) = dump {
            call = call.with_rays_to(out);
        }
        if let Some(bent) = &mut bent {
            call = call.with_bent_normals(bent);
        }
        call.run(&mut ao, &mut report)
    };
    let spent = match &arguments.dump_rays {
        None => run(None).map_err(interrupted)?,
        Some(path) => {
            let (mut failure, mut spent) = (None, Spent::default());
            let written = umbrage_scene::write_atomically(path, |out| match run(Some(out)) {
                Ok(by_run) => {
                    spent = by_run;
                    Ok(())
                }
                Err(error) => {
                    failure = Some(error);
                    Err(std::io::ErrorKind::Other.into())
                }
            });
            match failure {
                Some(error) => return Err(interrupted(error)),
                None => written?,
            }
            spent
        }
    };
    let bake_s = start.elapsed().as_secs_f64();
    bar.check()?;
    let baked_here = ao.iter().filter(|ao| !ao.is_nan()).count();
    let baked = Baked { target, ao, bent_normals: bent };
    match arguments.shard {
        None => baked.write(&arguments.output)?,
        Some(shard) => {
            baked.write_part(&arguments.output, shard, fingerprint(arguments, options, &meshes, &baked))?
        }
    }
    if let Some(path) = &arguments.stats {
        let rays = spent.rays;
        let by_rays =
            spent.receivers.iter().map(|&(rays, count)| json!({ "rays": rays, "receivers": count }));
        let stats = json!({
            "umbrage": env!("CARGO_PKG_VERSION"),
            "mesh": source(),
            "method": options.method.name(),
            "shard": arguments.shard.map(|s| s.to_string()),
            "triangles": meshes.iter().map(|m| m.triangles.len()).sum::<usize>(),
            "receivers": baked_here,
            "rays": rays,
            "receivers_by_rays": by_rays.collect::<Vec<_>>(),
            "target_error": options.target_error,
            "estimated_error": spent.estimated_error,
            "radius": Some(options.radius.resolve(occluders.diagonal())).filter(|r| r.is_finite()),
            "threads": rayon::current_num_threads(),
            "load_s": load_s,
            "build_s": build_s,
            "bake_s": bake_s,
            "mrays_s": rays as f64 / bake_s * 1e-6,
            "ao_mean": baked.ao.iter().filter(|ao| !ao.is_nan()).map(|&ao| f64::from(ao)).sum::<f64>()
                / baked_here.max(1) as f64,
        });
        super::tools::write_json(path, &stats)?;
    }
    bar.finish();
    Ok(())
}

/// What a cancelled call means to the user.
fn interrupted(error: impl Into<BakeError>) -> anyhow::Error {
    match error.into() {
        BakeError::Cancelled => Interrupted.into(),
        other => other.into(),
    }
}

/// [`interrupted`] for a surface by itself.
fn surface_interrupted(error: SurfaceError) -> anyhow::Error {
    match error {
        SurfaceError::Cancelled => Interrupted.into(),
        other => other.into(),
    }
}

/// Everything that decides about the result.
fn fingerprint(
    arguments: &BakeArguments,
    options: &BakeOptions,
    meshes: &[&TriangleMesh],
    baked: &Baked,
) -> u64 {
    let mut fingerprint = Fingerprint::default();
    meshes.iter().for_each(|mesh| fingerprint.mesh(mesh));
    if let BakeTarget::Points { positions, normals } = &baked.target {
        fingerprint.words(positions.iter().chain(normals).flatten().map(|x| x.to_bits()));
    }
    let all = format!("{options:?} {:?} {}", arguments.normal_source(), arguments.ground);
    fingerprint.bytes(all.as_bytes());
    fingerprint.finish()
}
