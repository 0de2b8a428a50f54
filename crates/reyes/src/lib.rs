#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

mod bucket;
mod build;
mod cache;
mod cells;
mod diagsplit;
mod dice;
mod error;
mod eye;
mod footprint;
mod grid;
mod kernel;
mod length;
mod occluder;
mod options;
mod patch;
mod rated;
mod state;
mod subdiv;
mod surface;
mod tessellate;
mod trace;

pub use bucket::{BucketOptions, Fragment, RasterCamera, rasterize};
pub use error::SurfaceError;
pub use eye::EyeRates;
pub use footprint::{camera_differential, light_differential, reflect, refract};
pub use length::MAX_LEVEL;
pub use options::{Borders, FootprintRule, Rates, TraceOptions};
pub use patch::Bicubic;
pub use rated::{RatedHit, RatedSurface};
pub use state::TraceState;
pub use subdiv::{BoundaryRule, CreaseMethod, INFINITE_SHARPNESS, MAX_VALENCE, SubdivisionMesh};
pub use surface::{Bounds, LimitPoint, Surface, SurfaceCounts, SurfaceOptions};
pub use trace::{SurfaceHit, SurfaceTracer, TraceCounts};
