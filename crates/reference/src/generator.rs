//! Random numbers and directions that share no code with the samplers that are measured.

/// A stream of 64-bit numbers.
///
/// # Source
/// The mixing function of Steele, Lea and Flood, Fast Splittable Pseudorandom Number Generators, 2014.
#[derive(Clone, Debug)]
pub(crate) struct Generator(u64);

/// Step of the counter: the golden section in units of 2^-64, made odd.
const STEP: u64 = 0x9e37_79b9_7f4a_7c15;

/// Mixes the bits of `x`.
pub(crate) fn mix(x: u64) -> u64 {
    let x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    x ^ (x >> 31)
}

impl Generator {
    /// The stream number `stream` of `seed`.
    pub(crate) fn new(seed: u64, stream: u64) -> Self {
        Self(mix(seed.wrapping_add(STEP)).wrapping_add(mix(stream ^ 0x5851_f42d_4c95_7f2d)))
    }

    /// The next number in `[0, 1)`, a multiple of 2^-53.
    pub(crate) fn unit(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(STEP);
        (mix(self.0) >> 11) as f64 / (1u64 << 53) as f64
    }

    /// A random direction around the z axis, density `z / pi` per steradian: a point of the disc, by rejection, lifted to the
    /// hemisphere.
    pub(crate) fn cosine_direction(&mut self) -> [f64; 3] {
        loop {
            let (x, y) = (2.0 * self.unit() - 1.0, 2.0 * self.unit() - 1.0);
            let r2 = x * x + y * y;
            if r2 < 1.0 {
                return [x, y, (1.0 - r2).sqrt()];
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn directions_are_cosine_weighted_and_streams_differ() {
        let mut generator = Generator::new(1, 2);
        let n = 200_000;
        let (mut sum, mut squares) = ([0.0; 3], [0.0; 3]);
        for _ in 0..n {
            let d = generator.cosine_direction();
            for axis in 0..3 {
                sum[axis] += d[axis] / f64::from(n);
                squares[axis] += d[axis] * d[axis] / f64::from(n);
            }
        }
        // Standard errors are about 0.001.
        for (mean, expected) in sum.into_iter().zip([0.0, 0.0, 2.0 / 3.0]) {
            assert!((mean - expected).abs() < 5e-3, "{sum:?}");
        }
        for (mean, expected) in squares.into_iter().zip([0.25, 0.25, 0.5]) {
            assert!((mean - expected).abs() < 5e-3, "{squares:?}");
        }
        assert_ne!(Generator::new(1, 2).unit(), Generator::new(1, 3).unit());
        assert_ne!(Generator::new(1, 2).unit(), Generator::new(2, 2).unit());
    }
}
