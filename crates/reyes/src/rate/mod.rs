//! How finely patches are divided: lengths of micropolygon edges at each rate, footprints of rays, rates for a picture.

mod eye;
pub(crate) mod footprint;
pub(crate) mod length;

pub use eye::EyeRates;
pub use footprint::{camera_differential, light_differential, reflect, refract};
pub use length::MAX_LEVEL;
