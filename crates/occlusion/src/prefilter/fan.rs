//! A ray with a solid angle through the hierarchy (`[Lacewell08]`, Algorithm 1, by the node instead of by the box).
//!
//! Here: which children of a node end which rays of a fan, and what rays lose. Not here: the walk itself
//! ([`Bvh::walk_fans`]), opacities (`opacity.rs`).
//!
//! Departures: children are composited by adding optical depths; nothing is interpolated between levels, see
//! [`super::Blend`]; a node crossed in part dims in part; the ray ends where 10 bits are lost.

use super::{
    ConeRay, Directions, Query,
    depths::Depths,
    query::Cones,
    storage::{Table, WIDTH},
};
use umbrage_accel::{Bvh, FAN, FanGoal, FanNode, FanRay, Note, Statistics, WALKS};
use umbrage_geom::{
    OpticalDepth, Ray,
    kernel::{BlockMask, LANES, TriangleBlock, fan::FanRays},
    segment_hits_triangle,
};

/// Optical depth in bits from which an approximate ray counts as blocked: less than a thousandth is lost.
const BLACK: f32 = 10.0;

/// Rays prepared at once.
const CHUNK: usize = 8;

/// The share that mark 1 stands for.
const SHARE: f32 = 1.0 / 255.0;

/// A share in `[0, 1]` of the squared radius that a child counts with, as a mark of its node; marks of 0 never end rays.
pub(crate) fn mark(share: f32) -> u8 {
    (share * 255.0).round().clamp(1.0, 255.0) as u8
}

/// One fan on its way.
struct Fan<V> {
    /// Place of the first ray.
    first: usize,
    /// Rays that the fan answers.
    fit: u32,
    /// Rays that are blocked.
    black: u32,
    /// A child ends a ray where its `sizes` is less; 0 for never.
    kappa: [f32; FAN],
    /// Largest `kappa` of any ray.
    widest: f32,
    /// Of the node looked at last: squared radius over squared distance, by slot.
    sizes: [f32; WIDTH],
    views: [V; FAN],
    /// Lost in nodes, bits.
    stored: [f32; FAN],
    /// What may be lost in nodes until the ray is black.
    room: [f32; FAN],
    /// Lost in triangles.
    exact: [OpticalDepth; FAN],
}

impl<V: Copy + Default> Fan<V> {
    fn new() -> Self {
        Self {
            first: 0,
            fit: 0,
            black: 0,
            kappa: [0.0; FAN],
            widest: 0.0,
            sizes: [0.0; WIDTH],
            views: [V::default(); FAN],
            stored: [0.0; FAN],
            room: [0.0; FAN],
            exact: [OpticalDepth::CLEAR; FAN],
        }
    }
}

/// Answers cones through [`Bvh::walk_fans`].
pub(crate) struct Answer<'a, T: Table> {
    pub(crate) bvh: &'a Bvh,
    pub(crate) depths: &'a Depths,
    pub(crate) table: &'a T,
    pub(crate) directions: Directions,
    pub(crate) query: &'a Query,
    pub(crate) cones: &'a [ConeRay],
    pub(crate) passed: &'a mut [f32],
    fans: Vec<Fan<T::View>>,
}

impl<'a, T: Table> Answer<'a, T> {
    pub(crate) fn new(
        (bvh, depths, table): (&'a Bvh, &'a Depths, &'a T),
        directions: Directions,
        query: &'a Query,
        cones: &'a [ConeRay],
        passed: &'a mut [f32],
    ) -> Self {
        Self { bvh, depths, table, directions, query, cones, passed, fans: Vec::with_capacity(WALKS) }
    }

    /// Walks all cones.
    pub(crate) fn run(mut self, stats: &mut impl Statistics) {
        let rays: Vec<Ray> = self.cones.iter().map(|cone| cone.ray).collect();
        self.bvh.walk_fans(&rays, &mut self, stats);
    }
}

#[inline(always)]
fn smaller(a: f32, b: f32) -> f32 {
    if a < b { a } else { b }
}

#[inline(always)]
fn larger(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}

impl<T: Table> FanGoal for Answer<'_, T> {
    #[inline(always)]
    fn start(&mut self, walk: usize, first: usize, fit: u32, _: &FanRays<FAN>) {
        while self.fans.len() <= walk {
            self.fans.push(Fan::new());
        }
        let fan = &mut self.fans[walk];
        (fan.first, fan.fit, fan.black, fan.widest) = (first, fit, 0, 0.0);
        let count = (u32::BITS - fit.leading_zeros()) as usize;
        for at in (0..count.min(FAN)).step_by(CHUNK) {
            let cones = Cones::<CHUNK>::new(self.query, self.directions, &self.cones[first + at..]);
            for i in 0..CHUNK {
                let (r, kappa) = ((at + i) % FAN, cones.kappa[i]);
                fan.kappa[r] = kappa;
                fan.views[r] = self.table.view(cones.cells[i], cones.direction(i));
                fan.stored[r] = 0.0;
                // A ray that no node may end goes on until nothing at all is left.
                fan.room[r] = if kappa > 0.0 { BLACK } else { f32::INFINITY };
                fan.exact[r] = OpticalDepth::CLEAR;
                fan.widest = larger(fan.widest, kappa);
            }
        }
    }

    #[inline(always)]
    fn may_end(&mut self, walk: usize, note: &Note, rows: &[[f32; WIDTH]; 6]) -> u32 {
        let fan = &mut self.fans[walk];
        // Of the diagonal, and of twice the way to the middle.
        let (mut square, mut distance) = ([0f32; WIDTH], [0f32; WIDTH]);
        for axis in 0..3 {
            let (low, high) = (&rows[2 * axis], &rows[2 * axis + 1]);
            for i in 0..WIDTH {
                let (size, middle) = (high[i] - low[i], low[i] + high[i]);
                square[i] += size * size;
                distance[i] += middle * middle;
            }
        }
        let mut small = 0;
        for i in 0..WIDTH {
            let share = f32::from(note.marks[i]) * SHARE;
            let size = if note.marks[i] == 0 { f32::INFINITY } else { square[i] * share / distance[i] };
            fan.sizes[i] = size;
            // False for NaN.
            small |= u32::from(size < fan.widest) << i;
        }
        small
    }

    #[inline(always)]
    fn end<S: Statistics>(
        &mut self,
        at: FanNode<'_>,
        mut left: u32,
        entered: &mut [u32; WIDTH],
        stats: &mut S,
    ) -> u32 {
        let fan = &mut self.fans[at.walk];
        let (sizes, raise) = (fan.sizes, self.query.raise());
        let mut used = [0u32; WIDTH];
        for (i, used) in used.iter_mut().enumerate() {
            *used = (at.used >> i & 1).wrapping_neg();
        }
        let mut black = 0;
        while left != 0 {
            let r = left.trailing_zeros() as usize % FAN;
            left &= left - 1;
            let (mut entry, mut exit) = ([f32::NEG_INFINITY; WIDTH], [f32::INFINITY; WIDTH]);
            for axis in 0..3 {
                let row = 2 * axis + (at.rays.negative[axis][r] as usize & 1);
                let (near, far) = (&at.rows[row], &at.rows[row ^ 1]);
                let (inv_near, inv_far) = (at.rays.inv_near[axis][r], at.rays.inv_far[axis][r]);
                for i in 0..WIDTH {
                    // The comparisons are false for NaN, which drops it.
                    entry[i] = larger(near[i] * inv_near, entry[i]);
                    exit[i] = smaller(far[i] * inv_far, exit[i]);
                }
            }
            let (start, end, kappa) = (at.rays.slab_near[r], at.rays.slab_far[r], fan.kappa[r]);
            let (mut fraction, mut any) = ([0f32; WIDTH], 0u32);
            for i in 0..WIDTH {
                let (t0, t1) = (larger(entry[i], start), smaller(exit[i], end));
                let (hit, fits) = (t0 <= t1, sizes[i] < kappa);
                entered[i] |= if hit & !fits { used[i] & 1 << r } else { 0 };
                let crossed = ((t1 - t0) + raise) / ((exit[i] - entry[i]) + raise);
                fraction[i] = if hit & fits { crossed } else { 0.0 };
                any |= if hit & fits { used[i] } else { 0 };
            }
            if any == 0 {
                continue;
            }
            let depths = self.table.depths(fan.views[r], at.note.index);
            let (mut bits, mut slots) = ([0f32; WIDTH], 0);
            for i in 0..WIDTH {
                bits[i] = if fraction[i] > 0.0 { depths[i] * fraction[i] } else { 0.0 };
                slots |= u32::from(fraction[i] > 0.0) << i;
            }
            stats.ends(at.index, slots);
            let bits =
                ((bits[0] + bits[4]) + (bits[2] + bits[6])) + ((bits[1] + bits[5]) + (bits[3] + bits[7]));
            fan.stored[r] += bits;
            black |= u32::from(fan.stored[r] > fan.room[r]) << r;
        }
        fan.black |= black;
        black
    }

    #[inline(always)]
    fn leaf(&mut self, ray: FanRay, _: u32, block: &TriangleBlock, mask: BlockMask) -> bool {
        let FanRay { index, walk, column } = ray;
        let (fan, r) = (&mut self.fans[walk], column % FAN);
        let mut depth = fan.exact[r];
        let mut open = mask.certain | mask.uncertain;
        while open != 0 {
            let lane = open.trailing_zeros() as usize % LANES;
            open &= open - 1;
            let certain = mask.certain >> lane & 1 == 1;
            if certain || segment_hits_triangle(&self.cones[index].ray, block.get(lane)) {
                depth += self.depths.of(block, lane);
            }
        }
        fan.exact[r] = depth;
        let limit = if fan.kappa[r] > 0.0 { BLACK } else { f32::INFINITY };
        fan.room[r] = limit - depth.bits();
        let black = fan.stored[r] > fan.room[r] || depth.is_opaque();
        fan.black |= u32::from(black) << r;
        black
    }

    #[inline(always)]
    fn finish(&mut self, walk: usize) {
        let fan = &self.fans[walk];
        for r in (0..FAN).filter(|r| fan.fit >> r & 1 == 1) {
            // Powers take longer than a node.
            let (stored, exact) = (fan.stored[r], fan.exact[r]);
            let exact = if exact == OpticalDepth::CLEAR { 1.0 } else { exact.transmittance() };
            let passed = if stored == 0.0 { exact } else { exact * (-stored).exp2() };
            self.passed[fan.first + r] = if fan.black >> r & 1 == 1 { 0.0 } else { passed };
        }
    }
}
