//! The loop over lanes compiled for AVX2 and for AVX-512: the only unsafe code of this crate.
#![allow(unsafe_code)]

use super::{Columns, row_in_lanes};
use umbrage_geom::glam::Vec3;

/// Proof that this processor has AVX2.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Avx2(());

impl Avx2 {
    pub(crate) fn detect() -> Option<Self> {
        is_x86_feature_detected!("avx2").then_some(Self(()))
    }

    #[inline]
    pub(crate) fn row(self, curve: &[Vec3; 4], columns: &[Columns], row: &mut [Vec3]) {
        #[target_feature(enable = "avx2")]
        fn shell(curve: &[Vec3; 4], columns: &[Columns], row: &mut [Vec3]) {
            row_in_lanes(curve, columns, row);
        }
        // SAFETY: `self` proves the target features.
        unsafe { shell(curve, columns, row) }
    }
}

/// Proof that this processor has AVX-512 F and VL, used for the registers: vectors of 512 bits gain nothing here.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Avx512(());

impl Avx512 {
    pub(crate) fn detect() -> Option<Self> {
        (is_x86_feature_detected!("avx512f") && is_x86_feature_detected!("avx512vl")).then_some(Self(()))
    }

    #[inline]
    pub(crate) fn row(self, curve: &[Vec3; 4], columns: &[Columns], row: &mut [Vec3]) {
        #[target_feature(enable = "avx512f,avx512vl")]
        fn shell(curve: &[Vec3; 4], columns: &[Columns], row: &mut [Vec3]) {
            row_in_lanes(curve, columns, row);
        }
        // SAFETY: `self` proves the target features.
        unsafe { shell(curve, columns, row) }
    }
}
