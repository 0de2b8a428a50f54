//! AVX2: eight children at once. Same operations in the same order as `scalar.rs`, nothing fused, hence the same masks.

use super::FAN;
use super::{Avx2, Job, Kernel, NodeRay};
use crate::node::{Node, WIDTH};
use std::arch::x86_64::*;
use umbrage_geom::kernel::{
    BlockMask, BlockRay, TriangleBlock,
    fan::{self, FanRays},
};

/// Runs `job` compiled for AVX2 and FMA: everything it inlines may use them.
#[inline]
pub(crate) fn run<J: Job>(avx2: Avx2, job: J) -> J::Output {
    #[target_feature(enable = "avx2,fma,bmi1,lzcnt,popcnt")]
    fn shell<J: Job>(avx2: Avx2, job: J) -> J::Output {
        job.run(avx2)
    }
    // SAFETY: `avx2` proves the target features.
    unsafe { shell(avx2, job) }
}

/// Proof that this processor has AVX-512 with 256-bit forms (F, VL, DQ, BW), besides what [`Avx2`] proves.
///
/// The code of [`Avx2`] compiled once more: twice the registers and comparisons into mask registers. 512-bit vectors gain
/// nothing where they take two cycles.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Avx512(Avx2);

impl Avx512 {
    /// Asks the processor.
    pub(crate) fn detect() -> Option<Self> {
        let all = is_x86_feature_detected!("avx512f")
            && is_x86_feature_detected!("avx512vl")
            && is_x86_feature_detected!("avx512dq")
            && is_x86_feature_detected!("avx512bw");
        if all { Avx2::detect().map(Self) } else { None }
    }

    /// Runs `job` compiled for AVX-512.
    #[inline]
    pub(crate) fn run<J: Job>(self, job: J) -> J::Output {
        #[target_feature(enable = "avx512f,avx512vl,avx512dq,avx512bw,avx2,fma,bmi1,bmi2,lzcnt,popcnt")]
        fn shell<J: Job>(avx2: Avx2, job: J) -> J::Output {
            job.run(avx2)
        }
        // SAFETY: `self` proves the target features.
        unsafe { shell(self.0, job) }
    }
}

/// Entry and exit of each child.
///
/// # Safety
/// AVX2.
#[inline]
#[target_feature(enable = "avx2")]
unsafe fn slabs(node: &Node, ray: &NodeRay, tfar: f32) -> (__m256, __m256) {
    let (mut entry, mut exit) = (_mm256_set1_ps(ray.slab.tnear), _mm256_set1_ps(tfar));
    for axis in 0..3 {
        let row = ray.near_row[axis];
        // SAFETY: `near_row` is below 6 by construction, and so is its neighbour; rows are eight floats, aligned as the
        // node is.
        let (near, far) = unsafe {
            (
                _mm256_load_ps(node.bounds.get_unchecked(row).as_ptr()),
                _mm256_load_ps(node.bounds.get_unchecked(row ^ 1).as_ptr()),
            )
        };
        let near = _mm256_sub_ps(near, _mm256_set1_ps(ray.slab.origin_near[axis]));
        let far = _mm256_sub_ps(far, _mm256_set1_ps(ray.slab.origin_far[axis]));
        // `max` and `min` return the second operand for NaN, which drops it.
        entry = _mm256_max_ps(_mm256_mul_ps(near, _mm256_set1_ps(ray.slab.inv_near[axis])), entry);
        exit = _mm256_min_ps(_mm256_mul_ps(far, _mm256_set1_ps(ray.slab.inv_far[axis])), exit);
    }
    (entry, exit)
}

#[inline]
#[target_feature(enable = "avx2")]
fn fan_mask<const N: usize>(node: &Node, origin: [f32; 3], rays: &FanRays<N>, r: usize) -> u32 {
    let (mut entry, mut exit) = (_mm256_set1_ps(rays.slab_near[r]), _mm256_set1_ps(rays.slab_far[r]));
    for axis in 0..3 {
        let row = 2 * axis + (rays.negative[axis][r] as usize & 1);
        // SAFETY: `row` is below 6, and so is its neighbour; rows are eight floats, aligned as the node is.
        let (near, far) = unsafe {
            (
                _mm256_load_ps(node.bounds.get_unchecked(row).as_ptr()),
                _mm256_load_ps(node.bounds.get_unchecked(row ^ 1).as_ptr()),
            )
        };
        let near = _mm256_sub_ps(near, _mm256_set1_ps(origin[axis]));
        let far = _mm256_sub_ps(far, _mm256_set1_ps(origin[axis]));
        // `max` and `min` return the second operand for NaN, which drops it.
        entry = _mm256_max_ps(_mm256_mul_ps(near, _mm256_set1_ps(rays.inv_near[axis][r])), entry);
        exit = _mm256_min_ps(_mm256_mul_ps(far, _mm256_set1_ps(rays.inv_far[axis][r])), exit);
    }
    _mm256_movemask_ps(_mm256_cmp_ps::<_CMP_LE_OQ>(entry, exit)) as u32
}

#[inline]
#[target_feature(enable = "avx2")]
fn overlap(node: &Node, origin: [f32; 3], low: [f32; 3], high: [f32; 3]) -> u32 {
    let mut reaches = _mm256_castsi256_ps(_mm256_set1_epi32(-1));
    for axis in 0..3 {
        // SAFETY: rows are eight floats, aligned as the node is.
        let (least, greatest) = unsafe {
            (
                _mm256_load_ps(node.bounds[2 * axis].as_ptr()),
                _mm256_load_ps(node.bounds[2 * axis + 1].as_ptr()),
            )
        };
        let origin = _mm256_set1_ps(origin[axis]);
        let (least, greatest) = (_mm256_sub_ps(least, origin), _mm256_sub_ps(greatest, origin));
        let below = _mm256_cmp_ps::<_CMP_LE_OQ>(least, _mm256_set1_ps(high[axis]));
        let above = _mm256_cmp_ps::<_CMP_GE_OQ>(greatest, _mm256_set1_ps(low[axis]));
        reaches = _mm256_and_ps(reaches, _mm256_and_ps(below, above));
    }
    _mm256_movemask_ps(reaches) as u32
}

#[inline]
#[target_feature(enable = "avx2")]
fn columns(rows: [u64; FAN / 8]) -> [u32; WIDTH] {
    let bytes = _mm256_set_epi64x(rows[3] as i64, rows[2] as i64, rows[1] as i64, rows[0] as i64);
    // The highest bit of each byte is what `movemask` takes.
    [
        _mm256_movemask_epi8(_mm256_slli_epi64::<7>(bytes)) as u32,
        _mm256_movemask_epi8(_mm256_slli_epi64::<6>(bytes)) as u32,
        _mm256_movemask_epi8(_mm256_slli_epi64::<5>(bytes)) as u32,
        _mm256_movemask_epi8(_mm256_slli_epi64::<4>(bytes)) as u32,
        _mm256_movemask_epi8(_mm256_slli_epi64::<3>(bytes)) as u32,
        _mm256_movemask_epi8(_mm256_slli_epi64::<2>(bytes)) as u32,
        _mm256_movemask_epi8(_mm256_slli_epi64::<1>(bytes)) as u32,
        _mm256_movemask_epi8(bytes) as u32,
    ]
}

impl Kernel for Avx2 {
    #[inline(always)]
    fn mask(self, node: &Node, ray: &NodeRay, tfar: f32) -> u32 {
        // SAFETY: `self` proves the target features.
        unsafe {
            let (entry, exit) = slabs(node, ray, tfar);
            _mm256_movemask_ps(_mm256_cmp_ps::<_CMP_LE_OQ>(entry, exit)) as u32
        }
    }

    #[inline(always)]
    fn entries(self, node: &Node, ray: &NodeRay, tfar: f32, entries: &mut [f32; WIDTH]) -> u32 {
        // SAFETY: `self` proves the target features; the store fills the whole array.
        unsafe {
            let (entry, exit) = slabs(node, ray, tfar);
            _mm256_storeu_ps(entries.as_mut_ptr(), entry);
            _mm256_movemask_ps(_mm256_cmp_ps::<_CMP_LE_OQ>(entry, exit)) as u32
        }
    }

    #[inline(always)]
    fn filter(self, block: &TriangleBlock, ray: &BlockRay) -> BlockMask {
        Avx2::filter(self, block, ray)
    }

    #[inline(always)]
    fn fan_mask<const N: usize>(self, node: &Node, origin: [f32; 3], rays: &FanRays<N>, r: usize) -> u32 {
        // SAFETY: `self` proves the target features.
        unsafe { fan_mask(node, origin, rays, r % N) }
    }

    #[inline(always)]
    fn overlap(self, node: &Node, origin: [f32; 3], low: [f32; 3], high: [f32; 3]) -> u32 {
        // SAFETY: `self` proves the target features.
        unsafe { overlap(node, origin, low, high) }
    }

    type Planes = fan::x86::Planes;

    #[inline(always)]
    fn planes(self, block: &TriangleBlock, origin: [f32; 3]) -> Self::Planes {
        Avx2::planes(self, block, origin)
    }

    #[inline(always)]
    fn fan_filter(self, planes: &Self::Planes, rays: &FanRays<FAN>, r: usize) -> BlockMask {
        let r = r % FAN;
        let [x, y, z] = &rays.direction;
        Avx2::fan_filter(self, planes, [x[r], y[r], z[r]], rays.near[r], rays.far[r])
    }

    #[inline(always)]
    fn columns(self, rows: [u64; FAN / 8]) -> [u32; WIDTH] {
        // SAFETY: `self` proves the target features.
        unsafe { columns(rows) }
    }
}
