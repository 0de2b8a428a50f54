//! Input that breaks builders: it must build soon, and answer right.

use std::{sync::Arc, time::Instant};
use umbrage_accel::{
    BackEnd, BuildError, BuildOptions, BuildQuality, Bvh, Counters, InstancedBvh, Placement, brute,
};
use umbrage_geom::{
    Aabb, MeshError, Ray,
    glam::{Affine3A, Vec3},
};

fn both_qualities() -> [BuildOptions; 2] {
    [BuildQuality::Fast, BuildQuality::High].map(|quality| BuildOptions::default().with_quality(quality))
}

/// Builds both ways, within two minutes in all on a loaded machine, and compares some rays towards triangles.
fn check(name: &str, positions: &[[f32; 3]], triangles: &[[u32; 3]]) {
    let start = Instant::now();
    for options in both_qualities() {
        let bvh = Bvh::build(positions, triangles, &options).unwrap();
        assert_eq!(bvh.prim_count(), triangles.len());
        let used = triangles.iter().flatten().map(|&v| positions[v as usize]);
        assert_eq!(bvh.bounds(), used.fold(Aabb::EMPTY, Aabb::with_point), "{name}");
        let stride = triangles.len().div_ceil(6);
        let rays: Vec<_> = (0..triangles.len())
            .step_by(stride)
            .map(|i| {
                let [a, b, c] = triangles[i].map(|v| Vec3::from(positions[v as usize]));
                let target = a / 3.0 + b / 3.0 + c / 3.0;
                let size =
                    (b - a).abs().max_element().max((c - a).abs().max_element()).max(f32::MIN_POSITIVE);
                let origin = target + Vec3::new(0.3, 0.2, -1.0) * size;
                Ray::new(origin, target - origin)
            })
            .filter(Ray::is_valid)
            .collect();
        assert_eq!(brute::first_difference(&bvh, positions, triangles, &rays), None, "{name}");
    }
    assert!(start.elapsed().as_secs() < 120, "{name} took {:?}", start.elapsed());
}

/// One triangle for each triple of corners.
fn unshared(triangles: impl Iterator<Item = [[f32; 3]; 3]>) -> (Vec<[f32; 3]>, Vec<[u32; 3]>) {
    let positions: Vec<_> = triangles.flatten().collect();
    let indices = (0..positions.len() as u32 / 3).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
    (positions, indices)
}

#[test]
fn copies_of_one_triangle() {
    let positions = [[0.1, 0.2, 0.3], [1.1, 0.0, 0.5], [0.3, 1.7, 0.2]];
    check("copies", &positions, &vec![[0, 1, 2]; 40_000]);
    check("points", &[[0.1, 0.2, 0.3]], &vec![[0, 0, 0]; 40_000]);
    check("points at the origin", &[[0.0; 3]], &vec![[0, 0, 0]; 20_000]);
}

#[test]
fn coincident_centroids() {
    let (p, t) = unshared((0..20_000).map(|i| {
        let s = 1.0 + i as f32 * 2.5e-4;
        [[-s, -s, 0.0], [s, -s, 0.0], [0.0, 2.0 * s, 0.0]]
    }));
    check("nested", &p, &t);
    // A factor of two each: as deep as a sensible tree can get.
    let (p, t) = unshared((0..180).map(|i| {
        let s = 2f32.powi(i - 102);
        [[-s, -s, -s], [s, -s, s], [0.0, 2.0 * s, s]]
    }));
    check("powers of two", &p, &t);
}

#[test]
fn grids_and_rows() {
    // Equal spacing gives equal unions everywhere.
    let (p, t) = unshared((0..40_000).map(|i| {
        let (x, y) = ((i % 200) as f32, (i / 200) as f32);
        [[x, y, 0.0], [x + 1.0, y, 0.0], [x, y + 1.0, 0.0]]
    }));
    check("grid", &p, &t);
    let (p, t) = unshared((0..20_000).map(|i| {
        let x = i as f32;
        [[x, 0.0, 0.0], [x + 1.0, 0.0, 0.0], [x, 1.0, 0.0]]
    }));
    check("row", &p, &t);
    // On a line: areas are all 0, and so are the triangles.
    let (p, t) = unshared(
        (0..20_000).map(|i| [[i as f32, 0.0, 0.0], [i as f32, 0.0, 0.0], [i as f32 + 1.0, 0.0, 0.0]]),
    );
    check("line", &p, &t);
}

#[test]
fn huge_tiny_and_mixed() {
    let mut state = 1u32;
    let mut random = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 8) as f32 / (1 << 23) as f32 - 1.0
    };
    let cloud: Vec<_> = (0..3000).map(|_| [0; 9].map(|_| random())).collect();
    let scaled = |scale: &dyn Fn(usize) -> f32| {
        unshared(cloud.iter().enumerate().map(|(i, x)| {
            let s = scale(i);
            [[x[0] * s, x[1] * s, x[2] * s], [x[3] * s, x[4] * s, x[5] * s], [x[6] * s, x[7] * s, x[8] * s]]
        }))
    };
    for scale in [1e24, 1e12, 1e-12, 1e-38, 1e-44] {
        let (p, t) = scaled(&|_| scale);
        check(&format!("scale {scale:e}"), &p, &t);
    }
    let (p, t) = scaled(&|i| [1.0, 1e-9, 1e24, 1e-38, 1e9][i % 5]);
    check("mixed", &p, &t);
    let (mut p, t) = scaled(&|_| 1.0);
    p.iter_mut().for_each(|p| p[1] = 0.25);
    check("flat", &p, &t);
    check("one", &p, &t[..1]);
    check("five", &p, &t[..5]);
}

#[test]
fn bad_meshes_and_refits_are_named() {
    let options = BuildOptions::default();
    assert_eq!(Bvh::build(&[[0.0; 3]], &[], &options).unwrap_err(), MeshError::Empty.into());
    let p = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];
    assert!(matches!(
        Bvh::build(&p, &[[0, 1, 3]], &options),
        Err(BuildError::Mesh(MeshError::Index { triangle: 0, vertex: 3, .. }))
    ));
    let mut bvh = Bvh::build(&p, &[[0, 1, 2]], &options).unwrap();
    let ray = Ray::new([0.2, 0.2, -1.0], [0.0, 0.0, 1.0]);
    assert!(matches!(bvh.refit(&p[..2]), Err(BuildError::Count { what: "vertices", count: 2, expected: 3 })));
    let nan = [[0.0; 3], [f32::NAN; 3], [0.0; 3]];
    assert!(matches!(bvh.refit(&nan), Err(BuildError::Mesh(MeshError::NotFinite { vertex: 1, .. }))));
    assert!(bvh.any_hit(&ray), "a refused refit must not move anything");
    bvh.refit(&p.map(|v| v.map(|x| x + 10.0))).unwrap();
    assert!(!bvh.any_hit(&ray));
}

#[test]
fn bad_placements_are_named() {
    let p = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];
    let bvh = Arc::new(Bvh::build(&p, &[[0, 1, 2]], &BuildOptions::default()).unwrap());
    let fine = Placement { bvh: 0, world_from_object: Affine3A::IDENTITY };
    let with = |world_from_object| {
        InstancedBvh::build(vec![bvh.clone()], &[fine, Placement { bvh: 0, world_from_object }]).unwrap_err()
    };
    assert_eq!(
        with(Affine3A::from_scale(Vec3::new(1.0, 0.0, 1.0))),
        BuildError::TransformSingular { instance: 1 }
    );
    assert_eq!(
        with(Affine3A::from_scale(Vec3::new(1.0, 1e-9, 1.0))),
        BuildError::TransformSingular { instance: 1 }
    );
    assert_eq!(with(Affine3A::from_scale(Vec3::ZERO)), BuildError::TransformSingular { instance: 1 });
    assert_eq!(
        with(Affine3A::from_translation(Vec3::new(0.0, f32::NAN, 0.0))),
        BuildError::TransformNotFinite { instance: 1 }
    );
    assert_eq!(
        with(Affine3A::from_translation(Vec3::new(0.0, 2e24, 0.0))),
        BuildError::TransformTooFar { instance: 1 }
    );
    let unknown = InstancedBvh::build(vec![bvh.clone()], &[Placement { bvh: 1, ..fine }]);
    assert_eq!(unknown.unwrap_err(), BuildError::BvhIndex { instance: 0, bvh: 1, bvhs: 1 });
    let mut one = InstancedBvh::build(vec![bvh.clone()], &[fine]).unwrap();
    assert!(matches!(one.refit(vec![bvh], &[]), Err(BuildError::Count { what: "instances", .. })));
    let ray = Ray::new([0.2, 0.2, -1.0], [0.0, 0.0, 1.0]);
    assert!(one.any_hit(&ray));
    let none = InstancedBvh::build(vec![], &[]).unwrap();
    assert!(!none.any_hit(&ray) && none.closest_hit(&ray).is_none() && none.bounds().is_empty());
}

#[test]
fn denormal_directions_see_large_instances() {
    // The object's ray is rounded to denormals or to nothing; either way the answer is the definition's.
    let p = vec![[-1.0, -1.0, 1.0], [1.0, -1.0, 1.0], [0.0, 1.0, 1.0]];
    let t = vec![[0u32, 1, 2]];
    let bvh = Arc::new(Bvh::build(&p, &t, &BuildOptions::default()).unwrap());
    let placements = [1f32, 1e10, 1e20]
        .map(|s| Placement { bvh: 0, world_from_object: Affine3A::from_scale(Vec3::splat(s)) });
    let instanced = InstancedBvh::build(vec![bvh], &placements).unwrap();
    for exponent in [-60, -100, -126, -140, -149] {
        let ray = Ray::new([0.0; 3], Vec3::new(0.25, 0.5, 1.0) * 2f32.powi(exponent));
        let truth = brute::closest_instance_hit(&[(&p, &t)], &placements, &ray);
        assert_eq!(instanced.closest_hit(&ray), truth);
        assert_eq!(instanced.any_hit(&ray), truth.is_some());
    }
}

#[test]
fn counters_count() {
    let (p, t) = unshared((0..1000).map(|i| {
        let x = i as f32;
        [[x, 0.0, 0.0], [x + 1.0, 0.0, 0.0], [x, 1.0, 0.0]]
    }));
    for back_end in [BackEnd::Scalar, BackEnd::Avx2, BackEnd::Avx512].into_iter().filter(|b| b.is_supported())
    {
        let bvh = Bvh::build(&p, &t, &BuildOptions::default()).unwrap().with_back_end(back_end).unwrap();
        let mut counters = Counters::default();
        assert!(bvh.any_hit_with(&Ray::new([500.25, 0.25, -1.0], [0.0, 0.0, 1.0]), &mut counters));
        assert!(counters.nodes > 1 && counters.box_tests > counters.nodes, "{counters:?}");
        assert!((1..100).contains(&counters.triangle_tests), "{counters:?}");
        let mut invalid = Counters::default();
        assert!(!bvh.any_hit_with(&Ray::new([f32::NAN; 3], [0.0, 0.0, 1.0]), &mut invalid));
        assert_eq!(invalid, Counters::default());
    }
}
