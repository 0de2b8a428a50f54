//! Running an engine over slices of receivers: order, threads, progress, outputs.

use crate::{MaskError, MaskOptions, Outputs, Pattern, Receiver};
use umbrage_geom::{Progress, glam::Vec3, morton, sampling::combine};

/// Receivers that a thread takes at a time, neighbours in Morton order.
const BLOCK: usize = 64;

/// Finds which rays of receivers are blocked.
pub(crate) trait Engine: Sync {
    /// What a thread keeps between blocks.
    type Scratch: Send;

    fn scratch(&self) -> Self::Scratch;

    /// Writes the masks of a block of receivers, [`Pattern::words`] words each.
    fn masks(&self, receivers: &[Receiver], masks: &mut [u64], scratch: &mut Self::Scratch);
}

/// Answers all receivers.
///
/// # Errors
/// As the public calls that lead here; the outputs are untouched then.
pub(crate) fn run<E: Engine>(
    engine: &E,
    pattern: &Pattern,
    options: &MaskOptions,
    receivers: &[Receiver],
    outputs: Outputs<'_>,
    progress: &mut (dyn FnMut(f32) -> bool + Send),
) -> Result<(), MaskError> {
    options.validate(pattern)?;
    outputs.validate(receivers.len(), pattern.words())?;
    let points: Vec<[f32; 3]> = receivers.iter().map(|receiver| receiver.point().to_array()).collect();
    let order = morton::order(&points);
    let progress = Progress::new(order.len().div_ceil(BLOCK) as u64, progress);
    let words = pattern.words();
    let masks = blocks(engine, receivers, &order, words, &progress)?;
    progress.finish()?;
    write(pattern, outputs, &masks, order.iter().map(|&i| (i as usize, Some(&receivers[i as usize]))));
    Ok(())
}

/// Writes outputs from `masks`, which are in the order of `receivers`: indices into the outputs, and receivers where there
/// are any.
pub(crate) fn write<'a>(
    pattern: &Pattern,
    outputs: Outputs<'_>,
    masks: &[u64],
    receivers: impl Iterator<Item = (usize, Option<&'a Receiver>)>,
) {
    let words = pattern.words();
    let Outputs { ao, masks: mut all_masks, mut bent_normals } = outputs;
    for ((i, receiver), mask) in receivers.zip(masks.chunks(words)) {
        ao[i] = openness(pattern, mask);
        if let Some(all) = &mut all_masks {
            all[i * words..][..words].copy_from_slice(mask);
        }
        if let Some(bent) = &mut bent_normals {
            bent[i] = receiver.map_or(Vec3::ZERO, |receiver| bent_normal(pattern, receiver, mask)).to_array();
        }
    }
}

/// Checked receivers; `i` has the seed `combine(seed, i)`.
///
/// # Errors
/// [`MaskError::Length`], [`MaskError::Point`], [`MaskError::Normal`].
pub(crate) fn receivers(
    points: &[[f32; 3]],
    normals: &[[f32; 3]],
    seed: u32,
) -> Result<Vec<Receiver>, MaskError> {
    if points.len() != normals.len() {
        let (actual, expected) = (normals.len(), points.len());
        return Err(MaskError::Length { what: "normals", actual, expected, points: expected });
    }
    let pairs = points.iter().zip(normals).enumerate();
    pairs.map(|(i, (&point, &normal))| Receiver::new(i, point, normal, combine(seed, i as u32))).collect()
}

/// Masks in the order of `order`.
fn blocks<E: Engine>(
    engine: &E,
    receivers: &[Receiver],
    order: &[u32],
    words: usize,
    progress: &Progress<'_>,
) -> Result<Vec<u64>, MaskError> {
    let mut masks = vec![0; order.len() * words];
    let job = |(scratch, block): &mut (E::Scratch, Vec<Receiver>), (order, masks): (&[u32], &mut [u64])| {
        progress.check()?;
        block.clear();
        block.extend(order.iter().map(|&i| receivers[i as usize]));
        engine.masks(block, masks, scratch);
        progress.advance(1)?;
        Ok::<(), MaskError>(())
    };
    let room = || (engine.scratch(), Vec::with_capacity(BLOCK));
    #[cfg(feature = "rayon")]
    {
        use rayon::prelude::*;
        let blocks = order.par_chunks(BLOCK).zip(masks.par_chunks_mut(BLOCK * words));
        blocks.map_init(room, job).collect::<Result<(), MaskError>>()?;
    }
    #[cfg(not(feature = "rayon"))]
    {
        let mut room = room();
        order
            .chunks(BLOCK)
            .zip(masks.chunks_mut(BLOCK * words))
            .try_for_each(|block| job(&mut room, block))?;
    }
    Ok(masks)
}

/// Fraction of rays whose bit is 0.
pub(crate) fn openness(pattern: &Pattern, mask: &[u64]) -> f32 {
    let blocked: u32 = mask.iter().map(|word| word.count_ones()).sum();
    (pattern.len() - blocked as usize) as f32 / pattern.len() as f32
}

/// Mean direction of the free rays, or the normal.
pub(crate) fn bent_normal(pattern: &Pattern, receiver: &Receiver, mask: &[u64]) -> Vec3 {
    let free = pattern.directions().iter().enumerate().filter(|&(i, _)| mask[i / 64] >> (i % 64) & 1 == 0);
    let sum: Vec3 = free.map(|(_, &d)| d).sum();
    pattern.frame_of(receiver).world_from_local(sum).try_normalize().unwrap_or(receiver.normal())
}
