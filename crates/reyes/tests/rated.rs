//! Surfaces at rates chosen once: rays against the mesh, watertightness, back ends.

mod common;

use common::{cube, prism, sheet, zoo};
use std::{collections::HashMap, sync::Arc};
use umbrage_accel::{BackEnd, BuildOptions, Bvh};
use umbrage_geom::{
    FaceObject, PolygonMesh, Ray, TriangleMesh,
    glam::{Affine3A, Quat, Vec3},
    sampling::{hash, sobol_4d, unit},
};
use umbrage_reyes::{EyeRates, RatedSurface, Surface, SurfaceError, SurfaceOptions};

fn surface(mesh: &PolygonMesh) -> Arc<Surface> {
    Arc::new(Surface::build(mesh, &SurfaceOptions::default()).unwrap())
}

/// Levels without any order.
fn wild(mesh: &PolygonMesh, most: u32) -> RatedSurface {
    RatedSurface::build(
        surface(mesh),
        |patch| [hash(patch), hash(patch + 1000)].map(|x| (x % (most + 1)) as u8),
        &mut |_| true,
    )
    .unwrap()
}

fn rays(surface: &Surface) -> impl Iterator<Item = Ray> {
    let (low, size) = (surface.bounds().min, surface.bounds().size());
    (0..500u32).map(move |i| {
        let (x, y) = (sobol_4d(i, 0, 5), sobol_4d(i, 1, 5));
        let at = |x: [f32; 4]| low + size * (1.6 * Vec3::new(x[0], x[1], x[2]) - 0.3);
        Ray::between(at(x), at(y)).with_tfar(if i % 3 == 0 { 0.5 } else { f32::INFINITY })
    })
}

/// Rays see what they see of the mesh as a triangle soup.
#[test]
fn rays_agree_with_the_triangles() {
    for (name, mesh) in zoo() {
        for most in [0, 2, 5] {
            let rated = wild(&mesh, most);
            let soup = rated.to_mesh();
            let bvh = Bvh::build(&soup.positions, &soup.triangles, &BuildOptions::default()).unwrap();
            let mut hits = 0;
            for ray in rays(rated.surface()) {
                let expected = bvh.closest_hit(&ray);
                let hit = rated.closest_hit(&ray);
                assert_eq!(hit.map(|h| h.hit.t), expected.map(|h| h.t), "{name}, {most}");
                assert_eq!(rated.any_hit(&ray), expected.is_some(), "{name}, {most}");
                let Some(hit) = hit else { continue };
                hits += 1;
                let found = umbrage_geom::intersect_triangle(&ray, rated.corners(&hit)).unwrap();
                assert!(found.t == hit.hit.t && found.front == hit.hit.front);
                assert_eq!(hit.hit.levels, rated.levels(hit.hit.patch));
                // The limit surface at the hit's parameters is within a cell.
                let size = rated.corners(&hit).map(Vec3::from);
                let cell = size[0].distance(size[1]).max(size[0].distance(size[2]));
                let off = rated.limit(&hit).position.distance(ray.at(hit.hit.t));
                assert!(off <= cell.max(0.02 * rated.surface().bounds().diagonal()), "{name}, {most}: {off}");
            }
            assert!(hits > 30, "{name}, {most}: {hits}");
        }
    }
}

/// Rays in batches have the answers of single rays: shared origins, others between them, rays that no fan takes.
#[test]
fn batches_have_the_answers_of_single_rays() {
    for (name, mesh) in zoo() {
        let rated = wild(&mesh, 5);
        let all: Vec<Ray> = rays(rated.surface()).collect();
        let mut batch = Vec::new();
        for (i, ray) in all.iter().enumerate() {
            // Runs of 0 to 40 rays from one point.
            let point = all[i / 40 * 40].origin;
            let own = hash(i as u32 / 40).is_multiple_of(4) && i.is_multiple_of(3);
            batch.push(if own { *ray } else { Ray { origin: point, ..*ray } });
            if i % 50 == 7 {
                batch.push(Ray { origin: point, direction: Vec3::splat(1e-30), ..*ray });
                batch.push(Ray { origin: point, direction: Vec3::NAN, ..*ray });
                // From the surface itself.
                let patch = i as u32 % rated.surface().patch_count() as u32;
                let on = rated.surface().limit(patch, 0.5, 0.25).position;
                batch.extend([-0.1, 0.0, 0.1].map(|x| Ray::between(on, point + x)));
            }
        }
        let mut hits = vec![false; batch.len()];
        rated.any_hits(&batch, &mut hits);
        for (ray, hit) in batch.iter().zip(&hits) {
            assert_eq!(*hit, rated.any_hit(ray), "{name}: {ray:?}");
        }
        assert!(hits.contains(&true) && hits.contains(&false));
        rated.any_hits(&[], &mut []);
    }
}

/// Every edge of a closed surface has two triangles that run along it in opposite directions.
#[test]
fn closed_surfaces_stay_closed() {
    for (name, mesh) in zoo() {
        if name.contains("sheet") || name == "dart" || name == "one quad" {
            continue;
        }
        for most in [1, 4, 6] {
            let TriangleMesh { triangles, .. } = wild(&mesh, most).to_mesh();
            let mut balance: HashMap<[u32; 2], i32> = HashMap::new();
            for [a, b, c] in triangles {
                for [p, q] in [[a, b], [b, c], [c, a]] {
                    *balance.entry([p.min(q), p.max(q)]).or_default() += if p < q { 1 } else { -1 };
                }
            }
            let open = balance.values().filter(|&&count| count != 0).count();
            assert_eq!(open, 0, "{name}, levels up to {most}");
        }
    }
}

/// Points don't depend on instructions, nor on what the trees of patches may keep.
#[test]
fn back_ends_give_the_same_mesh() {
    for (name, mesh) in zoo() {
        let meshes = [BackEnd::Scalar, BackEnd::Avx2, BackEnd::Avx512].map(|back_end| {
            let options = SurfaceOptions::default().with_back_end(back_end).with_tree_bytes(0);
            let surface = Arc::new(Surface::build(&mesh, &options).unwrap());
            RatedSurface::build(surface, |patch| [(patch % 6) as u8, (patch % 5) as u8], &mut |_| true)
                .unwrap()
                .to_mesh()
        });
        assert_eq!(meshes[0], meshes[1], "{name}");
        assert_eq!(meshes[0], meshes[2], "{name}");
        let kept =
            RatedSurface::build(surface(&mesh), |patch| [(patch % 6) as u8, (patch % 5) as u8], &mut |_| {
                true
            });
        assert_eq!(kept.unwrap().to_mesh(), meshes[0], "{name}");
    }
}

#[test]
fn an_eye_sees_even_micropolygons() {
    // A flat sheet of unit squares, seen from above its middle.
    let rates = EyeRates::new(Vec3::new(4.0, 4.0, 10.0), 0.01).with_bend(0.0);
    let rated = RatedSurface::for_eye(surface(&sheet(8, |_, _| 0.0)), &rates, &mut |_| true).unwrap();
    let mesh = rated.to_mesh();
    for [a, b, _] in &mesh.triangles {
        let [a, b] = [a, b].map(|&v| Vec3::from(mesh.positions[v as usize]));
        let pixels = a.distance(b) / (0.01 * a.distance(Vec3::new(4.0, 4.0, 10.0)));
        assert!((0.4..=2.1).contains(&pixels), "{pixels}");
    }
    // Nearer eyes ask for finer rates, up to the level given.
    let levels = |z: f32| {
        let surface = surface(&sheet(3, |_, _| 0.0));
        let rates = EyeRates::new(Vec3::new(1.5, 1.5, z), 0.05).with_max_level(7);
        RatedSurface::for_eye(surface, &rates, &mut |_| true).unwrap().levels(4)
    };
    assert_eq!(levels(0.0), [7, 7]);
    let all: Vec<u8> = [0.1, 0.5, 2.0, 8.0, 100.0].map(|z| levels(z)[0]).to_vec();
    assert!(all.is_sorted_by(|a, b| a >= b) && all[0] > all[4] + 3, "{all:?}");
}

#[test]
fn bent_patches_are_finer_than_flat_ones() {
    // A ridge along the middle of a sheet.
    let control = sheet(8, |i, _| if i == 4 { 0.8 } else { 0.0 });
    let rated = |bend: f32| {
        let rates = EyeRates::new(Vec3::new(4.0, 4.0, 40.0), 0.002).with_bend(bend);
        RatedSurface::for_eye(surface(&control), &rates, &mut |_| true).unwrap()
    };
    let (even, bent) = (rated(0.0), rated(0.002));
    // Levels by how far patches are from flat: two levels is four times as long, or as short.
    for patch in 0..64 {
        let (even, bent) = (even.levels(patch), bent.levels(patch));
        assert!((0..2).all(|axis| even[axis].abs_diff(bent[axis]) <= 2), "{patch}: {even:?} {bent:?}");
    }
    // Far from the ridge nothing turns; on it edges across turn, those along it do not.
    let of = |x: f32| {
        (0..64).find(|&p| {
            (even.surface().limit(p, 0.5, 0.5).position - Vec3::new(x, 3.5, 0.0)).truncate().length() < 0.3
        })
    };
    let (flat, ridge) = (of(0.5).unwrap(), of(3.5).unwrap());
    assert!((0..2).all(|axis| bent.levels(flat)[axis] + 2 == even.levels(flat)[axis]));
    let gained: Vec<i32> = (0..2)
        .map(|axis| i32::from(bent.levels(ridge)[axis]) - i32::from(even.levels(ridge)[axis]))
        .collect();
    assert!(gained.iter().max() >= Some(&1) && gained.iter().min() == Some(&-2), "{gained:?}");
    // The finer the turn that edges may take, the finer they are.
    let counts = [0.4, 0.1, 0.02, 0.004].map(|bend| rated(bend).micropolygons());
    assert!(counts.is_sorted() && counts[0] < counts[3] / 4, "{counts:?}");
}

#[test]
fn meshes_carry_normals_and_texture() {
    let mut control = sheet(3, |i, j| unit(i * 7 + j));
    control.corner_uvs = control.corners.iter().map(|&v| [(v % 4) as f32, (v / 4) as f32]).collect();
    let mesh = RatedSurface::build(surface(&control), |_| [3, 2], &mut |_| true).unwrap().to_mesh();
    assert_eq!(mesh.corner_uvs.len(), mesh.triangles.len());
    assert!(mesh.validate().is_ok());
    assert!(mesh.corner_uvs.as_flattened().as_flattened().iter().all(|&x| (-1e-6..=3.000_001).contains(&x)));
    assert!(mesh.corner_normals.as_flattened().iter().all(|&n| (Vec3::from(n).length() - 1.0).abs() < 1e-5));
}

/// Objects are those of the control mesh, also where their faces have no area, and surfaces that stand at several places are as
/// fine as the nearest asks.
#[test]
fn meshes_carry_objects_and_rates_of_all_places() {
    let mut control = prism(5);
    let runs = [("bottom", 0..1), ("none", 1..1), ("top", 1..2), ("side", 2..7)];
    control.objects = runs.map(|(name, faces)| FaceObject { name: name.into(), faces }).to_vec();
    let mesh = RatedSurface::build(surface(&control), |_| [2, 2], &mut |_| true).unwrap().to_mesh();
    mesh.validate().unwrap();
    let objects: Vec<_> = mesh.objects.iter().map(|o| (&o.name[..], o.triangles.len())).collect();
    // Parts of the pentagons lose two cells' halves at each outer edge, which is as coarse as the side's.
    assert_eq!(objects, [("bottom", 5 * 28), ("none", 0), ("top", 5 * 28), ("side", 5 * 32)]);
    control.positions.fill([1.0; 3]);
    let none = RatedSurface::build(surface(&control), |_| [1, 1], &mut |_| true).unwrap().to_mesh();
    assert_eq!((none.triangles.len(), none.objects.len()), (0, 4));

    let place = |x: f32, scale: f32| {
        Affine3A::from_scale_rotation_translation(Vec3::splat(scale), Quat::IDENTITY, Vec3::X * x)
    };
    let levels = |places: &[Affine3A]| {
        let rated = RatedSurface::for_eye_on(
            surface(&cube()),
            places,
            &EyeRates::new(Vec3::X * 10.0, 0.02),
            &mut |_| true,
        )
        .unwrap();
        (0..6).map(|patch| rated.levels(patch)).collect::<Vec<_>>()
    };
    let (near, far, large) = (levels(&[place(7.0, 1.0)]), levels(&[place(-90.0, 1.0)]), place(-90.0, 10.0));
    assert_eq!(levels(&[place(-90.0, 1.0), place(7.0, 1.0)]), near);
    // Ten times as large at ten times the distance.
    assert_eq!(levels(&[large]), levels(&[place(0.0, 1.0)]));
    assert!(near.iter().zip(&far).all(|(n, f)| n[0] > f[0] + 2), "{near:?} {far:?}");
    assert_eq!(levels(&[]), [[0, 0]; 6]);
}

#[test]
fn bad_rates_are_named() {
    let error = |result: Result<RatedSurface, SurfaceError>, expected: &str| match result.err() {
        Some(SurfaceError::Option { name, .. }) => assert_eq!(name, expected),
        other => panic!("{expected}: {other:?}"),
    };
    error(RatedSurface::build(surface(&cube()), |_| [13, 0], &mut |_| true), "level");
    for width in [0.0, -1.0, f32::NAN, f32::INFINITY] {
        error(
            RatedSurface::for_eye(surface(&cube()), &EyeRates::new(Vec3::ZERO, width), &mut |_| true),
            "width",
        );
    }
    error(RatedSurface::for_eye(surface(&cube()), &EyeRates::new(Vec3::NAN, 1.0), &mut |_| true), "width");
    let rates = EyeRates::new(Vec3::ZERO, 1.0);
    error(RatedSurface::for_eye(surface(&cube()), &rates.with_max_level(13), &mut |_| true), "max_level");
    for bend in [-1.0, f32::NAN, f32::INFINITY] {
        error(RatedSurface::for_eye(surface(&cube()), &rates.with_bend(bend), &mut |_| true), "bend");
    }
    let rated = RatedSurface::build(surface(&cube()), |_| [2, 2], &mut |_| true).unwrap();
    for bad in [Ray::new([f32::NAN; 3], [0.0, 0.0, 1.0]), Ray::new([0.0; 3], [0.0; 3])] {
        assert!(!rated.any_hit(&bad) && rated.closest_hit(&bad).is_none());
    }
}
