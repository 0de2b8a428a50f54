//! Rays against a surface: a hierarchy over patch bounds, rates by footprint, grids on demand.

mod cache;
mod occluder;
mod options;
mod state;

pub use options::{Borders, FootprintRule, Rates, TraceOptions};
pub use state::TraceState;

use self::{cache::GridCache, occluder::OpaqueCells};
use crate::{
    Surface, SurfaceError,
    mesh::dice::{GridKey, Stitch},
    mesh::grid::{Grid, GridRay},
    patch::{Node, QUARTERS},
    rate::footprint::Width,
    subdiv::NONE,
    surface::LimitPoint,
};
use std::{
    ops::ControlFlow,
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering::Relaxed},
    },
};
use umbrage_accel::{BoxBvh, BuildQuality};
use umbrage_geom::{Aabb, Ray, RayDifferential, glam::Vec3, offset_origin};

/// Where a ray meets a surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfaceHit {
    /// Ray parameter of the micropolygon's hit.
    pub t: f32,
    /// Index of the patch.
    pub patch: u32,
    /// Parameters of the point, in `[0, 1]`.
    pub u: f32,
    /// See [`Self::u`].
    pub v: f32,
    /// Levels at which the patch was diced for this ray: `2^levels[0]` cells along `u`.
    pub levels: [u8; 2],
    /// Whether the side is hit from which the control mesh's faces run counter-clockwise.
    pub front: bool,
}

/// Work of a tracer and all its threads so far; operations of the surface's patches are [`crate::SurfaceCounts`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct TraceCounts {
    /// Grids diced, again after eviction.
    pub dice: u64,
    /// Cells of these grids.
    pub micropolygons: u64,
    /// Grids dropped for room.
    pub evicted: u64,
}

/// Traces rays against a surface whose patches are diced as each ray needs.
///
/// What a ray sees of a patch depends on the ray and the surface alone, so answers are the same for any order of rays, number
/// of threads and cache size.
pub struct SurfaceTracer {
    pub(crate) surface: Arc<Surface>,
    pub(crate) bvh: BoxBvh,
    pub(crate) options: TraceOptions,
    cache: GridCache,
    occluders: Option<OpaqueCells>,
    dice: AtomicU64,
    micropolygons: AtomicU64,
}

/// One ray's way through the surface.
pub(crate) struct RayWalk<'a, 's> {
    pub(crate) tracer: &'a SurfaceTracer,
    /// The whole ray, by which rates are chosen.
    pub(crate) whole: GridRay,
    /// The ray up to the closest hit so far.
    pub(crate) ray: GridRay,
    pub(crate) width: Width,
    pub(crate) state: &'s mut TraceState,
    any: bool,
    closest: Option<(SurfaceHit, GridKey, u32)>,
}

impl SurfaceTracer {
    /// Builds the hierarchy over patches; nothing is diced.
    ///
    /// # Errors
    /// [`SurfaceError::Option`], [`SurfaceError::Build`].
    pub fn new(surface: Arc<Surface>, options: &TraceOptions) -> Result<Self, SurfaceError> {
        options.check()?;
        let boxes: Vec<Aabb> = surface.patches.iter().map(|p| p.bounds).collect();
        Ok(Self {
            bvh: BoxBvh::build(&boxes, BuildQuality::High)?,
            cache: GridCache::new(options.cache_bytes),
            occluders: (options.occluder_cells > 0 && options.has_seams())
                .then(|| OpaqueCells::build(&surface, options.occluder_cells))
                .flatten(),
            options: *options,
            surface,
            dice: 0.into(),
            micropolygons: 0.into(),
        })
    }

    /// The surface.
    pub fn surface(&self) -> &Surface {
        &self.surface
    }

    /// How it is traced.
    pub fn options(&self) -> &TraceOptions {
        &self.options
    }

    /// Work done so far.
    pub fn counts(&self) -> TraceCounts {
        TraceCounts {
            dice: self.dice.load(Relaxed),
            micropolygons: self.micropolygons.load(Relaxed),
            evicted: self.cache.evicted.load(Relaxed) as u64,
        }
    }

    /// Most bytes that grids took at any time, those that threads hold left out.
    pub fn peak_grid_bytes(&self) -> usize {
        self.cache.peak_bytes()
    }

    /// Bytes of the hierarchy over patches.
    pub fn bvh_bytes(&self) -> usize {
        self.bvh.bytes()
    }

    /// Whether the open segment meets any micropolygon that it sees. Rays that are not [valid](Ray::is_valid) miss.
    pub fn any_hit(&self, ray: &Ray, differential: &RayDifferential, state: &mut TraceState) -> bool {
        if self.is_blocked_inside(ray, state) {
            return true;
        }
        self.query(ray, differential, state, true).is_some_and(|query| query.closest.is_some())
    }

    /// The hit with the smallest `t`.
    pub fn closest_hit(
        &self,
        ray: &Ray,
        differential: &RayDifferential,
        state: &mut TraceState,
    ) -> Option<SurfaceHit> {
        self.query(ray, differential, state, false)?.closest.map(|(hit, ..)| hit)
    }

    /// Whether an opaque cell answers for the segment.
    pub(crate) fn is_blocked_inside(&self, ray: &Ray, state: &mut TraceState) -> bool {
        let blocked = self.occluders.as_ref().is_some_and(|cells| cells.block(ray));
        state.occluder_hits += u64::from(blocked);
        blocked
    }

    /// Cells of the lattice that are inside the surface, and its bytes.
    pub fn opaque_cells(&self) -> (usize, usize) {
        self.occluders.as_ref().map_or((0, 0), |cells| (cells.opaque, cells.bytes()))
    }

    pub(crate) fn start<'a, 's>(
        &'a self,
        ray: &Ray,
        differential: &RayDifferential,
        state: &'s mut TraceState,
        any: bool,
    ) -> Option<RayWalk<'a, 's>> {
        let whole = GridRay::new(ray)?;
        let width = Width::new(ray, differential, self.options.edge.into());
        state.begin();
        Some(RayWalk { tracer: self, whole, ray: whole, width, state, any, closest: None })
    }

    fn query<'a, 's>(
        &'a self,
        ray: &Ray,
        differential: &RayDifferential,
        state: &'s mut TraceState,
        any: bool,
    ) -> Option<RayWalk<'a, 's>> {
        let mut query = self.start(ray, differential, state, any)?;
        let _ = self.bvh.walk(ray, |patch| {
            if query.patch(patch) && any {
                return ControlFlow::Break(());
            }
            ControlFlow::Continue(query.closest.map_or(ray.tfar, |(hit, ..)| hit.t))
        });
        Some(query)
    }

    /// The rate at which `ray` sees a patch before any stitching; `None` if the ray misses its box.
    pub fn levels(&self, patch: u32, ray: &Ray, differential: &RayDifferential) -> Option<[u8; 2]> {
        let whole = GridRay::new(ray)?;
        self.rate(patch, &whole, &Width::new(ray, differential, self.options.edge.into()))
    }

    fn rate(&self, patch: u32, ray: &GridRay, width: &Width) -> Option<[u8; 2]> {
        let bounds = &self.surface.patches[patch as usize].bounds;
        ray.slab.entry(bounds, ray.slab.tfar)?;
        let interval = width.interval(bounds);
        Some(match self.options.footprint {
            FootprintRule::Entry => self.levels_for(patch, width.least(interval[0], interval[1])),
            FootprintRule::FinalApproach => {
                let [first, last] = self.coarse_hits(patch, &ray.ray).unwrap_or(interval);
                self.levels_for(patch, width.least(first, last))
            }
            FootprintRule::ExactFinalApproach => self.exact_approach(patch, ray, width, interval),
            FootprintRule::Edges | FootprintRule::ProjectedEdges | FootprintRule::DiagSplit => {
                let [bottom, right, top, left] =
                    [0, 1, 2, 3].map(|edge| self.edge_level(patch, edge, ray, width));
                let levels = [bottom.max(top), right.max(left)];
                // Edges may differ by more than the sides of a grid do.
                levels.map(|l| l.max(GridKey::depth_for(levels)))
            }
        })
    }

    /// Whether borders are moved to where neighbours have vertices.
    fn has_seams(&self) -> bool {
        self.options.has_seams()
    }

    pub(crate) fn levels_for(&self, patch: u32, width: f64) -> [u8; 2] {
        let isotropic = self.options.rates == Rates::Equal;
        let Surface { patches, context, .. } = &*self.surface;
        patches[patch as usize].levels_for(width, self.options.max_level, isotropic, context)
    }

    /// The limit surface at a hit.
    pub fn limit(&self, hit: &SurfaceHit) -> LimitPoint {
        self.surface.limit(hit.patch, hit.u, hit.v)
    }

    /// Where a ray from a hit should start, in direction `direction`: on the limit surface, moved off by what the
    /// tessellations that this and a ray of twice the width see may lie above it.
    pub fn leave(&self, hit: &SurfaceHit, direction: Vec3) -> Vec3 {
        let point = self.limit(hit);
        let patch = &self.surface.patches[hit.patch as usize];
        let coarser = hit.levels.map(|l| l.saturating_sub(1));
        let context = &self.surface.context;
        let shift = patch.deviation(hit.levels, context) + patch.deviation(coarser, context);
        let side = 1f32.copysign(direction.dot(point.normal));
        let moved = point.position + point.normal * (side * shift as f32);
        offset_origin(moved, point.normal, direction, moved.abs().max_element())
    }
}

/// The borders of a patch as a ray sees them, found when needed.
struct Seams {
    patch: u32,
    levels: [u8; 2],
    shifts: [Option<[u8; 2]>; 4],
}

impl RayWalk<'_, '_> {
    /// Looks for hits on a patch; whether there was any so far.
    pub(crate) fn patch(&mut self, patch: u32) -> bool {
        if self.tracer.options.footprint == FootprintRule::DiagSplit {
            self.diagsplit(patch);
            return self.closest.is_some();
        }
        let Some(levels) = self.levels(patch) else { return self.closest.is_some() };
        let mut seams = Seams { patch, levels, shifts: [None; 4] };
        let tracer = self.tracer;
        self.part(&tracer.surface.patches[patch as usize].root, 0, [0, 0], &mut seams);
        self.closest.is_some()
    }

    fn levels(&mut self, patch: u32) -> Option<[u8; 2]> {
        if let Some(known) = self.state.levels.get(patch) {
            return known;
        }
        let levels = self.tracer.rate(patch, &self.whole, &self.width);
        self.state.levels.set(patch, levels);
        levels
    }

    /// How many levels the halves of an edge are coarser than the patch.
    fn shifts(&mut self, seams: &mut Seams, edge: usize) -> [u8; 2] {
        if let Some(known) = seams.shifts[edge] {
            return known;
        }
        let tracer = self.tracer;
        let links = tracer.surface.patches[seams.patch as usize].links[edge];
        let own = seams.levels[edge % 2];
        let mut shifts = links.map(|link| {
            if tracer.options.footprint.is_by_edges() {
                return own.saturating_sub(tracer.edge_level(seams.patch, edge, &self.whole, &self.width));
            }
            if link.patch == NONE {
                return 0;
            }
            let Some(theirs) = self.levels(link.patch) else { return 0 };
            let theirs = theirs[usize::from(link.edge) % 2];
            own.saturating_sub(link.meeting.in_own_units(theirs))
        });
        if edge >= 2 {
            // These edges run against the parameters.
            shifts.reverse();
        }
        seams.shifts[edge] = Some(shifts);
        shifts
    }

    /// Looks for hits on a part of a patch; `true` ends the query.
    fn part(&mut self, node: &Node, depth: u8, place: [u16; 2], seams: &mut Seams) -> bool {
        let tracer = self.tracer;
        let leaf_depth = GridKey::depth_for(seams.levels);
        if depth == leaf_depth {
            return self.grid(depth, place, seams);
        }
        let children = node.split(&tracer.surface.context);
        let mut entered = [(0f32, 0usize); 4];
        let mut count = 0;
        for (k, child) in children.iter().enumerate() {
            let mut entry = self.ray.slab.entry(&child.bounds, self.ray.slab.tfar);
            if entry.is_none() && tracer.has_seams() {
                let mut bounds = child.bounds;
                self.widen(&mut bounds, depth + 1, quarter_place(place, k), seams);
                if bounds != child.bounds {
                    entry = self.ray.slab.entry(&bounds, self.ray.slab.tfar);
                }
            }
            let Some(entry) = entry else { continue };
            let mut at = count;
            while at > 0 && entered[at - 1].0 > entry {
                entered[at] = entered[at - 1];
                at -= 1;
            }
            entered[at] = (entry, k);
            count += 1;
        }
        for &(entry, k) in &entered[..count] {
            if entry > self.ray.slab.tfar {
                break;
            }
            if self.part(&children[k], depth + 1, quarter_place(place, k), seams) {
                return true;
            }
        }
        false
    }

    /// Makes room for border vertices that are stitched to places beyond the part.
    fn widen(&mut self, bounds: &mut Aabb, depth: u8, place: [u16; 2], seams: &mut Seams) {
        let surface = &self.tracer.surface;
        let part =
            GridKey { patch: seams.patch, depth, levels: seams.levels, place, stitch: Stitch::default() };
        for edge in 0..4 {
            if !part.touches(edge) {
                continue;
            }
            let axis = edge % 2;
            let shift = self.shifts(seams, edge).into_iter().max().unwrap_or(0);
            if shift + depth <= seams.levels[axis] {
                continue;
            }
            *bounds = bounds.union(surface.stitched_ends(&part, edge, shift));
        }
    }

    fn grid(&mut self, depth: u8, place: [u16; 2], seams: &mut Seams) -> bool {
        let tracer = self.tracer;
        let mut key =
            GridKey { patch: seams.patch, depth, levels: seams.levels, place, stitch: Stitch::default() };
        if tracer.has_seams() {
            for edge in 0..4 {
                if key.touches(edge) {
                    let shifts = self.shifts(seams, edge);
                    key.stitch = key.stitch.with(edge, key.half_of(edge, shifts));
                }
            }
        }
        self.grid_of(key)
    }

    /// Looks for hits on one grid; `true` ends the query.
    pub(crate) fn grid_of(&mut self, key: GridKey) -> bool {
        let tracer = self.tracer;
        let Self { state, ray, any, closest, .. } = self;
        state.grid_tests += 1;
        let grid = state.grids.get(&key, || {
            tracer.cache.get(&key, || {
                let grid = tracer.surface.dice(&key);
                tracer.dice.fetch_add(1, Relaxed);
                tracer.micropolygons.fetch_add(grid.cells() as u64, Relaxed);
                grid
            })
        });
        if *any {
            if grid.any_hit(ray) {
                let hit =
                    SurfaceHit { t: 0.0, patch: key.patch, u: 0.0, v: 0.0, levels: key.levels, front: true };
                *closest = Some((hit, key, 0));
                return true;
            }
            return false;
        }
        closest_on(grid, ray, key, closest);
        false
    }
}

/// Updates `closest` with hits on `grid`. Ties go by key, so that the order of visits doesn't matter.
fn closest_on(
    grid: &Grid,
    ray: &mut GridRay,
    key: GridKey,
    closest: &mut Option<(SurfaceHit, GridKey, u32)>,
) {
    let Some(hit) = grid.closest_hit(ray) else { return };
    let rank = |key: &GridKey, triangle: u32| (key.patch, key.place[1], key.place[0], triangle);
    let nearer = closest.as_ref().is_none_or(|(old, old_key, triangle)| {
        hit.t < old.t || (hit.t == old.t && rank(&key, hit.triangle) < rank(old_key, *triangle))
    });
    if nearer {
        let found = SurfaceHit {
            t: hit.t,
            patch: key.patch,
            u: hit.u,
            v: hit.v,
            levels: key.levels,
            front: hit.front,
        };
        *closest = Some((found, key, hit.triangle));
    }
}

fn quarter_place(place: [u16; 2], k: usize) -> [u16; 2] {
    let (a, b) = QUARTERS[k];
    [2 * place[0] + a as u16, 2 * place[1] + b as u16]
}
