//! What only comparisons with `[Laine10]` need: the published pattern of rays, and both ways to find masks of nodes
//! ([`NodeMasks`], which [`crate::TableOptions`] chooses).
//!
//! [`relaxed`] gives the rays of section 6 of the paper, jittered as in section 3. They are *biased*: each ray is the centroid of
//! a cell of the disc, so no ray comes near the horizon, and a small rotation and tilt don't make up for it. Against the reference
//! of `docs/accuracy.md`, in the mean over its scenes, `ao` is too bright by about 0.007 with 32 rays, 0.006 with 64, 0.002 with 256
//! and 0.001 with 1024.

pub(crate) mod lloyd;

pub use crate::table::node_mask::NodeMasks;

use crate::pattern::{PatternOptions, Points};

/// Fraction of a turn that the published pattern is turned by at random.
const ROTATION_TURNS: f32 = 0.125;
/// Largest tilt of the published pattern, as a fraction of the sine of its lowest ray's elevation.
const TILT_OF_LOWEST_RAY: f32 = 0.2;

/// Settings of the published pattern with `rays` rays (32 to 1024, a multiple of 32).
///
/// # Source
/// `[Laine10]`, section 6 for the points, section 3 for the two jitters. Departure: relaxation starts from scrambled Sobol
/// points, see the file `lloyd.rs`.
pub fn relaxed(rays: u32) -> PatternOptions {
    PatternOptions {
        rays,
        points: Points::Relaxed,
        rotation: ROTATION_TURNS,
        tilt: TILT_OF_LOWEST_RAY,
        ..PatternOptions::default()
    }
}
