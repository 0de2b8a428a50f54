//! Blocks of regular grids: eight boxes as small numbers, and the eight triangles of 2 x 2 cells.

use super::{LANES, Lanes, fan::FanRays};
use crate::{Aabb, SlabRay};

/// Boxes of up to eight children, rounded outwards to 256 planes along each axis.
#[derive(Clone, Copy, Debug)]
pub struct BoxBlock {
    base: [f32; 3],
    /// Powers of two, so that products with numbers of planes are exact.
    step: [f32; 3],
    /// By rows smallest x, largest x, smallest y, ..; by child.
    planes: [[u8; LANES]; 6],
}

/// The smallest normal power of two that is at least `x`, which is not negative.
fn power_of_two_above(x: f64) -> f32 {
    let x = x.max(f64::from(f32::MIN_POSITIVE));
    let below = f64::from_bits(x.to_bits() & !((1 << 52) - 1));
    (if below < x { 2.0 * below } else { below }) as f32
}

impl BoxBlock {
    /// Around the first eight of `boxes`, none of them empty.
    pub fn new(boxes: &[Aabb]) -> Self {
        let whole = boxes.iter().fold(Aabb::EMPTY, |all, b| all.union(*b));
        let mut block = Self { base: [0.0; 3], step: [0.0; 3], planes: [[0; LANES]; 6] };
        for axis in 0..3 {
            let (low, high) = (whole.min[axis], whole.max[axis]);
            // A few planes more than the size asks for, and sums that round.
            let ulp = f64::from(low.abs().max(high.abs())) * f64::from(f32::EPSILON);
            let step = power_of_two_above((f64::from(high) - f64::from(low) + 4.0 * ulp) / 250.0);
            (block.base[axis], block.step[axis]) = (low, step);
            for (i, b) in boxes.iter().take(LANES).enumerate() {
                let number = |x: f32| (f64::from(x) - f64::from(low)) / f64::from(step);
                let mut first = number(b.min[axis]).floor().clamp(0.0, 255.0) as u8;
                let mut last = number(b.max[axis]).ceil().clamp(0.0, 255.0) as u8;
                while first > 0 && block.plane(axis, first) > b.min[axis] {
                    first -= 1;
                }
                while last < u8::MAX && block.plane(axis, last) < b.max[axis] {
                    last += 1;
                }
                block.planes[2 * axis][i] = first;
                block.planes[2 * axis + 1][i] = last;
            }
        }
        block
    }

    #[inline(always)]
    pub(super) fn plane(&self, axis: usize, number: u8) -> f32 {
        f32::from(number) * self.step[axis] + self.base[axis]
    }

    #[cfg(target_arch = "x86_64")]
    #[inline(always)]
    pub(super) fn parts(&self, axis: usize) -> (f32, f32, &[[u8; LANES]; 6]) {
        (self.base[axis], self.step[axis], &self.planes)
    }

    /// Box of a child as stored.
    ///
    /// # Panics
    /// If `child` is not below [`LANES`].
    pub fn child(&self, child: usize) -> Aabb {
        let at =
            |row: usize| [0, 1, 2].map(|axis| self.plane(axis, self.planes[2 * axis + row][child])).into();
        Aabb { min: at(0), max: at(1) }
    }

    /// Children that the segment up to `ray.tfar` may enter, one bit each; of no meaning where there is no child.
    #[inline]
    pub fn entered(&self, ray: &SlabRay) -> u32 {
        let mut mask = 0;
        for child in 0..LANES {
            mask |= u32::from(ray.entry(&self.child(child), ray.tfar).is_some()) << child;
        }
        mask
    }

    /// For each child those of `rays` of a fan from `origin` that may enter it, a bit each; of no meaning where there is no
    /// child.
    #[inline]
    pub fn columns<const N: usize>(&self, origin: [f32; 3], fan: &FanRays<N>, rays: u32) -> [u32; LANES] {
        let mut columns = [0; LANES];
        for (child, column) in columns.iter_mut().enumerate() {
            for r in (0..N).filter(|r| rays >> r & 1 == 1) {
                let (mut entry, mut exit) = (fan.slab_near[r], fan.slab_far[r]);
                for (axis, origin) in origin.iter().enumerate() {
                    let row = 2 * axis + (fan.negative[axis][r] as usize & 1);
                    let relative = |row: usize| self.plane(axis, self.planes[row][child]) - origin;
                    // The comparisons are false for NaN, which drops it.
                    let (near, far) =
                        (relative(row) * fan.inv_near[axis][r], relative(row ^ 1) * fan.inv_far[axis][r]);
                    entry = if near > entry { near } else { entry };
                    exit = if far < exit { far } else { exit };
                }
                *column |= u32::from(entry <= exit) << r;
            }
        }
        columns
    }
}

/// The triangles of 2 x 2 cells over 3 x 3 vertices: two a cell along the diagonal from its first corner, cells row by row.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(16))]
pub struct CellBlock {
    /// By axis, row of vertices; three vertices and one number that is not used.
    rows: [[[f32; 4]; 3]; 3],
    used: u8,
}

impl CellBlock {
    /// From coordinates by axis and row, the fourth of each row of no meaning. `used` has a bit for each triangle; those
    /// have finite corners.
    #[inline(always)]
    pub fn new(rows: [[[f32; 4]; 3]; 3], used: u8) -> Self {
        Self { rows, used }
    }

    #[cfg(target_arch = "x86_64")]
    #[inline(always)]
    pub(super) fn rows(&self, axis: usize) -> &[[f32; 4]; 3] {
        &self.rows[axis]
    }

    /// Column and row of a triangle's corner.
    #[inline(always)]
    fn vertex(lane: usize, corner: usize) -> [usize; 2] {
        let [x, y] = [lane / 2 % 2, lane / 4];
        match (corner, lane % 2) {
            (0, _) => [x, y],
            (1, 0) => [x + 1, y],
            (2, 1) => [x, y + 1],
            _ => [x + 1, y + 1],
        }
    }
}

impl Lanes for CellBlock {
    #[inline(always)]
    fn used(&self) -> u8 {
        self.used
    }

    #[inline(always)]
    fn triangle(&self, lane: usize) -> [[f32; 3]; 3] {
        [0, 1, 2].map(|corner| {
            let [x, y] = Self::vertex(lane % LANES, corner);
            [0, 1, 2].map(|axis| self.rows[axis][y][x])
        })
    }

    #[cfg(target_arch = "x86_64")]
    #[inline(always)]
    unsafe fn corner(&self, corner: usize, axis: usize) -> std::arch::x86_64::__m256 {
        // SAFETY: as of this function.
        unsafe { super::x86::cell_corner(self, corner, axis) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        Ray,
        kernel::{
            BlockMask, BlockRay, TriangleLanes,
            fan::{self, CHUNK},
            scalar,
        },
    };
    use proptest::prelude::*;

    fn coordinate() -> impl Strategy<Value = f32> {
        prop_oneof![
            6 => -1f32..1.0,
            2 => prop::sample::select(vec![0.0, -0.0, 0.5, 1.0, -1.0]),
            1 => prop::sample::select(vec![1e-30, -1e-38, 1e18, -1e23, 3e5]),
        ]
    }

    fn vector() -> impl Strategy<Value = [f32; 3]> {
        [coordinate(), coordinate(), coordinate()]
    }

    fn rays() -> impl Strategy<Value = Ray> {
        (vector(), vector(), prop_oneof![Just(f32::INFINITY), 0f32..4.0])
            .prop_map(|(o, d, tfar)| Ray::new(o, d).with_tfar(tfar))
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(1500))]

        #[test]
        fn boxes_hold_what_they_are_made_of(
            ends in prop::collection::vec((vector(), vector()), 1..=8), ray in rays(),
        ) {
            let boxes: Vec<Aabb> =
                ends.iter().map(|(a, b)| Aabb::EMPTY.with_point(*a).with_point(*b)).collect();
            let block = BoxBlock::new(&boxes);
            let whole = boxes.iter().fold(Aabb::EMPTY, |all, b| all.union(*b));
            for (i, b) in boxes.iter().enumerate() {
                let stored = block.child(i);
                prop_assert!(stored.min.cmple(b.min).all() && stored.max.cmpge(b.max).all());
                let room = whole.size() * (2.01 / 125.0) + whole.min.abs().max(whole.max.abs()) * 1e-5;
                prop_assert!((stored.size() - b.size()).cmple(room + 1e-36).all(), "{} {}", stored.size(), b.size());
            }
            let Some(slab) = SlabRay::new(&ray) else { return Ok(()) };
            let mask = block.entered(&slab);
            for (i, b) in boxes.iter().enumerate() {
                prop_assert!(mask >> i & 1 == 1 || slab.entry(b, slab.tfar).is_none());
            }
            #[cfg(target_arch = "x86_64")]
            if let Some(avx2) = crate::simd::Avx2::detect() {
                let used = (1u32 << boxes.len()) - 1;
                prop_assert_eq!(avx2.entered(&block, &slab) & used, mask & used);
            }
            let mut fan = FanRays::<CHUNK>::default();
            if fan.prepare(0, &[ray; 3]) == 0 {
                return Ok(());
            }
            let columns = block.columns(ray.origin.to_array(), &fan, 0b101);
            for (b, column) in boxes.iter().zip(columns) {
                prop_assert!([0, 0b101].contains(&column));
                prop_assert!(column != 0 || !slab.surely_crosses(b));
            }
            #[cfg(target_arch = "x86_64")]
            if let Some(avx2) = crate::simd::Avx2::detect() {
                let same = avx2.columns(&block, ray.origin.to_array(), &fan, 0b101);
                prop_assert_eq!(&same[..boxes.len()], &columns[..boxes.len()]);
            }
        }

        #[test]
        fn cells_are_their_triangles(
            vertices in prop::collection::vec(vector(), 9), used in any::<u8>(), ray in rays(),
        ) {
            let row = |axis: usize, j: usize| [0, 1, 2, 2].map(|i| vertices[3 * j + i][axis]);
            let cells = CellBlock::new([0, 1, 2].map(|axis| [0, 1, 2].map(|j| row(axis, j))), used);
            let mut lanes = TriangleLanes::EMPTY;
            for lane in (0..LANES).filter(|lane| used >> lane & 1 == 1) {
                let [a, b, d, c] = [0, 1, 3, 4].map(|k| vertices[lane / 4 * 3 + lane / 2 % 2 + k]);
                lanes.set(lane, if lane % 2 == 0 { [a, b, c] } else { [a, c, d] });
                prop_assert_eq!(cells.triangle(lane), lanes.triangle(lane));
            }
            let Some(prepared) = BlockRay::new(&ray) else { return Ok(()) };
            prop_assert_eq!(scalar::filter(&cells, &prepared), scalar::filter(&lanes, &prepared));
            #[cfg(target_arch = "x86_64")]
            if let Some(avx2) = crate::simd::Avx2::detect() {
                prop_assert_eq!(avx2.filter(&cells, &prepared), avx2.filter(&lanes, &prepared));
            }
            let mut rays = FanRays::<CHUNK>::default();
            if rays.prepare(0, &[ray]) == 0 {
                return Ok(());
            }
            let (origin, d) = (ray.origin.to_array(), rays.direction.map(|row| row[0]));
            let check = |mask: BlockMask| {
                prop_assert_eq!((mask.certain | mask.uncertain) & !used, 0);
                for lane in (0..LANES).filter(|lane| (used & !mask.uncertain) >> lane & 1 == 1) {
                    let truth = crate::segment_hits_triangle(&ray, cells.triangle(lane));
                    prop_assert_eq!(mask.certain >> lane & 1 == 1, truth, "lane {}", lane);
                }
                Ok(())
            };
            check(fan::scalar::Planes::new(&cells, origin).filter(d, rays.near[0], rays.far[0]))?;
            #[cfg(target_arch = "x86_64")]
            if let Some(avx2) = crate::simd::Avx2::detect() {
                check(avx2.fan_filter(&avx2.planes(&cells, origin), d, rays.near[0], rays.far[0]))?;
            }
        }
    }
}
