#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

pub mod baked;
mod error;
mod integrate;
mod lobes;
mod mask;
mod options;
mod receivers;
mod texel;

#[cfg(test)]
mod tests;

pub use error::BakeError;
pub use integrate::{bake, blocks};
pub use options::{BakeOptions, Jitter, NormalSource, Shard};
pub use receivers::Receivers;
pub use texel::{TexelImage, TexelMap, VAxis};

use std::io::Write;
use umbrage_aomask::exact::adaptive::Spent;
use umbrage_query::{Answers, Occluders, QueryError, engine};

/// What [`bake_with`] gives besides openness, by methods with masks.
#[derive(Default)]
pub struct BakeExtras<'d, 'b> {
    /// Gets every ray in the order of receivers: 36 bytes each, little-endian `f32`s origin, `tnear`, direction, `tfar`, and
    /// a `u32` that is 1 if nothing passed.
    pub dump: Option<&'d mut dyn Write>,
    /// One for each receiver, of unit length: the mean of the rays' directions, each as often as it is free. The mean normal
    /// where nothing passes, zero for receivers without a direction; those of other shards stay as they are.
    pub bent_normals: Option<&'b mut [[f32; 3]]>,
}

/// [`bake`] with more results; says how many rays it took.
///
/// # Errors
/// Those of [`bake`]; [`BakeError::Query`] if a method without masks is asked for more than `ao`; [`BakeError::Dump`]. After an
/// error `ao` and bent normals are as they were.
pub fn bake_with(
    occluders: &Occluders,
    receivers: &Receivers,
    options: &BakeOptions,
    shard: Shard,
    ao: &mut [f32],
    extras: BakeExtras<'_, '_>,
    progress: &mut (dyn FnMut(f32) -> bool + Send),
) -> Result<Spent, BakeError> {
    options.validate()?;
    let sky = options.sky(occluders.diagonal());
    let engine = engine::sky(options.method, occluders, &sky, &mut |_| progress(0.0))?;
    let engine = &*engine;
    match engine.answers() {
        Answers::Receivers => {
            mask::bake_receivers(engine, sky.radius, receivers, options, shard, (ao, extras), progress)
        }
        Answers::Rays if extras.dump.is_none() && extras.bent_normals.is_none() => {
            integrate::bake_rays(engine, &sky, receivers, options, shard, ao, progress)?;
            let part = integrate::shard_of(receivers, shard, ao)?;
            let lobes = |&i: &u32| receivers.lobes(i as usize).len() as u64;
            let count: u64 = part.iter().flatten().map(lobes).sum();
            Ok(Spent::uniform(options.rays, count))
        }
        _ => {
            let reason = "rays and bent normals are written by methods with masks";
            Err(QueryError::Unsupported { method: options.method.name(), reason }.into())
        }
    }
}
