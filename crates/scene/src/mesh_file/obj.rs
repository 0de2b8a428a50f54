//! Wavefront OBJ: vertices, normals, texture coordinates, polygons and object names.
//!
//! Not here: what subdivision tags mean (`tags.rs`).
//!
//! Our own reader, because `tobj` splits vertices at object borders, renumbers them, and doesn't name lines; tests
//! compare with it.

use super::{ContentError, tags::Tags};
use umbrage_geom::mesh::{MAX_COORDINATE, MAX_ELEMENTS};
use umbrage_geom::{FaceObject, MeshError, PolygonMesh, TriangleMesh};

/// No normal or texture coordinate at this corner.
const NONE: u32 = u32::MAX;

/// Contents of a file, with polygons as they are.
#[derive(Default)]
pub(super) struct Obj {
    positions: Vec<[f32; 3]>,
    normals: Vec<[f32; 3]>,
    uvs: Vec<[f32; 2]>,
    face_sizes: Vec<u32>,
    /// Indices of vertex, texture coordinate and normal, the last two empty until a file uses them.
    corners: Vec<u32>,
    corner_uvs: Vec<u32>,
    corner_normals: Vec<u32>,
    /// Name, and first face.
    objects: Vec<(String, usize)>,
    tags: Tags,
    /// Indices beyond what was declared so far, to be looked at again at the end.
    forward: Vec<ForwardIndex>,
}

#[derive(Clone, Copy)]
enum Stream {
    Vertex,
    Uv,
    Normal,
}

struct ForwardIndex {
    line: usize,
    stream: Stream,
    index: u32,
}

/// Reads a whole file.
pub(super) fn parse(bytes: &[u8]) -> Result<Obj, ContentError> {
    let mut obj = Obj::default();
    let mut joined = Vec::new();
    let mut lines = bytes.split(|&b| b == b'\n').enumerate();
    while let Some((i, mut line)) = lines.next() {
        let number = i + 1;
        // A backslash at the end continues the line.
        if let Some(start) = continued(line) {
            joined.clear();
            joined.extend_from_slice(start);
            for (_, next) in lines.by_ref() {
                joined.push(b' ');
                match continued(next) {
                    Some(more) => joined.extend_from_slice(more),
                    None => {
                        joined.extend_from_slice(next);
                        break;
                    }
                }
            }
            line = &joined;
        }
        obj.statement(line, number).map_err(|message| ContentError::Line(number, message))?;
    }
    obj.check_forward()?;
    if obj.positions.len() > MAX_ELEMENTS {
        return Err(MeshError::TooMany { what: "vertices", count: obj.positions.len() }.into());
    }
    if obj.face_sizes.is_empty() {
        return Err(MeshError::Empty.into());
    }
    Ok(obj)
}

fn continued(line: &[u8]) -> Option<&[u8]> {
    line.strip_suffix(b"\r").unwrap_or(line).strip_suffix(b"\\")
}

impl Obj {
    fn statement(&mut self, line: &[u8], number: usize) -> Result<(), String> {
        let line = line.trim_ascii();
        let (keyword, rest) = match line.iter().position(u8::is_ascii_whitespace) {
            Some(end) => line.split_at(end),
            None => (line, &[][..]),
        };
        match keyword {
            b"v" => {
                let p = floats::<3>(rest, 3, "vertex", "coordinates")?;
                if p.iter().any(|x| x.abs() > MAX_COORDINATE) {
                    return Err(format!("vertex has a coordinate beyond {MAX_COORDINATE:e}"));
                }
                self.positions.push(p);
            }
            b"vn" => self.normals.push(floats::<3>(rest, 3, "normal", "coordinates")?),
            b"vt" => self.uvs.push(floats::<2>(rest, 1, "texture coordinate", "numbers")?),
            b"f" => self.face(rest, number)?,
            b"o" | b"g" => {
                let name = String::from_utf8_lossy(rest).trim().to_string();
                self.objects.push((name, self.face_sizes.len()));
            }
            b"t" | b"#t" => self.tags.read(rest, number, keyword == b"#t")?,
            [] | [b'#', ..] => {}
            // What else an OBJ may hold doesn't concern shadows, but a binary file is not an OBJ.
            _ if line.iter().any(|&b| b < b' ' && b != b'\t') => {
                return Err("not text: this is not an OBJ file".into());
            }
            _ => {}
        }
        Ok(())
    }

    fn face(&mut self, rest: &[u8], line: usize) -> Result<(), String> {
        let mut size = 0;
        for word in words(rest) {
            let mut parts = word.split(|&b| b == b'/');
            let v = self.index(parts.next().unwrap_or_default(), Stream::Vertex, line)?;
            let mut optional = |stream| match parts.next() {
                None | Some(b"") => Ok(NONE),
                Some(part) => self.index(part, stream, line),
            };
            let uv = optional(Stream::Uv)?;
            let normal = optional(Stream::Normal)?;
            if parts.next().is_some() {
                return Err(format!("'{}' has more than three indices", quote(word)));
            }
            push_attribute(&mut self.corner_uvs, uv, self.corners.len());
            push_attribute(&mut self.corner_normals, normal, self.corners.len());
            self.corners.push(v);
            size += 1;
        }
        if size < 3 {
            return Err(format!("face has {size} corners, expected at least 3"));
        }
        self.face_sizes.push(size);
        Ok(())
    }

    /// An index from 0, of one that counts from 1 or, if negative, back from the latest.
    fn index(&mut self, text: &[u8], stream: Stream, line: usize) -> Result<u32, String> {
        let count = self.count(stream);
        let name = stream.name();
        let Some(value) = parse_integer(text) else {
            return Err(format!("'{}' is not a {name} index", quote(text)));
        };
        let index = match value {
            0 => return Err(format!("{name} index 0 (indices start at 1)")),
            1.. => value - 1,
            _ if value + (count as i64) < 0 => {
                return Err(format!("{name} index {value} reaches back past the first of {count}"));
            }
            _ => value + count as i64,
        };
        if index >= MAX_ELEMENTS as i64 {
            return Err(format!("{name} index {value} is past the end"));
        }
        let index = index as u32;
        if index as usize >= count {
            self.forward.push(ForwardIndex { line, stream, index });
        }
        Ok(index)
    }

    fn count(&self, stream: Stream) -> usize {
        match stream {
            Stream::Vertex => self.positions.len(),
            Stream::Uv => self.uvs.len(),
            Stream::Normal => self.normals.len(),
        }
    }

    fn check_forward(&self) -> Result<(), ContentError> {
        for &ForwardIndex { line, stream, index } in &self.forward {
            let count = self.count(stream);
            if index as usize >= count {
                let name = stream.name();
                let message =
                    format!("{name} index {} is past the end (the file has {count})", index as u64 + 1);
                return Err(ContentError::Line(line, message));
            }
        }
        Ok(())
    }

    pub(super) fn into_triangles(self) -> Result<TriangleMesh, ContentError> {
        let mut mesh = TriangleMesh::default();
        let triangles: usize = self.face_sizes.iter().map(|&n| n as usize - 2).sum();
        if triangles > MAX_ELEMENTS {
            return Err(MeshError::TooMany { what: "triangles", count: triangles }.into());
        }
        mesh.triangles.reserve_exact(triangles);
        let mut corner = 0;
        for &size in &self.face_sizes {
            for i in corner + 1..corner + size as usize - 1 {
                self.push_triangle([corner, i, i + 1], &mut mesh);
            }
            corner += size as usize;
        }
        let polygons = PolygonMesh { objects: self.face_objects(), ..PolygonMesh::default() };
        mesh.objects = polygons.triangle_objects(self.face_sizes.iter().map(|&size| size - 2));
        mesh.positions = self.positions;
        Ok(mesh)
    }

    /// Runs of faces under one name; names without faces are left out.
    fn face_objects(&self) -> Vec<FaceObject> {
        let count = self.face_sizes.len();
        let mut objects: Vec<FaceObject> = Vec::new();
        for (i, (name, first)) in self.objects.iter().enumerate() {
            let end = self.objects.get(i + 1).map_or(count, |(_, next)| *next);
            if *first == end {
                continue;
            }
            if objects.is_empty() && *first > 0 {
                objects.push(FaceObject { name: String::new(), faces: 0..*first as u32 });
            }
            objects.push(FaceObject { name: name.clone(), faces: *first as u32..end as u32 });
        }
        objects
    }

    fn push_triangle(&self, corners: [usize; 3], mesh: &mut TriangleMesh) {
        let vertices = corners.map(|c| self.corners[c]);
        mesh.triangles.push(vertices);
        if !self.corner_uvs.is_empty() {
            // Corners past the end of the list have none.
            mesh.corner_uvs.push(corners.map(|c| match self.corner_uvs.get(c) {
                Some(&uv) if uv != NONE => self.uvs[uv as usize],
                _ => [0.0; 2],
            }));
        }
        if !self.corner_normals.is_empty() {
            let positions = vertices.map(|v| self.positions[v as usize]);
            mesh.corner_normals.push(corners.map(|c| match self.corner_normals.get(c) {
                Some(&n) if n != NONE => super::normal_or_geometric(self.normals[n as usize], positions),
                _ => super::geometric_normal(positions),
            }));
        }
    }

    pub(super) fn into_polygons(self) -> Result<PolygonMesh, ContentError> {
        let corner_uvs = (0..if self.corner_uvs.is_empty() { 0 } else { self.corners.len() })
            .map(|c| match self.corner_uvs.get(c) {
                Some(&uv) if uv != NONE => self.uvs[uv as usize],
                _ => [0.0; 2],
            })
            .collect();
        let mut mesh = PolygonMesh {
            objects: self.face_objects(),
            positions: self.positions,
            face_sizes: self.face_sizes,
            corners: self.corners,
            corner_uvs,
            ..PolygonMesh::default()
        };
        self.tags.apply(&mut mesh)?;
        Ok(mesh)
    }
}

impl Stream {
    fn name(self) -> &'static str {
        match self {
            Self::Vertex => "vertex",
            Self::Uv => "texture coordinate",
            Self::Normal => "normal",
        }
    }
}

/// Stores the index of one corner's attribute; nothing is stored until the first corner that has one.
fn push_attribute(list: &mut Vec<u32>, index: u32, corner: usize) {
    if index != NONE {
        list.resize(corner, NONE);
        list.push(index);
    }
}

pub(super) fn words(line: &[u8]) -> impl Iterator<Item = &[u8]> {
    line.split(|b| b.is_ascii_whitespace()).filter(|w| !w.is_empty()).take_while(|w| w[0] != b'#')
}

/// The first `N` numbers of a line, at least `least`; what follows (weights, colours) is ignored.
fn floats<const N: usize>(rest: &[u8], least: usize, what: &str, parts: &str) -> Result<[f32; N], String> {
    let mut numbers = [0.0; N];
    let mut found = 0;
    for (number, word) in numbers.iter_mut().zip(words(rest)) {
        *number = parse_float(word).ok_or_else(|| format!("{what}: '{}' is not a number", quote(word)))?;
        if !number.is_finite() {
            return Err(format!("{what}: {} is not finite", quote(word)));
        }
        found += 1;
    }
    if found < least {
        return Err(format!("{what} has {found} {parts}, expected {N}"));
    }
    Ok(numbers)
}

pub(super) fn parse_float(word: &[u8]) -> Option<f32> {
    std::str::from_utf8(word).ok()?.parse().ok()
}

pub(super) fn parse_integer(word: &[u8]) -> Option<i64> {
    // Far below overflow: sums with counts are safe.
    std::str::from_utf8(word).ok()?.parse().ok().filter(|i: &i64| i.abs() < 1 << 40)
}

pub(super) fn quote(word: &[u8]) -> String {
    String::from_utf8_lossy(&word[..word.len().min(40)]).into_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn triangles(text: &str) -> TriangleMesh {
        let mesh = parse(text.as_bytes()).and_then(Obj::into_triangles).unwrap();
        mesh.validate().unwrap();
        mesh
    }

    #[test]
    fn corners_keep_their_own_streams() {
        let mesh = triangles(
            "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0 1.0\nvt .5 1\nvt 0.25\nvn 0 0 2\n\
             f 1/1/1 2/2/1 3//1 \\\n -1/1\nf 1 2 3\n",
        );
        assert_eq!(mesh.triangles, [[0, 1, 2], [0, 2, 3], [0, 1, 2]]);
        assert_eq!(mesh.corner_uvs[0], [[0.5, 1.0], [0.25, 0.0], [0.0, 0.0]]);
        assert_eq!(mesh.corner_uvs[1], [[0.5, 1.0], [0.0, 0.0], [0.5, 1.0]]);
        assert_eq!(mesh.corner_normals, [[[0.0, 0.0, 1.0]; 3]; 3]);
    }

    #[test]
    fn objects_and_groups_become_runs() {
        let mesh = triangles(
            "v 0 0 0\nv 1 0 0\nv 1 1 0\nf 1 2 3\no a\ng\ng part 1\nf 1 2 3\nf 1 2 3 # last\no empty\ng b\nf 3 2 1\n",
        );
        let objects: Vec<_> = mesh.objects.iter().map(|o| (&o.name[..], o.triangles.clone())).collect();
        assert_eq!(objects, [("", 0..1), ("part 1", 1..3), ("b", 3..4)]);
    }
}
