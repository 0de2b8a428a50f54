//! Subdivision surfaces among occluders that are traced as such, without triangle meshes.

use super::{ShadingPoint, objects_of};
use crate::{QueryError, SurfaceMode, engine::Report, share_of, subdivide};
use std::{
    ops::ControlFlow,
    sync::{Arc, Mutex},
};
use umbrage_accel::{BoxBvh, BuildError, BuildQuality, FAN, Statistics, object_from_world, object_ray};
use umbrage_geom::{
    Aabb, OpticalDepth, Ray, RayDifferential,
    glam::{Affine3A, DAffine3, Mat3A, Vec3, Vec3A},
};
use umbrage_reyes::{LimitPoint, RatedSurface, SurfaceTracer, TraceOptions, TraceState};
use umbrage_scene::{Scene, Subdivision, SubdivisionRate};

/// Share of a surface's extent by which its box in world space is padded, far more than what transforms round.
const BOX_PADDING: f32 = 1e-5;

/// What was made of the surfaces so far.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub struct SurfaceWork {
    /// Patches of all surfaces.
    pub patches: u64,
    /// Grids diced, again after eviction; with rates chosen once, one for each patch.
    pub grids: u64,
    /// Micropolygons of these grids.
    pub micropolygons: u64,
    /// Grids dropped for room.
    pub evicted: u64,
    /// Bytes of surfaces, of their hierarchies, and of grids at their most.
    pub bytes: u64,
}

/// A surface in its own space.
struct TracedSurface {
    traced: SurfaceRates,
    /// First face of each object but the first.
    object_starts: Vec<u32>,
}

enum SurfaceRates {
    /// Rates by each ray's footprint; states that threads keep between rays.
    Footprint(SurfaceTracer, Mutex<Vec<TraceState>>),
    /// One rate a patch.
    Once(RatedSurface),
}

struct PlacedSurface {
    body: Arc<TracedSurface>,
    object_from_world: DAffine3,
    world_from_object: Affine3A,
    normal_matrix: Mat3A,
    /// Material of each object.
    materials: Vec<u32>,
}

/// All surfaces of a scene.
pub(super) struct Surfaces {
    placed: Vec<PlacedSurface>,
    bodies: Vec<Arc<TracedSurface>>,
    top: BoxBvh,
    bounds: Aabb,
}

/// A hit in the space of a surface.
struct Hit {
    t: f32,
    patch: u32,
    front: bool,
    limit: LimitPoint,
    /// Where rays on the side of the limit's normal, or on the other side, leave.
    leave: Vec3,
    /// Normal of the micropolygon, on the side of the limit's; that of the limit where it isn't known.
    face: Vec3,
}

impl TracedSurface {
    fn build(
        scene: &Scene,
        mesh: usize,
        subdivision: &Subdivision,
        mode: SurfaceMode,
        progress: Report<'_>,
    ) -> Result<Self, QueryError> {
        let failed = |source| QueryError::from_surface(&scene.meshes[mesh].name, source);
        let traced = match (mode, subdivision.rate) {
            (SurfaceMode::Footprint, SubdivisionRate::Pixels(pixels)) => {
                let surface = subdivide::traced_surface(subdivision).map_err(failed)?;
                let cache_bytes = usize::try_from(scene.settings.grid_cache.bytes()).unwrap_or(usize::MAX);
                let options = TraceOptions::default()
                    .with_edge(pixels)
                    .with_max_level(subdivide::MAX_LEVEL)
                    .with_cache_bytes(cache_bytes);
                let tracer = SurfaceTracer::new(surface, &options).map_err(failed)?;
                if !progress(1.0) {
                    return Err(QueryError::Cancelled);
                }
                SurfaceRates::Footprint(tracer, Mutex::default())
            }
            _ => SurfaceRates::Once(subdivide::rated(scene, mesh, subdivision, progress).map_err(failed)?),
        };
        let object_starts = subdivision.control.objects.iter().skip(1).map(|o| o.faces.start).collect();
        Ok(Self { traced, object_starts })
    }

    fn surface(&self) -> &umbrage_reyes::Surface {
        match &self.traced {
            SurfaceRates::Footprint(tracer, _) => tracer.surface(),
            SurfaceRates::Once(rated) => rated.surface(),
        }
    }

    /// Runs `job` with a state that no other thread has.
    fn with_state<T>(
        tracer: &SurfaceTracer,
        states: &Mutex<Vec<TraceState>>,
        stats: &mut impl Statistics,
        job: impl FnOnce(&mut TraceState) -> T,
    ) -> T {
        let kept = || states.lock().unwrap_or_else(|poisoned| poisoned.into_inner());
        let state = kept().pop();
        let mut state = state.unwrap_or_else(|| TraceState::new(tracer.options()));
        let before = state.grid_tests();
        let answer = job(&mut state);
        (before..state.grid_tests()).for_each(|_| stats.node(1));
        kept().push(state);
        answer
    }

    fn any_hit(&self, ray: &Ray, differential: &RayDifferential, stats: &mut impl Statistics) -> bool {
        match &self.traced {
            SurfaceRates::Footprint(tracer, states) => {
                Self::with_state(tracer, states, stats, |state| tracer.any_hit(ray, differential, state))
            }
            SurfaceRates::Once(rated) => rated.any_hit(ray),
        }
    }

    fn closest_hit(
        &self,
        ray: &Ray,
        differential: &RayDifferential,
        stats: &mut impl Statistics,
    ) -> Option<Hit> {
        match &self.traced {
            SurfaceRates::Footprint(tracer, states) => {
                let hit = Self::with_state(tracer, states, stats, |state| {
                    tracer.closest_hit(ray, differential, state)
                })?;
                let limit = tracer.limit(&hit);
                let side = if hit.front { limit.normal } else { -limit.normal };
                let leave = tracer.leave(&hit, side);
                Some(Hit { t: hit.t, patch: hit.patch, front: hit.front, limit, leave, face: limit.normal })
            }
            SurfaceRates::Once(rated) => {
                let hit = rated.closest_hit(ray)?;
                let [a, b, c] = rated.corners(&hit).map(|p| Vec3::from(p).as_dvec3());
                let face = (b - a).cross(c - a).normalize_or_zero();
                // On the micropolygon's plane, as exact as its corners.
                let along = ray.origin.as_dvec3() + f64::from(hit.hit.t) * ray.direction.as_dvec3();
                let leave = (along - face * (along - a).dot(face)).as_vec3();
                let (limit, face) = (rated.limit(&hit), face.as_vec3());
                let hit = hit.hit;
                Some(Hit { t: hit.t, patch: hit.patch, front: hit.front, limit, leave, face })
            }
        }
    }
}

impl PlacedSurface {
    fn object_ray(&self, ray: &Ray, differential: &RayDifferential) -> (Ray, RayDifferential) {
        let linear = |v: Vec3| (self.object_from_world.matrix3 * v.as_dvec3()).as_vec3();
        let differential = RayDifferential {
            d_origin: differential.d_origin.map(linear),
            d_direction: differential.d_direction.map(linear),
        };
        (object_ray(ray, &self.object_from_world), differential)
    }

    /// The hit as the integrator sees it.
    fn shading_point(&self, hit: &Hit, albedos: &[Vec3]) -> ShadingPoint {
        let world = |n: Vec3| {
            let n = if hit.front { n } else { -n };
            (self.normal_matrix * Vec3A::from(n)).normalize_or_zero()
        };
        let (shading, geometric) = (world(hit.limit.normal), world(hit.face));
        let leave = Vec3A::from(hit.leave);
        let m = &self.world_from_object.matrix3;
        let sum =
            m.x_axis.abs() * leave.x.abs() + m.y_axis.abs() * leave.y.abs() + m.z_axis.abs() * leave.z.abs();
        let face = self.body.surface().face_of(hit.patch).0;
        let object = self.body.object_starts.partition_point(|&start| start <= face);
        let agrees = shading.dot(geometric) > 0.0;
        ShadingPoint {
            point: self.world_from_object.transform_point3a(leave).into(),
            geometric_normal: geometric.into(),
            shading_normal: if agrees { shading } else { geometric }.into(),
            magnitude: 4.0 * (sum + self.world_from_object.translation.abs()).max_element(),
            albedo: albedos[self.materials[object] as usize],
            opacity: 1.0,
            t: hit.t,
            width: 0.0,
        }
    }
}

impl Surfaces {
    /// The surfaces of `scene`; its instances without them are left in the scene that is returned. `None` if there are none.
    /// `progress` gets growing fractions that end at exactly 1 if there are any, and returns `false` to cancel.
    pub(super) fn split(
        scene: &Scene,
        mode: SurfaceMode,
        progress: Report<'_>,
    ) -> Result<Option<(Self, Scene)>, QueryError> {
        let is_surface = |mesh: usize| scene.meshes[mesh].subdivision.is_some();
        if mode == SurfaceMode::Mesh || !scene.instances.iter().any(|instance| is_surface(instance.mesh)) {
            return Ok(None);
        }
        let is_placed = |mesh: usize| scene.instances.iter().any(|instance| instance.mesh == mesh);
        let count = (0..scene.meshes.len()).filter(|&mesh| is_surface(mesh) && is_placed(mesh)).count();
        let mut of_mesh: Vec<Option<Arc<TracedSurface>>> = vec![None; scene.meshes.len()];
        let mut placed = Vec::new();
        for instance in scene.instances.iter().filter(|instance| is_surface(instance.mesh)) {
            let body = match (&of_mesh[instance.mesh], &scene.meshes[instance.mesh].subdivision) {
                (Some(body), _) => Arc::clone(body),
                (None, Some(subdivision)) => {
                    let built = of_mesh.iter().flatten().count();
                    let mut progress = share_of(progress, built, count);
                    Arc::new(TracedSurface::build(scene, instance.mesh, subdivision, mode, &mut progress)?)
                }
                (None, None) => continue,
            };
            of_mesh[instance.mesh] = Some(Arc::clone(&body));
            let objects = objects_of(scene, instance);
            let singular = || QueryError::Build {
                object: instance.name.clone(),
                source: BuildError::TransformSingular { instance: placed.len() },
            };
            if objects.iter().any(|(_, depth)| *depth != OpticalDepth::OPAQUE) {
                let reason = "some surface is semi-transparent, which only surfaces as meshes can be";
                return Err(QueryError::Unsupported { method: mode.name(), reason });
            }
            placed.push(PlacedSurface {
                body,
                object_from_world: object_from_world(&instance.world_from_object).ok_or_else(singular)?,
                world_from_object: instance.world_from_object,
                normal_matrix: instance.world_from_object.matrix3.inverse().transpose(),
                materials: objects.into_iter().map(|(material, _)| material).collect(),
            });
        }
        let boxes: Vec<Aabb> = placed.iter().map(world_bounds).collect();
        let top = BoxBvh::build(&boxes, BuildQuality::High)
            .map_err(|source| QueryError::from_build("surfaces", source))?;
        let bounds = boxes.iter().fold(Aabb::EMPTY, |all, own| all.union(*own));
        let mut rest = scene.clone();
        rest.instances.retain(|instance| !is_surface(instance.mesh));
        let bodies = of_mesh.into_iter().flatten().collect();
        Ok(Some((Self { placed, bodies, top, bounds }, rest)))
    }

    pub(super) fn bounds(&self) -> Aabb {
        self.bounds
    }

    pub(super) fn work(&self) -> SurfaceWork {
        let mut work = SurfaceWork::default();
        for body in &self.bodies {
            let patches = body.surface().patch_count() as u64;
            work.patches += patches;
            work.bytes += body.surface().bytes() as u64;
            match &body.traced {
                SurfaceRates::Footprint(tracer, _) => {
                    let counts = tracer.counts();
                    work.grids += counts.dice;
                    work.micropolygons += counts.micropolygons;
                    work.evicted += counts.evicted;
                    work.bytes += (tracer.bvh_bytes() + tracer.peak_grid_bytes()) as u64;
                }
                SurfaceRates::Once(rated) => {
                    work.grids += patches;
                    work.micropolygons += rated.micropolygons();
                    work.bytes += rated.bytes() as u64;
                }
            }
        }
        work
    }

    /// Marks those of `rays` that a surface blocks.
    pub(super) fn block(
        &self,
        rays: &[Ray],
        differential: impl Fn(usize) -> RayDifferential,
        blocked: &mut [bool],
        stats: &mut impl Statistics,
    ) {
        if let [placed] = &self.placed[..]
            && let SurfaceRates::Once(rated) = &placed.body.traced
        {
            // Rays of one origin walk together.
            for (rays, blocked) in rays.chunks(FAN).zip(blocked.chunks_mut(FAN)) {
                let own: Vec<Ray> =
                    rays.iter().map(|ray| object_ray(ray, &placed.object_from_world)).collect();
                let mut hits = [false; FAN];
                rated.any_hits(&own, &mut hits[..own.len()]);
                blocked.iter_mut().zip(hits).for_each(|(blocked, hit)| *blocked |= hit);
            }
            return;
        }
        for (i, (ray, blocked)) in rays.iter().zip(blocked).enumerate() {
            if *blocked {
                continue;
            }
            let differential = differential(i);
            *blocked = self
                .top
                .walk(ray, |index| {
                    let placed = &self.placed[index as usize];
                    let (own, d) = placed.object_ray(ray, &differential);
                    if placed.body.any_hit(&own, &d, stats) {
                        return ControlFlow::Break(());
                    }
                    ControlFlow::Continue(ray.tfar)
                })
                .is_break();
        }
    }

    /// The nearest hit along `ray`.
    pub(super) fn closest_hit(
        &self,
        ray: &Ray,
        differential: &RayDifferential,
        albedos: &[Vec3],
        stats: &mut impl Statistics,
    ) -> Option<ShadingPoint> {
        let mut nearest: Option<(usize, Hit)> = None;
        let _ = self.top.walk(ray, |index| {
            let placed = &self.placed[index as usize];
            let (own, d) = placed.object_ray(ray, differential);
            if let Some(hit) = placed.body.closest_hit(&own, &d, stats) {
                let is_nearer = nearest.as_ref().is_none_or(|(known, old)| {
                    hit.t < old.t || (hit.t == old.t && (index as usize) < *known)
                });
                if is_nearer {
                    nearest = Some((index as usize, hit));
                }
            }
            ControlFlow::Continue(nearest.as_ref().map_or(ray.tfar, |(_, hit)| hit.t))
        });
        nearest.map(|(index, hit)| self.placed[index].shading_point(&hit, albedos))
    }
}

fn world_bounds(placed: &PlacedSurface) -> Aabb {
    let own = placed.body.surface().bounds();
    let corner = |i: u32| {
        let at = |axis: usize| if i >> axis & 1 == 0 { own.min[axis] } else { own.max[axis] };
        placed.world_from_object.transform_point3(Vec3::new(at(0), at(1), at(2)))
    };
    let bounds = (0..8).map(corner).fold(Aabb::EMPTY, |bounds, p| bounds.with_point(p.to_array()));
    let largest = bounds.min.abs().max(bounds.max.abs()).max_element();
    let padding = Vec3::splat(BOX_PADDING * (bounds.diagonal() + largest));
    Aabb { min: bounds.min - padding, max: bounds.max + padding }
}
