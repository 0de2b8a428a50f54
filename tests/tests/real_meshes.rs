//! Real models, where the folder `../shared/meshes` (or `UMBRAGE_MESHES`) exists; a clear word where it doesn't.

use std::path::PathBuf;
use umbrage::inspect::inspect_mesh;
use umbrage_accel::{BuildOptions, Bvh, brute};
use umbrage_bake::{Bake, BakeOptions, NormalSource, Receivers};
use umbrage_geom::{Ray, TriangleMesh, glam::Vec3, sampling::RandomStream, sampling::uniform_sphere};
use umbrage_query::{Ground, Occluders};
use umbrage_scene::{Radius, read_mesh};

fn mesh(name: &str) -> Option<TriangleMesh> {
    let default = || PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../../shared/meshes"));
    let folder = std::env::var_os("UMBRAGE_MESHES").map_or_else(default, PathBuf::from);
    if !folder.is_dir() {
        eprintln!("SKIPPED: {name}: no folder {} and no UMBRAGE_MESHES", folder.display());
        return None;
    }
    Some(read_mesh(&folder.join(name)).unwrap())
}

/// Random rays through the bounds, half of them aimed at vertices, against a loop over all triangles.
fn agrees_with_brute_force(name: &str, rays: usize) {
    let Some(mesh) = mesh(name) else { return };
    let bvh = Bvh::build(&mesh.positions, &mesh.triangles, &BuildOptions::default()).unwrap();
    let bounds = mesh.bounds();
    let mut random = RandomStream::new(11, 0);
    let mut hits = 0;
    for i in 0..rays {
        let mut unit = || random.next_unit();
        let origin = bounds.min + bounds.size() * Vec3::new(unit(), unit(), unit()) * 1.2;
        let direction = if i % 2 == 0 {
            uniform_sphere([unit(), unit()].into())
        } else {
            let vertex = random.next_below(mesh.positions.len() as u32);
            Vec3::from(mesh.positions[vertex as usize]) - origin
        };
        let ray = Ray::new(origin, direction);
        let truth = brute::closest_hit(&mesh.positions, &mesh.triangles, &ray);
        assert_eq!(bvh.closest_hit(&ray), truth, "{name}: {ray:?}");
        assert_eq!(bvh.any_hit(&ray), truth.is_some(), "{name}: {ray:?}");
        hits += usize::from(truth.is_some());
    }
    assert!(hits > rays / 4, "{name}: only {hits} of {rays} rays hit");
}

#[test]
fn bunny_agrees_with_brute_force() {
    agrees_with_brute_force("closed/bunny_6k.obj", 1500);
}

#[test]
fn fandisk_with_its_flat_faces_agrees_with_brute_force() {
    agrees_with_brute_force("closed/fandisk.obj", 700);
}

#[test]
fn teapot_agrees_with_brute_force() {
    agrees_with_brute_force("open/teapot.obj", 1500);
}

#[test]
fn sibenik_agrees_with_brute_force() {
    agrees_with_brute_force("scenes/sibenik.obj", 120);
}

#[test]
fn rays_from_inside_closed_meshes_never_leak() {
    for name in ["closed/spot.obj", "closed/sphere_1280.obj", "closed/torus_4608.obj"] {
        let Some(mesh) = mesh(name) else { return };
        let bvh = Bvh::build(&mesh.positions, &mesh.triangles, &BuildOptions::default()).unwrap();
        let normals = mesh.smooth_normals();
        let mut random = RandomStream::new(3, 0);
        for _ in 0..20_000 {
            // Just under a vertex, hence inside, aimed at another vertex or anywhere.
            let v = random.next_below(mesh.positions.len() as u32) as usize;
            let inside =
                Vec3::from(mesh.positions[v]) - 1e-3 * mesh.bounds().diagonal() * Vec3::from(normals[v]);
            let target = Vec3::from(mesh.positions[random.next_below(mesh.positions.len() as u32) as usize]);
            let ray = Ray::new(inside, target - inside);
            let back = Ray::new(inside, inside - target);
            assert!(bvh.any_hit(&ray) && bvh.any_hit(&back), "{name}: {ray:?}");
        }
    }
}

#[test]
fn inspection_agrees_with_the_counts_of_the_collection() {
    let Some(sibenik) = mesh("scenes/sibenik.obj") else { return };
    let report = inspect_mesh(&sibenik);
    assert_eq!((report.vertices, report.triangles), (40_979, 75_284));
    assert!(report.degenerate_triangles <= 13);
    let Some(bunny) = mesh("closed/bunny_6k.obj") else { return };
    let report = inspect_mesh(&bunny);
    assert_eq!((report.vertices, report.triangles, report.degenerate_triangles), (3_301, 6_598, 0));
    assert!(report.edges.closed());
}

#[test]
fn baked_creases_are_darker_than_bumps() {
    let Some(mesh) = mesh("closed/bunny_6k.obj") else { return };
    let occluders = Occluders::of_meshes(&[&mesh], Ground::Absent, &mut |_| true).unwrap();
    let receivers = Receivers::vertices(&mesh, NormalSource::Smooth).unwrap();
    let options = BakeOptions::default().with_rays(64).with_radius(Radius::OfDiagonal(0.1));
    let mut ao = vec![f32::NAN; receivers.len()];
    Bake::new(&occluders, &receivers, &options).run(&mut ao, &mut |_| true).unwrap();
    // Curvature by the offset of a vertex from the mean of its neighbours, along its normal.
    let normals = mesh.smooth_normals();
    let mut sums = vec![(Vec3::ZERO, 0.0); mesh.positions.len()];
    for t in &mesh.triangles {
        for i in 0..3 {
            let sum = &mut sums[t[i] as usize];
            sum.0 += Vec3::from(mesh.positions[t[(i + 1) % 3] as usize]);
            sum.1 += 1.0;
        }
    }
    let (mut concave, mut convex) = (Vec::new(), Vec::new());
    for (v, (sum, count)) in sums.into_iter().enumerate() {
        let bump = (Vec3::from(mesh.positions[v]) - sum / count).dot(normals[v].into());
        if bump < -0.002 {
            concave.push(ao[v])
        } else if bump > 0.002 {
            convex.push(ao[v])
        }
    }
    let mean = |values: &[f32]| values.iter().sum::<f32>() / values.len() as f32;
    assert!(concave.len() > 20 && convex.len() > 20);
    assert!(mean(&concave) + 0.05 < mean(&convex), "{} {}", mean(&concave), mean(&convex));
}
