//! Why a prefiltered hierarchy could not be built or asked.

use umbrage_accel::BuildError;
use umbrage_geom::{Cancelled, MeshError};

/// Why prefiltering or a query failed. Nothing is changed when it does.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum PrefilterError {
    /// The geometry itself can't be used.
    #[error(transparent)]
    Mesh(#[from] MeshError),
    /// The hierarchy could not be built.
    #[error(transparent)]
    Build(#[from] BuildError),
    /// Opacities were neither one for all triangles nor one for each.
    #[error("{count} opacities for {triangles} triangles: give one for all, or one for each")]
    OpacityCount {
        /// How many came.
        count: usize,
        /// How many triangles there are.
        triangles: usize,
    },
    /// An opacity is outside `[0, 1]` or NaN.
    #[error("opacity {index} is {value}, which is not between 0 and 1")]
    Opacity {
        /// Index in the caller's slice.
        index: usize,
        /// Its value.
        value: f32,
    },
    /// The correlation height is negative, NaN or infinite.
    #[error("correlation height {0} is not a finite number from 0")]
    CorrelationHeight(f32),
    /// A setting is outside its range.
    #[error("{what} is {value}, which is not between {least} and {most}")]
    Setting {
        /// Name of the setting.
        what: &'static str,
        /// Its value.
        value: f64,
        /// Smallest one allowed.
        least: f64,
        /// Largest one allowed.
        most: f64,
    },
    /// The threshold `T` is not above 0.
    #[error("threshold {0} is not above 0")]
    Threshold(f32),
    /// Not as many hierarchies were named as there are instances.
    #[error("{count} prefiltered hierarchies are named for {instances} instances")]
    InstanceCount {
        /// How many came.
        count: usize,
        /// How many instances there are.
        instances: usize,
    },
    /// An instance names a prefiltered hierarchy that does not exist, or one over other triangles than the instance's.
    #[error("instance {instance} can't use prefiltered hierarchy {hierarchy}")]
    Hierarchy {
        /// Index of the instance.
        instance: usize,
        /// The hierarchy it names.
        hierarchy: u32,
    },
    /// Pilot receivers are missing, or the target is not above 0.
    #[error("a target error of {target} over {receivers} receivers can't be aimed at")]
    Target {
        /// The error asked for.
        target: f32,
        /// How many receivers came.
        receivers: usize,
    },
    /// The progress callback said so.
    #[error("cancelled")]
    Cancelled,
}

impl From<Cancelled> for PrefilterError {
    fn from(_: Cancelled) -> Self {
        Self::Cancelled
    }
}
