//! Ambient occlusion by single rays: what a receiver sees of a white sky.
//!
//! Falloff is sampled, not weighted: each ray is cut to a random length with the falloff's distribution
//! ([`Falloff::length`]). The expected result is that of weighting the nearest hit, and any-hit queries and semi-transparent
//! occluders need no special case (there, "nearest hit" generalizes to every crossing weighted by its own distance).

use super::receivers::{Lobe, check_count};
use super::{BakeError, BakeExtras, BakeOptions, Jitter, Receivers, Shard, bake_with};
use crate::query::{Engine, LightRay, Occluders, QueryError};
use rayon::prelude::*;
use umbrage_geom::{
    Falloff, Frame, Progress, Ray,
    glam::{Vec2, Vec3},
    morton, offset_origin,
    sampling::{Rotation, combine, cosine_hemisphere, sobol_4d},
};

/// Receivers that are computed together; they are neighbours in Morton order.
const BLOCK: usize = 64;

/// Rays that are traced together.
const BATCH: usize = 1024;

/// Least height of a ray above the surface it starts on, as a cosine.
pub(super) const MIN_HEIGHT: f32 = 5e-4;

/// Steps of the table of ray lengths: what interpolation in it changes of `ao` is below 1 / 4096, where a falloff jumps, and
/// far below elsewhere. Asking [`Falloff::length`] for each ray took longer than tracing it (400 to 700 ns).
const LENGTHS: u16 = 4096;

/// Salt of the seed that turns patterns, so that it has nothing to do with the one that makes them.
const TURN: u32 = 0x7475_726e;

/// Blocks of receivers, the most [`Shard`]s that `receivers` of them can be split into.
pub fn blocks(receivers: usize) -> usize {
    receivers.div_ceil(BLOCK)
}

/// Computes `ao` of the receivers of `shard`: 1 where open, 0 where fully occluded (glTF's sense; the libraries' occlusion
/// is `1 - ao`).
///
/// `ao` has one element a receiver; those of other shards are left as they are, so that a slice filled with NaN and given
/// to every shard in turn ends up as the whole bake, bit for bit. Results depend on the arguments only, not on the number
/// of threads (rayon's current pool). `progress` gets growing fractions that end at exactly 1, from any thread, and returns
/// `false` to cancel.
///
/// Rays are cosine-weighted around the receiver's normal. Where that normal is a shading normal, rays that would start into
/// the receiver's own triangle are mirrored at its plane, so that convex surfaces stay exactly 1.
///
/// Methods with masks take one pattern of rays for all receivers, turned and tilted a little at random unless jitter is off.
///
/// # Errors
/// Those of [`BakeOptions::validate`]; [`BakeError::Query`] with the reason if the method can't answer; [`BakeError::Mask`] for a
/// number of rays that masks can't have; [`BakeError::TargetError`], [`BakeError::Length`], [`BakeError::Shard`],
/// [`BakeError::Cancelled`]. After an error `ao` is as it was.
pub fn bake(
    occluders: &Occluders,
    receivers: &Receivers,
    options: &BakeOptions,
    shard: Shard,
    ao: &mut [f32],
    progress: &mut (dyn FnMut(f32) -> bool + Send),
) -> Result<(), BakeError> {
    bake_with(occluders, receivers, options, shard, ao, BakeExtras::default(), progress).map(drop)
}

/// [`bake`] by an engine that answers rays.
pub(super) fn bake_rays(
    occluders: &Occluders,
    engine: &dyn Engine,
    receivers: &Receivers,
    options: &BakeOptions,
    shard: Shard,
    ao: &mut [f32],
    progress: &mut (dyn FnMut(f32) -> bool + Send),
) -> Result<(), BakeError> {
    let mine = shard_of(receivers, shard, ao)?;
    let integrator = Integrator::new(occluders.diagonal(), engine, receivers, options);
    let progress = Progress::new(mine.len() as u64, progress);
    let results = mine
        .par_iter()
        .map_init(Scratch::default, |scratch, block| {
            progress.check()?;
            let ao = |&i: &u32| integrator.ao(i as usize, scratch);
            let values: Vec<f32> = block.iter().map(ao).collect::<Result<_, QueryError>>()?;
            progress.advance(1)?;
            Ok(values)
        })
        .collect::<Result<Vec<_>, BakeError>>()?;
    progress.finish()?;
    for (receiver, value) in mine.into_iter().flatten().zip(results.into_iter().flatten()) {
        ao[receiver as usize] = value;
    }
    Ok(())
}

/// Blocks of receivers in Morton order that belong to `shard`.
///
/// # Errors
/// [`BakeError::Length`], [`BakeError::Count`], [`BakeError::Shard`].
pub(super) fn shard_of(receivers: &Receivers, shard: Shard, ao: &[f32]) -> Result<Vec<Vec<u32>>, BakeError> {
    if ao.len() != receivers.len() {
        return Err(BakeError::Length { what: "results", actual: ao.len(), expected: receivers.len() });
    }
    check_count(receivers.len())?;
    let blocks = blocks(receivers.len());
    let Shard { index, count } = shard;
    if index >= count || (count > 1 && count as usize > blocks) {
        return Err(BakeError::Shard { index, count, blocks });
    }
    let order = morton::order(receivers.points());
    Ok(order.chunks(BLOCK).skip(index as usize).step_by(count as usize).map(<[u32]>::to_vec).collect())
}

/// `direction`, mirrored at the plane with the normal `face` if it leads below.
pub(super) fn above(direction: Vec3, face: Vec3) -> Vec3 {
    let height = direction.dot(face);
    if height < MIN_HEIGHT {
        (direction + face * (height.abs().max(MIN_HEIGHT) - height)).normalize()
    } else {
        direction
    }
}

struct Integrator<'a> {
    engine: &'a dyn Engine,
    receivers: &'a Receivers,
    options: &'a BakeOptions,
    /// World units.
    radius: f32,
    /// Lengths in world units at evenly spaced random numbers from 0 to 1; empty if all have the radius.
    lengths: Vec<f32>,
    /// The one pattern of all receivers; empty if each has its own.
    shared: Vec<Sample>,
}

/// What tells the rays of a receiver apart.
#[derive(Clone, Copy)]
struct Sample {
    /// Around the z axis.
    direction: Vec3,
    /// Length, world units.
    length: f32,
    /// Random number in `[0, 1)` that chooses the lobe.
    lobe: f32,
}

#[derive(Default)]
struct Scratch {
    rays: Vec<LightRay>,
    passed: Vec<f32>,
}

impl<'a> Integrator<'a> {
    fn new(
        diagonal: f32,
        engine: &'a dyn Engine,
        receivers: &'a Receivers,
        options: &'a BakeOptions,
    ) -> Self {
        let radius = options.radius.resolve(diagonal);
        let length = |i| options.falloff.length(f32::from(i) / f32::from(LENGTHS)) * radius;
        let lengths = match options.falloff {
            Falloff::Constant => Vec::new(),
            _ => (0..=LENGTHS).map(length).collect(),
        };
        let mut integrator = Self { engine, receivers, options, radius, lengths, shared: Vec::new() };
        if options.jitter != Jitter::Pattern {
            integrator.shared = (0..options.rays).map(|i| integrator.sample(i, options.seed)).collect();
        }
        integrator
    }

    fn sample(&self, index: u32, seed: u32) -> Sample {
        let [x, y, u, lobe] = sobol_4d(index, 0, seed);
        let length = if self.lengths.is_empty() {
            self.radius
        } else {
            let at = u * f32::from(LENGTHS);
            let [low, high] = [self.lengths[at as usize], self.lengths[at as usize + 1]];
            low + (high - low) * at.fract()
        };
        Sample { direction: cosine_hemisphere(Vec2::new(x, y)), length, lobe }
    }

    fn ao(&self, receiver: usize, scratch: &mut Scratch) -> Result<f32, QueryError> {
        let lobes = self.receivers.lobes(receiver);
        if lobes.is_empty() {
            return Ok(1.0);
        }
        let seed = combine(self.options.seed, receiver as u32);
        let rotation = match self.options.jitter {
            Jitter::Rotation => Rotation::from_seed(seed ^ TURN),
            Jitter::Pattern | Jitter::Off => Rotation::NONE,
        };
        let rays = self.options.rays as usize;
        let mut light = 0.0;
        for start in (0..rays).step_by(BATCH) {
            let Scratch { rays: batch, passed } = &mut *scratch;
            batch.clear();
            let share = std::f32::consts::PI / rays as f32;
            batch.extend((start..rays.min(start + BATCH)).map(|i| {
                let sample = match self.shared.get(i) {
                    Some(sample) => Sample { direction: rotation.apply(sample.direction), ..*sample },
                    None => self.sample(i as u32, seed),
                };
                let ray = self.ray(receiver, Lobe::choose(lobes, sample.lobe), &sample);
                LightRay { ray, solid_angle: share / sample.direction.z.max(1e-3) }
            }));
            passed.clear();
            passed.resize(batch.len(), 1.0);
            self.engine.transmittances(batch, None, passed, None)?;
            light += passed.iter().map(|&x| f64::from(x)).sum::<f64>();
        }
        Ok((light / rays as f64) as f32)
    }

    fn ray(&self, receiver: usize, lobe: &Lobe, sample: &Sample) -> Ray {
        let direction = above(Frame::from_normal(lobe.normal).world_from_local(sample.direction), lobe.face);
        let magnitude = self.receivers.magnitudes[receiver];
        let origin =
            offset_origin(lobe.point, lobe.face, direction, magnitude) + lobe.face * self.options.bias;
        Ray::new(origin, direction).with_tfar(sample.length)
    }
}
