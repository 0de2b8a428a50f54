//! Solid boxes in a wide bounding volume hierarchy.
//!
//! Djeu11, section 3.9 says that volumetric occluders don't apply to bounding volume hierarchies, which have no empty
//! nodes. But a node can have boxes from inside of solids beside its children: eight cost one more step of SIMD, and those near
//! the root are met before any triangle.
//!
//! Here: the structure and its queries. Not here: where boxes come from (`voxels.rs`, `carve.rs`), their places (`places.rs`),
//! when they are made (`lazy.rs`), those of instances (`instances.rs`), walking (`umbrage-accel`).

mod forecast;
mod instances;
mod lazy;
mod places;

pub use forecast::{Forecast, ShadowRays};
pub use instances::{SolidInstances, SolidInstancesScratch};
pub use lazy::{LazyScratch, LazySolidBvh, Prepared};

use super::{
    Ends, ObjectMesh, SolidOptions, Solids, carve::carve, ends, object_mesh::unique_id, voxels::Voxels,
};
use crate::OcclusionError;
use std::sync::Arc;
use umbrage_accel::{self as accel, BackEnd, BuildError, Bvh, NodeNote, SolidPack, Statistics};
use umbrage_geom::{Aabb, Ray, SlabRay, glam::Vec3};

/// Boxes of a pack.
const LANES: usize = SolidPack::LANES;

/// Most boxes of a generator.
const MOST_BOXES: usize = 128;

/// Most voxels along the longest side of a generator.
const MOST_VOXELS: f64 = 144.0;

/// Shadow rays for each triangle from which on looking for boxes is worth it: it takes about as long as tracing ten.
const RAYS_PER_TRIANGLE: f64 = 30.0;

/// Most lights that have boxes of their own: rays to many lights in turn pay more for what they fetch than they gain.
const MOST_LIGHTS: usize = 8;

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
    /// How many triangles its surface has, and their area.
    triangles: u32,
    area: f64,
}

/// Boxes with their indices.
#[derive(Clone, Copy, Debug)]
struct Pack {
    boxes: SolidPack,
    ids: [u32; LANES],
    /// Index of the first pack on the way from the root to this one.
    top: u32,
}

impl Pack {
    const EMPTY: Self = Self { boxes: SolidPack::EMPTY, ids: [u32::MAX; LANES], top: 0 };

    fn set(&mut self, lane: usize, aabb: &Aabb, solid: u32) {
        self.boxes.set(lane, aabb);
        self.ids[lane] = solid;
    }
}

/// Boxes inside of generators.
#[derive(Clone, Debug, Default)]
struct Carved {
    interiors: Vec<Arc<Interior>>,
    solids: Vec<Aabb>,
    /// Interior that each box belongs to.
    owners: Vec<u32>,
}

impl Carved {
    fn new(positions: &[[f32; 3]], triangles: &[[u32; 3]], found: &Solids) -> Self {
        let mut this = Self::default();
        for (index, generator) in found.all().iter().enumerate() {
            let surface = found.surface(index, positions, triangles);
            // Boxes much larger than triangles are what counts, and about that many fit along a side.
            let resolution = (f64::from(generator.triangles).sqrt() / 4.0).clamp(24.0, MOST_VOXELS) as usize;
            let winding = |point| surface.winding_number(point);
            let Some(voxels) =
                Voxels::build(&generator.bounds, resolution, &mut surface.triangles(), &winding)
            else {
                continue;
            };
            let carved = carve(&voxels, &generator.bounds, MOST_BOXES);
            if carved.boxes.is_empty() {
                continue;
            }
            this.owners.extend(std::iter::repeat_n(this.interiors.len() as u32, carved.boxes.len()));
            this.solids.extend(carved.boxes);
            this.interiors.push(Arc::new(Interior {
                bounds: generator.bounds,
                voxels,
                guards: surface.guards().to_vec(),
                coverage: carved.coverage,
                triangles: generator.triangles,
                area: forecast::area(surface.triangles()),
            }));
        }
        this
    }

    /// Adds what other objects of the mesh have.
    fn append(&mut self, other: &Self) {
        let first = self.interiors.len() as u32;
        self.interiors.extend(other.interiors.iter().cloned());
        self.solids.extend(&other.solids);
        self.owners.extend(other.owners.iter().map(|owner| first + owner));
    }
}

/// A wide hierarchy whose any-hit meets boxes inside of solids early; exact.
#[derive(Clone, Debug)]
pub struct SolidBvh {
    /// Notes of nodes are indices of packs, from 1.
    bvh: Arc<Bvh>,
    packs: Vec<Pack>,
    carved: Carved,
    /// See [`unique_id`].
    id: u64,
}

/// What a thread keeps from ray to ray: for each light the boxes that ended rays last. With another [`SolidBvh`] than before it
/// starts anew.
#[derive(Clone, Debug, Default)]
pub struct SolidScratch {
    lights: Vec<Light>,
    /// More than [`MOST_LIGHTS`] were seen.
    many: bool,
    /// [`SolidBvh::id`] of the boxes.
    id: u64,
}

/// By pack, for the first ones on ways from the root.
type Light = Vec<Option<Box<LightPack>>>;

/// A pack as one light has it: whatever ended rays last, in the pack or below, takes the places of what wasn't used for longest.
#[derive(Clone, Debug)]
struct LightPack {
    pack: Pack,
    /// When each lane was last used.
    used: [u32; LANES],
    clock: u32,
}

impl LightPack {
    fn new(pack: Pack) -> Self {
        Self { pack, used: [0; LANES], clock: 0 }
    }

    #[inline(always)]
    fn touch(&mut self, lane: usize) {
        // A wrap of the clock makes the order wrong for a while, which costs time only.
        self.clock = self.clock.wrapping_add(1);
        self.used[lane] = self.clock;
    }

    /// Remembers a box in the place of the one that wasn't used for longest. It is not among them: rays would have met it.
    #[inline(always)]
    fn remember(&mut self, aabb: &Aabb, solid: u32) {
        let mut oldest = 0;
        for lane in 1..LANES {
            oldest = if self.used[lane] < self.used[oldest] { lane } else { oldest };
        }
        self.pack.set(oldest, aabb, solid);
        self.touch(oldest);
    }
}

impl SolidBvh {
    /// Finds generators among the objects of `mesh` and puts boxes from inside of them into `bvh`, which must be that of the mesh.
    /// It is copied if others use it too, and if there are any boxes.
    ///
    /// # Errors
    /// Those of [`Solids::find`]; [`OcclusionError::Triangles`] if `bvh` has not as many triangles as the mesh.
    pub fn build(
        bvh: Arc<Bvh>,
        mesh: &ObjectMesh<'_>,
        options: &SolidBvhOptions,
    ) -> Result<Self, OcclusionError> {
        mesh.check_hierarchy(bvh.prim_count())?;
        let found = Solids::find(mesh, &options.solids)?;
        Ok(Self::new(bvh, Carved::new(mesh.positions, mesh.triangles, &found)))
    }

    /// [`Self::build`] where `rays` are expected to gain by it: there are 30 a triangle, [`Forecast::pays`], and generators have
    /// 4000 triangles, or 16,000 if rays come one by one. Nothing is copied otherwise, no box looked for if the audit of the
    /// objects says no, and nothing audited for fewer rays.
    ///
    /// # Errors
    /// As [`Self::build`].
    pub fn build_if_it_pays(
        bvh: &Arc<Bvh>,
        mesh: &ObjectMesh<'_>,
        rays: &ShadowRays<'_>,
        options: &SolidBvhOptions,
    ) -> Result<Option<Self>, OcclusionError> {
        mesh.check_hierarchy(bvh.prim_count())?;
        let &ObjectMesh { positions, triangles, .. } = mesh;
        if rays.lights.is_empty() || rays.count < RAYS_PER_TRIANGLE * triangles.len() as f64 {
            return Ok(None);
        }
        let found = Solids::find(mesh, &options.solids)?;
        if !Forecast::may_pay(found.all(), triangles.len(), rays) {
            return Ok(None);
        }
        let carved = Carved::new(positions, triangles, &found);
        let pays = carved.forecast(rays.lights, triangles.len()).pays();
        Ok(pays.then(|| Self::new(bvh.clone(), carved)))
    }

    fn new(mut bvh: Arc<Bvh>, carved: Carved) -> Self {
        let mut packs = Vec::new();
        if !carved.solids.is_empty() {
            let places = places::choose(&bvh, &carved.solids);
            let owned = Arc::make_mut(&mut bvh);
            (0..owned.view().node_count() as u32).for_each(|node| owned.set_note(node, NodeNote::default()));
            for place in places {
                let mut pack = Pack { top: place.top, ..Pack::EMPTY };
                let boxes = place.solids.iter().enumerate();
                boxes.for_each(|(lane, &solid)| pack.set(lane, &carved.solids[solid as usize], solid));
                packs.push(pack);
                owned.set_note(place.node, NodeNote { index: packs.len() as u32, ..NodeNote::default() });
            }
        }
        Self { bvh, packs, carved, id: unique_id() }
    }

    /// What can be said of rays to `lights` (points; far away for distant ones).
    pub fn forecast(&self, lights: &[Vec3]) -> Forecast {
        self.carved.forecast(lights, self.bvh.prim_count())
    }

    /// Whether the open segment meets any triangle.
    ///
    /// `light` names the light that the ray goes to, if any: rays to one light are likely to end at the same boxes.
    pub fn any_hit(&self, ray: &Ray, ends: Ends, light: Option<usize>, scratch: &mut SolidScratch) -> bool {
        if self.packs.is_empty() {
            return self.bvh.any_hit(ray);
        }
        self.bvh.any_hit_among_with(ray, &mut self.search(ends, light, scratch, &mut ()), &mut ())
    }

    /// What a thread needs to trace rays.
    pub fn scratch(&self) -> SolidScratch {
        SolidScratch { id: self.id, ..SolidScratch::default() }
    }

    /// [`Self::any_hit`], counted.
    pub fn any_hit_with(
        &self,
        ray: &Ray,
        ends: Ends,
        light: Option<usize>,
        scratch: &mut SolidScratch,
        stats: &mut impl Statistics,
    ) -> bool {
        if self.packs.is_empty() {
            return self.bvh.any_hit_with(ray, stats);
        }
        let mut ended = None;
        let mut search = self.search(ends, light, scratch, &mut ended);
        let hit = self.bvh.any_hit_among_with(ray, &mut search, stats);
        ended.into_iter().for_each(|remembered| stats.ended_in_solid(remembered));
        hit
    }

    /// [`Self::any_hit`] of rays to one light. Runs of rays that share an origin walk together, which is faster, and several of
    /// these take turns: many rays a call are best.
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
        assert_eq!(rays.len(), hits.len(), "one answer a ray");
        if self.packs.is_empty() {
            return self.bvh.any_hits_with(rays, hits, &mut ());
        }
        let mut unwatched = ();
        let mut search = self.search(ends, light, scratch, &mut unwatched);
        let shares = |i: usize, other: usize| rays.get(other).is_some_and(|r| r.origin == rays[i].origin);
        let alone = |i: usize| !shares(i, i + 1) && !shares(i, i.wrapping_sub(1));
        let mut start = 0;
        while start < rays.len() {
            let single = alone(start);
            let end = (start + 1..rays.len()).find(|&i| alone(i) != single).unwrap_or(rays.len());
            if single {
                // A fan of one ray would cost more than the ray.
                for (ray, hit) in rays[start..end].iter().zip(&mut hits[start..end]) {
                    *hit = self.bvh.any_hit_among_with(ray, &mut search, &mut ());
                }
            } else {
                self.bvh.any_hits_among_with(&rays[start..end], &mut hits[start..end], &mut search, &mut ());
            }
            start = end;
        }
    }

    fn search<'a, W: Watch>(
        &'a self,
        ends: Ends,
        light: Option<usize>,
        scratch: &'a mut SolidScratch,
        watch: &'a mut W,
    ) -> Search<'a, W> {
        if scratch.id != self.id {
            *scratch = self.scratch();
        }
        let SolidScratch { lights, many, .. } = scratch;
        if light.is_some_and(|light| light >= MOST_LIGHTS) {
            *many = true;
            lights.clear();
        }
        let light = light.filter(|_| !*many);
        if let Some(light) = light
            && lights.len() <= light
        {
            lights.resize_with(light + 1, || vec![None; self.packs.len()]);
        }
        Search { this: self, ends, light: light.map(|light| &mut lights[light]), watch }
    }

    /// Whether all points of `region`, such as a light, are surely outside of every generator, so that segments to it have
    /// [`Ends::Outside`].
    pub fn is_outside(&self, region: &Aabb) -> bool {
        self.carved.interiors.iter().all(|interior| interior.region_is_outside(region))
    }

    /// Whether `solid`, which the segment crosses, blocks it: the endpoint rule, and the guards.
    #[inline]
    fn vouches(&self, solid: u32, ray: &Ray, ends: Ends) -> bool {
        let interior = &self.carved.interiors[self.carved.owners[solid as usize] as usize];
        (interior.guards.is_empty() || interior.avoids_guards(ray))
            && (ends == Ends::Outside || interior.has_end_outside(ray))
    }

    /// Number of generators that have occluders.
    pub fn solid_count(&self) -> usize {
        self.carved.interiors.len()
    }

    /// The boxes inside of solids.
    pub fn occluders(&self) -> &[Aabb] {
        &self.carved.solids
    }

    /// Nodes that have boxes.
    pub fn pack_count(&self) -> usize {
        self.packs.len()
    }

    /// Share of random lines through the bounds of generator `index` that its boxes stop, before any triangle is asked; `None` if
    /// there is no such generator.
    pub fn coverage(&self, index: usize) -> Option<f32> {
        self.carved.interiors.get(index).map(|interior| interior.coverage)
    }

    /// The hierarchy.
    pub fn bvh(&self) -> &Arc<Bvh> {
        &self.bvh
    }

    /// Bytes that all of it holds.
    pub fn bytes(&self) -> usize {
        let voxels: usize = self.carved.interiors.iter().map(|interior| interior.voxels.bytes()).sum();
        let boxes = size_of_val(&self.carved.solids[..]) + size_of_val(&self.carved.owners[..]);
        self.bvh.bytes() + size_of_val(&self.packs[..]) + boxes + voxels
    }

    /// The same on another back end. Answers are the same.
    ///
    /// # Errors
    /// [`BuildError::BackEnd`] if this processor lacks it.
    pub fn with_back_end(self, back_end: BackEnd) -> Result<Self, BuildError> {
        Ok(Self { bvh: Arc::new(Arc::unwrap_or_clone(self.bvh).with_back_end(back_end)?), ..self })
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

    fn avoids_guards(&self, ray: &Ray) -> bool {
        let Some(slab) = SlabRay::new(ray) else { return false };
        self.guards.iter().all(|guard| slab.entry(guard, slab.tfar).is_none())
    }
}

/// Is told of rays that end at a box, and whether their light remembers it; `()` does nothing.
trait Watch {
    fn solid(&mut self, _remembered: bool) {}
}

impl Watch for () {}

/// Of one ray.
impl Watch for Option<bool> {
    fn solid(&mut self, remembered: bool) {
        *self = Some(remembered);
    }
}

/// The boxes as one batch of rays to one light sees them.
struct Search<'a, W> {
    this: &'a SolidBvh,
    ends: Ends,
    light: Option<&'a mut Light>,
    watch: &'a mut W,
}

impl<W> Search<'_, W> {
    /// The pack of a note, and whether the light has its own.
    #[inline(always)]
    fn find(&self, index: u32) -> Option<(&Pack, bool)> {
        let place = (index as usize).wrapping_sub(1);
        let own = self.light.as_ref().and_then(|light| light.get(place)?.as_ref());
        match own {
            Some(own) => Some((&own.pack, true)),
            None => Some((self.this.packs.get(place)?, false)),
        }
    }

    /// Notes that a box ended a ray.
    #[inline(always)]
    fn used(&mut self, index: u32, lane: usize, solid: u32) {
        let Some(light) = &mut self.light else { return };
        let packs = &self.this.packs;
        let place = (index as usize).wrapping_sub(1);
        let top = packs[place].top as usize;
        let own = light[top].get_or_insert_with(|| Box::new(LightPack::new(packs[top])));
        if top == place {
            own.touch(lane);
        } else {
            own.remember(&self.this.carved.solids[solid as usize], solid);
        }
    }
}

impl<W: Watch> accel::SolidBoxes for Search<'_, W> {
    #[inline(always)]
    fn pack(&self, index: u32) -> Option<&SolidPack> {
        self.find(index).map(|(pack, _)| &pack.boxes)
    }

    #[inline(always)]
    fn blocks(&mut self, ray: &Ray, _: usize, index: u32, mut lanes: u32) -> bool {
        while lanes != 0 {
            let lane = lanes.trailing_zeros() as usize % LANES;
            lanes &= lanes - 1;
            let Some((solid, first)) = self.find(index).map(|(pack, own)| (pack.ids[lane], own)) else {
                return false;
            };
            if self.this.vouches(solid, ray, self.ends) {
                self.watch.solid(first);
                self.used(index, lane, solid);
                return true;
            }
        }
        false
    }
}
