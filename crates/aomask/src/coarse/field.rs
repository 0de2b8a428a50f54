//! Directional opacity of space in cells of several sizes, after voxel cone tracing (Crassin et al. 2011).
//!
//! Here: making the field, and cones that march through it. Not here: which lines meet which triangles (`voxelize.rs`).
//!
//! Each of 13 directions (towards the faces, edges and corners of a cube; opposite ones are the same) has a grid of its own, turned to
//! it. A cell of every level stores the optical depth that explains which share of the lines along its direction its triangles
//! block (semi-transparent ones with the probability of their opacity), given that nothing blocked them in the cell before. A cone looks up the grid whose direction is nearest to its own, in
//! cells that grow with its width, cell by cell.

use super::{
    Cones, FarField,
    voxelize::{Grid, LEVELS, LINES, Level},
};
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

/// Most cells that a cone passes.
const MOST_STEPS: usize = 4096;

/// Cells that are looked up together.
const AHEAD: usize = 8;

/// Cones that march together.
const LANES: usize = 8;

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

/// How cones go through a field: the knobs between error and time, beside where the field starts.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct MarchOptions {
    /// Cones of a receiver, about; neighbouring rays, 32 at most, share one.
    pub cones: usize,
    /// Width of cells in widths of the cone.
    pub coarseness: f32,
    /// What cones run on. Answers are the same.
    pub back_end: BackEnd,
}

impl Default for MarchOptions {
    fn default() -> Self {
        Self { cones: 128, coarseness: 0.5, back_end: BackEnd::best() }
    }
}

impl MarchOptions {
    /// Sets the number of cones.
    #[must_use]
    pub fn with_cones(self, cones: usize) -> Self {
        Self { cones, ..self }
    }

    /// Sets the width of cells.
    #[must_use]
    pub fn with_coarseness(self, coarseness: f32) -> Self {
        Self { coarseness, ..self }
    }

    /// Sets the back end.
    #[must_use]
    pub fn with_back_end(self, back_end: BackEnd) -> Self {
        Self { back_end, ..self }
    }
}

/// A field as what lies far away from the receivers of one pattern.
#[derive(Clone, Debug)]
pub struct FieldCones<'a> {
    field: &'a OpacityField,
    near: f32,
    bundle: usize,
    /// Levels of the cells that cones pass, one after the other; more than they need.
    steps: Vec<u8>,
    axes: Vec<Axis>,
    back_end: BackEnd,
}

/// What cones need of a grid.
#[derive(Clone, Copy, Debug)]
struct Axis {
    direction: [f32; 3],
    /// Of the grid, and where its origin is along them.
    axes: [[f32; 3]; 3],
    low: [f32; 3],
}

impl<'a> FieldCones<'a> {
    /// For patterns of `rays` rays, at least 1, of which `near` (world units) has been answered and that end at `radius` or before.
    ///
    /// # Errors
    /// [`MaskError::Radius`] unless `near` and `radius` are more than 0; [`MaskError::BackEnd`].
    pub fn new(
        field: &'a OpacityField,
        rays: usize,
        near: f32,
        radius: f32,
        options: &MarchOptions,
    ) -> Result<Self, MaskError> {
        for length in [near, radius] {
            if length.is_nan() || length <= 0.0 {
                return Err(MaskError::Radius(length));
            }
        }
        let back_end = options.back_end;
        if !back_end.is_supported() {
            return Err(MaskError::BackEnd(back_end));
        }
        let rays = rays.max(1);
        let bundle = (rays / options.cones.max(1)).clamp(1, 32);
        // Of a cone, as if all were spread evenly over the hemisphere.
        let width = (std::f32::consts::TAU * bundle as f32 / rays as f32).sqrt();
        // Beyond the grid there is nothing; receivers that are farther outside than it is large see it small.
        let end = radius.min(near + 2.0 * field.bounds.diagonal());
        let level_at = |t: f32| {
            let wanted = (t * width * options.coarseness / field.cell).max(1.0).log2() as usize;
            wanted.min(LEVELS - 1)
        };
        let (mut steps, mut t, mut level) = (Vec::new(), near, level_at(near));
        while t < end && steps.len() < MOST_STEPS {
            if level_at(t) > level {
                // The first cell of a level may be met where it ends.
                level += 1;
                steps.push(level as u8);
            }
            steps.push(level as u8);
            t += field.length * (1 << level) as f32;
        }
        steps.push(level as u8);
        let axis = |grid: &Grid| Axis {
            direction: grid.axes[2].normalize().as_vec3().to_array(),
            axes: grid.axes.map(|axis| axis.as_vec3().to_array()),
            low: grid.low.map(|x| x as f32),
        };
        let axes = field.grids.iter().map(axis).collect();
        Ok(Self { field, near, bundle, steps, axes, back_end })
    }
}

impl FarField for FieldCones<'_> {
    fn near(&self) -> f32 {
        self.near
    }

    fn bundle(&self) -> usize {
        self.bundle
    }

    fn transmittances(&self, cones: &Cones, passed: &mut [f32]) {
        if self.axes.is_empty() {
            return passed.fill(1.0);
        }
        self.back_end.run(March { far: self, cones, passed });
    }
}

/// Cones of one receiver on their way.
struct March<'a> {
    far: &'a FieldCones<'a>,
    cones: &'a Cones,
    passed: &'a mut [f32],
}

impl Job for March<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self { far, cones, passed } = self;
        let origin = cones.origin.to_array();
        for (i, passed) in passed.chunks_mut(LANES).enumerate() {
            let (at, n) = (i * LANES, passed.len());
            let (mut direction, mut length) = ([[0.5; LANES]; 3], [0.0; LANES]);
            for (to, from) in direction.iter_mut().zip(&cones.directions) {
                to[..n].copy_from_slice(&from[at..at + n]);
            }
            length[..n].copy_from_slice(&cones.lengths[at..at + n]);
            let depth = march(far, origin, &direction, &length);
            let mut out = [0.0; LANES];
            for lane in 0..LANES {
                out[lane] = exp_minus(depth[lane]);
            }
            passed.copy_from_slice(&out[..n]);
        }
    }
}

/// The grid of each cone: that whose direction is nearest to its own.
#[inline(always)]
fn grids_of(far: &FieldCones<'_>, [x, y, z]: &[[f32; LANES]; 3]) -> [u32; LANES] {
    let (mut best, mut number) = ([0.0; LANES], [0u32; LANES]);
    for (i, axis) in far.axes.iter().enumerate() {
        let [ax, ay, az] = axis.direction;
        for lane in 0..LANES {
            let along = (ax * x[lane] + ay * y[lane] + az * z[lane]).abs();
            let closer = along > best[lane];
            best[lane] = if closer { along } else { best[lane] };
            number[lane] = if closer { i as u32 } else { number[lane] };
        }
    }
    number
}

/// Optical depth along eight cones from `origin`. Each passes cell by cell along the third axis of its grid.
#[inline(always)]
fn march(
    far: &FieldCones<'_>,
    origin: [f32; 3],
    direction: &[[f32; LANES]; 3],
    length: &[f32; LANES],
) -> [f32; LANES] {
    let number = grids_of(far, direction);
    let [x, y, z] = direction;
    // Origins and directions along the axes of the grids.
    let (mut start, mut slope) = ([[0.0; LANES]; 3], [[0.0; LANES]; 3]);
    for lane in 0..LANES {
        let axis = &far.axes[number[lane] as usize % AXES];
        for i in 0..3 {
            let [ax, ay, az] = axis.axes[i];
            start[i][lane] = ax * origin[0] + ay * origin[1] + az * origin[2] - axis.low[i];
            slope[i][lane] = ax * x[lane] + ay * y[lane] + az * z[lane];
        }
    }
    // Where cones are along the third axis, counted so that it grows, and where they end.
    let (mut place, mut from, mut end, mut per_cell) =
        ([0.0; LANES], [0.0; LANES], [0.0; LANES], [0.0; LANES]);
    for lane in 0..LANES {
        let steep = slope[2][lane].abs();
        from[lane] = if slope[2][lane] < 0.0 { -start[2][lane] } else { start[2][lane] };
        place[lane] = from[lane] + steep * far.near;
        end[lane] = from[lane] + steep * length[lane];
        per_cell[lane] = 1.0 / steep;
    }
    // Cells have their depth for a way along the third axis; this cone's way is longer.
    let unit = 1.0 / (far.field.length);
    // First which cells, then what they hold: so that many loads are under way at a time.
    let (mut first, mut strides, mut most) = ([0; LANES], [[0; LANES]; 3], [[0.0; LANES]; 3]);
    let mut loaded = u8::MAX;
    let mut sum = [0.0; LANES];
    // Exact rays have passed a part of the first cell. The rest is taken to hold less than its share: around receivers most of
    // what a cell holds is near them (bush, 1024 rays: a bias of -0.0004 rather than -0.0052).
    let mut begun = false;
    for steps in far.steps.chunks(AHEAD) {
        let (mut cells, mut shares) = ([[0u32; LANES]; AHEAD], [[0.0; LANES]; AHEAD]);
        let mut open = 0;
        for ((&step, cells), shares) in steps.iter().zip(&mut cells).zip(&mut shares) {
            if step != loaded {
                loaded = step;
                for lane in 0..LANES {
                    let grid = &far.field.grids[number[lane] as usize % AXES];
                    let level = &grid.levels[step as usize % LEVELS];
                    first[lane] = level.first;
                    for axis in 0..3 {
                        strides[axis][lane] = level.strides[axis];
                        most[axis][lane] = (level.size[axis] + 1) as f32;
                    }
                }
            }
            let (size, scale) = ((1u32 << step) as f32, 1.0 / (1u32 << step) as f32);
            let (mut t, mut left) = ([0.0; LANES], 0u32);
            for lane in 0..LANES {
                let face = ((place[lane] * scale).floor() + 1.0) * size;
                let to = if face < end[lane] { face } else { end[lane] };
                let way = to - place[lane];
                let way = if way > 0.0 { way } else { 0.0 };
                let part = way * scale;
                shares[lane] = part * (if begun { 1.0 } else { part }) * per_cell[lane] * unit;
                t[lane] = (place[lane] + 0.5 * way - from[lane]) * per_cell[lane];
                left |= u32::from(way > 0.0);
                place[lane] = face;
            }
            begun = true;
            if left == 0 {
                break;
            }
            open += 1;
            *cells = first;
            for axis in 0..3 {
                for lane in 0..LANES {
                    // Half a cell less than rounding wants, one more for the empty layer.
                    let at = (start[axis][lane] + slope[axis][lane] * t[lane]) * scale + 0.5;
                    let at = if at > 0.0 { at } else { 0.0 };
                    let at = if at < most[axis][lane] { at } else { most[axis][lane] };
                    // Adding this rounds to whole numbers, which end up in the low bits.
                    let i = (at + 12_582_912.0).to_bits() & 0x3f_ffff;
                    cells[lane] += Level::offset(strides[axis][lane], axis, i);
                }
            }
        }
        let roots = &far.field.roots[..];
        let mut codes = [[0u8; LANES]; AHEAD];
        for (codes, cells) in codes.iter_mut().zip(&cells).take(open) {
            for lane in 0..LANES {
                codes[lane] = roots.get(cells[lane] as usize).copied().unwrap_or(0);
            }
        }
        for (codes, shares) in codes.iter().zip(&shares).take(open) {
            for lane in 0..LANES {
                let root = f32::from(codes[lane]);
                sum[lane] += root * root * (OPAQUE as f32 / (255.0 * 255.0)) * shares[lane];
            }
        }
        if open < steps.len() {
            break;
        }
        let mut least = f32::INFINITY;
        for &sum in &sum {
            least = if sum < least { sum } else { least };
        }
        if least > OPAQUE as f32 {
            break;
        }
    }
    sum
}

/// `exp(-x)` for `x` from 0, to about 1e-6 of it; 0 where less than [`OPAQUE`] leaves passes.
#[inline(always)]
fn exp_minus(x: f32) -> f32 {
    let y = x * -std::f32::consts::LOG2_E;
    let y = if y > -60.0 { y } else { -60.0 };
    let shifted = y + 12_582_912.0;
    let whole = shifted - 12_582_912.0;
    let f = (y - whole) * std::f32::consts::LN_2;
    let series = 1.0 + f * (1.0 + f * (0.5 + f * (1.0 / 6.0 + f * (1.0 / 24.0 + f * (1.0 / 120.0)))));
    let power = f32::from_bits(((whole + 127.0) as u32) << 23);
    if x < 0.999 * OPAQUE as f32 { series * power } else { 0.0 }
}
