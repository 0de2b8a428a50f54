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

/// `p - o` where `f64` holds it exactly.
pub(crate) fn exact_difference(p: [f32; 3], o: [f32; 3]) -> Option<[f64; 3]> {
    let mut difference = [0.0; 3];
    for axis in 0..3 {
        let (a, b) = (f64::from(p[axis]), f64::from(o[axis]));
        let x = a - b;
        // The rounding error of the difference, itself exact (Knuth's two-sum).
        let b_used = x - a;
        let error = (a - (x - b_used)) - (b + b_used);
        if error != 0.0 {
            return None;
        }
        difference[axis] = x;
    }
    Some(difference)
}

/// Sign of `det(x, y, z)` where each vector, scaled by a power of two of its own, is one of integers below `2^40`; `None`
/// where not. All sums then stay below `2^123`.
pub(crate) fn small_det_sign(vectors: [[f64; 3]; 3]) -> Option<i32> {
    let mut fixed = [[0i64; 3]; 3];
    for (integers, vector) in fixed.iter_mut().zip(vectors) {
        let largest = vector.iter().fold(0f64, |m, x| m.max(x.abs()));
        if largest == 0.0 {
            return Some(0);
        }
        // Sums of two f32 are normal f64: the exponent is that of the largest component.
        let exponent = (largest.to_bits() >> 52) as i64 - 1023;
        let scale = f64::from_bits(((39 - exponent + 1023) as u64) << 52);
        for (integer, x) in integers.iter_mut().zip(vector) {
            let scaled = x * scale;
            *integer = scaled as i64;
            if *integer as f64 != scaled {
                return None;
            }
        }
    }
    let [x, y, z] = fixed.map(|v| v.map(i128::from));
    let minor = |i: usize, j: usize| y[i] * z[j] - y[j] * z[i];
    Some((x[0] * minor(1, 2) + x[1] * minor(2, 0) + x[2] * minor(0, 1)).signum() as i32)
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

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(4000))]
        #[test]
        fn small_determinants_agree_with_rationals(
            p in prop::array::uniform9(prop_oneof![
                4 => (-4i16..4).prop_map(f32::from),
                3 => (0u8..200).prop_map(|i| 1e6 + f32::from(i) * 0.0625),
                1 => any_finite(),
                1 => -1f32..1.0,
            ]),
            o in prop::array::uniform3(prop_oneof![(-4i16..4).prop_map(f32::from), Just(1e6f32), any_finite()]),
        ) {
            let q = |x: f32| BigRational::from_float(x).unwrap();
            let rows = [[p[0], p[1], p[2]], [p[3], p[4], p[5]], [p[6], p[7], p[8]]];
            let (Some(y), Some(z)) = (exact_difference(rows[1], o), exact_difference(rows[2], o)) else {
                return Ok(());
            };
            for axis in 0..3 {
                prop_assert_eq!(BigRational::from_float(y[axis]).unwrap(), q(rows[1][axis]) - q(o[axis]));
            }
            if let Some(sign) = small_det_sign([rows[0].map(f64::from), y, z]) {
                let [x, y, z] = [rows[0].map(f64::from), y, z].map(|v| v.map(|x| BigRational::from_float(x).unwrap()));
                let det = &x[0] * (&y[1] * &z[2] - &y[2] * &z[1]) + &x[1] * (&y[2] * &z[0] - &y[0] * &z[2])
                    + &x[2] * (&y[0] * &z[1] - &y[1] * &z[0]);
                prop_assert_eq!(sign, det.cmp(&q(0.0)) as i32);
            }
        }
    }

    #[test]
    fn lattices_far_from_the_origin_are_small() {
        let o = [1e6, 1e6 + 0.0625, -1e6];
        let p = [1e6 + 0.125, 1e6, -1e6 + 0.0625];
        let difference = exact_difference(p, o).unwrap();
        assert_eq!(difference, [0.125, -0.0625, 0.0625]);
        assert!(small_det_sign([[0.3f32, 0.2, 0.1].map(f64::from), difference, [1.0, 2.0, 3.0]]).is_some());
        assert_eq!(exact_difference([1e30; 3], [1e-30; 3]), None);
        assert_eq!(small_det_sign([[1.0, 1e-30, 0.0], [1.0; 3], [2.0; 3]]), None);
    }

    fn num_pow(base: &BigRational, exponent: i32) -> BigRational {
        let p = (0..exponent.unsigned_abs()).fold(BigRational::from_integer(1.into()), |a, _| a * base);
        if exponent < 0 { p.recip() } else { p }
    }
}
