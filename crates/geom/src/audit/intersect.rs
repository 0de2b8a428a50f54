//! Triangles of one mesh that cut or touch each other elsewhere than where they are joined.
//!
//! Here: an exact test of two triangles, and a tree that finds candidates. Departure from Djeu11, section 3.2, which names
//! a collision library: every sign is exact, so touching counts and nothing is missed.

use super::Finding;
use crate::{
    Aabb,
    exact::{Accumulator, exact_difference, small_det_sign},
    is_degenerate,
    mesh::{MeshError, validate_indices},
    morton,
    triangle::{DET_ERROR, add_det, certain_sign},
};
use glam::DVec3;

type Point = [f32; 3];

/// Sign of `det(b - a, c - a, d - a)`: on which side of a triangle a point is; exact.
fn side(a: Point, b: Point, c: Point, d: Point) -> i32 {
    let vector = |p: Point| DVec3::from(p.map(f64::from)) - DVec3::from(a.map(f64::from));
    let (x, y, z) = (vector(b), vector(c), vector(d));
    let size = |v: DVec3| v.abs().max_element();
    let error = DET_ERROR * size(x) * size(y) * size(z);
    certain_sign(x.dot(y.cross(z)), error).unwrap_or_else(|| exact_side(a, b, c, d))
}

#[cold]
fn exact_side(a: Point, b: Point, c: Point, d: Point) -> i32 {
    if let (Some(x), Some(y), Some(z)) =
        (exact_difference(b, a), exact_difference(c, a), exact_difference(d, a))
        && let Some(sign) = small_det_sign([x, y, z])
    {
        return sign;
    }
    let mut sum = Accumulator::ZERO;
    add_det(&mut sum, b, c, d, None, false);
    add_det(&mut sum, a, c, d, None, true);
    add_det(&mut sum, b, a, d, None, true);
    add_det(&mut sum, b, c, a, None, true);
    sum.sign()
}

/// Sign of the area of three points without coordinate `axis`; exact.
fn turn(axis: usize, p: Point, q: Point, r: Point) -> i32 {
    let (i, j) = ((axis + 1) % 3, (axis + 2) % 3);
    let mut sum = Accumulator::ZERO;
    for (p, q) in [(p, q), (q, r), (r, p)] {
        sum.add_product(&[p[i], q[j]], false);
        sum.add_product(&[p[j], q[i]], true);
    }
    sum.sign()
}

/// An axis without which a triangle still has area.
fn flat_axis(t: [Point; 3]) -> usize {
    (0..3).find(|&axis| turn(axis, t[0], t[1], t[2]) != 0).unwrap_or(0)
}

/// Whether two closed segments in a plane meet.
fn segments_meet(axis: usize, [p, q]: [Point; 2], [r, s]: [Point; 2]) -> bool {
    let (a, b) = (turn(axis, p, q, r), turn(axis, p, q, s));
    let (c, d) = (turn(axis, r, s, p), turn(axis, r, s, q));
    if [a, b, c, d] == [0; 4] {
        // On one line: their boxes overlap.
        return (0..3).filter(|&x| x != axis).all(|x| {
            let (low, high) = (p[x].min(q[x]), p[x].max(q[x]));
            low <= r[x].max(s[x]) && r[x].min(s[x]) <= high
        });
    }
    a * b <= 0 && c * d <= 0
}

fn point_in_triangle(axis: usize, p: Point, [a, b, c]: [Point; 3]) -> bool {
    let signs = [turn(axis, a, b, p), turn(axis, b, c, p), turn(axis, c, a, p)];
    !(signs.contains(&1) && signs.contains(&-1))
}

/// Whether a closed segment meets a closed triangle with area.
fn segment_meets([p, q]: [Point; 2], t: [Point; 3]) -> bool {
    let [a, b, c] = t;
    let (sp, sq) = (side(a, b, c, p), side(a, b, c, q));
    if sp * sq > 0 {
        return false;
    }
    if sp == 0 && sq == 0 {
        let axis = flat_axis(t);
        return point_in_triangle(axis, p, t)
            || [[a, b], [b, c], [c, a]].into_iter().any(|edge| segments_meet(axis, [p, q], edge));
    }
    let signs = [side(p, q, a, b), side(p, q, b, c), side(p, q, c, a)];
    !(signs.contains(&1) && signs.contains(&-1))
}

/// Whether two triangles with area meet elsewhere than in the corners (welded, `ids`) that they share.
fn meet(s: [Point; 3], t: [Point; 3], s_ids: [u32; 3], t_ids: [u32; 3]) -> bool {
    let edges = |t: [Point; 3]| [[t[0], t[1]], [t[1], t[2]], [t[2], t[0]]];
    let shared: Vec<(usize, usize)> =
        (0..3).flat_map(|i| (0..3).map(move |j| (i, j))).filter(|&(i, j)| s_ids[i] == t_ids[j]).collect();
    match shared[..] {
        [] => {
            edges(s).into_iter().any(|edge| segment_meets(edge, t))
                || edges(t).into_iter().any(|edge| segment_meets(edge, s))
        }
        // What they have in common beside the corner reaches the opposite side of one of them.
        [(i, j)] => {
            segment_meets([s[(i + 1) % 3], s[(i + 2) % 3]], t)
                || segment_meets([t[(j + 1) % 3], t[(j + 2) % 3]], s)
        }
        // Folded on to each other.
        [(i, j), (k, l)] => {
            let (p, q, a, b) = (s[i], s[k], s[3 - i - k], t[3 - j - l]);
            let axis = flat_axis(s);
            side(p, q, a, b) == 0 && turn(axis, p, q, a) == turn(axis, p, q, b)
        }
        _ => true,
    }
}

/// Triangles in a leaf of the tree of candidates.
const LEAF: usize = 4;

/// Finds pairs of triangles that meet elsewhere than in a common corner or edge; triangles without area don't count.
///
/// # Errors
/// [`MeshError::Index`].
pub fn self_intersections(
    positions: &[[f32; 3]],
    triangles: &[[u32; 3]],
    welded: &[u32],
) -> Result<Finding<[u32; 2]>, MeshError> {
    validate_indices(triangles, positions.len().min(welded.len()))?;
    let corners = |t: u32| triangles[t as usize].map(|v| positions[v as usize]);
    let with_area: Vec<u32> = (0..triangles.len() as u32).filter(|&t| !is_degenerate(corners(t))).collect();
    let centers: Vec<Point> =
        with_area.iter().map(|&t| Aabb::from_points(&corners(t)).center().into()).collect();
    let order: Vec<u32> = morton::order(&centers).into_iter().map(|i| with_area[i as usize]).collect();
    let mut pairs: Vec<[u32; 2]> = Vec::new();
    if order.is_empty() {
        return Ok(Finding::default());
    }
    // A complete binary tree over runs of the order: node `i` has children `2 i + 1` and `2 i + 2`.
    let leaves = order.len().div_ceil(LEAF).next_power_of_two();
    let mut boxes = vec![Aabb::EMPTY; 2 * leaves - 1];
    let run = |leaf: usize| &order[(leaf * LEAF).min(order.len())..((leaf + 1) * LEAF).min(order.len())];
    for i in (0..boxes.len()).rev() {
        boxes[i] = if i + 1 >= leaves {
            run(i + 1 - leaves).iter().flat_map(|&t| corners(t)).fold(Aabb::EMPTY, Aabb::with_point)
        } else {
            boxes[2 * i + 1].union(boxes[2 * i + 2])
        };
    }
    let overlap = |a: &Aabb, b: &Aabb| a.min.cmple(b.max).all() && b.min.cmple(a.max).all();
    let ids = |t: u32| triangles[t as usize].map(|v| welded[v as usize]);
    let mut stack = vec![(0usize, 0usize)];
    while let Some((a, b)) = stack.pop() {
        if !overlap(&boxes[a], &boxes[b]) {
            continue;
        }
        if a + 1 < leaves {
            let children = [2 * a + 1, 2 * a + 2];
            if a == b {
                stack.extend([
                    (children[0], children[0]),
                    (children[1], children[1]),
                    (children[0], children[1]),
                ]);
            } else {
                // Both have the same depth, so the other has children too.
                stack.extend(children.into_iter().flat_map(|c| [(c, 2 * b + 1), (c, 2 * b + 2)]));
            }
            continue;
        }
        for &s in run(a + 1 - leaves) {
            for &t in run(b + 1 - leaves) {
                let boxes = (Aabb::from_points(&corners(s)), Aabb::from_points(&corners(t)));
                if (a != b || s < t)
                    && overlap(&boxes.0, &boxes.1)
                    && meet(corners(s), corners(t), ids(s), ids(t))
                {
                    pairs.push([s.min(t), s.max(t)]);
                }
            }
        }
    }
    pairs.sort_unstable();
    let mut finding = Finding::default();
    pairs.into_iter().for_each(|pair| finding.add(pair));
    Ok(finding)
}
