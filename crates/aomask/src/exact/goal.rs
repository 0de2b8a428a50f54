//! What hits mean: blocked or not, or dimmed.

use super::{
    rays::GROUP,
    walk::{Goal, Ground},
};
use crate::Sides;
use std::ops::ControlFlow;
use umbrage_accel::Bvh;
use umbrage_geom::{
    OpticalDepth, Ray, TriangleHit, intersect_triangle,
    kernel::{BlockMask, LANES},
    segment_hits_triangle,
};

/// Whether any triangle blocks `ray`.
pub(crate) fn any_hit(bvh: &Bvh, ray: &Ray, sides: Sides) -> bool {
    match sides {
        Sides::Both => bvh.any_hit(ray),
        Sides::Front => {
            let stop = |_, hit: TriangleHit| match hit.front {
                true => ControlFlow::Break(()),
                false => ControlFlow::Continue(()),
            };
            bvh.for_each_hit(ray, stop).is_break()
        }
    }
}

/// Rays end at the first triangle that blocks.
pub(crate) struct Blocked {
    pub(crate) sides: Sides,
}

impl Blocked {
    #[inline(always)]
    fn blocks(&self, ray: &Ray, corners: [[f32; 3]; 3]) -> bool {
        match self.sides {
            Sides::Both => segment_hits_triangle(ray, corners),
            Sides::Front => intersect_triangle(ray, corners).is_some_and(|hit| hit.front),
        }
    }
}

impl Goal for Blocked {
    #[inline(always)]
    fn lanes(&mut self, ground: &Ground<'_>, leaf: u32, ray: usize, mask: BlockMask) -> bool {
        // The side on which the origin lies may be uncertain.
        let (certain, mut open) = match self.sides {
            Sides::Both => (mask.certain, mask.uncertain),
            Sides::Front => (0, mask.certain | mask.uncertain),
        };
        let mut hit = certain != 0;
        while open != 0 && !hit {
            let lane = open.trailing_zeros() as usize % LANES;
            open &= open - 1;
            hit = self.blocks(&ground.rays.ray(ray, ground.origin), ground.block(leaf).get(lane));
        }
        hit
    }

    #[inline(always)]
    fn rays(&mut self, ground: &Ground<'_>, leaf: u32, lane: usize, group: usize, mask: BlockMask) -> u8 {
        let (mut hit, mut open) = (mask.certain, mask.uncertain);
        if self.sides == Sides::Front && hit != 0 {
            // One certain hit tells the side for all.
            let ray = ground.rays.ray(group * GROUP + hit.trailing_zeros() as usize, ground.origin);
            if !self.blocks(&ray, ground.block(leaf).get(lane)) {
                return 0;
            }
        }
        while open != 0 {
            let i = open.trailing_zeros() as usize;
            open &= open - 1;
            let ray = ground.rays.ray(group * GROUP + i, ground.origin);
            hit |= u8::from(self.blocks(&ray, ground.block(leaf).get(lane))) << i;
        }
        hit
    }

    #[inline(always)]
    fn skipped(&self, sides: impl FnOnce() -> (u32, u32)) -> u32 {
        match self.sides {
            Sides::Both => 0,
            Sides::Front => sides().1,
        }
    }
}

/// Rays are dimmed by every triangle they hit.
pub(crate) struct Dimmed<'a, F> {
    /// By ray, from the first of all walks: clear at the start.
    pub(crate) sums: &'a mut [OpticalDepth],
    pub(crate) depth_of: &'a F,
}

impl<F: Fn(u32) -> OpticalDepth> Dimmed<'_, F> {
    /// Adds what the triangle in `lane` blocks of ray number `ray`, if it is hit. Whether nothing gets through any more.
    #[inline(always)]
    fn add(&mut self, ground: &Ground<'_>, leaf: u32, lane: usize, ray: usize, certain: bool) -> bool {
        let hit = certain
            || segment_hits_triangle(&ground.rays.ray(ray, ground.origin), ground.block(leaf).get(lane));
        let sum = &mut self.sums[ground.item + ray];
        if hit {
            *sum += (self.depth_of)(ground.bvh.view().prims(leaf)[lane]);
        }
        sum.is_opaque()
    }
}

impl<F: Fn(u32) -> OpticalDepth> Goal for Dimmed<'_, F> {
    #[inline(always)]
    fn lanes(&mut self, ground: &Ground<'_>, leaf: u32, ray: usize, mask: BlockMask) -> bool {
        let mut open = mask.certain | mask.uncertain;
        let mut opaque = false;
        while open != 0 {
            let lane = open.trailing_zeros() as usize % LANES;
            open &= open - 1;
            opaque |= self.add(ground, leaf, lane, ray, mask.certain >> lane & 1 == 1);
        }
        opaque
    }

    #[inline(always)]
    fn rays(&mut self, ground: &Ground<'_>, leaf: u32, lane: usize, group: usize, mask: BlockMask) -> u8 {
        let (mut open, mut done) = (mask.certain | mask.uncertain, 0);
        while open != 0 {
            let i = open.trailing_zeros() as usize;
            open &= open - 1;
            let opaque = self.add(ground, leaf, lane, group * GROUP + i, mask.certain >> i & 1 == 1);
            done |= u8::from(opaque) << i;
        }
        done
    }

    #[inline(always)]
    fn skipped(&self, _: impl FnOnce() -> (u32, u32)) -> u32 {
        0
    }
}
