//! Micropolygons of all patches of a surface, at one rate a patch, in little memory.
//!
//! Blocks of 2 x 2 cells, eight triangles, lie below nodes of eight boxes, rounded outwards to numbers of 8 bits. Which
//! blocks a node has follows from the levels of its patch: blocks in Morton order, eight in turn. Vertices of a patch lie
//! row by row, one axis after the other.

use crate::mesh::grid::GridRay;
use umbrage_accel::FAN;
use umbrage_geom::{
    Aabb, Ray, TriangleHit,
    glam::Vec3,
    intersect_triangle,
    kernel::{
        BlockMask, BoxBlock, CellBlock,
        fan::{self, FanRays},
        scalar,
    },
    segment_hits_triangle,
    simd::{Avx2, BackEnd},
};

/// A block seen from the origin of a fan.
enum Planes {
    Scalar(fan::scalar::Planes),
    #[cfg(target_arch = "x86_64")]
    Avx2(fan::x86::Planes),
}

/// Where the cells of a patch are.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PatchCells {
    pub(crate) levels: [u8; 2],
    /// Whether borders were moved, so that cells may have collapsed.
    stitched: bool,
    first_node: u32,
    /// Of its first number in the array of coordinates.
    first_number: usize,
}

/// See the [module](self).
#[derive(Debug)]
pub(crate) struct Cells {
    patches: Vec<PatchCells>,
    numbers: Vec<f32>,
    nodes: Vec<BoxBlock>,
    patch_of: Vec<u32>,
    avx2: Option<Avx2>,
}

/// Every other bit.
#[inline(always)]
fn compact(x: u32) -> u32 {
    let x = x & 0x5555_5555;
    let x = (x | x >> 1) & 0x3333_3333;
    let x = (x | x >> 2) & 0x0f0f_0f0f;
    let x = (x | x >> 4) & 0x00ff_00ff;
    (x | x >> 8) & 0xffff
}

/// Column and row of block `index` of `2^bits[0]` by `2^bits[1]`.
#[inline(always)]
fn block_at(index: u32, bits: [u32; 2]) -> [usize; 2] {
    let square = bits[0].min(bits[1]);
    let low = index & ((1 << (2 * square)) - 1);
    let high = index >> (2 * square) << square;
    let [x, y] = [compact(low), compact(low >> 1)];
    // Not by `map`, which is not inlined into functions with target features.
    if bits[0] > bits[1] { [(x | high) as usize, y as usize] } else { [x as usize, (y | high) as usize] }
}

impl PatchCells {
    #[inline(always)]
    fn bits(&self) -> [u32; 2] {
        [u32::from(self.levels[0].saturating_sub(1)), u32::from(self.levels[1].saturating_sub(1))]
    }

    #[inline(always)]
    fn blocks(&self) -> u32 {
        let [a, b] = self.bits();
        1 << (a + b)
    }

    #[inline(always)]
    fn columns(&self) -> usize {
        (1 << self.levels[0]) + 1
    }

    #[inline(always)]
    fn rows(&self) -> usize {
        (1 << self.levels[1]) + 1
    }

    #[inline(always)]
    fn vertices(&self) -> usize {
        self.columns() * self.rows()
    }

    /// Vertices of a triangle: cell by cell, row by row, the lower one first.
    pub(crate) fn triangle(&self, index: u32) -> [usize; 3] {
        let (cell, columns) = (index as usize / 2, self.columns());
        let corner = cell % (columns - 1) + cell / (columns - 1) * columns;
        if index.is_multiple_of(2) {
            [corner, corner + 1, corner + columns + 1]
        } else {
            [corner, corner + columns + 1, corner + columns]
        }
    }
}

impl Cells {
    /// Room for patches of these levels.
    pub(crate) fn new(levels: &[[u8; 2]]) -> Self {
        let (mut patches, mut first_number, mut first_node) = (Vec::with_capacity(levels.len()), 0, 0);
        for &levels in levels {
            let patch = PatchCells { levels, stitched: false, first_node, first_number };
            first_number += 3 * patch.vertices();
            first_node += patch.blocks().div_ceil(8);
            patches.push(patch);
        }
        Self {
            patches,
            // Rows of three are read by fours.
            numbers: vec![0.0; first_number + 2],
            nodes: Vec::with_capacity(first_node as usize),
            patch_of: Vec::with_capacity(first_node as usize),
            avx2: BackEnd::best().instructions().avx2(),
        }
    }

    /// Adds the next patch, vertices row by row.
    pub(crate) fn push(&mut self, vertices: &[Vec3], stitched: bool, boxes: &mut Vec<Aabb>) {
        let index = self.patch_of.last().map_or(0, |&last| last + 1);
        self.patches[index as usize].stitched = stitched;
        let patch = self.patches[index as usize];
        for axis in 0..3 {
            let start = patch.first_number + axis * vertices.len();
            for (number, p) in self.numbers[start..][..vertices.len()].iter_mut().zip(vertices) {
                *number = p[axis];
            }
        }
        let bits = patch.bits();
        for first in (0..patch.blocks()).step_by(8) {
            let mut children = [Aabb::EMPTY; 8];
            let count = (patch.blocks() - first).min(8);
            for (block, child) in (first..first + count).zip(&mut children) {
                let [x, y] = block_at(block, bits);
                let (x, y) = (2 * x, 2 * y);
                for j in y..=(y + 2).min(patch.rows() - 1) {
                    for i in x..=(x + 2).min(patch.columns() - 1) {
                        *child = child.with_point(vertices[j * patch.columns() + i]);
                    }
                }
            }
            let children = &children[..count as usize];
            self.nodes.push(BoxBlock::new(children));
            self.patch_of.push(index);
            boxes.push(children.iter().fold(Aabb::EMPTY, |all, b| all.union(*b)));
        }
    }

    /// Patch that a node belongs to.
    #[inline(always)]
    pub(crate) fn patch_of(&self, node: u32) -> u32 {
        self.patch_of[node as usize]
    }

    pub(crate) fn patch(&self, patch: u32) -> &PatchCells {
        &self.patches[patch as usize]
    }

    pub(crate) fn bytes(&self) -> usize {
        size_of_val(&self.patches[..])
            + size_of_val(&self.numbers[..])
            + size_of_val(&self.nodes[..])
            + size_of_val(&self.patch_of[..])
    }

    #[inline(always)]
    pub(crate) fn vertex(&self, patch: &PatchCells, index: usize) -> [f32; 3] {
        let (numbers, count) = (&self.numbers[patch.first_number..], patch.vertices());
        [numbers[index], numbers[count + index], numbers[2 * count + index]]
    }

    /// Corners of a triangle of a patch.
    #[inline]
    pub(crate) fn corners(&self, patch: &PatchCells, triangle: u32) -> [[f32; 3]; 3] {
        let [a, b, c] = patch.triangle(triangle);
        [self.vertex(patch, a), self.vertex(patch, b), self.vertex(patch, c)]
    }

    /// The triangles of a block and the index of the first; those of its second row of cells come a row of cells later.
    #[inline(always)]
    fn gather(&self, patch: &PatchCells, block: u32) -> (CellBlock, u32) {
        let [x, y] = block_at(block, patch.bits());
        let (x, y) = (2 * x, 2 * y);
        let [columns, rows] = [patch.columns(), patch.rows()];
        let mut vertices = [[[0f32; 4]; 3]; 3];
        for (axis, rows_of_axis) in vertices.iter_mut().enumerate() {
            for (j, place) in rows_of_axis.iter_mut().enumerate() {
                // A block of one row of cells has no third row of vertices.
                let row = axis * columns * rows + (y + j).min(rows - 1) * columns + x;
                if let Some(row) = self.numbers[patch.first_number + row..].first_chunk() {
                    *place = *row;
                }
            }
        }
        let mut used = 0xff;
        if patch.levels[0] == 0 {
            used &= 0x33;
        }
        if patch.levels[1] == 0 {
            used &= 0x0f;
        }
        if patch.stitched {
            used &= !collapsed(&vertices);
        }
        (CellBlock::new(vertices, used), 2 * (y * (columns - 1) + x) as u32)
    }

    /// Looks for hits below a node: any, or the one with the smallest `t` up to where `ray` ends, into `closest`, with the
    /// index of its triangle in the patch; ties go to the smallest. Whether there was one.
    #[inline(always)]
    pub(crate) fn trace<const ANY: bool>(
        &self,
        node: u32,
        ray: &mut GridRay,
        closest: &mut Option<(TriangleHit, u32)>,
    ) -> bool {
        let mut mask = self.entered(&self.nodes[node as usize], ray);
        let patch = &self.patches[self.patch_of[node as usize] as usize];
        let first = 8 * (node - patch.first_node);
        let count = patch.blocks() - first;
        if count < 8 {
            mask &= (1 << count) - 1;
        }
        let mut found = false;
        while mask != 0 {
            let block = first + mask.trailing_zeros();
            mask &= mask - 1;
            let (cells, first) = self.gather(patch, block);
            let BlockMask { certain, uncertain } = self.filter(&cells, ray);
            if ANY && certain != 0 {
                return true;
            }
            let mut open = certain | uncertain;
            while open != 0 {
                let lane = open.trailing_zeros() & 7;
                open &= open - 1;
                let triangle = first + (lane & 3) + (lane >> 2) * 2 * (patch.columns() as u32 - 1);
                let corners = self.corners(patch, triangle);
                if ANY {
                    if segment_hits_triangle(&ray.ray, corners) {
                        return true;
                    }
                    continue;
                }
                let Some(hit) = intersect_triangle(&ray.ray, corners) else { continue };
                let nearer = match closest {
                    Some((old, index)) => hit.t < old.t || (hit.t == old.t && triangle < *index),
                    None => true,
                };
                if nearer {
                    found = true;
                    *closest = Some((hit, triangle));
                    ray.end_behind(hit.t);
                }
            }
        }
        found
    }

    /// Those of some rays of a fan from `origin` that hit something below a node, a bit each; `ray(r)` is the one with bit `r`.
    #[inline(always)]
    pub(crate) fn trace_fan(
        &self,
        node: u32,
        rays: u32,
        fan: &FanRays<FAN>,
        origin: [f32; 3],
        all: &[Ray],
    ) -> u32 {
        let patch = &self.patches[self.patch_of[node as usize] as usize];
        let first = 8 * (node - patch.first_node);
        let columns = self.columns(&self.nodes[node as usize], origin, fan, rays);
        let mut hit = 0;
        for (block, entered) in (first..patch.blocks()).zip(columns) {
            let mut left = entered & !hit;
            if left == 0 {
                continue;
            }
            let (cells, first) = self.gather(patch, block);
            let planes = self.planes(&cells, origin);
            while left != 0 {
                let r = left.trailing_zeros() as usize % FAN;
                left &= left - 1;
                let BlockMask { certain, uncertain: mut open } = self.fan_filter(&planes, fan, r);
                let mut is_hit = certain != 0;
                while open != 0 && !is_hit {
                    let lane = open.trailing_zeros() & 7;
                    open &= open - 1;
                    let triangle = first + (lane & 3) + (lane >> 2) * 2 * (patch.columns() as u32 - 1);
                    is_hit = segment_hits_triangle(&all[r], self.corners(patch, triangle));
                }
                hit |= u32::from(is_hit) << r;
            }
        }
        hit
    }

    #[inline(always)]
    fn columns(&self, boxes: &BoxBlock, origin: [f32; 3], fan: &FanRays<FAN>, rays: u32) -> [u32; 8] {
        #[cfg(target_arch = "x86_64")]
        if let Some(avx2) = self.avx2 {
            return avx2.columns(boxes, origin, fan, rays);
        }
        boxes.columns(origin, fan, rays)
    }

    #[inline(always)]
    fn planes(&self, cells: &CellBlock, origin: [f32; 3]) -> Planes {
        #[cfg(target_arch = "x86_64")]
        if let Some(avx2) = self.avx2 {
            return Planes::Avx2(avx2.planes(cells, origin));
        }
        Planes::Scalar(fan::scalar::Planes::new(cells, origin))
    }

    #[inline(always)]
    fn fan_filter(&self, planes: &Planes, rays: &FanRays<FAN>, r: usize) -> BlockMask {
        let [x, y, z] = &rays.direction;
        let (direction, near, far) = ([x[r], y[r], z[r]], rays.near[r], rays.far[r]);
        match (planes, self.avx2) {
            #[cfg(target_arch = "x86_64")]
            (Planes::Avx2(planes), Some(avx2)) => avx2.fan_filter(planes, direction, near, far),
            (Planes::Scalar(planes), _) => planes.filter(direction, near, far),
            #[cfg(target_arch = "x86_64")]
            (Planes::Avx2(_), None) => BlockMask { certain: 0, uncertain: 0xff },
        }
    }

    /// By the best instructions that this processor has.
    #[inline(always)]
    fn filter(&self, cells: &CellBlock, ray: &GridRay) -> BlockMask {
        #[cfg(target_arch = "x86_64")]
        if let Some(avx2) = self.avx2 {
            return avx2.filter(cells, &ray.block);
        }
        scalar::filter(cells, &ray.block)
    }

    #[inline(always)]
    fn entered(&self, boxes: &BoxBlock, ray: &GridRay) -> u32 {
        #[cfg(target_arch = "x86_64")]
        if let Some(avx2) = self.avx2 {
            return avx2.entered(boxes, &ray.slab);
        }
        boxes.entered(&ray.slab)
    }
}

/// Triangles of a block of which two corners are one point: stitching collapses them, and left out, they don't cost the exact
/// predicate a proof. One bit each.
#[inline(always)]
fn collapsed(vertices: &[[[f32; 4]; 3]; 3]) -> u8 {
    let same = |[i, j]: [usize; 2], [k, l]: [usize; 2]| {
        vertices[0][j][i] == vertices[0][l][k]
            && vertices[1][j][i] == vertices[1][l][k]
            && vertices[2][j][i] == vertices[2][l][k]
    };
    let mut mask = 0;
    for cell in 0..4 {
        let (i, j) = (cell % 2, cell / 2);
        let [a, b, c, d] = [[i, j], [i + 1, j], [i + 1, j + 1], [i, j + 1]];
        let across = same(a, c);
        let (lower, upper) = (across || same(a, b) || same(b, c), across || same(a, d) || same(c, d));
        mask |= (u8::from(lower) | u8::from(upper) << 1) << (2 * cell);
    }
    mask
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blocks_come_once_each() {
        for (a, b) in (0..6).flat_map(|a| (0..6).map(move |b| (a, b))) {
            let mut seen: Vec<_> = (0..1 << (a + b)).map(|block| block_at(block, [a, b])).collect();
            seen.sort_unstable();
            let all: Vec<_> = (0..1 << a).flat_map(|x| (0..1 << b).map(move |y| [x, y])).collect();
            assert_eq!(seen, all, "{a}, {b}");
        }
    }
}
