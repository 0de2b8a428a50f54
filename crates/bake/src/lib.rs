#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

pub mod baked;
mod call;
mod error;
mod integrate;
mod lobes;
mod mask;
mod options;
mod receivers;
mod texel;

#[cfg(test)]
mod tests;

pub use call::Bake;
pub use error::BakeError;
pub use integrate::blocks;
pub use options::{BakeOptions, Jitter, NormalSource};
pub use receivers::Receivers;
pub use texel::{TexelImage, TexelMap, VAxis};
pub use umbrage_image::Shard;
