//! Occlusion masks of triangles (`[Laine10]`, section 3.1 and figure 1), and the tests that spare them (sections 4.2 and 5).
//!
//! Here: eight pairs of a triangle and a receiver at a time. Not here: which pairs are asked about (`traversal.rs`,
//! `raster/`).

use super::{
    edge::EdgeTable,
    lanes::{F8, V8, and},
    plane::PlaneTable,
};
use crate::Sides;
use umbrage_geom::{
    Frame,
    glam::{DVec3, Vec3},
};

/// Coordinates, in radii, up to which products of four stay far from the largest `f32`; beyond, `f64` is used.
const MAX_F32_COORDINATE: f32 = 1e9;

/// The surroundings of a receiver in radii, and the pattern's axes.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Local {
    origin: [f32; 3],
    /// One over the radius.
    inverse: f32,
    /// Tangent, bitangent and normal.
    axes: [[f32; 3]; 3],
}

impl Local {
    pub(crate) fn new(origin: Vec3, frame: &Frame, radius: f32) -> Self {
        let axes = [frame.tangent, frame.bitangent, frame.normal].map(|v| v.to_array());
        Self { origin: origin.to_array(), inverse: 1.0 / radius, axes }
    }

    /// Points around the receiver, in radii, world axes.
    #[inline(always)]
    pub(crate) fn points(&self, rows: &[[f32; 8]; 3]) -> V8 {
        (V8::from_rows(rows) - V8::splat(self.origin)).scale(F8::splat(self.inverse))
    }

    /// Turns vectors from the world's axes to the pattern's.
    ///
    /// Done last: what is computed in the world's axes keeps the precision that flat and axis-parallel things have there.
    #[inline(always)]
    pub(crate) fn turn(&self, v: V8) -> V8 {
        let [x, y, z] = self.axes;
        V8::new(V8::splat(x).dot(v), V8::splat(y).dot(v), V8::splat(z).dot(v))
    }

    /// A point around the receiver, in radii, world axes.
    pub(crate) fn point(&self, p: [f32; 3]) -> DVec3 {
        (Vec3::from(p).as_dvec3() - Vec3::from(self.origin).as_dvec3()) * f64::from(self.inverse)
    }

    /// The pattern's axis along the normal.
    #[inline(always)]
    pub(crate) fn up(&self) -> [f32; 3] {
        self.axes[2]
    }
}

/// Tables that masks of triangles are looked up in.
#[derive(Clone, Copy, Debug)]
pub(crate) struct TriangleTables<'a, const W: usize> {
    /// By directions of rays.
    pub(crate) edges: &'a EdgeTable<W>,
    /// By ends of rays, in radii.
    pub(crate) planes: &'a PlaneTable<W>,
    /// By ends of rays as if all had length 1.
    pub(crate) directions: &'a PlaneTable<W>,
}

/// Eight pairs of a triangle and a receiver with what their masks need. Bits of lanes.
pub(crate) struct Triangles {
    /// Lanes where the triangle has a vertex above the horizon.
    pub(crate) above: u32,
    /// Lanes where the triangle faces the receiver, if it is one-sided; never those whose plane holds the receiver.
    pub(crate) facing: u32,
    /// Lanes where the triangle's plane is within the radius.
    pub(crate) close: u32,
    /// Lanes where the bounding sphere of the region of influence holds the receiver.
    pub(crate) reached: u32,
    /// Planes through the receiver and each edge: inward normals, world axes.
    edges: [V8; 3],
    /// The triangles' planes: normals away from the receiver, world axes, and distances in radii.
    normals: V8,
    distances: F8,
    /// Lanes whose numbers are too large for the above.
    pub(crate) large: u32,
}

impl Triangles {
    /// Tests triangles with `corners` around their receivers, in radii, whose rays are around `up`.
    #[inline(always)]
    pub(crate) fn new([a, b, c]: [V8; 3], up: V8, sides: Sides) -> Self {
        let (low, high) = (a.min(b).min(c), a.max(b).max(c));
        let top = a.dot(up).max(b.dot(up)).max(c.dot(up));
        let normals = (b - a).cross(c - a);
        let heights = normals.dot(a);
        let facing = match sides {
            Sides::Both => F8::ZERO.lt(heights.abs()),
            Sides::Front | Sides::FrontFirst => heights.lt(F8::ZERO),
        };
        let distances = heights.abs() / normals.dot(normals).sqrt();
        let sign = heights.signum();
        Self {
            above: F8::ZERO.lt(top),
            facing,
            close: distances.le(F8::splat(1.0)),
            reached: within_reach([a, b, c], (low + high).scale(F8::splat(0.5))),
            edges: [a.cross(b).scale(sign), b.cross(c).scale(sign), c.cross(a).scale(sign)],
            normals: normals.scale(sign),
            distances,
            large: F8::splat(MAX_F32_COORDINATE).le(low.abs().max(high.abs()).largest()),
        }
    }

    /// Calls `visit` with the masks of the lanes in `which`; `turn` turns vectors to the pattern's axes. Hits nearer than
    /// `near`, in radii, don't count (`[Laine10]`, section 4.3).
    #[inline(always)]
    pub(crate) fn masks<const W: usize>(
        &self,
        which: u32,
        tables: TriangleTables<'_, W>,
        turn: impl Fn(V8) -> V8,
        near: f32,
        mut visit: impl FnMut(usize, [u64; W]),
    ) {
        let [e0, e1, e2] = self.edges;
        let edge_cells = |normals| tables.edges.cells(turn(normals));
        let (e0, e1, e2) = (edge_cells(e0), edge_cells(e1), edge_cells(e2));
        let normals = turn(self.normals);
        let planes = tables.planes.cells(normals, self.distances);
        let (mut near_cells, mut cut) = ([0; 8], 0);
        if near > 0.0 {
            let distances = self.distances / F8::splat(near);
            cut = distances.le(F8::splat(1.0));
            near_cells = tables.directions.cells(normals, distances.min(F8::splat(1.0)));
        }
        let mut left = which;
        while left != 0 {
            let i = left.trailing_zeros() as usize % 8;
            left &= left - 1;
            let two = and(tables.edges.mask(e0[i]), tables.edges.mask(e1[i]));
            let three = and(&two, tables.edges.mask(e2[i]));
            let mut mask = and(&three, tables.planes.mask(planes[i]));
            if cut >> i & 1 == 1 {
                let crossed = tables.directions.mask(near_cells[i]);
                for w in 0..W {
                    mask[w] &= !crossed[w];
                }
            }
            visit(i, mask);
        }
    }

    /// Does lane `i` again for a triangle many millions of radii in size: `corners` around the receiver, in radii.
    #[cold]
    pub(crate) fn redo_large(&mut self, i: usize, corners: [DVec3; 3], up: Vec3, sides: Sides) {
        let [a, b, c] = corners;
        let size = a.abs().max(b.abs()).max(c.abs()).max_element();
        let normal = (b - a).cross(c - a).normalize_or_zero();
        let height = normal.dot(a);
        let facing = match sides {
            Sides::Both => height != 0.0,
            Sides::Front | Sides::FrontFirst => height < 0.0,
        };
        let up = up.as_dvec3();
        let set = |bits: &mut u32, bit: bool| *bits = *bits & !(1 << i) | u32::from(bit) << i;
        set(&mut self.above, a.dot(up).max(b.dot(up)).max(c.dot(up)) > 0.0);
        set(&mut self.facing, facing);
        set(&mut self.close, height.abs() <= 1.0);
        set(&mut self.reached, true);
        let sign = height.signum();
        let [a, b, c] = [a, b, c].map(|v| v / size);
        for (row, v) in self.edges.iter_mut().zip([a.cross(b), b.cross(c), c.cross(a)]) {
            row.set_lane(i, (v * sign).normalize_or_zero().as_vec3().to_array());
        }
        self.normals.set_lane(i, (normal * sign).as_vec3().to_array());
        self.distances.0[i] = height.abs() as f32;
    }
}

/// Lanes whose sphere around `center` through the farthest corner, grown by the radius, holds the receiver.
#[inline(always)]
fn within_reach([a, b, c]: [V8; 3], center: V8) -> u32 {
    let (a, b, c) = (a - center, b - center, c - center);
    let reach = F8::splat(1.0) + a.dot(a).max(b.dot(b)).max(c.dot(c)).sqrt();
    center.dot(center).le(reach * reach * F8::splat(1.0 + 1e-5))
}
