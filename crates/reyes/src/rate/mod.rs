//! How finely patches are divided: by a ray's footprint, by a picture's camera, or by edges.

pub(crate) mod diagsplit;
pub(crate) mod eye;
pub(crate) mod footprint;
pub(crate) mod length;
