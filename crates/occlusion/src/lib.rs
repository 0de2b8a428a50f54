#![doc = include_str!("../README.md")]
#![deny(unsafe_code)] // but for `kernel/x86.rs` of each module

pub mod prefilter;
pub mod volumetric;
