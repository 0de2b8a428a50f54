//! Scenes, receivers and the reference that all methods are held to: the pattern's rays, cast one by one.
#![allow(dead_code)] // every test file uses some of it

use std::ops::ControlFlow;
use umbrage_accel::{BuildOptions, Bvh};
use umbrage_aomask::{
    BackEnd, MaskCall, MaskError, MaskOptions, MaskTables, Outputs, Pattern, PatternOptions,
    Points as DiscPoints, Receiver, Sides,
};
use umbrage_geom::{
    Falloff, Ray, TriangleHit, TriangleMesh,
    glam::{Vec2, Vec3},
    offset_origin,
    sampling::{RandomStream, triangle},
};

pub struct Scene {
    pub mesh: TriangleMesh,
    pub bvh: Bvh,
}

pub fn scene(name: &str, triangles: usize) -> Scene {
    let parameters = umbrage_scene::generate::Parameters { triangles: Some(triangles), ..Default::default() };
    from_mesh(umbrage_scene::generate::generate(name, &parameters).expect("a generator").mesh)
}

pub fn from_mesh(mesh: TriangleMesh) -> Scene {
    let bvh = Bvh::build(&mesh.positions, &mesh.triangles, &BuildOptions::default()).expect("valid mesh");
    Scene { mesh, bvh }
}

pub fn soup(triangles: &[[[f32; 3]; 3]]) -> Scene {
    let positions = triangles.iter().flatten().copied().collect();
    let indices = (0..triangles.len() as u32).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
    from_mesh(TriangleMesh::new(positions, indices).expect("valid soup"))
}

pub fn pattern(rays: u32, falloff: Falloff) -> Pattern {
    Pattern::new(&PatternOptions::default().with_rays(rays).with_falloff(falloff)).expect("valid options")
}

/// The fixed pattern that tables take.
pub fn table_pattern(rays: u32, falloff: Falloff) -> Pattern {
    let options = PatternOptions::default().with_points(DiscPoints::Middles);
    Pattern::new(&options.with_rays(rays).with_falloff(falloff)).expect("valid options")
}

pub type Points = (Vec<[f32; 3]>, Vec<[f32; 3]>);

/// Points on random triangles, on the front side.
pub fn receivers(mesh: &TriangleMesh, count: usize, seed: u32) -> Points {
    let mut random = RandomStream::new(seed, 1);
    let mut points = (Vec::new(), Vec::new());
    while points.0.len() < count {
        let [a, b, c] =
            mesh.triangle(random.next_below(mesh.triangles.len() as u32) as usize).map(Vec3::from);
        let normal = (b - a).as_dvec3().cross((c - a).as_dvec3()).normalize_or_zero().as_vec3();
        if normal == Vec3::ZERO {
            continue;
        }
        let uv = triangle(Vec2::new(random.next_unit(), random.next_unit()));
        let magnitude = a.abs().max(b.abs()).max(c.abs()).max_element();
        let point = offset_origin(a + (b - a) * uv.x + (c - a) * uv.y, normal, normal, magnitude);
        points.0.push(point.to_array());
        points.1.push(normal.to_array());
    }
    points
}

/// Rays of receiver `i` as the methods define them.
pub fn rays(pattern: &Pattern, (points, normals): &Points, options: &MaskOptions, i: usize) -> Vec<Ray> {
    let seed = Receiver::seed_of(points[i], normals[i], options.seed);
    let receiver = Receiver::new(i, points[i], normals[i], seed).expect("valid receiver");
    pattern.rays_of(&receiver, options.radius).collect()
}

/// Points with normals.
pub type Slices<'a> = (&'a [[f32; 3]], &'a [[f32; 3]]);

/// Method `mask`.
pub fn mask(
    bvh: &Bvh,
    pattern: &Pattern,
    (points, normals): Slices<'_>,
    options: &MaskOptions,
    back_end: BackEnd,
    outputs: Outputs<'_>,
) -> Result<(), MaskError> {
    let receivers = Receiver::from_slices(points, normals, options.seed)?;
    let call = MaskCall::new(bvh, pattern, &receivers, options).with_back_end(back_end);
    call.answer(outputs, &mut |_| true)
}

/// Method `mask-table`.
pub fn table(
    tables: &MaskTables,
    bvh: &Bvh,
    (points, normals): Slices<'_>,
    options: &MaskOptions,
    outputs: Outputs<'_>,
    go_on: bool,
) -> Result<(), MaskError> {
    let receivers = Receiver::from_slices(points, normals, options.seed)?;
    tables.answer(bvh, &receivers, options, outputs, &mut |_| go_on)
}

/// Masks of all receivers by exact single rays.
pub fn exact(scene: &Scene, pattern: &Pattern, points: &Points, options: &MaskOptions) -> Vec<u64> {
    let mut masks = Vec::new();
    for i in 0..points.0.len() {
        let mut words = vec![0u64; pattern.words()];
        for (k, ray) in rays(pattern, points, options, i).iter().enumerate() {
            let hit = match options.sides {
                Sides::Both => scene.bvh.any_hit(ray),
                Sides::Front => {
                    let stop = |_, hit: TriangleHit| match hit.front {
                        true => ControlFlow::Break(()),
                        false => ControlFlow::Continue(()),
                    };
                    scene.bvh.for_each_hit(ray, stop).is_break()
                }
                Sides::FrontFirst => scene.bvh.closest_hit(ray).is_some_and(|hit| hit.front),
            };
            words[k / 64] |= u64::from(hit) << (k % 64);
        }
        masks.extend(words);
    }
    masks
}

/// Ambient occlusion where the nearest hit of each ray of length `radius` is weighted by `falloff`.
pub fn weighted(scene: &Scene, rays: &[Ray], radius: f32, falloff: &Falloff) -> f64 {
    let occlusion = |ray: &Ray| {
        let ray = ray.with_tfar(radius);
        scene.bvh.closest_hit(&ray).map_or(0.0, |hit| f64::from(falloff.weight(hit.t / radius)))
    };
    1.0 - rays.iter().map(occlusion).sum::<f64>() / rays.len() as f64
}

/// How masks differ from `exact` ones.
pub struct Difference {
    /// Fraction of rays that differ.
    pub rays: f64,
    /// Mean difference of ambient occlusion.
    pub bias: f64,
    /// Mean absolute difference of ambient occlusion.
    pub mean_abs: f64,
}

pub fn difference(pattern: &Pattern, masks: &[u64], exact: &[u64]) -> Difference {
    let words = pattern.words();
    let (receivers, rays) = (exact.len() / words, pattern.len() as f64);
    let mut sum = Difference { rays: 0.0, bias: 0.0, mean_abs: 0.0 };
    let ones = |mask: &[u64]| mask.iter().map(|w| f64::from(w.count_ones())).sum::<f64>();
    for (mask, exact) in masks.chunks(words).zip(exact.chunks(words)) {
        let differ: Vec<u64> = mask.iter().zip(exact).map(|(a, b)| a ^ b).collect();
        let error = (ones(exact) - ones(mask)) / rays;
        sum.rays += ones(&differ) / rays / receivers as f64;
        sum.bias += error / receivers as f64;
        sum.mean_abs += error.abs() / receivers as f64;
    }
    sum
}
