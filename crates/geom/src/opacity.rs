//! Optical depth in fixed point, so that transmittance does not depend on the order in which triangles are met.

/// How much a ray has been dimmed: `-log2(transmittance)` in steps of 2^-32, or opaque.
///
/// Sums of integers are the same in any order and on any machine; products of `f32` would not be. One step of rounding
/// for each triangle changes the transmittance by less than 2^-33 of itself.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct OpticalDepth(u64);

impl OpticalDepth {
    /// Nothing in the way.
    pub const CLEAR: Self = Self(0);
    /// Nothing gets through.
    pub const OPAQUE: Self = Self(u64::MAX);
    /// From here on the transmittance rounds to 0 in `f32`.
    const BLACK: u64 = 150 << 32;

    /// Depth of one crossing of a surface that blocks the fraction `opacity`; values outside `[0, 1]` are clamped, NaN
    /// counts as opaque.
    pub fn from_opacity(opacity: f32) -> Self {
        if opacity <= 0.0 {
            Self::CLEAR
        } else if opacity < 1.0 {
            Self((-(1.0 - f64::from(opacity)).log2() * 2f64.powi(32)).round() as u64)
        } else {
            Self::OPAQUE
        }
    }

    /// Whether transmittance is exactly 0, whatever is added.
    #[inline]
    pub fn is_opaque(self) -> bool {
        self.0 >= Self::BLACK
    }

    /// `-log2(transmittance)`, rounded; `2^32` when opaque.
    #[inline]
    pub fn bits(self) -> f32 {
        self.0 as f32 * (1.0 / (1u64 << 32) as f32)
    }

    /// Fraction of light that passes, in `[0, 1]`: 1 exactly when clear, 0 exactly when opaque.
    pub fn transmittance(self) -> f32 {
        if self.is_opaque() { 0.0 } else { (-(self.0 as f64) * 2f64.powi(-32)).exp2() as f32 }
    }
}

impl std::ops::AddAssign for OpticalDepth {
    #[inline]
    fn add_assign(&mut self, other: Self) {
        self.0 = self.0.saturating_add(other.0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn depths_add_up_to_products() {
        let mut depth = OpticalDepth::CLEAR;
        assert_eq!(depth.transmittance(), 1.0);
        for _ in 0..3 {
            depth += OpticalDepth::from_opacity(0.85);
        }
        assert!((depth.transmittance() - (1.0 - f64::from(0.85f32)).powi(3) as f32).abs() < 1e-9);
        assert!((depth.bits() + 3.0 * 0.15f32.log2()).abs() < 1e-5);
        depth += OpticalDepth::from_opacity(1.0);
        assert!(depth.is_opaque());
        assert_eq!(depth.transmittance(), 0.0);
        assert_eq!(OpticalDepth::from_opacity(f32::NAN), OpticalDepth::OPAQUE);
        assert_eq!(OpticalDepth::from_opacity(0.0), OpticalDepth::CLEAR);
    }

    #[test]
    fn opaque_starts_where_the_transmittance_rounds_to_0() {
        let (last, first) = (OpticalDepth(OpticalDepth::BLACK - 1), OpticalDepth(OpticalDepth::BLACK));
        assert!(!last.is_opaque() && first.is_opaque());
        // The smallest number above 0, and half of it, which is a tie with 0.
        assert_eq!(last.transmittance(), f32::from_bits(1));
        assert_eq!((first.transmittance(), 2f64.powi(-150) as f32), (0.0, 0.0));
        // Sums get there by layers that each let something through.
        let mut sum = OpticalDepth::CLEAR;
        for layer in 1..=300 {
            sum += OpticalDepth::from_opacity(1.0 - 0.5f32.sqrt());
            assert_eq!(sum.is_opaque(), sum.transmittance() == 0.0, "{layer}");
        }
        assert!((149.9..150.1).contains(&sum.bits()));
    }
}
