//! Method `mask` and fans against rays cast one by one: no bit may differ.

mod common;

use common::{Scene, exact, from_mesh, pattern, receivers, scene, soup};
use proptest::prelude::*;
use umbrage_accel::brute;
use umbrage_aomask::{
    BackEnd, MaskCall, MaskError, MaskOptions, Outputs, Pattern, PatternOptions, Receiver, Sides,
    exact::fans::FanCall,
};
use umbrage_geom::{Falloff, OpticalDepth, Ray, TriangleMesh, glam::Vec3, sampling::RandomStream};

fn answer(
    scene: &Scene,
    pattern: &Pattern,
    (points, normals): &common::Points,
    options: &MaskOptions,
    back_end: BackEnd,
) -> Vec<u64> {
    let (mut ao, mut out) = (vec![0.0; points.len()], vec![!0; points.len() * pattern.words()]);
    let outputs = Outputs::new(&mut ao).with_masks(&mut out);
    common::mask(&scene.bvh, pattern, (points, normals), options, back_end, outputs)
        .expect("valid arguments");
    for (ao, mask) in ao.iter().zip(out.chunks(pattern.words())) {
        let blocked: u32 = mask.iter().map(|w| w.count_ones()).sum();
        assert_eq!(*ao, (pattern.len() as u32 - blocked) as f32 / pattern.len() as f32);
    }
    out
}

fn supported() -> impl Iterator<Item = BackEnd> {
    BackEnd::ALL.into_iter().filter(|b| b.is_supported())
}

/// All bits agree with single rays, on all back ends.
fn check(scene: &Scene, pattern: &Pattern, points: &common::Points, options: &MaskOptions) {
    let expected = exact(scene, pattern, points, options);
    for back_end in supported() {
        assert!(answer(scene, pattern, points, options, back_end) == expected, "{back_end:?} {options:?}");
    }
}

#[test]
fn a_low_wall_hides_what_analysis_says_for_every_number_of_rays() {
    // A wall 0.2 high at distance 1, endless for receivers beside it: half of what is below atan(0.2) in its direction.
    let wall = [[1.0, 0.0, -2e4], [1.0, 0.0, 2e4], [1.0, 0.2, 2e4], [1.0, 0.2, -2e4]];
    let scene = soup(&[[wall[0], wall[1], wall[2]], [wall[0], wall[2], wall[3]]]);
    let hidden = 0.5 * (1.0 - 1.0 / 1.04f64.sqrt());
    let count = 4000;
    let points: common::Points = (0..count).map(|i| ([0.0, 0.0, i as f32 * 0.01], [0.0, 1.0, 0.0])).unzip();
    for rays in [8u32, 32, 64, 256, 1024] {
        let (pattern, mut ao) = (pattern(rays, Falloff::Constant), vec![0.0; count]);
        let (options, best) = (MaskOptions::default(), BackEnd::best());
        let outputs = Outputs::new(&mut ao);
        common::mask(&scene.bvh, &pattern, (&points.0, &points.1), &options, best, outputs).unwrap();
        let mean = ao.iter().map(|&x| f64::from(x)).sum::<f64>() / count as f64;
        // At most the error of independent rays.
        let error = (hidden * (1.0 - hidden) / f64::from(rays) / count as f64).sqrt();
        assert!((mean - (1.0 - hidden)).abs() < 4.0 * error, "{rays} rays: {mean}, {error}");
    }
}

#[test]
fn rays_above_a_face_have_the_bits_of_single_rays() {
    let scene = scene("city", 20_000);
    let (points, normals) = receivers(&scene.mesh, 60, 11);
    let mut random = RandomStream::new(3, 3);
    // Shading normals lean away from the faces; one is the face's own.
    let asked: Vec<Receiver> = (0..60)
        .map(|i| {
            let face = Vec3::from(normals[i]);
            let lean = Vec3::from_array(std::array::from_fn(|_| random.next_unit() - 0.5));
            let normal = if i == 0 { face } else { (face + lean).normalize() };
            Receiver::new(i, points[i], normal.to_array(), i as u32).unwrap().with_face(normals[i])
        })
        .collect();
    assert!(asked[0].face().is_none() && asked[1].face().is_some());
    for rays in [32, 288, 1024] {
        for falloff in [Falloff::Constant, Falloff::Linear] {
            let pattern = pattern(rays, falloff);
            let options = MaskOptions::default().with_radius(0.2 * scene.mesh.bounds().diagonal());
            let words = pattern.words();
            let mut expected = vec![0u64; asked.len() * words];
            let mut free = Vec::new();
            for (i, receiver) in asked.iter().enumerate() {
                let mut sum = Vec3::ZERO;
                for (k, ray) in pattern.rays_of(receiver, options.radius).enumerate() {
                    let face = receiver.face().unwrap_or(receiver.normal());
                    assert!(ray.direction.dot(face) > 4e-4, "below the face");
                    let hit = scene.bvh.any_hit(&ray);
                    expected[i * words + k / 64] |= u64::from(hit) << (k % 64);
                    sum += ray.direction * f32::from(u8::from(!hit));
                }
                free.push(sum / rays as f32);
            }
            for back_end in supported() {
                let (mut ao, mut out) = (vec![0.0; asked.len()], vec![0; expected.len()]);
                let mut directions = vec![[0.0; 3]; asked.len()];
                let outputs =
                    Outputs::new(&mut ao).with_masks(&mut out).with_free_directions(&mut directions);
                let (bvh, silent) = (&scene.bvh, &mut |_| true);
                MaskCall::new(bvh, &pattern, &asked, &options)
                    .with_back_end(back_end)
                    .answer(outputs, silent)
                    .unwrap();
                assert!(out == expected, "{rays} {back_end:?}");
                for (ours, expected) in directions.into_iter().zip(&free) {
                    assert!(Vec3::from(ours).distance(*expected) < 1e-4);
                }
            }
        }
    }
}

#[test]
fn scenes_have_the_bits_of_single_rays() {
    for (name, triangles) in [("bush", 6_000), ("hairball", 6_000), ("city", 20_000)] {
        let scene = scene(name, triangles);
        let diagonal = scene.mesh.bounds().diagonal();
        for (rays, count) in [(32, 40), (128, 40), (288, 20), (1024, 12)] {
            let pattern = pattern(rays, if rays == 288 { Falloff::Linear } else { Falloff::Constant });
            let points = receivers(&scene.mesh, count, rays);
            for radius in [0.01, 0.1, 3.0] {
                let options = MaskOptions::default().with_radius(radius * diagonal).with_seed(rays);
                check(&scene, &pattern, &points, &options);
                check(&scene, &pattern, &points, &options.with_sides(Sides::Front));
                check(&scene, &pattern, &points, &options.with_sides(Sides::FrontFirst));
            }
        }
    }
}

fn corner() -> impl Strategy<Value = [f32; 3]> {
    let x = || prop_oneof![3 => -1f32..1.0, 2 => (-2i8..3).prop_map(f32::from), 1 => Just(1e-30f32)];
    [x(), x(), x()]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(150))]
    #[test]
    fn soups_have_the_bits_of_single_rays(
        triangles in prop::collection::vec([corner(), corner(), corner()], 1..60),
        points in prop::collection::vec((corner(), corner()), 1..12),
        on_vertex in any::<bool>(), radius in prop::sample::select(vec![1e-20f32, 0.1, 1.0, 1e9, f32::INFINITY]),
        (scale, shift) in prop::sample::select(vec![(1f32, 0f32), (1e-12, 0.0), (1e12, 0.0), (1.0, 1e4)]),
        sides in prop::sample::select(vec![Sides::Both, Sides::Front, Sides::FrontFirst]), axes in any::<bool>(),
    ) {
        let place = |p: [f32; 3]| p.map(|x| x * scale + shift);
        let triangles: Vec<_> = triangles.into_iter().map(|t| t.map(place)).collect();
        let scene = soup(&triangles);
        let normal = |n: [f32; 3]| if n == [0.0; 3] { [0.0, 0.0, 1.0] } else { n };
        let mut points: common::Points = points.into_iter().map(|(p, n)| (place(p), normal(n))).unzip();
        if on_vertex && let Some(t) = triangles.first() {
            points.0[0] = t[0];
        }
        // Without jitter about an axis, many directions lie in planes of the grid.
        let options = PatternOptions::default().with_rays(96);
        let pattern = Pattern::new(&if axes { options.fixed() } else { options }).unwrap();
        check(&scene, &pattern, &points, &MaskOptions::default().with_radius(radius * scale).with_sides(sides));
    }

    #[test]
    fn fans_have_the_answers_of_single_rays(
        triangles in prop::collection::vec([corner(), corner(), corner()], 1..60),
        origins in prop::collection::vec(corner(), 1..6), per_fan in prop::sample::select(vec![1usize, 3, 16, 40, 300]),
        target in corner(), spread in prop::sample::select(vec![0f32, 0.1, 3.0]), seed in any::<u32>(),
        length in prop::sample::select(vec![1f32, 1e-30, 1e25, f32::INFINITY, f32::NAN]),
    ) {
        let scene = soup(&triangles);
        let mut random = RandomStream::new(seed, 0);
        let mut rays = Vec::new();
        for &origin in &origins {
            for _ in 0..per_fan {
                let mut near = |x: f32| x + (random.next_unit() - 0.5) * spread;
                let end = target.map(&mut near);
                rays.push(Ray::between(origin, end).with_tfar(length));
            }
        }
        let TriangleMesh { positions, triangles, .. } = &scene.mesh;
        let expected: Vec<bool> = rays.iter().map(|ray| brute::any_hit(positions, triangles, ray)).collect();
        let depth = |i: u32| OpticalDepth::from_opacity(if i.is_multiple_of(7) { 1.0 } else { 0.3 });
        let dimmed: Vec<OpticalDepth> =
            rays.iter().map(|ray| brute::transmittance(positions, triangles, ray, depth)).collect();
        for back_end in supported() {
            let mut hits = vec![true; rays.len()];
            FanCall::new(&scene.bvh, &rays, per_fan).with_back_end(back_end).any_hits(&mut hits).unwrap();
            prop_assert_eq!(&hits, &expected, "{:?}", back_end);
            let mut sums = vec![OpticalDepth::OPAQUE; rays.len()];
            FanCall::new(&scene.bvh, &rays, per_fan).with_back_end(back_end).transmittances(depth, &mut sums).unwrap();
            prop_assert_eq!(&sums, &dimmed, "{:?}", back_end);
        }
    }
}

#[test]
fn longer_rays_and_more_triangles_block_more() {
    let all = scene("bush", 4_000);
    let half = TriangleMesh::new(all.mesh.positions.clone(), all.mesh.triangles[..2_000].to_vec());
    let half = from_mesh(half.expect("part of a valid mesh"));
    let (pattern, points) = (pattern(128, Falloff::Constant), receivers(&all.mesh, 60, 1));
    let mut shorter = vec![0; points.0.len() * pattern.words()];
    for radius in [0.02, 0.1, 0.5] {
        let options = MaskOptions::default().with_radius(radius * all.mesh.bounds().diagonal());
        let of = |scene| answer(scene, &pattern, &points, &options, BackEnd::best());
        let (fewer, longer) = (of(&half), of(&all));
        assert!(shorter.iter().zip(&longer).all(|(a, b)| a & !b == 0));
        assert!(fewer.iter().zip(&longer).all(|(a, b)| a & !b == 0));
        assert!(longer != fewer && longer != shorter);
        shorter = longer;
    }
}

#[test]
fn bad_fans_are_refused() {
    let scene = soup(&[[[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]]);
    let mut rays = vec![Ray::new([0.2, 0.2, 1.0], [0.0, 0.0, -1.0]); 6];
    let hits = &mut [false; 6];
    let call =
        |rays: &[Ray], per_fan, hits: &mut [bool]| FanCall::new(&scene.bvh, rays, per_fan).any_hits(hits);
    for per_fan in [0, 4, 1025] {
        assert_eq!(call(&rays, per_fan, hits), Err(MaskError::Fan { per_fan, rays: 6 }));
    }
    assert_eq!(call(&rays, 3, &mut hits[..5]), Err(MaskError::Answers { answers: 5, rays: 6 }));
    assert_eq!(call(&rays, 3, hits), Ok(()));
    assert_eq!(*hits, [true; 6]);
    rays[4].origin += Vec3::X;
    assert_eq!(call(&rays, 3, hits), Err(MaskError::FanOrigin { fan: 1 }));
    assert_eq!(call(&[], 3, &mut []), Ok(()));
}
