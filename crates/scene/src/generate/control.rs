//! Control meshes of subdivision surfaces: `cube-sphere`, `creased-cube`, `open-patch`, `star-tube`.

use super::{Generated, Inputs, random::heading};
use umbrage_geom::{FaceObject, PolygonMesh, glam::Vec3};

fn generated(mut control: PolygonMesh, name: &str) -> Generated {
    control.objects = vec![FaceObject { name: name.into(), faces: 0..control.face_sizes.len() as u32 }];
    let mesh = control.triangulate().expect("control meshes are valid as written");
    Generated { mesh, control: Some(control) }
}

/// A cube of the given half width that stands on the ground.
fn cube(half: f32) -> PolygonMesh {
    let corner = |i: u32| {
        let side = |bit: u32| if i >> bit & 1 == 1 { half } else { -half };
        [side(0), side(1) + half, side(2)]
    };
    let faces: [[u32; 4]; 6] =
        [[1, 3, 7, 5], [0, 4, 6, 2], [2, 6, 7, 3], [0, 1, 5, 4], [4, 5, 7, 6], [0, 2, 3, 1]];
    PolygonMesh {
        positions: (0..8).map(corner).collect(),
        face_sizes: vec![4; 6],
        corners: faces.concat(),
        ..PolygonMesh::default()
    }
}

pub fn cube_sphere(_: &Inputs) -> Generated {
    generated(cube(1.0), "cube-sphere")
}

pub fn creased_cube(inputs: &Inputs) -> Generated {
    let sharpness = inputs.number("sharpness") as f32;
    let mut control = cube(1.0);
    // The top is rimmed, one upright edge fades at half the sharpness and one lower corner stays a corner.
    let rim = [[2, 3], [3, 7], [7, 6], [6, 2]];
    control.creases = rim.map(|edge| (edge, sharpness)).to_vec();
    if sharpness > 0.0 {
        control.creases.push(([1, 3], sharpness * 0.5));
        control.sharp_vertices.push((0, sharpness));
    } else {
        control.creases.clear();
    }
    generated(control, "creased-cube")
}

/// A wavy sheet of 4 x 4 quads with a hole of one quad, so that it has an outer and an inner boundary.
pub fn open_patch(_: &Inputs) -> Generated {
    let mut control = PolygonMesh::default();
    for j in 0..5u8 {
        for i in 0..5u8 {
            let (x, z) = (f32::from(i) * 0.5 - 1.0, 1.0 - f32::from(j) * 0.5);
            let y = 0.5 + if (i + j) % 2 == 0 { 0.25 } else { -0.25 } * f32::from(i) / 2.0;
            control.positions.push([x, y, z]);
        }
    }
    for j in 0..4u32 {
        for i in 0..4u32 {
            let a = j * 5 + i;
            if (i, j) != (1, 2) {
                control.face_sizes.push(4);
                control.corners.extend([a, a + 1, a + 6, a + 5]);
                let uv = |i: u32, j: u32| [i as f32 / 4.0, j as f32 / 4.0];
                control.corner_uvs.extend([uv(i, j), uv(i + 1, j), uv(i + 1, j + 1), uv(i, j + 1)]);
            }
        }
    }
    generated(control, "open-patch")
}

/// A column whose cross-section is a star of `points` points, closed by polygons of `2 points` corners: limit points
/// of high valence, faces that aren't quads, and necks.
pub fn star_tube(inputs: &Inputs) -> Generated {
    let points = inputs.number("points") as u32;
    let sides = 2 * points;
    let mut control = PolygonMesh::default();
    let rows = [(0.6, 0.0), (1.0, 0.4), (0.5, 1.0), (0.9, 1.6), (0.7, 2.0)];
    for (radius, height) in rows {
        for k in 0..sides {
            let reach = radius * if k % 2 == 0 { 1.0 } else { 0.6 };
            let p = heading(-std::f32::consts::TAU * k as f32 / sides as f32) * reach;
            control.positions.push((p + Vec3::Y * height).to_array());
        }
    }
    for row in 0..rows.len() as u32 - 1 {
        for k in 0..sides {
            let (a, b) = (row * sides + k, row * sides + (k + 1) % sides);
            control.face_sizes.push(4);
            control.corners.extend([a, b, b + sides, a + sides]);
        }
    }
    // A polygon below, a fan around a vertex of valence `sides` above.
    control.face_sizes.push(sides);
    control.corners.extend((0..sides).rev());
    let top = (rows.len() as u32 - 1) * sides;
    let apex = control.positions.len() as u32;
    control.positions.push([0.0, 2.2, 0.0]);
    for k in 0..sides {
        control.face_sizes.push(3);
        control.corners.extend([top + k, top + (k + 1) % sides, apex]);
    }
    generated(control, "star-tube")
}

#[cfg(test)]
mod tests {
    use super::super::{Parameters, generate, tests::volume};

    #[test]
    fn faces_and_tags_are_as_documented() {
        let control = |name| generate(name, &Parameters::default()).unwrap().control.unwrap();
        assert_eq!(control("cube-sphere").face_sizes, [4; 6]);
        let creased = control("creased-cube");
        let edges: std::collections::HashSet<_> = creased
            .faces()
            .flat_map(|f| (0..4).map(move |i| (f[i].min(f[(i + 1) % 4]), f[i].max(f[(i + 1) % 4]))))
            .collect();
        assert_eq!(edges.len(), 12);
        assert_eq!(creased.creases.len(), 5);
        assert!(creased.creases.iter().all(|&([a, b], _)| edges.contains(&(a.min(b), a.max(b)))));
        let open = control("open-patch");
        assert_eq!(open.corner_uvs.len(), open.corners.len());
        assert!(control("star-tube").face_sizes.contains(&10));
    }

    #[test]
    fn closed_ones_face_outwards() {
        for name in ["cube-sphere", "creased-cube", "star-tube"] {
            assert!(volume(&generate(name, &Parameters::default()).unwrap().mesh) > 1.0, "{name}");
        }
    }
}
