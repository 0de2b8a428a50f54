//! Calls that answer receivers by methods `mask` and `mask-prefilter`.
//!
//! Here: what a call may say, and its checks. Not here: walks (`exact`), far fields (`coarse`), tables and rasterization, which have
//! calls of their own.

use crate::{
    BackEnd, MaskError, MaskOptions, Outputs, Pattern, Receiver, Sides,
    coarse::{Coarse, FarField},
    drive,
    exact::{DimmedMasks, Masks},
};
use umbrage_accel::Bvh;
use umbrage_geom::OpticalDepth;

/// Who asks by which rays among which triangles: exact masks of `receivers`, or those with a far field.
///
/// Answers depend on what is said here only, not on threads or the back end.
#[derive(Clone, Copy)]
#[must_use = "nothing is answered before `answer` or `transmit`"]
pub struct MaskCall<'a> {
    bvh: &'a Bvh,
    pattern: &'a Pattern,
    receivers: &'a [Receiver],
    options: &'a MaskOptions,
    back_end: BackEnd,
    far: Option<&'a dyn FarField>,
}

impl<'a> MaskCall<'a> {
    /// The rays of `pattern` from `receivers` among the triangles of `bvh`, all exact, on [`BackEnd::best`]. [`Receiver::from_slices`]
    /// makes receivers of points and normals; [`MaskOptions::seed`] is not used here.
    pub fn new(
        bvh: &'a Bvh,
        pattern: &'a Pattern,
        receivers: &'a [Receiver],
        options: &'a MaskOptions,
    ) -> Self {
        Self { bvh, pattern, receivers, options, back_end: BackEnd::best(), far: None }
    }

    /// Runs on another back end. Answers are the same.
    pub fn with_back_end(self, back_end: BackEnd) -> Self {
        Self { back_end, ..self }
    }

    /// Rays that nothing blocks up to [`FarField::near`] are answered by `far` from there on: method `mask-prefilter`. Not for
    /// distances, nor for sides other than both.
    pub fn with_far(self, far: &'a dyn FarField) -> Self {
        Self { far: Some(far), ..self }
    }

    /// Ambient occlusion of the receivers among opaque triangles. `progress` gets growing fractions that end at exactly 1, from any
    /// thread, and returns `false` to cancel. With a far field `ao`, bent normals and sectors are means over the rays of what passes;
    /// masks have the rays that nothing passes.
    ///
    /// # Errors
    /// [`MaskError::Radius`] (that of the far field too), [`MaskError::FalloffWithoutRadius`], [`MaskError::Rays`],
    /// [`MaskError::Length`], [`MaskError::Sectors`], [`MaskError::BackEnd`], [`MaskError::Unsupported`],
    /// [`MaskError::Cancelled`]. The outputs are as they were then.
    pub fn answer(
        self,
        outputs: Outputs<'_>,
        progress: &mut (dyn FnMut(f32) -> bool + Send),
    ) -> Result<(), MaskError> {
        let Self { pattern, receivers, options, .. } = self;
        let masks = self.masks(&outputs)?;
        match self.far {
            None => drive::run(&masks, pattern, options, receivers, outputs, progress),
            Some(far) => {
                let engine = Coarse::new(masks, false, pattern, options, far);
                drive::run(&engine, pattern, options, receivers, outputs, progress)
            }
        }
    }

    /// [`Self::answer`] among semi-transparent triangles: a ray passes the product of what all triangles that it hits let through,
    /// each counted once, `depth_of(index of the triangle)`, times what the far field lets pass if there is one. `ao`, bent normals
    /// and sectors are means over the rays of what passes; masks have the rays that nothing passes; distances are those of the
    /// nearest hits, however transparent.
    ///
    /// # Errors
    /// As for [`Self::answer`]; [`MaskError::Unsupported`] for [`Sides::FrontFirst`].
    pub fn transmit(
        self,
        depth_of: impl Fn(u32) -> OpticalDepth + Sync,
        outputs: Outputs<'_>,
        progress: &mut (dyn FnMut(f32) -> bool + Send),
    ) -> Result<(), MaskError> {
        let Self { pattern, receivers, options, .. } = self;
        if options.sides == Sides::FrontFirst {
            return Err(MaskError::Unsupported("fronts before any back among semi-transparent triangles"));
        }
        let masks = DimmedMasks::new(self.masks(&outputs)?, depth_of);
        match self.far {
            None => drive::run(&masks, pattern, options, receivers, outputs, progress),
            Some(far) => {
                let engine = Coarse::new(masks, true, pattern, options, far);
                drive::run(&engine, pattern, options, receivers, outputs, progress)
            }
        }
    }

    /// Exact masks, up to where the far field begins if there is one.
    fn masks(&self, outputs: &Outputs<'_>) -> Result<Masks<'a>, MaskError> {
        let limit = match self.far {
            None => f32::INFINITY,
            Some(far) => {
                let near = far.near();
                if near.is_nan() || near <= 0.0 {
                    return Err(MaskError::Radius(near));
                }
                if self.options.sides != Sides::Both {
                    return Err(MaskError::Unsupported("sides of far triangles"));
                }
                outputs.validate_for_tables()?;
                near
            }
        };
        Masks::new(self.bvh, self.pattern, self.options, limit, self.back_end, outputs)
    }
}
