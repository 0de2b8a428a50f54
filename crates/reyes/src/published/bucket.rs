//! The classic Reyes path (Cook, Carpenter and Catmull 1987): patches bound, split and diced for the camera, micropolygons
//! rasterized bucket by bucket, nothing kept from bucket to bucket but the image.
//!
//! Rates are set per patch by the footprint of the pixels where its box is nearest, and shared edges are stitched, so that
//! the whole image sees one watertight mesh. A micropolygon covers a pixel when the pixel's ray hits it by `geom`'s exact
//! predicate, so buckets agree with ray tracing of the same mesh bit for bit.

use crate::{MAX_LEVEL, Surface, SurfaceError, TraceCounts};
use umbrage_geom::{Aabb, Progress, Ray, glam::Vec3, intersect_triangle};

/// A pinhole camera: the ray through the middle of pixel `(x, y)` runs along `corner + (x + 1/2) right + (y + 1/2) down`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BucketCamera {
    /// Where all rays start, world units.
    pub eye: Vec3,
    /// Direction to the upper left corner of the image.
    pub corner: Vec3,
    /// Step of the direction to the next pixel.
    pub right: Vec3,
    /// Step of the direction to the next row.
    pub down: Vec3,
    /// Pixels in a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
}

/// Options of [`rasterize_buckets`].
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct BucketOptions {
    /// Pixels along a side of a bucket, at least 1.
    pub bucket: u32,
    /// Longest micropolygon edge in pixels.
    pub edge: f32,
    /// Most times that a patch is halved, at most [`MAX_LEVEL`].
    pub max_level: u8,
}

impl Default for BucketOptions {
    fn default() -> Self {
        Self { bucket: 32, edge: 1.0, max_level: 10 }
    }
}

impl BucketOptions {
    /// With another [`Self::bucket`].
    #[must_use]
    pub fn with_bucket(self, bucket: u32) -> Self {
        Self { bucket, ..self }
    }

    /// With another [`Self::edge`].
    #[must_use]
    pub fn with_edge(self, edge: f32) -> Self {
        Self { edge, ..self }
    }

    /// With another [`Self::max_level`].
    #[must_use]
    pub fn with_max_level(self, max_level: u8) -> Self {
        Self { max_level, ..self }
    }
}

/// What a pixel sees.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fragment {
    /// Parameter of the pixel's ray.
    pub t: f32,
    /// Index of the patch.
    pub patch: u32,
    /// Parameters of the point, in `[0, 1]`.
    pub u: f32,
    /// See [`Self::u`].
    pub v: f32,
}

/// Projections of points to pixels.
struct Projection {
    camera: BucketCamera,
    /// Rows that turn a direction into `(x w, y w, w)`.
    rows: [Vec3; 3],
}

impl BucketCamera {
    /// The ray through the middle of a pixel.
    pub fn ray(&self, x: u32, y: u32) -> Ray {
        Ray::new(self.eye, self.corner + self.right * (x as f32 + 0.5) + self.down * (y as f32 + 0.5))
    }

    fn projection(&self) -> Result<Projection, SurfaceError> {
        let normal = self.right.cross(self.down);
        let volume = self.corner.dot(normal);
        if !volume.is_normal() || !self.eye.is_finite() {
            let value = volume.into();
            return Err(SurfaceError::Option {
                name: "camera",
                value,
                expected: "three independent directions",
            });
        }
        // Cramer's rule for direction = w (corner + x right + y down).
        let rows = [self.down.cross(self.corner), self.corner.cross(self.right), normal].map(|r| r / volume);
        Ok(Projection { camera: *self, rows })
    }
}

impl Projection {
    /// Pixels that the points of a box may project to, `[x0, y0, x1, y1]` with open ends; `None` if they are all behind or
    /// outside. With a margin of a pixel for rounding.
    fn pixels(&self, bounds: &Aabb) -> Option<[u32; 4]> {
        let (mut low, mut high) = ([f32::INFINITY; 2], [f32::NEG_INFINITY; 2]);
        let mut in_front = 0;
        for corner in 0..8 {
            let pick =
                |axis: usize| if corner >> axis & 1 == 1 { bounds.max[axis] } else { bounds.min[axis] };
            let d = Vec3::new(pick(0), pick(1), pick(2)) - self.camera.eye;
            let [x, y, w] = self.rows.map(|row| row.dot(d));
            if w <= 0.0 {
                continue;
            }
            in_front += 1;
            for (axis, p) in [x / w, y / w].into_iter().enumerate() {
                low[axis] = low[axis].min(p);
                high[axis] = high[axis].max(p);
            }
        }
        let size = [self.camera.width, self.camera.height];
        match in_front {
            0 => None,
            // Cut by the plane of the eye: anywhere.
            1..8 => Some([0, 0, size[0], size[1]]),
            _ => {
                let start = [0, 1].map(|i| (low[i] - 2.0).max(0.0) as u32);
                let end = [0, 1].map(|i| ((high[i] + 2.0).max(0.0) as u32).saturating_add(1).min(size[i]));
                (start[0] < end[0] && start[1] < end[1]).then_some([start[0], start[1], end[0], end[1]])
            }
        }
    }

    /// Length of a pixel's shorter side at the box's nearest point, 0 if that is beside the eye.
    fn footprint(&self, bounds: &Aabb) -> f64 {
        // `w` is linear, so its smallest value is at a corner.
        let row = self.rows[2];
        let nearest = Vec3::select(row.cmpgt(Vec3::ZERO), bounds.min, bounds.max);
        let w = row.dot(nearest - self.camera.eye).max(0.0);
        f64::from(w * self.camera.right.length().min(self.camera.down.length()))
    }
}

/// What every pixel sees of a surface, row by row, and the work done.
///
/// # Errors
/// [`SurfaceError::Option`] for a bucket of no pixels, an edge that is not positive, a level beyond [`MAX_LEVEL`] or a flat
/// camera; [`SurfaceError::Cancelled`] by `progress`, which counts buckets.
pub fn rasterize_buckets(
    surface: &Surface,
    camera: &BucketCamera,
    options: &BucketOptions,
    progress: &Progress,
) -> Result<(Vec<Option<Fragment>>, TraceCounts), SurfaceError> {
    let option = |name, value, expected| Err(SurfaceError::Option { name, value, expected });
    if options.bucket == 0 {
        return option("bucket", 0.0, "at least 1 pixel");
    }
    if options.edge.is_nan() || options.edge <= 0.0 {
        return option("edge", options.edge.into(), "a positive number");
    }
    if options.max_level > MAX_LEVEL {
        return option("max_level", options.max_level.into(), "0 to 12");
    }
    let projection = camera.projection()?;
    let across = camera.width.div_ceil(options.bucket);
    let mut buckets = vec![Vec::new(); (across * camera.height.div_ceil(options.bucket)) as usize];
    // Bound: each patch into all buckets that it may touch.
    let levels: Vec<[u8; 2]> = (0..surface.patch_count() as u32)
        .map(|patch| {
            let bounds = surface.patch_bounds(patch);
            let Some([x0, y0, x1, y1]) = projection.pixels(&bounds) else {
                return [surface.least_level(patch); 2];
            };
            for y in y0 / options.bucket..=(y1 - 1) / options.bucket {
                for x in x0 / options.bucket..=(x1 - 1) / options.bucket {
                    buckets[(y * across + x) as usize].push(patch);
                }
            }
            let width = projection.footprint(&bounds) * f64::from(options.edge);
            surface.levels_for(patch, width, options.max_level)
        })
        .collect();
    let mut image = vec![None; (camera.width * camera.height) as usize];
    let mut counts = TraceCounts::default();
    for (bucket, patches) in buckets.iter().enumerate() {
        let (x0, y0) = (bucket as u32 % across * options.bucket, bucket as u32 / across * options.bucket);
        let area =
            [x0, y0, (x0 + options.bucket).min(camera.width), (y0 + options.bucket).min(camera.height)];
        for &patch in patches {
            fill(surface, &projection, patch, &levels, area, &mut image, &mut counts);
        }
        progress.advance(1).map_err(|_| SurfaceError::Cancelled)?;
    }
    Ok((image, counts))
}

/// Splits, dices and rasterizes the parts of a patch that may show in `area`.
fn fill(
    surface: &Surface,
    projection: &Projection,
    patch: u32,
    levels: &[[u8; 2]],
    area: [u32; 4],
    image: &mut [Option<Fragment>],
    counts: &mut TraceCounts,
) {
    let camera = &projection.camera;
    for key in surface.parts_of(patch, levels) {
        if projection.pixels(&surface.part_bounds(&key)).is_none_or(|p| overlap(p, area).is_none()) {
            continue;
        }
        let grid = surface.dice(&key);
        counts.dice += 1;
        counts.micropolygons += grid.cells() as u64;
        for triangle in 0..grid.triangle_count() {
            let corners = grid.corners(triangle);
            let Some(pixels) = projection.pixels(&Aabb::from_points(&corners)) else { continue };
            let Some([x0, y0, x1, y1]) = overlap(pixels, area) else { continue };
            for (x, y) in (y0..y1).flat_map(|y| (x0..x1).map(move |x| (x, y))) {
                let Some(hit) = intersect_triangle(&camera.ray(x, y), corners) else { continue };
                let pixel = &mut image[(y * camera.width + x) as usize];
                if pixel.is_none_or(|old| hit.t < old.t || (hit.t == old.t && patch < old.patch)) {
                    let (u, v) = grid.parameters_at(triangle, hit.u, hit.v);
                    *pixel = Some(Fragment { t: hit.t, patch, u, v });
                }
            }
        }
    }
}

fn overlap(a: [u32; 4], b: [u32; 4]) -> Option<[u32; 4]> {
    let [x0, y0, x1, y1] = [a[0].max(b[0]), a[1].max(b[1]), a[2].min(b[2]), a[3].min(b[3])];
    (x0 < x1 && y0 < y1).then_some([x0, y0, x1, y1])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::SurfaceOptions;
    use umbrage_accel::{BuildOptions, Bvh};
    use umbrage_geom::PolygonMesh;

    fn surface() -> Surface {
        let side = |i: u32, bit: u32| if i >> bit & 1 == 1 { 1.0 } else { -1.0 };
        let cube = PolygonMesh {
            positions: (0..8).map(|i| [side(i, 0), side(i, 1), side(i, 2)]).collect(),
            face_sizes: vec![4, 4, 4, 4, 3, 3, 4],
            corners: vec![1, 3, 7, 5, 0, 4, 6, 2, 2, 6, 7, 3, 0, 1, 5, 4, 4, 5, 7, 4, 7, 6, 0, 2, 3, 1],
            creases: vec![([1, 3], 2.0)],
            ..PolygonMesh::default()
        };
        Surface::build(&cube, &SurfaceOptions::default()).unwrap()
    }

    fn camera(distance: f32) -> BucketCamera {
        BucketCamera {
            eye: Vec3::new(0.3, 0.2, distance),
            corner: Vec3::new(-0.4, 0.35, -1.0),
            right: Vec3::new(0.8 / 70.0, 0.0, 0.0),
            down: Vec3::new(0.0, -0.7 / 60.0, 0.0),
            width: 70,
            height: 60,
        }
    }

    /// Every pixel sees what its ray hits of the same tessellation, whatever the buckets; close views cut the eye's plane.
    #[test]
    fn buckets_agree_with_rays() {
        let surface = surface();
        for distance in [4.0, 1.4, 0.2] {
            let camera = camera(distance);
            let options = BucketOptions::default().with_max_level(6);
            let projection = camera.projection().unwrap();
            let levels = |patch| {
                let bounds = surface.patch_bounds(patch);
                match projection.pixels(&bounds) {
                    Some(_) => surface.levels_for(patch, projection.footprint(&bounds), 6),
                    None => [surface.least_level(patch); 2],
                }
            };
            let (mesh, _) = surface.tessellate(levels).unwrap();
            let bvh = Bvh::build(&mesh.positions, &mesh.triangles, &BuildOptions::default()).unwrap();
            let mut first = None;
            for bucket in [7, 32, 100] {
                let (image, counts) =
                    rasterize_buckets(&surface, &camera, &options.with_bucket(bucket), &Progress::silent())
                        .unwrap();
                for (i, fragment) in image.iter().enumerate() {
                    let ray = camera.ray(i as u32 % 70, i as u32 / 70);
                    assert_eq!(fragment.map(|f| f.t), bvh.closest_hit(&ray).map(|h| h.t), "pixel {i}");
                }
                assert!(counts.dice > 0 && image.iter().flatten().count() > 200);
                assert_eq!(first.get_or_insert(image.clone()), &image);
            }
        }
    }

    #[test]
    fn bad_options_and_cancelling() {
        let surface = surface();
        let run = |camera: BucketCamera, options: BucketOptions| {
            rasterize_buckets(&surface, &camera, &options, &Progress::silent()).err()
        };
        let default = BucketOptions::default();
        for (options, bad) in [
            (default.with_bucket(0), "bucket"),
            (default.with_edge(f32::NAN), "edge"),
            (default.with_max_level(13), "max_level"),
        ] {
            assert!(
                matches!(run(camera(4.0), options), Some(SurfaceError::Option { name, .. }) if name == bad)
            );
        }
        let flat = BucketCamera { down: Vec3::ZERO, ..camera(4.0) };
        assert!(matches!(run(flat, default), Some(SurfaceError::Option { name: "camera", .. })));
        let mut stop = |_: f32| false;
        let progress = Progress::new(6, &mut stop);
        let error = rasterize_buckets(&surface, &camera(4.0), &default, &progress).err();
        assert_eq!(error, Some(SurfaceError::Cancelled));
    }
}
