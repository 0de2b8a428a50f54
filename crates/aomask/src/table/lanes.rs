//! Eight numbers at a time, and masks of words: plain loops that the compiler vectorizes.
//!
//! Everything is `inline(always)`: what is not inlined into a back end's shell lacks its instructions. That rules out
//! `array::map` and `array::from_fn`, whose insides the compiler may keep apart.

use std::ops::{Add, Div, Mul, Sub};

/// Eight numbers, one a lane.
#[derive(Clone, Copy, Debug)]
#[repr(align(32))]
pub(crate) struct F8(pub(crate) [f32; 8]);

macro_rules! operator {
    ($trait:ident, $method:ident) => {
        impl $trait for F8 {
            type Output = Self;

            #[inline(always)]
            fn $method(mut self, other: Self) -> Self {
                for i in 0..8 {
                    self.0[i] = self.0[i].$method(other.0[i]);
                }
                self
            }
        }
    };
}
operator!(Add, add);
operator!(Sub, sub);
operator!(Mul, mul);
operator!(Div, div);

impl F8 {
    pub(crate) const ZERO: Self = Self([0.0; 8]);

    #[inline(always)]
    pub(crate) fn splat(x: f32) -> Self {
        Self([x; 8])
    }

    /// The smaller of each pair, the second if one is NaN.
    #[inline(always)]
    pub(crate) fn min(mut self, other: Self) -> Self {
        for i in 0..8 {
            self.0[i] = if self.0[i] < other.0[i] { self.0[i] } else { other.0[i] };
        }
        self
    }

    /// The larger of each pair, the second if one is NaN.
    #[inline(always)]
    pub(crate) fn max(mut self, other: Self) -> Self {
        for i in 0..8 {
            self.0[i] = if self.0[i] > other.0[i] { self.0[i] } else { other.0[i] };
        }
        self
    }

    #[inline(always)]
    pub(crate) fn abs(mut self) -> Self {
        for i in 0..8 {
            self.0[i] = self.0[i].abs();
        }
        self
    }

    #[inline(always)]
    pub(crate) fn sqrt(mut self) -> Self {
        for i in 0..8 {
            self.0[i] = self.0[i].sqrt();
        }
        self
    }

    /// 1 with the signs of the lanes.
    #[inline(always)]
    pub(crate) fn signum(mut self) -> Self {
        for i in 0..8 {
            self.0[i] = 1f32.copysign(self.0[i]);
        }
        self
    }

    /// `self` where the bit is set, else `other`.
    #[inline(always)]
    pub(crate) fn select(mut self, bits: u32, other: Self) -> Self {
        for i in 0..8 {
            self.0[i] = if bits >> i & 1 == 1 { self.0[i] } else { other.0[i] };
        }
        self
    }

    /// Bits of the lanes with `self <= other`; not where one is NaN.
    #[inline(always)]
    pub(crate) fn le(self, other: Self) -> u32 {
        let mut bits = 0;
        for i in 0..8 {
            bits |= u32::from(self.0[i] <= other.0[i]) << i;
        }
        bits
    }

    /// Bits of the lanes with `self < other`; not where one is NaN.
    #[inline(always)]
    pub(crate) fn lt(self, other: Self) -> u32 {
        let mut bits = 0;
        for i in 0..8 {
            bits |= u32::from(self.0[i] < other.0[i]) << i;
        }
        bits
    }

    /// Each lane rounded to the nearest integer, for lanes in `[0, 2^22]`.
    #[inline(always)]
    pub(crate) fn nearest(self) -> U8 {
        // In numbers from 2^23 on, the last bit of the significand counts ones.
        const ONES: f32 = (1u32 << 23) as f32;
        let mut out = [0; 8];
        for (i, out) in out.iter_mut().enumerate() {
            *out = (self.0[i] + ONES).to_bits() & 0x7f_ffff;
        }
        U8(out)
    }
}

/// Eight integers.
#[derive(Clone, Copy, Debug)]
#[repr(align(32))]
pub(crate) struct U8(pub(crate) [u32; 8]);

impl U8 {
    /// `self + factor * other`, modulo 2^32.
    #[inline(always)]
    pub(crate) fn plus(mut self, factor: u32, other: Self) -> Self {
        for i in 0..8 {
            self.0[i] = self.0[i].wrapping_add(factor.wrapping_mul(other.0[i]));
        }
        self
    }
}

/// Eight vectors.
#[derive(Clone, Copy, Debug)]
pub(crate) struct V8 {
    pub(crate) x: F8,
    pub(crate) y: F8,
    pub(crate) z: F8,
}

impl V8 {
    #[inline(always)]
    pub(crate) fn new(x: F8, y: F8, z: F8) -> Self {
        Self { x, y, z }
    }

    /// Rows of three axes.
    #[inline(always)]
    pub(crate) fn from_rows(rows: &[[f32; 8]; 3]) -> Self {
        Self { x: F8(rows[0]), y: F8(rows[1]), z: F8(rows[2]) }
    }

    #[inline(always)]
    pub(crate) fn splat(v: [f32; 3]) -> Self {
        Self { x: F8::splat(v[0]), y: F8::splat(v[1]), z: F8::splat(v[2]) }
    }

    #[inline(always)]
    pub(crate) fn dot(self, other: Self) -> F8 {
        self.x * other.x + self.y * other.y + self.z * other.z
    }

    #[inline(always)]
    pub(crate) fn cross(self, other: Self) -> Self {
        Self {
            x: self.y * other.z - self.z * other.y,
            y: self.z * other.x - self.x * other.z,
            z: self.x * other.y - self.y * other.x,
        }
    }

    #[inline(always)]
    pub(crate) fn scale(self, factor: F8) -> Self {
        Self { x: self.x * factor, y: self.y * factor, z: self.z * factor }
    }

    #[inline(always)]
    pub(crate) fn min(self, other: Self) -> Self {
        Self { x: self.x.min(other.x), y: self.y.min(other.y), z: self.z.min(other.z) }
    }

    #[inline(always)]
    pub(crate) fn max(self, other: Self) -> Self {
        Self { x: self.x.max(other.x), y: self.y.max(other.y), z: self.z.max(other.z) }
    }

    #[inline(always)]
    pub(crate) fn abs(self) -> Self {
        Self { x: self.x.abs(), y: self.y.abs(), z: self.z.abs() }
    }

    /// Largest component of each vector.
    #[inline(always)]
    pub(crate) fn largest(self) -> F8 {
        self.x.max(self.y).max(self.z)
    }

    #[inline(always)]
    pub(crate) fn lane(&self, i: usize) -> [f32; 3] {
        [self.x.0[i], self.y.0[i], self.z.0[i]]
    }

    pub(crate) fn set_lane(&mut self, i: usize, v: [f32; 3]) {
        (self.x.0[i], self.y.0[i], self.z.0[i]) = (v[0], v[1], v[2]);
    }
}

impl Add for V8 {
    type Output = Self;

    #[inline(always)]
    fn add(self, other: Self) -> Self {
        Self { x: self.x + other.x, y: self.y + other.y, z: self.z + other.z }
    }
}

impl Sub for V8 {
    type Output = Self;

    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        Self { x: self.x - other.x, y: self.y - other.y, z: self.z - other.z }
    }
}

/// Rays in both masks.
#[inline(always)]
pub(crate) fn and<const W: usize>(a: &[u64; W], b: &[u64; W]) -> [u64; W] {
    let mut out = *a;
    for w in 0..W {
        out[w] &= b[w];
    }
    out
}

/// Number of rays in `mask` that are not in `blocked`.
#[inline(always)]
pub(crate) fn gain<const W: usize>(mask: &[u64; W], blocked: &[u64; W]) -> u32 {
    let mut sum = 0;
    for w in 0..W {
        sum += (mask[w] & !blocked[w]).count_ones();
    }
    sum
}
