#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

mod color;
pub mod compare;
mod error;
mod file;
mod film;
mod fingerprint;
mod openexr;
mod png;
mod shard;

pub use color::{ColorMap, linear_to_srgb8};
pub use error::ImageError;
pub use file::{Format, check_part_writable, check_writable, read, write};
pub use film::{Film, GREY, Layer, MAX_PIXELS, MAX_SIDE, RGB, XYZ, Z, names};
pub use fingerprint::Fingerprint;
pub use openexr::{encode_exr, read_exr, write_exr};
pub use png::{ValueRange, encode_png, read_png, write_grey, write_heat_map, write_picture, write_png};
pub use shard::{Merged, Part, Shard, ShardError, Tile, TileGrid, merge, read_part, write_part};
