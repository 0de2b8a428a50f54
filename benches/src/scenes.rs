//! Geometry and rays that suites share.

use anyhow::Result;
use std::path::PathBuf;
use umbrage_geom::{
    Aabb, Frame, Ray, TriangleMesh,
    glam::{Vec2, Vec3},
    morton, offset_origin,
    sampling::{RandomStream, cosine_hemisphere, sobol_2d, sobol_4d, triangle},
};
use umbrage_scene::generate::{Parameters, generate};

/// The folder with real meshes: `UMBRAGE_MESHES`, or `../shared/meshes` beside the repository; `None` if it isn't there.
pub fn mesh_folder() -> Option<PathBuf> {
    let default = || PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../../shared/meshes"));
    let folder = std::env::var_os("UMBRAGE_MESHES").map_or_else(default, PathBuf::from);
    folder.is_dir().then_some(folder)
}

/// A generated mesh with about `triangles` triangles.
pub fn generated(name: &str, triangles: usize) -> Result<TriangleMesh> {
    let parameters = Parameters { triangles: Some(triangles), ..Parameters::default() };
    Ok(generate(name, &parameters)?.mesh)
}

/// Points on a surface that rays start from.
#[derive(Clone, Debug)]
pub struct Receivers {
    pub points: Vec<Vec3>,
    pub normals: Vec<Vec3>,
}

/// About `count` points spread evenly over the mesh's area, in Morton order, moved off the surface to the front side.
pub fn receivers(mesh: &TriangleMesh, count: usize, seed: u32) -> Receivers {
    let doubled_areas = (0..mesh.triangles.len()).map(|i| {
        let [a, b, c] = mesh.triangle(i).map(|p| Vec3::from(p).as_dvec3());
        (b - a).cross(c - a).length()
    });
    let mut total = 0.0;
    let cumulative: Vec<f64> = doubled_areas
        .map(|area| {
            total += area;
            total
        })
        .collect();
    let mut random = RandomStream::new(seed, 0);
    let (mut points, mut normals) = (Vec::new(), Vec::new());
    for i in 0..count {
        // One stratum of area for each receiver.
        let target = (i as f64 + f64::from(random.next_unit())) / count as f64 * total;
        let index = cumulative.partition_point(|&c| c <= target).min(mesh.triangles.len() - 1);
        let [a, b, c] = mesh.triangle(index).map(Vec3::from);
        let normal = (b - a).as_dvec3().cross((c - a).as_dvec3()).normalize_or_zero().as_vec3();
        let uv = triangle(Vec2::new(random.next_unit(), random.next_unit()));
        if normal == Vec3::ZERO {
            continue;
        }
        let magnitude = a.abs().max(b.abs()).max(c.abs()).max_element();
        points.push(offset_origin(a + (b - a) * uv.x + (c - a) * uv.y, normal, normal, magnitude));
        normals.push(normal);
    }
    let order = morton::order(&points.iter().map(|p| p.to_array()).collect::<Vec<_>>());
    Receivers {
        points: order.iter().map(|&i| points[i as usize]).collect(),
        normals: order.iter().map(|&i| normals[i as usize]).collect(),
    }
}

/// `per_receiver` cosine-weighted rays from each receiver, of length `radius` (world units, may be infinite).
pub fn ambient_rays(receivers: &Receivers, per_receiver: u32, radius: f32) -> Vec<Ray> {
    let mut rays = Vec::with_capacity(receivers.points.len() * per_receiver as usize);
    for (i, (&point, &normal)) in receivers.points.iter().zip(&receivers.normals).enumerate() {
        let frame = Frame::from_normal(normal);
        rays.extend((0..per_receiver).map(|k| {
            let [a, b, ..] = sobol_4d(k, 0, i as u32);
            let direction = frame.world_from_local(cosine_hemisphere(Vec2::new(a, b)));
            Ray::new(point, direction).with_tfar(radius)
        }));
    }
    rays
}

/// `per_receiver` rays from each receiver to a square light above the scene, half its size; segments end on the light.
pub fn shadow_rays(receivers: &Receivers, bounds: &Aabb, per_receiver: u32) -> Vec<Ray> {
    let (center, size) = (bounds.center(), bounds.diagonal());
    let middle = center + Vec3::new(0.3, 1.0, 0.2) * size;
    let mut rays = Vec::with_capacity(receivers.points.len() * per_receiver as usize);
    for (i, &point) in receivers.points.iter().enumerate() {
        rays.extend((0..per_receiver).map(|k| {
            let at = (sobol_2d(k, 0, i as u32) - 0.5) * 0.5 * size;
            Ray::between(point, middle + Vec3::new(at.x, 0.0, at.y))
        }));
    }
    rays
}

/// Rays of a pinhole camera that sees the whole scene from a corner, `side` x `side` pixels in tiles of 8 x 8.
pub fn camera_rays(bounds: &Aabb, side: u32) -> Vec<Ray> {
    let forward = -Vec3::new(0.6, 0.45, 0.66).normalize();
    let eye = bounds.center() - forward * bounds.diagonal();
    let right = forward.cross(Vec3::Y).normalize();
    let up = right.cross(forward);
    let pixel = |i: u32| (i as f32 + 0.5) / side as f32 - 0.5;
    let tiles = side.div_ceil(8);
    (0..tiles * tiles)
        .flat_map(|tile| (0..64).map(move |i| (tile % tiles * 8 + i % 8, tile / tiles * 8 + i / 8)))
        .filter(|&(x, y)| x < side && y < side)
        .map(|(x, y)| Ray::new(eye, forward + right * pixel(x) - up * pixel(y)))
        .collect()
}
