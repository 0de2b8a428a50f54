//! Occlusion masks of triangles ([Laine10], section 3.1 and figure 1), and the tests that spare them (section 5).
//!
//! Here: eight triangles of a leaf at a time, in the pattern's axes and radii. Not here: which leaves are visited
//! (`traversal.rs`).

use super::{
    edge::EdgeTable,
    lanes::{F8, V8, and},
    plane::PlaneTable,
};
use crate::Sides;
use umbrage_geom::{Frame, glam::Vec3, kernel::TriangleBlock};

/// Coordinates, in radii, up to which products of four stay far from the largest `f32`; beyond, `f64` is used.
const LARGE: f32 = 1e9;

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

    /// The pattern's axis along the normal.
    #[inline(always)]
    pub(crate) fn up(&self) -> [f32; 3] {
        self.axes[2]
    }
}

/// Eight triangles with what their masks need. Lanes that are culled, unused or degenerate are not in `alive`.
pub(crate) struct Triangles {
    pub(crate) alive: u32,
    /// Lanes left after each of the four culling tests.
    pub(crate) after: [u32; 4],
    /// Planes through the receiver and each edge: inward normals, world axes.
    edges: [V8; 3],
    /// The triangles' planes: normals away from the receiver, world axes, and distances in radii.
    normals: V8,
    distances: F8,
    /// Lanes whose numbers are too large for the above.
    large: u32,
}

impl Triangles {
    /// Puts the triangles of `block` through the culling tests.
    #[inline(always)]
    pub(crate) fn new(block: &TriangleBlock, local: &Local, sides: Sides) -> Self {
        let corners = &block.corners();
        let (a, b, c) = (local.points(&corners[0]), local.points(&corners[1]), local.points(&corners[2]));
        let (low, high) = (a.min(b).min(c), a.max(b).max(c));
        let up = V8::splat(local.up());
        let top = a.dot(up).max(b.dot(up)).max(c.dot(up));
        // Unused lanes are not a number.
        let used = high.z.le(F8::splat(f32::INFINITY));
        let large = F8::splat(LARGE).le(low.abs().max(high.abs()).largest()) & used;
        // 1. All vertices below the horizon.
        let above = F8::ZERO.lt(top) & used;
        // 2. One-sided and facing away. Triangles whose plane holds the receiver block nothing.
        let normals = (b - a).cross(c - a);
        let heights = normals.dot(a);
        let facing = above
            & match sides {
                Sides::Both => F8::ZERO.lt(heights.abs()),
                Sides::Front => heights.lt(F8::ZERO),
            };
        // 3. The plane is beyond the radius.
        let distances = heights.abs() / normals.dot(normals).sqrt();
        let close = facing & distances.le(F8::splat(1.0));
        // 4. The receiver is outside the bounding sphere of the region of influence.
        let reached = close & within_reach([a, b, c], (low + high).scale(F8::splat(0.5)));
        let sign = heights.signum();
        Self {
            alive: reached | large,
            after: [above | large, facing | large, close | large, reached | large],
            edges: [a.cross(b).scale(sign), b.cross(c).scale(sign), c.cross(a).scale(sign)],
            normals: normals.scale(sign),
            distances,
            large,
        }
    }

    /// Calls `visit` with the mask of each triangle that is left.
    #[inline(always)]
    pub(crate) fn masks<const W: usize>(
        &mut self,
        edge_table: &EdgeTable<W>,
        plane_table: &PlaneTable<W>,
        block: &TriangleBlock,
        local: &Local,
        sides: Sides,
        mut visit: impl FnMut([u64; W]),
    ) {
        if self.large != 0 {
            self.redo_large(block, local, sides);
        }
        let [e0, e1, e2] = self.edges;
        let edge_cells = |normals| edge_table.cells(local.turn(normals));
        let (e0, e1, e2) = (edge_cells(e0), edge_cells(e1), edge_cells(e2));
        let planes = plane_table.cells(local.turn(self.normals), self.distances);
        let mut left = self.alive;
        while left != 0 {
            let i = left.trailing_zeros() as usize % 8;
            left &= left - 1;
            let two = and(edge_table.mask(e0[i]), edge_table.mask(e1[i]));
            let three = and(&two, edge_table.mask(e2[i]));
            visit(and(&three, plane_table.mask(planes[i])));
        }
    }

    /// The same tests and planes for triangles millions of radii in size, in `f64` and scaled by their size.
    #[cold]
    fn redo_large(&mut self, block: &TriangleBlock, local: &Local, sides: Sides) {
        for i in (0..8).filter(|i| self.large >> i & 1 == 1) {
            let origin = Vec3::from(local.origin).as_dvec3();
            let [a, b, c] =
                block.get(i).map(|p| (Vec3::from(p).as_dvec3() - origin) * f64::from(local.inverse));
            let size = a.abs().max(b.abs()).max(c.abs()).max_element();
            let normal = (b - a).cross(c - a).normalize_or_zero();
            let height = normal.dot(a);
            let faces = match sides {
                Sides::Both => height != 0.0,
                Sides::Front => height < 0.0,
            };
            let up = Vec3::from(local.up()).as_dvec3();
            let top = a.dot(up).max(b.dot(up)).max(c.dot(up));
            if top <= 0.0 || !faces || height.abs() > 1.0 {
                self.alive &= !(1 << i);
                continue;
            }
            let sign = height.signum();
            let [a, b, c] = [a, b, c].map(|v| v / size);
            for (row, v) in self.edges.iter_mut().zip([a.cross(b), b.cross(c), c.cross(a)]) {
                row.set_lane(i, (v * sign).normalize_or_zero().as_vec3().to_array());
            }
            self.normals.set_lane(i, (normal * sign).as_vec3().to_array());
            self.distances.0[i] = height.abs() as f32;
        }
    }
}

/// Lanes whose sphere around `center` through the farthest corner, grown by the radius, holds the receiver.
#[inline(always)]
fn within_reach([a, b, c]: [V8; 3], center: V8) -> u32 {
    let (a, b, c) = (a - center, b - center, c - center);
    let reach = F8::splat(1.0) + a.dot(a).max(b.dot(b)).max(c.dot(c)).sqrt();
    center.dot(center).le(reach * reach * F8::splat(1.0 + 1e-5))
}
