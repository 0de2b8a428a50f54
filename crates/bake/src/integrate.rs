//! Ambient occlusion by single rays: what a receiver sees of a white sky.
//!
//! Rays are those of [`umbrage_aomask::pattern`], the same that masks have. Falloff is sampled, not weighted: each ray is cut to a
//! length with the falloff's distribution ([`umbrage_geom::Falloff::length`]). The expected result is that of weighting the nearest hit, and any-hit queries and semi-transparent
//! occluders need no special case (there, "nearest hit" generalizes to every crossing weighted by its own distance).

use super::{
    BakeError, BakeExtras, BakeOptions, Receivers, Shard, bake_with,
    lobes::{self, Asked},
    receivers::check_count,
};
use rayon::prelude::*;
use umbrage_aomask::Pattern;
use umbrage_geom::{Progress, morton};
use umbrage_query::{Engine, LightRay, Occluders, Sky};

/// Receivers that are computed together; they are neighbours in Morton order.
const BLOCK: usize = 64;

/// Rays that are traced together.
const BATCH: usize = 1024;

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
/// The mean of `ao` over seeds is openness without bias for any number of rays; vertices at the same place with the same normal
/// get the same `ao`.
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
    engine: &dyn Engine,
    sky: &Sky,
    receivers: &Receivers,
    options: &BakeOptions,
    shard: Shard,
    ao: &mut [f32],
    progress: &mut (dyn FnMut(f32) -> bool + Send),
) -> Result<(), BakeError> {
    let mine = shard_of(receivers, shard, ao)?;
    let pattern = Pattern::new(&sky.pattern)?;
    let progress = Progress::new(mine.len() as u64, progress);
    let results = mine
        .par_iter()
        .map_init(Scratch::default, |scratch, block| {
            progress.check()?;
            let values = block_ao(engine, (&pattern, sky.radius), receivers, options, block, scratch)?;
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

/// Rays of a receiver that are traced together, and what passed.
#[derive(Default)]
struct Scratch {
    rays: Vec<LightRay>,
    passed: Vec<f32>,
}

/// `ao` of the receivers of a block.
fn block_ao(
    engine: &dyn Engine,
    (pattern, radius): (&Pattern, f32),
    receivers: &Receivers,
    options: &BakeOptions,
    block: &[u32],
    scratch: &mut Scratch,
) -> Result<Vec<f32>, BakeError> {
    let asked = lobes::asked(receivers, block, options)?;
    let open = |asked: &Asked| -> Result<f32, BakeError> {
        let receiver = &asked.receiver;
        let Scratch { rays: batch, passed } = &mut *scratch;
        let directions = pattern.directions(pattern.member_of(receiver));
        let mut rays = pattern.rays_of(receiver, radius).zip(directions);
        let mut light = 0.0;
        loop {
            batch.clear();
            let next = rays.by_ref().take(BATCH);
            batch.extend(next.map(|(ray, &d)| LightRay::new(ray, pattern.solid_angle(d))));
            if batch.is_empty() {
                return Ok((light / pattern.len() as f64) as f32);
            }
            passed.clear();
            passed.resize(batch.len(), 1.0);
            engine.transmittances(batch, None, passed, None)?;
            light += passed.iter().map(|&x| f64::from(x)).sum::<f64>();
        }
    };
    let open = asked.iter().map(open).collect::<Result<Vec<_>, _>>()?;
    Ok(lobes::means(&asked, &open, block.len()))
}
