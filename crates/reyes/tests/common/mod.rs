//! Meshes that tests share.
#![allow(dead_code)]

use std::path::PathBuf;
use umbrage_geom::{PolygonMesh, glam::Vec3};

/// The folder with real meshes, if it is there.
pub fn mesh_folder() -> Option<PathBuf> {
    let beside = concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared/meshes");
    let folder = std::env::var_os("UMBRAGE_MESHES").map_or_else(|| beside.into(), PathBuf::from);
    if !folder.is_dir() {
        println!("SKIPPED: no meshes; set UMBRAGE_MESHES to their folder");
        return None;
    }
    Some(folder)
}

pub fn cube() -> PolygonMesh {
    let side = |i: u32, bit: u32| if i >> bit & 1 == 1 { 1.0 } else { -1.0 };
    let faces: [[u32; 4]; 6] =
        [[1, 3, 7, 5], [0, 4, 6, 2], [2, 6, 7, 3], [0, 1, 5, 4], [4, 5, 7, 6], [0, 2, 3, 1]];
    PolygonMesh {
        positions: (0..8).map(|i| [side(i, 0), side(i, 1), side(i, 2)]).collect(),
        face_sizes: vec![4; 6],
        corners: faces.concat(),
        ..PolygonMesh::default()
    }
}

/// `n` by `n` quadrilaterals over `[0, n] x [0, n]`, lifted by `height`.
pub fn sheet(n: u32, height: impl Fn(u32, u32) -> f32) -> PolygonMesh {
    let mut mesh = PolygonMesh::default();
    for j in 0..=n {
        for i in 0..=n {
            mesh.positions.push([i as f32, j as f32, height(i, j)]);
        }
    }
    for j in 0..n {
        for i in 0..n {
            let a = j * (n + 1) + i;
            mesh.face_sizes.push(4);
            mesh.corners.extend([a, a + 1, a + n + 2, a + n + 1]);
        }
    }
    mesh
}

/// A closed double pyramid over an `n`-gon: triangles, two vertices of valence `n`.
pub fn spindle(n: u32) -> PolygonMesh {
    let mut mesh = PolygonMesh::default();
    for i in 0..n {
        let angle = std::f32::consts::TAU * i as f32 / n as f32;
        mesh.positions.push([angle.cos(), angle.sin(), 0.0]);
    }
    mesh.positions.extend([[0.1, 0.0, 1.0], [0.0, 0.2, -1.2]]);
    for i in 0..n {
        let next = (i + 1) % n;
        mesh.face_sizes.extend([3, 3]);
        mesh.corners.extend([i, next, n, next, i, n + 1]);
    }
    mesh
}

/// A prism over an `n`-gon: two `n`-gons and `n` quadrilaterals.
pub fn prism(n: u32) -> PolygonMesh {
    let mut mesh = PolygonMesh::default();
    for z in [0.0f32, 1.5] {
        for i in 0..n {
            let angle = std::f32::consts::TAU * i as f32 / n as f32;
            mesh.positions.push([angle.cos() * (1.0 + 0.2 * z), angle.sin(), z + 0.1 * angle.cos()]);
        }
    }
    mesh.face_sizes = vec![n, n];
    mesh.corners = (0..n).rev().chain(n..2 * n).collect();
    for i in 0..n {
        let next = (i + 1) % n;
        mesh.face_sizes.push(4);
        mesh.corners.extend([i, next, n + next, n + i]);
    }
    mesh
}

/// Many kinds of meshes: closed, open, creased by all sorts of sharpness, mixed faces.
pub fn zoo() -> Vec<(&'static str, PolygonMesh)> {
    let mut creased = cube();
    creased.creases = vec![([2, 3], 10.0), ([3, 7], 10.0), ([7, 6], 10.0), ([6, 2], 10.0), ([1, 3], 0.7)];
    creased.sharp_vertices = vec![(0, 1.3), (4, 10.0)];
    let mut dart = sheet(4, |i, j| ((i * 7 + j * 3) % 5) as f32 * 0.3);
    dart.creases = vec![([12, 13], 1.4), ([13, 14], 10.0), ([6, 7], 0.6)];
    dart.sharp_vertices = vec![(0, 10.0)];
    let mut holed = sheet(5, |i, j| (i as f32 * 0.9).sin() + (j as f32 * 1.3).cos());
    holed.face_sizes.remove(12);
    holed.corners.drain(48..52);
    vec![
        ("cube", cube()),
        ("creased cube", creased),
        ("dart", dart),
        ("holed sheet", holed),
        ("spindle", spindle(7)),
        ("prism", prism(5)),
        ("one quad", sheet(1, |i, j| (i * j) as f32)),
        ("valence 3", spindle(3)),
    ]
}

/// Size of a mesh: its largest coordinate.
pub fn size_of(mesh: &PolygonMesh) -> f64 {
    mesh.positions.iter().fold(0f64, |m, &p| m.max(Vec3::from(p).abs().max_element().into()))
}
