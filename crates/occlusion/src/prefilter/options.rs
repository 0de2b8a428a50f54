//! What can be chosen when a hierarchy is prefiltered and when it is asked.

use super::{
    Directions,
    published::{Blend, CellSampling, Correlation, SegmentEnds, Storage},
};
use crate::OcclusionError;
use umbrage_accel::BuildQuality;

/// Options of [`super::Prefiltered::build`].
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct PrefilterOptions {
    /// Which nodes may end rays.
    pub correlation: Correlation,
    /// Cells along an edge of a cube face, `N_C`: 1 to 12.
    pub directions: u8,
    /// Lines along which an opacity is measured in each cell, 1 to 256. Against 16, the default of 8 takes half the time and
    /// has errors 3 % larger (bush of 500,000 triangles, 16 rays).
    pub lines: u16,
    /// Where in a cell they run.
    pub sampling: CellSampling,
    /// How opacities are stored.
    pub storage: Storage,
    /// What the build of the hierarchy spends its time on.
    pub quality: BuildQuality,
}

impl Default for PrefilterOptions {
    fn default() -> Self {
        Self {
            correlation: Correlation::Automatic,
            directions: 3,
            lines: 8,
            sampling: CellSampling::Jittered,
            storage: Storage::CubeU4,
            quality: BuildQuality::High,
        }
    }
}

/// `value` if it is within `least..=most`.
pub(crate) fn within(what: &'static str, value: f64, least: f64, most: f64) -> Result<(), OcclusionError> {
    if value >= least && value <= most {
        Ok(())
    } else {
        Err(OcclusionError::Setting { what, value, least, most })
    }
}

impl PrefilterOptions {
    /// Sets [`Self::directions`].
    #[must_use]
    pub fn with_directions(self, directions: u8) -> Self {
        Self { directions, ..self }
    }

    /// Sets [`Self::lines`].
    #[must_use]
    pub fn with_lines(self, lines: u16) -> Self {
        Self { lines, ..self }
    }

    /// Sets [`Self::quality`].
    #[must_use]
    pub fn with_quality(self, quality: BuildQuality) -> Self {
        Self { quality, ..self }
    }

    /// Checks ranges; returns the cells.
    ///
    /// # Errors
    /// [`OcclusionError::CorrelationHeight`], [`OcclusionError::Setting`].
    pub fn validate(&self) -> Result<Directions, OcclusionError> {
        if let Correlation::Height(height) = self.correlation
            && !(height >= 0.0 && height.is_finite())
        {
            return Err(OcclusionError::CorrelationHeight(height));
        }
        let most = f64::from(Directions::MOST);
        within("number of directions along a face", self.directions.into(), 1.0, most)?;
        within("number of lines", self.lines.into(), 1.0, 256.0)?;
        Ok(Directions::new(self.directions).expect("checked above"))
    }
}

/// How rays are answered.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct ConeQuery {
    /// `T`: a ray ends at a node when its solid angle is more than `T` times that of the node's bounding sphere. Smaller is
    /// faster, smoother and less accurate; infinite is exact.
    threshold: f32,
    /// Largest angle at which a node may end a ray, as radius over distance.
    pub(super) widest: f32,
    /// What happens at the ends of segments.
    pub ends: SegmentEnds,
    /// Blending.
    pub blend: Blend,
}

impl ConeQuery {
    /// Exact answers: no node ends a ray.
    pub const EXACT: Self = Self {
        threshold: f32::INFINITY,
        widest: Self::WIDEST,
        ends: SegmentEnds::Fraction,
        blend: Blend::Random,
    };
    /// The default of [`Self::with_widest`].
    pub const WIDEST: f32 = 0.35;

    /// A query with threshold `T`.
    ///
    /// # Errors
    /// [`OcclusionError::Threshold`] if it is not above 0.
    pub fn new(threshold: f32) -> Result<Self, OcclusionError> {
        if threshold > 0.0 {
            Ok(Self { threshold, ..Self::EXACT })
        } else {
            Err(OcclusionError::Threshold(threshold))
        }
    }

    /// The threshold `T`.
    pub fn threshold(&self) -> f32 {
        self.threshold
    }

    /// Sets the largest angle at which a node may end a ray, as radius over distance; 0 is exact.
    ///
    /// # Errors
    /// [`OcclusionError::Setting`] for NaN and values below 0.
    pub fn with_widest(self, widest: f32) -> Result<Self, OcclusionError> {
        within("widest angle", widest.into(), 0.0, f64::INFINITY)?;
        Ok(Self { widest, ..self })
    }
}
