//! Control meshes and options that can't be right, and those that look wrong but have an answer.

mod common;

use common::{cube, prism, sheet, spindle, zoo};
use std::sync::Arc;
use umbrage_geom::{FaceObject, MeshError, PolygonMesh, Ray, glam::Vec3};
use umbrage_reyes::{
    BoundaryRule, FootprintRule, RatedSurface, Surface, SurfaceError, SurfaceOptions, SurfaceTracer,
    TraceOptions, TraceState, camera_differential,
};

fn build(mesh: &PolygonMesh) -> Result<Surface, SurfaceError> {
    Surface::build(mesh, &SurfaceOptions::default())
}

fn error(mesh: &PolygonMesh) -> SurfaceError {
    build(mesh).expect_err("the mesh is bad")
}

#[test]
fn bad_meshes_are_named() {
    assert!(matches!(error(&PolygonMesh::default()), SurfaceError::Mesh(MeshError::Empty)));
    let with = |change: &dyn Fn(&mut PolygonMesh)| {
        let mut mesh = cube();
        change(&mut mesh);
        error(&mesh)
    };
    assert!(matches!(with(&|m| m.positions[3][1] = f32::NAN), SurfaceError::Mesh(_)));
    assert!(matches!(with(&|m| m.positions[3][1] = 1e30), SurfaceError::Mesh(_)));
    assert_eq!(with(&|m| m.corners.truncate(23)), SurfaceError::CornerCount { count: 23, expected: 24 });
    assert_eq!(with(&|m| m.corners[5] = 8), SurfaceError::VertexIndex { face: 1, vertex: 8, vertices: 8 });
    assert_eq!(with(&|m| m.corners[5] = 0), SurfaceError::RepeatedVertex { face: 1, vertex: 0 });
    let two = with(&|m| {
        m.face_sizes = vec![2; 12];
    });
    assert_eq!(two, SurfaceError::FaceSize { face: 0, size: 2 });
    // A seventh face over an edge that has two, and a face turned over.
    let third = with(&|m| {
        m.positions.push([3.0, 0.0, 0.0]);
        m.face_sizes.push(3);
        m.corners.extend([1, 3, 8]);
    });
    assert!(matches!(third, SurfaceError::NonManifoldEdge { .. }));
    assert!(matches!(with(&|m| m.corners[0..4].reverse()), SurfaceError::NonManifoldEdge { .. }));
    assert_eq!(with(&|m| m.creases.push(([0, 7], 1.0))), SurfaceError::CreaseEdge { edge: [0, 7] });
    assert!(matches!(with(&|m| m.creases.push(([0, 1], -1.0))), SurfaceError::Sharpness(_)));
    assert!(matches!(with(&|m| m.creases.push(([0, 1], f32::NAN))), SurfaceError::Sharpness(_)));
    let sharp = with(&|m| m.sharp_vertices.push((9, 1.0)));
    assert_eq!(sharp, SurfaceError::SharpVertex { vertex: 9, vertices: 8 });
    assert_eq!(with(&|m| m.corner_uvs.push([0.0; 2])), SurfaceError::UvCount { count: 1, expected: 24 });
    let nan = with(&|m| {
        m.corner_uvs = vec![[0.0; 2]; 24];
        m.corner_uvs[7][1] = f32::NAN;
    });
    assert_eq!(nan, SurfaceError::UvNotFinite { corner: 7 });
    // Runs of faces with a gap, an overlap, too many and too few.
    for runs in [[0..2, 3..6], [0..3, 2..6], [0..3, 3..7], [0..3, 3..5]] {
        let objects = runs.map(|faces| FaceObject { name: "part".into(), faces }).to_vec();
        let error = with(&|m| m.objects.clone_from(&objects));
        assert!(matches!(error, SurfaceError::ObjectFaces { count: 6, .. }), "{error}");
    }
    let options = SurfaceOptions::default().with_tight_levels(7);
    assert!(matches!(
        Surface::build(&cube(), &options),
        Err(SurfaceError::Option { name: "tight_levels", .. })
    ));
    let fan = spindle(umbrage_reyes::MAX_VALENCE as u32 + 1);
    assert!(matches!(error(&fan), SurfaceError::Valence { .. }));
}

/// All points and normals are finite.
fn check(name: &str, mesh: &PolygonMesh) {
    let surface = build(mesh).unwrap_or_else(|e| panic!("{name}: {e}"));
    let bounds = surface.bounds();
    for patch in 0..surface.patch_count() as u32 {
        for (u, v) in [(0.0, 0.0), (1.0, 1.0), (0.5, 0.25), (0.0, 1.0), (0.99, 0.01), (f32::NAN, 7.0)] {
            let point = surface.limit(patch, u, v);
            assert!(point.position.is_finite() && point.normal.is_finite(), "{name}");
            assert!(
                point.position.cmpge(bounds.min).all() && point.position.cmple(bounds.max).all(),
                "{name}: {} outside {bounds:?}",
                point.position
            );
        }
    }
    let (triangles, patches) = surface.tessellate(|patch| [(patch % 4) as u8, (patch % 3) as u8]).unwrap();
    assert_eq!(triangles.triangles.len(), patches.len());
    assert!(triangles.positions.iter().all(|&p| Vec3::from(p).is_finite()));
    check_rays(name, surface);
}

/// Rays through the middle end, by every rule, with footprints of no size and with none that are numbers, and what they hit is
/// where they say.
fn check_rays(name: &str, surface: Surface) {
    let surface = Arc::new(surface);
    let bounds = surface.bounds();
    let rules = [FootprintRule::Entry, FootprintRule::ExactFinalApproach, FootprintRule::DiagSplit];
    let rays: Vec<Ray> = (0..6u32)
        .map(|i| {
            let side = bounds.diagonal().max(1.0) * if i % 2 == 0 { 1.0 } else { -1.0 };
            let direction = Vec3::AXES[i as usize / 2] * side + Vec3::splat(0.01 * side);
            Ray::new(bounds.center() - direction, direction)
        })
        .collect();
    for rule in rules {
        let options = TraceOptions::default().with_footprint(rule).with_max_level(4).with_cache_bytes(20_000);
        let tracer = SurfaceTracer::new(Arc::clone(&surface), &options).unwrap();
        let mut state = TraceState::new(&options);
        for ray in &rays {
            for width in [0.0, f32::NAN, 0.3 * bounds.diagonal()] {
                let d = camera_differential(Vec3::X * width, Vec3::Y * width);
                let hit = tracer.closest_hit(ray, &d, &mut state);
                assert_eq!(tracer.any_hit(ray, &d, &mut state), hit.is_some(), "{name}, {rule:?}");
                let Some(hit) = hit else { continue };
                let p = ray.at(hit.t);
                let room = 1e-5 * (bounds.diagonal() + p.abs().max_element());
                assert!(p.cmpge(bounds.min - room).all() && p.cmple(bounds.max + room).all(), "{name}");
            }
        }
        assert!(tracer.peak_grid_bytes() <= 20_000);
    }
    let rated = RatedSurface::build(surface, |patch| [(patch % 3) as u8, 2], &mut |_| true).unwrap();
    for ray in &rays {
        assert_eq!(rated.any_hit(ray), rated.closest_hit(ray).is_some(), "{name}");
    }
    let mesh = rated.to_mesh();
    assert!(mesh.triangles.is_empty() || mesh.validate().is_ok(), "{name}");
}

#[test]
fn strange_meshes_have_answers() {
    check("valence 60", &spindle(60));
    check("valence 60 of quadrilaterals and a polygon of 60 corners", &prism(60));
    let mut isolated = cube();
    isolated.positions.push([50.0, 50.0, 50.0]);
    check("isolated vertex", &isolated);
    assert!(build(&isolated).unwrap().bounds().max.max_element() < 2.0);
    // Two faces back to back: every vertex has valence 2.
    let pillow = PolygonMesh {
        positions: vec![[0.0; 3], [1.0, 0.0, 0.0], [1.0, 1.0, 0.3], [0.0, 1.0, 0.0]],
        face_sizes: vec![4, 4],
        corners: vec![0, 1, 2, 3, 3, 2, 1, 0],
        ..PolygonMesh::default()
    };
    check("valence 2", &pillow);
    let mut flat = cube();
    flat.positions.fill([1.0, 2.0, 3.0]);
    check("no area", &flat);
    let mut folded = sheet(3, |_, _| 0.0);
    folded.positions[5] = folded.positions[6];
    check("zero-area faces", &folded);
    // Two cubes that share a vertex.
    let mut bow = cube();
    let other = cube();
    bow.positions.extend(other.positions.iter().map(|p| p.map(|x| x + 2.0)));
    bow.face_sizes.extend(&other.face_sizes);
    bow.corners.extend(other.corners.iter().map(|&v| if v == 0 { 7 } else { v + 8 }));
    check("two fans at a vertex", &bow);
    let mut slit = cube();
    // An edge cut open: a vertex of valence 2 at each end, two boundary edges in one place.
    slit.positions.extend([slit.positions[0], slit.positions[1]]);
    for corner in &mut slit.corners[12..16] {
        *corner = [8, 9, *corner, *corner][(*corner).min(2) as usize];
    }
    check("slit", &slit);
    check("holes", &zoo().swap_remove(3).1);
    let mut sharp = cube();
    sharp.creases = vec![([0, 1], f32::INFINITY), ([1, 3], 1e30), ([0, 2], 9.99)];
    sharp.sharp_vertices = vec![(7, f32::INFINITY), (6, 0.0)];
    check("infinite sharpness", &sharp);
    let mut far = cube();
    for p in &mut far.positions {
        p[0] += 1e6;
    }
    check("far away", &far);
    let mut huge = cube();
    huge.positions.iter_mut().flatten().for_each(|x| *x *= 1e23);
    check("huge", &huge);
}

#[test]
fn corners_of_open_meshes_stay_where_the_rule_says() {
    let corner = |boundary| {
        let mesh = PolygonMesh { boundary, ..sheet(2, |_, _| 0.0) };
        build(&mesh).unwrap().limit(0, 0.0, 0.0).position
    };
    assert_eq!(corner(BoundaryRule::EdgeAndCorner), Vec3::ZERO);
    // The boundary's cubic B-spline: a sixth of each neighbour.
    assert!(corner(BoundaryRule::EdgeOnly).abs_diff_eq(Vec3::new(1.0 / 6.0, 1.0 / 6.0, 0.0), 1e-6));
}
