//! Proofs where there are no such instructions: nothing proves them.

use super::Job;

/// There is no proof of AVX2.
#[derive(Clone, Copy, Debug)]
pub enum Avx2 {}

/// There is no proof of AVX-512.
#[derive(Clone, Copy, Debug)]
pub enum Avx512 {}

impl Avx2 {
    /// Always `None`.
    pub fn detect() -> Option<Self> {
        None
    }

    pub(super) fn run<J: Job>(self, _: J) -> J::Output {
        match self {}
    }
}

impl Avx512 {
    /// Always `None`.
    pub fn detect() -> Option<Self> {
        None
    }

    /// Proof of AVX2.
    pub fn avx2(self) -> Avx2 {
        match self {}
    }

    pub(super) fn run<J: Job>(self, _: J) -> J::Output {
        match self {}
    }
}
