//! Boxes inside of an object when the first ray comes near it (Djeu11, section 4.8.5).
//!
//! Here: when objects are prepared, and how what was prepared reaches all threads. Not here: what is prepared, and queries
//! (`mod.rs`). Answers are exact with any boxes, so who prepares what when changes none. The work that rays take does depend on
//! it, unless everything is prepared first ([`LazySolidBvh::prepare_all`]).

use super::{Carved, SolidBvh, SolidBvhOptions, SolidScratch};
use crate::{
    OcclusionError,
    volumetric::{Ends, Object, ObjectMesh, Solids, object_mesh::unique_id},
};
use std::{
    ops::{AddAssign, ControlFlow, Range},
    sync::{
        Arc, Mutex, MutexGuard, OnceLock,
        atomic::{AtomicBool, AtomicU32, AtomicU64, AtomicUsize, Ordering},
    },
};
use umbrage_accel::{BoxBvh, BoxVisitor, BuildQuality, Bvh, Statistics};
use umbrage_geom::{Aabb, Ray};

/// Fewest triangles that enclose space.
const MIN_SOLID_TRIANGLES: usize = 4;

/// Rays after which boxes are taken into use however few they are. Putting them into the hierarchy takes as long as tracing
/// about so many.
const MAX_WAITING_RAYS: u64 = 1 << 18;

/// An object that may generate.
#[derive(Debug)]
struct Candidate {
    triangles: Range<u32>,
    bounds: Aabb,
    /// Whether some thread prepares it, or has.
    claimed: AtomicBool,
    carved: OnceLock<Carved>,
}

/// How much was prepared.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub struct Prepared {
    /// Objects that may have occluders: opaque, and not flat.
    pub objects: usize,
    /// Of these, objects that a ray came near to.
    pub prepared: usize,
    /// Of these, objects that have occluders.
    pub generators: usize,
    /// Boxes inside of them.
    pub boxes: usize,
}

impl AddAssign for Prepared {
    fn add_assign(&mut self, other: Self) {
        self.objects += other.objects;
        self.prepared += other.prepared;
        self.generators += other.generators;
        self.boxes += other.boxes;
    }
}

/// A [`SolidBvh`] whose objects are audited and get their boxes when the first ray reaches their bounds, once for all
/// threads. Objects that no ray reaches cost nothing.
///
/// Which objects are prepared depends on the rays alone, not on threads.
#[derive(Debug)]
pub struct LazySolidBvh<'a> {
    bvh: Arc<Bvh>,
    positions: &'a [[f32; 3]],
    triangles: &'a [[u32; 3]],
    options: SolidBvhOptions,
    candidates: Vec<Candidate>,
    /// How many were claimed.
    claims: AtomicUsize,
    /// Boxes that are ready, and those of them in [`Self::current`].
    ready: AtomicUsize,
    published: AtomicUsize,
    /// Rays that came while some were not in use.
    waited: AtomicU64,
    /// Held while boxes are put into the hierarchy.
    publishing: Mutex<()>,
    current: Mutex<Arc<SolidBvh>>,
    /// Times that it was replaced.
    version: AtomicU32,
    /// See [`unique_id`].
    id: u64,
}

/// What a thread needs to trace rays. With another [`LazySolidBvh`] than before it starts anew.
#[derive(Debug)]
pub struct LazyScratch {
    current: Arc<SolidBvh>,
    version: u32,
    solid: SolidScratch,
    /// Candidates that no thread had claimed when this was made, and how many had been then.
    waiting: Waiting,
    claims: usize,
    /// [`LazySolidBvh::id`] of all this.
    id: u64,
}

/// Unclaimed candidates.
#[derive(Debug, Default)]
struct Waiting {
    candidates: Vec<u32>,
    bounds: Option<BoxBvh>,
}

fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(|poisoned| poisoned.into_inner())
}

impl<'a> LazySolidBvh<'a> {
    /// Prepares nothing yet. `bvh` must be that of the mesh.
    ///
    /// # Errors
    /// Those of [`ObjectMesh::validate`]; [`OcclusionError::Setting`]; [`OcclusionError::Triangles`] if `bvh` has not as many
    /// triangles as the mesh.
    pub fn build(
        bvh: Arc<Bvh>,
        mesh: &ObjectMesh<'a>,
        options: &SolidBvhOptions,
    ) -> Result<Self, OcclusionError> {
        mesh.check_hierarchy(bvh.prim_count())?;
        mesh.validate()?;
        options.solids.validate()?;
        let &ObjectMesh { positions, triangles, .. } = mesh;
        let candidate = |object: &Object| {
            let own = &triangles[object.triangles.start as usize..object.triangles.end as usize];
            let corners = own.iter().flatten().map(|&v| positions[v as usize]);
            let bounds = corners.fold(Aabb::EMPTY, Aabb::with_point);
            let solid =
                object.opaque && own.len() >= MIN_SOLID_TRIANGLES && bounds.min.cmplt(bounds.max).all();
            solid.then(|| Candidate {
                triangles: object.triangles.clone(),
                bounds,
                claimed: AtomicBool::new(false),
                carved: OnceLock::new(),
            })
        };
        let candidates = mesh.objects_or_whole().iter().filter_map(candidate).collect();
        let current = SolidBvh::new(bvh, Carved::default());
        Ok(Self { positions, triangles, options: *options, candidates, ..Self::ready(current) })
    }

    /// With all objects prepared already.
    pub fn ready(built: SolidBvh) -> Self {
        Self {
            bvh: built.bvh.clone(),
            positions: &[],
            triangles: &[],
            options: SolidBvhOptions::default(),
            candidates: Vec::new(),
            claims: AtomicUsize::new(0),
            ready: AtomicUsize::new(0),
            published: AtomicUsize::new(0),
            waited: AtomicU64::new(0),
            publishing: Mutex::new(()),
            current: Mutex::new(Arc::new(built)),
            version: AtomicU32::new(0),
            id: unique_id(),
        }
    }

    /// How many triangles the mesh has.
    pub(super) fn prim_count(&self) -> usize {
        self.bvh.prim_count()
    }

    /// What a thread needs to trace rays.
    pub fn scratch(&self) -> LazyScratch {
        let version = self.version.load(Ordering::Acquire);
        let current = locked(&self.current).clone();
        let solid = current.scratch();
        let (waiting, claims) = self.waiting();
        LazyScratch { current, version, solid, waiting, claims, id: self.id }
    }

    /// [`SolidBvh::any_hits`], and prepares what the rays reach.
    ///
    /// # Panics
    /// If the slices differ in length.
    pub fn any_hits(
        &self,
        rays: &[Ray],
        hits: &mut [bool],
        ends: Ends,
        light: Option<usize>,
        scratch: &mut LazyScratch,
    ) {
        self.reach(rays, scratch);
        scratch.current.any_hits(rays, hits, ends, light, &mut scratch.solid);
    }

    /// [`SolidBvh::any_hit_with`], and prepares what the ray reaches.
    pub fn any_hit_with(
        &self,
        ray: &Ray,
        ends: Ends,
        light: Option<usize>,
        scratch: &mut LazyScratch,
        stats: &mut impl Statistics,
    ) -> bool {
        self.reach(std::slice::from_ref(ray), scratch);
        scratch.current.any_hit_with(ray, ends, light, &mut scratch.solid, stats)
    }

    /// Prepares all objects and puts their boxes into use, so that the work of a ray does not depend on which rays came before it
    /// on other threads.
    pub fn prepare_all(&self) {
        let prepare = |candidate: &Candidate| {
            if !candidate.claimed.swap(true, Ordering::Relaxed) {
                self.claims.fetch_add(1, Ordering::AcqRel);
                let carved = candidate.carved.get_or_init(|| self.carve(candidate));
                self.ready.fetch_add(carved.solids.len(), Ordering::AcqRel);
            }
        };
        #[cfg(feature = "rayon")]
        {
            use rayon::prelude::*;
            self.candidates.par_iter().for_each(prepare);
        }
        #[cfg(not(feature = "rayon"))]
        self.candidates.iter().for_each(prepare);
        let _guard = locked(&self.publishing);
        self.publish();
    }

    /// How much was prepared so far.
    pub fn prepared(&self) -> Prepared {
        let ready = || self.candidates.iter().filter_map(|candidate| candidate.carved.get());
        let built = locked(&self.current).clone();
        if self.candidates.is_empty() {
            let (generators, boxes) = (built.solid_count(), built.occluders().len());
            return Prepared { objects: generators, prepared: generators, generators, boxes };
        }
        Prepared {
            objects: self.candidates.len(),
            prepared: ready().count(),
            generators: ready().filter(|carved| !carved.solids.is_empty()).count(),
            boxes: ready().map(|carved| carved.solids.len()).sum(),
        }
    }

    /// Prepares candidates that the rays reach, and takes over what other threads prepared.
    #[inline]
    pub(super) fn reach(&self, rays: &[Ray], scratch: &mut LazyScratch) {
        if scratch.id != self.id {
            *scratch = self.scratch();
        }
        if !scratch.waiting.candidates.is_empty() {
            self.claim(rays, scratch);
        }
        if self.ready.load(Ordering::Relaxed) != self.published.load(Ordering::Relaxed) {
            self.publish_if_due(rays.len() as u64);
        }
        if self.version.load(Ordering::Relaxed) != scratch.version {
            scratch.version = self.version.load(Ordering::Acquire);
            scratch.current = locked(&self.current).clone();
            scratch.solid = scratch.current.scratch();
        }
    }

    fn waiting(&self) -> (Waiting, usize) {
        let claims = self.claims.load(Ordering::Acquire);
        let free = |i: &u32| !self.candidates[*i as usize].claimed.load(Ordering::Relaxed);
        let candidates: Vec<u32> = (0..self.candidates.len() as u32).filter(free).collect();
        let bounds: Vec<Aabb> = candidates.iter().map(|&i| self.candidates[i as usize].bounds).collect();
        // There are no more candidates than triangles, and these have a hierarchy.
        let bounds = BoxBvh::build(&bounds, BuildQuality::Fast).ok();
        (Waiting { candidates, bounds }, claims)
    }

    /// Candidates that a ray reaches first are prepared by its thread; others that come meanwhile do without.
    #[inline(never)]
    fn claim(&self, rays: &[Ray], scratch: &mut LazyScratch) {
        let claims = self.claims.load(Ordering::Relaxed);
        // Many are taken off at a time, so that lists are made seldom.
        if claims - scratch.claims > scratch.waiting.candidates.len() / 2 || claims == self.candidates.len() {
            (scratch.waiting, scratch.claims) = self.waiting();
        }
        let Some(bounds) = &scratch.waiting.bounds else { return };
        let mut reached = Reached { this: self, waiting: &scratch.waiting.candidates, found: Vec::new() };
        for ray in rays {
            let _ = bounds.walk_unsorted(ray, &mut reached);
        }
        for index in reached.found {
            let candidate = &self.candidates[index as usize];
            let carved = candidate.carved.get_or_init(|| self.carve(candidate));
            self.ready.fetch_add(carved.solids.len(), Ordering::AcqRel);
        }
    }

    /// The boxes of one object.
    fn carve(&self, candidate: &Candidate) -> Carved {
        let own = &self.triangles[candidate.triangles.start as usize..candidate.triangles.end as usize];
        // Vertices of an object are mostly together.
        let used = || own.iter().flatten().copied();
        let (first, last) = (used().min().unwrap_or(0), used().max().unwrap_or(0));
        let positions = &self.positions[first as usize..=last as usize];
        let triangles: Vec<[u32; 3]> = own.iter().map(|triangle| triangle.map(|v| v - first)).collect();
        // What was checked before holds for parts of it: without an error this is the object's part.
        let found = Solids::find(&ObjectMesh::new(positions, &triangles), &self.options.solids);
        Carved::new(positions, &triangles, &found.unwrap_or_default())
    }

    /// Puts boxes into use once they are half as many as those in use, or have waited long; so all of it takes no longer than
    /// a few times what the last takes.
    #[inline(never)]
    fn publish_if_due(&self, rays: u64) {
        let waited = self.waited.fetch_add(rays, Ordering::Relaxed) + rays;
        let (ready, published) = (self.ready.load(Ordering::Acquire), self.published.load(Ordering::Acquire));
        if 2 * ready < 3 * published && waited < MAX_WAITING_RAYS {
            return;
        }
        // One thread does it, and others go on with what they have.
        let Ok(_guard) = self.publishing.try_lock() else { return };
        self.publish();
    }

    /// Puts all boxes that are ready into use. The caller holds [`Self::publishing`].
    fn publish(&self) {
        let mut all = Carved::default();
        self.candidates.iter().filter_map(|candidate| candidate.carved.get()).for_each(|c| all.append(c));
        if all.solids.len() == self.published.load(Ordering::Acquire) {
            return;
        }
        let count = all.solids.len();
        *locked(&self.current) = Arc::new(SolidBvh::new(self.bvh.clone(), all));
        self.waited.store(0, Ordering::Relaxed);
        self.version.fetch_add(1, Ordering::Release);
        self.published.store(count, Ordering::Release);
    }
}

impl LazyScratch {
    /// The hierarchy to walk now, and what is remembered of its boxes; `None` if there are none.
    #[inline]
    pub(super) fn boxes(&mut self) -> Option<(&SolidBvh, &mut SolidScratch)> {
        (!self.current.packs.is_empty()).then_some((&*self.current, &mut self.solid))
    }
}

/// Claims what a ray reaches.
struct Reached<'a, 'b> {
    this: &'a LazySolidBvh<'b>,
    waiting: &'a [u32],
    found: Vec<u32>,
}

impl BoxVisitor for Reached<'_, '_> {
    #[inline(always)]
    fn visit(&mut self, index: u32) -> ControlFlow<(), f32> {
        let index = self.waiting[index as usize];
        let claimed = &self.this.candidates[index as usize].claimed;
        if !claimed.load(Ordering::Relaxed) && !claimed.swap(true, Ordering::Relaxed) {
            self.this.claims.fetch_add(1, Ordering::AcqRel);
            self.found.push(index);
        }
        ControlFlow::Continue(f32::INFINITY)
    }
}
