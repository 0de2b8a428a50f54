//! Blocks of triangles tested together.
