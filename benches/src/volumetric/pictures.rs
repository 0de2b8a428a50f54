//! Pictures of what rays do, and the occluders themselves.

use super::{Case, scene::Shadows};
use anyhow::{Context, Result};
use image::{Rgb, RgbImage};
use std::{fmt::Write as _, path::Path};
use umbrage_accel::{Counters, kdtree::Order};
use umbrage_geom::{Aabb, TriangleMesh};
use umbrage_occlusion::volumetric::{Ends, KdQuery, KdVolumetricScratch};

/// Pixels along a side.
const SIDE: u32 = 512;

/// Writes operations a pixel (figures 2.2 and 3.11), pixels ended by occluders (figure 4.4) and the occluders (figure 3.12),
/// these as an OBJ too.
pub fn write(folder: &Path, case: &Case) -> Result<()> {
    std::fs::create_dir_all(folder).with_context(|| folder.display().to_string())?;
    let shadows = case.scene.shadows(&case.structures.bvh, SIDE, 4, 1, 0);
    let name = &case.scene.name;
    let save = |image: &RgbImage, what: &str| {
        let path = folder.join(format!("{name}-{what}.png"));
        image.save(&path).with_context(|| path.display().to_string())
    };
    let plain = work(case, &shadows, Order::RAY, false);
    let best = work(case, &shadows, Order::QUICK, true);
    let most = plain.iter().chain(&best).map(|p| p.operations).fold(1.0, f64::max);
    for (pixels, what) in [(&plain, "operations-ray-order"), (&best, "operations-occluders")] {
        let shade = |p: &Pixel| (255.0 * (1.0 - (p.operations / most).sqrt())) as u8;
        save(&draw(pixels, |p| Rgb([shade(p); 3])), what)?;
    }
    let blue = |p: &Pixel| {
        let (lit, ended) = (p.lit, p.ended);
        let gray = 60.0 + 180.0 * lit;
        Rgb([
            (gray * (1.0 - ended)) as u8,
            (gray * (1.0 - 0.6 * ended)) as u8,
            (gray + (255.0 - gray) * ended) as u8,
        ])
    };
    save(&draw(&best, blue), "ended-by-occluders")?;
    let boxes = boxes_mesh(case.structures.kd.occluders());
    let path = folder.join(format!("{name}-occluders.obj"));
    std::fs::write(&path, obj(&boxes)).with_context(|| path.display().to_string())?;
    if !boxes.triangles.is_empty() {
        save(&render(case, boxes)?, "occluders")?;
    }
    Ok(())
}

/// What the shadow rays of a pixel did.
#[derive(Clone, Copy, Default)]
struct Pixel {
    /// Traversal steps and triangle tests.
    operations: f64,
    /// Share of rays that met nothing.
    lit: f64,
    /// Share of rays that an occluder ended.
    ended: f64,
    seen: bool,
}

fn work(case: &Case, shadows: &Shadows, order: Order, occluders: bool) -> Vec<Pixel> {
    let mut pixels = vec![Pixel::default(); (SIDE * SIDE) as usize];
    let mut rays = vec![0.0f64; pixels.len()];
    let mut scratch = KdVolumetricScratch::default();
    for fan in &shadows.fans {
        let query = KdQuery::default().with_order(order).with_ends(Ends::Unknown).with_occluders(occluders);
        let query = query.with_light(Some(fan.light as usize));
        let mut c = Counters::default();
        for ray in &shadows.rays[fan.start as usize..fan.end as usize] {
            case.structures.kd.any_hit_with(ray, &query, &mut scratch, &mut c);
        }
        let pixel = &mut pixels[fan.pixel as usize];
        pixel.operations += (c.nodes + c.triangle_tests) as f64;
        pixel.lit += c.misses as f64;
        pixel.ended += c.cell_hits as f64;
        pixel.seen = true;
        rays[fan.pixel as usize] += f64::from(fan.end - fan.start);
    }
    for (pixel, rays) in pixels.iter_mut().zip(rays) {
        pixel.lit /= rays.max(1.0);
        pixel.ended /= rays.max(1.0);
    }
    pixels
}

fn draw(pixels: &[Pixel], color: impl Fn(&Pixel) -> Rgb<u8>) -> RgbImage {
    RgbImage::from_fn(SIDE, SIDE, |x, y| {
        let pixel = &pixels[(y * SIDE + x) as usize];
        if pixel.seen { color(pixel) } else { Rgb([255; 3]) }
    })
}

/// Boxes as twelve triangles each.
fn boxes_mesh(boxes: &[Aabb]) -> TriangleMesh {
    let mut mesh = TriangleMesh::default();
    let quads = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    for aabb in boxes {
        let first = mesh.positions.len() as u32;
        let corner =
            |i: usize| [0, 1, 2].map(|axis| if i >> axis & 1 == 0 { aabb.min[axis] } else { aabb.max[axis] });
        mesh.positions.extend((0..8).map(corner));
        let faces = quads.iter().flat_map(|q| [[q[0], q[1], q[2]], [q[0], q[2], q[3]]]);
        mesh.triangles.extend(faces.map(|t| t.map(|v: u32| v + first)));
    }
    mesh
}

fn obj(mesh: &TriangleMesh) -> String {
    let mut text = String::new();
    for [x, y, z] in &mesh.positions {
        let _ = writeln!(text, "v {x} {y} {z}");
    }
    for [a, b, c] in &mesh.triangles {
        let _ = writeln!(text, "f {} {} {}", a + 1, b + 1, c + 1);
    }
    text
}

/// The boxes alone, from the scene's camera, shaded by the direction of their faces.
fn render(case: &Case, boxes: TriangleMesh) -> Result<RgbImage> {
    let normals = case.scene.first_normals(&boxes, SIDE)?;
    Ok(RgbImage::from_fn(SIDE, SIDE, |x, y| match normals[(y * SIDE + x) as usize] {
        Some(n) => {
            let shade = 0.35 + 0.3 * n.y.abs() + 0.2 * n.x.abs() + 0.05 * n.z.abs();
            Rgb([255.0, 235.0, 200.0].map(|c: f32| (c * shade.min(1.0)) as u8))
        }
        None => Rgb([255; 3]),
    }))
}
