//! Points of the limit surface against many levels of refinement.

mod common;

use common::{cube, mesh_folder, prism, sheet, size_of, spindle, zoo};
use umbrage_geom::{
    PolygonMesh,
    glam::{DMat3, DVec3, Vec3},
};
use umbrage_reyes::{BoundaryRule, CreaseMethod, SubdivisionMesh, Surface, SurfaceOptions};
use umbrage_scene::read_polygons;

fn build(mesh: &PolygonMesh) -> Surface {
    Surface::build(mesh, &SurfaceOptions::default()).unwrap()
}

fn refined(mesh: &SubdivisionMesh, levels: u32) -> SubdivisionMesh {
    (0..levels).fold(mesh.clone(), |mesh, _| mesh.refine())
}

/// Where a vertex goes in so many levels: only the faces around it are refined.
fn followed(mesh: &SubdivisionMesh, vertex: u32, levels: u32) -> DVec3 {
    let start = mesh.around(vertex).unwrap();
    (0..levels).fold(start, |mesh, _| mesh.refine().around(0).unwrap()).positions()[0]
}

/// Levels after which nothing moves any more, at any valence here: distances shrink to three quarters at least.
const SETTLED: u32 = 90;

/// A vertex of the `levels` times refined mesh in each patch and its parameters there: one of `stride` faces.
fn places(
    mesh: &SubdivisionMesh,
    surface: &Surface,
    levels: u32,
    stride: usize,
) -> Vec<(u32, [f32; 2], u32)> {
    let fine = refined(mesh, levels);
    let faces: Vec<&[u32]> = fine.faces().collect();
    let starts: Vec<u32> = mesh
        .faces()
        .scan(0, |end, face| {
            *end += face.len() as u32;
            Some(*end - face.len() as u32)
        })
        .collect();
    let mut found = Vec::new();
    for patch in 0..surface.patch_count() as u32 {
        // A part of a face is a face of the next level.
        let (face, part) = surface.face_of(patch);
        let start = part.map_or(face, |corner| starts[face as usize] + corner);
        let depth = levels - u32::from(part.is_some());
        for path in (0..1u32 << (2 * depth)).step_by(stride) {
            let (mut face, mut corner) = (start, 0);
            let (mut u, mut v, mut step) = (0f32, 0f32, 0.5f32);
            for level in 0..depth {
                // Child `k` of a face starts with the face's corner `k`.
                let k = path >> (2 * level) & 3;
                corner = (k + corner) % 4;
                u += step * [0.0, 1.0, 1.0, 0.0][corner as usize];
                v += step * [0.0, 0.0, 1.0, 1.0][corner as usize];
                face = if level == 0 && part.is_none() { starts[face as usize] + k } else { 4 * face + k };
                step *= 0.5;
            }
            u += 2.0 * step * [0.0, 1.0, 1.0, 0.0][corner as usize];
            v += 2.0 * step * [0.0, 0.0, 1.0, 1.0][corner as usize];
            found.push((patch, [u, v], faces[face as usize][0]));
        }
    }
    found
}

/// The largest distance of limit positions from vertices that were refined 8 times more, in sizes of the mesh; corners of
/// patches, where vertices of high valence are still on their way then, from vertices that have settled. One of `stride` places
/// in each patch, one of `every` in all.
fn worst_limit(control: &PolygonMesh, levels: u32, stride: usize, every: usize) -> f64 {
    let mesh = SubdivisionMesh::new(control).unwrap();
    let (surface, fine) = (build(control), refined(&mesh, levels));
    let mut worst = 0f64;
    for (patch, [u, v], vertex) in places(&mesh, &surface, levels, stride).into_iter().step_by(every) {
        let is_corner = (u == 0.0 || u == 1.0) && (v == 0.0 || v == 1.0);
        let truth = followed(&fine, vertex, if is_corner { SETTLED } else { 8 });
        let off = surface.limit(patch, u, v).position.as_dvec3().distance(truth);
        worst = worst.max(off / size_of(control));
    }
    worst
}

#[test]
fn limit_points_are_those_of_eight_more_levels() {
    for (name, control) in zoo().into_iter().chain([("valence 60", spindle(60)), ("60 corners", prism(60))]) {
        let stride = if control.face_sizes.len() > 60 { 29 } else { 5 };
        let worst = worst_limit(&control, 4, stride, 1);
        println!("{name}: {worst:e}");
        assert!(worst < 5e-7, "{name}: {worst:e}");
    }
}

#[test]
fn limit_points_of_characters_are_those_of_eight_more_levels() {
    let Some(folder) = mesh_folder() else { return };
    for name in ["bigguy", "monsterfrog", "killeroo_requad"] {
        let path = folder.join("subdivision").join(name).with_extension("obj");
        let worst = worst_limit(&read_polygons(&path).unwrap(), 2, 7, 19);
        println!("{name}: {worst:e}");
        assert!(worst < 5e-7, "{name}: {worst:e}");
    }
}

/// With the rules that the files name, or imply.
#[test]
fn limit_points_of_tagged_shapes_are_those_of_eight_more_levels() {
    let Some(folder) = mesh_folder() else { return };
    let mut shapes = 0;
    for entry in std::fs::read_dir(folder.join("opensubdiv")).unwrap() {
        let path = entry.unwrap().path();
        if !path.file_stem().unwrap().to_str().unwrap().ends_with("_control") {
            continue;
        }
        let worst = worst_limit(&read_polygons(&path).unwrap(), 4, 29, 1);
        println!("{}: {worst:e}", path.display());
        assert!(worst < 5e-7, "{}: {worst:e}", path.display());
        shapes += 1;
    }
    assert!(shapes >= 15, "{shapes} shapes");
}

/// Corners that keep their place, and Chaikin's creases.
#[test]
fn limit_points_obey_the_rules_of_the_mesh() {
    let mut chain = sheet(4, |i, j| ((i * 7 + j * 3) % 5) as f32 * 0.3);
    chain.creases = vec![([11, 12], 3.0), ([12, 13], 1.5), ([12, 17], 0.8), ([17, 22], 10.0)];
    for (name, control) in zoo().into_iter().chain([("chain", chain.clone())]) {
        let (boundary, crease_method) = (BoundaryRule::EdgeAndCorner, CreaseMethod::Chaikin);
        let worst = worst_limit(&PolygonMesh { boundary, crease_method, ..control }, 3, 3, 1);
        assert!(worst < 5e-7, "{name}: {worst:e}");
    }
    // Corner 0 of the sheet is that of patch 0, vertex 12 that of patch 10.
    let uniform = build(&chain);
    let pinned = build(&PolygonMesh { boundary: BoundaryRule::EdgeAndCorner, ..chain.clone() });
    let chaikin = build(&PolygonMesh { crease_method: CreaseMethod::Chaikin, ..chain.clone() });
    let at = |surface: &Surface, patch| surface.limit(patch, 0.0, 0.0).position;
    assert_eq!(at(&pinned, 0), Vec3::from(chain.positions[0]));
    assert!(at(&uniform, 0).distance(at(&pinned, 0)) > 0.1);
    assert_eq!((at(&pinned, 10), at(&chaikin, 0)), (at(&uniform, 10), at(&uniform, 0)));
    assert!(at(&chaikin, 10).distance(at(&uniform, 10)) > 1e-4, "{}", at(&chaikin, 10));
}

/// A ridge of height 1 in the plane, of sharpness 1 on one side of its middle and 2 on the other. By hand: after a level, at
/// which it stays, sharpness is 0 and 1, or, by Chaikin's method, 0.25 and 0.75, whose blend is half a crease's.
#[test]
fn sharpness_decays_as_calculated_by_hand() {
    let mut ridge = sheet(4, |_, j| if j == 2 { 1.0 } else { 0.0 });
    ridge.creases = vec![([11, 12], 1.0), ([12, 13], 2.0)];
    for (crease_method, height) in [(CreaseMethod::Uniform, 61.0 / 72.0), (CreaseMethod::Chaikin, 0.875)] {
        let surface = build(&PolygonMesh { crease_method, ..ridge.clone() });
        let middle = surface.limit(10, 0.0, 0.0).position;
        assert!(middle.abs_diff_eq(Vec3::new(2.0, 2.0, height), 1e-6), "{crease_method:?}: {middle}");
    }
}

/// What is around a vertex doesn't need the rest of the mesh.
#[test]
fn vertices_need_only_what_is_around_them() {
    for (name, control) in zoo() {
        for method in [CreaseMethod::Uniform, CreaseMethod::Chaikin] {
            let boundary = BoundaryRule::EdgeAndCorner;
            let control = PolygonMesh { boundary, crease_method: method, ..control.clone() };
            let mesh = SubdivisionMesh::new(&control).unwrap();
            let fine = refined(&mesh, 3);
            for vertex in 0..control.positions.len() as u32 {
                let off = followed(&mesh, vertex, 3).distance(fine.positions()[vertex as usize]);
                assert!(off < 1e-14 * size_of(&control), "{name}, vertex {vertex}: {off:e}");
            }
            assert!(mesh.around(mesh.positions().len() as u32).is_none());
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

/// Charts that meet at an extraordinary vertex, a dart of a seam that ends inside, and one chart that ignores another's values.
#[test]
fn texture_seams_end_and_meet() {
    // Each side of a cube is its own chart: a square that keeps its corners.
    let mut control = cube();
    let chart = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]];
    control.corner_uvs = (0..6).flat_map(|side| chart.map(|[u, v]| [u + 2.0 * side as f32, v])).collect();
    let surface = build(&control);
    for patch in 0..6 {
        for (u, v) in [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0), (0.5, 0.0), (0.5, 0.5)] {
            let uv = surface.uv(patch, u, v).unwrap();
            let expected = [u + 2.0 * patch as f32, v];
            assert!((uv.x - expected[0]).abs() < 1e-5 && (uv.y - expected[1]).abs() < 1e-6, "{patch}: {uv}");
        }
    }
    // Other values in one chart change no other.
    control.corner_uvs[..4].iter_mut().for_each(|uv| uv[1] *= 5.0);
    let changed = build(&control);
    assert_ne!(changed.uv(0, 0.3, 0.7), surface.uv(0, 0.3, 0.7));
    assert!((1..6).all(|patch| changed.uv(patch, 0.3, 0.7) == surface.uv(patch, 0.3, 0.7)));
    // A slit from the boundary to the middle vertex: there the two sides meet.
    let mut slit = sheet(4, |_, _| 0.0);
    slit.corner_uvs = slit.corners.iter().map(|&v| [(v % 5) as f32, (v / 5) as f32]).collect();
    for (corner, &v) in slit.corners.iter().enumerate() {
        if [2, 7].contains(&v) && (corner / 4) % 4 >= 2 {
            slit.corner_uvs[corner][0] += 0.5;
        }
    }
    let surface = build(&slit);
    let sides = |row: u32, v: f32| {
        let [left, right] =
            [(4 * row + 1, 1.0), (4 * row + 2, 0.0)].map(|(p, u)| surface.uv(p, u, v).unwrap());
        right - left
    };
    assert!((sides(0, 0.0).x - 0.5).abs() < 1e-6 && (sides(0, 1.0).x - 0.5).abs() < 0.1);
    assert!(sides(1, 1.0).length() < 1e-6 && sides(2, 0.4).length() < 1e-6);
    let gaps = [0.0, 0.25, 0.5, 0.75, 1.0].map(|v| sides(1, v).x);
    assert!(gaps.is_sorted_by(|a, b| a > b) && gaps[0] > 0.2, "{gaps:?}");
}
