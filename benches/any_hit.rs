//! Criterion bench of the any-hit kernel; every answer is checked against brute force before it is timed.

use criterion::{Criterion, criterion_group, criterion_main};
use std::hint::black_box;
use umbrage_accel::{BackEnd, BuildOptions, Bvh, brute};
use umbrage_geom::{Ray, sampling::RandomStream, sampling::uniform_sphere};
use umbrage_scene::generate::{Parameters, generate};

fn any_hit(c: &mut Criterion) {
    for name in ["bush", "cathedral", "blob"] {
        let parameters = Parameters { triangles: Some(10_000), ..Parameters::default() };
        let mesh = generate(name, &parameters).expect("a small scene").mesh;
        let bounds = mesh.bounds();
        let mut random = RandomStream::new(7, 0);
        let mut unit = || random.next_unit();
        let rays: Vec<Ray> = (0..1000)
            .map(|_| {
                let origin =
                    bounds.min + bounds.size() * umbrage_geom::glam::Vec3::new(unit(), unit(), unit());
                Ray::new(origin, uniform_sphere([unit(), unit()].into()))
            })
            .collect();
        let truth: Vec<bool> =
            rays.iter().map(|ray| brute::any_hit(&mesh.positions, &mesh.triangles, ray)).collect();
        let bvh =
            Bvh::build(&mesh.positions, &mesh.triangles, &BuildOptions::default()).expect("a valid mesh");
        let scalar = bvh.clone().with_back_end(BackEnd::Scalar).expect("always there");
        for (back_end, bvh) in [("best", bvh), ("scalar", scalar)] {
            assert!(rays.iter().map(|ray| bvh.any_hit(ray)).eq(truth.iter().copied()));
            c.bench_function(&format!("any_hit/{name}_10k/{back_end}"), |b| {
                b.iter(|| rays.iter().filter(|ray| bvh.any_hit(black_box(ray))).count());
            });
        }
    }
}

criterion_group!(benches, any_hit);
criterion_main!(benches);
