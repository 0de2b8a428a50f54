//! Tests across crates; they are in `tests/`, their stored images and scenes in `golden/`.
