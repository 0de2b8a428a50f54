//! AVX2: eight children at once. Same operations in the same order as `scalar.rs`, nothing fused, hence the same bits.

use super::{Columns, FanNode, Job, Kernel, Prepared, Step};
use crate::prefilter::{
    fan::FAN,
    wide::{Node, WIDTH},
};
use std::arch::x86_64::*;
use umbrage_geom::{
    glam::Vec3,
    kernel::{
        BlockMask, BlockRay, TriangleBlock,
        fan::{self, FanRays},
        x86::Avx2,
    },
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

#[inline]
#[target_feature(enable = "avx2")]
fn look(node: &Node, origin: [f32; 3]) -> FanNode {
    let mut seen = FanNode { rows: [[0.0; WIDTH]; 6], sizes: [0.0; WIDTH], used: 0 };
    let mut distance = _mm256_setzero_ps();
    for (axis, from) in origin.into_iter().enumerate() {
        let from = _mm256_set1_ps(from);
        // SAFETY: rows are eight floats, aligned as the nodes are.
        unsafe {
            let low = _mm256_sub_ps(_mm256_load_ps(node.bounds[2 * axis].as_ptr()), from);
            let high = _mm256_sub_ps(_mm256_load_ps(node.bounds[2 * axis + 1].as_ptr()), from);
            _mm256_store_ps(seen.rows[2 * axis].as_mut_ptr(), low);
            _mm256_store_ps(seen.rows[2 * axis + 1].as_mut_ptr(), high);
            let middle = _mm256_mul_ps(_mm256_add_ps(low, high), _mm256_set1_ps(0.5));
            distance = _mm256_add_ps(distance, _mm256_mul_ps(middle, middle));
        }
    }
    // SAFETY: rows are eight floats or integers, aligned as the nodes are.
    unsafe {
        let sizes = _mm256_div_ps(_mm256_load_ps(node.reach.as_ptr()), distance);
        _mm256_store_ps(seen.sizes.as_mut_ptr(), sizes);
        let children = _mm256_load_si256(node.children.as_ptr().cast());
        let empty = _mm256_cmpeq_epi32(children, _mm256_set1_epi32(-1));
        seen.used = !(_mm256_movemask_ps(_mm256_castsi256_ps(empty)) as u32) & 0xff;
    }
    seen
}

/// Entry and exit of each child, and those within the segment.
#[inline]
#[target_feature(enable = "avx2")]
fn slabs(node: &FanNode, rays: &FanRays<FAN>, r: usize) -> [__m256; 4] {
    let (mut entry, mut exit) = (_mm256_set1_ps(f32::NEG_INFINITY), _mm256_set1_ps(f32::INFINITY));
    for axis in 0..3 {
        let row = 2 * axis + (rays.negative[axis][r] as usize & 1);
        // SAFETY: rows are eight floats, aligned as the node is.
        let (near, far) =
            unsafe { (_mm256_load_ps(node.rows[row].as_ptr()), _mm256_load_ps(node.rows[row ^ 1].as_ptr())) };
        // `max` and `min` return the second operand for NaN, which drops it.
        entry = _mm256_max_ps(_mm256_mul_ps(near, _mm256_set1_ps(rays.inv_near[axis][r])), entry);
        exit = _mm256_min_ps(_mm256_mul_ps(far, _mm256_set1_ps(rays.inv_far[axis][r])), exit);
    }
    let t0 = _mm256_max_ps(entry, _mm256_set1_ps(rays.slab_near[r]));
    let t1 = _mm256_min_ps(exit, _mm256_set1_ps(rays.slab_far[r]));
    [entry, exit, t0, t1]
}

/// Sets bit `r` in the columns of `entered`.
#[inline]
#[target_feature(enable = "avx2")]
fn note(columns: &mut Columns, entered: __m256, r: usize) {
    let bit = _mm256_set1_epi32(1 << r);
    // SAFETY: eight integers, aligned as the columns are.
    unsafe {
        let at = columns.0.as_mut_ptr().cast();
        let bits = _mm256_and_si256(_mm256_castps_si256(entered), bit);
        _mm256_store_si256(at, _mm256_or_si256(_mm256_load_si256(at), bits));
    }
}

#[inline]
#[target_feature(enable = "avx2")]
fn enter(node: &FanNode, rays: &FanRays<FAN>, r: usize, columns: &mut Columns) {
    let [_, _, t0, t1] = slabs(node, rays, r);
    note(columns, _mm256_cmp_ps::<_CMP_LE_OQ>(t0, t1), r);
}

#[inline]
#[target_feature(enable = "avx2")]
fn enter_or_stop(
    node: &FanNode,
    rays: &FanRays<FAN>,
    r: usize,
    kappa: f32,
    raise: f32,
    columns: &mut Columns,
) -> (u32, [f32; WIDTH]) {
    let [entry, exit, t0, t1] = slabs(node, rays, r);
    let hit = _mm256_cmp_ps::<_CMP_LE_OQ>(t0, t1);
    // SAFETY: a row is eight floats, aligned as the node is.
    let sizes = unsafe { _mm256_load_ps(node.sizes.as_ptr()) };
    let fits = _mm256_cmp_ps::<_CMP_LT_OQ>(sizes, _mm256_set1_ps(kappa));
    note(columns, _mm256_andnot_ps(fits, hit), r);
    let stops = _mm256_and_ps(hit, fits);
    let stop = _mm256_movemask_ps(stops) as u32;
    let mut fraction = [0.0; WIDTH];
    if stop != 0 {
        let raise = _mm256_set1_ps(raise);
        let covered = _mm256_add_ps(_mm256_sub_ps(t1, t0), raise);
        let crossed = _mm256_add_ps(_mm256_sub_ps(exit, entry), raise);
        let covered = _mm256_and_ps(stops, _mm256_div_ps(covered, crossed));
        // SAFETY: the store fills the whole array.
        unsafe { _mm256_storeu_ps(fraction.as_mut_ptr(), covered) };
    }
    (stop, fraction)
}

#[inline]
#[target_feature(enable = "avx2")]
fn any_below(node: &FanNode, kappa: f32) -> bool {
    // SAFETY: a row is eight floats, aligned as the node is.
    let sizes = unsafe { _mm256_load_ps(node.sizes.as_ptr()) };
    _mm256_movemask_ps(_mm256_cmp_ps::<_CMP_LT_OQ>(sizes, _mm256_set1_ps(kappa))) != 0
}

#[inline]
#[target_feature(enable = "avx2")]
fn nonzero(columns: &Columns) -> u32 {
    // SAFETY: eight integers, aligned as the columns are.
    let columns = unsafe { _mm256_load_si256(columns.0.as_ptr().cast()) };
    let zero = _mm256_cmpeq_epi32(columns, _mm256_setzero_si256());
    !(_mm256_movemask_ps(_mm256_castsi256_ps(zero)) as u32) & 0xff
}

/// # Safety
/// AVX2.
#[inline]
#[target_feature(enable = "avx2")]
unsafe fn step(node: &Node, ray: &Prepared, sizes: &[f32; WIDTH]) -> Step {
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
    // SAFETY: so many are the sizes.
    let sizes = unsafe { _mm256_loadu_ps(sizes.as_ptr()) };
    let fits = _mm256_cmp_ps::<_CMP_LT_OQ>(sizes, _mm256_set1_ps(ray.kappa));
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
    fn sizes(self, node: &Node, origin: Vec3) -> [f32; WIDTH] {
        self.look(node, origin.to_array()).sizes
    }

    #[inline(always)]
    fn step(self, node: &Node, ray: &Prepared, sizes: &[f32; WIDTH]) -> Step {
        // SAFETY: `self` proves the target features.
        unsafe { step(node, ray, sizes) }
    }

    #[inline(always)]
    fn filter(self, block: &TriangleBlock, ray: &BlockRay) -> BlockMask {
        Avx2::filter(self, block, ray)
    }

    #[inline(always)]
    fn look(self, node: &Node, origin: [f32; 3]) -> FanNode {
        // SAFETY: `self` proves the target features.
        unsafe { look(node, origin) }
    }

    #[inline(always)]
    fn any_below(self, node: &FanNode, kappa: f32) -> bool {
        // SAFETY: `self` proves the target features.
        unsafe { any_below(node, kappa) }
    }

    #[inline(always)]
    fn enter(self, node: &FanNode, rays: &FanRays<FAN>, r: usize, columns: &mut Columns) {
        // SAFETY: `self` proves the target features.
        unsafe { enter(node, rays, r % FAN, columns) }
    }

    #[inline(always)]
    fn enter_or_stop(
        self,
        node: &FanNode,
        rays: &FanRays<FAN>,
        r: usize,
        kappa: f32,
        raise: f32,
        columns: &mut Columns,
    ) -> (u32, [f32; WIDTH]) {
        // SAFETY: `self` proves the target features.
        unsafe { enter_or_stop(node, rays, r % FAN, kappa, raise, columns) }
    }

    #[inline(always)]
    fn nonzero(self, columns: &Columns) -> u32 {
        // SAFETY: `self` proves the target features.
        unsafe { nonzero(columns) }
    }

    #[inline(always)]
    fn prefetch<T>(self, slice: &[T], index: usize) {
        let target = slice.as_ptr().wrapping_add(index).cast::<i8>();
        for offset in (0..size_of::<T>()).step_by(64) {
            // SAFETY: a prefetch of any address is harmless; SSE belongs to the x86_64 baseline.
            unsafe { _mm_prefetch::<_MM_HINT_T0>(target.wrapping_add(offset)) };
        }
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
}
