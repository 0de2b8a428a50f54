//! Boxes inside of solids that end rays at nodes.
//!
//! Here: eight such boxes, and what their owner is asked. Not here: where boxes come from and why they block
//! (`umbrage-occlusion`, module `volumetric`), walking (`traversal.rs`, `fan.rs`).

use crate::node::WIDTH;
use umbrage_geom::{Aabb, Ray};

/// Eight boxes, one a lane, tested in one step. Unlike those of nodes they are not rounded. Empty lanes have boxes that no
/// segment crosses.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
pub struct SolidPack {
    /// Smallest x, largest x, smallest y, ..
    pub(crate) rows: [[f32; WIDTH]; 6],
}

impl SolidPack {
    /// Boxes that there is room for.
    pub const LANES: usize = WIDTH;

    /// No box.
    pub const EMPTY: Self = {
        let (inf, neg) = ([f32::INFINITY; WIDTH], [f32::NEG_INFINITY; WIDTH]);
        Self { rows: [inf, neg, inf, neg, inf, neg] }
    };

    /// Puts a box into `lane`.
    ///
    /// # Panics
    /// If `lane` is not below [`Self::LANES`].
    #[inline]
    pub fn set(&mut self, lane: usize, aabb: &Aabb) {
        for axis in 0..3 {
            self.rows[2 * axis][lane] = aabb.min[axis];
            self.rows[2 * axis + 1][lane] = aabb.max[axis];
        }
    }

    /// The box in `lane`.
    ///
    /// # Panics
    /// If `lane` is not below [`Self::LANES`].
    #[inline]
    pub fn get(&self, lane: usize) -> Aabb {
        let at = |row: usize| self.rows[row][lane];
        Aabb { min: [at(0), at(2), at(4)].into(), max: [at(1), at(3), at(5)].into() }
    }
}

/// The owner of boxes that end rays ([`crate::Bvh::any_hit_among_with`]).
///
/// A node whose [`crate::NodeNote::index`] is not 0 has the pack of that index, which rays meet before the node's children.
pub trait SolidBoxes {
    /// Whether there are any at all.
    const ANY: bool = true;

    /// Pack `index`, if there is one.
    fn pack(&self, index: u32) -> Option<&SolidPack>;

    /// Whether the boxes in `lanes` (a bit each) of pack `index` block the segment, which surely has a point strictly inside
    /// each of them. `place` is that of the ray in its batch.
    fn blocks(&mut self, ray: &Ray, place: usize, index: u32, lanes: u32) -> bool;
}

/// No boxes.
impl SolidBoxes for () {
    const ANY: bool = false;

    #[inline(always)]
    fn pack(&self, _: u32) -> Option<&SolidPack> {
        None
    }

    #[inline(always)]
    fn blocks(&mut self, _: &Ray, _: usize, _: u32, _: u32) -> bool {
        false
    }
}

impl<S: SolidBoxes> SolidBoxes for &mut S {
    const ANY: bool = S::ANY;

    #[inline(always)]
    fn pack(&self, index: u32) -> Option<&SolidPack> {
        S::pack(self, index)
    }

    #[inline(always)]
    fn blocks(&mut self, ray: &Ray, place: usize, index: u32, lanes: u32) -> bool {
        S::blocks(self, ray, place, index, lanes)
    }
}
