//! The field of stored opacity and what cones see in it.

mod common;

use common::{Scene, pattern, receivers, scene, soup};
use umbrage_aomask::{
    BackEnd, MaskCall, MaskError, MaskOptions, Outputs, Receiver,
    coarse::{
        Cones, FarField,
        field::{FieldCones, FieldOptions, MarchOptions, OpacityField},
    },
};
use umbrage_geom::{
    Aabb, Falloff, OpticalDepth,
    glam::Vec3,
    sampling::{RandomStream, uniform_sphere},
};

fn field(scene: &Scene, cells: u32) -> OpacityField {
    let options = FieldOptions::default().with_cells(cells);
    OpacityField::build(&scene.mesh.positions, &scene.mesh.triangles, &options, &mut |_| true).unwrap()
}

fn cones(origin: Vec3, directions: &[Vec3], length: f32) -> Cones {
    Cones {
        origin,
        directions: [0, 1, 2].map(|axis| directions.iter().map(|d| d[axis]).collect()),
        lengths: vec![length; directions.len()],
        solid_angles: vec![0.05; directions.len()],
    }
}

fn passed(field: &OpacityField, near: f32, cones: &Cones, back_end: BackEnd) -> Vec<f32> {
    let far =
        FieldCones::new(field, 128, near, 1e3, &MarchOptions::default().with_back_end(back_end)).unwrap();
    let mut passed = vec![f32::NAN; cones.lengths.len()];
    far.transmittances(cones, &mut passed);
    passed
}

fn sphere(count: usize, seed: u32) -> Vec<Vec3> {
    let mut random = RandomStream::new(seed, 0);
    (0..count).map(|_| uniform_sphere([random.next_unit(), random.next_unit()].into())).collect()
}

/// A square of 2 x 2 around the origin that faces `normal`, of `n` x `n` x 2 triangles.
fn wall(normal: Vec3, n: usize) -> Scene {
    let (u, v) = normal.any_orthonormal_pair();
    let at = |i: usize, j: usize| {
        let of = |k: usize| 2.0 * k as f32 / n as f32 - 1.0;
        (u * of(i) + v * of(j)).to_array()
    };
    let mut triangles = Vec::new();
    for (i, j) in (0..n * n).map(|k| (k / n, k % n)) {
        triangles.push([at(i, j), at(i + 1, j), at(i + 1, j + 1)]);
        triangles.push([at(i, j), at(i + 1, j + 1), at(i, j + 1)]);
    }
    soup(&triangles)
}

#[test]
fn a_wall_blocks_and_nothing_else_does() {
    for (normal, n) in [(Vec3::Z, 1), (Vec3::Z, 40), (Vec3::new(0.3, -0.5, 0.8).normalize(), 25)] {
        let field = field(&wall(normal, n), 32);
        let (u, v) = normal.any_orthonormal_pair();
        let origin = normal * 0.4;
        let targets = [(0.0, 0.0), (0.3, 0.2), (-0.25, 0.35), (0.1, -0.4)];
        let ahead: Vec<Vec3> = targets.iter().map(|&(a, b)| (u * a + v * b - origin).normalize()).collect();
        let through = passed(&field, 0.1, &cones(origin, &ahead, 2.0), BackEnd::best());
        assert!(through.iter().all(|&x| x < 0.06), "{normal} {n}: {through:?}");
        let back: Vec<Vec3> = ahead.iter().map(|&d| -d).collect();
        for (directions, length) in [(&back, 2.0), (&ahead, 0.2)] {
            let open = passed(&field, 0.1, &cones(origin, directions, length), BackEnd::best());
            assert!(open.iter().all(|&x| x == 1.0), "{normal} {n}: {open:?}");
        }
    }
}

#[test]
fn independent_triangles_attenuate_as_rays_find() {
    let mut random = RandomStream::new(5, 0);
    let mut triangles = Vec::new();
    for _ in 0..20_000 {
        let mut point = || Vec3::new(random.next_unit(), random.next_unit(), random.next_unit());
        let (center, u, v) = (point(), point() - 0.5, point() - 0.5);
        triangles.push([center, center + u * 0.03, center + v * 0.03].map(|p| p.to_array()));
    }
    let scene = soup(&triangles);
    let field = field(&scene, 48);
    let directions = sphere(2_000, 1);
    let (near, length) = (0.05, 0.4);
    let cones = cones(Vec3::splat(0.5), &directions, length);
    let all = passed(&field, near, &cones, BackEnd::best());
    assert!(all.iter().all(|x| (0.0..=1.0).contains(x)));
    let rays = cones.rays(near).map(|(ray, _)| f64::from(u8::from(!scene.bvh.any_hit(&ray))));
    let (seen, truth) = (all.iter().map(|&x| f64::from(x)).sum::<f64>() / 2e3, rays.sum::<f64>() / 2e3);
    assert!((seen - truth).abs() < 0.03 && (0.1..0.9).contains(&truth), "{seen} {truth}");
}

/// Triangles in a cube, independent of each other.
fn dust(count: usize) -> Scene {
    let mut random = RandomStream::new(6, 0);
    let mut triangles = Vec::new();
    for _ in 0..count {
        let mut point = || Vec3::new(random.next_unit(), random.next_unit(), random.next_unit());
        let (center, u, v) = (point(), point() - 0.5, point() - 0.5);
        triangles.push([center, center + u * 0.04, center + v * 0.04].map(|p| p.to_array()));
    }
    soup(&triangles)
}

fn transparent(scene: &Scene, opacities: &[f32], cells: u32) -> Result<OpacityField, MaskError> {
    let (positions, triangles) = (&scene.mesh.positions, &scene.mesh.triangles);
    let options = FieldOptions::default().with_cells(cells);
    OpacityField::build_transparent(positions, triangles, opacities, &options, &mut |_| true)
}

#[test]
fn semi_transparent_triangles_attenuate_as_products_do() {
    let scene = dust(30_000);
    let directions = sphere(1_000, 4);
    let (near, length) = (0.05, 0.4);
    let cones = cones(Vec3::splat(0.5), &directions, length);
    // One opacity for all, and several.
    let mixed = |i: u32| [0.1, 0.5, 1.0, 0.0][i as usize % 4];
    let opacity: [&dyn Fn(u32) -> f32; 3] = [&|_| 0.7, &|_| 0.15, &mixed];
    for (number, of) in opacity.into_iter().enumerate() {
        let opacities: Vec<f32> = (0..scene.mesh.triangles.len() as u32).map(of).collect();
        let field = transparent(&scene, &opacities, 48).unwrap();
        let seen = passed(&field, near, &cones, BackEnd::best());
        let exact = cones.rays(near).map(|(ray, _)| {
            scene.bvh.transmittance(&ray, |prim| OpticalDepth::from_opacity(of(prim))).transmittance()
        });
        let mean = |values: &mut dyn Iterator<Item = f32>| values.map(f64::from).sum::<f64>() / 1e3;
        let (seen, truth) = (mean(&mut seen.into_iter()), mean(&mut exact.into_iter()));
        assert!((seen - truth).abs() < 0.02 && (0.1..0.95).contains(&truth), "{number}: {seen} {truth}");
    }
}

#[test]
fn opacities_of_one_are_opaque_bit_for_bit() {
    let scene = dust(5_000);
    let n = scene.mesh.triangles.len();
    let cones = cones(Vec3::splat(0.4), &sphere(200, 5), 2.0);
    let expected = passed(&field(&scene, 32), 0.03, &cones, BackEnd::best());
    for opacities in [vec![1.0; n], vec![f32::NAN; n], Vec::new()] {
        let field = transparent(&scene, &opacities, 32).unwrap();
        assert_eq!(passed(&field, 0.03, &cones, BackEnd::best()), expected);
    }
    let clear = transparent(&scene, &vec![0.0; n], 32).unwrap();
    assert_eq!(passed(&clear, 0.03, &cones, BackEnd::best()), [1.0; 200]);
    let refused = transparent(&scene, &[0.5], 32).unwrap_err();
    assert_eq!(refused, MaskError::Opacities { actual: 1, triangles: n });
    // However many threads there are.
    let veil = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let field = pool.install(|| transparent(&scene, &vec![0.4; n], 32)).unwrap();
        passed(&field, 0.03, &cones, BackEnd::Scalar)
    };
    assert_eq!(veil(1), veil(3));
}

#[test]
fn back_ends_and_threads_have_the_same_bits() {
    let scene = scene("bush", 20_000);
    let build = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| field(&scene, 40))
    };
    let [one, three] = [1, 3].map(build);
    // A number that is no multiple of what is taken at a time; origins in and outside of the grid.
    for (i, origin) in [scene.mesh.bounds().center(), scene.mesh.bounds().max * 1.5].into_iter().enumerate() {
        let cones = cones(origin, &sphere(101, i as u32), 3.0);
        let expected = passed(&one, 0.02, &cones, BackEnd::Scalar);
        assert!(i == 1 || expected.iter().any(|&x| x > 0.0 && x < 1.0));
        for back_end in BackEnd::ALL.into_iter().filter(|b| b.is_supported()) {
            assert_eq!(passed(&three, 0.02, &cones, back_end), expected, "{back_end:?}");
        }
    }
}

#[test]
fn occlusion_of_foliage_is_close_to_exact_masks() {
    let scene = scene("bush", 20_000);
    let (pattern, points) = (pattern(256, Falloff::Constant), receivers(&scene.mesh, 64, 3));
    let options = MaskOptions::default().with_radius(0.1 * scene.mesh.bounds().diagonal());
    let asked: Vec<Receiver> = points
        .0
        .iter()
        .zip(&points.1)
        .enumerate()
        .map(|(i, (&p, &n))| Receiver::new(i, p, n, Receiver::seed_of(p, n, 0)).unwrap())
        .collect();
    let (mut truth, mut ao) = ([0.0; 64], [0.0; 64]);
    let outputs = Outputs::new(&mut truth);
    MaskCall::new(&scene.bvh, &pattern, &asked, &options).answer(outputs, &mut |_| true).unwrap();
    let field = field(&scene, 96);
    let near = 0.2 * options.radius;
    let far = FieldCones::new(&field, 256, near, options.radius, &MarchOptions::default()).unwrap();
    let outputs = Outputs::new(&mut ao);
    MaskCall::new(&scene.bvh, &pattern, &asked, &options)
        .with_far(&far)
        .answer(outputs, &mut |_| true)
        .unwrap();
    let errors = || ao.iter().zip(truth).map(|(&a, b)| f64::from(a) - f64::from(b));
    let (bias, rmse) = (errors().sum::<f64>() / 64.0, (errors().map(|e| e * e).sum::<f64>() / 64.0).sqrt());
    assert!(bias.abs() < 0.015 && rmse < 0.04 && rmse > 0.0, "{bias} {rmse}");
}

#[test]
fn nothing_blocks_nothing() {
    let options = FieldOptions::default();
    let field = OpacityField::build(&[], &[], &options, &mut |_| true).unwrap();
    let cones = cones(Vec3::ZERO, &sphere(20, 2), f32::INFINITY);
    assert_eq!(passed(&field, 0.1, &cones, BackEnd::best()), [1.0; 20]);
    // Nor does what lies outside of the box.
    let wall = wall(Vec3::Z, 4);
    let bounds = Aabb { min: Vec3::splat(5.0), max: Vec3::splat(6.0) };
    let (positions, triangles) = (&wall.mesh.positions, &wall.mesh.triangles);
    let options = options.with_bounds(bounds).with_cells(16);
    let field = OpacityField::build(positions, triangles, &options, &mut |_| true).unwrap();
    assert_eq!(passed(&field, 0.1, &cones, BackEnd::best()), [1.0; 20]);
}

#[test]
fn bad_input_has_typed_errors() {
    let wall = wall(Vec3::Z, 4);
    let (positions, triangles) = (&wall.mesh.positions, &wall.mesh.triangles);
    let build = |options: &FieldOptions| OpacityField::build(positions, triangles, options, &mut |_| true);
    for cells in [0, 7, OpacityField::MAX_CELLS + 1] {
        let refused = build(&FieldOptions::default().with_cells(cells)).unwrap_err();
        assert!(matches!(refused, MaskError::Resolution { value, .. } if value == cells));
    }
    let nan = Vec3::new(f32::NAN, 0.0, 0.0);
    for bounds in [Aabb::EMPTY, Aabb { min: nan, max: Vec3::ONE }] {
        let refused = build(&FieldOptions::default().with_bounds(bounds)).unwrap_err();
        assert!(matches!(refused, MaskError::Build(_)), "{refused}");
    }
    let options = FieldOptions::default().with_cells(8);
    for (positions, triangles) in [(vec![[f32::NAN; 3]; 3], vec![[0, 1, 2]]), (vec![], vec![[0, 1, 2]])] {
        let refused = OpacityField::build(&positions, &triangles, &options, &mut |_| true).unwrap_err();
        assert!(matches!(refused, MaskError::Build(_)), "{refused}");
    }
    let refused = OpacityField::build(positions, triangles, &options, &mut |f| f < 0.5).unwrap_err();
    assert_eq!(refused, MaskError::Cancelled);
    let mut seen = Vec::new();
    let mut watch = |f| {
        seen.push(f);
        true
    };
    let field = OpacityField::build(positions, triangles, &options, &mut watch).unwrap();
    assert!(seen.is_sorted() && seen.len() > 2 && seen.last() == Some(&1.0));
    for (near, radius) in [(0.0, 1.0), (f32::NAN, 1.0), (0.1, -1.0), (0.1, f32::NAN)] {
        let march = MarchOptions::default();
        let refused = FieldCones::new(&field, 32, near, radius, &march).unwrap_err();
        assert!(matches!(refused, MaskError::Radius(_)));
    }
    for march in [
        MarchOptions::default().with_cones(0),
        MarchOptions::default().with_coarseness(0.0),
        MarchOptions::default().with_coarseness(f32::NAN),
    ] {
        let refused = FieldCones::new(&field, 32, 0.1, 1.0, &march).unwrap_err();
        assert!(matches!(refused, MaskError::Option { .. }));
    }
    // A single point has no extent at all.
    let flat = OpacityField::build(&[[1.0; 3]; 3], &[[0, 1, 2]], &options, &mut |_| true).unwrap();
    assert_eq!(passed(&flat, 0.1, &cones(Vec3::ZERO, &[Vec3::X], 9.0), BackEnd::best()), [1.0]);
    assert!(flat.cell() > 0.0);
}
