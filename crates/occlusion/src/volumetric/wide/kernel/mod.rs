//! Back ends: what a step of a walk needs, on portable code or AVX2.

#[cfg(target_arch = "x86_64")]
#[allow(unsafe_code)] // SIMD, behind safe functions
mod x86;

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
