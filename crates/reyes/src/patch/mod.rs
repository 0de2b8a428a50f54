//! Patches: a face with the faces around it, which can be refined without anything else (Djeu 2011, section 5.8.1).

mod bicubic;
pub(crate) mod kernel;
mod node;
mod ring;

pub use bicubic::Bicubic;
pub(crate) use bicubic::{Speeds, weights};
pub(crate) use node::{Children, Kind, Lattice, Node, QUARTERS, TreeContext, quarter_at};
pub(crate) use ring::Ring;
