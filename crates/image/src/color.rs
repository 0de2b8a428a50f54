//! The sRGB transfer curve and colour maps.

use std::sync::OnceLock;

/// Linear light of an sRGB-encoded value, both in `[0, 1]` (IEC 61966-2-1).
pub fn srgb_to_linear(encoded: f64) -> f64 {
    if encoded <= 0.04045 { encoded / 12.92 } else { ((encoded + 0.055) / 1.055).powf(2.4) }
}

/// The 8-bit sRGB value nearest to linear light: below 0 and NaN give 0, above 1 gives 255.
///
/// Looked up between the exact midpoints of neighbouring values, so that no rounding of a power function shows.
pub fn linear_to_srgb8(linear: f32) -> u8 {
    static MIDPOINTS: OnceLock<[f32; 255]> = OnceLock::new();
    let midpoints =
        MIDPOINTS.get_or_init(|| std::array::from_fn(|i| srgb_to_linear((i as f64 + 0.5) / 255.0) as f32));
    midpoints.partition_point(|&m| m <= linear) as u8
}

/// How a number in `[0, 1]` becomes a colour.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum ColorMap {
    /// Dark blue over green to yellow, equal steps look equal; for cost and other amounts.
    Viridis,
    /// Black over purple to light yellow, equal steps look equal; for errors: none is black.
    Magma,
    /// Blue over white (at 0.5) to red; for signed differences.
    Diverging,
}

/// Every eighth of the CC0 colour maps of van der Walt and Smith (2015).
const VIRIDIS: [[u8; 3]; 9] = [
    [68, 1, 84],
    [71, 44, 122],
    [59, 81, 139],
    [44, 113, 142],
    [33, 144, 141],
    [39, 173, 129],
    [92, 200, 99],
    [170, 220, 50],
    [253, 231, 37],
];
const MAGMA: [[u8; 3]; 9] = [
    [0, 0, 4],
    [28, 16, 68],
    [79, 18, 123],
    [129, 37, 129],
    [181, 54, 122],
    [229, 80, 100],
    [251, 135, 97],
    [254, 194, 135],
    [252, 253, 191],
];
const DIVERGING: [[u8; 3]; 5] = [[8, 48, 107], [70, 140, 200], [255, 255, 255], [214, 96, 77], [103, 0, 31]];

impl ColorMap {
    /// 8-bit sRGB colour of `t`, clamped to `[0, 1]`; NaN is mid grey, which no map contains.
    pub fn color(self, t: f32) -> [u8; 3] {
        if t.is_nan() {
            return [128; 3];
        }
        let stops: &[[u8; 3]] = match self {
            Self::Viridis => &VIRIDIS,
            Self::Magma => &MAGMA,
            Self::Diverging => &DIVERGING,
        };
        let position = t.clamp(0.0, 1.0) * (stops.len() - 1) as f32;
        let i = (position as usize).min(stops.len() - 2);
        let f = position - i as f32;
        std::array::from_fn(|c| {
            let (a, b) = (f32::from(stops[i][c]), f32::from(stops[i + 1][c]));
            (a + (b - a) * f + 0.5) as u8
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_byte_survives_decoding_and_encoding() {
        for byte in 0..=255u8 {
            assert_eq!(linear_to_srgb8(srgb_to_linear(f64::from(byte) / 255.0) as f32), byte);
        }
        assert_eq!(linear_to_srgb8(f32::NAN), 0);
        assert_eq!(linear_to_srgb8(-1.0), 0);
        assert_eq!(linear_to_srgb8(f32::INFINITY), 255);
        assert_eq!(linear_to_srgb8(0.5), 188);
    }

    #[test]
    fn maps_are_brighter_for_more() {
        for map in [ColorMap::Viridis, ColorMap::Magma] {
            let luma = |t: f32| {
                map.color(t).iter().zip([0.2, 0.7, 0.1]).map(|(&c, w)| f32::from(c) * w).sum::<f32>()
            };
            assert!((0..64).all(|i| luma(i as f32 / 64.0) < luma((i + 1) as f32 / 64.0)), "{map:?}");
        }
        assert_eq!(ColorMap::Diverging.color(0.5), [255; 3]);
        assert_eq!(ColorMap::Magma.color(f32::NAN), [128; 3]);
        assert_eq!(ColorMap::Viridis.color(f32::INFINITY), [253, 231, 37]);
    }
}
