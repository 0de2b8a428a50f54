#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

mod error;
mod mesh;
mod patch;
pub mod published;
mod rate;
mod subdiv;
mod surface;
mod trace;

pub use error::SurfaceError;
pub use mesh::{RatedHit, RatedSurface};
pub use patch::Bicubic;
pub use rate::{EyeRates, MAX_LEVEL, camera_differential, light_differential, reflect, refract};
pub use subdiv::{BoundaryRule, CreaseMethod, INFINITE_SHARPNESS, MAX_VALENCE, SubdivisionMesh};
pub use surface::{LimitPoint, PatchBounds, Surface, SurfaceCounts, SurfaceOptions};
pub use trace::{
    Borders, FootprintRule, Rates, SurfaceHit, SurfaceTracer, TraceCounts, TraceOptions, TraceState,
};
