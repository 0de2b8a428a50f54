//! What only comparisons with `[Djeu11]` need: how cells are classified there, with a ray a cell.

pub use super::classify::Classifier;
