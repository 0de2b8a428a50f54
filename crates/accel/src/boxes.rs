//! The hierarchy over boxes whose contents only the caller knows.

use crate::{
    BackEnd, BuildError, BuildQuality,
    bvh::MAX_PRIMS,
    fan::Walk,
    kernel::{self, FAN, Job, Kernel, NodeRay},
    node::Tree,
    topology::Topology,
    traversal::{self, SortedWalk, just_behind},
};
use std::ops::ControlFlow;
use umbrage_geom::{Aabb, Ray, SlabRay, kernel::fan::FanRays};

/// An 8-wide bounding volume hierarchy over boxes: patches, grids, whatever can say itself where a ray meets it.
#[derive(Clone, Debug)]
pub struct BoxBvh {
    tree: Tree,
    /// Index of each leaf's box.
    prims: Vec<u32>,
    back_end: BackEnd,
}

/// What to do in boxes that a segment may enter: see [`BoxBvh::walk_with`].
pub trait BoxVisitor {
    /// Called with the index of a box; see [`BoxBvh::walk`].
    fn visit(&mut self, index: u32) -> ControlFlow<(), f32>;
}

/// What to do in boxes that rays of one origin may enter: see [`BoxBvh::walk_fan`].
pub trait BoxFanVisitor {
    /// Called with the index of a box and the rays of `fan` that may enter it, a bit each. Returns those of them that need no
    /// more.
    fn visit(&mut self, index: u32, rays: u32, fan: &FanRays<FAN>) -> u32;
}

struct Closure<F>(F);

impl<F: FnMut(u32) -> ControlFlow<(), f32>> BoxVisitor for Closure<F> {
    #[inline(always)]
    fn visit(&mut self, index: u32) -> ControlFlow<(), f32> {
        (self.0)(index)
    }
}

impl BoxBvh {
    /// Builds over `boxes`, of which none may be empty or not finite; takes `O(n log n)` time.
    ///
    /// # Errors
    /// [`BuildError::Box`] for an empty box or one that is not finite; [`BuildError::TooMany`] beyond `2^30` boxes.
    pub fn build(boxes: &[Aabb], quality: BuildQuality) -> Result<Self, BuildError> {
        if boxes.len() > MAX_PRIMS {
            return Err(BuildError::TooMany { what: "boxes", count: boxes.len(), limit: MAX_PRIMS });
        }
        if let Some(index) =
            boxes.iter().position(|b| b.is_empty() || !b.min.is_finite() || !b.max.is_finite())
        {
            return Err(BuildError::Box { index });
        }
        let (mut tree, mut prims) = (Tree::new(Vec::new()), Vec::new());
        if !boxes.is_empty() {
            // Half of what they are around is taken to be solid.
            let area = |i: u32| 0.25 * boxes[i as usize].area();
            let topology = Topology::build(boxes, quality, area, |run| (run.len() == 1).then_some(()));
            prims = topology.leaves.iter().map(|(leaf, ())| topology.order[leaf.start as usize]).collect();
            tree = Tree::new(topology.nodes);
            tree.refit(|leaf| boxes[prims[leaf] as usize]);
        }
        Ok(Self { tree, prims, back_end: BackEnd::best() })
    }

    /// Calls `visit` with the index of every box that the segment may enter, roughly from near to far, until it breaks.
    ///
    /// `visit` returns where the segment ends from now on: the ray's `tfar`, or the `t` of the nearest hit so far (boxes
    /// that tie with it after rounding are still visited). A ray that is not [valid](Ray::is_valid) enters no box.
    pub fn walk(&self, ray: &Ray, visit: impl FnMut(u32) -> ControlFlow<(), f32>) -> ControlFlow<()> {
        self.walk_with(ray, &mut Closure(visit))
    }

    /// [`Self::walk`] with a visitor instead of a closure: if its [`BoxVisitor::visit`] is `#[inline(always)]`, it is compiled
    /// for the instructions that the hierarchy uses.
    pub fn walk_with(&self, ray: &Ray, visitor: &mut impl BoxVisitor) -> ControlFlow<()> {
        kernel::run(self.back_end, WalkBoxes { bvh: self, ray, visitor })
    }

    /// [`Self::walk_with`] in no particular order, until the visitor breaks: faster, where any hit ends the walk. Where the
    /// segment ends, which [`BoxVisitor::visit`] returns, makes no difference.
    pub fn walk_unsorted(&self, ray: &Ray, visitor: &mut impl BoxVisitor) -> ControlFlow<()> {
        kernel::run(self.back_end, WalkUnsorted(WalkBoxes { bvh: self, ray, visitor }))
    }

    /// Walks rays of one origin together. Returns the rays that were answered, one bit each.
    ///
    /// Until the visitor says that an answered ray needs no more, the ray is given every box that its closed segment touches
    /// in exact arithmetic, and no box twice. It may be given other boxes too. Which other boxes, and the order of all, depend
    /// on which other rays of the fan still look, because a node is tested against all of them together where that is faster.
    ///
    /// Rays that are not answered are given no box. They are not valid, or their direction or segment is of extreme size:
    /// they need a walk of their own.
    ///
    /// # Panics
    /// If there are no rays or more than [`FAN`]; origins of the same bits are for the caller to see to.
    pub fn walk_fan(&self, rays: &[Ray], visitor: &mut impl BoxFanVisitor) -> u32 {
        assert!((1..=FAN).contains(&rays.len()), "{} rays are no fan", rays.len());
        kernel::run(self.back_end, WalkFan { bvh: self, rays, visitor })
    }

    /// Smallest box around all boxes; empty if there are none.
    pub fn bounds(&self) -> Aabb {
        if self.tree.nodes.is_empty() { Aabb::EMPTY } else { self.tree.bounds }
    }

    /// Bytes that the hierarchy holds.
    pub fn bytes(&self) -> usize {
        self.tree.bytes() + size_of_val(&self.prims[..])
    }
}

struct WalkBoxes<'a, V> {
    bvh: &'a BoxBvh,
    ray: &'a Ray,
    visitor: &'a mut V,
}

struct WalkUnsorted<'a, V>(WalkBoxes<'a, V>);

impl<V: BoxVisitor> Job for WalkUnsorted<'_, V> {
    type Output = ControlFlow<()>;

    #[inline(always)]
    fn run<K: Kernel>(self, kernel: K) -> ControlFlow<()> {
        let WalkBoxes { bvh, ray, visitor } = self.0;
        let Some(slab) = SlabRay::new(ray) else { return ControlFlow::Continue(()) };
        if bvh.tree.nodes.is_empty() {
            return ControlFlow::Continue(());
        }
        let node = NodeRay::new(slab);
        let mut walk = traversal::Walk::new(kernel, &bvh.tree, &node, &mut ());
        while let Some(leaf) = walk.next(&mut ()) {
            if visitor.visit(bvh.prims[leaf]).is_break() {
                return ControlFlow::Break(());
            }
        }
        ControlFlow::Continue(())
    }
}

struct WalkFan<'a, V> {
    bvh: &'a BoxBvh,
    rays: &'a [Ray],
    visitor: &'a mut V,
}

impl<V: BoxFanVisitor> Job for WalkFan<'_, V> {
    type Output = u32;

    #[inline(always)]
    fn run<K: Kernel>(self, kernel: K) -> u32 {
        let Self { bvh, rays, visitor } = self;
        let mut walk = Walk::new();
        let fit = walk.start(0, rays, &bvh.bounds());
        if bvh.tree.nodes.is_empty() {
            return fit;
        }
        while let Some((leaf, rays)) = walk.next_leaf(kernel, &bvh.tree) {
            walk.alive &= !visitor.visit(bvh.prims[leaf], rays, &walk.fan.rays);
        }
        fit
    }
}

impl<V: BoxVisitor> Job for WalkBoxes<'_, V> {
    type Output = ControlFlow<()>;

    #[inline(always)]
    fn run<K: Kernel>(self, kernel: K) -> ControlFlow<()> {
        let Some(slab) = SlabRay::new(self.ray) else { return ControlFlow::Continue(()) };
        if self.bvh.tree.nodes.is_empty() {
            return ControlFlow::Continue(());
        }
        let node = NodeRay::new(slab);
        let mut walk = SortedWalk::new(kernel, &self.bvh.tree, &node);
        let mut tfar = self.ray.tfar;
        while let Some(leaf) = walk.next(&mut ()) {
            match self.visitor.visit(self.bvh.prims[leaf]) {
                ControlFlow::Break(()) => return ControlFlow::Break(()),
                ControlFlow::Continue(t) if t < tfar => {
                    tfar = t;
                    walk.set_tfar(just_behind(t).min(self.ray.tfar));
                }
                ControlFlow::Continue(_) => {}
            }
        }
        ControlFlow::Continue(())
    }
}
