//! The pattern of rays that receivers share.
//!
//! Here: directions, lengths, their order, what a receiver's seed chooses, and the one arithmetic that turns a pattern into
//! world-space rays. Not here: how the points of the disc are made (`spiral.rs`; the published ones are in
//! [`crate::published`]), nor what masks prepare from a pattern (`exact/rays.rs`).
//!
//! # No bias
//! By default a pattern is a *family* of sets of directions, its members (see the file `spiral.rs`). The seed of a receiver
//! chooses a member and an angle about the normal. Averaged over seeds, the fraction of rays that are free *is* cosine-weighted
//! openness, for any number of rays: each ray is uniform in its share of the disc.
//!
//! # World-space rays
//! Ray `i` of a receiver has `origin` = the receiver's point, `tnear` = 0, `tfar = radius * lengths[i]` and
//!
//! ```text
//! direction = tangent * d.x + bitangent * d.y + normal * d.z      (d = directions[i]; (a + b) + c, no fused operation)
//! ```
//!
//! with the receiver's member and the frame of [`Pattern::frame_of`], all in `f32`. Rays of a receiver with a
//! [face](Receiver::with_face) that lead below it are mirrored. Whoever computes the same casts the same rays,
//! bit for bit. `tfar` is in units of `direction`, whose length is 1 to within 1e-6. A ray of length 0 is not
//! [valid](Ray::is_valid): it hits nothing.

mod spiral;

use crate::{
    MaskError, Receiver,
    exact::rays::{Shape, shapes},
    published::lloyd,
};
use umbrage_geom::{
    Falloff, Frame, Ray,
    glam::{Vec2, Vec3},
    sampling::{Rotation, combine, concentric_disc, hash, lift, sobol_4d},
};

/// Different turns and tilts; a receiver's seed chooses one.
const JITTERS: u32 = 1024;
/// Distance between the turns of successive samples of one receiver, in units of one jitter: odd, and unlike the golden angle of the
/// rings, with which turns would repeat the azimuths of neighbouring rings.
const JITTER_STRIDE: u32 = 583;

/// Rays that stay together in every split of the order.
const UNIT: usize = 32;
/// Rays of the smallest group that stays together.
const GROUP: usize = 8;

/// Which points of the disc a pattern lifts to directions.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Points {
    /// A family without bias: every receiver has one ray at random in each of the equal shares of the disc's area.
    #[default]
    Jittered,
    /// One set for all receivers, in the middle of the shares: what tables need. Biased by at most half a share.
    Middles,
    /// The relaxed points of `[Laine10]`, one set for all receivers: see [`crate::published`]. Biased.
    Relaxed,
}

/// Settings of a pattern. Start from the default: 128 rays of equal length, without bias.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct PatternOptions {
    /// Rays of a receiver, 1 to [`Pattern::MAX_RAYS`]. Masks need a multiple of 8 up to [`Pattern::MAX_MASK_RAYS`].
    pub rays: u32,
    /// How occlusion fades with distance; ray lengths are distributed by it.
    pub falloff: Falloff,
    /// Which points of the disc.
    pub points: Points,
    /// Width of the range of random rotations about the normal, turns, 0 to 1.
    pub rotation: f32,
    /// How far the normal may tilt at random, as a fraction of the sine of the lowest ray's elevation, 0 to 0.95: below 1 no
    /// ray gets under the receiver's tangent plane. Only for [`Points::Relaxed`]: other points reach the horizon.
    pub tilt: f32,
    /// Seed of points and jitters.
    pub seed: u32,
}

impl Default for PatternOptions {
    fn default() -> Self {
        let points = Points::Jittered;
        Self { rays: 128, falloff: Falloff::Constant, points, rotation: 1.0, tilt: 0.0, seed: 0 }
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

    /// Sets [`Self::points`].
    #[must_use]
    pub fn with_points(self, points: Points) -> Self {
        Self { points, ..self }
    }

    /// Sets [`Self::rotation`] and [`Self::tilt`].
    #[must_use]
    pub fn with_jitter(self, rotation: f32, tilt: f32) -> Self {
        Self { rotation, tilt, ..self }
    }

    /// One set of rays in the middle of the shares, turned by no angle: all receivers with the same normal have the same rays.
    #[must_use]
    pub fn fixed(self) -> Self {
        self.with_points(Points::Middles).with_jitter(0.0, 0.0)
    }

    /// Sets [`Self::seed`].
    #[must_use]
    pub fn with_seed(self, seed: u32) -> Self {
        Self { seed, ..self }
    }

    fn validate(&self) -> Result<(), MaskError> {
        let relaxed = self.points == Points::Relaxed;
        let most = if relaxed { Pattern::MAX_MASK_RAYS } else { Pattern::MAX_RAYS };
        let multiple = if relaxed { UNIT as u32 } else { 1 };
        if self.rays == 0 || self.rays > most || !self.rays.is_multiple_of(multiple) {
            return Err(MaskError::Rays { rays: self.rays, most, multiple });
        }
        let most_tilt = if relaxed { 0.95 } else { 0.0 };
        for (what, value, limit) in [("rotation", self.rotation, 1.0), ("tilt", self.tilt, most_tilt)] {
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

/// Directions and lengths of rays around the z axis, in an order where neighbours are close.
///
/// Directions are cosine-weighted: each ray stands for the same share of irradiance. Every aligned run of 8, 16 or 32 rays
/// is a compact group of directions; so is every larger run that comes from halving. A pattern has one or more members, of
/// which each receiver has one.
#[derive(Clone, Debug, PartialEq)]
pub struct Pattern {
    /// Rays of a receiver.
    rays: usize,
    /// Member by member.
    directions: Box<[Vec3]>,
    /// Member by member; one run for all where all lengths are 1.
    lengths: Box<[f32]>,
    jitters: Box<[Jitter]>,
    tilts: bool,
    /// What masks need of it; empty if there are too many rays for masks.
    shapes: Box<[Shape]>,
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
    /// Most rays of a pattern.
    pub const MAX_RAYS: u32 = 1 << 16;

    /// Most rays of a pattern that masks can have.
    pub const MAX_MASK_RAYS: u32 = 1024;

    /// Makes the pattern; takes about a millisecond up to 1024 rays ([`Points::Relaxed`]: 20 to 40).
    ///
    /// # Errors
    /// [`MaskError::Rays`], [`MaskError::Jitter`], [`MaskError::Falloff`].
    pub fn new(options: &PatternOptions) -> Result<Self, MaskError> {
        options.validate()?;
        let rays = options.rays as usize;
        let members = match options.points {
            Points::Jittered => spiral::family(rays, options.seed),
            Points::Middles => vec![spiral::middles(rays)],
            Points::Relaxed => {
                let points = lloyd::disc_points(rays, options.seed).into_iter();
                vec![points.map(|p| lift(p.as_vec2())).collect()]
            }
        };
        Ok(Self::of_members(members, options))
    }

    /// A pattern of the given sets of unit directions (z along the normal, more than 0), one a member, for comparisons with other
    /// sets; [`PatternOptions::points`] and [`PatternOptions::rays`] are not used.
    ///
    /// # Errors
    /// As for [`Self::new`]; [`MaskError::Members`] unless their number is a power of two and all have as many directions.
    pub fn from_directions(members: Vec<Vec<Vec3>>, options: &PatternOptions) -> Result<Self, MaskError> {
        let rays = members.first().map_or(0, Vec::len);
        if !members.len().is_power_of_two() || members.iter().any(|member| member.len() != rays) {
            return Err(MaskError::Members(members.len()));
        }
        options.clone().with_rays(rays as u32).validate()?;
        Ok(Self::of_members(members, options))
    }

    fn of_members(mut members: Vec<Vec<Vec3>>, options: &PatternOptions) -> Self {
        members.iter_mut().for_each(|directions| split(directions));
        let (count, rays) = (members.len(), members[0].len());
        let directions: Box<[Vec3]> = members.into_iter().flatten().collect();
        let lowest = directions.iter().fold(1f32, |z, d| z.min(d.z));
        let mut pattern = Self {
            rays,
            lengths: lengths(rays, count, &options.falloff),
            directions,
            jitters: jitters(options, lowest),
            tilts: options.tilt > 0.0,
            shapes: Box::new([]),
        };
        if pattern.check_masks().is_ok() {
            pattern.shapes = shapes(&pattern);
        }
        pattern
    }

    /// Number of rays of a receiver.
    #[allow(clippy::len_without_is_empty)] // never empty
    #[inline]
    pub fn len(&self) -> usize {
        self.rays
    }

    /// Number of members, a power of two.
    #[inline]
    pub fn members(&self) -> usize {
        self.directions.len() / self.rays
    }

    /// Words of 64 bits in a mask of all rays; bits beyond the last ray are 0.
    #[inline]
    pub fn words(&self) -> usize {
        self.len().div_ceil(64)
    }

    /// # Errors
    /// [`MaskError::Rays`] unless masks can have as many rays: a multiple of 8 up to [`Self::MAX_MASK_RAYS`].
    pub(crate) fn check_masks(&self) -> Result<(), MaskError> {
        let (rays, most, multiple) = (self.rays as u32, Self::MAX_MASK_RAYS, GROUP as u32);
        if rays > most || !rays.is_multiple_of(multiple) {
            return Err(MaskError::Rays { rays, most, multiple });
        }
        Ok(())
    }

    /// Where the order splits a run of `n` rays, from the whole pattern down.
    pub(crate) fn half(n: usize) -> usize {
        let whole = |unit: usize| (n / unit).div_ceil(2) * unit;
        if n > UNIT {
            whole(UNIT)
        } else if n > GROUP {
            whole(GROUP)
        } else {
            n / 2
        }
    }

    /// Unit directions of `member`, z along the normal.
    ///
    /// # Panics
    /// If there are fewer members.
    #[inline]
    pub fn directions(&self, member: usize) -> &[Vec3] {
        &self.directions[member * self.rays..][..self.rays]
    }

    /// Lengths of the rays of `member` in radii, 0 to 1. One of length 0 can't be blocked.
    ///
    /// # Panics
    /// If there are fewer members.
    #[inline]
    pub fn lengths(&self, member: usize) -> &[f32] {
        assert!(member < self.members());
        let start = if self.has_shared_lengths() { 0 } else { member * self.rays };
        &self.lengths[start..][..self.rays]
    }

    /// Whether all members have the same lengths, ray for ray.
    pub(crate) fn has_shared_lengths(&self) -> bool {
        self.lengths.len() == self.rays
    }

    /// Whether all rays have length 1.
    pub fn has_equal_lengths(&self) -> bool {
        self.lengths.iter().all(|&l| l == 1.0)
    }

    pub(crate) fn shapes(&self) -> &[Shape] {
        &self.shapes
    }

    /// Solid angle that a ray of local direction `direction` stands for, steradians: its share of the projected solid angle, no
    /// nearer to the horizon than the middle of the lowest share.
    #[inline]
    pub fn solid_angle(&self, direction: Vec3) -> f32 {
        let share = std::f32::consts::PI / self.rays as f32;
        // In the lowest share the mean of 1 / z is 2 sqrt(n).
        share / direction.z.max(0.5 / (self.rays as f32).sqrt())
    }

    /// The member that `receiver` has.
    #[inline]
    pub fn member_of(&self, receiver: &Receiver) -> usize {
        // The lower bits; the turn has the upper ones.
        hash(receiver.seed()).wrapping_add(receiver.sample()) as usize & (self.members() - 1)
    }

    /// Axes of the pattern at `receiver`, turn and tilt applied.
    #[inline]
    pub fn frame_of(&self, receiver: &Receiver) -> Frame {
        let number =
            (hash(receiver.seed()) >> 22).wrapping_add(receiver.sample().wrapping_mul(JITTER_STRIDE));
        let jitter = self.jitters[(number % JITTERS) as usize];
        let frame = Frame::from_normal(receiver.normal());
        let Frame { tangent, bitangent, normal } = if self.tilts {
            Frame::from_normal(frame.world_from_local(jitter.normal).normalize())
        } else {
            frame
        };
        let [cos, sin] = jitter.rotation.to_array();
        Frame { tangent: tangent * cos + bitangent * sin, bitangent: bitangent * cos - tangent * sin, normal }
    }

    /// The rays of `receiver`, `radius` in world units; see the [module](self) for the arithmetic.
    pub fn rays_of<'a>(
        &'a self,
        receiver: &Receiver,
        radius: f32,
    ) -> impl ExactSizeIterator<Item = Ray> + use<'a> {
        let (receiver, frame, origin, member) =
            (*receiver, self.frame_of(receiver), receiver.point(), self.member_of(receiver));
        self.directions(member).iter().zip(self.lengths(member)).map(move |(&d, &length)| Ray {
            origin,
            direction: receiver.above(frame.world_from_local(d)),
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

/// Lengths that follow `falloff` (`[Laine10]`, equation 3), one from each of `n` equal shares, for each member. They follow the
/// radical inverse of the index, so that every group of neighbours has long and short rays; from member to member the shares shift,
/// so that each ray has all lengths in turn.
fn lengths(n: usize, members: usize, falloff: &Falloff) -> Box<[f32]> {
    if *falloff == Falloff::Constant {
        return vec![1.0; n].into();
    }
    let mut order: Vec<u32> = (0..n as u32).collect();
    order.sort_by_key(|i| i.reverse_bits());
    let mut lengths = vec![0.0; members * n];
    for (member, lengths) in lengths.chunks_mut(n).enumerate() {
        // Not the order in which members take their places in the rings: places and lengths are unrelated.
        let shift = (member * 5 % members) as f64 / members as f64;
        for (rank, &i) in order.iter().enumerate() {
            let u = ((rank as f64 + 0.5) / n as f64 + shift).fract() as f32;
            // A falloff that starts below 1 leaves some rays without length.
            lengths[i as usize] = if falloff.weight(0.0) > u { falloff.length(u) } else { 0.0 };
        }
    }
    lengths.into()
}

fn jitters(options: &PatternOptions, lowest: f32) -> Box<[Jitter]> {
    let seed = combine(options.seed, 0x6a69_7474);
    let jitter = |i| {
        let [turn, x, y, _] = sobol_4d(i, 0, seed);
        let turn = (turn - 0.5) * options.rotation;
        let rotation = Rotation::from_turns(turn).apply(Vec3::X) + 0.0;
        // Adding 0 takes the sign from -0, which frames would see.
        let tilt = concentric_disc(Vec2::new(x, y)) * (options.tilt * lowest) + 0.0;
        Jitter { rotation: rotation.truncate(), normal: lift(tilt) }
    };
    let mut jitters: Vec<Jitter> = (0..JITTERS).map(jitter).collect();
    if options.tilt == 0.0 {
        // In order, so that successive samples of a receiver, a golden section apart, are evenly spread.
        let angle = |jitter: &Jitter| {
            let Vec2 { x, y } = jitter.rotation;
            if y < 0.0 { 3.0 + x } else { 1.0 - x }
        };
        jitters.sort_by(|a, b| angle(a).total_cmp(&angle(b)));
    }
    jitters.into()
}

#[cfg(test)]
mod tests;
