//! Grids of micropolygons and where rays meet them.
//!
//! Here: layout, boxes over blocks of 2 x 2 cells, intersection by `geom`'s exact predicate. Not here: where vertices lie
//! (`dice.rs`).

use umbrage_geom::{
    Aabb, Ray, SlabRay,
    glam::Vec3,
    intersect_triangle,
    kernel::{BlockRay, TriangleLanes, scalar},
    segment_hits_triangle,
};

/// Cells along a side of the largest grid, as a power of two.
pub(crate) const GRID_LEVEL: u8 = 3;

/// Most vertices of a grid.
pub(crate) const MAX_VERTICES: usize = ((1 << GRID_LEVEL) + 1) * ((1 << GRID_LEVEL) + 1);

/// Boxes of eight blocks, one a lane: rows smallest x, largest x, smallest y, ..
type BoxRow = [[f32; 8]; 6];

/// Micropolygons: `2^levels[0]` by `2^levels[1]` cells, each two triangles along the diagonal from its first corner.
#[derive(Debug)]
pub(crate) struct Grid {
    pub(crate) levels: [u8; 2],
    /// Row by row.
    positions: Box<[Vec3]>,
    boxes: Box<[BoxRow]>,
    /// Parameters of the vertices: where the grid starts, and the size of a cell.
    start: [f32; 2],
    step: [f32; 2],
    /// Where border vertices were moved: bottom, right, top, left, in steps of cells, empty if nowhere.
    moved: Box<[[f32; 2]]>,
}

/// Where a ray meets a grid.
#[derive(Clone, Copy, Debug)]
pub(crate) struct GridHit {
    pub(crate) t: f32,
    pub(crate) u: f32,
    pub(crate) v: f32,
    pub(crate) triangle: u32,
    pub(crate) front: bool,
}

/// A ray prepared for grids.
#[derive(Clone, Copy, Debug)]
pub(crate) struct GridRay {
    pub(crate) ray: Ray,
    pub(crate) slab: SlabRay,
    pub(crate) block: BlockRay,
}

impl GridRay {
    #[inline(always)]
    pub(crate) fn new(ray: &Ray) -> Option<Self> {
        Some(Self { ray: *ray, slab: SlabRay::new(ray)?, block: BlockRay::new(ray)? })
    }

    /// Ends the segment just behind `t`, so that what ties with a hit there is still found.
    pub(crate) fn end_behind(&mut self, t: f32) {
        let end = (t * (1.0 + 2f32.powi(-20))).next_up().min(self.ray.tfar);
        self.slab.tfar = self.slab.scaled_tfar(end);
        self.block.set_tfar(end);
    }
}

/// Blocks of 2 x 2 cells along a side of `2^level` cells.
fn blocks(level: u8) -> usize {
    (1usize << level).div_ceil(2)
}

impl Grid {
    /// From vertices row by row and their parameters; `moved` holds parameters of all vertices where borders were moved.
    pub(crate) fn new(
        levels: [u8; 2],
        positions: &[Vec3],
        start: [f32; 2],
        step: [f32; 2],
        moved: Option<&[[f32; 2]]>,
    ) -> Self {
        let mut grid = Self {
            levels,
            positions: positions.into(),
            boxes: Box::default(),
            start,
            step,
            moved: moved.unwrap_or_default().into(),
        };
        let (inf, neg) = ([f32::INFINITY; 8], [f32::NEG_INFINITY; 8]);
        let count = blocks(levels[0]) * blocks(levels[1]);
        let mut rows = vec![[inf, neg, inf, neg, inf, neg]; count.div_ceil(8)];
        for block in 0..count {
            let aabb = grid.block_bounds(block);
            for axis in 0..3 {
                rows[block / 8][2 * axis][block % 8] = aabb.min[axis];
                rows[block / 8][2 * axis + 1][block % 8] = aabb.max[axis];
            }
        }
        grid.boxes = rows.into();
        grid
    }

    pub(crate) fn columns(&self) -> usize {
        (1 << self.levels[0]) + 1
    }

    /// Vertices, row by row.
    pub(crate) fn positions(&self) -> &[Vec3] {
        &self.positions
    }

    /// Parameters of vertex `index`.
    pub(crate) fn parameters(&self, index: usize) -> [f32; 2] {
        if let Some(&moved) = self.moved.get(index) {
            return moved;
        }
        let (i, j) = (index % self.columns(), index / self.columns());
        [self.start[0] + i as f32 * self.step[0], self.start[1] + j as f32 * self.step[1]]
    }

    /// Parameters at barycentric weights of the second and third corner of a triangle.
    pub(crate) fn parameters_at(&self, triangle: u32, second: f32, third: f32) -> (f32, f32) {
        let [a, b, c] = self.triangle(triangle).map(|v| self.parameters(v));
        let mix = |k: usize| a[k] * (1.0 - second - third) + b[k] * second + c[k] * third;
        (mix(0).clamp(0.0, 1.0), mix(1).clamp(0.0, 1.0))
    }

    /// Number of cells, each a micropolygon.
    pub(crate) fn cells(&self) -> usize {
        1 << (self.levels[0] + self.levels[1])
    }

    pub(crate) fn bytes(&self) -> usize {
        size_of::<Self>()
            + size_of_val(&self.positions[..])
            + size_of_val(&self.boxes[..])
            + size_of_val(&self.moved[..])
    }

    /// Vertices of a triangle: cell by cell, row by row, the lower one first.
    pub(crate) fn triangle(&self, index: u32) -> [usize; 3] {
        let cell = index as usize / 2;
        let columns = self.columns();
        let corner = cell % (columns - 1) + cell / (columns - 1) * columns;
        if index.is_multiple_of(2) {
            [corner, corner + 1, corner + columns + 1]
        } else {
            [corner, corner + columns + 1, corner + columns]
        }
    }

    pub(crate) fn triangle_count(&self) -> u32 {
        2 * self.cells() as u32
    }

    pub(crate) fn corners(&self, triangle: u32) -> [[f32; 3]; 3] {
        self.triangle(triangle).map(|v| self.positions[v].to_array())
    }

    /// Cells of a block: first column and row, end column and row.
    fn block_cells(&self, block: usize) -> [usize; 4] {
        let across = blocks(self.levels[0]);
        let (x, y) = (2 * (block % across), 2 * (block / across));
        [x, y, (x + 2).min(1 << self.levels[0]), (y + 2).min(1 << self.levels[1])]
    }

    fn block_bounds(&self, block: usize) -> Aabb {
        let [x0, y0, x1, y1] = self.block_cells(block);
        let mut aabb = Aabb::EMPTY;
        for y in y0..=y1 {
            for x in x0..=x1 {
                aabb = aabb.with_point(self.positions[y * self.columns() + x]);
            }
        }
        aabb
    }

    /// The triangles of a block, and the index of the one in each lane.
    #[inline(always)]
    fn gather(&self, block: usize) -> (TriangleLanes, [u32; 8]) {
        let [x0, y0, x1, y1] = self.block_cells(block);
        let columns = self.columns();
        let mut lanes = TriangleLanes::EMPTY;
        let mut indices = [u32::MAX; 8];
        let mut lane = 0;
        for y in y0..y1 {
            for x in x0..x1 {
                let first = y * columns + x;
                let [a, b] = [first, first + 1].map(|v| self.positions[v].to_array());
                let [d, c] = [first + columns, first + columns + 1].map(|v| self.positions[v].to_array());
                // Stitching collapses triangles; left out, they don't cost the exact predicate a proof.
                if a != c {
                    if a != b && b != c {
                        lanes.set(lane, [a, b, c]);
                    }
                    if a != d && c != d {
                        lanes.set(lane + 1, [a, c, d]);
                    }
                }
                let triangle = 2 * (y * (columns - 1) + x) as u32;
                indices[lane] = triangle;
                indices[lane + 1] = triangle + 1;
                lane += 2;
            }
        }
        (lanes, indices)
    }

    /// Blocks whose boxes the segment may enter, a bit each.
    #[inline(always)]
    fn entered(&self, row: &BoxRow, slab: &SlabRay) -> u32 {
        let (mut t0, mut t1) = ([slab.tnear; 8], [slab.tfar; 8]);
        for axis in 0..3 {
            let forward = slab.inv_near[axis] >= 0.0;
            let (near, far) = if forward {
                (&row[2 * axis], &row[2 * axis + 1])
            } else {
                (&row[2 * axis + 1], &row[2 * axis])
            };
            for i in 0..8 {
                // `max` and `min` return the other operand for NaN.
                t0[i] = t0[i].max((near[i] - slab.origin_near[axis]) * slab.inv_near[axis]);
                t1[i] = t1[i].min((far[i] - slab.origin_far[axis]) * slab.inv_far[axis]);
            }
        }
        (0..8).fold(0, |mask, i| mask | u32::from(t0[i] <= t1[i]) << i)
    }

    /// Calls `visit` with every triangle that the filter can't rule out, and whether it is hit for certain, until `true`.
    #[inline(always)]
    fn candidates(&self, ray: &mut GridRay, mut visit: impl FnMut(&mut GridRay, u32, bool) -> bool) -> bool {
        for (base, row) in self.boxes.iter().enumerate() {
            let mut open = self.entered(row, &ray.slab);
            while open != 0 {
                let block = 8 * base + open.trailing_zeros() as usize;
                open &= open - 1;
                let (lanes, indices) = self.gather(block);
                let mask = filter(&lanes, &ray.block);
                let mut left = mask.certain | mask.uncertain;
                while left != 0 {
                    let lane = left.trailing_zeros() as usize % 8;
                    left &= left - 1;
                    if visit(ray, indices[lane], mask.certain >> lane & 1 == 1) {
                        return true;
                    }
                }
            }
        }
        false
    }

    /// Whether the open segment meets any triangle.
    pub(crate) fn any_hit(&self, ray: &mut GridRay) -> bool {
        self.candidates(ray, |ray, triangle, certain| {
            certain || segment_hits_triangle(&ray.ray, self.corners(triangle))
        })
    }

    /// The hit with the smallest `t` before or at the end that `ray` was given; ties go to the smallest triangle.
    pub(crate) fn closest_hit(&self, ray: &mut GridRay) -> Option<GridHit> {
        let mut closest: Option<(umbrage_geom::TriangleHit, u32)> = None;
        self.candidates(ray, |ray, triangle, _| {
            if let Some(hit) = intersect_triangle(&ray.ray, self.corners(triangle)) {
                let before = |(old, index): (umbrage_geom::TriangleHit, u32)| {
                    hit.t < old.t || (hit.t == old.t && triangle < index)
                };
                if closest.is_none_or(before) {
                    closest = Some((hit, triangle));
                    ray.end_behind(hit.t);
                }
            }
            false
        });
        closest.map(|(hit, triangle)| {
            let (u, v) = self.parameters_at(triangle, hit.u, hit.v);
            GridHit { t: hit.t, u, v, triangle, front: hit.front }
        })
    }

    /// Longest edge or diagonal, both ways, of any cell, world units.
    pub(crate) fn longest_edge(&self) -> f64 {
        let columns = self.columns();
        let mut longest = 0f64;
        for cell in 0..self.cells() {
            let corner = cell % (columns - 1) + cell / (columns - 1) * columns;
            let corners = [corner, corner + 1, corner + columns + 1, corner + columns];
            let [a, b, c, d] = corners.map(|v| self.positions[v].as_dvec3());
            for (p, q) in [(a, b), (b, c), (c, d), (d, a), (a, c), (b, d)] {
                longest = longest.max(p.distance(q));
            }
        }
        longest
    }
}

/// The best filter that this processor has.
#[inline(always)]
fn filter(block: &TriangleLanes, ray: &BlockRay) -> umbrage_geom::kernel::BlockMask {
    #[cfg(target_arch = "x86_64")]
    if let Some(avx2) = umbrage_geom::simd::BackEnd::best().instructions().avx2() {
        return avx2.filter(block, ray);
    }
    scalar::filter(block, ray)
}
