//! Every query of every hierarchy against the loop over all triangles.

use proptest::prelude::*;
use std::{ops::ControlFlow, sync::Arc};
use umbrage_accel::{BackEnd, BuildOptions, BuildQuality, Bvh, InstancedBvh, Placement, brute};
use umbrage_geom::{
    OpticalDepth, Ray,
    glam::{Affine3A, EulerRot, Mat3A, Quat, Vec3, Vec3A},
};

type Soup = (Vec<[f32; 3]>, Vec<[u32; 3]>);

/// Integers meet edges, vertices and planes exactly; the rest stresses rounding and range.
fn coordinate() -> impl Strategy<Value = f32> {
    prop_oneof![
        10 => (-3i8..=3).prop_map(f32::from),
        10 => -3f32..3.0,
        1 => prop::sample::select(vec![-0.0f32, 1e-40, 1e-12, 1e9, 1.000_000_1, -16_777_216.0]),
    ]
}

fn point() -> impl Strategy<Value = [f32; 3]> {
    [coordinate(), coordinate(), coordinate()]
}

/// Triangles over a few shared vertices: neighbours, copies, coplanar and degenerate ones come by themselves.
fn soup() -> impl Strategy<Value = Soup> {
    let style = prop_oneof![
        4 => Just((0u8, 1f32)),
        2 => Just((1, 1.0)),
        1 => Just((2, 1.0)),
        1 => prop::sample::select(vec![(0, 1e-12f32), (0, 1e12), (0, 1e23), (0, 1e-37)]),
    ];
    (prop::collection::vec(point(), 1..40), prop::collection::vec(any::<[u16; 3]>(), 1..120), style).prop_map(
        |(mut positions, indices, (style, scale))| {
            for (i, p) in positions.iter_mut().enumerate() {
                match style {
                    // All on a grid; all in a plane; as drawn.
                    1 => p.iter_mut().for_each(|x| *x = x.clamp(-3.0, 3.0).round()),
                    2 => p[i % 2] = 1.0,
                    _ => {}
                }
                p.iter_mut().for_each(|x| *x = (*x * scale).clamp(-1e24, 1e24));
            }
            let count = positions.len();
            let triangles = indices.iter().map(|t| t.map(|i| u32::from(i) % count as u32)).collect();
            (positions, triangles)
        },
    )
}

/// How a ray is made from a soup: origin, a target by corner weights, what to do with the result.
type Aim = ([f32; 3], [f32; 3], usize, (f32, f32), u8, u8);

fn aim() -> impl Strategy<Value = Aim> {
    let weights = prop_oneof![Just((0f32, 0f32)), Just((0.5, 0.5)), Just((0.5, 0.0)), (0f32..1.0, 0f32..1.0)];
    (point(), point(), any::<usize>(), weights, 0u8..8, 0u8..8)
}

fn make_ray((positions, triangles): &Soup, (o, d, target, (u, v), direction, ends): Aim) -> Ray {
    let corners = triangles[target % triangles.len()].map(|i| Vec3::from(positions[i as usize]));
    let on_triangle = corners[0] + (corners[1] - corners[0]) * u + (corners[2] - corners[0]) * v;
    let size = positions.iter().flatten().fold(0f32, |m, x| m.max(x.abs())).max(1e-40);
    // Mesh-sized origins: soups come in all scales.
    let origin = if direction == 7 { on_triangle } else { Vec3::from(o) * (size / 3.0).min(1e24) };
    let direction = match direction {
        0 | 1 => Vec3::from(d),
        2 => Vec3::X * d[0],
        3 => Vec3::new(-0.0, d[1], 0.0),
        _ => on_triangle - origin,
    };
    let (tnear, tfar) = match ends {
        0 => (0.0, 1.0),
        1 => (1.0, f32::INFINITY),
        2 => (0.0, 1.0f32.next_up()),
        3 => (0.5, 2.0),
        4 => (0.0, f32::NAN),
        _ => (0.0, f32::INFINITY),
    };
    Ray { origin, direction, tnear, tfar }
}

fn back_ends() -> impl Iterator<Item = BackEnd> {
    [BackEnd::Scalar, BackEnd::Avx2, BackEnd::Avx512].into_iter().filter(|b| b.is_supported())
}

/// Depths of opaque, clear and half-clear triangles.
fn depth(prim: u32) -> OpticalDepth {
    OpticalDepth::from_opacity([0.85, 0.5, 0.0, 0.3, 0.999, 0.01, 0.2][prim as usize % 7])
}

fn agrees(bvh: &Bvh, (positions, triangles): &Soup, rays: &[Ray]) -> Result<(), TestCaseError> {
    for back_end in back_ends() {
        let bvh = bvh.clone().with_back_end(back_end).unwrap();
        for ray in rays {
            let truth = brute::closest_hit(positions, triangles, ray);
            prop_assert_eq!(bvh.closest_hit(ray), truth, "{:?} {:?}", back_end, ray);
            prop_assert_eq!(bvh.any_hit(ray), truth.is_some(), "{:?} {:?}", back_end, ray);
            let (mut all, mut expected) = (Vec::new(), Vec::new());
            let _ = bvh.for_each_hit(ray, |prim, hit| {
                all.push((prim, hit));
                ControlFlow::Continue(())
            });
            let _ = brute::for_each_hit(positions, triangles, ray, |prim, hit| {
                expected.push((prim, hit));
                ControlFlow::Continue(())
            });
            all.sort_by_key(|&(prim, _)| prim);
            prop_assert_eq!(all, expected);
            for depth in [depth, |prim: u32| OpticalDepth::from_opacity(f32::from(prim.is_multiple_of(3)))] {
                let sum = bvh.transmittance(ray, depth);
                prop_assert_eq!(sum, brute::transmittance(positions, triangles, ray, depth));
            }
        }
        // Slices: as given; from one origin, more of them than a fan holds, invalid ones between; fans of narrow and of
        // short rays; fans of several origins.
        let origin = rays.first().map_or(Vec3::ZERO, |ray| ray.origin);
        let invalid = Ray { tfar: f32::NAN, ..Ray::new(origin, Vec3::X) };
        let fan: Vec<Ray> = rays.iter().map(|ray| Ray { origin, ..*ray }).chain([invalid]).collect();
        let many: Vec<Ray> = rays.iter().chain(&fan).chain(&fan).cycle().take(150).copied().collect();
        let like = |ray: &Ray, i: usize, tfar: f32| {
            let turn = Vec3::from([0, 5, 10].map(|bits| ((i as u32 * 40_503) >> bits) as f32 % 32.0 / 64.0));
            Ray { direction: ray.direction * (Vec3::ONE + turn), tfar, ..*ray }
        };
        let narrow: Vec<Ray> = (0..100).map(|i| like(&rays[i / 25 % rays.len()], i, f32::INFINITY)).collect();
        let short: Vec<Ray> = (0..100).map(|i| like(&rays[i / 50 % rays.len()], i, 1.0)).collect();
        for batch in [rays, &fan, &many, &narrow, &short] {
            let mut hits = vec![true; batch.len()];
            bvh.any_hits(batch, &mut hits);
            for (ray, hit) in batch.iter().zip(hits) {
                prop_assert_eq!(brute::any_hit(positions, triangles, ray), hit, "{:?} {:?}", back_end, ray);
            }
            let mut closest = vec![None; batch.len()];
            bvh.closest_hits(batch, &mut closest);
            for (ray, hit) in batch.iter().zip(closest) {
                prop_assert_eq!(
                    brute::closest_hit(positions, triangles, ray),
                    hit,
                    "{:?} {:?}",
                    back_end,
                    ray
                );
            }
            let mut sums = vec![OpticalDepth::OPAQUE; batch.len()];
            bvh.transmittances(batch, depth, &mut sums);
            for (ray, sum) in batch.iter().zip(sums) {
                prop_assert_eq!(brute::transmittance(positions, triangles, ray, depth), sum);
            }
        }
    }
    Ok(())
}

fn options() -> impl Strategy<Value = BuildOptions> {
    (any::<bool>(), 1u8..=8).prop_map(|(fast, leaf_size)| {
        let quality = if fast { BuildQuality::Fast } else { BuildQuality::High };
        BuildOptions::default().with_quality(quality).with_leaf_size(leaf_size)
    })
}

/// Turned, stretched, sheared, mirrored, far away.
fn transform() -> impl Strategy<Value = Affine3A> {
    let scale = prop_oneof![
        3 => Just(1f32), 1 => Just(-2.0), 1 => Just(1e-3), 1 => Just(300.0), 1 => 0.1f32..3.0,
    ];
    let distance = prop::sample::select(vec![0f32, 1.0, 10.0, 1e4, 1e6]);
    (
        [-3f32..3.0, -3f32..3.0, -3f32..3.0],
        [scale.clone(), scale.clone(), scale],
        point(),
        distance,
        -1f32..1.0,
    )
        .prop_map(|(turn, scale, to, distance, shear)| {
            let turn = Quat::from_euler(EulerRot::XYZ, turn[0], turn[1], turn[2]);
            let shear = Mat3A::from_cols(Vec3A::X, Vec3A::new(shear, 1.0, 0.0), Vec3A::Z);
            let matrix3 = Mat3A::from_quat(turn) * shear * Mat3A::from_diagonal(scale.into());
            let to = Vec3A::from(to).clamp(Vec3A::splat(-3.0), Vec3A::splat(3.0));
            Affine3A { matrix3, translation: to * distance }
        })
}

fn instances_agree(
    instanced: &InstancedBvh,
    meshes: &[Soup],
    placements: &[Placement],
    rays: &[Ray],
) -> Result<(), TestCaseError> {
    let slices: Vec<_> = meshes.iter().map(|(p, t)| (&p[..], &t[..])).collect();
    for back_end in back_ends() {
        let instanced = instanced.clone().with_back_end(back_end).unwrap();
        for ray in rays {
            let truth = brute::closest_instance_hit(&slices, placements, ray);
            prop_assert_eq!(instanced.closest_hit(ray), truth, "{:?} {:?}", back_end, ray);
            prop_assert_eq!(instanced.any_hit(ray), truth.is_some());
            let (mut all, mut expected) = (Vec::new(), Vec::new());
            let _ = instanced.for_each_hit(ray, |instance, prim, hit| {
                all.push((instance, prim, hit));
                ControlFlow::Continue(())
            });
            let mut sum = OpticalDepth::CLEAR;
            let _ = brute::for_each_instance_hit(&slices, placements, ray, |instance, prim, hit| {
                expected.push((instance, prim, hit));
                sum += depth(instance + prim);
                ControlFlow::Continue(())
            });
            all.sort_by_key(|&(instance, prim, _)| (instance, prim));
            prop_assert_eq!(all, expected);
            if sum.is_opaque() {
                sum = OpticalDepth::OPAQUE;
            }
            prop_assert_eq!(instanced.transmittance(ray, |instance, prim| depth(instance + prim)), sum);
        }
    }
    Ok(())
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(250))]
    #[test]
    fn every_query_agrees_with_brute_force(
        soup in soup(), aims in prop::collection::vec(aim(), 12), options in options(),
    ) {
        let bvh = Bvh::build(&soup.0, &soup.1, &options).unwrap();
        let rays: Vec<_> = aims.into_iter().map(|aim| make_ray(&soup, aim)).collect();
        agrees(&bvh, &soup, &rays)?;
    }

    #[test]
    fn refits_agree_with_brute_force(
        soup in soup(), moved in prop::collection::vec(point(), 40), aims in prop::collection::vec(aim(), 8),
    ) {
        let mut bvh = Bvh::build(&soup.0, &soup.1, &BuildOptions::default()).unwrap();
        let moved = (moved[..soup.0.len()].to_vec(), soup.1);
        bvh.refit(&moved.0).unwrap();
        let rays: Vec<_> = aims.into_iter().map(|aim| make_ray(&moved, aim)).collect();
        agrees(&bvh, &moved, &rays)?;
    }

    #[test]
    fn instances_agree_with_brute_force(
        meshes in [soup(), soup()], moves in prop::collection::vec((0u32..2, transform()), 0..12),
        again in prop::collection::vec(transform(), 12), aims in prop::collection::vec((aim(), 0usize..12), 8),
    ) {
        let bvhs = meshes.each_ref().map(|(p, t)| Arc::new(Bvh::build(p, t, &BuildOptions::default()).unwrap()));
        // Objects of 1e23 can't be moved on; those have their own test.
        prop_assume!(meshes.iter().flat_map(|m| m.0.as_flattened()).all(|x| x.abs() < 1e15));
        let mut placements: Vec<_> =
            moves.iter().map(|&(bvh, world_from_object)| Placement { bvh, world_from_object }).collect();
        let mut instanced = InstancedBvh::build(bvhs.to_vec(), &placements).unwrap();
        for round in 0..2 {
            let rays: Vec<_> = aims.iter().map(|&(aim, target)| {
                let ray = make_ray(&meshes[target % 2], aim);
                if placements.is_empty() || aim.5 == 7 {
                    return ray;
                }
                let map = placements[target % placements.len()].world_from_object;
                Ray {
                    origin: map.transform_point3(ray.origin),
                    direction: map.transform_vector3(ray.direction),
                    ..ray
                }
            }).collect();
            instances_agree(&instanced, &meshes, &placements, &rays)?;
            if round == 0 {
                placements.iter_mut().zip(&again).for_each(|(p, &map)| p.world_from_object = map);
                instanced.refit(bvhs.to_vec(), &placements).unwrap();
            }
        }
    }
}

/// Corners and triangles of an OBJ, faces as fans.
fn read_obj(path: &std::path::Path) -> Soup {
    let text = std::fs::read_to_string(path).unwrap();
    let (mut positions, mut triangles) = (Vec::new(), Vec::new());
    for line in text.lines() {
        let mut words = line.split_whitespace();
        match words.next() {
            Some("v") => {
                let p: Vec<f32> = words.take(3).map(|w| w.parse().unwrap()).collect();
                positions.push([p[0], p[1], p[2]]);
            }
            Some("f") => {
                let corner = |w: &str| w.split('/').next().unwrap().parse::<u32>().unwrap() - 1;
                let f: Vec<u32> = words.map(corner).collect();
                triangles.extend((2..f.len()).map(|i| [f[0], f[i - 1], f[i]]));
            }
            _ => {}
        }
    }
    (positions, triangles)
}

/// Closed meshes, where they are there: rays from inside at vertices and edges all hit, and all answers are brute force's.
#[test]
fn real_meshes_agree_and_do_not_leak() {
    let beside = concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared/meshes");
    let folder = std::env::var("UMBRAGE_MESHES").unwrap_or_else(|_| beside.into());
    let closed = std::path::Path::new(&folder).join("closed");
    for name in ["bunny_6k.obj", "sphere_1280.obj", "torus_4608.obj", "spot.obj"] {
        let path = closed.join(name);
        if !path.exists() {
            println!("SKIPPED: no {name}; set UMBRAGE_MESHES to a folder with closed/{name}");
            continue;
        }
        let soup = read_obj(&path);
        let bvh = Bvh::build(&soup.0, &soup.1, &BuildOptions::default()).unwrap();
        let corners = |t: [u32; 3]| t.map(|v| Vec3::from(soup.0[v as usize]));
        let rays: Vec<_> = (0..40usize)
            .flat_map(|i| {
                let at = |i: usize| corners(soup.1[i * 7919 % soup.1.len()]);
                let [a, b, c] = at(i);
                let [d, e, _] = at(i + 1);
                let origin = (a + b + c) / 3.0;
                [d - origin, (d + e) / 2.0 - origin, -(b - a).cross(c - a)].map(|to| Ray::new(origin, to))
            })
            .collect();
        agrees(&bvh, &soup, &rays).unwrap();
        // Convex, around the origin: whatever starts there must hit.
        if name.starts_with("sphere") {
            let center = bvh.bounds().center();
            for &[a, b, _] in &soup.1 {
                let [a, b] = [a, b].map(|v| Vec3::from(soup.0[v as usize]));
                assert!(bvh.any_hit(&Ray::new(center, a - center)), "leak at {a}");
                assert!(bvh.any_hit(&Ray::new(center, (a + b) / 2.0 - center)), "leak between {a} and {b}");
            }
        }
    }
}
