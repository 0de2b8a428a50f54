//! The engines: what each method does with rays, receivers or images.
//!
//! One file an engine. Its name in [`AoMethod`] or [`ShadowMethod`] and its arm in [`shadows`] or [`sky`] are all that the rest of
//! the workspace sees of it.

mod by_rays;
mod kd;
mod mask;
mod mask_prefilter;
mod mask_raster;
mod mask_table;
mod prefilter;
mod rays;
mod solid;
mod surface;
mod tile;

pub use by_rays::openness_by_rays;

use super::{AoMethod, Occluders, Pilot, QueryError, SceneKind, ShadowMethod, Structure, View};
use umbrage_accel::Counters;
use umbrage_aomask::{
    MaskOptions, Outputs, Pattern, PatternOptions, Points, RasterView, Receiver, Sides,
    exact::adaptive::Spent,
};
use umbrage_geom::{Frame, Ray, RayDifferential};
use umbrage_occlusion::volumetric::{Prepared, ShadowRays};

/// A callback that gets growing fractions and returns `false` to cancel.
pub type Report<'r> = &'r mut (dyn FnMut(f32) -> bool + Send);

/// Progress of step `number` of `count`, as fractions of all steps; exactly 1 at the end of the last.
pub(crate) fn share_of(
    progress: Report<'_>,
    number: usize,
    count: usize,
) -> impl FnMut(f32) -> bool + Send + '_ {
    move |fraction| {
        let is_end = number + 1 == count && fraction == 1.0;
        progress(if is_end { 1.0 } else { (number as f32 + fraction) / count as f32 })
    }
}

/// One sample of a light or of the sky, seen from a receiver.
#[derive(Clone, Copy, Debug)]
pub struct LightRay {
    /// Segment from the receiver to the sample. Rays of one batch share their origin.
    pub ray: Ray,
    /// Solid angle that the sample stands for, steradians; 0 for point lights.
    pub solid_angle: f32,
    /// Width of what the receiver stands for, such as a pixel's footprint, world units: how finely subdivision surfaces are seen.
    pub width: f32,
}

impl LightRay {
    /// A ray from a receiver that is a point.
    pub fn new(ray: Ray, solid_angle: f32) -> Self {
        Self { ray, solid_angle, width: 0.0 }
    }

    /// Sets [`Self::width`].
    #[must_use]
    pub fn with_width(self, width: f32) -> Self {
        Self { width, ..self }
    }

    /// A square footprint that starts as wide as the receiver and grows with the solid angle.
    pub(crate) fn differential(&self) -> RayDifferential {
        let length = self.ray.direction.length();
        let frame = Frame::from_normal(self.ray.direction / length);
        let axes = [frame.tangent, frame.bitangent];
        let spread = self.solid_angle.sqrt() * length;
        RayDifferential {
            d_origin: axes.map(|axis| axis * self.width),
            d_direction: axes.map(|axis| axis * spread),
        }
    }
}

/// What an engine answers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Answers {
    /// Rays that the caller chooses: [`Engine::transmittances`].
    Rays,
    /// Receivers, whose rays the engine chooses: [`Engine::sky`].
    Receivers,
    /// All receivers of an image: [`Engine::image`].
    Images,
}

/// A method at work on some occluders.
///
/// Engines answer the calls that [`Self::answers`] names; others are [`QueryError::Unsupported`].
pub trait Engine: Sync {
    /// The method's name.
    fn name(&self) -> &'static str;

    /// Which call it answers.
    fn answers(&self) -> Answers {
        Answers::Rays
    }

    /// Writes the fraction of light that passes along each ray; counts into `counters` if there are any. All go to the light of
    /// index `light`, or to the sky.
    ///
    /// # Errors
    /// [`QueryError::Unsupported`] unless [`Self::answers`] is [`Answers::Rays`].
    fn transmittances(
        &self,
        rays: &[LightRay],
        light: Option<usize>,
        passed: &mut [f32],
        counters: Option<&mut Counters>,
    ) -> Result<(), QueryError> {
        let _ = (rays, light, passed, counters);
        Err(QueryError::Unsupported { method: self.name(), reason: "it does not answer single rays" })
    }

    /// Answers how open the sky is over each receiver, and says how many rays it took.
    ///
    /// # Errors
    /// [`QueryError::Unsupported`] unless [`Self::answers`] is [`Answers::Receivers`]; [`QueryError::Mask`];
    /// [`QueryError::Cancelled`].
    fn sky(
        &self,
        receivers: &[Receiver],
        outputs: Outputs<'_>,
        progress: Report<'_>,
    ) -> Result<Spent, QueryError> {
        let _ = (receivers, outputs, progress);
        Err(QueryError::Unsupported { method: self.name(), reason: "it does not choose rays for receivers" })
    }

    /// Answers how open the sky is over all receivers of an image; `seed` chooses the patterns' turns.
    ///
    /// # Errors
    /// [`QueryError::Unsupported`] unless [`Self::answers`] is [`Answers::Images`]; [`QueryError::Mask`];
    /// [`QueryError::Cancelled`].
    fn image(
        &self,
        view: &RasterView<'_>,
        seed: u32,
        outputs: Outputs<'_>,
        progress: Report<'_>,
    ) -> Result<(), QueryError> {
        let _ = (view, seed, outputs, progress);
        Err(QueryError::Unsupported { method: self.name(), reason: "it does not answer whole images" })
    }

    /// The rays that receivers have, by engines that answer receivers.
    fn pattern(&self) -> Option<&Pattern> {
        None
    }

    /// Makes now what rays would otherwise make when they come near. The work of a ray then does not depend on the rays of other
    /// threads.
    fn prepare_all(&self) {}

    /// The engine for the rays of one tile, one after the other, if it remembers something from ray to ray. With `counted` it
    /// starts with an empty memory, so that the work counted depends on the tile alone.
    fn for_tile(&self, counted: bool) -> Option<Box<dyn Engine + '_>> {
        let _ = counted;
        None
    }

    /// The structures that it asks, which [`Occluders::structures`] has the times and bytes of.
    fn structures(&self) -> &'static [Structure] {
        &[Structure::Bvh]
    }

    /// What was made of the occluders so far, by engines that make it when rays come near.
    fn prepared(&self) -> Option<Prepared> {
        None
    }

    /// What else there is to say of how it answers.
    fn note(&self) -> Option<&'static str> {
        None
    }
}

/// What the ambient rays of all receivers have in common.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct Sky {
    /// Rays of a receiver, how occluders fade, seed and jitter.
    pub pattern: PatternOptions,
    /// How far occluders count, world units; may be infinite.
    pub radius: f32,
    /// Which sides of triangles block.
    pub sides: Sides,
    /// From where receivers are seen.
    pub view: View,
    /// Standard error of the openness to aim at: receivers get as many rays as that takes by an estimate, up to those of the
    /// pattern.
    pub target_error: Option<f32>,
    /// A sample of the receivers that will be asked, if [`AoMethod::wants_pilot`]; without one such a method takes points on the
    /// surfaces of the scene.
    pub pilot: Pilot,
    /// Threshold `T` of [`AoMethod::Prefilter`]: smaller is nearer to exact rays, and slower. `None` is 0.3.
    pub threshold: Option<f32>,
}

impl Sky {
    /// Both sides block, receivers are given as points, and all get the rays of the pattern.
    pub fn new(pattern: PatternOptions, radius: f32) -> Self {
        Self {
            pattern,
            radius,
            sides: Sides::Both,
            view: View::NoCamera,
            target_error: None,
            pilot: Pilot::default(),
            threshold: None,
        }
    }

    /// Sets [`Self::sides`].
    #[must_use]
    pub fn with_sides(self, sides: Sides) -> Self {
        Self { sides, ..self }
    }

    /// Sets [`Self::target_error`].
    #[must_use]
    pub fn with_target_error(self, target_error: Option<f32>) -> Self {
        Self { target_error, ..self }
    }

    /// Sets [`Self::threshold`].
    #[must_use]
    pub fn with_threshold(self, threshold: Option<f32>) -> Self {
        Self { threshold, ..self }
    }

    /// Sets [`Self::view`].
    #[must_use]
    pub fn with_view(self, view: View) -> Self {
        Self { view, ..self }
    }

    /// Sets [`Self::pilot`].
    #[must_use]
    pub fn with_pilot(self, pilot: Pilot) -> Self {
        Self { pilot, ..self }
    }

    fn options(&self) -> MaskOptions {
        MaskOptions::default().with_radius(self.radius).with_sides(self.sides)
    }

    /// The pattern and the options of masks, checked.
    fn masks(&self) -> Result<(Pattern, MaskOptions), QueryError> {
        self.checked(&self.pattern)
    }

    /// [`Self::masks`] with one set of rays for all receivers, turned as asked for.
    fn masks_of_tables(&self) -> Result<(Pattern, MaskOptions), QueryError> {
        self.checked(&self.pattern.clone().with_points(Points::Middles))
    }

    fn checked(&self, pattern: &PatternOptions) -> Result<(Pattern, MaskOptions), QueryError> {
        let (pattern, options) = (Pattern::new(pattern)?, self.options());
        options.validate(&pattern)?;
        Ok((pattern, options))
    }
}

const FRONT_FIRST_NEEDS_OPAQUE: &str =
    "some triangles are semi-transparent, and fronts before any back need opaque ones";

/// Whether masks can have so many rays.
pub fn mask_rays(rays: u32) -> bool {
    (8..=Pattern::MAX_MASK_RAYS).contains(&rays) && rays.is_multiple_of(8)
}

/// What can be chosen of shadow methods.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[non_exhaustive]
pub struct ShadowOptions {
    /// Threshold `T` of [`ShadowMethod::Prefilter`]: smaller is nearer to exact rays, and slower. `None` is 0.2.
    pub threshold: Option<f32>,
}

impl ShadowOptions {
    /// Sets [`Self::threshold`].
    #[must_use]
    pub fn with_threshold(self, threshold: Option<f32>) -> Self {
        Self { threshold }
    }
}

/// The engine of a shadow method, by default options.
///
/// # Errors
/// Those of [`shadows_with`].
pub fn shadows<'a>(
    method: ShadowMethod,
    occluders: &'a Occluders,
    progress: Report<'_>,
) -> Result<Box<dyn Engine + 'a>, QueryError> {
    shadows_with(method, occluders, &ShadowOptions::default(), progress)
}

/// The engine of a shadow method.
///
/// # Errors
/// [`QueryError::Unsupported`] with the reason; [`QueryError::Build`], [`QueryError::Occlusion`], [`QueryError::Cancelled`] of
/// the structures that are made for it.
pub fn shadows_with<'a>(
    method: ShadowMethod,
    occluders: &'a Occluders,
    options: &ShadowOptions,
    progress: Report<'_>,
) -> Result<Box<dyn Engine + 'a>, QueryError> {
    method.check(&occluders.kind(View::NoCamera))?;
    Ok(match method {
        ShadowMethod::Bvh if occluders.has_surfaces() => {
            Box::new(surface::Surface::new(method.name(), occluders))
        }
        ShadowMethod::Bvh => Box::new(rays::Rays::new(method.name(), occluders, Sides::Both)),
        ShadowMethod::Kd
        | ShadowMethod::KdVolumetric
        | ShadowMethod::KdVolumetricRay
        | ShadowMethod::KdVolumetricExtended
        | ShadowMethod::KdVolumetricBreadth
        | ShadowMethod::KdVolumetricQuick
        | ShadowMethod::KdVolumetricSolid => Box::new(kd::Kd::build(method, occluders, progress)?),
        ShadowMethod::BvhVolumetric => Box::new(solid::Solid::new(occluders)?),
        ShadowMethod::Prefilter => {
            let threshold = options.threshold.unwrap_or(prefilter::SHADOW_THRESHOLD);
            Box::new(prefilter::Prefilter::build(occluders, threshold, progress)?)
        }
    })
}

/// `bvh-volumetric`, built, if the shadow `rays` are expected to gain by it.
pub(crate) fn solid_where_it_pays<'a>(
    occluders: &'a Occluders,
    rays: &ShadowRays,
) -> Option<Box<dyn Engine + 'a>> {
    Some(Box::new(solid::Solid::where_it_pays(occluders, rays)?))
}

/// The engine of an ambient occlusion method.
///
/// # Errors
/// [`QueryError::Unsupported`] with the reason; [`QueryError::Mask`], [`QueryError::Occlusion`], [`QueryError::Cancelled`] of the
/// structures that are made for it.
pub fn sky<'a>(
    method: AoMethod,
    occluders: &'a Occluders,
    sky: &Sky,
    progress: Report<'_>,
) -> Result<Box<dyn Engine + 'a>, QueryError> {
    let kind: SceneKind = occluders.kind(sky.view);
    method.check(&kind)?;
    if sky.target_error.is_some() && method != AoMethod::Mask {
        let reason = "only method mask can aim at a target error";
        return Err(QueryError::Unsupported { method: method.name(), reason });
    }
    Ok(match method {
        AoMethod::Rays if sky.sides != Sides::Both && (kind.instances_apart || kind.surfaces) => {
            let reason = "sides other than both need instances and surfaces in one mesh";
            return Err(QueryError::Unsupported { method: method.name(), reason });
        }
        AoMethod::Rays if sky.sides == Sides::FrontFirst && !kind.opaque => {
            return Err(QueryError::Unsupported { method: method.name(), reason: FRONT_FIRST_NEEDS_OPAQUE });
        }
        AoMethod::Rays if kind.surfaces => Box::new(surface::Surface::new(method.name(), occluders)),
        AoMethod::Rays => Box::new(rays::Rays::new(method.name(), occluders, sky.sides)),
        AoMethod::Mask => Box::new(mask::Mask::build(occluders, sky)?),
        AoMethod::MaskPrefilter => Box::new(mask_prefilter::MaskPrefilter::build(occluders, sky, progress)?),
        AoMethod::MaskTable => Box::new(mask_table::MaskTable::build(occluders, sky)?),
        AoMethod::MaskRaster => Box::new(mask_raster::MaskRaster::build(occluders, sky)?),
        AoMethod::Prefilter if sky.sides != Sides::Both => {
            let reason = "prefiltered occluders block from both sides";
            return Err(QueryError::Unsupported { method: method.name(), reason });
        }
        AoMethod::Prefilter => {
            let threshold = sky.threshold.unwrap_or(prefilter::AO_THRESHOLD);
            Box::new(prefilter::Prefilter::build(occluders, threshold, progress)?)
        }
    })
}

/// Makes the structures that `method` will ask for, so that [`sky`] finds them.
///
/// # Errors
/// [`QueryError::Occlusion`], [`QueryError::Mask`], [`QueryError::Cancelled`].
pub fn prepare_sky(method: AoMethod, occluders: &Occluders, progress: Report<'_>) -> Result<(), QueryError> {
    match method {
        AoMethod::Prefilter => occluders.prefiltered(progress).map(drop),
        AoMethod::MaskPrefilter => occluders.far_opacity(progress).map(drop),
        AoMethod::Rays | AoMethod::Mask | AoMethod::MaskTable | AoMethod::MaskRaster => Ok(()),
    }
}

/// The parts of occluders in one mesh, which [`super::Needs::one_mesh`] has made sure of.
fn one_mesh<T>(method: &'static str, part: Option<T>) -> Result<T, QueryError> {
    part.ok_or(QueryError::Unsupported { method, reason: "instances are kept apart" })
}
