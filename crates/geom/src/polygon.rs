//! Polygon meshes with the tags that subdivision surfaces need.

use crate::{MeshError, TriangleMesh};

/// A mesh of polygons of any size, with creases: the control mesh of a subdivision surface.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PolygonMesh {
    /// Vertex positions, object units.
    pub positions: Vec<[f32; 3]>,
    /// Number of corners of each face, at least 3.
    pub face_sizes: Vec<u32>,
    /// Corners of all faces in a row, indices into [`Self::positions`], counter-clockwise seen from outside.
    pub corners: Vec<u32>,
    /// One texture coordinate a corner; empty, or as long as [`Self::corners`].
    pub corner_uvs: Vec<[f32; 2]>,
    /// Edges with a sharpness above 0, as two vertices and the sharpness; 10 and more is infinitely sharp.
    pub creases: Vec<([u32; 2], f32)>,
    /// Vertices with a sharpness above 0.
    pub sharp_vertices: Vec<(u32, f32)>,
}

impl PolygonMesh {
    /// The faces as slices of vertex indices.
    pub fn faces(&self) -> impl Iterator<Item = &[u32]> {
        let mut start = 0;
        self.face_sizes.iter().map(move |&size| {
            let end = (start + size as usize).min(self.corners.len());
            let face = &self.corners[start.min(end)..end];
            start = end;
            face
        })
    }

    /// Fan triangulation from each face's first corner.
    ///
    /// # Errors
    /// Those of [`TriangleMesh::validate`].
    pub fn triangulate(&self) -> Result<TriangleMesh, MeshError> {
        let mut mesh = TriangleMesh { positions: self.positions.clone(), ..TriangleMesh::default() };
        let mut start = 0;
        for face in self.faces() {
            for i in 2..face.len() {
                mesh.triangles.push([face[0], face[i - 1], face[i]]);
                if let Some(uvs) = self.corner_uvs.get(start..start + face.len()) {
                    mesh.corner_uvs.push([uvs[0], uvs[i - 1], uvs[i]]);
                }
            }
            start += face.len();
        }
        mesh.validate()?;
        Ok(mesh)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn polygons_become_fans() {
        let mesh = PolygonMesh {
            positions: vec![[0.0; 3]; 5],
            face_sizes: vec![3, 4],
            corners: vec![0, 1, 2, 0, 2, 3, 4],
            ..PolygonMesh::default()
        };
        assert_eq!(mesh.triangulate().unwrap().triangles, [[0, 1, 2], [0, 2, 3], [0, 3, 4]]);
    }
}
