//! AVX2: eight children at once. Same operations in the same order as `scalar.rs`, nothing fused, hence the same masks.

use super::{Avx2, Job, Kernel, NodeRay};
use crate::node::{Node, WIDTH};
use std::arch::x86_64::*;
use umbrage_geom::kernel::{BlockMask, BlockRay, TriangleBlock};

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
}
