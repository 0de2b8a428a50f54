//! Method `mask`: all rays of a receiver walk the hierarchy together. Exact.

use super::{Answers, Engine, Report, Sky, one_mesh};
use crate::query::{AoMethod, Occluders, QueryError};
use umbrage_accel::Bvh;
use umbrage_aomask::{
    BackEnd, MaskError, MaskOptions, Outputs, Pattern, Receiver, Sides,
    exact::{
        self,
        adaptive::{Adaptive, Spent},
        fans,
    },
};
use umbrage_geom::{OpticalDepth, Ray};

pub(super) struct Mask<'a> {
    occluders: &'a Occluders,
    bvh: &'a Bvh,
    pattern: Pattern,
    options: MaskOptions,
    /// Patterns for a target error.
    adaptive: Option<(Adaptive, f32)>,
}

impl<'a> Mask<'a> {
    pub(super) fn build(occluders: &'a Occluders, sky: &Sky) -> Result<Self, QueryError> {
        let method = AoMethod::Mask.name();
        let bvh = one_mesh(method, occluders.flat())?;
        let (pattern, options) = sky.masks()?;
        if options.sides == Sides::FrontFirst && !occluders.is_opaque() {
            return Err(QueryError::Unsupported { method, reason: super::FRONT_FIRST_NEEDS_OPAQUE });
        }
        let adaptive = match sky.target_error {
            Some(target) => Some((Adaptive::new(&sky.pattern)?, target)),
            None => None,
        };
        Ok(Self { occluders, bvh, pattern, options, adaptive })
    }

    /// Answers receivers by the rays of a pattern.
    fn answer(
        &self,
        pattern: &Pattern,
        receivers: &[Receiver],
        outputs: Outputs<'_>,
        progress: Report<'_>,
    ) -> Result<(), MaskError> {
        let (Self { bvh, options, .. }, best) = (self, BackEnd::best());
        if self.occluders.is_opaque() {
            return exact::answer_receivers(bvh, pattern, receivers, options, best, outputs, progress);
        }
        let depth = |prim| self.occluders.flat_depth(prim);
        exact::transmit(bvh, depth, pattern, receivers, options, best, outputs, progress)
    }
}

impl Engine for Mask<'_> {
    fn name(&self) -> &'static str {
        AoMethod::Mask.name()
    }

    fn answers(&self) -> Answers {
        Answers::Receivers
    }

    fn pattern(&self) -> Option<&Pattern> {
        Some(&self.pattern)
    }

    fn answers_listed(&self) -> bool {
        true
    }

    fn has_fractions(&self) -> bool {
        !self.occluders.is_opaque()
    }

    fn sky(
        &self,
        receivers: &[Receiver],
        outputs: Outputs<'_>,
        progress: Report<'_>,
    ) -> Result<Option<Spent>, QueryError> {
        let mut ask =
            |pattern: &Pattern, receivers: &[Receiver], outputs: Outputs<'_>, progress: Report<'_>| {
                self.answer(pattern, receivers, outputs, progress)
            };
        match &self.adaptive {
            Some((adaptive, target)) => {
                Ok(Some(adaptive.answer(receivers, *target, &mut ask, outputs, progress)?))
            }
            None => ask(&self.pattern, receivers, outputs, progress).map(|()| None).map_err(QueryError::from),
        }
    }

    fn listed(&self, rays: &[Ray], per_receiver: usize, passed: &mut [f32]) -> Result<(), QueryError> {
        let (bvh, sides, best) = (self.bvh, self.options.sides, BackEnd::best());
        if self.occluders.is_opaque() {
            let mut hits = vec![false; rays.len()];
            fans::any_hits(bvh, rays, per_receiver, sides, best, &mut hits)?;
            hits.into_iter().zip(passed).for_each(|(hit, out)| *out = f32::from(u8::from(!hit)));
        } else {
            let mut sums = vec![OpticalDepth::CLEAR; rays.len()];
            let depth = |prim| self.occluders.flat_depth(prim);
            fans::transmittances(bvh, rays, per_receiver, sides, depth, best, &mut sums)?;
            sums.into_iter().zip(passed).for_each(|(sum, out)| *out = sum.transmittance());
        }
        Ok(())
    }
}
