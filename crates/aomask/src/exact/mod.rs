//! Method `mask`: the rays of a receiver walk the hierarchy together and get the bits of rays cast one by one.
//!
//! Here: the call that answers receivers, walks that take turns. Not here: the walk (`walk.rs`), its tests (`kernel`), rays
//! (`rays.rs`).
//!
//! Exact: ray `i` of a receiver is blocked if and only if [`umbrage_geom::segment_hits_triangle`] holds for the ray of
//! [`Pattern::rays_of`] and some triangle.

pub mod fans;
mod goal;
mod kernel;
mod rays;
mod walk;

use crate::{
    BackEnd, MaskError, MaskOptions, Outputs, Pattern, Receiver,
    drive::{self, Engine},
};
use goal::{Blocked, any_hit};
use kernel::{Hull, Job, Kernel};
use rays::{GROUP, Part};
use umbrage_accel::Bvh;
use walk::{Goal, Walk};

/// Walks that take turns, so that one works while others wait for memory.
const TURNS: usize = 8;

/// Ambient occlusion of receivers at `points` (world units, see [`Receiver::new`]) that look along `normals` among the
/// triangles of `bvh`. Results depend on the arguments only, not on threads or `back_end`. `progress` gets growing fractions
/// that end at exactly 1, from any thread, and returns `false` to cancel.
///
/// # Errors
/// [`MaskError::Radius`], [`MaskError::FalloffWithoutRadius`], [`MaskError::Length`], [`MaskError::Point`],
/// [`MaskError::Normal`], [`MaskError::BackEnd`], [`MaskError::Cancelled`]. The outputs are as they were then.
#[allow(clippy::too_many_arguments)] // what there is to say
pub fn answer(
    bvh: &Bvh,
    pattern: &Pattern,
    points: &[[f32; 3]],
    normals: &[[f32; 3]],
    options: &MaskOptions,
    back_end: BackEnd,
    outputs: Outputs<'_>,
    progress: &mut (dyn FnMut(f32) -> bool + Send),
) -> Result<(), MaskError> {
    if !back_end.is_supported() {
        return Err(MaskError::BackEnd(back_end));
    }
    options.validate(pattern)?;
    let receivers = drive::receivers(points, normals, options.seed)?;
    let parts = rays::parts(pattern, options.radius);
    let engine = Masks { bvh, pattern, options, back_end, parts };
    drive::run(&engine, pattern, options, &receivers, outputs, progress)
}

/// What all receivers of a call share.
struct Masks<'a> {
    bvh: &'a Bvh,
    pattern: &'a Pattern,
    options: &'a MaskOptions,
    back_end: BackEnd,
    parts: Vec<Part>,
}

impl Engine for Masks<'_> {
    type Scratch = Box<[Walk]>;

    fn scratch(&self) -> Box<[Walk]> {
        (0..TURNS).map(|_| Walk::new()).collect()
    }

    fn masks(&self, receivers: &[Receiver], masks: &mut [u64], walks: &mut Box<[Walk]>) {
        for (p, part) in self.parts.iter().enumerate() {
            kernel::run(
                self.back_end,
                Run { masks: self, part, first: p == 0, receivers, out: masks, walks },
            );
        }
    }
}

/// One part of the rays of a block of receivers.
struct Run<'a> {
    masks: &'a Masks<'a>,
    part: &'a Part,
    /// Whether the output has to be cleared.
    first: bool,
    receivers: &'a [Receiver],
    out: &'a mut [u64],
    walks: &'a mut [Walk],
}

impl Job for Run<'_> {
    type Output = ();

    #[inline(always)]
    fn run<K: Kernel>(self, kernel: K) {
        let Self { masks: &Masks { bvh, pattern, options, .. }, part, first, receivers, out, walks } = self;
        let words = pattern.words();
        if first {
            out.fill(0);
        }
        for walk in walks.iter_mut().filter(|walk| walk.part != Some(part.first)) {
            part.begin(&mut walk.rays);
            walk.part = Some(part.first);
        }
        let mut goal = Blocked { sides: options.sides };
        let mut next = 0;
        let start = |walk: &mut Walk| {
            let Some(receiver) = receivers.get(next) else { return false };
            let frame = pattern.frame_of(receiver);
            part.turn(&frame, &mut walk.rays);
            let axis = frame.world_from_local(part.cone.axis).to_array();
            let hull = Hull::new(part.reach, frame.normal.to_array(), axis, part.cone.angle);
            walk.start(next, receiver.point().to_array(), hull);
            next += 1;
            true
        };
        let end = |walk: &Walk| {
            let out = &mut out[walk.item * words..][..words];
            write(walk, part, out);
            alone(bvh, pattern, options, part, &receivers[walk.item], walk, out);
        };
        take_turns(kernel, bvh, walks, &mut goal, start, end);
    }
}

/// Lets walks take turns, one step each, while `start` puts new rays into those that have ended. `start` returns false when
/// there are no more; `end` sees each walk that has ended.
#[inline(always)]
fn take_turns<K: Kernel>(
    kernel: K,
    bvh: &Bvh,
    walks: &mut [Walk],
    goal: &mut impl Goal,
    mut start: impl FnMut(&mut Walk) -> bool,
    mut end: impl FnMut(&Walk),
) {
    let mut turns: [usize; TURNS] = std::array::from_fn(|i| i);
    let (mut busy, mut more) = (0, true);
    loop {
        while busy < TURNS && more {
            more = start(&mut walks[turns[busy]]);
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
                end(walk);
                busy -= 1;
                turns.swap(turn, busy);
            }
        }
    }
}

/// Puts the bits of a walk that has ended into the mask of its receiver.
#[inline(always)]
fn write(walk: &Walk, part: &Part, out: &mut [u64]) {
    for g in 0..part.len / GROUP {
        let bits = walk.done[g] & !walk.rays.closed[g];
        let at = part.first + g * GROUP;
        out[at / 64] |= u64::from(bits) << (at % 64);
    }
}

/// Answers rays that could not walk.
#[inline(always)]
fn alone(
    bvh: &Bvh,
    pattern: &Pattern,
    options: &MaskOptions,
    part: &Part,
    receiver: &Receiver,
    walk: &Walk,
    out: &mut [u64],
) {
    if walk.rays.closed[..part.len / GROUP].iter().all(|&closed| closed == 0) {
        return;
    }
    for (i, ray) in pattern.rays_of(receiver, options.radius).enumerate().skip(part.first).take(part.len) {
        let at = i - part.first;
        if walk.rays.closed[at / GROUP] >> (at % GROUP) & 1 == 1 {
            out[i / 64] |= u64::from(any_hit(bvh, &ray, options.sides)) << (i % 64);
        }
    }
}
