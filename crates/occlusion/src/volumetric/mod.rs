//! Opaque cells inside closed meshes end shadow rays early, and images don't change (Djeu11, chapters 2 to 4).
//!
//! # Theorem
//! Let turned triangles be a closed surface ([`umbrage_geom::audit`]), `x` a point of an open segment and `y` another point of
//! it or one of its ends, neither on the surface, with different winding numbers. Then
//! [`umbrage_geom::segment_hits_triangle`] is true for the segment and one of the triangles. For the winding numbers of `x`
//! and `y` moved by the same small enough vector are what they were, so every segment moved so crosses a triangle between
//! the two; a triangle that is crossed for a sequence of such vectors that shrinks to zero is met, as triangles are closed, and
//! its plane does not contain the direction, which doesn't change.
//!
//! So a segment that passes through the inside of an empty cell of winding number other than 0 is blocked, given that one of its
//! ends, or any point of it, is known to be in space of winding number 0. Three rules keep this exact:
//!
//! - *Insides only.* A cell ends a ray only if the segment surely has a point strictly inside it, whatever was rounded
//!   ([`umbrage_geom::SlabRay::surely_crosses`]). Djeu11, section 3.6.1 leaves false occlusion near the edges of cells open.
//! - *The endpoint rule.* One end must be outside; [`Ends`] says how that is known. Djeu11, section 3.3 assumes it.
//! - *Guards.* A mesh with holes is closed by caps, and what its cells say holds for segments that don't meet the boxes around
//!   the caps. Djeu11, section 4.7.4 rejects such meshes.
//!
//! Self-intersections, nested and touching shells do no harm, so the audit's test for them (Djeu11, section 3.2) isn't
//! needed here.

mod boxes;
mod cache;
mod carve;
mod classify;
mod ends;
mod grown;
mod kd;
mod object_mesh;
pub mod published;
mod solids;
mod voxels;
mod wide;

pub use ends::Ends;
pub use kd::{KdQuery, KdVolumetric, KdVolumetricOptions, KdVolumetricScratch};
pub use object_mesh::{Object, ObjectMesh};
pub use solids::{Solid, SolidOptions, Solids};
pub use wide::{
    Forecast, LazyScratch, LazySolidBvh, Prepared, ShadowRays, SolidBvh, SolidBvhOptions, SolidInstances,
    SolidInstancesScratch, SolidScratch,
};
