//! A kd-tree over triangles: cells that don't overlap, some of them empty.
//!
//! Here: layout, queries, and what marks empty cells as inside or outside of solids. Not here: which cells those are
//! (`umbrage-occlusion`, module `volumetric`). For rays alone, [`crate::Bvh`] is faster.

mod build;
mod cells;
mod clip;
mod node;
mod walk;

pub use cells::{Leaf, Location};
pub use node::LeafState;
pub use walk::{Blocker, Cells, KdScratch, Order, Search, Start};

use crate::{
    BackEnd, BuildError, Statistics,
    bvh::MAX_PRIMS,
    kernel::{self, Job, Kernel},
};
use node::Node;
use umbrage_geom::{
    Aabb, Progress, Ray,
    kernel::{LANES, TriangleBlock},
    mesh::validate_slices,
};

/// Options of [`KdTree::build`].
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct KdOptions {
    /// Cost of a traversal step, in the unit of [`Self::cost_intersect`].
    pub cost_traverse: f32,
    /// Cost of testing a block of up to eight triangles.
    pub cost_intersect: f32,
    /// Part of its cost that a split is forgiven when one side is empty (Djeu11, section 3.3: 15 %).
    pub empty_bonus: f32,
}

impl Default for KdOptions {
    fn default() -> Self {
        Self { cost_traverse: 1.0, cost_intersect: 3.0, empty_bonus: 0.15 }
    }
}

impl KdOptions {
    /// With another [`Self::cost_traverse`].
    #[must_use]
    pub fn with_cost_traverse(self, cost_traverse: f32) -> Self {
        Self { cost_traverse, ..self }
    }

    /// With another [`Self::cost_intersect`].
    #[must_use]
    pub fn with_cost_intersect(self, cost_intersect: f32) -> Self {
        Self { cost_intersect, ..self }
    }

    /// With another [`Self::empty_bonus`].
    #[must_use]
    pub fn with_empty_bonus(self, empty_bonus: f32) -> Self {
        Self { empty_bonus, ..self }
    }
}

/// A kd-tree over triangles.
///
/// Queries answer exactly what a loop over all triangles answers ([`crate::brute`]), in every [`Order`].
///
/// # Layout
/// Nodes of 8 bytes (`[Djeu11]`, section 3.3), left children next to their parents. Leaves hold copies of their triangles in
/// blocks of up to eight, 128 bytes each, so that one SIMD filter tests a leaf.
///
/// # Empty cells
/// A leaf that is not [`LeafState::Boundary`] has no triangle that reaches into the inside of its cell or lies in the inside
/// of one of its faces together with an empty neighbour there: triangles are clipped to cells with room for all rounding, and
/// dropped only where they touch no more than the rim of a face.
#[derive(Clone, Debug)]
pub struct KdTree {
    nodes: Vec<Node>,
    blocks: Vec<TriangleBlock>,
    /// Index of each lane's triangle; unused lanes, which come last, have `u32::MAX`.
    prims: Vec<[u32; LANES]>,
    bounds: Aabb,
    count: usize,
    back_end: BackEnd,
}

impl KdTree {
    /// Builds over all `triangles`; takes `O(n log n)` time.
    ///
    /// # Errors
    /// [`BuildError::Mesh`] as from [`validate_slices`]; [`BuildError::TooMany`] beyond `2^30` triangles or `2^29` nodes.
    pub fn build(
        positions: &[[f32; 3]],
        triangles: &[[u32; 3]],
        options: &KdOptions,
    ) -> Result<Self, BuildError> {
        Self::build_guarded(positions, triangles, &[], options, &mut |_| true)
    }

    /// [`Self::build`] with `guards`: triangles of finite coordinates that block nothing, but that no empty cell touches.
    /// `progress` is called with numbers that grow to 1, and cancels by returning `false`.
    ///
    /// # Errors
    /// As [`Self::build`]; [`BuildError::Cancelled`].
    pub fn build_guarded(
        positions: &[[f32; 3]],
        triangles: &[[u32; 3]],
        guards: &[[[f32; 3]; 3]],
        options: &KdOptions,
        progress: &mut (dyn FnMut(f32) -> bool + Send),
    ) -> Result<Self, BuildError> {
        validate_slices(positions, triangles)?;
        let count = triangles.len() + guards.len();
        if count > MAX_PRIMS {
            return Err(BuildError::TooMany { what: "triangles", count, limit: MAX_PRIMS });
        }
        let corners = |prim: u32| match triangles.get(prim as usize) {
            Some(triangle) => triangle.map(|v| positions[v as usize]),
            None => guards[prim as usize - triangles.len()],
        };
        let all = (0..count as u32).flat_map(corners);
        let bounds = all.fold(Aabb::EMPTY, |aabb, p| aabb.with_point(p.map(|x| x + 0.0)));
        let progress = Progress::new(build::PROGRESS, progress);
        let built = build::build(count, triangles.len(), &corners, &bounds, options, &progress)?;
        progress.finish()?;
        Ok(Self {
            nodes: built.nodes,
            blocks: built.blocks,
            prims: built.prims,
            bounds,
            count: triangles.len(),
            back_end: BackEnd::best(),
        })
    }

    /// Whether the open segment meets any triangle.
    pub fn any_hit(&self, ray: &Ray) -> bool {
        self.blocker_with(ray, Order::RAY, &mut (), &mut KdScratch::default(), &mut ()).any()
    }

    /// What blocks the open segment: a triangle, or an opaque cell that `cells` vouches for. Which of several is not
    /// promised.
    pub fn blocker_with(
        &self,
        ray: &Ray,
        order: Order,
        cells: &mut impl Cells,
        scratch: &mut KdScratch<1>,
        stats: &mut impl Statistics,
    ) -> Blocker {
        let [blocker] = self.blockers_with([ray], order, cells, scratch, stats);
        blocker
    }

    /// [`Self::blocker_with`] of `N` rays that walk together; four are a packet as in Djeu11, section 3.7.1.
    #[inline]
    pub fn blockers_with<const N: usize>(
        &self,
        rays: [&Ray; N],
        order: Order,
        cells: &mut impl Cells,
        scratch: &mut KdScratch<N>,
        stats: &mut impl Statistics,
    ) -> [Blocker; N] {
        const { assert!(N >= 1 && N <= 32, "lanes are bits of one word") };
        kernel::run(self.back_end, Blockers { tree: self, rays, order, cells, scratch, stats })
    }

    /// Smallest box around all triangles and guards.
    pub fn bounds(&self) -> Aabb {
        self.bounds
    }

    /// Bytes that the tree holds, its copies of the triangles included.
    pub fn bytes(&self) -> usize {
        size_of_val(&self.nodes[..]) + size_of_val(&self.blocks[..]) + size_of_val(&self.prims[..])
    }

    /// Number of triangles.
    pub fn prim_count(&self) -> usize {
        self.count
    }

    /// Number of nodes, leaves included.
    pub fn node_count(&self) -> usize {
        self.nodes.len()
    }

    /// What queries run on.
    pub fn back_end(&self) -> BackEnd {
        self.back_end
    }

    /// The same tree on another back end. Answers are the same.
    ///
    /// # Errors
    /// [`BuildError::BackEnd`] if this processor lacks it.
    pub fn with_back_end(self, back_end: BackEnd) -> Result<Self, BuildError> {
        if back_end.is_supported() {
            Ok(Self { back_end, ..self })
        } else {
            Err(BuildError::BackEnd(back_end))
        }
    }

    /// Triangles in a block.
    #[inline]
    fn block_len(&self, block: usize) -> u32 {
        self.prims[block].iter().take_while(|&&prim| prim != u32::MAX).count() as u32
    }
}

struct Blockers<'a, const N: usize, C, S> {
    tree: &'a KdTree,
    rays: [&'a Ray; N],
    order: Order,
    cells: &'a mut C,
    scratch: &'a mut KdScratch<N>,
    stats: &'a mut S,
}

impl<const N: usize, C: Cells, S: Statistics> Job for Blockers<'_, N, C, S> {
    type Output = [Blocker; N];

    #[inline(always)]
    fn run<K: Kernel>(self, kernel: K) -> [Blocker; N] {
        let Self { tree, rays, order, cells, scratch, stats } = self;
        walk::walk(kernel, tree, rays, order, cells, scratch, stats)
    }
}
