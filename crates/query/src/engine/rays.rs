//! Methods `bvh` and `rays`: exact rays through the wide BVH, or through two levels.

use super::{Engine, LightRay};
use crate::{Occluders, QueryError};
use umbrage_accel::Counters;
use umbrage_aomask::Sides;
use umbrage_geom::Ray;

/// Exact single rays.
pub(super) struct Rays<'a> {
    name: &'static str,
    occluders: &'a Occluders,
    sides: Sides,
}

impl<'a> Rays<'a> {
    pub(super) fn new(name: &'static str, occluders: &'a Occluders, sides: Sides) -> Self {
        Self { name, occluders, sides }
    }
}

impl Engine for Rays<'_> {
    fn name(&self) -> &'static str {
        self.name
    }

    fn transmittances(
        &self,
        rays: &[LightRay],
        _: Option<usize>,
        passed: &mut [f32],
        counters: Option<&mut Counters>,
    ) -> Result<(), QueryError> {
        let rays: Vec<Ray> = rays.iter().map(|light| light.ray).collect();
        match counters {
            None => self.occluders.transmittances(&rays, self.sides, passed, &mut ()),
            Some(counters) => self.occluders.transmittances(&rays, self.sides, passed, counters),
        }
        Ok(())
    }
}
