//! A ray with a solid angle through the wide tree ([Lacewell08], Algorithm 1, by the node instead of by the box).
//!
//! Here: the walk of one ray. Not here: many rays at once (`packet.rs`), boxes (`kernel`), opacities (`opacity.rs`).
//!
//! Departures: children are composited by adding optical depths; nothing is interpolated between levels, see
//! [`super::Blend`]; a node crossed in part dims in part; the ray ends where 10 bits are lost.

use super::{
    kernel::{Kernel, Prepared, Step, dot},
    storage::Table,
    wide::{LEAF, MAX_LEVELS, WIDTH, Wide},
};
use umbrage_accel::Statistics;
use umbrage_geom::{OpticalDepth, Ray, kernel::LANES, segment_hits_triangle};

/// Optical depth in bits from which an approximate ray counts as blocked: less than a thousandth is lost.
pub(crate) const BLACK: f32 = 10.0;

/// Watches where rays end, beside what [`Statistics`] sees.
pub trait StopStatistics: Statistics {
    /// The ray ended at `slots` (a bit each) of the children of `node`, which is on `level`; the root is on level 0.
    #[inline(always)]
    fn stops(&mut self, slots: u32, level: impl FnOnce() -> usize) {
        let _ = (slots, level);
    }
}

impl StopStatistics for () {}
impl StopStatistics for umbrage_accel::Counters {}

/// Optical depths of triangles.
#[derive(Clone, Debug)]
pub(crate) enum Depths {
    Opaque,
    Uniform(OpticalDepth),
    PerTriangle(Vec<OpticalDepth>),
}

impl Depths {
    #[inline(always)]
    pub(crate) fn of(&self, prim: u32) -> OpticalDepth {
        match self {
            Self::Opaque => OpticalDepth::OPAQUE,
            Self::Uniform(depth) => *depth,
            Self::PerTriangle(depths) => depths[prim as usize],
        }
    }

    pub(crate) fn bytes(&self) -> usize {
        if let Self::PerTriangle(depths) = self { size_of_val(&depths[..]) } else { 0 }
    }
}

/// What a ray has lost.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Lost {
    /// In nodes, bits.
    pub(crate) stored: f32,
    /// In triangles.
    pub(crate) exact: OpticalDepth,
}

impl Lost {
    /// Whether a ray that may end at nodes is blocked.
    #[inline(always)]
    pub(crate) fn is_black(&self) -> bool {
        self.exact.is_opaque() || self.stored + self.exact.bits() > BLACK
    }

    /// Fraction that passes: that of the triangles alone where no node took part.
    #[inline(always)]
    pub(crate) fn transmittance(&self) -> f32 {
        // Powers take longer than a node.
        let exact = if self.exact == OpticalDepth::CLEAR { 1.0 } else { self.exact.transmittance() };
        if self.stored == 0.0 { exact } else { exact * (-self.stored).exp2() }
    }
}

/// What a leaf adds: every triangle that the segment hits.
#[inline(always)]
pub(crate) fn leaf_depth<K: Kernel, S: Statistics>(
    kernel: K,
    wide: &Wide,
    depths: &Depths,
    leaf: usize,
    ray: &Ray,
    prepared: &Prepared,
    stats: &mut S,
) -> OpticalDepth {
    let block = &wide.blocks[leaf];
    let mask = kernel.filter(block, &prepared.block);
    stats.triangles(wide.leaf_prims(leaf).count() as u32);
    stats.uncertain(mask.uncertain.count_ones());
    let mut depth = OpticalDepth::CLEAR;
    let mut open = mask.certain | mask.uncertain;
    while open != 0 {
        let lane = open.trailing_zeros() as usize % LANES;
        open &= open - 1;
        if mask.certain >> lane & 1 == 1 || segment_hits_triangle(ray, block.get(lane)) {
            depth += depths.of(wide.prims[leaf][lane]);
        }
    }
    depth
}

/// The tree and what belongs to it.
pub(crate) struct Scene<'a, T> {
    pub(crate) wide: &'a Wide,
    pub(crate) depths: &'a Depths,
    pub(crate) table: &'a T,
}

// Derived, these would ask for tables that can be copied.
impl<T> Clone for Scene<'_, T> {
    fn clone(&self) -> Self {
        *self
    }
}

impl<T> Copy for Scene<'_, T> {}

impl<T: Table> Scene<'_, T> {
    /// What `ray` loses in the subtree of `start`, a child reference. With `exact`, until nothing is left; otherwise until
    /// [`BLACK`], where all counts as lost.
    #[inline(always)]
    pub(crate) fn walk<K: Kernel, S: StopStatistics>(
        &self,
        kernel: K,
        start: u32,
        ray: &Ray,
        prepared: &Prepared,
        view: T::View,
        stats: &mut S,
    ) -> Lost {
        let Self { wide, depths, table } = *self;
        let mut lost = Lost::default();
        if start & LEAF != 0 {
            lost.exact = leaf_depth(kernel, wide, depths, (start & !LEAF) as usize, ray, prepared, stats);
            return lost;
        }
        let black = Lost { stored: 0.0, exact: OpticalDepth::OPAQUE };
        let approximate = prepared.kappa > 0.0;
        let mut stack = [(0u32, 0u32); MAX_LEVELS];
        let mut depth = 0;
        let (mut index, mut mask) = (start, 0);
        let mut enter = true;
        loop {
            if enter {
                let node = &wide.nodes[index as usize];
                let Step { descend, stop, fraction } =
                    kernel.step(node, prepared, &kernel.distances(node, prepared.origin));
                stats.node(node.len() as u32);
                if stop != 0 {
                    stats.stops(stop, || wide.levels.partition_point(|level| level.end <= index as usize));
                    let rows = table.depths(view, index as usize);
                    lost.stored += dot(&rows, &fraction);
                    if lost.is_black() {
                        return black;
                    }
                }
                mask = descend;
            }
            if mask == 0 {
                if depth == 0 {
                    return lost;
                }
                depth -= 1;
                // Only nodes with children left are on the stack.
                (index, mask) = stack[depth];
            }
            let child = wide.nodes[index as usize].children[mask.trailing_zeros() as usize % WIDTH];
            mask &= mask - 1;
            enter = child & LEAF == 0;
            if enter {
                if mask != 0 {
                    stack[depth] = (index, mask);
                    depth += 1;
                }
                index = child;
            } else {
                let leaf = (child & !LEAF) as usize;
                let added = leaf_depth(kernel, wide, depths, leaf, ray, prepared, stats);
                if added != OpticalDepth::CLEAR {
                    lost.exact += added;
                    if if approximate { lost.is_black() } else { lost.exact.is_opaque() } {
                        return black;
                    }
                }
            }
        }
    }
}
