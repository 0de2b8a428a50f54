#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

mod atomic;
mod byte_size;
mod flatten;
pub mod generate;
mod mesh_file;
mod scene;
mod scene_file;
mod view;

pub use atomic::{AtomicWriter, WriteError, check_writable, write_atomically};
pub use byte_size::{ByteSize, ByteSizeError};
pub use mesh_file::{
    MeshFileError, PlyVertices, PointCloud, VertexAttributes, WriteMeshError, read_mesh, read_ply_vertices,
    read_points, read_polygons, write_obj, write_ply, write_ply_points,
};
pub use scene::{
    Ambient, Camera, Instance, Light, Material, NamedMesh, Radius, Scene, Settings, Subdivision,
    SubdivisionRate,
};
pub use scene_file::SceneError;
pub use view::Ground;
