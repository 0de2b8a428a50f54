//! Baking by engines that answer receivers: all rays of a receiver at once.

use super::{
    Bake, BakeError,
    integrate::shard_of,
    lobes::{self, LobeReceiver},
};
use std::io::{self, Write};
use umbrage_aomask::{Outputs, Pattern, Receiver, exact::adaptive::Spent};
use umbrage_query::{Engine, QueryError};

/// [`Bake`] by an engine that answers receivers.
pub(super) fn bake_receivers(
    call: Bake<'_>,
    engine: &dyn Engine,
    radius: f32,
    ao: &mut [f32],
    progress: &mut (dyn FnMut(f32) -> bool + Send),
) -> Result<Spent, BakeError> {
    let Bake { receivers, options, shard, dump, bent_normals, .. } = call;
    if options.target_error.is_some() && dump.is_some() {
        return Err(BakeError::TargetError("receivers get different numbers of rays, which can't be listed"));
    }
    if let Some(bent) = bent_normals.as_ref().filter(|bent| bent.len() != receivers.len()) {
        let (actual, expected) = (bent.len(), receivers.len());
        return Err(BakeError::Length { what: "bent normals", actual, expected });
    }
    let mine: Vec<u32> = shard_of(receivers, shard, ao)?.concat();
    let pattern = engine
        .pattern()
        .ok_or(QueryError::Unsupported { method: engine.name(), reason: "it does not answer receivers" })?;
    let asked = lobes::asked(receivers, &mine, options)?;
    let of: Vec<Receiver> = asked.iter().map(|asked| asked.receiver).collect();
    let mut open = vec![1.0; of.len()];
    let mut masks = vec![0; if dump.is_some() { of.len() * pattern.words() } else { 0 }];
    let mut free = vec![[0.0; 3]; if bent_normals.is_some() { of.len() } else { 0 }];
    let mut outputs = Outputs::new(&mut open);
    if dump.is_some() {
        outputs = outputs.with_masks(&mut masks);
    }
    if bent_normals.is_some() {
        outputs = outputs.with_free_directions(&mut free);
    }
    let spent = engine.sky(&of, outputs, progress)?;
    if let Some(out) = dump {
        write_rays(&asked, &masks, pattern, radius, out).map_err(BakeError::Dump)?;
    }
    let means = lobes::means(&asked, &open, mine.len());
    mine.iter().zip(means).for_each(|(&i, open)| ao[i as usize] = open);
    if let Some(bent) = bent_normals {
        let all = lobes::bent_normals(&asked, &free, mine.len());
        mine.iter().zip(all).for_each(|(&i, one)| bent[i as usize] = one);
    }
    Ok(spent)
}

fn write_rays(
    asked: &[LobeReceiver],
    masks: &[u64],
    pattern: &Pattern,
    radius: f32,
    out: &mut dyn Write,
) -> io::Result<()> {
    for (asked, mask) in asked.iter().zip(masks.chunks(pattern.words())) {
        for (i, ray) in pattern.rays_of(&asked.receiver, radius).enumerate() {
            let [ox, oy, oz] = ray.origin.to_array();
            let [dx, dy, dz] = ray.direction.to_array();
            for x in [ox, oy, oz, ray.tnear, dx, dy, dz, ray.tfar] {
                out.write_all(&x.to_le_bytes())?;
            }
            out.write_all(&((mask[i / 64] >> (i % 64) & 1) as u32).to_le_bytes())?;
        }
    }
    out.flush()
}
