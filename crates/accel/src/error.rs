//! Why a structure could not be built.

use umbrage_geom::MeshError;

/// Why building or refitting failed. Nothing is changed when it does.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum BuildError {
    /// The geometry itself can't be used.
    #[error(transparent)]
    Mesh(#[from] MeshError),
    /// More primitives than node references can count.
    #[error("{count} {what} are more than one hierarchy can hold ({limit})")]
    TooMany {
        /// `triangles` or `instances`.
        what: &'static str,
        /// How many there are.
        count: usize,
        /// How many there may be.
        limit: usize,
    },
    /// A box is empty or not finite.
    #[error("box {index} is empty or not finite")]
    Box {
        /// Index of the box, from 0.
        index: usize,
    },
    /// A refit brought another number of things than the build.
    #[error("refit with {count} {what}, but the hierarchy was built with {expected}")]
    Count {
        /// `vertices` or `instances`.
        what: &'static str,
        /// How many came.
        count: usize,
        /// How many were there at the build.
        expected: usize,
    },
    /// A placement names a hierarchy that does not exist.
    #[error("instance {instance} uses hierarchy {bvh}, but there are only {bvhs} (indices from 0)")]
    BvhIndex {
        /// Index of the placement, from 0.
        instance: usize,
        /// The hierarchy it names.
        bvh: u32,
        /// How many there are.
        bvhs: usize,
    },
    /// A transform has an entry that is NaN or infinite.
    #[error("the transform of instance {instance} is not finite")]
    TransformNotFinite {
        /// Index of the placement, from 0.
        instance: usize,
    },
    /// A transform can't be inverted: its condition number (largest row sum times that of the inverse) is over `2^24`.
    #[error("the transform of instance {instance} is singular or nearly so")]
    TransformSingular {
        /// Index of the placement, from 0.
        instance: usize,
    },
    /// A transform moves its object beyond [`umbrage_geom::mesh::MAX_COORDINATE`].
    #[error("the transform of instance {instance} moves it beyond {}", umbrage_geom::mesh::MAX_COORDINATE)]
    TransformTooFar {
        /// Index of the placement, from 0.
        instance: usize,
    },
    /// A progress callback stopped the build.
    #[error(transparent)]
    Cancelled(#[from] umbrage_geom::Cancelled),
    /// The back end needs instructions that this processor lacks.
    #[error("this processor has no support for the back end {0:?}")]
    BackEnd(crate::BackEnd),
}
