//! The oracle: plain operations, one child at a time.

use super::{Columns, FanNode, Kernel, Prepared, Step};
use crate::prefilter::{
    fan::FAN,
    wide::{Node, WIDTH},
};
use umbrage_geom::{
    glam::Vec3,
    kernel::{
        BlockMask, BlockRay, TriangleBlock,
        fan::{self, FanRays},
        scalar,
    },
};

/// Portable code.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Scalar;

impl Kernel for Scalar {
    #[inline]
    fn sizes(self, node: &Node, origin: Vec3) -> [f32; WIDTH] {
        self.look(node, origin.to_array()).sizes
    }

    #[inline]
    fn step(self, node: &Node, ray: &Prepared, sizes: &[f32; WIDTH]) -> Step {
        let mut step = Step { descend: 0, stop: 0, fraction: [0.0; WIDTH] };
        for (i, &size) in sizes.iter().enumerate() {
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
                if size < ray.kappa {
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

    #[inline]
    fn look(self, node: &Node, origin: [f32; 3]) -> FanNode {
        let mut seen = FanNode { rows: node.bounds, sizes: node.reach, used: (1 << node.len()) - 1 };
        for i in 0..WIDTH {
            let mut distance = 0.0;
            for (axis, from) in origin.into_iter().enumerate() {
                seen.rows[2 * axis][i] -= from;
                seen.rows[2 * axis + 1][i] -= from;
                let middle = (seen.rows[2 * axis][i] + seen.rows[2 * axis + 1][i]) * 0.5;
                distance += middle * middle;
            }
            seen.sizes[i] /= distance;
        }
        seen
    }

    #[inline]
    fn any_below(self, node: &FanNode, kappa: f32) -> bool {
        node.sizes.iter().any(|&size| size < kappa)
    }

    #[inline]
    fn enter(self, node: &FanNode, rays: &FanRays<FAN>, r: usize, columns: &mut Columns) {
        self.enter_or_stop(node, rays, r, 0.0, 0.0, columns);
    }

    #[inline]
    fn enter_or_stop(
        self,
        node: &FanNode,
        rays: &FanRays<FAN>,
        r: usize,
        kappa: f32,
        raise: f32,
        columns: &mut Columns,
    ) -> (u32, [f32; WIDTH]) {
        let (mut stop, mut fraction) = (0, [0.0; WIDTH]);
        for (i, fraction) in fraction.iter_mut().enumerate() {
            let (mut entry, mut exit) = (f32::NEG_INFINITY, f32::INFINITY);
            for axis in 0..3 {
                let row = 2 * axis + (rays.negative[axis][r] as usize & 1);
                let t0 = node.rows[row][i] * rays.inv_near[axis][r];
                let t1 = node.rows[row ^ 1][i] * rays.inv_far[axis][r];
                // The comparisons are false for NaN, which drops it.
                entry = if t0 > entry { t0 } else { entry };
                exit = if t1 < exit { t1 } else { exit };
            }
            let t0 = if entry > rays.slab_near[r] { entry } else { rays.slab_near[r] };
            let t1 = if exit < rays.slab_far[r] { exit } else { rays.slab_far[r] };
            if t0 <= t1 {
                if node.sizes[i] < kappa {
                    stop |= 1 << i;
                    *fraction = ((t1 - t0) + raise) / ((exit - entry) + raise);
                } else {
                    columns.0[i] |= 1 << r;
                }
            }
        }
        (stop, fraction)
    }

    #[inline]
    fn nonzero(self, columns: &Columns) -> u32 {
        (0..WIDTH).fold(0, |mask, i| mask | u32::from(columns.0[i] != 0) << i)
    }

    #[inline(always)]
    fn prefetch<T>(self, _: &[T], _: usize) {}

    type Planes = fan::scalar::Planes;

    #[inline]
    fn planes(self, block: &TriangleBlock, origin: [f32; 3]) -> Self::Planes {
        fan::scalar::Planes::new(block, origin)
    }

    #[inline]
    fn fan_filter(self, planes: &Self::Planes, rays: &FanRays<FAN>, r: usize) -> BlockMask {
        let [x, y, z] = &rays.direction;
        planes.filter([x[r], y[r], z[r]], rays.near[r], rays.far[r])
    }
}
