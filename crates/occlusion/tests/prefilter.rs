//! Laws of prefiltered occlusion, and what it answers to bad input.

use proptest::prelude::*;
use umbrage_accel::{BuildOptions, Bvh, Counters};
use umbrage_geom::{
    OpticalDepth, Ray, TriangleMesh,
    glam::{Mat3, Vec3},
    sampling::RandomStream,
};
use umbrage_occlusion::OcclusionError;
use umbrage_occlusion::prefilter::{
    ConeQuery, ConeRay, Directions, PrefilterOptions, Prefiltered,
    published::{Blend, Correlation, Published, SegmentEnds, Storage},
};
use umbrage_scene::generate::{Parameters, generate};

fn generated(name: &str, triangles: usize, level: u32) -> TriangleMesh {
    let parameters = Parameters { triangles: Some(triangles), level: Some(level), ..Parameters::default() };
    generate(name, &parameters).expect("known parameters").mesh
}

/// Loose random triangles in the unit cube.
fn flakes(count: usize, size: f32, seed: u32) -> (Vec<[f32; 3]>, Vec<[u32; 3]>) {
    let mut random = RandomStream::new(seed, 0);
    let mut positions = Vec::new();
    for _ in 0..count {
        let middle = Vec3::from([0, 1, 2].map(|_| random.next_unit()));
        for _ in 0..3 {
            let offset = Vec3::from([0, 1, 2].map(|_| random.next_unit() - 0.5)) * size;
            positions.push((middle + offset).clamp(Vec3::ZERO, Vec3::ONE).to_array());
        }
    }
    let triangles = (0..count as u32).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
    (positions, triangles)
}

fn build(
    positions: &[[f32; 3]],
    triangles: &[[u32; 3]],
    opacity: &[f32],
    options: &PrefilterOptions,
) -> Prefiltered {
    Prefiltered::build(positions, triangles, opacity, options, &mut |_| true).expect("good input")
}

/// Segments between random points of a box around the mesh, of every solid angle.
fn cones(mesh: &TriangleMesh, count: usize, seed: u32) -> Vec<ConeRay> {
    let (center, size) = (mesh.bounds().center(), mesh.bounds().diagonal());
    let mut random = RandomStream::new(seed, 1);
    (0..count)
        .map(|i| {
            let mut point =
                || center + (Vec3::from([0, 1, 2].map(|_| random.next_unit())) - 0.5) * 1.6 * size;
            let ray = Ray::between(point(), point());
            ConeRay { ray, solid_angle: 10f32.powi(-((i % 6) as i32)) }
        })
        .collect()
}

fn answers(scene: &Prefiltered, rays: &[ConeRay], query: &ConeQuery) -> Vec<f32> {
    let mut passed = vec![f32::NAN; rays.len()];
    scene.transmittances(rays, query, &mut passed);
    passed
}

#[test]
fn exact_queries_are_those_of_the_bvh() {
    let mesh = generated("bush", 6_000, 0);
    let opacity: Vec<f32> = (0..mesh.triangles.len()).map(|i| [1.0, 0.85, 0.3, 0.0][i % 4]).collect();
    let rays = cones(&mesh, 600, 1);
    let bvh = Bvh::build(&mesh.positions, &mesh.triangles, &BuildOptions::default()).expect("a bush");
    let depths: Vec<OpticalDepth> = opacity.iter().map(|&a| OpticalDepth::from_opacity(a)).collect();
    for storage in Storage::ALL {
        let options = PrefilterOptions::default().with_storage(storage).with_lines(2);
        let scene = build(&mesh.positions, &mesh.triangles, &opacity, &options);
        let exact = answers(&scene, &rays, &ConeQuery::EXACT);
        let narrow =
            |angle| -> Vec<ConeRay> { rays.iter().map(|r| ConeRay { solid_angle: angle, ..*r }).collect() };
        let query = ConeQuery::new(0.2).expect("above 0");
        for (i, ray) in rays.iter().enumerate() {
            let truth = bvh.transmittance(&ray.ray, |prim| depths[prim as usize]).transmittance();
            assert_eq!(exact[i].to_bits(), truth.to_bits());
        }
        for angle in [0.0, -1.0, f32::NAN] {
            assert_eq!(answers(&scene, &narrow(angle), &query), exact);
        }
        assert_eq!(answers(&scene, &rays, &ConeQuery::new(f32::INFINITY).expect("above 0")), exact);
        assert_eq!(answers(&scene, &rays, &query.with_widest(0.0).unwrap()), exact);
    }
}

#[test]
fn packets_answer_as_single_rays() {
    let mesh = generated("bush", 8_000, 0);
    let scene = build(&mesh.positions, &mesh.triangles, &[0.85], &PrefilterOptions::default());
    let mut rays = cones(&mesh, 200, 2);
    // Fans from one origin among them, and rays that are not valid.
    for i in 0..100 {
        rays[i].ray.origin = rays[i / 16 * 16].ray.origin;
    }
    rays[5].ray.direction = Vec3::ZERO;
    rays[6].ray.tfar = f32::NAN;
    for query in [0.1, 1.0].map(|t| ConeQuery::new(t).expect("above 0")) {
        let together = answers(&scene, &rays, &query);
        for (ray, &answer) in rays.iter().zip(&together) {
            assert_eq!(scene.transmittance(ray, &query).to_bits(), answer.to_bits());
        }
        assert_eq!((together[5], together[6]), (1.0, 1.0));
    }
}

#[test]
fn threads_change_nothing() {
    let mesh = generated("tentacles", 8_000, 0);
    let rays = cones(&mesh, 3_000, 3);
    let query = ConeQuery::new(0.3).expect("above 0");
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
        pool.install(|| {
            let scene = build(&mesh.positions, &mesh.triangles, &[1.0], &PrefilterOptions::default());
            answers(&scene, &rays, &query).iter().map(|x| x.to_bits()).collect::<Vec<_>>()
        })
    };
    assert_eq!(run(1), run(3));
}

#[test]
fn rays_end_early_and_stay_close_to_the_truth() {
    let mesh = generated("bush", 20_000, 1);
    for opacity in [0.85, 1.0] {
        let scene = build(&mesh.positions, &mesh.triangles, &[opacity], &PrefilterOptions::default());
        assert!(scene.stop_share() > 0.1, "{}", scene.stop_share());
        let rays: Vec<ConeRay> =
            cones(&mesh, 4_000, 4).into_iter().map(|r| ConeRay { solid_angle: 3e-3, ..r }).collect();
        let (mut few, mut many) = (Counters::default(), Counters::default());
        let mut passed = [vec![0.0; rays.len()], vec![0.0; rays.len()]];
        let query = ConeQuery::new(0.2).expect("above 0");
        scene.transmittances_with(&rays, &query, &mut passed[0], &mut few);
        scene.transmittances_with(&rays, &ConeQuery::EXACT, &mut passed[1], &mut many);
        // Exact opaque rays end early too.
        assert!(opacity == 1.0 || few.nodes * 3 < many.nodes * 2, "{} {}", few.nodes, many.nodes);
        let mean = |v: &[f32]| v.iter().sum::<f32>() / v.len() as f32;
        let bias = mean(&passed[0]) - mean(&passed[1]);
        assert!(bias.abs() < 0.02, "{opacity}: {bias}");
    }
}

/// Where rays end depends on the tree, so that single answers may rise by the error of the method; means may not.
#[test]
fn more_triangles_let_less_through() {
    let (mut positions, mut triangles) = flakes(1500, 0.08, 1);
    let options = PrefilterOptions::default();
    let query = ConeQuery::new(0.3).unwrap();
    let mut last = f64::INFINITY;
    for seed in 2..6 {
        let mesh = TriangleMesh::new(positions.clone(), triangles.clone()).unwrap();
        let scene = build(&positions, &triangles, &[0.85], &options);
        let passed = answers(&scene, &cones(&mesh, 4000, 9), &query);
        let mean = passed.iter().map(|&x| f64::from(x)).sum::<f64>() / passed.len() as f64;
        assert!(mean < last, "{mean} after {last}");
        last = mean;
        let (more, faces) = flakes(500, 0.08, seed);
        let base = positions.len() as u32;
        positions.extend(more);
        triangles.extend(faces.iter().map(|t| t.map(|v| v + base)));
    }
    assert!(last < 0.9, "{last}");
}

#[test]
fn a_closed_box_lets_nothing_out() {
    let mut mesh = generated("bush", 4_000, 0);
    let aggregate = mesh.triangles.len();
    // A light in a box beside the bush, its faces cut finely.
    let walls = generated("box", 12, 4);
    let base = mesh.positions.len() as u32;
    mesh.positions.extend(walls.positions.iter().map(|p| [p[0] + 3.0, p[1], p[2]]));
    mesh.triangles.extend(walls.triangles.iter().map(|t| t.map(|v| v + base)));
    let mut opacity = vec![0.85; aggregate];
    opacity.resize(mesh.triangles.len(), 1.0);
    let scene = build(&mesh.positions, &mesh.triangles, &opacity, &PrefilterOptions::default());
    let mut random = RandomStream::new(1, 2);
    let mut unit = || Vec3::from([0, 1, 2].map(|_| random.next_unit()));
    let rays: Vec<ConeRay> = (0..2_000)
        .map(|i| {
            let light = Vec3::new(3.0, 0.5, 0.0) + (unit() - 0.5) * 0.9;
            let receiver = (unit() - 0.5) * 20.0 + Vec3::new(0.0, 12.0, 0.0);
            ConeRay { ray: Ray::between(receiver, light), solid_angle: [1e-4, 0.01, 1.0, 6.0][i % 4] }
        })
        .collect();
    for t in [1e-6, 0.01, 0.1, 0.5, 2.0, 100.0] {
        for ends in [SegmentEnds::Fraction, SegmentEnds::Whole] {
            for widest in [ConeQuery::WIDEST, 1e3] {
                let query = ConeQuery::new(t).expect("above 0").with_ends(ends).with_widest(widest).unwrap();
                assert!(answers(&scene, &rays, &query).iter().all(|&passed| passed == 0.0), "T = {t}");
            }
        }
    }
}

#[test]
fn turning_everything_changes_little() {
    let mesh = generated("bush", 20_000, 0);
    let turn = Mat3::from_axis_angle(Vec3::new(0.3, 0.9, -0.2).normalize(), 0.7);
    let turned: Vec<[f32; 3]> = mesh.positions.iter().map(|&p| (turn * Vec3::from(p)).to_array()).collect();
    let straight = build(&mesh.positions, &mesh.triangles, &[0.85], &PrefilterOptions::default());
    let oblique = build(&turned, &mesh.triangles, &[0.85], &PrefilterOptions::default());
    let rays: Vec<ConeRay> =
        cones(&mesh, 6_000, 5).into_iter().map(|r| ConeRay { solid_angle: 0.01, ..r }).collect();
    let also: Vec<ConeRay> = rays
        .iter()
        .map(|r| ConeRay {
            ray: Ray { origin: turn * r.ray.origin, direction: turn * r.ray.direction, ..r.ray },
            ..*r
        })
        .collect();
    let query = ConeQuery::new(0.2).expect("above 0");
    let mean = |v: Vec<f32>| v.iter().sum::<f32>() / v.len() as f32;
    let (a, b) = (mean(answers(&straight, &rays, &query)), mean(answers(&oblique, &also, &query)));
    assert!((a - b).abs() < 0.01, "{a} {b}");
}

#[test]
fn refits_follow_the_vertices() {
    let mesh = generated("bush", 6_000, 0);
    let options = PrefilterOptions::default();
    let mut scene = build(&mesh.positions, &mesh.triangles, &[0.85], &options);
    let rays = cones(&mesh, 500, 6);
    let query = ConeQuery::new(0.2).expect("above 0");
    let before = answers(&scene, &rays, &query);
    scene.refit(&mesh.positions, &mut |_| true).expect("as many vertices");
    assert_eq!(answers(&scene, &rays, &query), before);
    let moved: Vec<[f32; 3]> =
        mesh.positions.iter().map(|p| [p[0] + 0.3 * p[1] * p[1], p[1], 0.8 * p[2]]).collect();
    scene.refit(&moved, &mut |_| true).expect("as many vertices");
    let fresh = build(&moved, &mesh.triangles, &[0.85], &options);
    assert_eq!(answers(&scene, &rays, &ConeQuery::EXACT), answers(&fresh, &rays, &ConeQuery::EXACT));
    let mean = |v: Vec<f32>| v.iter().sum::<f32>() / v.len() as f32;
    let (kept, new) = (mean(answers(&scene, &rays, &query)), mean(answers(&fresh, &rays, &query)));
    assert!((kept - new).abs() < 0.02, "{kept} {new}");
    assert!(matches!(scene.refit(&moved[1..], &mut |_| true), Err(OcclusionError::Build(_))));
    assert!(matches!(
        scene.refit(&vec![[f32::NAN; 3]; moved.len()], &mut |_| true),
        Err(OcclusionError::Mesh(_))
    ));
}

#[test]
fn published_opacities_agree_with_rendering() {
    let (positions, triangles) = flakes(400, 0.12, 7);
    let rendered =
        Published::build(&positions, &triangles, 0.85, 1e3, 3).expect("flakes").rendered_opacities();
    for height in [1.0, 4.0] {
        let published = Published::build(&positions, &triangles, 0.85, height, 3).expect("flakes");
        for (a, b) in published.root_opacities().iter().zip(&rendered) {
            assert!((a - b).abs() < 0.12, "K = {height}: {a} {b}");
        }
    }
}

#[test]
fn published_is_exact_where_it_must_descend() {
    let (positions, triangles) = flakes(200, 0.2, 8);
    let mesh = TriangleMesh::new(positions, triangles).expect("flakes");
    let bvh = Bvh::build(&mesh.positions, &mesh.triangles, &BuildOptions::default()).expect("flakes");
    let exact = |ray: &Ray| bvh.transmittance(ray, |_| OpticalDepth::from_opacity(0.5)).transmittance();
    let high = Published::build(&mesh.positions, &mesh.triangles, 0.5, 100.0, 3).expect("flakes");
    let low = Published::build(&mesh.positions, &mesh.triangles, 0.5, 0.0, 3).expect("flakes");
    assert!(low.height() > 4.0);
    for cone in cones(&mesh, 300, 9) {
        for (scene, threshold) in [(&high, 1e-3), (&low, f32::INFINITY)] {
            let passed = scene.transmittance(&cone, threshold).expect("above 0");
            assert!((passed - exact(&cone.ray)).abs() < 1e-5);
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]
    #[test]
    fn opacities_are_fractions_and_grow_with_triangles(
        seed in 0u32..1000, count in 8usize..60, alpha in 0f32..=1.0, height in 0f32..4.0, directions in 1u8..5,
    ) {
        let (mut positions, mut triangles) = flakes(count, 0.5, seed);
        // Two slivers keep the bounds, and so the lines.
        for corner in [[0.0f32; 3], [1.0; 3]] {
            let base = positions.len() as u32;
            positions.extend([corner, corner.map(|x| (x - 1e-3).abs()), corner]);
            triangles.push([base, base + 1, base + 2]);
        }
        let scene = Published::build(&positions, &triangles, alpha, height, directions).unwrap();
        prop_assert!(scene.opacities().iter().all(|a| (0.0..=1.0).contains(a)));
        let before = scene.rendered_opacities();
        let (more, faces) = flakes(5, 0.5, seed + 1);
        let base = positions.len() as u32;
        positions.extend(more);
        triangles.extend(faces.iter().map(|t| t.map(|v| v + base)));
        let after = Published::build(&positions, &triangles, alpha, height, directions).unwrap().rendered_opacities();
        for (a, b) in before.iter().zip(&after) {
            prop_assert!(b + 1e-6 >= *a, "{} {}", a, b);
        }
    }

    #[test]
    fn answers_are_fractions(
        seed in 0u32..1000, count in 1usize..80, flat in any::<bool>(), alpha in 0f32..=1.0,
        t in prop::sample::select(vec![1e-6f32, 0.1, 1.0, 1e6]), widest in prop::sample::select(vec![0.35f32, 1e9, 0.0]),
        storage in prop::sample::select(Storage::ALL.to_vec()), anywhere in any::<bool>(),
    ) {
        let (mut positions, triangles) = flakes(count, 0.3, seed);
        if flat {
            positions.iter_mut().for_each(|p| p[1] = 0.25);
        }
        let correlation = if anywhere { Correlation::ANYWHERE } else { Correlation::Automatic };
        let options = PrefilterOptions::default().with_storage(storage).with_lines(4).with_correlation(correlation);
        let scene = build(&positions, &triangles, &[alpha], &options);
        let mesh = TriangleMesh::new(positions, triangles).unwrap();
        let mut rays = cones(&mesh, 60, seed);
        rays[0].ray = Ray::new([0.5; 3], [1.0, 0.0, 0.0]);
        rays[1].ray = Ray::new([0.5, 0.25, 0.5], [0.0, 0.0, 1.0]).with_tfar(0.1);
        rays[2].solid_angle = f32::INFINITY;
        for blend in [Blend::Random, Blend::None] {
            let query = ConeQuery::new(t).unwrap().with_widest(widest).unwrap().with_blend(blend);
            prop_assert!(answers(&scene, &rays, &query).iter().all(|x| (0.0..=1.0).contains(x)));
        }
    }
}

#[test]
fn bad_input_has_names() {
    let (positions, triangles) = flakes(10, 0.3, 10);
    let default = PrefilterOptions::default();
    let fails = |opacity: &[f32], options: &PrefilterOptions| {
        Prefiltered::build(&positions, &triangles, opacity, options, &mut |_| true).expect_err("bad input")
    };
    for value in [-0.1, 1.1, f32::NAN] {
        let error = fails(&[value], &default);
        assert!(matches!(error, OcclusionError::Opacity { index: 0, .. }), "{error}");
    }
    assert_eq!(fails(&[], &default), OcclusionError::OpacityCount { count: 0, triangles: 10 });
    assert_eq!(fails(&[0.5; 3], &default), OcclusionError::OpacityCount { count: 3, triangles: 10 });
    for height in [-1.0, f32::NAN, f32::INFINITY] {
        let error = fails(&[1.0], &default.with_correlation(Correlation::Height(height)));
        assert!(matches!(error, OcclusionError::CorrelationHeight(_)), "{error}");
    }
    for directions in [0, 13, 255] {
        let error = fails(&[1.0], &default.with_directions(directions));
        assert!(error.to_string().contains("directions"), "{error}");
    }
    assert!(fails(&[1.0], &default.with_lines(0)).to_string().contains("lines"));
    let empty = Prefiltered::build(&[], &[], &[1.0], &default, &mut |_| true);
    assert!(matches!(empty, Err(OcclusionError::Mesh(_))));
    let cancelled = Prefiltered::build(&positions, &triangles, &[1.0], &default, &mut |_| false);
    assert!(matches!(cancelled, Err(OcclusionError::Cancelled)));
    for t in [0.0, -1.0, f32::NAN] {
        assert!(matches!(ConeQuery::new(t), Err(OcclusionError::Threshold(_))));
        assert!(matches!(ConeQuery::EXACT.with_widest(-1.0), Err(OcclusionError::Setting { .. })));
        assert!(matches!(ConeQuery::EXACT.with_widest(f32::NAN), Err(OcclusionError::Setting { .. })));
    }
    assert!(Published::build(&positions, &triangles, 2.0, 1.0, 3).is_err());
    assert!(Published::build(&positions, &triangles, 1.0, f32::NAN, 3).is_err());
    assert!(Published::build(&positions, &triangles, 1.0, 1.0, 0).is_err());
    assert_eq!(Directions::new(0), None);
}

#[test]
fn instances_dim_as_copies_do() {
    use std::sync::Arc;
    use umbrage_accel::{InstancedBvh, Placement};
    use umbrage_geom::glam::{Affine3A, Quat};
    use umbrage_occlusion::prefilter::PrefilteredInstances;

    let mesh = generated("bush", 8_000, 0);
    let map = |scale: f32, turn: f32, x: f32| {
        let rotation = Quat::from_rotation_y(turn);
        Affine3A::from_scale_rotation_translation(Vec3::splat(scale), rotation, Vec3::new(x, 0.0, 0.0))
    };
    let maps = [map(1.0, 0.0, -2.0), map(0.5, 1.0, 0.0), map(1.5, -2.0, 2.5)];
    let mut copies = TriangleMesh::default();
    for map in &maps {
        let base = copies.positions.len() as u32;
        copies.positions.extend(mesh.positions.iter().map(|&p| map.transform_point3(p.into()).to_array()));
        copies.triangles.extend(mesh.triangles.iter().map(|t| t.map(|v| v + base)));
    }
    let options = PrefilterOptions::default();
    let flat = build(&copies.positions, &copies.triangles, &[0.85], &options);
    let bvh = Bvh::build(&mesh.positions, &mesh.triangles, &BuildOptions::default()).expect("a bush");
    let placements: Vec<Placement> =
        maps.iter().map(|&world_from_object| Placement { bvh: 0, world_from_object }).collect();
    let top = InstancedBvh::build(vec![Arc::new(bvh)], &placements).expect("three bushes");
    let one = Arc::new(build(&mesh.positions, &mesh.triangles, &[0.85], &options));
    let instances = PrefilteredInstances::new(&top, vec![one.clone()], &[0; 3]).expect("as many");
    let rays: Vec<ConeRay> =
        cones(&copies, 4_000, 11).into_iter().map(|r| ConeRay { solid_angle: 0.003, ..r }).collect();
    for (query, tolerance) in [(ConeQuery::EXACT, 1e-4), (ConeQuery::new(0.2).expect("above 0"), 0.01)] {
        let mean = |v: &[f32]| v.iter().sum::<f32>() / v.len() as f32;
        let placed: Vec<f32> = rays.iter().map(|ray| instances.transmittance(ray, &query)).collect();
        let (a, b) = (mean(&placed), mean(&answers(&flat, &rays, &query)));
        assert!((a - b).abs() < tolerance, "{a} {b}");
    }
    assert!(matches!(
        PrefilteredInstances::new(&top, vec![one.clone()], &[0; 2]),
        Err(OcclusionError::InstanceCount { .. })
    ));
    assert!(matches!(
        PrefilteredInstances::new(&top, vec![one], &[0, 0, 1]),
        Err(OcclusionError::Hierarchy { instance: 2, .. })
    ));
}

#[test]
fn plans_keep_the_error_they_promise() {
    use umbrage_geom::sampling::{combine, stratified};

    let mesh = generated("bush", 20_000, 0);
    let scene = build(&mesh.positions, &mesh.triangles, &[0.85], &PrefilterOptions::default());
    let ground = |i: usize| Vec3::new((i % 16) as f32 * 0.2 - 1.6, 0.0, (i / 16) as f32 * 0.2 - 1.6);
    let fan = |i: usize, rays: u32, seed: u32, out: &mut Vec<ConeRay>| {
        let light = |s: umbrage_geom::glam::Vec2| Vec3::new(1.0 + s.x, 4.0, s.y);
        let squares = stratified(rays, combine(seed, i as u32));
        let solid_angle = 0.06 / rays as f32;
        out.extend(squares.iter().map(|&s| ConeRay { ray: Ray::between(ground(i), light(s)), solid_angle }));
    };
    let mut last = f64::INFINITY;
    for target in [0.02, 0.04, 0.08] {
        let plan = scene.plan(target, 128, fan).expect("a target");
        assert!(plan.error <= target && plan.query.threshold().is_finite(), "{plan:?}");
        assert!(plan.steps <= last, "{plan:?}");
        last = plan.steps;
        // On receivers that the pilot has not seen.
        let mut squares = 0.0;
        for i in 128..256 {
            let mean = |rays, seed, query: &ConeQuery| {
                let mut cones = Vec::new();
                fan(i, rays, seed, &mut cones);
                let passed = answers(&scene, &cones, query);
                passed.iter().sum::<f32>() / passed.len() as f32
            };
            squares += (mean(plan.rays, 9, &plan.query) - mean(900, 10, &ConeQuery::EXACT)).powi(2) / 128.0;
        }
        assert!(squares.sqrt() < 1.5 * target, "{target}: {}", squares.sqrt());
    }
    assert!(matches!(scene.plan(0.0, 128, fan), Err(OcclusionError::Target { .. })));
    assert!(matches!(scene.plan(f32::NAN, 128, fan), Err(OcclusionError::Target { .. })));
    assert!(matches!(scene.plan(0.1, 0, fan), Err(OcclusionError::Target { .. })));
}
