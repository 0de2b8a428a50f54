//! Method `mask-prefilter`: exact masks up to a distance, stored opacity beyond it. Approximate.
//!
//! Here: how both parts of a ray make one answer. Not here: the stored opacity, which is whatever implements [`FarField`].

use crate::{
    BackEnd, MaskError, MaskOptions, Outputs, Pattern, Receiver, Sides,
    drive::{self, Engine},
    exact::{Masks, Walks},
    gather::Answers,
};
use umbrage_accel::Bvh;
use umbrage_geom::Ray;

/// Something that knows, approximately, how much light passes along bundles of rays.
pub trait FarField: Sync {
    /// Writes the fraction of light that passes along each of `rays`, which stand for the solid angles of the same indices
    /// (steradians). Runs of rays share their origin.
    fn transmittances(&self, rays: &[Ray], solid_angles: &[f32], passed: &mut [f32]);
}

/// Ambient occlusion of `receivers`: rays that nothing blocks within `near` (world units, exactly, among the triangles of
/// `bvh`) are answered by `far` from there on. `ao`, bent normals and sectors are means over the rays of what passes; masks
/// have the rays that nothing passes.
///
/// # Errors
/// As for [`crate::exact::answer_receivers`]; [`MaskError::Radius`] unless `near` is more than 0;
/// [`MaskError::Unsupported`] for distances and for sides other than both.
#[allow(clippy::too_many_arguments)] // what there is to say
pub fn answer_receivers(
    bvh: &Bvh,
    far: &impl FarField,
    near: f32,
    pattern: &Pattern,
    receivers: &[Receiver],
    options: &MaskOptions,
    back_end: BackEnd,
    outputs: Outputs<'_>,
    progress: &mut (dyn FnMut(f32) -> bool + Send),
) -> Result<(), MaskError> {
    if near.is_nan() || near <= 0.0 {
        return Err(MaskError::Radius(near));
    }
    if options.sides != Sides::Both {
        return Err(MaskError::Unsupported("sides of far triangles"));
    }
    outputs.validate_for_tables()?;
    let masks = Masks::new(bvh, pattern, options, near, back_end, &outputs)?;
    drive::run(&Coarse { masks, far, near }, pattern, options, receivers, outputs, progress)
}

struct Coarse<'a, F> {
    masks: Masks<'a>,
    far: &'a F,
    near: f32,
}

impl<F: FarField> Engine for Coarse<'_, F> {
    type Scratch = Walks;

    fn scratch(&self) -> Walks {
        self.masks.scratch()
    }

    fn answer(&self, receivers: &[Receiver], answers: &mut Answers, walks: &mut Walks) {
        self.masks.answer(receivers, answers, walks);
        let (pattern, words) = (self.masks.pattern, self.masks.pattern.words());
        let share = std::f32::consts::PI / pattern.len() as f32;
        // Of the rays that go on, which they are.
        let (mut rays, mut angles, mut which) = (Vec::new(), Vec::new(), Vec::new());
        answers.passed.clear();
        for (receiver, mask) in receivers.iter().zip(answers.masks.chunks(words)) {
            for (i, ray) in pattern.rays_of(receiver, self.masks.options.radius).enumerate() {
                let blocked = mask[i / 64] >> (i % 64) & 1 == 1;
                if !blocked && ray.tfar > self.near {
                    which.push(answers.passed.len());
                    // The two segments are open: no hit falls between them.
                    rays.push(Ray { tnear: self.near.next_down(), ..ray });
                    angles.push(share / pattern.directions()[i].z.max(1e-3));
                }
                answers.passed.push(if blocked { 0.0 } else { 1.0 });
            }
        }
        let mut passed = vec![1.0; rays.len()];
        self.far.transmittances(&rays, &angles, &mut passed);
        for (&at, passed) in which.iter().zip(passed) {
            answers.passed[at] = passed;
            let (receiver, ray) = (at / pattern.len(), at % pattern.len());
            answers.masks[receiver * words + ray / 64] |= u64::from(passed == 0.0) << (ray % 64);
        }
    }
}
