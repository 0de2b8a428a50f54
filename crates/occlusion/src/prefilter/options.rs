//! What can be chosen when a hierarchy is prefiltered and when it is asked.

use super::Directions;
use crate::OcclusionError;
use umbrage_accel::BuildQuality;

/// Which nodes may end rays.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub enum Correlation {
    /// Nodes that are wide against every connected surface in them: no setting, see `correlation.rs`.
    Automatic,
    /// Nodes above one height everywhere, as published: leaves have height 0, others the mean of their children plus 1.
    Height(f32),
}

/// Directions in which opacity is measured.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum CellSampling {
    /// All over the cell.
    #[default]
    Jittered,
    /// Its centre, as published. Some centres are axes, along which boxes have their smallest silhouettes: darker.
    Center,
}

/// How opacities are stored (`[Lacewell08]`, section 4.4).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum Storage {
    /// Cube map of `f32`.
    CubeF32,
    /// Cube map of bytes: square roots of optical depths up to 12 bits.
    CubeU8,
    /// Cube map of half bytes, rounded at random.
    #[default]
    CubeU4,
    /// Spherical harmonics of bands 0 and 2, six bytes. Odd bands are 0, since opposite directions see the same.
    Harmonics2,
    /// Bands 0, 2 and 4, fifteen bytes.
    Harmonics4,
    /// The mean over directions, one byte ("DC").
    Average,
    /// The published ad-hoc formula from areas of bounding spheres, one byte.
    SphereArea,
}

impl Storage {
    /// All forms.
    pub const ALL: [Self; 7] = [
        Self::CubeF32,
        Self::CubeU8,
        Self::CubeU4,
        Self::Harmonics4,
        Self::Harmonics2,
        Self::Average,
        Self::SphereArea,
    ];

    /// A name for tables and command lines.
    pub fn name(self) -> &'static str {
        match self {
            Self::CubeF32 => "cube-f32",
            Self::CubeU8 => "cube-u8",
            Self::CubeU4 => "cube-u4",
            Self::Harmonics2 => "sh2",
            Self::Harmonics4 => "sh4",
            Self::Average => "dc",
            Self::SphereArea => "sphere-area",
        }
    }
}

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
    /// Sets [`Self::correlation`].
    #[must_use]
    pub fn with_correlation(self, correlation: Correlation) -> Self {
        Self { correlation, ..self }
    }

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

    /// Sets [`Self::sampling`].
    #[must_use]
    pub fn with_sampling(self, sampling: CellSampling) -> Self {
        Self { sampling, ..self }
    }

    /// Sets [`Self::storage`].
    #[must_use]
    pub fn with_storage(self, storage: Storage) -> Self {
        Self { storage, ..self }
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

/// What becomes of a node that fits the cone but that the segment does not cross from side to side.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SegmentEnds {
    /// It dims by the crossed fraction of its optical depth.
    #[default]
    Fraction,
    /// It dims as if crossed, as published: too dark.
    Whole,
}

/// How opacities of neighbouring levels and directions are blended.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Blend {
    /// At random: each ray has a threshold up to twice larger or smaller, and a direction moved by up to an eighth of a cell.
    /// The mean over rays is that of interpolation (between directions only near the borders of cells), at no cost.
    #[default]
    Random,
    /// Not at all: the nearest direction, and one threshold.
    None,
}

/// How rays are answered.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct Query {
    /// `T`: a ray ends at a node when its solid angle is more than `T` times that of the node's bounding sphere. Smaller is
    /// faster, smoother and less accurate; infinite is exact.
    threshold: f32,
    /// Largest angle at which a node may end a ray, as radius over distance.
    pub widest: f32,
    /// What happens at the ends of segments.
    pub ends: SegmentEnds,
    /// Blending.
    pub blend: Blend,
}

impl Query {
    /// Exact answers: no node ends a ray.
    pub const EXACT: Self = Self {
        threshold: f32::INFINITY,
        widest: Self::WIDEST,
        ends: SegmentEnds::Fraction,
        blend: Blend::Random,
    };
    /// The default of [`Self::widest`].
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

    /// Sets [`Self::widest`]; NaN and values below 0 count as 0, which is exact.
    #[must_use]
    pub fn with_widest(self, widest: f32) -> Self {
        Self { widest: widest.max(0.0), ..self }
    }

    /// Sets [`Self::ends`].
    #[must_use]
    pub fn with_ends(self, ends: SegmentEnds) -> Self {
        Self { ends, ..self }
    }

    /// Sets [`Self::blend`].
    #[must_use]
    pub fn with_blend(self, blend: Blend) -> Self {
        Self { blend, ..self }
    }
}
