//! Patches and their neighbours from a control mesh.

use crate::{
    SurfaceError,
    patch::{Kind, Node, Ring, TreeContext},
    rate::length::Lengths,
    subdiv::{NONE, SubdivisionMesh},
    surface::{Link, Meeting, Patch},
};
use std::collections::HashMap;
use umbrage_geom::{BoundaryRule, PolygonMesh, glam::Vec3};

/// Named runs of faces follow one another from the first face to the last.
pub(crate) fn check_objects(control: &PolygonMesh) -> Result<(), SurfaceError> {
    let (count, mut expected) = (control.face_sizes.len() as u32, 0);
    for (i, object) in control.objects.iter().enumerate() {
        let last = i + 1 == control.objects.len();
        let faces = object.faces.clone();
        if faces.start != expected
            || faces.end < faces.start
            || faces.end > count
            || (last && faces.end < count)
        {
            let object = object.name.clone();
            return Err(SurfaceError::ObjectFaces { object, faces, expected, count });
        }
        expected = faces.end;
    }
    Ok(())
}

/// The control mesh of the texture: one vertex for each different coordinate of a vertex. Corners of its seams and
/// boundaries keep their place, whatever the boundary rule of the positions is.
pub(crate) fn uv_control(control: &PolygonMesh) -> Result<PolygonMesh, SurfaceError> {
    let expected = control.corners.len();
    if control.corner_uvs.len() != expected {
        return Err(SurfaceError::UvCount { count: control.corner_uvs.len(), expected });
    }
    let mut uv = PolygonMesh {
        face_sizes: control.face_sizes.clone(),
        boundary: BoundaryRule::EdgeAndCorner,
        crease_method: control.crease_method,
        ..PolygonMesh::default()
    };
    let mut known: HashMap<(u32, [u32; 2]), u32> = HashMap::new();
    for (corner, (&v, &[x, y])) in control.corners.iter().zip(&control.corner_uvs).enumerate() {
        if !x.is_finite() || !y.is_finite() {
            return Err(SurfaceError::UvNotFinite { corner });
        }
        // Adding 0 makes one of both zeros.
        let index = *known.entry((v, [x + 0.0, y + 0.0].map(f32::to_bits))).or_insert_with(|| {
            uv.positions.push([x, y, 0.0]);
            uv.positions.len() as u32 - 1
        });
        uv.corners.push(index);
    }
    let creases: HashMap<[u32; 2], f32> =
        control.creases.iter().flat_map(|&([a, b], s)| [([a, b], s), ([b, a], s)]).collect();
    let sharp: HashMap<u32, f32> = control.sharp_vertices.iter().copied().collect();
    let mut start = 0;
    for face in control.faces() {
        for i in 0..face.len() {
            let next = (i + 1) % face.len();
            if let Some(&s) = creases.get(&[face[i], face[next]]) {
                uv.creases.push(([uv.corners[start + i], uv.corners[start + next]], s));
            }
            if let Some(&s) = sharp.get(&face[i]) {
                uv.sharp_vertices.push((uv.corners[start + i], s));
            }
        }
        start += face.len();
    }
    Ok(uv)
}

/// Makes patches from a mesh and its first refinement.
pub(crate) struct Builder<'a> {
    mesh: &'a SubdivisionMesh,
    /// One level further, if the mesh has other faces than quadrilaterals.
    fine: Option<SubdivisionMesh>,
    /// First patch of each face.
    first: Vec<u32>,
    context: &'a TreeContext,
}

impl<'a> Builder<'a> {
    pub(crate) fn new(mesh: &'a SubdivisionMesh, context: &'a TreeContext) -> Self {
        let mut first = Vec::with_capacity(mesh.face_count());
        let mut count = 0;
        for face in 0..mesh.face_count() {
            first.push(count);
            let size = mesh.face(face).len() as u32;
            count += if size == 4 { 1 } else { size };
        }
        let fine = (count as usize != mesh.face_count()).then(|| mesh.refine());
        Self { mesh, fine, first, context }
    }

    fn is_quad(&self, face: usize) -> bool {
        self.mesh.face(face).len() == 4
    }

    pub(crate) fn build(&self) -> (Vec<Patch>, Vec<Vec3>) {
        let positions = self.fine.as_ref().unwrap_or(self.mesh).positions.len();
        let mut limits = vec![Vec3::NAN; positions];
        let mut patches = Vec::new();
        for face in 0..self.mesh.face_count() {
            let start = self.mesh.face(face).start;
            if self.is_quad(face) {
                let corners = [0, 1, 2, 3].map(|k| self.mesh.corners[(start + k) as usize]);
                let links = [0, 1, 2, 3].map(|k| self.quad_links(start + k));
                let root = self.quad_root(face, &corners, &mut limits);
                patches.push(self.patch(root, face, None, corners, links));
                continue;
            }
            let Some(fine) = &self.fine else { continue };
            for h in self.mesh.face(face) {
                let ring = fine_ring(fine, h, 0);
                let corners = [0, 1, 2, 3].map(|k| fine.corners[(4 * h + k) as usize]);
                self.set_limits(&ring, &corners, &mut limits);
                let root = Node::from_ring(ring, self.context);
                let links = self.part_links(h);
                patches.push(self.patch(root, face, Some(h - start), corners, links));
            }
        }
        (patches, limits)
    }

    fn patch(
        &self,
        root: Node,
        face: usize,
        part: Option<u32>,
        corners: [u32; 4],
        links: [[Link; 2]; 4],
    ) -> Patch {
        let bounds = root.bounds;
        let lengths = Lengths::new(matches!(root.kind, Kind::Regular(_)));
        Patch {
            root,
            face: face as u32,
            part,
            corners,
            links,
            lengths,
            bounds,
            edge_points: Default::default(),
        }
    }

    fn set_limits(&self, ring: &Ring, corners: &[u32; 4], limits: &mut [Vec3]) {
        for k in 0..4 {
            let limit = &mut limits[corners[k] as usize];
            if limit.is_nan() {
                *limit = ring.limit(k, self.context.method).as_vec3();
            }
        }
    }

    fn quad_root(&self, face: usize, corners: &[u32; 4], limits: &mut [Vec3]) -> Node {
        let start = self.mesh.face(face).start;
        match &self.fine {
            Some(fine) if !self.mesh.has_quad_ring(face) => {
                let rings = [0, 1, 2, 3].map(|k| fine_ring(fine, start + k, k as usize));
                for k in 0..4 {
                    let limit = &mut limits[corners[k] as usize];
                    if limit.is_nan() {
                        *limit = rings[k].limit(k, self.context.method).as_vec3();
                    }
                }
                Node::forked(rings.map(|ring| Node::from_ring(ring, self.context)))
            }
            _ => {
                let ring = ring(self.mesh, [0, 1, 2, 3].map(|k| start + k));
                self.set_limits(&ring, corners, limits);
                Node::from_ring(ring, self.context)
            }
        }
    }

    /// The part of its face that corner `h` belongs to, a patch.
    fn part(&self, h: u32) -> u32 {
        let face = self.mesh.face_of(h);
        self.first[face] + (h - self.mesh.face(face).start)
    }

    /// Neighbours of the edge `h` of a quadrilateral.
    fn quad_links(&self, h: u32) -> [Link; 2] {
        let twin = self.mesh.twins[h as usize];
        if twin == NONE {
            return [Link { patch: NONE, edge: 0, meeting: Meeting::Whole }; 2];
        }
        let face = self.mesh.face_of(twin);
        if self.is_quad(face) {
            let edge = (twin - self.mesh.face(face).start) as u8;
            return [Link { patch: self.first[face], edge, meeting: Meeting::Whole }; 2];
        }
        let meeting = Meeting::OtherIsHalf;
        [
            Link { patch: self.part(self.mesh.next(twin)), edge: 3, meeting },
            Link { patch: self.part(twin), edge: 0, meeting },
        ]
    }

    /// Neighbours of the part of a face at its corner `h`: edges 0 and 3 are halves of edges of the face.
    fn part_links(&self, h: u32) -> [[Link; 2]; 4] {
        let (next, previous) = (self.mesh.next(h), self.mesh.previous(h));
        let inner = |h: u32, edge: u8| [Link { patch: self.part(h), edge, meeting: Meeting::Whole }; 2];
        // The half of edge `h` at its start (`upper` of the twin), or at its end.
        let outer = |h: u32, at_start: bool| {
            let twin = self.mesh.twins[h as usize];
            if twin == NONE {
                return [Link { patch: NONE, edge: 0, meeting: Meeting::Whole }; 2];
            }
            let face = self.mesh.face_of(twin);
            let link = if self.is_quad(face) {
                let edge = (twin - self.mesh.face(face).start) as u8;
                Link { patch: self.first[face], edge, meeting: Meeting::OwnIsHalf { upper: at_start } }
            } else if at_start {
                Link { patch: self.part(self.mesh.next(twin)), edge: 3, meeting: Meeting::Whole }
            } else {
                Link { patch: self.part(twin), edge: 0, meeting: Meeting::Whole }
            };
            [link; 2]
        };
        [outer(h, true), inner(next, 2), inner(previous, 1), outer(previous, false)]
    }
}

/// The ring of a face with the given corners.
fn ring(mesh: &SubdivisionMesh, corners: [u32; 4]) -> Ring {
    let fans = corners.map(|h| mesh.fan(h));
    let own = [0, 1, 2, 3].map(|k| fans[k].1);
    Ring { fans: fans.map(|(fan, _)| fan), own }
}

/// The ring of face `face` of a refined mesh, its first corner as corner `turn`.
fn fine_ring(fine: &SubdivisionMesh, face: u32, turn: usize) -> Ring {
    ring(fine, [0, 1, 2, 3].map(|k| 4 * face + ((k + 4 - turn) % 4) as u32))
}
