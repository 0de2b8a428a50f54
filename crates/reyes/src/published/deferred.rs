//! Shadow rays that try the patches nearest to their end first (Djeu 2011, section 6.15, the deferment list).

use crate::{SurfaceTracer, TraceState};
use std::ops::ControlFlow;
use umbrage_geom::{Ray, RayDifferential};

/// [`SurfaceTracer::any_hit`] with the patches nearest to the segment's end tried first: an occluder there, where a diverging
/// ray is wide, spares the fine rates near the origin.
///
/// The answer is that of [`SurfaceTracer::any_hit`].
pub fn any_hit_deferred(
    tracer: &SurfaceTracer,
    ray: &Ray,
    differential: &RayDifferential,
    state: &mut TraceState,
) -> bool {
    if tracer.is_blocked_inside(ray, state) {
        return true;
    }
    let mut deferred = std::mem::take(&mut state.deferred);
    deferred.clear();
    let _ = tracer.bvh.walk(ray, |patch| {
        deferred.push(patch);
        ControlFlow::Continue(ray.tfar)
    });
    let hit = tracer.start(ray, differential, state, true).is_some_and(|mut query| {
        // Last in, first out.
        deferred.iter().rev().any(|&patch| query.patch(patch))
    });
    state.deferred = deferred;
    hit
}
