//! The plane table ([Laine10], section 3.1): which rays cross a plane, for every plane at once.
//!
//! Here: how a plane finds its cell, filling the cells, bounds on what rounding to a cell changes. Not here: a finer form of
//! the table's surface (`edge.rs`), which planes a triangle or a node asks for (`triangle_mask.rs`, `node_mask.rs`).

use crate::kernel::{BackEnd, Job};
use umbrage_geom::glam::Vec3;

/// Eight numbers, one a lane.
pub(crate) type F8 = [f32; 8];

/// Coordinates of eight vectors.
pub(crate) type V8 = [F8; 3];

/// Share of the table's radius that distances take, the `7/8` of the paper.
const DEPTH: f32 = 0.875;

/// Masks of the rays whose end lies on the far side of a plane, for planes `n . x = d` with unit `n`, `0 <= d <= 1` (in
/// radii).
///
/// A cube of `resolution^3` cells. The plane's coordinates in it are `n * (1 - 7/8 d) / max|n_i|`: planes through the
/// receiver, as of edges of triangles, lie exactly on the cube's surface, where the angular resolution is best; the centre
/// is unused. Cells stand for the plane at their centre, and the outermost centres lie on the surface itself. So two planes
/// that differ in sign only have complementary masks, and neighbouring triangles neither leak nor overlap along an edge.
#[derive(Clone, Debug)]
pub(crate) struct PlaneTable<const W: usize> {
    resolution: u32,
    cells: Box<[[u64; W]]>,
}

impl<const W: usize> PlaneTable<W> {
    /// The table for rays that end at `ends` (in radii), at most `64 * W`.
    pub(crate) fn build(ends: &[Vec3], resolution: u32, back_end: BackEnd) -> Self {
        let rays = Rays::<W>::new(ends);
        let side = resolution as usize;
        let mut cells = vec![[0; W]; side * side * side].into_boxed_slice();
        let layer =
            |(z, layer): (usize, &mut [[u64; W]])| back_end.run(Layer { rays: &rays, side, z, layer });
        #[cfg(feature = "rayon")]
        {
            use rayon::prelude::*;
            cells.par_chunks_mut(side * side).enumerate().for_each(layer);
        }
        #[cfg(not(feature = "rayon"))]
        cells.chunks_mut(side * side).enumerate().for_each(layer);
        Self { resolution, cells }
    }

    pub(crate) fn bytes(&self) -> usize {
        size_of_val(&self.cells[..])
    }

    /// Largest difference between a coordinate of a plane and of its cell's centre.
    pub(crate) fn half_cell(&self) -> f32 {
        1.0 / (self.resolution - 1) as f32
    }

    /// Cells of eight planes: normals of any length but 0, distances in radii. What is not finite gets any cell.
    #[inline(always)]
    pub(crate) fn cells(&self, normals: &V8, distances: &F8) -> [u32; 8] {
        let half = 0.5 * (self.resolution - 1) as f32;
        std::array::from_fn(|i| {
            let n = [normals[0][i], normals[1][i], normals[2][i]];
            let largest = n[0].abs().max(n[1].abs()).max(n[2].abs());
            let scale = half * (1.0 - DEPTH * distances[i]) / largest;
            let [x, y, z] = n.map(|x| nearest(x * scale + half));
            x + self.resolution * (y + self.resolution * z)
        })
    }

    /// The mask of a cell that [`Self::cells`] gave.
    #[inline(always)]
    pub(crate) fn mask(&self, cell: u32) -> &[u64; W] {
        &self.cells[(cell as usize).min(self.cells.len() - 1)]
    }
}

/// `x` rounded to the nearest integer, for `x` in `[0, 2^22]`.
#[inline(always)]
pub(super) fn nearest(x: f32) -> u32 {
    // In numbers from 2^23 on, the last bit of the significand counts ones.
    const ONES: f32 = (1u32 << 23) as f32;
    (x + ONES).to_bits() & 0x7f_ffff
}

/// Ends of rays by coordinate. Bits without a ray hold NaN, which no comparison lets through.
pub(super) struct Rays<const W: usize> {
    ends: [Vec<F8>; 3],
}

impl<const W: usize> Rays<W> {
    pub(super) fn new(ends: &[Vec3]) -> Self {
        let rows = |axis: usize| {
            (0..W * 8).map(move |group| {
                std::array::from_fn(|i| ends.get(group * 8 + i).map_or(f32::NAN, |end| end[axis]))
            })
        };
        Self { ends: [0, 1, 2].map(|axis| rows(axis).collect()) }
    }

    /// Bits of the rays whose end has `normal . end >= distance`.
    #[inline(always)]
    pub(super) fn beyond(&self, normal: Vec3, distance: f32) -> [u64; W] {
        let [x, y, z] = [0, 1, 2].map(|axis| &self.ends[axis][..W * 8]);
        std::array::from_fn(|word| {
            (0..8).fold(0, |bits, byte| {
                let g = word * 8 + byte;
                let mask = (0..8).fold(0, |mask, i| {
                    let dot = normal.x * x[g][i] + normal.y * y[g][i] + normal.z * z[g][i];
                    mask | u64::from(dot >= distance) << i
                });
                bits | mask << (8 * byte)
            })
        })
    }
}

/// Fills one layer of a table.
struct Layer<'a, const W: usize> {
    rays: &'a Rays<W>,
    side: usize,
    z: usize,
    layer: &'a mut [[u64; W]],
}

impl<const W: usize> Job for Layer<'_, W> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let step = 2.0 / (self.side - 1) as f32;
        let coordinate = |i: usize| i as f32 * step - 1.0;
        for (i, cell) in self.layer.iter_mut().enumerate() {
            let q = Vec3::new(coordinate(i % self.side), coordinate(i / self.side), coordinate(self.z));
            // The surface is met exactly: planes through the receiver.
            let distance = if i % self.side % (self.side - 1) == 0
                || i / self.side % (self.side - 1) == 0
                || self.z % (self.side - 1) == 0
            {
                0.0
            } else {
                (1.0 - q.abs().max_element()) / DEPTH
            };
            // Cells in the middle belong to no plane within the radius.
            if distance <= 1.0 + 2.0 * step {
                *cell = self.rays.beyond(q.normalize_or_zero(), distance);
            }
        }
    }
}

/// At least the distance between two unit vectors, from the sine of their angle up to a right one.
#[inline(always)]
pub(super) fn chord(sine: f32) -> f32 {
    // The exact ratio is 1 / cos(a / 2), from 1 to sqrt(2).
    sine * (1.0 + 0.42 * sine * sine)
}

/// Enlarges circles on the unit sphere so that no ray inside is lost when the circle is rounded to a cell.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Margin {
    /// Largest distance between a plane's coordinates and its cell's centre.
    offset: f32,
    /// Largest difference in distance, radii.
    depth: f32,
}

impl Margin {
    pub(crate) fn of<const W: usize>(table: &PlaneTable<W>) -> Self {
        // A little more than the bounds, for rounding.
        let half = table.half_cell() * 1.0001 + 4e-6;
        Self { offset: half * 3f32.sqrt() * 1.0001, depth: half / DEPTH * 1.0001 }
    }

    /// Sine of the largest angle between a normal and that of the cell of its plane at distance `d` or less.
    ///
    /// The plane's coordinates have a length of at least `1 - 7/8 d`, and the cell's centre is within `offset` of them.
    #[inline(always)]
    fn sine(self, d: f32) -> f32 {
        (self.offset / (1.0 - DEPTH * d)).min(1.0)
    }

    /// Distance to look up for a circle of directions with this cosine and sine of its angular radius, so that the mask
    /// found holds all of the circle's rays of length 1; negative if there is none and all rays have to be taken.
    ///
    /// A direction within the angle `r` of the axis is within `r + a` of the cell's normal, `a` the angle between the two;
    /// so the cell's distance must be at most `cos(r + a)`, and it is at most `depth` more than what is looked up. If `a`
    /// has no bound below a right angle, the result is negative.
    #[inline(always)]
    pub(crate) fn circle(self, cosine: f32, sine: f32) -> f32 {
        let a = self.sine(cosine);
        cosine * (1.0 - a * a).sqrt() - sine * a - self.depth
    }

    /// Distance to look up for a plane at distance `d`, so that the mask found holds all ends of rays, of length 1 at
    /// most, beyond the plane; negative if there is none.
    ///
    /// The end's distance from the two planes differs by the distance of their normals.
    #[inline(always)]
    pub(crate) fn plane(self, d: f32) -> f32 {
        d - chord(self.sine(d)) - self.depth
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Pattern, PatternOptions};
    use proptest::prelude::*;

    fn lookup(table: &PlaneTable<2>, n: Vec3, d: f32) -> [u64; 2] {
        let cells = table.cells(&[[n.x; 8], [n.y; 8], [n.z; 8]], &[d; 8]);
        *table.mask(cells[5])
    }

    fn bit(mask: [u64; 2], i: usize) -> bool {
        mask[i / 64] >> (i % 64) & 1 == 1
    }

    fn ends() -> Vec<Vec3> {
        Pattern::new(&PatternOptions::default()).unwrap().directions().to_vec()
    }

    fn normal() -> impl Strategy<Value = Vec3> {
        prop::array::uniform3(-1f32..1.0)
            .prop_map(Vec3::from)
            .prop_filter("length", |n| n.length() > 0.1)
            .prop_map(Vec3::normalize)
    }

    #[test]
    fn back_ends_fill_the_same_table() {
        let tables = BackEnd::ALL.map(|b| PlaneTable::<2>::build(&ends()[..96], 9, b));
        assert!(tables.iter().all(|t| t.cells == tables[0].cells));
        // No ray, no bit.
        assert!(tables[0].cells.iter().all(|c| c[1] >> 32 == 0));
        assert!(tables[0].cells.iter().any(|c| c[1] != 0));
    }

    #[test]
    fn lookups_are_exact_up_to_the_cell_and_margins_lose_nothing() {
        let ends = ends();
        let table = PlaneTable::<2>::build(&ends, 48, BackEnd::best());
        let margin = Margin::of(&table);
        let mut runner = proptest::test_runner::TestRunner::deterministic();
        runner
            .run(&(normal(), 0f32..1.0), |(n, d)| {
                let near = chord(margin.sine(d)) + margin.depth;
                let mask = lookup(&table, n * 3.0, d);
                let through = lookup(&table, n, 0.0);
                let opposite = lookup(&table, -n, 0.0);
                let (circle, plane) = (margin.circle(d, (1.0 - d * d).sqrt()), margin.plane(d));
                for (i, e) in ends.iter().enumerate() {
                    let height = n.dot(*e);
                    if (height - d).abs() > near {
                        prop_assert_eq!(bit(mask, i), height > d);
                    }
                    prop_assert!(bit(through, i) != bit(opposite, i) || height.abs() < 0.05);
                    if height >= d {
                        prop_assert!(circle < 0.0 || bit(lookup(&table, n, circle), i));
                        prop_assert!(plane < 0.0 || bit(lookup(&table, n, plane), i));
                    }
                }
                // Opposite planes through the receiver share no ray and leave none out, save those in the plane itself.
                prop_assert!((0..2).all(|w| (through[w] ^ opposite[w]).count_ones() >= 62));
                Ok(())
            })
            .unwrap();
    }

    #[test]
    fn strange_planes_get_some_cell() {
        let table = PlaneTable::<2>::build(&ends(), 8, BackEnd::Scalar);
        for x in [f32::NAN, f32::INFINITY, 0.0, f32::MAX] {
            lookup(&table, Vec3::new(x, 1.0, x), x);
            lookup(&table, Vec3::splat(x), 0.5);
        }
    }
}
