//! The pattern of rays that every receiver shares (`[Laine10]`, sections 1, 3 and 6).
//!
//! Here: directions, lengths, their order, the two jitters, and the one arithmetic that turns a pattern into world-space
//! rays. Not here: how points of the disc are made (`lloyd.rs`).
//!
//! # World-space rays
//! Ray `i` of a receiver has `origin` = the receiver's point, `tnear` = 0, `tfar = radius * lengths[i]` and
//!
//! ```text
//! direction = tangent * d.x + bitangent * d.y + normal * d.z      (d = directions[i]; (a + b) + c, no fused operation)
//! ```
//!
//! with the frame of [`Pattern::frame_of`], all in `f32`. Whoever computes the same casts the same rays, bit for bit. `tfar`
//! is in units of `direction`, whose length is 1 to within 1e-6. A ray of length 0 is not [valid](Ray::is_valid): it hits
//! nothing.

mod lloyd;

use crate::{MaskError, Receiver};
use umbrage_geom::{
    Falloff, Frame, Ray,
    glam::{Vec2, Vec3},
    sampling::{Rotation, combine, concentric_disc, hash, lift, sobol_4d},
};

/// Different jitters; a receiver's seed chooses one.
const JITTERS: u32 = 1024;

/// Rays that stay together in every split of the order.
const UNIT: usize = 32;

/// Settings of a pattern. Start from the default: 128 rays of equal length.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct PatternOptions {
    /// Rays of a receiver: a multiple of 32, 32 to [`Pattern::MAX_RAYS`].
    pub rays: u32,
    /// How occlusion fades with distance; ray lengths are distributed by it.
    pub falloff: Falloff,
    /// Width of the range of random rotations about the normal, turns, 0 to 1.
    pub rotation: f32,
    /// How far the normal may tilt at random, as a fraction of the sine of the lowest ray's elevation, 0 to 0.95: below 1 no
    /// ray gets under the receiver's tangent plane. More shows as noise between receivers: at 0.9 up to 0.03 of `ao`.
    pub tilt: f32,
    /// Seed of points and jitters.
    pub seed: u32,
}

impl Default for PatternOptions {
    fn default() -> Self {
        Self { rays: 128, falloff: Falloff::Constant, rotation: 0.125, tilt: 0.2, seed: 0 }
    }
}

impl PatternOptions {
    /// Sets [`Self::rays`].
    #[must_use]
    pub fn with_rays(self, rays: u32) -> Self {
        Self { rays, ..self }
    }

    /// Sets [`Self::falloff`].
    #[must_use]
    pub fn with_falloff(self, falloff: Falloff) -> Self {
        Self { falloff, ..self }
    }

    /// Sets [`Self::rotation`] and [`Self::tilt`]; zeros turn jitter off.
    #[must_use]
    pub fn with_jitter(self, rotation: f32, tilt: f32) -> Self {
        Self { rotation, tilt, ..self }
    }

    /// Sets [`Self::seed`].
    #[must_use]
    pub fn with_seed(self, seed: u32) -> Self {
        Self { seed, ..self }
    }

    fn validate(&self) -> Result<(), MaskError> {
        if self.rays == 0 || self.rays > Pattern::MAX_RAYS || !self.rays.is_multiple_of(UNIT as u32) {
            return Err(MaskError::Rays(self.rays));
        }
        for (what, value, limit) in [("rotation", self.rotation, 1.0), ("tilt", self.tilt, 0.95)] {
            if !(0.0..=limit).contains(&value) {
                return Err(MaskError::Jitter { what, value, limit });
            }
        }
        if let Falloff::Table(weights) = &self.falloff {
            Falloff::table(weights.clone())?;
        }
        Ok(())
    }
}

/// Directions and lengths of up to 1024 rays around the z axis, in an order where neighbours are close.
///
/// Directions are cosine-weighted: each ray stands for the same share of irradiance. Every aligned run of 8, 16 or 32 rays
/// is a compact group of directions; so is every larger run that comes from halving.
#[derive(Clone, Debug, PartialEq)]
pub struct Pattern {
    directions: Box<[Vec3]>,
    lengths: Box<[f32]>,
    jitters: Box<[Jitter]>,
}

/// One rotation about the normal and one tilt of it.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Jitter {
    /// Cosine and sine.
    rotation: Vec2,
    /// Tilted normal in the frame of the receiver's normal.
    normal: Vec3,
}

impl Pattern {
    /// Most rays.
    pub const MAX_RAYS: u32 = 1024;

    /// Makes the pattern; takes milliseconds (1024 rays: 20 to 40).
    ///
    /// # Errors
    /// [`MaskError::Rays`], [`MaskError::Jitter`], [`MaskError::Falloff`].
    pub fn new(options: &PatternOptions) -> Result<Self, MaskError> {
        options.validate()?;
        let points = lloyd::disc_points(options.rays as usize, options.seed);
        let mut directions: Vec<Vec3> = points.into_iter().map(|p| lift(p.as_vec2())).collect();
        split(&mut directions);
        let lowest = directions.iter().fold(1f32, |z, d| z.min(d.z));
        Ok(Self {
            lengths: lengths(directions.len(), &options.falloff),
            directions: directions.into(),
            jitters: jitters(options, lowest),
        })
    }

    /// Number of rays.
    #[allow(clippy::len_without_is_empty)] // never empty
    #[inline]
    pub fn len(&self) -> usize {
        self.directions.len()
    }

    /// Words of 64 bits in a mask of all rays; bits beyond the last ray are 0.
    #[inline]
    pub fn words(&self) -> usize {
        self.len().div_ceil(64)
    }

    /// Where the order splits a run of `n` rays, from the whole pattern down.
    pub(crate) fn half(n: usize) -> usize {
        if n > UNIT { (n / UNIT).div_ceil(2) * UNIT } else { n / 2 }
    }

    /// Unit directions, z along the normal.
    #[inline]
    pub fn directions(&self) -> &[Vec3] {
        &self.directions
    }

    /// Lengths in radii, 0 to 1. One of length 0 can't be blocked.
    #[inline]
    pub fn lengths(&self) -> &[f32] {
        &self.lengths
    }

    /// Whether all rays have length 1.
    pub fn has_equal_lengths(&self) -> bool {
        self.lengths.iter().all(|&l| l == 1.0)
    }

    /// Axes of the pattern at `receiver`, both jitters applied.
    #[inline]
    pub fn frame_of(&self, receiver: &Receiver) -> Frame {
        let jitter = self.jitters[(hash(receiver.seed()) % JITTERS) as usize];
        let tilted = Frame::from_normal(receiver.normal()).world_from_local(jitter.normal).normalize();
        let Frame { tangent, bitangent, normal } = Frame::from_normal(tilted);
        let [cos, sin] = jitter.rotation.to_array();
        Frame { tangent: tangent * cos + bitangent * sin, bitangent: bitangent * cos - tangent * sin, normal }
    }

    /// The rays of `receiver`, `radius` in world units; see the [module](self) for the arithmetic.
    pub fn rays_of<'a>(
        &'a self,
        receiver: &Receiver,
        radius: f32,
    ) -> impl ExactSizeIterator<Item = Ray> + use<'a> {
        let (frame, origin) = (self.frame_of(receiver), receiver.point());
        self.directions.iter().zip(&self.lengths).map(move |(&d, &length)| Ray {
            origin,
            direction: frame.world_from_local(d),
            tnear: 0.0,
            tfar: radius * length,
        })
    }
}

/// Orders directions by a k-d split, halving along the longest side of the box around them.
fn split(directions: &mut [Vec3]) {
    let n = directions.len();
    if n < 2 {
        return;
    }
    let low = directions.iter().copied().reduce(Vec3::min).unwrap_or_default();
    let high = directions.iter().copied().reduce(Vec3::max).unwrap_or_default();
    let axis = (high - low).max_position();
    directions.sort_by(|a, b| a[axis].total_cmp(&b[axis]));
    let half = Pattern::half(n);
    let (left, right) = directions.split_at_mut(half);
    split(left);
    split(right);
}

/// Lengths that follow `falloff` (`[Laine10]`, equation 3), one from each of `n` equal shares. They follow the radical
/// inverse of the index, so that every group of neighbours has long and short rays.
fn lengths(n: usize, falloff: &Falloff) -> Box<[f32]> {
    let mut order: Vec<u32> = (0..n as u32).collect();
    order.sort_by_key(|i| i.reverse_bits());
    let mut lengths = vec![0.0; n];
    for (rank, &i) in order.iter().enumerate() {
        let u = (rank as f32 + 0.5) / n as f32;
        // A falloff that starts below 1 leaves some rays without length.
        lengths[i as usize] = if falloff.weight(0.0) > u { falloff.length(u) } else { 0.0 };
    }
    lengths.into()
}

fn jitters(options: &PatternOptions, lowest: f32) -> Box<[Jitter]> {
    let seed = combine(options.seed, 0x6a69_7474);
    let jitter = |i| {
        let [turn, x, y, _] = sobol_4d(i, 0, seed);
        let rotation = Rotation::from_turns((turn - 0.5) * options.rotation).apply(Vec3::X) + 0.0;
        // Adding 0 takes the sign from -0, which frames would see.
        let tilt = concentric_disc(Vec2::new(x, y)) * (options.tilt * lowest) + 0.0;
        Jitter { rotation: rotation.truncate(), normal: lift(tilt) }
    };
    (0..JITTERS).map(jitter).collect()
}

#[cfg(test)]
mod tests;
