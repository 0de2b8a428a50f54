//! Why a surface could not be built or traced.

use umbrage_accel::BuildError;
use umbrage_geom::{Cancelled, MeshError};

/// What is wrong with a control mesh or with options. Nothing is built then.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum SurfaceError {
    /// No faces, too many elements, or coordinates that can't be used.
    #[error(transparent)]
    Mesh(#[from] MeshError),
    /// Sizes of faces don't add up to the number of corners.
    #[error("faces have {expected} corners in all, but {count} are given")]
    CornerCount {
        /// Corners given.
        count: usize,
        /// Sum of the faces' sizes.
        expected: usize,
    },
    /// There must be one texture coordinate a corner, or none at all.
    #[error("{count} texture coordinates for {expected} corners")]
    UvCount {
        /// Texture coordinates given.
        count: usize,
        /// Corners of all faces.
        expected: usize,
    },
    /// A texture coordinate is NaN or infinite.
    #[error("the texture coordinate of corner {corner} is not finite")]
    UvNotFinite {
        /// Index of the corner, from 0.
        corner: usize,
    },
    /// A face has fewer than three corners, or more than fit a vertex's one-ring.
    #[error("face {face} has {size} corners, expected 3 to {max}", max = crate::MAX_VALENCE)]
    FaceSize {
        /// Index of the face, from 0.
        face: usize,
        /// Its corners.
        size: u32,
    },
    /// A corner names a vertex that does not exist.
    #[error("face {face} uses vertex {vertex}, but there are only {vertices} (indices from 0)")]
    VertexIndex {
        /// Index of the face, from 0.
        face: usize,
        /// The vertex it names.
        vertex: u32,
        /// How many there are.
        vertices: usize,
    },
    /// A face uses a vertex twice.
    #[error("face {face} uses vertex {vertex} more than once")]
    RepeatedVertex {
        /// Index of the face, from 0.
        face: usize,
        /// The vertex.
        vertex: u32,
    },
    /// More than two faces share an edge, or two run along it in the same direction.
    #[error("edge {0}-{1} is not manifold: it has more than two faces, or two of opposite orientation", edge[0], edge[1])]
    NonManifoldEdge {
        /// Its vertices.
        edge: [u32; 2],
    },
    /// A vertex has more faces than [`crate::MAX_VALENCE`].
    #[error("vertex {vertex} has {valence} faces, more than {max}", max = crate::MAX_VALENCE)]
    Valence {
        /// The vertex.
        vertex: u32,
        /// Its faces.
        valence: usize,
    },
    /// A crease is on no edge of the mesh.
    #[error("there is no edge {0}-{1} for a crease", edge[0], edge[1])]
    CreaseEdge {
        /// Vertices of the crease.
        edge: [u32; 2],
    },
    /// A sharp vertex does not exist.
    #[error("sharp vertex {vertex} does not exist: there are only {vertices} (indices from 0)")]
    SharpVertex {
        /// The vertex.
        vertex: u32,
        /// How many there are.
        vertices: usize,
    },
    /// A sharpness is negative or NaN.
    #[error("sharpness {0} is not a number of at least 0")]
    Sharpness(f32),
    /// Named runs of faces leave a gap, overlap or go past the end.
    #[error(
        "object '{object}' has faces {faces:?}, expected them to start at {expected} and to end with the last of {count}"
    )]
    ObjectFaces {
        /// Name of the run.
        object: String,
        /// Its faces.
        faces: std::ops::Range<u32>,
        /// Where it should start.
        expected: u32,
        /// Faces of the mesh.
        count: u32,
    },
    /// An option is out of its range.
    #[error("{name} is {value}, expected {expected}")]
    Option {
        /// Which option.
        name: &'static str,
        /// What it is.
        value: f64,
        /// What it may be.
        expected: &'static str,
    },
    /// The progress callback stopped the call.
    #[error("cancelled")]
    Cancelled,
    /// The hierarchy over patches could not be built.
    #[error(transparent)]
    Build(#[from] BuildError),
}

impl From<Cancelled> for SurfaceError {
    fn from(_: Cancelled) -> Self {
        Self::Cancelled
    }
}
