//! The plane table (`[Laine10]`, section 3.1): which rays cross a plane, for every plane at once.
//!
//! Here: how a plane finds its cell, filling the cells, bounds on what rounding to a cell changes. Not here: a finer form of
//! the table's surface (`edge.rs`), which planes a triangle or a node asks for (`triangle_mask.rs`, `node_mask.rs`).

use super::lanes::{F8, V8};
use crate::BackEnd;
use umbrage_geom::{glam::Vec3, simd::Job};

/// Share of the table's radius that distances take, the `7/8` of the paper.
const DEPTH_SHARE: f32 = 0.875;

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
    pub(crate) fn cells(&self, normals: V8, distances: F8) -> [u32; 8] {
        let half = 0.5 * (self.resolution - 1) as f32;
        let depth = F8::splat(half) - F8::splat(half * DEPTH_SHARE) * distances;
        let at = normals.scale(depth / normals.abs().largest());
        let [x, y, z] = [at.x, at.y, at.z];
        let half = F8::splat(half);
        let upper = (y + half).nearest().plus(self.resolution, (z + half).nearest());
        (x + half).nearest().plus(self.resolution, upper).0
    }

    /// The mask of a cell that [`Self::cells`] gave.
    #[inline(always)]
    pub(crate) fn mask(&self, cell: u32) -> &[u64; W] {
        &self.cells[(cell as usize).min(self.cells.len() - 1)]
    }
}

/// Ends of rays by coordinate. Bits without a ray hold NaN, which no comparison lets through.
pub(super) struct Rays<const W: usize> {
    ends: [Vec<[f32; 8]>; 3],
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
        let [x, y, z] = &self.ends;
        let (x, y, z) = (&x[..W * 8], &y[..W * 8], &z[..W * 8]);
        let n = V8::splat(normal.to_array());
        let mut words = [0; W];
        for group in 0..W * 8 {
            let heights = n.dot(V8::new(F8(x[group]), F8(y[group]), F8(z[group])));
            words[group / 8] |= u64::from(F8::splat(distance).le(heights)) << (group % 8 * 8);
        }
        words
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
            let outermost = |i: usize| i == 0 || i == self.side - 1;
            let on_surface = outermost(i % self.side) || outermost(i / self.side) || outermost(self.z);
            let distance = if on_surface { 0.0 } else { (1.0 - q.abs().max_element()) / DEPTH_SHARE };
            // Cells in the middle belong to no plane within the radius.
            if distance <= 1.0 + 2.0 * step {
                *cell = self.rays.beyond(q.normalize_or_zero(), distance);
            }
        }
    }
}

/// See [`chord`].
const CHORD: f32 = 0.42;

/// At least the distance between two unit vectors, from the sine of their angle up to a right one.
#[inline(always)]
pub(super) fn chord(sine: f32) -> f32 {
    // The exact ratio is 1 / cos(a / 2), from 1 to sqrt(2).
    sine * (1.0 + CHORD * sine * sine)
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
        Self { offset: half * 3f32.sqrt() * 1.0001, depth: half / DEPTH_SHARE * 1.0001 }
    }

    /// Sine of the largest angle between a normal and that of the cell of its plane at distance `d` or less.
    ///
    /// The plane's coordinates have a length of at least `1 - 7/8 d`, and the cell's centre is within `offset` of them.
    #[inline(always)]
    fn sine(self, d: F8) -> F8 {
        let one = F8::splat(1.0);
        (F8::splat(self.offset) / (one - F8::splat(DEPTH_SHARE) * d)).min(one)
    }

    /// Distance to look up for a circle of directions with this cosine and sine of its angular radius, so that the mask
    /// found holds all of the circle's rays of length 1; negative if there is none and all rays have to be taken.
    ///
    /// A direction within the angle `r` of the axis is within `r + a` of the cell's normal, `a` the angle between the two;
    /// so the cell's distance must be at most `cos(r + a)`, and it is at most `depth` more than what is looked up. If `a`
    /// has no bound below a right angle, the result is negative.
    #[inline(always)]
    pub(crate) fn circle(self, cosine: F8, sine: F8) -> F8 {
        let a = self.sine(cosine);
        cosine * (F8::splat(1.0) - a * a).sqrt() - sine * a - F8::splat(self.depth)
    }

    /// Distance to look up for a plane at distance `d`, so that the mask found holds all ends of rays, of length 1 at
    /// most, beyond the plane; negative if there is none.
    ///
    /// The end's distance from the two planes differs by the distance of their normals.
    #[inline(always)]
    pub(crate) fn plane(self, d: F8) -> F8 {
        let sine = self.sine(d);
        // As `chord`.
        d - sine * (F8::splat(1.0) + F8::splat(CHORD) * sine * sine) - F8::splat(self.depth)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Pattern, PatternOptions};
    use proptest::prelude::*;

    fn lookup(table: &PlaneTable<2>, n: Vec3, d: f32) -> [u64; 2] {
        let cells = table.cells(V8::splat(n.to_array()), F8::splat(d));
        *table.mask(cells[5])
    }

    fn bit(mask: [u64; 2], i: usize) -> bool {
        mask[i / 64] >> (i % 64) & 1 == 1
    }

    fn ends() -> Vec<Vec3> {
        Pattern::new(&PatternOptions::default()).unwrap().directions(0).to_vec()
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
                let near = chord(margin.sine(F8::splat(d)).0[0]) + margin.depth;
                let mask = lookup(&table, n * 3.0, d);
                let through = lookup(&table, n, 0.0);
                let opposite = lookup(&table, -n, 0.0);
                let sine = F8::splat((1.0 - d * d).sqrt());
                let [circle, plane] =
                    [margin.circle(F8::splat(d), sine), margin.plane(F8::splat(d))].map(|x| x.0[7]);
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
