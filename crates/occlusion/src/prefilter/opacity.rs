//! Directional opacity of every node that may end rays, bottom-up in linear time (`[Lacewell08]`, section 3.3).
//!
//! Here: lines through a node's silhouette, dimmed by what the node holds. Not here: how opacity is stored (`storage.rs`),
//! which nodes have one (`correlation.rs`).
//!
//! The opacity of a node in a direction is the mean over lines that cross its box. Along a line, children that have an opacity
//! count with it, and the others with what is in them: at the correlation height that is the exact rendering of the paper,
//! above it the compositing of children. Departures: up to eight children at once; random lines instead of pixels, all over
//! the cell of directions. Eight lines go together, a lane each.

use super::{
    Directions, PrefilterOptions,
    depths::Depths,
    fan::mark,
    published::CellSampling,
    storage::{Cells, Cube, OPAQUE, WIDTH},
};
use umbrage_accel::{Bvh, Child, View};
use umbrage_geom::{
    Aabb, Cancelled, Progress,
    kernel::{TriangleBlock, larger, smaller},
    sampling::{combine, sobol_4d, unit},
    simd::{BackEnd, Job},
};

/// Nodes whose opacities are computed together.
const CHUNK: usize = 256;

/// Lines that go together.
const LINES: usize = 8;

/// Eight numbers, a line each.
type Lanes = [f32; LINES];

/// Smallest component of a direction: its inverse times any size is finite.
const MIN_COMPONENT: f32 = 1e-9;

/// Directions of a cell, with where lines cross the silhouette before the node's own rotation.
struct Batch {
    direction: [Lanes; 3],
    inverse: [Lanes; 3],
    at: [Lanes; 2],
}

/// Lines of all cells, cell by cell.
struct Lines {
    batches: Vec<Batch>,
    per_cell: usize,
}

impl Lines {
    fn new(directions: Directions, options: &PrefilterOptions) -> Self {
        let per_cell = usize::from(options.lines).div_ceil(LINES);
        let mut batches = Vec::with_capacity(directions.cells() * per_cell);
        for cell in 0..directions.cells() {
            for first in (0..per_cell * LINES).step_by(LINES) {
                let zero = [[0.0; LINES]; 3];
                let mut batch = Batch { direction: zero, inverse: zero, at: [[0.0; LINES]; 2] };
                for lane in 0..LINES {
                    let [u, v, s, t] = sobol_4d((first + lane) as u32, 0, cell as u32);
                    let direction = match options.sampling {
                        CellSampling::Jittered => directions.at(cell, u, v),
                        CellSampling::Center => directions.center(cell),
                    };
                    for axis in 0..3 {
                        let x = direction[axis].abs().max(MIN_COMPONENT).copysign(direction[axis]);
                        batch.direction[axis][lane] = x;
                        batch.inverse[axis][lane] = 1.0 / x;
                    }
                    (batch.at[0][lane], batch.at[1][lane]) = (s, t);
                }
                batches.push(batch);
            }
        }
        Self { batches, per_cell }
    }
}

/// All bits, if `x`: masks and separate loops, since selections between values become branches, one a lane.
#[inline(always)]
fn all_if(x: bool) -> u32 {
    if x { u32::MAX } else { 0 }
}

/// `a` where all bits of `which` are set, `b` where none is.
#[inline(always)]
fn select(which: u32, a: f32, b: f32) -> f32 {
    f32::from_bits(a.to_bits() & which | b.to_bits() & !which)
}

/// 1, if `x`.
#[inline(always)]
fn one_if(x: bool) -> f32 {
    f32::from_bits(1f32.to_bits() & all_if(x))
}

/// 2 to the power of `-x` for `x` from 0, to within 3e-6 of itself; hardly anything from 126 on.
#[inline(always)]
fn dimmed(x: f32) -> f32 {
    /// Adding it rounds to a whole number, which is then in the lowest bits.
    const ROUND_TO_WHOLE: f32 = (3u32 << 22) as f32;
    let x = smaller(x, 126.0);
    let rounded = x + ROUND_TO_WHOLE;
    let whole = rounded.to_bits().wrapping_sub(ROUND_TO_WHOLE.to_bits());
    let y = ((rounded - ROUND_TO_WHOLE) - x) * std::f32::consts::LN_2;
    let series = 1.0 + y * (1.0 + y * (1.0 / 2.0 + y * (1.0 / 6.0 + y * (1.0 / 24.0 + y / 120.0))));
    series * f32::from_bits(127u32.wrapping_sub(whole) << 23)
}

/// Points where lines enter a box: uniform over its silhouette for uniform `u`, `v`.
#[inline(always)]
fn entry_points(aabb: &Aabb, batch: &Batch, turn: [f32; 2]) -> [Lanes; 3] {
    let (low, size) = (aabb.min.to_array(), (aabb.max - aabb.min).to_array());
    let faces = [size[1] * size[2], size[2] * size[0], size[0] * size[1]];
    let (mut u, mut v) = ([0f32; LINES], [0f32; LINES]);
    let (mut on_x, mut on_y) = ([0u32; LINES], [0u32; LINES]);
    let [dx, dy, dz] = &batch.direction;
    for i in 0..LINES {
        let turned = batch.at[0][i] + turn[0];
        let turned = turned - one_if(turned >= 1.0);
        v[i] = batch.at[1][i] + turn[1];
        v[i] -= one_if(v[i] >= 1.0);
        let (x, y, z) = (dx[i].abs() * faces[0], dy[i].abs() * faces[1], dz[i].abs() * faces[2]);
        let target = turned * (x + y + z);
        on_x[i] = all_if(target < x);
        on_y[i] = all_if(target < x + y) & !on_x[i];
        // What is left of the target on the face that it falls on, over that face.
        let before = select(on_x[i], 0.0, select(on_y[i], x, x + y));
        let area = select(on_x[i], x, select(on_y[i], y, z));
        // 1 for a box that is seen edge-on.
        u[i] = smaller((target - before) / area, 1.0);
    }
    let mut points = [[0.0; LINES]; 3];
    for i in 0..LINES {
        // The face's own axis, then the two that follow it in turn.
        let x = select(on_x[i], one_if(dx[i] < 0.0), select(on_y[i], v[i], u[i]));
        let y = select(on_x[i], u[i], select(on_y[i], one_if(dy[i] < 0.0), v[i]));
        let z = select(on_x[i], v[i], select(on_y[i], u[i], one_if(dz[i] < 0.0)));
        points[0][i] = low[0] + size[0] * x;
        points[1][i] = low[1] + size[1] * y;
        points[2][i] = low[2] + size[2] * z;
    }
    points
}

/// What lines through a node need.
struct Measure<'a, T> {
    view: View<'a>,
    bvh: &'a Bvh,
    depths: &'a Depths,
    /// Of the nodes below.
    table: &'a T,
    lines: &'a Lines,
    masks: &'a [u8],
    indices: &'a [u32],
}

/// Opacities of one slot, cell by cell.
type Row = (u32, usize, Vec<f32>);

impl<T: Cells> Job for Measure<'_, T> {
    type Output = Vec<Row>;

    #[inline(always)]
    fn run(self) -> Self::Output {
        let mut rows = Vec::with_capacity(self.indices.len() * WIDTH);
        let mut stack = Vec::with_capacity(WIDTH * View::MAX_LEVELS);
        for &index in self.indices {
            for (slot, (aabb, child)) in self.bvh.children(index).enumerate() {
                if self.masks[index as usize] >> slot & 1 == 1 {
                    let seed = combine(index, slot as u32);
                    let mut row = vec![0.0; self.table.cells()];
                    for (cell, opacity) in row.iter_mut().enumerate() {
                        *opacity = self.opacity(child, &aabb, cell, seed, &mut stack);
                    }
                    rows.push((index, slot, row));
                }
            }
        }
        rows
    }
}

impl<T: Cells> Measure<'_, T> {
    #[inline(always)]
    fn opacity(
        &self,
        child: Child,
        aabb: &Aabb,
        cell: usize,
        seed: u32,
        stack: &mut Vec<(u32, [u32; LINES])>,
    ) -> f32 {
        let random = |k: u32| unit(combine(seed, 2 * cell as u32 + k));
        let turn = [random(0), random(1)];
        let mut sum = [0f32; LINES];
        for batch in &self.lines.batches[cell * self.lines.per_cell..][..self.lines.per_cell] {
            let points = entry_points(aabb, batch, turn);
            let mut met = [0f32; LINES];
            match child {
                Child::Leaf(leaf) => {
                    self.leaf(self.view.leaf(leaf), batch, &points, &[u32::MAX; LINES], &mut met);
                }
                Child::Node(node) => self.walk(node, batch, &points, cell, &mut met, stack),
            }
            for lane in 0..LINES {
                sum[lane] += 1.0 - dimmed(met[lane]);
            }
        }
        let total = ((sum[0] + sum[4]) + (sum[2] + sum[6])) + ((sum[1] + sum[5]) + (sum[3] + sum[7]));
        smaller(total / (self.lines.per_cell * LINES) as f32, 1.0)
    }

    /// Adds what lines meet below `node`.
    #[inline(always)]
    fn walk(
        &self,
        node: u32,
        batch: &Batch,
        points: &[Lanes; 3],
        cell: usize,
        met: &mut Lanes,
        stack: &mut Vec<(u32, [u32; LINES])>,
    ) {
        stack.clear();
        stack.push((node, [u32::MAX; LINES]));
        while let Some((child, within)) = stack.pop() {
            if child & View::LEAF != 0 {
                self.leaf(self.view.leaf(child & !View::LEAF), batch, points, &within, met);
                continue;
            }
            let (node, mask) = (self.view.node(child), self.masks[child as usize]);
            let (rows, start) = (node.bounds(), node.note().index);
            for (slot, &below) in node.children()[..node.len()].iter().enumerate() {
                let (mut entry, mut exit) = ([f32::NEG_INFINITY; LINES], [f32::INFINITY; LINES]);
                for axis in 0..3 {
                    let (low, high) = (rows[2 * axis][slot], rows[2 * axis + 1][slot]);
                    for i in 0..LINES {
                        let a = (low - points[axis][i]) * batch.inverse[axis][i];
                        let b = (high - points[axis][i]) * batch.inverse[axis][i];
                        entry[i] = larger(smaller(a, b), entry[i]);
                        exit[i] = smaller(larger(a, b), exit[i]);
                    }
                }
                let (mut hit, mut any) = ([0u32; LINES], 0);
                for i in 0..LINES {
                    hit[i] = all_if(entry[i] <= exit[i]) & within[i];
                    any |= hit[i];
                }
                if mask >> slot & 1 == 1 {
                    let depth = self.table.depth(cell, start, slot);
                    for i in 0..LINES {
                        met[i] += f32::from_bits(depth.to_bits() & hit[i]);
                    }
                } else if any != 0 {
                    stack.push((below, hit));
                }
            }
        }
    }

    /// Adds the triangles of a leaf that lines cross. Not watertight: a line that slips through an edge is one of many.
    #[inline(always)]
    fn leaf(
        &self,
        block: &TriangleBlock,
        batch: &Batch,
        points: &[Lanes; 3],
        within: &[u32; LINES],
        met: &mut Lanes,
    ) {
        let d = &batch.direction;
        for triangle in 0..block.len() {
            let bits = self.depths.of(block, triangle).bits();
            let depth = smaller(bits, OPAQUE);
            let [a, b, c] = block.get(triangle);
            let (e, f) = ([b[0] - a[0], b[1] - a[1], b[2] - a[2]], [c[0] - a[0], c[1] - a[1], c[2] - a[2]]);
            for i in 0..LINES {
                // Moeller and Trumbore, for both sides.
                let h = [
                    d[1][i] * f[2] - d[2][i] * f[1],
                    d[2][i] * f[0] - d[0][i] * f[2],
                    d[0][i] * f[1] - d[1][i] * f[0],
                ];
                let volume = e[0] * h[0] + e[1] * h[1] + e[2] * h[2];
                let s = [points[0][i] - a[0], points[1][i] - a[1], points[2][i] - a[2]];
                let q = [s[1] * e[2] - s[2] * e[1], s[2] * e[0] - s[0] * e[2], s[0] * e[1] - s[1] * e[0]];
                let sign = 1f32.copysign(volume);
                let u = (s[0] * h[0] + s[1] * h[1] + s[2] * h[2]) * sign;
                let v = (d[0][i] * q[0] + d[1][i] * q[1] + d[2][i] * q[2]) * sign;
                let inside = all_if(u >= 0.0) & all_if(v >= 0.0) & all_if(u + v < volume * sign) & within[i];
                met[i] += f32::from_bits(depth.to_bits() & inside);
            }
        }
    }
}

/// Nodes by level, the root's first.
pub(crate) fn levels(bvh: &Bvh) -> Vec<Vec<u32>> {
    let count = bvh.view().node_count();
    let (mut levels, mut level_of) = (Vec::<Vec<u32>>::new(), vec![0usize; count]);
    for node in 0..count as u32 {
        let level = level_of[node as usize];
        if levels.len() == level {
            levels.push(Vec::new());
        }
        levels[level].push(node);
        for (_, child) in bvh.children(node) {
            if let Child::Node(child) = child {
                level_of[child as usize] = level + 1;
            }
        }
    }
    levels
}

/// Opacities of all children that `masks` let end rays, from the leaves up. `slots` is the sum of all rows.
pub(crate) fn measure<T: Cells>(
    bvh: &mut Bvh,
    depths: &Depths,
    directions: Directions,
    (masks, slots): (&[u8], usize),
    options: &PrefilterOptions,
    progress: &Progress,
) -> Result<T, Cancelled> {
    let lines = Lines::new(directions, options);
    let mut table = T::new(directions.cells(), slots);
    let back_end = BackEnd::Avx2.unless_forced();
    for level in levels(bvh).into_iter().rev() {
        let job = |indices: &[u32]| {
            progress.check()?;
            let view = bvh.view();
            let rows =
                back_end.run(Measure { view, bvh, depths, table: &table, lines: &lines, masks, indices });
            progress.advance(indices.len() as u64)?;
            Ok(rows)
        };
        #[cfg(feature = "rayon")]
        let done: Result<Vec<Vec<Row>>, Cancelled> = {
            use rayon::prelude::*;
            level.par_chunks(CHUNK).map(job).collect()
        };
        #[cfg(not(feature = "rayon"))]
        let done: Result<Vec<Vec<Row>>, Cancelled> = level.chunks(CHUNK).map(job).collect();
        for (index, slot, row) in done?.into_iter().flatten() {
            let mut note = *bvh.view().node(index).note();
            for (cell, &opacity) in row.iter().enumerate() {
                let random = unit(combine(combine(index, slot as u32), !(cell as u32)));
                table.set(cell, note.index, slot, opacity, random);
            }
            note.marks[slot] = mark(share(&row));
            bvh.set_note(index, note);
        }
    }
    Ok(table)
}

/// Smallest share of its size that a node may count with.
const MIN_SIZE_SHARE: f32 = 0.3;

/// Share of its squared radius that a node counts with: the variance of what passes through it, over the largest there is.
/// Where nearly nothing or nearly all passes, a ray may end sooner.
fn share(opacities: &[f32]) -> f32 {
    let sum: f32 = opacities.iter().map(|a| a * (1.0 - a)).sum();
    (4.0 * sum / opacities.len() as f32).max(MIN_SIZE_SHARE)
}

/// Opacities by the ad-hoc formula from cross sections of bounding spheres (section 4.4), over all children at once.
pub(crate) fn sphere_areas(bvh: &mut Bvh, depths: &Depths, (masks, slots): (&[u8], usize)) -> Cube<u8> {
    let mut table = Cube::<u8>::new(1, slots);
    let square = |aabb: &Aabb| aabb.size().length_squared();
    // Opacity of the union of each node's children.
    let mut whole = vec![0f32; bvh.view().node_count()];
    for index in (0..whole.len() as u32).rev() {
        let children: Vec<(Aabb, Child)> = bvh.children(index).collect();
        let union = children.iter().fold(Aabb::EMPTY, |all, (aabb, _)| all.union(*aabb));
        let around = square(&union).max(f32::MIN_POSITIVE);
        let mut note = *bvh.view().node(index).note();
        let mut passed = 1.0;
        for (slot, (aabb, child)) in children.iter().enumerate() {
            let alpha = match *child {
                Child::Leaf(leaf) => {
                    let block = bvh.view().leaf(leaf);
                    let own = square(aabb).max(f32::MIN_POSITIVE);
                    1.0 - (0..block.len()).fold(1.0, |passed, lane| {
                        let triangle = Aabb::from_points(&block.get(lane));
                        let alpha = 1.0 - depths.of(block, lane).transmittance();
                        passed * (1.0 - alpha * (square(&triangle) / own).min(1.0))
                    })
                }
                Child::Node(child) => whole[child as usize],
            };
            if masks[index as usize] >> slot & 1 == 1 {
                table.set(0, note.index, slot, alpha, 0.0);
                note.marks[slot] = mark(1.0);
            }
            passed *= 1.0 - alpha * (square(aabb) / around).min(1.0);
        }
        whole[index as usize] = 1.0 - passed;
        bvh.set_note(index, note);
    }
    table
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dimming_is_a_power_of_two() {
        for i in 0..2000 {
            let x = i as f32 * 0.05;
            let (fast, exact) = (dimmed(x), (-x).exp2());
            assert!((fast - exact).abs() <= 4e-6 * exact, "{x}: {fast} {exact}");
        }
        assert_eq!((dimmed(0.0), 1.0 - dimmed(1e9)), (1.0, 1.0));
    }
}
