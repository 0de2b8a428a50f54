//! Ways to answer how much light passes, behind one trait, and the choice between them.
//!
//! A method sees all rays of one receiver to one light (or all its ambient rays) at once, with each ray's share of solid
//! angle, so that methods which trace fans, masks or cones can use them.

use crate::{RenderError, far::FarOpacity, geometry::Geometry, volumetric};
use umbrage_accel::{Bvh, Counters, Statistics};
use umbrage_aomask::{
    BackEnd, MaskError, MaskOptions, MaskTables, Outputs, Pattern, PatternOptions, Receiver, TableOptions,
    coarse, exact,
};
use umbrage_geom::{Falloff, Ray};
use umbrage_occlusion::{
    prefilter::{ConeRay, Prefiltered, PrefilteredInstances, Query},
    volumetric::Prepared,
    volumetric::ShadowRays,
};

/// One sample of a light or of the sky, seen from a receiver.
#[derive(Clone, Copy, Debug)]
pub struct LightRay {
    /// Segment from the receiver to the sample. Rays of one batch share their origin.
    pub ray: Ray,
    /// Solid angle that the sample stands for, steradians; 0 for point lights.
    pub solid_angle: f32,
}

/// A method that answers shadow or ambient rays.
pub trait Method: Sync {
    /// The name users know it by.
    fn name(&self) -> &'static str;

    /// Writes the fraction of light that passes along each ray; counts into `counters` if there are any. All go to the light of
    /// index `light`, or to the sky.
    fn transmittances(
        &self,
        rays: &[LightRay],
        light: Option<usize>,
        passed: &mut [f32],
        counters: Option<&mut Counters>,
    );

    /// What was made of occluders so far, by methods that make them when they are needed.
    fn prepared(&self) -> Option<Prepared> {
        None
    }

    /// Writes how open the sky is over each receiver, 1 is open: for methods that choose ambient rays themselves. The
    /// default, `false`, asks for [`Self::transmittances`] instead.
    fn opennesses(&self, receivers: &[Receiver], open: &mut [f32]) -> bool {
        let _ = (receivers, open);
        false
    }
}

/// Exact rays through the scene's wide BVH.
struct SingleRays<'a> {
    geometry: &'a Geometry,
    name: &'static str,
}

impl Method for SingleRays<'_> {
    fn name(&self) -> &'static str {
        self.name
    }

    fn transmittances(
        &self,
        rays: &[LightRay],
        _: Option<usize>,
        passed: &mut [f32],
        counters: Option<&mut Counters>,
    ) {
        let rays: Vec<Ray> = rays.iter().map(|light| light.ray).collect();
        match counters {
            None => self.geometry.transmittances(&rays, passed, &mut ()),
            Some(counters) => self.geometry.transmittances(&rays, passed, counters),
        }
    }
}

/// Rays end at prefiltered nodes that fit inside their cones; approximate.
struct PrefilteredRays<'a> {
    scene: PrefilteredScene<'a>,
    query: Query,
}

enum PrefilteredScene<'a> {
    Flat(&'a Prefiltered),
    Instanced(PrefilteredInstances<'a>),
}

impl<'a> PrefilteredRays<'a> {
    fn new(geometry: &'a Geometry, threshold: f32) -> Result<Self, RenderError> {
        let failed = |source| RenderError::Prefilter { object: "scene".into(), source };
        let parts = geometry.prefiltered()?;
        let scene = match geometry.instances() {
            None => PrefilteredScene::Flat(&parts.scenes[0]),
            Some(top) => PrefilteredScene::Instanced(
                PrefilteredInstances::new(top, parts.scenes.clone(), &parts.of_instance).map_err(failed)?,
            ),
        };
        Ok(Self { scene, query: Query::new(threshold).map_err(failed)? })
    }

    fn answer(&self, rays: &[ConeRay], passed: &mut [f32], stats: &mut impl Statistics) {
        match &self.scene {
            PrefilteredScene::Flat(scene) => scene.transmittances_with(rays, &self.query, passed, stats),
            PrefilteredScene::Instanced(scene) => rays
                .iter()
                .zip(passed)
                .for_each(|(ray, out)| *out = scene.transmittance_with(ray, &self.query, stats)),
        }
    }
}

impl Method for PrefilteredRays<'_> {
    fn name(&self) -> &'static str {
        PREFILTER
    }

    fn transmittances(
        &self,
        rays: &[LightRay],
        _: Option<usize>,
        passed: &mut [f32],
        counters: Option<&mut Counters>,
    ) {
        // Few at a time, so that no memory is asked for.
        let mut cones = [ConeRay { ray: Ray::new([0.0; 3], [0.0; 3]), solid_angle: 0.0 }; 64];
        let mut counters = counters;
        for (rays, passed) in rays.chunks(cones.len()).zip(passed.chunks_mut(cones.len())) {
            for (cone, light) in cones.iter_mut().zip(rays) {
                *cone = ConeRay { ray: light.ray, solid_angle: light.solid_angle };
            }
            match &mut counters {
                None => self.answer(&cones[..rays.len()], passed, &mut ()),
                Some(counters) => self.answer(&cones[..rays.len()], passed, *counters),
            }
        }
    }
}

/// Name of the approximate method.
const PREFILTER: &str = "prefilter";

/// Thresholds `T` of prefiltered shadows and ambient occlusion: `docs/prefilter.md` has the errors.
const SHADOW_THRESHOLD: f32 = 0.2;
/// See [`SHADOW_THRESHOLD`].
pub(crate) const AO_THRESHOLD: f32 = 0.3;

/// All ambient rays of a receiver as one mask.
struct Masks<'a> {
    rays: SingleRays<'a>,
    bvh: &'a Bvh,
    way: Way,
    options: MaskOptions,
}

/// How masks are found.
enum Way {
    /// The bits of single rays.
    Exact(Pattern),
    /// From tables: approximate.
    Tables(Box<MaskTables>),
    /// Exact up to a distance, by stored opacity beyond it: approximate.
    Prefiltered(Pattern, Box<FarOpacity>, f32),
}

impl<'a> Masks<'a> {
    fn new(name: &'static str, geometry: &'a Geometry, sky: &SkyRays) -> Result<Self, RenderError> {
        let bvh = geometry.flat().filter(|_| name == MASK || geometry.is_opaque());
        let bvh = bvh.ok_or(RenderError::MaskGeometry(name))?;
        let pattern_options = PatternOptions::default()
            .with_rays(sky.samples)
            .with_falloff(sky.falloff.clone())
            .with_seed(sky.seed);
        let pattern = Pattern::new(&pattern_options)?;
        let options = MaskOptions::default().with_radius(sky.radius);
        options.validate(&pattern)?;
        let way = match name {
            MASK_TABLE => Way::Tables(Box::new(MaskTables::new(pattern, &TableOptions::default())?)),
            MASK_PREFILTER => {
                let mesh = geometry.flat_opaque().map(|(_, mesh)| mesh);
                let mesh = mesh.ok_or(RenderError::MaskGeometry(name))?;
                let far = Box::new(FarOpacity::build(mesh, &mut |_| true)?);
                match far.near(bvh, &pattern, &pattern_options, &options)? {
                    Some(near) => Way::Prefiltered(pattern, far, near),
                    None => Way::Exact(pattern),
                }
            }
            _ => Way::Exact(pattern),
        };
        Ok(Self { rays: SingleRays { geometry, name }, bvh, way, options })
    }

    fn answer(&self, receivers: &[Receiver], open: &mut [f32]) -> Result<(), MaskError> {
        let (bvh, options, outputs) = (self.bvh, &self.options, Outputs::new(open));
        match &self.way {
            Way::Tables(tables) => tables.answer_receivers(bvh, receivers, options, outputs, &mut |_| true),
            Way::Prefiltered(pattern, far, near) => {
                let (far, best) = (far.cones(pattern.len(), *near, options.radius)?, BackEnd::best());
                coarse::answer_receivers(bvh, &far, pattern, receivers, options, best, outputs, &mut |_| true)
            }
            Way::Exact(pattern) if self.rays.geometry.is_opaque() => {
                let best = BackEnd::best();
                exact::answer_receivers(bvh, pattern, receivers, options, best, outputs, &mut |_| true)
            }
            Way::Exact(pattern) => {
                let (best, depth) = (BackEnd::best(), |prim| self.rays.geometry.flat_depth(prim));
                exact::transmit(bvh, depth, pattern, receivers, options, best, outputs, &mut |_| true)
            }
        }
    }
}

impl Method for Masks<'_> {
    fn name(&self) -> &'static str {
        self.rays.name
    }

    fn transmittances(
        &self,
        rays: &[LightRay],
        light: Option<usize>,
        passed: &mut [f32],
        counters: Option<&mut Counters>,
    ) {
        self.rays.transmittances(rays, light, passed, counters);
    }

    fn opennesses(&self, receivers: &[Receiver], open: &mut [f32]) -> bool {
        // Options and lengths were checked; nobody cancels.
        self.answer(receivers, open).is_ok()
    }
}

/// Whether masks can have so many rays.
pub(crate) fn mask_rays(rays: u32) -> bool {
    (32..=Pattern::MAX_RAYS).contains(&rays) && rays.is_multiple_of(32)
}

/// What ambient rays of a scene have in common.
#[derive(Clone, Debug)]
pub struct SkyRays {
    /// Rays of a receiver.
    pub samples: u32,
    /// How far occluders count, world units; may be infinite.
    pub radius: f32,
    /// How they fade with distance.
    pub falloff: Falloff,
    /// Seed of the pattern.
    pub seed: u32,
}

const MASK: &str = "mask";
const MASK_PREFILTER: &str = "mask-prefilter";
const MASK_TABLE: &str = "mask-table";
/// Rasterization answers whole images before pixels are shaded (`raster_sky.rs`).
pub(crate) const MASK_RASTER: &str = "mask-raster";

/// Names of the shadow methods, `auto` first.
pub const SHADOW_METHODS: &[&str] = &[
    "auto",
    "bvh",
    "kd",
    "kd-volumetric",
    "kd-volumetric:ray",
    "kd-volumetric:extended",
    "kd-volumetric:bfs",
    "kd-volumetric:qdbfs",
    "kd-volumetric:solid",
    "kd-volumetric:guided",
    "bvh-volumetric",
    PREFILTER,
];
/// Names of the ambient occlusion methods, `auto` first.
pub const AO_METHODS: &[&str] = &["auto", "rays", MASK, MASK_PREFILTER, MASK_TABLE, MASK_RASTER, PREFILTER];

/// Checks the names of both methods, before anything is built.
///
/// # Errors
/// [`RenderError::Method`].
pub fn check_names(settings: &umbrage_scene::Settings) -> Result<(), RenderError> {
    for (name, purpose, known) in
        [(&settings.shadows, "shadow", SHADOW_METHODS), (&settings.ao, "ambient occlusion", AO_METHODS)]
    {
        if !known.contains(&name.as_str()) {
            return Err(RenderError::Method { name: name.clone(), purpose, known });
        }
    }
    Ok(())
}

/// A method and why it was taken.
pub struct Choice<'a> {
    /// The method.
    pub method: Box<dyn Method + 'a>,
    /// One line for people.
    pub reason: &'static str,
}

/// The shadow method called `name`, for the `rays` that are expected.
///
/// # Errors
/// [`RenderError::Method`] if there is none; [`RenderError::Prefilter`].
pub fn shadow_method<'a>(
    name: &str,
    geometry: &'a Geometry,
    rays: &ShadowRays,
) -> Result<Choice<'a>, RenderError> {
    if name == "auto"
        && let Some(method) = volumetric::where_it_pays(geometry, rays)
    {
        return Ok(Choice {
            method,
            reason: "exact; many rays are expected to end at boxes inside of solids",
        });
    }
    match volumetric::method(name, geometry) {
        Some(method) => Ok(Choice { method, reason: "asked for" }),
        None => choose(name, "shadow", SHADOW_METHODS, geometry),
    }
}

/// The ambient occlusion method called `name`, for a scene with the sky `sky` if it has one.
///
/// # Errors
/// [`RenderError::Method`] if there is none; [`RenderError::Prefilter`]; for methods with masks [`RenderError::MaskGeometry`]
/// and [`RenderError::Mask`].
pub fn ao_method<'a>(
    name: &str,
    geometry: &'a Geometry,
    sky: Option<&SkyRays>,
) -> Result<Choice<'a>, RenderError> {
    if let Some(sky) = sky {
        let (method, reason) = match name {
            MASK => (MASK, "asked for"),
            MASK_TABLE => (MASK_TABLE, "asked for; approximate"),
            MASK_PREFILTER => (MASK_PREFILTER, "asked for; approximate"),
            "auto" if mask_rays(sky.samples) && geometry.flat().is_some() => {
                (MASK, "exact, and faster than single rays")
            }
            _ => ("", ""),
        };
        if !method.is_empty() {
            return Ok(Choice { method: Box::new(Masks::new(method, geometry, sky)?), reason });
        }
    }
    if name == MASK_RASTER {
        return Ok(Choice {
            method: Box::new(SingleRays { geometry, name: MASK_RASTER }),
            reason: "asked for",
        });
    }
    // Without a sky nothing is asked.
    let name = if [MASK, MASK_PREFILTER, MASK_TABLE].contains(&name) { AO_METHODS[1] } else { name };
    choose(name, "ambient occlusion", AO_METHODS, geometry)
}

fn choose<'a>(
    name: &str,
    purpose: &'static str,
    known: &'static [&'static str],
    geometry: &'a Geometry,
) -> Result<Choice<'a>, RenderError> {
    let exact = known[1];
    if name == PREFILTER {
        let threshold = if purpose == "shadow" { SHADOW_THRESHOLD } else { AO_THRESHOLD };
        let method = Box::new(PrefilteredRays::new(geometry, threshold)?);
        return Ok(Choice { method, reason: "asked for; approximate" });
    }
    let reason = match name {
        "auto" if purpose == "shadow" => "exact; few rays are expected to end at boxes inside of solids",
        "auto" => "exact; masks need 32 to 1024 samples, a multiple of 32, and instances in one mesh",
        _ if name == exact => "asked for",
        _ => return Err(RenderError::Method { name: name.into(), purpose, known }),
    };
    Ok(Choice { method: Box::new(SingleRays { geometry, name: exact }), reason })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_volumetric_method_is_listed() {
        assert_eq!(&SHADOW_METHODS[2..][..volumetric::NAMES.len()], volumetric::NAMES);
    }
}
