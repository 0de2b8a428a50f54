//! The hierarchy over the triangles of one mesh.

use crate::{
    BackEnd, BuildError, BuildOptions, Statistics, fan,
    kernel::{self, Job, Kernel},
    memory,
    node::Tree,
    packet,
    solid::SolidBoxes,
    topology::Topology,
    traversal,
};
use fan::{FEWEST_FAN_RAYS, FanGoal};
use std::ops::{ControlFlow, Range};
use umbrage_geom::{
    Aabb, OpticalDepth, Ray, TriangleHit,
    glam::Vec3,
    kernel::{LANES, TriangleBlock},
    mesh::{validate_positions, validate_slices},
};

/// Most triangles, and most instances: `obvhs` and references to children count twice as many nodes in 31 bits.
pub(crate) const MAX_PRIMS: usize = 1 << 30;

/// A hit on a mesh.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    /// Ray parameter, see [`TriangleHit::t`].
    pub t: f32,
    /// Barycentric weight of the second corner.
    pub u: f32,
    /// Barycentric weight of the third corner.
    pub v: f32,
    /// Index of the triangle in the caller's array.
    pub prim_index: u32,
    /// Whether the corners run counter-clockwise as seen from the ray's origin side.
    pub front: bool,
}

impl Hit {
    /// `hit` on triangle `prim_index`.
    #[inline]
    pub fn new(prim_index: u32, TriangleHit { t, u, v, front }: TriangleHit) -> Self {
        Self { t, u, v, prim_index, front }
    }

    /// The order that defines the closest hit: by `t`, then by `prim_index`.
    #[inline]
    pub fn is_before(&self, other: &Self) -> bool {
        self.t < other.t || (self.t == other.t && self.prim_index < other.prim_index)
    }
}

/// An 8-wide bounding volume hierarchy over triangles; immutable but for [`Self::refit`].
///
/// Every query answers exactly what a loop over all triangles with [`umbrage_geom::segment_hits_triangle`] or
/// [`umbrage_geom::intersect_triangle`] answers ([`crate::brute`]), whatever the build options and back end: the segment is
/// open, triangles are closed, rays that are not [valid](Ray::is_valid) and degenerate triangles miss.
///
/// # Layout
/// Nodes and leaves are 128 bytes, two cache lines. A leaf has up to eight triangles over up to eight vertices, with 32 bytes
/// more for the indices of its vertices and 4 for that of each triangle.
#[derive(Clone, Debug)]
pub struct Bvh {
    pub(crate) tree: Tree,
    /// Leaf by leaf; the tag is where the leaf starts in `prims`.
    pub(crate) blocks: Vec<TriangleBlock>,
    /// Indices of triangles in the caller's array.
    pub(crate) prims: Vec<u32>,
    /// The caller's vertices in each leaf, for refits; `u32::MAX` after the last.
    vertices: Vec<[u32; LANES]>,
    /// Number of the caller's vertices.
    vertex_count: usize,
    back_end: BackEnd,
}

fn corners(positions: &[[f32; 3]], triangle: [u32; 3]) -> [[f32; 3]; 3] {
    triangle.map(|v| positions[v as usize])
}

/// The vertices of a leaf's triangles, each once: what a [`TriangleBlock`] is made of.
#[derive(Clone, Copy, Debug)]
pub struct LeafVertices {
    /// `u32::MAX` after the last.
    pub ids: [u32; LANES],
    /// By triangle: places in `ids`.
    pub corners: [[u8; 3]; LANES],
}

impl LeafVertices {
    /// Those of the triangles in `run`, eight at most; `None` if there are more than a leaf holds.
    pub fn of(triangles: &[[u32; 3]], run: &[u32]) -> Option<Self> {
        let mut this = Self { ids: [u32::MAX; LANES], corners: [[0; 3]; LANES] };
        for (corners, &prim) in this.corners.iter_mut().zip(run) {
            for (corner, id) in corners.iter_mut().zip(triangles[prim as usize]) {
                // The first place that holds this vertex, or none yet.
                let place = this.ids.iter().position(|&known| known == id || known == u32::MAX)?;
                this.ids[place] = id;
                *corner = place as u8;
            }
        }
        Some(this)
    }
}

fn area(positions: &[[f32; 3]], triangle: [u32; 3]) -> f32 {
    let [a, b, c] = corners(positions, triangle).map(Vec3::from);
    0.5 * (b - a).cross(c - a).length()
}

fn triangle_boxes(positions: &[[f32; 3]], triangles: &[[u32; 3]]) -> Vec<Aabb> {
    let aabb = |&t: &[u32; 3]| Aabb::from_points(&corners(positions, t));
    #[cfg(feature = "rayon")]
    {
        use rayon::prelude::*;
        triangles.par_iter().with_min_len(1 << 14).map(aabb).collect()
    }
    #[cfg(not(feature = "rayon"))]
    triangles.iter().map(aabb).collect()
}

impl Bvh {
    /// Builds over all `triangles`; takes `O(n log n)` time.
    ///
    /// # Errors
    /// [`BuildError::Mesh`] as from [`validate_slices`]; [`BuildError::TooMany`] beyond `2^30` triangles or
    /// `2^32 - 2` vertices.
    pub fn build(
        positions: &[[f32; 3]],
        triangles: &[[u32; 3]],
        options: &BuildOptions,
    ) -> Result<Self, BuildError> {
        validate_slices(positions, triangles)?;
        if triangles.len() > MAX_PRIMS {
            return Err(BuildError::TooMany { what: "triangles", count: triangles.len(), limit: MAX_PRIMS });
        }
        if positions.len() >= u32::MAX as usize {
            let (count, limit) = (positions.len(), u32::MAX as usize - 1);
            return Err(BuildError::TooMany { what: "vertices", count, limit });
        }
        let boxes = triangle_boxes(positions, triangles);
        let leaf_size = usize::from(options.leaf_size).clamp(1, LANES);
        let fits = |run: &[u32]| if run.len() <= leaf_size { LeafVertices::of(triangles, run) } else { None };
        let topology =
            Topology::build(&boxes, options.quality, |prim| area(positions, triangles[prim as usize]), fits);
        let mut blocks = memory::with_capacity(topology.leaves.len());
        let mut vertices = Vec::with_capacity(topology.leaves.len());
        for (range, of) in &topology.leaves {
            let mut block =
                TriangleBlock::new(&[[0.0; 3]; LANES], &of.corners[..range.len()]).expect("it fits by now");
            block.tag = range.start;
            blocks.push(block);
            vertices.push(of.ids);
        }
        let mut bvh = Self {
            tree: Tree::new(topology.nodes),
            blocks,
            prims: topology.order,
            vertices,
            vertex_count: positions.len(),
            back_end: BackEnd::best(),
        };
        bvh.fill(positions);
        Ok(bvh)
    }

    /// Moves the vertices and keeps the tree; takes linear time.
    ///
    /// Answers stay exact for any motion. Queries get slower the more the mesh deforms: build again then.
    ///
    /// # Errors
    /// [`BuildError::Count`] unless there are as many `positions` as at the build; [`BuildError::Mesh`] for coordinates as
    /// from [`validate_positions`]. Nothing has moved then.
    pub fn refit(&mut self, positions: &[[f32; 3]]) -> Result<(), BuildError> {
        if positions.len() != self.vertex_count {
            return Err(BuildError::Count {
                what: "vertices",
                count: positions.len(),
                expected: self.vertex_count,
            });
        }
        validate_positions(positions)?;
        self.fill(positions);
        Ok(())
    }

    /// Index of a leaf's triangle in the caller's array.
    #[inline]
    pub(crate) fn prim(&self, leaf: usize, lane: usize) -> u32 {
        self.prims[self.blocks[leaf].tag as usize + lane]
    }

    /// Writes vertices into leaves and boxes into nodes.
    fn fill(&mut self, positions: &[[f32; 3]]) {
        for (block, ids) in self.blocks.iter_mut().zip(&self.vertices) {
            let mut vertices = [[0.0; 3]; LANES];
            let used = ids.iter().take_while(|&&id| id != u32::MAX);
            let len = vertices.iter_mut().zip(used).map(|(v, &id)| *v = positions[id as usize]).count();
            block.move_vertices(&vertices[..len]);
        }
        let vertices = &self.vertices;
        self.tree.refit(|leaf| {
            let used = vertices[leaf].iter().take_while(|&&id| id != u32::MAX);
            used.fold(Aabb::EMPTY, |aabb, &id| aabb.with_point(positions[id as usize]))
        });
    }

    /// Whether the open segment meets any triangle.
    pub fn any_hit(&self, ray: &Ray) -> bool {
        self.any_hit_with(ray, &mut ())
    }

    /// [`Self::any_hit`], counted.
    pub fn any_hit_with(&self, ray: &Ray, stats: &mut impl Statistics) -> bool {
        kernel::run(self.back_end, AnyHit { bvh: self, ray, stats })
    }

    /// The hit with the smallest `t` (rounded as in [`TriangleHit::t`]), ties going to the smallest `prim_index`.
    pub fn closest_hit(&self, ray: &Ray) -> Option<Hit> {
        self.closest_hit_with(ray, &mut ())
    }

    /// [`Self::closest_hit`], counted.
    pub fn closest_hit_with(&self, ray: &Ray, stats: &mut impl Statistics) -> Option<Hit> {
        kernel::run(self.back_end, ClosestHit { bvh: self, ray, stats })
    }

    /// [`Self::closest_hit`] of each ray, each walking alone. With the `rayon` feature, over all threads of the caller's
    /// pool.
    ///
    /// # Panics
    /// If the slices differ in length.
    pub fn closest_hits(&self, rays: &[Ray], hits: &mut [Option<Hit>]) {
        assert_eq!(rays.len(), hits.len(), "as many answers as rays");
        let batch = |(rays, hits)| kernel::run(self.back_end, ClosestHits { bvh: self, rays, hits });
        #[cfg(feature = "rayon")]
        {
            use rayon::prelude::*;
            rays.par_chunks(1 << 11).zip(hits.par_chunks_mut(1 << 11)).for_each(batch);
        }
        #[cfg(not(feature = "rayon"))]
        batch((rays, hits));
    }

    /// Calls `visit` with every triangle hit, exactly once each, in no promised order, until it breaks. Returns what the
    /// last visit returned.
    pub fn for_each_hit(
        &self,
        ray: &Ray,
        visit: impl FnMut(u32, TriangleHit) -> ControlFlow<()>,
    ) -> ControlFlow<()> {
        self.for_each_hit_with(ray, visit, &mut ())
    }

    /// [`Self::for_each_hit`], counted.
    pub fn for_each_hit_with(
        &self,
        ray: &Ray,
        visit: impl FnMut(u32, TriangleHit) -> ControlFlow<()>,
        stats: &mut impl Statistics,
    ) -> ControlFlow<()> {
        kernel::run(self.back_end, ForEachHit { bvh: self, ray, visit, stats })
    }

    /// Sum of `depth_of(prim_index)` over all triangles hit, [`OpticalDepth::OPAQUE`] as soon as nothing gets through.
    ///
    /// `depth_of` must give the same depth for the same triangle; it is not called for all once the sum is opaque.
    pub fn transmittance(&self, ray: &Ray, depth_of: impl Fn(u32) -> OpticalDepth) -> OpticalDepth {
        self.transmittance_with(ray, depth_of, &mut ())
    }

    /// [`Self::transmittance`], counted.
    pub fn transmittance_with(
        &self,
        ray: &Ray,
        depth_of: impl Fn(u32) -> OpticalDepth,
        stats: &mut impl Statistics,
    ) -> OpticalDepth {
        kernel::run(self.back_end, Transmittance { bvh: self, ray, depth_of, stats })
    }

    /// [`Self::any_hit`] of each ray. With the `rayon` feature, over all threads of the caller's pool.
    ///
    /// # Panics
    /// If the slices differ in length.
    pub fn any_hits(&self, rays: &[Ray], hits: &mut [bool]) {
        assert_eq!(rays.len(), hits.len(), "as many answers as rays");
        let batch =
            |(rays, hits)| kernel::run(self.back_end, AnyHits { bvh: self, rays, hits, stats: &mut () });
        #[cfg(feature = "rayon")]
        {
            use rayon::prelude::*;
            rays.par_chunks(1 << 11).zip(hits.par_chunks_mut(1 << 11)).for_each(batch);
        }
        #[cfg(not(feature = "rayon"))]
        batch((rays, hits));
    }

    /// [`Self::any_hits`], counted, on this thread alone.
    ///
    /// # Panics
    /// If the slices differ in length.
    pub fn any_hits_with(&self, rays: &[Ray], hits: &mut [bool], stats: &mut impl Statistics) {
        assert_eq!(rays.len(), hits.len(), "as many answers as rays");
        kernel::run(self.back_end, AnyHits { bvh: self, rays, hits, stats });
    }

    /// [`Self::any_hit`] of a ray that may end at boxes inside of solids: what `solids` says of them is believed.
    pub fn any_hit_among_with(
        &self,
        ray: &Ray,
        solids: &mut impl SolidBoxes,
        stats: &mut impl Statistics,
    ) -> bool {
        kernel::run(self.back_end, AnyHitAmong { bvh: self, ray, solids, stats })
    }

    /// [`Self::any_hit_among_with`] of each ray, on this thread alone; those of one origin that follow each other walk together.
    ///
    /// # Panics
    /// If the slices differ in length.
    pub fn any_hits_among_with(
        &self,
        rays: &[Ray],
        hits: &mut [bool],
        solids: &mut impl SolidBoxes,
        stats: &mut impl Statistics,
    ) {
        assert_eq!(rays.len(), hits.len(), "as many answers as rays");
        kernel::run(self.back_end, AnyHitsAmong { bvh: self, rays, hits, solids, stats });
    }

    /// [`Self::transmittance`] of each ray. With the `rayon` feature, over all threads of the caller's pool.
    ///
    /// # Panics
    /// If the slices differ in length.
    pub fn transmittances(
        &self,
        rays: &[Ray],
        depth_of: impl Fn(u32) -> OpticalDepth + Sync,
        sums: &mut [OpticalDepth],
    ) {
        assert_eq!(rays.len(), sums.len(), "as many answers as rays");
        let depth_of = &depth_of;
        let batch = |(rays, sums)| {
            kernel::run(self.back_end, Transmittances { bvh: self, rays, depth_of, sums, stats: &mut () });
        };
        #[cfg(feature = "rayon")]
        {
            use rayon::prelude::*;
            rays.par_chunks(1 << 11).zip(sums.par_chunks_mut(1 << 11)).for_each(batch);
        }
        #[cfg(not(feature = "rayon"))]
        batch((rays, sums));
    }

    /// [`Self::transmittances`], counted, on this thread alone.
    ///
    /// # Panics
    /// If the slices differ in length.
    pub fn transmittances_with(
        &self,
        rays: &[Ray],
        depth_of: impl Fn(u32) -> OpticalDepth,
        sums: &mut [OpticalDepth],
        stats: &mut impl Statistics,
    ) {
        assert_eq!(rays.len(), sums.len(), "as many answers as rays");
        kernel::run(self.back_end, Transmittances { bvh: self, rays, depth_of: &depth_of, sums, stats });
    }

    /// Walks `rays` for a goal of the caller's: those of one origin that follow each other together, [`FAN`](crate::FAN) at
    /// most, others alone, [`WALKS`](crate::WALKS) fans in turn; on this thread.
    pub fn walk_fans_with(&self, rays: &[Ray], goal: &mut impl FanGoal, stats: &mut impl Statistics) {
        kernel::run(self.back_end, WalkFans { bvh: self, rays, goal, stats });
    }

    /// Smallest box around all triangles.
    pub fn bounds(&self) -> Aabb {
        self.tree.bounds
    }

    /// Bytes that the hierarchy holds, its copies of vertices and indices included.
    pub fn bytes(&self) -> usize {
        self.tree.bytes()
            + size_of_val(&self.blocks[..])
            + size_of_val(&self.prims[..])
            + size_of_val(&self.vertices[..])
    }

    /// Number of triangles.
    pub fn prim_count(&self) -> usize {
        self.prims.len()
    }

    /// What queries run on.
    pub fn back_end(&self) -> BackEnd {
        self.back_end
    }

    /// The same hierarchy on another back end. Answers are the same.
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
}

struct AnyHit<'a, S> {
    bvh: &'a Bvh,
    ray: &'a Ray,
    stats: &'a mut S,
}

impl<S: Statistics> Job for AnyHit<'_, S> {
    type Output = bool;

    #[inline(always)]
    fn run<K: Kernel>(self, kernel: K) -> bool {
        traversal::any_hit(kernel, self.bvh, self.ray, self.stats)
    }
}

struct AnyHits<'a, S> {
    bvh: &'a Bvh,
    rays: &'a [Ray],
    hits: &'a mut [bool],
    stats: &'a mut S,
}

impl<S: Statistics> Job for AnyHits<'_, S> {
    type Output = ();

    #[inline(always)]
    fn run<K: Kernel>(self, kernel: K) {
        let Self { bvh, rays, hits, stats } = self;
        hits.fill(false);
        let mut packets = packet::Scratch::new();
        let packet = |goal: &mut fan::AnyHit<'_, ()>, range: Range<usize>, stats: &mut S| {
            packet::any_hits(kernel, bvh, &rays[range.clone()], &mut goal.hits[range], &mut packets, stats);
        };
        fan::answer(
            kernel,
            bvh,
            rays,
            FEWEST_FAN_RAYS,
            &mut fan::AnyHit { rays, hits, solids: () },
            packet,
            stats,
        );
    }
}

struct AnyHitAmong<'a, B, S> {
    bvh: &'a Bvh,
    ray: &'a Ray,
    solids: &'a mut B,
    stats: &'a mut S,
}

impl<B: SolidBoxes, S: Statistics> Job for AnyHitAmong<'_, B, S> {
    type Output = bool;

    #[inline(always)]
    fn run<K: Kernel>(self, kernel: K) -> bool {
        traversal::any_hit_among(kernel, self.bvh, self.ray, 0, self.solids, self.stats)
    }
}

struct AnyHitsAmong<'a, B, S> {
    bvh: &'a Bvh,
    rays: &'a [Ray],
    hits: &'a mut [bool],
    solids: &'a mut B,
    stats: &'a mut S,
}

impl<B: SolidBoxes, S: Statistics> Job for AnyHitsAmong<'_, B, S> {
    type Output = ();

    #[inline(always)]
    fn run<K: Kernel>(self, kernel: K) {
        let Self { bvh, rays, hits, solids, stats } = self;
        hits.fill(false);
        let alone = |goal: &mut fan::AnyHit<'_, &mut B>, range: Range<usize>, stats: &mut S| {
            for place in range {
                let ray = &rays[place];
                goal.hits[place] = traversal::any_hit_among(kernel, bvh, ray, place, &mut goal.solids, stats);
            }
        };
        fan::answer(
            kernel,
            bvh,
            rays,
            FEWEST_FAN_RAYS,
            &mut fan::AnyHit { rays, hits, solids },
            alone,
            stats,
        );
    }
}

struct ClosestHit<'a, S> {
    bvh: &'a Bvh,
    ray: &'a Ray,
    stats: &'a mut S,
}

impl<S: Statistics> Job for ClosestHit<'_, S> {
    type Output = Option<Hit>;

    #[inline(always)]
    fn run<K: Kernel>(self, kernel: K) -> Option<Hit> {
        traversal::closest_hit(kernel, self.bvh, self.ray, None, self.stats)
    }
}

struct ClosestHits<'a> {
    bvh: &'a Bvh,
    rays: &'a [Ray],
    hits: &'a mut [Option<Hit>],
}

impl Job for ClosestHits<'_> {
    type Output = ();

    #[inline(always)]
    fn run<K: Kernel>(self, kernel: K) {
        for (ray, hit) in self.rays.iter().zip(self.hits) {
            *hit = traversal::closest_hit(kernel, self.bvh, ray, None, &mut ());
        }
    }
}

struct ForEachHit<'a, F, S> {
    bvh: &'a Bvh,
    ray: &'a Ray,
    visit: F,
    stats: &'a mut S,
}

impl<F: FnMut(u32, TriangleHit) -> ControlFlow<()>, S: Statistics> Job for ForEachHit<'_, F, S> {
    type Output = ControlFlow<()>;

    #[inline(always)]
    fn run<K: Kernel>(mut self, kernel: K) -> ControlFlow<()> {
        traversal::for_each_hit(kernel, self.bvh, self.ray, &mut self.visit, self.stats)
    }
}

struct Transmittance<'a, F, S> {
    bvh: &'a Bvh,
    ray: &'a Ray,
    depth_of: F,
    stats: &'a mut S,
}

impl<F: Fn(u32) -> OpticalDepth, S: Statistics> Job for Transmittance<'_, F, S> {
    type Output = OpticalDepth;

    #[inline(always)]
    fn run<K: Kernel>(self, kernel: K) -> OpticalDepth {
        traversal::transmittance(kernel, self.bvh, self.ray, &self.depth_of, self.stats)
    }
}

struct Transmittances<'a, F, S> {
    bvh: &'a Bvh,
    rays: &'a [Ray],
    depth_of: &'a F,
    sums: &'a mut [OpticalDepth],
    stats: &'a mut S,
}

impl<F: Fn(u32) -> OpticalDepth, S: Statistics> Job for Transmittances<'_, F, S> {
    type Output = ();

    #[inline(always)]
    fn run<K: Kernel>(self, kernel: K) {
        let Self { bvh, rays, depth_of, sums, stats } = self;
        sums.fill(OpticalDepth::CLEAR);
        let alone = |goal: &mut fan::Transmittance<'_, F>, range: Range<usize>, stats: &mut S| {
            for index in range {
                goal.sums[index] = traversal::transmittance(kernel, bvh, &rays[index], depth_of, stats);
            }
        };
        let mut goal = fan::Transmittance { bvh, rays, sums, depth_of };
        fan::answer(kernel, bvh, rays, FEWEST_FAN_RAYS, &mut goal, alone, stats);
    }
}

struct WalkFans<'a, G, S> {
    bvh: &'a Bvh,
    rays: &'a [Ray],
    goal: &'a mut G,
    stats: &'a mut S,
}

impl<G: FanGoal, S: Statistics> Job for WalkFans<'_, G, S> {
    type Output = ();

    #[inline(always)]
    fn run<K: Kernel>(self, kernel: K) {
        let Self { bvh, rays, goal, stats } = self;
        // Single rays are fans too.
        let none = |_: &mut G, _: Range<usize>, _: &mut S| {};
        fan::answer(kernel, bvh, rays, 1, goal, none, stats);
    }
}
