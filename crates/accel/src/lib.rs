#![doc = include_str!("../README.md")]

pub mod brute;
pub mod kdtree;

mod binary;
mod boxes;
mod bvh;
mod error;
mod fan;
mod instances;
mod kernel;
mod memory;
mod node;
mod options;
mod packet;
mod solid;
mod statistics;
mod topology;
mod traversal;
mod view;

pub use binary::{BinaryNode, BinaryTree};
pub use boxes::{BoxBvh, BoxFanVisitor, BoxVisitor};
pub use bvh::{Bvh, Hit, LeafVertices};
pub use error::BuildError;
pub use fan::{FanGoal, FanRay, WALKS};
pub use instances::{InstanceBoxes, InstanceHit, InstancedBvh, Placement, object_from_world, object_ray};
pub use kdtree::KdTree;
pub use kernel::FAN;
pub use node::NodeNote;
pub use options::{BuildOptions, BuildQuality};
pub use solid::{SolidBoxes, SolidPack};
pub use statistics::{Counters, Statistics};
pub use umbrage_geom::simd::BackEnd;
pub use view::{Child, NodeView, View};
