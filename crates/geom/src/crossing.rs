//! Crossings that can be counted: parity and winding numbers that no edge, vertex or grazed plane upsets.
//!
//! [`crate::segment_hits_triangle`] takes triangles as closed: a ray through a shared edge hits both sides, so its hits say
//! whether something is in the way, not how often. Here every ray is taken as moved by an infinitely small vector
//! `e = (epsilon, epsilon^2, epsilon^3)`, the same for all, which meets no edge, no vertex and no plane that it is parallel
//! to.
//!
//! # Theorem
//! With the notation of [`crate::triangle`] and `N = (b - a) x (c - a)`, a move of the origin by `e` leaves `D` and adds
//!
//! ```text
//! ((p - q) x d) . e   to the edge determinant det(d, p - o, q - o)
//! N . e               to T - t D, the plane's sign at the point o + t d
//! ```
//!
//! [`crosses_triangle`] is the answer for all small enough `epsilon > 0`: where a determinant is zero, the sign of the first
//! component of these vectors that isn't zero stands for it. If a vector is zero, the edge is parallel to `d`; then `D = 0`
//! and the moved line misses the plane. Otherwise no sign is zero, so the moved segment crosses the inside of the triangle
//! or misses it altogether.
//!
//! Consequences, for any closed oriented surface, self-intersecting or with degenerate triangles as it may be, since they
//! hold for the moved segment: the crossings of a half line out minus in are the winding number around its start; their
//! parity is odd inside and even outside a simple solid; those of a segment are the difference between its two ends.
//! Degenerate triangles are never crossed.
//!
//! The ends move too: a point on the surface counts as the point moved by `e`, on one side of every triangle. So segments
//! `(r, s)` and `(s, t)` of one ray together have the crossings of `(r, t)`, none lost or counted twice.
//!
//! # Source
//! Edelsbrunner and Muecke, Simulation of Simplicity, ACM Transactions on Graphics 9(1), 1990; departure: the ray moves, not
//! every vertex, which two products a component can settle.

use crate::{
    Ray,
    exact::Accumulator,
    triangle::{Filter, beyond, certain_sign, exact_edge_sign},
};

/// How a segment crosses an oriented triangle.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Crossing {
    /// Through the front, whose corners run counter-clockwise: into a solid.
    Entering,
    /// Through the back: out of a solid.
    Leaving,
}

impl Crossing {
    /// What the crossing adds to the winding number around the start of the segment: 1 when leaving, -1 when entering.
    #[inline]
    pub fn winding(self) -> i32 {
        match self {
            Self::Entering => -1,
            Self::Leaving => 1,
        }
    }
}

/// Whether and how the segment of `ray`, moved by an infinitely small vector, crosses the triangle; exact, see the
/// [module](self).
///
/// Where no determinant is zero this is `Some` exactly when [`crate::segment_hits_triangle`] is true. A ray that is not
/// [valid](Ray::is_valid) crosses nothing, nor does one cross a triangle with a coordinate that is not finite.
#[inline]
pub fn crosses_triangle(ray: &Ray, corners: [[f32; 3]; 3]) -> Option<Crossing> {
    if !ray.is_valid() || !corners.as_flattened().iter().all(|x| x.is_finite()) {
        return None;
    }
    let filter = Filter::new(ray, corners);
    let [a, b, c] = corners;
    let mut side = 0;
    for (edge, (p, q)) in filter.edges.into_iter().zip([(c, b), (a, c), (b, a)]) {
        let sign = certain_sign(edge, filter.edge_error).unwrap_or_else(|| moved_edge(ray, p, q));
        if sign == 0 || sign == -side {
            return None;
        }
        side = sign;
    }
    // The moved determinants add up to `D`, which therefore has their sign.
    let beyond = |t| match beyond(ray, corners, &filter, t) {
        0 => moved_plane(corners),
        sign => sign,
    };
    let within = beyond(ray.tnear) == side && (ray.tfar == f32::INFINITY || beyond(ray.tfar) == -side);
    within.then_some(if side > 0 { Crossing::Entering } else { Crossing::Leaving })
}

/// Sign of `det(d, p - o, q - o)` after the move; 0 if the edge is parallel to the direction.
#[cold]
fn moved_edge(ray: &Ray, p: [f32; 3], q: [f32; 3]) -> i32 {
    let sign = exact_edge_sign(ray, p, q);
    if sign != 0 {
        return sign;
    }
    let d = ray.direction.to_array();
    first_sign(|i, j, sum| {
        sum.add_product(&[p[i], d[j]], false);
        sum.add_product(&[q[i], d[j]], true);
        sum.add_product(&[p[j], d[i]], true);
        sum.add_product(&[q[j], d[i]], false);
    })
}

/// Side of a triangle's plane that one of its points moves to: 1 where `N` points; 0 if the triangle is degenerate.
#[cold]
fn moved_plane(corners: [[f32; 3]; 3]) -> i32 {
    first_sign(|i, j, sum| {
        for (p, q) in [(0, 1), (1, 2), (2, 0)] {
            let (p, q): ([f32; 3], [f32; 3]) = (corners[p], corners[q]);
            sum.add_product(&[p[i], q[j]], false);
            sum.add_product(&[p[j], q[i]], true);
        }
    })
}

/// Sign of the first component of a cross product that is not zero; `component` adds up the one on axis `(i, j)`.
fn first_sign(component: impl Fn(usize, usize, &mut Accumulator)) -> i32 {
    let signs = [(1, 2), (2, 0), (0, 1)].map(|(i, j)| {
        let mut sum = Accumulator::ZERO;
        component(i, j, &mut sum);
        sum.sign()
    });
    signs.into_iter().find(|&sign| sign != 0).unwrap_or(0)
}

/// Winding number of a closed oriented surface around the start of `ray` minus that around its end; around the start for
/// a half line. A loop over all `triangles`, exact.
///
/// A start on the surface counts as moved by an infinitely small vector, see the [module](self). If the surface isn't
/// closed, this is the number of crossings out minus in. A ray that is not [valid](Ray::is_valid) gives 0.
pub fn winding_number(ray: &Ray, triangles: impl IntoIterator<Item = [[f32; 3]; 3]>) -> i32 {
    triangles.into_iter().filter_map(|corners| crosses_triangle(ray, corners)).map(Crossing::winding).sum()
}

#[cfg(test)]
mod tests;
