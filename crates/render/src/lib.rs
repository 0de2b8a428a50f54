#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

mod camera;
mod error;
mod integrator;
mod light;
mod picture;
mod raster_sky;
mod target;

pub use camera::CameraRays;
pub use error::RenderError;
pub use integrator::{NO_DEPTH, RayCounts};
pub use light::{Incoming, LightSampler};
pub use picture::{MAX_SAMPLES, MethodUsed, RenderOptions, Rendered, TILE, check_settings, render};
pub use target::Samples;
