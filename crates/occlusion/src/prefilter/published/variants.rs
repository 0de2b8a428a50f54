//! Published variants and forms of storage, which [`PrefilterOptions`] and [`ConeQuery`] can choose in place of what ships.

use super::super::{ConeQuery, PrefilterOptions};

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

/// The correlation height of [`PrefilterOptions`] that lets every node end rays.
impl Correlation {
    /// Every node may end rays, single triangles excepted.
    pub const ANYWHERE: Self = Self::Height(0.0);
}

impl PrefilterOptions {
    /// Sets [`Self::correlation`].
    #[must_use]
    pub fn with_correlation(self, correlation: Correlation) -> Self {
        Self { correlation, ..self }
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
}

impl ConeQuery {
    /// Sets [`Self::ends`].
    #[must_use]
    pub fn with_ends(mut self, ends: SegmentEnds) -> Self {
        self.ends = ends;
        self
    }

    /// Sets [`Self::blend`].
    #[must_use]
    pub fn with_blend(mut self, blend: Blend) -> Self {
        self.blend = blend;
        self
    }
}
