//! Rays that share an origin walk together, each answered as if alone.
//!
//! Here: the walk of a fan of up to [`FAN`] rays. Not here: which rays make a fan (`parts.rs`), what none of them reaches
//! (`envelope.rs`), rays of different origins (`packet.rs`), boxes and triangles (`kernel`).

mod envelope;
mod parts;

use self::{
    envelope::Envelope,
    parts::{Part, Parts, may_enter},
};
use crate::{
    Bvh, Statistics,
    kernel::{Ahead, Columns, FAN, Fan, Kernel, Prepared, Rows, Stack},
    node::{LEAF, Node, NodeNote, Tree, WIDTH},
    solid::{SolidBoxes, SolidPack},
    traversal,
};
use std::ops::Range;
use umbrage_geom::{
    Aabb, OpticalDepth, Ray,
    kernel::{
        BlockMask, LANES, TriangleBlock,
        fan::{CHUNK, FanRays},
        larger,
    },
    segment_hits_triangle,
};

/// Fewest rays that are worth a fan.
pub(crate) const FEWEST_FAN_RAYS: usize = 4;

/// Fewest rays for which a node is first tested against the envelope.
const FEWEST_RAYS_FOR_ENVELOPE: u32 = 4;

/// A ray of a fan.
#[derive(Clone, Copy, Debug)]
pub struct FanRay {
    /// Its place in the batch.
    pub index: usize,
    /// Which of the fans that take turns it belongs to, below [`WALKS`].
    pub walk: usize,
    /// Its column there.
    pub column: usize,
}

/// What is asked about each ray of a batch. Everything that is called often should be `#[inline(always)]` and written as
/// loops over arrays: it is then compiled with the instructions of the walk.
pub trait FanGoal {
    /// Whether rays may end at nodes.
    const ENDS: bool = false;

    /// Rays of the batch start together: the one in column `i` of `rays` is `first + i`. Bit `i` of `fit` is set for those that
    /// the walk answers. `limits` are 0 and say where rays end, if they may: at a child whose squared radius, times its mark
    /// in 255ths ([`NodeNote`]), over squared distance is less. A mark of 0 ends none.
    #[inline(always)]
    fn start(&mut self, walk: usize, first: usize, fit: u32, limits: &mut [f32; FAN]) {
        let _ = (walk, first, fit, limits);
    }

    /// Ends a ray at some children of a node, a bit each in `slots`, instead of entering them. `covered` is the part of its way
    /// through each that the segment covers, 0 for others. Whether the ray needs no more.
    #[inline(always)]
    fn end(&mut self, ray: FanRay, note: &NodeNote, slots: u32, covered: &[f32; WIDTH]) -> bool {
        let _ = (ray, note, slots, covered);
        false
    }

    /// Whether boxes inside of solids may end rays, see [`SolidBoxes`].
    const SOLIDS: bool = false;

    /// See [`SolidBoxes::pack`].
    #[inline(always)]
    fn pack(&self, index: u32) -> Option<&SolidPack> {
        let _ = index;
        None
    }

    /// See [`SolidBoxes::blocks`].
    #[inline(always)]
    fn solid(&mut self, ray: FanRay, index: u32, lanes: u32) -> bool {
        let _ = (ray, index, lanes);
        false
    }

    /// Takes the triangles of a leaf that a ray hits for certain, and those that the exact predicate has to decide.
    /// Whether the ray needs no more.
    fn leaf(&mut self, ray: FanRay, leaf: u32, block: &TriangleBlock, mask: BlockMask) -> bool;

    /// The rays that started last in this walk have met everything.
    #[inline(always)]
    fn finish(&mut self, walk: usize) {
        let _ = walk;
    }
}

/// One fan on its way.
pub(crate) struct Walk {
    pub(crate) fan: Fan,
    stack: Stack,
    top: usize,
    /// Rays that still look.
    pub(crate) alive: u32,
    origin: [f32; 3],
    envelope: Envelope,
    /// Whether the envelope may exclude anything.
    narrow: bool,
    /// Whether all rays start at the origin.
    starts: bool,
    /// Index of the first ray.
    first: usize,
    /// Where each ray ends, and the largest of these; for goals that end rays.
    limits: [f32; FAN],
    widest: f32,
}

impl Walk {
    pub(crate) fn new() -> Self {
        let rays = FanRays::default();
        let envelope = Envelope::new(&rays, 0, 0);
        let (stack, origin) = (Stack::new(), [0.0; 3]);
        let fan = Fan { rays, ahead: Ahead::new(origin, [origin; 2]), signs: None };
        Self {
            fan,
            stack,
            top: 0,
            alive: 0,
            origin,
            envelope,
            narrow: false,
            starts: false,
            first: 0,
            limits: [0.0; FAN],
            widest: 0.0,
        }
    }

    /// Takes up `rays` of one origin; returns those that it can answer.
    #[inline(always)]
    pub(crate) fn start(&mut self, first: usize, rays: &[Ray], bounds: &Aabb) -> u32 {
        let mut fit = 0;
        if rays[0].origin.is_finite() {
            for (i, chunk) in rays.chunks(CHUNK).enumerate() {
                fit |= self.fan.rays.prepare(i * CHUNK, chunk) << (i * CHUNK);
            }
        }
        self.origin = rays[0].origin.to_array();
        self.first = first;
        self.envelope = Envelope::new(&self.fan.rays, fit, rays.len());
        let relative = [bounds.min - rays[0].origin, bounds.max - rays[0].origin].map(|v| v.to_array());
        self.fan.ahead = Ahead::new(self.envelope.sum, relative);
        self.narrow = self.envelope.extent.is_some() || self.envelope.axes > 1;
        self.starts = rays.iter().fold(0, |any, ray| any | ray.tnear.to_bits()) == 0;
        self.fan.signs = self.envelope.signs();
        self.alive = fit;
        self.top = usize::from(fit != 0);
        (self.stack.children[0], self.stack.rays[0]) = (0, fit);
        fit
    }

    /// The next node or leaf, and the rays that enter it.
    #[inline(always)]
    fn pop(&mut self) -> Option<(u32, u32)> {
        loop {
            if self.top == 0 {
                return None;
            }
            self.top -= 1;
            let mask = self.stack.rays[self.top] & self.alive;
            if mask != 0 {
                return Some((self.stack.children[self.top], mask));
            }
        }
    }

    /// Children that the rays in `mask` may enter, as far as one test for all tells.
    #[inline(always)]
    fn wanted<K: Kernel>(&self, kernel: K, node: &Node, rows: &Rows, mask: u32) -> u32 {
        if self.narrow && mask.count_ones() >= FEWEST_RAYS_FOR_ENVELOPE {
            node.used & self.envelope.mask(kernel, rows)
        } else {
            node.used
        }
    }

    /// Puts the `wanted` children that the rays in `mask` enter on the stack.
    #[inline(always)]
    fn push<K: Kernel, S: Statistics>(
        &mut self,
        kernel: K,
        node: &Node,
        rows: &Rows,
        mask: u32,
        wanted: u32,
        stats: &mut S,
    ) {
        let bottom = self.top;
        if wanted & wanted.wrapping_sub(1) == 0 {
            let slot = wanted.trailing_zeros() as usize % WIDTH;
            (self.stack.children[bottom], self.stack.rays[bottom]) = (node.children[slot], mask);
            self.top += usize::from(wanted != 0);
        } else {
            stats.node(node.len() as u32);
            self.top = kernel.fan_push(node, rows, &self.fan, mask, wanted, &mut self.stack, bottom);
        }
    }

    /// Goes on to the next leaf, and returns it with the rays that enter it.
    #[inline(always)]
    pub(crate) fn next_leaf<K: Kernel>(&mut self, kernel: K, tree: &Tree) -> Option<(usize, u32)> {
        while let Some((child, mask)) = self.pop() {
            if child & LEAF != 0 {
                return Some(((child & !LEAF) as usize, mask));
            }
            let node = &tree.nodes[child as usize];
            let rows = kernel.rows(node, self.origin);
            let wanted = self.wanted(kernel, node, &rows, mask);
            self.push(kernel, node, &rows, mask, wanted, &mut ());
        }
        None
    }

    /// Visits one node or leaf; false if there was none left. `walk` is its own number.
    #[inline(always)]
    fn step<K: Kernel, S: Statistics, G: FanGoal>(
        &mut self,
        kernel: K,
        bvh: &Bvh,
        walk: usize,
        goal: &mut G,
        stats: &mut S,
    ) -> bool {
        let Some((child, mask)) = self.pop() else { return false };
        if child & LEAF != 0 {
            self.leaf(kernel, bvh, (child & !LEAF) as usize, mask, walk, goal, stats);
            return true;
        }
        let node = &bvh.tree.nodes[child as usize];
        let mut mask = mask;
        if G::SOLIDS && node.note.index != 0 {
            self.solids(kernel, node.note.index, mask, walk, goal);
            mask &= self.alive;
            if mask == 0 {
                return true;
            }
        }
        let rows = kernel.rows(node, self.origin);
        let wanted = self.wanted(kernel, node, &rows, mask);
        if !G::ENDS || !self.ends(kernel, node, &rows, child, wanted, mask, walk, goal, stats) {
            self.push(kernel, node, &rows, mask, wanted, stats);
        }
        // Without a loop over what was pushed, whose length nothing predicts.
        for &child in &self.stack.children[self.top.saturating_sub(3)..self.top] {
            let (leaf, index) = (child & LEAF != 0, (child & !LEAF) as usize);
            let node = bvh.tree.nodes.as_ptr().wrapping_add(index).cast::<u8>();
            let block = bvh.blocks.as_ptr().wrapping_add(index).cast::<u8>();
            kernel.prefetch(if leaf { block } else { node }, size_of::<Node>());
        }
        true
    }

    /// Ends those of the rays in `rest` that boxes of pack `index` block.
    #[inline(always)]
    fn solids<K: Kernel, G: FanGoal>(
        &mut self,
        kernel: K,
        index: u32,
        mut rest: u32,
        walk: usize,
        goal: &mut G,
    ) {
        let Some(pack) = goal.pack(index) else { return };
        let rows = kernel.pack_rows(pack, self.origin);
        if self.narrow && self.envelope.mask(kernel, &rows) == 0 {
            return;
        }
        while rest != 0 {
            let r = rest.trailing_zeros() as usize % FAN;
            rest &= rest - 1;
            let crossed = kernel.fan_crossed(&rows, &self.fan.rays, r);
            let ray = FanRay { index: self.first + r, walk, column: r };
            if crossed != 0 && goal.solid(ray, index, crossed) {
                self.alive &= !(1 << r);
            }
        }
    }

    /// Ends rays at children of a node and pushes the others; false if none of the `wanted` is small enough for any ray.
    #[inline(always)]
    #[allow(clippy::too_many_arguments)] // the state of one loop
    fn ends<K: Kernel, S: Statistics>(
        &mut self,
        kernel: K,
        node: &Node,
        rows: &Rows,
        index: u32,
        wanted: u32,
        mut rest: u32,
        walk: usize,
        goal: &mut impl FanGoal,
        stats: &mut S,
    ) -> bool {
        let sizes = kernel.sizes(rows, &node.note);
        if wanted & kernel.smaller(&sizes, self.widest) == 0 {
            return false;
        }
        stats.node(node.len() as u32);
        let (mut columns, mut covered) = (Columns::NONE, [0.0; WIDTH]);
        while rest != 0 {
            let r = rest.trailing_zeros() as usize % FAN;
            rest &= rest - 1;
            let slots = kernel.enter_or_end(
                rows,
                &sizes,
                &self.fan.rays,
                r,
                self.limits[r],
                &mut columns,
                &mut covered,
            );
            if slots != 0 {
                stats.ended_at_node(index, slots);
                let ray = FanRay { index: self.first + r, walk, column: r };
                self.alive &= !(u32::from(goal.end(ray, &node.note, slots, &covered)) << r);
            }
        }
        self.top = kernel.push(node, rows, &self.fan, &columns, node.used, &mut self.stack, self.top);
        true
    }

    /// Tests the rays in `rest` against a leaf.
    #[inline(always)]
    #[allow(clippy::too_many_arguments)] // the state of one loop
    fn leaf<K: Kernel, S: Statistics>(
        &mut self,
        kernel: K,
        bvh: &Bvh,
        leaf: usize,
        mut rest: u32,
        walk: usize,
        goal: &mut impl FanGoal,
        stats: &mut S,
    ) {
        let block = &bvh.blocks[leaf];
        let mut planes = kernel.planes(block, self.origin);
        let mut asked = if self.starts { 0 } else { u8::MAX };
        while rest != 0 {
            let r = rest.trailing_zeros() as usize;
            rest &= rest - 1;
            let mask = loop {
                let mask = kernel.fan_filter(&planes, &self.fan.rays, r);
                let ask = mask.uncertain & !asked;
                if ask == 0 {
                    break mask;
                }
                asked |= ask;
                kernel.ask_sides(&mut planes, block, self.origin, ask);
            };
            stats.triangles(block.len() as u32);
            stats.uncertain(mask.uncertain.count_ones());
            let ray = FanRay { index: self.first + r, walk, column: r };
            if mask.certain | mask.uncertain != 0 && goal.leaf(ray, leaf as u32, block, mask) {
                self.alive &= !(1 << r);
            }
        }
    }
}

/// Walks a ray that no fan takes, because it is not valid or of extreme size, from leaf to leaf.
fn alone<K: Kernel, S: Statistics>(
    kernel: K,
    bvh: &Bvh,
    index: usize,
    ray: &Ray,
    walk: usize,
    goal: &mut impl FanGoal,
    stats: &mut S,
) {
    goal.start(walk, index, 1, &mut [0.0; FAN]);
    if let Some(prepared) = Prepared::new(ray) {
        let mut leaves = traversal::Walk::new(kernel, &bvh.tree, &prepared.node, stats);
        while let Some(leaf) = leaves.next(stats) {
            let mask = traversal::filter(kernel, bvh, leaf, &prepared.block, stats);
            let at = FanRay { index, walk, column: 0 };
            if mask.certain | mask.uncertain != 0 && goal.leaf(at, leaf as u32, &bvh.blocks[leaf], mask) {
                break;
            }
        }
    }
    goal.finish(walk);
}

/// Fans that take turns, so that one works while others wait for memory.
pub const WALKS: usize = 8;

/// Bytes of nodes and leaves up to which fans walk one after the other: they fit into the second-level cache, and what
/// other fans keep would only push things out of the first.
const CACHED_BYTES: usize = 1 << 19;

/// Answers rays by fans where at least `smallest` share an origin; the others are left to `packet`, [`PACKET`] at most at a
/// time.
#[inline(always)]
pub(crate) fn answer<K: Kernel, S: Statistics, G: FanGoal>(
    kernel: K,
    bvh: &Bvh,
    rays: &[Ray],
    smallest: usize,
    goal: &mut G,
    mut packet: impl FnMut(&mut G, Range<usize>, &mut S),
    stats: &mut S,
) {
    // Made when first needed: a single fan shouldn't pay for all.
    let mut walks: Vec<Walk> = Vec::with_capacity(WALKS);
    let mut turns: [usize; WALKS] = std::array::from_fn(|i| i);

    let near = size_of_val(&*bvh.tree.nodes) + size_of_val(&*bvh.blocks) <= CACHED_BYTES;
    let (most, turn_over) = if near { (1, 0) } else { (WALKS, 1) };

    let mut busy = 0;
    let mut parts = Parts::new(rays, smallest);
    loop {
        while busy < most {
            match parts.next() {
                Some(Part::Fan(range)) if !may_enter(&rays[range.clone()], &bvh.tree.bounds) => {
                    let all = u32::MAX >> (FAN - range.len());
                    goal.start(turns[busy], range.start, all, &mut [0.0; FAN]);
                    goal.finish(turns[busy]);
                }
                Some(Part::Fan(range)) => {
                    if walks.len() == busy {
                        walks.push(Walk::new());
                    }
                    let walk = turns[busy];
                    let fit = walks[walk].start(range.start, &rays[range.clone()], &bvh.tree.bounds);
                    for index in range.clone().filter(|index| fit >> (index - range.start) & 1 == 0) {
                        alone(kernel, bvh, index, &rays[index], walk, goal, stats);
                    }
                    let Walk { limits, widest, .. } = &mut walks[walk];
                    if G::ENDS {
                        *limits = [0.0; FAN];
                    }
                    goal.start(walk, range.start, fit, limits);
                    *widest = if G::ENDS { limits.iter().fold(0.0, |a, &b| larger(a, b)) } else { 0.0 };
                    busy += 1;
                }
                Some(Part::Packet(range)) => packet(goal, range, stats),
                None => break,
            }
        }
        if busy == 0 {
            return;
        }
        let mut turn = 0;
        while turn < busy {
            let walk = turns[turn];
            if walks[walk].step(kernel, bvh, walk, goal, stats) {
                turn += turn_over;
            } else {
                goal.finish(walk);
                busy -= 1;
                turns.swap(turn, busy);
            }
        }
    }
}

/// Whether any triangle is hit.
pub(crate) struct AnyHit<'a, B> {
    pub(crate) rays: &'a [Ray],
    pub(crate) hits: &'a mut [bool],
    pub(crate) solids: B,
}

impl<B: SolidBoxes> FanGoal for AnyHit<'_, B> {
    const SOLIDS: bool = B::ANY;

    #[inline(always)]
    fn pack(&self, index: u32) -> Option<&SolidPack> {
        self.solids.pack(index)
    }

    #[inline(always)]
    fn solid(&mut self, FanRay { index: place, .. }: FanRay, index: u32, lanes: u32) -> bool {
        let hit = self.solids.blocks(&self.rays[place], place, index, lanes);
        self.hits[place] |= hit;
        hit
    }

    #[inline(always)]
    fn leaf(&mut self, FanRay { index, .. }: FanRay, _: u32, block: &TriangleBlock, mask: BlockMask) -> bool {
        let mut hit = mask.certain != 0;
        let mut open = mask.uncertain;
        while open != 0 && !hit {
            let lane = open.trailing_zeros() as usize % LANES;
            open &= open - 1;
            hit = segment_hits_triangle(&self.rays[index], block.get(lane));
        }
        self.hits[index] = hit;
        hit
    }
}

/// The sum of what all triangles hit let through.
pub(crate) struct Transmittance<'a, F> {
    pub(crate) bvh: &'a Bvh,
    pub(crate) rays: &'a [Ray],
    /// Clear at the start.
    pub(crate) sums: &'a mut [OpticalDepth],
    pub(crate) depth_of: &'a F,
}

impl<F: Fn(u32) -> OpticalDepth> FanGoal for Transmittance<'_, F> {
    #[inline(always)]
    fn leaf(
        &mut self,
        FanRay { index, .. }: FanRay,
        leaf: u32,
        block: &TriangleBlock,
        mask: BlockMask,
    ) -> bool {
        let mut open = mask.certain | mask.uncertain;
        let mut sum = self.sums[index];
        while open != 0 {
            let lane = open.trailing_zeros() as usize % LANES;
            open &= open - 1;
            let certain = mask.certain >> lane & 1 == 1;
            if certain || segment_hits_triangle(&self.rays[index], block.get(lane)) {
                sum += (self.depth_of)(self.bvh.prim(leaf as usize, lane));
            }
        }
        let opaque = sum.is_opaque();
        self.sums[index] = if opaque { OpticalDepth::OPAQUE } else { sum };
        opaque
    }
}
