//! Rays that share an origin walk together, each answered as if alone.
//!
//! Here: the walk of a fan of up to [`FAN`] rays. Not here: rays of different origins (`packet.rs`), boxes and triangles
//! (`kernel`).

use crate::{
    Bvh, Statistics,
    kernel::{FAN, Kernel},
    node::{LEAF, MAX_LEVELS, Node, WIDTH},
    packet::PACKET,
    traversal,
};
use std::ops::Range;
use umbrage_geom::{
    Ray,
    kernel::{
        BlockMask, LANES,
        fan::{CHUNK, FanRays},
    },
    segment_hits_triangle,
};

/// What fans need, kept from one to the next.
pub(crate) struct Scratch {
    rays: FanRays<FAN>,
    /// Children to visit with the rays that enter them.
    stack: [(u32, u32); (WIDTH - 1) * MAX_LEVELS + 1],
}

impl Scratch {
    pub(crate) fn new() -> Self {
        Self { rays: FanRays::default(), stack: [(0, 0); (WIDTH - 1) * MAX_LEVELS + 1] }
    }
}

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
    /// The fan that ended the last packet.
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
    fn mask<K: Kernel>(&self, kernel: K, node: &Node, origin: [f32; 3]) -> u32 {
        let reached = self.extent.map_or(0xff, |[low, high]| kernel.overlap(node, origin, low, high));
        if self.axes == 0 { reached } else { reached & kernel.fan_mask(node, origin, &self.ray, 0) }
    }
}

/// Answers up to [`FAN`] rays of one origin.
#[inline(always)]
pub(crate) fn any_hits<K: Kernel, S: Statistics>(
    kernel: K,
    bvh: &Bvh,
    rays: &[Ray],
    hits: &mut [bool],
    scratch: &mut Scratch,
    stats: &mut S,
) {
    let Scratch { rays: fan, stack } = scratch;
    let origin = rays[0].origin.to_array();
    let mut alive = 0u32;
    if rays[0].origin.is_finite() {
        for (i, chunk) in rays.chunks(CHUNK).enumerate() {
            alive |= fan.prepare(i * CHUNK, chunk) << (i * CHUNK);
        }
    }
    let fit = alive;
    let envelope = Envelope::new(fan, fit, rays.len());
    let narrow = envelope.extent.is_some() || envelope.axes > 1;
    let mut top = 1;
    stack[0] = (0, alive);
    while top > 0 {
        top -= 1;
        let (child, mask) = stack[top];
        let mask = mask & alive;
        if mask == 0 {
            continue;
        }
        if child & LEAF != 0 {
            let leaf = (child & !LEAF) as usize;
            alive &= !leaf_hits(kernel, bvh, leaf, mask, origin, fan, rays, stats);
            continue;
        }
        let node = &bvh.tree.nodes[child as usize];
        let mut candidates = 0xff;
        if narrow && mask.count_ones() >= WIDE {
            candidates = envelope.mask(kernel, node, origin);
            if candidates & candidates.wrapping_sub(1) == 0 {
                if candidates != 0 {
                    let slot = candidates.trailing_zeros() as usize % WIDTH;
                    if node.children[slot] != u32::MAX {
                        stack[top] = (node.children[slot], mask);
                        top += 1;
                    }
                }
                continue;
            }
        }
        let (rows, mut entered) = fan_rows(kernel, node, mask, origin, fan, stats);
        entered &= candidates;
        let columns = kernel.columns(rows);
        // Small boxes first on to the stack, so that large ones are visited first.
        while entered != 0 {
            let slot = (31 - entered.leading_zeros()) as usize % WIDTH;
            entered &= !(1 << slot);
            stack[top] = (node.children[slot], columns[slot]);
            top += 1;
        }
    }
    let dead = fit & !alive;
    for (r, (ray, hit)) in rays.iter().zip(hits).enumerate() {
        *hit =
            if fit >> r & 1 == 1 { dead >> r & 1 == 1 } else { traversal::any_hit(kernel, bvh, ray, stats) };
    }
}

/// Which children each ray enters: bytes are rays, bits children; and the children that any ray enters.
#[inline(always)]
fn fan_rows<K: Kernel, S: Statistics>(
    kernel: K,
    node: &Node,
    mask: u32,
    origin: [f32; 3],
    fan: &FanRays<FAN>,
    stats: &mut S,
) -> ([u64; FAN / 8], u32) {
    let (mut rows, mut entered) = ([0u64; FAN / 8], 0);
    for (group, row) in rows.iter_mut().enumerate() {
        let mut rest = mask >> (8 * group) & 0xff;
        let mut bytes = 0;
        while rest != 0 {
            let r = rest.trailing_zeros() as usize;
            rest &= rest - 1;
            let children = kernel.fan_mask(node, origin, fan, 8 * group + r);
            stats.node(node.len() as u32);
            entered |= children;
            bytes |= u64::from(children) << (8 * r);
        }
        *row = bytes;
    }
    (rows, entered)
}

/// Which of the rays in `rest` hit a triangle of the leaf.
#[inline(always)]
#[allow(clippy::too_many_arguments)] // the state of one loop
fn leaf_hits<K: Kernel, S: Statistics>(
    kernel: K,
    bvh: &Bvh,
    leaf: usize,
    mut rest: u32,
    origin: [f32; 3],
    fan: &FanRays<FAN>,
    rays: &[Ray],
    stats: &mut S,
) -> u32 {
    let block = &bvh.blocks[leaf];
    let planes = kernel.planes(block, origin);
    let mut hits = 0;
    while rest != 0 {
        let r = rest.trailing_zeros() as usize;
        rest &= rest - 1;
        let mask: BlockMask = kernel.fan_filter(&planes, fan, r);
        stats.triangles(bvh.leaf_len(leaf) as u32);
        stats.uncertain(mask.uncertain.count_ones());
        let mut hit = mask.certain != 0;
        let mut open = mask.uncertain;
        while open != 0 && !hit {
            let lane = open.trailing_zeros() as usize % LANES;
            open &= open - 1;
            hit = segment_hits_triangle(&rays[r], block.get(lane));
        }
        hits |= u32::from(hit) << r;
    }
    hits
}
