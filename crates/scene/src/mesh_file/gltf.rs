//! glTF and GLB: the triangles of the default scene, in world space.
//!
//! Read by the `gltf` crate. It trusts sizes, strides and types of accessors, so they are checked before it reads them.

use super::ContentError;
use gltf::accessor::{DataType, Dimensions};
use gltf::mesh::{Mode, Primitive};
use gltf::{Accessor, Document, Node, Semantic, buffer};
use std::path::Path;
use umbrage_geom::glam::{Affine3A, DMat4, Mat4};
use umbrage_geom::mesh::MAX_ELEMENTS;
use umbrage_geom::{MeshError, MeshObject, TriangleMesh};

/// Most values of an accessor that stores none of them (all zero but for sparse ones): nothing else bounds its size.
const MAX_IMPLICIT: usize = 1 << 24;

/// Deepest nesting of nodes.
const MAX_DEPTH: usize = 256;

/// Reads a document; `folder` is where its external buffers are.
pub(super) fn parse(bytes: &[u8], folder: Option<&Path>) -> Result<TriangleMesh, ContentError> {
    let (document, mut blob) = open(bytes)?;
    let buffers = document
        .buffers()
        .map(|buffer| read_buffer(&buffer, folder, &mut blob))
        .collect::<Result<Vec<_>, _>>()?;
    let mut reader = SceneReader {
        buffers,
        mesh: TriangleMesh::default(),
        visited: vec![false; document.nodes().count()],
    };
    let Some(scene) = document.default_scene().or_else(|| document.scenes().next()) else {
        return Err(ContentError::content(format!(
            "it has no scene ({} meshes)",
            document_meshes(&document)
        )));
    };
    for node in scene.nodes() {
        reader.node(&node, DMat4::IDENTITY, 0)?;
    }
    reader.mesh.validate()?;
    Ok(reader.mesh)
}

/// Parses and validates. The library's validation looks up the accessor of positions before it knows that it exists.
fn open(bytes: &[u8]) -> Result<(Document, Option<Vec<u8>>), ContentError> {
    let invalid = |error: gltf::Error| ContentError::content(format!("not valid glTF: {error}"));
    let gltf::Gltf { document, blob } = gltf::Gltf::from_slice_without_validation(bytes).map_err(invalid)?;
    let json = document.into_json();
    for (m, mesh) in json.meshes.iter().enumerate() {
        let indices = mesh.primitives.iter().flat_map(|p| p.attributes.values());
        if let Some(missing) = indices.map(|i| i.value()).find(|&i| i >= json.accessors.len()) {
            return Err(ContentError::content(format!("mesh {m}: there is no accessor {missing}")));
        }
    }
    Ok((Document::from_json(json).map_err(invalid)?, blob))
}

fn document_meshes(document: &Document) -> usize {
    document.meshes().count()
}

fn read_buffer(
    buffer: &buffer::Buffer<'_>,
    folder: Option<&Path>,
    blob: &mut Option<Vec<u8>>,
) -> Result<Vec<u8>, ContentError> {
    let index = buffer.index();
    let data = match buffer.source() {
        buffer::Source::Bin => {
            blob.take().ok_or_else(|| ContentError::content(format!("buffer {index} has no binary chunk")))?
        }
        buffer::Source::Uri(uri) if uri.starts_with("data:") => {
            buffer::Data::from_source(buffer.source(), None)
                .map_err(|e| ContentError::content(format!("buffer {index}: data URI: {e}")))?
                .0
        }
        buffer::Source::Uri(uri) => {
            let path = percent_decoded(uri).filter(|p| !p.contains("://")).ok_or_else(|| {
                ContentError::content(format!("buffer {index}: '{uri}' is not a relative path"))
            })?;
            let path = folder.unwrap_or(Path::new("")).join(path);
            std::fs::read(&path).map_err(|e| {
                ContentError::content(format!("buffer {index}: cannot read {}: {e}", path.display()))
            })?
        }
    };
    if data.len() < buffer.length() {
        return Err(ContentError::content(format!(
            "buffer {index} should have {} bytes, but has {}",
            buffer.length(),
            data.len()
        )));
    }
    Ok(data)
}

fn percent_decoded(uri: &str) -> Option<String> {
    let mut bytes = uri.bytes();
    let mut decoded = Vec::new();
    while let Some(byte) = bytes.next() {
        if byte == b'%' {
            let digit = |b: Option<u8>| (b? as char).to_digit(16);
            decoded.push((digit(bytes.next())? * 16 + digit(bytes.next())?) as u8);
        } else {
            decoded.push(byte);
        }
    }
    String::from_utf8(decoded).ok()
}

struct SceneReader {
    buffers: Vec<Vec<u8>>,
    mesh: TriangleMesh,
    visited: Vec<bool>,
}

impl SceneReader {
    fn node(&mut self, node: &Node<'_>, parent: DMat4, depth: usize) -> Result<(), ContentError> {
        // A tree, says the format; anything else could go round in circles.
        if std::mem::replace(&mut self.visited[node.index()], true) {
            return Err(ContentError::content(format!("node {} has more than one parent", node.index())));
        }
        if depth > MAX_DEPTH {
            return Err(ContentError::content(format!("nodes are nested more than {MAX_DEPTH} deep")));
        }
        let world = parent * Mat4::from_cols_array_2d(&node.transform().matrix()).as_dmat4();
        if let Some(mesh) = node.mesh() {
            let name =
                node.name().or(mesh.name()).map_or_else(|| format!("node{}", node.index()), String::from);
            for primitive in mesh.primitives() {
                let place = format!("mesh {} primitive {}", mesh.index(), primitive.index());
                self.primitive(&primitive, &name, world)
                    .map_err(|message| ContentError::content(format!("{place}: {message}")))?;
            }
        }
        node.children().try_for_each(|child| self.node(&child, world, depth + 1))
    }

    fn primitive(&mut self, primitive: &Primitive<'_>, name: &str, world: DMat4) -> Result<(), String> {
        if !matches!(primitive.mode(), Mode::Triangles | Mode::TriangleStrip | Mode::TriangleFan) {
            return Ok(());
        }
        let Some(positions) = primitive.get(&Semantic::Positions) else {
            return Err("it has no POSITION".into());
        };
        let f32s = [DataType::F32];
        self.check(&positions, "POSITION", Dimensions::Vec3, &f32s)?;
        let count = positions.count();
        let reader = primitive.reader(|buffer| self.buffers.get(buffer.index()).map(|data| &data[..]));
        let positions: Vec<[f32; 3]> = reader.read_positions().ok_or("POSITION has no data")?.collect();
        let normals: Option<Vec<[f32; 3]>> = match primitive.get(&Semantic::Normals) {
            None => None,
            Some(accessor) => {
                self.check_attribute(&accessor, "NORMAL", Dimensions::Vec3, &f32s, count)?;
                reader.read_normals().map(Iterator::collect)
            }
        };
        let uvs: Option<Vec<[f32; 2]>> = match primitive.get(&Semantic::TexCoords(0)) {
            None => None,
            Some(accessor) => {
                let types = [DataType::F32, DataType::U8, DataType::U16];
                self.check_attribute(&accessor, "TEXCOORD_0", Dimensions::Vec2, &types, count)?;
                reader.read_tex_coords(0).map(|uvs| uvs.into_f32().collect())
            }
        };
        let indices: Vec<u32> = match primitive.indices() {
            None => (0..u32::try_from(count).map_err(|_| "too many vertices")?).collect(),
            Some(accessor) => {
                self.check(
                    &accessor,
                    "indices",
                    Dimensions::Scalar,
                    &[DataType::U8, DataType::U16, DataType::U32],
                )?;
                reader.read_indices().ok_or("its indices have no data")?.into_u32().collect()
            }
        };
        if let Some(index) = indices.iter().find(|&&i| i as usize >= positions.len()) {
            return Err(format!("index {index} is past the end ({} vertices, from 0)", positions.len()));
        }
        self.push(positions, normals, uvs, &triangles(primitive.mode(), &indices), name, world)
    }

    fn push(
        &mut self,
        positions: Vec<[f32; 3]>,
        normals: Option<Vec<[f32; 3]>>,
        uvs: Option<Vec<[f32; 2]>>,
        triangles: &[[u32; 3]],
        name: &str,
        world: DMat4,
    ) -> Result<(), String> {
        if triangles.is_empty() {
            return Ok(());
        }
        for (what, have, add) in [
            ("vertices", self.mesh.positions.len(), positions.len()),
            ("triangles", self.mesh.triangles.len(), triangles.len()),
        ] {
            if have + add > MAX_ELEMENTS {
                return Err(MeshError::TooMany { what, count: have + add }.to_string());
            }
        }
        let mut part = TriangleMesh { positions, triangles: triangles.to_vec(), ..TriangleMesh::default() };
        part.objects =
            vec![MeshObject { name: name.into(), triangles: 0..triangles.len() as u32, opacity: 1.0 }];
        part.validate().map_err(|e| e.to_string())?;
        if let Some(normals) = normals {
            part.corner_normals = (0..part.triangles.len())
                .map(|i| {
                    let positions = part.triangle(i);
                    part.triangles[i].map(|v| super::normal_or_geometric(normals[v as usize], positions))
                })
                .collect();
        }
        if let Some(uvs) = uvs {
            part.corner_uvs = part.triangles.iter().map(|t| t.map(|v| uvs[v as usize])).collect();
        }
        let world = world.as_mat4();
        if world != Mat4::IDENTITY {
            part.transform(&Affine3A::from_mat4(world));
            part.validate().map_err(|e| format!("after the transforms of its nodes, {e}"))?;
        }
        self.mesh.append(&part);
        Ok(())
    }

    fn check_attribute(
        &self,
        accessor: &Accessor<'_>,
        what: &str,
        dimensions: Dimensions,
        types: &[DataType],
        count: usize,
    ) -> Result<(), String> {
        self.check(accessor, what, dimensions, types)?;
        if accessor.count() < count {
            return Err(format!("{what} has {} values for {count} vertices", accessor.count()));
        }
        Ok(())
    }

    /// Everything that the library's iterators take for granted.
    fn check(
        &self,
        accessor: &Accessor<'_>,
        what: &str,
        dimensions: Dimensions,
        types: &[DataType],
    ) -> Result<(), String> {
        if accessor.dimensions() != dimensions || !types.contains(&accessor.data_type()) {
            let (has, a) = (accessor.dimensions(), accessor.data_type());
            return Err(format!("{what} is {has:?} of {a:?}, expected {dimensions:?} of {types:?}"));
        }
        let (size, count) = (accessor.size(), accessor.count());
        if count == 0 {
            return Err(format!("{what} is empty"));
        }
        match accessor.view() {
            Some(view) => self.check_range(&view, accessor.offset(), size, count, what)?,
            None if accessor.sparse().is_none() => return Err(format!("{what} has no data")),
            None if count > MAX_IMPLICIT => return Err(format!("{what} has {count} values without data")),
            None => {}
        }
        if let Some(sparse) = accessor.sparse() {
            if sparse.count() == 0 || sparse.count() > count {
                return Err(format!("{what} replaces {} of {count} values", sparse.count()));
            }
            let (indices, values) = (sparse.indices(), sparse.values());
            let index_size = indices.index_type().size();
            self.check_range(&indices.view(), indices.offset(), index_size, sparse.count(), what)?;
            self.check_range(&values.view(), values.offset(), size, sparse.count(), what)?;
        }
        Ok(())
    }

    /// That `count` values of `size` bytes from `offset` on lie inside the view, and the view inside its buffer.
    fn check_range(
        &self,
        view: &buffer::View<'_>,
        offset: usize,
        size: usize,
        count: usize,
        what: &str,
    ) -> Result<(), String> {
        let stride = view.stride().unwrap_or(size);
        let buffer = self.buffers.get(view.buffer().index()).map_or(0, Vec::len);
        let end = (count - 1)
            .checked_mul(stride)
            .and_then(|bytes| bytes.checked_add(offset)?.checked_add(size))
            .filter(|&end| end <= view.length());
        let view_end = view.offset().checked_add(view.length()).filter(|&end| end <= buffer);
        if stride < size || end.is_none() || view_end.is_none() {
            return Err(format!("{what} reaches past the end of its buffer"));
        }
        Ok(())
    }
}

fn triangles(mode: Mode, indices: &[u32]) -> Vec<[u32; 3]> {
    match mode {
        Mode::TriangleStrip => indices
            .windows(3)
            .enumerate()
            .map(|(i, w)| if i % 2 == 0 { [w[0], w[1], w[2]] } else { [w[1], w[0], w[2]] })
            .collect(),
        Mode::TriangleFan => indices.windows(2).skip(1).map(|w| [indices[0], w[0], w[1]]).collect(),
        _ => indices.chunks_exact(3).map(|c| [c[0], c[1], c[2]]).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn strips_alternate_and_fans_share_their_first_vertex() {
        assert_eq!(triangles(Mode::TriangleStrip, &[0, 1, 2, 3]), [[0, 1, 2], [2, 1, 3]]);
        assert_eq!(triangles(Mode::TriangleFan, &[7, 1, 2, 3]), [[7, 1, 2], [7, 2, 3]]);
        assert_eq!(triangles(Mode::Triangles, &[0, 1, 2, 3]), [[0, 1, 2]]);
    }

    #[test]
    fn paths_are_decoded() {
        assert_eq!(percent_decoded("a%20b.bin").as_deref(), Some("a b.bin"));
        assert_eq!(percent_decoded("%ff"), None);
        assert_eq!(percent_decoded("%2"), None);
    }
}
