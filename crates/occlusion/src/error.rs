//! Why a structure could not be built or asked.

use umbrage_accel::BuildError;
use umbrage_geom::{Cancelled, MeshError};

/// Why a build or a query failed. Nothing is changed when it does.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum OcclusionError {
    /// The geometry itself can't be used.
    #[error(transparent)]
    Mesh(#[from] MeshError),
    /// The hierarchy could not be built.
    #[error(transparent)]
    Build(BuildError),
    /// An object names triangles that don't exist, or ends before it starts.
    #[error("object {object} has the triangles {start} to {end} of {triangles}")]
    Object {
        /// Index of the object, from 0.
        object: usize,
        /// Its first triangle.
        start: u32,
        /// The one after its last.
        end: u32,
        /// How many triangles there are.
        triangles: usize,
    },
    /// A triangle belongs to two objects.
    #[error("triangle {triangle} belongs to the objects {} and {}", .objects[0], .objects[1])]
    Overlap {
        /// Index of the triangle, from 0.
        triangle: u32,
        /// Both objects.
        objects: [usize; 2],
    },
    /// A hierarchy or tree is over other triangles than the mesh's.
    #[error("a hierarchy of {count} triangles was given for a mesh of {triangles}")]
    Triangles {
        /// How many the hierarchy has.
        count: usize,
        /// How many the mesh has.
        triangles: usize,
    },
    /// There is not one mesh for each hierarchy that is placed.
    #[error("{meshes} meshes with solid boxes for {hierarchies} hierarchies")]
    Meshes {
        /// How many meshes came.
        meshes: usize,
        /// How many hierarchies there are.
        hierarchies: usize,
    },
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

impl From<Cancelled> for OcclusionError {
    fn from(_: Cancelled) -> Self {
        Self::Cancelled
    }
}

impl From<BuildError> for OcclusionError {
    fn from(error: BuildError) -> Self {
        match error {
            BuildError::Cancelled(_) => Self::Cancelled,
            other => Self::Build(other),
        }
    }
}
