//! Method `mask`: the rays of a receiver walk the hierarchy together and get the bits of rays cast one by one.
//!
//! Here: blocks of receivers, walks that take turns. Not here: the call ([`crate::MaskCall`]), the walk (`walk.rs`), its tests (`kernel`), rays
//! (`rays.rs`).
//!
//! Exact: ray `i` of a receiver is blocked if and only if [`umbrage_geom::segment_hits_triangle`] holds for the ray of
//! [`Pattern::rays_of`] and some triangle.

pub mod adaptive;
pub mod fans;
mod goal;
mod kernel;
pub(crate) mod rays;
mod walk;

use crate::{
    BackEnd, MaskError, MaskOptions, Outputs, Pattern, Receiver, Sides, drive::Engine, gather::Answers,
};
use goal::{Blocked, Dimmed, Hit, Nearest};
use kernel::{Hull, Job, Kernel};
use rays::{GROUP, Part};
use umbrage_accel::Bvh;
use umbrage_geom::{OpticalDepth, Ray};
use walk::{Goal, Walk};

/// Walks that take turns, so that one works while others wait for memory.
const TURNS: usize = 8;

/// What a thread keeps.
pub(crate) type Walks = Box<[Walk]>;

/// What all receivers of a call share.
pub(crate) struct Masks<'a> {
    bvh: &'a Bvh,
    pub(crate) pattern: &'a Pattern,
    pub(crate) options: &'a MaskOptions,
    back_end: BackEnd,
    /// Whether distances are asked for.
    distances: bool,
    parts: Vec<Part<'a>>,
    /// Rays end there if they are longer, world units.
    limit: f32,
}

impl<'a> Masks<'a> {
    /// Rays end at `limit` (world units) if they are longer; those that can't walk needn't.
    pub(crate) fn new(
        bvh: &'a Bvh,
        pattern: &'a Pattern,
        options: &'a MaskOptions,
        limit: f32,
        back_end: BackEnd,
        outputs: &Outputs<'_>,
    ) -> Result<Self, MaskError> {
        if !back_end.is_supported() {
            return Err(MaskError::BackEnd(back_end));
        }
        options.validate(pattern)?;
        let distances = outputs.hit_distances.is_some();
        let parts = rays::parts(pattern, options.radius, limit);
        Ok(Self { bvh, pattern, options, back_end, distances, parts, limit })
    }

    fn run(&self, receivers: &[Receiver], goal: &mut impl Goal, out: &mut [u64], walks: &mut [Walk]) {
        out.fill(0);
        for part in &self.parts {
            kernel::run(self.back_end, Run { masks: self, part, receivers, goal, out, walks });
        }
    }

    /// Nearest hits, into masks and distances.
    fn run_nearest(&self, receivers: &[Receiver], answers: &mut Answers, walks: &mut [Walk]) {
        let Answers { masks, distances, .. } = answers;
        let (rays, words, sides) = (self.pattern.len(), self.pattern.words(), self.options.sides);
        let mut hits = vec![Hit::NONE; receivers.len() * rays];
        self.run(receivers, &mut Nearest { sides, hits: &mut hits }, masks, walks);
        masks.fill(0);
        distances.clear();
        for (i, hit) in hits.iter().enumerate() {
            let blocked = hit.blocks(sides);
            masks[i / rays * words + i % rays / 64] |= u64::from(blocked) << (i % rays % 64);
            distances.push(if blocked { hit.t } else { f32::INFINITY });
        }
    }
}

impl Engine for Masks<'_> {
    type Scratch = Walks;

    fn scratch(&self) -> Walks {
        (0..TURNS).map(|_| Walk::new()).collect()
    }

    fn answer(&self, receivers: &[Receiver], answers: &mut Answers, walks: &mut Walks) {
        let sides = self.options.sides;
        if self.distances || sides == Sides::FrontFirst {
            self.run_nearest(receivers, answers, walks);
        } else {
            self.run(receivers, &mut Blocked { sides }, &mut answers.masks, walks);
        }
    }
}

/// [`Masks`] among semi-transparent triangles.
pub(crate) struct DimmedMasks<'a, F> {
    masks: Masks<'a>,
    depth_of: F,
}

impl<'a, F: Fn(u32) -> OpticalDepth + Sync> DimmedMasks<'a, F> {
    /// Not for [`Sides::FrontFirst`]. `depth_of` tells what a crossing of the triangle with an index adds.
    pub(crate) fn new(masks: Masks<'a>, depth_of: F) -> Self {
        Self { masks, depth_of }
    }
}

impl<F: Fn(u32) -> OpticalDepth + Sync> Engine for DimmedMasks<'_, F> {
    type Scratch = Walks;

    fn scratch(&self) -> Walks {
        self.masks.scratch()
    }

    fn answer(&self, receivers: &[Receiver], answers: &mut Answers, walks: &mut Walks) {
        let Self { masks, depth_of } = self;
        if masks.distances {
            masks.run_nearest(receivers, answers, walks);
        }
        let mut sums = vec![OpticalDepth::CLEAR; receivers.len() * masks.pattern.len()];
        let mut goal = Dimmed { sides: masks.options.sides, sums: &mut sums, depth_of };
        masks.run(receivers, &mut goal, &mut answers.masks, walks);
        answers.passed.clear();
        answers.passed.extend(sums.into_iter().map(OpticalDepth::transmittance));
    }
}

/// One part of the rays of a block of receivers.
struct Run<'a, G> {
    masks: &'a Masks<'a>,
    part: &'a Part<'a>,
    receivers: &'a [Receiver],
    goal: &'a mut G,
    out: &'a mut [u64],
    walks: &'a mut [Walk],
}

impl<G: Goal> Job for Run<'_, G> {
    type Output = ();

    #[inline(always)]
    fn run<K: Kernel>(self, kernel: K) {
        let Self { masks, part, receivers, goal, out, walks } = self;
        let mut source = ByReceiver { masks, part, receivers, next: 0, out, mirrored: Vec::new() };
        take_turns(kernel, masks.bvh, walks, goal, &mut source);
    }
}

/// Receiver by receiver.
struct ByReceiver<'a> {
    masks: &'a Masks<'a>,
    part: &'a Part<'a>,
    receivers: &'a [Receiver],
    next: usize,
    out: &'a mut [u64],
    /// Rays of a receiver with a face.
    mirrored: Vec<Ray>,
}

impl<G: Goal> Source<G> for ByReceiver<'_> {
    #[inline(always)]
    fn start(&mut self, walk: &mut Walk) -> bool {
        let Self { masks: Masks { pattern, options, limit, .. }, part, receivers, next, mirrored, .. } = self;
        let Some(receiver) = receivers.get(*next) else { return false };
        let first = *next * pattern.len() + part.first();
        *next += 1;
        if receiver.face().is_some() {
            let rays = pattern.rays_of(receiver, options.radius).skip(part.first()).take(part.len());
            mirrored.clear();
            mirrored.extend(rays.map(|ray| ray.with_tfar(ray.tfar.min(*limit))));
            walk.part = None;
            walk.rays.load(mirrored);
            walk.start(first, receiver.point().to_array(), fans::hull(mirrored));
            return true;
        }
        let (frame, member) = (pattern.frame_of(receiver), pattern.member_of(receiver));
        if G::SHRINKS || part.has_many_ends() || walk.part != Some(part.first()) {
            part.begin(member, &mut walk.rays);
            walk.part = Some(part.first());
        }
        part.turn(member, &frame, &mut walk.rays);
        let cone = part.cone(member);
        let axis = frame.world_from_local(cone.axis).to_array();
        let hull = Hull::new(part.reach(member), frame.normal.to_array(), axis, cone.angle);
        walk.start(first, receiver.point().to_array(), hull);
        true
    }

    #[inline(always)]
    fn end(&mut self, walk: &Walk, goal: &mut G) {
        let Self { masks: Masks { bvh, pattern, options, .. }, part, receivers, out, .. } = self;
        let (words, receiver) = (pattern.words(), walk.item / pattern.len());
        let out = &mut out[receiver * words..][..words];
        write(walk, part, out);
        alone(bvh, pattern, options, part, &receivers[receiver], walk, goal, out);
    }
}

/// Where walks get their rays. A trait, since closures would not be compiled with the caller's instructions.
trait Source<G> {
    /// Puts new rays into a walk; false if there are no more.
    fn start(&mut self, walk: &mut Walk) -> bool;

    /// Sees a walk that has ended.
    fn end(&mut self, walk: &Walk, goal: &mut G);
}

/// Lets walks take turns, one step each, while `source` puts new rays into those that have ended.
#[inline(always)]
fn take_turns<K: Kernel, G: Goal>(
    kernel: K,
    bvh: &Bvh,
    walks: &mut [Walk],
    goal: &mut G,
    source: &mut impl Source<G>,
) {
    let mut turns: [usize; TURNS] = std::array::from_fn(|i| i);
    let (mut busy, mut more) = (0, true);
    loop {
        while busy < TURNS && more {
            more = source.start(&mut walks[turns[busy]]);
            busy += usize::from(more);
        }
        if busy == 0 {
            return;
        }
        let mut turn = 0;
        while turn < busy {
            let walk = &mut walks[turns[turn]];
            if walk.step(kernel, bvh, goal) {
                turn += 1;
            } else {
                source.end(walk, goal);
                busy -= 1;
                turns.swap(turn, busy);
            }
        }
    }
}

/// Puts the bits of a walk that has ended into the mask of its receiver.
#[inline(always)]
fn write(walk: &Walk, part: &Part<'_>, out: &mut [u64]) {
    for g in 0..part.len() / GROUP {
        let bits = walk.done[g] & !walk.rays.closed[g];
        let at = part.first() + g * GROUP;
        out[at / 64] |= u64::from(bits) << (at % 64);
    }
}

/// Answers rays that could not walk.
#[inline(always)]
#[allow(clippy::too_many_arguments)] // the state of one call
fn alone(
    bvh: &Bvh,
    pattern: &Pattern,
    options: &MaskOptions,
    part: &Part<'_>,
    receiver: &Receiver,
    walk: &Walk,
    goal: &mut impl Goal,
    out: &mut [u64],
) {
    if walk.rays.closed[..part.len() / GROUP].iter().all(|&closed| closed == 0) {
        return;
    }
    for (i, ray) in pattern.rays_of(receiver, options.radius).enumerate().skip(part.first()).take(part.len())
    {
        let at = i - part.first();
        if walk.rays.closed[at / GROUP] >> (at % GROUP) & 1 == 1 {
            out[i / 64] |= u64::from(goal.alone(bvh, walk.item + at, &ray)) << (i % 64);
        }
    }
}
