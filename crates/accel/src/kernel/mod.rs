//! Back ends of a traversal step. All return the same children in `mask`, and filters that are right.

mod scalar;
#[cfg(target_arch = "x86_64")]
mod x86;

pub(crate) use scalar::Scalar;
#[cfg(target_arch = "x86_64")]
pub(crate) use umbrage_geom::kernel::x86::Avx2;

use crate::node::{Node, WIDTH};
use umbrage_geom::{
    Ray, SlabRay,
    kernel::{BlockMask, BlockRay, TriangleBlock},
};

/// A valid ray prepared for boxes of nodes.
#[derive(Clone, Copy, Debug)]
pub(crate) struct NodeRay {
    pub(crate) slab: SlabRay,
    /// Row of [`Node::bounds`] that holds the near plane of each axis, even or odd; the far plane is its neighbour.
    near_row: [usize; 3],
}

impl NodeRay {
    #[inline(always)]
    pub(crate) fn new(slab: SlabRay) -> Self {
        let inv_near = slab.inv_near.to_array();
        Self { slab, near_row: [0, 1, 2].map(|axis| 2 * axis + usize::from(inv_near[axis] < 0.0)) }
    }
}

/// A ray prepared for boxes and triangles.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Prepared {
    pub(crate) node: NodeRay,
    pub(crate) block: BlockRay,
}

impl Prepared {
    /// `None` if the ray is not valid, which is a miss.
    #[inline(always)]
    pub(crate) fn new(ray: &Ray) -> Option<Self> {
        Some(Self { node: NodeRay::new(SlabRay::new(ray)?), block: BlockRay::new(ray)? })
    }
}

/// One traversal step on some instruction set.
pub(crate) trait Kernel: Copy {
    /// Bit `i` is set when the ray may enter child `i` before `tfar` (scaled as by [`SlabRay`]).
    fn mask(self, node: &Node, ray: &NodeRay, tfar: f32) -> u32;

    /// [`Self::mask`], and where the ray enters: defined for children in the mask.
    fn entries(self, node: &Node, ray: &NodeRay, tfar: f32, entries: &mut [f32; WIDTH]) -> u32;

    /// See [`umbrage_geom::kernel`].
    fn filter(self, block: &TriangleBlock, ray: &BlockRay) -> BlockMask;
}

/// Work that runs on any kernel.
pub(crate) trait Job {
    type Output;

    fn run<K: Kernel>(self, kernel: K) -> Self::Output;
}

/// Which instructions a structure's queries use. Answers don't depend on it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum BackEnd {
    /// Portable code, one box or triangle at a time.
    Scalar,
    /// AVX2 and FMA, eight at a time.
    Avx2,
}

impl BackEnd {
    /// The fastest one that this processor has.
    pub fn best() -> Self {
        if Self::Avx2.is_supported() { Self::Avx2 } else { Self::Scalar }
    }

    /// Whether this processor has it.
    pub fn is_supported(self) -> bool {
        match self {
            Self::Scalar => true,
            #[cfg(target_arch = "x86_64")]
            Self::Avx2 => Avx2::detect().is_some(),
            #[cfg(not(target_arch = "x86_64"))]
            Self::Avx2 => false,
        }
    }

    /// Runs `job` on this back end, or on the portable one where it is missing.
    #[inline]
    pub(crate) fn run<J: Job>(self, job: J) -> J::Output {
        match self {
            #[cfg(target_arch = "x86_64")]
            Self::Avx2 => match Avx2::detect() {
                Some(avx2) => x86::run(avx2, job),
                None => job.run(Scalar),
            },
            _ => job.run(Scalar),
        }
    }
}
