//! What can be chosen when occlusion is baked.

use super::BakeError;
use umbrage_aomask::{PatternOptions, Points, Sides};
use umbrage_geom::Falloff;
use umbrage_query::{AoMethod, Sky};
use umbrage_scene::Radius;

/// Settings of a bake. Start from the default: method `rays`, 256 rays, no radius, constant falloff, both sides, seed 0.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct BakeOptions {
    /// How occlusion is answered.
    pub method: AoMethod,
    /// Rays from each receiver, 1 to [`BakeOptions::MAX_RAYS`].
    pub rays: u32,
    /// How far occluders count. A fraction refers to [`umbrage_query::Occluders::diagonal`].
    pub radius: Radius,
    /// How occluders fade with distance; anything but constant needs a radius.
    pub falloff: Falloff,
    /// Which sides of occluders block.
    pub sides: Sides,
    /// How patterns of rays differ between receivers.
    pub jitter: Jitter,
    /// Seed of all random choices.
    pub seed: u32,
    /// Distance by which rays start above the surface, world units, beyond what rounding asks for. 0 is right for
    /// receivers that lie on the mesh; points that were made with less care may need more.
    pub bias: f32,
    /// Standard error of `ao` to aim at, more than 0: each receiver gets as many rays as that takes by an estimate, up to
    /// [`Self::rays`]. Only for [`AoMethod::Mask`], among opaque occluders.
    pub target_error: Option<f32>,
}

/// How patterns of rays differ between receivers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Jitter {
    /// Every receiver has rays of its own, chosen by its place and normal: errors are independent noise without bias.
    #[default]
    Pattern,
    /// One set of rays, turned about the normal by a random angle. Its own error, at most half a ray's share, is common to all
    /// receivers.
    Rotation,
    /// One set of rays for all: no noise between receivers with equal normals, but errors have structure.
    Off,
}

/// Where the normals of receivers on a mesh come from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum NormalSource {
    /// Normals of triangles. At a vertex each ray leaves around the normal of one of its triangles, chosen in proportion
    /// to the angle that the triangle has there: the result is the mean over the triangles weighted by angle.
    Geometric,
    /// One normal a vertex, the mean of its triangles' weighted by angle; interpolated between vertices.
    #[default]
    Smooth,
    /// The normals that the file gives to corners; their mean at a vertex, weighted by angle. Where they are zero, as
    /// [`Self::Smooth`].
    File,
}

impl Default for BakeOptions {
    fn default() -> Self {
        Self {
            method: AoMethod::Rays,
            rays: 256,
            radius: Radius::Unbounded,
            falloff: Falloff::Constant,
            sides: Sides::Both,
            jitter: Jitter::Pattern,
            seed: 0,
            bias: 0.0,
            target_error: None,
        }
    }
}

impl BakeOptions {
    /// Most rays from one receiver: as many as one run of the Sobol points has.
    pub const MAX_RAYS: u32 = 1 << 16;

    /// Sets [`Self::method`].
    #[must_use]
    pub fn with_method(self, method: AoMethod) -> Self {
        Self { method, ..self }
    }

    /// Sets [`Self::rays`].
    #[must_use]
    pub fn with_rays(self, rays: u32) -> Self {
        Self { rays, ..self }
    }

    /// Sets [`Self::radius`].
    #[must_use]
    pub fn with_radius(self, radius: Radius) -> Self {
        Self { radius, ..self }
    }

    /// Sets [`Self::falloff`].
    #[must_use]
    pub fn with_falloff(self, falloff: Falloff) -> Self {
        Self { falloff, ..self }
    }

    /// Sets [`Self::sides`].
    #[must_use]
    pub fn with_sides(self, sides: Sides) -> Self {
        Self { sides, ..self }
    }

    /// Sets [`Self::jitter`].
    #[must_use]
    pub fn with_jitter(self, jitter: Jitter) -> Self {
        Self { jitter, ..self }
    }

    /// Sets [`Self::seed`].
    #[must_use]
    pub fn with_seed(self, seed: u32) -> Self {
        Self { seed, ..self }
    }

    /// Sets [`Self::bias`].
    #[must_use]
    pub fn with_bias(self, bias: f32) -> Self {
        Self { bias, ..self }
    }

    /// Sets [`Self::target_error`].
    #[must_use]
    pub fn with_target_error(self, target_error: f32) -> Self {
        Self { target_error: Some(target_error), ..self }
    }

    /// What all receivers have in common, among occluders with a diagonal of `diagonal`.
    pub(super) fn sky(&self, diagonal: f32) -> Sky {
        let pattern = PatternOptions::default()
            .with_rays(self.rays)
            .with_falloff(self.falloff.clone())
            .with_seed(self.seed);
        let pattern = match self.jitter {
            Jitter::Pattern => pattern,
            Jitter::Rotation => pattern.with_points(Points::Middles),
            Jitter::Off => pattern.fixed(),
        };
        let sky = Sky::new(pattern, self.radius.resolve(diagonal)).with_sides(self.sides);
        sky.with_target_error(self.target_error)
    }

    /// Checks everything that doesn't depend on receivers or occluders.
    ///
    /// # Errors
    /// [`BakeError::Count`], [`BakeError::Radius`], [`BakeError::FalloffWithoutRadius`], [`BakeError::Falloff`],
    /// [`BakeError::Bias`], [`BakeError::TargetError`].
    pub fn validate(&self) -> Result<(), BakeError> {
        if self.rays == 0 || self.rays > Self::MAX_RAYS {
            let (value, limit) = (self.rays.into(), Self::MAX_RAYS.into());
            return Err(BakeError::Count { what: "number of rays", value, limit });
        }
        let radius = self.radius.resolve(1.0);
        if radius.is_nan() || radius <= 0.0 {
            return Err(BakeError::Radius(radius));
        }
        if let Falloff::Table(weights) = &self.falloff {
            Falloff::table(weights.clone())?;
        }
        if radius == f32::INFINITY && self.falloff != Falloff::Constant {
            return Err(BakeError::FalloffWithoutRadius);
        }
        if self.target_error.is_some_and(|e| e.is_nan() || e <= 0.0) {
            return Err(BakeError::TargetError("it has to be more than 0"));
        }
        if !(self.bias >= 0.0 && self.bias.is_finite()) {
            return Err(BakeError::Bias(self.bias));
        }
        Ok(())
    }
}
