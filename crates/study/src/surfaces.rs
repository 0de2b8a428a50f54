//! Camera rays over subdivision surfaces: each way to trace them, at several lengths of edges.

use super::{
    Answers, Missing, Row, StudyError, StudyOptions,
    measure::{BUDGET_ENDED, mark_pareto, quartiles},
};
use rayon::prelude::*;
use std::time::{Duration, Instant};
use umbrage_geom::{Ray, RayDifferential, sampling::sobol_2d};
use umbrage_query::{Occluders, QueryError, SurfaceMode, subdivide};
use umbrage_render::CameraRays;
use umbrage_scene::{Scene, SubdivisionRate};

/// Lengths of edges, pixels.
const EDGES: [f32; 5] = [8.0, 4.0, 2.0, 1.0, 0.5];

/// Length of edges of the surfaces that answers are held against, pixels: a half of the finest that is measured, whose error is a
/// quarter.
const REFERENCE_EDGE: f32 = 0.25;

/// Largest width of the image that edges are measured in, pixels.
const WIDTH: u32 = 320;

/// Camera rays that are compared.
const RAYS: u32 = 20_000;

/// Errors beyond so many pixels are silhouettes: the ray meets another part of the surface.
const SILHOUETTE: f64 = 4.0;

const PASSES: usize = 5;

/// Camera rays with their footprints.
type Rays = Vec<(Ray, RayDifferential)>;

/// Measures all modes that fit within `time`. An error is the difference of depth along a ray, in pixels at that depth, from
/// micropolygons of a quarter of a pixel; rays that meet another part of the surface are left out.
pub(crate) fn answer(
    control: &Scene,
    options: &StudyOptions,
    time: Duration,
    go_on: &mut (dyn FnMut() -> bool + Send),
) -> Result<Answers, StudyError> {
    let start = Instant::now();
    let mut control = control.clone();
    let settings = &mut control.settings;
    let smaller = settings.width.div_ceil(WIDTH).max(1);
    (settings.width, settings.height) =
        ((settings.width / smaller).max(1), (settings.height / smaller).max(1));
    let control = &control;
    let rays = camera_rays(control);
    let trace = |occluders: &Occluders| depths(occluders, &rays);
    let (fine, _) = built(control, SurfaceMode::Once, REFERENCE_EDGE, go_on)?;
    let truth = trace(&fine);
    drop(fine);
    let (mut rows, mut missing) = (Vec::new(), Vec::new());
    for edge in EDGES {
        for &mode in SurfaceMode::ALL {
            let settings = format!("edges of {edge} pixels");
            let known = missing.iter().any(|missing: &Missing| missing.method == mode.name());
            if !options.wants(mode.name()) || known {
                continue;
            }
            if start.elapsed() > time && !rows.is_empty() {
                let method = format!("{}, {settings}", mode.name());
                missing.push(Missing { method, reason: BUDGET_ENDED.into() });
                continue;
            }
            let (occluders, build_s) = match built(control, mode, edge, go_on) {
                Ok(built) => built,
                Err(StudyError::Query(QueryError::Unsupported { reason, .. })) => {
                    missing.push(Missing { method: mode.name().into(), reason: reason.into() });
                    continue;
                }
                Err(other) => return Err(other),
            };
            let (mut times, mut found) = (Vec::new(), Vec::new());
            while times.is_empty() || (times.len() < PASSES && start.elapsed() < time) {
                let start = Instant::now();
                found = trace(&occluders);
                times.push(start.elapsed().as_secs_f64());
                if !go_on() {
                    return Err(StudyError::Cancelled);
                }
            }
            rows.push(row((mode, edge, settings), &occluders, build_s, &times, (&found, &truth, &rays)));
        }
    }
    mark_pareto(&mut rows);
    Ok(Answers {
        question: "surfaces".into(),
        title: "Camera rays over subdivision surfaces: error of depth, pixels".into(),
        radius: None,
        receivers: rays.len(),
        mean: 0.0,
        reference_rays: 1,
        reference_standard_error: 0.0,
        reference_standard_error_of_mean: 0.0,
        rows,
        missing,
    })
}

fn camera_rays(scene: &Scene) -> Rays {
    let (width, height) = (scene.settings.width, scene.settings.height);
    let camera = CameraRays::new(&scene.camera, width, height);
    let at = |i: u32| {
        let square = sobol_2d(i, 0, 0x7375_7266);
        let (x, y) = (square.x * width as f32, square.y * height as f32);
        (camera.ray(x, y, [0.0; 2]), camera.differential(x, y, [0.0; 2]))
    };
    (0..RAYS).map(at).collect()
}

/// The scene's surfaces traced by `mode` with edges of so many pixels, and the seconds that took.
fn built(
    control: &Scene,
    mode: SurfaceMode,
    edge: f32,
    go_on: &mut (dyn FnMut() -> bool + Send),
) -> Result<(Occluders, f64), StudyError> {
    let mut scene = control.clone();
    scene.settings.surfaces = mode.name().into();
    for mesh in &mut scene.meshes {
        if let Some(subdivision) = &mut mesh.subdivision {
            subdivision.rate = SubdivisionRate::Pixels(edge);
        }
    }
    let start = Instant::now();
    subdivide::refine(&mut scene, &mut |_| go_on())?;
    let occluders = Occluders::of_scene(&scene, &mut |_| go_on())?;
    Ok((occluders, start.elapsed().as_secs_f64()))
}

fn depths(occluders: &Occluders, rays: &Rays) -> Vec<Option<f32>> {
    let depth = |(ray, differential): &(Ray, RayDifferential)| {
        occluders.closest_hit(ray, differential, &mut ()).map(|hit| hit.t)
    };
    rays.par_iter().map(depth).collect()
}

fn row(
    (mode, edge, settings): (SurfaceMode, f32, String),
    occluders: &Occluders,
    build_s: f64,
    times: &[f64],
    (found, truth, rays): (&[Option<f32>], &[Option<f32>], &Rays),
) -> Row {
    let errors = found.iter().zip(truth).zip(rays).filter_map(|((found, truth), (_, differential))| {
        let (found, truth) = (f64::from((*found)?), f64::from((*truth)?));
        let pixel = truth * f64::from(differential.d_direction[0].length());
        Some((found - truth) / pixel).filter(|error| error.abs() <= SILHOUETTE)
    });
    let errors: Vec<f64> = errors.collect();
    let n = errors.len().max(1) as f64;
    let mean_square = errors.iter().map(|e| e * e).sum::<f64>() / n;
    let [low, median, high] = quartiles(times);
    let (hierarchy, geometry) = occluders.bytes();
    let surfaces = occluders.surface_work().map_or(0, |work| work.bytes as usize);
    Row {
        method: mode.name(),
        exact: false,
        settings,
        rays: None,
        threshold: None,
        pixels: Some(edge),
        build_s,
        bytes: hierarchy + geometry + surfaces,
        time_s: median,
        time_quartiles_s: [low, high],
        passes: times.len(),
        mrays_s: rays.len() as f64 / median * 1e-6,
        bias: errors.iter().sum::<f64>() / n,
        bias_standard_error: (mean_square / n).sqrt(),
        rmse: mean_square.sqrt(),
        largest_error: errors.iter().fold(0.0, |most, e| e.abs().max(most)),
        work: None,
        pareto: false,
    }
}
