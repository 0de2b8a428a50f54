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
//! use umbrage_render::bake::{BakeOptions, Ground, NormalSource, Occluders, Receivers, Shard, bake};
//!
//! let tetrahedron = TriangleMesh::new(
//!     vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
//!     vec![[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]],
//! )?;
//! let occluders = Occluders::build(&[&tetrahedron], Ground::Absent)?;
//! let receivers = Receivers::vertices(&tetrahedron, NormalSource::Smooth)?;
//! let mut ao = vec![f32::NAN; receivers.len()];
//! bake(&occluders, &receivers, &BakeOptions::default(), Shard::WHOLE, &mut ao, &mut |_| true)?;
//! assert_eq!(ao, [1.0; 4]); // convex: nothing in the way
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod error;
mod integrate;
mod mask;
mod occluders;
mod options;
mod receivers;
mod texel;

#[cfg(test)]
mod tests;

pub use error::BakeError;
pub use integrate::{bake, bake_points, blocks};
pub use mask::{MaskExtras, MaskMethod, bake_masks};
pub use occluders::{Ground, Occluders};
pub use options::{BakeOptions, Jitter, NormalSource, Shard, Sides};
pub use receivers::Receivers;
pub use texel::{TexelImage, TexelMap, VAxis};
