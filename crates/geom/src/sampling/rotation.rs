//! Turns of directions about the normal.

use super::trig::sin_cos;
use glam::Vec3;
use std::f64::consts::PI;

/// A rotation about the z axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rotation {
    sin: f32,
    cos: f32,
}

impl Rotation {
    /// Counter-clockwise by `turns` full turns, `|turns|` up to 1e5; anything that is not finite counts as 0.
    pub fn from_turns(turns: f32) -> Self {
        let turns = if turns.is_finite() { f64::from(turns) } else { 0.0 };
        // Whole turns go first, exactly.
        let (sin, cos) = sin_cos((turns - turns.floor()) * (2.0 * PI));
        Self { sin: sin as f32, cos: cos as f32 }
    }

    /// The turned vector.
    #[inline]
    pub fn apply(self, v: Vec3) -> Vec3 {
        Vec3::new(v.x * self.cos - v.y * self.sin, v.x * self.sin + v.y * self.cos, v.z)
    }
}
