//! One call that bakes.

use super::{BakeError, BakeOptions, Receivers, integrate, lobes, mask};
use std::io::Write;
use umbrage_aomask::exact::adaptive::Spent;
use umbrage_image::Shard;
use umbrage_query::{Answers, Occluders, QueryError, engine};

/// What to bake: who asks, what occludes, by which options; and what to write besides `ao`.
#[must_use = "nothing is baked before `run`"]
pub struct Bake<'a> {
    pub(crate) occluders: &'a Occluders,
    pub(crate) receivers: &'a Receivers,
    pub(crate) options: &'a BakeOptions,
    pub(crate) shard: Shard,
    pub(crate) dump: Option<&'a mut dyn Write>,
    pub(crate) bent_normals: Option<&'a mut [[f32; 3]]>,
}

impl<'a> Bake<'a> {
    /// All receivers, and nothing but `ao`.
    pub fn new(occluders: &'a Occluders, receivers: &'a Receivers, options: &'a BakeOptions) -> Self {
        Self { occluders, receivers, options, shard: Shard::WHOLE, dump: None, bent_normals: None }
    }

    /// Only the receivers of `shard`, one of at most [`crate::blocks`] shards.
    pub fn with_shard(self, shard: Shard) -> Self {
        Self { shard, ..self }
    }

    /// Writes every ray in the order of receivers, by methods with masks: 36 bytes each, little-endian `f32`s origin, `tnear`,
    /// direction, `tfar`, and a `u32` that is 1 if nothing passed.
    pub fn with_rays_to(self, out: &'a mut dyn Write) -> Self {
        Self { dump: Some(out), ..self }
    }

    /// Writes one bent normal a receiver, of unit length, by methods with masks: the mean of the rays' directions, each as often as
    /// it is free. It is the mean normal where nothing passes, and zero for receivers without a direction; those of other shards stay
    /// as they are.
    pub fn with_bent_normals(self, bent_normals: &'a mut [[f32; 3]]) -> Self {
        Self { bent_normals: Some(bent_normals), ..self }
    }

    /// Computes `ao` of the receivers of the shard: 1 where open, 0 where fully occluded (glTF's sense; the libraries' occlusion
    /// is `1 - ao`). Says how many rays it took.
    ///
    /// `ao` has one element a receiver; those of other shards are left as they are, so that a slice filled with NaN and given
    /// to every shard in turn ends up as the whole bake, bit for bit. Results depend on the arguments only, not on the number
    /// of threads (rayon's current pool). `progress` gets growing fractions that end at exactly 1, from any thread, and returns
    /// `false` to cancel.
    ///
    /// Rays are cosine-weighted around the receiver's normal. Where that normal is a shading normal, rays that would start into
    /// the receiver's own triangle are mirrored at its plane, so that convex surfaces stay exactly 1.
    ///
    /// The mean of `ao` over seeds is openness without bias for any number of rays; vertices at the same place with the same normal
    /// get the same `ao`.
    ///
    /// # Errors
    /// Those of [`BakeOptions::validate`]; [`BakeError::Query`] with the reason if the method can't answer; [`BakeError::Mask`] for a
    /// number of rays that masks can't have; [`BakeError::TargetError`], [`BakeError::Length`], [`BakeError::Shard`],
    /// [`BakeError::Dump`], [`BakeError::Cancelled`]. After an error `ao` and bent normals are as they were.
    pub fn run(
        self,
        ao: &mut [f32],
        progress: &mut (dyn FnMut(f32) -> bool + Send),
    ) -> Result<Spent, BakeError> {
        let options = self.options;
        options.validate()?;
        let mut sky = options.sky(self.occluders.diagonal());
        if options.method.wants_pilot() {
            sky.pilot = lobes::pilot(self.receivers, options)?;
        }
        let engine = engine::sky(options.method, self.occluders, &sky, &mut |_| progress(0.0))?;
        match engine.answers() {
            Answers::Receivers => mask::bake_receivers(self, &*engine, sky.radius, ao, progress),
            Answers::Rays if self.dump.is_none() && self.bent_normals.is_none() => {
                integrate::bake_rays(&self, &*engine, &sky, ao, progress)
            }
            _ => {
                let reason = "rays and bent normals are written by methods with masks";
                Err(QueryError::Unsupported { method: options.method.name(), reason }.into())
            }
        }
    }
}
