//! Occlusion masks of triangles ([Laine10], section 3.1 and figure 1), and the tests that spare them (section 5).
//!
//! Here: eight triangles of a leaf at a time, in the pattern's axes and radii. Not here: which leaves are visited
//! (`traversal.rs`).

use super::{
    edge::EdgeTable,
    plane::{F8, PlaneTable, V8},
};
use crate::Sides;
use umbrage_geom::{
    Frame,
    glam::{DVec3, Vec3},
    kernel::TriangleBlock,
};

/// Coordinates, in radii, up to which products of four stay far from the largest `f32`; beyond, `f64` is used.
const LARGE: f32 = 1e9;

/// World space to the pattern's axes at a receiver, in radii.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Local {
    pub(crate) origin: [f32; 3],
    /// Rows, each divided by the radius.
    pub(crate) rows: [[f32; 3]; 3],
}

impl Local {
    pub(crate) fn new(origin: Vec3, frame: &Frame, radius: f32) -> Self {
        let rows = [frame.tangent, frame.bitangent, frame.normal].map(|v| (v / radius).to_array());
        Self { origin: origin.to_array(), rows }
    }

    /// Turns and scales a vector.
    #[inline(always)]
    pub(crate) fn vector(&self, v: [f32; 3]) -> [f32; 3] {
        self.rows.map(|row| row[0] * v[0] + row[1] * v[1] + row[2] * v[2])
    }

    /// Turns and scales eight vectors.
    #[inline(always)]
    pub(crate) fn vectors(&self, v: &V8) -> V8 {
        self.rows.map(|row| std::array::from_fn(|i| row[0] * v[0][i] + row[1] * v[1][i] + row[2] * v[2][i]))
    }

    /// Moves, turns and scales eight points.
    #[inline(always)]
    fn points(&self, p: &V8) -> V8 {
        let moved = std::array::from_fn(|axis| {
            let origin = self.origin[axis];
            p[axis].map(|x| x - origin)
        });
        self.vectors(&moved)
    }
}

#[inline(always)]
fn cross(a: &V8, b: &V8) -> V8 {
    let row = |u: usize, v: usize| std::array::from_fn(|i| a[u][i] * b[v][i] - a[v][i] * b[u][i]);
    [row(1, 2), row(2, 0), row(0, 1)]
}

#[inline(always)]
fn dot(a: &V8, b: &V8) -> F8 {
    std::array::from_fn(|i| a[0][i] * b[0][i] + a[1][i] * b[1][i] + a[2][i] * b[2][i])
}

#[inline(always)]
fn minus(a: &V8, b: &V8) -> V8 {
    std::array::from_fn(|axis| std::array::from_fn(|i| a[axis][i] - b[axis][i]))
}

/// Bits of the lanes where `test` is true.
#[inline(always)]
pub(crate) fn bits(test: impl Fn(usize) -> bool) -> u32 {
    (0..8).fold(0, |bits, i| bits | u32::from(test(i)) << i)
}

/// Eight triangles with what their masks need. Lanes that are culled, unused or degenerate are not in `alive`.
pub(crate) struct Triangles {
    pub(crate) alive: u32,
    /// Lanes left after each of the four culling tests.
    pub(crate) after: [u32; 4],
    /// Planes through the receiver and each edge: inward normals.
    edges: [V8; 3],
    /// The triangles' planes: normals away from the receiver, and distances in radii.
    normals: V8,
    distances: F8,
    /// Lanes whose numbers are too large for the above.
    large: u32,
}

impl Triangles {
    /// Puts the triangles of `block` through the culling tests.
    #[inline(always)]
    pub(crate) fn new(block: &TriangleBlock, local: &Local, sides: Sides) -> Self {
        let [a, b, c] = block.corners().each_ref().map(|corner| local.points(corner));
        let largest: F8 = std::array::from_fn(|i| {
            [&a, &b, &c].iter().flat_map(|v| v.iter()).fold(0f32, |m, lanes| m.max(lanes[i].abs()))
        });
        let used = bits(|i| a[0][i] == a[0][i]);
        let large = bits(|i| largest[i] >= LARGE) & used;
        // 1. All vertices below the horizon.
        let above = bits(|i| a[2][i].max(b[2][i]).max(c[2][i]) > 0.0) & used;
        // 2. One-sided and facing away. Triangles whose plane holds the receiver block nothing.
        let normals = cross(&minus(&b, &a), &minus(&c, &a));
        let heights = dot(&normals, &a);
        let facing = above
            & match sides {
                Sides::Both => bits(|i| heights[i] != 0.0),
                Sides::Front => bits(|i| heights[i] < 0.0),
            };
        // 3. The plane is beyond the radius.
        let squares = dot(&normals, &normals);
        let distances: F8 = std::array::from_fn(|i| heights[i].abs() / squares[i].sqrt());
        let close = facing & bits(|i| distances[i] <= 1.0);
        // 4. The receiver is outside the bounding sphere of the region of influence.
        let reached = close & within_reach(&a, &b, &c);
        let sign: F8 = std::array::from_fn(|i| 1f32.copysign(heights[i]));
        let signed = |v: V8| v.map(|row| std::array::from_fn(|i| row[i] * sign[i]));
        Self {
            alive: reached | large,
            after: [above | large, facing | large, close | large, reached | large],
            edges: [signed(cross(&a, &b)), signed(cross(&b, &c)), signed(cross(&c, &a))],
            normals: signed(normals),
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
        let edges = self.edges.each_ref().map(|normals| edge_table.cells(normals));
        let planes = plane_table.cells(&self.normals, &self.distances);
        let mut left = self.alive;
        while left != 0 {
            let i = left.trailing_zeros() as usize % 8;
            left &= left - 1;
            let [e0, e1, e2] = edges.each_ref().map(|cells| edge_table.mask(cells[i]));
            let plane = plane_table.mask(planes[i]);
            visit(std::array::from_fn(|w| e0[w] & e1[w] & e2[w] & plane[w]));
        }
    }

    /// The same tests and planes for triangles millions of radii in size, in `f64` and scaled by their size.
    #[cold]
    fn redo_large(&mut self, block: &TriangleBlock, local: &Local, sides: Sides) {
        for i in (0..8).filter(|i| self.large >> i & 1 == 1) {
            let [a, b, c] = block.get(i).map(|p| {
                let v = Vec3::from(p).as_dvec3() - Vec3::from(local.origin).as_dvec3();
                let row = |r: [f32; 3]| Vec3::from(r).as_dvec3().dot(v);
                DVec3::new(row(local.rows[0]), row(local.rows[1]), row(local.rows[2]))
            });
            let size = a.abs().max(b.abs()).max(c.abs()).max_element();
            let normal = (b - a).cross(c - a).normalize_or_zero();
            let height = normal.dot(a);
            let faces = match sides {
                Sides::Both => height != 0.0,
                Sides::Front => height < 0.0,
            };
            if a.z.max(b.z).max(c.z) <= 0.0 || !faces || height.abs() > 1.0 || !size.is_finite() {
                self.alive &= !(1 << i);
                continue;
            }
            let sign = height.signum();
            let [a, b, c] = [a, b, c].map(|v| v / size);
            for (row, v) in self.edges.iter_mut().zip([a.cross(b), b.cross(c), c.cross(a)]) {
                let v = (v * sign).normalize_or_zero().as_vec3().to_array();
                row.iter_mut().zip(v).for_each(|(lanes, x)| lanes[i] = x);
            }
            let normal = (normal * sign).as_vec3().to_array();
            self.normals.iter_mut().zip(normal).for_each(|(lanes, x)| lanes[i] = x);
            self.distances[i] = height.abs() as f32;
        }
    }
}

/// Lanes whose bounding sphere, grown by the radius, holds the receiver.
#[inline(always)]
fn within_reach(a: &V8, b: &V8, c: &V8) -> u32 {
    let center: V8 = std::array::from_fn(|axis| {
        std::array::from_fn(|i| {
            let (a, b, c) = (a[axis][i], b[axis][i], c[axis][i]);
            0.5 * (a.min(b).min(c) + a.max(b).max(c))
        })
    });
    let radii = [a, b, c].map(|v| {
        let v = minus(v, &center);
        dot(&v, &v)
    });
    let distance = dot(&center, &center);
    bits(|i| {
        let reach = 1.0 + radii[0][i].max(radii[1][i]).max(radii[2][i]).sqrt();
        distance[i] <= reach * reach * (1.0 + 1e-5)
    })
}
