//! What solids are looked for in: a mesh and its objects, checked in one place.

use crate::OcclusionError;
use std::{
    borrow::Cow,
    ops::Range,
    sync::atomic::{AtomicU64, Ordering},
};
use umbrage_geom::mesh::validate_slices;

/// A run of triangles that belong together.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Object {
    /// Which triangles.
    pub triangles: Range<u32>,
    /// Whether no light passes them: others never make occluders (Djeu11, section 3.8.1).
    pub opaque: bool,
}

/// A mesh and the objects in it, none of which share a triangle. Triangles of no object block rays, but enclose nothing.
#[derive(Clone, Debug)]
pub struct ObjectMesh<'a> {
    /// Vertices.
    pub positions: &'a [[f32; 3]],
    /// Corners of each triangle.
    pub triangles: &'a [[u32; 3]],
    /// The objects; the whole mesh is an opaque one if there are none.
    pub objects: Cow<'a, [Object]>,
}

impl<'a> ObjectMesh<'a> {
    /// The whole mesh as one opaque object.
    pub fn new(positions: &'a [[f32; 3]], triangles: &'a [[u32; 3]]) -> Self {
        Self { positions, triangles, objects: Cow::Borrowed(&[]) }
    }

    /// With objects.
    #[must_use]
    pub fn with_objects(self, objects: impl Into<Cow<'a, [Object]>>) -> Self {
        Self { objects: objects.into(), ..self }
    }

    /// Checks what builds rely on.
    ///
    /// # Errors
    /// [`OcclusionError::Mesh`], [`OcclusionError::Object`], [`OcclusionError::Overlap`].
    pub fn validate(&self) -> Result<(), OcclusionError> {
        validate_slices(self.positions, self.triangles)?;
        let triangles = self.triangles.len();
        for (object, Object { triangles: Range { start, end }, .. }) in self.objects.iter().enumerate() {
            if start > end || *end as usize > triangles {
                return Err(OcclusionError::Object { object, start: *start, end: *end, triangles });
            }
        }
        let used = |&i: &usize| !self.objects[i].triangles.is_empty();
        let mut order: Vec<usize> = (0..self.objects.len()).filter(used).collect();
        order.sort_by_key(|&i| self.objects[i].triangles.start);
        for pair in order.windows(2) {
            let [first, second] = [pair[0], pair[1]];
            if self.objects[second].triangles.start < self.objects[first].triangles.end {
                let triangle = self.objects[second].triangles.start;
                return Err(OcclusionError::Overlap { triangle, objects: [first, second] });
            }
        }
        Ok(())
    }

    /// Checks that a hierarchy of `count` triangles may be that of the mesh.
    pub(super) fn check_hierarchy(&self, count: usize) -> Result<(), OcclusionError> {
        let triangles = self.triangles.len();
        if count == triangles { Ok(()) } else { Err(OcclusionError::Triangles { count, triangles }) }
    }

    /// The objects, or the whole mesh as one.
    pub(super) fn objects_or_whole(&self) -> Cow<'_, [Object]> {
        if self.objects.is_empty() {
            vec![Object { triangles: 0..self.triangles.len() as u32, opaque: true }].into()
        } else {
            Cow::Borrowed(&self.objects)
        }
    }
}

/// A number that no other structure of this process has. What threads remember of a structure carries it, so that with another
/// structure it is forgotten rather than believed. Copies of a structure share theirs: they have the same boxes.
pub(super) fn unique_id() -> u64 {
    static NEXT: AtomicU64 = AtomicU64::new(1);
    NEXT.fetch_add(1, Ordering::Relaxed)
}
