//! Directional opacity of every node that may end rays, bottom-up in linear time (`[Lacewell08]`, section 3.3).
//!
//! Here: lines through a node's silhouette, dimmed by what the node holds. Not here: how opacity is stored (`storage.rs`),
//! which nodes have one (`correlation.rs`).
//!
//! The opacity of a node in a direction is the mean over lines that cross its box. Along a line, children that have an opacity
//! count with it, and the others with what is in them: at the correlation height that is the exact rendering of the paper,
//! above it the compositing of children. Departures: up to eight children at once; random lines instead of pixels, all over
//! the cell of directions.

use super::{
    CellSampling, Directions, PrefilterOptions,
    kernel::{Job, Kernel, Prepared},
    storage::{Cube, Element, Table},
    walk::{Depths, Scene},
    wide::{LEAF, Node, WIDTH, Wide},
};
use umbrage_geom::{
    Aabb, Cancelled, Progress, Ray, SlabRay,
    glam::Vec3,
    sampling::{combine, sobol_4d, unit},
};

/// Nodes whose opacities are computed together.
const CHUNK: usize = 256;

/// A direction of a cell, with where lines cross the silhouette before the node's own rotation.
struct Line {
    direction: Vec3,
    slab: SlabRay,
    at: [f32; 2],
}

/// Lines of all cells, cell by cell.
struct Lines {
    lines: Vec<Line>,
    per_cell: usize,
}

impl Lines {
    fn new(directions: Directions, options: &PrefilterOptions) -> Self {
        let per_cell = usize::from(options.lines);
        let mut lines = Vec::with_capacity(directions.cells() * per_cell);
        for cell in 0..directions.cells() {
            for i in 0..per_cell {
                let [u, v, s, t] = sobol_4d(i as u32, 0, cell as u32);
                let direction = match options.sampling {
                    CellSampling::Jittered => directions.at(cell, u, v),
                    CellSampling::Center => directions.center(cell),
                };
                let slab = SlabRay::new(&Ray::new(Vec3::ZERO, direction)).expect("a unit vector");
                lines.push(Line { direction, slab, at: [s, t] });
            }
        }
        Self { lines, per_cell }
    }
}

/// Area of a box as seen along `d`, face by face.
#[inline(always)]
fn seen_areas(size: Vec3, d: Vec3) -> Vec3 {
    d.abs() * Vec3::new(size.y * size.z, size.z * size.x, size.x * size.y)
}

/// The point where a line along `d` enters the box: uniform over its silhouette for uniform `u`, `v`. `None` if the box is
/// seen edge-on.
#[inline(always)]
fn entry_point(aabb: &Aabb, d: Vec3, u: f32, v: f32) -> Option<Vec3> {
    let size = aabb.max - aabb.min;
    let areas = seen_areas(size, d);
    let mut target = u * (areas.x + areas.y + areas.z);
    let axis = if target < areas.x {
        0
    } else if target < areas.x + areas.y {
        target -= areas.x;
        1
    } else {
        target -= areas.x + areas.y;
        2
    };
    let area = areas[axis];
    if area.is_nan() || area <= 0.0 {
        return None;
    }
    let (a, b) = ((axis + 1) % 3, (axis + 2) % 3);
    let mut point = aabb.min;
    point[axis] = if d[axis] > 0.0 { aabb.min[axis] } else { aabb.max[axis] };
    point[a] += size[a] * (target / area).min(1.0);
    point[b] += size[b] * v;
    Some(point)
}

/// Computes the opacities of nodes `indices` of one level; those below are in `scene.table`.
struct Measure<'a, E> {
    scene: Scene<'a, Cube<E>>,
    lines: &'a Lines,
    directions: Directions,
    masks: &'a [u8],
    indices: std::ops::Range<usize>,
}

impl<E: Element> Job for Measure<'_, E> {
    /// Opacities cell by cell, for each node.
    type Output = Vec<[E; WIDTH]>;

    #[inline(always)]
    fn run<K: Kernel>(self, kernel: K) -> Self::Output {
        let cells = self.directions.cells();
        let mut rows = Vec::with_capacity(self.indices.len() * cells);
        for index in self.indices.clone() {
            let node = &self.scene.wide.nodes[index];
            for cell in 0..cells {
                let mut row = [E::default(); WIDTH];
                let mut mask = self.masks[index];
                while mask != 0 {
                    let slot = mask.trailing_zeros() as usize % WIDTH;
                    mask &= mask - 1;
                    row[slot] =
                        E::encode(self.opacity(kernel, node, slot, cell, combine(index as u32, slot as u32)));
                }
                rows.push(row);
            }
        }
        rows
    }
}

impl<E: Element> Measure<'_, E> {
    #[inline(always)]
    fn opacity<K: Kernel>(&self, kernel: K, node: &Node, slot: usize, cell: usize, seed: u32) -> f32 {
        let aabb = node.child_box(slot);
        let view = self.scene.table.view(cell as u32, self.directions.center(cell));
        let (turn_u, turn_v) =
            (unit(combine(seed, 2 * cell as u32)), unit(combine(seed, 2 * cell as u32 + 1)));
        let back = aabb.diagonal();
        let (mut blocked, mut count) = (0.0, 0u32);
        for line in &self.lines.lines[cell * self.lines.per_cell..][..self.lines.per_cell] {
            let turned = |x: f32, turn: f32| (x + turn).fract();
            let (u, v) = (turned(line.at[0], turn_u), turned(line.at[1], turn_v));
            let Some(point) = entry_point(&aabb, line.direction, u, v) else { continue };
            let ray = Ray::new(point - line.direction * back, line.direction);
            let mut slab = line.slab;
            (slab.origin_near, slab.origin_far) = (ray.origin, ray.origin);
            count += 1;
            if let Some(prepared) = Prepared::with_slab(&ray, slab, f32::INFINITY, Prepared::WHOLE) {
                blocked += 1.0 - self.scene.walk(kernel, node.children[slot], &ray, &prepared, view, &mut ());
            }
        }
        if count == 0 { 0.0 } else { blocked / count as f32 }
    }
}

/// Opacities of all children that `masks` let end rays, from the leaves up.
pub(crate) fn measure<E: Element>(
    wide: &mut Wide,
    depths: &Depths,
    directions: Directions,
    masks: &[u8],
    options: &PrefilterOptions,
    progress: &Progress,
) -> Result<Cube<E>, Cancelled> {
    let lines = Lines::new(directions, options);
    let cells = directions.cells();
    let mut table = Cube::<E>::new(cells, wide.nodes.len());
    for level in wide.levels.clone().into_iter().rev() {
        let scene = Scene { wide, depths, table: &table };
        let job = |start: usize| {
            progress.check()?;
            let indices = start..(start + CHUNK).min(level.end);
            let job = Measure { scene, lines: &lines, directions, masks, indices: indices.clone() };
            let rows = super::kernel::run(job);
            progress.advance(indices.len() as u64)?;
            Ok((indices, rows))
        };
        let starts: Vec<usize> = level.clone().step_by(CHUNK).collect();
        #[cfg(feature = "rayon")]
        let done: Result<Vec<_>, Cancelled> = {
            use rayon::prelude::*;
            starts.into_par_iter().map(job).collect()
        };
        #[cfg(not(feature = "rayon"))]
        let done: Result<Vec<_>, Cancelled> = starts.into_iter().map(job).collect();
        for (indices, rows) in done? {
            for (index, rows) in indices.zip(rows.chunks(cells)) {
                rows.iter().enumerate().for_each(|(cell, &row)| table.set(cell, index, row));
            }
        }
        for index in level {
            set_reach(&mut wide.nodes[index], masks[index], |slot| share(&table, index, slot));
        }
    }
    Ok(table)
}

/// Smallest share of its size that a node may count with.
const LEAST_SHARE: f32 = 0.3;

/// Share of its squared radius that a node counts with: the variance of what passes through it, over the largest there is.
/// Where nearly nothing or nearly all passes, a ray may end sooner.
fn share<E: Element>(table: &Cube<E>, node: usize, slot: usize) -> f32 {
    let cells = table.cells();
    let passed = (0..cells).map(|cell| (-table.get(cell, node)[slot].depth()).exp2());
    let sum: f32 = passed.map(|t| t * (1.0 - t)).sum();
    (4.0 * sum / cells as f32).max(LEAST_SHARE)
}

/// Sets from which squared radius on children end rays.
fn set_reach(node: &mut Node, mask: u8, share: impl Fn(usize) -> f32) {
    for slot in 0..node.len() {
        let radius = 0.5 * node.child_box(slot).diagonal();
        node.reach[slot] = if mask >> slot & 1 == 1 { radius * radius * share(slot) } else { f32::INFINITY };
    }
}

/// Opacities by the ad-hoc formula from cross sections of bounding spheres (section 4.4), over all children at once.
pub(crate) fn sphere_areas(wide: &mut Wide, depths: &Depths, masks: &[u8]) -> Cube<u8> {
    let mut table = Cube::<u8>::new(1, wide.nodes.len());
    let square = |aabb: &Aabb| aabb.size().length_squared();
    // Opacity of the union of each node's children.
    let mut whole = vec![0f32; wide.nodes.len()];
    for index in (0..wide.nodes.len()).rev() {
        let node = &wide.nodes[index];
        let around = square(&node.bounds()).max(f32::MIN_POSITIVE);
        let mut row = [0u8; WIDTH];
        let mut passed = 1.0;
        for (slot, coded) in row.iter_mut().enumerate().take(node.len()) {
            let (child, aabb) = (node.children[slot], node.child_box(slot));
            let alpha = if child & LEAF != 0 {
                let leaf = (child & !LEAF) as usize;
                let own = square(&aabb).max(f32::MIN_POSITIVE);
                let lanes = 0..wide.blocks[leaf].len();
                1.0 - lanes.into_iter().fold(1.0, |passed, lane| {
                    let triangle = Aabb::from_points(&wide.blocks[leaf].get(lane));
                    let alpha = 1.0 - depths.of(leaf, lane).transmittance();
                    passed * (1.0 - alpha * (square(&triangle) / own).min(1.0))
                })
            } else {
                whole[child as usize]
            };
            *coded = u8::encode(alpha);
            passed *= 1.0 - alpha * (square(&aabb) / around).min(1.0);
        }
        whole[index] = 1.0 - passed;
        table.set(0, index, row);
        set_reach(&mut wide.nodes[index], masks[index], |_| 1.0);
    }
    table
}

/// Means over directions, weighted by solid angle.
pub(crate) fn averages(cube: &Cube<f32>, directions: Directions, nodes: usize) -> Cube<u8> {
    let weights: Vec<f32> = (0..directions.cells()).map(|c| directions.weight(c)).collect();
    let total: f32 = weights.iter().sum();
    let mut table = Cube::<u8>::new(1, nodes);
    for node in 0..nodes {
        let mut sums = [0f32; WIDTH];
        for (cell, weight) in weights.iter().enumerate() {
            for (sum, depth) in sums.iter_mut().zip(cube.get(cell, node)) {
                *sum += weight * (1.0 - (-depth).exp2());
            }
        }
        table.set(0, node, sums.map(|sum| u8::encode((sum / total).min(1.0))));
    }
    table
}
