//! What no ray of a fan can reach.

use crate::kernel::{FAN, Kernel, Rows};
use umbrage_geom::kernel::{
    fan::{CHUNK, FanRays, slab_inverse},
    larger, smaller,
};

/// Halves by halves, so that it is SIMD.
#[inline(always)]
fn fold<T: Copy>(mut row: [T; CHUNK], f: impl Fn(T, T) -> T) -> T {
    let mut half = CHUNK / 2;
    while half > 0 {
        for i in 0..half {
            row[i] = f(row[i], row[i + half]);
        }
        half /= 2;
    }
    row[0]
}

/// What a whole fan can't reach.
///
/// A ray that is, on each axis where all directions have one sign, as slow as the slowest towards near planes and as fast
/// as the fastest towards far planes enters whatever any ray enters; and no segment leaves the box around all of them.
pub(super) struct Envelope {
    /// One ray; on axes of mixed signs its entry is 0 and its exit NaN, which drops it.
    ray: FanRays<1>,
    /// On how many axes all directions have one sign.
    pub(super) axes: usize,
    /// Of all directions.
    pub(super) sum: [f32; 3],
    /// Box around all segments, relative to the origin, if it is finite.
    pub(super) extent: Option<[[f32; 3]; 2]>,
}

impl Envelope {
    /// For the rays in `fit`, of the first `len`.
    #[inline(always)]
    pub(super) fn new(fan: &FanRays<FAN>, fit: u32, len: usize) -> Self {
        let mut ray = FanRays::<1>::default();
        let mut extent = [[0f32; 3]; 2];
        let (mut axes, mut sum) = (0, [0.0; 3]);
        for axis in 0..3 {
            // Sizes of directions, ends of segments, and sign bits: those set in all, those set in any.
            let (mut least, mut most) = ([f32::INFINITY; CHUNK], [0f32; CHUNK]);
            let (mut low, mut high, mut total) = ([0f32; CHUNK], [0f32; CHUNK], [0f32; CHUNK]);
            let (mut all, mut any) = ([1u32; CHUNK], [0u32; CHUNK]);
            for at in (0..len.min(FAN)).step_by(CHUNK) {
                for i in 0..CHUNK {
                    let r = (at + i) % FAN;
                    let idle = fit >> r & 1 == 0;
                    let direction = fan.direction[axis][r];
                    let size = direction.abs();
                    // 0 times infinity stays where it is.
                    let end = if idle || direction == 0.0 { 0.0 } else { direction * fan.far[r] };
                    let (small, large) = if idle { (f32::INFINITY, 0.0) } else { (size, size) };
                    least[i] = smaller(least[i], small);
                    most[i] = larger(most[i], large);
                    total[i] += if idle { 0.0 } else { direction };
                    low[i] = smaller(low[i], end);
                    high[i] = larger(high[i], end);
                    let negative = fan.negative[axis][r];
                    all[i] &= if idle { 1 } else { negative };
                    any[i] |= if idle { 0 } else { negative };
                }
            }
            let (least, most) = (fold(least, smaller), fold(most, larger));
            let (all, any) = (fold(all, |a, b| a & b), fold(any, |a, b| a | b));
            sum[axis] = fold(total, |a, b| a + b);
            let one_sign = all == any;
            let sign = if any != 0 { -1.0 } else { 1.0 };
            ray.negative[axis] = [any];
            let (slowest, fastest) = (slab_inverse(most)[0], slab_inverse(least)[1]);
            ray.inv_near[axis] = [if one_sign { sign * slowest } else { 0.0 }];
            ray.inv_far[axis] = [if one_sign { sign * fastest } else { f32::NAN }];
            axes += usize::from(one_sign);
            // Two roundings, and one of the box's plane.
            extent[0][axis] = fold(low, smaller) * (1.0 + 2f32.powi(-20)) - f32::MIN_POSITIVE;
            extent[1][axis] = fold(high, larger) * (1.0 + 2f32.powi(-20)) + f32::MIN_POSITIVE;
        }
        ray.slab_near = [0.0];
        ray.slab_far = [f32::INFINITY];
        let finite = extent.as_flattened().iter().all(|x| x.is_finite());
        Self { ray, axes, sum, extent: finite.then_some(extent) }
    }

    /// See [`Fan::signs`].
    #[inline(always)]
    pub(super) fn signs(&self) -> Option<[u32; 3]> {
        let [[x], [y], [z]] = self.ray.negative;
        if self.axes == 3 { Some([x, y, z]) } else { None }
    }

    /// Children that some ray may enter.
    #[inline(always)]
    pub(super) fn mask<K: Kernel>(&self, kernel: K, rows: &Rows) -> u32 {
        let reached = self.extent.map_or(0xff, |[low, high]| kernel.overlap(rows, low, high));
        if self.axes == 0 { reached } else { reached & kernel.fan_mask(rows, &self.ray, 0) }
    }
}
