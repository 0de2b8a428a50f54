//! Directional opacity of space in cells of several sizes, after voxel cone tracing (Crassin et al. 2011).
//!
//! Here: making the field. Not here: which lines meet which triangles (`voxelize.rs`), cones that march through it
//! (`field/march.rs`).
//!
//! Each of 13 directions (towards the faces, edges and corners of a cube; opposite ones are the same) has a grid of its own, turned to
//! it. A cell of every level stores the optical depth that explains which share of the lines along its direction its triangles
//! block (semi-transparent ones with the probability of their opacity), given that nothing blocked them in the cell before. A cone looks up the grid whose direction is nearest to its own, in
//! cells that grow with its width, cell by cell.

mod march;

pub use march::{FieldCones, MarchOptions};

use super::voxelize::{Grid, LINES};
use crate::{BackEnd, MaskError};
use std::sync::atomic::{AtomicU64, Ordering};
use umbrage_accel::BuildError;
use umbrage_geom::{
    Aabb, Progress,
    glam::{DVec3, Vec3},
    mesh::validate_slices,
    sampling::{combine, hash, unit},
    simd::Job,
};

/// Directions.
const AXES: usize = 13;

/// Optical depth of a cell that lets nothing pass.
const OPAQUE: f64 = 8.0;

/// Triangles that a thread takes at a time.
const CHUNK: usize = 4096;

/// Settings of an [`OpacityField`].
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct FieldOptions {
    /// Cells along the longest side, 8 to [`OpacityField::MAX_CELLS`].
    pub cells: u32,
    /// Length of cells in widths, 0.25 to 16: rays that look up a direction go along the cells.
    pub elongation: f32,
    /// What the grid spans; the bounds of the triangles where there is none. Nothing outside blocks.
    pub bounds: Option<Aabb>,
}

impl Default for FieldOptions {
    fn default() -> Self {
        Self { cells: 128, elongation: 2.0, bounds: None }
    }
}

impl FieldOptions {
    /// Sets the number of cells.
    #[must_use]
    pub fn with_cells(self, cells: u32) -> Self {
        Self { cells, ..self }
    }

    /// Sets the length of cells.
    #[must_use]
    pub fn with_elongation(self, elongation: f32) -> Self {
        Self { elongation, ..self }
    }

    /// Sets the box.
    #[must_use]
    pub fn with_bounds(self, bounds: Aabb) -> Self {
        Self { bounds: Some(bounds), ..self }
    }
}

/// Directional opacity of a scene.
#[derive(Clone, Debug)]
pub struct OpacityField {
    /// Width of the finest cells, world units.
    cell: f32,
    /// Their length, world units.
    length: f32,
    /// Around everything that blocks.
    bounds: Aabb,
    /// One for each direction.
    grids: Vec<Grid>,
    /// By cell of all grids: the root of the optical depth along the length of the cell.
    roots: Vec<u8>,
}

/// Towards faces, edges and corners of a cube, one of each opposite pair.
fn axes() -> [DVec3; AXES] {
    let mut axes = [DVec3::ZERO; AXES];
    for (axis, code) in axes.iter_mut().zip(14..27) {
        let digit = |n: i32| f64::from(code / n % 3 - 1);
        *axis = DVec3::new(digit(1), digit(3), digit(9)).normalize();
    }
    axes
}

impl OpacityField {
    /// Most cells along a side.
    pub const MAX_CELLS: u32 = 192;

    /// Makes the field of opaque triangles; linear in triangles and in what they cover. `progress` gets growing fractions that end
    /// at exactly 1, from any thread, and returns `false` to cancel.
    ///
    /// # Errors
    /// [`MaskError::Resolution`], [`MaskError::Elongation`]; [`MaskError::Build`] for positions and indices that make no mesh and for a box that is empty
    /// or not finite; [`MaskError::Cancelled`].
    pub fn build(
        positions: &[[f32; 3]],
        triangles: &[[u32; 3]],
        options: &FieldOptions,
        progress: &mut (dyn FnMut(f32) -> bool + Send),
    ) -> Result<Self, MaskError> {
        Self::build_transparent(positions, triangles, &[], options, progress)
    }

    /// [`Self::build`] among semi-transparent triangles: `opacities` has the fraction of light that a crossing of each triangle
    /// blocks (NaN counts as opaque), or nothing if all are opaque.
    ///
    /// A triangle of opacity `a` blocks each line that meets it with probability `a`, independently of all other triangles, so
    /// that the mean over lines of what passes several triangles is the product of what each lets pass.
    ///
    /// # Errors
    /// As for [`Self::build`]; [`MaskError::Opacities`].
    pub fn build_transparent(
        positions: &[[f32; 3]],
        triangles: &[[u32; 3]],
        opacities: &[f32],
        options: &FieldOptions,
        progress: &mut (dyn FnMut(f32) -> bool + Send),
    ) -> Result<Self, MaskError> {
        if !opacities.is_empty() && opacities.len() != triangles.len() {
            return Err(MaskError::Opacities { actual: opacities.len(), triangles: triangles.len() });
        }
        if !(8..=Self::MAX_CELLS).contains(&options.cells) {
            let (value, limit) = (options.cells, Self::MAX_CELLS);
            return Err(MaskError::Resolution { what: "far opacity", value, limit });
        }
        if !(0.25..=16.0).contains(&options.elongation) {
            return Err(MaskError::Elongation(options.elongation));
        }
        // No triangles are no mesh, but a scene that blocks nothing.
        if !triangles.is_empty() {
            validate_slices(positions, triangles).map_err(BuildError::from)?;
        }
        let corners = triangles.iter().flatten();
        let within = corners.fold(Aabb::EMPTY, |aabb, &v| aabb.with_point(positions[v as usize]));
        let bounds = options.bounds.unwrap_or(within);
        let size = bounds.max.as_dvec3() - bounds.min.as_dvec3();
        let mut field = Self { cell: 1.0, length: 1.0, bounds, grids: Vec::new(), roots: Vec::new() };
        if triangles.is_empty() {
            return progress(1.0).then_some(field).ok_or(MaskError::Cancelled);
        }
        if !(size.min_element() >= 0.0 && size.is_finite()) {
            return Err(BuildError::Box { index: 0 }.into());
        }
        let cell = (size.max_element() / f64::from(options.cells)).max(f64::from(f32::MIN_POSITIVE));
        let length = cell * f64::from(options.elongation);
        (field.cell, field.length) = (cell as f32, length as f32);
        let mut cells = 0;
        for axis in axes() {
            let grid = Grid::new(axis, positions, triangles, &bounds, [cell, length], cells);
            cells = grid.cells.end;
            field.grids.push(grid);
        }
        field.roots = vec![0; cells];
        let progress = Progress::new(AXES as u64, progress);
        field.fill(positions, triangles, opacities, &progress)?;
        progress.finish()?;
        Ok(field)
    }

    fn fill(
        &mut self,
        positions: &[[f32; 3]],
        triangles: &[[u32; 3]],
        opacities: &[f32],
        progress: &Progress<'_>,
    ) -> Result<(), MaskError> {
        let depths = Depths::new();
        let most = self.grids.iter().map(|grid| grid.cells.len()).max().unwrap_or(0);
        let marks: Vec<AtomicU64> = (0..most).map(|_| AtomicU64::new(0)).collect();
        let chunks = triangles.len().div_ceil(CHUNK);
        for (axis, grid) in self.grids.iter().enumerate() {
            let work = |chunk: usize| {
                progress.check()?;
                let range = chunk * CHUNK..triangles.len().min((chunk + 1) * CHUNK);
                let seed = combine(axis as u32, chunk as u32);
                let (triangles, opacities) = (&triangles[range.clone()], opacities.get(range).unwrap_or(&[]));
                BackEnd::best().run(Marking { grid, positions, triangles, opacities, seed, marks: &marks });
                Ok::<(), MaskError>(())
            };
            #[cfg(feature = "rayon")]
            {
                use rayon::prelude::*;
                (0..chunks).into_par_iter().try_for_each(work)?;
            }
            #[cfg(not(feature = "rayon"))]
            (0..chunks).try_for_each(work)?;
            for level in &grid.levels {
                let [x, y, z] = level.size;
                let mark = |at: [u32; 3]| {
                    let cell = level.cell(at) as usize;
                    marks[cell - grid.cells.start].load(Ordering::Relaxed)
                };
                for at in (1..=z).flat_map(|k| (1..=y).flat_map(move |j| (1..=x).map(move |i| [i, j, k]))) {
                    let [i, j, k] = at;
                    let hit = mark(at);
                    if hit != 0 {
                        let depth = depths.of(hit, mark([i, j, k - 1]), mark([i, j, k + 1]));
                        let cell = level.cell(at);
                        self.roots[cell as usize] = coded(depth, unit(hash(cell)));
                    }
                }
            }
            marks.iter().for_each(|mark| mark.store(0, Ordering::Relaxed));
            progress.advance(1)?;
        }
        Ok(())
    }

    /// Bytes of what is stored.
    pub fn bytes(&self) -> usize {
        self.roots.len()
    }

    /// Width of the finest cells, world units.
    pub fn cell(&self) -> f32 {
        self.cell
    }
}

/// Marks the cells of some triangles.
struct Marking<'a> {
    grid: &'a Grid,
    positions: &'a [[f32; 3]],
    triangles: &'a [[u32; 3]],
    /// Of the triangles; empty if all are opaque.
    opacities: &'a [f32],
    /// Of the lines that semi-transparent triangles block.
    seed: u32,
    marks: &'a [AtomicU64],
}

impl Job for Marking<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        for (i, triangle) in self.triangles.iter().enumerate() {
            let corners = triangle.map(|v| Vec3::from(self.positions[v as usize]).as_dvec3());
            match self.opacities.get(i) {
                Some(&opacity) if opacity < 1.0 => {
                    let seed = combine(self.seed, i as u32);
                    let blocks = |a, b| unit(combine(hash(seed ^ a), b)) < opacity;
                    self.grid.mark(corners, self.marks, blocks);
                }
                _ => self.grid.mark(corners, self.marks, |_, _| true),
            }
        }
    }
}

/// Optical depths by what happens to the lines of a cell.
struct Depths([f64; (LINES * LINES + 1) as usize]);

impl Depths {
    fn new() -> Self {
        let mut sums = [0.0; (LINES * LINES + 1) as usize];
        for n in 1..sums.len() {
            sums[n] = sums[n - 1] + 1.0 / n as f64;
        }
        Self(sums)
    }

    /// Of a cell whose lines `hit` are blocked, for light that has passed the cell before it, from either side: what is
    /// blocked there does not count, so that neither the two faces of a thin solid count twice nor parts of one surface in
    /// two cells are taken for independent.
    fn of(&self, hit: u64, before: u64, after: u64) -> f64 {
        let one = |other: u64| {
            let open = LINES * LINES - other.count_ones();
            (open != 0).then(|| self.block(open, (hit & !other).count_ones()))
        };
        match (one(before), one(after)) {
            (Some(a), Some(b)) => 0.5 * (a + b),
            (Some(a), None) | (None, Some(a)) => a,
            (None, None) => OPAQUE,
        }
    }

    /// `hit` of `open` lines are blocked. Were they so independently, 1/n + 1/(n-1) + .. has the logarithm of the share that
    /// passes as its mean; the logarithm of the mean share would be too large.
    fn block(&self, open: u32, hit: u32) -> f64 {
        let passed = open - hit;
        if passed == 0 { OPAQUE } else { (self.0[open as usize] - self.0[passed as usize]).min(OPAQUE) }
    }
}

/// The code of a depth, rounded at random so that the mean is right.
fn coded(depth: f64, random: f32) -> u8 {
    let code = (depth / OPAQUE).sqrt() * 255.0;
    let (below, square) = (code.floor(), code * code);
    let above = (square - below * below) / (2.0 * below + 1.0);
    (below + f64::from(u8::from(f64::from(random) < above))) as u8
}
