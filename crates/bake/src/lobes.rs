//! The lobes of receivers as what engines answer: one question a lobe.

use super::{BakeError, BakeOptions, Receivers, receivers::Lobe};
use umbrage_aomask::Receiver;
use umbrage_geom::{
    glam::Vec3,
    offset_origin,
    sampling::{combine, unit},
};
use umbrage_query::Pilot;

/// Tells the draw of a receiver's lobe apart from its rays.
const LOBE_DRAW_SALT: u32 = 0x6d61_736b;

/// A lobe of a receiver.
pub(super) struct LobeReceiver {
    pub receiver: Receiver,
    /// Index into the receivers of the shard.
    pub slot: usize,
    /// Share of the lobe in the receiver's answer.
    pub share: f32,
}

/// The lobes of the receivers `mine`. Lobes at the same place with the same normal have the same rays, whatever their index.
///
/// # Errors
/// [`BakeError::Mask`] for a point or normal that is not usable.
pub(super) fn asked(
    receivers: &Receivers,
    mine: &[u32],
    options: &BakeOptions,
) -> Result<Vec<LobeReceiver>, BakeError> {
    let mut asked = Vec::new();
    for (slot, &index) in mine.iter().enumerate() {
        let index = index as usize;
        let lobes = receivers.lobes(index);
        for (number, lobe) in lobes.iter().enumerate() {
            let origin = offset_origin(lobe.point, lobe.face, lobe.face, receivers.magnitudes[index])
                + lobe.face * options.bias;
            let seed = Receiver::seed_of(lobe.point.to_array(), lobe.normal.to_array(), options.seed);
            let receiver = Receiver::new(index, origin.to_array(), lobe.normal.to_array(), seed)?;
            let receiver = receiver.with_face(lobe.face.to_array());
            asked.push(LobeReceiver { receiver, slot, share: Lobe::share(lobes, number) });
        }
    }
    Ok(asked)
}

/// A sample of the receivers, for methods that look at one first; the same for every shard.
///
/// # Errors
/// Those of [`asked`].
pub(super) fn pilot(receivers: &Receivers, options: &BakeOptions) -> Result<Pilot, BakeError> {
    let some: Vec<u32> = Pilot::indices(receivers.len()).map(|i| i as u32).collect();
    Ok(Pilot::new(drawn(receivers, &some, options)?, receivers.len()))
}

/// A lobe of each of the receivers `some`, drawn by their shares; receivers without a direction have none.
///
/// # Errors
/// Those of [`asked`].
pub(super) fn drawn(
    receivers: &Receivers,
    some: &[u32],
    options: &BakeOptions,
) -> Result<Vec<Receiver>, BakeError> {
    let draw = |lobes: &[LobeReceiver]| {
        let mut left = unit(combine(lobes[0].receiver.seed(), LOBE_DRAW_SALT));
        let drawn = lobes.iter().find(|lobe| {
            left -= lobe.share;
            left < 0.0
        });
        drawn.unwrap_or(&lobes[lobes.len() - 1]).receiver
    };
    let asked = asked(receivers, some, options)?;
    Ok(asked.chunk_by(|a, b| a.slot == b.slot).map(draw).collect())
}

/// Means over the lobes of each of `count` receivers; receivers without a direction are open.
pub(super) fn means(asked: &[LobeReceiver], open: &[f32], count: usize) -> Vec<f32> {
    let mut means = vec![1.0; count];
    let mut last = usize::MAX;
    for (&LobeReceiver { slot, share, .. }, open) in asked.iter().zip(open) {
        if slot != last {
            means[slot] = 0.0;
        }
        means[slot] += share * open;
        last = slot;
    }
    means
}

/// Bent normals of each of `count` receivers from the free directions of their lobes: the mean normal where nothing passes.
pub(super) fn bent_normals(asked: &[LobeReceiver], free: &[[f32; 3]], count: usize) -> Vec<[f32; 3]> {
    let mut sums = vec![(Vec3::ZERO, Vec3::ZERO); count];
    for (&LobeReceiver { receiver, slot, share, .. }, &free) in asked.iter().zip(free) {
        sums[slot].0 += Vec3::from(free) * share;
        sums[slot].1 += receiver.normal() * share;
    }
    let unit = |(free, normal): (Vec3, Vec3)| free.try_normalize().unwrap_or(normal.normalize_or_zero());
    sums.into_iter().map(|sums| unit(sums).to_array()).collect()
}
