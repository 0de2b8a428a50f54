//! Queries of instances, on any kernel.

use super::*;

pub(super) struct Entered<'a, S> {
    pub(super) this: &'a InstancedBvh,
    pub(super) ray: &'a Ray,
    pub(super) entered: &'a mut Vec<usize>,
    pub(super) stats: &'a mut S,
}

impl<S: Statistics> Job for Entered<'_, S> {
    type Output = ();

    #[inline(always)]
    fn run<K: Kernel>(self, kernel: K) {
        match self.this.prepare(self.ray) {
            None => {}
            Some(TopRay::Everywhere) => self.entered.extend(0..self.this.instances.len()),
            Some(TopRay::Slab(node)) => {
                let mut walk = traversal::Walk::new(kernel, &self.this.tree, &node, self.stats);
                while let Some(index) = walk.next(self.stats) {
                    self.entered.push(index);
                }
            }
        }
    }
}

pub(super) struct AnyHit<'a, S> {
    pub(super) this: &'a InstancedBvh,
    pub(super) ray: &'a Ray,
    pub(super) stats: &'a mut S,
}

struct AnyHitVisitor;

impl<S: Statistics> Visitor<S> for AnyHitVisitor {
    #[inline(always)]
    fn visit<K: Kernel>(
        &mut self,
        kernel: K,
        (_, bvh, ray): (u32, &Bvh, Ray),
        stats: &mut S,
    ) -> ControlFlow<()> {
        let hit = traversal::any_hit(kernel, bvh, &ray, stats);
        if hit { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    }
}

impl<S: Statistics> Job for AnyHit<'_, S> {
    type Output = bool;

    #[inline(always)]
    fn run<K: Kernel>(self, kernel: K) -> bool {
        self.this.walk(kernel, self.ray, self.stats, AnyHitVisitor).is_break()
    }
}

pub(super) struct AnyHitAmong<'a, I, S> {
    pub(super) this: &'a InstancedBvh,
    pub(super) ray: &'a Ray,
    pub(super) insides: &'a mut I,
    pub(super) stats: &'a mut S,
}

struct InsideVisitor<'a, I> {
    instances: &'a [Instance],
    insides: &'a mut I,
}

impl<I: InstanceBoxes, S: Statistics> Visitor<S> for InsideVisitor<'_, I> {
    #[inline(always)]
    fn visit<K: Kernel>(
        &mut self,
        kernel: K,
        (instance, bvh, ray): (u32, &Bvh, Ray),
        stats: &mut S,
    ) -> ControlFlow<()> {
        let hit = match self.insides.inside(self.instances[instance as usize].bvh, &ray) {
            Some((noted, mut solids)) => traversal::any_hit_among(kernel, noted, &ray, 0, &mut solids, stats),
            None => traversal::any_hit(kernel, bvh, &ray, stats),
        };
        if hit { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    }
}

impl<I: InstanceBoxes, S: Statistics> Job for AnyHitAmong<'_, I, S> {
    type Output = bool;

    #[inline(always)]
    fn run<K: Kernel>(self, kernel: K) -> bool {
        let Self { this, ray, insides, stats } = self;
        this.walk(kernel, ray, stats, InsideVisitor { instances: &this.instances, insides }).is_break()
    }
}

pub(super) struct ForEachHit<'a, F, S> {
    pub(super) this: &'a InstancedBvh,
    pub(super) ray: &'a Ray,
    pub(super) visit: F,
    pub(super) stats: &'a mut S,
}

struct HitVisitor<F>(F);

impl<F: FnMut(u32, u32, TriangleHit) -> ControlFlow<()>, S: Statistics> Visitor<S> for HitVisitor<F> {
    #[inline(always)]
    fn visit<K: Kernel>(
        &mut self,
        kernel: K,
        (instance, bvh, ray): (u32, &Bvh, Ray),
        stats: &mut S,
    ) -> ControlFlow<()> {
        let mut visit = |prim, hit| (self.0)(instance, prim, hit);
        traversal::for_each_hit(kernel, bvh, &ray, &mut visit, stats)
    }
}

impl<F: FnMut(u32, u32, TriangleHit) -> ControlFlow<()>, S: Statistics> Job for ForEachHit<'_, F, S> {
    type Output = ControlFlow<()>;

    #[inline(always)]
    fn run<K: Kernel>(self, kernel: K) -> ControlFlow<()> {
        self.this.walk(kernel, self.ray, self.stats, HitVisitor(self.visit))
    }
}

pub(super) struct Transmittance<'a, F, S> {
    pub(super) this: &'a InstancedBvh,
    pub(super) ray: &'a Ray,
    pub(super) depth_of: F,
    pub(super) stats: &'a mut S,
}

struct DepthVisitor<'a, F> {
    depth_of: F,
    sum: &'a mut OpticalDepth,
}

impl<F: Fn(u32, u32) -> OpticalDepth, S: Statistics> Visitor<S> for DepthVisitor<'_, F> {
    #[inline(always)]
    fn visit<K: Kernel>(
        &mut self,
        kernel: K,
        (instance, bvh, ray): (u32, &Bvh, Ray),
        stats: &mut S,
    ) -> ControlFlow<()> {
        let mut add = |prim| {
            *self.sum += (self.depth_of)(instance, prim);
            if self.sum.is_opaque() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
        };
        traversal::for_each_crossing(kernel, bvh, &ray, &mut add, stats)
    }
}

impl<F: Fn(u32, u32) -> OpticalDepth, S: Statistics> Job for Transmittance<'_, F, S> {
    type Output = OpticalDepth;

    #[inline(always)]
    fn run<K: Kernel>(self, kernel: K) -> OpticalDepth {
        let mut sum = OpticalDepth::CLEAR;
        let visitor = DepthVisitor { depth_of: self.depth_of, sum: &mut sum };
        match self.this.walk(kernel, self.ray, self.stats, visitor) {
            ControlFlow::Break(()) => OpticalDepth::OPAQUE,
            ControlFlow::Continue(()) => sum,
        }
    }
}

pub(super) struct ClosestHit<'a, S> {
    pub(super) this: &'a InstancedBvh,
    pub(super) ray: &'a Ray,
    pub(super) stats: &'a mut S,
}

impl<S: Statistics> ClosestHit<'_, S> {
    /// Keeps the closest hit on one instance, if it is closer.
    #[inline(always)]
    fn visit<K: Kernel>(&mut self, kernel: K, index: usize, closest: &mut Option<InstanceHit>) {
        let (instance, bvh, ray) = self.this.enter(index, self.ray);
        let limit = closest.map(|closest| closest.hit.t);
        if let Some(hit) = traversal::closest_hit(kernel, bvh, &ray, limit, self.stats) {
            let hit = InstanceHit { instance, hit };
            if closest.is_none_or(|closest| hit.is_before(&closest)) {
                *closest = Some(hit);
            }
        }
    }
}

impl<S: Statistics> Job for ClosestHit<'_, S> {
    type Output = Option<InstanceHit>;

    #[inline(always)]
    fn run<K: Kernel>(mut self, kernel: K) -> Option<InstanceHit> {
        let mut closest = None;
        match self.this.prepare(self.ray)? {
            TopRay::Everywhere => {
                for index in 0..self.this.instances.len() {
                    self.visit(kernel, index, &mut closest);
                }
            }
            TopRay::Slab(node) => {
                let mut walk = traversal::SortedWalk::new(kernel, &self.this.tree, &node);
                while let Some(index) = walk.next(self.stats) {
                    self.visit(kernel, index, &mut closest);
                    if let Some(closest) = &closest {
                        walk.set_tfar(traversal::just_behind(closest.hit.t).min(self.ray.tfar));
                    }
                }
            }
        }
        closest
    }
}
