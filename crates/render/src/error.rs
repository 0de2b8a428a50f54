//! Why rendering failed.

use umbrage_query::QueryError;

/// Why a picture could not be made.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RenderError {
    /// The occluders or a method could not be made ready, or the method can't answer.
    #[error(transparent)]
    Query(QueryError),
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
    /// A target error can't be aimed at.
    #[error("can't aim at the target error: {0}")]
    TargetError(&'static str),
    /// The image or the shard is impossible.
    #[error(transparent)]
    Image(#[from] umbrage_image::ImageError),
    /// The progress callback returned `false`.
    #[error("cancelled")]
    Cancelled,
}

impl From<QueryError> for RenderError {
    fn from(error: QueryError) -> Self {
        match error {
            QueryError::Cancelled => Self::Cancelled,
            other => Self::Query(other),
        }
    }
}

impl From<umbrage_geom::Cancelled> for RenderError {
    fn from(_: umbrage_geom::Cancelled) -> Self {
        Self::Cancelled
    }
}
