//! Instruction sets: what each back end may use, the proof that the processor has it, and running work compiled for it.
//!
//! Every crate of the workspace chooses instructions here. Answers never depend on the choice: code fuses no operation unless
//! every back end does, or unless the fused operation is exact.
//!
//! | back end | target features |
//! |---|---|
//! | [`BackEnd::Scalar`] | what every processor of the target has |
//! | [`BackEnd::Avx2`] | AVX2, FMA, BMI1, BMI2, LZCNT, POPCNT |
//! | [`BackEnd::Avx512`] | those of AVX2, and AVX-512 F, BW, CD, DQ, VL, VPOPCNTDQ |
//!
//! # Forcing a back end
//! The environment variable [`UMBRAGE_BACKEND`](VARIABLE) (`scalar`, `avx2` or `avx512`) replaces what [`BackEnd::best`] and
//! [`BackEnd::unless_forced`] return, for tests and for measurements. It is read once a process. [`BackEnd::forced`] returns an
//! error for a value that names no back end, or one that this processor lacks: programs should call it first and stop at an
//! error, because the other two functions then act as if the variable were not set. A back end that a caller names itself,
//! for example through `Bvh::with_back_end`, is used whatever the variable says.

#[cfg(target_arch = "x86_64")]
pub mod x86;

#[cfg(not(target_arch = "x86_64"))]
#[path = "none.rs"]
pub mod x86;

pub use x86::{Avx2, Avx512};

use std::{fmt, str::FromStr, sync::OnceLock};

/// Name of the environment variable that forces a back end.
pub const VARIABLE: &str = "UMBRAGE_BACKEND";

/// Portable work that the compiler vectorizes: loops over arrays of eight or sixteen. [`Self::run`] and what it calls often
/// must be `#[inline(always)]`, so that they are compiled for the instructions of the function they are inlined into.
/// Closures are not.
pub trait Job {
    /// Result of the job.
    type Output;

    /// Runs the job.
    fn run(self) -> Self::Output;
}

/// Work that has code of its own for AVX2. Both functions must be `#[inline(always)]`, as in a [`Job`].
pub trait Dispatch {
    /// Result of the work.
    type Output;

    /// Runs portable code.
    fn portable(self) -> Self::Output;

    /// Runs code for AVX2. On [`BackEnd::Avx512`] the same code is compiled once more: with twice the registers, and
    /// comparisons into mask registers.
    #[cfg(target_arch = "x86_64")]
    fn avx2(self, avx2: Avx2) -> Self::Output;
}

/// Which instructions are used. Answers don't depend on it. The [module](self) lists the target features of each.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum BackEnd {
    /// What every processor of the target has.
    Scalar,
    /// AVX2 and FMA, eight numbers at a time.
    Avx2,
    /// AVX-512: 32 registers and mask registers.
    Avx512,
}

/// Why [`VARIABLE`] can't be followed.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum BackEndError {
    /// The value names no back end.
    #[error("{VARIABLE}: there is no back end {0:?}; back ends are scalar, avx2 and avx512")]
    Unknown(String),
    /// This processor lacks the back end.
    #[error("{VARIABLE}: this processor lacks the instructions of back end {0}")]
    Missing(BackEnd),
}

/// The text is not one of `scalar`, `avx2` and `avx512`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("back ends are scalar, avx2 and avx512")]
pub struct ParseBackEndError;

impl FromStr for BackEnd {
    type Err = ParseBackEndError;

    fn from_str(name: &str) -> Result<Self, Self::Err> {
        Self::ALL.into_iter().find(|b| b.name() == name).ok_or(ParseBackEndError)
    }
}

impl fmt::Display for BackEnd {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl BackEnd {
    /// All back ends, supported or not, the narrowest first.
    pub const ALL: [Self; 3] = [Self::Scalar, Self::Avx2, Self::Avx512];

    fn name(self) -> &'static str {
        match self {
            Self::Scalar => "scalar",
            Self::Avx2 => "avx2",
            Self::Avx512 => "avx512",
        }
    }

    /// The forced back end, or else the widest one that this processor has.
    #[inline]
    pub fn best() -> Self {
        if let Ok(Some(forced)) = request() { *forced } else { widest().back_end() }
    }

    /// The forced back end, or else this one if the processor has it, or else [`Self::Scalar`].
    #[inline]
    pub fn unless_forced(self) -> Self {
        if let Ok(Some(forced)) = request() { *forced } else { self.instructions().back_end() }
    }

    /// The back end that [`VARIABLE`] asks for; `None` if it is not set.
    ///
    /// # Errors
    /// [`BackEndError::Unknown`] if the value names no back end; [`BackEndError::Missing`] if this processor lacks it.
    pub fn forced() -> Result<Option<Self>, BackEndError> {
        request().clone()
    }

    fn parse(value: &str) -> Result<Self, BackEndError> {
        let back_end: Self = value.parse().map_err(|_| BackEndError::Unknown(value.to_owned()))?;
        if back_end.is_supported() { Ok(back_end) } else { Err(BackEndError::Missing(back_end)) }
    }

    /// Whether this processor has the instructions.
    pub fn is_supported(self) -> bool {
        self.instructions().back_end() == self
    }

    /// The back end with proof that the processor has it; that of [`Self::Scalar`] where it does not.
    #[inline]
    pub fn instructions(self) -> Instructions {
        match (self, widest()) {
            (Self::Avx512, Instructions::Avx512(avx512)) => Instructions::Avx512(avx512),
            (Self::Avx2, widest) => widest.avx2().map_or(Instructions::Scalar, Instructions::Avx2),
            _ => Instructions::Scalar,
        }
    }

    /// Runs `job` on this back end, or on [`Self::Scalar`] where the processor lacks it.
    #[inline]
    pub fn run<J: Job>(self, job: J) -> J::Output {
        self.instructions().run(job)
    }

    /// Runs `work` on this back end, or on [`Self::Scalar`] where the processor lacks it.
    #[inline]
    pub fn dispatch<D: Dispatch>(self, work: D) -> D::Output {
        self.instructions().dispatch(work)
    }
}

/// What [`VARIABLE`] asks for.
#[inline]
fn request() -> &'static Result<Option<BackEnd>, BackEndError> {
    // What a process was started with does not change.
    static REQUEST: OnceLock<Result<Option<BackEnd>, BackEndError>> = OnceLock::new();
    REQUEST.get_or_init(|| {
        std::env::var_os(VARIABLE).map(|value| BackEnd::parse(&value.to_string_lossy())).transpose()
    })
}

/// The widest instructions that this processor has.
#[inline]
fn widest() -> Instructions {
    // The processor is asked once: queries of single rays dispatch so often that asking would show.
    static WIDEST: OnceLock<Instructions> = OnceLock::new();
    *WIDEST.get_or_init(|| match (Avx512::detect(), Avx2::detect()) {
        (Some(avx512), _) => Instructions::Avx512(avx512),
        (None, Some(avx2)) => Instructions::Avx2(avx2),
        (None, None) => Instructions::Scalar,
    })
}

/// A back end with proof that the processor has it.
#[derive(Clone, Copy, Debug)]
pub enum Instructions {
    /// See [`BackEnd::Scalar`].
    Scalar,
    /// See [`BackEnd::Avx2`].
    Avx2(Avx2),
    /// See [`BackEnd::Avx512`].
    Avx512(Avx512),
}

impl Instructions {
    /// Which back end this is.
    #[inline]
    pub fn back_end(self) -> BackEnd {
        match self {
            Self::Scalar => BackEnd::Scalar,
            Self::Avx2(_) => BackEnd::Avx2,
            Self::Avx512(_) => BackEnd::Avx512,
        }
    }

    /// Proof of AVX2, which AVX-512 includes.
    #[inline]
    pub fn avx2(self) -> Option<Avx2> {
        match self {
            Self::Scalar => None,
            Self::Avx2(avx2) => Some(avx2),
            Self::Avx512(avx512) => Some(avx512.avx2()),
        }
    }

    /// Runs `job` compiled for these instructions.
    #[inline]
    pub fn run<J: Job>(self, job: J) -> J::Output {
        match self {
            Self::Scalar => job.run(),
            Self::Avx2(avx2) => avx2.run(job),
            Self::Avx512(avx512) => avx512.run(job),
        }
    }

    /// Runs `work` compiled for these instructions.
    #[inline]
    pub fn dispatch<D: Dispatch>(self, work: D) -> D::Output {
        match self {
            #[cfg(target_arch = "x86_64")]
            Self::Avx2(avx2) => avx2.run(OnAvx2(work, avx2)),
            #[cfg(target_arch = "x86_64")]
            Self::Avx512(avx512) => avx512.run(OnAvx2(work, avx512.avx2())),
            _ => work.portable(),
        }
    }
}

/// The AVX2 code of some work, as a job.
#[cfg(target_arch = "x86_64")]
struct OnAvx2<D>(D, Avx2);

#[cfg(target_arch = "x86_64")]
impl<D: Dispatch> Job for OnAvx2<D> {
    type Output = D::Output;

    #[inline(always)]
    fn run(self) -> D::Output {
        self.0.avx2(self.1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_read_back() {
        for back_end in BackEnd::ALL {
            assert_eq!(back_end.to_string().parse(), Ok(back_end));
        }
        for bad in ["", "AVX2", "avx", "best", " scalar"] {
            assert_eq!(BackEnd::parse(bad), Err(BackEndError::Unknown(bad.to_owned())));
        }
    }

    #[test]
    fn what_is_missing_is_an_error() {
        for back_end in BackEnd::ALL {
            let parsed = BackEnd::parse(back_end.name());
            if back_end.is_supported() {
                assert_eq!(parsed, Ok(back_end));
                assert_eq!(back_end.instructions().back_end(), back_end);
            } else {
                assert_eq!(parsed, Err(BackEndError::Missing(back_end)));
                assert_eq!(back_end.instructions().back_end(), BackEnd::Scalar);
            }
        }
        assert!(BackEnd::Scalar.is_supported() && BackEnd::best().is_supported());
    }

    /// Sums of products, which some back end might fuse.
    struct Sums<'a>(&'a [[f32; 3]]);

    impl Job for Sums<'_> {
        type Output = Vec<u32>;

        #[inline(always)]
        fn run(self) -> Vec<u32> {
            self.0.iter().map(|[a, b, c]| (a * b + c).to_bits()).collect()
        }
    }

    #[test]
    fn no_back_end_fuses() {
        let triples: Vec<[f32; 3]> = (1..100u8)
            .map(|i| [1.0 + f32::from(i) * 1e-3, 1.0 / f32::from(i), -f32::from(i).recip()])
            .collect();
        let fused: Vec<u32> = triples.iter().map(|[a, b, c]| a.mul_add(*b, *c).to_bits()).collect();
        let expected = BackEnd::Scalar.run(Sums(&triples));
        assert_ne!(expected, fused);
        for back_end in BackEnd::ALL {
            assert_eq!(back_end.run(Sums(&triples)), expected, "{back_end}");
        }
    }
}
