//! Which lines along one direction meet a triangle in which cells of a grid that is turned to that direction.
//!
//! Here: turned grids, their levels, the marks. Not here: what opacity follows from them (`field.rs`).

use std::sync::atomic::{AtomicU64, Ordering};
use umbrage_geom::{
    Aabb, Frame,
    glam::{DVec3, Vec3},
};

/// Lines to the side of a cell; a power of two, 8 at most.
pub(super) const LINES: u32 = 8;

/// Levels of a grid: cells of each are twice as large as those of the one before.
pub(super) const LEVELS: usize = 4;

/// Cells to the side of a brick, whose 64 cells lie together: a cone stays in few lines of the cache.
const BRICK: u32 = 4;

/// Cells of one level, with an empty layer around them.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Level {
    /// First cell of the level among all.
    pub(super) first: u32,
    /// Distance of neighbouring bricks along each axis, in cells.
    pub(super) strides: [u32; 3],
    /// Cells along each axis, without the layer.
    pub(super) size: [u32; 3],
}

impl Level {
    fn new(first: u32, size: [u32; 3]) -> Self {
        let [x, y, _] = size.map(|n| (n + 2).div_ceil(BRICK));
        Self { first, strides: [64, 64 * x, 64 * x * y], size }
    }

    /// Cells of all bricks.
    pub(super) fn cells(&self) -> usize {
        self.strides[2] as usize * (self.size[2] as usize + 2).div_ceil(BRICK as usize)
    }

    /// What coordinate `i` (0 in the empty layer) along `axis` adds to the number of a cell.
    #[inline(always)]
    pub(super) fn offset(stride: u32, axis: usize, i: u32) -> u32 {
        (i / BRICK) * stride + ((i % BRICK) << (2 * axis))
    }

    /// Number of a cell by coordinates from 0 in the empty layer.
    #[inline(always)]
    pub(super) fn cell(&self, at: [u32; 3]) -> u32 {
        let mut cell = self.first;
        for (axis, i) in at.into_iter().enumerate() {
            cell += Self::offset(self.strides[axis], axis, i);
        }
        cell
    }
}

/// A grid whose third axis is a direction.
#[derive(Clone, Debug)]
pub(super) struct Grid {
    /// Axes of the grid; units of their lengths are cells of the finest level.
    pub(super) axes: [DVec3; 3],
    /// What the least corner has along the axes.
    pub(super) low: [f64; 3],
    pub(super) levels: [Level; LEVELS],
    /// Cells of all levels.
    pub(super) cells: std::ops::Range<usize>,
}

impl Grid {
    /// Around what lies in `bounds` of the points of triangles; `cell` and `length` are the width of the finest cells and their
    /// length along `direction` (world units), `first` the
    /// number of the first cell.
    pub(super) fn new(
        direction: DVec3,
        positions: &[[f32; 3]],
        triangles: &[[u32; 3]],
        bounds: &Aabb,
        [cell, length]: [f64; 2],
        first: usize,
    ) -> Self {
        let frame = Frame::from_normal(direction.as_vec3());
        let u = frame.tangent.as_dvec3();
        let u = (u - direction * u.dot(direction)).normalize();
        let axes = [u / cell, direction.cross(u) / cell, direction / length];
        let mut grid = Self { axes, low: [0.0; 3], levels: Default::default(), cells: first..first };
        let points = triangles.iter().flatten().map(|&v| Vec3::from(positions[v as usize]).as_dvec3());
        let seen = extent(axes, points);
        let corner = |i: usize| {
            let of =
                |axis: usize| f64::from(if i >> axis & 1 == 1 { bounds.max[axis] } else { bounds.min[axis] });
            DVec3::new(of(0), of(1), of(2))
        };
        let allowed = extent(axes, (0..8).map(corner));
        let mut size = [1; 3];
        for axis in 0..3 {
            let [low, high] = [seen[axis][0].max(allowed[axis][0]), seen[axis][1].min(allowed[axis][1])];
            grid.low[axis] = low;
            // Of cells as wide as a `u32` has no number for there are none: bounds have few cells.
            size[axis] = ((high - low).ceil() as u32).max(1);
        }
        for (l, level) in grid.levels.iter_mut().enumerate() {
            let size = size.map(|n| n.div_ceil(1 << l));
            *level = Level::new(grid.cells.end as u32, size);
            grid.cells.end += level.cells();
        }
        grid
    }

    /// Marks the cells in which lines meet a triangle: by cell of the grid a bit for each of its lines. Only lines count of which
    /// `blocks`, which gets their numbers along both axes, says so.
    #[inline(always)]
    pub(super) fn mark(&self, corners: [DVec3; 3], marks: &[AtomicU64], blocks: impl Fn(u32, u32) -> bool) {
        let lines = f64::from(LINES);
        let place = |p: DVec3, axis: usize| p.dot(self.axes[axis]) - self.low[axis];
        // Lines are in the middle between whole numbers, so that none lies on a face of a cell.
        let seen = corners.map(|p| [place(p, 0) * lines - 0.5, place(p, 1) * lines - 0.5]);
        let size = self.levels[0].size;
        let most = |axis: usize| f64::from(size[axis] * LINES - 1);
        let [b_low, b_high] = ends(seen.map(|p| p[1]));
        let (first, last) = (b_low.ceil().max(0.0), b_high.floor().min(most(1)));
        let [a_low, a_high] = ends(seen.map(|p| p[0]));
        if !(first <= last && a_low.ceil() <= a_high && a_high >= 0.0 && a_low <= most(0)) {
            return;
        }
        let [[a0, b0], [a1, b1], [a2, b2]] = seen;
        let det = (a1 - a0) * (b2 - b0) - (a2 - a0) * (b1 - b0);
        if det == 0.0 {
            return;
        }
        // Depth: w0 + da (a - a0) + db (b - b0).
        let depths = corners.map(|p| place(p, 2));
        let [w_low, w_high] = ends(depths);
        let (e1, e2) = (depths[1] - depths[0], depths[2] - depths[0]);
        let da = (e1 * (b2 - b0) - e2 * (b1 - b0)) / det;
        let db = (e2 * (a1 - a0) - e1 * (a2 - a0)) / det;
        for b in first as u32..=last as u32 {
            let row = f64::from(b);
            let mut crossed = [f64::INFINITY, f64::NEG_INFINITY];
            for (p, q) in [(0, 1), (1, 2), (2, 0)] {
                if let Some(a) = crossing(seen[p], seen[q], row) {
                    crossed = [crossed[0].min(a), crossed[1].max(a)];
                }
            }
            // Half-open, so that of two triangles with a common edge one is hit.
            let (from, end) = (crossed[0].ceil().max(0.0), crossed[1].ceil().min(most(0) + 1.0));
            if from < end {
                for a in (from as u32..end as u32).filter(|&a| blocks(a, b)) {
                    let depth = depths[0] + da * (f64::from(a) - a0) + db * (row - b0);
                    self.mark_at(a, b, depth.max(w_low).min(w_high), marks);
                }
            }
        }
    }

    /// Marks the cells of all levels in which line (`a`, `b`) is at `depth`.
    #[inline(always)]
    fn mark_at(&self, a: u32, b: u32, depth: f64, marks: &[AtomicU64]) {
        let depth = if depth >= 0.0 { depth as u32 } else { u32::MAX };
        if depth >= self.levels[0].size[2] {
            return;
        }
        for (l, level) in self.levels.iter().enumerate() {
            // Coarser levels see every other line of the level before.
            if (a | b) & ((1 << l) - 1) != 0 {
                break;
            }
            let (a, b) = (a >> l, b >> l);
            let cell = level.cell([a / LINES + 1, b / LINES + 1, (depth >> l) + 1]);
            let bit = a % LINES * LINES + b % LINES;
            let mark = &marks[cell as usize - self.cells.start];
            if mark.load(Ordering::Relaxed) >> bit & 1 == 0 {
                mark.fetch_or(1 << bit, Ordering::Relaxed);
            }
        }
    }
}

#[inline(always)]
fn ends(values: [f64; 3]) -> [f64; 2] {
    let [a, b, c] = values;
    [a.min(b).min(c), a.max(b).max(c)]
}

/// Least and largest coordinates of points along `axes`.
fn extent(axes: [DVec3; 3], points: impl Iterator<Item = DVec3>) -> [[f64; 2]; 3] {
    let mut extent = [[f64::INFINITY, f64::NEG_INFINITY]; 3];
    for p in points {
        for (extent, axis) in extent.iter_mut().zip(axes) {
            let x = p.dot(axis);
            *extent = [extent[0].min(x), extent[1].max(x)];
        }
    }
    extent
}

/// Where the edge between `p` and `q` crosses row `b`; the same bits for both directions of the edge.
#[inline(always)]
fn crossing(p: [f64; 2], q: [f64; 2], b: f64) -> Option<f64> {
    let ([a0, b0], [a1, b1]) = if p[1] < q[1] { (p, q) } else { (q, p) };
    (b0 <= b && b < b1).then(|| a0 + (a1 - a0) * ((b - b0) / (b1 - b0)))
}
