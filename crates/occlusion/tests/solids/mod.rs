//! Solids, whole and spoilt, and segments that are hard on them.

use proptest::prelude::*;
use umbrage_geom::{Ray, glam::Vec3};
use umbrage_occlusion::volumetric::Object;

/// Vertices and triangles.
pub type Mesh = (Vec<[f32; 3]>, Vec<[u32; 3]>);

/// A solid to put into a mesh: shape, center, half sizes, how it is spoilt.
pub type Part = (u8, [f32; 3], [f32; 3], u8);

pub fn part() -> impl Strategy<Value = Part> {
    let place = || {
        let x = || prop_oneof![(-3i8..=3).prop_map(f32::from), (-6i8..=6).prop_map(|x| f32::from(x) * 0.37)];
        [x(), x(), x()]
    };
    let size = || {
        let x = || prop_oneof![Just(1.0f32), Just(2.0), 0.3f32..3.0];
        [x(), x(), x()]
    };
    (0u8..4, place(), size(), 0u8..12)
}

pub fn cube() -> Mesh {
    let positions = (0..8).map(|i| [0, 1, 2].map(|axis| (i >> axis & 1) as f32 * 2.0 - 1.0)).collect();
    let quads = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    (positions, quads.iter().flat_map(|q| [[q[0], q[1], q[2]], [q[0], q[2], q[3]]]).collect())
}

/// A sphere of 8 * 4^`level` triangles.
pub fn sphere(level: u32) -> Mesh {
    let mut positions = vec![Vec3::X, Vec3::NEG_X, Vec3::Y, Vec3::NEG_Y, Vec3::Z, Vec3::NEG_Z];
    let mut triangles = Vec::new();
    for [x, y, z] in
        [[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5u32]]
    {
        triangles.push([x, y, z]);
    }
    for _ in 0..level {
        let mut finer = Vec::new();
        for [a, b, c] in triangles {
            // Middles of edges are made twice, at the same place: the audit joins them.
            let mut middle = |i: u32, j: u32| {
                positions.push((positions[i as usize] + positions[j as usize]).normalize());
                positions.len() as u32 - 1
            };
            let (d, e, f) = (middle(a, b), middle(b, c), middle(c, a));
            finer.extend([[a, d, f], [d, b, e], [f, e, c], [d, e, f]]);
        }
        triangles = finer;
    }
    (positions.iter().map(|p| p.to_array()).collect(), triangles)
}

pub fn mesh(parts: &[Part]) -> (Mesh, Vec<Object>) {
    let (mut positions, mut triangles, mut objects) = (Vec::new(), Vec::new(), Vec::new());
    for &(shape, center, half, spoil) in parts {
        let (p, mut t) = match shape {
            0 => cube(),
            1 => sphere(0),
            2 => sphere(1),
            4 => sphere(4),
            _ => sphere(2),
        };
        match spoil {
            0 => drop(t.remove(t.len() / 2)),
            1 => t[1].swap(0, 1),
            2 => t.iter_mut().for_each(|t| t.swap(1, 2)),
            3 => t.push(t[2]),
            4 => drop(t.drain(..t.len() / 3)),
            _ => {}
        }
        let (first, start) = (positions.len() as u32, triangles.len() as u32);
        positions.extend(p.iter().map(|p| [0, 1, 2].map(|axis| center[axis] + p[axis] * half[axis])));
        triangles.extend(t.iter().map(|t| t.map(|v| v + first)));
        objects.push(Object { triangles: start..triangles.len() as u32, opaque: spoil != 5 });
    }
    ((positions, triangles), objects)
}

/// How an end of a segment is made: kind, numbers.
pub type Aim = (u8, [f32; 3], usize, (f32, f32));

pub fn aim() -> impl Strategy<Value = Aim> {
    let coordinate = || prop_oneof![(-4i8..=4).prop_map(f32::from), -4f32..4.0];
    let weights =
        prop_oneof![Just((0f32, 0f32)), Just((0.5, 0.0)), Just((0.25, 0.25)), (0f32..0.5, 0f32..0.5)];
    (0u8..6, [coordinate(), coordinate(), coordinate()], any::<usize>(), weights)
}

/// A point in space, far away, on the surface or inside of a part.
pub fn point((positions, triangles): &Mesh, parts: &[Part], (kind, free, index, (u, v)): Aim) -> Vec3 {
    let corners = triangles[index % triangles.len()].map(|v| Vec3::from(positions[v as usize]));
    match kind {
        0 | 1 => free.into(),
        2 => Vec3::from(free) * 50.0,
        3 | 4 => corners[0] + (corners[1] - corners[0]) * u + (corners[2] - corners[0]) * v,
        _ => {
            let (_, center, half, _) = parts[index % parts.len()];
            Vec3::from(center) + Vec3::from(half) * Vec3::from(free) * 0.1
        }
    }
}

pub fn segments(mesh: &Mesh, parts: &[Part], aims: Vec<(Aim, Aim, u8)>) -> Vec<Ray> {
    aims.into_iter()
        .map(|(from, to, ends)| {
            let ray = Ray::between(point(mesh, parts, from), point(mesh, parts, to));
            match ends {
                0 => ray.with_tfar(f32::INFINITY),
                1 => Ray { tnear: 0.3, tfar: 0.9, ..ray },
                2 => Ray { direction: ray.direction * Vec3::new(1.0, 0.0, 1.0), ..ray },
                3 => Ray { direction: ray.direction * Vec3::Y, tfar: 2.0, ..ray },
                _ => ray,
            }
        })
        .collect()
}
