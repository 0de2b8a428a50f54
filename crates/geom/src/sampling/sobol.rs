//! Owen-scrambled Sobol points, computed one at a time.
//!
//! # Source
//! Sobol 1967; Owen 1995; the hashed scrambling and the padding of Burley, Practical Hash-based Owen Scrambling, JCGT 9(4),
//! 2020, through the crate `sobol_burley`, which has 2^16 points of 256 dimensions. Here both are without limit: points
//! are taken in runs of 2^16 and dimensions in sets of four, each run and each set under a seed of its own.

use super::hash::combine;
use glam::Vec2;

/// Points in one run; within it the points are stratified against each other.
const RUN: u32 = 1 << 16;

/// Salt that keeps the pairs of [`sobol_2d`] apart from the sets of [`sobol_4d`].
const PAIRS: u32 = 0x7ad9_2ef5;

#[inline]
fn padded(index: u32, set: u32, seed: u32) -> (u32, u32) {
    let seed = combine(seed, set);
    let run = index / RUN;
    (index % RUN, if run == 0 { seed } else { combine(seed, run) })
}

/// Coordinate `dimension` of point `index` of the sequence `seed`, in `[0, 1)`.
///
/// Points `0..2^k` are evenly spread in every dimension, and well spread over the dimensions `4s .. 4s + 4` together; sets
/// of four are unrelated to each other, and so are sequences with different seeds.
#[inline]
pub fn sobol(index: u32, dimension: u32, seed: u32) -> f32 {
    let (index, seed) = padded(index, dimension / 4, seed);
    sobol_burley::sample(index, dimension % 4, seed)
}

/// Point `index` of the planar sequence number `pair` of `seed`, in the half-open unit square.
///
/// Every pair is a (0, 2)-sequence in base 2: of `2^k` successive points from a multiple of `2^k`, each dyadic rectangle of
/// area `2^-k` holds exactly one (up to 2^16 points). Pairs are unrelated to each other and to [`sobol`].
#[inline]
pub fn sobol_2d(index: u32, pair: u32, seed: u32) -> Vec2 {
    let (index, seed) = padded(index, pair, seed ^ PAIRS);
    Vec2::new(sobol_burley::sample(index, 0, seed), sobol_burley::sample(index, 1, seed))
}

/// Coordinates `4 * set .. 4 * set + 4` of point `index`: the same numbers as [`sobol`], faster.
#[inline]
pub fn sobol_4d(index: u32, set: u32, seed: u32) -> [f32; 4] {
    let (index, seed) = padded(index, set, seed);
    sobol_burley::sample_4d(index, 0, seed)
}
