//! Solid boxes in a wide bounding volume hierarchy.
//!
//! Djeu11, section 3.9 says that volumetric occluders don't apply to bounding volume hierarchies, which have no empty
//! nodes. But the slab test of a wide node covers eight boxes whether they are children or not: boxes from inside of solids in
//! some of the slots cost no test of their own, and those near the root are met before any triangle.
//!
//! Here: the structure and its queries. Not here: where boxes come from (`voxels.rs`, `carve.rs`), their places (`build.rs`).

mod build;
mod fan;
mod kernel;
mod node;
mod walk;

use super::{Ends, Object, SolidOptions, Solids, carve::carve, ends, voxels::Voxels};
use kernel::{Job, Kernel};
use node::{Node, WIDTH};
use std::sync::Arc;
use umbrage_accel::Bvh;
use umbrage_geom::{Aabb, Ray, SlabRay};

/// Slots of the root for what each light met last.
const RESERVED: usize = 3;

/// Most boxes of a generator.
const MOST_BOXES: usize = 48;

/// Options of [`SolidBvh::build`].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[non_exhaustive]
pub struct SolidBvhOptions {
    /// Which objects may generate occluders.
    pub solids: SolidOptions,
}

impl SolidBvhOptions {
    /// With other rules for generators.
    #[must_use]
    pub fn with_solids(self, solids: SolidOptions) -> Self {
        Self { solids, ..self }
    }
}

/// One generator's part.
#[derive(Clone, Debug)]
struct Interior {
    bounds: Aabb,
    voxels: Voxels,
    /// Boxes around the caps over its holes.
    guards: Vec<Aabb>,
    /// Share of the lines through its bounds that its boxes stop.
    coverage: f32,
}

/// A wide hierarchy whose any-hit meets boxes inside of solids early; exact.
#[derive(Clone, Debug)]
pub struct SolidBvh {
    bvh: Arc<Bvh>,
    nodes: Vec<Node>,
    interiors: Vec<Interior>,
    solids: Vec<Aabb>,
    /// Interior that each box belongs to.
    owners: Vec<u32>,
    simd: bool,
}

/// What a thread keeps from ray to ray: for each light the root with the boxes that ended rays last, and room for fans.
///
/// It belongs to one [`SolidBvh`]: with another, remembered boxes would be wrong.
#[derive(Clone, Debug)]
pub struct SolidScratch {
    lights: Vec<LightRoot>,
    fan: Box<fan::Fan>,
}

#[derive(Clone, Debug)]
struct LightRoot {
    node: Node,
    next: usize,
}

impl LightRoot {
    /// Remembers a box in the place of the oldest.
    #[inline]
    fn remember(&mut self, aabb: &Aabb, solid: u32) {
        let place = WIDTH - 1 - self.next;
        self.node.set_solid(place, aabb, solid);
        self.next = (self.next + 1) % RESERVED;
    }
}

/// Work of a walk.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SolidCounters {
    /// Nodes visited.
    pub nodes: u64,
    /// Leaves visited.
    pub leaves: u64,
    /// Rays that ended at a solid box.
    pub solid_hits: u64,
    /// Of these at the root, where a light remembered the box.
    pub remembered_hits: u64,
}

/// Watches walks; `()` does nothing.
trait Watch {
    fn node(&mut self) {}
    fn leaf(&mut self) {}
    fn solid(&mut self, _at_root: bool) {}
}

impl Watch for () {}

impl Watch for SolidCounters {
    fn node(&mut self) {
        self.nodes += 1;
    }

    fn leaf(&mut self) {
        self.leaves += 1;
    }

    fn solid(&mut self, at_root: bool) {
        self.solid_hits += 1;
        self.remembered_hits += u64::from(at_root);
    }
}

impl SolidBvh {
    /// Finds generators among `objects` (the whole mesh if there are none) and puts boxes from inside of them into a copy of
    /// the nodes of `bvh`, which must be that of the mesh. Leaves are shared.
    ///
    /// # Panics
    /// If a triangle names a vertex that does not exist, or an object triangles that don't.
    pub fn build(
        bvh: Arc<Bvh>,
        positions: &[[f32; 3]],
        triangles: &[[u32; 3]],
        objects: &[Object],
        options: &SolidBvhOptions,
    ) -> Self {
        let found = Solids::find(positions, triangles, objects, &options.solids);
        let (mut interiors, mut solids, mut owners) = (Vec::new(), Vec::new(), Vec::new());
        for (index, generator) in found.generators().iter().enumerate() {
            let surface = found.surface(index, positions, triangles);
            // Boxes much larger than triangles are what counts, and about that many fit along a side.
            let resolution = (f64::from(generator.triangles).sqrt() / 4.0).clamp(24.0, 96.0) as usize;
            let winding = |point| surface.winding_number(point);
            let Some(voxels) =
                Voxels::build(&generator.bounds, resolution, &mut surface.triangles(), &winding)
            else {
                continue;
            };
            let carved = carve(&voxels, &generator.bounds, MOST_BOXES, 0.002);
            if carved.boxes.is_empty() {
                continue;
            }
            owners.extend(std::iter::repeat_n(interiors.len() as u32, carved.boxes.len()));
            solids.extend(carved.boxes);
            let guards = surface.guards().to_vec();
            interiors.push(Interior { bounds: generator.bounds, voxels, guards, coverage: carved.coverage });
        }
        let nodes = build::build(&bvh, &solids, if solids.is_empty() { 0 } else { RESERVED });
        Self { bvh, nodes, interiors, solids, owners, simd: true }
    }

    /// Whether the open segment meets any triangle.
    ///
    /// `light` names the light that the ray goes to, if any: rays to one light are likely to end at the same boxes.
    pub fn any_hit(&self, ray: &Ray, ends: Ends, light: Option<usize>, scratch: &mut SolidScratch) -> bool {
        let root =
            light.filter(|_| !self.solids.is_empty()).map(|light| self.root(&mut scratch.lights, light));
        kernel::run(self.simd, AnyHit { this: self, ray, ends, root, watch: &mut () })
    }

    /// What a thread needs to trace rays.
    pub fn scratch(&self) -> SolidScratch {
        SolidScratch { lights: Vec::new(), fan: Box::new(fan::Fan::new()) }
    }

    /// [`Self::any_hit`], counted.
    pub fn any_hit_counted(
        &self,
        ray: &Ray,
        ends: Ends,
        light: Option<usize>,
        scratch: &mut SolidScratch,
        counters: &mut SolidCounters,
    ) -> bool {
        let root =
            light.filter(|_| !self.solids.is_empty()).map(|light| self.root(&mut scratch.lights, light));
        kernel::run(self.simd, AnyHit { this: self, ray, ends, root, watch: counters })
    }

    /// [`Self::any_hit`] of rays to one light. Runs of rays that share an origin walk together, which is faster.
    ///
    /// # Panics
    /// If the slices differ in length.
    pub fn any_hits(
        &self,
        rays: &[Ray],
        hits: &mut [bool],
        ends: Ends,
        light: Option<usize>,
        scratch: &mut SolidScratch,
    ) {
        assert_eq!(rays.len(), hits.len(), "as many answers as rays");
        let SolidScratch { lights, fan } = scratch;
        let root = light.filter(|_| !self.solids.is_empty()).map(|light| self.root(lights, light));
        kernel::run(self.simd, AnyHits { this: self, rays, hits, ends, root, fan });
    }

    /// The root as `light` sees it.
    fn root<'a>(&self, lights: &'a mut Vec<LightRoot>, light: usize) -> &'a mut LightRoot {
        if lights.len() <= light {
            lights.resize(light + 1, LightRoot { node: self.nodes[0], next: 0 });
        }
        &mut lights[light]
    }

    /// Whether all points of `region`, such as a light, are surely outside of every generator, so that segments to it have
    /// [`Ends::Outside`].
    pub fn is_outside(&self, region: &Aabb) -> bool {
        self.interiors.iter().all(|interior| interior.region_is_outside(region))
    }

    /// Whether `solid`, which the segment crosses, blocks it: the endpoint rule, and the guards.
    #[inline]
    fn vouches(&self, solid: u32, ray: &Ray, slab: &SlabRay, ends: Ends) -> bool {
        let interior = &self.interiors[self.owners[solid as usize] as usize];
        interior.guards.iter().all(|guard| slab.entry(guard, slab.tfar).is_none())
            && (ends == Ends::Outside || interior.has_end_outside(ray))
    }

    /// Number of generators that have occluders.
    pub fn generator_count(&self) -> usize {
        self.interiors.len()
    }

    /// The boxes inside of solids.
    pub fn occluders(&self) -> &[Aabb] {
        &self.solids
    }

    /// Share of random lines through the bounds of generator `index` that its boxes stop, before any triangle is asked.
    ///
    /// # Panics
    /// If there is no such generator.
    pub fn coverage(&self, index: usize) -> f32 {
        self.interiors[index].coverage
    }

    /// The hierarchy that leaves are shared with.
    pub fn bvh(&self) -> &Arc<Bvh> {
        &self.bvh
    }

    /// Bytes beside those of [`Self::bvh`].
    pub fn bytes(&self) -> usize {
        let voxels: usize = self.interiors.iter().map(|interior| interior.voxels.bytes()).sum();
        size_of_val(&self.nodes[..]) + size_of_val(&self.solids[..]) + size_of_val(&self.owners[..]) + voxels
    }

    /// The same on portable code, or on the best instructions of the processor. Answers are the same.
    #[must_use]
    pub fn with_simd(self, simd: bool) -> Self {
        Self { simd, ..self }
    }
}

impl Interior {
    fn region_is_outside(&self, region: &Aabb) -> bool {
        let apart = region.max.cmplt(self.bounds.min).any() || region.min.cmpgt(self.bounds.max).any();
        apart || self.voxels.region_is_outside(region)
    }

    fn has_end_outside(&self, ray: &Ray) -> bool {
        ends::either(ray, |point, margin| {
            let (min, max) = (self.bounds.min.as_dvec3(), self.bounds.max.as_dvec3());
            (point + margin).cmplt(min).any()
                || (point - margin).cmpgt(max).any()
                || self.voxels.is_outside(point, margin)
        })
    }
}

struct AnyHit<'a, W> {
    this: &'a SolidBvh,
    ray: &'a Ray,
    ends: Ends,
    root: Option<&'a mut LightRoot>,
    watch: &'a mut W,
}

impl<W: Watch> Job for AnyHit<'_, W> {
    type Output = bool;

    #[inline(always)]
    fn run<K: Kernel>(mut self, kernel: K) -> bool {
        let Some(prepared) = walk::Prepared::new(self.ray) else { return false };
        walk::any_hit(kernel, self.this, &prepared, self.ends, 0, self.root.as_deref_mut(), self.watch)
    }
}

struct AnyHits<'a> {
    this: &'a SolidBvh,
    rays: &'a [Ray],
    hits: &'a mut [bool],
    ends: Ends,
    root: Option<&'a mut LightRoot>,
    fan: &'a mut fan::Fan,
}

impl Job for AnyHits<'_> {
    type Output = ();

    #[inline(always)]
    fn run<K: Kernel>(mut self, kernel: K) {
        let mut start = 0;
        while start < self.rays.len() {
            let origin = self.rays[start].origin;
            let run =
                self.rays[start..].iter().take(fan::RAYS).take_while(|ray| ray.origin == origin).count();
            let range = start..start + run;
            let (rays, hits) = (&self.rays[range.clone()], &mut self.hits[range]);
            self.fan.any_hits(kernel, self.this, rays, hits, self.ends, self.root.as_deref_mut());
            start += run;
        }
    }
}
