//! Files of baked ambient occlusion: results, parts made by shards, and joining parts.
//!
//! A part is a PLY that says in a comment what it belongs to; receivers of other shards have `ao` -1. Of texels it holds
//! column and row as x and y.

use crate::TexelImage;
use std::path::{Path, PathBuf};
use umbrage_geom::TriangleMesh;
use umbrage_image::{
    Film, Format, GREY, ImageError, Shard, ShardError, ValueRange, XYZ, names, write_exr, write_grey,
};
use umbrage_scene::{
    MeshFileError, PlyVertices, VertexAttributes, WriteMeshError, read_ply_vertices, write_obj, write_ply,
    write_ply_points,
};

/// Marks receivers of other shards in a part.
const OTHER_SHARD_AO: f32 = -1.0;

/// First word of the comment that makes a PLY a part.
const PART_COMMENT: &str = "umbrage-part";

/// What was baked, with what is needed to write it down.
#[derive(Clone, Debug, PartialEq)]
pub enum BakeTarget {
    /// Vertices of a mesh.
    Vertices(TriangleMesh),
    /// Given points with normals.
    Points {
        /// World units.
        positions: Vec<[f32; 3]>,
        /// Unit.
        normals: Vec<[f32; 3]>,
    },
    /// Texels that triangles cover, row by row.
    Texels {
        /// Texels across.
        width: u32,
        /// Texels down.
        height: u32,
        /// Column and row of each receiver.
        at: Vec<[u32; 2]>,
        /// How far charts are grown before the image is written.
        dilate: u32,
    },
}

/// A bake: one `ao` (1 is open, 0 fully occluded) for each receiver of the target.
#[derive(Clone, Debug, PartialEq)]
pub struct Baked {
    /// The receivers.
    pub target: BakeTarget,
    /// Their `ao`.
    pub ao: Vec<f32>,
    /// Their bent normals, if they were asked for: unit vectors in world space.
    pub bent_normals: Option<Vec<[f32; 3]>>,
}

/// Why a bake could not be written, read or joined.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum BakedError {
    /// The extension does not suit what was baked.
    #[error("{}: {what} are written as {expected}", .path.display())]
    Extension {
        /// The file.
        path: PathBuf,
        /// What was baked.
        what: &'static str,
        /// Extensions that suit.
        expected: &'static str,
    },
    /// A part says something impossible about itself.
    #[error("{}: not a part of a bake, or damaged", .0.display())]
    NotAPart(PathBuf),
    /// Parts are missing, come twice or belong to different bakes.
    #[error(transparent)]
    Shard(#[from] ShardError),
    /// An image could not be written.
    #[error(transparent)]
    Image(#[from] ImageError),
    /// A mesh could not be written.
    #[error(transparent)]
    Write(#[from] WriteMeshError),
    /// A part could not be read.
    #[error(transparent)]
    Read(#[from] MeshFileError),
}

/// How an `ao` is stored in 8 bits: linear, 255 is open.
fn grey(ao: &[f32]) -> Vec<[u8; 3]> {
    ao.iter().map(|&ao| [(ao.clamp(0.0, 1.0) * 255.0).round() as u8; 3]).collect()
}

impl BakeTarget {
    /// Checks that the target can be written to a file of that name.
    ///
    /// # Errors
    /// [`BakedError::Extension`].
    pub fn check_extension(&self, path: &Path) -> Result<(), BakedError> {
        let (what, extensions, expected): (_, &[&str], _) = match self {
            Self::Vertices(_) => ("vertices", &["ply", "obj"], ".ply or .obj"),
            Self::Points { .. } => ("points", &["ply"], ".ply"),
            Self::Texels { .. } => ("texels", &["png", "exr"], ".png or .exr"),
        };
        let extension = path.extension().and_then(|e| e.to_str()).unwrap_or("").to_ascii_lowercase();
        if extensions.contains(&extension.as_str()) {
            Ok(())
        } else {
            Err(BakedError::Extension { path: path.into(), what, expected })
        }
    }
}

impl Baked {
    /// Writes the result, atomically: PLY with grey `red`, `green`, `blue` and a float `ao`; OBJ with vertex colours; PNG
    /// with 8-bit linear grey; EXR with layers `ao` and `coverage`. Bent normals are floats `bent_x`, `bent_y`, `bent_z` in PLY,
    /// comments in OBJ, a layer `bent` in EXR, and left out of PNG.
    ///
    /// # Errors
    /// [`BakedError::Extension`], [`BakedError::Image`], [`BakedError::Write`].
    pub fn write(&self, path: &Path) -> Result<(), BakedError> {
        self.target.check_extension(path)?;
        let colors = grey(&self.ao);
        let axis = |axis: usize| -> Vec<f32> {
            self.bent_normals.iter().flatten().map(|normal| normal[axis]).collect()
        };
        let bent = [0, 1, 2].map(axis);
        let mut scalars = vec![("ao", &self.ao[..])];
        if self.bent_normals.is_some() {
            scalars.extend(["bent_x", "bent_y", "bent_z"].into_iter().zip(bent.iter().map(|b| &b[..])));
        }
        let comments = ["ambient occlusion by Umbrage: ao is 1 where open, 0 where fully occluded"];
        let attributes = VertexAttributes {
            colors: Some(&colors),
            scalars: &scalars,
            comments: &comments,
            ..VertexAttributes::default()
        };
        match &self.target {
            BakeTarget::Vertices(mesh) => {
                let is_obj = path.extension().is_some_and(|e| e.eq_ignore_ascii_case("obj"));
                let write = if is_obj { write_obj } else { write_ply };
                Ok(write(path, mesh, &attributes)?)
            }
            BakeTarget::Points { positions, normals } => {
                let attributes = VertexAttributes { normals: Some(normals), ..attributes };
                Ok(write_ply_points(path, positions, &attributes)?)
            }
            BakeTarget::Texels { width, height, at, dilate } => {
                self.write_image(path, *width, *height, at, *dilate)
            }
        }
    }

    fn write_image(
        &self,
        path: &Path,
        width: u32,
        height: u32,
        at: &[[u32; 2]],
        dilate: u32,
    ) -> Result<(), BakedError> {
        let pixels = width as usize * height as usize;
        let mut image = TexelImage { width, height, ao: vec![1.0; pixels], covered: vec![false; pixels] };
        for (&[x, y], &ao) in at.iter().zip(&self.ao) {
            let index = y as usize * width as usize + x as usize;
            image.ao[index] = ao;
            image.covered[index] = true;
        }
        image.dilate(dilate);
        let mut film = Film::new(width, height)?;
        film.add_layer_with(names::AO, GREY, image.ao)?;
        let coverage = image.covered.iter().map(|&c| f32::from(u8::from(c))).collect();
        film.add_layer_with("coverage", GREY, coverage)?;
        if let Some(normals) = &self.bent_normals {
            let mut bent = vec![0.0; 3 * pixels];
            for (&[x, y], normal) in at.iter().zip(normals) {
                let index = y as usize * width as usize + x as usize;
                bent[3 * index..][..3].copy_from_slice(normal);
            }
            film.add_layer_with("bent", XYZ, bent)?;
        }
        match Format::of(path)? {
            Format::Png => drop(write_grey(path, &film, names::AO, Some(ValueRange::UNIT))?),
            _ => write_exr(path, &film)?,
        }
        Ok(())
    }

    /// Writes one shard of the bake as a part, atomically; receivers of other shards are NaN.
    ///
    /// # Errors
    /// [`BakedError::Extension`] unless the name ends in `.ply`; [`BakedError::Write`].
    pub fn write_part(&self, path: &Path, shard: Shard, fingerprint: u64) -> Result<(), BakedError> {
        check_part_extension(path)?;
        let ao: Vec<f32> = self.ao.iter().map(|&ao| if ao.is_nan() { OTHER_SHARD_AO } else { ao }).collect();
        let kind = match &self.target {
            BakeTarget::Vertices(_) => "vertices 0 0 0".into(),
            BakeTarget::Points { .. } => "points 0 0 0".into(),
            BakeTarget::Texels { width, height, dilate, .. } => format!("texels {width} {height} {dilate}"),
        };
        let comment = format!("{PART_COMMENT} {shard} {fingerprint:016x} {kind}");
        let (scalars, comments) = ([("ao", &ao[..])], [comment.as_str()]);
        let attributes =
            VertexAttributes { scalars: &scalars, comments: &comments, ..VertexAttributes::default() };
        match &self.target {
            BakeTarget::Vertices(mesh) => write_ply(path, mesh, &attributes)?,
            BakeTarget::Points { positions, normals } => {
                let attributes = VertexAttributes { normals: Some(normals), ..attributes };
                write_ply_points(path, positions, &attributes)?;
            }
            BakeTarget::Texels { at, .. } => {
                let positions: Vec<_> = at.iter().map(|&[x, y]| [x as f32, y as f32, 0.0]).collect();
                write_ply_points(path, &positions, &attributes)?;
            }
        }
        Ok(())
    }
}

/// Checks that a part can have that name.
///
/// # Errors
/// [`BakedError::Extension`] unless it ends in `.ply`.
pub fn check_part_extension(path: &Path) -> Result<(), BakedError> {
    if path.extension().is_some_and(|e| e.eq_ignore_ascii_case("ply")) {
        Ok(())
    } else {
        Err(BakedError::Extension { path: path.into(), what: "parts of a bake", expected: ".ply" })
    }
}

/// What a part says about itself.
#[derive(Clone, Debug, PartialEq)]
struct Header {
    shard: Shard,
    fingerprint: u64,
    kind: String,
    numbers: [u32; 3],
}

impl Header {
    fn parse(comments: &[String]) -> Option<Self> {
        let mut words = comments.iter().find_map(|c| c.trim().strip_prefix(PART_COMMENT))?.split_whitespace();
        let shard = words.next()?.parse().ok()?;
        let fingerprint = u64::from_str_radix(words.next()?, 16).ok()?;
        let kind = words.next()?.into();
        let mut number = || words.next()?.parse().ok();
        Some(Self { shard, fingerprint, kind, numbers: [number()?, number()?, number()?] })
    }

    fn target(&self, ply: PlyVertices) -> Option<BakeTarget> {
        let [width, height, dilate] = self.numbers;
        match self.kind.as_str() {
            "vertices" => {
                let PlyVertices { positions, triangles, corner_uvs, .. } = ply;
                Some(BakeTarget::Vertices(TriangleMesh {
                    positions,
                    triangles,
                    corner_uvs,
                    ..TriangleMesh::default()
                }))
            }
            "points" => Some(BakeTarget::Points { positions: ply.positions, normals: ply.normals }),
            "texels" => {
                let inside =
                    |p: &[f32; 3]| p[0] >= 0.0 && p[1] >= 0.0 && p[0] < width as f32 && p[1] < height as f32;
                let fits = u64::from(width.max(height)) <= u64::from(crate::TexelMap::MAX_SIZE);
                let at = ply.positions.iter().map(|p| [p[0] as u32, p[1] as u32]).collect();
                (fits && ply.positions.iter().all(inside)).then_some(BakeTarget::Texels {
                    width,
                    height,
                    at,
                    dilate,
                })
            }
            _ => None,
        }
    }
}

fn read_part(path: &Path) -> Result<(Header, Baked), BakedError> {
    let mut ply = read_ply_vertices(path)?;
    let not_a_part = || BakedError::NotAPart(path.into());
    let header = Header::parse(&ply.comments).ok_or_else(not_a_part)?;
    let ao = std::mem::take(&mut ply.ao);
    if ao.len() != ply.positions.len() || !ao.iter().all(|&a| a == OTHER_SHARD_AO || (0.0..=1.0).contains(&a))
    {
        return Err(not_a_part());
    }
    let target = header.target(ply).ok_or_else(not_a_part)?;
    Ok((header, Baked { target, ao, bent_normals: None }))
}

/// Joins the parts of a bake, given in any order: the result is, bit for bit, that of a run without shards.
///
/// # Errors
/// [`BakedError::NotAPart`], [`BakedError::Shard`], [`BakedError::Read`].
pub fn merge(parts: &[PathBuf]) -> Result<Baked, BakedError> {
    let (first_path, rest) = parts.split_first().ok_or(ShardError::NoParts)?;
    let (first, mut baked) = read_part(first_path)?;
    let mut seen = vec![(first.shard, first_path)];
    for path in rest {
        let (header, part) = read_part(path)?;
        let same = header.shard.count() == first.shard.count()
            && header.fingerprint == first.fingerprint
            && part.target == baked.target;
        if !same {
            let (path, first) = (path.clone(), first_path.clone());
            return Err(
                ShardError::Mismatch { path, first, what: "mesh, settings or number of shards" }.into()
            );
        }
        if let Some(&(shard, first)) = seen.iter().find(|(shard, _)| *shard == header.shard) {
            return Err(ShardError::Duplicate { path: path.clone(), first: first.clone(), shard }.into());
        }
        seen.push((header.shard, path));
        for (ao, new) in baked.ao.iter_mut().zip(part.ao) {
            if new != OTHER_SHARD_AO {
                *ao = new;
            }
        }
    }
    let missing: Vec<u32> = (1..=first.shard.count())
        .filter(|&index| seen.iter().all(|(shard, _)| shard.index() != index))
        .collect();
    if !missing.is_empty() {
        return Err(ShardError::Missing { count: first.shard.count(), missing }.into());
    }
    if baked.ao.contains(&OTHER_SHARD_AO) {
        return Err(BakedError::NotAPart(first_path.clone()));
    }
    Ok(baked)
}
