//! How opacities lie in memory (`[Lacewell08]`, section 4.4), and what a ray reads of them: optical depths of eight children.
//!
//! Here: forms of storage. Not here: where opacities come from (`opacity.rs`).
//!
//! A node that may end rays has a *row* of slots in every cell of directions, up to the last slot that may. Cells are
//! outermost: the rays of a fan look at few of them, in which the rows of nodes that lie together share cache lines.

use super::Directions;
use umbrage_geom::glam::Vec3;

/// Children of a node.
pub(crate) const WIDTH: usize = 8;

/// Optical depth, `-log2(1 - opacity)`, of something that blocks everything; finite so that 0 times it is 0.
pub(crate) const OPAQUE: f32 = 64.0;

/// Optical depth in bits of an opacity in `[0, 1]`.
pub(crate) fn depth_of(opacity: f32) -> f32 {
    (-(1.0 - opacity).log2()).clamp(0.0, OPAQUE)
}

/// Optical depths of nodes' children by direction. `start` is where a node's row starts.
pub(crate) trait Table: Sync {
    /// What a ray looks at.
    type View: Copy + Default + Send;

    /// For a direction and the cell it is taken to be in.
    fn view(&self, cell: u32, direction: Vec3) -> Self::View;

    /// Bits; finite; of no meaning in slots that may not end rays.
    fn depths(&self, view: Self::View, start: u32) -> [f32; WIDTH];
}

/// A table with a value for each cell, while it is made.
pub(crate) trait Cells: Table + Sized {
    /// With rows of `slots` in all.
    fn new(cells: usize, slots: usize) -> Self;

    fn cells(&self) -> usize;

    /// Writes an opacity in `[0, 1]`; `random` in `[0, 1)` decides about rounding.
    fn set(&mut self, cell: usize, start: u32, slot: usize, opacity: f32, random: f32);

    /// Bits.
    fn depth(&self, cell: usize, start: u32, slot: usize) -> f32;

    fn bytes(&self) -> usize;
}

/// What a cube map holds for one child in one direction.
pub(crate) trait Element: Copy + Default + Send + Sync {
    fn encode(opacity: f32) -> Self;
    /// Optical depth, bits.
    fn depth(self) -> f32;
}

impl Element for f32 {
    fn encode(opacity: f32) -> Self {
        depth_of(opacity)
    }

    #[inline(always)]
    fn depth(self) -> f32 {
        self
    }
}

/// Largest optical depth that bytes can say, in bits; a sum beyond 10 counts as opaque.
const MAX_BYTE_DEPTH: f32 = 12.0;

impl Element for u8 {
    fn encode(opacity: f32) -> Self {
        (255.0 * (depth_of(opacity) / MAX_BYTE_DEPTH).sqrt()).round() as Self
    }

    #[inline(always)]
    fn depth(self) -> f32 {
        let x = f32::from(self);
        x * x * (MAX_BYTE_DEPTH / (255.0 * 255.0))
    }
}

/// A cube map of elements.
#[derive(Clone, Debug)]
pub(crate) struct Cube<E> {
    /// 1 if nothing depends on direction.
    cells: usize,
    /// Slots of a cell.
    slots: usize,
    /// Cell by cell, and room for a whole row at the end.
    elements: Vec<E>,
}

impl<E: Element> Table for Cube<E> {
    type View = usize;

    #[inline(always)]
    fn view(&self, cell: u32, _: Vec3) -> usize {
        if self.cells == 1 { 0 } else { cell as usize * self.slots }
    }

    #[inline(always)]
    fn depths(&self, view: usize, start: u32) -> [f32; WIDTH] {
        // A loop: closures would not be compiled with the caller's instructions.
        let row = &self.elements[view + start as usize..][..WIDTH];
        let mut depths = [0.0; WIDTH];
        for i in 0..WIDTH {
            depths[i] = row[i].depth();
        }
        depths
    }
}

impl<E: Element> Cells for Cube<E> {
    fn new(cells: usize, slots: usize) -> Self {
        Self { cells, slots, elements: vec![E::default(); cells * slots + WIDTH] }
    }

    fn cells(&self) -> usize {
        self.cells
    }

    fn set(&mut self, cell: usize, start: u32, slot: usize, opacity: f32, _: f32) {
        self.elements[cell * self.slots + start as usize + slot] = E::encode(opacity);
    }

    #[inline(always)]
    fn depth(&self, cell: usize, start: u32, slot: usize) -> f32 {
        self.elements[cell * self.slots + start as usize + slot].depth()
    }

    fn bytes(&self) -> usize {
        size_of_val(&self.elements[..])
    }
}

/// A cube map of half bytes, rounded at random so that means stay: rounding is far below the noise of lines.
#[derive(Clone, Debug)]
pub(crate) struct Halves {
    cells: usize,
    /// Bytes of a cell; rows start at even slots.
    bytes: usize,
    halves: Vec<u8>,
}

/// Depth of half byte 1, bits; that of others grows by squares.
const DEPTH_OF_HALF_BYTE_1: f32 = 8.0 / 196.0;

/// Optical depth of a half byte, bits: squares up to 8, and then opaque.
#[inline(always)]
fn half_depth(x: f32) -> f32 {
    // Without a selection, which would become a branch: 15 is 1 more than 14.
    let last = if x > 14.0 { x - 14.0 } else { 0.0 };
    x * x * DEPTH_OF_HALF_BYTE_1 + last * OPAQUE
}

impl Halves {
    /// The half byte of an opacity.
    fn encode(opacity: f32, random: f32) -> u8 {
        let passed = |code: u8| (-half_depth(code.into())).exp2();
        let above = (1..15).find(|&code| 1.0 - passed(code) >= opacity).unwrap_or(15);
        let (more, less) = (passed(above - 1), passed(above));
        above - u8::from(random * (more - less) >= more - (1.0 - opacity))
    }
}

impl Table for Halves {
    type View = usize;

    #[inline(always)]
    fn view(&self, cell: u32, _: Vec3) -> usize {
        cell as usize * self.bytes
    }

    #[inline(always)]
    fn depths(&self, view: usize, start: u32) -> [f32; WIDTH] {
        let row = &self.halves[view + (start / 2) as usize..][..WIDTH / 2];
        let bits = u32::from_le_bytes([row[0], row[1], row[2], row[3]]);
        let mut depths = [0.0; WIDTH];
        for (i, depth) in depths.iter_mut().enumerate() {
            *depth = half_depth((bits >> (4 * i) & 15) as i32 as f32);
        }
        depths
    }
}

impl Cells for Halves {
    fn new(cells: usize, slots: usize) -> Self {
        let bytes = slots.div_ceil(2);
        Self { cells, bytes, halves: vec![0; cells * bytes + WIDTH / 2] }
    }

    fn cells(&self) -> usize {
        self.cells
    }

    fn set(&mut self, cell: usize, start: u32, slot: usize, opacity: f32, random: f32) {
        let at = start as usize + slot;
        let (half, shift) = (&mut self.halves[cell * self.bytes + at / 2], at % 2 * 4);
        *half = *half & !(15 << shift) | Self::encode(opacity, random) << shift;
    }

    #[inline(always)]
    fn depth(&self, cell: usize, start: u32, slot: usize) -> f32 {
        let at = start as usize + slot;
        half_depth((self.halves[cell * self.bytes + at / 2] >> (at % 2 * 4) & 15).into())
    }

    fn bytes(&self) -> usize {
        self.halves.len()
    }
}

/// Coefficients of even real spherical harmonics of the opacity, `N` of them: 6 or 15.
#[derive(Clone, Debug)]
pub(crate) struct Harmonics<const N: usize> {
    /// Slots of a coefficient.
    slots: usize,
    /// Coefficient by coefficient, and room for a whole row at the end.
    coefficients: Vec<i8>,
}

/// Largest coefficient that a byte can say: that of opacity 1 everywhere is `2 sqrt(pi)`.
const MAX_BYTE_COEFFICIENT: f32 = 3.6;

/// Real spherical harmonics of bands 0, 2 and 4 at a unit vector.
pub(crate) fn basis(d: Vec3) -> [f32; 15] {
    let Vec3 { x, y, z } = d;
    let (xx, yy, zz) = (x * x, y * y, z * z);
    [
        0.282_094_8,
        1.092_548_4 * x * y,
        1.092_548_4 * y * z,
        0.315_391_57 * (3.0 * zz - 1.0),
        1.092_548_4 * x * z,
        0.546_274_2 * (xx - yy),
        2.503_343 * x * y * (xx - yy),
        1.770_130_8 * y * z * (3.0 * xx - yy),
        0.946_174_7 * x * y * (7.0 * zz - 1.0),
        0.669_046_5 * y * z * (7.0 * zz - 3.0),
        0.105_785_55 * (35.0 * zz * zz - 30.0 * zz + 3.0),
        0.669_046_5 * x * z * (7.0 * zz - 3.0),
        0.473_087_35 * (xx - yy) * (7.0 * zz - 1.0),
        1.770_130_8 * x * z * (xx - 3.0 * yy),
        0.625_835_7 * (xx * (xx - 3.0 * yy) - yy * (3.0 * xx - yy)),
    ]
}

/// `N` coefficients, made by default.
#[derive(Clone, Copy)]
pub(crate) struct Weights<const N: usize>([f32; N]);

impl<const N: usize> Default for Weights<N> {
    fn default() -> Self {
        Self([0.0; N])
    }
}

impl<const N: usize> Harmonics<N> {
    /// Projects the opacities of a cube map.
    pub(crate) fn project(cube: &Cube<f32>, directions: Directions) -> Self {
        // The constant of a harmonic is restored by the sum of weights, so that opacity 1 stays 1.
        let weights: Vec<(f32, [f32; 15])> =
            (0..cube.cells).map(|c| (directions.weight(c), basis(directions.center(c)))).collect();
        let total: f32 = weights.iter().map(|w| w.0).sum();
        let scale = 4.0 * std::f32::consts::PI / total;
        let mut coefficients = vec![0i8; N * cube.slots + WIDTH];
        for slot in 0..cube.slots {
            let mut sums = [0f32; N];
            for (cell, (weight, basis)) in weights.iter().enumerate() {
                let opacity = 1.0 - (-cube.depth(cell, 0, slot)).exp2();
                sums.iter_mut().zip(basis).for_each(|(sum, y)| *sum += weight * y * opacity * scale);
            }
            for (k, sum) in sums.into_iter().enumerate() {
                let coded = (sum * (127.0 / MAX_BYTE_COEFFICIENT)).round().clamp(-127.0, 127.0);
                coefficients[k * cube.slots + slot] = coded as i8;
            }
        }
        Self { slots: cube.slots, coefficients }
    }

    pub(crate) fn bytes(&self) -> usize {
        self.coefficients.len()
    }
}

impl<const N: usize> Table for Harmonics<N> {
    type View = Weights<N>;

    #[inline(always)]
    fn view(&self, _: u32, direction: Vec3) -> Weights<N> {
        let basis = basis(direction.normalize_or_zero());
        Weights(std::array::from_fn(|i| basis[i] * (MAX_BYTE_COEFFICIENT / 127.0)))
    }

    #[inline(always)]
    fn depths(&self, view: Weights<N>, start: u32) -> [f32; WIDTH] {
        let mut opacity = [0f32; WIDTH];
        for (k, weight) in view.0.into_iter().enumerate() {
            let row = &self.coefficients[k * self.slots + start as usize..][..WIDTH];
            for i in 0..WIDTH {
                opacity[i] += weight * f32::from(row[i]);
            }
        }
        opacity.map(|alpha| depth_of(alpha.clamp(0.0, 1.0 - 1.0 / 4096.0)))
    }
}

/// Means over directions, weighted by solid angle.
pub(crate) fn averages(cube: &Cube<f32>, directions: Directions) -> Cube<u8> {
    let weights: Vec<f32> = (0..directions.cells()).map(|c| directions.weight(c)).collect();
    let total: f32 = weights.iter().sum();
    let mut table = Cube::<u8>::new(1, cube.slots);
    for slot in 0..cube.slots {
        let blocked = |(cell, weight): (usize, &f32)| weight * (1.0 - (-cube.depth(cell, 0, slot)).exp2());
        let sum: f32 = weights.iter().enumerate().map(blocked).sum();
        table.set(0, 0, slot, (sum / total).min(1.0), 0.0);
    }
    table
}

/// Any of the forms.
#[derive(Clone, Debug)]
pub(crate) enum Stored {
    F32(Cube<f32>),
    U8(Cube<u8>),
    U4(Halves),
    Harmonics2(Harmonics<6>),
    Harmonics4(Harmonics<15>),
}

impl Stored {
    pub(crate) fn bytes(&self) -> usize {
        match self {
            Self::F32(table) => table.bytes(),
            Self::U8(table) => table.bytes(),
            Self::U4(table) => table.bytes(),
            Self::Harmonics2(table) => table.bytes(),
            Self::Harmonics4(table) => table.bytes(),
        }
    }
}

/// Runs `$body` with `$table` bound to whatever `$stored` holds.
macro_rules! with_table {
    ($stored:expr, $table:ident => $body:expr) => {
        match $stored {
            $crate::prefilter::storage::Stored::F32($table) => $body,
            $crate::prefilter::storage::Stored::U8($table) => $body,
            $crate::prefilter::storage::Stored::U4($table) => $body,
            $crate::prefilter::storage::Stored::Harmonics2($table) => $body,
            $crate::prefilter::storage::Stored::Harmonics4($table) => $body,
        }
    };
}
pub(crate) use with_table;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_keep_opacity() {
        for i in 0..=1000 {
            let alpha = i as f32 / 1000.0;
            let back = 1.0 - (-u8::encode(alpha).depth()).exp2();
            assert!((back - alpha).abs() < 0.005, "{alpha} {back}");
        }
        assert_eq!(u8::encode(0.0).depth(), 0.0);
        assert!(u8::encode(1.0).depth() > 10.0);
    }

    #[test]
    fn half_bytes_keep_the_mean() {
        let mut table = Halves::new(2, 3);
        for i in 0..=200 {
            let alpha = i as f32 / 200.0;
            let mut sum = 0.0;
            for k in 0..500 {
                table.set(1, 0, 2, alpha, k as f32 / 500.0);
                let depth = table.depth(1, 0, 2);
                assert_eq!(table.depths(table.view(1, Vec3::X), 0)[2], depth);
                let back = 1.0 - (-depth).exp2();
                assert!((back - alpha).abs() < 0.16, "{alpha} {back}");
                sum += back / 500.0;
            }
            assert!((sum - alpha).abs() < 0.002, "{alpha} {sum}");
        }
        assert_eq!(Halves::encode(0.0, 0.0), 0);
        assert_eq!(Halves::encode(1.0, 0.999), 15);
        assert_eq!(table.depths(table.view(1, Vec3::X), 0)[..2], [0.0; 2]);
    }

    #[test]
    fn harmonics_are_orthonormal() {
        let directions = Directions::new(12).unwrap();
        let mut products = [[0f32; 15]; 15];
        for cell in 0..directions.cells() {
            let y = basis(directions.center(cell));
            for (row, a) in products.iter_mut().zip(y) {
                for (sum, b) in row.iter_mut().zip(y) {
                    *sum += 2.0 * directions.weight(cell) * a * b;
                }
            }
        }
        for (i, row) in products.iter().enumerate() {
            for (j, &product) in row.iter().enumerate() {
                let expected = f32::from(u8::from(i == j));
                assert!((product - expected).abs() < 0.03, "{i} {j}: {product}");
            }
        }
    }

    #[test]
    fn harmonics_follow_a_cube() {
        let directions = Directions::new(6).unwrap();
        let mut cube = Cube::<f32>::new(directions.cells(), 4);
        let truth = |d: Vec3| 0.2 + 0.6 * d.y * d.y;
        for cell in 0..directions.cells() {
            cube.set(cell, 0, 3, truth(directions.center(cell)), 0.0);
        }
        let (two, four) =
            (Harmonics::<6>::project(&cube, directions), Harmonics::<15>::project(&cube, directions));
        for cell in 0..directions.cells() {
            let d = directions.center(cell);
            for depth in [two.depths(two.view(0, d), 0)[3], four.depths(four.view(0, d), 0)[3]] {
                assert!((1.0 - (-depth).exp2() - truth(d)).abs() < 0.03);
            }
        }
    }
}
