//! The tree of quarters of a patch. Quarters are made when they are first asked for, and kept as far as their budget of memory
//! allows. A quarter is a bicubic patch where the surface is regular; around extraordinary vertices and decaying creases it
//! is a ring of control points, which is split down to level [`MAX_DEPTH`] and counts as its nearest corner there.
//!
//! Here: bounds, splits, positions and limit points. Not here: rings ([`Ring`]) and bicubic patches ([`Bicubic`]), how finely
//! a patch is diced (`dice.rs`, `length.rs`), which parts a ray visits (`trace.rs`).

use super::{Bicubic, Ring, weights};
use crate::{
    patch::kernel::{Columns, Kernel, LANES},
    subdiv::CreaseMethod,
    surface::LimitPoint,
};
use std::{
    ops::Range,
    sync::{
        OnceLock,
        atomic::{AtomicU64, AtomicUsize, Ordering::Relaxed},
    },
};
use umbrage_geom::{
    Aabb,
    glam::{DVec3, Vec3},
};

/// Levels below which an irregular patch counts as its nearest corner.
const MAX_DEPTH: u32 = 40;

/// What all nodes of a surface share.
#[derive(Debug)]
pub(crate) struct TreeContext {
    pub(crate) method: CreaseMethod,
    pub(crate) kernel: Kernel,
    /// Whether bounds of bicubic patches are those of their Bezier points.
    pub(crate) bezier_bounds: bool,
    /// Bytes that nodes below the roots may take in all; beyond, they are made again each time.
    pub(crate) limit: usize,
    pub(crate) bytes: AtomicUsize,
    pub(crate) bounds: AtomicU64,
    pub(crate) splits: AtomicU64,
}

/// What a node is made of.
#[derive(Debug)]
pub(crate) enum Kind {
    Regular(Box<Bicubic>),
    Irregular(Box<Ring>),
    /// A face of the control mesh beside faces that are no quadrilaterals; its quarters are given.
    Forked,
}

#[derive(Debug)]
pub(crate) struct Node {
    pub(crate) kind: Kind,
    /// Holds every micropolygon vertex of this part, rounding included.
    pub(crate) bounds: Aabb,
    children: OnceLock<Box<[Node; 4]>>,
}

/// Quarters in the order of corners: of the tree, or made for the occasion.
pub(crate) enum Children<'a> {
    Stored(&'a [Node; 4]),
    Made(Box<[Node; 4]>),
}

impl std::ops::Deref for Children<'_> {
    type Target = [Node; 4];

    fn deref(&self) -> &[Node; 4] {
        match self {
            Self::Stored(nodes) => nodes,
            Self::Made(nodes) => nodes,
        }
    }
}

/// `aabb` with room for the rounding of evaluation: 16 terms of at most `magnitude`, a few units in the last place each.
fn padded(aabb: Aabb, magnitude: f32) -> Aabb {
    let pad = Vec3::splat(magnitude * (16.0 * f32::EPSILON) + f32::MIN_POSITIVE);
    Aabb { min: aabb.min - pad, max: aabb.max + pad }
}

/// Vertices of a grid: `u = u0 + i * step_u` of `size`, `i` in `us`.
#[derive(Clone, Debug)]
pub(crate) struct Lattice {
    pub(crate) u0: u32,
    pub(crate) v0: u32,
    pub(crate) step_u: u32,
    pub(crate) step_v: u32,
    /// Vertices in a row of the output.
    pub(crate) stride: usize,
}

/// Part of a patch in lattice coordinates.
#[derive(Clone, Copy, Debug)]
struct Place {
    u: u32,
    v: u32,
    size: u32,
}

impl Place {
    fn quarter(self, k: usize) -> Self {
        let half = self.size / 2;
        let (a, b) = QUARTERS[k];
        Self { u: self.u + a * half, v: self.v + b * half, size: half }
    }
}

/// Offsets of quarters, in the order of corners.
pub(crate) const QUARTERS: [(u32, u32); 4] = [(0, 0), (1, 0), (1, 1), (0, 1)];

/// The corner at `(u, v)` in halves.
pub(crate) fn quarter_at(right: bool, top: bool) -> usize {
    match (right, top) {
        (false, false) => 0,
        (true, false) => 1,
        (true, true) => 2,
        (false, true) => 3,
    }
}

impl Node {
    pub(crate) fn regular(patch: Bicubic, context: &TreeContext) -> Self {
        context.bounds.fetch_add(1, Relaxed);
        let hull = if context.bezier_bounds { patch.bezier_hull() } else { patch.hull() };
        let bounds = padded(hull, patch.magnitude());
        Self { kind: Kind::Regular(Box::new(patch)), bounds, children: OnceLock::new() }
    }

    pub(crate) fn irregular(ring: Ring, context: &TreeContext) -> Self {
        context.bounds.fetch_add(1, Relaxed);
        let hull = ring.hull();
        let bounds = padded(hull, hull.min.abs().max(hull.max.abs()).max_element());
        Self { kind: Kind::Irregular(Box::new(ring)), bounds, children: OnceLock::new() }
    }

    pub(crate) fn from_ring(ring: Ring, context: &TreeContext) -> Self {
        match ring.regular() {
            Some(patch) => Self::regular(patch, context),
            None => Self::irregular(ring, context),
        }
    }

    pub(crate) fn forked(children: [Self; 4]) -> Self {
        let bounds = children.iter().fold(Aabb::EMPTY, |b, child| b.union(child.bounds));
        Self { kind: Kind::Forked, bounds, children: OnceLock::from(Box::new(children)) }
    }

    /// Bytes of a node and what it owns, children left out.
    fn bytes(&self) -> usize {
        size_of::<Self>()
            + match &self.kind {
                Kind::Regular(_) => size_of::<Bicubic>(),
                Kind::Irregular(ring) => {
                    size_of::<Ring>() + ring.fans.iter().map(|f| size_of_val(&f.spokes[..])).sum::<usize>()
                }
                Kind::Forked => 0,
            }
    }

    /// Bytes of this and all nodes below that are there.
    pub(crate) fn total_bytes(&self) -> usize {
        let below = self.children.get().map_or(0, |nodes| nodes.iter().map(Self::total_bytes).sum());
        self.bytes() + below
    }

    /// The Reyes operation split.
    pub(crate) fn split(&self, context: &TreeContext) -> Children<'_> {
        if let Some(children) = self.children.get() {
            return Children::Stored(children);
        }
        let made = Box::new(self.fresh_quarters(context));
        let bytes: usize = made.iter().map(Self::bytes).sum();
        if context.bytes.fetch_add(bytes, Relaxed) + bytes > context.limit {
            context.bytes.fetch_sub(bytes, Relaxed);
            return Children::Made(made);
        }
        Children::Stored(self.children.get_or_init(|| made))
    }

    /// Quarters that are not stored.
    pub(crate) fn fresh_quarters(&self, context: &TreeContext) -> [Self; 4] {
        context.splits.fetch_add(1, Relaxed);
        match &self.kind {
            Kind::Regular(patch) => patch.split().map(|part| Self::regular(part, context)),
            Kind::Irregular(ring) => ring.split(context.method).map(|part| Self::from_ring(part, context)),
            Kind::Forked => unreachable!("forked nodes are made with their children"),
        }
    }

    /// Bounds after `levels` of preemptive subdivision (Djeu 2011, section 6.13.5).
    pub(crate) fn tight_bounds(&self, levels: u32, context: &TreeContext) -> Aabb {
        if levels == 0 {
            return self.bounds;
        }
        self.split(context)
            .iter()
            .fold(Aabb::EMPTY, |b, child| b.union(child.tight_bounds(levels - 1, context)))
    }

    /// Position at `(u, v)` of `size`, a power of two. The same bits whichever grid asks.
    pub(crate) fn position(&self, u: u32, v: u32, size: u32, context: &TreeContext) -> Vec3 {
        let mut out = [Vec3::ZERO];
        let lattice = Lattice { u0: u, v0: v, step_u: 1, step_v: 1, stride: 1 };
        let place = Place { u: 0, v: 0, size };
        self.fill_part(place, &lattice, [0..1, 0..1], &mut out, context);
        out[0]
    }

    /// Positions of a whole lattice of `counts` vertices.
    pub(crate) fn fill(
        &self,
        size: u32,
        lattice: &Lattice,
        counts: [usize; 2],
        out: &mut [Vec3],
        context: &TreeContext,
    ) {
        self.fill_part(Place { u: 0, v: 0, size }, lattice, [0..counts[0], 0..counts[1]], out, context);
    }

    /// Positions of the vertices `parts` of a lattice, which lie in this node, at `place`.
    ///
    /// Which node of the tree is asked depends on the parameters alone, never on the lattice: a vertex between quarters
    /// belongs to the upper one, a corner of an irregular node to the topmost such node.
    fn fill_part(
        &self,
        place: Place,
        lattice: &Lattice,
        parts: [Range<usize>; 2],
        out: &mut [Vec3],
        context: &TreeContext,
    ) {
        let [us, vs] = &parts;
        if us.is_empty() || vs.is_empty() {
            return;
        }
        match &self.kind {
            Kind::Regular(patch) => return fill_regular(patch, place, lattice, &parts, out, context.kernel),
            Kind::Irregular(_) if is_corners_only(place, lattice, &parts) => {}
            _ => {
                let children = self.split(context);
                let half = place.size / 2;
                // First vertex at or beyond the middle.
                let cut = |range: &Range<usize>, start: u32, step: u32, middle: u32| {
                    let first = middle.saturating_sub(start).div_ceil(step) as usize;
                    first.clamp(range.start, range.end)
                };
                let (cu, cv) = (
                    cut(us, lattice.u0, lattice.step_u, place.u + half),
                    cut(vs, lattice.v0, lattice.step_v, place.v + half),
                );
                let (low_u, high_u) = (us.start..cu, cu..us.end);
                let (low_v, high_v) = (vs.start..cv, cv..vs.end);
                let quarters = [
                    [low_u.clone(), low_v.clone()],
                    [high_u.clone(), low_v],
                    [high_u, high_v.clone()],
                    [low_u, high_v],
                ];
                for (k, quarter) in quarters.into_iter().enumerate() {
                    children[k].fill_part(place.quarter(k), lattice, quarter, out, context);
                }
            }
        }
        if let Kind::Irregular(ring) = &self.kind {
            fill_corners(ring, place, lattice, &parts, out, context.method);
        }
    }

    /// Position and derivatives at `u`, `v` in `[0, 1]`.
    pub(crate) fn limit(&self, u: f64, v: f64, context: &TreeContext) -> LimitPoint {
        self.limit_below(u, v, 0, context)
    }

    fn limit_below(&self, u: f64, v: f64, depth: u32, context: &TreeContext) -> LimitPoint {
        let scale = 2f64.powi(depth as i32);
        match &self.kind {
            Kind::Regular(patch) => {
                let [du, dv] = patch.derivatives(u, v).map(|d| d.as_dvec3() * scale);
                return LimitPoint::new(patch.position(u, v), [du, dv]);
            }
            Kind::Irregular(ring) => {
                let at_corner = (u == 0.0 || u == 1.0) && (v == 0.0 || v == 1.0);
                if at_corner || depth >= MAX_DEPTH {
                    let corner = quarter_at(u >= 0.5, v >= 0.5);
                    let [a, b] = ring.tangents(corner, context.method);
                    // Tangents run along the next and the previous edge.
                    let [du, dv] = match corner {
                        0 => [a, b],
                        1 => [-b, a],
                        2 => [-a, -b],
                        _ => [b, -a],
                    };
                    let position = ring.limit(corner, context.method).as_vec3();
                    let point = LimitPoint::new(position, [du, dv]);
                    return if point.normal == Vec3::ZERO {
                        point.with_normal(self.chord_normal())
                    } else {
                        point
                    };
                }
            }
            Kind::Forked => {}
        }
        let (right, top) = (u >= 0.5, v >= 0.5);
        let fold = |x: f64, upper: bool| if upper { 2.0 * x - 1.0 } else { 2.0 * x };
        let children = self.split(context);
        children[quarter_at(right, top)].limit_below(fold(u, right), fold(v, top), depth + 1, context)
    }

    /// Normal of the face's corners, where the limit has none.
    fn chord_normal(&self) -> DVec3 {
        match &self.kind {
            Kind::Irregular(ring) => {
                let [a, b, c, d] = [0, 1, 2, 3].map(|k| ring.fans[k].center);
                (c - a).cross(d - b)
            }
            _ => DVec3::ZERO,
        }
    }
}

/// The corner of `place` that vertex `(i, j)` is, if it is one.
fn corner_at(place: Place, lattice: &Lattice, i: usize, j: usize) -> Option<usize> {
    let u = lattice.u0 + i as u32 * lattice.step_u - place.u;
    let v = lattice.v0 + j as u32 * lattice.step_v - place.v;
    let at_corner = (u == 0 || u == place.size) && (v == 0 || v == place.size);
    at_corner.then(|| quarter_at(u != 0, v != 0))
}

fn is_corners_only(place: Place, lattice: &Lattice, [us, vs]: &[Range<usize>; 2]) -> bool {
    us.len() <= 2
        && vs.len() <= 2
        && us.clone().all(|i| vs.clone().all(|j| corner_at(place, lattice, i, j).is_some()))
}

fn fill_corners(
    ring: &Ring,
    place: Place,
    lattice: &Lattice,
    [us, vs]: &[Range<usize>; 2],
    out: &mut [Vec3],
    method: CreaseMethod,
) {
    for j in [vs.start, vs.end - 1] {
        for i in [us.start, us.end - 1] {
            if let Some(corner) = corner_at(place, lattice, i, j) {
                out[j * lattice.stride + i] = ring.limit(corner, method).as_vec3();
            }
        }
    }
}

fn fill_regular(
    patch: &Bicubic,
    place: Place,
    lattice: &Lattice,
    [us, vs]: &[Range<usize>; 2],
    out: &mut [Vec3],
    kernel: Kernel,
) {
    let at = |start: u32, i: usize, step: u32, origin: u32| {
        f64::from(start + i as u32 * step - origin) / f64::from(place.size)
    };
    // A row of a grid and a bit more; longer rows come in pieces.
    const MAX_ROW_POINTS: usize = 8 * LANES;
    let mut weights_known = [[0f32; 4]; MAX_ROW_POINTS];
    let mut first = us.start;
    while first < us.end {
        let piece = first..us.end.min(first + MAX_ROW_POINTS);
        let known = &mut weights_known[..piece.len()];
        for (i, w) in known.iter_mut().enumerate() {
            *w = weights(at(lattice.u0, first + i, lattice.step_u, place.u));
        }
        let mut columns = [Columns::NONE; MAX_ROW_POINTS / LANES];
        for (columns, weights) in columns.iter_mut().zip(known.chunks(LANES)) {
            *columns = Columns::new(weights);
        }
        let columns = &columns[..piece.len().div_ceil(LANES)];
        for j in vs.clone() {
            let curve = patch.curve(weights(at(lattice.v0, j, lattice.step_v, place.v)));
            kernel.row(&curve, known, columns, &mut out[j * lattice.stride..][piece.clone()]);
        }
        first = piece.end;
    }
}
