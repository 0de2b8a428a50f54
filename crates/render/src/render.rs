//! From a scene to layers of an image, tile by tile over all threads.

use crate::{
    RenderError,
    camera::Camera,
    geometry::Geometry,
    image::{Film, GREY, RGB, ShardSpec, Tile, TileGrid, XYZ, Z, names},
    integrator::{Integrator, Pixel, RayCounts, Scratch, Sky},
    light::Light,
    method::{MASK_RASTER, SkyRays, ao_method, shadow_method},
    raster_sky,
};
use rayon::prelude::*;
use std::sync::Mutex;
use umbrage_accel::Counters;
use umbrage_geom::{Progress, glam::Vec3};
use umbrage_occlusion::volumetric::{Prepared, ShadowRays};
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
    pub shard: ShardSpec,
    /// Whether to count work for the layer `cost`; without it there is no such layer, and rays are a little faster.
    pub count_cost: bool,
}

impl Default for RenderOptions {
    fn default() -> Self {
        Self { shard: ShardSpec::WHOLE, count_cost: false }
    }
}

impl RenderOptions {
    /// Renders only the tiles of `shard`.
    #[must_use]
    pub fn with_shard(self, shard: ShardSpec) -> Self {
        Self { shard, ..self }
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
    /// Names of the methods that were used for shadows and ambient occlusion, and why.
    pub methods: [(&'static str, &'static str); 2],
}

/// Checks sample counts and method names, which the command line can set as well as a scene file.
///
/// # Errors
/// [`RenderError::Count`], [`RenderError::Method`].
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
    // Sample numbers are 32 bits wide.
    let most = u64::from(u32::MAX / settings.spp);
    for (what, value) in &counts[1..] {
        if u64::from(*value) > most {
            return Err(RenderError::Count { what, value: (*value).into(), limit: most });
        }
    }
    crate::method::check_names(settings)
}

/// Renders `scene`, whose triangles are in `geometry`, on the threads of the current `rayon` pool.
///
/// The same bits come out for any number of threads and any partition into shards.
///
/// # Errors
/// [`RenderError::Count`], [`RenderError::Method`], [`RenderError::Image`], [`RenderError::Cancelled`].
pub fn render(
    scene: &Scene,
    geometry: &Geometry,
    options: &RenderOptions,
    report: &mut (dyn FnMut(f32) -> bool + Send),
) -> Result<Rendered, RenderError> {
    let settings = &scene.settings;
    check_settings(settings)?;
    let grid = TileGrid::new(settings.width, settings.height, TILE)?;
    let tiles: Vec<u32> = options.shard.tiles(&grid).map_err(crate::image::ImageError::from)?.collect();
    let bounds = geometry.bounds();
    let lights: Vec<Light> = scene.lights.iter().map(Light::new).collect();
    let places: Vec<Vec3> = lights.iter().filter_map(|light| light.place(&bounds)).collect();
    let samples: f64 = lights.iter().map(|light| f64::from(light.samples(settings.shadow_samples))).sum();
    let points = f64::from(settings.width) * f64::from(settings.height) * f64::from(settings.spp);
    let together = samples / lights.len().max(1) as f64;
    let rays = ShadowRays { lights: &places, count: points * samples, together };
    let shadows = shadow_method(&settings.shadows, geometry, &rays)?;
    let sky = scene.ambient.as_ref().map(|ambient| SkyRays {
        samples: settings.ao_samples,
        radius: ambient.radius.resolve(geometry.bounds().diagonal()),
        falloff: ambient.falloff.clone(),
        seed: settings.seed,
    });
    let ambient = ao_method(&settings.ao, geometry, sky.as_ref())?;
    let mut integrator = Integrator {
        camera: Camera::new(&scene.camera, settings.width, settings.height),
        geometry,
        lights,
        sky: scene.ambient.as_ref().zip(sky.clone()).map(|(ambient, sky)| Sky {
            radiance: ambient.radiance.into(),
            radius: sky.radius,
            falloff: sky.falloff,
        }),
        background: Vec3::from(scene.background),
        shadows: &*shadows.method,
        ambient: &*ambient.method,
        spp: settings.spp,
        shadow_samples: settings.shadow_samples,
        ao_samples: settings.ao_samples,
        seed: settings.seed,
        count_cost: options.count_cost,
        open: Vec::new(),
        width: settings.width,
    };
    if let (MASK_RASTER, Some(sky)) = (settings.ao.as_str(), &sky) {
        integrator.open =
            raster_sky::openness(&integrator, geometry, sky, [settings.width, settings.height])?;
    }
    let target = Mutex::new(Target::new(settings, options.count_cost)?);
    let progress = Progress::new(tiles.len() as u64, report);
    tiles.par_iter().try_for_each(|&index| {
        progress.check()?;
        let tile = grid.tile(index);
        let mut scratch = Scratch::default();
        let places: Vec<(u32, u32)> =
            (tile.y..tile.y_end).flat_map(|y| (tile.x..tile.x_end).map(move |x| (x, y))).collect();
        integrator.open_pixels(&places, &mut scratch);
        let pixels: Vec<Pixel> =
            places.into_iter().map(|(x, y)| integrator.pixel(x, y, &mut scratch)).collect();
        target.lock().unwrap_or_else(|poisoned| poisoned.into_inner()).put(&tile, &pixels, &scratch);
        progress.advance(1)
    })?;
    progress.finish()?;
    let target = target.into_inner().unwrap_or_else(|poisoned| poisoned.into_inner());
    Ok(Rendered {
        film: target.film,
        rays: target.rays,
        counters: options.count_cost.then_some(target.counters),
        occluders: shadows.method.prepared(),
        methods: [shadows, ambient].map(|choice| (choice.method.name(), choice.reason)),
    })
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
