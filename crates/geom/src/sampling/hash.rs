//! Integer hashes that make seeds, and the stream of random numbers that starts from one.

use rand_pcg::Pcg32;

/// Largest `f32` below 1.
pub const ONE_MINUS: f32 = 1.0 - f32::EPSILON / 2.0;

/// A bijective hash of 32 bits: neighbouring inputs give unrelated outputs, 0 included.
///
/// # Source
/// The three-round multiply-and-shift form found by Wellons's hash prospector, after adding a constant so that 0 does
/// not map to itself.
#[inline]
pub const fn hash(x: u32) -> u32 {
    let x = x.wrapping_add(0x9e37_79b9);
    let x = (x ^ (x >> 17)).wrapping_mul(0xed5a_d4bb);
    let x = (x ^ (x >> 11)).wrapping_mul(0xac4c_1b51);
    let x = (x ^ (x >> 15)).wrapping_mul(0x3184_8bab);
    x ^ (x >> 14)
}

/// One seed from two; the order matters.
#[inline]
pub const fn combine(a: u32, b: u32) -> u32 {
    hash(hash(a).wrapping_add(b))
}

/// Seed of pixel `(x, y)` of an image that is rendered with `seed`.
#[inline]
pub const fn pixel_seed(x: u32, y: u32, seed: u32) -> u32 {
    combine(combine(seed, x), y)
}

/// A number in `[0, 1)`, a multiple of 2^-24, from the upper bits of `bits`.
#[inline]
pub const fn unit(bits: u32) -> f32 {
    (bits >> 8) as f32 * (1.0 / (1 << 24) as f32)
}

/// A stream of random numbers (PCG XSH-RR 64/32) for `seed` and `stream`; different pairs give unrelated streams.
#[derive(Clone, Debug)]
pub struct RandomStream(Pcg32);

impl RandomStream {
    /// The start of a stream.
    pub fn new(seed: u32, stream: u32) -> Self {
        // Both go through the hash, since generators with related states or increments are correlated.
        let [a, b] = [combine(seed, stream), combine(stream ^ 0x5bd1_e995, seed)];
        let [c, d] = [hash(a ^ 0x68e3_1da4), hash(b ^ 0xb529_7a4d)];
        let wide = |high: u32, low: u32| u64::from(high) << 32 | u64::from(low);
        Self(Pcg32::new(wide(a, b), wide(c, d)))
    }

    /// The next 32 random bits.
    #[inline]
    pub fn next_bits(&mut self) -> u32 {
        use rand_pcg::rand_core::Rng as _;
        self.0.next_u32()
    }

    /// The next number in `[0, 1)`.
    #[inline]
    pub fn next_unit(&mut self) -> f32 {
        unit(self.next_bits())
    }

    /// The next integer in `0..bound`, each equally likely to within `bound / 2^32`; 0 if `bound` is 0.
    #[inline]
    pub fn next_below(&mut self, bound: u32) -> u32 {
        ((u64::from(self.next_bits()) * u64::from(bound)) >> 32) as u32
    }
}
