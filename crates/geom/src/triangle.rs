//! THE ray-triangle predicate of the workspace, exact.
//!
//! # Theorem
//! Let `o`, `d`, `tnear`, `tfar` be those of a [valid](Ray::is_valid) ray and `a`, `b`, `c` finite points, all as given
//! in `f32`, and `A = a - o` and so on in exact arithmetic. With
//!
//! ```text
//! U = det(d, C, B)   V = det(d, A, C)   W = det(d, B, A)   D = U + V + W   T = -det(A, B, C)
//! ```
//!
//! [`segment_hits_triangle`] is true if and only if `D != 0`, none of `U`, `V`, `W` has the sign opposite to `D`, and
//! `tnear < T / D < tfar`: the open segment meets the closed triangle (edges and vertices included) in one point.
//!
//! Consequences: degenerate triangles (`D = 0` for every `d`) and triangles whose plane contains the direction are never
//! hit; the answer depends on nothing but the numbers given, hence not on the instruction set, the order of corners or
//! triangles, or the structure that led here; and a segment from strictly inside a closed mesh to strictly outside hits at
//! least one of its triangles, since the crossing points of segments moved a little to the side have a limit on some
//! closed triangle whose plane does not contain the direction.
//!
//! # How
//! A filter in `f64` decides nearly always; what it can't decide is summed exactly in integers (`exact.rs`). SIMD kernels
//! (`kernel/`) put a filter in `f32` before it.
//!
//! # Source
//! Edge determinants and the order of the tests: Woop, Benthin and Wald, Watertight Ray/Triangle Intersection, JCGT 2(1),
//! 2013. Filters: Shewchuk 1997, without his expansions: products of `f32` are short integers.

use crate::{
    Ray,
    exact::{Accumulator, exact_difference, small_det_sign},
};
use glam::{DVec3, Vec3};

/// Where a segment meets a triangle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TriangleHit {
    /// Ray parameter `T / D`, rounded to `f32` from a value off by less than 2^-28 of itself.
    pub t: f32,
    /// Barycentric weight of the second corner, in `[0, 1]`, rounded.
    pub u: f32,
    /// Barycentric weight of the third corner, in `[0, 1]`, rounded.
    pub v: f32,
    /// Whether the corners run counter-clockwise as seen from the ray's origin side.
    pub front: bool,
}

/// Relative bound on the rounding of every determinant below, in units of `|largest component|` of its factors.
///
/// Differences of `f32` are rounded once in `f64`, `u = 2^-53`. A determinant is six products of three such numbers: at
/// most 3 roundings of its factors, 3 multiplications or subtractions inside, 3 additions outside, so each product
/// carries at most `(1 + u)^9`: in all `6 * 9 u (1 + tiny)` of the product of the three largest components. 2^-47 is 64 u.
/// Nothing under- or overflows: products of four `f32` lie between `2^-596` and `2^512`.
pub(crate) const DET_ERROR: f64 = 1.0 / (1u64 << 47) as f64;

/// The filter's determinants and bounds.
pub(crate) struct Filter {
    /// `U`, `V`, `W`.
    pub(crate) edges: [f64; 3],
    /// Bound on the error of each of them.
    pub(crate) edge_error: f64,
    /// `T`.
    volume: f64,
    /// Bound on its error.
    volume_error: f64,
}

impl Filter {
    #[inline]
    pub(crate) fn new(ray: &Ray, corners: [[f32; 3]; 3]) -> Self {
        let origin = ray.origin.as_dvec3();
        let d = ray.direction.as_dvec3();
        // Not by `map`, which is not inlined into functions with target features.
        let relative = |p: [f32; 3]| DVec3::new(p[0].into(), p[1].into(), p[2].into()) - origin;
        let [a, b, c] = [relative(corners[0]), relative(corners[1]), relative(corners[2])];
        let [ab, bc, ca] = [a.cross(b), b.cross(c), c.cross(a)];
        let size = |v: DVec3| v.abs().max_element();
        let (sa, sb, sc) = (size(a), size(b), size(c));
        let pairs = (sa * sb).max(sb * sc).max(sc * sa);
        Self {
            edges: [-d.dot(bc), -d.dot(ca), -d.dot(ab)],
            edge_error: DET_ERROR * size(d) * pairs,
            volume: -a.dot(bc),
            volume_error: DET_ERROR * sa * sb * sc,
        }
    }
}

/// Sign of `x` if it is larger than `error`.
#[inline]
pub(crate) fn certain_sign(x: f64, error: f64) -> Option<i32> {
    if x > error {
        Some(1)
    } else if x < -error {
        Some(-1)
    } else {
        None
    }
}

/// Adds `det(x, y, z)`, times `factor` if there is one.
pub(crate) fn add_det(
    sum: &mut Accumulator,
    x: [f32; 3],
    y: [f32; 3],
    z: [f32; 3],
    factor: Option<f32>,
    negate: bool,
) {
    for (i, j, k, odd) in [
        (0, 1, 2, false),
        (1, 2, 0, false),
        (2, 0, 1, false),
        (0, 2, 1, true),
        (1, 0, 2, true),
        (2, 1, 0, true),
    ] {
        match factor {
            None => sum.add_product(&[x[i], y[j], z[k]], odd != negate),
            Some(f) => sum.add_product(&[f, x[i], y[j], z[k]], odd != negate),
        }
    }
}

/// Sign of `det(d, p - o, q - o)`, exactly. Coordinates on a common grid, as of meshes far from the origin, where nothing is
/// certain, take the short way.
pub(crate) fn exact_edge_sign(ray: &Ray, p: [f32; 3], q: [f32; 3]) -> i32 {
    let o = ray.origin.to_array();
    let differences = exact_difference(p, o).zip(exact_difference(q, o));
    let small =
        differences.and_then(|(p, q)| small_det_sign([ray.direction.to_array().map(f64::from), p, q]));
    small.unwrap_or_else(|| exact_edge(ray, p, q).sign())
}

/// `det(d, p - o, q - o)`, exactly.
fn exact_edge(ray: &Ray, p: [f32; 3], q: [f32; 3]) -> Accumulator {
    let (o, d) = (ray.origin.to_array(), ray.direction.to_array());
    let mut sum = Accumulator::ZERO;
    add_det(&mut sum, d, p, q, None, false);
    add_det(&mut sum, d, p, o, None, true);
    add_det(&mut sum, d, o, q, None, true);
    sum
}

/// Adds `factor * D`: `-det(d, a, b) - det(d, b, c) - det(d, c, a)`, where the origin cancels.
fn add_exact_d(
    sum: &mut Accumulator,
    ray: &Ray,
    [a, b, c]: [[f32; 3]; 3],
    factor: Option<f32>,
    negate: bool,
) {
    let d = ray.direction.to_array();
    add_det(sum, d, a, b, factor, !negate);
    add_det(sum, d, b, c, factor, !negate);
    add_det(sum, d, c, a, factor, !negate);
}

/// Adds `T`: `-det(a - o, b - o, c - o)`.
fn add_exact_t(sum: &mut Accumulator, ray: &Ray, [a, b, c]: [[f32; 3]; 3]) {
    let o = ray.origin.to_array();
    add_det(sum, a, b, c, None, true);
    add_det(sum, o, b, c, None, false);
    add_det(sum, a, o, c, None, false);
    add_det(sum, a, b, o, None, false);
}

/// Sign of `D` if the line meets the closed triangle in one point, else 0.
#[inline]
fn line_side(ray: &Ray, corners: [[f32; 3]; 3], filter: &Filter) -> i32 {
    let [u, v, w] = filter.edges;
    let (lowest, highest) = (u.min(v).min(w), u.max(v).max(w));
    let (positive, negative) = (highest > filter.edge_error, lowest < -filter.edge_error);
    if positive && negative {
        0
    } else if lowest > filter.edge_error {
        1
    } else if highest < -filter.edge_error {
        -1
    } else {
        line_side_exact(ray, corners, filter, positive, negative)
    }
}

#[cold]
fn line_side_exact(
    ray: &Ray,
    [a, b, c]: [[f32; 3]; 3],
    filter: &Filter,
    mut positive: bool,
    mut negative: bool,
) -> i32 {
    for (x, (p, q)) in filter.edges.into_iter().zip([(c, b), (a, c), (b, a)]) {
        if certain_sign(x, filter.edge_error).is_none() {
            let sign = exact_edge_sign(ray, p, q);
            positive |= sign > 0;
            negative |= sign < 0;
            if positive && negative {
                return 0;
            }
        }
    }
    i32::from(positive) - i32::from(negative)
}

/// Sign of `T - t D`: of the triangle's plane at the point `o + t d`.
#[inline]
pub(crate) fn beyond(ray: &Ray, corners: [[f32; 3]; 3], filter: &Filter, t: f32) -> i32 {
    let td = f64::from(t) * (filter.edges[0] + filter.edges[1] + filter.edges[2]);
    // Three more errors of an edge, and two roundings each of sums and product.
    let error = filter.volume_error
        + f64::from(t) * 4.0 * filter.edge_error
        + (filter.volume.abs() + td.abs()) * DET_ERROR;
    certain_sign(filter.volume - td, error).unwrap_or_else(|| exact_beyond(ray, corners, t))
}

/// Whether `T / D` lies strictly between the ends of the segment; `side` is the sign of `D`.
#[inline]
fn within_segment(ray: &Ray, corners: [[f32; 3]; 3], filter: &Filter, side: i32) -> bool {
    let beyond = |t| beyond(ray, corners, filter, t);
    beyond(ray.tnear) == side && (ray.tfar == f32::INFINITY || beyond(ray.tfar) == -side)
}

/// Sign of `T - t D`, exactly.
#[cold]
fn exact_beyond(ray: &Ray, corners: [[f32; 3]; 3], t: f32) -> i32 {
    if t == 0.0 {
        let [a, b, c] = corners.map(|p| exact_difference(p, ray.origin.to_array()));
        if let (Some(a), Some(b), Some(c)) = (a, b, c)
            && let Some(sign) = small_det_sign([a, b, c])
        {
            return -sign;
        }
    }
    let mut sum = Accumulator::ZERO;
    add_exact_t(&mut sum, ray, corners);
    add_exact_d(&mut sum, ray, corners, Some(t), true);
    sum.sign()
}

/// Whether the open segment of `ray` meets the closed triangle; exact, see the [module](self).
///
/// A ray that is not [valid](Ray::is_valid) hits nothing, nor does one hit a triangle with a coordinate that is not
/// finite.
#[inline]
pub fn segment_hits_triangle(ray: &Ray, corners: [[f32; 3]; 3]) -> bool {
    if !ray.is_valid() || !corners.as_flattened().iter().all(|x| x.is_finite()) {
        return false;
    }
    let filter = Filter::new(ray, corners);
    let side = line_side(ray, corners, &filter);
    side != 0 && within_segment(ray, corners, &filter, side)
}

/// Where the open segment of `ray` meets the closed triangle: `Some` exactly when [`segment_hits_triangle`] is true.
#[inline]
pub fn intersect_triangle(ray: &Ray, corners: [[f32; 3]; 3]) -> Option<TriangleHit> {
    if !ray.is_valid() || !corners.as_flattened().iter().all(|x| x.is_finite()) {
        return None;
    }
    let filter = Filter::new(ray, corners);
    let side = line_side(ray, corners, &filter);
    if side == 0 || !within_segment(ray, corners, &filter, side) {
        return None;
    }
    let d = filter.edges[0] + filter.edges[1] + filter.edges[2];
    let accurate = 2f64.powi(-29);
    let t = if filter.volume_error < filter.volume.abs() * accurate
        && 4.0 * filter.edge_error + d.abs() * DET_ERROR < d.abs() * accurate
    {
        filter.volume / d
    } else {
        t_by_normal(ray, corners).unwrap_or_else(|| exact_t(ray, corners))
    };
    let weight = |edge: f64| if d == 0.0 { 1.0 / 3.0 } else { (edge / d).clamp(0.0, 1.0) as f32 };
    let (u, v) = (weight(filter.edges[1]), weight(filter.edges[2]));
    // Rounding must not carry `t` out of the open segment that it lies in; where no number is inside, it is one of the ends.
    let t = (t as f32).max(ray.tnear.next_up()).min(ray.tfar.next_down());
    Some(TriangleHit { t, u, v: v.min(1.0 - u), front: side > 0 })
}

/// `T / D` by the triangle's normal, to 2^-29 of itself where that is certain: of small triangles far away the sum of `U`, `V`
/// and `W` leaves little, while differences of corners lose nothing.
///
/// With `n = (b - a) x (c - a)`, `D = -d . n` and `T = -A . n`: determinants, whose errors are bounded as [`DET_ERROR`] says.
fn t_by_normal(ray: &Ray, corners: [[f32; 3]; 3]) -> Option<f64> {
    let [a, b, c] = corners.map(|p| DVec3::new(p[0].into(), p[1].into(), p[2].into()));
    let (to_a, d) = (a - ray.origin.as_dvec3(), ray.direction.as_dvec3());
    let (e, f) = (b - a, c - a);
    let normal = e.cross(f);
    let (volume, side) = (to_a.dot(normal), d.dot(normal));
    let size = |v: DVec3| v.abs().max_element();
    let error = DET_ERROR * size(e) * size(f);
    let accurate = 2f64.powi(-31);
    let certain = error * size(to_a) < volume.abs() * accurate && error * size(d) < side.abs() * accurate;
    certain.then(|| volume / side)
}

/// `T / D` from exact sums, off by a few 2^-52 of itself.
#[cold]
fn exact_t(ray: &Ray, corners: [[f32; 3]; 3]) -> f64 {
    let (mut volume, mut d) = (Accumulator::ZERO, Accumulator::ZERO);
    add_exact_t(&mut volume, ray, corners);
    add_exact_d(&mut d, ray, corners, None, false);
    let ((vm, ve), (dm, de)) = (volume.approximate(), d.approximate());
    // Two steps, so that neither factor leaves the range of f64.
    let exponent = ve - de;
    vm / dm * 2f64.powi(exponent / 2) * 2f64.powi(exponent - exponent / 2)
}

/// Sign of `det(a - p, b - p, c - p)`: 1 if `point` is behind the triangle's plane (`T < 0` in the [module](self)'s terms), -1
/// in front, 0 on it or if the triangle is degenerate; exact for finite coordinates.
pub fn plane_side(point: Vec3, corners: [[f32; 3]; 3]) -> i32 {
    let [a, b, c] = corners.map(|p| DVec3::new(p[0].into(), p[1].into(), p[2].into()) - point.as_dvec3());
    let size = |v: DVec3| v.abs().max_element();
    let error = DET_ERROR * size(a) * size(b) * size(c);
    // `exact_beyond` at 0 looks at nothing but the origin and gives the sign of `T`.
    certain_sign(a.dot(b.cross(c)), error)
        .unwrap_or_else(|| -exact_beyond(&Ray::new(point, Vec3::X), corners, 0.0))
}

/// Whether a triangle of finite corners has exactly no area, so that no ray can hit it.
pub fn is_degenerate(corners: [[f32; 3]; 3]) -> bool {
    let [a, b, c] = corners.map(|p| DVec3::new(p[0].into(), p[1].into(), p[2].into()));
    let (e, f) = (b - a, c - a);
    let n = e.cross(f);
    let error = 2f64.powi(-49) * e.abs().max_element() * f.abs().max_element();
    if n.abs().max_element() > error {
        return false;
    }
    // Each component of the normal is a sum of six products of two coordinates.
    (0..3).all(|axis| {
        let (i, j) = ((axis + 1) % 3, (axis + 2) % 3);
        let mut sum = Accumulator::ZERO;
        for (p, q) in [(0, 1), (1, 2), (2, 0)] {
            let (p, q): ([f32; 3], [f32; 3]) = (corners[p], corners[q]);
            sum.add_product(&[p[i], q[j]], false);
            sum.add_product(&[p[j], q[i]], true);
        }
        sum.sign() == 0
    })
}

#[cfg(test)]
mod tests;
