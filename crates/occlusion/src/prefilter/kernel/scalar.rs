//! The oracle: plain operations, one child at a time.

use super::{Kernel, Prepared, Step};
use crate::prefilter::wide::{Node, WIDTH};
use umbrage_geom::{
    glam::Vec3,
    kernel::{BlockMask, BlockRay, TriangleBlock, scalar},
};

/// Portable code.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Scalar;

impl Kernel for Scalar {
    #[inline]
    fn distances(self, node: &Node, origin: Vec3) -> [f32; WIDTH] {
        std::array::from_fn(|i| {
            (0..3).fold(0.0, |sum, axis| {
                let middle = (node.bounds[2 * axis][i] + node.bounds[2 * axis + 1][i]) * 0.5 - origin[axis];
                sum + middle * middle
            })
        })
    }

    #[inline]
    fn step(self, node: &Node, ray: &Prepared, distances: &[f32; WIDTH]) -> Step {
        let mut step = Step { descend: 0, stop: 0, fraction: [0.0; WIDTH] };
        for (i, distance) in distances.iter().enumerate() {
            let (mut entry, mut exit) = (f32::NEG_INFINITY, f32::INFINITY);
            for axis in 0..3 {
                let row = ray.near_row[axis];
                let (near, far) = (node.bounds[row][i], node.bounds[row ^ 1][i]);
                // The comparisons are false for NaN, which drops it.
                let t0 = (near - ray.slab.origin_near[axis]) * ray.slab.inv_near[axis];
                let t1 = (far - ray.slab.origin_far[axis]) * ray.slab.inv_far[axis];
                entry = if t0 > entry { t0 } else { entry };
                exit = if t1 < exit { t1 } else { exit };
            }
            let t0 = if entry > ray.slab.tnear { entry } else { ray.slab.tnear };
            let t1 = if exit < ray.slab.tfar { exit } else { ray.slab.tfar };
            if t0 <= t1 {
                if node.reach[i] < ray.kappa * distance {
                    step.stop |= 1 << i;
                    step.fraction[i] = ((t1 - t0) + ray.raise) / ((exit - entry) + ray.raise);
                } else {
                    step.descend |= 1 << i;
                }
            }
        }
        step
    }

    #[inline]
    fn filter(self, block: &TriangleBlock, ray: &BlockRay) -> BlockMask {
        scalar::filter(block, ray)
    }
}
