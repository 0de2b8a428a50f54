//! Why a query could not be answered.

use umbrage_accel::BuildError;
use umbrage_aomask::MaskError;
use umbrage_geom::MeshError;
use umbrage_occlusion::OcclusionError;
use umbrage_reyes::SurfaceError;

/// Why occluders or an engine could not be built, or a call not be answered.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum QueryError {
    /// No method has that name.
    #[error("unknown {purpose} method '{name}', expected one of {}", .known.join(", "))]
    UnknownMethod {
        /// What was asked for.
        name: String,
        /// `shadow`, `ambient occlusion` or `surface`.
        purpose: &'static str,
        /// Names of all methods.
        known: Vec<&'static str>,
    },
    /// The method can't answer what it was asked. No other method answers in its place.
    #[error("method {method} can't be used here: {reason}")]
    Unsupported {
        /// The method that was asked for.
        method: &'static str,
        /// Why it can't answer.
        reason: &'static str,
    },
    /// An acceleration structure could not be built.
    #[error("{object}: {source}")]
    Build {
        /// Name of the mesh, `scene` or `instances`.
        object: String,
        /// What is wrong with it.
        source: BuildError,
    },
    /// A mesh can't be used.
    #[error("mesh {index}: {source}")]
    Mesh {
        /// Which of the meshes given, from 0.
        index: usize,
        /// What is wrong with it.
        source: MeshError,
    },
    /// There is nothing that could occlude.
    #[error("no occluder: at least one mesh is needed")]
    NoOccluder,
    /// A control mesh is no subdivision surface, or its rate impossible.
    #[error("{object}: {source}")]
    Surface {
        /// Name of the mesh.
        object: String,
        /// What is wrong with it.
        source: SurfaceError,
    },
    /// Stored or volumetric occlusion could not be built or used.
    #[error("occlusion: {0}")]
    Occlusion(OcclusionError),
    /// Masks can't be used with these settings.
    #[error("ambient occlusion by masks: {0}")]
    Mask(MaskError),
    /// The progress callback returned `false`.
    #[error("cancelled")]
    Cancelled,
}

impl QueryError {
    /// Why a structure over `object` could not be built.
    pub(crate) fn from_build(object: &str, source: BuildError) -> Self {
        match source {
            BuildError::Cancelled(_) => Self::Cancelled,
            source => Self::Build { object: object.into(), source },
        }
    }
}

impl QueryError {
    /// Why the subdivision surface `object` can't be used.
    pub(crate) fn from_surface(object: &str, source: SurfaceError) -> Self {
        match source {
            SurfaceError::Cancelled => Self::Cancelled,
            source => Self::Surface { object: object.into(), source },
        }
    }
}

impl From<umbrage_geom::Cancelled> for QueryError {
    fn from(_: umbrage_geom::Cancelled) -> Self {
        Self::Cancelled
    }
}

impl From<MaskError> for QueryError {
    fn from(error: MaskError) -> Self {
        match error {
            MaskError::Cancelled => Self::Cancelled,
            other => Self::Mask(other),
        }
    }
}

impl From<OcclusionError> for QueryError {
    fn from(error: OcclusionError) -> Self {
        match error {
            OcclusionError::Cancelled => Self::Cancelled,
            other => Self::Occlusion(other),
        }
    }
}
