//! Known integrals, uniformity, stratification, ranges and golden values.

use super::*;
use glam::{Vec2, Vec3};
use proptest::prelude::*;
use std::f64::consts::PI;

const N: u32 = 1 << 14;

fn squares() -> impl Iterator<Item = Vec2> {
    (0..N).map(|i| sobol_2d(i, 3, 77))
}

/// Mean of `f` over the Sobol points.
fn mean(f: impl Fn(Vec2) -> f64) -> f64 {
    squares().map(f).sum::<f64>() / f64::from(N)
}

/// Fails unless counts that should be equal differ less than chance explains: chi-square beyond 6 sigma.
fn assert_even(counts: &[u32]) {
    let expected = counts.iter().sum::<u32>() as f64 / counts.len() as f64;
    let chi2: f64 = counts.iter().map(|&c| (f64::from(c) - expected).powi(2) / expected).sum();
    let freedom = counts.len() as f64 - 1.0;
    assert!(
        chi2 < freedom + 6.0 * (2.0 * freedom).sqrt(),
        "chi-square {chi2} for {freedom} degrees of freedom"
    );
}

/// Bits that must not change: scenes rendered with a seed depend on them.
#[test]
fn golden_bits() {
    let floats = |v: &[f32]| v.iter().map(|x| x.to_bits()).collect::<Vec<_>>();
    let rectangle = SphericalRectangle::new(Vec3::ZERO, Vec3::new(-1.0, 0.5, 2.0), Vec3::X * 3.0, Vec3::Y);
    let square = Vec2::new(0.3, 0.7);
    let mut random = RandomStream::new(5, 6);
    let actual = [
        vec![hash(0), hash(1), combine(1, 2), pixel_seed(3, 4, 5), random.next_bits(), random.next_bits()],
        floats(&[sobol(0, 0, 0), sobol(5, 1, 9), sobol(70_000, 300, 9)]),
        floats(&sobol_4d(11, 2, 3)),
        floats(&concentric_disc(square).to_array()),
        floats(&uniform_sphere(square).to_array()),
        floats(&rectangle.sample(square).unwrap().direction.to_array()),
        floats(&SphereLight::new(Vec3::ZERO, Vec3::ONE, 0.5).sample(square).unwrap().point.to_array()),
    ];
    for (a, g) in actual.iter().zip(GOLDEN) {
        assert_eq!(a, g, "all: {actual:?}");
    }
}

const GOLDEN: [&[u32]; 7] = [
    &[0xfd42f46a, 0xa6f2487a, 0xd6acc1ac, 0x60391de5, 0x3007e502, 0x31f48aef],
    &[0x3f01d944, 0x3dc4edd0, 0x3e9e23c8],
    &[0x3f4796ca, 0x3f44718c, 0x3f6071f4, 0x3f5f5926],
    &[0xbe90d0be, 0x3e90d0bd],
    &[0xbf005429, 0xbe549f45, 0x3f570a40],
    &[0xbdab3fa2, 0x3efb7e8a, 0x3f5df54c],
    &[0x3f1ebc7c, 0x3f5401c3, 0x3f395f20],
];

#[test]
fn hashes_and_streams_are_even() {
    let mut counts = vec![0; 256];
    (0..1u32 << 16).for_each(|i| counts[(hash(i) >> 24) as usize] += 1);
    assert_even(&counts);
    counts.fill(0);
    (0..256).for_each(|y| (0..256).for_each(|x| counts[(pixel_seed(x, y, 0) & 255) as usize] += 1));
    assert_even(&counts);
    // First numbers of neighbouring streams, in pairs.
    counts.fill(0);
    for seed in 0..1 << 14 {
        let (a, b) = (RandomStream::new(seed, 0).next_below(16), RandomStream::new(seed, 1).next_below(16));
        counts[(16 * a + b) as usize] += 1;
    }
    assert_even(&counts);
    // Every flipped input bit flips each output bit half of the time.
    for bit in 0..32 {
        let flips: u32 =
            (0..4096).map(|i| (hash(i * 7919) ^ hash((i * 7919) ^ (1 << bit))).count_ones()).sum();
        assert!((f64::from(flips) / 4096.0 - 16.0).abs() < 0.4, "bit {bit}");
    }
}

/// One point in each dyadic rectangle of area `1 / points.len()`.
fn assert_net(points: &[Vec2]) {
    let bits = points.len().trailing_zeros();
    for x_bits in 0..=bits {
        let (columns, rows) = (1u32 << x_bits, 1u32 << (bits - x_bits));
        let mut seen = vec![false; points.len()];
        for p in points {
            let cell = (p.x * columns as f32) as u32 + columns * (p.y * rows as f32) as u32;
            assert!(
                !std::mem::replace(&mut seen[cell as usize], true),
                "{columns} x {rows}: two points in {cell}"
            );
        }
    }
}

#[test]
fn sobol_pairs_are_nets() {
    for (pair, seed) in [(0, 0), (1, 0), (2, 99), (1_000_000, 5)] {
        for block in [0u32, 256, 1 << 16, 7 << 16] {
            let points: Vec<_> = (block..block + 256).map(|i| sobol_2d(i, pair, seed)).collect();
            assert_net(&points);
        }
    }
    // Four dimensions: the box test of the lowest bits, one point of 16 in each half-space combination of two.
    for d in 0..4 {
        let mut column: Vec<u32> = (0..64).map(|i| (sobol(i, d + 8, 4) * 64.0) as u32).collect();
        column.sort_unstable();
        assert!(column.into_iter().eq(0..64));
    }
}

#[test]
fn sobol_sets_runs_and_seeds_are_unrelated() {
    let correlation = |f: &dyn Fn(u32) -> (f32, f32)| {
        (0..4096).map(f).map(|(a, b)| (f64::from(a) - 0.5) * (f64::from(b) - 0.5)).sum::<f64>() / 4096.0
            * 12.0
    };
    assert!(correlation(&|i| (sobol(i, 0, 1), sobol(i, 4, 1))).abs() < 0.06);
    assert!(correlation(&|i| (sobol(i, 0, 1), sobol(i, 0, 2))).abs() < 0.06);
    assert!(correlation(&|i| (sobol(i, 0, 1), sobol(i + (1 << 16), 0, 1))).abs() < 0.06);
    assert!(correlation(&|i| (sobol(i, 0, 1), sobol_2d(i, 0, 1).x)).abs() < 0.06);
    assert!(correlation(&|i| (sobol_2d(i, 0, 1).x, sobol_2d(i, 1, 1).x)).abs() < 0.06);
}

#[test]
fn stratified_points_fill_their_cells() {
    assert!(stratified(0, 1).is_empty());
    for n in [1, 2, 3, 7, 16, 23, 100, 1000] {
        let points = stratified(n, 5);
        assert_eq!(points.len(), n as usize);
        let rows = f64::from(n).sqrt().round() as u32;
        let mut i = 0;
        for row in 0..rows {
            let (start, end) = (row * n / rows, (row + 1) * n / rows);
            for column in 0..end - start {
                let (x, y) = (f64::from(points[i].x), f64::from(points[i].y));
                let left = x * f64::from(end - start) - f64::from(column);
                assert!((-1e-5..1.0 + 1e-5).contains(&left));
                let up = (y * f64::from(n) - f64::from(start)) / f64::from(end - start);
                assert!((-1e-5..1.0 + 1e-5).contains(&up));
                i += 1;
            }
        }
    }
}

#[test]
fn moments_of_the_maps() {
    let close = |value: f64, truth: f64| assert!((value - truth).abs() < 2e-4, "{value} instead of {truth}");
    close(mean(|s| f64::from(concentric_disc(s).length_squared())), 0.5);
    close(mean(|s| f64::from(concentric_disc(s).x * concentric_disc(s).x)), 0.25);
    close(mean(|s| f64::from(concentric_disc(s).y)), 0.0);
    close(mean(|s| f64::from(cosine_hemisphere(s).z)), 2.0 / 3.0);
    close(mean(|s| f64::from(cosine_hemisphere(s).z).powi(2)), 0.5);
    close(mean(|s| f64::from(uniform_hemisphere(s).z)), 0.5);
    close(mean(|s| f64::from(uniform_hemisphere(s).x).powi(2)), 1.0 / 3.0);
    close(mean(|s| f64::from(uniform_sphere(s).z)), 0.0);
    close(mean(|s| f64::from(uniform_sphere(s).y).powi(2)), 1.0 / 3.0);
    close(mean(|s| f64::from(triangle(s).x)), 1.0 / 3.0);
    close(mean(|s| f64::from(triangle(s).x * triangle(s).y)), 1.0 / 12.0);
    let corner = |s| parallelogram(Vec3::ONE, Vec3::new(2.0, 1.0, 0.0), Vec3::Z, s);
    close(mean(|s| f64::from(corner(s).x)), 2.0);
    close(mean(|s| f64::from(corner(s).z)), 1.5);
}

#[test]
fn maps_are_uniform() {
    let count = |cell: &dyn Fn(Vec2) -> u32| {
        let mut counts = vec![0; 256];
        // Independent points, so that the chi-square test applies as it stands.
        let mut random = RandomStream::new(8, 8);
        for _ in 0..1 << 16 {
            counts[cell(Vec2::new(random.next_unit(), random.next_unit())) as usize] += 1;
        }
        assert_even(&counts);
    };
    let turn = |x: f32, y: f32| ((y.atan2(x) / std::f32::consts::TAU + 0.5) * 16.0).min(15.9) as u32;
    let bin = |x: f32| (16.0 * x).clamp(0.0, 15.9) as u32;
    count(&|s| {
        let d = concentric_disc(s);
        bin(d.length_squared()) + 16 * turn(d.x, d.y)
    });
    count(&|s| {
        let d = uniform_hemisphere(s);
        bin(d.z) + 16 * turn(d.x, d.y)
    });
    count(&|s| {
        let d = uniform_sphere(s);
        bin(0.5 * d.z + 0.5) + 16 * turn(d.y, d.x)
    });
    count(&|s| {
        // The share of the triangle left of x is 1 - (1 - x)^2; y is uniform on the rest of its line.
        let b = triangle(s);
        bin(1.0 - (1.0 - b.x) * (1.0 - b.x)) + 16 * bin(b.y / (1.0 - b.x))
    });
}

/// Solid angle of a rectangle by the corner formula of the literature on configuration factors, in the plane z = h.
fn solid_angle_by_corners(x: [f64; 2], y: [f64; 2], h: f64) -> f64 {
    let corner = |x: f64, y: f64| (x * y).atan2(h * (x * x + y * y + h * h).sqrt());
    corner(x[1], y[1]) - corner(x[0], y[1]) - corner(x[1], y[0]) + corner(x[0], y[0])
}

#[test]
fn rectangle_solid_angles() {
    // A face of a cube around the receiver sees a sixth of everything.
    let face = SphericalRectangle::new(Vec3::ZERO, Vec3::new(-1.0, -1.0, 1.0), 2.0 * Vec3::X, 2.0 * Vec3::Y);
    assert!((f64::from(face.solid_angle()) - 4.0 * PI / 6.0).abs() < 1e-6);
    assert!(!face.is_front());
    // Far away: area over squared distance, in full precision.
    let far = SphericalRectangle::new(Vec3::ZERO, Vec3::new(1e6, 0.0, 0.0), Vec3::Y * 1e-2, Vec3::Z * 1e-2);
    assert!((f64::from(far.solid_angle()) / 1e-16 - 1.0).abs() < 1e-6);
    // Seen from very near, all but a hemisphere.
    let near =
        SphericalRectangle::new(Vec3::ZERO, Vec3::new(-1.0, -1.0, -1e-6), Vec3::X * 2.0, Vec3::Y * 2.0);
    assert!(near.is_front());
    assert!((f64::from(near.solid_angle()) - 2.0 * PI).abs() < 1e-5);
}

#[test]
fn rectangles_are_sampled_evenly_in_solid_angle() {
    let cases = [
        // Ordinary; very near; thin and grazing; small and far: both inversions.
        (Vec3::new(-0.3, 0.4, 1.0), 2.0, 0.5),
        (Vec3::new(-1.0, -2.0, 1e-3), 3.0, 4.0),
        (Vec3::new(-1.0, 0.5, 1e-6), 3.0, 4.0),
        (Vec3::new(30.0, 40.0, 10.0), 0.01, 0.02),
    ];
    for (corner, w, h) in cases {
        let rectangle = SphericalRectangle::new(Vec3::ZERO, corner, Vec3::X * w, Vec3::Y * h);
        let (c, w, h) = (corner.as_dvec3(), f64::from(w), f64::from(h));
        let share = |x: f64, y: f64| solid_angle_by_corners([c.x, c.x + x], [c.y, c.y + y], c.z);
        let total = share(w, h);
        assert!((f64::from(rectangle.solid_angle()) / total - 1.0).abs() < 1e-5);
        // The share of samples in every corner piece is its share of the solid angle.
        let samples: Vec<_> = squares().map(|s| rectangle.sample(s).unwrap()).collect();
        for (fx, fy) in [(0.25, 1.0), (1.0, 0.3), (0.5, 0.5), (0.9, 0.1), (0.01, 0.6)] {
            let inside = |s: &&LightSample| {
                let p = s.point.as_dvec3() - c;
                p.x < fx * w && p.y < fy * h
            };
            let counted = samples.iter().filter(inside).count() as f64 / f64::from(N);
            assert!((counted - share(fx * w, fy * h) / total).abs() < 3e-3, "{corner} {fx} {fy}: {counted}");
        }
    }
}

#[test]
fn spheres_by_solid_angle() {
    // The irradiance of a sphere straight above is pi (R / h)^2 at any distance: mean of cos / (pdf pi).
    for (height, radius) in [(2f32, 1f32), (1e6, 1.0), (1e15, 1e-2), (1.0 + 1e-6, 1.0)] {
        let sphere = SphereLight::new(Vec3::ZERO, Vec3::new(0.0, 0.0, height), radius);
        let factor =
            mean(|s| sphere.sample(s).map_or(0.0, |s| f64::from(s.direction.z) / (f64::from(s.pdf) * PI)));
        let truth = (f64::from(radius) / f64::from(height)).powi(2);
        assert!((factor / truth - 1.0).abs() < 1e-4, "{height} {radius}: {factor} instead of {truth}");
    }
    let inside = SphereLight::new(Vec3::ZERO, Vec3::new(0.0, 0.5, 0.0), 1.0);
    assert!(inside.is_inside());
    for s in squares().take(1000) {
        let s = inside.sample(s).unwrap();
        assert!((s.point.distance(Vec3::new(0.0, 0.5, 0.0)) - 1.0).abs() < 1e-6);
    }
    let cone = Cone::new(Vec3::NEG_Z, 1e-6).unwrap();
    assert!((f64::from(cone.solid_angle()) / (PI * f64::from(1e-6f32).powi(2)) - 1.0).abs() < 1e-6);
    assert_eq!(Cone::new(Vec3::Y * 3.0, f32::NAN).unwrap().sample(Vec2::ONE * 0.9), Vec3::Y);
    assert!((f64::from(Cone::new(Vec3::Y, 9.0).unwrap().solid_angle()) - 4.0 * PI).abs() < 1e-5);
    assert!(Cone::new(Vec3::ZERO, 1.0).is_none());
}

#[test]
fn flat_lights_by_area() {
    // Irradiance of a parallel disc on its axis: R^2 / (R^2 + h^2).
    let disc = |s| disc_light(Vec3::ZERO, Vec3::Z * 2.0, Vec3::NEG_Z * 5.0, 1.5, s);
    let factor =
        |l: Option<LightSample>| l.map_or(0.0, |l| f64::from(l.direction.z) / (f64::from(l.pdf) * PI));
    assert!((mean(|s| factor(disc(s))) - 2.25 / 6.25).abs() < 1e-4);
    // The mean of 1 / pdf is the solid angle, for any way to sample it.
    let (corner, u, v) = (Vec3::new(0.3, -0.5, 1.0), Vec3::new(1.0, 0.0, 0.5), Vec3::Y * 2.0);
    let by_area = mean(|s| 1.0 / f64::from(parallelogram_light(Vec3::ZERO, corner, u, v, s).unwrap().pdf));
    let exact = SphericalRectangle::new(Vec3::ZERO, corner, u, v).solid_angle();
    assert!((by_area / f64::from(exact) - 1.0).abs() < 1e-4);
}

#[test]
fn lights_without_solid_angle_give_nothing() {
    let s = Vec2::splat(0.5);
    let nan = f32::NAN;
    let rectangle = |corner: Vec3, u: Vec3, v: Vec3| SphericalRectangle::new(Vec3::ZERO, corner, u, v);
    for r in [
        rectangle(Vec3::X, Vec3::X, Vec3::Y), // in the plane, beside
        rectangle(Vec3::new(-1.0, -1.0, 0.0), Vec3::X * 2.0, Vec3::Y * 2.0), // on it
        rectangle(Vec3::Z, Vec3::ZERO, Vec3::Y),
        rectangle(Vec3::Z, Vec3::X, Vec3::X),
        rectangle(Vec3::Z, Vec3::X, Vec3::Y * nan),
        rectangle(Vec3::Z * f32::INFINITY, Vec3::X, Vec3::Y),
        rectangle(Vec3::Z * 1e30, Vec3::X, Vec3::Y),
    ] {
        assert_eq!((r.solid_angle(), r.sample(s)), (0.0, None), "{r:?}");
    }
    for (center, radius) in
        [(Vec3::Z, 0.0), (Vec3::Z, -1.0), (Vec3::Z, nan), (Vec3::Z * nan, 1.0), (Vec3::Z * 1e30, 1.0)]
    {
        let sphere = SphereLight::new(Vec3::ZERO, center, radius);
        assert_eq!((sphere.solid_angle(), sphere.sample(s)), (0.0, None));
    }
    assert_eq!(disc_light(Vec3::ZERO, Vec3::X, Vec3::Z, 0.5, s), None);
    assert_eq!(disc_light(Vec3::ZERO, Vec3::ZERO, Vec3::Z, 0.5, s), None);
    assert_eq!(disc_light(Vec3::ZERO, Vec3::Z, Vec3::Z, 0.0, s), None);
    assert_eq!(disc_light(Vec3::ZERO, Vec3::Z, Vec3::ZERO, 1.0, s), None);
    assert_eq!(parallelogram_light(Vec3::ZERO, Vec3::Z, Vec3::X, Vec3::X, s), None);
}

#[test]
fn rotations_turn_about_z() {
    let d = Vec3::new(0.6, 0.3, 0.2);
    let quarter = Rotation::from_turns(0.25).apply(d);
    assert!((quarter - Vec3::new(-d.y, d.x, d.z)).length() < 1e-6);
    assert_eq!(Rotation::from_turns(f32::NAN).apply(d), d);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2000))]

    #[test]
    fn numbers_stay_in_range(index: u32, dimension: u32, seed: u32) {
        let p = sobol_2d(index, dimension, seed);
        let q = sobol_4d(index, dimension / 4, seed);
        prop_assert_eq!(q[dimension as usize % 4], sobol(index, dimension, seed));
        let r = RandomStream::new(index, seed).next_unit();
        for x in [p.x, p.y, q[0], q[1], q[2], q[3], r, unit(index)] {
            prop_assert!((0.0..1.0).contains(&x));
        }
        let s = stratified(index % 50 + 1, seed);
        prop_assert!(s.iter().all(|p| p.min_element() >= 0.0 && p.max_element() < 1.0));
    }

    #[test]
    fn directions_have_unit_length(
        x in prop_oneof![0f32..1.0, Just(0.0), Just(0.5), Just(ONE_MINUS)],
        y in prop_oneof![0f32..1.0, Just(0.0), Just(0.5), Just(ONE_MINUS)], seed: u32,
    ) {
        let s = Vec2::new(x, y);
        prop_assert!(concentric_disc(s).length() < 1.0);
        let cosine = Rotation::from_turns(unit(hash(seed))).apply(cosine_hemisphere(s));
        for d in [cosine, uniform_hemisphere(s), uniform_sphere(s)] {
            prop_assert!((d.length() - 1.0).abs() < 3e-7, "{} {}", s, d);
        }
        prop_assert!(cosine.z >= 5e-4 && uniform_hemisphere(s).z > 0.0);
        let b = triangle(s);
        prop_assert!(b.min_element() >= 0.0 && b.x + b.y <= 1.0);
    }

    #[test]
    fn light_samples_are_sound(
        receiver in prop::array::uniform3(-1f32..1.0), at in prop::array::uniform3(-1f32..1.0),
        a in prop::array::uniform3(-1f32..1.0), b in prop::array::uniform3(-1f32..1.0),
        size in prop::sample::select(vec![1e-6f32, 1e-3, 1.0, 1e3]), away in prop::sample::select(vec![1f32, 1e3]),
        x in prop_oneof![0f32..1.0, Just(0.0), Just(ONE_MINUS)], y in prop_oneof![0f32..1.0, Just(0.0), Just(ONE_MINUS)],
    ) {
        let (receiver, at, u) = (Vec3::from(receiver), Vec3::from(at) * away, Vec3::from(a) * size);
        let v = u.cross(Vec3::from(b));
        prop_assume!(u.length() > 1e-2 * size && v.length() > 1e-2 * u.length());
        let s = Vec2::new(x, y);
        let rectangle = SphericalRectangle::new(receiver, at, u, v);
        prop_assert!((0.0..=std::f32::consts::TAU).contains(&rectangle.solid_angle()));
        let mut samples = vec![disc_light(receiver, at, u, size, s), parallelogram_light(receiver, at, u, v, s)];
        if let Some(sample) = rectangle.sample(s) {
            // Inside the rectangle, to the rounding of the coordinates.
            let p = sample.point.as_dvec3() - at.as_dvec3();
            let slack = 1e-6 * f64::from(away.max(size));
            for edge in [u.as_dvec3(), v.as_dvec3()] {
                let along = p.dot(edge.normalize());
                prop_assert!(along > -slack && along < edge.length() + slack, "{} of {}", along, edge.length());
            }
            prop_assert!(p.dot(u.as_dvec3().cross(v.as_dvec3()).normalize()).abs() < slack);
            samples.push(Some(sample));
        }
        samples.push(SphereLight::new(receiver, at, size).sample(s));
        for sample in samples.into_iter().flatten() {
            prop_assert!((sample.direction.length() - 1.0).abs() < 1e-6);
            prop_assert!(sample.pdf > 0.0 && sample.pdf.is_finite() && sample.distance > 0.0);
            let end = receiver + sample.direction * sample.distance;
            prop_assert!((end - sample.point).length() <= 1e-5 * (away + size));
        }
    }
}
