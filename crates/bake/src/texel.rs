//! Receivers at the texels of an image that texture coordinates unfold a mesh onto.

use super::receivers::{Lobe, check_count, face_normal, inward, magnitude, vertex_normals};
use super::{BakeError, NormalSource, Receivers};
use umbrage_geom::{
    TriangleMesh,
    glam::{DVec2, DVec3, Vec3},
};

/// Most repeats of the image that one triangle may span.
const MAX_REPEATS: f64 = 8.0;

/// Farthest that texture coordinates may be from 0.
const MAX_UV: f64 = 1024.0 * MAX_REPEATS;

/// Marks a texel that no triangle covers.
const NO_TRIANGLE: u32 = u32::MAX;

/// Which way texture coordinate `v` runs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum VAxis {
    /// `v = 0` at the bottom row of the image: OBJ, PLY.
    #[default]
    Up,
    /// `v = 0` at the top row: glTF.
    Down,
}

impl VAxis {
    /// The way of a mesh file's format: glTF counts v from the top of the image, other formats from the bottom.
    pub fn of_file(path: &std::path::Path) -> Self {
        let extension = path.extension().and_then(|e| e.to_str()).unwrap_or("").to_ascii_lowercase();
        if extension == "gltf" || extension == "glb" { Self::Down } else { Self::Up }
    }
}

/// Which triangle each texel of an image shows.
///
/// A texel belongs to the triangle that covers its centre, edges included; where several do (shared edges, overlapping
/// charts), to the one with the lowest index. Mirrored charts count like others. Texture coordinates outside `[0, 1]` wrap
/// around, as in a repeating texture.
#[derive(Clone, Debug, PartialEq)]
pub struct TexelMap {
    width: u32,
    height: u32,
    /// For each texel, row by row from the top.
    triangles: Vec<u32>,
    /// Weights of the second and third corner there.
    weights: Vec<[f32; 2]>,
}

/// A baked image, row by row from the top.
#[derive(Clone, Debug, PartialEq)]
pub struct TexelImage {
    /// Texels across.
    pub width: u32,
    /// Texels down.
    pub height: u32,
    /// 1 is open, 0 fully occluded; 1 where nothing was baked and [`Self::dilate`] did not reach.
    pub ao: Vec<f32>,
    /// Whether a triangle covers the texel (not changed by [`Self::dilate`]).
    pub covered: Vec<bool>,
}

impl TexelMap {
    /// Largest width and height.
    pub const MAX_SIZE: u32 = 16_384;

    /// Unfolds `mesh` onto `width` x `height` texels, each from 1 to [`Self::MAX_SIZE`].
    ///
    /// # Errors
    /// [`BakeError::Mesh`] (index 0), [`BakeError::NoUvs`], [`BakeError::Count`], [`BakeError::Uv`],
    /// [`BakeError::NoTexel`] if all texture coordinates have zero area or miss every centre.
    pub fn new(mesh: &TriangleMesh, width: u32, height: u32, v_axis: VAxis) -> Result<Self, BakeError> {
        mesh.validate().map_err(|source| BakeError::Mesh { index: 0, source })?;
        for (what, value) in [("image width", width), ("image height", height)] {
            if value == 0 || value > Self::MAX_SIZE {
                let limit = Self::MAX_SIZE.into();
                return Err(BakeError::Count { what, value: value.into(), limit });
            }
        }
        if mesh.corner_uvs.is_empty() {
            return Err(BakeError::NoUvs);
        }
        let texels = width as usize * height as usize;
        let mut map =
            Self { width, height, triangles: vec![NO_TRIANGLE; texels], weights: vec![[0.0; 2]; texels] };
        for (triangle, uvs) in mesh.corner_uvs.iter().enumerate() {
            let corners = uvs.map(|[u, v]| {
                let v = if v_axis == VAxis::Up { 1.0 - f64::from(v) } else { f64::from(v) };
                DVec2::new(f64::from(u), v)
            });
            let (low, high) =
                (corners[0].min(corners[1]).min(corners[2]), corners[0].max(corners[1]).max(corners[2]));
            // Written so that NaN fails.
            let sane = corners.iter().all(|c| c.is_finite() && c.abs().max_element() <= MAX_UV)
                && (high - low).max_element() <= MAX_REPEATS;
            if !sane {
                return Err(BakeError::Uv { triangle, limit: MAX_REPEATS as u32 });
            }
            let size = DVec2::new(width.into(), height.into());
            map.draw(triangle as u32, corners.map(|c| c * size));
        }
        if map.triangles.iter().all(|&t| t == NO_TRIANGLE) {
            return Err(BakeError::NoTexel { width, height });
        }
        Ok(map)
    }

    /// Gives `triangle` all free texels whose centres its `corners` (in texels, y down) cover.
    fn draw(&mut self, triangle: u32, corners: [DVec2; 3]) {
        let [a, b, c] = corners;
        let area = edge(a, b, c);
        if area == 0.0 {
            return;
        }
        let (low, high) = (a.min(b).min(c), a.max(b).max(c));
        for row in (low.y - 0.5).ceil() as i64..=(high.y - 0.5).floor() as i64 {
            for column in (low.x - 0.5).ceil() as i64..=(high.x - 0.5).floor() as i64 {
                let center = DVec2::new(column as f64 + 0.5, row as f64 + 0.5);
                let sides = [edge(b, c, center), edge(c, a, center), edge(a, b, center)];
                if sides.iter().any(|&s| if area > 0.0 { s < 0.0 } else { s > 0.0 }) {
                    continue;
                }
                let x = column.rem_euclid(self.width.into()) as usize;
                let y = row.rem_euclid(self.height.into()) as usize;
                let texel = y * self.width as usize + x;
                if self.triangles[texel] == NO_TRIANGLE {
                    let sum = sides[0] + sides[1] + sides[2];
                    self.triangles[texel] = triangle;
                    self.weights[texel] = [(sides[1] / sum) as f32, (sides[2] / sum) as f32];
                }
            }
        }
    }

    /// Texels across and down.
    pub fn size(&self) -> [u32; 2] {
        [self.width, self.height]
    }

    /// Whether a triangle covers each texel, row by row.
    pub fn covered(&self) -> Vec<bool> {
        self.triangles.iter().map(|&t| t != NO_TRIANGLE).collect()
    }

    /// Receivers at the covered texels, row by row; `mesh` is the one the map was made from.
    ///
    /// Normals are those of triangles, or interpolated from [`NormalSource`]; where these vanish, the triangle's. Texels of
    /// triangles without area in space look nowhere: their `ao` is 1.
    ///
    /// # Errors
    /// [`BakeError::NoNormals`], [`BakeError::Count`].
    pub fn receivers(&self, mesh: &TriangleMesh, normals: NormalSource) -> Result<Receivers, BakeError> {
        let means = match normals {
            NormalSource::File if mesh.corner_normals.is_empty() => return Err(BakeError::NoNormals),
            NormalSource::File | NormalSource::Geometric => None,
            NormalSource::Smooth => vertex_normals(mesh, normals)?,
        };
        let covered = self.triangles.iter().zip(&self.weights).filter(|t| *t.0 != NO_TRIANGLE);
        check_count(covered.clone().count())?;
        let mut receivers = Receivers::default();
        for (&triangle, &[u, v]) in covered {
            let index = triangle as usize;
            let weights = [1.0 - f64::from(u) - f64::from(v), f64::from(u), f64::from(v)];
            let mix = |values: [[f32; 3]; 3]| {
                (0..3).fold(DVec3::ZERO, |sum, i| sum + Vec3::from(values[i]).as_dvec3() * weights[i])
            };
            let face = face_normal(mesh, index);
            let shading = match (normals, &means) {
                (NormalSource::File, _) => mix(mesh.corner_normals[index]).try_normalize(),
                (_, Some(means)) => mix(mesh.triangles[index].map(|v| means[v as usize])).try_normalize(),
                _ => None,
            };
            let normal = shading.unwrap_or(face).as_vec3();
            // A shading normal that points away from the front is taken to mean the back of the surface.
            let face = if normal.as_dvec3().dot(face) < 0.0 { -face } else { face }.as_vec3();
            let (corners, magnitude) = (mesh.triangle(index), magnitude(mesh, index));
            let point = inward(mix(corners), corners, magnitude);
            receivers.push(point.to_array(), magnitude, Lobe::single(point, normal, face));
        }
        Ok(receivers)
    }

    /// The image of `ao`, one value for each of [`Self::receivers`]; texels that no triangle covers are 1.
    ///
    /// # Errors
    /// [`BakeError::Length`].
    pub fn image(&self, ao: &[f32]) -> Result<TexelImage, BakeError> {
        let covered = self.covered();
        let expected = covered.iter().filter(|&&c| c).count();
        if ao.len() != expected {
            return Err(BakeError::Length { what: "results", actual: ao.len(), expected });
        }
        let mut values = ao.iter();
        let fill = |&c: &bool| if c { *values.next().unwrap_or(&1.0) } else { 1.0 };
        let ao = covered.iter().map(fill).collect();
        Ok(TexelImage { width: self.width, height: self.height, ao, covered })
    }
}

/// Twice the signed area of `a`, `b`, `p`. Exactly opposite for `b`, `a`, so that neighbouring triangles leave no gap.
fn edge(a: DVec2, b: DVec2, p: DVec2) -> f64 {
    if (a.x, a.y) > (b.x, b.y) {
        return -edge(b, a, p);
    }
    (b - a).perp_dot(p - a)
}

impl TexelImage {
    /// Fills the surroundings of charts, so that filtering at seams meets baked values: `texels` times, each empty texel
    /// beside a filled one becomes the mean of the filled ones among its eight neighbours. Edges of the image don't wrap.
    pub fn dilate(&mut self, texels: u32) {
        let (width, height) = (self.width as usize, self.height as usize);
        let neighbours = |at: usize| {
            let (x, y) = (at % width, at / width);
            let rows = y.saturating_sub(1)..=(y + 1).min(height - 1);
            rows.flat_map(move |r| (x.saturating_sub(1)..=(x + 1).min(width - 1)).map(move |c| r * width + c))
        };
        let mut filled = self.covered.clone();
        let mut rim: Vec<usize> =
            (0..filled.len()).filter(|&at| !filled[at] && neighbours(at).any(|n| filled[n])).collect();
        for _ in 0..texels {
            // All means first: texels of one step don't see each other.
            let mean = |&at: &usize| {
                let near = neighbours(at).filter(|&n| filled[n]).map(|n| f64::from(self.ao[n]));
                let (sum, count) = near.fold((0.0, 0), |(sum, count), value| (sum + value, count + 1));
                (sum / f64::from(count)) as f32
            };
            let means: Vec<f32> = rim.iter().map(mean).collect();
            for (&at, mean) in rim.iter().zip(means) {
                self.ao[at] = mean;
                filled[at] = true;
            }
            rim = rim.iter().flat_map(|&at| neighbours(at)).filter(|&n| !filled[n]).collect();
            rim.sort_unstable();
            rim.dedup();
        }
    }
}
