//! Exact sums of products of `f32`, in integers.
//!
//! Here: [`Accumulator`], wide enough for any sum of at most 2^12 products of up to four finite `f32`. Not here: which
//! products decide a hit (`triangle.rs`).

/// Weight of bit 0 is `2^MIN_EXPONENT`: the lowest bit of a product of four denormals is `2^(4 * -149)`.
const MIN_EXPONENT: i32 = -4 * 149;

/// The highest bit of such a product is below `2^(4 * 128)`; 4 * 149 + 4 * 128 bits, 12 for the number of terms, a sign
/// and the slack of a 192-bit addition round up to 20 limbs.
const LIMBS: usize = 20;

/// A finite `f32` as `mantissa * 2^exponent`.
#[derive(Clone, Copy)]
struct Parts {
    mantissa: i64,
    exponent: i32,
}

impl Parts {
    fn new(x: f32) -> Self {
        let bits = x.to_bits();
        let (biased, fraction) = ((bits >> 23 & 0xff) as i32, i64::from(bits & 0x7f_ffff));
        let magnitude = if biased == 0 { fraction } else { fraction | 0x80_0000 };
        Self { mantissa: if x < 0.0 { -magnitude } else { magnitude }, exponent: biased.max(1) - 150 }
    }
}

/// An exact sum: a fixed-point number in two's complement that no sum of products of up to four `f32` can overflow.
#[derive(Clone)]
pub(crate) struct Accumulator {
    limbs: [u64; LIMBS],
}

impl Accumulator {
    pub(crate) const ZERO: Self = Self { limbs: [0; LIMBS] };

    /// Adds the exact product of finite `factors`, one to four of them; subtracts it if `negate`.
    pub(crate) fn add_product(&mut self, factors: &[f32], negate: bool) {
        let (mut mantissa, mut exponent) = (1i128, 0);
        for &factor in factors {
            let parts = Parts::new(factor);
            mantissa *= i128::from(parts.mantissa);
            exponent += parts.exponent;
        }
        if mantissa == 0 {
            return;
        }
        let negative = (mantissa < 0) != negate;
        let shift = (exponent - MIN_EXPONENT) as usize;
        let (limb, bit) = (shift / 64, shift % 64);
        // The magnitude is below 2^96: shifted by up to 63 bits it fills three limbs.
        let magnitude = mantissa.unsigned_abs();
        let low = magnitude << bit;
        let high = if bit == 0 { 0 } else { magnitude >> (128 - bit) };
        let words = [low as u64, (low >> 64) as u64, high as u64];
        let mut carry = false;
        for (i, slot) in self.limbs[limb..].iter_mut().enumerate() {
            let word = words.get(i).copied().unwrap_or(0);
            let (sum, over) = if negative {
                let (a, b1) = slot.overflowing_sub(word);
                let (a, b2) = a.overflowing_sub(u64::from(carry));
                (a, b1 | b2)
            } else {
                let (a, c1) = slot.overflowing_add(word);
                let (a, c2) = a.overflowing_add(u64::from(carry));
                (a, c1 | c2)
            };
            *slot = sum;
            carry = over;
            if i >= 2 && !carry {
                break;
            }
        }
    }

    /// -1, 0 or 1.
    pub(crate) fn sign(&self) -> i32 {
        if self.limbs[LIMBS - 1] >> 63 == 1 { -1 } else { i32::from(self.limbs.iter().any(|&l| l != 0)) }
    }

    /// The value as a pair `(m, e)` with value `m * 2^e`, off by at most 2^-52 of itself; 0 is `(0, 0)`.
    ///
    /// A pair, since the value of four large factors has no room in an `f64` next to its neighbours' small ones.
    pub(crate) fn approximate(&self) -> (f64, i32) {
        let negative = self.sign() < 0;
        let mut limbs = self.limbs;
        if negative {
            let mut carry = true;
            for l in &mut limbs {
                let (v, c) = (!*l).overflowing_add(u64::from(carry));
                *l = v;
                carry = c;
            }
        }
        let Some(top) = limbs.iter().rposition(|&l| l != 0) else { return (0.0, 0) };
        // The top 128 bits, as far as there are so many.
        let lower = if top > 0 { limbs[top - 1] } else { 0 };
        let value = (u128::from(limbs[top]) << 64 | u128::from(lower)) as f64;
        (if negative { -value } else { value }, MIN_EXPONENT + 64 * (top as i32 - 1))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use num_rational::BigRational;
    use proptest::prelude::*;

    fn any_finite() -> impl Strategy<Value = f32> {
        prop_oneof![
            any::<u32>().prop_map(f32::from_bits).prop_filter("finite", |x| x.is_finite()),
            (-8i8..8).prop_map(f32::from),
            prop::sample::select(vec![f32::MAX, f32::MIN, 1e-45, -1e-45, f32::MIN_POSITIVE, 0.0]),
        ]
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(2000))]
        #[test]
        fn sums_agree_with_rationals(
            terms in prop::collection::vec((prop::collection::vec(any_finite(), 1..=4), any::<bool>()), 1..40),
            cancel in any::<bool>(),
        ) {
            let q = |x: f32| BigRational::from_float(x).unwrap();
            let mut accumulator = Accumulator::ZERO;
            let mut truth = q(0.0);
            for (factors, negate) in terms.iter().chain(terms.iter().skip(1).filter(|_| cancel)) {
                accumulator.add_product(factors, *negate);
                let product = factors.iter().fold(q(1.0), |a, &f| a * q(f));
                if *negate { truth -= product } else { truth += product }
            }
            if cancel {
                // Take the first sum away again, term by term, leaving heavy cancellation behind.
                for (factors, negate) in &terms {
                    accumulator.add_product(factors, !negate);
                    let product = factors.iter().fold(q(1.0), |a, &f| a * q(f));
                    if *negate { truth += product } else { truth -= product }
                }
            }
            prop_assert_eq!(accumulator.sign(), truth.cmp(&q(0.0)) as i32);
            let (m, e) = accumulator.approximate();
            let two = BigRational::from_integer(2.into());
            let approx = BigRational::from_float(m).unwrap() * num_pow(&two, e);
            let error = if truth > approx { &truth - &approx } else { &approx - &truth };
            let size = if truth < q(0.0) { -truth } else { truth };
            prop_assert!(error <= size * BigRational::from_float(2f64.powi(-52)).unwrap());
        }
    }

    fn num_pow(base: &BigRational, exponent: i32) -> BigRational {
        let p = (0..exponent.unsigned_abs()).fold(BigRational::from_integer(1.into()), |a, _| a * base);
        if exponent < 0 { p.recip() } else { p }
    }
}
