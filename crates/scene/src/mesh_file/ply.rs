//! PLY: ascii, little and big endian.
//!
//! The header is read by `ply-rs-bw`. The payload is read here: straight into our arrays, with errors that name the
//! element, and checked against the size of the file before anything is allocated.

use super::{ContentError, PlyVertices, PointCloud};
use ply_rs_bw::parser::{ParseError, Parser, Reader};
use ply_rs_bw::ply::{DefaultElement, ElementDef, Encoding, PropertyType, ScalarType};
use umbrage_geom::TriangleMesh;

/// What a property of a vertex means to us, by its usual names.
const VERTEX_SLOTS: [&[&str]; SLOTS] = [
    &["x"],
    &["y"],
    &["z"],
    &["nx"],
    &["ny"],
    &["nz"],
    &["s", "u", "texture_u", "texture_s"],
    &["t", "v", "texture_v", "texture_t"],
    &["red", "diffuse_red"],
    &["green", "diffuse_green"],
    &["blue", "diffuse_blue"],
    &["ao"],
];
const SLOTS: usize = 12;
const COLOR: std::ops::Range<usize> = 8..11;
const AO: usize = 11;

/// What a list of a face means to us.
const INDEX_NAMES: [&str; 2] = ["vertex_indices", "vertex_index"];
const FACE_UV_NAME: &str = "texcoord";

#[derive(Default)]
struct Vertices {
    /// Values of the slots, in their order.
    values: Vec<[f64; SLOTS]>,
    /// Which slots the file has.
    has: [bool; SLOTS],
}

#[derive(Default)]
struct Faces {
    triangles: Vec<[u32; 3]>,
    /// Texture coordinates of faces that bring their own; empty, or as long as `triangles`.
    corner_uvs: Vec<[[f32; 2]; 3]>,
}

#[derive(Default)]
struct Contents {
    vertices: Vertices,
    faces: Option<Faces>,
    comments: Vec<String>,
}

/// Reads vertices and faces.
pub(super) fn parse_mesh(bytes: &[u8]) -> Result<TriangleMesh, ContentError> {
    let Contents { vertices, faces, .. } = parse(bytes)?;
    let faces =
        faces.ok_or_else(|| ContentError::content("it has no element 'face' (is it a point cloud?)"))?;
    let positions = vertices.positions()?;
    let mut mesh = TriangleMesh { positions, triangles: faces.triangles, ..TriangleMesh::default() };
    // Before corners are looked up.
    mesh.validate()?;
    if vertices.has_all(3..6) {
        let normals = vertices.column::<3>(3);
        mesh.corner_normals = (0..mesh.triangles.len())
            .map(|i| {
                let positions = mesh.triangle(i);
                mesh.triangles[i].map(|v| super::normal_or_geometric(normals[v as usize], positions))
            })
            .collect();
    }
    if !faces.corner_uvs.is_empty() {
        mesh.corner_uvs = faces.corner_uvs;
    } else if vertices.has_all(6..8) {
        let uvs = vertices.column::<2>(6);
        mesh.corner_uvs = mesh.triangles.iter().map(|t| t.map(|v| uvs[v as usize])).collect();
    }
    if vertices.has_all(COLOR) {
        mesh.vertex_colors = vertices.column::<3>(COLOR.start);
    }
    Ok(mesh)
}

/// Reads vertices as they are, with comments, normals and `ao`.
pub(super) fn parse_vertices(bytes: &[u8]) -> Result<PlyVertices, ContentError> {
    let Contents { vertices, faces, comments } = parse(bytes)?;
    let positions = vertices.positions()?;
    let faces = faces.unwrap_or_default();
    if let Some(&v) = faces.triangles.iter().flatten().find(|&&v| v as usize >= positions.len()) {
        return Err(ContentError::content(format!(
            "a face uses vertex {v}, but there are only {}",
            positions.len()
        )));
    }
    Ok(PlyVertices {
        normals: if vertices.has_all(3..6) { vertices.column::<3>(3) } else { Vec::new() },
        ao: if vertices.has[AO] {
            vertices.values.iter().map(|v| v[AO] as f32).collect()
        } else {
            Vec::new()
        },
        positions,
        triangles: faces.triangles,
        corner_uvs: faces.corner_uvs,
        comments,
    })
}

/// Reads vertices with normals.
pub(super) fn parse_points(bytes: &[u8]) -> Result<PointCloud, ContentError> {
    let vertices = parse(bytes)?.vertices;
    let positions = vertices.positions()?;
    if positions.is_empty() {
        return Err(ContentError::content("it has no points"));
    }
    umbrage_geom::mesh::validate_positions(&positions)?;
    if !vertices.has_all(3..6) {
        return Err(ContentError::content("its points have no normals (properties nx, ny and nz)"));
    }
    let mut normals = vertices.column::<3>(3);
    for (i, normal) in normals.iter_mut().enumerate() {
        let unit = umbrage_geom::glam::Vec3::from(*normal).as_dvec3().normalize_or_zero();
        if unit == umbrage_geom::glam::DVec3::ZERO {
            let [x, y, z] = *normal;
            return Err(ContentError::content(format!(
                "the normal of point {i} has no length: ({x}, {y}, {z})"
            )));
        }
        *normal = unit.as_vec3().to_array();
    }
    Ok(PointCloud { positions, normals })
}

impl Vertices {
    fn positions(&self) -> Result<Vec<[f32; 3]>, ContentError> {
        if !self.has_all(0..3) {
            return Err(ContentError::content("it has no element 'vertex' with x, y and z"));
        }
        let positions = self.column::<3>(0);
        umbrage_geom::mesh::validate_positions(&positions)?;
        Ok(positions)
    }

    fn has_all(&self, slots: std::ops::Range<usize>) -> bool {
        self.has[slots].iter().all(|&h| h)
    }

    fn column<const N: usize>(&self, first: usize) -> Vec<[f32; N]> {
        self.values.iter().map(|v| std::array::from_fn(|i| v[first + i] as f32)).collect()
    }
}

fn parse(bytes: &[u8]) -> Result<Contents, ContentError> {
    if !bytes.starts_with(b"ply\n") && !bytes.starts_with(b"ply\r") && !bytes.starts_with(b"ply ") {
        return Err(ContentError::Line(1, "it does not start with 'ply'".into()));
    }
    let mut reader = Reader::new(bytes);
    let header =
        Parser::<DefaultElement>::new().read_header(&mut reader).map_err(|e| header_flaw(&e, bytes))?;
    let line = reader.line();
    let mut source = Source { rest: reader.into_inner(), encoding: header.encoding, line, words: &[] };
    let mut contents = Contents { comments: header.comments.clone(), ..Contents::default() };
    for (name, element) in &header.elements {
        source.check_count(element)?;
        match &name[..] {
            "vertex" => contents.vertices = read_vertices(&mut source, element)?,
            "face" => contents.faces = Some(read_faces(&mut source, element)?),
            _ => {
                for i in 0..if element.properties.is_empty() { 0 } else { element.count } {
                    source.begin(element, i)?;
                    for (_, property) in &element.properties {
                        source
                            .property(&property.data_type, |_| ())
                            .map_err(|m| source.flaw(element, i, m))?;
                    }
                    source.end(element, i)?;
                }
            }
        }
    }
    Ok(contents)
}

/// The library's message has several lines and holds the state of its parser.
fn header_flaw(error: &ParseError, bytes: &[u8]) -> ContentError {
    let Some(line) = error.line() else { return ContentError::content(format!("PLY header: {error}")) };
    let message = error.to_string();
    let message = message.strip_prefix(&format!("Line {line}: ")).unwrap_or(&message);
    let text = bytes.split(|&b| b == b'\n').nth(line.saturating_sub(1)).unwrap_or_default();
    let text = String::from_utf8_lossy(&text[..text.len().min(80)]);
    let message = if message.starts_with("Couldn't parse line") {
        format!("PLY header: '{}' is not a header line", text.trim())
    } else {
        format!("PLY header: {}", message.split('\n').next().unwrap_or_default().trim_end_matches(['.', ' ']))
    };
    ContentError::Line(line, message)
}

fn read_vertices(source: &mut Source<'_>, element: &ElementDef) -> Result<Vertices, ContentError> {
    let mut vertices = Vertices::default();
    let slots: Vec<Option<usize>> = element
        .properties
        .iter()
        .map(|(name, property)| {
            VERTEX_SLOTS
                .iter()
                .position(|names| names.contains(&&name[..]))
                .filter(|_| matches!(property.data_type, PropertyType::Scalar(_)))
        })
        .collect();
    for &slot in slots.iter().flatten() {
        vertices.has[slot] = true;
    }
    if slots.is_empty() {
        return Ok(vertices);
    }
    vertices.values.reserve_exact(element.count);
    for i in 0..element.count {
        source.begin(element, i)?;
        let mut values = [0.0; SLOTS];
        for ((name, property), slot) in element.properties.iter().zip(&slots) {
            let mut last = 0.0;
            source.property(&property.data_type, |v| last = v).map_err(|m| source.flaw(element, i, m))?;
            if let Some(slot) = *slot {
                if !(last as f32).is_finite() {
                    return Err(source.flaw(element, i, format!("{name} is {last:?}, not a finite number")));
                }
                values[slot] = match &property.data_type {
                    PropertyType::Scalar(ScalarType::UChar) if COLOR.contains(&slot) => last / 255.0,
                    _ => last,
                };
            }
        }
        source.end(element, i)?;
        vertices.values.push(values);
    }
    Ok(vertices)
}

fn read_faces(source: &mut Source<'_>, element: &ElementDef) -> Result<Faces, ContentError> {
    let mut faces = Faces::default();
    let kind = |name: &str, property: &PropertyType| match property {
        PropertyType::List(_, ScalarType::Float | ScalarType::Double) => name == FACE_UV_NAME,
        PropertyType::List(..) => INDEX_NAMES.contains(&name),
        PropertyType::Scalar(_) => false,
    };
    let mut has_indices = false;
    for (name, property) in &element.properties {
        let wanted = kind(name, &property.data_type);
        has_indices |= wanted && name != FACE_UV_NAME;
    }
    if !has_indices && element.count > 0 {
        return Err(ContentError::content(
            "element 'face' has no list of integers 'vertex_indices' or 'vertex_index'",
        ));
    }
    let (mut indices, mut uvs) = (Vec::new(), Vec::<f32>::new());
    for i in 0..element.count {
        source.begin(element, i)?;
        indices.clear();
        uvs.clear();
        for (name, property) in &element.properties {
            let is_uv = name == FACE_UV_NAME;
            let wanted = kind(name, &property.data_type);
            let result = source.property(&property.data_type, |v| match (wanted, is_uv) {
                (true, true) => uvs.push(v as f32),
                (true, false) => indices.push(v),
                _ => {}
            });
            result.map_err(|m| source.flaw(element, i, m))?;
        }
        source.end(element, i)?;
        if indices.len() < 3 {
            return Err(source.flaw(element, i, format!("{} corners, expected at least 3", indices.len())));
        }
        if let Some(bad) = indices.iter().find(|&&v| !(0.0..u32::MAX as f64).contains(&v)) {
            return Err(source.flaw(element, i, format!("{bad} is not a vertex")));
        }
        let first = faces.triangles.len();
        let corner = |c: usize| indices[c] as u32;
        faces.triangles.extend((2..indices.len()).map(|c| [corner(0), corner(c - 1), corner(c)]));
        if uvs.len() == 2 * indices.len() && uvs.iter().all(|x| x.is_finite()) {
            faces.corner_uvs.resize(first, [[0.0; 2]; 3]);
            let uv = |c: usize| [uvs[2 * c], uvs[2 * c + 1]];
            faces.corner_uvs.extend((2..indices.len()).map(|c| [uv(0), uv(c - 1), uv(c)]));
        }
    }
    if !faces.corner_uvs.is_empty() {
        faces.corner_uvs.resize(faces.triangles.len(), [[0.0; 2]; 3]);
    }
    Ok(faces)
}

/// The payload that is left to read.
struct Source<'a> {
    rest: &'a [u8],
    encoding: Encoding,
    /// Of ascii.
    line: usize,
    /// What is left of the line of ascii.
    words: &'a [u8],
}

impl<'a> Source<'a> {
    /// Refuses an element that can't fit into the rest of the file.
    fn check_count(&self, element: &ElementDef) -> Result<(), ContentError> {
        let least: usize = element.properties.iter().map(|(_, p)| self.least_size(&p.data_type)).sum();
        let bytes = element.count as u128 * least as u128;
        // The line end after the last line may be missing.
        if bytes > self.rest.len() as u128 + 1 {
            return Err(ContentError::content(format!(
                "the header promises {} elements '{}', at least {bytes} bytes, but only {} follow",
                element.count,
                element.name,
                self.rest.len()
            )));
        }
        Ok(())
    }

    fn least_size(&self, property: &PropertyType) -> usize {
        match (self.encoding, property) {
            // A digit and a separator.
            (Encoding::Ascii, _) => 2,
            (_, PropertyType::Scalar(scalar) | PropertyType::List(scalar, _)) => size(scalar),
        }
    }

    fn flaw(&self, element: &ElementDef, index: usize, message: String) -> ContentError {
        let message = format!("{} {index}: {message}", element.name);
        if self.encoding == Encoding::Ascii {
            ContentError::Line(self.line.saturating_sub(1), message)
        } else {
            ContentError::Content(message)
        }
    }

    /// Goes to the next line of ascii that isn't blank.
    fn begin(&mut self, element: &ElementDef, index: usize) -> Result<(), ContentError> {
        if self.encoding != Encoding::Ascii {
            return Ok(());
        }
        while self.words.is_empty() {
            if self.rest.is_empty() {
                return Err(ContentError::content(format!(
                    "it ends after {index} of {} elements '{}'",
                    element.count, element.name
                )));
            }
            let end = self.rest.iter().position(|&b| b == b'\n').unwrap_or(self.rest.len());
            self.words = self.rest[..end].trim_ascii();
            self.rest = self.rest.get(end + 1..).unwrap_or_default();
            self.line += 1;
        }
        Ok(())
    }

    fn end(&mut self, element: &ElementDef, index: usize) -> Result<(), ContentError> {
        if self.words.is_empty() {
            return Ok(());
        }
        let surplus = String::from_utf8_lossy(self.words).into_owned();
        Err(self.flaw(element, index, format!("surplus '{surplus}' at the end of the line")))
    }

    /// Hands the values of one property to `sink`.
    fn property(&mut self, property: &PropertyType, mut sink: impl FnMut(f64)) -> Result<(), String> {
        match property {
            PropertyType::Scalar(scalar) => sink(self.scalar(scalar)?),
            PropertyType::List(count_type, scalar) => {
                let count = self.scalar(count_type)?;
                if count < 0.0 || count.fract() != 0.0 {
                    return Err(format!("a list of {count} values"));
                }
                // Bounded by the size of the file, since every value must be there.
                for _ in 0..count as u64 {
                    sink(self.scalar(scalar)?);
                }
            }
        }
        Ok(())
    }

    fn scalar(&mut self, scalar: &ScalarType) -> Result<f64, String> {
        if self.encoding == Encoding::Ascii {
            return self.word(scalar);
        }
        let Some((bytes, rest)) = self.rest.split_at_checked(size(scalar)) else {
            return Err("the file ends here".into());
        };
        self.rest = rest;
        let mut raw = [0; 8];
        raw[..bytes.len()].copy_from_slice(bytes);
        if self.encoding == Encoding::BinaryBigEndian {
            raw[..bytes.len()].reverse();
        }
        let [a, b, c, d, ..] = raw;
        Ok(match scalar {
            ScalarType::Char => f64::from(a as i8),
            ScalarType::UChar => f64::from(a),
            ScalarType::Short => f64::from(i16::from_le_bytes([a, b])),
            ScalarType::UShort => f64::from(u16::from_le_bytes([a, b])),
            ScalarType::Int => f64::from(i32::from_le_bytes([a, b, c, d])),
            ScalarType::UInt => f64::from(u32::from_le_bytes([a, b, c, d])),
            ScalarType::Float => f64::from(f32::from_le_bytes([a, b, c, d])),
            ScalarType::Double => f64::from_le_bytes(raw),
        })
    }

    fn word(&mut self, scalar: &ScalarType) -> Result<f64, String> {
        if self.words.is_empty() {
            return Err("the line has too few values".into());
        }
        let end = self.words.iter().position(u8::is_ascii_whitespace).unwrap_or(self.words.len());
        let (word, rest) = self.words.split_at(end);
        self.words = rest.trim_ascii_start();
        let text = std::str::from_utf8(word).ok();
        let integer = !matches!(scalar, ScalarType::Float | ScalarType::Double);
        let value = if integer {
            // Some writers put real numbers where the header says integer; whole ones are fine.
            text.and_then(|t| t.parse::<f64>().ok()).filter(|v| v.fract() == 0.0)
        } else if *scalar == ScalarType::Float {
            // Rounded once, not first to double.
            text.and_then(|t| t.parse::<f32>().ok()).map(f64::from)
        } else {
            text.and_then(|t| t.parse::<f64>().ok())
        };
        value.ok_or_else(|| {
            let kind = if integer { "an integer" } else { "a number" };
            format!("'{}' is not {kind}", String::from_utf8_lossy(&word[..word.len().min(40)]))
        })
    }
}

fn size(scalar: &ScalarType) -> usize {
    match scalar {
        ScalarType::Char | ScalarType::UChar => 1,
        ScalarType::Short | ScalarType::UShort => 2,
        ScalarType::Int | ScalarType::UInt | ScalarType::Float => 4,
        ScalarType::Double => 8,
    }
}
