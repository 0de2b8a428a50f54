//! Baking with the table method of `umbrage-aomask`: all rays of a receiver at once, approximately.

use super::receivers::Lobe;
use super::{BakeError, BakeOptions, Jitter, Occluders, Receivers, Shard, Sides, integrate::shard_of};
use std::io::{self, Write};
use umbrage_aomask as aomask;
use umbrage_geom::{offset_origin, sampling::combine};

/// Computes `ao` of the receivers of `shard` by [`aomask::MaskTables`], as [`super::bake`] does by exact rays. Errors of that
/// method are in `docs/aomask.md`.
///
/// Every receiver has the same pattern of rays, turned and tilted a little at random unless jitter is off. Rays that would start into
/// the receiver's own triangle, as around a shading normal, are blocked by it.
///
/// `dump`, if there is one, gets every ray in the order of receivers: 36 bytes each, little-endian `f32`s origin, `tnear`,
/// direction, `tfar`, and a `u32` that is 1 if the ray was found blocked.
///
/// # Errors
/// Those of [`super::bake`]; [`BakeError::Mask`] for a number of rays that is not a multiple of 32 up to 1024;
/// [`BakeError::SemiTransparent`]; [`BakeError::Dump`]. After an error `ao` is as it was.
pub fn bake_mask_table(
    occluders: &Occluders,
    receivers: &Receivers,
    options: &BakeOptions,
    shard: Shard,
    ao: &mut [f32],
    dump: Option<&mut dyn Write>,
    progress: &mut (dyn FnMut(f32) -> bool + Send),
) -> Result<(), BakeError> {
    options.validate()?;
    if !occluders.is_opaque() {
        return Err(BakeError::SemiTransparent);
    }
    let mine: Vec<u32> = shard_of(receivers, shard, ao)?.concat();
    // Tilts as far as the pattern allows would be noise in `ao` of up to 0.03.
    let mut pattern = aomask::PatternOptions::default()
        .with_jitter(0.125, 0.2)
        .with_rays(options.rays)
        .with_falloff(options.falloff.clone())
        .with_seed(options.seed);
    if options.jitter == Jitter::Off {
        pattern = pattern.with_jitter(0.0, 0.0);
    }
    let tables = aomask::MaskTables::new(aomask::Pattern::new(&pattern)?, &aomask::TableOptions::default())?;
    let sides = match options.sides {
        Sides::Both => aomask::Sides::Both,
        Sides::Front => aomask::Sides::Front,
    };
    let mask_options = aomask::MaskOptions::default()
        .with_radius(options.radius.resolve(occluders.diagonal()))
        .with_sides(sides);
    let (asked, shares) = lobes(receivers, &mine, options)?;
    let words = tables.pattern().words();
    let mut open = vec![0.0; asked.len()];
    let mut masks = vec![0; if dump.is_some() { asked.len() * words } else { 0 }];
    let mut outputs = aomask::Outputs::new(&mut open);
    if dump.is_some() {
        outputs = outputs.with_masks(&mut masks);
    }
    tables.answer_receivers(occluders.bvh(), &asked, &mask_options, outputs, progress)?;
    if let Some(out) = dump {
        dump_rays(tables.pattern(), &asked, &masks, mask_options.radius, out).map_err(BakeError::Dump)?;
    }
    // Receivers without a direction are open.
    let mut values = vec![1.0; mine.len()];
    let mut last = usize::MAX;
    for (&(slot, share), open) in shares.iter().zip(open) {
        if slot != last {
            values[slot] = 0.0;
        }
        values[slot] += share * open;
        last = slot;
    }
    mine.iter().zip(values).for_each(|(&i, value)| ao[i as usize] = value);
    Ok(())
}

/// One receiver of `umbrage-aomask` for each lobe of the receivers in `mine`, with the index into `mine` and the lobe's share.
type Asked = (Vec<aomask::Receiver>, Vec<(usize, f32)>);

fn lobes(receivers: &Receivers, mine: &[u32], options: &BakeOptions) -> Result<Asked, BakeError> {
    let (mut asked, mut shares) = (Vec::new(), Vec::new());
    for (slot, &index) in mine.iter().enumerate() {
        let index = index as usize;
        let lobes = receivers.lobes(index);
        for (number, lobe) in lobes.iter().enumerate() {
            let origin = offset_origin(lobe.point, lobe.face, lobe.face, receivers.magnitudes[index])
                + lobe.face * options.bias;
            let seed = combine(combine(options.seed, index as u32), number as u32);
            asked.push(aomask::Receiver::new(index, origin.to_array(), lobe.normal.to_array(), seed)?);
            shares.push((slot, Lobe::share(lobes, number)));
        }
    }
    Ok((asked, shares))
}

fn dump_rays(
    pattern: &aomask::Pattern,
    receivers: &[aomask::Receiver],
    masks: &[u64],
    radius: f32,
    out: &mut dyn Write,
) -> io::Result<()> {
    for (receiver, mask) in receivers.iter().zip(masks.chunks(pattern.words())) {
        for (i, ray) in pattern.rays_of(receiver, radius).enumerate() {
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
