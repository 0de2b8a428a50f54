//! Pictures of each method beside the exact one with many rays, differences, and where the work is.

use super::{Answers, Missing, StudyError, Subject, curve, measure::BUDGET_ENDED};
use std::time::{Duration, Instant};
use umbrage_image::{ColorMap, Film, ValueRange, encode_png, linear_to_srgb8, names};
use umbrage_query::{AoMethod, Occluders, QueryError, ShadowMethod};
use umbrage_render::{RenderError, RenderOptions, render};
use umbrage_scene::{Ambient, Scene};

/// Largest width of pictures, pixels.
const WIDTH: u32 = 400;

/// Smallest width, however slow rays are.
const SMALLEST_WIDTH: f64 = 128.0;

/// Rays of the picture that others are held against.
const MANY_RAYS: u32 = 512;

/// Rays of a method that no row recommends.
const USUAL_RAYS: u32 = 64;

/// Differences of this size, and larger ones, have the strongest colour.
pub(crate) const STRONGEST_DIFFERENCE: f32 = 0.1;

/// Error that the settings of pictures are chosen for.
const TARGET: f64 = 0.02;

/// All pictures of a study.
#[derive(Clone, Debug)]
pub struct Pictures {
    /// What they show.
    pub title: String,
    /// Pixels across.
    pub width: u32,
    /// Pixels down.
    pub height: u32,
    /// What others are compared with: a caption and a PNG file.
    pub exact: (String, Vec<u8>),
    /// One for each method.
    pub methods: Vec<Picture>,
    /// Methods without a picture, and why.
    pub missing: Vec<Missing>,
    /// Nodes entered and triangles tested by single rays, as a PNG file, with the number that the brightest colour means.
    pub cost: Option<(Vec<u8>, f32)>,
}

/// A picture by one method.
#[derive(Clone, Debug)]
pub struct Picture {
    /// Method and settings.
    pub caption: String,
    /// A PNG file.
    pub picture: Vec<u8>,
    /// Red where it is too bright, blue where it is too dark; a PNG file.
    pub difference: Vec<u8>,
    /// Mean signed difference from the exact picture.
    pub mean_difference: f64,
    /// Root mean square difference from the exact picture.
    pub rms_difference: f64,
}

/// Renders the ambient occlusion of the study's last sky question, or shadows where there is none, by every method, for about `time`.
pub(crate) fn render_all(
    subject: &Subject,
    answers: &[Answers],
    time: Duration,
    go_on: &mut (dyn FnMut() -> bool + Send),
) -> Result<Pictures, StudyError> {
    let sky = answers.iter().rev().find(|answers| answers.radius.is_some());
    let asked = sky.or(answers.first());
    let mut scene = subject.scene().clone();
    let layer = if sky.is_some() { names::AO } else { names::SHADOW };
    if let Some(answers) = sky {
        scene.lights.clear();
        scene.ambient = Some(Ambient {
            radiance: [1.0; 3],
            radius: answers.radius.unwrap_or_default(),
            falloff: umbrage_geom::Falloff::Constant,
        });
    } else {
        scene.ambient = None;
    }
    let exact_method = if sky.is_some() { AoMethod::Rays.name() } else { ShadowMethod::Bvh.name() };
    // Of the row with the most rays.
    let speed = |a: &Answers| a.rows.iter().rfind(|row| row.method == exact_method).map(|row| row.mrays_s);
    let (width, height) = size(&scene, asked.and_then(speed).unwrap_or(1.0), time);
    let settings = &mut scene.settings;
    (settings.width, settings.height, settings.spp) = (width, height, 1);
    let start = Instant::now();
    let (exact, cost) = film(&scene, subject.occluders(), (exact_method, MANY_RAYS), true, go_on)?;
    let truth = exact.require(layer)?.values().to_vec();
    let (mut methods, mut missing) = (Vec::new(), Vec::new());
    let candidates: Vec<&'static str> = match sky {
        Some(_) => AoMethod::ALL.iter().map(|method| method.name()).collect(),
        None => ShadowMethod::ALL.iter().map(|method| method.name()).collect(),
    };
    for method in candidates {
        let rays = asked.and_then(|a| rays_for(a, method)).unwrap_or(USUAL_RAYS);
        // A slow method ends the time for pictures, not the study.
        let mut interrupted = false;
        let mut within = || {
            interrupted = !go_on();
            !interrupted && start.elapsed() < time
        };
        let reason = match film(&scene, subject.occluders(), (method, rays), false, &mut within) {
            Ok((film, _)) => {
                let values = film.require(layer)?.values();
                methods.push(picture(format!("{method}, {rays} rays"), values, &truth, [width, height])?);
                continue;
            }
            Err(StudyError::Render(RenderError::Query(QueryError::Unsupported { reason, .. }))) => reason,
            Err(StudyError::Cancelled) if !interrupted => BUDGET_ENDED,
            Err(other) => return Err(other),
        };
        missing.push(Missing { method: method.into(), reason: reason.into() });
    }
    let what = if sky.is_some() { "Ambient occlusion" } else { "Shadows" };
    Ok(Pictures {
        title: format!("{what}, {width} x {height} pixels, one camera sample a pixel"),
        width,
        height,
        exact: (format!("{exact_method}, {MANY_RAYS} rays"), grey(&truth, [width, height])?),
        methods,
        missing,
        cost,
    })
}

/// Rays for an error of [`TARGET`], of those that were measured.
fn rays_for(answers: &Answers, method: &str) -> Option<u32> {
    let own: Vec<_> = answers.rows.iter().filter(|row| row.method == method).cloned().collect();
    curve::fastest_within(&own, TARGET)?.rays
}

/// Size of pictures such that one with many rays takes a quarter of `time` if `mrays_s` million rays take a second.
fn size(scene: &Scene, mrays_s: f64, time: Duration) -> (u32, u32) {
    let shape = f64::from(scene.settings.height) / f64::from(scene.settings.width);
    let rays = time.as_secs_f64() / 4.0 * mrays_s * 1e6;
    let width = (rays / f64::from(MANY_RAYS) / shape).sqrt().clamp(SMALLEST_WIDTH, f64::from(WIDTH)) as u32;
    let width = width.min(scene.settings.width.max(16)) / 8 * 8;
    (width, ((f64::from(width) * shape) as u32).max(8))
}

/// Renders by one method, with the heat map of the work if asked for.
#[allow(clippy::type_complexity)] // the film and an encoded picture with its scale
fn film(
    scene: &Scene,
    occluders: &Occluders,
    (method, rays): (&str, u32),
    count: bool,
    go_on: &mut (dyn FnMut() -> bool + Send),
) -> Result<(Film, Option<(Vec<u8>, f32)>), StudyError> {
    let mut scene = scene.clone();
    if scene.ambient.is_some() {
        (scene.settings.ao, scene.settings.ao_samples) = (method.into(), rays);
    } else {
        (scene.settings.shadows, scene.settings.shadow_samples) = (method.into(), rays);
    }
    let options = RenderOptions::default().with_count_cost(count);
    let rendered = render(&scene, occluders, &options, &mut |_| go_on())?;
    let cost = match rendered.film.layer(names::COST) {
        Some(layer) => {
            let range = ValueRange { min: 0.0, max: ValueRange::of(layer.values()).max };
            let colors: Vec<_> =
                layer.values().iter().map(|&v| ColorMap::Viridis.color(range.position(v))).collect();
            Some((encode_png(rendered.film.width(), rendered.film.height(), &colors)?, range.max))
        }
        None => None,
    };
    Ok((rendered.film, cost))
}

fn grey(values: &[f32], [width, height]: [u32; 2]) -> Result<Vec<u8>, StudyError> {
    let pixels: Vec<[u8; 3]> = values.iter().map(|&v| [linear_to_srgb8(v); 3]).collect();
    Ok(encode_png(width, height, &pixels)?)
}

fn picture(caption: String, values: &[f32], truth: &[f32], size: [u32; 2]) -> Result<Picture, StudyError> {
    let differences: Vec<f32> = values.iter().zip(truth).map(|(a, b)| a - b).collect();
    let scaled = |d: &f32| ColorMap::Diverging.color(0.5 + 0.5 * d / STRONGEST_DIFFERENCE);
    let colors: Vec<[u8; 3]> = differences.iter().map(scaled).collect();
    let n = differences.len().max(1) as f64;
    let squares = differences.iter().map(|&d| f64::from(d).powi(2)).sum::<f64>();
    Ok(Picture {
        caption,
        picture: grey(values, size)?,
        difference: encode_png(size[0], size[1], &colors)?,
        mean_difference: differences.iter().map(|&d| f64::from(d)).sum::<f64>() / n,
        rms_difference: (squares / n).sqrt(),
    })
}
