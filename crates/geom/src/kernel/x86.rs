//! The filter on AVX2 and FMA, eight lanes at once.

use super::{
    ABOVE_SLOPE, BlockMask, BlockRay, BoxBlock, CellBlock, DEPTH_ERROR, DEPTH_UNDERFLOW, EDGE_ERROR, LANES,
    LARGEST, Lanes, SHEAR_ERROR, TriangleBlock, fan::FanRays,
};
use crate::{
    SlabRay,
    simd::{
        Avx2,
        x86::{load, planes},
    },
};
use std::arch::x86_64::*;

impl Avx2 {
    /// As [`TriangleBlock::above`], up to rounding.
    #[inline(always)]
    pub fn above(self, block: &TriangleBlock, origin: [f32; 3], up: [f32; 3]) -> u8 {
        // SAFETY: `self` proves the target features.
        unsafe { above(block, origin, up) }
    }

    /// The bits of [`BoxBlock::entered`]. Fast only when inlined into a function with these target features.
    #[inline(always)]
    pub fn entered(self, block: &BoxBlock, ray: &SlabRay) -> u32 {
        // SAFETY: `self` proves the target features.
        unsafe { entered(block, ray) }
    }

    /// The same as [`BoxBlock::columns`]. Fast only when inlined into a function with these target features.
    #[inline(always)]
    pub fn columns<const N: usize>(
        self,
        block: &BoxBlock,
        origin: [f32; 3],
        fan: &FanRays<N>,
        rays: u32,
    ) -> [u32; LANES] {
        // SAFETY: `self` proves the target features.
        unsafe { columns(block, origin, fan, rays) }
    }

    /// Filters a block; see the [module](super).
    ///
    /// Fast only when inlined into a function with these target features.
    #[inline(always)]
    pub fn filter(self, block: &impl Lanes, ray: &BlockRay) -> BlockMask {
        // SAFETY: `self` proves the target features.
        unsafe { filter(block, ray) }
    }
}

/// Coordinate `axis` of one corner of each triangle.
#[inline]
#[target_feature(enable = "avx2")]
pub(super) fn corner(block: &TriangleBlock, corner: usize, axis: usize) -> __m256 {
    // SAFETY: both are rows of eight; the one of floats is aligned as the block is.
    let (vertices, lanes) = unsafe {
        (
            _mm256_load_ps(block.vertices[axis].as_ptr()),
            _mm_loadl_epi64(block.corners[corner].as_ptr().cast()),
        )
    };
    _mm256_permutevar8x32_ps(vertices, _mm256_cvtepu8_epi32(lanes))
}

/// Coordinate `axis` of one corner of each triangle.
#[inline]
#[target_feature(enable = "avx2")]
pub(super) fn cell_corner(block: &CellBlock, corner: usize, axis: usize) -> __m256 {
    let rows = block.rows(axis);
    // SAFETY: a row is four floats.
    let row = |j: usize| unsafe { _mm_loadu_ps(rows[j].as_ptr()) };
    let (low, high) = match corner {
        // Vertices 0 0 1 1, 3 3 4 4.
        0 => (_mm_unpacklo_ps(row(0), row(0)), _mm_unpacklo_ps(row(1), row(1))),
        // 1 4 2 5, 4 7 5 8.
        1 => {
            let [a, b, c] = [row(0), row(1), row(2)].map(|r| _mm_shuffle_ps::<0b11_10_10_01>(r, r));
            (_mm_unpacklo_ps(a, b), _mm_unpacklo_ps(b, c))
        }
        // 4 3 5 4, 7 6 8 7.
        _ => {
            let [b, c] = [row(1), row(2)].map(|r| _mm_shuffle_ps::<0b01_10_00_01>(r, r));
            (b, c)
        }
    };
    _mm256_insertf128_ps::<1>(_mm256_castps128_ps256(low), high)
}

#[inline]
#[target_feature(enable = "avx2,fma")]
fn entered(block: &BoxBlock, ray: &SlabRay) -> u32 {
    let (mut entry, mut exit) = (_mm256_set1_ps(ray.tnear), _mm256_set1_ps(ray.tfar));
    for axis in 0..3 {
        let (base, step, rows) = block.parts(axis);
        let backward = usize::from(ray.inv_near[axis] < 0.0);
        let plane = |row: usize| planes(&rows[row % 6], step, base);
        let near = _mm256_sub_ps(plane(2 * axis + backward), _mm256_set1_ps(ray.origin_near[axis]));
        let far = _mm256_sub_ps(plane(2 * axis + 1 - backward), _mm256_set1_ps(ray.origin_far[axis]));
        // `max` and `min` return the second operand for NaN, which drops it.
        entry = _mm256_max_ps(_mm256_mul_ps(near, _mm256_set1_ps(ray.inv_near[axis])), entry);
        exit = _mm256_min_ps(_mm256_mul_ps(far, _mm256_set1_ps(ray.inv_far[axis])), exit);
    }
    _mm256_movemask_ps(_mm256_cmp_ps::<_CMP_LE_OQ>(entry, exit)) as u32
}

#[inline]
#[target_feature(enable = "avx2,fma,bmi1")]
fn columns<const N: usize>(
    block: &BoxBlock,
    origin: [f32; 3],
    fan: &FanRays<N>,
    mut left: u32,
) -> [u32; LANES] {
    let mut ends = [[_mm256_setzero_ps(); 2]; 3];
    for (axis, ends) in ends.iter_mut().enumerate() {
        let (base, step, rows) = block.parts(axis);
        for (end, row) in ends.iter_mut().zip(&rows[2 * axis..]) {
            *end = _mm256_sub_ps(planes(row, step, base), _mm256_set1_ps(origin[axis]));
        }
    }
    let mut columns = _mm256_setzero_si256();
    while left != 0 {
        let r = left.trailing_zeros() as usize % N;
        left &= left - 1;
        let (mut entry, mut exit) = (_mm256_set1_ps(fan.slab_near[r]), _mm256_set1_ps(fan.slab_far[r]));
        for (axis, ends) in ends.iter().enumerate() {
            let backward = fan.negative[axis][r] as usize & 1;
            let (near, far) = (ends[backward], ends[1 - backward]);
            // `max` and `min` return the second operand for NaN, which drops it.
            entry = _mm256_max_ps(_mm256_mul_ps(near, _mm256_set1_ps(fan.inv_near[axis][r])), entry);
            exit = _mm256_min_ps(_mm256_mul_ps(far, _mm256_set1_ps(fan.inv_far[axis][r])), exit);
        }
        let entered = _mm256_castps_si256(_mm256_cmp_ps::<_CMP_LE_OQ>(entry, exit));
        columns = _mm256_or_si256(columns, _mm256_and_si256(entered, _mm256_set1_epi32(1 << r)));
    }
    let mut rows = [0; LANES];
    // SAFETY: a row is eight integers.
    unsafe { _mm256_storeu_si256(rows.as_mut_ptr().cast(), columns) };
    rows
}

#[inline]
#[target_feature(enable = "avx2,fma")]
fn above(block: &TriangleBlock, origin: [f32; 3], up: [f32; 3]) -> u8 {
    let mut heights = _mm256_setzero_ps();
    for axis in 0..3 {
        let x = _mm256_sub_ps(load(&block.vertices[axis]), _mm256_set1_ps(origin[axis]));
        heights = _mm256_fmadd_ps(x, _mm256_set1_ps(up[axis]), heights);
        let size = _mm256_andnot_ps(_mm256_set1_ps(-0.0), x);
        heights = _mm256_fmadd_ps(size, _mm256_set1_ps(ABOVE_SLOPE), heights);
    }
    // Lanes of all ones where the vertex is below.
    let below = _mm256_cmp_ps::<_CMP_LT_OQ>(heights, _mm256_setzero_ps());
    let of = |corner: usize| {
        // SAFETY: a row of eight bytes.
        let lanes = unsafe { _mm_loadl_epi64(block.corners[corner].as_ptr().cast()) };
        _mm256_permutevar8x32_ps(below, _mm256_cvtepu8_epi32(lanes))
    };
    let all = _mm256_and_ps(_mm256_and_ps(of(0), of(1)), of(2));
    block.used() & !(_mm256_movemask_ps(all) as u8)
}

/// `A'.x`, `A'.y`, `A.z'` of one corner.
#[inline]
#[target_feature(enable = "avx2,fma")]
fn shear(block: &impl Lanes, c: usize, ray: &BlockRay) -> [__m256; 3] {
    let relative = |i: usize| {
        // SAFETY: this function's target features.
        let row = unsafe { block.corner(c, ray.axes[i] % 3) };
        _mm256_sub_ps(row, _mm256_set1_ps(ray.origin[i]))
    };
    let sign = _mm256_and_ps(_mm256_set1_ps(ray.sign), _mm256_set1_ps(-0.0));
    let z = _mm256_xor_ps(relative(2), sign);
    let x = _mm256_fnmadd_ps(_mm256_set1_ps(ray.slopes[0]), z, relative(0));
    let y = _mm256_fnmadd_ps(_mm256_set1_ps(ray.slopes[1]), z, relative(1));
    [x, y, z]
}

/// `a[0] * b[1] - a[1] * b[0]`.
#[inline]
#[target_feature(enable = "avx2,fma")]
fn edge(a: [__m256; 3], b: [__m256; 3]) -> __m256 {
    _mm256_fmsub_ps(a[0], b[1], _mm256_mul_ps(a[1], b[0]))
}

#[inline]
#[target_feature(enable = "avx2,fma")]
fn filter(block: &impl Lanes, ray: &BlockRay) -> BlockMask {
    let [a, b, c] = [shear(block, 0, ray), shear(block, 1, ray), shear(block, 2, ray)];
    let least = _mm256_min_ps(_mm256_min_ps(a[2], b[2]), c[2]);
    let greatest = _mm256_max_ps(_mm256_max_ps(a[2], b[2]), c[2]);
    let in_front = _mm256_cmp_ps::<_CMP_NLT_UQ>(greatest, _mm256_set1_ps(ray.near.below));
    let before_end = _mm256_cmp_ps::<_CMP_NGT_UQ>(least, _mm256_set1_ps(ray.far.above));
    let within = _mm256_and_ps(in_front, before_end);

    let absolute = |x: __m256| _mm256_andnot_ps(_mm256_set1_ps(-0.0), x);
    let larger = |p: [__m256; 3]| _mm256_max_ps(absolute(p[0]), absolute(p[1]));
    let across = _mm256_max_ps(_mm256_max_ps(larger(a), larger(b)), larger(c));
    let depth = _mm256_max_ps(absolute(least), absolute(greatest));
    let size = _mm256_add_ps(across, depth);
    // NaN in `size` is not less: sheared coordinates are NaN only where `depth` is infinite, whatever `max` drops.
    let sane = _mm256_cmp_ps::<_CMP_LT_OQ>(size, _mm256_set1_ps(LARGEST));
    let error = _mm256_fmadd_ps(
        _mm256_mul_ps(_mm256_set1_ps(EDGE_ERROR), size),
        _mm256_fmadd_ps(_mm256_set1_ps(SHEAR_ERROR), size, across),
        _mm256_set1_ps(f32::MIN_POSITIVE),
    );
    let (u, v, w) = (edge(c, b), edge(a, c), edge(b, a));
    let lowest = _mm256_min_ps(_mm256_min_ps(u, v), w);
    let highest = _mm256_max_ps(_mm256_max_ps(u, v), w);
    let minus_error = _mm256_xor_ps(error, _mm256_set1_ps(-0.0));
    let any_positive = _mm256_cmp_ps::<_CMP_GT_OQ>(highest, error);
    let any_negative = _mm256_cmp_ps::<_CMP_LT_OQ>(lowest, minus_error);
    let outside = _mm256_and_ps(sane, _mm256_and_ps(any_positive, any_negative));
    let open = _mm256_andnot_ps(outside, within);
    let open_mask = _mm256_movemask_ps(open) as u8 & block.used();
    if open_mask == 0 {
        return BlockMask::default();
    }
    let all_positive = _mm256_cmp_ps::<_CMP_GT_OQ>(lowest, error);
    let all_negative = _mm256_cmp_ps::<_CMP_LT_OQ>(highest, minus_error);
    let inside = _mm256_and_ps(_mm256_and_ps(sane, open), _mm256_or_ps(all_positive, all_negative));
    let clear_ends = _mm256_and_ps(
        _mm256_cmp_ps::<_CMP_GT_OQ>(least, _mm256_set1_ps(ray.near.above)),
        _mm256_cmp_ps::<_CMP_LT_OQ>(greatest, _mm256_set1_ps(ray.far.below)),
    );
    let certain = _mm256_movemask_ps(_mm256_and_ps(inside, clear_ends)) as u8 & open_mask;
    let straddling = _mm256_movemask_ps(_mm256_andnot_ps(clear_ends, inside)) as u8 & open_mask;
    if straddling == 0 {
        return BlockMask { certain, uncertain: open_mask & !certain };
    }

    // Edges of one sign: make it positive.
    let flip = _mm256_and_ps(all_negative, _mm256_set1_ps(-0.0));
    let volume = _mm256_fmadd_ps(u, a[2], _mm256_fmadd_ps(v, b[2], _mm256_mul_ps(w, c[2])));
    let volume = _mm256_xor_ps(volume, flip);
    let sum = _mm256_xor_ps(_mm256_add_ps(_mm256_add_ps(u, v), w), flip);
    let relative =
        _mm256_fmadd_ps(_mm256_set1_ps(3.0), error, _mm256_mul_ps(_mm256_set1_ps(DEPTH_ERROR), sum));
    // Masks of lanes surely beyond and surely before the depth `z`; NaN is neither.
    let compare = |z: f32| {
        let z = _mm256_set1_ps(z);
        let bound = _mm256_fmadd_ps(_mm256_add_ps(depth, z), relative, _mm256_set1_ps(DEPTH_UNDERFLOW));
        let difference = _mm256_fnmadd_ps(z, sum, volume);
        let beyond = _mm256_cmp_ps::<_CMP_GT_OQ>(difference, bound);
        let before = _mm256_cmp_ps::<_CMP_LT_OQ>(difference, _mm256_xor_ps(bound, _mm256_set1_ps(-0.0)));
        (_mm256_movemask_ps(beyond) as u8, _mm256_movemask_ps(before) as u8)
    };
    let (after_near, before_near) = compare(ray.near.rounded);
    let (after_far, before_far) =
        if ray.far.rounded == f32::INFINITY { (0, 0xff) } else { compare(ray.far.rounded) };
    let missed = straddling & (before_near | after_far);
    let certain = certain | (straddling & after_near & before_far);
    BlockMask { certain, uncertain: open_mask & !certain & !missed }
}
