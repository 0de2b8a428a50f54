//! Cones that march through a field, eight at a time.
//!
//! Here: which cells a cone passes and what their depths add up to. Not here: making the field (`field.rs`).

use super::{AXES, OPAQUE, OpacityField};
use crate::{
    BackEnd, MaskError,
    coarse::{
        Cones, FarField,
        voxelize::{Grid, LEVELS, Level},
    },
};
use umbrage_geom::simd::Job;

/// Most cells that a cone passes.
const MOST_STEPS: usize = 4096;

/// Cells that are looked up together.
const AHEAD: usize = 8;

/// Cones that march together.
const LANES: usize = 8;

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
    /// [`MaskError::Radius`] unless `near` and `radius` are more than 0; [`MaskError::Option`], [`MaskError::BackEnd`].
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
        let MarchOptions { cones, coarseness, back_end } = *options;
        for (name, value) in [("rays", rays), ("cones", cones)] {
            if value == 0 {
                return Err(MaskError::Option { name, value: 0.0, expected: "at least 1" });
            }
        }
        // NaN is refused too.
        if !(coarseness > 0.0 && coarseness.is_finite()) {
            let (name, value) = ("coarseness", coarseness);
            return Err(MaskError::Option { name, value, expected: "a finite number above 0" });
        }
        if !back_end.is_supported() {
            return Err(MaskError::BackEnd(back_end));
        }
        let bundle = (rays / cones).clamp(1, 32);
        // Of a cone, as if all were spread evenly over the hemisphere.
        let width = (std::f32::consts::TAU * bundle as f32 / rays as f32).sqrt();
        // Beyond the grid there is nothing; receivers that are farther outside than it is large see it small.
        let end = radius.min(near + 2.0 * field.bounds.diagonal());
        let level_at = |t: f32| {
            let wanted = (t * width * coarseness / field.cell).max(1.0).log2() as usize;
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
