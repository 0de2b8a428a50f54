//! Boxes inside of meshes that are placed several times: each mesh has its own once, in its own space.

use super::{LazyScratch, LazySolidBvh, Prepared, Search, Watch};
use crate::{
    OcclusionError,
    volumetric::{Ends, object_mesh::unique_id},
};
use umbrage_accel::{Bvh, InstanceBoxes, InstancedBvh, Statistics};
use umbrage_geom::Ray;

/// Instances whose meshes have solid boxes; exact.
///
/// An instance is hit where [`umbrage_accel::object_ray`] hits its mesh, and that very ray, rounded as it is, is what boxes, ends
/// and guards are held against: so a box ends it only if it hits the mesh.
#[derive(Debug)]
pub struct SolidInstances<'a> {
    top: &'a InstancedBvh,
    meshes: Vec<LazySolidBvh<'a>>,
    /// See [`unique_id`].
    id: u64,
}

/// What a thread needs to trace rays. With other [`SolidInstances`] than before it starts anew.
#[derive(Debug)]
pub struct SolidInstancesScratch {
    /// By mesh.
    meshes: Vec<LazyScratch>,
    /// [`SolidInstances::id`] of all this.
    id: u64,
}

impl<'a> SolidInstances<'a> {
    /// With the boxes of `meshes`, one for each of `top`'s hierarchies.
    ///
    /// # Errors
    /// [`OcclusionError::Meshes`] if there are not as many; [`OcclusionError::Triangles`] if one is of another mesh.
    pub fn build(top: &'a InstancedBvh, meshes: Vec<LazySolidBvh<'a>>) -> Result<Self, OcclusionError> {
        let hierarchies = top.bvhs().len();
        if hierarchies != meshes.len() {
            return Err(OcclusionError::Meshes { meshes: meshes.len(), hierarchies });
        }
        for (bvh, mesh) in top.bvhs().iter().zip(&meshes) {
            let (count, triangles) = (bvh.prim_count(), mesh.prim_count());
            if count != triangles {
                return Err(OcclusionError::Triangles { count, triangles });
            }
        }
        Ok(Self { top, meshes, id: unique_id() })
    }

    /// What a thread needs to trace rays.
    pub fn scratch(&self) -> SolidInstancesScratch {
        SolidInstancesScratch { meshes: self.meshes.iter().map(LazySolidBvh::scratch).collect(), id: self.id }
    }

    /// What `scratch` has for the meshes, made anew if it was that of others.
    #[inline]
    fn own<'s>(&self, scratch: &'s mut SolidInstancesScratch) -> &'s mut [LazyScratch] {
        if scratch.id != self.id {
            *scratch = self.scratch();
        }
        &mut scratch.meshes
    }

    /// Whether the open segment meets any triangle of any instance. Prepares the objects that it reaches.
    pub fn any_hit(&self, ray: &Ray, scratch: &mut SolidInstancesScratch) -> bool {
        let mut entered = Entered { meshes: &self.meshes, scratch: self.own(scratch), watch: &mut () };
        self.top.any_hit_among_with(ray, &mut entered, &mut ())
    }

    /// [`Self::any_hit`], counted.
    pub fn any_hit_with(
        &self,
        ray: &Ray,
        scratch: &mut SolidInstancesScratch,
        stats: &mut impl Statistics,
    ) -> bool {
        let mut ended = None;
        let mut entered = Entered { meshes: &self.meshes, scratch: self.own(scratch), watch: &mut ended };
        let hit = self.top.any_hit_among_with(ray, &mut entered, stats);
        ended.into_iter().for_each(|remembered| stats.ended_in_solid(remembered));
        hit
    }

    /// [`LazySolidBvh::prepare_all`] of all meshes.
    pub fn prepare_all(&self) {
        self.meshes.iter().for_each(LazySolidBvh::prepare_all);
    }

    /// How much was prepared so far, over all meshes.
    pub fn prepared(&self) -> Prepared {
        let mut sum = Prepared::default();
        self.meshes.iter().for_each(|mesh| sum += mesh.prepared());
        sum
    }
}

/// The meshes as one ray enters them.
struct Entered<'a, 'b, W> {
    meshes: &'a [LazySolidBvh<'b>],
    scratch: &'a mut [LazyScratch],
    watch: &'a mut W,
}

impl<W: Watch> InstanceBoxes for Entered<'_, '_, W> {
    type SolidBoxes<'s>
        = Search<'s, W>
    where
        Self: 's;

    #[inline(always)]
    fn inside(&mut self, bvh: u32, ray: &Ray) -> Option<(&Bvh, Search<'_, W>)> {
        let scratch = &mut self.scratch[bvh as usize];
        self.meshes[bvh as usize].reach(std::slice::from_ref(ray), scratch);
        let (solid, scratch) = scratch.boxes()?;
        // Boxes that ended rays to a light in one instance say little about the others.
        Some((solid.bvh(), solid.search(Ends::Unknown, None, scratch, self.watch)))
    }
}
