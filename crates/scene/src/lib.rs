#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

pub mod atomic;
mod flatten;
pub mod generate;
pub mod mesh_file;
pub mod scene;
pub mod scene_file;

mod view;

pub use atomic::{WriteError, check_writable, write_atomically};
pub use mesh_file::{
    MeshFileError, PlyVertices, Points, VertexAttributes, WriteMeshError, read_mesh, read_ply_vertices,
    read_points, read_polygons, write_obj, write_ply, write_ply_points,
};
pub use scene::{
    Ambient, Camera, Instance, Light, Material, NamedMesh, Radius, Scene, Settings, Subdivision,
    SubdivisionRate,
};
pub use scene_file::SceneError;
pub use view::Ground;
