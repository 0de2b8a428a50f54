//! A whole patch as micropolygons, with boxes over them in little memory.
//!
//! Blocks of 2 x 2 cells, eight triangles, are the leaves of a tree of eight children a node whose shape follows from the
//! levels: blocks in Morton order, eight in turn below one node. Boxes are rounded outwards to numbers of 8 bits.

use crate::grid::GridRay;
use umbrage_geom::{
    Aabb, TriangleHit,
    glam::Vec3,
    intersect_triangle,
    kernel::{BlockMask, TriangleLanes, scalar},
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

/// Boxes of up to eight children.
#[derive(Clone, Copy, Debug)]
struct Node {
    base: [f32; 3],
    /// Powers of two, so that products with numbers are exact.
    step: [f32; 3],
    /// Smallest x of each child, largest x, smallest y, ..
    planes: [[u8; 8]; 6],
}

/// See the [module](self).
#[derive(Debug)]
pub(crate) struct PatchMesh {
    levels: [u8; 2],
    /// Whether borders were moved, so that cells may have collapsed.
    stitched: bool,
    /// Row by row.
    positions: Box<[Vec3]>,
    /// From the root down, level by level.
    nodes: Box<[Node]>,
}

impl Node {
    fn new(boxes: &[Aabb]) -> Self {
        let whole = boxes.iter().fold(Aabb::EMPTY, |all, b| all.union(*b));
        let mut node = Self { base: [0.0; 3], step: [0.0; 3], planes: [[0; 8]; 6] };
        for axis in 0..3 {
            let size = f64::from(whole.max[axis]) - f64::from(whole.min[axis]);
            // 252 steps and what rounding of the sums takes off at either end.
            let ulp = f64::from(whole.min[axis].abs().max(whole.max[axis].abs())) * f64::from(f32::EPSILON);
            let step = power_of_two_above((size + 4.0 * ulp) / 252.0);
            let base = (f64::from(whole.min[axis]) - f64::from(step)) as f32;
            let base = if base <= whole.min[axis] { base } else { whole.min[axis] };
            (node.base[axis], node.step[axis]) = (base, step);
            for (i, b) in boxes.iter().enumerate() {
                let at = |q: u8| f32::from(q) * step + base;
                let number = |x: f32| ((f64::from(x) - f64::from(base)) / f64::from(step)).clamp(0.0, 255.0);
                let (mut low, mut high) =
                    (number(b.min[axis]).floor() as u8, number(b.max[axis]).ceil() as u8);
                while low > 0 && at(low) > b.min[axis] {
                    low -= 1;
                }
                while high < u8::MAX && at(high) < b.max[axis] {
                    high += 1;
                }
                node.planes[2 * axis][i] = low;
                node.planes[2 * axis + 1][i] = high;
            }
        }
        node
    }

    /// Children that the segment may enter, a bit each; of no meaning where there is none.
    #[inline(always)]
    fn entered(&self, ray: &GridRay, avx2: Option<Avx2>) -> u32 {
        let slab = &ray.slab;
        let (mut t0, mut t1) = ([slab.tnear; 8], [slab.tfar; 8]);
        for axis in 0..3 {
            let backward = usize::from(slab.inv_near[axis] < 0.0);
            let (near, far) = (&self.planes[2 * axis + backward], &self.planes[2 * axis + 1 - backward]);
            let (base, step) = (self.base[axis], self.step[axis]);
            for i in 0..8 {
                let (near, far) = (f32::from(near[i]) * step + base, f32::from(far[i]) * step + base);
                // `max` and `min` return the other operand for NaN.
                t0[i] = t0[i].max((near - slab.origin_near[axis]) * slab.inv_near[axis]);
                t1[i] = t1[i].min((far - slab.origin_far[axis]) * slab.inv_far[axis]);
            }
        }
        #[cfg(target_arch = "x86_64")]
        if let Some(avx2) = avx2 {
            return avx2.less_or_equal(&t0, &t1);
        }
        let _ = avx2;
        let mut mask = 0;
        for i in 0..8 {
            mask |= u32::from(t0[i] <= t1[i]) << i;
        }
        mask
    }
}

/// The smallest power of two that is at least `x`, as a normal number.
fn power_of_two_above(x: f64) -> f32 {
    let x = x.max(f64::from(f32::MIN_POSITIVE));
    let bits = x.to_bits();
    let below = f64::from_bits(bits & !((1 << 52) - 1));
    (if below < x { 2.0 * below } else { below }) as f32
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
    pub(crate) fn new(levels: [u8; 2], positions: Vec<Vec3>, stitched: bool) -> Self {
        let mut mesh = Self { levels, stitched, positions: positions.into(), nodes: Box::default() };
        let mut boxes: Vec<Aabb> = (0..mesh.blocks()).map(|block| mesh.block_bounds(block)).collect();
        // From the leaves up, then turned around.
        let mut rows = Vec::new();
        loop {
            rows.push(boxes.chunks(8).map(Node::new).collect::<Vec<_>>());
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
        let columns = self.columns();
        let rows = self.positions.len() / columns;
        let mut aabb = Aabb::EMPTY;
        for j in y..=(y + 2).min(rows - 1) {
            for i in x..=(x + 2).min(columns - 1) {
                aabb = aabb.with_point(self.positions[j * columns + i]);
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
        self.triangle(triangle).map(|v| self.positions[v].to_array())
    }

    /// The triangles of a block and the index of the first; those of the second row of cells come `2 * columns` later.
    #[inline(always)]
    fn gather(&self, block: u32) -> (TriangleLanes, u32) {
        let [x, y] = block_at(block, self.bits()).map(|i| 2 * i as usize);
        let columns = self.columns();
        let mut lanes = TriangleLanes::EMPTY;
        let first = y * columns + x;
        let (wide, high) = (self.levels[0] > 0, self.levels[1] > 0);
        for j in 0..1 + usize::from(high) {
            for i in 0..1 + usize::from(wide) {
                let corner = first + j * columns + i;
                let [a, b] = [self.positions[corner].to_array(), self.positions[corner + 1].to_array()];
                let (d, c) = (
                    self.positions[corner + columns].to_array(),
                    self.positions[corner + columns + 1].to_array(),
                );
                let lane = 4 * j + 2 * i;
                if !self.stitched {
                    lanes.set(lane, [a, b, c]);
                    lanes.set(lane + 1, [a, c, d]);
                    continue;
                }
                // Stitching collapses triangles; left out, they don't cost the exact predicate a proof.
                if a != c {
                    if a != b && b != c {
                        lanes.set(lane, [a, b, c]);
                    }
                    if a != d && c != d {
                        lanes.set(lane + 1, [a, c, d]);
                    }
                }
            }
        }
        (lanes, 2 * (y * (columns - 1) + x) as u32)
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
        let mut mask = self.nodes[0].entered(ray, avx2) & ((1u32 << root_children) - 1);
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
                mask = self.nodes[(starts[level] + child) as usize].entered(ray, avx2);
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

/// The best filter that this processor has.
#[inline(always)]
fn filter(lanes: &TriangleLanes, ray: &GridRay, avx2: Option<Avx2>) -> BlockMask {
    #[cfg(target_arch = "x86_64")]
    if let Some(avx2) = avx2 {
        return avx2.filter(lanes, &ray.block);
    }
    let _ = avx2;
    scalar::filter(lanes, &ray.block)
}
