//! Shadow rays through a kd-tree whose opaque cells end them.

use super::{
    Ends, ObjectMesh, SolidOptions, Solids,
    boxes::BoxPack,
    cache::OccluderCache,
    classify::{Classifier, classify},
    ends::{is_outside, region_is_outside},
    grown,
    object_mesh::unique_id,
};
use crate::OcclusionError;
use umbrage_accel::{
    BackEnd, BuildError, KdTree, Statistics,
    kdtree::{Blocker, Cells, KdOptions, KdScratch, Order, Start},
};
use umbrage_geom::{Aabb, Ray, SlabRay};

/// Boxes around generators that rays are tested against first.
const GROUPS: usize = 8;

/// Options of [`KdVolumetric::build`].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[non_exhaustive]
pub struct KdVolumetricOptions {
    /// How the tree is built.
    pub tree: KdOptions,
    /// Which objects may generate occluders.
    pub solids: SolidOptions,
    /// How cells are classified.
    pub classifier: Classifier,
}

impl KdVolumetricOptions {
    /// With other options of the tree.
    #[must_use]
    pub fn with_tree(self, tree: KdOptions) -> Self {
        Self { tree, ..self }
    }

    /// With other rules for generators.
    #[must_use]
    pub fn with_solids(self, solids: SolidOptions) -> Self {
        Self { solids, ..self }
    }

    /// With another way to classify.
    #[must_use]
    pub fn with_classifier(self, classifier: Classifier) -> Self {
        Self { classifier, ..self }
    }
}

/// A kd-tree with volumetric occluders; exact.
#[derive(Clone, Debug)]
pub struct KdVolumetric {
    tree: KdTree,
    solids: Solids,
    /// Cells of opaque leaves, by slot: the node-to-bounds table of Djeu11, section 3.5, for these alone. Then larger boxes.
    boxes: Vec<Aabb>,
    /// By slot of a leaf: what a guided query remembers for it, itself or a larger box around it.
    remembered: Vec<u32>,
    /// Boxes around generators, at most [`GROUPS`].
    groups: Vec<Aabb>,
    group_pack: BoxPack<GROUPS>,
    /// See [`unique_id`].
    id: u64,
}

/// What a thread needs to trace rays: lists of nodes and a cache for each light. With another [`KdVolumetric`] than before, caches
/// start anew.
#[derive(Clone, Debug, Default)]
pub struct KdVolumetricScratch {
    single: KdScratch<1>,
    packet: KdScratch<4>,
    caches: Vec<OccluderCache>,
    /// [`KdVolumetric::id`] of the caches; 0 before the first ray.
    id: u64,
}

impl KdVolumetricScratch {
    /// Forgets what belongs to another tree.
    #[inline]
    fn belong_to(&mut self, id: u64) {
        if self.id != id {
            self.caches.clear();
            self.id = id;
        }
    }

    /// The cache of `light`, made when first asked for.
    fn cache(caches: &mut Vec<OccluderCache>, light: usize) -> &mut OccluderCache {
        if caches.len() <= light {
            caches.resize_with(light + 1, OccluderCache::default);
        }
        &mut caches[light]
    }
}

/// How rays are traced; answers don't depend on it, but [`Ends::Outside`] must be true.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct KdQuery {
    /// The traversal order.
    pub order: Order,
    /// What is known of the ends.
    pub ends: Ends,
    /// The light whose cache is used, if any.
    pub light: Option<usize>,
    /// Whether occluders end rays at all.
    pub occluders: bool,
    /// Whether the light's last ray decides how the next one walks ([`Self::with_guide`]).
    pub guided: bool,
}

impl Default for KdQuery {
    /// [`Order::QUICK`] without a cache.
    fn default() -> Self {
        Self { order: Order::QUICK, ends: Ends::Unknown, light: None, occluders: true, guided: false }
    }
}

impl KdQuery {
    /// With another order.
    #[must_use]
    pub fn with_order(self, order: Order) -> Self {
        Self { order, ..self }
    }

    /// With other knowledge of the ends.
    #[must_use]
    pub fn with_ends(self, ends: Ends) -> Self {
        Self { ends, ..self }
    }

    /// With or without a guide, not from the dissertation: rays to a light whose last ray wasn't blocked walk in ray order
    /// without occluders; others look into the cache first, which has boxes grown over many cells, and walk in [`Self::order`].
    /// Of generators, guards and ends nothing is asked before a cell could end the ray. So most rays that nothing blocks cost
    /// what they cost in ray order. Without a light it is as if none had been blocked.
    #[must_use]
    pub fn with_guide(self, guided: bool) -> Self {
        Self { guided, ..self }
    }

    /// With occluders or without.
    #[must_use]
    pub fn with_occluders(self, occluders: bool) -> Self {
        Self { occluders, ..self }
    }

    /// With the cache of a light.
    #[must_use]
    pub fn with_light(self, light: Option<usize>) -> Self {
        Self { light, ..self }
    }
}

impl KdVolumetric {
    /// Builds the tree over all triangles, finds the generators among the objects and classifies the empty cells. `progress` is
    /// called with numbers that grow to 1 and cancels by returning `false`.
    ///
    /// # Errors
    /// Those of [`Solids::find`] and [`KdTree::build_guarded`]; [`OcclusionError::Cancelled`].
    pub fn build(
        mesh: &ObjectMesh<'_>,
        options: &KdVolumetricOptions,
        progress: &mut (dyn FnMut(f32) -> bool + Send),
    ) -> Result<Self, OcclusionError> {
        let solids = Solids::find(mesh, &options.solids)?;
        let (positions, triangles) = (mesh.positions, mesh.triangles);
        let tree = KdTree::build_guarded(positions, triangles, solids.caps(), &options.tree, progress)?;
        Self::from_parts(tree, solids, options.classifier)
    }

    /// Adds occluders to a tree over the mesh that `solids` was found in, with its caps as guards
    /// ([`KdTree::build_guarded`]).
    ///
    /// # Errors
    /// [`OcclusionError::Triangles`] if the tree has not as many triangles as the mesh.
    pub fn from_parts(
        mut tree: KdTree,
        solids: Solids,
        classifier: Classifier,
    ) -> Result<Self, OcclusionError> {
        let (count, triangles) = (tree.prim_count(), solids.triangle_count());
        if count != triangles {
            return Err(OcclusionError::Triangles { count, triangles });
        }
        let boxes =
            if solids.all().is_empty() { Vec::new() } else { classify(&mut tree, &solids, classifier) };
        let (boxes, remembered) = grown::grow(&tree, boxes);
        let groups = grouped(solids.all().iter().map(|g| g.bounds).collect());
        let mut group_pack = BoxPack::EMPTY;
        groups.iter().enumerate().for_each(|(i, group)| group_pack.set(i, group));
        Ok(Self { tree, solids, boxes, remembered, groups, group_pack, id: unique_id() })
    }

    /// Whether the open segment meets any triangle.
    pub fn any_hit(&self, ray: &Ray, query: &KdQuery, scratch: &mut KdVolumetricScratch) -> bool {
        self.any_hit_with(ray, query, scratch, &mut ())
    }

    /// [`Self::any_hit`], counted.
    pub fn any_hit_with(
        &self,
        ray: &Ray,
        query: &KdQuery,
        scratch: &mut KdVolumetricScratch,
        stats: &mut impl Statistics,
    ) -> bool {
        scratch.belong_to(self.id);
        let KdVolumetricScratch { single, caches, .. } = scratch;
        let [hit] = self.walk([ray], query, single, caches, stats);
        hit
    }

    /// [`Self::any_hit`] of each ray, in packets of four (Djeu11, section 3.7.1).
    ///
    /// # Panics
    /// If the slices differ in length.
    pub fn any_hits(
        &self,
        rays: &[Ray],
        hits: &mut [bool],
        query: &KdQuery,
        scratch: &mut KdVolumetricScratch,
    ) {
        self.any_hits_with(rays, hits, query, scratch, &mut ());
    }

    /// [`Self::any_hits`], counted.
    ///
    /// # Panics
    /// If the slices differ in length.
    pub fn any_hits_with(
        &self,
        rays: &[Ray],
        hits: &mut [bool],
        query: &KdQuery,
        scratch: &mut KdVolumetricScratch,
        stats: &mut impl Statistics,
    ) {
        assert_eq!(rays.len(), hits.len(), "as many answers as rays");
        scratch.belong_to(self.id);
        let KdVolumetricScratch { packet, caches, .. } = scratch;
        for (rays, hits) in rays.chunks(4).zip(hits.chunks_mut(4)) {
            // A short packet is filled up with a ray that is not valid, which costs nothing.
            let none = Ray { tfar: f32::NAN, ..rays[0] };
            let four = [0, 1, 2, 3].map(|i| rays.get(i).unwrap_or(&none));
            let found = self.walk(four, query, packet, caches, stats);
            hits.copy_from_slice(&found[..hits.len()]);
        }
    }

    #[inline(always)]
    fn walk<const N: usize>(
        &self,
        rays: [&Ray; N],
        query: &KdQuery,
        scratch: &mut KdScratch<N>,
        caches: &mut Vec<OccluderCache>,
        stats: &mut impl Statistics,
    ) -> [bool; N] {
        let found = if query.occluders && !self.boxes.is_empty() {
            let cache = query.light.map(|light| KdVolumetricScratch::cache(caches, light));
            if query.guided {
                self.walk_guided(rays, query, scratch, cache, stats)
            } else {
                let mut cells = Occluders { this: self, ends: query.ends, cache, events: Events::default() };
                let found = self.tree.blockers_with(rays, query.order, &mut cells, scratch, stats);
                cells.events.report(stats);
                found
            }
        } else {
            self.tree.blockers_with(rays, Order::RAY, &mut (), scratch, stats)
        };
        for (&ray, &blocker) in rays.iter().zip(&found) {
            match blocker {
                Blocker::Cell(slot) => stats.ended_in_cell(self.boxes[slot as usize].area()),
                _ if ray.is_valid() => stats.ended(blocker.any()),
                _ => {}
            }
        }
        found.map(Blocker::any)
    }

    #[inline(always)]
    fn walk_guided<const N: usize>(
        &self,
        rays: [&Ray; N],
        query: &KdQuery,
        scratch: &mut KdScratch<N>,
        mut cache: Option<&mut OccluderCache>,
        stats: &mut impl Statistics,
    ) -> [Blocker; N] {
        let found = if cache.as_ref().is_some_and(|cache| cache.blocked) {
            let (cache, events) = (cache.as_deref_mut(), Events::default());
            let mut cells = Guided { this: self, rays: &rays, ends: query.ends, cache, events };
            let found = self.tree.blockers_with(rays, query.order, &mut cells, scratch, stats);
            cells.events.report(stats);
            found
        } else {
            // In ray order the surface comes before what it is around: cells would end no ray.
            self.tree.blockers_with(rays, Order::RAY, &mut (), scratch, stats)
        };
        if let Some(cache) = cache {
            cache.blocked = found.iter().any(|blocker| blocker.any());
        }
        found
    }

    /// Whether cells may end the ray: the guards and the endpoint rule.
    #[inline]
    fn counts(&self, ray: &Ray, slab: &SlabRay, ends: Ends) -> bool {
        self.solids.guards().iter().all(|guard| slab.entry(guard, slab.tfar).is_none())
            && (ends == Ends::Outside || is_outside(&self.tree, ray))
    }

    /// Whether all points of `region`, such as a light, are surely outside of every generator, so that segments to it have
    /// [`Ends::Outside`].
    pub fn is_outside(&self, region: &Aabb) -> bool {
        !self.solids.may_enclose(region) || region_is_outside(&self.tree, region)
    }

    /// The tree.
    pub fn tree(&self) -> &KdTree {
        &self.tree
    }

    /// The generators.
    pub fn solids(&self) -> &Solids {
        &self.solids
    }

    /// The occluders: opaque cells, by slot.
    pub fn occluders(&self) -> &[Aabb] {
        &self.boxes[..self.remembered.len()]
    }

    /// Boxes of several opaque cells each, which guided queries remember.
    pub fn grown(&self) -> &[Aabb] {
        &self.boxes[self.remembered.len()..]
    }

    /// Opaque leaves among all leaves (Djeu11, section 4.8.2).
    pub fn occurrence_rate(&self) -> f64 {
        // Every inner node has two children.
        self.occluders().len() as f64 / self.tree.node_count().div_ceil(2) as f64
    }

    /// Bytes that the tree and its occluders hold.
    pub fn bytes(&self) -> usize {
        self.tree.bytes() + size_of_val(&self.boxes[..]) + size_of_val(&self.remembered[..])
    }

    /// The same on another back end. Answers are the same.
    ///
    /// # Errors
    /// [`BuildError::BackEnd`] if this processor lacks it.
    pub fn with_back_end(self, back_end: BackEnd) -> Result<Self, BuildError> {
        Ok(Self { tree: self.tree.with_back_end(back_end)?, ..self })
    }
}

/// Joins boxes, those first that grow least, until there are few.
fn grouped(mut boxes: Vec<Aabb>) -> Vec<Aabb> {
    // Quadratic in what is left: long lists are first joined in order.
    if boxes.len() > 256 {
        let run = boxes.len().div_ceil(256);
        boxes = boxes.chunks(run).map(|chunk| chunk.iter().copied().fold(Aabb::EMPTY, Aabb::union)).collect();
    }
    while boxes.len() > GROUPS {
        let mut best = (f32::INFINITY, 0, 1);
        for i in 0..boxes.len() {
            for j in 0..i {
                let growth = boxes[i].union(boxes[j]).area() - boxes[i].area().max(boxes[j].area());
                if growth < best.0 {
                    best = (growth, j, i);
                }
            }
        }
        let other = boxes.swap_remove(best.2);
        boxes[best.1] = boxes[best.1].union(other);
    }
    boxes
}

/// What happened before and beside the walk, counted only where statistics want it.
#[derive(Default)]
struct Events {
    boxes: u32,
    lookups: u32,
    found: u32,
}

impl Events {
    #[inline(always)]
    fn report(&self, stats: &mut impl Statistics) {
        stats.boxes(self.boxes);
        (0..self.lookups).for_each(|i| stats.looked_up(i < self.found));
    }
}

/// The occluders as one walk sees them.
struct Occluders<'a> {
    this: &'a KdVolumetric,
    ends: Ends,
    cache: Option<&'a mut OccluderCache>,
    events: Events,
}

impl Cells for Occluders<'_> {
    #[inline(always)]
    fn start(&mut self, _: usize, ray: &Ray, slab: &SlabRay) -> Start {
        let this = self.this;
        // Dynamic use, [Djeu11], section 4.3, with a box a generator.
        self.events.boxes += this.groups.len() as u32;
        if this.group_pack.touched(slab) == 0 {
            return Start::Plain;
        }
        for guard in this.solids.guards() {
            self.events.boxes += 1;
            if slab.entry(guard, slab.tfar).is_some() {
                return Start::Plain;
            }
        }
        if self.ends == Ends::Unknown && !is_outside(&this.tree, ray) {
            return Start::Plain;
        }
        if let Some(cache) = &mut self.cache {
            self.events.boxes += 4;
            self.events.lookups += 1;
            if let Some(slot) = cache.find(slab) {
                self.events.found += 1;
                return Start::Blocked(slot);
            }
        }
        Start::Cells
    }

    #[inline(always)]
    fn blocks(&mut self, slot: u32, _: usize, slab: &SlabRay) -> bool {
        let aabb = &self.this.boxes[slot as usize];
        let crossed = slab.surely_crosses(aabb);
        if crossed && let Some(cache) = &mut self.cache {
            cache.insert(slot, aabb);
        }
        crossed
    }
}

/// The occluders as rays see them that are likely to be blocked, since the light's last ray was.
struct Guided<'a> {
    this: &'a KdVolumetric,
    rays: &'a [&'a Ray],
    ends: Ends,
    cache: Option<&'a mut OccluderCache>,
    events: Events,
}

impl Cells for Guided<'_> {
    #[inline(always)]
    fn start(&mut self, _: usize, ray: &Ray, slab: &SlabRay) -> Start {
        if let Some(cache) = &mut self.cache {
            self.events.boxes += 4;
            self.events.lookups += 1;
            if let Some(slot) = cache.find(slab)
                && self.this.counts(ray, slab, self.ends)
            {
                self.events.found += 1;
                return Start::Blocked(slot);
            }
        }
        Start::Cells
    }

    #[inline(always)]
    fn blocks(&mut self, slot: u32, lane: usize, slab: &SlabRay) -> bool {
        let crossed = slab.surely_crosses(&self.this.boxes[slot as usize])
            && self.this.counts(self.rays[lane], slab, self.ends);
        if crossed && let Some(cache) = &mut self.cache {
            let slot = self.this.remembered[slot as usize];
            cache.insert(slot, &self.this.boxes[slot as usize]);
        }
        crossed
    }
}
