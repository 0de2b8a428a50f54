use super::*;

/// Two parallel squares of two triangles each, and rays through none, one and both of them.
fn case() -> (TriangleMesh, Vec<Ray>, Vec<u32>) {
    let corner = |i: u32, z: f32| [(i % 2) as f32, (i / 2) as f32, z];
    let positions = (0..8).map(|i| corner(i % 4, (i / 4) as f32)).collect();
    let triangles = vec![[0, 1, 2], [1, 3, 2], [4, 5, 6], [5, 7, 6]];
    let mesh = TriangleMesh::new(positions, triangles).expect("valid");
    let mut rays = Vec::new();
    let mut crossings = Vec::new();
    for i in 0..37u32 {
        let x = (i as f32 + 0.4) / 24.0;
        let tfar = if i % 3 == 0 { 1.5 } else { 5.0 };
        rays.push(Ray::new([x, 0.3, -1.0], [0.0, 0.0, 1.0]).with_tfar(tfar));
        crossings.push(if x > 1.0 { 0 } else { 1 + u32::from(tfar > 2.0) });
    }
    (mesh, rays, crossings)
}

#[test]
fn every_call_finds_the_occluders() {
    let (mesh, rays, crossings) = case();
    let embree = Embree::new(&mesh).expect("Embree is installed");
    let pool = rayon::ThreadPoolBuilder::new().num_threads(2).build().expect("two threads");
    for mut entry in embree.any_hit(&rays) {
        for pool in [None, Some(&pool)] {
            entry.prepare();
            entry.run(pool);
            assert!(
                entry.answers().iter().eq(crossings.iter().map(|&n| n > 0).collect::<Vec<_>>().iter()),
                "{}",
                entry.mode()
            );
        }
    }
    assert!(embree.builds().high_bytes > 0 && embree.builds().medium_bytes > 0);
}

#[test]
fn backs_let_rays_pass() {
    let (mesh, rays, crossings) = case();
    // All rays come from behind; those turned around, from the front.
    let turned: Vec<Ray> = rays
        .iter()
        .map(|ray| Ray::new(ray.origin + ray.direction * ray.tfar, -ray.direction).with_tfar(ray.tfar))
        .collect();
    let embree = Embree::new(&mesh).expect("Embree is installed");
    for (rays, blocked) in [(&rays, false), (&turned, true)] {
        for mut entry in embree.front_hit(rays).expect("a third build") {
            entry.prepare();
            entry.run(None);
            let expected: Vec<bool> = crossings.iter().map(|&n| blocked && n > 0).collect();
            assert_eq!(entry.answers(), expected, "{}", entry.mode());
        }
    }
}

#[test]
fn filters_count_each_triangle_once() {
    let (mesh, rays, crossings) = case();
    let embree = Embree::new(&mesh).expect("Embree is installed");
    let opacity = OpticalDepth::from_opacity(0.5);
    let depth = |n: u32| {
        let mut sum = OpticalDepth::CLEAR;
        (0..n).for_each(|_| sum += opacity);
        sum
    };
    for mut entry in embree.transmittance(&rays, opacity) {
        entry.prepare();
        entry.run(None);
        assert_eq!(
            entry.answers(),
            crossings.iter().map(|&n| depth(n)).collect::<Vec<_>>(),
            "{}",
            entry.mode()
        );
    }
}
