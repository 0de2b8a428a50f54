//! Fixed patterns of directions for ambient occlusion.

use super::hash::{hash, unit};
use super::maps::cosine_hemisphere;
use super::sobol::sobol_2d;
use super::trig::sin_cos;
use glam::Vec3;
use std::f64::consts::PI;

/// `N` cosine-weighted unit directions around the z axis: scrambled Sobol points, mapped to the disc and lifted.
///
/// Each direction carries the same share `1 / N` of the irradiance of a constant sky. All have `z` of at least 5e-4, so
/// none runs in the surface itself.
#[derive(Clone, Debug, PartialEq)]
pub struct HemispherePattern {
    directions: Box<[Vec3]>,
}

/// The number of directions was 0 or more than [`HemispherePattern::MAX`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0} directions in a hemisphere: expected 1 to {max}", max = HemispherePattern::MAX)]
pub struct PatternSize(pub u32);

impl HemispherePattern {
    /// Most directions in a pattern.
    pub const MAX: u32 = 4096;

    /// The pattern of `n` directions that belongs to `seed`.
    ///
    /// # Errors
    /// [`PatternSize`] if `n` is 0 or above [`Self::MAX`].
    pub fn new(n: u32, seed: u32) -> Result<Self, PatternSize> {
        if n == 0 || n > Self::MAX {
            return Err(PatternSize(n));
        }
        Ok(Self { directions: (0..n).map(|i| cosine_hemisphere(sobol_2d(i, 0, seed))).collect() })
    }

    /// How many directions there are, at least 1.
    #[allow(clippy::len_without_is_empty)] // never empty
    pub fn len(&self) -> usize {
        self.directions.len()
    }

    /// All directions in local coordinates, z along the normal.
    pub fn directions(&self) -> &[Vec3] {
        &self.directions
    }

    /// Direction `i` turned about the normal.
    ///
    /// # Panics
    /// If `i` is out of range.
    #[inline]
    pub fn rotated(&self, i: usize, rotation: Rotation) -> Vec3 {
        rotation.apply(self.directions[i])
    }
}

/// A rotation about the z axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rotation {
    sin: f32,
    cos: f32,
}

impl Rotation {
    /// No rotation.
    pub const NONE: Self = Self { sin: 0.0, cos: 1.0 };

    /// Counter-clockwise by `turns` full turns, `|turns|` up to 1e5; anything that is not finite counts as 0.
    pub fn from_turns(turns: f32) -> Self {
        let turns = if turns.is_finite() { f64::from(turns) } else { 0.0 };
        // Whole turns go first, exactly.
        let (sin, cos) = sin_cos((turns - turns.floor()) * (2.0 * PI));
        Self { sin: sin as f32, cos: cos as f32 }
    }

    /// A random rotation.
    pub fn from_seed(seed: u32) -> Self {
        Self::from_turns(unit(hash(seed)))
    }

    /// The turned vector.
    #[inline]
    pub fn apply(self, v: Vec3) -> Vec3 {
        Vec3::new(v.x * self.cos - v.y * self.sin, v.x * self.sin + v.y * self.cos, v.z)
    }
}
