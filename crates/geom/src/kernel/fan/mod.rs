//! Rays that share an origin: what a block of triangles looks like from there is worked out once, and each ray then costs
//! three dot products.
//!
//! Here: the prepared rays and why the filter can be trusted. Its back ends are [`scalar`] and `x86`.
//!
//! # The filter
//! Notation as in the [parent module](super): `u = 2^-24`, `A = a - o` and so on, edges `e_a = b - c`, `e_b = c - a`,
//! `e_c = a - b`. The edge determinants are dot products with three normals that no ray changes:
//! `U = d . (C x e_a)`, `V = d . (A x e_b)`, `W = d . (B x e_c)`. The line meets the plane at `t = T / (U + V + W)` with
//! `T = -A . (e_b x e_c)`. Directions are scaled by a power of two so that the sizes of their components add up to at most
//! 1 and at least 1/2.
//!
//! # Bound for the edges
//! Let `L` be the largest component of `A`, `B`, `C` and `l` that of the edges; both are differences rounded once. A
//! component of a normal is at most `2 L l` and errs by `4.1 u` of that; a dot product adds three roundings: in all
//! `14.3 u L l`. The filter uses `E = 16 u L l + 2^-126`. Taking edges from the vertices, not from `A`, `B` and `C`, is what
//! makes this small: the error shrinks with the triangle, not only with its distance.
//!
//! # Bound for the depth
//! `T` errs by at most `3 L (4.1 + 1 + 3) u 2 l^2 < 49 u L l^2`; for edges of one sign `D = |U + V + W|` errs by
//! `3 E + 2 u D`. Hence `T - z D`, evaluated, errs by less than `72 u L l^2 + z (3.1 E + 8 u D) + 2^-100` and a part `u` of
//! itself. A hit can't be further than `6.1 L`, since some component of the direction is at least 1/6.
//! Nothing is certain where `L >= 2^40`.

pub mod scalar;
#[cfg(target_arch = "x86_64")]
pub mod x86;

use super::UNIT;
use crate::Ray;
use glam::Vec3;

/// `16 u`.
const EDGE_ERROR: f32 = 16.0 * UNIT;
/// `72 u`.
const VOLUME_ERROR: f32 = 72.0 * UNIT;
/// `8 u`.
const DEPTH_ERROR: f32 = 8.0 * UNIT;
/// Longest way to a triangle, in units of `L`.
const REACH: f32 = 6.1;

/// `2^40 (1 - 2^-21)`.
const SLAB_DOWN: f32 = (1u64 << 40) as f32 * (1.0 - 1.0 / (1 << 21) as f32);
/// `2^40 (1 + 2^-21)`.
const SLAB_UP: f32 = (1u64 << 40) as f32 * (1.0 + 1.0 / (1 << 21) as f32);
const POW_79: f32 = (1u128 << 79) as f32;
const POW_87: f32 = (1u128 << 87) as f32;
/// `2^86`, most that the sizes of a direction's components may add up to.
const LARGEST_SIZE: f32 = (1u128 << 86) as f32;
const SMALLEST_SIZE: f32 = 1.0 / LARGEST_SIZE;

/// What pads a chunk.
const IDLE: Ray = Ray { origin: Vec3::ZERO, direction: Vec3::X, tnear: 0.0, tfar: 1.0 };

/// Rays prepared together at most by [`FanRays::prepare`].
pub const CHUNK: usize = 16;

/// Up to `N` rays from one origin, prepared for boxes and triangles; one ray a column.
///
/// The slab part is that of [`crate::SlabRay`], with the same argument for why it can't miss.
#[derive(Clone, Debug)]
#[repr(C, align(64))]
pub struct FanRays<const N: usize> {
    /// By axis. Scaled as the module says.
    pub direction: [[f32; N]; 3],
    /// Start of the segment in units of the scaled direction, exact.
    pub near: [f32; N],
    /// End of the segment in the same units, exact, or infinite.
    pub far: [f32; N],
    /// By axis: reciprocal for near planes, towards 0; for slabs, whose `t` is `2^40` times that of `near`.
    pub inv_near: [[f32; N]; 3],
    /// By axis: reciprocal for far planes, away from 0.
    pub inv_far: [[f32; N]; 3],
    /// By axis: 1 where the direction is negative, or negative zero.
    pub negative: [[u32; N]; 3],
    /// Start of the segment for slabs, rounded down.
    pub slab_near: [f32; N],
    /// End of the segment for slabs, rounded up.
    pub slab_far: [f32; N],
}

/// Reciprocals of the `size` of a direction's component, for near and for far planes; see [`FanRays`].
#[inline(always)]
pub fn slab_inverse(size: f32) -> [f32; 2] {
    let inverse = 1.0 / size;
    let near = if inverse < POW_79 { inverse } else { POW_79 } * SLAB_DOWN;
    let far = if size < 1.0 / (2.0 * POW_79) { f32::INFINITY } else { inverse * SLAB_UP };
    [near, far]
}

/// The columns of a row from `at`.
#[inline(always)]
fn chunk<T, const N: usize>(row: &mut [T; N], at: usize) -> &mut [T; CHUNK] {
    (&mut row[at..at + CHUNK]).try_into().expect("as long as a chunk")
}

impl<const N: usize> Default for FanRays<N> {
    fn default() -> Self {
        let (rows, row) = ([[0.0; N]; 3], [0.0; N]);
        Self {
            direction: rows,
            near: row,
            far: row,
            inv_near: rows,
            inv_far: rows,
            negative: [[0; N]; 3],
            slab_near: row,
            slab_far: row,
        }
    }
}

impl<const N: usize> FanRays<N> {
    /// Prepares up to [`CHUNK`] `rays` into the columns from `at`; all origins must be the same finite point.
    ///
    /// Bit `i` of the result is set for rays that the fan can answer. The others are not valid, or their direction or
    /// segment is of extreme size (beyond `2^86`): they need a query of their own.
    ///
    /// # Panics
    /// If `rays` are too many for a chunk, or for the columns.
    #[inline(always)]
    pub fn prepare(&mut self, at: usize, rays: &[Ray]) -> u32 {
        if let Ok(full) = rays.try_into() {
            return self.prepare_chunk(at, full);
        }
        let mut padded = [IDLE; CHUNK];
        padded[..rays.len()].copy_from_slice(rays);
        self.prepare_chunk(at, &padded) & ((1 << rays.len()) - 1)
    }

    #[inline(always)]
    fn prepare_chunk(&mut self, at: usize, rays: &[Ray; CHUNK]) -> u32 {
        let mut fit = [0u32; CHUNK];
        // One loop a step, so that each becomes SIMD.
        let mut scale = [0.0; CHUNK];
        let mut d = [[0.0; CHUNK]; 3];
        for i in 0..CHUNK {
            let direction = rays[i].direction;
            (d[0][i], d[1][i], d[2][i]) = (direction.x, direction.y, direction.z);
        }
        for i in 0..CHUNK {
            let size = d[0][i].abs() + d[1][i].abs() + d[2][i].abs();
            let sane = (SMALLEST_SIZE..=LARGEST_SIZE).contains(&size);
            fit[i] = u32::from(sane);
            // 2 to the power of -1 - exponent.
            scale[i] = f32::from_bits((253u32 << 23).wrapping_sub(size.to_bits() & (0xff << 23)));
        }
        for (axis, d) in d.iter().enumerate() {
            let direction: &mut [f32; CHUNK] = chunk(&mut self.direction[axis], at);
            let inv_near: &mut [f32; CHUNK] = chunk(&mut self.inv_near[axis], at);
            let inv_far: &mut [f32; CHUNK] = chunk(&mut self.inv_far[axis], at);
            let negative: &mut [u32; CHUNK] = chunk(&mut self.negative[axis], at);
            for i in 0..CHUNK {
                let x = d[i] * scale[i];
                let [near, far] = slab_inverse(x.abs());
                direction[i] = x;
                inv_near[i] = near.copysign(x);
                inv_far[i] = far.copysign(x);
                negative[i] = x.to_bits() >> 31;
            }
        }
        let (near, far) = (chunk(&mut self.near, at), chunk(&mut self.far, at));
        let (slab_near, slab_far) = (chunk(&mut self.slab_near, at), chunk(&mut self.slab_far, at));
        for i in 0..CHUNK {
            let Ray { tnear, tfar, .. } = rays[i];
            // 2 to the power of exponent + 1.
            let unscale = f32::from_bits((254u32 << 23).wrapping_sub(scale[i].to_bits()));
            (near[i], far[i]) = (tnear * unscale, tfar * unscale);
            let exact = (tnear == 0.0 || near[i] >= f32::MIN_POSITIVE) && far[i] >= f32::MIN_POSITIVE;
            fit[i] &= u32::from(exact && tnear >= 0.0 && tnear < tfar);
            let start = if near[i] < POW_87 { near[i] } else { POW_87 } * SLAB_DOWN;
            slab_near[i] = if start < f32::MIN_POSITIVE { 0.0 } else { start };
            let end = far[i] * SLAB_UP;
            slab_far[i] = if end > f32::MIN_POSITIVE { end } else { f32::MIN_POSITIVE };
        }
        let mut mask = 0;
        for (i, fit) in fit.iter().enumerate() {
            mask |= fit << i;
        }
        mask
    }
}
