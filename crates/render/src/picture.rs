//! From a scene to layers of an image, tile by tile over all threads.

use crate::{
    RenderError,
    camera::CameraRays,
    integrator::{Integrator, Pixel, RayCounts, Scratch, SkySampling},
    light::LightSampler,
    raster_sky,
    target::{self, Samples},
};
use rayon::prelude::*;
use std::sync::Mutex;
use umbrage_accel::Counters;
use umbrage_aomask::{Pattern, PatternOptions};
use umbrage_geom::{Progress, glam::Vec3};
use umbrage_image::{Film, GREY, RGB, Shard, Tile, TileGrid, XYZ, Z, names};
use umbrage_occlusion::volumetric::{Prepared, ShadowRays};
use umbrage_query::{
    AoMethod, Engine, Exactness, Occluders, QueryError, SceneKind, Selection, ShadowMethod, Sky, SurfaceMode,
    plan,
};
use umbrage_scene::{Scene, Settings};

/// Pixels along each side of a tile, the unit of parallel work and of shards.
pub const TILE: u32 = 32;

/// Most camera, shadow or ambient samples a pixel.
pub const MAX_SAMPLES: u32 = 1 << 20;

/// What to render of a scene, beside its own settings.
#[derive(Clone, Copy, Debug)]
#[non_exhaustive]
pub struct RenderOptions {
    /// Which tiles to render; the others stay 0.
    pub shard: Shard,
    /// Whether to count work for the layer `cost`; without it there is no such layer, and rays are a little faster.
    pub count_cost: bool,
    /// Root mean square error of the layers `shadow` and `ao` to aim at, more than 0: numbers of samples are chosen by pilot pixels
    /// in place of those of the scene ([`crate::Samples`]). For exact methods.
    pub target_error: Option<f32>,
}

impl Default for RenderOptions {
    fn default() -> Self {
        Self { shard: Shard::WHOLE, count_cost: false, target_error: None }
    }
}

impl RenderOptions {
    /// Renders only the tiles of `shard`.
    #[must_use]
    pub fn with_shard(self, shard: Shard) -> Self {
        Self { shard, ..self }
    }

    /// Sets [`Self::target_error`].
    #[must_use]
    pub fn with_target_error(self, target_error: Option<f32>) -> Self {
        Self { target_error, ..self }
    }

    /// Sets whether work is counted.
    #[must_use]
    pub fn with_count_cost(self, count_cost: bool) -> Self {
        Self { count_cost, ..self }
    }
}

/// A finished picture.
#[derive(Debug)]
pub struct Rendered {
    /// Layers `beauty`, `shadow`, `ao`, `normal`, `depth` and, if asked for, `cost`.
    pub film: Film,
    /// Rays traced.
    pub rays: RayCounts,
    /// Work done, if counted.
    pub counters: Option<Counters>,
    /// Occluders that were made for shadow rays, by methods that have them.
    pub occluders: Option<Prepared>,
    /// What answered shadow rays, and why.
    pub shadows: MethodUsed,
    /// What answered the sky, and why.
    pub ao: MethodUsed,
    /// Samples that were chosen for a target error.
    pub samples: Option<Samples>,
}

/// The method that answered one kind of ray.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MethodUsed {
    /// Its name; `None` if nothing was asked.
    pub name: Option<&'static str>,
    /// Why it was taken, or why nothing was asked.
    pub reason: &'static str,
}

impl MethodUsed {
    fn new(choice: Option<&plan::Choice<'_>>, nothing: &'static str) -> Self {
        match choice {
            Some(choice) => Self { name: Some(choice.engine.name()), reason: choice.reason },
            None => Self { name: None, reason: nothing },
        }
    }
}

/// Checks sample counts and method names, which the command line can set as well as a scene file.
///
/// # Errors
/// [`RenderError::Count`]; [`RenderError::Query`] for a method that does not exist.
pub fn check_settings(settings: &Settings) -> Result<(), RenderError> {
    let counts = [
        ("spp", settings.spp),
        ("shadow_samples", settings.shadow_samples),
        ("ao_samples", settings.ao_samples),
    ];
    for (what, value) in counts {
        if value == 0 || value > MAX_SAMPLES {
            return Err(RenderError::Count { what, value: value.into(), limit: MAX_SAMPLES.into() });
        }
    }
    if settings.ao_samples > Pattern::MAX_RAYS {
        let (what, value, limit) = ("ao_samples", settings.ao_samples.into(), Pattern::MAX_RAYS.into());
        return Err(RenderError::Count { what, value, limit });
    }
    // Sample numbers are 32 bits wide.
    let most = u64::from(u32::MAX / settings.spp);
    for (what, value) in &counts[1..] {
        if u64::from(*value) > most {
            return Err(RenderError::Count { what, value: (*value).into(), limit: most });
        }
    }
    selections(settings)?;
    settings.surfaces.parse::<SurfaceMode>()?;
    Ok(())
}

/// The methods that the settings name.
fn selections(settings: &Settings) -> Result<(Selection<ShadowMethod>, Selection<AoMethod>), RenderError> {
    Ok((settings.shadows.parse()?, settings.ao.parse()?))
}

/// Renders `scene`, whose triangles are in `occluders`, on the threads of the current `rayon` pool.
///
/// The same bits come out for any number of threads and any partition into shards. `report` gets 0 while structures are made,
/// then growing fractions that end at exactly 1; it returns `false` to cancel.
///
/// # Errors
/// [`RenderError::Count`], [`RenderError::Query`], [`RenderError::Image`], [`RenderError::Cancelled`].
pub fn render(
    scene: &Scene,
    occluders: &Occluders,
    options: &RenderOptions,
    report: &mut (dyn FnMut(f32) -> bool + Send),
) -> Result<Rendered, RenderError> {
    let mut settings = scene.settings.clone();
    check_settings(&settings)?;
    let grid = TileGrid::new(settings.width, settings.height, TILE)?;
    let tiles: Vec<u32> = options.shard.tiles(&grid).map_err(umbrage_image::ImageError::from)?.collect();
    let lights: Vec<LightSampler> = scene.lights.iter().map(LightSampler::new).collect();
    let samples = match options.target_error {
        Some(target) => {
            let samples = choose_samples(scene, &lights, occluders, target, &mut |_| report(0.0))?;
            (settings.shadow_samples, settings.ao_samples) = (samples.shadow, samples.ao);
            Some(samples)
        }
        None => None,
    };
    let settings = &settings;
    let shadows = choose_shadows(settings, &lights, occluders, &mut |_| report(0.0))?;
    let mut sky = sky_query(scene, settings, occluders);
    let asked = selections(settings)?.1;
    if let (Some(sky), Selection::Method(method)) = (&mut sky, asked)
        && method.wants_pilot()
    {
        let camera = integrator(scene, settings, (Vec::new(), occluders), None, [None, None])?;
        sky.pilot = camera.pilot(settings.height);
    }
    let ambient = match &sky {
        Some(sky) => Some(plan::sky(asked, occluders, sky, &mut |_| report(0.0))?),
        None => None,
    };
    let engines = [&shadows, &ambient].map(|choice| choice.as_ref().map(|choice| &*choice.engine));
    let mut integrator = integrator(scene, settings, (lights, occluders), sky.as_ref(), engines)?;
    integrator.count_cost = options.count_cost;
    if let Some(engine) = integrator.ambient {
        let size = [settings.width, settings.height];
        integrator.open = raster_sky::openness(&integrator, engine, size, &mut |_| report(0.0))?;
    }
    if options.count_cost {
        engines.into_iter().flatten().for_each(Engine::prepare_all);
    }
    let target = Mutex::new(Target::new(settings, options.count_cost)?);
    let progress = Progress::new(tiles.len() as u64, report);
    tiles.par_iter().try_for_each(|&index| {
        progress.check()?;
        let tile = grid.tile(index);
        let mut scratch = integrator.scratch();
        let places: Vec<(u32, u32)> =
            (tile.y..tile.y_end).flat_map(|y| (tile.x..tile.x_end).map(move |x| (x, y))).collect();
        integrator.open_pixels(&places, &mut scratch, &progress);
        let pixels: Vec<Pixel> =
            places.into_iter().map(|(x, y)| integrator.pixel(x, y, &mut scratch)).collect();
        if let Some(error) = scratch.failed.take() {
            return Err(RenderError::from(error));
        }
        target.lock().unwrap_or_else(|poisoned| poisoned.into_inner()).put(&tile, &pixels, &scratch);
        Ok(progress.advance(1)?)
    })?;
    progress.finish()?;
    let target = target.into_inner().unwrap_or_else(|poisoned| poisoned.into_inner());
    Ok(Rendered {
        film: target.film,
        rays: target.rays,
        counters: options.count_cost.then_some(target.counters),
        occluders: shadows.as_ref().and_then(|choice| choice.engine.prepared()),
        shadows: MethodUsed::new(shadows.as_ref(), "the scene has no lights"),
        ao: MethodUsed::new(ambient.as_ref(), "the scene has no ambient light"),
        samples,
    })
}

/// What pixels depend on, without work counted and anything known of the sky.
fn integrator<'a>(
    scene: &Scene,
    settings: &Settings,
    (lights, occluders): (Vec<LightSampler>, &'a Occluders),
    sky: Option<&Sky>,
    [shadows, ambient]: [Option<&'a dyn Engine>; 2],
) -> Result<Integrator<'a>, RenderError> {
    let sky = match scene.ambient.as_ref().zip(sky) {
        Some((ambient, sky)) => Some(SkySampling {
            radiance: ambient.radiance.into(),
            radius: sky.radius,
            pattern: Pattern::new(&sky.pattern).map_err(QueryError::from)?,
        }),
        None => None,
    };
    Ok(Integrator {
        camera: CameraRays::new(&scene.camera, settings.width, settings.height),
        occluders,
        lights,
        sky,
        background: Vec3::from(scene.background),
        shadows,
        ambient,
        spp: settings.spp,
        shadow_samples: settings.shadow_samples,
        ao_samples: settings.ao_samples,
        seed: settings.seed,
        salt: 0,
        count_cost: false,
        open: Vec::new(),
        width: settings.width,
    })
}

/// Finds the numbers of samples for a target error.
fn choose_samples(
    scene: &Scene,
    lights: &[LightSampler],
    occluders: &Occluders,
    target: f32,
    progress: &mut (dyn FnMut(f32) -> bool + Send),
) -> Result<Samples, RenderError> {
    if target.is_nan() || target <= 0.0 {
        return Err(RenderError::TargetError("it has to be more than 0"));
    }
    let (shadow_method, ao_method) = selections(&scene.settings)?;
    let exact = |exactness: Exactness| exactness == Exactness::Exact;
    if matches!(shadow_method, Selection::Method(method) if !exact(method.exactness()))
        || matches!(ao_method, Selection::Method(method) if !exact(method.exactness()))
    {
        return Err(RenderError::TargetError("approximate methods have errors that more samples don't mend"));
    }
    let pilots = target::pilots(scene.settings.width, scene.settings.height);
    let mut measure = |settings: &Settings, layer: usize| {
        // Only one of the layers costs rays.
        let lights = if layer == 0 { lights.to_vec() } else { Vec::new() };
        let shadows = choose_shadows(settings, &lights, occluders, progress)?;
        let sky = if layer == 1 { sky_query(scene, settings, occluders) } else { None };
        let ambient = match &sky {
            Some(sky) => Some(plan::sky(ao_method, occluders, sky, progress)?),
            None => None,
        };
        let engines = [&shadows, &ambient].map(|choice| choice.as_ref().map(|choice| &*choice.engine));
        let base = integrator(scene, settings, (lights, occluders), sky.as_ref(), engines)?;
        Ok(target::squared_errors(|salt| Integrator { salt, ..base.clone() }, &pilots, &mut |_| {
            progress(0.0)
        })?[layer])
    };
    let with = |shadow_samples, ao_samples| Settings { shadow_samples, ao_samples, ..scene.settings.clone() };
    let (shadow, shadow_error) = match lights.is_empty() {
        true => (1, None),
        false => target::choose(target, 1, |n| measure(&with(n, 8), 0))?,
    };
    let (ao, ao_error) = match &scene.ambient {
        None => (8, None),
        Some(_) => target::choose(target, 8, |n| measure(&with(1, n), 1))?,
    };
    Ok(Samples { shadow, ao, shadow_error, ao_error })
}

/// The shadow method of a scene, if it has lights.
fn choose_shadows<'a>(
    settings: &Settings,
    lights: &[LightSampler],
    occluders: &'a Occluders,
    progress: &mut (dyn FnMut(f32) -> bool + Send),
) -> Result<Option<plan::Choice<'a>>, RenderError> {
    if lights.is_empty() {
        return Ok(None);
    }
    let bounds = occluders.bounds();
    let places: Vec<Vec3> = lights.iter().filter_map(|light| light.place(&bounds)).collect();
    let samples: f64 = lights.iter().map(|light| f64::from(light.samples(settings.shadow_samples))).sum();
    let points = f64::from(settings.width) * f64::from(settings.height) * f64::from(settings.spp);
    let together = samples / lights.len() as f64;
    let rays = ShadowRays { lights: &places, count: points * samples, together };
    Ok(Some(plan::shadows(selections(settings)?.0, occluders, &rays, progress)?))
}

/// What the ambient rays of a scene have in common, if it has an ambient light.
fn sky_query(scene: &Scene, settings: &Settings, occluders: &Occluders) -> Option<Sky> {
    let ambient = scene.ambient.as_ref()?;
    let pattern = PatternOptions::default()
        .with_rays(settings.ao_samples)
        .with_falloff(ambient.falloff.clone())
        .with_seed(settings.seed);
    let view = SceneKind::of_scene(scene).view;
    Some(Sky::new(pattern, ambient.radius.resolve(occluders.diagonal())).with_view(view))
}

struct Target {
    film: Film,
    rays: RayCounts,
    counters: Counters,
}

/// The layers that a film gets, with how a pixel fills them.
type Fill = fn(&Pixel, &mut Vec<f32>);
const LAYERS: [(&str, &[&str], Fill); 6] = [
    (names::BEAUTY, RGB, |p, out| out.extend(p.beauty.to_array())),
    (names::SHADOW, GREY, |p, out| out.push(p.shadow)),
    (names::AO, GREY, |p, out| out.push(p.ao)),
    (names::NORMAL, XYZ, |p, out| out.extend(p.normal.to_array())),
    (names::DEPTH, Z, |p, out| out.push(p.depth)),
    (names::COST, GREY, |p, out| out.push(p.cost)),
];

impl Target {
    fn new(settings: &Settings, count_cost: bool) -> Result<Self, RenderError> {
        let mut film = Film::new(settings.width, settings.height)?;
        for (name, channels, _) in LAYERS {
            if name != names::COST || count_cost {
                film.add_layer(name, channels)?;
            }
        }
        Ok(Self { film, rays: RayCounts::default(), counters: Counters::default() })
    }

    fn put(&mut self, tile: &Tile, pixels: &[Pixel], scratch: &Scratch) {
        // `cost`, the last, is left out of films without it.
        for (layer, (_, _, fill)) in LAYERS.iter().enumerate().take(self.film.layers().len()) {
            let mut values = Vec::with_capacity(3 * pixels.len());
            pixels.iter().for_each(|pixel| fill(pixel, &mut values));
            self.film.put_tile(layer, tile, &values);
        }
        self.rays += scratch.counts;
        self.counters += scratch.counters;
    }
}
