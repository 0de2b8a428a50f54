#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

mod drive;
mod error;
mod options;
pub mod pattern;
mod receiver;

pub use error::MaskError;
pub use options::{MaskOptions, Outputs, Sides};
pub use pattern::{Pattern, PatternOptions};
pub use receiver::Receiver;
