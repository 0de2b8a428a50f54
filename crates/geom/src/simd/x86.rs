//! Proofs and shells of x86-64, and vector operations that several crates use.
#![allow(clippy::missing_safety_doc)] // functions with target features are safe to call where the features are enabled

use super::Job;
use std::arch::x86_64::*;

/// Numbers of a vector.
const LANES: usize = 8;

/// Proof that this processor has AVX2, FMA, BMI1, BMI2, LZCNT and POPCNT.
#[derive(Clone, Copy, Debug)]
pub struct Avx2(());

/// Proof that this processor has AVX-512 (F, BW, CD, DQ, VL, VPOPCNTDQ), besides what [`Avx2`] proves.
#[derive(Clone, Copy, Debug)]
pub struct Avx512(Avx2);

impl Avx2 {
    /// Asks the processor.
    pub fn detect() -> Option<Self> {
        let all = is_x86_feature_detected!("avx2")
            && is_x86_feature_detected!("fma")
            && is_x86_feature_detected!("bmi1")
            && is_x86_feature_detected!("bmi2")
            && is_x86_feature_detected!("lzcnt")
            && is_x86_feature_detected!("popcnt");
        all.then_some(Self(()))
    }

    /// Runs `job` compiled for these instructions.
    #[inline]
    pub(super) fn run<J: Job>(self, job: J) -> J::Output {
        #[target_feature(enable = "avx2,fma,bmi1,bmi2,lzcnt,popcnt")]
        fn shell<J: Job>(job: J) -> J::Output {
            job.run()
        }
        // SAFETY: `self` proves the target features.
        unsafe { shell(job) }
    }

    /// Asks for the cache lines of `bytes` bytes from `target`, which may be any address.
    #[inline(always)]
    pub fn prefetch(self, target: *const u8, bytes: usize) {
        for offset in (0..bytes).step_by(64) {
            // SAFETY: every x86-64 processor has SSE, and no address is bad for a hint.
            unsafe { _mm_prefetch::<_MM_HINT_T0>(target.cast::<i8>().wrapping_add(offset)) };
        }
    }
}

impl Avx512 {
    /// Asks the processor.
    pub fn detect() -> Option<Self> {
        let all = is_x86_feature_detected!("avx512f")
            && is_x86_feature_detected!("avx512bw")
            && is_x86_feature_detected!("avx512cd")
            && is_x86_feature_detected!("avx512dq")
            && is_x86_feature_detected!("avx512vl")
            && is_x86_feature_detected!("avx512vpopcntdq");
        if all { Avx2::detect().map(Self) } else { None }
    }

    /// Proof of AVX2.
    #[inline(always)]
    pub fn avx2(self) -> Avx2 {
        self.0
    }

    /// Runs `job` compiled for these instructions.
    #[inline]
    pub(super) fn run<J: Job>(self, job: J) -> J::Output {
        #[target_feature(
            enable = "avx2,fma,bmi1,bmi2,lzcnt,popcnt,avx512f,avx512bw,avx512cd,avx512dq,avx512vl,avx512vpopcntdq"
        )]
        fn shell<J: Job>(job: J) -> J::Output {
            job.run()
        }
        // SAFETY: `self` proves the target features.
        unsafe { shell(job) }
    }
}

/// The numbers of a row.
#[inline]
#[target_feature(enable = "avx2")]
pub fn load(row: &[f32; LANES]) -> __m256 {
    // SAFETY: a row is eight floats.
    unsafe { _mm256_loadu_ps(row.as_ptr()) }
}

/// Writes a row.
#[inline]
#[target_feature(enable = "avx2")]
pub fn store(row: &mut [f32; LANES], x: __m256) {
    // SAFETY: a row is eight floats.
    unsafe { _mm256_storeu_ps(row.as_mut_ptr(), x) }
}

/// Planes `base + number * step`. If the products are exact, as for boxes of 8 bits, each plane is rounded once, and so has
/// the bits of the two operations apart.
#[inline]
#[target_feature(enable = "avx2,fma")]
pub fn planes(numbers: &[u8; LANES], step: f32, base: f32) -> __m256 {
    // SAFETY: a row is eight bytes.
    let numbers = unsafe { _mm_loadl_epi64(numbers.as_ptr().cast()) };
    let numbers = _mm256_cvtepi32_ps(_mm256_cvtepu8_epi32(numbers));
    _mm256_fmadd_ps(numbers, _mm256_set1_ps(step), _mm256_set1_ps(base))
}

/// Number of set bits in each lane.
#[inline]
#[target_feature(enable = "avx2")]
pub fn count_ones(x: __m256i) -> __m256i {
    let of_nibble =
        _mm256_broadcastsi128_si256(_mm_setr_epi8(0, 1, 1, 2, 1, 2, 2, 3, 1, 2, 2, 3, 2, 3, 3, 4));
    let nibbles = _mm256_set1_epi8(0xf);
    let low = _mm256_shuffle_epi8(of_nibble, _mm256_and_si256(x, nibbles));
    let high = _mm256_shuffle_epi8(of_nibble, _mm256_and_si256(_mm256_srli_epi32::<4>(x), nibbles));
    let pairs = _mm256_maddubs_epi16(_mm256_add_epi8(low, high), _mm256_set1_epi8(1));
    _mm256_madd_epi16(pairs, _mm256_set1_epi16(1))
}

/// Sorts lanes as unsigned integers, the smallest first or the largest first: a network of six layers.
#[inline]
#[target_feature(enable = "avx2")]
pub fn sorted<const LARGEST_FIRST: bool>(x: __m256i) -> __m256i {
    /// Compares lanes with their partners. Those in `LATER` take what comes later in the order.
    #[inline]
    #[target_feature(enable = "avx2")]
    fn exchange<const LATER: i32, const LARGEST_FIRST: bool>(x: __m256i, partner: __m256i) -> __m256i {
        let (small, large) = (_mm256_min_epu32(x, partner), _mm256_max_epu32(x, partner));
        if LARGEST_FIRST {
            _mm256_blend_epi32::<LATER>(large, small)
        } else {
            _mm256_blend_epi32::<LATER>(small, large)
        }
    }
    let by = |x: __m256i, partners: __m256i| _mm256_permutevar8x32_epi32(x, partners);
    let x = exchange::<0b1100_1100, LARGEST_FIRST>(x, _mm256_shuffle_epi32::<0b01_00_11_10>(x));
    let x = exchange::<0b1111_0000, LARGEST_FIRST>(x, _mm256_permute2x128_si256::<1>(x, x));
    let x = exchange::<0b1010_1010, LARGEST_FIRST>(x, _mm256_shuffle_epi32::<0b10_11_00_01>(x));
    let x = exchange::<0b0011_0000, LARGEST_FIRST>(x, _mm256_permute4x64_epi64::<0b11_01_10_00>(x));
    let x = exchange::<0b0101_0000, LARGEST_FIRST>(x, by(x, _mm256_setr_epi32(0, 4, 2, 6, 1, 5, 3, 7)));
    exchange::<0b0101_0100, LARGEST_FIRST>(x, by(x, _mm256_setr_epi32(0, 2, 1, 4, 3, 6, 5, 7)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bits_are_counted() {
        if Avx2::detect().is_none() {
            return;
        }
        let values = [0, 1, u32::MAX, 0x8000_0001, 0x0f0f_0f0f, 0x1234_5678, 1 << 16, 0xdead_beef];
        // SAFETY: AVX2 is there; arrays and vectors are as large.
        let counts = unsafe {
            let x = std::mem::transmute::<[u32; LANES], __m256i>(values);
            std::mem::transmute::<__m256i, [u32; LANES]>(count_ones(x))
        };
        assert_eq!(counts, values.map(u32::count_ones));
    }

    #[test]
    fn the_network_sorts() {
        if Avx2::detect().is_none() {
            return;
        }
        let sorted = |values: [u32; LANES]| {
            // SAFETY: AVX2 is there; arrays and vectors are as large.
            unsafe {
                let x = std::mem::transmute::<[u32; LANES], __m256i>(values);
                [sorted::<false>(x), sorted::<true>(x)]
                    .map(|x| std::mem::transmute::<__m256i, [u32; LANES]>(x))
            }
        };
        // A network that sorts zeros and ones sorts everything.
        for bits in 0..256u32 {
            let mut values = [0, 1, 2, 3, 4, 5, 6, 7].map(|i| (bits >> i & 1) * (u32::MAX - i));
            let [rising, falling] = sorted(values);
            values.sort_unstable();
            assert_eq!(rising, values);
            values.reverse();
            assert_eq!(falling, values);
        }
    }
}
