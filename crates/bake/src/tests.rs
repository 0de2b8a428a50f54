//! Analytic cases, exact cases, and what must not change the bits.

mod masks;
mod texels;

use super::*;
use proptest::prelude::*;
use umbrage_accel::{BuildOptions, Bvh};
use umbrage_aomask::Sides;
use umbrage_aomask::exact::adaptive::Spent;
use umbrage_geom::{
    Falloff, MeshError, MeshObject, Ray, TriangleMesh,
    glam::{Affine3A, Quat, Vec2, Vec3},
    sampling::{RandomStream, cosine_hemisphere, sobol_2d, uniform_sphere},
};
use umbrage_query::{AoMethod, Ground, Occluders, QueryError};
use umbrage_scene::Radius;

/// [`bake`] of plain points and normals.
fn bake_points(
    occluders: &Occluders,
    points: &[[f32; 3]],
    normals: &[[f32; 3]],
    options: &BakeOptions,
    ao: &mut [f32],
) -> Result<Spent, BakeError> {
    let receivers = Receivers::from_points(points, normals)?;
    Bake::new(occluders, &receivers, options).run(ao, &mut |_| true)
}

/// A globe of `n` x `2 n` quads around the origin, radius 1, with a latitude-longitude map.
fn sphere(n: u32) -> TriangleMesh {
    let columns = 2 * n;
    let mut mesh = TriangleMesh::default();
    for row in 0..=n {
        let latitude = std::f64::consts::PI * f64::from(row) / f64::from(n);
        for column in 0..columns {
            let longitude = std::f64::consts::TAU * f64::from(column) / f64::from(columns);
            let (s, c) = latitude.sin_cos();
            // One vertex a pole, so that normals there are smooth.
            if column == 0 || (row > 0 && row < n) {
                mesh.positions.push([(s * longitude.cos()) as f32, c as f32, (-s * longitude.sin()) as f32]);
            }
        }
    }
    let vertex = |row: u32, column: u32| match row {
        0 => 0,
        _ if row == n => 1 + (n - 1) * columns,
        _ => 1 + (row - 1) * columns + column % columns,
    };
    for row in 0..n {
        for column in 0..columns {
            let corners = [(row, column), (row + 1, column), (row + 1, column + 1), (row, column + 1)];
            for [a, b, c] in [[0, 1, 2], [0, 2, 3]].map(|t| t.map(|i: usize| corners[i])) {
                let triangle = [a, b, c].map(|(r, c)| vertex(r, c));
                if triangle[0] == triangle[1] || triangle[1] == triangle[2] || triangle[2] == triangle[0] {
                    continue;
                }
                mesh.triangles.push(triangle);
                mesh.corner_uvs
                    .push([a, b, c].map(|(r, c)| [c as f32 / columns as f32, 1.0 - r as f32 / n as f32]));
                mesh.corner_normals.push(triangle.map(|v| mesh.positions[v as usize]));
            }
        }
    }
    mesh.validate().unwrap();
    mesh
}

/// An axis-parallel box with outward faces, eight vertices.
fn cuboid(low: [f32; 3], high: [f32; 3]) -> TriangleMesh {
    let pick = |i: u32, axis: usize| if i >> axis & 1 == 0 { low[axis] } else { high[axis] };
    let positions = (0..8).map(|i| [pick(i, 0), pick(i, 1), pick(i, 2)]).collect();
    let quads = [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]];
    let triangles = quads.iter().flat_map(|q| [[q[0], q[1], q[2]], [q[0], q[2], q[3]]]).collect();
    TriangleMesh::new(positions, triangles).unwrap()
}

/// A parallelogram with edges `u` and `v`, facing along `u x v`.
fn quad(corner: [f32; 3], u: [f32; 3], v: [f32; 3]) -> TriangleMesh {
    let (p, u, v) = (Vec3::from(corner), Vec3::from(u), Vec3::from(v));
    let positions = [p, p + u, p + u + v, p + v].map(|p| p.to_array()).to_vec();
    let mut mesh = TriangleMesh::new(positions, vec![[0, 1, 2], [0, 2, 3]]).unwrap();
    let uvs = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]];
    mesh.corner_uvs = mesh.triangles.iter().map(|t| t.map(|i| uvs[i as usize])).collect();
    mesh
}

/// A ceiling over the origin at height `y`.
fn ceiling(y: f32, half: f32) -> TriangleMesh {
    quad([-half, y, -half], [2.0 * half, 0.0, 0.0], [0.0, 0.0, 2.0 * half])
}

fn transparent(mut mesh: TriangleMesh, opacity: f32) -> TriangleMesh {
    mesh.objects =
        vec![MeshObject { name: String::new(), triangles: 0..mesh.triangles.len() as u32, opacity }];
    mesh
}

/// Occlusion of one receiver.
fn occlusion(meshes: &[&TriangleMesh], point: [f32; 3], normal: [f32; 3], options: &BakeOptions) -> f64 {
    let occluders = Occluders::of_meshes(meshes, Ground::Absent, &mut |_| true).unwrap();
    let mut ao = [f32::NAN];
    bake_points(&occluders, &[point], &[normal], options, &mut ao).unwrap();
    1.0 - f64::from(ao[0])
}

fn bake_all(mesh: &TriangleMesh, receivers: &Receivers, options: &BakeOptions) -> Vec<f32> {
    let occluders = Occluders::of_meshes(&[mesh], Ground::Absent, &mut |_| true).unwrap();
    let mut ao = vec![f32::NAN; receivers.len()];
    Bake::new(&occluders, receivers, options).run(&mut ao, &mut |_| true).unwrap();
    ao
}

const UP: [f32; 3] = [0.0, 1.0, 0.0];

fn many_rays() -> BakeOptions {
    BakeOptions::default().with_rays(8192)
}

#[test]
fn sphere_above_a_plane() {
    // Configuration factor of a sphere straight above: (R / h)^2. The mesh lies inside its sphere by up to 6e-4.
    for height in [1.5f32, 2.0, 4.0] {
        let mut ball = sphere(64);
        ball.transform(&Affine3A::from_translation(Vec3::new(0.0, height, 0.0)));
        let ground = quad([-9.0, 0.0, 9.0], [18.0, 0.0, 0.0], [0.0, 0.0, -18.0]);
        for jitter in [Jitter::Pattern, Jitter::Rotation, Jitter::Off] {
            let options = many_rays().with_jitter(jitter);
            let actual = occlusion(&[&ground, &ball], [0.0; 3], UP, &options);
            let truth = f64::from(height).powi(-2);
            assert!((actual - truth).abs() < 2e-3, "{height} {jitter:?}: {actual} instead of {truth}");
        }
    }
}

#[test]
fn wall_beside_a_floor() {
    // A long wall of height h at distance x: (1 - x / sqrt(x^2 + h^2)) / 2.
    let wall = quad([0.0, 0.0, 1e4], [0.0, 0.0, -2e4], [0.0, 1.0, 0.0]);
    for x in [0.01f32, 0.5, 2.0] {
        let truth = 0.5 * (1.0 - f64::from(x) / f64::from(x * x + 1.0).sqrt());
        let actual = occlusion(&[&wall], [x, 0.0, 0.0], UP, &many_rays());
        assert!((actual - truth).abs() < 2e-3, "{x}: {actual} instead of {truth}");
    }
}

#[test]
fn edge_of_two_walls() {
    // Floor (x > 0) and wall (y > 0) share the z axis, with a vertex in its middle.
    let l = 1e4;
    let positions = vec![
        [0.0, 0.0, 0.0],
        [0.0, 0.0, -l],
        [0.0, 0.0, l],
        [l, 0.0, -l],
        [l, 0.0, l],
        [0.0, l, -l],
        [0.0, l, l],
    ];
    let triangles = vec![[0, 4, 3], [0, 3, 1], [0, 2, 4], [0, 5, 6], [0, 1, 5], [0, 6, 2]];
    let mesh = TriangleMesh::new(positions, triangles).unwrap();
    let ao = |normals| bake_all(&mesh, &Receivers::vertices(&mesh, normals).unwrap(), &many_rays())[0];
    // Each face sees a quarter of all directions: half of its hemisphere.
    assert!((ao(NormalSource::Geometric) - 0.5).abs() < 2e-3);
    // Between the faces: the share of a wedge of 45 degrees to each side is sin 45.
    assert!((ao(NormalSource::Smooth) - std::f32::consts::FRAC_1_SQRT_2).abs() < 2e-3);
}

#[test]
fn inside_a_closed_box() {
    let mesh = cuboid([-1.0; 3], [1.0; 3]);
    for normal in [UP, [0.3, -0.2, 5.0]] {
        let both = occlusion(&[&mesh], [0.1, 0.2, -0.9], normal, &BakeOptions::default());
        assert_eq!(both, 1.0);
        let options = BakeOptions::default().with_sides(Sides::Front);
        assert_eq!(occlusion(&[&mesh], [0.1, 0.2, -0.9], normal, &options), 0.0);
        assert_eq!(occlusion(&[&mesh], [0.1, -2.0, -0.9], UP, &options), {
            occlusion(&[&mesh], [0.1, -2.0, -0.9], UP, &BakeOptions::default())
        });
        let near = BakeOptions::default().with_radius(Radius::Absolute(0.05));
        assert_eq!(occlusion(&[&mesh], [0.1, 0.2, -0.9], normal, &near), 0.0);
    }
}

#[test]
fn ground_below() {
    let mesh = cuboid([0.0; 3], [1.0; 3]);
    let occluders = Occluders::of_meshes(&[&mesh], Ground::Below, &mut |_| true).unwrap();
    assert_eq!(occluders.bounds(), mesh.bounds());
    let points = [[5.0, 0.0, 0.5], [1.0, 0.5, 0.5], [0.5, 0.0, 0.5], [0.5, 1.0, 0.5]];
    let normals = [[-1e-3, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, -1.0, 0.0], UP];
    let mut ao = [f32::NAN; 4];
    bake_points(&occluders, &points, &normals, &many_rays(), &mut ao).unwrap();
    assert!(ao[0] > 0.98 && ao[0] < 1.0, "{ao:?}"); // the box is far
    assert!((ao[1] - 0.5).abs() < 2e-3, "{ao:?}"); // a wall sees ground in half of its directions
    assert_eq!(ao[2..], [0.0, 1.0]); // resting on the ground; the top
    // A lone plane over its own ground: nothing above it.
    let plane = quad([-1.0, 3.0, 1.0], [2.0, 0.0, 0.0], [0.0, 0.0, -2.0]);
    let occluders = Occluders::of_meshes(&[&plane], Ground::Below, &mut |_| true).unwrap();
    let receivers = Receivers::vertices(&plane, NormalSource::Geometric).unwrap();
    let mut ao = [f32::NAN; 4];
    Bake::new(&occluders, &receivers, &BakeOptions::default()).run(&mut ao, &mut |_| true).unwrap();
    assert_eq!(ao, [1.0; 4]);
}

#[test]
fn falloffs_have_the_expectation_of_weighted_hits() {
    let table = Falloff::table(vec![0.9, 0.9, 0.3, 0.0]).unwrap();
    let roof = ceiling(0.4, 1e3);
    for falloff in [Falloff::Constant, Falloff::Linear, Falloff::Quadratic, Falloff::Exponential, table] {
        // A ceiling at height k r is k r / c away in a direction with cosine c: integral of weight(k / c) 2 c dc.
        let (steps, k) = (20_000, 0.4 / 1.25);
        let term = |i| {
            let c: f64 = (f64::from(i) + 0.5) / f64::from(steps);
            f64::from(falloff.weight((k / c) as f32)) * 2.0 * c
        };
        let truth = (0..steps).map(term).sum::<f64>() / f64::from(steps);
        let options = many_rays().with_radius(Radius::Absolute(1.25)).with_falloff(falloff.clone());
        let actual = occlusion(&[&roof], [0.0; 3], UP, &options);
        assert!((actual - truth).abs() < 3e-3, "{falloff:?}: {actual} instead of {truth}");
    }
}

#[test]
fn falloff_agrees_with_weighting_the_nearest_hit() {
    let mut random = RandomStream::new(3, 1);
    let mut point = |scale: f32| {
        let square = Vec2::new(random.next_unit(), random.next_unit());
        uniform_sphere(square) * scale * (0.2 + random.next_unit())
    };
    let mut soup = TriangleMesh::default();
    for i in 0..200 {
        let center = point(1.0);
        soup.positions.extend([point(0.2), point(0.2), point(0.2)].map(|p| (p + center).to_array()));
        soup.triangles.push([3 * i, 3 * i + 1, 3 * i + 2]);
    }
    let bvh = Bvh::build(&soup.positions, &soup.triangles, &BuildOptions::default()).unwrap();
    let n = 8192;
    let sum: f64 = (0..n)
        .map(|i| {
            let d = cosine_hemisphere(sobol_2d(i, 0, 5));
            let hit = bvh.closest_hit(&Ray::new([0.0; 3], [d.x, d.z, d.y]));
            hit.map_or(0.0, |hit| f64::from(Falloff::Linear.weight(hit.t / 0.9)))
        })
        .sum();
    let options = many_rays().with_radius(Radius::Absolute(0.9)).with_falloff(Falloff::Linear);
    let actual = occlusion(&[&soup], [0.0; 3], UP, &options);
    let truth = sum / f64::from(n);
    assert!(truth > 0.1 && (actual - truth).abs() < 5e-3, "{actual} instead of {truth}");
}

#[test]
fn transparent_occluders_dim() {
    let [low, high] = [1.0, 2.0].map(|y| transparent(ceiling(y, 1e4), 0.25));
    let opaque = ceiling(3.0, 1e4);
    let through = |meshes: &[&TriangleMesh], options: &BakeOptions| occlusion(meshes, [0.0; 3], UP, options);
    let options = BakeOptions::default();
    assert!((through(&[&low], &options) - 0.25).abs() < 1e-3);
    assert!((through(&[&low, &high], &options) - (1.0 - 0.75 * 0.75)).abs() < 1e-3);
    assert!(through(&[&low, &high, &opaque], &options) > 0.999);
    // The ceilings face down (u x v = -y), so both count from below, and nothing counts from above.
    let front = options.with_sides(Sides::Front);
    assert!((through(&[&low, &high], &front) - (1.0 - 0.75 * 0.75)).abs() < 1e-3);
    assert_eq!(occlusion(&[&low, &opaque], [0.0, 4.0, 0.0], [0.0, -1.0, 0.0], &front), 0.0);
}

#[test]
fn convex_meshes_are_fully_open() {
    let far = Vec3::new(1e4, -7e3, 3e3);
    let turn = Quat::from_rotation_x(0.7);
    for (scale, shift) in
        [(1.0, Vec3::ZERO), (1.0, far), (1e-6, Vec3::ZERO), (1e-6, far * 1e-6), (1e12, far * 1e12)]
    {
        for mut mesh in [sphere(12), cuboid([-1.0, -0.1, -3.0], [2.0, 0.1, 3.0])] {
            mesh.transform(&Affine3A::from_scale_rotation_translation(Vec3::splat(scale), turn, shift));
            for normals in [NormalSource::Geometric, NormalSource::Smooth, NormalSource::File] {
                if normals == NormalSource::File && mesh.corner_normals.is_empty() {
                    continue;
                }
                let mut kinds = vec![Receivers::vertices(&mesh, normals).unwrap()];
                if !mesh.corner_uvs.is_empty() {
                    let map = TexelMap::new(&mesh, 48, 24, VAxis::Up).unwrap();
                    kinds.push(map.receivers(&mesh, normals).unwrap());
                }
                for receivers in kinds {
                    let ao = bake_all(&mesh, &receivers, &BakeOptions::default());
                    let shaded = ao.iter().filter(|&&x| x != 1.0).count();
                    assert_eq!(shaded, 0, "scale {scale}, shift {shift}, {normals:?}, of {}", ao.len());
                }
            }
        }
    }
}

#[test]
fn vertices_without_a_side_are_open() {
    let roof = ceiling(1.0, 10.0);
    let mut mesh = quad([0.0; 3], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]);
    mesh.positions.extend([[0.2, 0.1, 0.2], [0.4, 0.1, 0.4]]);
    mesh.triangles.push([4, 4, 5]);
    mesh.corner_uvs.clear();
    mesh.positions.push([0.5, 0.5, 0.5]);
    let occluders = Occluders::of_meshes(&[&mesh, &roof], Ground::Absent, &mut |_| true).unwrap();
    for normals in [NormalSource::Geometric, NormalSource::Smooth] {
        let receivers = Receivers::vertices(&mesh, normals).unwrap();
        let mut ao = vec![f32::NAN; 7];
        Bake::new(&occluders, &receivers, &BakeOptions::default()).run(&mut ao, &mut |_| true).unwrap();
        assert!(ao[..4].iter().all(|&x| x < 0.05), "{ao:?}");
        assert_eq!(ao[4..], [1.0; 3]);
    }
}

/// A scene with some of everything, and its receivers.
fn mixed() -> (Occluders, Receivers) {
    let mut ball = sphere(10);
    ball.transform(&Affine3A::from_translation(Vec3::new(0.3, 0.9, 0.0)));
    let pane = transparent(ceiling(2.0, 1.0), 0.6);
    let mut mesh = cuboid([-2.0, -1.0, -2.0], [2.0, 0.0, 2.0]);
    mesh.append(&ball);
    let receivers = Receivers::vertices(&mesh, NormalSource::Geometric).unwrap();
    (Occluders::of_meshes(&[&mesh, &pane], Ground::Below, &mut |_| true).unwrap(), receivers)
}

#[test]
fn threads_and_shards_give_the_same_bits() {
    let (occluders, receivers) = mixed();
    let radius = Radius::OfDiagonal(0.5);
    let options = BakeOptions::default().with_rays(40).with_radius(radius).with_falloff(Falloff::Linear);
    let run = |threads: usize, shard: Shard, ao: &mut [f32]| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| Bake::new(&occluders, &receivers, &options).with_shard(shard).run(ao, &mut |_| true))
            .unwrap();
    };
    let new = || vec![f32::NAN; receivers.len()];
    let [mut one, mut two, mut merged] = [new(), new(), new()];
    run(1, Shard::WHOLE, &mut one);
    run(2, Shard::WHOLE, &mut two);
    assert_eq!(one, two);
    assert!(one.iter().any(|&x| x < 0.7) && one.iter().all(|x| (0.0..=1.0).contains(x)));
    let count = blocks(receivers.len()) as u32;
    assert!(count > 2);
    for (done, index) in (0..count).rev().enumerate() {
        run(2, Shard::new(index + 1, count).unwrap(), &mut merged);
        assert_eq!(merged.iter().any(|x| x.is_nan()), done + 1 < count as usize);
    }
    assert_eq!(one, merged);
    let many = Shard::new(1, count + 1).unwrap();
    let error = Bake::new(&occluders, &receivers, &options).with_shard(many).run(&mut merged, &mut |_| true);
    assert!(matches!(error, Err(BakeError::Shard { .. })));
    assert!(Shard::new(3, 2).is_err() && Shard::new(0, 0).is_err());
}

#[test]
fn progress_ends_at_one_and_cancels() {
    let (occluders, receivers) = mixed();
    let options = BakeOptions::default().with_rays(4);
    let mut ao = vec![-1.0; receivers.len()];
    let mut seen = Vec::new();
    Bake::new(&occluders, &receivers, &options)
        .run(&mut ao, &mut |f| {
            seen.push(f);
            true
        })
        .unwrap();
    assert!(seen.windows(2).all(|w| w[0] < w[1]) && seen.last() == Some(&1.0), "{seen:?}");
    for limit in [0.0, 0.99] {
        let mut ao = vec![-1.0; receivers.len()];
        let cancelled = Bake::new(&occluders, &receivers, &options).run(&mut ao, &mut |f| f < limit);
        assert!(matches!(cancelled, Err(BakeError::Cancelled)));
        assert!(ao.iter().all(|&x| x == -1.0));
    }
}

#[test]
fn seeds_and_bias_matter() {
    let roof = ceiling(1.0, 1.0);
    let options = BakeOptions::default().with_rays(64);
    let at = |options: &BakeOptions| occlusion(&[&roof], [0.3, 0.0, 0.1], UP, options);
    assert_eq!(at(&options), at(&options));
    let values: Vec<f64> = (0..8).map(|seed| at(&options.clone().with_seed(seed))).collect();
    assert!(values.iter().any(|v| *v != values[0]));
    // Above the roof nothing is left.
    assert_eq!(at(&options.with_bias(1.5)), 0.0);
}

#[test]
fn bad_input_is_named() {
    let mesh = ceiling(1.0, 1.0);
    let occluders = Occluders::of_meshes(&[&mesh], Ground::Absent, &mut |_| true).unwrap();
    let run = |options: BakeOptions| {
        bake_points(&occluders, &[[0.0; 3]], &[UP], &options, &mut [0.0]).unwrap_err().to_string()
    };
    let base = BakeOptions::default;
    assert!(run(base().with_rays(0)).contains("number of rays is 0"));
    assert!(run(base().with_rays(70_000)).contains("65536"));
    for radius in [0.0, -1.0, f32::NAN] {
        assert!(run(base().with_radius(Radius::Absolute(radius))).starts_with("radius is"));
        assert!(run(base().with_radius(Radius::OfDiagonal(radius))).starts_with("radius is"));
    }
    assert!(run(base().with_falloff(Falloff::Linear)).contains("needs a radius"));
    assert!(run(base().with_falloff(Falloff::Table(vec![2.0, 1.0]))).contains("weight 0 is 2"));
    assert!(run(base().with_bias(-1.0)).contains("bias is -1"));
    let points = |p: &[[f32; 3]], n: &[[f32; 3]]| Receivers::from_points(p, n).unwrap_err();
    assert!(matches!(points(&[[0.0; 3]], &[]), BakeError::Length { actual: 0, expected: 1, .. }));
    for bad in [f32::NAN, f32::INFINITY, 1e30] {
        let error = points(&[[0.0; 3], [0.0, bad, 0.0]], &[UP; 2]);
        assert!(matches!(error, BakeError::Point { index: 1, .. }));
    }
    for bad in [[0.0; 3], [f32::NAN, 0.0, 1.0], [f32::INFINITY, 0.0, 0.0]] {
        assert!(matches!(points(&[[0.0; 3]; 3], &[UP, UP, bad]), BakeError::Normal { index: 2, .. }));
    }
    let empty = TriangleMesh::default();
    let error = Occluders::of_meshes(&[&mesh, &empty], Ground::Absent, &mut |_| true).err().unwrap();
    assert!(matches!(error, QueryError::Mesh { index: 1, source: MeshError::Empty }));
    assert!(matches!(Occluders::of_meshes(&[], Ground::Absent, &mut |_| true), Err(QueryError::NoOccluder)));
    assert!(matches!(Receivers::vertices(&mesh, NormalSource::File), Err(BakeError::NoNormals)));
    let mut short = [0.0; 1];
    let receivers = Receivers::from_points(&[[0.0; 3]; 2], &[UP; 2]).unwrap();
    let error = Bake::new(&occluders, &receivers, &base()).run(&mut short, &mut |_| true);
    assert!(matches!(error, Err(BakeError::Length { what: "results", .. })));
}
