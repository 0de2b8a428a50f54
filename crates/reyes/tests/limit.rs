//! Points of the limit surface against many levels of refinement.

mod common;

use common::{cube, sheet, size_of, zoo};
use umbrage_geom::{
    PolygonMesh,
    glam::{DMat3, DVec3, Vec3},
};
use umbrage_reyes::{BoundaryRule, CreaseMethod, SubdivisionMesh, Surface, SurfaceOptions};

fn build(mesh: &PolygonMesh) -> Surface {
    Surface::build(mesh, &SurfaceOptions::default()).unwrap()
}

fn refined(mesh: &SubdivisionMesh, levels: u32) -> SubdivisionMesh {
    (0..levels).fold(mesh.clone(), |mesh, _| mesh.refine())
}

/// The limit of a sequence that converges geometrically (Aitken), from three levels.
fn extrapolated([p, q, r]: [DVec3; 3]) -> DVec3 {
    let ratio = if p == q { 0.0 } else { ((r - q).dot(q - p) / (q - p).length_squared()).clamp(0.0, 0.8) };
    r + (r - q) * (ratio / (1.0 - ratio))
}

/// The limit at a regular vertex, whose error is a sum of powers of 1/4.
fn richardson([p, q, r]: [DVec3; 3]) -> DVec3 {
    let (a, b) = (q + (q - p) / 3.0, r + (r - q) / 3.0);
    b + (b - a) / 15.0
}

#[test]
fn limit_points_are_those_of_eight_levels() {
    for (name, control) in zoo() {
        let surface = build(&control);
        let mesh = SubdivisionMesh::new(&control, BoundaryRule::EdgeOnly, CreaseMethod::Uniform).unwrap();
        let size = size_of(&control);
        let levels = if control.face_sizes.len() > 12 { 4 } else { 5 };
        let fine = refined(&mesh, levels);
        let finer = fine.refine();
        let finest = finer.refine();
        let mut worst = 0f64;
        for patch in 0..surface.patch_count() as u32 {
            let (face, part) = surface.face_of(patch);
            let face = mesh.faces().nth(face as usize).unwrap();
            for k in 0..4 {
                let vertex = match part {
                    None => face[k],
                    Some(corner) if k == 0 => face[corner as usize],
                    Some(_) => continue,
                };
                let (u, v) = [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)][k];
                let limit = surface.limit(patch, u, v).position.as_dvec3();
                let at = [&fine, &finer, &finest].map(|mesh| mesh.positions()[vertex as usize]);
                worst = worst.max(limit.distance(extrapolated(at)) / size);
            }
        }
        assert!(worst < 2e-6, "{name}: {worst:e}");
    }
}

/// Inner points: the surface of the refined mesh is the same surface.
#[test]
fn refining_the_control_mesh_changes_no_point() {
    for (name, control) in zoo() {
        if control.face_sizes.iter().any(|&n| n != 4) {
            continue;
        }
        let mesh = SubdivisionMesh::new(&control, BoundaryRule::EdgeOnly, CreaseMethod::Uniform).unwrap();
        let fine = refined(&mesh, 4);
        let coarse = build(&control);
        let finer = fine.refine();
        let finest = finer.refine();
        let size = size_of(&control);
        for patch in 0..coarse.patch_count() as u32 {
            // Corner 0 of face 4 f + k at each level, followed by its place in the patch.
            for path in 0..256u32 {
                let (mut face, mut turn) = (patch, 0u32);
                let (mut u, mut v, mut step) = (0f32, 0f32, 0.5f32);
                for level in 0..4 {
                    let k = path >> (2 * level) & 3;
                    let corner = (k + turn) % 4;
                    u += step * [0.0, 1.0, 1.0, 0.0][corner as usize];
                    v += step * [0.0, 0.0, 1.0, 1.0][corner as usize];
                    face = 4 * face + k;
                    turn = corner;
                    step *= 0.5;
                }
                let vertex = fine.faces().nth(face as usize).map(|f| f[0]);
                let Some(vertex) = vertex.filter(|_| path % 17 == 0) else { continue };
                // Corner `turn` of the smallest part.
                let last = 2.0 * step;
                u += last * [0.0, 1.0, 1.0, 0.0][turn as usize];
                v += last * [0.0, 0.0, 1.0, 1.0][turn as usize];
                let limit = coarse.limit(patch, u, v).position.as_dvec3();
                let at = [&fine, &finer, &finest].map(|mesh| mesh.positions()[vertex as usize]);
                let is_control = (u == 0.0 || u == 1.0) && (v == 0.0 || v == 1.0);
                let expected = if is_control { extrapolated(at) } else { richardson(at) };
                let off = limit.distance(expected) / size;
                assert!(off < 2e-6, "{name}, patch {patch} at {u}, {v}: {off:e}");
            }
        }
    }
}

#[test]
fn normals_are_perpendicular_to_differences() {
    for (name, control) in zoo() {
        let surface = build(&control);
        for patch in 0..surface.patch_count() as u32 {
            for (u, v, towards) in [
                (0.0, 0.0, [(1e-3, 0.0), (0.0, 1e-3)]),
                (1.0, 0.0, [(-1e-3, 0.0), (0.0, 1e-3)]),
                (1.0, 1.0, [(-1e-3, 0.0), (0.0, -1e-3)]),
                (0.0, 1.0, [(1e-3, 0.0), (0.0, -1e-3)]),
                (0.5, 0.3, [(1e-3, 0.0), (0.0, 1e-3)]),
            ] {
                let point = surface.limit(patch, u, v);
                assert!((point.normal.length() - 1.0).abs() < 1e-5, "{name}, patch {patch} at {u}, {v}");
                // A corner without creases is a spike, along which directions converge slowly.
                if control
                    .sharp_vertices
                    .iter()
                    .any(|&(v, s)| s >= 10.0 && Vec3::from(control.positions[v as usize]) == point.position)
                {
                    continue;
                }
                for (a, b) in towards {
                    let chord =
                        (surface.limit(patch, u + a, v + b).position - point.position).normalize_or_zero();
                    let off = chord.dot(point.normal).abs();
                    // One-sided differences at 1/1000 of a patch, coarser where the tangent's length vanishes.
                    assert!(off < 0.06, "{name}, patch {patch} at {u}, {v} towards {a}, {b}: {off}");
                }
            }
        }
    }
}

/// Convex control meshes around the origin have normals that point away from it.
#[test]
fn normals_point_outwards() {
    let surface = build(&cube());
    for patch in 0..6 {
        for (u, v) in [(0.0, 0.0), (0.5, 0.5), (1.0, 0.3), (0.9, 1.0)] {
            let point = surface.limit(patch, u, v);
            assert!(point.normal.dot(point.position) > 0.5);
        }
    }
}

#[test]
fn surfaces_are_affinely_invariant() {
    let map =
        DMat3::from_cols(DVec3::new(1.2, 0.3, -0.4), DVec3::new(-0.1, 0.8, 0.5), DVec3::new(0.2, 0.1, 1.4));
    let shift = DVec3::new(0.5, -0.25, 1.0);
    for (name, control) in zoo() {
        let mut moved = control.clone();
        for p in &mut moved.positions {
            *p = (map * Vec3::from(*p).as_dvec3() + shift).as_vec3().to_array();
        }
        let (a, b) = (build(&control), build(&moved));
        let size = size_of(&moved);
        for patch in 0..a.patch_count() as u32 {
            for (u, v) in [(0.0, 0.0), (0.25, 0.125), (1.0, 0.5), (0.7, 0.9)] {
                let expected = map * a.limit(patch, u, v).position.as_dvec3() + shift;
                let off = expected.distance(b.limit(patch, u, v).position.as_dvec3()) / size;
                assert!(off < 2e-6, "{name}: {off:e}");
            }
        }
    }
}

/// Weights add up to 1: a control mesh in one point is that point, and a flat one stays in its plane.
#[test]
fn weights_are_a_partition_of_unity() {
    for (name, mut control) in zoo() {
        control.positions.fill([3.0, -5.0, 7.0]);
        let surface = build(&control);
        for patch in 0..surface.patch_count() as u32 {
            for (u, v) in [(0.0, 0.0), (0.3, 0.6), (1.0, 1.0), (0.5, 0.0)] {
                let off =
                    (surface.limit(patch, u, v).position - Vec3::new(3.0, -5.0, 7.0)).abs().max_element();
                assert!(off <= 4e-6, "{name}: {off:e}");
            }
        }
    }
}

#[test]
fn regular_patches_join_with_two_derivatives() {
    let surface = build(&sheet(6, |i, j| ((i * 5 + j * 11) % 7) as f32 * 0.2));
    let side = 6;
    for (x, y) in [(1, 2), (2, 2), (3, 1), (2, 4)] {
        let left = surface.bicubic(y * side + x).unwrap();
        let right = surface.bicubic(y * side + x + 1).unwrap();
        for v in [0.0, 0.4, 1.0] {
            let h = 1e-3;
            assert!(left.position(1.0, v).abs_diff_eq(right.position(0.0, v), 1e-6));
            let (a, b) = (left.derivatives(1.0, v), right.derivatives(0.0, v));
            assert!(a[0].abs_diff_eq(b[0], 1e-5) && a[1].abs_diff_eq(b[1], 1e-5));
            let second = |p: Vec3, q: Vec3| (q - p) / h as f32;
            let from_left = second(left.derivatives(1.0 - h, v)[0], left.derivatives(1.0, v)[0]);
            let from_right = second(right.derivatives(0.0, v)[0], right.derivatives(h, v)[0]);
            assert!(from_left.abs_diff_eq(from_right, 2e-2), "{from_left} {from_right}");
        }
    }
}

#[test]
fn texture_coordinates_follow_seams() {
    let mut control = sheet(4, |_, _| 0.0);
    let corner_uv = |v: u32| [(v % 5) as f32 / 4.0, (v / 5) as f32 / 4.0];
    control.corner_uvs = control.corners.iter().map(|&v| corner_uv(v)).collect();
    // The right half is another chart.
    for face in (0..16).filter(|face| face % 4 >= 2) {
        control.corner_uvs[4 * face..4 * face + 4].iter_mut().for_each(|uv| uv[0] += 10.0);
    }
    let surface = build(&control);
    for patch in 0..16u32 {
        let chart = if patch % 4 >= 2 { 10.0 } else { 0.0 };
        for (u, v) in [(0.0, 0.0), (1.0, 0.5), (0.25, 1.0)] {
            let uv = surface.uv(patch, u, v).unwrap();
            let p = surface.limit(patch, u, v).position;
            assert!(uv.x >= chart - 1e-6 && uv.x <= chart + 1.0 + 1e-6);
            // Straight seams keep their place; the middle column's chart border is where the geometry is 2.
            if patch % 4 == 1 && u == 1.0 {
                assert!((uv.x - 0.5).abs() < 1e-6 && (p.x - 2.0).abs() < 1e-6);
            }
        }
    }
    assert!(build(&sheet(2, |_, _| 0.0)).uv(0, 0.5, 0.5).is_none());
}
