//! What tests and benchmarks of the workspace share and users don't need: the unbiased reference of ambient occlusion.
#![forbid(unsafe_code)]

mod generator;
pub mod reference;

pub use reference::{Question, Reference};
