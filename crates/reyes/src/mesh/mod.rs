//! Micropolygons: grids of parts of patches, and whole surfaces at one rate a patch.

mod cells;
pub(crate) mod dice;
pub(crate) mod grid;
mod rated;
mod tessellate;

pub use rated::{RatedHit, RatedSurface};
