//! Masks against the rays that they answer.

use super::*;
use umbrage_scene::generate::{Parameters, generate};

/// A record of dumped rays, and whether the ray was found blocked.
fn dumped(record: &[u8]) -> (Ray, bool) {
    let word = |i: usize| <[u8; 4]>::try_from(&record[4 * i..][..4]).unwrap();
    let f = |i: usize| f32::from_le_bytes(word(i));
    let (origin, direction) = (Vec3::new(f(0), f(1), f(2)), Vec3::new(f(4), f(5), f(6)));
    (Ray { origin, tnear: f(3), direction, tfar: f(7) }, u32::from_le_bytes(word(8)) == 1)
}

#[test]
fn masks_have_the_answers_of_their_rays() {
    let (globe, floor) = (sphere(10), quad([-4.0, -1.01, 4.0], [8.0, 0.0, 0.0], [0.0, 0.0, -8.0]));
    let solid = Occluders::of_meshes(&[&globe, &floor], Ground::Absent, &mut |_| true).unwrap();
    let veiled =
        Occluders::of_meshes(&[&globe, &transparent(floor.clone(), 0.4)], Ground::Absent, &mut |_| true)
            .unwrap();
    let map = TexelMap::new(&globe, 24, 12, VAxis::Up).unwrap();
    let all = [
        Receivers::vertices(&globe, NormalSource::Smooth).unwrap(),
        Receivers::vertices(&globe, NormalSource::Geometric).unwrap(),
        map.receivers(&globe, NormalSource::Smooth).unwrap(),
    ];
    let methods = [(AoMethod::MaskTable, 0.02), (AoMethod::Mask, 0.0)];
    for ((receivers, (method, most)), occluders) in
        all.iter().flat_map(|r| methods.map(|m| (r, m))).zip([&solid, &solid, &solid, &veiled].iter().cycle())
    {
        if method == AoMethod::MaskTable && !occluders.is_opaque() {
            continue;
        }
        let options = BakeOptions::default().with_rays(256).with_radius(Radius::Absolute(3.0));
        let mut reference = vec![0.0; receivers.len()];
        Bake::new(occluders, receivers, &options).run(&mut reference, &mut |_| true).unwrap();
        let masks =
            |shard, ao: &mut [f32], dump: Option<&mut dyn std::io::Write>, bent: Option<&mut [[f32; 3]]>| {
                let options = options.clone().with_method(method);
                let mut call = Bake::new(occluders, receivers, &options).with_shard(shard);
                if let Some(out) = dump {
                    call = call.with_rays_to(out);
                }
                if let Some(bent) = bent {
                    call = call.with_bent_normals(bent);
                }
                call.run(ao, &mut |_| true).unwrap();
            };
        let (mut ao, mut rays) = (vec![f32::NAN; receivers.len()], Vec::new());
        let mut bent = vec![[f32::NAN; 3]; receivers.len()];
        masks(Shard::WHOLE, &mut ao, Some(&mut rays), Some(&mut bent));
        let error = ao.iter().zip(&reference).map(|(a, b)| (a - b).abs()).sum::<f32>() / ao.len() as f32;
        let least = reference.iter().copied().fold(1.0, f32::min);
        assert!(error < 0.015 && least < 0.8, "error {error}, least {least}, {method:?}");
        assert!(bent.iter().all(|&n| (Vec3::from(n).length() - 1.0).abs() < 1e-5));
        let mut parts = vec![f32::NAN; receivers.len()];
        for index in 1..=3 {
            masks(Shard::new(index, 3).unwrap(), &mut parts, None, None);
        }
        let close = |(a, b): (&f32, &f32)| (a - b).abs() < 1e-6;
        assert!(parts.iter().zip(&ao).all(close), "{method:?}");
        // The rays written down, cast one by one; semi-transparent triangles let all of them pass.
        let count = rays.len() / 36;
        assert!(count >= receivers.len() * 256 && count.is_multiple_of(256));
        let (mut differ, mut passed) = (0, Vec::new());
        for record in rays.chunks(36) {
            let (ray, blocked) = dumped(record);
            assert!(ray.is_valid() && ray.tfar == 3.0);
            let depth = occluders.transmittance(&ray, &mut ());
            differ += usize::from((depth == 0.0) != blocked);
            passed.push(depth);
        }
        assert!(differ as f64 <= most * count as f64, "{method:?}: {differ} of {count}");
        if method == AoMethod::Mask && count == receivers.len() * 256 {
            // Dumped in the order of receivers that a bake has.
            let mut means: Vec<f32> = passed
                .chunks(256)
                .map(|p| (p.iter().map(|&x| f64::from(x)).sum::<f64>() / 256.0) as f32)
                .collect();
            let mut sorted = ao.clone();
            means.sort_by(f32::total_cmp);
            sorted.sort_by(f32::total_cmp);
            assert_eq!(means, sorted);
        }
    }
}

/// A bush of half-transparent leaves above a ground.
#[test]
fn stored_opacity_of_semi_transparent_leaves_is_close_to_masks() {
    let parameters = Parameters { triangles: Some(6000), ..Parameters::default() };
    let bush = transparent(generate("bush", &parameters).unwrap().mesh, 0.5);
    let low = bush.bounds().min.y - 1e-3;
    let floor = quad([-4.0, low, 4.0], [8.0, 0.0, 0.0], [0.0, 0.0, -8.0]);
    let occluders = Occluders::of_meshes(&[&bush, &floor], Ground::Absent, &mut |_| true).unwrap();
    assert!(!occluders.is_opaque());
    let mut is_used = false;
    let on_floor = TexelMap::new(&floor, 40, 40, VAxis::Up).unwrap();
    for receivers in [
        Receivers::vertices(&bush, NormalSource::Smooth).unwrap(),
        on_floor.receivers(&floor, NormalSource::Geometric).unwrap(),
    ] {
        let bake = |method: AoMethod, shards: u32| {
            let options = BakeOptions::default().with_rays(64).with_method(method);
            let mut ao = vec![f32::NAN; receivers.len()];
            for index in 1..=shards {
                let call = Bake::new(&occluders, &receivers, &options);
                call.with_shard(Shard::new(index, shards).unwrap()).run(&mut ao, &mut |_| true).unwrap();
            }
            ao
        };
        let mean = |ao: &[f32]| ao.iter().map(|&ao| f64::from(ao)).sum::<f64>() / ao.len() as f64;
        let (exact, stored) = (bake(AoMethod::Mask, 1), bake(AoMethod::MaskPrefilter, 1));
        let [exact_mean, stored_mean] = [&exact, &stored].map(|ao| mean(ao));
        assert!((exact_mean - stored_mean).abs() < 0.005, "{exact_mean} {stored_mean}");
        assert!(exact_mean < 0.97, "{exact_mean}");
        is_used |= exact != stored;
        let bits = |ao: &[f32]| ao.iter().map(|ao| ao.to_bits()).collect::<Vec<_>>();
        assert_eq!(bits(&bake(AoMethod::MaskPrefilter, 3)), bits(&stored));
    }
    assert!(is_used, "all rays were exact");
}

#[test]
fn convex_surfaces_are_open_to_masks_around_shading_normals() {
    let globe = sphere(6);
    let occluders = Occluders::of_meshes(&[&globe], Ground::Absent, &mut |_| true).unwrap();
    let receivers =
        TexelMap::new(&globe, 16, 8, VAxis::Up).unwrap().receivers(&globe, NormalSource::Smooth).unwrap();
    let mut ao = vec![f32::NAN; receivers.len()];
    let options = BakeOptions::default().with_rays(1024).with_method(AoMethod::Mask);
    Bake::new(&occluders, &receivers, &options).run(&mut ao, &mut |_| true).unwrap();
    assert!(ao.iter().all(|&ao| ao == 1.0));
}

#[test]
fn rays_that_start_inside_are_free_where_fronts_must_come_first() {
    let globe = sphere(6);
    let occluders = Occluders::of_meshes(&[&globe], Ground::Absent, &mut |_| true).unwrap();
    let receivers = Receivers::from_points(&[[0.0; 3], [0.0, 3.0, 0.0]], &[UP, [0.0, -1.0, 0.0]]).unwrap();
    let options = BakeOptions::default().with_sides(Sides::FrontFirst);
    let (mut by_rays, mut by_masks) = ([0.0; 2], [0.0; 2]);
    Bake::new(&occluders, &receivers, &options).run(&mut by_rays, &mut |_| true).unwrap();
    let options = options.with_method(AoMethod::Mask);
    Bake::new(&occluders, &receivers, &options).run(&mut by_masks, &mut |_| true).unwrap();
    for ao in [by_rays, by_masks] {
        assert!(ao[0] == 1.0 && (ao[1] - 8.0 / 9.0).abs() < 0.03, "{ao:?}");
    }
}

fn is_unsupported(error: &BakeError, word: &str) -> bool {
    matches!(error, BakeError::Query(QueryError::Unsupported { reason, .. }) if reason.contains(word))
}

#[test]
fn masks_name_what_they_cannot_do() {
    let globe = sphere(4);
    let receivers = Receivers::vertices(&globe, NormalSource::Smooth).unwrap();
    let mut ao = vec![-1.0; receivers.len()];
    let opaque = Occluders::of_meshes(&[&globe], Ground::Absent, &mut |_| true).unwrap();
    let veil =
        Occluders::of_meshes(&[&transparent(globe.clone(), 0.5)], Ground::Absent, &mut |_| true).unwrap();
    let mut call = |occluders: &Occluders, rays: u32, method, sides, go_on: bool| {
        let options = BakeOptions::default().with_rays(rays).with_sides(sides).with_method(method);
        Bake::new(occluders, &receivers, &options).run(&mut ao, &mut |_| go_on)
    };
    for method in [AoMethod::MaskTable, AoMethod::Mask] {
        let odd = call(&opaque, 33, method, Sides::Both, true);
        assert!(matches!(odd, Err(BakeError::Mask(umbrage_aomask::MaskError::Rays { rays: 33, .. }))));
        assert!(matches!(call(&opaque, 64, method, Sides::Both, false), Err(BakeError::Cancelled)));
        let error = call(&veil, 64, method, Sides::FrontFirst, true).unwrap_err();
        assert!(is_unsupported(&error, "semi-transparent"), "{error}");
    }
    let error = call(&veil, 64, AoMethod::MaskTable, Sides::Both, true).unwrap_err();
    assert!(is_unsupported(&error, "semi-transparent"), "{error}");
    let error = call(&opaque, 64, AoMethod::MaskRaster, Sides::Both, true).unwrap_err();
    assert!(is_unsupported(&error, "camera"), "{error}");
    let error = call(&opaque, 64, AoMethod::Prefilter, Sides::Front, true).unwrap_err();
    assert!(is_unsupported(&error, "both sides"), "{error}");
    assert!(ao.iter().all(|&ao| ao == -1.0));
}
