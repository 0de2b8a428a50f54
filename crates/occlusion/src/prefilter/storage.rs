//! How opacities lie in memory (`[Lacewell08]`, section 4.4), and what a ray reads of them: optical depths of eight children.

use super::{Directions, kernel::Kernel, wide::WIDTH};
use umbrage_geom::glam::Vec3;

/// Largest optical depth that bytes can say, in bits; a sum beyond 10 counts as opaque.
const DEEPEST: f32 = 12.0;

/// Optical depth, `-log2(1 - opacity)`, of something that blocks everything; finite so that 0 times it is 0.
const OPAQUE: f32 = 64.0;

/// Optical depth in bits of an opacity in `[0, 1]`.
pub(crate) fn depth_of(opacity: f32) -> f32 {
    (-(1.0 - opacity).log2()).clamp(0.0, OPAQUE)
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

impl Element for u8 {
    fn encode(opacity: f32) -> Self {
        (255.0 * (depth_of(opacity) / DEEPEST).sqrt()).round() as Self
    }

    #[inline(always)]
    fn depth(self) -> f32 {
        let x = f32::from(self);
        x * x * (DEEPEST / (255.0 * 255.0))
    }
}

/// Optical depths of nodes' children by direction.
pub(crate) trait Table: Sync {
    /// What a ray looks at.
    type View: Copy + Send;

    /// For a direction and the cell it is taken to be in.
    fn view(&self, cell: u32, direction: Vec3) -> Self::View;

    /// Bits; finite.
    fn depths(&self, view: Self::View, node: usize) -> [f32; WIDTH];

    /// Asks for what [`Self::depths`] reads.
    fn prefetch<K: Kernel>(&self, kernel: K, view: Self::View, node: usize);
}

/// One row for each cell and node, cells outermost: a ray looks at one cell only.
#[derive(Clone, Debug)]
pub(crate) struct Cube<E> {
    nodes: usize,
    /// 1 if nothing depends on direction.
    cells: usize,
    rows: Vec<[E; WIDTH]>,
}

impl<E: Element> Cube<E> {
    pub(crate) fn new(cells: usize, nodes: usize) -> Self {
        Self { nodes, cells, rows: vec![[E::default(); WIDTH]; cells * nodes] }
    }

    pub(crate) fn set(&mut self, cell: usize, node: usize, row: [E; WIDTH]) {
        self.rows[cell * self.nodes + node] = row;
    }

    pub(crate) fn get(&self, cell: usize, node: usize) -> [E; WIDTH] {
        self.rows[cell * self.nodes + node]
    }

    pub(crate) fn cells(&self) -> usize {
        self.cells
    }

    pub(crate) fn bytes(&self) -> usize {
        size_of_val(&self.rows[..])
    }
}

impl<E: Element> Table for Cube<E> {
    type View = usize;

    #[inline(always)]
    fn view(&self, cell: u32, _: Vec3) -> usize {
        if self.cells == 1 { 0 } else { cell as usize * self.nodes }
    }

    #[inline(always)]
    fn depths(&self, view: usize, node: usize) -> [f32; WIDTH] {
        // A loop: closures would not be compiled with the caller's instructions.
        let row = &self.rows[view + node];
        let mut depths = [0.0; WIDTH];
        for i in 0..WIDTH {
            depths[i] = row[i].depth();
        }
        depths
    }

    #[inline(always)]
    fn prefetch<K: Kernel>(&self, kernel: K, view: usize, node: usize) {
        kernel.prefetch(&self.rows, view + node);
    }
}

/// Coefficients of even real spherical harmonics of the opacity, `N` of them: 6 or 15.
#[derive(Clone, Debug)]
pub(crate) struct Harmonics<const N: usize> {
    rows: Vec<[[i8; WIDTH]; N]>,
}

/// Largest coefficient that a byte can say: that of opacity 1 everywhere is `2 sqrt(pi)`.
const LARGEST: f32 = 3.6;

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

impl<const N: usize> Harmonics<N> {
    /// Projects the opacities of a cube map.
    pub(crate) fn project(cube: &Cube<f32>, directions: Directions) -> Self {
        // The constant of a harmonic is restored by the sum of weights, so that opacity 1 stays 1.
        let weights: Vec<(f32, [f32; 15])> =
            (0..cube.cells).map(|c| (directions.weight(c), basis(directions.center(c)))).collect();
        let total: f32 = weights.iter().map(|w| w.0).sum();
        let scale = 4.0 * std::f32::consts::PI / total;
        let mut rows = vec![[[0i8; WIDTH]; N]; cube.nodes];
        for (node, row) in rows.iter_mut().enumerate() {
            let mut sums = [[0f32; WIDTH]; N];
            for (cell, (weight, basis)) in weights.iter().enumerate() {
                let opacity = cube.get(cell, node).map(|depth| 1.0 - (-depth).exp2());
                for (sum, value) in sums.iter_mut().zip(basis) {
                    for (sum, alpha) in sum.iter_mut().zip(opacity) {
                        *sum += weight * value * alpha * scale;
                    }
                }
            }
            *row =
                sums.map(|lanes| lanes.map(|c| (c * (127.0 / LARGEST)).round().clamp(-127.0, 127.0) as i8));
        }
        Self { rows }
    }

    pub(crate) fn bytes(&self) -> usize {
        size_of_val(&self.rows[..])
    }
}

impl<const N: usize> Table for Harmonics<N> {
    type View = [f32; N];

    #[inline(always)]
    fn view(&self, _: u32, direction: Vec3) -> [f32; N] {
        let basis = basis(direction.normalize_or_zero());
        std::array::from_fn(|i| basis[i] * (LARGEST / 127.0))
    }

    #[inline(always)]
    fn depths(&self, view: [f32; N], node: usize) -> [f32; WIDTH] {
        let mut opacity = [0f32; WIDTH];
        for (row, weight) in self.rows[node].iter().zip(view) {
            for (sum, &c) in opacity.iter_mut().zip(row) {
                *sum += weight * f32::from(c);
            }
        }
        opacity.map(|alpha| depth_of(alpha.clamp(0.0, 1.0 - 1.0 / 4096.0)))
    }

    #[inline(always)]
    fn prefetch<K: Kernel>(&self, kernel: K, _: [f32; N], node: usize) {
        kernel.prefetch(&self.rows, node);
    }
}

/// Any of the forms.
#[derive(Clone, Debug)]
pub(crate) enum Stored {
    F32(Cube<f32>),
    U8(Cube<u8>),
    Harmonics2(Harmonics<6>),
    Harmonics4(Harmonics<15>),
}

impl Stored {
    pub(crate) fn bytes(&self) -> usize {
        match self {
            Self::F32(table) => table.bytes(),
            Self::U8(table) => table.bytes(),
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
        let mut cube = Cube::<f32>::new(directions.cells(), 1);
        let truth = |d: Vec3| 0.2 + 0.6 * d.y * d.y;
        for cell in 0..directions.cells() {
            cube.set(cell, 0, [depth_of(truth(directions.center(cell))); WIDTH]);
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
