#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

pub mod prefilter;
pub mod volumetric;
