//! The oracle: every query as a loop over all triangles, with nothing but the predicate of `geom`.
//!
//! The hierarchies of this crate return exactly what these functions return. Callers give valid indices and finite
//! coordinates; an index out of range panics.

use crate::{Bvh, Hit, InstanceHit, Placement, object_from_world, object_ray};
use std::ops::ControlFlow;
use umbrage_geom::{OpticalDepth, Ray, TriangleHit, intersect_triangle, segment_hits_triangle};

/// Positions and triangles of one mesh.
pub type MeshSlices<'a> = (&'a [[f32; 3]], &'a [[u32; 3]]);

fn corners(positions: &[[f32; 3]], triangle: [u32; 3]) -> [[f32; 3]; 3] {
    triangle.map(|v| positions[v as usize])
}

/// See [`Bvh::any_hit`].
pub fn any_hit(positions: &[[f32; 3]], triangles: &[[u32; 3]], ray: &Ray) -> bool {
    triangles.iter().any(|&t| segment_hits_triangle(ray, corners(positions, t)))
}

/// See [`Bvh::closest_hit`].
pub fn closest_hit(positions: &[[f32; 3]], triangles: &[[u32; 3]], ray: &Ray) -> Option<Hit> {
    let mut closest: Option<Hit> = None;
    let _ = for_each_hit(positions, triangles, ray, |prim_index, hit| {
        let hit = Hit::new(prim_index, hit);
        if closest.is_none_or(|closest| hit.is_before(&closest)) {
            closest = Some(hit);
        }
        ControlFlow::Continue(())
    });
    closest
}

/// See [`Bvh::for_each_hit`]. Returns what the last visit returned.
pub fn for_each_hit(
    positions: &[[f32; 3]],
    triangles: &[[u32; 3]],
    ray: &Ray,
    mut visit: impl FnMut(u32, TriangleHit) -> ControlFlow<()>,
) -> ControlFlow<()> {
    for (i, &t) in triangles.iter().enumerate() {
        if let Some(hit) = intersect_triangle(ray, corners(positions, t)) {
            visit(i as u32, hit)?;
        }
    }
    ControlFlow::Continue(())
}

/// See [`Bvh::transmittance`].
pub fn transmittance(
    positions: &[[f32; 3]],
    triangles: &[[u32; 3]],
    ray: &Ray,
    depth_of: impl Fn(u32) -> OpticalDepth,
) -> OpticalDepth {
    let mut sum = OpticalDepth::CLEAR;
    let _ = for_each_hit(positions, triangles, ray, |prim_index, _| {
        sum += depth_of(prim_index);
        ControlFlow::Continue(())
    });
    if sum.is_opaque() { OpticalDepth::OPAQUE } else { sum }
}

/// See [`crate::InstancedBvh::for_each_hit`]; meshes are given as slices, one pair for each hierarchy. Placements that
/// can't be inverted are skipped.
pub fn for_each_instance_hit(
    meshes: &[MeshSlices],
    placements: &[Placement],
    ray: &Ray,
    mut visit: impl FnMut(u32, u32, TriangleHit) -> ControlFlow<()>,
) -> ControlFlow<()> {
    for (instance, placement) in placements.iter().enumerate() {
        let Some(object_from_world) = object_from_world(&placement.world_from_object) else { continue };
        let (positions, triangles) = meshes[placement.bvh as usize];
        let ray = object_ray(ray, &object_from_world);
        for_each_hit(positions, triangles, &ray, |prim_index, hit| visit(instance as u32, prim_index, hit))?;
    }
    ControlFlow::Continue(())
}

/// See [`crate::InstancedBvh::closest_hit`].
pub fn closest_instance_hit(
    meshes: &[MeshSlices],
    placements: &[Placement],
    ray: &Ray,
) -> Option<InstanceHit> {
    let mut closest: Option<InstanceHit> = None;
    let _ = for_each_instance_hit(meshes, placements, ray, |instance, prim_index, hit| {
        let hit = InstanceHit { instance, hit: Hit::new(prim_index, hit) };
        if closest.is_none_or(|closest| hit.is_before(&closest)) {
            closest = Some(hit);
        }
        ControlFlow::Continue(())
    });
    closest
}

/// Compares `bvh` with the loops on every ray; the first ray with a different answer, if any.
///
/// A self-check for tests and benches: never time a wrong answer.
pub fn first_difference(
    bvh: &Bvh,
    positions: &[[f32; 3]],
    triangles: &[[u32; 3]],
    rays: &[Ray],
) -> Option<usize> {
    rays.iter().position(|ray| {
        let truth = closest_hit(positions, triangles, ray);
        bvh.any_hit(ray) != truth.is_some() || bvh.closest_hit(ray) != truth
    })
}
