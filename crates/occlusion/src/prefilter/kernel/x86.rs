//! AVX2: eight children at once. Same operations in the same order as `scalar.rs`, nothing fused, hence the same bits.

use super::{Job, Kernel, Prepared, Step};
use crate::prefilter::wide::{Node, WIDTH};
use std::arch::x86_64::*;
use umbrage_geom::{
    glam::Vec3,
    kernel::{BlockMask, BlockRay, TriangleBlock, x86::Avx2},
};

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

/// # Safety
/// AVX2.
#[inline]
#[target_feature(enable = "avx2")]
unsafe fn distances(node: &Node, origin: Vec3) -> [f32; WIDTH] {
    let mut sum = _mm256_setzero_ps();
    for axis in 0..3 {
        // SAFETY: rows are eight floats, aligned as the node is.
        let (low, high) = unsafe {
            (
                _mm256_load_ps(node.bounds[2 * axis].as_ptr()),
                _mm256_load_ps(node.bounds[2 * axis + 1].as_ptr()),
            )
        };
        let middle = _mm256_mul_ps(_mm256_add_ps(low, high), _mm256_set1_ps(0.5));
        let middle = _mm256_sub_ps(middle, _mm256_set1_ps(origin[axis]));
        sum = _mm256_add_ps(sum, _mm256_mul_ps(middle, middle));
    }
    let mut result = [0.0; WIDTH];
    // SAFETY: the store fills the whole array.
    unsafe { _mm256_storeu_ps(result.as_mut_ptr(), sum) };
    result
}

/// # Safety
/// AVX2.
#[inline]
#[target_feature(enable = "avx2")]
unsafe fn step(node: &Node, ray: &Prepared, distances: &[f32; WIDTH]) -> Step {
    let (mut entry, mut exit) = (_mm256_set1_ps(f32::NEG_INFINITY), _mm256_set1_ps(f32::INFINITY));
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
        let t0 = _mm256_sub_ps(near, _mm256_set1_ps(ray.slab.origin_near[axis]));
        let t1 = _mm256_sub_ps(far, _mm256_set1_ps(ray.slab.origin_far[axis]));
        // `max` and `min` return the second operand for NaN, which drops it.
        entry = _mm256_max_ps(_mm256_mul_ps(t0, _mm256_set1_ps(ray.slab.inv_near[axis])), entry);
        exit = _mm256_min_ps(_mm256_mul_ps(t1, _mm256_set1_ps(ray.slab.inv_far[axis])), exit);
    }
    let t0 = _mm256_max_ps(entry, _mm256_set1_ps(ray.slab.tnear));
    let t1 = _mm256_min_ps(exit, _mm256_set1_ps(ray.slab.tfar));
    let hit = _mm256_cmp_ps::<_CMP_LE_OQ>(t0, t1);
    // SAFETY: a row is eight floats, aligned as the node is; so many are the distances.
    let (reach, distance) =
        unsafe { (_mm256_load_ps(node.reach.as_ptr()), _mm256_loadu_ps(distances.as_ptr())) };
    let fits = _mm256_cmp_ps::<_CMP_LT_OQ>(reach, _mm256_mul_ps(_mm256_set1_ps(ray.kappa), distance));
    let stops = _mm256_and_ps(hit, fits);
    let stop = _mm256_movemask_ps(stops) as u32;
    let descend = _mm256_movemask_ps(hit) as u32 & !stop;
    let mut fraction = [0.0; WIDTH];
    if stop != 0 {
        let raise = _mm256_set1_ps(ray.raise);
        let covered = _mm256_add_ps(_mm256_sub_ps(t1, t0), raise);
        let crossed = _mm256_add_ps(_mm256_sub_ps(exit, entry), raise);
        let covered = _mm256_and_ps(stops, _mm256_div_ps(covered, crossed));
        // SAFETY: the store fills the whole array.
        unsafe { _mm256_storeu_ps(fraction.as_mut_ptr(), covered) };
    }
    Step { descend, stop, fraction }
}

impl Kernel for Avx2 {
    #[inline(always)]
    fn distances(self, node: &Node, origin: Vec3) -> [f32; WIDTH] {
        // SAFETY: `self` proves the target features.
        unsafe { distances(node, origin) }
    }

    #[inline(always)]
    fn step(self, node: &Node, ray: &Prepared, distances: &[f32; WIDTH]) -> Step {
        // SAFETY: `self` proves the target features.
        unsafe { step(node, ray, distances) }
    }

    #[inline(always)]
    fn filter(self, block: &TriangleBlock, ray: &BlockRay) -> BlockMask {
        Avx2::filter(self, block, ray)
    }
}
