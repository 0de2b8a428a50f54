//! Methods `bvh` and `rays` among subdivision surfaces that are traced as such: by footprint, or at rates chosen once.

use super::{Engine, LightRay};
use crate::{Occluders, QueryError};
use umbrage_accel::Counters;

/// Rays through triangles, then through surfaces.
pub(super) struct Surface<'a> {
    name: &'static str,
    occluders: &'a Occluders,
}

impl<'a> Surface<'a> {
    pub(super) fn new(name: &'static str, occluders: &'a Occluders) -> Self {
        Self { name, occluders }
    }
}

impl Engine for Surface<'_> {
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
        match counters {
            None => self.occluders.transmittances_with_surfaces(rays, passed, &mut ()),
            Some(counters) => self.occluders.transmittances_with_surfaces(rays, passed, counters),
        }
        Ok(())
    }
}
