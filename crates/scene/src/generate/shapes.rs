//! `plane`, `sphere`, `box`, and the grid on the surface of a cube that they and the lumps share.

use super::{Generated, Inputs};
use umbrage_geom::{
    MeshObject, TriangleMesh,
    glam::{DVec3, IVec3, Vec3},
};

/// Faces of a cube as outward normal and the axes of its chart; `u x v` is the normal.
const FACES: [[IVec3; 3]; 6] = [
    [IVec3::X, IVec3::NEG_Z, IVec3::Y],
    [IVec3::NEG_X, IVec3::Z, IVec3::Y],
    [IVec3::Z, IVec3::X, IVec3::Y],
    [IVec3::NEG_Z, IVec3::NEG_X, IVec3::Y],
    [IVec3::Y, IVec3::X, IVec3::NEG_Z],
    [IVec3::NEG_Y, IVec3::X, IVec3::Z],
];

/// Space around each chart, as a fraction of its cell.
const GUTTER: f32 = 0.02;

/// Segments along the edges of a cube for about `triangles` triangles: `12 n^2` are made.
pub fn cube_segments(triangles: usize) -> usize {
    ((triangles as f64 / 12.0).sqrt().round() as usize).max(1)
}

/// A closed grid of `n` x `n` squares on each face of the cube `[-1, 1]^3`, moved by `place`.
///
/// Texture coordinates are six separate charts in two rows of three.
pub fn cube_grid(n: usize, name: &str, place: impl Fn(DVec3) -> DVec3) -> TriangleMesh {
    let m = n as i32;
    let mut mesh = TriangleMesh::default();
    mesh.positions.reserve_exact(6 * n * n + 2);
    let centered = |i: i32| f64::from(2 * i - m) / f64::from(m);
    for y in 0..=m {
        let mut push = |x: i32, z: i32| {
            let p = place(DVec3::new(centered(x), centered(y), centered(z)));
            mesh.positions.push(p.as_vec3().to_array());
        };
        if y == 0 || y == m {
            (0..=m).for_each(|z| (0..=m).for_each(|x| push(x, z)));
        } else {
            (0..m).for_each(|x| push(x, 0));
            (0..m).for_each(|z| push(m, z));
            (1..=m).rev().for_each(|x| push(x, m));
            (1..=m).rev().for_each(|z| push(0, z));
        }
    }
    mesh.triangles.reserve_exact(12 * n * n);
    mesh.corner_uvs.reserve_exact(12 * n * n);
    for (face, [normal, u, v]) in FACES.into_iter().enumerate() {
        let cell = [(face % 3) as f32, (face / 3) as f32];
        let uv = |i: i32, j: i32| {
            let t = [i, j].map(|k| GUTTER + (1.0 - 2.0 * GUTTER) * (k as f32 / n as f32));
            [(cell[0] + t[0]) / 3.0, (cell[1] + t[1]) / 2.0]
        };
        let vertex = |i: i32, j: i32| {
            let p = (normal * m + u * (2 * i - m) + v * (2 * j - m) + IVec3::splat(m)) / 2;
            cube_vertex(m, p)
        };
        for j in 0..m {
            for i in 0..m {
                let corners = [(i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)];
                // Diagonals run towards the cube's corners, where angles are widest.
                let turn = usize::from((2 * i + 1 < m) != (2 * j + 1 < m));
                for [a, b, c] in [[0, 1, 2], [0, 2, 3]] {
                    let t = [a, b, c].map(|k| corners[(k + turn) % 4]);
                    mesh.triangles.push(t.map(|(i, j)| vertex(i, j)));
                    mesh.corner_uvs.push(t.map(|(i, j)| uv(i, j)));
                }
            }
        }
    }
    whole(mesh, name)
}

/// Number of the vertex at lattice point `p` of the surface of the cube `[0, n]^3`, in the order of [`cube_grid`].
fn cube_vertex(n: i32, p: IVec3) -> u32 {
    let layer = (n + 1) * (n + 1);
    let ring = || match (p.x, p.z) {
        (x, 0) if x < n => x,
        (x, z) if x == n && z < n => n + z,
        (x, z) if z == n && x > 0 => 3 * n - x,
        (_, z) => 4 * n - z,
    };
    let index = if p.y == 0 {
        p.x + p.z * (n + 1)
    } else if p.y == n {
        layer + (n - 1) * 4 * n + p.x + p.z * (n + 1)
    } else {
        layer + (p.y - 1) * 4 * n + ring()
    };
    index as u32
}

/// The point of the unit sphere that belongs to a point of the cube `[-1, 1]^3`: equal steps on an edge become equal
/// angles. Grid lines become great circles, so that the image of [`cube_grid`] never folds.
pub fn sphere_point(p: DVec3) -> DVec3 {
    let warp = |t: f64| if t.abs() == 1.0 { t } else { libm::tan(t * std::f64::consts::FRAC_PI_4) };
    DVec3::new(warp(p.x), warp(p.y), warp(p.z)).normalize()
}

/// `mesh` as one opaque object.
pub fn whole(mut mesh: TriangleMesh, name: &str) -> TriangleMesh {
    let triangles = 0..mesh.triangles.len() as u32;
    mesh.objects = vec![MeshObject { name: name.to_owned(), triangles, opacity: 1.0 }];
    mesh
}

/// Moves `mesh` to stand on the ground at `place`.
pub fn put_on_ground(mesh: &mut TriangleMesh, place: Vec3) {
    let low = mesh.positions.iter().map(|p| p[1]).fold(f32::INFINITY, f32::min);
    for p in &mut mesh.positions {
        *p = [p[0] + place.x, p[1] - low, p[2] + place.z];
    }
}

pub fn plane(inputs: &Inputs) -> Generated {
    let (width, depth) = (inputs.number("width"), inputs.number("depth"));
    let squares = (inputs.triangles as f64 / 2.0).max(1.0);
    let columns = ((squares * width / depth).sqrt().round()).clamp(1.0, squares) as usize;
    let rows = ((squares / columns as f64).round() as usize).max(1);
    let mut mesh = TriangleMesh::default();
    for j in 0..=rows {
        for i in 0..=columns {
            let (u, v) = (i as f64 / columns as f64, j as f64 / rows as f64);
            mesh.positions.push([((u - 0.5) * width) as f32, 0.0, ((0.5 - v) * depth) as f32]);
        }
    }
    let uv = |k: u32| {
        let (i, j) = (k as usize % (columns + 1), k as usize / (columns + 1));
        [i as f32 / columns as f32, j as f32 / rows as f32]
    };
    for j in 0..rows as u32 {
        for i in 0..columns as u32 {
            let a = j * (columns as u32 + 1) + i;
            let d = a + columns as u32 + 1;
            for t in [[a, a + 1, d + 1], [a, d + 1, d]] {
                mesh.triangles.push(t);
                mesh.corner_uvs.push(t.map(uv));
            }
        }
    }
    whole(mesh, "plane").into()
}

pub fn sphere(inputs: &Inputs) -> Generated {
    cube_grid(cube_segments(inputs.triangles), "sphere", |p| sphere_point(p) + DVec3::Y).into()
}

pub fn cuboid(inputs: &Inputs) -> Generated {
    let half = ["width", "height", "depth"].map(|side| inputs.number(side) / 2.0);
    let half = DVec3::from(half);
    cube_grid(cube_segments(inputs.triangles), "box", |p| (p + DVec3::Y) * half).into()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sphere_is_round_and_boxes_have_their_size() {
        let mesh = cube_grid(5, "s", sphere_point);
        for p in &mesh.positions {
            assert!((DVec3::from(p.map(f64::from)).length() - 1.0).abs() < 1e-6);
        }
        assert_eq!(mesh.positions.len(), 6 * 25 + 2);
        let mesh = cube_grid(3, "b", |p| p * DVec3::new(1.0, 2.0, 3.0));
        assert!((super::super::tests::volume(&mesh) - 48.0).abs() < 1e-4);
    }

    #[test]
    fn charts_stay_in_their_cells() {
        let mesh = cube_grid(4, "s", sphere_point);
        for (t, uvs) in mesh.corner_uvs.iter().enumerate() {
            let face = t / (mesh.triangles.len() / 6);
            for uv in uvs {
                let (x, y) = (uv[0] * 3.0 - (face % 3) as f32, uv[1] * 2.0 - (face / 3) as f32);
                assert!((0.01..0.99).contains(&x) && (0.01..0.99).contains(&y), "{uv:?}");
            }
            let [a, b, c] = *uvs;
            let double_area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
            assert!(double_area > 0.0);
        }
    }
}
