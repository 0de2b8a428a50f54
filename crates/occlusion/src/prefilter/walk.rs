//! A ray with a solid angle through the wide tree (`[Lacewell08]`, Algorithm 1, by the node instead of by the box).
//!
//! Here: the walk of one ray. Not here: many rays at once (`fan.rs`, `packet.rs`), boxes (`kernel`), opacities (`opacity.rs`).
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

/// Optical depths of triangles, leaf by leaf, so that a hit needs no index of its triangle.
#[derive(Clone, Debug)]
pub(crate) enum Depths {
    Uniform(OpticalDepth),
    /// Up to 256 different ones, and which of them each lane has.
    Palette(Vec<OpticalDepth>, Vec<[u8; LANES]>),
    PerLane(Vec<[OpticalDepth; LANES]>),
}

impl Depths {
    /// For opacities in `[0, 1]`, one or one a triangle, and the triangles in the lanes of leaves.
    pub(crate) fn new(opacity: &[f32], wide: &Wide) -> Self {
        let mut different: Vec<u32> = opacity.iter().map(|a| a.to_bits()).collect();
        different.sort_unstable();
        different.dedup();
        if let [one] = different[..] {
            return Self::Uniform(OpticalDepth::from_opacity(f32::from_bits(one)));
        }
        let lanes = || (0..wide.blocks.len()).map(|leaf| wide.leaf_prims(leaf));
        let row =
            |prims: &[u32]| std::array::from_fn(|lane| opacity[prims[lane.min(prims.len() - 1)] as usize]);
        if different.len() > 256 {
            return Self::PerLane(lanes().map(|prims| row(prims).map(OpticalDepth::from_opacity)).collect());
        }
        // Bits of numbers from 0 are in the order of the numbers.
        let place = |a: f32| different.binary_search(&a.to_bits()).unwrap_or(0) as u8;
        let lanes = lanes().map(|prims| row(prims).map(place)).collect();
        Self::Palette(
            different.iter().map(|&a| OpticalDepth::from_opacity(f32::from_bits(a))).collect(),
            lanes,
        )
    }

    #[inline(always)]
    pub(crate) fn of(&self, leaf: usize, lane: usize) -> OpticalDepth {
        match self {
            Self::Uniform(depth) => *depth,
            Self::Palette(palette, lanes) => palette[usize::from(lanes[leaf][lane])],
            Self::PerLane(lanes) => lanes[leaf][lane],
        }
    }

    pub(crate) fn bytes(&self) -> usize {
        match self {
            Self::Uniform(_) => 0,
            Self::Palette(palette, lanes) => size_of_val(&palette[..]) + size_of_val(&lanes[..]),
            Self::PerLane(lanes) => size_of_val(&lanes[..]),
        }
    }
}

/// What a ray has lost.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Lost {
    /// In nodes, bits.
    stored: f32,
    /// In triangles.
    exact: OpticalDepth,
    /// What it may lose in nodes until it is black.
    room: f32,
    /// What it may lose in all.
    limit: f32,
}

impl Lost {
    /// Nothing yet. A ray that no node may end (`kappa` 0) goes on until nothing at all is left.
    #[inline(always)]
    pub(crate) fn nothing(kappa: f32) -> Self {
        let limit = if kappa > 0.0 { BLACK } else { f32::INFINITY };
        Self { stored: 0.0, exact: OpticalDepth::CLEAR, room: limit, limit }
    }

    /// Adds a node's share; whether the ray is black.
    #[inline(always)]
    pub(crate) fn add_stored(&mut self, bits: f32) -> bool {
        self.stored += bits;
        self.stored > self.room
    }

    /// Adds triangles; whether the ray is black.
    #[inline(always)]
    pub(crate) fn add_exact(&mut self, depth: OpticalDepth) -> bool {
        self.exact += depth;
        self.room = self.limit - self.exact.bits();
        self.stored > self.room || self.exact.is_opaque()
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
    stats.triangles(block.len() as u32);
    stats.uncertain(mask.uncertain.count_ones());
    let mut depth = OpticalDepth::CLEAR;
    let mut open = mask.certain | mask.uncertain;
    while open != 0 {
        let lane = open.trailing_zeros() as usize % LANES;
        open &= open - 1;
        if mask.certain >> lane & 1 == 1 || segment_hits_triangle(ray, block.get(lane)) {
            depth += depths.of(leaf, lane);
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
    /// Fraction of light that `ray` keeps in the subtree of `start`, a child reference; 0 from [`BLACK`] on.
    #[inline(always)]
    pub(crate) fn walk<K: Kernel, S: StopStatistics>(
        &self,
        kernel: K,
        start: u32,
        ray: &Ray,
        prepared: &Prepared,
        view: T::View,
        stats: &mut S,
    ) -> f32 {
        let Self { wide, depths, table } = *self;
        let mut lost = Lost::nothing(prepared.kappa);
        if start & LEAF != 0 {
            let leaf = (start & !LEAF) as usize;
            let depth = leaf_depth(kernel, wide, depths, leaf, ray, prepared, stats);
            return if lost.add_exact(depth) { 0.0 } else { lost.transmittance() };
        }
        let mut stack = [(0u32, 0u32); MAX_LEVELS];
        let mut depth = 0;
        let (mut index, mut mask) = (start, 0);
        let mut enter = true;
        loop {
            if enter {
                let node = &wide.nodes[index as usize];
                let Step { descend, stop, fraction } =
                    kernel.step(node, prepared, &kernel.sizes(node, prepared.origin));
                stats.node(node.len() as u32);
                if stop != 0 {
                    stats.stops(stop, || wide.levels.partition_point(|level| level.end <= index as usize));
                    let rows = table.depths(view, index as usize);
                    if lost.add_stored(dot(&rows, &fraction)) {
                        return 0.0;
                    }
                }
                mask = descend;
            }
            if mask == 0 {
                if depth == 0 {
                    return lost.transmittance();
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
                if added != OpticalDepth::CLEAR && lost.add_exact(added) {
                    return 0.0;
                }
            }
        }
    }
}
