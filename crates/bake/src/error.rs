//! Why baking failed.

use umbrage_geom::{FalloffError, MeshError};
use umbrage_query::QueryError;

/// Why occlusion could not be baked. Nothing has been written to the caller's slices.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum BakeError {
    /// A mesh can't be used.
    #[error("mesh {index}: {source}")]
    Mesh {
        /// Which of the meshes given, from 0.
        index: usize,
        /// What is wrong with it.
        source: MeshError,
    },
    /// The occluders or the method could not be made ready, or the method can't answer.
    #[error(transparent)]
    Query(QueryError),
    /// A setting is 0 or too large.
    #[error("{what} is {value}, expected 1 to {limit}")]
    Count {
        /// Name of the setting.
        what: &'static str,
        /// Its value.
        value: u64,
        /// Largest possible value.
        limit: u64,
    },
    /// The radius is 0, negative or NaN.
    #[error("radius is {0}, expected more than 0")]
    Radius(f32),
    /// A falloff other than constant without a radius that it could refer to.
    #[error("a falloff other than constant needs a radius")]
    FalloffWithoutRadius,
    /// The falloff can't be used.
    #[error(transparent)]
    Falloff(#[from] FalloffError),
    /// The bias is negative or not finite.
    #[error("bias is {0}, expected a finite distance of at least 0")]
    Bias(f32),
    /// Points and normals, or receivers and results, differ in number.
    #[error("{what}: {actual} for {expected} receiver points")]
    Length {
        /// `normals` or `results`.
        what: &'static str,
        /// How many there are.
        actual: usize,
        /// How many there should be.
        expected: usize,
    },
    /// A receiver point is NaN, infinite or farther out than geometry may be.
    #[error("receiver point {index} is not usable: ({}, {}, {})", .point[0], .point[1], .point[2])]
    Point {
        /// Index of the point, from 0.
        index: usize,
        /// The point.
        point: [f32; 3],
    },
    /// A receiver's normal is zero or not finite.
    #[error("the normal of receiver {index} is zero or not finite: ({}, {}, {})", .normal[0], .normal[1], .normal[2])]
    Normal {
        /// Index of the receiver, from 0.
        index: usize,
        /// The normal.
        normal: [f32; 3],
    },
    /// Normals from the file were asked for, but there are none.
    #[error("the mesh has no normals; choose geometric or smooth ones")]
    NoNormals,
    /// Baking per texel needs texture coordinates.
    #[error("the mesh has no texture coordinates, which baking per texel needs")]
    NoUvs,
    /// A texture coordinate is NaN, infinite or absurdly large, or a triangle spans too many repeats of the image.
    #[error(
        "the texture coordinates of triangle {triangle} are not finite or span more than {limit} repeats of the image"
    )]
    Uv {
        /// Index of the triangle, from 0.
        triangle: usize,
        /// Most repeats that one triangle may span, and largest distance from 0 in units of 1024 of them.
        limit: u32,
    },
    /// No triangle covers the centre of any texel.
    #[error("no triangle covers a texel: the texture coordinates have no area at {width} x {height}")]
    NoTexel {
        /// Texels across.
        width: u32,
        /// Texels down.
        height: u32,
    },
    /// There are more shards than blocks of receivers.
    #[error("{count} shards are not possible: there are {blocks} blocks of receivers to share")]
    Shard {
        /// How many shards.
        count: u32,
        /// How many blocks of receivers there are to share.
        blocks: usize,
    },
    /// Masks could not be computed.
    #[error(transparent)]
    Mask(umbrage_aomask::MaskError),
    /// The target error is 0, negative or NaN, or the method can't aim at one.
    #[error("target error: {0}")]
    TargetError(&'static str),
    /// Rays could not be written down.
    #[error("writing rays: {0}")]
    Dump(std::io::Error),
    /// The progress callback returned `false`.
    #[error("cancelled")]
    Cancelled,
}

impl From<umbrage_geom::Cancelled> for BakeError {
    fn from(_: umbrage_geom::Cancelled) -> Self {
        Self::Cancelled
    }
}

impl From<umbrage_aomask::MaskError> for BakeError {
    fn from(error: umbrage_aomask::MaskError) -> Self {
        match error {
            umbrage_aomask::MaskError::Cancelled => Self::Cancelled,
            other => Self::Mask(other),
        }
    }
}

impl From<QueryError> for BakeError {
    fn from(error: QueryError) -> Self {
        match error {
            QueryError::Cancelled => Self::Cancelled,
            QueryError::Mask(source) => Self::Mask(source),
            other => Self::Query(other),
        }
    }
}
