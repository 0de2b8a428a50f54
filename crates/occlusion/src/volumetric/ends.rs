//! The endpoint rule: a segment both of whose ends are inside of something may cross opaque cells and hit nothing.

use umbrage_accel::{
    KdTree,
    kdtree::{LeafState, Location},
};
use umbrage_geom::{Aabb, Ray, glam::DVec3};

/// What the caller knows of the ends of segments.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Ends {
    /// Nothing: each ray's ends are looked up, the far one first. Where both are in boundary cells or inside, only triangles
    /// count.
    #[default]
    Unknown,
    /// One end of each segment is outside of every generator, as [`super::KdVolumetric::is_outside`] says of a light.
    Outside,
}

/// Far more than `f64` can err by in `origin + t * direction`, relative to what is added.
const MARGIN: f64 = 1.0 / (1u64 << 45) as f64;

/// The point at `t` (finite), and how far off along each axis it may be.
fn end(ray: &Ray, t: f32) -> (DVec3, f64) {
    let (origin, step) = (ray.origin.as_dvec3(), f64::from(t) * ray.direction.as_dvec3());
    (origin + step, origin.abs().max(step.abs()).max_element() * MARGIN)
}

/// Whether `outside(point, margin)` is true of an end of the segment: whatever is within `margin` of `point` along each axis.
#[inline]
pub(crate) fn either(ray: &Ray, outside: impl Fn(DVec3, f64) -> bool) -> bool {
    if ray.tfar == f32::INFINITY {
        return true;
    }
    [ray.tfar, ray.tnear].into_iter().any(|t| {
        let (point, margin) = end(ray, t);
        outside(point, margin)
    })
}

/// Whether an end of the segment is surely in space of winding number 0.
#[inline]
pub(crate) fn is_outside(tree: &KdTree, ray: &Ray) -> bool {
    either(ray, |point, margin| {
        matches!(tree.locate(point, margin), Location::Outside | Location::Inside(LeafState::Clear))
    })
}

/// Whether all points of the closed `region` are surely in space of winding number 0.
pub(crate) fn region_is_outside(tree: &KdTree, region: &Aabb) -> bool {
    let bounds = tree.bounds();
    region.max.cmplt(bounds.min).any()
        || region.min.cmpgt(bounds.max).any()
        || tree.all_in(region, LeafState::Clear)
}
