//! The oracle: plain operations, one child at a time.

use super::{
    Ahead, Columns, FAN, Fan, Kernel, NodeRay, Rows, SHARE_OF_MARK_1, SHORTEST_WAY, Sizes, Stack, surely,
};
use crate::{
    node::{Node, NodeNote, WIDTH},
    solid::SolidPack,
};
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
            let (near, far) = (node.row(ray.near_row[axis]), node.row(ray.near_row[axis] ^ 1));
            for i in 0..WIDTH {
                // The comparisons are false for NaN, which drops it.
                let entry = (near[i] - ray.slab.origin_near[axis]) * ray.slab.inv_near[axis];
                let exit = (far[i] - ray.slab.origin_far[axis]) * ray.slab.inv_far[axis];
                entries[i] = if entry > entries[i] { entry } else { entries[i] };
                exits[i] = if exit < exits[i] { exit } else { exits[i] };
            }
        }
        (0..WIDTH).fold(0, |mask, i| mask | u32::from(entries[i] <= exits[i]) << i) & node.used
    }

    #[inline]
    fn crossed(self, pack: &SolidPack, ray: &NodeRay) -> u32 {
        let crosses = |i: &usize| ray.slab.surely_crosses(&pack.get(*i));
        (0..WIDTH).filter(crosses).fold(0, |mask, i| mask | 1 << i)
    }

    #[inline]
    fn pack_rows(self, pack: &SolidPack, origin: [f32; 3]) -> Rows {
        Rows([0, 1, 2, 3, 4, 5].map(|row| pack.rows[row].map(|plane| plane - origin[row / 2])))
    }

    #[inline]
    fn fan_crossed(self, rows: &Rows, rays: &FanRays<FAN>, r: usize) -> u32 {
        let [start, end] = surely(rays.slab_near[r], rays.slab_far[r]);
        let crosses = |i: &usize| {
            let (mut entries, mut exit) = ([start, 0.0, 0.0, 0.0], end);
            for axis in 0..3 {
                let row = 2 * axis + (rays.negative[axis][r] as usize & 1);
                entries[axis + 1] = rows.0[row][*i] * rays.inv_far[axis][r];
                exit = (rows.0[row ^ 1][*i] * rays.inv_near[axis][r]).min(exit);
            }
            // False for NaN.
            entries.iter().all(|&entry| entry < exit)
        };
        (0..WIDTH).filter(crosses).fold(0, |mask, i| mask | 1 << i)
    }

    #[inline]
    fn filter(self, block: &TriangleBlock, ray: &BlockRay) -> BlockMask {
        scalar::filter(block, ray)
    }

    #[inline]
    fn rows(self, node: &Node, origin: [f32; 3]) -> Rows {
        Rows([0, 1, 2, 3, 4, 5].map(|row| node.row(row).map(|plane| plane - origin[row / 2])))
    }

    #[inline]
    fn fan_mask<const N: usize>(self, rows: &Rows, rays: &FanRays<N>, r: usize) -> u32 {
        let (mut entries, mut exits) = ([rays.slab_near[r]; WIDTH], [rays.slab_far[r]; WIDTH]);
        for axis in 0..3 {
            let row = 2 * axis + rays.negative[axis][r] as usize;
            let (near, far) = (&rows.0[row], &rows.0[row ^ 1]);
            for i in 0..WIDTH {
                let entry = near[i] * rays.inv_near[axis][r];
                let exit = far[i] * rays.inv_far[axis][r];
                entries[i] = if entry > entries[i] { entry } else { entries[i] };
                exits[i] = if exit < exits[i] { exit } else { exits[i] };
            }
        }
        (0..WIDTH).fold(0, |mask, i| mask | u32::from(entries[i] <= exits[i]) << i)
    }

    #[inline]
    fn overlap(self, rows: &Rows, low: [f32; 3], high: [f32; 3]) -> u32 {
        let reaches = |i: usize| {
            (0..3).all(|axis| rows.0[2 * axis][i] <= high[axis] && rows.0[2 * axis + 1][i] >= low[axis])
        };
        (0..WIDTH).fold(0, |mask, i| mask | u32::from(reaches(i)) << i)
    }

    type Planes = fan::scalar::Planes;

    #[inline]
    fn prefetch(self, _: *const u8, _: usize) {}

    #[inline]
    fn planes(self, block: &TriangleBlock, origin: [f32; 3]) -> Self::Planes {
        Self::Planes::new(block, origin)
    }

    #[inline]
    fn ask_sides(self, planes: &mut Self::Planes, block: &TriangleBlock, origin: [f32; 3], lanes: u8) {
        planes.ask_sides(block, origin, lanes);
    }

    #[inline]
    fn fan_filter(self, planes: &Self::Planes, rays: &FanRays<FAN>, r: usize) -> BlockMask {
        planes.filter([0, 1, 2].map(|axis| rays.direction[axis][r]), rays.near[r], rays.far[r])
    }

    #[inline]
    fn fan_push(
        self,
        node: &Node,
        rows: &Rows,
        fan: &Fan,
        left: u32,
        wanted: u32,
        stack: &mut Stack,
        top: usize,
    ) -> usize {
        let mut columns = [0; WIDTH];
        for r in (0..FAN).filter(|r| left >> r & 1 == 1) {
            let entered = self.fan_mask(rows, &fan.rays, r) & wanted;
            columns.iter_mut().enumerate().for_each(|(i, column)| *column |= (entered >> i & 1) << r);
        }
        self.push(node, rows, fan, &Columns(columns), wanted, stack, top)
    }

    #[inline]
    fn sizes(self, rows: &Rows, note: &NodeNote) -> Sizes {
        let mut sizes = Sizes([0.0; WIDTH]);
        for (i, size) in sizes.0.iter_mut().enumerate() {
            let (mut square, mut distance) = (0.0, 0.0);
            for axis in 0..3 {
                let (low, high) = (rows.0[2 * axis][i], rows.0[2 * axis + 1][i]);
                square += (high - low) * (high - low);
                distance += (low + high) * (low + high);
            }
            *size = if note.marks[i] == 0 {
                f32::INFINITY
            } else {
                square * (f32::from(note.marks[i]) * SHARE_OF_MARK_1) / distance
            };
        }
        sizes
    }

    #[inline]
    fn smaller(self, sizes: &Sizes, limit: f32) -> u32 {
        (0..WIDTH).fold(0, |mask, i| mask | u32::from(sizes.0[i] < limit) << i)
    }

    #[inline]
    fn enter_or_end(
        self,
        rows: &Rows,
        sizes: &Sizes,
        rays: &FanRays<FAN>,
        r: usize,
        limit: f32,
        columns: &mut Columns,
        covered: &mut [f32; WIDTH],
    ) -> u32 {
        let mut ends = 0;
        for (i, covered) in covered.iter_mut().enumerate() {
            let (mut entry, mut exit) = (f32::NEG_INFINITY, f32::INFINITY);
            for axis in 0..3 {
                let row = 2 * axis + (rays.negative[axis][r] as usize & 1);
                let t0 = rows.0[row][i] * rays.inv_near[axis][r];
                let t1 = rows.0[row ^ 1][i] * rays.inv_far[axis][r];
                // The comparisons are false for NaN, which drops it.
                entry = if t0 > entry { t0 } else { entry };
                exit = if t1 < exit { t1 } else { exit };
            }
            let t0 = if entry > rays.slab_near[r] { entry } else { rays.slab_near[r] };
            let t1 = if exit < rays.slab_far[r] { exit } else { rays.slab_far[r] };
            *covered = 0.0;
            if t0 <= t1 && sizes.0[i] < limit {
                ends |= 1 << i;
                *covered = ((t1 - t0) + SHORTEST_WAY) / ((exit - entry) + SHORTEST_WAY);
            } else if t0 <= t1 {
                columns.0[i] |= 1 << r;
            }
        }
        ends
    }

    #[inline]
    fn push(
        self,
        node: &Node,
        rows: &Rows,
        fan: &Fan,
        columns: &Columns,
        wanted: u32,
        stack: &mut Stack,
        mut top: usize,
    ) -> usize {
        let key = |i: usize| {
            let middle = [0, 1, 2].map(|axis| rows.0[2 * axis][i] + rows.0[2 * axis + 1][i]);
            let [x, y, z] = [0, 1, 2].map(|axis| fan.ahead.direction[axis] * middle[axis]);
            (columns.0[i].count_ones() as f32 - (x + y + z + fan.ahead.offset).clamp(0.0, Ahead::MOST))
                * node.merit(i)
        };
        let (bottom, mut keys) = (top, [0.0; WIDTH]);
        for i in (0..WIDTH).filter(|&i| columns.0[i] != 0 && wanted >> i & 1 == 1) {
            // Insertion, the largest key on top.
            let mut at = top;
            while at > bottom && keys[at - 1 - bottom] > key(i) {
                stack.children[at] = stack.children[at - 1];
                stack.rays[at] = stack.rays[at - 1];
                keys[at - bottom] = keys[at - 1 - bottom];
                at -= 1;
            }
            (stack.children[at], stack.rays[at], keys[at - bottom]) =
                (node.children[i], columns.0[i], key(i));
            top += 1;
        }
        top
    }
}
