//! Points of bicubic patches, many at a time, by the best instructions of the machine.
//!
//! Every back end does the operations of [`scalar`] in the same order, none fused, so that a point has the same bits whichever
//! grid asks for it and wherever it runs.

mod scalar;

use umbrage_geom::{
    glam::Vec3,
    simd::{BackEnd, Instructions, Job},
};

/// Columns evaluated together.
pub(crate) const LANES: usize = 8;

/// Their coordinates, x, y, z of each in turn, as points lie in memory.
const NUMBERS: usize = 3 * LANES;

/// Fewer columns than this are not worth the room of [`LANES`].
const MIN_LANE_COLUMNS: usize = 4;

/// Weights of four control points for up to [`LANES`] columns, three times each.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Columns([[f32; NUMBERS]; 4]);

impl Columns {
    /// No columns.
    pub(crate) const NONE: Self = Self([[0.0; NUMBERS]; 4]);

    pub(crate) fn new(weights: &[[f32; 4]]) -> Self {
        let mut columns = Self::NONE;
        for (lane, weights) in weights.iter().take(LANES).enumerate() {
            for (row, &w) in columns.0.iter_mut().zip(weights) {
                row[3 * lane..3 * lane + 3].fill(w);
            }
        }
        columns
    }
}

/// Evaluation of rows on some instructions.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Kernel(Instructions);

impl Kernel {
    /// That of a back end, or the portable one where the processor lacks it.
    pub(crate) fn new(back_end: BackEnd) -> Self {
        Self(back_end.instructions())
    }

    /// A row of points: `curve` holds the four control points of the row's curve, `weights` those of its columns, also given
    /// as `columns`.
    #[inline]
    pub(crate) fn row(self, curve: &[Vec3; 4], weights: &[[f32; 4]], columns: &[Columns], row: &mut [Vec3]) {
        match self.0 {
            Instructions::Scalar => scalar::row(curve, weights, row),
            _ if row.len() < MIN_LANE_COLUMNS => scalar::row(curve, weights, row),
            instructions => instructions.run(Row { curve, columns, row }),
        }
    }
}

/// [`Kernel::row`] in lanes.
struct Row<'a> {
    curve: &'a [Vec3; 4],
    columns: &'a [Columns],
    row: &'a mut [Vec3],
}

impl Job for Row<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        row_in_lanes(self.curve, self.columns, self.row);
    }
}

#[inline(always)]
fn row_in_lanes(curve: &[Vec3; 4], columns: &[Columns], row: &mut [Vec3]) {
    let mut control = [[0f32; NUMBERS]; 4];
    for (numbers, p) in control.iter_mut().zip(curve) {
        for lane in 0..LANES {
            numbers[3 * lane] = p.x;
            numbers[3 * lane + 1] = p.y;
            numbers[3 * lane + 2] = p.z;
        }
    }
    let [a, b, c, d] = &control;
    for (columns, row) in columns.iter().zip(row.chunks_mut(LANES)) {
        let w = &columns.0;
        let mut numbers = [0f32; NUMBERS];
        for i in 0..NUMBERS {
            numbers[i] = ((a[i] * w[0][i] + b[i] * w[1][i]) + c[i] * w[2][i]) + d[i] * w[3][i];
        }
        if let Ok(row) = <&mut [Vec3; LANES]>::try_from(&mut *row) {
            // Of fixed length, so that it becomes a copy.
            for i in 0..LANES {
                row[i] = Vec3::new(numbers[3 * i], numbers[3 * i + 1], numbers[3 * i + 2]);
            }
        } else {
            for (p, n) in row.iter_mut().zip(numbers.chunks_exact(3)) {
                *p = Vec3::new(n[0], n[1], n[2]);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Bicubic, patch::weights};
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(200))]

        /// Every back end and any number of columns give the bits of one point after the other.
        #[test]
        fn back_ends_agree(
            points in prop::collection::vec(prop::array::uniform3(-1e3f32..1e3), 16), count in 1usize..70,
            scale in prop::sample::select(vec![1f32, 1e-20, 1e18]), v in 0f64..=1.0, first in 0f64..0.5,
        ) {
            let control = |i: usize, j: usize| Vec3::from(points[4 * j + i]) * scale;
            let patch = Bicubic { points: [0, 1, 2, 3].map(|j| [0, 1, 2, 3].map(|i| control(i, j))) };
            let at: Vec<f64> = (0..count).map(|i| first + 0.5 * i as f64 / count as f64).collect();
            let all: Vec<[f32; 4]> = at.iter().map(|&u| weights(u)).collect();
            let columns: Vec<Columns> = all.chunks(LANES).map(Columns::new).collect();
            let expected: Vec<_> = at.iter().map(|&u| patch.position(u, v).to_array().map(f32::to_bits)).collect();
            for back_end in BackEnd::ALL {
                let mut row = vec![Vec3::NAN; count];
                Kernel::new(back_end).row(&patch.curve(weights(v)), &all, &columns, &mut row);
                let bits: Vec<_> = row.iter().map(|p| p.to_array().map(f32::to_bits)).collect();
                prop_assert_eq!(&bits, &expected, "{:?}", back_end);
            }
        }
    }
}
