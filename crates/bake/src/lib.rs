//! Baking ambient occlusion onto vertices, texels or given points, by exact ray casting or by masks.
//!
//! Results are called `ao`: 1 is open, 0 fully occluded, as in glTF. Elsewhere the libraries speak of occlusion, `1 - ao`.
//!
//! Rays start a few units in the last place above the receiver's surface: of two surfaces that coincide, neither occludes the
//! other's receivers.
//!
//! Here: receivers, occluders, the integral, images of texels. Not here: reading and writing files, the command line.
//!
//! ```
//! use umbrage_geom::TriangleMesh;
//! use umbrage_render::bake::{BakeOptions, NormalSource, Receivers, Shard, bake};
//! use umbrage_render::query::{Ground, Occluders};
//!
//! let tetrahedron = TriangleMesh::new(
//!     vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
//!     vec![[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]],
//! )?;
//! let occluders = Occluders::of_meshes(&[&tetrahedron], Ground::Absent, &mut |_| true)?;
//! let receivers = Receivers::vertices(&tetrahedron, NormalSource::Smooth)?;
//! let mut ao = vec![f32::NAN; receivers.len()];
//! bake(&occluders, &receivers, &BakeOptions::default(), Shard::WHOLE, &mut ao, &mut |_| true)?;
//! assert_eq!(ao, [1.0; 4]); // convex: nothing in the way
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod error;
mod integrate;
mod lobes;
mod mask;
mod options;
mod receivers;
mod texel;

#[cfg(test)]
mod tests;

pub use error::BakeError;
pub use integrate::{bake, blocks};
pub use options::{BakeOptions, Jitter, NormalSource, Shard};
pub use receivers::Receivers;
pub use texel::{TexelImage, TexelMap, VAxis};

use crate::query::{Answers, Occluders, QueryError, engine};
use std::io::Write;
use umbrage_aomask::exact::adaptive::Spent;

/// What [`bake_with`] gives besides openness, by methods with masks.
#[derive(Default)]
pub struct BakeExtras<'d, 'b> {
    /// Gets every ray in the order of receivers: 36 bytes each, little-endian `f32`s origin, `tnear`, direction, `tfar`, and
    /// a `u32` that is 1 if nothing passed.
    pub dump: Option<&'d mut dyn Write>,
    /// One for each receiver, of unit length: the mean of the rays' directions, each as often as it is free. The mean normal
    /// where nothing passes, zero for receivers without a direction; those of other shards stay as they are.
    pub bent_normals: Option<&'b mut [[f32; 3]]>,
}

/// [`bake`] with more results; says how many rays it took.
///
/// # Errors
/// Those of [`bake`]; [`BakeError::Query`] if a method without masks is asked for more than `ao`; [`BakeError::Dump`]. After an
/// error `ao` and bent normals are as they were.
pub fn bake_with(
    occluders: &Occluders,
    receivers: &Receivers,
    options: &BakeOptions,
    shard: Shard,
    ao: &mut [f32],
    extras: BakeExtras<'_, '_>,
    progress: &mut (dyn FnMut(f32) -> bool + Send),
) -> Result<Spent, BakeError> {
    options.validate()?;
    let sky = options.sky(occluders.diagonal());
    let engine = engine::sky(options.method, occluders, &sky, &mut |_| progress(0.0))?;
    let engine = &*engine;
    match engine.answers() {
        Answers::Receivers => {
            mask::bake_receivers(engine, sky.radius, receivers, options, shard, (ao, extras), progress)
        }
        Answers::Rays if extras.dump.is_none() && extras.bent_normals.is_none() => {
            integrate::bake_rays(engine, &sky, receivers, options, shard, ao, progress)?;
            let part = integrate::shard_of(receivers, shard, ao)?;
            let lobes = |&i: &u32| receivers.lobes(i as usize).len() as u64;
            let count: u64 = part.iter().flatten().map(lobes).sum();
            Ok(Spent::uniform(options.rays, count))
        }
        _ => {
            let reason = "rays and bent normals are written by methods with masks";
            Err(QueryError::Unsupported { method: options.method.name(), reason }.into())
        }
    }
}
