#![doc = include_str!("../README.md")]
#![deny(unsafe_code)] // but for `exact/kernel/x86.rs`

mod call;
pub mod coarse;
mod drive;
mod error;
pub mod exact;
mod gather;
mod options;
pub mod pattern;
pub mod published;
pub mod raster;
mod receiver;
pub mod table;

pub use call::MaskCall;
pub use error::MaskError;
pub use options::{MaskOptions, Outputs, Sides};
pub use pattern::{Pattern, PatternOptions, Points};
pub use raster::{RasterCall, RasterCamera, RasterLevel, RasterOptions, RasterView};
pub use receiver::Receiver;
pub use table::{MaskTables, TableOptions};
pub use umbrage_geom::simd::BackEnd;
