//! The oracle: plain operations, one child at a time.

use super::{Kernel, NodeRay};
use crate::node::{Node, WIDTH};
use umbrage_geom::kernel::{BlockMask, BlockRay, TriangleBlock, scalar};

/// Portable code.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Scalar;

impl Kernel for Scalar {
    #[inline]
    fn mask(self, node: &Node, ray: &NodeRay, tfar: f32) -> u32 {
        self.entries(node, ray, tfar, &mut [0.0; WIDTH])
    }

    #[inline]
    fn entries(self, node: &Node, ray: &NodeRay, tfar: f32, entries: &mut [f32; WIDTH]) -> u32 {
        let mut exits = [tfar; WIDTH];
        *entries = [ray.slab.tnear; WIDTH];
        for axis in 0..3 {
            let (near, far) = (&node.bounds[ray.near_row[axis]], &node.bounds[ray.near_row[axis] ^ 1]);
            for i in 0..WIDTH {
                // The comparisons are false for NaN, which drops it.
                let entry = (near[i] - ray.slab.origin_near[axis]) * ray.slab.inv_near[axis];
                let exit = (far[i] - ray.slab.origin_far[axis]) * ray.slab.inv_far[axis];
                entries[i] = if entry > entries[i] { entry } else { entries[i] };
                exits[i] = if exit < exits[i] { exit } else { exits[i] };
            }
        }
        (0..WIDTH).fold(0, |mask, i| mask | u32::from(entries[i] <= exits[i]) << i)
    }

    #[inline]
    fn filter(self, block: &TriangleBlock, ray: &BlockRay) -> BlockMask {
        scalar::filter(block, ray)
    }
}
