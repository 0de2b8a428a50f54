#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

pub mod bake;
pub mod baked;
pub mod camera;
pub mod cli;
pub mod compare;
mod error;
mod far;
pub mod fingerprint;
pub mod image;
pub mod inspect;
mod integrator;
pub mod light;
pub mod query;
mod raster_sky;
pub mod render;
pub mod subdivide;
mod target;

pub use error::RenderError;
pub use integrator::{NO_DEPTH, RayCounts};
pub use target::Samples;
