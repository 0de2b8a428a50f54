//! Single rays through a tree, on any kernel.
//!
//! Here: walks from leaf to leaf, in the order of children or from near to far, and the queries of [`Bvh`] that use them:
//! any hit, with and without boxes inside of solids, closest hit, all hits, transmittance. Not here: rays of one origin that
//! walk together (`fan.rs`), packets (`packet.rs`), kd-trees (`kdtree`).

use crate::{
    Bvh, Hit, Statistics,
    kernel::{Kernel, NodeRay, Prepared},
    node::{LEAF, MAX_LEVELS, Node, Tree, WIDTH},
    solid::SolidBoxes,
};
use std::ops::ControlFlow;
use umbrage_geom::{
    OpticalDepth, Ray, SlabRay, TriangleHit, intersect_triangle,
    kernel::{BlockMask, BlockRay, LANES},
    segment_hits_triangle,
};

/// The leaves whose boxes a segment may enter, in the order of children.
///
/// An iterator, since closures can't be forced into the function that has the kernel's target features. The stack holds
/// what is left of each node on the way down, one entry a level.
pub(crate) struct Walk<'a, K> {
    kernel: K,
    nodes: &'a [Node],
    ray: &'a NodeRay,
    stack: [(u32, u32); MAX_LEVELS],
    depth: usize,
    index: u32,
    /// Children of node `index` still to visit.
    mask: u32,
}

impl<'a, K: Kernel> Walk<'a, K> {
    #[inline(always)]
    pub(crate) fn new<S: Statistics>(kernel: K, tree: &'a Tree, ray: &'a NodeRay, stats: &mut S) -> Self {
        let nodes = &tree.nodes[..];
        let mask = kernel.mask(&nodes[0], ray, ray.slab.tfar);
        stats.node(nodes[0].len() as u32);
        Self { kernel, nodes, ray, stack: [(0, 0); MAX_LEVELS], depth: 0, index: 0, mask }
    }

    #[inline(always)]
    pub(crate) fn next<S: Statistics>(&mut self, stats: &mut S) -> Option<usize> {
        loop {
            while self.mask == 0 {
                if self.depth == 0 {
                    return None;
                }
                self.depth -= 1;
                (self.index, self.mask) = self.stack[self.depth];
            }
            let node = &self.nodes[self.index as usize];
            let child = node.children[self.mask.trailing_zeros() as usize % WIDTH];
            self.mask &= self.mask - 1;
            if child & LEAF != 0 {
                return Some((child & !LEAF) as usize);
            }
            if self.mask != 0 {
                self.stack[self.depth] = (self.index, self.mask);
                self.depth += 1;
            }
            self.index = child;
            let node = &self.nodes[child as usize];
            self.mask = self.kernel.mask(node, self.ray, self.ray.slab.tfar);
            stats.node(node.len() as u32);
        }
    }
}

/// The leaves whose boxes a segment may enter, roughly from near to far.
pub(crate) struct SortedWalk<'a, K> {
    kernel: K,
    nodes: &'a [Node],
    ray: &'a NodeRay,
    /// Entry and reference of what is still to visit, each node's nearest child on top.
    stack: [(f32, u32); (WIDTH - 1) * MAX_LEVELS + 1],
    top: usize,
    tfar: f32,
}

impl<'a, K: Kernel> SortedWalk<'a, K> {
    #[inline(always)]
    pub(crate) fn new(kernel: K, tree: &'a Tree, ray: &'a NodeRay) -> Self {
        let stack = [(0.0, 0); (WIDTH - 1) * MAX_LEVELS + 1];
        Self { kernel, nodes: &tree.nodes, ray, stack, top: 1, tfar: ray.slab.tfar }
    }

    /// Ends the segment at `tfar` (the ray's `t`) from now on.
    #[inline(always)]
    pub(crate) fn set_tfar(&mut self, tfar: f32) {
        self.tfar = self.ray.slab.scaled_tfar(tfar);
    }

    #[inline(always)]
    pub(crate) fn next<S: Statistics>(&mut self, stats: &mut S) -> Option<usize> {
        let mut entries = [0.0; WIDTH];
        while self.top > 0 {
            self.top -= 1;
            let (entry, child) = self.stack[self.top];
            if entry > self.tfar {
                continue;
            }
            if child & LEAF != 0 {
                return Some((child & !LEAF) as usize);
            }
            let node = &self.nodes[child as usize];
            let mut mask = self.kernel.entries(node, self.ray, self.tfar, &mut entries);
            stats.node(node.len() as u32);
            let bottom = self.top;
            while mask != 0 {
                let slot = mask.trailing_zeros() as usize % WIDTH;
                mask &= mask - 1;
                // Insertion, nearest on top.
                let (entry, mut at) = (entries[slot], self.top);
                while at > bottom && self.stack[at - 1].0 < entry {
                    self.stack[at] = self.stack[at - 1];
                    at -= 1;
                }
                self.stack[at] = (entry, node.children[slot]);
                self.top += 1;
            }
        }
        None
    }
}

/// A segment cut just behind `t`, so that what ties with a hit at `t` after rounding is still inside.
#[inline]
pub(crate) fn just_behind(t: f32) -> f32 {
    (t * (1.0 + 2f32.powi(-20))).next_up()
}

/// Lanes of a leaf that are hit for certain, and lanes left open.
#[inline(always)]
pub(crate) fn filter<K: Kernel, S: Statistics>(
    kernel: K,
    bvh: &Bvh,
    leaf: usize,
    ray: &BlockRay,
    stats: &mut S,
) -> BlockMask {
    let mask = kernel.filter(&bvh.blocks[leaf], ray);
    stats.triangles(bvh.blocks[leaf].len() as u32);
    stats.uncertain(mask.uncertain.count_ones());
    mask
}

/// Lowest lane of `open`, taken out.
#[inline(always)]
fn take_lane(open: &mut u8) -> usize {
    let lane = open.trailing_zeros() as usize % LANES;
    *open &= *open - 1;
    lane
}

/// The walk of [`Walk`] once more, as a loop with its state in registers: 5 % faster. Prefetching the child after next
/// changed nothing on the bunny and the dragon.
#[inline(always)]
pub(crate) fn any_hit<K: Kernel, S: Statistics>(kernel: K, bvh: &Bvh, ray: &Ray, stats: &mut S) -> bool {
    any_hit_among(kernel, bvh, ray, 0, &mut (), stats)
}

/// Whether boxes of a node, of which `entered` are the children that the ray enters, block it.
#[inline(always)]
fn ends_inside<K: Kernel, B: SolidBoxes>(
    kernel: K,
    node: &Node,
    entered: u32,
    ray: &Ray,
    prepared: &NodeRay,
    place: usize,
    solids: &mut B,
) -> bool {
    let index = node.note.index;
    if !B::ANY || index == 0 || entered == 0 {
        return false;
    }
    let crossed = solids.pack(index).map_or(0, |pack| kernel.crossed(pack, prepared));
    crossed != 0 && solids.blocks(ray, place, index, crossed)
}

/// [`any_hit`] of the ray in place `place` of a batch, which may end at `solids`.
#[inline(always)]
pub(crate) fn any_hit_among<K: Kernel, B: SolidBoxes, S: Statistics>(
    kernel: K,
    bvh: &Bvh,
    ray: &Ray,
    place: usize,
    solids: &mut B,
    stats: &mut S,
) -> bool {
    let Some(slab) = SlabRay::new(ray) else { return false };
    let node_ray = NodeRay::new(slab);
    let nodes = &bvh.tree.nodes[..];
    let tfar = node_ray.slab.tfar;
    let mut stack = [(0u32, 0u32); MAX_LEVELS];
    let mut depth = 0;
    let mut node = &nodes[0];
    let mut index = 0;
    let mut mask = kernel.mask(node, &node_ray, tfar);
    stats.node(node.len() as u32);
    if ends_inside(kernel, node, mask, ray, &node_ray, place, solids) {
        return true;
    }
    // Rays that end at boxes don't need it.
    let mut block = if B::ANY { None } else { BlockRay::new(ray) };
    loop {
        if mask == 0 {
            if depth == 0 {
                return false;
            }
            depth -= 1;
            // Only nodes with children left are on the stack.
            (index, mask) = stack[depth];
            node = &nodes[index as usize];
        }
        let child = node.children[mask.trailing_zeros() as usize % WIDTH];
        mask &= mask - 1;
        if child & LEAF != 0 {
            let leaf = (child & !LEAF) as usize;
            if B::ANY && block.is_none() {
                block = BlockRay::new(ray);
            }
            let Some(prepared) = block else { return false };
            let BlockMask { certain, uncertain: mut open } = filter(kernel, bvh, leaf, &prepared, stats);
            if certain != 0 {
                return true;
            }
            while open != 0 {
                if segment_hits_triangle(ray, bvh.blocks[leaf].get(take_lane(&mut open))) {
                    return true;
                }
            }
        } else {
            if mask != 0 {
                stack[depth] = (index, mask);
                depth += 1;
            }
            index = child;
            node = &nodes[index as usize];
            mask = kernel.mask(node, &node_ray, tfar);
            stats.node(node.len() as u32);
            if ends_inside(kernel, node, mask, ray, &node_ray, place, solids) {
                return true;
            }
        }
    }
}

#[inline(always)]
pub(crate) fn for_each_hit<K: Kernel, S: Statistics>(
    kernel: K,
    bvh: &Bvh,
    ray: &Ray,
    visit: &mut impl FnMut(u32, TriangleHit) -> ControlFlow<()>,
    stats: &mut S,
) -> ControlFlow<()> {
    let Some(prepared) = Prepared::new(ray) else { return ControlFlow::Continue(()) };
    let mut walk = Walk::new(kernel, &bvh.tree, &prepared.node, stats);
    while let Some(leaf) = walk.next(stats) {
        let mask = filter(kernel, bvh, leaf, &prepared.block, stats);
        let mut open = mask.certain | mask.uncertain;
        while open != 0 {
            let lane = take_lane(&mut open);
            if let Some(hit) = intersect_triangle(ray, bvh.blocks[leaf].get(lane)) {
                visit(bvh.prim(leaf, lane), hit)?;
            }
        }
    }
    ControlFlow::Continue(())
}

/// Calls `visit` once with the index of every triangle hit.
#[inline(always)]
pub(crate) fn for_each_crossing<K: Kernel, S: Statistics>(
    kernel: K,
    bvh: &Bvh,
    ray: &Ray,
    visit: &mut impl FnMut(u32) -> ControlFlow<()>,
    stats: &mut S,
) -> ControlFlow<()> {
    let Some(prepared) = Prepared::new(ray) else { return ControlFlow::Continue(()) };
    let mut walk = Walk::new(kernel, &bvh.tree, &prepared.node, stats);
    while let Some(leaf) = walk.next(stats) {
        let mask = filter(kernel, bvh, leaf, &prepared.block, stats);
        let mut open = mask.certain | mask.uncertain;
        while open != 0 {
            let lane = take_lane(&mut open);
            if mask.certain >> lane & 1 == 1 || segment_hits_triangle(ray, bvh.blocks[leaf].get(lane)) {
                visit(bvh.prim(leaf, lane))?;
            }
        }
    }
    ControlFlow::Continue(())
}

/// The sum of `depth_of` over all triangles hit, opaque as soon as nothing gets through.
#[inline(always)]
pub(crate) fn transmittance<K: Kernel, S: Statistics>(
    kernel: K,
    bvh: &Bvh,
    ray: &Ray,
    depth_of: &impl Fn(u32) -> OpticalDepth,
    stats: &mut S,
) -> OpticalDepth {
    let mut sum = OpticalDepth::CLEAR;
    let mut add = |prim| {
        sum += depth_of(prim);
        if sum.is_opaque() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    };
    match for_each_crossing(kernel, bvh, ray, &mut add, stats) {
        ControlFlow::Break(()) => OpticalDepth::OPAQUE,
        ControlFlow::Continue(()) => sum,
    }
}

/// The closest hit that is not behind `limit` (in `t`; ties with it are reported), if any.
///
/// Culling is by the exact segment grown a little, the choice by `t` as [`intersect_triangle`] rounds it.
#[inline(always)]
pub(crate) fn closest_hit<K: Kernel, S: Statistics>(
    kernel: K,
    bvh: &Bvh,
    ray: &Ray,
    limit: Option<f32>,
    stats: &mut S,
) -> Option<Hit> {
    let Prepared { node, mut block } = Prepared::new(ray)?;
    let mut walk = SortedWalk::new(kernel, &bvh.tree, &node);
    if let Some(t) = limit {
        let end = just_behind(t).min(ray.tfar);
        block.set_tfar(end);
        walk.set_tfar(end);
    }
    let mut closest: Option<Hit> = None;
    while let Some(leaf) = walk.next(stats) {
        let mask = filter(kernel, bvh, leaf, &block, stats);
        let mut open = mask.certain | mask.uncertain;
        while open != 0 {
            let lane = take_lane(&mut open);
            let Some(hit) = intersect_triangle(ray, bvh.blocks[leaf].get(lane)) else { continue };
            let hit = Hit::new(bvh.prim(leaf, lane), hit);
            if closest.is_none_or(|closest| hit.is_before(&closest)) {
                closest = Some(hit);
                let end = just_behind(hit.t).min(ray.tfar);
                block.set_tfar(end);
                walk.set_tfar(end);
            }
        }
    }
    closest
}
