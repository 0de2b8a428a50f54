//! What can be chosen, and where answers go.

use crate::{MaskError, Pattern};

/// Which sides of a triangle block rays.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Sides {
    /// Both.
    #[default]
    Both,
    /// Only the front, from which the corners run counter-clockwise: rays pass through backs.
    Front,
    /// Only a front that a ray meets before any back: rays that meet a back first start inside something, and are free. Of
    /// several triangles at the same distance the first in the caller's order counts. Only for method `mask`.
    FrontFirst,
}

/// Settings of a call that answers receivers. Start from the default: no radius, both sides, seed 0.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct MaskOptions {
    /// Length of the longest ray, world units, more than 0; infinite only if all rays have the same length.
    pub radius: f32,
    /// Which sides of triangles block.
    pub sides: Sides,
    /// Seed of the rays: a receiver of a slice has the seed [`Receiver::seed_of`](crate::Receiver::seed_of) of its point and normal
    /// with this one.
    pub seed: u32,
}

impl Default for MaskOptions {
    fn default() -> Self {
        Self { radius: f32::INFINITY, sides: Sides::Both, seed: 0 }
    }
}

impl MaskOptions {
    /// Sets [`Self::radius`].
    #[must_use]
    pub fn with_radius(self, radius: f32) -> Self {
        Self { radius, ..self }
    }

    /// Sets [`Self::sides`].
    #[must_use]
    pub fn with_sides(self, sides: Sides) -> Self {
        Self { sides, ..self }
    }

    /// Sets [`Self::seed`].
    #[must_use]
    pub fn with_seed(self, seed: u32) -> Self {
        Self { seed, ..self }
    }

    /// [`Self::validate`] for methods that know masks only.
    pub(crate) fn validate_for_tables(&self, pattern: &Pattern) -> Result<(), MaskError> {
        if self.sides == Sides::FrontFirst {
            return Err(MaskError::Unsupported("fronts before any back"));
        }
        self.validate(pattern)
    }

    /// Checks the radius against the lengths of `pattern`.
    ///
    /// # Errors
    /// [`MaskError::Radius`], [`MaskError::FalloffWithoutRadius`]; [`MaskError::Rays`] if masks can't have as many rays as
    /// `pattern`.
    pub fn validate(&self, pattern: &Pattern) -> Result<(), MaskError> {
        pattern.check_masks()?;
        if self.radius.is_nan() || self.radius <= 0.0 {
            return Err(MaskError::Radius(self.radius));
        }
        if self.radius == f32::INFINITY && !pattern.has_equal_lengths() {
            return Err(MaskError::FalloffWithoutRadius);
        }
        Ok(())
    }
}

/// Where answers go. Slices belong to the caller and are as long as there are receivers, unless said otherwise.
#[derive(Debug)]
#[non_exhaustive]
pub struct Outputs<'a> {
    /// Fraction of rays that are free: 1 is open, 0 fully occluded.
    pub ao: &'a mut [f32],
    /// [`Pattern::words`] words for each receiver; bit `i % 64` of word `i / 64` is set if ray `i` is blocked.
    pub masks: Option<&'a mut [u64]>,
    /// Mean direction of the free rays, of unit length; the normal where no ray is free or their mean is zero.
    pub bent_normals: Option<&'a mut [[f32; 3]]>,
    /// Mean over all rays of the direction times what passes; its direction is the bent normal.
    pub free_directions: Option<&'a mut [[f32; 3]]>,
    /// Openness by azimuth: a number of equal sectors, and that many values for each receiver, each the mean over the rays
    /// in the sector (that over all rays where it has none). Sector 0 begins at the tangent of [`Frame::from_normal`] of the
    /// receiver's normal, the next ones follow towards its bitangent.
    ///
    /// [`Frame::from_normal`]: umbrage_geom::Frame::from_normal
    pub sectors: Option<(u32, &'a mut [f32])>,
    /// Mean distance of the nearest hits, in units of directions (whose lengths are 1 to within 1e-6), over the rays that
    /// hit something; infinite where none does. Only for method `mask`.
    pub hit_distances: Option<&'a mut [f32]>,
}

impl<'a> Outputs<'a> {
    /// Only [`Self::ao`].
    pub fn new(ao: &'a mut [f32]) -> Self {
        Self {
            ao,
            masks: None,
            bent_normals: None,
            free_directions: None,
            sectors: None,
            hit_distances: None,
        }
    }

    /// Asks for [`Self::masks`] too.
    #[must_use]
    pub fn with_masks(self, masks: &'a mut [u64]) -> Self {
        Self { masks: Some(masks), ..self }
    }

    /// Asks for [`Self::bent_normals`] too.
    #[must_use]
    pub fn with_bent_normals(self, bent_normals: &'a mut [[f32; 3]]) -> Self {
        Self { bent_normals: Some(bent_normals), ..self }
    }

    /// Asks for [`Self::free_directions`] too.
    #[must_use]
    pub fn with_free_directions(self, free_directions: &'a mut [[f32; 3]]) -> Self {
        Self { free_directions: Some(free_directions), ..self }
    }

    /// Asks for [`Self::sectors`] too.
    #[must_use]
    pub fn with_sectors(self, count: u32, sectors: &'a mut [f32]) -> Self {
        Self { sectors: Some((count, sectors)), ..self }
    }

    /// Asks for [`Self::hit_distances`] too.
    #[must_use]
    pub fn with_hit_distances(self, hit_distances: &'a mut [f32]) -> Self {
        Self { hit_distances: Some(hit_distances), ..self }
    }

    /// Most sectors.
    pub const MAX_SECTORS: u32 = 64;

    /// Refuses what masks alone don't tell.
    pub(crate) fn validate_for_tables(&self) -> Result<(), MaskError> {
        match self.hit_distances {
            Some(_) => Err(MaskError::Unsupported("distances of hits")),
            None => Ok(()),
        }
    }

    /// Checks the lengths for `points` receivers of `words` words each.
    pub(crate) fn validate(&self, points: usize, words: usize) -> Result<(), MaskError> {
        let masks = self.masks.as_ref().map(|m| m.len());
        let bent_normals = self.bent_normals.as_ref().map(|b| b.len());
        let free_directions = self.free_directions.as_ref().map(|d| d.len());
        let hit_distances = self.hit_distances.as_ref().map(|d| d.len());
        let count = self.sectors.as_ref().map_or(1, |s| s.0);
        if count == 0 || count > Self::MAX_SECTORS {
            return Err(MaskError::Sectors(count));
        }
        let sectors = self.sectors.as_ref().map(|s| s.1.len());
        for (what, actual, expected) in [
            ("ao", Some(self.ao.len()), points),
            ("masks", masks, points.saturating_mul(words)),
            ("bent normals", bent_normals, points),
            ("free directions", free_directions, points),
            ("sectors", sectors, points.saturating_mul(count as usize)),
            ("hit distances", hit_distances, points),
        ] {
            if let Some(actual) = actual.filter(|&actual| actual != expected) {
                return Err(MaskError::Length { what, actual, expected, points });
            }
        }
        Ok(())
    }
}
