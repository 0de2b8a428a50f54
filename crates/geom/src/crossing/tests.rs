//! Parity and winding numbers on rays that meet edges, vertices and planes exactly.

use super::*;
use crate::segment_hits_triangle;
use glam::{IVec3, Vec3};
use num_rational::BigRational as Q;
use proptest::prelude::*;

type Triangle = [[f32; 3]; 3];

const ALONG_X: Ray = Ray { origin: Vec3::ZERO, direction: Vec3::X, tnear: 0.0, tfar: f32::INFINITY };

/// The surface of the cube `[0, 2 n]^3` in squares of side 2, cut along alternating diagonals.
fn cube(n: i32) -> Vec<Triangle> {
    let mut triangles = Vec::new();
    for (axis, top) in [(0, false), (1, false), (2, false), (0, true), (1, true), (2, true)] {
        for (i, j) in (0..n * n).map(|k| (k % n, k / n)) {
            let at = |di: i32, dj: i32| {
                let mut p = [0.0; 3];
                p[axis] = if top { 2 * n } else { 0 } as f32;
                p[(axis + 1) % 3] = (2 * (i + di)) as f32;
                p[(axis + 2) % 3] = (2 * (j + dj)) as f32;
                p
            };
            let [p, q, r, s] = [at(0, 0), at(1, 0), at(1, 1), at(0, 1)];
            let pair = if (i + j) % 2 == 0 { [[p, q, r], [p, r, s]] } else { [[q, r, s], [q, s, p]] };
            triangles.extend(pair.map(|[a, b, c]| if top { [a, b, c] } else { [a, c, b] }));
        }
    }
    triangles
}

fn octahedron(radius: i32) -> Vec<Triangle> {
    let r = radius as f32;
    let mut triangles = Vec::new();
    for signs in (0..8).map(|i| [0, 1, 2].map(|k| if i >> k & 1 == 1 { -r } else { r })) {
        let [a, b, c] = [0, 1, 2].map(|k| {
            let mut p = [0.0; 3];
            p[k] = signs[k];
            p
        });
        triangles.push(if signs.iter().product::<f32>() > 0.0 { [a, b, c] } else { [a, c, b] });
    }
    triangles
}

fn tetrahedron([a, b, c, d]: [[f32; 3]; 4]) -> Vec<Triangle> {
    vec![[a, c, b], [a, b, d], [b, c, d], [c, a, d]]
}

fn moved(triangles: &[Triangle], by: IVec3) -> impl Iterator<Item = Triangle> + '_ {
    triangles.iter().map(move |t| t.map(|p| (Vec3::from(p) + by.as_vec3()).to_array()))
}

fn parity(ray: &Ray, triangles: &[Triangle]) -> bool {
    triangles.iter().filter(|&&t| crosses_triangle(ray, t).is_some()).count() % 2 == 1
}

fn lattice(range: std::ops::RangeInclusive<i32>) -> impl Strategy<Value = IVec3> {
    [range.clone(), range.clone(), range].prop_map(IVec3::from)
}

fn direction() -> impl Strategy<Value = IVec3> {
    lattice(-6..=6).prop_filter("zero", |d| *d != IVec3::ZERO)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(4000))]
    /// Every lattice ray through a cube of squares of side 2 meets edges, diagonals, vertices or runs in faces.
    #[test]
    fn lattice_rays_count_cubes_right(o in lattice(-3..=9), d in direction(), flip in 0u32..8) {
        let triangles = cube(3);
        // Negative zeros must make no difference.
        let minus_zero = |k: usize| if d[k] == 0 && flip >> k & 1 == 1 { -0.0 } else { d[k] as f32 };
        let ray = Ray::new(o.as_vec3(), [minus_zero(0), minus_zero(1), minus_zero(2)]);
        // On the surface, the move towards +x, +y, +z decides: lower faces are inside, upper ones outside.
        let inside = (0..3).all(|k| (0..6).contains(&o[k]));
        prop_assert_eq!(winding_number(&ray, triangles.iter().copied()), i32::from(inside));
        prop_assert_eq!(parity(&ray, &triangles), inside);
    }

    #[test]
    fn lattice_rays_count_octahedra_right(o in lattice(-5..=5), d in direction()) {
        let ray = Ray::new(o.as_vec3(), d.as_vec3());
        let triangles = octahedron(4);
        // A point of the surface moves towards +x first: inwards where x is negative.
        let size: i32 = o.abs().element_sum();
        let inside = size < 4 || (size == 4 && o.x < 0);
        prop_assert_eq!(winding_number(&ray, triangles.iter().copied()), i32::from(inside));
    }

    /// Any tetrahedron, flat ones too: every direction from a point sees the same winding number.
    #[test]
    fn winding_does_not_depend_on_the_direction(
        corners in prop::array::uniform4(lattice(-3..=3)), o in lattice(-3..=3), d in direction(),
    ) {
        let triangles = tetrahedron(corners.map(|p| p.as_vec3().to_array()));
        let count = |d: Vec3| winding_number(&Ray::new(o.as_vec3(), d), triangles.iter().copied());
        let expected = count(Vec3::new(0.123, 0.456, -0.789));
        prop_assert_eq!(count(d.as_vec3()), expected);
        prop_assert_eq!(count(d.as_vec3() * 2f32.powi(-149)), expected);
        for corner in corners.into_iter().filter(|&c| c != o) {
            prop_assert_eq!(count((corner - o).as_vec3()), expected);
        }
        let volume = (corners[1] - corners[0])
            .cross(corners[2] - corners[0])
            .dot(corners[3] - corners[0]);
        prop_assert!([0, volume.signum()].contains(&expected));
    }

    /// Overlapping and touching solids add up; segments of a ray do, too, wherever it is cut.
    #[test]
    fn segments_add_up(o in lattice(-3..=9), d in direction(), by in lattice(-2..=6), cut in 0usize..9) {
        let mut triangles = cube(2);
        triangles.extend(moved(&cube(2), by));
        triangles.extend(moved(&octahedron(3), by - IVec3::Y));
        let ray = Ray::new(o.as_vec3(), d.as_vec3());
        let count = |ray: Ray| winding_number(&ray, triangles.iter().copied());
        let cut = [0.25, 1.0 / 3.0, 0.5, 0.6, 1.0, 2.0, 3.0, 4.0, 1e-45][cut];
        prop_assert_eq!(count(ray), count(ray.with_tfar(cut)) + count(Ray { tnear: cut, ..ray }));
        prop_assert_eq!(count(ray), count(Ray { direction: Vec3::X, ..ray }));
    }

    #[test]
    fn generic_rays_agree_with_the_closed_predicate(
        o in prop::array::uniform3(-1f32..1.0), d in prop::array::uniform3(-1f32..1.0),
        t in prop::array::uniform3(prop::array::uniform3(-1f32..1.0)), tfar in prop::sample::select(vec![1.0, f32::INFINITY]),
    ) {
        let ray = Ray::new(o, d).with_tfar(tfar);
        prop_assert_eq!(crosses_triangle(&ray, t).is_some(), segment_hits_triangle(&ray, t));
        let back = crosses_triangle(&ray, [t[0], t[2], t[1]]);
        prop_assert_eq!(back.map(Crossing::winding), crosses_triangle(&ray, t).map(|c| -c.winding()));
    }

    /// Against a move by a tiny rational number, on which every sign is the limit's.
    #[test]
    fn agrees_with_a_ray_moved_in_rationals(
        o in lattice(-3..=3), d in direction(), corners in prop::array::uniform3(lattice(-3..=3)),
        tfar in prop::sample::select(vec![0.5, 1.0, 2.0, f32::INFINITY]),
    ) {
        let ray = Ray::new(o.as_vec3(), d.as_vec3()).with_tfar(tfar);
        let corners = corners.map(|p| p.as_vec3().to_array());
        prop_assert_eq!(crosses_triangle(&ray, corners).map(Crossing::winding), moved_oracle(&ray, corners));
    }
}

/// All numbers are below 2^12 in units of a half, so a move by powers of 2^-30 keeps signs apart.
fn moved_oracle(ray: &Ray, corners: Triangle) -> Option<i32> {
    let q = |x: f32| Q::from_float(x).unwrap();
    let e = q(2f32.powi(-30));
    let o = ray.origin.to_array().map(q);
    let o = [&o[0] + &e, &o[1] + &e * &e, &o[2] + &e * &e * &e];
    let d = ray.direction.to_array().map(q);
    let [a, b, c] = corners.map(|p| [0, 1, 2].map(|k| q(p[k]) - &o[k]));
    let det = |x: &[Q; 3], y: &[Q; 3], z: &[Q; 3]| {
        &x[0] * (&y[1] * &z[2] - &y[2] * &z[1])
            + &x[1] * (&y[2] * &z[0] - &y[0] * &z[2])
            + &x[2] * (&y[0] * &z[1] - &y[1] * &z[0])
    };
    let zero = q(0.0);
    let edges = [det(&d, &c, &b), det(&d, &a, &c), det(&d, &b, &a)];
    let sum: Q = edges.iter().sum();
    if sum == zero || edges.iter().any(|x| (x > &zero) != (sum > zero)) {
        return None;
    }
    assert!(edges.iter().all(|x| *x != zero), "the moved line meets no edge");
    let t = -det(&a, &b, &c) / &sum;
    let within = t > q(ray.tnear) && (ray.tfar == f32::INFINITY || t < q(ray.tfar));
    within.then_some(if sum > zero { -1 } else { 1 })
}

#[test]
fn invalid_input_crosses_nothing() {
    let t = [[1.0, -1.0, -1.0], [1.0, 1.0, -1.0], [1.0, 0.0, 1.0]];
    assert_eq!(crosses_triangle(&ALONG_X, t), Some(Crossing::Leaving));
    assert_eq!(crosses_triangle(&ALONG_X, [t[0], t[2], t[1]]), Some(Crossing::Entering));
    assert_eq!(crosses_triangle(&Ray { direction: Vec3::ZERO, ..ALONG_X }, t), None);
    assert_eq!(crosses_triangle(&ALONG_X, [[f32::NAN; 3], t[1], t[2]]), None);
    assert_eq!(crosses_triangle(&ALONG_X, [t[0], t[1], t[1]]), None);
    assert_eq!(winding_number(&ALONG_X, []), 0);
}
