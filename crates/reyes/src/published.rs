//! What only comparisons with the literature need.
//!
//! Rays traced as Djeu 2011 publishes them are those of [`crate::TraceOptions::published`].

pub use crate::mesh::bucket::{BucketOptions, Fragment, RasterCamera, rasterize};
