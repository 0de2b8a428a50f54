//! What hits mean: blocked or not, dimmed, or how far away.

use super::{
    rays::GROUP,
    walk::{Goal, GoalContext},
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
fn any_hit(bvh: &Bvh, ray: &Ray, sides: Sides) -> bool {
    match sides {
        Sides::Both => bvh.any_hit(ray),
        Sides::Front => {
            let stop = |_, hit: TriangleHit| match hit.front {
                true => ControlFlow::Break(()),
                false => ControlFlow::Continue(()),
            };
            bvh.for_each_hit(ray, stop).is_break()
        }
        Sides::FrontFirst => bvh.closest_hit(ray).is_some_and(|hit| hit.front),
    }
}

/// Whether `ray` hits the triangle from a side that counts.
#[inline(always)]
fn hits(ray: &Ray, corners: [[f32; 3]; 3], sides: Sides) -> bool {
    match sides {
        Sides::Both => segment_hits_triangle(ray, corners),
        Sides::Front | Sides::FrontFirst => intersect_triangle(ray, corners).is_some_and(|hit| hit.front),
    }
}

/// Rays end at the first triangle that blocks. Not for [`Sides::FrontFirst`], which needs [`Nearest`].
pub(crate) struct Blocked {
    pub(crate) sides: Sides,
}

impl Goal for Blocked {
    const SHRINKS: bool = false;

    #[inline(always)]
    fn lanes(&mut self, ground: &mut GoalContext<'_>, leaf: u32, ray: usize, mask: BlockMask) -> bool {
        // The side on which the origin lies may be uncertain.
        let (certain, mut open) = match self.sides {
            Sides::Both => (mask.certain, mask.uncertain),
            Sides::Front | Sides::FrontFirst => (0, mask.certain | mask.uncertain),
        };
        let mut hit = certain != 0;
        while open != 0 && !hit {
            let lane = open.trailing_zeros() as usize % LANES;
            open &= open - 1;
            hit = hits(&ground.rays.ray(ray, ground.origin), ground.block(leaf).get(lane), self.sides);
        }
        hit
    }

    #[inline(always)]
    fn rays(
        &mut self,
        ground: &mut GoalContext<'_>,
        leaf: u32,
        lane: usize,
        group: usize,
        mask: BlockMask,
    ) -> u8 {
        let (mut hit, mut open) = (mask.certain, mask.uncertain);
        if self.sides != Sides::Both && hit != 0 {
            // One certain hit tells the side for all.
            let ray = ground.rays.ray(group * GROUP + hit.trailing_zeros() as usize, ground.origin);
            if !hits(&ray, ground.block(leaf).get(lane), self.sides) {
                return 0;
            }
        }
        while open != 0 {
            let i = open.trailing_zeros() as usize;
            open &= open - 1;
            let ray = ground.rays.ray(group * GROUP + i, ground.origin);
            hit |= u8::from(hits(&ray, ground.block(leaf).get(lane), self.sides)) << i;
        }
        hit
    }

    #[inline(always)]
    fn skipped(&self, sides: impl FnOnce() -> (u32, u32)) -> u32 {
        match self.sides {
            Sides::Both => 0,
            Sides::Front | Sides::FrontFirst => sides().1,
        }
    }

    fn alone(&mut self, bvh: &Bvh, _: usize, ray: &Ray) -> bool {
        any_hit(bvh, ray, self.sides)
    }
}

/// Rays are dimmed by every triangle they hit.
pub(crate) struct Dimmed<'a, F> {
    /// Not [`Sides::FrontFirst`].
    pub(crate) sides: Sides,
    /// By ray, from the first of all walks: clear at the start.
    pub(crate) sums: &'a mut [OpticalDepth],
    pub(crate) depth_of: &'a F,
}

impl<F: Fn(u32) -> OpticalDepth> Dimmed<'_, F> {
    /// Adds what the triangle in `lane` blocks of ray number `ray`, if it is hit. Whether nothing gets through any more.
    #[inline(always)]
    fn add(&mut self, ground: &GoalContext<'_>, leaf: u32, lane: usize, ray: usize, certain: bool) -> bool {
        let certain = certain && self.sides == Sides::Both;
        let corners = ground.block(leaf).get(lane);
        let hit = certain || hits(&ground.rays.ray(ray, ground.origin), corners, self.sides);
        let sum = &mut self.sums[ground.item + ray];
        if hit {
            *sum += (self.depth_of)(ground.bvh.view().prims(leaf)[lane]);
        }
        sum.is_opaque()
    }
}

impl<F: Fn(u32) -> OpticalDepth> Goal for Dimmed<'_, F> {
    const SHRINKS: bool = false;

    #[inline(always)]
    fn lanes(&mut self, ground: &mut GoalContext<'_>, leaf: u32, ray: usize, mask: BlockMask) -> bool {
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
    fn rays(
        &mut self,
        ground: &mut GoalContext<'_>,
        leaf: u32,
        lane: usize,
        group: usize,
        mask: BlockMask,
    ) -> u8 {
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
    fn skipped(&self, sides: impl FnOnce() -> (u32, u32)) -> u32 {
        if self.sides == Sides::Both { 0 } else { sides().1 }
    }

    fn alone(&mut self, bvh: &Bvh, index: usize, ray: &Ray) -> bool {
        let sum = &mut self.sums[index];
        *sum = OpticalDepth::CLEAR;
        let visit = |prim, hit: TriangleHit| {
            if self.sides == Sides::Both || hit.front {
                *sum += (self.depth_of)(prim);
            }
            if sum.is_opaque() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
        };
        bvh.for_each_hit(ray, visit).is_break()
    }
}

/// The nearest hit of a ray.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Hit {
    /// Infinite if there is none.
    pub(crate) t: f32,
    prim: u32,
    front: bool,
}

impl Hit {
    pub(crate) const NONE: Self = Self { t: f32::INFINITY, prim: u32::MAX, front: false };

    /// Whether the ray is blocked.
    pub(crate) fn blocks(&self, sides: Sides) -> bool {
        self.t < f32::INFINITY && (sides == Sides::Both || self.front)
    }
}

/// Rays look for their nearest hit, and get shorter with every hit.
pub(crate) struct Nearest<'a> {
    pub(crate) sides: Sides,
    /// By ray, from the first of all walks: none at the start.
    pub(crate) hits: &'a mut [Hit],
}

impl Nearest<'_> {
    /// Takes up that ray `index` hits triangle `prim`; whether it is the nearest so far.
    fn meet(&mut self, index: usize, prim: u32, hit: TriangleHit) -> bool {
        if self.sides == Sides::Front && !hit.front {
            return false;
        }
        let best = &mut self.hits[index];
        let nearer = hit.t < best.t || (hit.t == best.t && prim < best.prim);
        if nearer {
            *best = Hit { t: hit.t, prim, front: hit.front };
        }
        nearer
    }

    fn test(&mut self, ground: &mut GoalContext<'_>, leaf: u32, lane: usize, ray: usize) {
        let hit = intersect_triangle(&ground.rays.ray(ray, ground.origin), ground.block(leaf).get(lane));
        let prim = ground.bvh.view().prims(leaf)[lane];
        if let Some(hit) = hit.filter(|&hit| self.meet(ground.item + ray, prim, hit)) {
            ground.rays.shorten(ray, hit.t);
        }
    }
}

impl Goal for Nearest<'_> {
    const SHRINKS: bool = true;

    #[inline(always)]
    fn lanes(&mut self, ground: &mut GoalContext<'_>, leaf: u32, ray: usize, mask: BlockMask) -> bool {
        let mut open = mask.certain | mask.uncertain;
        while open != 0 {
            self.test(ground, leaf, open.trailing_zeros() as usize % LANES, ray);
            open &= open - 1;
        }
        false
    }

    #[inline(always)]
    fn rays(
        &mut self,
        ground: &mut GoalContext<'_>,
        leaf: u32,
        lane: usize,
        group: usize,
        mask: BlockMask,
    ) -> u8 {
        let mut open = mask.certain | mask.uncertain;
        while open != 0 {
            self.test(ground, leaf, lane, group * GROUP + open.trailing_zeros() as usize);
            open &= open - 1;
        }
        0
    }

    #[inline(always)]
    fn skipped(&self, sides: impl FnOnce() -> (u32, u32)) -> u32 {
        if self.sides == Sides::Front { sides().1 } else { 0 }
    }

    fn alone(&mut self, bvh: &Bvh, index: usize, ray: &Ray) -> bool {
        self.hits[index] = Hit::NONE;
        let visit = |prim, hit| {
            self.meet(index, prim, hit);
            ControlFlow::Continue(())
        };
        let _ = bvh.for_each_hit(ray, visit);
        self.hits[index].blocks(self.sides)
    }
}
