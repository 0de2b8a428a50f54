//! Back ends of a traversal step. All return the same children in `mask`, and filters that are right.

mod scalar;
#[cfg(target_arch = "x86_64")]
mod x86;

pub(crate) use scalar::Scalar;

use crate::{
    node::{MAX_LEVELS, Node, NodeNote, WIDTH},
    solid::SolidPack,
};
#[cfg(target_arch = "x86_64")]
use umbrage_geom::simd::Avx2;
use umbrage_geom::{
    Ray, SlabRay,
    kernel::{BlockMask, BlockRay, TriangleBlock, fan::FanRays},
    simd::{BackEnd, Dispatch},
};

/// Most rays of one origin that walk together.
pub const FAN: usize = 32;

/// A valid ray prepared for boxes of nodes.
#[derive(Clone, Copy, Debug)]
pub(crate) struct NodeRay {
    pub(crate) slab: SlabRay,
    /// Row of [`Node::grid`] that holds the near plane of each axis, even or odd; the far plane is its neighbour.
    near_row: [usize; 3],
}

impl NodeRay {
    #[inline(always)]
    pub(crate) fn new(slab: SlabRay) -> Self {
        let [x, y, z] = slab.inv_near.to_array();
        // Not by `map`, which is not inlined into functions with target features.
        let near_row = [usize::from(x < 0.0), 2 + usize::from(y < 0.0), 4 + usize::from(z < 0.0)];
        Self { slab, near_row }
    }
}

/// A ray prepared for boxes and triangles.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Prepared {
    pub(crate) node: NodeRay,
    pub(crate) block: BlockRay,
}

impl Prepared {
    /// `None` if the ray is not valid, which is a miss.
    #[inline(always)]
    pub(crate) fn new(ray: &Ray) -> Option<Self> {
        Some(Self { node: NodeRay::new(SlabRay::new(ray)?), block: BlockRay::new(ray)? })
    }
}

/// Boxes of a node relative to the origin of a fan: the rows of [`Node`], as planes.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
pub(crate) struct Rows(pub(crate) [[f32; WIDTH]; 6]);

/// How large children look.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(32))]
pub(crate) struct Sizes(pub(crate) [f32; WIDTH]);

/// For each child the rays that enter it, a bit each.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(C, align(32))]
pub(crate) struct Columns(pub(crate) [u32; WIDTH]);

impl Columns {
    /// No ray enters.
    pub(crate) const NONE: Self = Self([0; WIDTH]);
}

/// Later start and earlier end of a segment, given as slab tests have them: what scaling rounded off, and what it flushed to 0.
#[inline(always)]
fn surely(start: f32, end: f32) -> [f32; 2] {
    let start = start * (1.0 + 2f32.powi(-19));
    [if start > 2f32.powi(-100) { start } else { 2f32.powi(-100) }, end * (1.0 - 2f32.powi(-19))]
}

/// What both terms of the covered part of a way are raised by, so that a way of length 0 is covered.
const SHORTEST_WAY: f32 = 1.0 / (1u128 << 100) as f32;

/// The share that mark 1 stands for.
const SHARE_OF_MARK_1: f32 = 1.0 / 255.0;

/// How far ahead of a fan something is.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Ahead {
    /// The mean direction, scaled.
    pub(crate) direction: [f32; 3],
    pub(crate) offset: f32,
}

impl Ahead {
    /// Most that counts; all of it is below the difference of one ray.
    pub(crate) const MOST: f32 = 0.999;

    /// From a sum of directions and the box of the scene, relative to the fan's origin: 0 where the scene starts, about 1
    /// where it ends.
    #[inline(always)]
    pub(crate) fn new(sum: [f32; 3], [low, high]: [[f32; 3]; 2]) -> Self {
        let (mut start, mut range) = (0.0, f32::MIN_POSITIVE);
        for axis in 0..3 {
            let nearest = if sum[axis] > 0.0 { low[axis] } else { high[axis] };
            start += sum[axis] * nearest;
            range += sum[axis].abs() * (high[axis] - low[axis]);
        }
        // Boxes are given by their middle, twice.
        let scale = 0.5 / range;
        Self { direction: sum.map(|x| x * scale), offset: -2.0 * start * scale }
    }
}

/// Rays of one origin, prepared, with what holds for all of them.
pub(crate) struct Fan {
    pub(crate) rays: FanRays<FAN>,
    pub(crate) ahead: Ahead,
    /// By axis: 1 where all directions are negative, 0 where none is; `None` if they are mixed on some axis.
    pub(crate) signs: Option<[u32; 3]>,
}

/// Entries of [`Stack`]: the most that a walk can push, and room for writing a whole node at once.
const STACK: usize = (WIDTH - 1) * MAX_LEVELS + 1 + WIDTH;

/// Children to visit, and for each the rays that enter it.
pub(crate) struct Stack {
    pub(crate) children: [u32; STACK],
    pub(crate) rays: [u32; STACK],
}

impl Stack {
    pub(crate) fn new() -> Self {
        Self { children: [0; STACK], rays: [0; STACK] }
    }
}

/// One traversal step on some instruction set.
pub(crate) trait Kernel: Copy {
    /// Bit `i` is set when the ray may enter child `i` before `tfar` (scaled as by [`SlabRay`]).
    fn mask(self, node: &Node, ray: &NodeRay, tfar: f32) -> u32;

    /// [`Self::mask`], and where the ray enters: defined for children in the mask.
    fn entries(self, node: &Node, ray: &NodeRay, tfar: f32, entries: &mut [f32; WIDTH]) -> u32;

    /// Boxes that the open segment surely has a point strictly inside of, a bit each: [`SlabRay::surely_crosses`].
    fn crossed(self, pack: &SolidPack, ray: &NodeRay) -> u32;

    /// See [`umbrage_geom::kernel`].
    fn filter(self, block: &TriangleBlock, ray: &BlockRay) -> BlockMask;

    /// The boxes of `node`, moved so that `origin` is at 0.
    fn rows(self, node: &Node, origin: [f32; 3]) -> Rows;

    /// Children that ray `r` of a fan may enter; of no meaning in empty slots.
    fn fan_mask<const N: usize>(self, rows: &Rows, rays: &FanRays<N>, r: usize) -> u32;

    /// Bit `i` is set when child `i` reaches into the box `[low, high]`; of no meaning in empty slots.
    fn overlap(self, rows: &Rows, low: [f32; 3], high: [f32; 3]) -> u32;

    /// The boxes of `pack`, moved so that `origin` is at 0.
    fn pack_rows(self, pack: &SolidPack, origin: [f32; 3]) -> Rows;

    /// [`Self::crossed`] for ray `r` of a fan.
    ///
    /// Reciprocals and ends of [`FanRays`] are rounded as those of [`SlabRay`] are, and used the other way round here.
    fn fan_crossed(self, rows: &Rows, rays: &FanRays<FAN>, r: usize) -> u32;

    /// Asks for the cache lines of `bytes` bytes from `target`, which may be any address.
    fn prefetch(self, target: *const u8, bytes: usize);

    /// A leaf seen from the origin of a fan.
    type Planes: Copy;

    /// See [`umbrage_geom::kernel::fan`].
    fn planes(self, block: &TriangleBlock, origin: [f32; 3]) -> Self::Planes;

    /// See [`umbrage_geom::kernel::fan::scalar::Planes::ask_sides`].
    fn ask_sides(self, planes: &mut Self::Planes, block: &TriangleBlock, origin: [f32; 3], lanes: u8);

    /// See [`umbrage_geom::kernel::fan`].
    fn fan_filter(self, planes: &Self::Planes, rays: &FanRays<FAN>, r: usize) -> BlockMask;

    /// Pushes those of the `wanted` children that some ray in `left` may enter, each with the rays that may, so that the one
    /// of the largest product of how many do (less a part of one for the distance) and [`Node::merit`] is on top. Returns
    /// the new height of the stack.
    #[allow(clippy::too_many_arguments)] // the state of one loop
    fn fan_push(
        self,
        node: &Node,
        rows: &Rows,
        fan: &Fan,
        left: u32,
        wanted: u32,
        stack: &mut Stack,
        top: usize,
    ) -> usize;

    /// How large the children look from the fan's origin: squared radius times the share that is their mark in 255ths, over
    /// squared distance; infinite or not a number where the mark is 0.
    fn sizes(self, rows: &Rows, note: &NodeNote) -> Sizes;

    /// Children that look smaller than `limit`, a bit each.
    fn smaller(self, sizes: &Sizes, limit: f32) -> u32;

    /// Notes the children that ray `r` of a fan enters, those that look smaller than `limit` aside: they end it. Returns
    /// these, a bit each, and writes how much of its way through them the segment covers, 0 for others.
    #[allow(clippy::too_many_arguments)] // the state of one loop
    fn enter_or_end(
        self,
        rows: &Rows,
        sizes: &Sizes,
        rays: &FanRays<FAN>,
        r: usize,
        limit: f32,
        columns: &mut Columns,
        covered: &mut [f32; WIDTH],
    ) -> u32;

    /// The same as [`Self::fan_push`] where `columns` has the rays that enter each child.
    #[allow(clippy::too_many_arguments)] // the state of one loop
    fn push(
        self,
        node: &Node,
        rows: &Rows,
        fan: &Fan,
        columns: &Columns,
        wanted: u32,
        stack: &mut Stack,
        top: usize,
    ) -> usize;
}

/// Work that runs on any kernel.
pub(crate) trait Job {
    type Output;

    fn run<K: Kernel>(self, kernel: K) -> Self::Output;
}

/// A job as work with code of its own for each kernel.
struct OnKernel<J>(J);

impl<J: Job> Dispatch for OnKernel<J> {
    type Output = J::Output;

    #[inline(always)]
    fn portable(self) -> J::Output {
        self.0.run(Scalar)
    }

    #[cfg(target_arch = "x86_64")]
    #[inline(always)]
    fn avx2(self, avx2: Avx2) -> J::Output {
        self.0.run(avx2)
    }
}

/// Runs `job` on the kernel of `back_end`, or on the portable one where the processor lacks it.
#[inline]
pub(crate) fn run<J: Job>(back_end: BackEnd, job: J) -> J::Output {
    back_end.dispatch(OnKernel(job))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use umbrage_geom::Aabb;

    fn coordinate() -> impl Strategy<Value = f32> {
        prop_oneof![
            4 => -2f32..2.0,
            2 => (-4i8..5).prop_map(|i| f32::from(i) * 0.5),
            1 => prop::sample::select(vec![-0.0, 1e-30f32, 1e12]),
        ]
    }

    fn point() -> impl Strategy<Value = [f32; 3]> {
        [coordinate(), coordinate(), coordinate()]
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(2000))]
        #[test]
        fn back_ends_end_rays_alike(
            boxes in prop::collection::vec((point(), point(), any::<u8>()), 1..=8), o in point(), d in point(),
            limit in prop::sample::select(vec![0f32, 0.01, 1.0, f32::INFINITY]),
            tfar in prop::sample::select(vec![0.5f32, 1.0, f32::INFINITY]),
        ) {
            let mut node = Node::EMPTY;
            let aabbs: Vec<Aabb> = boxes.iter().map(|&(a, b, _)| Aabb::from_points(&[a, b])).collect();
            node.set_boxes(&aabbs);
            node.note.marks.iter_mut().zip(&boxes).for_each(|(mark, b)| *mark = b.2);
            let mut rays = FanRays::<FAN>::default();
            let r = 3;
            if rays.prepare(0, &[Ray::new(o, d).with_tfar(tfar); 16]) == 0 {
                return Ok(());
            }
            let rows = Scalar.rows(&node, o);
            let sizes = Scalar.sizes(&rows, &node.note);
            let (mut columns, mut covered) = (Columns::NONE, [0.0; WIDTH]);
            let ends = Scalar.enter_or_end(&rows, &sizes, &rays, r, limit, &mut columns, &mut covered);
            prop_assert!(ends & !Scalar.smaller(&sizes, limit) == 0);
            for i in 0..boxes.len() {
                // 0 too where the way is without end.
                prop_assert!(ends >> i & 1 == 1 || covered[i] == 0.0);
                prop_assert!((0.0..=1.0).contains(&covered[i]));
                let entered = columns.0[i] == 1 << r;
                prop_assert_eq!(ends >> i & 1 == 1 || entered, Scalar.fan_mask(&rows, &rays, r) >> i & 1 == 1);
                prop_assert!(boxes[i].2 != 0 || ends >> i & 1 == 0);
            }
            #[cfg(target_arch = "x86_64")]
            if let Some(avx2) = Avx2::detect() {
                let same = avx2.sizes(&rows, &node.note);
                prop_assert_eq!(avx2.smaller(&same, limit), Scalar.smaller(&sizes, limit));
                let (mut others, mut part) = (Columns::NONE, [0.0; WIDTH]);
                prop_assert_eq!(avx2.enter_or_end(&rows, &same, &rays, r, limit, &mut others, &mut part), ends);
                prop_assert_eq!(others, columns);
                prop_assert!(ends == 0 || part.map(f32::to_bits) == covered.map(f32::to_bits));
            }
        }

        #[test]
        fn crossed_boxes_are_crossed(
            o in [-9i64..10, -9i64..10, -9i64..10], d in [-9i64..10, -9i64..10, -9i64..10],
            boxes in prop::collection::vec(([-9i64..10, -9i64..10, -9i64..10], [0i64..7, 0i64..7, 0i64..7]), 1..=8),
            ends in prop::sample::select(vec![(0i64, 8), (0, 12), (3, 8), (0, 1 << 20)]),
            shift in -60i32..60, stretch in -60i32..60,
        ) {
            prop_assume!(d != [0; 3]);
            let (unit, length) = (2f32.powi(shift), 2f32.powi(stretch));
            let point = |p: [i64; 3]| p.map(|x| x as f32 * unit);
            let origin = point(o);
            // Parameters of ends are in eighths of the way to `o + d`.
            let end = |t: i64| t as f32 / 8.0 / length;
            let direction = d.map(|x| x as f32 * unit * length);
            let ray = Ray { origin: origin.into(), direction: direction.into(), tnear: end(ends.0), tfar: end(ends.1) };
            let mut pack = SolidPack::EMPTY;
            let mut truth = 0;
            for (i, &(low, size)) in boxes.iter().enumerate() {
                let high = [0, 1, 2].map(|axis| low[axis] + size[axis]);
                pack.set(i, &Aabb { min: point(low).into(), max: point(high).into() });
                // Bounds of `t` over the open box as fractions, denominators positive.
                let (mut bounds, mut inside) = (vec![((ends.0, 8), (ends.1, 8))], true);
                for axis in 0..3 {
                    match d[axis] {
                        0 => inside &= low[axis] < o[axis] && o[axis] < high[axis],
                        s if s > 0 => bounds.push(((low[axis] - o[axis], s), (high[axis] - o[axis], s))),
                        s => bounds.push(((o[axis] - high[axis], -s), (o[axis] - low[axis], -s))),
                    }
                }
                let before = |a: (i64, i64), b: (i64, i64)| a.0 * b.1 < b.0 * a.1;
                inside &= bounds.iter().all(|a| bounds.iter().all(|b| before(a.0, b.1)));
                truth |= u32::from(inside) << i;
            }
            let mut rays = FanRays::<FAN>::default();
            let r = 5;
            let fits = rays.prepare(0, &[ray; 16]) != 0;
            let rows = Scalar.pack_rows(&pack, origin);
            // Nothing here is closer than a unit of the grid: what is crossed is crossed surely.
            let node_ray = NodeRay::new(SlabRay::new(&ray).unwrap());
            prop_assert_eq!(Scalar.crossed(&pack, &node_ray), truth);
            prop_assert!(!fits || Scalar.fan_crossed(&rows, &rays, r) == truth);
            #[cfg(target_arch = "x86_64")]
            if let Some(avx2) = Avx2::detect() {
                prop_assert_eq!(avx2.crossed(&pack, &node_ray), truth);
                let rows = avx2.pack_rows(&pack, origin);
                prop_assert!(!fits || avx2.fan_crossed(&rows, &rays, r) == truth);
            }
        }
    }
}
