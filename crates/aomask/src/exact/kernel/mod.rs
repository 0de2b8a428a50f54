//! Back ends of the exact engine: what one step does to boxes, cones and triangles.
//!
//! Children and groups that a back end keeps may differ in rounding: every test is conservative. What is called certain about
//! a triangle is true in all of them ([`umbrage_geom::kernel::fan`]).

mod scalar;
#[cfg(target_arch = "x86_64")]
mod x86;

use super::rays::{GROUP, RaySet};
use umbrage_accel::{NodeView, View};
#[cfg(target_arch = "x86_64")]
use umbrage_geom::simd::Avx2;
use umbrage_geom::{
    kernel::{BlockMask, TriangleBlock, fan},
    simd::{BackEnd, Dispatch},
};

/// Children of a node, triangles of a leaf, rays of a group.
pub(crate) const LANES: usize = 8;

/// Entries of [`Stack`]: the most that a walk can push, every child once for each four groups, and room for writing a whole
/// node at once.
const STACK: usize = (LANES - 1) * View::MAX_LEVELS * (super::rays::GROUPS / 4) + 2 * LANES;

/// What the end of an interval is multiplied by: a box coordinate, a reciprocal and their product carry one rounding each, on
/// either side.
pub(crate) const INTERVAL_WIDENING: f32 = 1.0 + 16.0 / (1u32 << 24) as f32;

/// Added to squared lengths, so that they stay bounds where squares vanish.
pub(crate) const MIN_SQUARED_LENGTH: f32 = 1e-30;

/// Children to visit.
pub(crate) struct Stack {
    /// References as in [`NodeView::children`].
    pub(crate) children: Box<[u32; STACK]>,
    /// Groups that may enter, a bit each; or the numbers of four groups, a byte each, if there are rays.
    pub(crate) groups: Box<[u32; STACK]>,
    /// Rays of those four groups that may enter, or 0.
    pub(crate) rays: Box<[u32; STACK]>,
}

impl Stack {
    pub(crate) fn new() -> Self {
        // Never built in place and moved: memory that no walk gets to is never touched.
        let row = || vec![0; STACK].try_into().expect("as long");
        Self { children: row(), groups: row(), rays: row() }
    }
}

/// The number of ray `bit` of an entry with the groups `ids`.
#[inline(always)]
pub(crate) fn ray_of(ids: u32, bit: u32) -> usize {
    (ids >> (bit & 24) & 31) as usize * GROUP + (bit & 7) as usize
}

/// Boxes of a node's children relative to the receiver, in rows: smallest x, largest x, smallest y, ..
#[derive(Clone, Copy)]
#[repr(C, align(64))]
pub(crate) struct Rows(pub(crate) [[f32; LANES]; 6]);

/// Spheres around boxes, prepared for tests against cones.
///
/// A sphere of radius `R` at distance `D` meets the cone of half-angle `a` around `g` if `g . c >= D cos(a + b)` with
/// `sin b = R / D`: that is `g . c - cos(a) A + sin(a) R >= 0` with `A = sqrt(D^2 - R^2)`.
#[derive(Clone, Copy)]
#[repr(C, align(64))]
pub(crate) struct Spheres {
    pub(crate) center: [[f32; LANES]; 3],
    /// More than the test can err by.
    pub(crate) slack: [f32; LANES],
    /// `A`; 0 if the receiver is inside, or nearly.
    pub(crate) tangent: [f32; LANES],
    /// `R`; infinite if the receiver is inside, or nearly.
    pub(crate) radius: [f32; LANES],
}

/// A part of space, relative to the receiver, that no ray leaves: a ball, a half-space and a cone.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Hull {
    /// Radius of the ball, rounded up.
    pub(crate) radius: f32,
    /// Squared radius of the ball, rounded up.
    pub(crate) radius2: f32,
    /// Unit vector into the half-space.
    pub(crate) up: [f32; 3],
    /// By axis: whether the corner of a box that is farthest up is at its smallest coordinate.
    pub(crate) down: [usize; 3],
    /// Axis of the cone.
    pub(crate) axis: [f32; 3],
    /// Cosine and sine of its half-angle.
    pub(crate) angle: [f32; 2],
}

impl Hull {
    pub(crate) fn new(radius: f32, up: [f32; 3], axis: [f32; 3], angle: [f32; 2]) -> Self {
        let radius = radius * (1.0 + 1e-5);
        let mut down = [0; 3];
        for axis in 0..3 {
            down[axis] = usize::from(up[axis] < 0.0);
        }
        // Boxes nearer than this aren't told apart: their squares may vanish.
        Self { radius, radius2: (radius * radius).max(1e-30), up, down, axis, angle }
    }
}

/// A leaf seen from the receiver, prepared for tests against cones.
#[derive(Clone, Copy)]
#[repr(C, align(64))]
pub(crate) struct LeafRows {
    pub(crate) planes: fan::scalar::Planes,
    /// Length of each edge plane's normal.
    pub(crate) lengths: [[f32; LANES]; 3],
}

/// One step's work on some instruction set.
pub(crate) trait Kernel: Copy {
    /// A leaf seen from the receiver.
    type Planes: Copy;

    /// Boxes of `node` relative to `origin`.
    fn rows(self, node: NodeView<'_>, origin: [f32; 3]) -> Rows;

    /// Children that reach into `hull`; of no meaning in empty slots.
    fn inside(self, rows: &Rows, hull: &Hull) -> u32;

    /// Children whose boxes hold the origin, so that all rays enter them; of no meaning in empty slots.
    fn around(self, rows: &Rows) -> u32;

    /// Spheres around the children.
    fn spheres(self, rows: &Rows) -> Spheres;

    /// Children whose spheres meet the cone around all rays.
    fn ahead(self, spheres: &Spheres, hull: &Hull) -> u32;

    /// Groups of `rays` that may meet sphere `child`.
    fn cones(self, spheres: &Spheres, child: usize, rays: &RaySet) -> u32;

    /// Groups of `rays` that may meet box `child`, by the boxes around their directions.
    fn box_groups(self, rows: &Rows, child: usize, rays: &RaySet, hull: &Hull) -> u32;

    /// Rays of `group` that may meet box `child`, a bit each.
    fn box_rays(self, rows: &Rows, child: usize, rays: &RaySet, group: usize) -> u32;

    /// Pushes those of the `wanted` children that some of the rays in `left` (of the groups `ids`) may enter, each with the
    /// rays that may. Returns the new height of the stack.
    #[allow(clippy::too_many_arguments)] // the state of one loop
    fn push_rays(
        self,
        children: &[u32; LANES],
        rows: &Rows,
        rays: &RaySet,
        ids: u32,
        left: u32,
        wanted: u32,
        stack: &mut Stack,
        top: usize,
    ) -> usize;

    /// See [`umbrage_geom::kernel::fan`].
    fn planes(self, block: &TriangleBlock, origin: [f32; 3]) -> Self::Planes;

    /// See [`umbrage_geom::kernel::fan::scalar::Planes::ask_sides`].
    fn ask_sides(self, planes: &mut Self::Planes, block: &TriangleBlock, origin: [f32; 3], lanes: u8);

    /// Planes in rows.
    fn leaf_rows(self, planes: &Self::Planes) -> LeafRows;

    /// Triangles that ray number `ray` hits.
    fn ray_lanes(self, planes: &Self::Planes, rays: &RaySet, ray: usize) -> BlockMask;

    /// Triangles that reach above the plane of `hull`.
    fn above(self, block: &TriangleBlock, origin: [f32; 3], hull: &Hull) -> u32;

    /// Triangles whose planes come as near as `hull` reaches.
    fn near(self, rows: &LeafRows, hull: &Hull) -> u32;

    /// Groups with a ray that may hit the triangle in `lane`.
    fn lane_groups(self, rows: &LeafRows, lane: usize, rays: &RaySet) -> u32;

    /// Rays of `group` that hit the triangle in `lane`.
    fn lane_rays(self, rows: &LeafRows, lane: usize, rays: &RaySet, group: usize) -> BlockMask;

    /// Asks for the cache lines of `bytes` bytes from `target`, which may be any address.
    fn prefetch(self, target: *const u8, bytes: usize);
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
        self.0.run(scalar::Scalar)
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
