//! Masks of half spaces through the receiver: the surface of the plane table, kept apart and finer.
//!
//! Three of a triangle's four lookups are planes through the receiver and an edge. In `[Laine10]` they share one cube with all
//! other planes; a cube map of their own can be several times as fine in the same memory, and leaves the cube's inside
//! coarse, where less depends on it.

use super::{
    lanes::{F8, U8, V8},
    plane::{Rays, chord},
};
use crate::BackEnd;
use umbrage_geom::{glam::Vec3, simd::Job};

/// Masks of the rays on the positive side of a plane through the receiver, by the plane's normal: six faces of
/// `resolution^2` cells. Centres of outermost cells lie on the edges of the cube.
#[derive(Clone, Debug)]
pub(crate) struct EdgeTable<const W: usize> {
    resolution: u32,
    cells: Box<[[u64; W]]>,
}

impl<const W: usize> EdgeTable<W> {
    /// Every cell has the mask of its centre. So opposite normals have complementary masks, and neighbouring triangles
    /// neither leak nor overlap along an edge.
    pub(crate) fn nearest(directions: &[Vec3], resolution: u32, back_end: BackEnd) -> Self {
        Self::build(directions, resolution, back_end, |_| 0.0)
    }

    /// Every cell has all rays that are on the positive side for any normal in it.
    pub(crate) fn conservative(directions: &[Vec3], resolution: u32, back_end: BackEnd) -> Self {
        // A normal `q` with largest component 1 is within `offset` of its cell's centre `c`, so the sine of their angle is
        // at most `offset / |c|`, and heights of unit directions differ by at most the chord. A little for rounding.
        let offset = 2f32.sqrt() / (resolution - 1) as f32;
        Self::build(directions, resolution, back_end, |center| {
            chord(offset / center.length() * 1.0001) + 4e-6
        })
    }

    fn build(
        directions: &[Vec3],
        resolution: u32,
        back_end: BackEnd,
        slack: impl Fn(Vec3) -> f32 + Sync,
    ) -> Self {
        let rays = Rays::<W>::new(directions);
        let side = resolution as usize;
        let mut cells = vec![[0; W]; 6 * side * side].into_boxed_slice();
        let row = |(row, cells): (usize, &mut [[u64; W]])| {
            back_end.run(Row { rays: &rays, side, row, cells, slack: &slack });
        };
        #[cfg(feature = "rayon")]
        {
            use rayon::prelude::*;
            cells.par_chunks_mut(side).enumerate().for_each(row);
        }
        #[cfg(not(feature = "rayon"))]
        cells.chunks_mut(side).enumerate().for_each(row);
        Self { resolution, cells }
    }

    pub(crate) fn bytes(&self) -> usize {
        size_of_val(&self.cells[..])
    }

    /// Cells of eight normals of any length but 0. What is not finite gets any cell.
    #[inline(always)]
    pub(crate) fn cells(&self, normals: V8) -> [u32; 8] {
        let V8 { x, y, z } = normals;
        let V8 { x: ax, y: ay, z: az } = normals.abs();
        // Faces 0 and 1 look along x, 2 and 3 along y, 4 and 5 along z.
        let y_first = az.le(ay);
        let x_first = ay.max(az).le(ax);
        let main = x.select(x_first, y.select(y_first, z));
        let u = y.select(x_first, z.select(y_first, x));
        let v = z.select(x_first, x.select(y_first, y));
        let mut face = [0; 8];
        for (i, face) in face.iter_mut().enumerate() {
            let axis = if x_first >> i & 1 == 1 {
                0
            } else if y_first >> i & 1 == 1 {
                2
            } else {
                4
            };
            *face = axis + (main.0[i].to_bits() >> 31);
        }
        let half = F8::splat(0.5 * (self.resolution - 1) as f32);
        let scale = half / main.abs();
        let row = (v * scale + half).nearest().plus(self.resolution, U8(face));
        (u * scale + half).nearest().plus(self.resolution, row).0
    }

    /// The mask of a cell that [`Self::cells`] gave.
    #[inline(always)]
    pub(crate) fn mask(&self, cell: u32) -> &[u64; W] {
        &self.cells[(cell as usize).min(self.cells.len() - 1)]
    }
}

/// Fills one row of a face.
struct Row<'a, const W: usize, F> {
    rays: &'a Rays<W>,
    side: usize,
    row: usize,
    cells: &'a mut [[u64; W]],
    slack: &'a F,
}

impl<const W: usize, F: Fn(Vec3) -> f32> Job for Row<'_, W, F> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let step = 2.0 / (self.side - 1) as f32;
        let coordinate = |i: usize| i as f32 * step - 1.0;
        let (face, v) = (self.row / self.side, coordinate(self.row % self.side));
        let main = if face % 2 == 0 { 1.0 } else { -1.0 };
        for (i, cell) in self.cells.iter_mut().enumerate() {
            let u = coordinate(i);
            let center = match face / 2 {
                0 => Vec3::new(main, u, v),
                1 => Vec3::new(v, main, u),
                _ => Vec3::new(u, v, main),
            };
            *cell = self.rays.beyond(center.normalize(), -(self.slack)(center));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Pattern, PatternOptions};
    use proptest::prelude::*;

    fn lookup(table: &EdgeTable<2>, n: Vec3) -> u128 {
        let [low, high] = *table.mask(table.cells(V8::splat(n.to_array()))[3]);
        u128::from(low) | u128::from(high) << 64
    }

    #[test]
    fn lookups_are_exact_up_to_the_cell() {
        let directions = Pattern::new(&PatternOptions::default()).unwrap().directions(0).to_vec();
        let table = EdgeTable::<2>::nearest(&directions, 65, BackEnd::best());
        let rims = EdgeTable::<2>::conservative(&directions, 12, BackEnd::best());
        let mut runner = proptest::test_runner::TestRunner::deterministic();
        let normals = prop::array::uniform3(-1f32..1.0).prop_map(Vec3::from);
        runner
            .run(&(normals, -10i32..10), |(n, power)| {
                prop_assume!(n.length() > 0.01);
                let n = n * 10f32.powi(power);
                let (mask, opposite, rim) = (lookup(&table, n), lookup(&table, -n), lookup(&rims, n));
                // Rays in the plane itself belong to both sides.
                prop_assert!((mask ^ opposite).count_zeros() <= 2 && mask | opposite == !0);
                for (i, d) in directions.iter().enumerate() {
                    let height = n.normalize().dot(*d);
                    if height.abs() > 2f32.sqrt() / 64.0 {
                        prop_assert_eq!(mask >> i & 1 == 1, height > 0.0);
                    }
                    prop_assert!(height < 0.0 || rim >> i & 1 == 1);
                    prop_assert!(height > -0.3 || rim >> i & 1 == 0);
                }
                Ok(())
            })
            .unwrap();
        for n in [Vec3::ZERO, Vec3::NAN, Vec3::new(f32::INFINITY, 1.0, f32::INFINITY), Vec3::MAX] {
            lookup(&table, n);
        }
    }

    #[test]
    fn back_ends_fill_the_same_table() {
        let directions = Pattern::new(&PatternOptions::default()).unwrap().directions(0).to_vec();
        let tables = BackEnd::ALL.map(|b| EdgeTable::<2>::conservative(&directions, 9, b));
        assert!(tables.iter().all(|t| t.cells == tables[0].cells));
    }
}
