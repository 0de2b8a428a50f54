//! Polygon meshes with the tags that subdivision surfaces need.

use crate::{MeshError, MeshObject, TriangleMesh};
use std::ops::Range;

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
    /// What happens at the boundary of an open mesh.
    pub boundary: BoundaryRule,
    /// How the sharpness of creases decays.
    pub crease_method: CreaseMethod,
    /// Named runs of faces in order, without gaps; empty stands for one unnamed object.
    pub objects: Vec<FaceObject>,
}

/// A named run of faces of a [`PolygonMesh`].
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct FaceObject {
    /// Name as in the file.
    pub name: String,
    /// Its faces.
    pub faces: Range<u32>,
}

/// What happens at the boundary of an open subdivision surface.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum BoundaryRule {
    /// Boundary edges are creases; boundary vertices follow the curve.
    #[default]
    EdgeOnly,
    /// In addition, boundary vertices with one face are corners and keep their place.
    EdgeAndCorner,
}

/// How the sharpness of a subdivision surface's creases decays from level to level.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum CreaseMethod {
    /// By 1 a level.
    #[default]
    Uniform,
    /// By 1 a level after a Chaikin step along the crease, which smooths changes of sharpness.
    Chaikin,
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

    /// [`Self::objects`] of a mesh with so many triangles for each face, one number a face.
    pub fn triangle_objects(&self, triangles: impl IntoIterator<Item = u32>) -> Vec<MeshObject> {
        let mut ends = vec![0];
        for count in triangles {
            ends.push(ends[ends.len() - 1] + count);
        }
        let end = |face: u32| ends[(face as usize).min(ends.len() - 1)];
        let object = |o: &FaceObject| MeshObject {
            name: o.name.clone(),
            triangles: end(o.faces.start)..end(o.faces.end),
            opacity: 1.0,
        };
        self.objects.iter().map(object).collect()
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
        mesh.objects = self.triangle_objects(self.face_sizes.iter().map(|&size| size.max(2) - 2));
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
            objects: vec![
                FaceObject { name: "a".into(), faces: 0..1 },
                FaceObject { name: "b".into(), faces: 1..2 },
            ],
            ..PolygonMesh::default()
        };
        let fans = mesh.triangulate().unwrap();
        assert_eq!(fans.triangles, [[0, 1, 2], [0, 2, 3], [0, 3, 4]]);
        let objects: Vec<_> = fans.objects.iter().map(|o| (&o.name[..], o.triangles.clone())).collect();
        assert_eq!(objects, [("a", 0..1), ("b", 1..3)]);
    }
}
