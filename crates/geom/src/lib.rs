#![doc = include_str!("../README.md")]

pub mod aabb;
pub mod audit;
pub mod crossing;
pub mod differential;
pub mod falloff;
pub mod frame;
pub mod kernel;
pub mod mesh;
pub mod morton;
pub mod offset;
pub mod opacity;
pub mod polygon;
pub mod progress;
pub mod ray;
pub mod sampling;
pub mod simd;
pub mod triangle;

mod exact;

pub use aabb::{Aabb, SlabRay};
pub use crossing::{Crossing, crosses_triangle, winding_number};
pub use differential::RayDifferential;
pub use falloff::{Falloff, FalloffError};
pub use frame::Frame;
pub use glam;
pub use mesh::{MeshError, MeshObject, TriangleMesh};
pub use offset::offset_origin;
pub use opacity::OpticalDepth;
pub use polygon::{BoundaryRule, CreaseMethod, FaceObject, PolygonMesh};
pub use progress::{Cancelled, Progress};
pub use ray::Ray;
pub use triangle::{TriangleHit, intersect_triangle, is_degenerate, plane_side, segment_hits_triangle};
