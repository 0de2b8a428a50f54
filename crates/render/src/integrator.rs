//! What one pixel shows: direct light with soft shadows, and a sky dimmed by ambient occlusion.

use crate::{camera::CameraRays, light::LightSampler};
use umbrage_accel::Counters;
use umbrage_aomask::{Outputs, Pattern, Receiver};
use umbrage_geom::{
    Progress, Ray, RayDifferential,
    glam::{Vec2, Vec3},
    offset_origin,
    sampling::{combine, concentric_disc, pixel_seed, sobol_2d, sobol_4d, unit},
};
use umbrage_query::{Answers, Engine, LightRay, Occluders, Pilot, QueryError, ShadingPoint};

/// Semi-transparent surfaces that a camera ray may pass before it gives up.
const MAX_CAMERA_SURFACES: u32 = 1000;

/// Keeps the seeds of sky rays apart from those of lights.
const SKY_SALT: u32 = 1;

/// Distance reported where nothing is seen: what Blender and Nuke users expect of a depth layer.
pub const NO_DEPTH: f32 = 1e10;

/// Rays traced, by purpose.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct RayCounts {
    /// From the camera, those behind semi-transparent surfaces included.
    pub camera: u64,
    /// To lights.
    pub shadow: u64,
    /// Into the sky.
    pub ambient: u64,
}

impl std::ops::AddAssign for RayCounts {
    fn add_assign(&mut self, other: Self) {
        self.camera += other.camera;
        self.shadow += other.shadow;
        self.ambient += other.ambient;
    }
}

/// The sky as the integrator needs it.
#[derive(Clone)]
pub(crate) struct SkySampling {
    pub radiance: Vec3,
    /// World units; may be infinite.
    pub radius: f32,
    /// The rays of a camera sample's receiver.
    pub pattern: Pattern,
}

/// Everything a pixel depends on.
#[derive(Clone)]
pub(crate) struct Integrator<'a> {
    pub camera: CameraRays,
    pub occluders: &'a Occluders,
    pub lights: Vec<LightSampler>,
    pub sky: Option<SkySampling>,
    pub background: Vec3,
    /// Answers rays to lights, if there are any.
    pub shadows: Option<&'a dyn Engine>,
    /// Answers the sky, if there is one.
    pub ambient: Option<&'a dyn Engine>,
    pub spp: u32,
    pub shadow_samples: u32,
    pub ao_samples: u32,
    pub seed: u32,
    /// Other rays to lights and sky from the same surfaces, unless 0.
    pub salt: u32,
    pub count_cost: bool,
    /// Openness of the sky by camera sample and pixel (row by row of `width`), where it is known beforehand.
    pub open: Vec<Vec<f32>>,
    /// Pixels across.
    pub width: u32,
}

/// Values of one pixel, in the layers' own meaning.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Pixel {
    pub beauty: Vec3,
    pub shadow: f32,
    pub ao: f32,
    pub normal: Vec3,
    pub depth: f32,
    pub cost: f32,
    /// Whether some sample sees a surface.
    pub seen: bool,
    /// Whether light would reach one if nothing were in the way.
    pub lit: bool,
}

/// Buffers reused from pixel to pixel, and what was counted.
#[derive(Default)]
pub(crate) struct Scratch<'e> {
    /// [`Engine::for_tile`] of the shadows' engine, and of the sky's.
    shadows: Option<Box<dyn Engine + 'e>>,
    ambient: Option<Box<dyn Engine + 'e>>,
    squares: Vec<Vec2>,
    rays: Vec<LightRay>,
    /// Unshadowed irradiance that each ray stands for, cosine included.
    arriving: Vec<Vec3>,
    passed: Vec<f32>,
    /// Index of the pixel at work.
    pixel: usize,
    /// Openness of the sky by pixel and camera sample, where [`Integrator::open_pixels`] knows it.
    open: Vec<f32>,
    /// Which of those pixels is at work.
    slot: u32,
    pub counts: RayCounts,
    pub counters: Counters,
    /// The first call that failed; the pixels are of no use then.
    pub failed: Option<QueryError>,
}

#[derive(Default)]
struct Sums {
    beauty: Vec3,
    /// Luminance that reaches the surfaces, with and without shadows.
    lit: [f32; 2],
    ao: f32,
    normal: Vec3,
    depth: f32,
    hits: u32,
}

/// The layer `cost`: nodes entered and triangles tested.
fn work(counters: &Counters) -> u64 {
    counters.nodes + counters.triangle_tests
}

fn luminance(c: Vec3) -> f32 {
    c.dot(Vec3::new(0.2126, 0.7152, 0.0722))
}

/// Where rays leave a surface.
fn origin_on(surface: &ShadingPoint) -> Vec3 {
    let n = surface.geometric_normal;
    offset_origin(surface.point, n, n, surface.magnitude)
}

impl<'e> Integrator<'e> {
    /// What the pixels of one tile need.
    pub fn scratch(&self) -> Scratch<'e> {
        let for_tile = |engine: Option<&'e dyn Engine>| engine?.for_tile(self.count_cost);
        Scratch { shadows: for_tile(self.shadows), ambient: for_tile(self.ambient), ..Scratch::default() }
    }

    /// Asks the ambient method about all receivers of `pixels`, if it answers receivers; [`Self::pixel`] is then called with
    /// the same pixels in the same order. `progress` is asked whether to go on.
    pub fn open_pixels(&self, pixels: &[(u32, u32)], scratch: &mut Scratch, progress: &Progress<'_>) {
        scratch.open.clear();
        let Some(ambient) = self.ambient.filter(|ambient| ambient.answers() == Answers::Receivers) else {
            return;
        };
        let (mut receivers, mut slots) = (Vec::new(), Vec::new());
        let mut uncounted = Scratch::default();
        for (slot, &(x, y)) in pixels.iter().enumerate() {
            for sample in 0..self.spp {
                if let Some(receiver) = self.seen_receiver(slot, x, y, sample, &mut uncounted) {
                    receivers.push(receiver);
                    slots.push(slot * self.spp as usize + sample as usize);
                }
            }
        }
        let mut open = vec![1.0; receivers.len()];
        if let Err(error) =
            ambient.sky(&receivers, Outputs::new(&mut open), &mut |_| progress.check().is_ok())
        {
            scratch.failed = Some(error);
        }
        scratch.open.resize(pixels.len() * self.spp as usize, 1.0);
        slots.into_iter().zip(open).for_each(|(slot, open)| scratch.open[slot] = open);
        scratch.slot = 0;
    }

    /// Who asks about the sky where `sample` of pixel (`x`, `y`) meets a surface.
    fn seen_receiver(
        &self,
        index: usize,
        x: u32,
        y: u32,
        sample: u32,
        scratch: &mut Scratch,
    ) -> Option<Receiver> {
        let (origin, normal) = self.receiver(x, y, sample, scratch)?;
        self.sky_receiver(index, origin, normal, sample, pixel_seed(x, y, self.seed))
    }

    /// A sample of those who ask over the whole image of `height` rows, whatever part of it is rendered.
    pub fn pilot(&self, height: u32) -> Pilot {
        let mut uncounted = Scratch::default();
        let (width, spp) = (self.width as usize, self.spp as usize);
        let of = width * height as usize * spp;
        let receiver = |index: usize| {
            let (pixel, sample) = (index / spp, (index % spp) as u32);
            self.seen_receiver(index, (pixel % width) as u32, (pixel / width) as u32, sample, &mut uncounted)
        };
        Pilot::new(Pilot::indices(of).filter_map(receiver).collect(), of)
    }

    /// Computes pixel (`x`, `y`).
    pub fn pixel(&self, x: u32, y: u32, scratch: &mut Scratch) -> Pixel {
        let seed = pixel_seed(x, y, self.seed);
        let mut sums = Sums::default();
        let before = work(&scratch.counters);
        scratch.pixel = (y * self.width + x) as usize;
        for sample in 0..self.spp {
            let ray = self.camera_ray(x, y, sample, seed);
            match self.visible_surface(&ray, combine(seed, sample), scratch) {
                Some(surface) => self.shade(&surface, sample, seed, scratch, &mut sums),
                None => sums.beauty += self.background,
            }
        }
        scratch.slot += 1;
        let samples = self.spp as f32;
        let hits = sums.hits as f32;
        let cost = work(&scratch.counters) - before;
        Pixel {
            beauty: sums.beauty / samples,
            shadow: if sums.lit[1] > 0.0 { sums.lit[0] / sums.lit[1] } else { 1.0 },
            ao: if sums.hits > 0 { sums.ao / hits } else { 1.0 },
            normal: sums.normal.normalize_or_zero(),
            depth: if sums.hits > 0 { sums.depth / hits } else { NO_DEPTH },
            cost: cost as f32 / samples,
            seen: sums.hits > 0,
            lit: sums.lit[1] > 0.0,
        }
    }

    /// Who asks about the sky at `origin`: the rays of a pixel's samples are spread evenly.
    fn sky_receiver(
        &self,
        index: usize,
        origin: Vec3,
        normal: Vec3,
        sample: u32,
        seed: u32,
    ) -> Option<Receiver> {
        let seed = combine(self.salted(seed), SKY_SALT);
        let receiver = Receiver::new(index, origin.to_array(), normal.to_array(), seed).ok()?;
        Some(receiver.with_sample(sample))
    }

    fn salted(&self, seed: u32) -> u32 {
        if self.salt == 0 { seed } else { combine(seed, self.salt) }
    }

    /// The ray of a camera sample, and how it differs from those of neighbouring pixels where subdivision surfaces ask.
    fn camera_ray(&self, x: u32, y: u32, sample: u32, seed: u32) -> (Ray, RayDifferential) {
        let [dx, dy, lens_x, lens_y] = sobol_4d(sample, 0, seed);
        let lens = concentric_disc(Vec2::new(lens_x, lens_y)).to_array();
        let (x, y) = (x as f32 + dx, y as f32 + dy);
        let differential = match self.occluders.has_surfaces() {
            true => self.camera.differential(x, y, lens),
            false => RayDifferential::default(),
        };
        (self.camera.ray(x, y, lens), differential)
    }

    /// Origin of ambient rays and shading normal where `sample` of pixel (`x`, `y`) meets a surface.
    pub fn receiver(&self, x: u32, y: u32, sample: u32, scratch: &mut Scratch) -> Option<(Vec3, Vec3)> {
        let seed = pixel_seed(x, y, self.seed);
        let ray = self.camera_ray(x, y, sample, seed);
        let surface = self.visible_surface(&ray, combine(seed, sample), scratch)?;
        Some((origin_on(&surface), surface.shading_normal))
    }

    /// The surface that a camera ray shows: a semi-transparent one counts with the probability of its opacity.
    fn visible_surface(
        &self,
        (ray, differential): &(Ray, RayDifferential),
        seed: u32,
        scratch: &mut Scratch,
    ) -> Option<ShadingPoint> {
        let mut rest = *ray;
        for layer in 0..MAX_CAMERA_SURFACES {
            scratch.counts.camera += 1;
            let surface = if self.count_cost {
                self.occluders.closest_hit(&rest, differential, &mut scratch.counters)?
            } else {
                self.occluders.closest_hit(&rest, differential, &mut ())?
            };
            if surface.opacity >= 1.0 || unit(combine(seed, layer)) < surface.opacity {
                return Some(surface);
            }
            // `t` is rounded, by less than one unit in the last place: the next number is beyond the surface.
            rest.tnear = surface.t.next_up();
        }
        None
    }

    fn shade(&self, surface: &ShadingPoint, sample: u32, seed: u32, scratch: &mut Scratch, sums: &mut Sums) {
        let origin = origin_on(surface);
        let mut irradiance = Vec3::ZERO;
        for (number, light) in self.lights.iter().enumerate() {
            irradiance += self.direct(light, number as u32, origin, surface, sample, seed, scratch, sums);
        }
        let mut radiance = irradiance * std::f32::consts::FRAC_1_PI;
        let mut open = 1.0;
        if let Some(sky) = &self.sky {
            open = self.openness(sky, origin, surface, sample, seed, scratch);
            radiance += sky.radiance * open;
        }
        sums.beauty += radiance * surface.albedo;
        sums.ao += open;
        sums.normal += surface.shading_normal;
        sums.depth += surface.t;
        sums.hits += 1;
    }

    /// Irradiance from one light, shadowed.
    #[allow(clippy::too_many_arguments)] // all of them vary from call to call
    fn direct(
        &self,
        light: &LightSampler,
        number: u32,
        origin: Vec3,
        surface: &ShadingPoint,
        sample: u32,
        seed: u32,
        scratch: &mut Scratch,
        sums: &mut Sums,
    ) -> Vec3 {
        let samples = light.samples(self.shadow_samples);
        let Scratch { squares, rays, arriving, .. } = scratch;
        squares.clear();
        let seed = self.salted(seed);
        squares.extend((0..samples).map(|i| sobol_2d(sample * samples + i, number, seed)));
        rays.clear();
        arriving.clear();
        light.sample(origin, squares, &mut |_, incoming| {
            let cosine = surface.shading_normal.dot(incoming.direction);
            if cosine <= 0.0 || surface.geometric_normal.dot(incoming.direction) <= 0.0 {
                return;
            }
            let tfar = if incoming.distant { f32::INFINITY } else { 1.0 };
            let ray = Ray::new(origin, incoming.to_light).with_tfar(tfar);
            rays.push(LightRay::new(ray, incoming.solid_angle).with_width(surface.width));
            arriving.push(incoming.irradiance * cosine);
        });
        scratch.counts.shadow += scratch.rays.len() as u64;
        self.trace(Some(number as usize), scratch);
        let mut received = Vec3::ZERO;
        for (&arriving, &passed) in scratch.arriving.iter().zip(&scratch.passed) {
            received += arriving * passed;
            sums.lit[0] += luminance(arriving) * passed;
            sums.lit[1] += luminance(arriving);
        }
        received
    }

    /// Mean transmittance towards the sky: `ao`, 1 is open.
    fn openness(
        &self,
        sky: &SkySampling,
        origin: Vec3,
        surface: &ShadingPoint,
        sample: u32,
        seed: u32,
        scratch: &mut Scratch,
    ) -> f32 {
        if let Some(open) = self.open.get(sample as usize) {
            scratch.counts.ambient += u64::from(self.ao_samples);
            return open[scratch.pixel];
        }
        if let Some(&open) = scratch.open.get((scratch.slot * self.spp + sample) as usize) {
            scratch.counts.ambient += u64::from(self.ao_samples);
            return open;
        }
        scratch.rays.clear();
        if let Some(receiver) = self.sky_receiver(0, origin, surface.shading_normal, sample, seed) {
            let directions = sky.pattern.directions(sky.pattern.member_of(&receiver));
            let rays = sky.pattern.rays_of(&receiver, sky.radius).zip(directions);
            let ray = |(ray, &d)| LightRay::new(ray, sky.pattern.solid_angle(d)).with_width(surface.width);
            scratch.rays.extend(rays.map(ray));
        }
        scratch.counts.ambient += scratch.rays.len() as u64;
        self.trace(None, scratch);
        if scratch.passed.is_empty() {
            return 1.0;
        }
        scratch.passed.iter().sum::<f32>() / scratch.passed.len() as f32
    }

    /// Asks the rays in `scratch`, which go to a light, or to the sky.
    fn trace(&self, light: Option<usize>, scratch: &mut Scratch) {
        scratch.passed.clear();
        scratch.passed.resize(scratch.rays.len(), 1.0);
        let counters = self.count_cost.then_some(&mut scratch.counters);
        let engine = match light {
            Some(_) => scratch.shadows.as_deref().or(self.shadows),
            None => scratch.ambient.as_deref().or(self.ambient),
        };
        if let Some(engine) = engine
            && let Err(error) = engine.transmittances(&scratch.rays, light, &mut scratch.passed, counters)
        {
            scratch.failed = Some(error);
        }
    }
}
