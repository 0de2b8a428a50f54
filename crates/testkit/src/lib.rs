//! Oracles for tests, and the program in a folder of its own. A development dependency only; it depends on no other crate of the workspace, so that unit tests of
//! every crate can use it.

mod boxes;
mod program;

pub use boxes::{Segment, segment_meets_interior, segment_touches_box};
pub use program::ProgramFolder;
