//! The oracle: plain operations, one child, ray or triangle at a time.

use super::{Hull, Kernel, LANES, LeafRows, Rows, Spheres, Stack, ray_of};
use crate::exact::rays::{GROUP, GROUPS, RaySet};
use umbrage_accel::NodeView;
use umbrage_geom::kernel::{BlockMask, TriangleBlock, fan::scalar::Planes};

/// Portable code.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Scalar;

/// Whether ray number `ray` may meet the box in `child`; see [`super::Kernel::box_rays`].
fn enters(rows: &Rows, child: usize, rays: &RaySet, ray: usize) -> bool {
    let (mut entry, mut exit) = (0f32, rays.far[ray]);
    for axis in 0..3 {
        let inverse = rays.inverse[axis][ray];
        let row = 2 * axis + usize::from(inverse < 0.0);
        let (near, far) = (rows.0[row][child] * inverse, rows.0[row ^ 1][child] * inverse);
        // The comparisons are false for NaN, which drops it.
        entry = if near > entry { near } else { entry };
        exit = if far < exit { far } else { exit };
    }
    entry <= exit * super::INTERVAL_WIDENING + f32::MIN_POSITIVE
}

fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

#[allow(clippy::neg_cmp_op_on_partial_ord)] // NaN has to count as met
impl Kernel for Scalar {
    type Planes = Planes;

    fn rows(self, node: NodeView<'_>, origin: [f32; 3]) -> Rows {
        let (base, step) = (node.base(), node.step());
        let mut rows = Rows([[0.0; LANES]; 6]);
        for (i, (row, numbers)) in rows.0.iter_mut().zip(node.grid()).enumerate() {
            for (x, &number) in row.iter_mut().zip(numbers) {
                *x = (base[i / 2] + f32::from(number) * step[i / 2]) - origin[i / 2];
            }
        }
        rows
    }

    fn inside(self, rows: &Rows, hull: &Hull) -> u32 {
        (0..LANES).fold(0, |mask, i| {
            let gap = [0, 1, 2].map(|axis| rows.0[2 * axis][i].max(-rows.0[2 * axis + 1][i]).max(0.0));
            let top = [0, 1, 2].map(|axis| rows.0[2 * axis + 1 - hull.down[axis]][i]);
            let size = top.iter().fold(0f32, |sum, x| sum + x.abs());
            let inside = dot(gap, gap) <= hull.radius2 && dot(top, hull.up) >= -1e-5 * size - 1e-30;
            mask | u32::from(inside) << i
        })
    }

    fn around(self, rows: &Rows) -> u32 {
        (0..LANES).fold(0, |mask, i| {
            let inside = (0..3).all(|axis| rows.0[2 * axis][i] <= 0.0 && rows.0[2 * axis + 1][i] >= 0.0);
            mask | u32::from(inside) << i
        })
    }

    fn spheres(self, rows: &Rows) -> Spheres {
        let row = [0.0; LANES];
        let mut spheres = Spheres { center: [row; 3], slack: row, tangent: row, radius: row };
        for i in 0..LANES {
            let (mut distance2, mut radius2) = (0.0, 0.0);
            for axis in 0..3 {
                let (low, high) = (rows.0[2 * axis][i], rows.0[2 * axis + 1][i]);
                let (center, half) = ((low + high) * 0.5, (high - low) * 0.5);
                spheres.center[axis][i] = center;
                distance2 += center * center;
                radius2 += half * half;
            }
            let outside = radius2 < distance2 * 0.999 && distance2 > 1e-30 && distance2 < f32::INFINITY;
            spheres.tangent[i] = if outside { (distance2 - radius2).sqrt() } else { 0.0 };
            spheres.radius[i] = if outside { radius2.sqrt() } else { f32::INFINITY };
            spheres.slack[i] = 4e-6 * (spheres.tangent[i] + spheres.radius[i]);
        }
        spheres
    }

    fn ahead(self, spheres: &Spheres, hull: &Hull) -> u32 {
        (0..LANES).fold(0, |mask, i| {
            let along = spheres.slack[i] + dot(hull.axis, spheres.center.map(|row| row[i]));
            let rest = hull.angle[1] * spheres.radius[i] - hull.angle[0] * spheres.tangent[i];
            mask | u32::from(!(along + rest < 0.0)) << i
        })
    }

    fn cones(self, spheres: &Spheres, child: usize, rays: &RaySet) -> u32 {
        let center = spheres.center.map(|row| row[child]);
        (0..GROUPS).fold(0, |mask, g| {
            let along = spheres.slack[child] + dot(rays.axis.map(|row| row[g]), center);
            let rest = rays.sin[g] * spheres.radius[child] - rays.cos[g] * spheres.tangent[child];
            // NaN counts as met.
            mask | u32::from(!(along + rest < 0.0)) << g
        })
    }

    fn box_groups(self, rows: &Rows, child: usize, rays: &RaySet, hull: &Hull) -> u32 {
        (0..GROUPS).fold(0, |mask, g| {
            let (mut entry, mut exit) = (0f32, hull.radius);
            for axis in 0..3 {
                let (low, high) = (rows.0[2 * axis][child], rows.0[2 * axis + 1][child]);
                let [a, b] = [rays.ends[axis][0][g], rays.ends[axis][1][g]];
                if !a.is_nan() {
                    let all = [low * a, low * b, high * a, high * b];
                    entry = entry.max(all.into_iter().fold(f32::INFINITY, f32::min));
                    exit = exit.min(all.into_iter().fold(f32::NEG_INFINITY, f32::max));
                }
            }
            // NaN, from overflow, counts as met.
            mask | u32::from(!(entry > exit * (1.0 + 1e-5) + f32::MIN_POSITIVE)) << g
        })
    }

    fn box_rays(self, rows: &Rows, child: usize, rays: &RaySet, group: usize) -> u32 {
        (0..GROUP).fold(0, |mask, i| mask | u32::from(enters(rows, child, rays, group * GROUP + i)) << i)
    }

    fn push_rays(
        self,
        children: &[u32; LANES],
        rows: &Rows,
        rays: &RaySet,
        ids: u32,
        left: u32,
        wanted: u32,
        stack: &mut Stack,
        mut top: usize,
    ) -> usize {
        let bottom = top;
        for child in (0..LANES).rev().filter(|child| wanted >> child & 1 == 1) {
            let may = |bit: u32| left >> bit & 1 == 1 && enters(rows, child, rays, ray_of(ids, bit));
            let column = (0..32).fold(0, |column, bit| column | u32::from(may(bit)) << bit);
            if column != 0 {
                // By insertion, most rays on top.
                let mut at = top;
                while at > bottom && stack.rays[at - 1].count_ones() > column.count_ones() {
                    (stack.children[at], stack.rays[at]) = (stack.children[at - 1], stack.rays[at - 1]);
                    at -= 1;
                }
                (stack.children[at], stack.groups[top], stack.rays[at]) = (children[child], ids, column);
                top += 1;
            }
        }
        top
    }

    fn planes(self, block: &TriangleBlock, origin: [f32; 3]) -> Planes {
        Planes::new(block, origin)
    }

    fn ask_sides(self, planes: &mut Planes, block: &TriangleBlock, origin: [f32; 3], lanes: u8) {
        planes.ask_sides(block, origin, lanes);
    }

    fn leaf_rows(self, planes: &Planes) -> LeafRows {
        let mut lengths = [[0.0; LANES]; 3];
        for (row, normal) in lengths.iter_mut().zip(planes.normals()) {
            for (lane, length) in row.iter_mut().enumerate() {
                let n = normal.map(|row| row[lane]);
                *length = (dot(n, n) + super::MIN_SQUARED_LENGTH).sqrt();
            }
        }
        LeafRows { planes: *planes, lengths }
    }

    fn ray_lanes(self, planes: &Planes, rays: &RaySet, ray: usize) -> BlockMask {
        planes.filter(rays.direction.map(|row| row[ray]), 0.0, rays.far[ray])
    }

    fn above(self, block: &TriangleBlock, origin: [f32; 3], hull: &Hull) -> u32 {
        block.above(origin, hull.up).into()
    }

    fn near(self, rows: &LeafRows, hull: &Hull) -> u32 {
        let LeafRows { planes, .. } = rows;
        (0..LANES).fold(0, |mask, lane| {
            let sum = [0, 1, 2].map(|axis| planes.normals().iter().map(|n| n[axis][lane]).sum::<f32>());
            let reach = hull.radius
                * ((dot(sum, sum) + super::MIN_SQUARED_LENGTH).sqrt() * (1.0 + 1e-5)
                    + 8.0 * planes.error()[lane]);
            let height = planes.volume()[lane].abs() - planes.volume_error()[lane];
            // NaN counts as near.
            mask | u32::from(!(height > reach)) << lane
        })
    }

    fn lane_groups(self, rows: &LeafRows, lane: usize, rays: &RaySet) -> u32 {
        (0..GROUPS).fold(0, |mask, group| {
            let axis = rays.axis.map(|row| row[group]);
            let (mut below, mut above) = (false, false);
            for (normal, lengths) in rows.planes.normals().iter().zip(&rows.lengths) {
                let middle = dot(axis, normal.map(|row| row[lane]));
                let reach = rays.chord[group] * lengths[lane] + 4.0 * rows.planes.error()[lane];
                below |= middle + reach < 0.0;
                above |= middle - reach > 0.0;
            }
            mask | u32::from(!(below && above)) << group
        })
    }

    fn lane_rays(self, rows: &LeafRows, lane: usize, rays: &RaySet, group: usize) -> BlockMask {
        let [x, y, z] = &rays.direction;
        let direction = [rays.of_group(x, group), rays.of_group(y, group), rays.of_group(z, group)];
        rows.planes.filter_rays(lane, direction, rays.of_group(&rays.far, group))
    }

    fn prefetch(self, _: *const u8, _: usize) {}
}
