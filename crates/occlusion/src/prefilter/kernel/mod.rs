//! One step of a walk: eight boxes against one ray, and which of them end it. All back ends return the same bits.

mod scalar;
#[cfg(target_arch = "x86_64")]
#[allow(unsafe_code)]
mod x86;

#[cfg(test)]
mod tests;

pub(crate) use scalar::Scalar;

use super::{
    fan::FAN,
    wide::{Node, WIDTH},
};
use umbrage_geom::{
    Ray, SlabRay,
    glam::Vec3,
    kernel::{BlockMask, BlockRay, TriangleBlock, fan::FanRays},
};

/// A valid ray prepared for boxes, leaves and the question where it ends.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Prepared {
    pub(crate) slab: SlabRay,
    /// Row of [`Node::bounds`] that holds the near plane of each axis, even or odd; the far plane is its neighbour.
    near_row: [usize; 3],
    pub(crate) block: BlockRay,
    pub(crate) origin: Vec3,
    /// A child ends the ray when its `reach` over its squared distance is less than this; 0 for never.
    pub(crate) kappa: f32,
    /// What both terms of the crossed fraction are raised by: hardly anything, or so much that it becomes 1.
    pub(crate) raise: f32,
}

impl Prepared {
    /// Crossed fractions count.
    pub(crate) const FRACTION: f32 = 1.0 / (1u128 << 100) as f32;
    /// Every crossing counts in full.
    pub(crate) const WHOLE: f32 = (1u128 << 100) as f32;

    /// `None` if the ray is not valid, which is a miss.
    #[inline(always)]
    pub(crate) fn new(ray: &Ray, kappa: f32, raise: f32) -> Option<Self> {
        Self::with_slab(ray, SlabRay::new(ray)?, kappa, raise)
    }

    /// The same with what is known about the direction.
    #[inline(always)]
    pub(crate) fn with_slab(ray: &Ray, slab: SlabRay, kappa: f32, raise: f32) -> Option<Self> {
        let inv_near = slab.inv_near.to_array();
        let near_row = [0, 1, 2].map(|axis| 2 * axis + usize::from(inv_near[axis] < 0.0));
        Some(Self { slab, near_row, block: BlockRay::new(ray)?, origin: ray.origin, kappa, raise })
    }
}

/// Children of a node as one ray meets them.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Step {
    /// Children to descend into.
    pub(crate) descend: u32,
    /// Children that end the ray.
    pub(crate) stop: u32,
    /// Of each child that ends the ray the fraction of its crossing that the segment covers; 0 for the others.
    pub(crate) fraction: [f32; WIDTH],
}

/// A node as one origin sees it.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
pub(crate) struct FanNode {
    /// Planes relative to the origin, in the rows of [`Node::bounds`].
    rows: [[f32; WIDTH]; 6],
    /// `reach` of each child over its squared distance.
    sizes: [f32; WIDTH],
    /// One bit for each slot in use.
    pub(crate) used: u32,
}

/// For each child the rays that enter it, a bit each.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(C, align(32))]
pub(crate) struct Columns(pub(crate) [u32; WIDTH]);

/// No ray enters.
pub(crate) const NO_RAYS: Columns = Columns([0; WIDTH]);

/// One traversal step on some instruction set.
pub(crate) trait Kernel: Copy + Send + Sync {
    /// `reach` of each child over the squared distance of its centre from `origin`.
    fn sizes(self, node: &Node, origin: Vec3) -> [f32; WIDTH];

    /// Tests all children, whose `sizes` are from the ray's origin.
    fn step(self, node: &Node, ray: &Prepared, sizes: &[f32; WIDTH]) -> Step;

    /// See [`umbrage_geom::kernel`].
    fn filter(self, block: &TriangleBlock, ray: &BlockRay) -> BlockMask;

    /// Moves a node's boxes.
    fn look(self, node: &Node, origin: [f32; 3]) -> FanNode;

    /// Whether a child looks smaller than `kappa`.
    fn any_below(self, node: &FanNode, kappa: f32) -> bool;

    /// Notes the children that ray `r` enters.
    fn enter(self, node: &FanNode, rays: &FanRays<FAN>, r: usize, columns: &mut Columns);

    /// The same, if none of them ends the ray; and [`Step::stop`] and [`Step::fraction`] of those that do.
    fn enter_or_stop(
        self,
        node: &FanNode,
        rays: &FanRays<FAN>,
        r: usize,
        kappa: f32,
        raise: f32,
        columns: &mut Columns,
    ) -> (u32, [f32; WIDTH]);

    /// Children that some ray enters.
    fn nonzero(self, columns: &Columns) -> u32;

    /// Asks for an element of `slice` to be fetched; hardly more than a hint.
    fn prefetch<T>(self, slice: &[T], index: usize);

    /// A leaf as one origin sees it.
    type Planes;

    /// See [`umbrage_geom::kernel::fan`].
    fn planes(self, block: &TriangleBlock, origin: [f32; 3]) -> Self::Planes;

    /// See [`umbrage_geom::kernel::fan`].
    fn fan_filter(self, planes: &Self::Planes, rays: &FanRays<FAN>, r: usize) -> BlockMask;
}

/// Work that runs on any kernel.
pub(crate) trait Job {
    type Output;

    fn run<K: Kernel>(self, kernel: K) -> Self::Output;
}

/// Runs `job` on the best instructions of this processor.
#[inline]
pub(crate) fn run<J: Job>(job: J) -> J::Output {
    #[cfg(target_arch = "x86_64")]
    if let Some(avx2) = umbrage_geom::kernel::x86::Avx2::detect() {
        return x86::run(avx2, job);
    }
    job.run(Scalar)
}

/// Sum of products of eight pairs, always in the same order.
#[inline(always)]
pub(crate) fn dot(a: &[f32; WIDTH], b: &[f32; WIDTH]) -> f32 {
    let mut x = [0.0; WIDTH];
    for i in 0..WIDTH {
        x[i] = a[i] * b[i];
    }
    ((x[0] + x[4]) + (x[2] + x[6])) + ((x[1] + x[5]) + (x[3] + x[7]))
}
