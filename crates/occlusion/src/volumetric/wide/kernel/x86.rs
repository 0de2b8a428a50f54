//! AVX2: the operations of the portable code in the same order, hence the same masks.

use super::{Job, Kernel, Node, NodeRay};
use std::arch::x86_64::*;
use umbrage_geom::kernel::{BlockMask, BlockRay, TriangleBlock, x86::Avx2};

/// Runs `job` compiled for AVX2 and FMA: everything it inlines may use them.
#[inline]
pub(super) fn run<J: Job>(avx2: Avx2, job: J) -> J::Output {
    #[target_feature(enable = "avx2,fma,bmi1,lzcnt,popcnt")]
    fn shell<J: Job>(avx2: Avx2, job: J) -> J::Output {
        job.run(avx2)
    }
    // SAFETY: `avx2` proves the target features.
    unsafe { shell(avx2, job) }
}

impl Kernel for Avx2 {
    #[inline(always)]
    fn mask(self, node: &Node, ray: &NodeRay) -> u32 {
        // SAFETY: `self` proves AVX2. `near_row` is below 6 by construction, and so is its neighbour; rows are eight
        // floats, aligned as the node is.
        unsafe {
            let (mut entry, mut exit) = (_mm256_set1_ps(ray.slab.tnear), _mm256_set1_ps(ray.slab.tfar));
            for axis in 0..3 {
                let row = ray.near_row[axis];
                let near = _mm256_load_ps(node.bounds.get_unchecked(row).as_ptr());
                let far = _mm256_load_ps(node.bounds.get_unchecked(row ^ 1).as_ptr());
                let near = _mm256_sub_ps(near, _mm256_set1_ps(ray.slab.origin_near[axis]));
                let far = _mm256_sub_ps(far, _mm256_set1_ps(ray.slab.origin_far[axis]));
                // `max` and `min` return the second operand for NaN, which drops it.
                entry = _mm256_max_ps(_mm256_mul_ps(near, _mm256_set1_ps(ray.slab.inv_near[axis])), entry);
                exit = _mm256_min_ps(_mm256_mul_ps(far, _mm256_set1_ps(ray.slab.inv_far[axis])), exit);
            }
            _mm256_movemask_ps(_mm256_cmp_ps::<_CMP_LE_OQ>(entry, exit)) as u32
        }
    }

    #[inline(always)]
    fn filter(self, block: &TriangleBlock, ray: &BlockRay) -> BlockMask {
        Avx2::filter(self, block, ray)
    }

    #[inline(always)]
    fn at_most(self, a: &[f32; 8], b: &[f32; 8]) -> u32 {
        // SAFETY: `self` proves AVX2; each load reads one whole array.
        unsafe {
            let (a, b) = (_mm256_loadu_ps(a.as_ptr()), _mm256_loadu_ps(b.as_ptr()));
            _mm256_movemask_ps(_mm256_cmp_ps::<_CMP_LE_OQ>(a, b)) as u32
        }
    }

    #[inline(always)]
    fn less(self, a: &[f32; 8], b: &[f32; 8]) -> u32 {
        // SAFETY: as above.
        unsafe {
            let (a, b) = (_mm256_loadu_ps(a.as_ptr()), _mm256_loadu_ps(b.as_ptr()));
            _mm256_movemask_ps(_mm256_cmp_ps::<_CMP_LT_OQ>(a, b)) as u32
        }
    }
}
