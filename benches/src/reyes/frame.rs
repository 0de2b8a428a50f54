//! One image: camera rays, and shadow rays to area lights.

use super::scenes::{Light, Scene, View, shadow};
use anyhow::Result;
use std::{sync::Arc, time::Instant};
use umbrage_accel::{BuildOptions, Bvh, FAN};
use umbrage_geom::{
    Ray, TriangleMesh,
    glam::{Vec2, Vec3},
    offset_origin,
    sampling::{combine, hash, pixel_seed, unit},
};
use umbrage_reyes::{
    EyeRates, RatedSurface, Surface, SurfaceOptions, SurfaceTracer, TraceOptions, TraceState, published,
};

/// How shadow rays are traced.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Shadows {
    /// From the surface, as wide there as the pixel.
    FromPixel,
    /// From the surface, where all rays of a point start with no width.
    FromPoint,
    /// The same, patches near the light first.
    Deferred,
    /// From the light, converging on the point.
    Backward,
}

/// What is rendered.
#[derive(Clone, Copy)]
pub struct Setting<'a> {
    pub view: View,
    pub lights: &'a [Light],
    /// Strata of each light.
    pub strata: [u32; 2],
    pub shadows: Shadows,
}

/// Rates chosen once, by the camera: see [`EyeRates`].
#[derive(Clone, Copy)]
pub struct Once {
    pub pixels: f32,
    pub bend: Option<f32>,
}

/// A method: its name, how its surface is made and traced.
#[derive(Clone, Copy)]
pub struct Method {
    pub name: &'static str,
    pub surface: SurfaceOptions,
    pub trace: TraceOptions,
    /// Instead of rates by each ray, one rate a patch: edges of so many pixels, all alike if the turn is 0.
    pub once: Option<Once>,
}

impl Method {
    pub fn new(name: &'static str, surface: SurfaceOptions, trace: TraceOptions) -> Self {
        Self { name, surface, trace, once: None }
    }

    /// Rates chosen once, by the camera.
    pub fn once(name: &'static str, pixels: f32) -> Self {
        // Nothing of the trees of patches is needed once a patch is made.
        let surface = SurfaceOptions::default().with_tight_levels(0).with_tree_bytes(0);
        Self { once: Some(Once { pixels, bend: None }), ..Self::new(name, surface, TraceOptions::default()) }
    }
}

/// Rates for a view.
pub fn rate(surface: Arc<Surface>, view: &View, once: Once) -> Result<RatedSurface> {
    let (_, differential) = view.ray(0, 0);
    let rates = EyeRates::new(view.eye, differential.d_direction[0].length() * once.pixels);
    let rates = once.bend.map_or(rates, |bend| rates.with_bend(bend));
    Ok(RatedSurface::for_eye(surface, &rates, &mut |_| true)?)
}

/// [`render`] at rates chosen once.
fn render_once(scene: &Scene, setting: &Setting, method: &Method, once: Once) -> Result<Frame> {
    #[cfg(feature = "embree")]
    let before = crate::memory::start();
    let start = Instant::now();
    let surface = Arc::new(Surface::build(&scene.control, &method.surface)?);
    let mut caster = rate(Arc::clone(&surface), &setting.view, once)?;
    let build_s = start.elapsed().as_secs_f64();
    // Rays take nothing more.
    #[cfg(feature = "embree")]
    let bytes = crate::memory::peak_since(before);
    let Cast { image, rays, hits, traced_s, seconds } = cast(setting, &mut caster);
    #[cfg(not(feature = "embree"))]
    let bytes = surface.bytes() + caster.bytes();
    let operations = surface.counts();
    let dice = surface.patch_count() as u64;
    Ok(Frame {
        image,
        seconds,
        traced_s,
        build_s,
        rays,
        hits,
        bound: operations.bound,
        split: operations.split,
        dice,
        micropolygons: caster.micropolygons(),
        bytes,
    })
}

/// An image and what it took.
#[derive(Default)]
pub struct Frame {
    /// Share of light samples seen, 1 where nothing is hit; without lights, distance of the hit.
    pub image: Vec<f32>,
    pub seconds: f64,
    /// Of these, the casting of camera rays and of shadow rays, without what makes the rays. Not of rates by ray.
    #[cfg_attr(not(feature = "embree"), allow(dead_code))] // only compared with a peer
    pub traced_s: [f64; 2],
    pub build_s: f64,
    pub rays: usize,
    pub hits: usize,
    pub bound: u64,
    pub split: u64,
    pub dice: u64,
    pub micropolygons: u64,
    pub bytes: usize,
}

impl Frame {
    /// Reyes operations.
    pub fn operations(&self) -> u64 {
        self.bound + self.split + self.dice
    }

    /// Root mean square difference of two images.
    pub fn rmse(&self, other: &[f32]) -> f64 {
        let squares: f64 = self.image.iter().zip(other).map(|(a, b)| f64::from(a - b).powi(2)).sum();
        (squares / self.image.len() as f64).sqrt()
    }
}

/// Where in its stratum pixel `(x, y)` samples light `l`.
pub fn jitter(x: u32, y: u32, l: usize, i: u32) -> Vec2 {
    let seed = combine(pixel_seed(x, y, 7), hash(l as u32 * 64 + i));
    Vec2::new(unit(seed), unit(hash(seed)))
}

/// Renders with a surface made for the occasion.
pub fn render(scene: &Scene, setting: &Setting, method: &Method) -> Result<Frame> {
    if let Some(once) = method.once {
        return render_once(scene, setting, method, once);
    }
    let start = Instant::now();
    let surface = Arc::new(Surface::build(&scene.control, &method.surface)?);
    let tracer = SurfaceTracer::new(Arc::clone(&surface), &method.trace)?;
    let build_s = start.elapsed().as_secs_f64();
    let start = Instant::now();
    let (image, rays, hits) = trace(&tracer, setting);
    let seconds = start.elapsed().as_secs_f64();
    let (operations, counts) = (surface.counts(), tracer.counts());
    Ok(Frame {
        image,
        seconds,
        traced_s: [0.0; 2],
        build_s,
        rays,
        hits,
        bound: operations.bound,
        split: operations.split,
        dice: counts.dice,
        micropolygons: counts.micropolygons,
        bytes: surface.bytes() + tracer.bvh_bytes() + tracer.peak_grid_bytes(),
    })
}

fn trace(tracer: &SurfaceTracer, setting: &Setting) -> (Vec<f32>, usize, usize) {
    let size = setting.view.size;
    let samples = setting.strata[0] * setting.strata[1];
    let mut state = TraceState::new(tracer.options());
    let mut image = vec![1f32; (size * size) as usize];
    let (mut rays, mut hits) = (0, 0);
    for (x, y) in setting.view.pixels() {
        let (ray, differential) = setting.view.ray(x, y);
        rays += 1;
        let Some(hit) = tracer.closest_hit(&ray, &differential, &mut state) else { continue };
        hits += 1;
        let pixel = &mut image[(y * size + x) as usize];
        *pixel = hit.t;
        if setting.lights.is_empty() {
            continue;
        }
        let normal = tracer.limit(&hit).normal;
        let d_pixel = differential.transfer(&ray, hit.t, normal).d_origin;
        let mut seen = 0u32;
        for (l, light) in setting.lights.iter().enumerate() {
            for i in 0..samples {
                let (target, steps) = light.sample(i, setting.strata, jitter(x, y, l, i));
                let origin = tracer.leave(&hit, target - ray.at(hit.t));
                let zero = [Vec3::ZERO; 2];
                let d_point = if setting.shadows == Shadows::FromPixel { d_pixel } else { zero };
                let blocked = match setting.shadows {
                    Shadows::FromPixel | Shadows::FromPoint => {
                        let (ray, d) = shadow(origin, target, d_point, steps);
                        tracer.any_hit(&ray, &d, &mut state)
                    }
                    Shadows::Deferred => {
                        let (ray, d) = shadow(origin, target, d_point, steps);
                        published::any_hit_deferred(tracer, &ray, &d, &mut state)
                    }
                    Shadows::Backward => {
                        let (ray, d) = shadow(target, origin, steps, d_point);
                        tracer.any_hit(&ray, &d, &mut state)
                    }
                };
                rays += 1;
                seen += u32::from(!blocked);
            }
        }
        *pixel = seen as f32 / (samples * setting.lights.len() as u32) as f32;
    }
    (image, rays, hits)
}

/// Something that rays are traced against.
pub trait Caster {
    /// Appends `t` and unit normal of the closest micropolygon of each ray to `hits`. Returns the seconds of casting, without
    /// those of converting rays.
    fn closest_hits(&mut self, rays: &[Ray], hits: &mut Vec<Option<(f32, Vec3)>>) -> f64;

    /// Appends whether each ray is blocked to `blocked`; every `fan` rays have one origin. Returns seconds as above.
    fn any_hits(&mut self, rays: &[Ray], fan: usize, blocked: &mut Vec<bool>) -> f64;
}

impl Caster for RatedSurface {
    fn closest_hits(&mut self, rays: &[Ray], hits: &mut Vec<Option<(f32, Vec3)>>) -> f64 {
        let start = Instant::now();
        hits.extend(rays.iter().map(|ray| {
            let hit = self.closest_hit(ray)?;
            let [a, b, c] = self.corners(&hit).map(Vec3::from);
            Some((hit.hit.t, (b - a).cross(c - a).normalize_or_zero()))
        }));
        start.elapsed().as_secs_f64()
    }

    fn any_hits(&mut self, rays: &[Ray], fan: usize, blocked: &mut Vec<bool>) -> f64 {
        let start = Instant::now();
        for rays in rays.chunks(fan).flat_map(|rays| rays.chunks(FAN)) {
            let mut hits = [false; FAN];
            Self::any_hits(self, rays, &mut hits[..rays.len()]);
            blocked.extend(&hits[..rays.len()]);
        }
        start.elapsed().as_secs_f64()
    }
}

/// An image by a [`Caster`], and what it took.
pub struct Cast {
    pub image: Vec<f32>,
    pub rays: usize,
    pub hits: usize,
    /// Seconds of casting: camera rays, shadow rays.
    pub traced_s: [f64; 2],
    /// Seconds in all.
    pub seconds: f64,
}

/// Pixels whose rays are cast together: a tile of [`View::pixels`].
const TILE: usize = 256;

/// Renders as [`render`] does, with shadow rays from micropolygons; without lights, distances.
pub fn cast(setting: &Setting, caster: &mut impl Caster) -> Cast {
    let start = Instant::now();
    let size = setting.view.size;
    let samples = setting.strata[0] * setting.strata[1];
    let most = samples as usize * setting.lights.len();
    let mut cast = Cast {
        image: vec![1f32; (size * size) as usize],
        rays: 0,
        hits: 0,
        traced_s: [0.0; 2],
        seconds: 0.0,
    };
    let (mut rays, mut hits) = (Vec::with_capacity(TILE), Vec::with_capacity(TILE));
    let (mut shadow_rays, mut blocked) = (Vec::new(), Vec::new());
    // Hits are as exact as `t` is.
    let magnitude = 8.0 * setting.view.eye.abs().max_element();
    let pixels: Vec<(u32, u32)> = setting.view.pixels().collect();
    for tile in pixels.chunks(TILE) {
        rays.clear();
        rays.extend(tile.iter().map(|&(x, y)| setting.view.ray(x, y).0));
        hits.clear();
        cast.traced_s[0] += caster.closest_hits(&rays, &mut hits);
        cast.rays += rays.len();
        cast.hits += hits.iter().flatten().count();
        shadow_rays.clear();
        let seen = || tile.iter().zip(&rays).zip(&hits).filter_map(|(p, hit)| Some((p, (*hit)?)));
        for ((&(x, y), ray), (t, normal)) in seen() {
            cast.image[(y * size + x) as usize] = t;
            let point = ray.at(t);
            for (l, light) in setting.lights.iter().enumerate() {
                for i in 0..samples {
                    let (target, _) = light.sample(i, setting.strata, jitter(x, y, l, i));
                    let origin = offset_origin(point, normal, target - point, magnitude);
                    shadow_rays.push(Ray::between(origin, target));
                }
            }
        }
        if most == 0 {
            continue;
        }
        blocked.clear();
        cast.traced_s[1] += caster.any_hits(&shadow_rays, most, &mut blocked);
        cast.rays += shadow_rays.len();
        for (((&(x, y), _), _), blocked) in seen().zip(blocked.chunks(most)) {
            let count = blocked.iter().filter(|&&b| b).count();
            cast.image[(y * size + x) as usize] = 1.0 - count as f32 / most as f32;
        }
    }
    cast.seconds = start.elapsed().as_secs_f64();
    cast
}

/// The limit surface, by triangles much smaller than pixels.
pub struct Reference {
    mesh: TriangleMesh,
    bvh: Bvh,
}

impl Reference {
    /// Every patch at `level`.
    pub fn new(scene: &Scene, level: u8) -> Result<Self> {
        let surface = Surface::build(&scene.control, &SurfaceOptions::default())?;
        let (mesh, _) = surface.tessellate(|_| [level; 2])?;
        let bvh = Bvh::build(&mesh.positions, &mesh.triangles, &BuildOptions::default())?;
        Ok(Self { mesh, bvh })
    }

    /// Where a ray meets the surface, and the cosine of its angle there, 0 from behind.
    pub fn closest_hit(&self, ray: &Ray) -> Option<(f32, f32)> {
        let hit = self.bvh.closest_hit(ray)?;
        let [a, b, c] = self.mesh.triangle(hit.prim_index as usize).map(Vec3::from);
        let normal = (b - a).as_dvec3().cross((c - a).as_dvec3()).normalize_or_zero().as_vec3();
        Some((hit.t, (-normal.dot(ray.direction.normalize())).max(0.0)))
    }

    /// The image that [`render`] should come to.
    pub fn render(&self, setting: &Setting) -> Vec<f32> {
        let size = setting.view.size;
        let samples = setting.strata[0] * setting.strata[1];
        let mut image = vec![1f32; (size * size) as usize];
        for (x, y) in setting.view.pixels() {
            let (ray, _) = setting.view.ray(x, y);
            let Some(hit) = self.bvh.closest_hit(&ray) else { continue };
            let pixel = &mut image[(y * size + x) as usize];
            *pixel = hit.t;
            if setting.lights.is_empty() {
                continue;
            }
            let [a, b, c] = self.mesh.triangle(hit.prim_index as usize).map(Vec3::from);
            let normal = (b - a).as_dvec3().cross((c - a).as_dvec3()).normalize_or_zero().as_vec3();
            let point = a + (b - a) * hit.u + (c - a) * hit.v;
            let magnitude = a.abs().max(b.abs()).max(c.abs()).max_element();
            let mut seen = 0u32;
            for (l, light) in setting.lights.iter().enumerate() {
                for i in 0..samples {
                    let (target, _) = light.sample(i, setting.strata, jitter(x, y, l, i));
                    let origin = offset_origin(point, normal, target - point, magnitude);
                    seen += u32::from(!self.bvh.any_hit(&Ray::between(origin, target)));
                }
            }
            *pixel = seen as f32 / (samples * setting.lights.len() as u32) as f32;
        }
        image
    }
}
