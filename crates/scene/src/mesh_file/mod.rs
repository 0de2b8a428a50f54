//! Meshes and points from files, and meshes to files.
//!
//! Here: the choice of format and the errors. Not here: the formats (`obj.rs` with `tags.rs`, `ply.rs`, `gltf.rs`, `write.rs`).

mod gltf;
mod obj;
mod ply;
mod tags;
mod write;

pub use write::{VertexAttributes, WriteMeshError, write_obj, write_ply, write_ply_points};

use std::path::{Path, PathBuf};
use std::{fs, io};
use umbrage_geom::{MeshError, PolygonMesh, TriangleMesh};

/// Points to bake at.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PointCloud {
    /// Where, world units.
    pub positions: Vec<[f32; 3]>,
    /// One unit normal a point.
    pub normals: Vec<[f32; 3]>,
}

/// Why a mesh file can't be used. The text is one line and names the file.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum MeshFileError {
    /// The file could not be read.
    #[error("{}: cannot read it: {source}", .path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// What the system says.
        source: io::Error,
    },
    /// The path is a folder.
    #[error("{}: it is a folder, not a mesh file", .path.display())]
    Folder {
        /// The folder.
        path: PathBuf,
    },
    /// The name does not end as those of the formats that can be read.
    #[error("{}: unknown extension, expected {expected}", .path.display())]
    Extension {
        /// The file.
        path: PathBuf,
        /// The extensions that would do.
        expected: &'static str,
    },
    /// A line is wrong.
    #[error("{}:{line}: {message}", .path.display())]
    Line {
        /// The file.
        path: PathBuf,
        /// Number of the line, from 1.
        line: usize,
        /// What is wrong.
        message: String,
    },
    /// The contents are wrong at no particular line.
    #[error("{}: {message}", .path.display())]
    Content {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        message: String,
    },
    /// The file could be read, but the mesh can't be used.
    #[error("{}: {source}", .path.display())]
    Mesh {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        source: MeshError,
    },
}

/// What is wrong with the contents of a file, before it is known which file.
#[derive(Debug)]
pub(crate) enum ContentError {
    Line(usize, String),
    Content(String),
    Mesh(MeshError),
}

impl ContentError {
    fn content(message: impl Into<String>) -> Self {
        Self::Content(message.into())
    }

    fn at(self, path: &Path) -> MeshFileError {
        let path = path.to_path_buf();
        match self {
            Self::Line(line, message) => MeshFileError::Line { path, line, message: one_line(&message) },
            Self::Content(message) => MeshFileError::Content { path, message: one_line(&message) },
            Self::Mesh(source) => MeshFileError::Mesh { path, source },
        }
    }
}

impl From<MeshError> for ContentError {
    fn from(error: MeshError) -> Self {
        Self::Mesh(error)
    }
}

/// Reads a mesh: OBJ, PLY, glTF or GLB by the name's extension.
///
/// - OBJ: `v`, `vn`, `vt`, `f`; polygons become fans; `o` and `g` name objects, in order. Other statements are ignored.
/// - PLY: ascii and both binary forms; `vertex` with `x y z`, optionally `nx ny nz` and `s t`, `u v` or
///   `texture_u texture_v`; `face` with a list `vertex_indices` or `vertex_index`, optionally a list `texcoord`.
/// - glTF and GLB: triangles, strips and fans of the default scene, in world space; one object a primitive.
///
/// Vertices keep the order and the indices of the file. The mesh is validated.
///
/// # Errors
/// [`MeshFileError`], which names the file and, for text, the line.
pub fn read_mesh(path: &Path) -> Result<TriangleMesh, MeshFileError> {
    let expected = ".obj, .ply, .gltf or .glb";
    let extension = known_extension(path, &["obj", "ply", "gltf", "glb"], expected)?;
    let bytes = read_file(path)?;
    let mesh = match extension {
        "obj" => obj::parse(&bytes).and_then(|obj| obj.into_triangles()),
        "ply" => ply::parse_mesh(&bytes),
        _ => gltf::parse(&bytes, path.parent()),
    };
    mesh.and_then(|mesh| {
        mesh.validate()?;
        Ok(mesh)
    })
    .map_err(|flaw| flaw.at(path))
}

/// Reads an OBJ file with its polygons and the tags that subdivision needs, `t` statements or `#t` comments, as OpenSubdiv's
/// regression shapes have them:
///
/// - `t crease 2/1/0 a b s`: the edge between two vertices, counted from 0, has sharpness `s`; longer, a chain of vertices
///   with one sharpness for all edges or one for each;
/// - `t corner 1/1/0 v s`: sharpness of a vertex, or of several;
/// - `t interpolateboundary 1/0/0 n`: 1 is [`BoundaryRule::EdgeAndCorner`](umbrage_geom::BoundaryRule::EdgeAndCorner), 2 is
///   `EdgeOnly`, as without the tag; 0 is accepted for meshes without a boundary;
/// - `t creasemethod 0/0/1 normal` or `chaikin`: [`CreaseMethod`](umbrage_geom::CreaseMethod).
///
/// # Errors
/// [`MeshFileError`], also for tags and values of tags that are not implemented.
pub fn read_polygons(path: &Path) -> Result<PolygonMesh, MeshFileError> {
    known_extension(path, &["obj"], ".obj")?;
    let bytes = read_file(path)?;
    obj::parse(&bytes).and_then(|obj| obj.into_polygons()).map_err(|flaw| flaw.at(path))
}

/// Reads points and normals from the `vertex` element of a PLY file.
///
/// # Errors
/// [`MeshFileError`], also if there is no point, no normal (`nx ny nz`), or a normal without length.
pub fn read_points(path: &Path) -> Result<PointCloud, MeshFileError> {
    known_extension(path, &["ply"], ".ply")?;
    let bytes = read_file(path)?;
    ply::parse_points(&bytes).map_err(|flaw| flaw.at(path))
}

/// What a PLY says of its vertices, whether or not it has faces.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PlyVertices {
    /// `x`, `y`, `z`.
    pub positions: Vec<[f32; 3]>,
    /// `nx`, `ny`, `nz` as they are; empty if the file has none.
    pub normals: Vec<[f32; 3]>,
    /// `ao` as it is; empty if the file has none.
    pub ao: Vec<f32>,
    /// Faces cut into triangles; empty if the file has none.
    pub triangles: Vec<[u32; 3]>,
    /// Texture coordinates of faces; empty, or as long as `triangles`.
    pub corner_uvs: Vec<[[f32; 2]; 3]>,
    /// Lines of comment in the header.
    pub comments: Vec<String>,
}

/// Reads a PLY file as a set of vertices.
///
/// # Errors
/// [`MeshFileError`].
pub fn read_ply_vertices(path: &Path) -> Result<PlyVertices, MeshFileError> {
    known_extension(path, &["ply"], ".ply")?;
    let bytes = read_file(path)?;
    ply::parse_vertices(&bytes).map_err(|flaw| flaw.at(path))
}

fn known_extension(
    path: &Path,
    known: &[&'static str],
    expected: &'static str,
) -> Result<&'static str, MeshFileError> {
    if path.is_dir() {
        return Err(MeshFileError::Folder { path: path.into() });
    }
    let extension = path.extension().and_then(|e| e.to_str()).unwrap_or_default();
    let found = known.iter().find(|k| k.eq_ignore_ascii_case(extension));
    found.copied().ok_or_else(|| MeshFileError::Extension { path: path.into(), expected })
}

fn read_file(path: &Path) -> Result<Vec<u8>, MeshFileError> {
    fs::read(path).map_err(|source| MeshFileError::Read { path: path.into(), source })
}

/// Control characters, line ends among them, become spaces, runs of spaces one, and long messages are cut: garbage must
/// not reach a terminal.
pub(crate) fn one_line(message: &str) -> String {
    const MAX_MESSAGE_CHARS: usize = 240;
    let mut line = String::new();
    for word in message.split(|c: char| c.is_whitespace() || c.is_control()).filter(|w| !w.is_empty()) {
        if !line.is_empty() {
            line.push(' ');
        }
        line.push_str(word);
        if line.len() > MAX_MESSAGE_CHARS {
            let end = (0..=MAX_MESSAGE_CHARS).rev().find(|&i| line.is_char_boundary(i)).unwrap_or(0);
            line.truncate(end);
            line.push_str("...");
            break;
        }
    }
    line
}

/// The direction of `corners`' geometric normal; zero without area.
fn geometric_normal(corners: [[f32; 3]; 3]) -> [f32; 3] {
    let p = corners.map(|c| umbrage_geom::glam::Vec3::from(c).as_dvec3());
    (p[1] - p[0]).cross(p[2] - p[0]).normalize_or_zero().as_vec3().to_array()
}

/// `normal` with unit length; the geometric normal of the triangle if it has none.
fn normal_or_geometric(normal: [f32; 3], corners: [[f32; 3]; 3]) -> [f32; 3] {
    let unit = umbrage_geom::glam::Vec3::from(normal).as_dvec3().normalize_or_zero();
    if unit == umbrage_geom::glam::DVec3::ZERO {
        geometric_normal(corners)
    } else {
        unit.as_vec3().to_array()
    }
}
