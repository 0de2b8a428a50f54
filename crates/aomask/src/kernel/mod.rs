//! Instruction sets: loops over arrays of eight or sixteen, compiled again for each.
//!
//! A [`Job`] is portable code, inlined into a function that may use the wider instructions; the compiler vectorizes it. No
//! operation is fused unless written so, hence the same bits on every back end.

#[cfg(target_arch = "x86_64")]
mod x86;

/// Work that runs on any back end. `run` and all it calls should be `#[inline(always)]`.
pub(crate) trait Job {
    type Output;

    fn run(self) -> Self::Output;
}

/// Which instructions an engine uses. Answers don't depend on it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum BackEnd {
    /// What every processor of the target has.
    Scalar,
    /// AVX2, eight numbers at a time.
    Avx2,
    /// AVX-512 (F, BW, CD, DQ, VL, VPOPCNTDQ), sixteen numbers at a time.
    Avx512,
}

impl BackEnd {
    /// All of them, supported or not.
    pub const ALL: [Self; 3] = [Self::Scalar, Self::Avx2, Self::Avx512];

    /// The widest one that this processor has.
    pub fn best() -> Self {
        Self::ALL.into_iter().rev().find(|b| b.is_supported()).unwrap_or(Self::Scalar)
    }

    /// Whether this processor has it.
    pub fn is_supported(self) -> bool {
        match self {
            Self::Scalar => true,
            #[cfg(target_arch = "x86_64")]
            Self::Avx2 => x86::Avx2::detect().is_some(),
            #[cfg(target_arch = "x86_64")]
            Self::Avx512 => x86::Avx512::detect().is_some(),
            #[cfg(not(target_arch = "x86_64"))]
            _ => false,
        }
    }

    /// Runs `job` on this back end, or on the portable one where it is missing.
    #[inline]
    pub(crate) fn run<J: Job>(self, job: J) -> J::Output {
        #[cfg(target_arch = "x86_64")]
        {
            if self == Self::Avx512
                && let Some(avx512) = x86::Avx512::detect()
            {
                return avx512.run(job);
            }
            if self == Self::Avx2
                && let Some(avx2) = x86::Avx2::detect()
            {
                return avx2.run(job);
            }
        }
        job.run()
    }
}
