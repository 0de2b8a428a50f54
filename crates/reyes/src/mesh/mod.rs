//! Micropolygons: grids diced from parts of patches, whole surfaces at one rate a patch, and rasterization of grids.

pub(crate) mod bucket;
pub(crate) mod cells;
pub(crate) mod dice;
pub(crate) mod grid;
pub(crate) mod rated;
pub(crate) mod tessellate;
