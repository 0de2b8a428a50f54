//! Meshes with vertex attributes to PLY and OBJ.

use crate::atomic::{WriteError, write_atomically};
use std::io::{self, Write};
use std::path::Path;
use umbrage_geom::{MeshError, TriangleMesh};

/// What a written mesh carries besides its shape; every slice has one entry a vertex.
#[derive(Clone, Copy, Debug, Default)]
pub struct VertexAttributes<'a> {
    /// Unit normals; PLY only, as `nx`, `ny`, `nz`.
    pub normals: Option<&'a [[f32; 3]]>,
    /// Colours, 8 bits a channel, as `red`, `green`, `blue`.
    pub colors: Option<&'a [[u8; 3]]>,
    /// Named numbers, such as `ao` (1 is open, 0 fully occluded), `bent_x`.
    pub scalars: &'a [(&'a str, &'a [f32])],
    /// Lines of comment for the header.
    pub comments: &'a [&'a str],
}

/// Why a mesh could not be written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum WriteMeshError {
    /// The mesh itself can't be used.
    #[error("{0}")]
    Mesh(#[from] MeshError),
    /// An attribute has not one entry a vertex.
    #[error("vertex attribute '{name}' has {count} entries for {vertices} vertices")]
    Length {
        /// The attribute.
        name: String,
        /// Its entries.
        count: usize,
        /// Vertices of the mesh.
        vertices: usize,
    },
    /// A name that is empty, taken, or not made of ASCII letters, digits and `_`.
    #[error("'{0}' can't name a vertex attribute")]
    Name(String),
    /// The file could not be written.
    #[error("{0}")]
    Write(#[from] WriteError),
}

/// Names that PLY properties of a vertex have already.
const RESERVED_PROPERTIES: [&str; 9] = ["x", "y", "z", "nx", "ny", "nz", "red", "green", "blue"];

/// Writes a binary little-endian PLY: `x y z`, `nx ny nz`, `red green blue`, then the scalars as `float`; triangles as
/// `vertex_indices`, with a list `texcoord` where the mesh has texture coordinates.
///
/// The file appears whole or not at all.
///
/// # Errors
/// [`WriteMeshError`].
pub fn write_ply(
    path: &Path,
    mesh: &TriangleMesh,
    attributes: &VertexAttributes<'_>,
) -> Result<(), WriteMeshError> {
    check(mesh, attributes)?;
    write_ply_unchecked(path, mesh, attributes)
}

/// Like [`write_ply`], of points without faces.
///
/// # Errors
/// [`WriteMeshError`].
pub fn write_ply_points(
    path: &Path,
    positions: &[[f32; 3]],
    attributes: &VertexAttributes<'_>,
) -> Result<(), WriteMeshError> {
    umbrage_geom::mesh::validate_positions(positions)?;
    let points = TriangleMesh { positions: positions.to_vec(), ..TriangleMesh::default() };
    check_attributes(&points, attributes)?;
    write_ply_unchecked(path, &points, attributes)
}

fn write_ply_unchecked(
    path: &Path,
    mesh: &TriangleMesh,
    attributes: &VertexAttributes<'_>,
) -> Result<(), WriteMeshError> {
    write_atomically(path, |w| {
        ply_header(w, mesh, attributes)?;
        for (i, position) in mesh.positions.iter().enumerate() {
            write_floats(w, position)?;
            if let Some(normals) = attributes.normals {
                write_floats(w, &normals[i])?;
            }
            if let Some(colors) = attributes.colors {
                w.write_all(&colors[i])?;
            }
            for (_, values) in attributes.scalars {
                write_floats(w, &values[i..=i])?;
            }
        }
        for (i, triangle) in mesh.triangles.iter().enumerate() {
            w.write_all(&[3])?;
            for v in triangle {
                w.write_all(&v.to_le_bytes())?;
            }
            if let Some(uvs) = mesh.corner_uvs.get(i) {
                w.write_all(&[6])?;
                write_floats(w, uvs.as_flattened())?;
            }
        }
        Ok(())
    })?;
    Ok(())
}

fn ply_header(w: &mut impl Write, mesh: &TriangleMesh, attributes: &VertexAttributes<'_>) -> io::Result<()> {
    writeln!(w, "ply\nformat binary_little_endian 1.0")?;
    for comment in attributes.comments.iter().flat_map(|c| c.lines()) {
        writeln!(w, "comment {comment}")?;
    }
    writeln!(w, "element vertex {}", mesh.positions.len())?;
    for name in ["x", "y", "z"].into_iter().chain(attributes.normals.iter().flat_map(|_| ["nx", "ny", "nz"]))
    {
        writeln!(w, "property float {name}")?;
    }
    for name in attributes.colors.iter().flat_map(|_| ["red", "green", "blue"]) {
        writeln!(w, "property uchar {name}")?;
    }
    for (name, _) in attributes.scalars {
        writeln!(w, "property float {name}")?;
    }
    if !mesh.triangles.is_empty() {
        // `uint` and not `int`, so that every index fits.
        writeln!(w, "element face {}\nproperty list uchar uint vertex_indices", mesh.triangles.len())?;
    }
    if !mesh.corner_uvs.is_empty() {
        writeln!(w, "property list uchar float texcoord")?;
    }
    writeln!(w, "end_header")
}

fn write_floats(w: &mut impl Write, values: &[f32]) -> io::Result<()> {
    values.iter().try_for_each(|v| w.write_all(&v.to_le_bytes()))
}

/// Writes an OBJ: `v x y z r g b` with colours in `[0, 1]`, objects as `o`, texture coordinates as `vt`.
///
/// OBJ has no place for other numbers, so each scalar follows the vertices in comments: `# umbrage attribute NAME COUNT`
/// and then one line `#a VALUE` a vertex, in their order. Normals are not written. The file appears whole or not at all.
///
/// # Errors
/// [`WriteMeshError`].
pub fn write_obj(
    path: &Path,
    mesh: &TriangleMesh,
    attributes: &VertexAttributes<'_>,
) -> Result<(), WriteMeshError> {
    check(mesh, attributes)?;
    write_atomically(path, |w| {
        for comment in attributes.comments.iter().flat_map(|c| c.lines()) {
            writeln!(w, "# {comment}")?;
        }
        for (i, [x, y, z]) in mesh.positions.iter().enumerate() {
            write!(w, "v {x} {y} {z}")?;
            if let Some(colors) = attributes.colors {
                let [r, g, b] = colors[i].map(|c| f32::from(c) / 255.0);
                write!(w, " {r} {g} {b}")?;
            }
            writeln!(w)?;
        }
        for (name, values) in attributes.scalars {
            writeln!(w, "# umbrage attribute {name} {}", values.len())?;
            values.iter().try_for_each(|v| writeln!(w, "#a {v}"))?;
        }
        for [u, v] in mesh.corner_uvs.as_flattened() {
            writeln!(w, "vt {u} {v}")?;
        }
        for object in mesh.objects_or_whole() {
            // Line ends in a name would start a statement.
            let name = super::one_line(&object.name);
            if !name.is_empty() || mesh.objects.len() > 1 {
                writeln!(w, "o {name}")?;
            }
            for t in object.triangles {
                let corners = mesh.triangles[t as usize].map(|v| v as u64 + 1);
                if mesh.corner_uvs.is_empty() {
                    writeln!(w, "f {} {} {}", corners[0], corners[1], corners[2])?;
                } else {
                    let uv = 3 * t as u64 + 1;
                    let [a, b, c] = corners;
                    writeln!(w, "f {a}/{uv} {b}/{} {c}/{}", uv + 1, uv + 2)?;
                }
            }
        }
        Ok(())
    })?;
    Ok(())
}

fn check(mesh: &TriangleMesh, attributes: &VertexAttributes<'_>) -> Result<(), WriteMeshError> {
    mesh.validate()?;
    check_attributes(mesh, attributes)
}

fn check_attributes(mesh: &TriangleMesh, attributes: &VertexAttributes<'_>) -> Result<(), WriteMeshError> {
    let vertices = mesh.positions.len();
    let mut names: Vec<&str> = RESERVED_PROPERTIES.to_vec();
    for &(name, _) in attributes.scalars {
        let letters = name.bytes().all(|b| b.is_ascii_alphanumeric() || b == b'_');
        if !letters || name.is_empty() || name.as_bytes()[0].is_ascii_digit() || names.contains(&name) {
            return Err(WriteMeshError::Name(name.into()));
        }
        names.push(name);
    }
    let counts = attributes.scalars.iter().map(|&(name, values)| (name, values.len()));
    let normals = attributes.normals.map(|n| ("normals", n.len()));
    let colors = attributes.colors.map(|c| ("colors", c.len()));
    match counts.chain(normals).chain(colors).find(|&(_, count)| count != vertices) {
        Some((name, count)) => Err(WriteMeshError::Length { name: name.into(), count, vertices }),
        None => Ok(()),
    }
}
