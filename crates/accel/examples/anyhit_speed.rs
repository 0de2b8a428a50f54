//! Any-hit rays per second on a displaced sphere, or on the OBJ named as argument: all back ends, one thread.
//!
//! `cargo run --release -p umbrage-accel --example anyhit_speed -- [MESH.obj|-] [LEAF_SIZE]`

use rand_pcg::{Pcg32, rand_core::Rng};
use std::time::Instant;
use umbrage_accel::{BackEnd, BuildOptions, BuildQuality, Bvh, Counters};
use umbrage_geom::{Ray, glam::Vec3};

type Mesh = (Vec<[f32; 3]>, Vec<[u32; 3]>);

/// A sphere of `2 * n * n` triangles with bumps.
fn sphere(n: u32) -> Mesh {
    let mut positions = Vec::new();
    for i in 0..=n {
        for j in 0..=n {
            let (theta, phi) =
                (i as f32 / n as f32 * std::f32::consts::PI, j as f32 / n as f32 * std::f32::consts::TAU);
            let direction = Vec3::new(theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos());
            let bumps = (20.0 * direction.x).sin() * (23.0 * direction.y).sin() * (19.0 * direction.z).sin();
            positions.push((direction * (1.0 + 0.1 * bumps)).to_array());
        }
    }
    let quads = (0..n).flat_map(|i| (0..n).map(move |j| i * (n + 1) + j));
    let triangles = quads.flat_map(|a| [[a, a + n + 1, a + 1], [a + 1, a + n + 1, a + n + 2]]).collect();
    (positions, triangles)
}

/// Triangles of an OBJ whose faces are triangles with positive indices.
fn obj(path: &str) -> Result<Mesh, Box<dyn std::error::Error>> {
    let text = std::fs::read_to_string(path)?;
    let (mut positions, mut triangles) = (Vec::new(), Vec::new());
    for line in text.lines() {
        let mut words = line.split_whitespace();
        match words.next() {
            Some("v") => {
                let p: Vec<f32> = words.map(str::parse).collect::<Result<_, _>>()?;
                positions.push([p[0], p[1], p[2]]);
            }
            Some("f") => {
                let corner = |w: &str| w.split('/').next().unwrap_or(w).parse::<u32>().map(|i| i - 1);
                let f: Vec<u32> = words.map(corner).collect::<Result<_, _>>()?;
                triangles.extend((2..f.len()).map(|i| [f[0], f[i - 1], f[i]]));
            }
            _ => {}
        }
    }
    Ok((positions, triangles))
}

/// Cosine-distributed rays from just above random triangles, `each` of them a point, up to `radius`.
fn ambient((positions, triangles): &Mesh, points: usize, each: usize, radius: f32) -> Vec<Ray> {
    let mut random = Pcg32::new(7, 11);
    let mut uniform = move || (random.next_u32() >> 8) as f32 / (1 << 24) as f32;
    let mut rays = Vec::new();
    let stride = (triangles.len() as f32 / points as f32).max(1.0);
    for point in 0..points {
        // Neighbours in the mesh follow each other, as receivers in a picture do.
        let corners = triangles[(point as f32 * stride) as usize % triangles.len()];
        let [a, b, c] = corners.map(|v| Vec3::from(positions[v as usize]));
        let normal = (b - a).cross(c - a).normalize_or_zero();
        let origin = (a + b + c) / 3.0 + normal * 1e-4 * (b - a).length();
        for _ in 0..each {
            let z = 2.0 * uniform() - 1.0;
            let (s, phi) = ((1.0 - z * z).max(0.0).sqrt(), uniform() * std::f32::consts::TAU);
            let direction = normal + Vec3::new(s * phi.cos(), s * phi.sin(), z);
            rays.push(Ray::new(origin, direction.normalize_or_zero() * radius).with_tfar(1.0));
        }
    }
    rays
}

/// Time of all rays: the sum over short runs of the best of seven rounds, which other load hardly disturbs.
fn seconds(bvh: &Bvh, rays: &[Ray], hits: &mut [bool]) -> f64 {
    let mut best = vec![f64::INFINITY; rays.len().div_ceil(2000)];
    for _ in 0..7 {
        for ((rays, hits), best) in rays.chunks(2000).zip(hits.chunks_mut(2000)).zip(&mut best) {
            let start = Instant::now();
            bvh.any_hits_with(rays, hits, &mut ());
            *best = best.min(start.elapsed().as_secs_f64());
        }
    }
    best.iter().sum()
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let mesh = match arguments.next() {
        Some(path) if path != "-" => obj(&path)?,
        _ => sphere(708),
    };
    let leaf_size = arguments.next().map_or(Ok(BuildOptions::default().leaf_size), |s| s.parse())?;
    for quality in [BuildQuality::Fast, BuildQuality::High] {
        let options = BuildOptions::default().with_quality(quality).with_leaf_size(leaf_size);
        let start = Instant::now();
        let bvh = Bvh::build(&mesh.0, &mesh.1, &options)?;
        println!(
            "{quality:?}: {} triangles in {:.2?}, {:.1} bytes each",
            bvh.prim_count(),
            start.elapsed(),
            bvh.bytes() as f64 / bvh.prim_count() as f64
        );
        let diagonal = bvh.bounds().diagonal();
        for part in [0.03, 0.1, 10.0] {
            let rays = ambient(&mesh, 10_000, 32, part * diagonal);
            let mut hits = vec![false; rays.len()];
            let mut expected = None;
            for back_end in
                [BackEnd::Scalar, BackEnd::Avx2, BackEnd::Avx512].into_iter().filter(|b| b.is_supported())
            {
                let bvh = bvh.clone().with_back_end(back_end)?;
                let best = seconds(&bvh, &rays, &mut hits);
                let mut counters = Counters::default();
                bvh.any_hits_with(&rays, &mut hits, &mut counters);
                assert!(*expected.get_or_insert(hits.clone()) == hits, "back ends differ");
                let per_ray = |count: u64| count as f64 / rays.len() as f64;
                println!(
                    "  radius {part:>4}: {back_end:?} {:.2} Mrays/s, hits {:.3}, a ray: nodes {:.1}, triangles {:.1}, uncertain {:.4}",
                    rays.len() as f64 / best * 1e-6,
                    hits.iter().filter(|&&h| h).count() as f64 / rays.len() as f64,
                    per_ray(counters.nodes),
                    per_ray(counters.triangle_tests),
                    per_ray(counters.uncertain),
                );
            }
        }
    }
    Ok(())
}
