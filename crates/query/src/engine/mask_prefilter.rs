//! Method `mask-prefilter`: masks for what is near, stored opacity for what is far. Approximate.

use super::{Answers, Engine, Report, Sky, one_mesh};
use crate::{
    AoMethod, Occluders, QueryError, Structure,
    far::{Blockers, FarOpacity},
    share_of,
};
use std::sync::Arc;
use umbrage_accel::Bvh;
use umbrage_aomask::{MaskOptions, Outputs, Pattern, Receiver, Sides, exact::adaptive::Spent};
use umbrage_geom::OpticalDepth;

pub(super) struct MaskPrefilter<'a> {
    occluders: &'a Occluders,
    bvh: &'a Bvh,
    pattern: Pattern,
    options: MaskOptions,
    far: Arc<FarOpacity>,
    /// Where stored opacity begins, world units; `None` if it would begin too far away to be of use.
    near: Option<f32>,
}

impl<'a> MaskPrefilter<'a> {
    pub(super) fn build(
        occluders: &'a Occluders,
        sky: &Sky,
        progress: Report<'_>,
    ) -> Result<Self, QueryError> {
        let method = AoMethod::MaskPrefilter.name();
        if sky.sides != Sides::Both {
            let reason = "stored opacity blocks from both sides";
            return Err(QueryError::Unsupported { method, reason });
        }
        let bvh = one_mesh(method, occluders.flat())?;
        let (pattern, options) = sky.masks()?;
        let far = one_mesh(method, occluders.far_opacity(&mut share_of(progress, 0, 2))?)?;
        let blockers = blockers(occluders, bvh);
        let mut choosing = share_of(progress, 1, 2);
        let near = far.near(&blockers, &pattern, &sky.pattern, &options, &sky.pilot, &mut choosing)?;
        if !choosing(1.0) {
            return Err(QueryError::Cancelled);
        }
        Ok(Self { occluders, bvh, pattern, options, far, near })
    }
}

/// The triangles of occluders in one mesh, whose hierarchy is `bvh`.
fn blockers<'a>(
    occluders: &'a Occluders,
    bvh: &'a Bvh,
) -> Blockers<'a, impl Fn(u32) -> OpticalDepth + Sync + 'a> {
    let depth_of = (!occluders.is_opaque()).then_some(move |prim| occluders.flat_depth(prim));
    Blockers { bvh, depth_of }
}

impl Engine for MaskPrefilter<'_> {
    fn name(&self) -> &'static str {
        AoMethod::MaskPrefilter.name()
    }

    fn structures(&self) -> &'static [Structure] {
        &[Structure::Bvh, Structure::FarOpacity]
    }

    fn answers(&self) -> Answers {
        Answers::Receivers
    }

    fn pattern(&self) -> Option<&Pattern> {
        Some(&self.pattern)
    }

    fn note(&self) -> Option<&'static str> {
        match self.near {
            Some(_) => None,
            None => Some("stored opacity would err too much within the radius, so all rays are exact"),
        }
    }

    fn sky(
        &self,
        receivers: &[Receiver],
        outputs: Outputs<'_>,
        progress: Report<'_>,
    ) -> Result<Spent, QueryError> {
        let Self { occluders, bvh, pattern, options, .. } = self;
        let far = self.near.map(|near| self.far.cones(pattern.len(), near, options.radius)).transpose()?;
        blockers(occluders, bvh).answer(far.as_ref(), pattern, receivers, options, outputs, progress)?;
        Ok(Spent::uniform(pattern.len() as u32, receivers.len() as u64))
    }
}
