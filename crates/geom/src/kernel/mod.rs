//! Blocks of triangles tested together: an `f32` filter before the exact predicate.
//!
//! Here: the block, the prepared ray and why the filter can be trusted. Not here: the predicate itself
//! ([`crate::segment_hits_triangle`]), which decides what a filter leaves open. The back ends ([`scalar`], `x86`) may round
//! differently and so leave different lanes open; what they call certain is true in all of them.
//!
//! # The filter
//! Notation: `u = 2^-24`, `z` the axis where `|d|` is largest, `s` the sign of `d.z`, `A = a - o` and so on. After Woop et
//! al. (2013): depths `A.z' = s A.z`, slopes `Sx = d.x / |d.z|`, sheared coordinates `A'.x = A.x - Sx A.z'`, edges
//! `U = C'.x B'.y - C'.y B'.x`, `V = A'.x C'.y - A'.y C'.x`, `W = B'.x A'.y - B'.y A'.x`. These are the edge determinants of
//! [`crate::triangle`] up to one common factor, and where they agree in sign the line meets the triangle at the depth
//! `z = (U A.z' + V B.z' + W C.z') / (U + V + W) = t |d.z|`, between the least and the greatest of the three.
//!
//! # Bound for the edges
//! Let `m` be the largest sheared `|x|` or `|y|` and `M` that plus the largest `|z|`. Differences and slopes carry one
//! rounding each, `|S| <= 1`, so a sheared coordinate errs by at most `u |A.x| + 3 u |A.z| + u |A'.x| <= 4.1 u M`, the
//! numbers computed standing for the exact ones. With `e = 5 u M` a product errs by `2 m e + e^2`, and evaluating an edge
//! adds at most `4 u m^2`: in all `24 u M m + 50 u^2 M^2`. The filter uses `E = 32 u M (m + 4 u M) + 2^-126`: a third more,
//! for the rounding of `E` itself; `2^-126` is more than all underflow. Nothing is certain unless `M < 2^40`, so no product
//! below overflows. An edge beyond `E` has its sign for certain.
//!
//! # Bound for the depth
//! The depths `A.z'` are differences rounded once, which keeps their order relative to any `f32`: comparing the least and
//! the greatest with `tnear |d.z|` and `tfar |d.z|`, each rounded outwards, mostly settles the interval. Otherwise, for
//! edges of one sign, `T' = U A.z' + V B.z' + W C.z'` is compared with `z D'`, `D' = U + V + W`, for `z` one end. `T'` errs by
//! at most `Z (3 E + 5 u |D'|)`, `Z` the largest `|z|`, and `z D'` by `|z| (3 E + 4 u |D'|)`; with the subtraction
//! `(Z + |z|) (3 E + 6 u |D'|)`. The filter uses `8 u` and adds `2^-100`. Ends so small that their product with `|d.z|`
//! underflows, or so large that it might overflow, are left open (NaN).

pub mod fan;
mod grid;
pub mod scalar;
#[cfg(target_arch = "x86_64")]
pub mod x86;

pub use grid::{BoxBlock, CellBlock};

use crate::Ray;

/// `a` if it is smaller, else `b`; so `b` if either is NaN. One instruction.
#[inline(always)]
pub fn smaller(a: f32, b: f32) -> f32 {
    if a < b { a } else { b }
}

/// `a` if it is larger, else `b`; so `b` if either is NaN.
#[inline(always)]
pub fn larger(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}

/// Triangles in a block.
pub const LANES: usize = 8;

/// `u`.
const UNIT: f32 = 1.0 / (1u32 << 24) as f32;
/// `32 u`.
const EDGE_ERROR: f32 = 32.0 / (1u32 << 24) as f32;
/// `4 u`.
const SHEAR_ERROR: f32 = 4.0 / (1u32 << 24) as f32;
/// `8 u`.
const DEPTH_ERROR: f32 = 8.0 / (1u32 << 24) as f32;
/// More than all underflow in a depth comparison: `2^-100`.
const DEPTH_UNDERFLOW: f32 = f32::MIN_POSITIVE * (1u32 << 26) as f32;
/// Slope below which [`TriangleBlock::above`] trusts no sign.
const ABOVE_SLOPE: f32 = 1e-5;
/// Size of `M` from which nothing is certain: `2^40`.
const LARGEST: f32 = (1u64 << 40) as f32;

/// Up to eight triangles over up to eight vertices: two cache lines. Triangles are lanes 0, 1, ..
///
/// Triangles that lie together share vertices: six of a strip have eight. A block is so less than half the size of three
/// corners a lane, which is worth more than the shuffles that put corners into lanes: large scenes wait for memory.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(128))]
pub struct TriangleBlock {
    /// By axis, vertex.
    vertices: [[f32; LANES]; 3],
    /// By corner, lane: the number of its vertex, below 8.
    corners: [[u8; LANES]; 3],
    /// Triangles.
    len: u32,
    /// For the block's owner.
    pub tag: u32,
}

impl TriangleBlock {
    /// No triangle.
    pub const EMPTY: Self = Self { vertices: [[0.0; LANES]; 3], corners: [[0; LANES]; 3], len: 0, tag: 0 };

    /// Triangles over shared vertices, all finite; `None` if there are more than eight of either, or a corner names no
    /// vertex.
    pub fn new(vertices: &[[f32; 3]], triangles: &[[u8; 3]]) -> Option<Self> {
        let known = |&corner: &u8| usize::from(corner) < vertices.len();
        if vertices.len() > LANES || triangles.len() > LANES || !triangles.as_flattened().iter().all(known) {
            return None;
        }
        let mut this = Self { len: triangles.len() as u32, ..Self::EMPTY };
        this.move_vertices(vertices);
        for (lane, triangle) in triangles.iter().enumerate() {
            for (lanes, &corner) in this.corners.iter_mut().zip(triangle) {
                lanes[lane] = corner;
            }
        }
        Some(this)
    }

    /// Adds a triangle, its vertices shared with those of the same bits before it; false if there is no room, which
    /// changes nothing. `vertices`, of which it says how many are used so far, starts at 0.
    pub fn push(&mut self, triangle: [[f32; 3]; 3], vertices: &mut usize) -> bool {
        let lane = self.len();
        if lane == LANES {
            return false;
        }
        let (before, used) = (*self, *vertices);
        for (corner, vertex) in triangle.into_iter().enumerate() {
            let same =
                |&i: &usize| (0..3).all(|axis| self.vertices[axis][i].to_bits() == vertex[axis].to_bits());
            let place = (0..*vertices).find(same).unwrap_or(*vertices);
            if place == LANES {
                (*self, *vertices) = (before, used);
                return false;
            }
            *vertices = (*vertices).max(place + 1);
            (0..3).for_each(|axis| self.vertices[axis][place] = vertex[axis]);
            self.corners[corner][lane] = place as u8;
        }
        self.len += 1;
        true
    }

    /// Gives the first vertices other places.
    ///
    /// # Panics
    /// If there are more than eight.
    pub fn move_vertices(&mut self, vertices: &[[f32; 3]]) {
        for (i, vertex) in vertices.iter().enumerate() {
            for (row, &x) in self.vertices.iter_mut().zip(vertex) {
                row[i] = x;
            }
        }
    }

    /// Number of triangles.
    #[inline]
    pub fn len(&self) -> usize {
        self.len as usize
    }

    /// Whether there is no triangle.
    #[inline]
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// One bit for each triangle.
    #[inline]
    fn used(&self) -> u8 {
        ((1u32 << self.len) - 1) as u8
    }

    /// The triangle in `lane`; that of some vertices if there is none.
    ///
    /// # Panics
    /// If `lane` is not below [`LANES`].
    #[inline]
    pub fn get(&self, lane: usize) -> [[f32; 3]; 3] {
        self.corners.map(|corner| {
            let vertex = usize::from(corner[lane]) % LANES;
            [self.vertices[0][vertex], self.vertices[1][vertex], self.vertices[2][vertex]]
        })
    }

    /// Triangles with a corner that is not for certain below the plane through `origin` across `up`, a vector of at most unit
    /// length; one bit each. Corners within a slope of 1e-5 of the plane count as above.
    #[inline]
    pub fn above(&self, origin: [f32; 3], up: [f32; 3]) -> u8 {
        let mut heights = [0f32; LANES];
        for axis in 0..3 {
            for (height, &x) in heights.iter_mut().zip(&self.vertices[axis]) {
                let x = x - origin[axis];
                *height += x * up[axis] + x.abs() * ABOVE_SLOPE;
            }
        }
        // NaN counts as above.
        let below = |row: &[u8; LANES], lane: usize| heights[usize::from(row[lane]) % LANES] < 0.0;
        let above = |lane: usize| self.corners.iter().any(|row| !below(row, lane));
        (0..self.len()).fold(0, |mask, lane| mask | u8::from(above(lane)) << lane)
    }

    /// All corners by corner, axis, lane; NaN in unused lanes.
    #[inline(always)]
    pub fn corners(&self) -> [[[f32; LANES]; 3]; 3] {
        self.corners.map(|vertices| {
            self.vertices.map(|row| {
                let mut lanes = vertices.map(|vertex| row[usize::from(vertex) % LANES]);
                for (lane, x) in lanes.iter_mut().enumerate() {
                    *x = if lane < self.len() { *x } else { f32::NAN };
                }
                lanes
            })
        })
    }
}

/// Up to eight triangles with corners of their own, a lane each: gathered to be tested once. [`TriangleBlock`] takes less
/// memory.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(32))]
pub struct TriangleLanes {
    /// By corner, axis, lane.
    corners: [[[f32; LANES]; 3]; 3],
    used: u8,
}

impl TriangleLanes {
    /// No triangle.
    pub const EMPTY: Self = Self { corners: [[[0.0; LANES]; 3]; 3], used: 0 };

    /// Puts a triangle of finite corners into `lane`.
    ///
    /// # Panics
    /// If `lane` is not below [`LANES`].
    #[inline]
    pub fn set(&mut self, lane: usize, corners: [[f32; 3]; 3]) {
        for (rows, corner) in self.corners.iter_mut().zip(corners) {
            for (row, x) in rows.iter_mut().zip(corner) {
                row[lane] = x;
            }
        }
        self.used |= 1 << lane;
    }
}

mod lanes {
    /// Triangles in lanes, however they are stored.
    pub trait Lanes {
        /// One bit for each lane in use.
        fn used(&self) -> u8;

        /// The triangle in `lane`.
        fn triangle(&self, lane: usize) -> [[f32; 3]; 3];

        /// Coordinate `axis` of one corner of each triangle.
        ///
        /// # Safety
        /// AVX2.
        #[cfg(target_arch = "x86_64")]
        unsafe fn corner(&self, corner: usize, axis: usize) -> std::arch::x86_64::__m256;
    }
}
pub(crate) use lanes::Lanes;

impl Lanes for TriangleBlock {
    #[inline(always)]
    fn used(&self) -> u8 {
        self.used()
    }

    #[inline(always)]
    fn triangle(&self, lane: usize) -> [[f32; 3]; 3] {
        self.get(lane)
    }

    #[cfg(target_arch = "x86_64")]
    #[inline(always)]
    unsafe fn corner(&self, corner: usize, axis: usize) -> std::arch::x86_64::__m256 {
        // SAFETY: as of this function.
        unsafe { x86::corner(self, corner, axis) }
    }
}

impl Lanes for TriangleLanes {
    #[inline(always)]
    fn used(&self) -> u8 {
        self.used
    }

    #[inline(always)]
    fn triangle(&self, lane: usize) -> [[f32; 3]; 3] {
        self.corners.map(|corner| corner.map(|lanes| lanes[lane]))
    }

    #[cfg(target_arch = "x86_64")]
    #[inline(always)]
    unsafe fn corner(&self, corner: usize, axis: usize) -> std::arch::x86_64::__m256 {
        // SAFETY: as of this function; a row is eight aligned floats.
        unsafe { std::arch::x86_64::_mm256_load_ps(self.corners[corner][axis].as_ptr()) }
    }
}

/// What a filter says about a block, one bit per lane. A lane in neither mask is certainly not hit, or unused.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct BlockMask {
    /// Triangles that [`crate::segment_hits_triangle`] is sure to report.
    pub certain: u8,
    /// Triangles that it must decide.
    pub uncertain: u8,
}

/// A valid ray prepared for filters.
#[derive(Clone, Copy, Debug)]
pub struct BlockRay {
    /// Coordinates `x`, `y`, `z` of the filter, each below 3.
    axes: [usize; 3],
    /// By those axes.
    origin: [f32; 3],
    /// `Sx`, `Sy`.
    slopes: [f32; 2],
    /// `s`.
    sign: f32,
    /// `|d.z|`.
    length: f32,
    near: End,
    far: End,
}

/// One end of the segment as depths `t |d.z|`.
#[derive(Clone, Copy, Debug)]
struct End {
    /// At most the exact depth.
    below: f32,
    /// At least the exact depth.
    above: f32,
    /// With one rounding, or NaN where that can't be had.
    rounded: f32,
}

impl End {
    #[inline(always)]
    fn new(t: f32, length: f32) -> Self {
        if t == 0.0 || t == f32::INFINITY {
            return Self { below: t, above: t, rounded: t };
        }
        let rounded = t * length;
        let large = rounded >= LARGEST * 2.0;
        let usable = rounded > f32::MIN_POSITIVE && !large;
        Self {
            below: if usable { rounded * (1.0 - 4.0 * UNIT) } else { 0.0 },
            above: if large { f32::INFINITY } else { rounded * (1.0 + 4.0 * UNIT) + f32::MIN_POSITIVE },
            rounded: if usable { rounded } else { f32::NAN },
        }
    }
}

impl BlockRay {
    /// Prepares `ray`; `None` if it is not [valid](Ray::is_valid).
    #[inline(always)]
    pub fn new(ray: &Ray) -> Option<Self> {
        if !ray.is_valid() {
            return None;
        }
        // Without branches, which random directions would mispredict.
        let size = ray.direction.abs();
        let (z, larger) = if size.x > size.y { (0, size.x) } else { (1, size.y) };
        let (z, length) = if larger > size.z { (z, larger) } else { (2, size.z) };
        let axes = [[1, 2, 0], [2, 0, 1], [0, 1, 2]][z];
        let (origin, direction) = (ray.origin.to_array(), ray.direction.to_array());
        Some(Self {
            axes,
            // Not by `map`, which is not inlined into functions with target features.
            origin: [origin[axes[0]], origin[axes[1]], origin[axes[2]]],
            slopes: [direction[axes[0]] / length, direction[axes[1]] / length],
            sign: 1f32.copysign(direction[z]),
            length,
            near: End::new(ray.tnear, length),
            far: End::new(ray.tfar, length),
        })
    }

    /// Ends the segment at `tfar`, which must be positive.
    #[inline]
    pub fn set_tfar(&mut self, tfar: f32) {
        self.far = End::new(tfar, self.length);
    }
}

#[cfg(test)]
mod tests;
