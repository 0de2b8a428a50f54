//! Why rendering or baking failed.

use umbrage_accel::BuildError;

/// Why a picture could not be made.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RenderError {
    /// An acceleration structure could not be built.
    #[error("{object}: {source}")]
    Build {
        /// Name of the mesh, or `scene`.
        object: String,
        /// What is wrong with it.
        source: BuildError,
    },
    /// A control mesh is no subdivision surface, or its rate impossible.
    #[error("{object}: {source}")]
    Surface {
        /// Name of the mesh.
        object: String,
        /// What is wrong with it.
        source: umbrage_reyes::SurfaceError,
    },
    /// A prefiltered hierarchy could not be built.
    #[error("{object}: {source}")]
    Prefilter {
        /// Name of the mesh, or `scene`.
        object: String,
        /// What is wrong with it.
        source: umbrage_occlusion::prefilter::PrefilterError,
    },
    /// No method has that name.
    #[error("unknown {purpose} method '{name}', expected one of {}", .known.join(", "))]
    Method {
        /// What was asked for.
        name: String,
        /// `shadow` or `ambient occlusion`.
        purpose: &'static str,
        /// What there is.
        known: &'static [&'static str],
    },
    /// Masks can't be used for the scene.
    #[error(
        "the method {0} can't do this scene: masks need all instances in one mesh, approximate ones opaque triangles too"
    )]
    MaskGeometry(&'static str),
    /// Rasterization needs a pinhole.
    #[error("the method mask-raster needs a camera without a lens (lens_radius 0)")]
    RasterLens,
    /// Masks can't be used with these settings.
    #[error("ambient occlusion by masks: {0}")]
    Mask(#[from] umbrage_aomask::MaskError),
    /// A count is 0 or too large.
    #[error("{what} is {value}, expected 1 to {limit}")]
    Count {
        /// Name of the setting.
        what: &'static str,
        /// Its value.
        value: u64,
        /// The largest possible value.
        limit: u64,
    },
    /// The image or the shard is impossible.
    #[error(transparent)]
    Image(#[from] crate::image::ImageError),
    /// The progress callback returned `false`.
    #[error("cancelled")]
    Cancelled,
}

impl From<umbrage_geom::Cancelled> for RenderError {
    fn from(_: umbrage_geom::Cancelled) -> Self {
        Self::Cancelled
    }
}
