//! The oracle: plain operations, one child at a time.

use super::FAN;
use super::{Kernel, NodeRay};
use crate::node::{Node, WIDTH};
use umbrage_geom::kernel::{
    BlockMask, BlockRay, TriangleBlock,
    fan::{self, FanRays},
    scalar,
};

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

    #[inline]
    fn fan_mask<const N: usize>(self, node: &Node, origin: [f32; 3], rays: &FanRays<N>, r: usize) -> u32 {
        let (mut entries, mut exits) = ([rays.slab_near[r]; WIDTH], [rays.slab_far[r]; WIDTH]);
        for axis in 0..3 {
            let row = 2 * axis + rays.negative[axis][r] as usize;
            let (near, far) = (&node.bounds[row], &node.bounds[row ^ 1]);
            for i in 0..WIDTH {
                let entry = (near[i] - origin[axis]) * rays.inv_near[axis][r];
                let exit = (far[i] - origin[axis]) * rays.inv_far[axis][r];
                entries[i] = if entry > entries[i] { entry } else { entries[i] };
                exits[i] = if exit < exits[i] { exit } else { exits[i] };
            }
        }
        (0..WIDTH).fold(0, |mask, i| mask | u32::from(entries[i] <= exits[i]) << i)
    }

    #[inline]
    fn overlap(self, node: &Node, origin: [f32; 3], low: [f32; 3], high: [f32; 3]) -> u32 {
        let reaches = |i: usize| {
            (0..3).all(|axis| {
                node.bounds[2 * axis][i] - origin[axis] <= high[axis]
                    && node.bounds[2 * axis + 1][i] - origin[axis] >= low[axis]
            })
        };
        (0..WIDTH).fold(0, |mask, i| mask | u32::from(reaches(i)) << i)
    }

    type Planes = fan::scalar::Planes;

    #[inline]
    fn planes(self, block: &TriangleBlock, origin: [f32; 3]) -> Self::Planes {
        Self::Planes::new(block, origin)
    }

    #[inline]
    fn fan_filter(self, planes: &Self::Planes, rays: &FanRays<FAN>, r: usize) -> BlockMask {
        planes.filter(rays.direction.map(|row| row[r]), rays.near[r], rays.far[r])
    }

    #[inline]
    fn columns(self, rows: [u64; FAN / 8]) -> [u32; WIDTH] {
        let mut columns = [0; WIDTH];
        for (i, row) in rows.into_iter().flat_map(u64::to_le_bytes).enumerate() {
            for (c, column) in columns.iter_mut().enumerate() {
                *column |= u32::from(row >> c & 1) << i;
            }
        }
        columns
    }
}
