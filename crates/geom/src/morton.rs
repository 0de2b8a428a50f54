//! Morton order: receivers that follow it are neighbours in space, which keeps what they visit in the cache.

use crate::Aabb;

/// Interleaves the lowest 21 bits of three numbers, `x` lowest.
#[inline]
pub fn interleave(x: u32, y: u32, z: u32) -> u64 {
    let spread = |v: u32| {
        let mut v = u64::from(v & 0x1f_ffff);
        v = (v | v << 32) & 0x001f_0000_0000_ffff;
        v = (v | v << 16) & 0x001f_0000_ff00_00ff;
        v = (v | v << 8) & 0x100f_00f0_0f00_f00f;
        v = (v | v << 4) & 0x10c3_0c30_c30c_30c3;
        (v | v << 2) & 0x1249_2492_4924_9249
    };
    spread(x) | spread(y) << 1 | spread(z) << 2
}

/// Indices of `points` in Morton order within their common bounds, ties by index. Points that are not finite come first.
pub fn order(points: &[[f32; 3]]) -> Vec<u32> {
    let bounds =
        points.iter().filter(|p| p.iter().all(|x| x.is_finite())).fold(Aabb::EMPTY, |b, &p| b.with_point(p));
    let (low, size) = (bounds.min.as_dvec3(), (bounds.max.as_dvec3() - bounds.min.as_dvec3()));
    let scale = 2_097_151.0 / size.max_element().max(f64::MIN_POSITIVE);
    let mut keyed: Vec<(u64, u32)> = points
        .iter()
        .enumerate()
        .map(|(i, p)| {
            // A cast from NaN or a negative number gives 0.
            let q = |axis: usize| ((f64::from(p[axis]) - low[axis]) * scale) as u32;
            (interleave(q(0), q(1), q(2)), i as u32)
        })
        .collect();
    keyed.sort_unstable();
    keyed.into_iter().map(|(_, i)| i).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bits_interleave() {
        for bit in 0..21 {
            assert_eq!(interleave(1 << bit, 0, 0), 1 << (3 * bit));
            assert_eq!(interleave(0, 1 << bit, 0), 2 << (3 * bit));
            assert_eq!(interleave(0, 0, 1 << bit), 4 << (3 * bit));
        }
    }

    #[test]
    fn order_is_a_permutation_that_groups_octants() {
        let points: Vec<[f32; 3]> =
            (0..64).map(|i| [(i % 4) as f32, (i / 4 % 4) as f32, (i / 16) as f32]).collect();
        let order = order(&points);
        let mut sorted = order.clone();
        sorted.sort_unstable();
        assert!(sorted.into_iter().eq(0..64));
        let octant = |i: u32| points[i as usize].map(|x| x >= 2.0);
        assert!(order.chunks(8).all(|c| c.iter().all(|&i| octant(i) == octant(c[0]))));
        assert!(super::order(&[]).is_empty());
        assert_eq!(super::order(&[[f32::NAN; 3], [1.0; 3]]).len(), 2);
    }
}
