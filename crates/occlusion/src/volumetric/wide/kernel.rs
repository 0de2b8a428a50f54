//! Back ends: what a step of a walk needs, on portable code or AVX2.
//!
//! The only file of the crate with `unsafe`.

use super::node::{Node, WIDTH};
use umbrage_geom::{
    SlabRay,
    kernel::{BlockMask, BlockRay, TriangleBlock, scalar},
};

/// A ray prepared for nodes.
#[derive(Clone, Copy, Debug)]
pub(super) struct NodeRay {
    pub(super) slab: SlabRay,
    /// Row of [`Node::bounds`] with the near plane of each axis; the far plane is its neighbour.
    near_row: [usize; 3],
}

impl NodeRay {
    #[inline(always)]
    pub(super) fn new(slab: SlabRay) -> Self {
        let row = |axis: usize| 2 * axis + usize::from(slab.inv_near[axis] < 0.0);
        Self { slab, near_row: [row(0), row(1), row(2)] }
    }
}

/// One instruction set.
pub(super) trait Kernel: Copy {
    /// Bit `i` is set if the ray may enter box `i` of the node.
    fn mask(self, node: &Node, ray: &NodeRay) -> u32;

    /// See [`umbrage_geom::kernel`].
    fn filter(self, block: &TriangleBlock, ray: &BlockRay) -> BlockMask;

    /// Bit `i` is set if `a[i] <= b[i]`.
    fn at_most(self, a: &[f32; WIDTH], b: &[f32; WIDTH]) -> u32;

    /// Bit `i` is set if `a[i] < b[i]`.
    fn less(self, a: &[f32; WIDTH], b: &[f32; WIDTH]) -> u32;
}

/// Work that runs on any of them.
pub(super) trait Job {
    type Output;

    fn run<K: Kernel>(self, kernel: K) -> Self::Output;
}

/// Portable code.
#[derive(Clone, Copy)]
struct Scalar;

impl Kernel for Scalar {
    #[inline(always)]
    fn mask(self, node: &Node, ray: &NodeRay) -> u32 {
        let (mut entry, mut exit) = ([ray.slab.tnear; WIDTH], [ray.slab.tfar; WIDTH]);
        for axis in 0..3 {
            let (near, far) = (&node.bounds[ray.near_row[axis]], &node.bounds[ray.near_row[axis] ^ 1]);
            for i in 0..WIDTH {
                let a = (near[i] - ray.slab.origin_near[axis]) * ray.slab.inv_near[axis];
                let b = (far[i] - ray.slab.origin_far[axis]) * ray.slab.inv_far[axis];
                entry[i] = if a > entry[i] { a } else { entry[i] };
                exit[i] = if b < exit[i] { b } else { exit[i] };
            }
        }
        (0..WIDTH).fold(0, |mask, i| mask | u32::from(entry[i] <= exit[i]) << i)
    }

    #[inline(always)]
    fn filter(self, block: &TriangleBlock, ray: &BlockRay) -> BlockMask {
        scalar::filter(block, ray)
    }

    #[inline(always)]
    fn at_most(self, a: &[f32; WIDTH], b: &[f32; WIDTH]) -> u32 {
        (0..WIDTH).fold(0, |mask, i| mask | u32::from(a[i] <= b[i]) << i)
    }

    #[inline(always)]
    fn less(self, a: &[f32; WIDTH], b: &[f32; WIDTH]) -> u32 {
        (0..WIDTH).fold(0, |mask, i| mask | u32::from(a[i] < b[i]) << i)
    }
}

/// Runs `job` on the fastest back end of the processor, or the portable one if `simd` is false.
#[inline]
pub(super) fn run<J: Job>(simd: bool, job: J) -> J::Output {
    #[cfg(target_arch = "x86_64")]
    if simd && let Some(avx2) = umbrage_geom::kernel::x86::Avx2::detect() {
        return x86::run(avx2, job);
    }
    let _ = simd;
    job.run(Scalar)
}

#[cfg(target_arch = "x86_64")]
mod x86 {
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
                    entry =
                        _mm256_max_ps(_mm256_mul_ps(near, _mm256_set1_ps(ray.slab.inv_near[axis])), entry);
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
}
