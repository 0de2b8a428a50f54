//! A ray with a solid angle through the hierarchy (`[Lacewell08]`, Algorithm 1, by the node instead of by the box).
//!
//! Here: which children of a node end which rays of a fan, and what rays lose. Not here: the walk itself
//! ([`Bvh::walk_fans_with`]), opacities (`opacity.rs`).
//!
//! Departures: children are composited by adding optical depths; nothing is interpolated between levels, see
//! [`super::published::Blend`]; a node crossed in part dims in part; the ray ends where 10 bits are lost.

use super::{
    ConeQuery, ConeRay, Directions,
    depths::Depths,
    published::SegmentEnds,
    query::Cones,
    storage::{Table, WIDTH},
};
use umbrage_accel::{Bvh, FAN, FanGoal, FanRay, NodeNote, Statistics, WALKS};
use umbrage_geom::{
    OpticalDepth, Ray,
    kernel::{BlockMask, LANES, TriangleBlock},
    segment_hits_triangle,
};

/// Optical depth in bits from which an approximate ray counts as blocked: less than a thousandth is lost.
const BLOCKED_DEPTH: f32 = 10.0;

/// Rays prepared at once.
const CHUNK: usize = 8;

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
    views: [V; FAN],
    /// Lost in nodes, bits.
    stored: [f32; FAN],
    /// What may be lost until the ray is black.
    limit: [f32; FAN],
    /// The same, less what is lost in triangles.
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
            views: [V::default(); FAN],
            stored: [0.0; FAN],
            limit: [0.0; FAN],
            room: [0.0; FAN],
            exact: [OpticalDepth::CLEAR; FAN],
        }
    }
}

/// Answers cones through [`Bvh::walk_fans_with`].
pub(crate) struct Answer<'a, T: Table> {
    pub(crate) bvh: &'a Bvh,
    pub(crate) depths: &'a Depths,
    pub(crate) table: &'a T,
    pub(crate) directions: Directions,
    pub(crate) query: &'a ConeQuery,
    pub(crate) cones: &'a [ConeRay],
    pub(crate) passed: &'a mut [f32],
    fans: Vec<Fan<T::View>>,
}

impl<'a, T: Table> Answer<'a, T> {
    pub(crate) fn new(
        (bvh, depths, table): (&'a Bvh, &'a Depths, &'a T),
        directions: Directions,
        query: &'a ConeQuery,
        cones: &'a [ConeRay],
        passed: &'a mut [f32],
    ) -> Self {
        Self { bvh, depths, table, directions, query, cones, passed, fans: Vec::with_capacity(WALKS) }
    }

    /// Walks all cones.
    pub(crate) fn run(mut self, stats: &mut impl Statistics) {
        let rays: Vec<Ray> = self.cones.iter().map(|cone| cone.ray).collect();
        self.bvh.walk_fans_with(&rays, &mut self, stats);
    }
}

impl<T: Table> FanGoal for Answer<'_, T> {
    const ENDS: bool = true;

    #[inline(always)]
    fn start(&mut self, walk: usize, first: usize, fit: u32, limits: &mut [f32; FAN]) {
        while self.fans.len() <= walk {
            self.fans.push(Fan::new());
        }
        let fan = &mut self.fans[walk];
        (fan.first, fan.fit, fan.black) = (first, fit, 0);
        let count = (u32::BITS - fit.leading_zeros()) as usize;
        for at in (0..count.min(FAN)).step_by(CHUNK) {
            let cones = Cones::<CHUNK>::new(self.query, self.directions, &self.cones[first + at..]);
            for i in 0..CHUNK {
                let (r, kappa) = ((at + i) % FAN, cones.kappa[i]);
                limits[r] = kappa;
                fan.views[r] = self.table.view(cones.cells[i], cones.direction(i));
                fan.stored[r] = 0.0;
                // A ray that no node may end goes on until nothing at all is left.
                fan.limit[r] = if kappa > 0.0 { BLOCKED_DEPTH } else { f32::INFINITY };
                fan.room[r] = fan.limit[r];
                fan.exact[r] = OpticalDepth::CLEAR;
            }
        }
    }

    #[inline(always)]
    fn end(&mut self, ray: FanRay, note: &NodeNote, slots: u32, covered: &[f32; WIDTH]) -> bool {
        let (fan, r) = (&mut self.fans[ray.walk], ray.column % FAN);
        let depths = self.table.depths(fan.views[r], note.index);
        let mut bits = [0f32; WIDTH];
        match self.query.ends {
            SegmentEnds::Fraction => {
                for i in 0..WIDTH {
                    bits[i] = depths[i] * covered[i];
                }
            }
            SegmentEnds::Whole => {
                for i in 0..WIDTH {
                    bits[i] = depths[i] * (slots >> i & 1) as f32;
                }
            }
        }
        fan.stored[r] +=
            ((bits[0] + bits[4]) + (bits[2] + bits[6])) + ((bits[1] + bits[5]) + (bits[3] + bits[7]));
        let black = fan.stored[r] > fan.room[r];
        fan.black |= u32::from(black) << r;
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
        fan.room[r] = fan.limit[r] - depth.bits();
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
