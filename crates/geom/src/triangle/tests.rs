//! The predicate against rational arithmetic.

use super::*;
use glam::Vec3;
use num_rational::BigRational as Q;
use proptest::prelude::*;

fn q(x: f32) -> Q {
    Q::from_float(x).unwrap()
}

fn sub(p: &[Q; 3], o: &[Q; 3]) -> [Q; 3] {
    [&p[0] - &o[0], &p[1] - &o[1], &p[2] - &o[2]]
}

fn det(x: &[Q; 3], y: &[Q; 3], z: &[Q; 3]) -> Q {
    &x[0] * (&y[1] * &z[2] - &y[2] * &z[1])
        + &x[1] * (&y[2] * &z[0] - &y[0] * &z[2])
        + &x[2] * (&y[0] * &z[1] - &y[1] * &z[0])
}

/// `T / D` where the theorem says "hit".
fn oracle(ray: &Ray, corners: [[f32; 3]; 3]) -> Option<Q> {
    if !ray.is_valid() {
        return None;
    }
    let o = ray.origin.to_array().map(q);
    let d = ray.direction.to_array().map(q);
    let [a, b, c] = corners.map(|p| sub(&p.map(q), &o));
    let zero = q(0.0);
    let edges = [det(&d, &c, &b), det(&d, &a, &c), det(&d, &b, &a)];
    if edges.iter().any(|e| *e > zero) && edges.iter().any(|e| *e < zero) {
        return None;
    }
    let sum: Q = edges.iter().sum();
    if sum == zero {
        return None;
    }
    let t = -det(&a, &b, &c) / sum;
    (t > q(ray.tnear) && (ray.tfar == f32::INFINITY || t < q(ray.tfar))).then_some(t)
}

/// Small integers meet edges, vertices and planes exactly; the rest stresses range and rounding.
fn coordinate() -> impl Strategy<Value = f32> {
    prop_oneof![
        6 => (-4i8..=4).prop_map(f32::from),
        3 => -1f32..1.0,
        1 => prop::sample::select(vec![1e-40f32, -1e-45, 1e12, 1e-12, 1e20, -0.0, 16_777_216.0, 1.000_000_1]),
    ]
}

fn point() -> impl Strategy<Value = [f32; 3]> {
    [coordinate(), coordinate(), coordinate()]
}

fn check(ray: &Ray, corners: [[f32; 3]; 3]) -> Result<(), TestCaseError> {
    let truth = oracle(ray, corners);
    prop_assert_eq!(segment_hits_triangle(ray, corners), truth.is_some());
    for turn in 0..3 {
        let turned = [corners[turn], corners[(turn + 1) % 3], corners[(turn + 2) % 3]];
        let mirrored = [turned[0], turned[2], turned[1]];
        prop_assert_eq!(segment_hits_triangle(ray, turned), truth.is_some());
        prop_assert_eq!(segment_hits_triangle(ray, mirrored), truth.is_some());
    }
    let hit = intersect_triangle(ray, corners);
    prop_assert_eq!(hit.is_some(), truth.is_some());
    if let (Some(hit), Some(truth)) = (hit, truth) {
        prop_assert!(ray.tnear < hit.t && hit.t < ray.tfar);
        prop_assert!((0.0..=1.0).contains(&hit.u) && hit.v >= 0.0 && hit.u + hit.v <= 1.0 + 1e-6);
        let near_end = hit.t == ray.tnear.next_up() || hit.t == ray.tfar.next_down();
        if hit.t > f32::MIN_POSITIVE && hit.t < f32::MAX && !near_end {
            let error = q(hit.t) - &truth;
            let error = if error < q(0.0) { -error } else { error };
            prop_assert!(error <= truth * q(f32::EPSILON * 0.500_001));
        }
    }
    Ok(())
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(6000))]
    #[test]
    fn agrees_with_rationals(
        o in point(), d in point(), a in point(), b in point(), c in point(),
        tnear in prop::sample::select(vec![0f32, 0.5, 1.0]),
        tfar in prop::sample::select(vec![f32::INFINITY, 1.0, 2.0, 1e-3]),
    ) {
        check(&Ray { origin: o.into(), direction: d.into(), tnear, tfar }, [a, b, c])?;
    }

    #[test]
    fn agrees_on_rays_aimed_at_the_triangle(
        o in point(), a in point(), b in point(), c in point(),
        (u, v) in (0f32..=1.0, 0f32..=1.0), corner in 0..4, end in prop::sample::select(vec![f32::INFINITY, 1.0]),
    ) {
        // Corner 0: inside; 1: towards an edge; 2: towards a vertex; 3: beside it by rounding.
        let (u, v) = match corner { 0 => (u * 0.5, v * 0.5), 1 => (u, 0.0), 2 => (0.0, 0.0), _ => (u, -1e-8) };
        let [pa, pb, pc] = [a, b, c].map(Vec3::from);
        let target = pa + (pb - pa) * u + (pc - pa) * v;
        let o = Vec3::from(o);
        check(&Ray { origin: o, direction: target - o, tnear: 0.0, tfar: end }, [a, b, c])?;
    }

    #[test]
    fn degeneracy_is_exact(a in point(), b in point(), c in point()) {
        let [pa, pb, pc] = [a, b, c].map(|p| p.map(q));
        let (e, f) = (sub(&pb, &pa), sub(&pc, &pa));
        let zero = q(0.0);
        let truth = (0..3).all(|i| {
            let (j, k) = ((i + 1) % 3, (i + 2) % 3);
            &e[j] * &f[k] - &e[k] * &f[j] == zero
        });
        prop_assert_eq!(is_degenerate([a, b, c]), truth);
    }

    #[test]
    fn closed_meshes_do_not_leak(
        o in prop::array::uniform3(-0.3f32..0.3), corner in 0usize..8, axis in 0usize..3, along in 0f32..=1.0,
        at in prop::array::uniform3(-1e4f32..1e4),
    ) {
        // A box around `at`, rays from inside aimed at vertices and at points of its edges.
        let corners: Vec<[f32; 3]> = (0..8)
            .map(|i| [0, 1, 2].map(|k| at[k] + if i >> k & 1 == 1 { 1.0 } else { -1.0 }))
            .collect();
        let faces = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
        let origin = Vec3::from(o) + Vec3::from(at);
        let (from, to) = (Vec3::from(corners[corner]), Vec3::from(corners[corner ^ (1 << axis)]));
        let ray = Ray::new(origin, from + (to - from) * along - origin);
        let hits = faces.iter().flat_map(|f| [[f[0], f[1], f[2]], [f[0], f[2], f[3]]]);
        prop_assert!(hits.map(|t| t.map(|i: usize| corners[i])).any(|t| segment_hits_triangle(&ray, t)));
    }
}

#[test]
fn edges_and_ends_follow_the_definition() {
    let corners = [[0.0, 0.0, 1.0], [2.0, 0.0, 1.0], [0.0, 2.0, 1.0]];
    let up = |x: f32, y: f32| Ray::new([x, y, 0.0], [0.0, 0.0, 1.0]);
    for (x, y) in [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (2.0, 0.0), (0.5, 0.5)] {
        assert!(segment_hits_triangle(&up(x, y), corners), "{x} {y}");
    }
    assert!(!segment_hits_triangle(&up(1.0, 1.000_000_1), corners));
    assert!(!segment_hits_triangle(&up(-f32::MIN_POSITIVE, 0.5), corners));
    // Ends are open.
    assert!(!segment_hits_triangle(&up(0.5, 0.5).with_tfar(1.0), corners));
    assert!(segment_hits_triangle(&up(0.5, 0.5).with_tfar(1.0f32.next_up()), corners));
    assert!(!segment_hits_triangle(&Ray { tnear: 1.0, ..up(0.5, 0.5) }, corners));
    assert!(!segment_hits_triangle(&Ray::new([0.5, 0.5, 1.0], [0.0, 0.0, 1.0]), corners));
    let hit = intersect_triangle(&up(0.5, 0.25), corners).unwrap();
    assert_eq!((hit.t, hit.u, hit.v, hit.front), (1.0, 0.25, 0.125, false));
    assert!(intersect_triangle(&Ray::new([0.5, 0.5, 2.0], [0.0, 0.0, -1.0]), corners).unwrap().front);
    // In the plane, degenerate, not finite.
    assert!(!segment_hits_triangle(&Ray::new([-1.0, 0.5, 1.0], [1.0, 0.0, 0.0]), corners));
    assert!(!segment_hits_triangle(&up(0.5, 0.0), [corners[0], corners[1], corners[1]]));
    assert!(!segment_hits_triangle(&up(0.5, 0.5), [[f32::NAN; 3], corners[1], corners[2]]));
}

#[test]
fn sides_of_planes_are_exact() {
    let triangle = [[0.0, 0.0, 1.0], [1.0, 0.0, 1.0], [0.0, 1.0, 1.0]];
    // In front: the corners run counter-clockwise.
    assert_eq!(plane_side(Vec3::new(0.2, 0.2, 2.0), triangle), -1);
    assert_eq!(plane_side(Vec3::new(9.0, -7.0, 1.0f32.next_down()), triangle), 1);
    assert_eq!(plane_side(Vec3::new(9.0, -7.0, 1.0), triangle), 0);
    let oblique = [[0.1, 0.2, 0.3], [1.7, 0.9, 0.4], [0.3, 1.1, 2.9]];
    for corner in oblique {
        assert_eq!(plane_side(corner.into(), oblique), 0);
        let side = |x: f32| plane_side(Vec3::new(x, corner[1], corner[2]), oblique);
        assert_eq!((side(corner[0].next_up()), side(corner[0].next_down())), (-1, 1));
    }
}

#[test]
fn a_hit_between_neighbouring_numbers_is_reported() {
    // The plane is crossed at t = (1 + 2 e) / (1 + e) = 1 + e / (1 + e), between the ends 1 and 1 + e.
    let e = f32::EPSILON;
    let ray =
        Ray { tnear: 1.0, tfar: 1.0 + e, ..Ray::new([0.25, 0.25, -1.0 - 2.0 * e], [0.0, 0.0, 1.0 + e]) };
    let corners = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];
    let hit = intersect_triangle(&ray, corners);
    assert!(segment_hits_triangle(&ray, corners));
    assert!(hit.is_some_and(|hit| hit.t == ray.tnear || hit.t == ray.tfar));
}
