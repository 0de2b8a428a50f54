//! Whole meshes: checking, neighbours, one level of refinement.

use super::{
    CreaseMethod, Fan, MAX_VALENCE, Spoke,
    rules::{self, INFINITE_SHARPNESS, Star, child_sharpness, decay},
};
use crate::SurfaceError;
use std::collections::HashMap;
use umbrage_geom::{
    BoundaryRule, MeshError, PolygonMesh,
    glam::{DVec3, Vec3},
    mesh::{MAX_ELEMENTS, validate_positions},
};

/// No half-edge: the other side of a boundary.
pub(crate) const NONE: u32 = u32::MAX;

/// A manifold polygon mesh with creases that can be refined, in `f64`.
///
/// A vertex where several fans of faces meet is split into one vertex for each fan; the extra ones come last. Vertices
/// without faces keep their place.
#[derive(Clone, Debug)]
pub struct SubdivisionMesh {
    pub(crate) positions: Vec<DVec3>,
    /// First corner of each face, and the number of corners at the end.
    pub(crate) starts: Vec<u32>,
    /// Vertex of each corner. A corner also stands for the half-edge from it to the face's next corner.
    pub(crate) corners: Vec<u32>,
    face_of: Vec<u32>,
    pub(crate) twins: Vec<u32>,
    /// Sharpness of each half-edge, the same in both.
    sharpness: Vec<f32>,
    vertex_sharpness: Vec<f32>,
    /// The half-edge that each vertex's fan starts with: the boundary's in an open fan, `NONE` without faces.
    first: Vec<u32>,
    method: CreaseMethod,
}

/// Vertices of half-edge `h` from `corners` and first corners of faces.
fn half_edge_ends(mesh: &SubdivisionMesh, h: u32) -> [u32; 2] {
    [mesh.corners[h as usize], mesh.corners[mesh.next(h) as usize]]
}

/// The edges around a vertex of a mesh whose face points are known.
struct MeshStar<'a> {
    neighbours: &'a [DVec3],
    sharpness: &'a [f32],
    face_points: DVec3,
}

impl Star for MeshStar<'_> {
    fn edges(&self) -> usize {
        self.neighbours.len()
    }

    fn neighbour(&self, i: usize) -> DVec3 {
        self.neighbours[i]
    }

    fn sharpness(&self, i: usize) -> f32 {
        self.sharpness[i]
    }

    fn face_points(&self) -> DVec3 {
        self.face_points
    }
}

fn check(control: &PolygonMesh) -> Result<(), SurfaceError> {
    let vertices = control.positions.len();
    if control.face_sizes.is_empty() {
        return Err(MeshError::Empty.into());
    }
    for (what, count) in [("vertices", vertices), ("corners", control.corners.len())] {
        // A level of refinement has four times as many corners.
        if count > MAX_ELEMENTS / 4 {
            return Err(MeshError::TooMany { what, count }.into());
        }
    }
    validate_positions(&control.positions)?;
    let expected = control.face_sizes.iter().map(|&n| n as usize).sum();
    if expected != control.corners.len() {
        return Err(SurfaceError::CornerCount { count: control.corners.len(), expected });
    }
    for (face, corners) in control.faces().enumerate() {
        if !(3..=MAX_VALENCE).contains(&corners.len()) {
            return Err(SurfaceError::FaceSize { face, size: corners.len() as u32 });
        }
        if let Some(&vertex) = corners.iter().find(|&&v| v as usize >= vertices) {
            return Err(SurfaceError::VertexIndex { face, vertex, vertices });
        }
        let mut sorted = corners.to_vec();
        sorted.sort_unstable();
        if let Some(pair) = sorted.windows(2).find(|pair| pair[0] == pair[1]) {
            return Err(SurfaceError::RepeatedVertex { face, vertex: pair[0] });
        }
    }
    let sharpness = control.creases.iter().map(|c| c.1).chain(control.sharp_vertices.iter().map(|v| v.1));
    for sharpness in sharpness {
        if sharpness.is_nan() || sharpness < 0.0 {
            return Err(SurfaceError::Sharpness(sharpness));
        }
    }
    if let Some(&(vertex, _)) = control.sharp_vertices.iter().find(|v| v.0 as usize >= vertices) {
        return Err(SurfaceError::SharpVertex { vertex, vertices });
    }
    Ok(())
}

impl SubdivisionMesh {
    /// Checks a control mesh and finds its neighbours; takes linear time. The control mesh's boundary rule and crease method
    /// hold for all levels.
    ///
    /// # Errors
    /// [`SurfaceError`], all kinds but those about options and texture coordinates.
    pub fn new(control: &PolygonMesh) -> Result<Self, SurfaceError> {
        check(control)?;
        let mut starts = vec![0];
        starts.extend(control.face_sizes.iter().scan(0, |end, &n| {
            *end += n;
            Some(*end)
        }));
        let mut vertex_sharpness = vec![0.0; control.positions.len()];
        for &(v, s) in &control.sharp_vertices {
            vertex_sharpness[v as usize] = s.max(vertex_sharpness[v as usize]);
        }
        let positions = control.positions.iter().map(|&p| Vec3::from(p).as_dvec3()).collect();
        let corners = control.corners.clone();
        let mut mesh = Self::connect(positions, starts, corners, vertex_sharpness, control.crease_method)?;
        mesh.set_creases(control)?;
        mesh.split_fans(control.boundary)?;
        Ok(mesh)
    }

    /// Finds twins. Creases and fans are still to be set.
    fn connect(
        positions: Vec<DVec3>,
        starts: Vec<u32>,
        corners: Vec<u32>,
        vertex_sharpness: Vec<f32>,
        method: CreaseMethod,
    ) -> Result<Self, SurfaceError> {
        let runs = starts.windows(2).enumerate();
        let face_of =
            runs.flat_map(|(f, run)| std::iter::repeat_n(f as u32, (run[1] - run[0]) as usize)).collect();
        let mut mesh = Self {
            first: vec![NONE; positions.len()],
            twins: vec![NONE; corners.len()],
            sharpness: vec![0.0; corners.len()],
            positions,
            starts,
            corners,
            face_of,
            vertex_sharpness,
            method,
        };
        let mut open: HashMap<[u32; 2], u32> = HashMap::with_capacity(mesh.corners.len());
        for h in 0..mesh.corners.len() as u32 {
            let edge = half_edge_ends(&mesh, h);
            if open.insert(edge, h).is_some() {
                return Err(SurfaceError::NonManifoldEdge { edge });
            }
            if let Some(&twin) = open.get(&[edge[1], edge[0]]) {
                mesh.twins[h as usize] = twin;
                mesh.twins[twin as usize] = h;
            }
        }
        Ok(mesh)
    }

    fn set_creases(&mut self, control: &PolygonMesh) -> Result<(), SurfaceError> {
        let edges: HashMap<[u32; 2], u32> = if control.creases.is_empty() {
            HashMap::new()
        } else {
            (0..self.corners.len() as u32).map(|h| (half_edge_ends(self, h), h)).collect()
        };
        for &(edge, sharpness) in &control.creases {
            let [a, b] = edge;
            let h = edges.get(&[a, b]).or_else(|| edges.get(&[b, a]));
            let h = *h.ok_or(SurfaceError::CreaseEdge { edge })? as usize;
            let sharpness = sharpness.max(self.sharpness[h]);
            self.sharpness[h] = sharpness;
            if self.twins[h] != NONE {
                self.sharpness[self.twins[h] as usize] = sharpness;
            }
        }
        Ok(())
    }

    /// Gives each fan a vertex of its own, makes boundaries sharp.
    fn split_fans(&mut self, boundary: BoundaryRule) -> Result<(), SurfaceError> {
        for h in 0..self.corners.len() {
            if self.twins[h] == NONE {
                self.sharpness[h] = INFINITE_SHARPNESS;
            }
        }
        let mut seen = vec![false; self.corners.len()];
        for h in 0..self.corners.len() as u32 {
            if seen[h as usize] {
                continue;
            }
            // Clockwise to the boundary, or all the way round.
            let mut first = h;
            while let Some(before) = self.clockwise(first) {
                first = before;
                if first == h {
                    break;
                }
            }
            let fan: Vec<u32> = self.outgoing(first).collect();
            let mut v = self.corners[h as usize];
            if fan.len() > MAX_VALENCE {
                return Err(SurfaceError::Valence { vertex: v, valence: fan.len() });
            }
            if self.first[v as usize] != NONE {
                let original = v as usize;
                v = self.positions.len() as u32;
                self.positions.push(self.positions[original]);
                self.vertex_sharpness.push(self.vertex_sharpness[original]);
                self.first.push(NONE);
            }
            self.first[v as usize] = first;
            for &h in &fan {
                seen[h as usize] = true;
                self.corners[h as usize] = v;
            }
            let is_corner = boundary == BoundaryRule::EdgeAndCorner && fan.len() == 1;
            if is_corner && self.twins[first as usize] == NONE {
                self.vertex_sharpness[v as usize] = INFINITE_SHARPNESS;
            }
        }
        Ok(())
    }

    pub(crate) fn next(&self, h: u32) -> u32 {
        let face = self.face_of[h as usize] as usize;
        if h + 1 == self.starts[face + 1] { self.starts[face] } else { h + 1 }
    }

    pub(crate) fn previous(&self, h: u32) -> u32 {
        let face = self.face_of[h as usize] as usize;
        if h == self.starts[face] { self.starts[face + 1] - 1 } else { h - 1 }
    }

    fn clockwise(&self, h: u32) -> Option<u32> {
        let twin = self.twins[h as usize];
        (twin != NONE).then(|| self.next(twin))
    }

    /// Half-edges that leave a vertex, counter-clockwise from `first`.
    fn outgoing(&self, first: u32) -> impl Iterator<Item = u32> {
        std::iter::successors(Some(first), move |&h| {
            let twin = self.twins[self.previous(h) as usize];
            (twin != NONE && twin != first).then_some(twin)
        })
    }

    /// Number of faces.
    pub fn face_count(&self) -> usize {
        self.starts.len() - 1
    }

    /// Corners of face `face`.
    pub(crate) fn face(&self, face: usize) -> std::ops::Range<u32> {
        self.starts[face]..self.starts[face + 1]
    }

    pub(crate) fn face_of(&self, h: u32) -> usize {
        self.face_of[h as usize] as usize
    }

    /// Positions of the vertices.
    pub fn positions(&self) -> &[DVec3] {
        &self.positions
    }

    /// Vertex indices of each face.
    pub fn faces(&self) -> impl Iterator<Item = &[u32]> {
        self.starts.windows(2).map(|run| &self.corners[run[0] as usize..run[1] as usize])
    }

    pub(crate) fn crease_method(&self) -> CreaseMethod {
        self.method
    }

    pub(crate) fn face_point(&self, face: usize) -> DVec3 {
        let corners = &self.corners[self.starts[face] as usize..self.starts[face + 1] as usize];
        corners.iter().map(|&v| self.positions[v as usize]).sum::<DVec3>() / corners.len() as f64
    }

    /// Whether all faces around the corners of `face` have four corners.
    pub(crate) fn has_quad_ring(&self, face: usize) -> bool {
        self.face(face).all(|h| {
            let first = self.first[self.corners[h as usize] as usize];
            self.outgoing(first).all(|out| self.face(self.face_of(out)).len() == 4)
        })
    }

    /// The fan around the vertex of corner `h`, all of whose faces have four corners, and the index of the face of `h` in it.
    pub(crate) fn fan(&self, h: u32) -> (Fan, usize) {
        let v = self.corners[h as usize] as usize;
        let closed = self.twins[self.first[v] as usize] != NONE;
        let start = if closed { h } else { self.first[v] };
        let position = |h: u32| self.positions[self.corners[h as usize] as usize];
        let mut own = 0;
        let mut spokes = Vec::new();
        let mut last = start;
        for (i, out) in self.outgoing(start).enumerate() {
            if out == h {
                own = i;
            }
            let (next, across) = (self.next(out), self.next(self.next(out)));
            spokes.push(Spoke {
                edge: position(next),
                diagonal: position(across),
                sharpness: self.sharpness[out as usize],
            });
            last = self.previous(out);
        }
        if !closed {
            let sharpness = self.sharpness[last as usize];
            spokes.push(Spoke { edge: position(last), diagonal: DVec3::NAN, sharpness });
        }
        let sharpness = self.vertex_sharpness[v];
        (Fan { center: self.positions[v], sharpness, closed, spokes: spokes.into() }, own)
    }

    /// One level of refinement. Vertices come in the order vertices, edges, faces of this mesh; face `i` of the result is
    /// that of corner `i` here and starts with the corner's vertex.
    #[must_use]
    pub fn refine(&self) -> Self {
        let face_points: Vec<DVec3> = (0..self.face_count()).map(|f| self.face_point(f)).collect();
        let vertices = self.positions.len();
        let mut edge_of = vec![NONE; self.corners.len()];
        let mut edge_points = Vec::new();
        for h in 0..self.corners.len() as u32 {
            let twin = self.twins[h as usize];
            if twin < h {
                edge_of[h as usize] = edge_of[twin as usize];
                continue;
            }
            edge_of[h as usize] = (vertices + edge_points.len()) as u32;
            let [a, b] = half_edge_ends(self, h).map(|v| self.positions[v as usize]);
            let faces = (twin != NONE).then(|| [h, twin].map(|h| face_points[self.face_of(h)]));
            edge_points.push(rules::edge_point(a, b, self.sharpness[h as usize], faces));
        }
        let face_base = (vertices + edge_points.len()) as u32;
        // Sharpness of the half of each edge next to the half-edge's start, and next to its end.
        let mut halves = vec![[0f32; 2]; self.corners.len()];
        let mut positions: Vec<DVec3> = Vec::with_capacity(face_base as usize + face_points.len());
        for v in 0..vertices {
            positions.push(self.refine_vertex(v, &face_points, &mut halves));
        }
        positions.extend(edge_points);
        positions.extend(face_points);
        let mut vertex_sharpness: Vec<f32> = self.vertex_sharpness.iter().map(|&s| decay(s)).collect();
        vertex_sharpness.resize(positions.len(), 0.0);
        let mut corners = Vec::with_capacity(4 * self.corners.len());
        let mut sharpness = Vec::with_capacity(4 * self.corners.len());
        for h in 0..self.corners.len() as u32 {
            let previous = self.previous(h) as usize;
            let middle = face_base + self.face_of[h as usize];
            corners.extend([self.corners[h as usize], edge_of[h as usize], middle, edge_of[previous]]);
            sharpness.extend([halves[h as usize][0], 0.0, 0.0, halves[previous][1]]);
        }
        let starts = (0..=self.corners.len() as u32).map(|i| 4 * i).collect();
        let mut fine = Self::connect(positions, starts, corners, vertex_sharpness, self.method)
            .expect("halves of a manifold mesh are one");
        fine.sharpness = sharpness;
        fine.set_first();
        fine
    }

    /// Finds where the fans of vertices start; each vertex has one fan.
    fn set_first(&mut self) {
        for h in 0..self.corners.len() as u32 {
            let v = self.corners[h as usize] as usize;
            // The boundary's half-edge where there is one.
            if self.first[v] == NONE || self.twins[h as usize] == NONE {
                self.first[v] = h;
            }
        }
    }

    /// The faces around a vertex as a mesh of their own, in which the vertex is the first; `None` if it has none or does not
    /// exist.
    ///
    /// Refined, it has around that vertex what the whole mesh has there, so that a limit is found in linear time:
    /// `mesh.refine().around(0)`, again and again.
    pub fn around(&self, vertex: u32) -> Option<Self> {
        let first = self.first.get(vertex as usize).copied().filter(|&first| first != NONE)?;
        let mut of_whole = vec![vertex];
        let mut known = HashMap::from([(vertex, 0)]);
        let (mut starts, mut corners, mut sharpness) = (vec![0], Vec::new(), Vec::new());
        for out in self.outgoing(first) {
            for h in self.face(self.face_of(out)) {
                let v = self.corners[h as usize];
                corners.push(*known.entry(v).or_insert_with(|| {
                    of_whole.push(v);
                    of_whole.len() as u32 - 1
                }));
                sharpness.push(self.sharpness[h as usize]);
            }
            starts.push(corners.len() as u32);
        }
        let positions = of_whole.iter().map(|&v| self.positions[v as usize]).collect();
        let vertex_sharpness = of_whole.iter().map(|&v| self.vertex_sharpness[v as usize]).collect();
        let mut part = Self::connect(positions, starts, corners, vertex_sharpness, self.method).ok()?;
        part.sharpness = sharpness;
        part.set_first();
        Some(part)
    }

    /// The new place of vertex `v`; sharpness of its ends of edges goes into `halves`.
    fn refine_vertex(&self, v: usize, face_points: &[DVec3], halves: &mut [[f32; 2]]) -> DVec3 {
        let first = self.first[v];
        if first == NONE {
            return self.positions[v];
        }
        let (mut neighbours, mut sharpness, mut sum) = (Vec::new(), Vec::new(), DVec3::ZERO);
        let mut last = first;
        for out in self.outgoing(first) {
            neighbours.push(self.positions[self.corners[self.next(out) as usize] as usize]);
            sharpness.push(self.sharpness[out as usize]);
            sum += face_points[self.face_of(out)];
            last = self.previous(out);
        }
        let open = self.twins[last as usize] == NONE;
        if open {
            neighbours.push(self.positions[self.corners[last as usize] as usize]);
            sharpness.push(self.sharpness[last as usize]);
        }
        let child = |i: usize| child_sharpness(sharpness.iter().copied(), i, self.method);
        for (i, out) in self.outgoing(first).enumerate() {
            halves[out as usize][0] = child(i);
            let twin = self.twins[out as usize];
            if twin != NONE {
                halves[twin as usize][1] = child(i);
            }
        }
        if open {
            halves[last as usize][1] = child(sharpness.len() - 1);
        }
        let star = MeshStar { neighbours: &neighbours, sharpness: &sharpness, face_points: sum };
        rules::vertex_point(self.positions[v], self.vertex_sharpness[v], &star)
    }
}
