//! Why a study could not be made.

use umbrage_bake::BakeError;
use umbrage_geom::{Cancelled, MeshError};
use umbrage_image::ImageError;
use umbrage_query::QueryError;
use umbrage_render::RenderError;

/// Why a study could not be made.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum StudyError {
    /// A mesh can't be used.
    #[error(transparent)]
    Mesh(#[from] MeshError),
    /// A structure could not be built or a call not be answered.
    #[error(transparent)]
    Query(QueryError),
    /// Receivers could not be made.
    #[error(transparent)]
    Bake(BakeError),
    /// A picture could not be rendered.
    #[error(transparent)]
    Render(RenderError),
    /// A picture could not be encoded.
    #[error(transparent)]
    Image(#[from] ImageError),
    /// Nothing can ask: no vertex has a direction, no texel is covered, or the camera sees no surface.
    #[error("there is no receiver: {0}")]
    NoReceiver(&'static str),
    /// An option is out of range.
    #[error("{what} {value} is out of range: {range}")]
    Option {
        /// Name of the option.
        what: &'static str,
        /// Its value.
        value: String,
        /// What is accepted.
        range: &'static str,
    },
    /// The page could not be written.
    #[error("report: {0}")]
    Page(String),
    /// The progress callback said so.
    #[error("cancelled")]
    Cancelled,
}

impl From<Cancelled> for StudyError {
    fn from(_: Cancelled) -> Self {
        Self::Cancelled
    }
}

impl From<QueryError> for StudyError {
    fn from(error: QueryError) -> Self {
        match error {
            QueryError::Cancelled => Self::Cancelled,
            other => Self::Query(other),
        }
    }
}

impl From<BakeError> for StudyError {
    fn from(error: BakeError) -> Self {
        match error {
            BakeError::Cancelled => Self::Cancelled,
            other => Self::Bake(other),
        }
    }
}

impl From<RenderError> for StudyError {
    fn from(error: RenderError) -> Self {
        match error {
            RenderError::Cancelled => Self::Cancelled,
            other => Self::Render(other),
        }
    }
}
