#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

mod error;
mod mesh;
mod options;
mod patch;
mod rate;
mod subdiv;
mod surface;
mod trace;

pub mod published;

pub use error::SurfaceError;
pub use mesh::rated::{RatedHit, RatedSurface};
pub use options::{Borders, FootprintRule, Rates, TraceOptions};
pub use patch::Bicubic;
pub use rate::eye::EyeRates;
pub use rate::footprint::{camera_differential, light_differential, reflect, refract};
pub use rate::length::MAX_LEVEL;
pub use subdiv::{BoundaryRule, CreaseMethod, INFINITE_SHARPNESS, MAX_VALENCE, SubdivisionMesh};
pub use surface::{Bounds, LimitPoint, Surface, SurfaceCounts, SurfaceOptions};
pub use trace::state::TraceState;
pub use trace::{SurfaceHit, SurfaceTracer, TraceCounts};
