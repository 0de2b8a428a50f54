//! Memory of meshes that Embree reads in place: [`super::ffi::Scene`] keeps it alive.
//!
//! No unsafe code is here, but that of `ffi.rs` relies on indices that these constructors check, so nothing else makes or changes
//! such memory.

use anyhow::{Result, bail};
use std::sync::Arc;
use umbrage_geom::{BoundaryRule, PolygonMesh};

/// A mesh that scenes share with us instead of copying it.
pub struct Buffers {
    /// One vertex more than the mesh has: Embree reads 16 bytes for each.
    pub(super) positions: Vec<[f32; 3]>,
    pub(super) triangles: Vec<[u32; 3]>,
}

impl Buffers {
    /// Copies a mesh. Indices must be valid.
    ///
    /// # Panics
    /// If an index is out of range.
    pub fn new(positions: &[[f32; 3]], triangles: &[[u32; 3]]) -> Arc<Self> {
        assert!(triangles.as_flattened().iter().all(|&v| (v as usize) < positions.len()), "valid indices");
        let positions = positions.iter().copied().chain([[0.0; 3]]).collect();
        Arc::new(Self { positions, triangles: triangles.to_vec() })
    }
}

/// A control mesh that scenes share with us, and how finely each of its edges is divided.
pub struct ControlBuffers {
    /// One vertex more than the mesh has, as in [`Buffers`].
    pub(super) positions: Vec<[f32; 3]>,
    pub(super) face_sizes: Vec<u32>,
    pub(super) corners: Vec<u32>,
    /// Segments of the edge from each corner to its face's next.
    pub(super) levels: Vec<f32>,
}

impl ControlBuffers {
    /// Copies a mesh without creases, whose boundary follows its curve.
    ///
    /// # Errors
    /// For creases, indices out of range, or counts that don't fit each other.
    pub fn new(mesh: &PolygonMesh, levels: &[f32]) -> Result<Arc<Self>> {
        let corners: u64 = mesh.face_sizes.iter().map(|&n| u64::from(n)).sum();
        let valid = corners == mesh.corners.len() as u64
            && levels.len() == mesh.corners.len()
            && mesh.corners.iter().all(|&v| (v as usize) < mesh.positions.len());
        let plain = mesh.creases.is_empty() && mesh.sharp_vertices.is_empty();
        if !valid || !plain || mesh.boundary != BoundaryRule::EdgeOnly {
            bail!("not a control mesh without creases whose boundary follows its curve");
        }
        Ok(Arc::new(Self {
            positions: mesh.positions.iter().copied().chain([[0.0; 3]]).collect(),
            face_sizes: mesh.face_sizes.clone(),
            corners: mesh.corners.clone(),
            levels: levels.to_vec(),
        }))
    }
}
