//! Which method answers, and why.
//!
//! `auto` takes exact methods only, and its choice says what it was and what was against others. A method that was asked for by
//! name is taken, or the call fails.

use super::{
    AoMethod, Engine, Occluders, QueryError, Selection, ShadowMethod, Sky,
    engine::{self, Report, mask_rays},
};
use umbrage_occlusion::volumetric::ShadowRays;

/// A method at work, and why it was taken.
pub struct Choice<'a> {
    /// The method.
    pub engine: Box<dyn Engine + 'a>,
    /// One line for people.
    pub reason: &'static str,
}

/// Why a method was taken that was asked for.
const ASKED_FOR: &str = "asked for";

/// The shadow method for the `rays` that are expected.
///
/// # Errors
/// Those of [`engine::shadows`].
pub fn shadows<'a>(
    selection: Selection<ShadowMethod>,
    occluders: &'a Occluders,
    rays: &ShadowRays,
    progress: Report<'_>,
) -> Result<Choice<'a>, QueryError> {
    let (method, reason) = match selection {
        Selection::Method(method) => (method, ASKED_FOR),
        Selection::Auto => {
            if occluders.has_surfaces() {
                let engine = engine::shadows(ShadowMethod::Bvh, occluders, progress)?;
                return Ok(Choice { engine, reason: "exact; subdivision surfaces are traced as such" });
            }
            if let Some(engine) = engine::solid_where_it_pays(occluders, rays) {
                let reason = "exact; many rays are expected to end at boxes inside of solids";
                return Ok(Choice { engine, reason });
            }
            (ShadowMethod::Bvh, "exact; few rays are expected to end at boxes inside of solids")
        }
    };
    Ok(Choice { engine: engine::shadows(method, occluders, progress)?, reason })
}

/// The ambient occlusion method for a sky.
///
/// # Errors
/// Those of [`engine::sky`].
pub fn sky<'a>(
    selection: Selection<AoMethod>,
    occluders: &'a Occluders,
    sky: &Sky,
    progress: Report<'_>,
) -> Result<Choice<'a>, QueryError> {
    let (method, reason) = match selection {
        Selection::Method(method) => (method, ASKED_FOR),
        Selection::Auto if !mask_rays(sky.pattern.rays) => {
            (AoMethod::Rays, "exact; masks need a multiple of 8 rays up to 1024")
        }
        Selection::Auto if occluders.has_surfaces() => {
            (AoMethod::Rays, "exact; subdivision surfaces are traced as such, and masks need meshes")
        }
        Selection::Auto if occluders.is_instanced() => {
            (AoMethod::Rays, "exact; instances are kept apart, and masks need them in one mesh")
        }
        Selection::Auto => (AoMethod::Mask, "exact, and faster than single rays"),
    };
    let engine = engine::sky(method, occluders, sky, progress)?;
    let reason = engine.note().unwrap_or(reason);
    Ok(Choice { engine, reason })
}

/// What `auto` takes for a sky of `rays` rays over receivers in one mesh, before anything is built.
pub fn sky_of_one_mesh(selection: Selection<AoMethod>, rays: u32) -> AoMethod {
    match selection {
        Selection::Method(method) => method,
        Selection::Auto if mask_rays(rays) => AoMethod::Mask,
        Selection::Auto => AoMethod::Rays,
    }
}
