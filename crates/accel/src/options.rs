//! How a hierarchy is built.

/// What a build spends its time on. Answers don't depend on it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum BuildQuality {
    /// Locally ordered clustering alone (PLOC, Meister and Bittner 2018).
    Fast,
    /// A wider search, then reinsertion of subtrees where that lowers the surface area cost (Meister and Bittner 2017).
    #[default]
    High,
}

/// Options of [`crate::Bvh::build`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct BuildOptions {
    /// What the build spends its time on.
    pub quality: BuildQuality,
    /// Most triangles in a leaf, 1 to 8; other values are clamped. Against 4, the default of 8 takes 0.6 of the memory and
    /// answers 2 to 15 % more any-hit queries on AVX2 (AMD EPYC, `examples/anyhit_speed.rs`, bunny_60k and a sphere of 1 M).
    pub leaf_size: u8,
}

impl Default for BuildOptions {
    fn default() -> Self {
        Self { quality: BuildQuality::High, leaf_size: 8 }
    }
}

impl BuildOptions {
    /// With another [`Self::quality`].
    #[must_use]
    pub fn with_quality(self, quality: BuildQuality) -> Self {
        Self { quality, ..self }
    }

    /// With another [`Self::leaf_size`].
    #[must_use]
    pub fn with_leaf_size(self, leaf_size: u8) -> Self {
        Self { leaf_size, ..self }
    }
}
