//! Fans: any rays that share an origin, answered together and exactly.
//!
//! Rays to the points of an area light are one use. A fan has up to [`MAX_FAN`] rays; neighbours in a fan should be close in
//! direction, eight and thirty-two of them best of all: the answers are the same in any order, but a good one is faster.
//!
//! Narrow fans, as those to most lights, gain nothing from groups: blocks of rays whose first fan is narrow are left to
//! [`Bvh::any_hits`] and [`Bvh::transmittances`], which walk with 32 rays.

use super::{
    Source, TURNS,
    goal::{Blocked, Dimmed, Hit, Nearest},
    kernel::{self, Hull, Job, Kernel},
    rays::{Cone, GROUP, GROUPS, RAYS, unit},
    take_turns,
    walk::{Goal, Walk},
};
use crate::{BackEnd, MaskError, Sides};
use umbrage_accel::Bvh;
use umbrage_geom::{OpticalDepth, Ray, glam::Vec3};

/// Most rays of a fan.
pub const MAX_FAN: usize = 1024;

/// Cosine of the half-angle below which a fan is narrow: 45 degrees.
const NARROW_FAN_COSINE: f32 = 0.7;

/// Rays that a thread takes at a time, at least.
const BLOCK: usize = 1 << 12;

/// Rays in fans that ask together.
#[derive(Clone, Copy)]
#[must_use = "nothing is answered before `any_hits` or `transmittances`"]
pub struct FanCall<'a> {
    bvh: &'a Bvh,
    rays: &'a [Ray],
    per_fan: usize,
    sides: Sides,
    back_end: BackEnd,
}

impl<'a> FanCall<'a> {
    /// Every `per_fan` of `rays` in turn share an origin. Rays that are not [valid](Ray::is_valid) hit nothing. Both sides of the
    /// triangles of `bvh` block, on [`BackEnd::best`].
    pub fn new(bvh: &'a Bvh, rays: &'a [Ray], per_fan: usize) -> Self {
        Self { bvh, rays, per_fan, sides: Sides::Both, back_end: BackEnd::best() }
    }

    /// Sets which sides of triangles block.
    pub fn with_sides(self, sides: Sides) -> Self {
        Self { sides, ..self }
    }

    /// Runs on another back end. Answers are the same.
    pub fn with_back_end(self, back_end: BackEnd) -> Self {
        Self { back_end, ..self }
    }

    /// Which rays are blocked: `hits[i]` tells of ray `i`, exactly as rays cast one by one.
    ///
    /// # Errors
    /// [`MaskError::Fan`], [`MaskError::FanOrigin`], [`MaskError::Answers`], [`MaskError::BackEnd`]. `hits` is as it was then.
    pub fn any_hits(self, hits: &mut [bool]) -> Result<(), MaskError> {
        let Self { bvh, rays, per_fan, sides, back_end } = self;
        check(rays, per_fan, back_end, hits.len())?;
        let job = |walks: &mut Box<[Walk]>, (rays, hits): (&[Ray], &mut [bool])| {
            if sides == Sides::Both && is_narrow(&rays[..per_fan]) {
                return bvh.any_hits_with(rays, hits, &mut ());
            }
            kernel::run(back_end, AnyHits { bvh, rays, per_fan, sides, hits, walks });
        };
        in_blocks(rays, per_fan, hits, job);
        Ok(())
    }

    /// What all triangles hit by each ray let through: the sum of `depth_of(index of the triangle)`, each triangle once,
    /// [`OpticalDepth::OPAQUE`] as soon as nothing gets through.
    ///
    /// # Errors
    /// As for [`Self::any_hits`]; [`MaskError::Unsupported`] for [`Sides::FrontFirst`].
    pub fn transmittances(
        self,
        depth_of: impl Fn(u32) -> OpticalDepth + Sync,
        sums: &mut [OpticalDepth],
    ) -> Result<(), MaskError> {
        let Self { bvh, rays, per_fan, sides, back_end } = self;
        check(rays, per_fan, back_end, sums.len())?;
        if sides == Sides::FrontFirst {
            return Err(MaskError::Unsupported("fronts before any back among semi-transparent triangles"));
        }
        let depth_of = &depth_of;
        let job = |walks: &mut Box<[Walk]>, (rays, sums): (&[Ray], &mut [OpticalDepth])| {
            if sides == Sides::Both && is_narrow(&rays[..per_fan]) {
                return bvh.transmittances_with(rays, depth_of, sums, &mut ());
            }
            kernel::run(back_end, Transmittances { bvh, rays, per_fan, sides, depth_of, sums, walks });
        };
        in_blocks(rays, per_fan, sums, job);
        Ok(())
    }
}

fn check(rays: &[Ray], per_fan: usize, back_end: BackEnd, answers: usize) -> Result<(), MaskError> {
    if !back_end.is_supported() {
        return Err(MaskError::BackEnd(back_end));
    }
    if per_fan == 0 || per_fan > MAX_FAN || !rays.len().is_multiple_of(per_fan) {
        return Err(MaskError::Fan { per_fan, rays: rays.len() });
    }
    if rays.len() != answers {
        return Err(MaskError::Answers { answers, rays: rays.len() });
    }
    let bits = |ray: &Ray| ray.origin.to_array().map(f32::to_bits);
    let same = |fan: &[Ray]| fan.iter().all(|ray| bits(ray) == bits(&fan[0]));
    match rays.chunks(per_fan).position(|fan| !same(fan)) {
        Some(fan) => Err(MaskError::FanOrigin { fan }),
        None => Ok(()),
    }
}

/// Whether a fan is so narrow that the hierarchy's own batches answer it, and those after it, sooner (`docs/aomask-exact.md`).
fn is_narrow(fan: &[Ray]) -> bool {
    hull(fan).angle[0] > NARROW_FAN_COSINE
}

/// Calls `job` with blocks of whole fans, on all threads of the caller's pool.
fn in_blocks<A: Send>(
    rays: &[Ray],
    per_fan: usize,
    answers: &mut [A],
    job: impl Fn(&mut Box<[Walk]>, (&[Ray], &mut [A])) + Sync + Send,
) {
    let size = BLOCK.next_multiple_of(per_fan);
    let room = || -> Box<[Walk]> { (0..TURNS).map(|_| Walk::new()).collect() };
    #[cfg(feature = "rayon")]
    {
        use rayon::prelude::*;
        rays.par_chunks(size).zip(answers.par_chunks_mut(size)).for_each_init(room, job);
    }
    #[cfg(not(feature = "rayon"))]
    {
        let mut walks = room();
        rays.chunks(size).zip(answers.chunks_mut(size)).for_each(|block| job(&mut walks, block));
    }
}

/// Where the rays of a walk can get.
#[inline(always)]
pub(super) fn hull(rays: &[Ray]) -> Hull {
    let valid = rays.iter().filter(|ray| ray.is_valid());
    let reach = valid.clone().map(|ray| f64::from(ray.tfar) * ray.direction.as_dvec3().length());
    let reach = reach.fold(0f64, f64::max).min(f64::INFINITY) as f32;
    let cone = Cone::around(valid.map(|ray| unit(ray.direction)));
    // Without a half-space that holds all of them, the plane culls nothing.
    let up = if cone.angle[0] > 0.0 { cone.axis } else { Vec3::ZERO };
    Hull::new(reach, up.to_array(), cone.axis.to_array(), cone.angle)
}

/// Fan by fan; writes what is blocked.
struct ByFan<'a, F> {
    bvh: &'a Bvh,
    rays: &'a [Ray],
    per_fan: usize,
    next: usize,
    /// Told the number of each blocked ray.
    blocked: F,
}

impl<G: Goal, F: FnMut(usize)> Source<G> for ByFan<'_, F> {
    #[inline(always)]
    fn start(&mut self, walk: &mut Walk) -> bool {
        if self.next == self.rays.len() {
            return false;
        }
        let part = &self.rays[self.next..self.next + self.len(self.next)];
        walk.part = None;
        walk.rays.load(part);
        walk.start(self.next, part[0].origin.to_array(), hull(part));
        self.next += part.len();
        true
    }

    #[inline(always)]
    fn end(&mut self, walk: &Walk, goal: &mut G) {
        let first = walk.item;
        for i in 0..self.len(first) {
            let bit = |of: &[u8; GROUPS]| of[i / GROUP] >> (i % GROUP) & 1 == 1;
            let walked = !bit(&walk.rays.closed);
            if if walked { bit(&walk.done) } else { goal.alone(self.bvh, first + i, &self.rays[first + i]) } {
                (self.blocked)(first + i);
            }
        }
    }
}

impl<F> ByFan<'_, F> {
    /// Rays of the walk whose first ray is `first`.
    #[inline(always)]
    fn len(&self, first: usize) -> usize {
        (self.per_fan - first % self.per_fan).min(RAYS)
    }
}

struct AnyHits<'a> {
    bvh: &'a Bvh,
    rays: &'a [Ray],
    per_fan: usize,
    sides: Sides,
    hits: &'a mut [bool],
    walks: &'a mut [Walk],
}

impl Job for AnyHits<'_> {
    type Output = ();

    #[inline(always)]
    fn run<K: Kernel>(self, kernel: K) {
        let Self { bvh, rays, per_fan, sides, hits, walks } = self;
        if sides == Sides::FrontFirst {
            let mut nearest = vec![Hit::NONE; rays.len()];
            let mut source = ByFan { bvh, rays, per_fan, next: 0, blocked: |_| {} };
            take_turns(kernel, bvh, walks, &mut Nearest { sides, hits: &mut nearest }, &mut source);
            hits.iter_mut().zip(nearest).for_each(|(blocked, hit)| *blocked = hit.blocks(sides));
            return;
        }
        hits.fill(false);
        let mut source = ByFan { bvh, rays, per_fan, next: 0, blocked: |ray: usize| hits[ray] = true };
        take_turns(kernel, bvh, walks, &mut Blocked { sides }, &mut source);
    }
}

struct Transmittances<'a, F> {
    bvh: &'a Bvh,
    rays: &'a [Ray],
    per_fan: usize,
    sides: Sides,
    depth_of: &'a F,
    sums: &'a mut [OpticalDepth],
    walks: &'a mut [Walk],
}

impl<F: Fn(u32) -> OpticalDepth> Job for Transmittances<'_, F> {
    type Output = ();

    #[inline(always)]
    fn run<K: Kernel>(self, kernel: K) {
        let Self { bvh, rays, per_fan, sides, depth_of, sums, walks } = self;
        sums.fill(OpticalDepth::CLEAR);
        let mut goal = Dimmed { sides, sums, depth_of };
        let mut source = ByFan { bvh, rays, per_fan, next: 0, blocked: |_| {} };
        take_turns(kernel, bvh, walks, &mut goal, &mut source);
        for sum in sums.iter_mut().filter(|sum| sum.is_opaque()) {
            *sum = OpticalDepth::OPAQUE;
        }
    }
}
