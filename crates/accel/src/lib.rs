#![doc = include_str!("../README.md")]

pub mod brute;

mod boxes;
mod bvh;
mod error;
mod instances;
mod kernel;
mod node;
mod options;
mod packet;
mod statistics;
mod topology;
mod traversal;

pub use boxes::BoxBvh;
pub use bvh::{Bvh, Hit};
pub use error::BuildError;
pub use instances::{InstanceHit, InstancedBvh, Placement, object_from_world, object_ray};
pub use kernel::BackEnd;
pub use options::{BuildOptions, BuildQuality};
pub use statistics::{Counters, Statistics};
