//! Ambient occlusion by single rays: what a receiver sees of a white sky.
//!
//! Rays are those of [`umbrage_aomask::pattern`], the same that masks have. Falloff is sampled, not weighted: each ray is cut to a
//! length with the falloff's distribution ([`umbrage_geom::Falloff::length`]). The expected result is that of weighting the nearest hit, and any-hit queries and semi-transparent
//! occluders need no special case (there, "nearest hit" generalizes to every crossing weighted by its own distance).

use super::{
    Bake, BakeError, BakeOptions, Receivers,
    lobes::{self, LobeReceiver},
    receivers::check_count,
};
use rayon::prelude::*;
use umbrage_aomask::{Pattern, exact::adaptive::Spent};
use umbrage_geom::{Progress, morton};
use umbrage_image::Shard;
use umbrage_query::{Engine, LightRay, Sky};

/// Receivers that are computed together; they are neighbours in Morton order.
const BLOCK_RECEIVERS: usize = 64;

/// Rays that are traced together.
const MAX_BATCH_RAYS: usize = 1024;

/// Blocks of receivers, the most [`Shard`]s that `receivers` of them can be split into.
pub fn blocks(receivers: usize) -> usize {
    receivers.div_ceil(BLOCK_RECEIVERS)
}

/// [`crate::Bake`] by an engine that answers rays; says how many rays it took.
pub(super) fn bake_rays(
    call: &Bake<'_>,
    engine: &dyn Engine,
    sky: &Sky,
    ao: &mut [f32],
    progress: &mut (dyn FnMut(f32) -> bool + Send),
) -> Result<Spent, BakeError> {
    let &Bake { receivers, options, shard, .. } = call;
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
    let lobes = |&i: &u32| receivers.lobes(i as usize).len() as u64;
    let asked = mine.iter().flatten().map(lobes).sum();
    for (receiver, value) in mine.into_iter().flatten().zip(results.into_iter().flatten()) {
        ao[receiver as usize] = value;
    }
    Ok(Spent::uniform(options.rays, asked))
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
    let count = shard.count() as usize;
    if count > 1 && count > blocks {
        return Err(BakeError::Shard { count: shard.count(), blocks });
    }
    let order = morton::order(receivers.points());
    let first = shard.index() as usize - 1;
    Ok(order.chunks(BLOCK_RECEIVERS).skip(first).step_by(count).map(<[u32]>::to_vec).collect())
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
    let open = |asked: &LobeReceiver| -> Result<f32, BakeError> {
        let receiver = &asked.receiver;
        let Scratch { rays: batch, passed } = &mut *scratch;
        let directions = pattern.directions(pattern.member_of(receiver));
        let mut rays = pattern.rays_of(receiver, radius).zip(directions);
        let mut light = 0.0;
        loop {
            batch.clear();
            let next = rays.by_ref().take(MAX_BATCH_RAYS);
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
