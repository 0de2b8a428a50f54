#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

mod error;
pub mod prefilter;
pub mod volumetric;

pub use error::OcclusionError;
