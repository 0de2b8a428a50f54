//! A whole patch as micropolygons, with boxes over them in little memory.
//!
//! Blocks of 2 x 2 cells, eight triangles, are the leaves of a tree of eight children a node whose shape follows from the
//! levels: blocks in Morton order, eight in turn below one node. Boxes are rounded outwards to numbers of 8 bits.

use crate::grid::GridRay;
use umbrage_geom::{
    Aabb, TriangleHit,
    glam::Vec3,
    intersect_triangle,
    kernel::{BlockMask, BoxBlock, CellBlock, scalar},
    segment_hits_triangle,
};

#[cfg(target_arch = "x86_64")]
pub(crate) use umbrage_geom::kernel::x86::Avx2;

/// Proof that there is AVX2; there is none elsewhere.
#[cfg(not(target_arch = "x86_64"))]
#[derive(Clone, Copy)]
pub(crate) enum Avx2 {}

#[cfg(not(target_arch = "x86_64"))]
impl Avx2 {
    pub(crate) fn detect() -> Option<Self> {
        None
    }
}

/// Levels of nodes: the finest patch has `2^22` blocks.
const MOST_LEVELS: usize = 8;

/// See the [module](self).
#[derive(Debug)]
pub(crate) struct PatchMesh {
    levels: [u8; 2],
    /// Whether borders were moved, so that cells may have collapsed.
    stitched: bool,
    /// Vertices row by row, one axis after the other, and room for reading four at a time.
    positions: Box<[f32]>,
    /// From the root down, level by level.
    nodes: Box<[BoxBlock]>,
}

/// Every other bit of the lowest 24.
#[inline(always)]
fn compact(x: u32) -> u32 {
    let x = x & 0x0055_5555;
    let x = (x | x >> 1) & 0x0033_3333;
    let x = (x | x >> 2) & 0x000f_0f0f;
    let x = (x | x >> 4) & 0x00ff_00ff;
    (x | x >> 8) & 0xffff
}

/// Column and row of block `index` of `2^bits[0]` by `2^bits[1]`.
#[inline(always)]
fn block_at(index: u32, bits: [u32; 2]) -> [u32; 2] {
    let square = bits[0].min(bits[1]);
    let low = index & ((1 << (2 * square)) - 1);
    let high = index >> (2 * square) << square;
    let [x, y] = [compact(low), compact(low >> 1)];
    if bits[0] > bits[1] { [x | high, y] } else { [x, y | high] }
}

impl PatchMesh {
    /// From vertices row by row.
    pub(crate) fn new(levels: [u8; 2], vertices: &[Vec3], stitched: bool) -> Self {
        let mut positions = Vec::with_capacity(3 * vertices.len() + 2);
        for axis in 0..3 {
            positions.extend(vertices.iter().map(|p| p[axis]));
        }
        positions.extend([0.0; 2]);
        let mut mesh = Self { levels, stitched, positions: positions.into(), nodes: Box::default() };
        let mut boxes: Vec<Aabb> = (0..mesh.blocks()).map(|block| mesh.block_bounds(block)).collect();
        // From the leaves up, then turned around.
        let mut rows = Vec::new();
        loop {
            rows.push(boxes.chunks(8).map(BoxBlock::new).collect::<Vec<_>>());
            if boxes.len() <= 8 {
                break;
            }
            let whole = |boxes: &[Aabb]| boxes.iter().fold(Aabb::EMPTY, |all, b| all.union(*b));
            boxes = boxes.chunks(8).map(whole).collect();
        }
        mesh.nodes = rows.into_iter().rev().flatten().collect();
        mesh
    }

    fn bits(&self) -> [u32; 2] {
        self.levels.map(|l| u32::from(l.saturating_sub(1)))
    }

    fn blocks(&self) -> u32 {
        let [a, b] = self.bits();
        1 << (a + b)
    }

    fn columns(&self) -> usize {
        (1 << self.levels[0]) + 1
    }

    fn rows(&self) -> usize {
        (1 << self.levels[1]) + 1
    }

    #[inline(always)]
    fn vertex(&self, index: usize) -> [f32; 3] {
        let count = self.columns() * self.rows();
        [self.positions[index], self.positions[count + index], self.positions[2 * count + index]]
    }

    pub(crate) fn levels(&self) -> [u8; 2] {
        self.levels
    }

    /// Number of cells, each a micropolygon.
    pub(crate) fn cells(&self) -> u64 {
        1 << (self.levels[0] + self.levels[1])
    }

    pub(crate) fn bytes(&self) -> usize {
        size_of::<Self>() + size_of_val(&self.positions[..]) + size_of_val(&self.nodes[..])
    }

    fn block_bounds(&self, block: u32) -> Aabb {
        let [x, y] = block_at(block, self.bits()).map(|i| 2 * i as usize);
        let [columns, rows] = [self.columns(), self.rows()];
        let mut aabb = Aabb::EMPTY;
        for j in y..=(y + 2).min(rows - 1) {
            for i in x..=(x + 2).min(columns - 1) {
                aabb = aabb.with_point(self.vertex(j * columns + i));
            }
        }
        aabb
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

    #[inline]
    pub(crate) fn corners(&self, triangle: u32) -> [[f32; 3]; 3] {
        self.triangle(triangle).map(|v| self.vertex(v))
    }

    /// The triangles of a block and the index of the first; those of the second row of cells come two rows of cells' width
    /// later.
    #[inline(always)]
    fn gather(&self, block: u32) -> (CellBlock, u32) {
        let [x, y] = block_at(block, self.bits());
        let (x, y) = (2 * x as usize, 2 * y as usize);
        let [columns, rows] = [self.columns(), self.rows()];
        let mut vertices = [[[0f32; 4]; 3]; 3];
        for axis in 0..3 {
            for j in 0..3 {
                // A block of one row of cells has no third row of vertices.
                let start = axis * columns * rows + (y + j).min(rows - 1) * columns + x;
                if let Some(row) = self.positions[start..].first_chunk() {
                    vertices[axis][j] = *row;
                }
            }
        }
        let mut used = 0xff;
        if self.levels[0] == 0 {
            used &= 0x33;
        }
        if self.levels[1] == 0 {
            used &= 0x0f;
        }
        if self.stitched {
            used &= !collapsed(&vertices);
        }
        (CellBlock::new(vertices, used), 2 * (y * (columns - 1) + x) as u32)
    }

    /// Looks for hits: any, or the one with the smallest `t` up to where `ray` ends, into `closest`, with the index of its
    /// triangle; ties go to the smallest. Whether there was one.
    #[inline(always)]
    pub(crate) fn trace<const ANY: bool>(
        &self,
        ray: &mut GridRay,
        closest: &mut Option<(TriangleHit, u32)>,
        avx2: Option<Avx2>,
    ) -> bool {
        // First node of each level, root first, and the mask of children that exist.
        let blocks = self.blocks();
        let mut starts = [0u32; MOST_LEVELS + 1];
        let mut last = 0;
        let mut count = 1u32;
        let total = blocks.trailing_zeros();
        // Nodes a level: one in eight of the level below, the last of them above the blocks.
        let depth = total.div_ceil(3).max(1) as usize;
        for level in 0..depth {
            starts[level] = last;
            count = 1 << total.saturating_sub(3 * (depth - level) as u32);
            last += count;
        }
        let _ = count;
        // Only the root may have fewer than eight children.
        let root_children = if total == 0 { 1 } else { 1u32 << (total - 3 * (depth as u32 - 1)) };
        let mut stack = [(0u32, 0u32); MOST_LEVELS];
        let mut level = 0;
        let mut node = 0;
        let mut mask = entered(&self.nodes[0], ray, avx2) & ((1u32 << root_children) - 1);
        let mut found = false;
        loop {
            if mask == 0 {
                if level == 0 {
                    return found;
                }
                level -= 1;
                (node, mask) = stack[level];
                continue;
            }
            let child = 8 * node + mask.trailing_zeros();
            mask &= mask - 1;
            if level + 1 < depth {
                stack[level] = (node, mask);
                level += 1;
                node = child;
                mask = entered(&self.nodes[(starts[level] + child) as usize], ray, avx2);
                continue;
            }
            let (lanes, first) = self.gather(child);
            let BlockMask { certain, uncertain } = filter(&lanes, ray, avx2);
            if ANY && certain != 0 {
                return true;
            }
            let mut open = certain | uncertain;
            while open != 0 {
                let lane = open.trailing_zeros() & 7;
                open &= open - 1;
                let below = lane >> 2;
                let triangle = first + (lane & 3) + below * 2 * (self.columns() as u32 - 1);
                let corners = self.corners(triangle);
                if ANY {
                    if segment_hits_triangle(&ray.ray, corners) {
                        return true;
                    }
                    continue;
                }
                let Some(hit) = intersect_triangle(&ray.ray, corners) else { continue };
                let before =
                    |&(old, index): &(TriangleHit, u32)| hit.t < old.t || (hit.t == old.t && triangle < index);
                if closest.as_ref().is_none_or(before) {
                    found = true;
                    *closest = Some((hit, triangle));
                    ray.end_behind(hit.t);
                }
            }
        }
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

/// The best instructions that this processor has.
#[inline(always)]
fn filter(cells: &CellBlock, ray: &GridRay, avx2: Option<Avx2>) -> BlockMask {
    #[cfg(target_arch = "x86_64")]
    if let Some(avx2) = avx2 {
        return avx2.filter(cells, &ray.block);
    }
    let _ = avx2;
    scalar::filter(cells, &ray.block)
}

#[inline(always)]
fn entered(boxes: &BoxBlock, ray: &GridRay, avx2: Option<Avx2>) -> u32 {
    #[cfg(target_arch = "x86_64")]
    if let Some(avx2) = avx2 {
        return avx2.entered(boxes, &ray.slab);
    }
    let _ = avx2;
    boxes.entered(&ray.slab)
}
