//! Method `mask`: all rays of a receiver walk the hierarchy together. Exact.

use super::{Answers, Engine, Report, Sky, one_mesh};
use crate::query::{AoMethod, Occluders, QueryError};
use umbrage_accel::Bvh;
use umbrage_aomask::{BackEnd, MaskOptions, Outputs, Pattern, Receiver, Sides, exact};

pub(super) struct Mask<'a> {
    occluders: &'a Occluders,
    bvh: &'a Bvh,
    pattern: Pattern,
    options: MaskOptions,
}

impl<'a> Mask<'a> {
    pub(super) fn build(occluders: &'a Occluders, sky: &Sky) -> Result<Self, QueryError> {
        let method = AoMethod::Mask.name();
        let bvh = one_mesh(method, occluders.flat())?;
        let (pattern, options) = sky.masks()?;
        if options.sides == Sides::FrontFirst && !occluders.is_opaque() {
            let reason = "some triangles are semi-transparent, and fronts before any back need opaque ones";
            return Err(QueryError::Unsupported { method, reason });
        }
        Ok(Self { occluders, bvh, pattern, options })
    }
}

impl Engine for Mask<'_> {
    fn name(&self) -> &'static str {
        AoMethod::Mask.name()
    }

    fn answers(&self) -> Answers {
        Answers::Receivers
    }

    fn sky(
        &self,
        receivers: &[Receiver],
        outputs: Outputs<'_>,
        progress: Report<'_>,
    ) -> Result<(), QueryError> {
        let Self { bvh, pattern, options, .. } = self;
        let best = BackEnd::best();
        if self.occluders.is_opaque() {
            exact::answer_receivers(bvh, pattern, receivers, options, best, outputs, progress)?;
        } else {
            let depth = |prim| self.occluders.flat_depth(prim);
            exact::transmit(bvh, depth, pattern, receivers, options, best, outputs, progress)?;
        }
        Ok(())
    }
}
