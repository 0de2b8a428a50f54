//! Linear subdivision: more triangles, the same shape.

use std::collections::HashMap;
use umbrage_geom::{MeshObject, TriangleMesh, glam::Vec3};

/// `mesh` with every triangle cut into `4^levels` equal ones by a grid of lines parallel to its sides.
///
/// Vertices on shared edges stay shared, objects keep their names, texture coordinates are interpolated.
pub fn linear(mesh: &TriangleMesh, levels: u32) -> TriangleMesh {
    let n = 1u32 << levels;
    let inner = (n - 1) as usize;
    let (edges, sides) = number_edges(mesh);
    let interior = inner * inner.saturating_sub(1) / 2;
    let edge_base = mesh.positions.len();
    let face_base = edge_base + edges.len() * inner;
    let mut out = TriangleMesh {
        positions: mesh.positions.clone(),
        objects: mesh
            .objects
            .iter()
            .map(|o| MeshObject {
                triangles: o.triangles.start * n * n..o.triangles.end * n * n,
                ..o.clone()
            })
            .collect(),
        ..TriangleMesh::default()
    };
    out.positions.reserve_exact(edges.len() * inner + mesh.triangles.len() * interior);
    out.triangles.reserve_exact(mesh.triangles.len() << (2 * levels));
    for &[a, b] in &edges {
        let [a, b] = [a, b].map(|v| Vec3::from(mesh.positions[v as usize]));
        out.positions.extend((1..n).map(|i| (a + (b - a) * (i as f32 / n as f32)).to_array()));
    }
    for (t, corners) in mesh.triangles.iter().enumerate() {
        let [a, b, c] = mesh.triangle(t).map(Vec3::from);
        let own_base = (face_base + t * interior) as u32;
        for j in 1..n {
            for i in 1..n - j {
                let p = a + (b - a) * (i as f32 / n as f32) + (c - a) * (j as f32 / n as f32);
                out.positions.push(p.to_array());
            }
        }
        // Vertex at i steps towards b and j towards c.
        let along = |side: usize, k: u32| {
            let (edge, reversed) = sides[t][side];
            (edge_base + edge as usize * inner) as u32 + if reversed { n - k } else { k } - 1
        };
        let index = |i: u32, j: u32| match (i, j, n - i - j) {
            (0, 0, _) => corners[0],
            (_, 0, 0) => corners[1],
            (0, _, 0) => corners[2],
            (i, 0, _) => along(0, i),
            (_, j, 0) => along(1, j),
            (0, j, _) => along(2, n - j),
            // Rows 1, 2, .. of the interior hold n - 2, n - 3, .. vertices.
            (i, j, _) => own_base + (j - 1) * (n - 1) - j * (j - 1) / 2 + i - 1,
        };
        let uvs = mesh.corner_uvs.get(t);
        let mut emit = |steps: [(u32, u32); 3]| {
            out.triangles.push(steps.map(|(i, j)| index(i, j)));
            if let Some(uv) = uvs {
                out.corner_uvs.push(steps.map(|(i, j)| {
                    let (u, v) = (i as f32 / n as f32, j as f32 / n as f32);
                    [0, 1].map(|k| uv[0][k] + (uv[1][k] - uv[0][k]) * u + (uv[2][k] - uv[0][k]) * v)
                }));
            }
        };
        for j in 0..n {
            for i in 0..n - j {
                emit([(i, j), (i + 1, j), (i, j + 1)]);
                if i + j + 2 <= n {
                    emit([(i + 1, j), (i + 1, j + 1), (i, j + 1)]);
                }
            }
        }
    }
    out
}

/// The edges, low vertex first, and for each triangle the edge of each side and whether the side runs against it.
#[allow(clippy::type_complexity)]
fn number_edges(mesh: &TriangleMesh) -> (Vec<[u32; 2]>, Vec<[(u32, bool); 3]>) {
    let mut edges = Vec::new();
    let mut numbers = HashMap::with_capacity(mesh.triangles.len() * 3 / 2);
    let sides = mesh.triangles.iter().map(|t| {
        [0, 1, 2].map(|s| {
            let (from, to) = (t[s], t[(s + 1) % 3]);
            let key = [from.min(to), from.max(to)];
            let number = *numbers.entry(key).or_insert_with(|| {
                edges.push(key);
                edges.len() as u32 - 1
            });
            (number, from > to)
        })
    });
    let sides = sides.collect();
    (edges, sides)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn area_stays_and_shared_edges_stay_shared() {
        let mut quad = TriangleMesh::new(
            vec![[0.0; 3], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]],
            vec![[0, 1, 2], [0, 2, 3]],
        )
        .unwrap();
        quad.corner_uvs = quad
            .triangles
            .iter()
            .map(|t| t.map(|v| [quad.positions[v as usize][0], quad.positions[v as usize][1]]))
            .collect();
        quad.objects = quad.objects_or_whole();
        for levels in 1..4 {
            let fine = linear(&quad, levels);
            fine.validate().unwrap();
            let n = 1 << levels;
            assert_eq!(fine.triangles.len(), 2 * n * n);
            assert_eq!(fine.positions.len(), (n + 1) * (n + 1));
            let mut area = 0.0;
            for t in 0..fine.triangles.len() {
                let [a, b, c] = fine.triangle(t).map(Vec3::from);
                let double = (b - a).cross(c - a).z;
                assert!((double - 1.0 / (n * n) as f32).abs() < 1e-6);
                area += double / 2.0;
                for (uv, p) in fine.corner_uvs[t].iter().zip(fine.triangle(t)) {
                    assert!((uv[0] - p[0]).abs() < 1e-6 && (uv[1] - p[1]).abs() < 1e-6);
                }
            }
            assert!((area - 1.0).abs() < 1e-5);
        }
    }
}
