//! Levels of detail by distance (`[Laine10]`, section 4.3).

use super::tile::Level;
use crate::{MaskError, MaskOptions, Pattern};
use umbrage_accel::BuildError;
use umbrage_geom::{Aabb, mesh::validate_slices};

/// Geometry that stands for the scene in a range of distances.
///
/// Level `i` of error `e` occludes receivers at distances from `k * e[i]` to `k * e[i + 1]` ([`RasterOptions::range_factor`]):
/// the scene itself, of error 0, near by, and ever coarser levels farther away, the last up to the radius.
#[derive(Clone, Copy, Debug)]
pub struct RasterLevel<'a> {
    /// Vertices, world units.
    pub positions: &'a [[f32; 3]],
    /// Corners of triangles.
    pub triangles: &'a [[u32; 3]],
    /// How far the surface is from the scene's, world units; 0 for the first level, growing from level to level.
    pub error: f32,
}

impl<'a> RasterLevel<'a> {
    /// The scene itself.
    pub fn exact(positions: &'a [[f32; 3]], triangles: &'a [[u32; 3]]) -> Self {
        Self { positions, triangles, error: 0.0 }
    }
}

/// Settings of [`super::RasterCall`].
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct RasterOptions {
    /// `k`: at how many times its error a level takes over. The paper uses 2 to 5.
    pub range_factor: f32,
    /// How many of the five culling tests end the work on a fragment, 0 to 5. Answers are the same; fewer cost time, which
    /// table 2 of the paper measures.
    pub culling_tests: u8,
}

impl Default for RasterOptions {
    fn default() -> Self {
        Self { range_factor: 3.0, culling_tests: 5 }
    }
}

impl RasterOptions {
    /// Sets [`Self::range_factor`].
    #[must_use]
    pub fn with_range_factor(self, range_factor: f32) -> Self {
        Self { range_factor, ..self }
    }

    /// Sets [`Self::culling_tests`].
    #[must_use]
    pub fn with_culling_tests(self, culling_tests: u8) -> Self {
        Self { culling_tests, ..self }
    }

    /// Checks what [`prepare`] doesn't.
    pub(super) fn validate(&self) -> Result<(), MaskError> {
        match self.culling_tests {
            0..=5 => Ok(()),
            tests => {
                let (name, value) = ("culling_tests", tests.into());
                Err(MaskError::Option { name, value, expected: "0 to 5" })
            }
        }
    }
}

/// Checks geometry and gives every level its range. Levels beyond the radius are left out.
pub(super) fn prepare<'a>(
    levels: &[RasterLevel<'a>],
    everything: &Aabb,
    options: &MaskOptions,
    raster: &RasterOptions,
    pattern: &Pattern,
) -> Result<Vec<Level<'a>>, MaskError> {
    let factor = raster.range_factor;
    if !(factor > 0.0 && factor.is_finite()) {
        return Err(MaskError::Level { level: 0, what: "range factor", value: factor });
    }
    // Nothing is farther away than this.
    let most = (everything.diagonal() * 1.001).max(1e-30);
    let radius = options.radius.clamp(1e-30, f32::MAX);
    let mut prepared = Vec::new();
    for (index, level) in levels.iter().enumerate() {
        validate_slices(level.positions, level.triangles).map_err(BuildError::from)?;
        let before = if index == 0 { 0.0 } else { levels[index - 1].error };
        let grows = if index == 0 { level.error == 0.0 } else { level.error > before };
        if !grows || !level.error.is_finite() {
            return Err(MaskError::Level { level: index, what: "error", value: level.error });
        }
        let near = factor * level.error;
        let far = levels.get(index + 1).map_or(radius, |next| radius.min(factor * next.error));
        if near >= far {
            continue;
        }
        let reach = far.min(most);
        // Rays of different lengths keep the radius as their unit: their ends decide, and the range only who is asked.
        let unit = if pattern.has_equal_lengths() { reach } else { radius };
        prepared.push(Level { positions: level.positions, triangles: level.triangles, reach, unit, near });
    }
    Ok(prepared)
}
