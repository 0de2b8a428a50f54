//! What is made of masks besides openness: distances, transmittance, bent normals, sectors.

mod common;

use common::{Points, Scene, pattern, rays, receivers, scene, soup};
use umbrage_aomask::{
    BackEnd, MaskCall, MaskError, MaskOptions, MaskTables, Outputs, Pattern, PatternOptions, Receiver, Sides,
    TableOptions,
};
use umbrage_geom::{
    Falloff, Frame, OpticalDepth,
    glam::{Mat3, Vec3},
};

fn seeded((points, normals): &Points, options: &MaskOptions) -> Vec<Receiver> {
    let receiver = |i: usize| {
        Receiver::new(i, points[i], normals[i], Receiver::seed_of(points[i], normals[i], options.seed))
    };
    (0..points.len()).map(|i| receiver(i).unwrap()).collect()
}

fn supported() -> impl Iterator<Item = BackEnd> {
    BackEnd::ALL.into_iter().filter(|b| b.is_supported())
}

#[test]
fn distances_are_those_of_the_nearest_hits() {
    for (name, radius) in [("bush", 0.2), ("city", f32::INFINITY)] {
        let scene = scene(name, 20_000);
        let (pattern, points) = (pattern(64, Falloff::Constant), receivers(&scene.mesh, 40, 3));
        let options = MaskOptions::default().with_radius(radius * scene.mesh.bounds().diagonal());
        for back_end in supported() {
            let (mut ao, mut distances) = ([0.0; 40], [0.0; 40]);
            let outputs = Outputs::new(&mut ao).with_hit_distances(&mut distances);
            common::mask(&scene.bvh, &pattern, (&points.0, &points.1), &options, back_end, outputs).unwrap();
            for i in 0..40 {
                let hits = rays(&pattern, &points, &options, i).into_iter();
                let hits: Vec<f64> =
                    hits.filter_map(|ray| scene.bvh.closest_hit(&ray)).map(|hit| hit.t.into()).collect();
                assert_eq!(ao[i], (64 - hits.len()) as f32 / 64.0);
                let mean = hits.iter().sum::<f64>() / hits.len() as f64;
                let expected = if hits.is_empty() { f32::INFINITY } else { mean as f32 };
                assert_eq!(distances[i], expected, "{name} {back_end:?}");
            }
        }
    }
}

#[test]
fn transmittance_counts_every_triangle_once() {
    let scene = scene("bush", 4_000);
    let (pattern, points) = (pattern(96, Falloff::Constant), receivers(&scene.mesh, 40, 3));
    let depth = |i: u32| OpticalDepth::from_opacity(if i.is_multiple_of(5) { 1.0 } else { 0.4 });
    for sides in [Sides::Both, Sides::Front] {
        let options =
            MaskOptions::default().with_radius(0.3 * scene.mesh.bounds().diagonal()).with_sides(sides);
        let asked = seeded(&points, &options);
        for back_end in supported() {
            let (mut ao, mut masks, mut bent) = ([0.0; 40], [!0; 80], [[0.0; 3]; 40]);
            let outputs = Outputs::new(&mut ao).with_masks(&mut masks).with_bent_normals(&mut bent);
            MaskCall::new(&scene.bvh, &pattern, &asked, &options)
                .with_back_end(back_end)
                .transmit(depth, outputs, &mut |_| true)
                .unwrap();
            for (i, receiver) in asked.iter().enumerate() {
                let (mut sum, mut direction) = (0.0, Vec3::ZERO);
                for (k, ray) in pattern.rays_of(receiver, options.radius).enumerate() {
                    let mut depths = OpticalDepth::CLEAR;
                    let _ = scene.bvh.for_each_hit(&ray, |prim, hit| {
                        if sides == Sides::Both || hit.front {
                            depths += depth(prim);
                        }
                        std::ops::ControlFlow::Continue(())
                    });
                    sum += f64::from(depths.transmittance());
                    direction += ray.direction * depths.transmittance();
                    assert_eq!(masks[2 * i + k / 64] >> (k % 64) & 1 == 1, depths.is_opaque());
                }
                assert_eq!(ao[i], (sum / 96.0) as f32, "{sides:?} {back_end:?}");
                let bent = Vec3::from(bent[i]);
                let expected = direction.try_normalize().unwrap_or(receiver.normal());
                assert!(bent.distance(expected) < 1e-3, "{bent} {expected}");
            }
        }
    }
}

#[test]
fn sectors_and_bent_normals_look_away_from_a_wall() {
    // A high wall at x = 0.1 beside a receiver that looks up.
    let wall = [[[0.1, -1e6, -1.0], [0.1, 1e6, -1.0], [0.1, 0.0, 1e6]]];
    let scene = soup(&wall);
    let pattern = Pattern::new(&PatternOptions::default().with_rays(1024)).unwrap();
    let (points, normals) = ([[0.0; 3]], [[0.0, 0.0, 1.0]]);
    let (mut ao, mut bent, mut sectors) = ([0.0], [[0.0; 3]], [0.0; 4]);
    let outputs = Outputs::new(&mut ao).with_bent_normals(&mut bent).with_sectors(4, &mut sectors);
    let options = MaskOptions::default();
    common::mask(&scene.bvh, &pattern, (&points, &normals), &options, BackEnd::best(), outputs).unwrap();
    assert!((ao[0] - 0.5).abs() < 0.03 && bent[0][0] < -0.3, "{ao:?} {bent:?}");
    // Sectors as the documentation has them: each is open if its middle leads away from the wall.
    let Frame { tangent, bitangent, .. } = Frame::from_normal(Vec3::Z);
    for (i, open) in sectors.into_iter().enumerate() {
        let (sin, cos) = (std::f32::consts::FRAC_PI_2 * (i as f32 + 0.5)).sin_cos();
        let middle = tangent * cos + bitangent * sin;
        let expected = if middle.x.abs() < 0.01 { 0.5 } else { f32::from(u8::from(middle.x < 0.0)) };
        assert!((open - expected).abs() < 0.6, "{i}: {open}, {middle}");
    }
    assert!((sectors.iter().sum::<f32>() / 4.0 - ao[0]).abs() < 0.03, "{sectors:?}");
    let mean =
        pattern.free_direction(&Receiver::new(0, points[0], normals[0], 0).unwrap(), &[0; 16]).unwrap();
    assert!(Vec3::from(mean).distance(Vec3::Z * (2.0 / 3.0)) < 0.03, "a cosine-weighted mean: {mean:?}");
}

#[test]
fn falloff_by_lengths_agrees_with_falloff_of_distances() {
    let scene = scene("city", 20_000);
    let radius = 0.15 * scene.mesh.bounds().diagonal();
    let points = receivers(&scene.mesh, 60, 5);
    let options = MaskOptions::default().with_radius(radius);
    for falloff in [Falloff::Linear, Falloff::Quadratic, Falloff::Exponential] {
        let by_lengths = pattern(1024, falloff.clone());
        let equal = pattern(1024, Falloff::Constant);
        let mut ao = [0.0; 60];
        common::mask(
            &scene.bvh,
            &by_lengths,
            (&points.0, &points.1),
            &options,
            BackEnd::best(),
            Outputs::new(&mut ao),
        )
        .unwrap();
        let direct = |i| {
            let rays = rays(&equal, &points, &options, i);
            common::weighted(&scene, &rays, radius, &falloff)
        };
        let errors: Vec<f64> = (0..60).map(|i| f64::from(ao[i]) - direct(i)).collect();
        let (mean, rms) =
            (errors.iter().sum::<f64>() / 60.0, (errors.iter().map(|e| e * e).sum::<f64>() / 60.0).sqrt());
        assert!(mean.abs() < 2e-3 && rms < 1e-2, "{falloff:?}: mean {mean}, rms {rms}");
    }
}

#[test]
fn turning_the_scene_keeps_the_mean() {
    let still = scene("bush", 3_000);
    let points = receivers(&still.mesh, 200, 9);
    let pattern = pattern(256, Falloff::Constant);
    let options = MaskOptions::default().with_radius(0.1 * still.mesh.bounds().diagonal());
    let mean = |scene: &Scene, (points, normals): &Points| {
        let mut ao = vec![0.0; points.len()];
        common::mask(
            &scene.bvh,
            &pattern,
            (points, normals),
            &options,
            BackEnd::best(),
            Outputs::new(&mut ao),
        )
        .unwrap();
        ao.iter().map(|&x| f64::from(x)).sum::<f64>() / ao.len() as f64
    };
    let expected = mean(&still, &points);
    assert!(expected > 0.2 && expected < 0.95);
    for (x, y) in [(0.3, 1.1), (2.0, -0.7), (-1.3, 0.2)] {
        let turn = Mat3::from_rotation_x(x) * Mat3::from_rotation_y(y);
        let all = |v: &[[f32; 3]]| v.iter().map(|&p| (turn * Vec3::from(p)).to_array()).collect::<Vec<_>>();
        let mut mesh = still.mesh.clone();
        mesh.positions = all(&mesh.positions);
        let turned = mean(&common::from_mesh(mesh), &(all(&points.0), all(&points.1)));
        // 200 receivers, errors of about 0.02 each that don't depend on each other.
        assert!((turned - expected).abs() < 5e-3, "{turned} {expected}");
    }
}

#[test]
fn what_can_not_be_answered_is_refused() {
    let scene = soup(&[[[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]]);
    let pattern = pattern(32, Falloff::Constant);
    let (points, normals) = ([[0.2, 0.2, -1.0]], [[0.0, 0.0, 1.0]]);
    let options = MaskOptions::default();
    let call = |outputs: Outputs<'_>, options: &MaskOptions| {
        common::mask(&scene.bvh, &pattern, (&points, &normals), options, BackEnd::best(), outputs)
    };
    let mut ao = [-1.0];
    for count in [0, 65] {
        assert_eq!(
            call(Outputs::new(&mut ao).with_sectors(count, &mut []), &options),
            Err(MaskError::Sectors(count))
        );
    }
    let short = call(Outputs::new(&mut ao).with_sectors(4, &mut [0.0; 3]), &options);
    assert!(matches!(short, Err(MaskError::Length { what: "sectors", actual: 3, expected: 4, .. })));
    let long = call(Outputs::new(&mut ao).with_hit_distances(&mut [0.0; 2]), &options);
    assert!(matches!(long, Err(MaskError::Length { what: "hit distances", .. })));
    assert!(matches!(
        pattern.free_direction(&seeded(&(points.to_vec(), normals.to_vec()), &options)[0], &[]),
        Err(MaskError::Length { what: "mask", .. })
    ));
    let first = options.with_sides(Sides::FrontFirst);
    let asked = seeded(&(points.to_vec(), normals.to_vec()), &options);
    let veiled = MaskCall::new(&scene.bvh, &pattern, &asked, &first).transmit(
        |_| OpticalDepth::OPAQUE,
        Outputs::new(&mut ao),
        &mut |_| true,
    );
    assert!(matches!(veiled, Err(MaskError::Unsupported(_))));
    let fixed = Pattern::new(&PatternOptions::default().with_rays(32).fixed()).unwrap();
    let tables = MaskTables::new(fixed, &TableOptions::default()).unwrap();
    let outputs = Outputs::new(&mut ao);
    let refused = common::table(&tables, &scene.bvh, (&points, &normals), &first, outputs, true);
    assert!(matches!(refused, Err(MaskError::Unsupported(_))));
    let (mut far, outputs) = ([0.0], Outputs::new(&mut ao));
    let outputs = outputs.with_hit_distances(&mut far);
    let refused = common::table(&tables, &scene.bvh, (&points, &normals), &options, outputs, true);
    assert!(matches!(refused, Err(MaskError::Unsupported(_))));
    assert_eq!(ao, [-1.0]);
    // A lone triangle from behind: fronts don't face the receiver.
    let mut blocked = |sides| {
        call(Outputs::new(&mut ao), &options.with_sides(sides)).unwrap();
        ao[0] < 1.0
    };
    assert!(blocked(Sides::Both) && !blocked(Sides::Front) && !blocked(Sides::FrontFirst));
}

/// Exact beyond a distance, as far as a far field can be.
struct ExactField<'a>(&'a Scene, f32);

impl umbrage_aomask::coarse::FarField for ExactField<'_> {
    fn near(&self) -> f32 {
        self.1
    }

    fn bundle(&self) -> usize {
        1
    }

    fn transmittances(&self, cones: &umbrage_aomask::coarse::Cones, passed: &mut [f32]) {
        for ((ray, solid_angle), out) in cones.rays(self.1).zip(passed) {
            assert!(solid_angle > 0.0);
            *out = f32::from(u8::from(!self.0.bvh.any_hit(&ray)));
        }
    }
}

#[test]
fn masks_with_an_exact_far_field_are_exact() {
    let scene = scene("bush", 4_000);
    let (pattern, points) = (pattern(96, Falloff::Linear), receivers(&scene.mesh, 50, 3));
    let options = MaskOptions::default().with_radius(0.3 * scene.mesh.bounds().diagonal());
    let asked = seeded(&points, &options);
    let expected = common::exact(&scene, &pattern, &points, &options);
    let call = |near: f32, options: &MaskOptions| {
        let (mut ao, mut masks) = ([0.0; 50], [0; 100]);
        let outputs = Outputs::new(&mut ao).with_masks(&mut masks);
        MaskCall::new(&scene.bvh, &pattern, &asked, options)
            .with_far(&ExactField(&scene, near))
            .answer(outputs, &mut |_| true)
            .map(|()| masks)
    };
    for near in [0.01, 0.3, 2.0] {
        assert_eq!(call(near * options.radius, &options).unwrap().to_vec(), expected, "{near}");
    }
    for near in [0.0, -1.0, f32::NAN] {
        assert!(matches!(call(near, &options), Err(MaskError::Radius(_))));
    }
    assert!(matches!(call(1.0, &options.with_sides(Sides::Front)), Err(MaskError::Unsupported(_))));
}

/// What passes semi-transparent triangles beyond a distance, exactly.
struct ExactVeils<'a>(&'a Scene, f32);

/// Opaque ones among them.
fn veil(prim: u32) -> umbrage_geom::OpticalDepth {
    umbrage_geom::OpticalDepth::from_opacity([0.2, 0.7, 1.0][prim as usize % 3])
}

impl umbrage_aomask::coarse::FarField for ExactVeils<'_> {
    fn near(&self) -> f32 {
        self.1
    }

    fn bundle(&self) -> usize {
        1
    }

    fn transmittances(&self, cones: &umbrage_aomask::coarse::Cones, passed: &mut [f32]) {
        for ((ray, _), out) in cones.rays(self.1).zip(passed) {
            *out = self.0.bvh.transmittance(&ray, veil).transmittance();
        }
    }
}

#[test]
fn transmittances_with_an_exact_far_field_are_exact() {
    let scene = scene("bush", 4_000);
    let (pattern, points) = (pattern(96, Falloff::Linear), receivers(&scene.mesh, 50, 3));
    let options = MaskOptions::default().with_radius(0.3 * scene.mesh.bounds().diagonal());
    let asked = seeded(&points, &options);
    let (mut expected, mut blocked) = ([0.0; 50], [0; 100]);
    let outputs = Outputs::new(&mut expected).with_masks(&mut blocked);
    MaskCall::new(&scene.bvh, &pattern, &asked, &options).transmit(veil, outputs, &mut |_| true).unwrap();
    let call = |near: f32, options: &MaskOptions| {
        let (mut ao, mut masks) = ([0.0; 50], [0; 100]);
        let outputs = Outputs::new(&mut ao).with_masks(&mut masks);
        let far = ExactVeils(&scene, near);
        MaskCall::new(&scene.bvh, &pattern, &asked, options)
            .with_far(&far)
            .transmit(veil, outputs, &mut |_| true)
            .map(|()| (ao, masks))
    };
    for near in [0.01, 0.3, 2.0] {
        let (ao, masks) = call(near * options.radius, &options).unwrap();
        // Products of two rounded factors.
        let far = ao.iter().zip(&expected).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        assert!(far < 1e-6, "{near}: {far}");
        assert_eq!(masks, blocked, "{near}");
    }
    assert!(blocked.iter().any(|&word| word != 0) && expected.iter().any(|&ao| ao > 0.0 && ao < 1.0));
    assert!(matches!(call(f32::NAN, &options), Err(MaskError::Radius(_))));
    assert!(matches!(call(1.0, &options.with_sides(Sides::Front)), Err(MaskError::Unsupported(_))));
}

/// The unit cube, closed.
fn cube() -> Scene {
    let positions: Vec<[f32; 3]> =
        (0..8).map(|i| [(i & 1) as f32, (i >> 1 & 1) as f32, (i >> 2) as f32]).collect();
    let quads = [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]];
    let triangles = quads.iter().flat_map(|q| [[q[0], q[1], q[2]], [q[0], q[2], q[3]]]).collect();
    common::from_mesh(umbrage_geom::TriangleMesh::new(positions, triangles).unwrap())
}

#[test]
fn odd_receivers_and_radii_have_defined_answers() {
    let scene = cube();
    let pattern = pattern(96, Falloff::Constant);
    // In the middle; on a vertex, an edge and a face, looking in and out; far away.
    let points = [[0.5; 3], [0.0; 3], [0.0; 3], [0.5, 0.0, 0.0], [0.5, 0.5, 0.0], [0.5, 0.5, 0.0], [1e20; 3]];
    let (d, u) = ([1.0, 1.0, 1.0], [0.0, 0.0, 1.0]);
    let normals = [u, d, d.map(|x| -x), u, u, [0.0, 0.0, -1e30], u];
    let ao = |radius: f32, sides| {
        let mut ao = [-1.0; 7];
        let options = MaskOptions::default().with_radius(radius).with_sides(sides);
        let outputs = Outputs::new(&mut ao);
        let best = BackEnd::best();
        common::mask(&scene.bvh, &pattern, (&points, &normals), &options, best, outputs).map(|()| ao)
    };
    let all = ao(f32::INFINITY, Sides::Both).unwrap();
    assert_eq!([all[0], all[6]], [0.0, 1.0]);
    // Rays in the plane of a face don't hit it; those that look out of the cube are free.
    assert_eq!([all[4], all[5]], [0.0, 1.0]);
    assert!(all[1] < all[2] && all.iter().all(|x| (0.0..=1.0).contains(x)), "{all:?}");
    assert_eq!(ao(1e9 * 2.0, Sides::Both).unwrap(), all);
    assert_eq!(ao(1e-30, Sides::Both).unwrap()[0], 1.0);
    // From inside only backs are seen.
    for sides in [Sides::Front, Sides::FrontFirst] {
        assert_eq!(ao(f32::INFINITY, sides).unwrap()[0], 1.0);
    }
    for radius in [0.0, -1.0, f32::NAN, f32::NEG_INFINITY] {
        assert!(matches!(ao(radius, Sides::Both), Err(MaskError::Radius(_))));
    }
    let falling = common::pattern(32, Falloff::Linear);
    let unbounded = MaskOptions::default();
    let (mut one, best) = ([0.0; 7], BackEnd::best());
    let refused =
        common::mask(&scene.bvh, &falling, (&points, &normals), &unbounded, best, Outputs::new(&mut one));
    assert_eq!(refused, Err(MaskError::FalloffWithoutRadius));
}

#[test]
fn degenerate_triangles_block_nothing_and_empty_scenes_are_refused() {
    let flat = soup(&[[[0.0; 3]; 3], [[0.0, 0.0, 1.0], [0.0, 1.0, 1.0], [0.0, 2.0, 1.0]]]);
    let (mut ao, pattern) = ([0.0; 2], pattern(64, Falloff::Constant));
    let (points, normals) = ([[0.0; 3], [0.0, 1.0, 1.0]], [[0.0, 0.0, 1.0]; 2]);
    let (options, best) = (MaskOptions::default(), BackEnd::best());
    common::mask(&flat.bvh, &pattern, (&points, &normals), &options, best, Outputs::new(&mut ao)).unwrap();
    assert_eq!(ao, [1.0; 2]);
    assert!(umbrage_accel::Bvh::build(&[], &[], &umbrage_accel::BuildOptions::default()).is_err());
    // No receivers are no trouble.
    common::mask(&flat.bvh, &pattern, (&[], &[]), &options, best, Outputs::new(&mut [])).unwrap();
}

#[test]
fn bad_patterns_and_receivers_are_named() {
    for rays in [0, Pattern::MAX_RAYS + 1] {
        let refused = Pattern::new(&PatternOptions::default().with_rays(rays));
        assert!(matches!(refused, Err(MaskError::Rays { rays: n, .. }) if n == rays));
    }
    // Patterns that masks can't have.
    for rays in [1, 31, 33, 1032] {
        let pattern = Pattern::new(&PatternOptions::default().with_rays(rays)).unwrap();
        let (scene, options, best) = (cube(), MaskOptions::default(), BackEnd::best());
        let mut ao = [-1.0];
        let (outputs, up) = (Outputs::new(&mut ao), [[0.0, 0.0, 1.0]]);
        let refused = common::mask(&scene.bvh, &pattern, (&[[0.0; 3]], &up), &options, best, outputs);
        assert!(matches!(refused, Err(MaskError::Rays { rays: n, .. }) if n == rays));
    }
    for table in [vec![0.5, 0.8], vec![1.0, f32::NAN, 0.0], vec![]] {
        let options = PatternOptions::default().with_falloff(Falloff::Table(table));
        assert!(matches!(Pattern::new(&options), Err(MaskError::Falloff(_))));
    }
    let (scene, pattern) = (cube(), pattern(32, Falloff::Constant));
    let mut ao = [-1.0; 2];
    let mut call = |points: &[[f32; 3]], normals: &[[f32; 3]]| {
        let (options, best) = (MaskOptions::default(), BackEnd::best());
        let outputs = Outputs::new(&mut ao);
        common::mask(&scene.bvh, &pattern, (points, normals), &options, best, outputs)
    };
    let up = [0.0, 0.0, 1.0];
    for bad in [[0.0; 3], [f32::NAN, 0.0, 0.0], [f32::INFINITY, 0.0, 0.0]] {
        assert!(matches!(call(&[[0.0; 3]; 2], &[up, bad]), Err(MaskError::Normal { index: 1, .. })));
    }
    for bad in [[f32::NAN; 3], [f32::INFINITY, 0.0, 0.0], [1e30; 3]] {
        assert!(matches!(call(&[bad, [0.0; 3]], &[up; 2]), Err(MaskError::Point { index: 0, .. })));
    }
    assert!(matches!(call(&[[0.0; 3]; 2], &[up]), Err(MaskError::Length { what: "normals", .. })));
    assert_eq!(ao, [-1.0; 2]);
}
