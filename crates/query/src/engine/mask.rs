//! Method `mask`: all rays of a receiver walk the hierarchy together. Exact.

use super::{Answers, Engine, Report, Sky, one_mesh};
use crate::{AoMethod, Occluders, QueryError};
use umbrage_accel::Bvh;
use umbrage_aomask::{
    MaskCall, MaskOptions, Outputs, Pattern, Receiver, Sides,
    exact::adaptive::{Adaptive, Spent},
};

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

    fn sky(
        &self,
        receivers: &[Receiver],
        outputs: Outputs<'_>,
        progress: Report<'_>,
    ) -> Result<Spent, QueryError> {
        let mut ask =
            |pattern: &Pattern, receivers: &[Receiver], outputs: Outputs<'_>, progress: Report<'_>| {
                let call = MaskCall::new(self.bvh, pattern, receivers, &self.options);
                if self.occluders.is_opaque() {
                    return call.answer(outputs, progress);
                }
                call.transmit(|prim| self.occluders.flat_depth(prim), outputs, progress)
            };
        match &self.adaptive {
            Some((adaptive, target)) => Ok(adaptive.answer(receivers, *target, &mut ask, outputs, progress)?),
            None => {
                ask(&self.pattern, receivers, outputs, progress)?;
                Ok(Spent::uniform(self.pattern.len() as u32, receivers.len() as u64))
            }
        }
    }
}
