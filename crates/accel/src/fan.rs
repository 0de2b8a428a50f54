//! Rays that share an origin walk together, each answered as if alone.
//!
//! Here: the walk of a fan of up to [`FAN`] rays. Not here: rays of different origins (`packet.rs`), boxes and triangles
//! (`kernel`).

use crate::{
    Bvh, Statistics,
    kernel::{FAN, Kernel, Rows, Stack},
    node::{LEAF, Node, WIDTH},
    packet::PACKET,
    traversal,
};
use std::ops::Range;
use umbrage_geom::{
    OpticalDepth, Ray,
    kernel::{
        BlockMask, LANES,
        fan::{CHUNK, FanRays},
    },
    segment_hits_triangle,
};

/// Fewest rays that are worth a fan.
const SMALLEST: usize = 4;

/// Fewest rays for which a node is first tested against the envelope.
const WIDE: u32 = 4;

/// A part of a slice of rays that is answered in one go.
pub(crate) enum Part {
    /// Rays of one origin, [`FAN`] at most.
    Fan(Range<usize>),
    /// Rays of any origins, [`PACKET`] at most.
    Packet(Range<usize>),
}

/// Cuts a slice of rays into fans and packets.
pub(crate) struct Parts<'a> {
    rays: &'a [Ray],
    at: usize,
    /// Rays of the fan that ended the last packet.
    fan: usize,
}

impl<'a> Parts<'a> {
    pub(crate) fn new(rays: &'a [Ray]) -> Self {
        Self { rays, at: 0, fan: 0 }
    }

    /// Rays from `at` whose origins have the same bits, up to [`FAN`].
    #[inline]
    fn same_origin(&self, at: usize) -> usize {
        let bits = |ray: &Ray| ray.origin.to_array().map(f32::to_bits);
        let rays = &self.rays[at..];
        let first = rays.first().map(bits);
        rays.iter().take(FAN).take_while(|ray| Some(bits(ray)) == first).count()
    }
}

impl Iterator for Parts<'_> {
    type Item = Part;

    #[inline]
    fn next(&mut self) -> Option<Part> {
        let start = self.at;
        let mut end = start;
        while self.fan == 0 && end < self.rays.len() && end - start < PACKET {
            let same = self.same_origin(end);
            if same >= SMALLEST {
                self.fan = same;
            } else {
                end += same.min(PACKET - (end - start));
            }
        }
        if end > start {
            self.at = end;
            return Some(Part::Packet(start..end));
        }
        let fan = std::mem::take(&mut self.fan);
        self.at += fan;
        (fan > 0).then_some(Part::Fan(start..start + fan))
    }
}

/// What a whole fan can't reach.
///
/// A ray that is, on each axis where all directions have one sign, as slow as the slowest towards near planes and as fast
/// as the fastest towards far planes enters whatever any ray enters; and no segment leaves the box around all of them.
struct Envelope {
    /// One ray; on axes of mixed signs its entry is 0 and its exit NaN, which drops it.
    ray: FanRays<1>,
    /// On how many axes all directions have one sign.
    axes: usize,
    /// Box around all segments, relative to the origin, if it is finite.
    extent: Option<[[f32; 3]; 2]>,
}

impl Envelope {
    #[inline(always)]
    fn new(fan: &FanRays<FAN>, fit: u32, len: usize) -> Self {
        let mut ray = FanRays::<1>::default();
        let mut extent = [[0f32; 3]; 2];
        let mut axes = 0;
        let columns = len.next_multiple_of(CHUNK).min(FAN);
        for axis in 0..3 {
            let (mut slowest, mut fastest) = ([f32::INFINITY; CHUNK], [0f32; CHUNK]);
            let (mut low, mut high) = ([0f32; CHUNK], [0f32; CHUNK]);
            let (mut negative, mut positive) = ([0u32; CHUNK], [0u32; CHUNK]);
            for at in (0..columns).step_by(CHUNK) {
                for i in 0..CHUNK {
                    let r = (at + i) % FAN;
                    let idle = (fit >> r & 1 == 0) as u32;
                    let (near, far) = (fan.inv_near[axis][r].abs(), fan.inv_far[axis][r].abs());
                    let near = if idle != 0 { f32::INFINITY } else { near };
                    let far = if idle != 0 { 0.0 } else { far };
                    let end = fan.direction[axis][r] * fan.far[r];
                    // 0 times infinity stays where it is.
                    let end = if idle != 0 || fan.direction[axis][r] == 0.0 { 0.0 } else { end };
                    slowest[i] = if near < slowest[i] { near } else { slowest[i] };
                    fastest[i] = if far > fastest[i] { far } else { fastest[i] };
                    low[i] = if end < low[i] { end } else { low[i] };
                    high[i] = if end > high[i] { end } else { high[i] };
                    negative[i] |= fan.negative[axis][r] & (idle ^ 1);
                    positive[i] |= (fan.negative[axis][r] ^ 1) & (idle ^ 1);
                }
            }
            let fold = |row: [f32; CHUNK], f: fn(f32, f32) -> f32| row.into_iter().reduce(f).unwrap_or(0.0);
            let smaller = |a: f32, b: f32| if a < b { a } else { b };
            let larger = |a: f32, b: f32| if a > b { a } else { b };
            let any = |row: [u32; CHUNK]| row.into_iter().fold(0, |a, b| a | b) != 0;
            let one_sign = !(any(negative) && any(positive));
            let sign = if any(negative) { -1.0 } else { 1.0 };
            ray.negative[axis] = [u32::from(any(negative))];
            ray.inv_near[axis] = [if one_sign { sign * fold(slowest, smaller) } else { 0.0 }];
            ray.inv_far[axis] = [if one_sign { sign * fold(fastest, larger) } else { f32::NAN }];
            axes += usize::from(one_sign);
            // Two roundings, and one of the box's plane.
            extent[0][axis] = fold(low, smaller) * (1.0 + 2f32.powi(-20)) - f32::MIN_POSITIVE;
            extent[1][axis] = fold(high, larger) * (1.0 + 2f32.powi(-20)) + f32::MIN_POSITIVE;
        }
        ray.slab_near = [0.0];
        ray.slab_far = [f32::INFINITY];
        let finite = extent.as_flattened().iter().all(|x| x.is_finite());
        Self { ray, axes, extent: finite.then_some(extent) }
    }

    /// Children that some ray may enter.
    #[inline(always)]
    fn mask<K: Kernel>(&self, kernel: K, rows: &Rows) -> u32 {
        let reached = self.extent.map_or(0xff, |[low, high]| kernel.overlap(rows, low, high));
        if self.axes == 0 { reached } else { reached & kernel.fan_mask(rows, &self.ray, 0) }
    }
}

/// What is asked about each ray.
pub(crate) trait Goal {
    /// Takes the triangles of a leaf that ray `index` hits for certain, and those that the exact predicate has to decide.
    /// Whether the ray needs no more.
    fn leaf(&mut self, bvh: &Bvh, leaf: usize, index: usize, mask: BlockMask) -> bool;

    /// Answers a ray that no fan takes.
    fn alone<K: Kernel, S: Statistics>(&mut self, kernel: K, bvh: &Bvh, index: usize, stats: &mut S);
}

/// One fan on its way.
struct Walk {
    fan: FanRays<FAN>,
    stack: Stack,
    top: usize,
    /// Rays that still look.
    alive: u32,
    origin: [f32; 3],
    envelope: Envelope,
    /// Whether the envelope may exclude anything.
    narrow: bool,
    /// Index of the first ray.
    first: usize,
}

impl Walk {
    fn new() -> Self {
        let fan = FanRays::default();
        let envelope = Envelope::new(&fan, 0, 0);
        let (stack, origin) = (Stack::new(), [0.0; 3]);
        Self { fan, stack, top: 0, alive: 0, origin, envelope, narrow: false, first: 0 }
    }

    /// Takes up `rays` of one origin; returns those that it can answer.
    #[inline(always)]
    fn start(&mut self, first: usize, rays: &[Ray]) -> u32 {
        let mut fit = 0;
        if rays[0].origin.is_finite() {
            for (i, chunk) in rays.chunks(CHUNK).enumerate() {
                fit |= self.fan.prepare(i * CHUNK, chunk) << (i * CHUNK);
            }
        }
        self.origin = rays[0].origin.to_array();
        self.first = first;
        self.envelope = Envelope::new(&self.fan, fit, rays.len());
        self.narrow = self.envelope.extent.is_some() || self.envelope.axes > 1;
        self.alive = fit;
        self.top = usize::from(fit != 0);
        (self.stack.children[0], self.stack.rays[0]) = (0, fit);
        fit
    }

    /// Visits one node or leaf; false if there was none left.
    #[inline(always)]
    fn step<K: Kernel, S: Statistics>(
        &mut self,
        kernel: K,
        bvh: &Bvh,
        goal: &mut impl Goal,
        stats: &mut S,
    ) -> bool {
        let (child, mask) = loop {
            if self.top == 0 {
                return false;
            }
            self.top -= 1;
            let mask = self.stack.rays[self.top] & self.alive;
            if mask != 0 {
                break (self.stack.children[self.top], mask);
            }
        };
        if child & LEAF != 0 {
            self.leaf(kernel, bvh, (child & !LEAF) as usize, mask, goal, stats);
            return true;
        }
        let node = &bvh.tree.nodes[child as usize];
        let rows = kernel.rows(node, self.origin);
        let mut wanted = node.used;
        let bottom = self.top;
        if self.narrow && mask.count_ones() >= WIDE {
            wanted &= self.envelope.mask(kernel, &rows);
        }
        if wanted & wanted.wrapping_sub(1) == 0 {
            let slot = wanted.trailing_zeros() as usize % WIDTH;
            (self.stack.children[bottom], self.stack.rays[bottom]) = (node.children[slot], mask);
            self.top += usize::from(wanted != 0);
        } else {
            stats.node(node.len() as u32);
            self.top =
                kernel.fan_push(&node.children, &rows, &self.fan, mask, wanted, &mut self.stack, bottom);
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

    /// Tests the rays in `rest` against a leaf.
    #[inline(always)]
    fn leaf<K: Kernel, S: Statistics>(
        &mut self,
        kernel: K,
        bvh: &Bvh,
        leaf: usize,
        mut rest: u32,
        goal: &mut impl Goal,
        stats: &mut S,
    ) {
        let block = &bvh.blocks[leaf];
        let planes = kernel.planes(block, self.origin);
        while rest != 0 {
            let r = rest.trailing_zeros() as usize;
            rest &= rest - 1;
            let mask = kernel.fan_filter(&planes, &self.fan, r);
            stats.triangles(block.len() as u32);
            stats.uncertain(mask.uncertain.count_ones());
            if mask.certain | mask.uncertain != 0 && goal.leaf(bvh, leaf, self.first + r, mask) {
                self.alive &= !(1 << r);
            }
        }
    }
}

/// Fans that take turns, so that one works while others wait for memory.
const TURNS: usize = 8;

/// Answers rays by fans where they share an origin; the others are left to `packet`, [`PACKET`] at most at a time.
#[inline(always)]
pub(crate) fn answer<K: Kernel, S: Statistics, G: Goal>(
    kernel: K,
    bvh: &Bvh,
    rays: &[Ray],
    goal: &mut G,
    mut packet: impl FnMut(&mut G, Range<usize>, &mut S),
    stats: &mut S,
) {
    let mut walks: [Walk; TURNS] = std::array::from_fn(|_| Walk::new());
    let mut turns: [usize; TURNS] = std::array::from_fn(|i| i);

    let mut busy = 0;
    let mut parts = Parts::new(rays);
    loop {
        while busy < TURNS {
            match parts.next() {
                Some(Part::Fan(range)) => {
                    let fit = walks[turns[busy]].start(range.start, &rays[range.clone()]);
                    for index in range.clone().filter(|index| fit >> (index - range.start) & 1 == 0) {
                        goal.alone(kernel, bvh, index, stats);
                    }
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
            if walks[turns[turn]].step(kernel, bvh, goal, stats) {
                turn += 1;
            } else {
                busy -= 1;
                turns.swap(turn, busy);
            }
        }
    }
}

/// Whether any triangle is hit.
pub(crate) struct AnyHit<'a> {
    pub(crate) rays: &'a [Ray],
    pub(crate) hits: &'a mut [bool],
}

impl Goal for AnyHit<'_> {
    #[inline(always)]
    fn leaf(&mut self, bvh: &Bvh, leaf: usize, index: usize, mask: BlockMask) -> bool {
        let mut hit = mask.certain != 0;
        let mut open = mask.uncertain;
        while open != 0 && !hit {
            let lane = open.trailing_zeros() as usize % LANES;
            open &= open - 1;
            hit = segment_hits_triangle(&self.rays[index], bvh.blocks[leaf].get(lane));
        }
        self.hits[index] = hit;
        hit
    }

    #[inline(always)]
    fn alone<K: Kernel, S: Statistics>(&mut self, kernel: K, bvh: &Bvh, index: usize, stats: &mut S) {
        self.hits[index] = traversal::any_hit(kernel, bvh, &self.rays[index], stats);
    }
}

/// The sum of what all triangles hit let through.
pub(crate) struct Transmittance<'a, F> {
    pub(crate) rays: &'a [Ray],
    /// Clear at the start.
    pub(crate) sums: &'a mut [OpticalDepth],
    pub(crate) depth_of: &'a F,
}

impl<F: Fn(u32) -> OpticalDepth> Goal for Transmittance<'_, F> {
    #[inline(always)]
    fn leaf(&mut self, bvh: &Bvh, leaf: usize, index: usize, mask: BlockMask) -> bool {
        let mut open = mask.certain | mask.uncertain;
        let mut sum = self.sums[index];
        while open != 0 {
            let lane = open.trailing_zeros() as usize % LANES;
            open &= open - 1;
            let certain = mask.certain >> lane & 1 == 1;
            if certain || segment_hits_triangle(&self.rays[index], bvh.blocks[leaf].get(lane)) {
                sum += (self.depth_of)(bvh.prim(leaf, lane));
            }
        }
        let opaque = sum.is_opaque();
        self.sums[index] = if opaque { OpticalDepth::OPAQUE } else { sum };
        opaque
    }

    #[inline(always)]
    fn alone<K: Kernel, S: Statistics>(&mut self, kernel: K, bvh: &Bvh, index: usize, stats: &mut S) {
        self.sums[index] = traversal::transmittance(kernel, bvh, &self.rays[index], self.depth_of, stats);
    }
}
