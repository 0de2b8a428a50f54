//! What only comparisons with the papers need: the classic Reyes path by buckets, the deferment list, and the rules by which
//! others set rates.
//!
//! The rules of rays are variants of [`FootprintRule`]; their code is here.

mod bucket;
mod deferred;
mod diagsplit;
mod rules;

use crate::{Borders, FootprintRule, Rates, TraceOptions};
pub use bucket::{BucketCamera, BucketOptions, Fragment, rasterize_buckets};
pub use deferred::any_hit_deferred;

/// Options as Djeu 2011 has them: equal rates, cracks where they form.
pub fn trace_options(footprint: FootprintRule) -> TraceOptions {
    TraceOptions::default().with_footprint(footprint).with_borders(Borders::Open).with_rates(Rates::Equal)
}
