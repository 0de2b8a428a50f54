//! Coarser meshes for levels of detail, by meshoptimizer.

use super::RasterLevel;
use crate::MaskError;
use meshopt::SimplifyOptions;
use umbrage_accel::BuildError;
use umbrage_geom::mesh::validate_slices;

/// A simplified mesh: other triangles over the same vertices.
#[derive(Clone, Debug, PartialEq)]
pub struct SimplifiedLevel {
    /// Corners of triangles.
    pub triangles: Vec<[u32; 3]>,
    /// Simplification error that was allowed, world units.
    pub error: f32,
}

impl SimplifiedLevel {
    /// The level over the vertices it was made from.
    pub fn level<'a>(&'a self, positions: &'a [[f32; 3]]) -> RasterLevel<'a> {
        RasterLevel { positions, triangles: &self.triangles, error: self.error }
    }
}

/// Up to `count` coarser levels of a mesh, the first with an error of `error` (world units), each other with three times that
/// of the one before (`[Laine10]`, figure 7). Ends early where nothing is left or nothing changes.
///
/// # Errors
/// [`MaskError::Build`] for geometry that can't be used; [`MaskError::Level`] if `error` is not positive and finite.
pub fn simplified_levels(
    positions: &[[f32; 3]],
    triangles: &[[u32; 3]],
    error: f32,
    count: usize,
) -> Result<Vec<SimplifiedLevel>, MaskError> {
    validate_slices(positions, triangles).map_err(BuildError::from)?;
    if !(error > 0.0 && error.is_finite()) {
        return Err(MaskError::Level { level: 1, what: "error", value: error });
    }
    // Loose parts smaller than the error go too.
    let options = SimplifyOptions::ErrorAbsolute | SimplifyOptions::Prune;
    let mut levels: Vec<SimplifiedLevel> = Vec::new();
    let mut error = error;
    for _ in 0..count {
        let finer = levels.last().map_or(triangles, |level| &level.triangles);
        let result = meshopt::simplify_decoder(finer.as_flattened(), positions, 0, error, options, None);
        let (coarse, _) = result.as_chunks::<3>();
        if coarse.is_empty() {
            break;
        }
        if coarse.len() < finer.len() {
            levels.push(SimplifiedLevel { triangles: coarse.to_vec(), error });
        }
        error *= 3.0;
    }
    Ok(levels)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn levels_get_coarser_and_stay_close() {
        // A bumpy sheet.
        let n = 40u32;
        let height = |x: u32, y: u32| ((x as f32 * 0.7).sin() + (y as f32 * 0.9).cos()) * 0.2;
        let positions: Vec<[f32; 3]> =
            (0..n * n).map(|i| [(i % n) as f32, (i / n) as f32, height(i % n, i / n)]).collect();
        let cell = |i: u32| {
            let at = i / (n - 1) * n + i % (n - 1);
            [[at, at + 1, at + n], [at + 1, at + n + 1, at + n]]
        };
        let triangles: Vec<[u32; 3]> = (0..(n - 1) * (n - 1)).flat_map(cell).collect();
        let levels = simplified_levels(&positions, &triangles, 0.02, 3).unwrap();
        assert!(!levels.is_empty());
        let mut count = triangles.len();
        for level in &levels {
            assert!(level.triangles.len() < count);
            count = level.triangles.len();
            assert_eq!(level.level(&positions).error, level.error);
        }
        assert!((levels[0].error - 0.02).abs() < 1e-9);
        for error in [0.0, -1.0, f32::NAN, f32::INFINITY] {
            assert!(matches!(
                simplified_levels(&positions, &triangles, error, 2),
                Err(MaskError::Level { .. })
            ));
        }
        assert!(matches!(simplified_levels(&positions, &[], 0.1, 2), Err(MaskError::Build(_))));
    }
}
