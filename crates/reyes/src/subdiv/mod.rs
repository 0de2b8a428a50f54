//! Catmull-Clark subdivision (Djeu 2011, section 5.8.1).

mod fan;
mod mesh;
mod rules;

pub(crate) use fan::{Fan, Spoke};
pub(crate) use mesh::NONE;
pub use mesh::SubdivisionMesh;
pub use rules::INFINITE_SHARPNESS;
pub use umbrage_geom::{BoundaryRule, CreaseMethod};

/// Most faces around a vertex, and most corners of a face.
pub const MAX_VALENCE: usize = 1 << 12;
