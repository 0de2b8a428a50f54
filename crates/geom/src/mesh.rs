//! Triangle meshes with named objects, and the checks every mesh passes before anything is built on it.
//!
//! Here: storage, validation, bounds, smooth normals, joining. Not here: reading files (`umbrage-scene`), the audit of
//! closedness.

use crate::{Aabb, is_degenerate};
use glam::{Affine3A, Vec3, Vec3A};
use std::ops::Range;

/// Largest magnitude of a coordinate that geometry may have, in world units.
///
/// Below it no difference of coordinates and no slab test can overflow, so that boxes stay conservative.
pub const MAX_COORDINATE: f32 = 1e24;

/// Most vertices or triangles in one mesh: indices are 32-bit and the last value marks "none".
pub const MAX_ELEMENTS: usize = u32::MAX as usize - 1;

/// A run of triangles with a name and one opacity.
#[derive(Clone, Debug, PartialEq)]
pub struct MeshObject {
    /// Name as the source gives it; may be empty and need not be unique.
    pub name: String,
    /// Indices into [`TriangleMesh::triangles`].
    pub triangles: Range<u32>,
    /// Fraction of light that one crossing of a triangle blocks, in `[0, 1]`; 1 is opaque.
    pub opacity: f32,
}

/// An indexed triangle mesh.
///
/// Vertices carry positions only; normals and texture coordinates belong to the corners of triangles, so that seams
/// don't split vertices and connectivity stays what the source says.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TriangleMesh {
    /// Vertex positions, object units.
    pub positions: Vec<[f32; 3]>,
    /// Corners of each triangle, indices into [`Self::positions`], counter-clockwise seen from outside.
    pub triangles: Vec<[u32; 3]>,
    /// One unit normal a corner; empty, or as long as [`Self::triangles`].
    pub corner_normals: Vec<[[f32; 3]; 3]>,
    /// One texture coordinate a corner; empty, or as long as [`Self::triangles`].
    pub corner_uvs: Vec<[[f32; 2]; 3]>,
    /// One colour a vertex, linear RGB in `[0, 1]`, that multiplies the material's; empty, or as long as
    /// [`Self::positions`].
    pub vertex_colors: Vec<[f32; 3]>,
    /// Named runs of triangles, in order, without gap or overlap. Empty means one unnamed opaque object.
    pub objects: Vec<MeshObject>,
}

/// Why a mesh can't be used.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum MeshError {
    /// There is no triangle.
    #[error("the mesh has no triangles")]
    Empty,
    /// A coordinate is NaN or infinite.
    #[error("vertex {vertex} is not finite: ({}, {}, {})", .position[0], .position[1], .position[2])]
    NotFinite {
        /// Index of the vertex, from 0.
        vertex: usize,
        /// Its position.
        position: [f32; 3],
    },
    /// A coordinate is larger than [`MAX_COORDINATE`].
    #[error("vertex {vertex} has a coordinate beyond {MAX_COORDINATE:e}: ({}, {}, {})", .position[0], .position[1], .position[2])]
    TooFar {
        /// Index of the vertex, from 0.
        vertex: usize,
        /// Its position.
        position: [f32; 3],
    },
    /// A triangle names a vertex that does not exist.
    #[error("triangle {triangle} uses vertex {vertex}, but there are only {vertices} (indices from 0)")]
    Index {
        /// Index of the triangle, from 0.
        triangle: usize,
        /// The vertex it names, from 0.
        vertex: u32,
        /// How many vertices there are.
        vertices: usize,
    },
    /// More than [`MAX_ELEMENTS`] vertices or triangles.
    #[error("{count} {what} are more than one mesh can hold ({MAX_ELEMENTS})")]
    TooMany {
        /// `vertices` or `triangles`.
        what: &'static str,
        /// How many there are.
        count: usize,
    },
    /// An attribute has the wrong length.
    #[error("{what} has {count} entries where there should be {expected}")]
    AttributeLength {
        /// Name of the attribute.
        what: &'static str,
        /// How many entries it has.
        count: usize,
        /// How many triangles or vertices there are.
        expected: usize,
    },
    /// The objects don't cover the triangles in order.
    #[error("object '{object}' covers triangles {}..{} where it should start at {expected} and end by {triangles}", .range.start, .range.end)]
    ObjectRange {
        /// Name of the object.
        object: String,
        /// What it covers.
        range: Range<u32>,
        /// Where it should start.
        expected: u32,
        /// How many triangles there are.
        triangles: usize,
    },
    /// An opacity is outside `[0, 1]` or NaN.
    #[error("object '{object}' has opacity {opacity}, which is not between 0 and 1")]
    Opacity {
        /// Name of the object.
        object: String,
        /// Its opacity.
        opacity: f32,
    },
}

/// Checks plain slices as [`TriangleMesh::validate`] does: counts, finite coordinates of sane size, indices in range.
///
/// # Errors
/// [`MeshError::Empty`], [`MeshError::TooMany`], [`MeshError::NotFinite`], [`MeshError::TooFar`],
/// [`MeshError::Index`].
pub fn validate_slices(positions: &[[f32; 3]], triangles: &[[u32; 3]]) -> Result<(), MeshError> {
    if triangles.is_empty() {
        return Err(MeshError::Empty);
    }
    for (what, count) in [("vertices", positions.len()), ("triangles", triangles.len())] {
        if count > MAX_ELEMENTS {
            return Err(MeshError::TooMany { what, count });
        }
    }
    validate_positions(positions)?;
    validate_indices(triangles, positions.len())
}

/// Checks that all triangles are of `vertices` vertices.
///
/// # Errors
/// [`MeshError::Index`].
pub fn validate_indices(triangles: &[[u32; 3]], vertices: usize) -> Result<(), MeshError> {
    for (triangle, corners) in triangles.iter().enumerate() {
        if let Some(&vertex) = corners.iter().find(|&&v| v as usize >= vertices) {
            return Err(MeshError::Index { triangle, vertex, vertices });
        }
    }
    Ok(())
}

/// Checks that every coordinate is finite and at most [`MAX_COORDINATE`].
///
/// # Errors
/// [`MeshError::NotFinite`], [`MeshError::TooFar`].
pub fn validate_positions(positions: &[[f32; 3]]) -> Result<(), MeshError> {
    for (vertex, &position) in positions.iter().enumerate() {
        if !position.iter().all(|x| x.is_finite()) {
            return Err(MeshError::NotFinite { vertex, position });
        }
        if position.iter().any(|x| x.abs() > MAX_COORDINATE) {
            return Err(MeshError::TooFar { vertex, position });
        }
    }
    Ok(())
}

impl TriangleMesh {
    /// A mesh of one unnamed opaque object, validated.
    ///
    /// # Errors
    /// Those of [`Self::validate`].
    pub fn new(positions: Vec<[f32; 3]>, triangles: Vec<[u32; 3]>) -> Result<Self, MeshError> {
        let mesh = Self { positions, triangles, ..Self::default() };
        mesh.validate()?;
        Ok(mesh)
    }

    /// Checks everything the rest of the workspace relies on.
    ///
    /// Degenerate triangles and unused vertices are allowed: they are counted by `inspect` and never hit.
    ///
    /// # Errors
    /// The first problem found, as [`MeshError`].
    pub fn validate(&self) -> Result<(), MeshError> {
        validate_slices(&self.positions, &self.triangles)?;
        let triangles = self.triangles.len();
        for (what, count, expected) in [
            ("corner_normals", self.corner_normals.len(), triangles),
            ("corner_uvs", self.corner_uvs.len(), triangles),
            ("vertex_colors", self.vertex_colors.len(), self.positions.len()),
        ] {
            if count != 0 && count != expected {
                return Err(MeshError::AttributeLength { what, count, expected });
            }
        }
        let mut expected = 0;
        for (i, object) in self.objects.iter().enumerate() {
            let range = object.triangles.clone();
            let last = i + 1 == self.objects.len();
            if range.start != expected
                || range.end < range.start
                || range.end as usize > triangles
                || (last && range.end as usize != triangles)
            {
                return Err(MeshError::ObjectRange {
                    object: object.name.clone(),
                    range,
                    expected,
                    triangles,
                });
            }
            expected = range.end;
            if !(0.0..=1.0).contains(&object.opacity) {
                return Err(MeshError::Opacity { object: object.name.clone(), opacity: object.opacity });
            }
        }
        Ok(())
    }

    /// Positions of the three corners of triangle `index`.
    ///
    /// # Panics
    /// If `index` is out of range.
    #[inline]
    pub fn triangle(&self, index: usize) -> [[f32; 3]; 3] {
        self.triangles[index].map(|v| self.positions[v as usize])
    }

    /// Smallest box around all vertices that a triangle uses; empty when there is no triangle.
    pub fn bounds(&self) -> Aabb {
        self.triangles.iter().flatten().fold(Aabb::EMPTY, |b, &v| b.with_point(self.positions[v as usize]))
    }

    /// The objects, or the one unnamed opaque object that an empty list stands for.
    pub fn objects_or_whole(&self) -> Vec<MeshObject> {
        if self.objects.is_empty() {
            let triangles = 0..self.triangles.len() as u32;
            vec![MeshObject { name: String::new(), triangles, opacity: 1.0 }]
        } else {
            self.objects.clone()
        }
    }

    /// Indices of triangles without area, which no ray ever hits.
    pub fn degenerate_triangles(&self) -> Vec<u32> {
        (0..self.triangles.len()).filter(|&i| is_degenerate(self.triangle(i))).map(|i| i as u32).collect()
    }

    /// One unit normal a vertex: the mean of the normals of its triangles weighted by the angle at the vertex (Thuermer
    /// and Wuethrich 1998). Zero for vertices that no triangle with area uses.
    pub fn smooth_normals(&self) -> Vec<[f32; 3]> {
        let mut sums = vec![glam::DVec3::ZERO; self.positions.len()];
        for corners in &self.triangles {
            let p = corners.map(|v| Vec3::from(self.positions[v as usize]).as_dvec3());
            let normal = (p[1] - p[0]).cross(p[2] - p[0]).normalize_or_zero();
            for i in 0..3 {
                let to_next = (p[(i + 1) % 3] - p[i]).normalize_or_zero();
                let to_previous = (p[(i + 2) % 3] - p[i]).normalize_or_zero();
                let angle = to_next.cross(to_previous).length().atan2(to_next.dot(to_previous));
                sums[corners[i] as usize] += normal * angle;
            }
        }
        sums.into_iter().map(|n| n.normalize_or_zero().as_vec3().to_array()).collect()
    }

    /// Moves every vertex by `world_from_self` and turns normals by its inverse transpose; a mirroring transform also
    /// reverses the corners, so that outside stays outside.
    pub fn transform(&mut self, world_from_self: &Affine3A) {
        for p in &mut self.positions {
            *p = world_from_self.transform_point3((*p).into()).to_array();
        }
        let mirrored = world_from_self.matrix3.determinant() < 0.0;
        let normal_matrix = world_from_self.matrix3.inverse().transpose();
        for normal in self.corner_normals.iter_mut().flatten() {
            *normal = (normal_matrix * Vec3A::from(*normal)).normalize_or_zero().to_array();
        }
        if mirrored {
            self.triangles.iter_mut().for_each(|t| t.swap(1, 2));
            self.corner_normals.iter_mut().for_each(|n| n.swap(1, 2));
            self.corner_uvs.iter_mut().for_each(|n| n.swap(1, 2));
        }
    }

    /// Adds `other` behind this mesh's triangles, keeping its objects.
    ///
    /// An attribute of corners or vertices that only one of the two has is dropped.
    pub fn append(&mut self, other: &Self) {
        let vertex_base = self.positions.len() as u32;
        let triangle_base = self.triangles.len() as u32;
        if triangle_base == 0 {
            *self = other.clone();
            return;
        }
        let mut objects = self.objects_or_whole();
        objects.extend(other.objects_or_whole().into_iter().map(|object| MeshObject {
            triangles: object.triangles.start + triangle_base..object.triangles.end + triangle_base,
            ..object
        }));
        self.objects = objects;
        append_attribute(&mut self.corner_normals, &other.corner_normals);
        append_attribute(&mut self.corner_uvs, &other.corner_uvs);
        append_attribute(&mut self.vertex_colors, &other.vertex_colors);
        self.positions.extend_from_slice(&other.positions);
        self.triangles.extend(other.triangles.iter().map(|t| t.map(|v| v + vertex_base)));
    }

    /// Bytes that the arrays of this mesh hold.
    pub fn bytes(&self) -> usize {
        size_of_val(&self.positions[..])
            + size_of_val(&self.triangles[..])
            + size_of_val(&self.corner_normals[..])
            + size_of_val(&self.corner_uvs[..])
            + size_of_val(&self.vertex_colors[..])
    }
}

fn append_attribute<T: Copy>(to: &mut Vec<T>, from: &[T]) {
    if to.is_empty() || from.is_empty() {
        to.clear();
    } else {
        to.extend_from_slice(from);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn quad() -> TriangleMesh {
        TriangleMesh::new(
            vec![[0.0; 3], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]],
            vec![[0, 1, 2], [0, 2, 3]],
        )
        .unwrap()
    }

    #[test]
    fn bad_meshes_are_named() {
        let nan = TriangleMesh::new(vec![[0.0; 3], [f32::NAN, 0.0, 0.0], [0.0; 3]], vec![[0, 1, 2]]);
        assert!(matches!(nan, Err(MeshError::NotFinite { vertex: 1, .. })));
        let far = TriangleMesh::new(vec![[0.0; 3], [2e24, 0.0, 0.0], [0.0; 3]], vec![[0, 1, 2]]);
        assert!(matches!(far, Err(MeshError::TooFar { vertex: 1, .. })));
        let index = TriangleMesh::new(vec![[0.0; 3]; 3], vec![[0, 1, 3]]);
        assert_eq!(index, Err(MeshError::Index { triangle: 0, vertex: 3, vertices: 3 }));
        assert_eq!(TriangleMesh::new(vec![[0.0; 3]], vec![]), Err(MeshError::Empty));
        let mut gap = quad();
        gap.objects = vec![MeshObject { name: "a".into(), triangles: 0..1, opacity: 1.0 }];
        assert!(matches!(gap.validate(), Err(MeshError::ObjectRange { .. })));
        gap.objects[0].triangles = 0..2;
        gap.objects[0].opacity = f32::NAN;
        assert!(matches!(gap.validate(), Err(MeshError::Opacity { .. })));
    }

    #[test]
    fn appending_keeps_objects_and_mirroring_keeps_outside() {
        let mut mesh = quad();
        mesh.append(&quad());
        mesh.validate().unwrap();
        assert_eq!(mesh.objects.len(), 2);
        assert_eq!(mesh.triangles[2], [4, 5, 6]);
        let mut mirrored = quad();
        mirrored.transform(&Affine3A::from_scale(Vec3::new(-1.0, 1.0, 1.0)));
        assert_eq!(mirrored.smooth_normals()[0], [0.0, 0.0, 1.0]);
    }

    #[test]
    fn degenerate_triangles_are_found() {
        let mesh = TriangleMesh::new(
            vec![[0.0; 3], [1.0, 1.0, 1.0], [2.0, 2.0, 2.0], [0.0, 1.0, 0.0]],
            vec![[0, 1, 2], [0, 1, 3], [3, 3, 1]],
        )
        .unwrap();
        assert_eq!(mesh.degenerate_triangles(), [0, 2]);
    }
}
