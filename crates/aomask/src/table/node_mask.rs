//! Occlusion masks of nodes: which rays may be blocked by what is in a box (`[Laine10]`, section 5 and figure 4).
//!
//! Here: masks by the circle around the box's bounding sphere, and by the box's silhouette. All are conservative: they hold
//! every ray that meets the box. Not here: the hemisphere test before and the walk after (`traversal.rs`).

use super::{
    edge::EdgeTable,
    lanes::{F8, V8, and},
    plane::{Margin, PlaneTable},
};

/// How the rays that may meet a node are found.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum NodeMasks {
    /// By the circle that the box's bounding sphere covers: one or two lookups.
    #[default]
    Circle,
    /// By the edges of the box's silhouette: four or six lookups, and tighter.
    Silhouette,
}

/// Boxes of a node's children around the receiver, in radii.
pub(crate) struct LocalBoxes {
    /// Lowest corners, the world's axes.
    pub(crate) low: V8,
    /// Highest corners, the world's axes.
    pub(crate) high: V8,
    /// Centres in the pattern's axes.
    pub(crate) center: V8,
    /// Squared length of half the diagonals.
    pub(crate) half_diagonal2: F8,
}

/// What to look up for the circles of eight boxes.
pub(crate) struct Circles {
    /// Bit `i`: box `i` may hold the receiver, and all its rays count.
    pub(crate) inside: u32,
    /// Distance in the table of directions; negative: all rays.
    pub(crate) direction: F8,
    /// Distance in the table of ends, where lengths differ; negative: all rays.
    pub(crate) end: F8,
}

impl LocalBoxes {
    /// `[Laine10]`, figure 4.
    #[inline(always)]
    pub(crate) fn circles(&self, directions: Margin, ends: Margin) -> Circles {
        let one = F8::splat(1.0);
        let (center2, radius2) = (self.center.dot(self.center), self.half_diagonal2);
        let center = center2.sqrt();
        // Squared distance to where the cone around the sphere touches it.
        let tangent2 = center2 - radius2;
        // Right: the cone touches within the radius. Left: the plane through the circle where the sphere leaves the
        // hemisphere.
        let near = (tangent2 / center2).max(F8::ZERO).sqrt();
        let far = ((tangent2 + one) / (center + center)).min(one);
        let cosine = far.select(one.lt(tangent2), near);
        let sine = (one - cosine * cosine).max(F8::ZERO).sqrt();
        // Not what is not a number.
        let outside = (F8::splat(1e-3) * center2).lt(tangent2) & center2.lt(F8::splat(f32::MAX));
        Circles {
            inside: !outside,
            direction: directions.circle(cosine, sine),
            end: ends.plane(center - radius2.sqrt()),
        }
    }
}

/// Silhouette edges of an axis-aligned box by where the eye is: for each axis 0 between the faces, 1 below, 2 above.
#[derive(Clone, Debug)]
pub(crate) struct Silhouettes {
    /// Pairs of corners, bit `a` of a corner set on the upper side of axis `a`; the cross product of the two, seen from the
    /// eye, points into the box. Empty where the eye is inside.
    edges: [Vec<[usize; 2]>; 27],
}

impl Silhouettes {
    pub(crate) fn new() -> Self {
        Self { edges: std::array::from_fn(|code| silhouette([code % 3, code / 3 % 3, code / 9])) }
    }

    /// Edges of the box from `low` to `high`, both relative to the eye.
    #[inline(always)]
    pub(crate) fn of(&self, low: [f32; 3], high: [f32; 3]) -> &[[usize; 2]] {
        let code = |axis: usize| {
            if low[axis] > 0.0 {
                1
            } else if high[axis] < 0.0 {
                2
            } else {
                0
            }
        };
        &self.edges[code(0) + 3 * code(1) + 9 * code(2)]
    }
}

/// The edges between a face that the eye sees and one that it does not.
fn silhouette(codes: [usize; 3]) -> Vec<[usize; 2]> {
    let mut edges: Vec<[usize; 2]> = Vec::new();
    for (axis, code) in codes.into_iter().enumerate().filter(|&(_, code)| code != 0) {
        let (u, v) = (1 << ((axis + 1) % 3), 1 << ((axis + 2) % 3));
        // Below the lower face, or above the upper: that face is seen, `u`, `v` clockwise or not.
        let upper = code == 2;
        let side = if upper { 1 << axis } else { 0 };
        let mut face = [side, side | u, side | u | v, side | v];
        if upper {
            face.reverse();
        }
        for i in 0..4 {
            let edge = [face[i], face[(i + 1) % 4]];
            // An edge of two visible faces appears twice, in opposite directions.
            match edges.iter().position(|&e| e == [edge[1], edge[0]]) {
                Some(at) => drop(edges.swap_remove(at)),
                None => edges.push(edge),
            }
        }
    }
    edges
}

/// Looks up masks of nodes.
#[derive(Clone, Debug)]
pub(crate) struct NodeLookup<'a, const W: usize> {
    /// By directions of rays.
    pub(crate) directions: &'a PlaneTable<W>,
    /// By ends of rays, if their lengths differ.
    pub(crate) ends: Option<&'a PlaneTable<W>>,
    /// Made by [`EdgeTable::conservative`].
    pub(crate) rims: &'a EdgeTable<W>,
    pub(crate) silhouettes: &'a Silhouettes,
}

impl<const W: usize> NodeLookup<'_, W> {
    /// Masks of all eight boxes by circles; `visit` gets those in `alive`.
    #[inline(always)]
    pub(crate) fn circles(&self, boxes: &LocalBoxes, alive: u32, mut visit: impl FnMut(usize, [u64; W])) {
        let margin = Margin::of(self.directions);
        let circles = boxes.circles(margin, self.ends.map_or(margin, Margin::of));
        let direction_cells = self.directions.cells(boxes.center, circles.direction);
        let end_cells = match self.ends {
            Some(ends) => ends.cells(boxes.center, circles.end),
            None => [0; 8],
        };
        let mut left = alive;
        while left != 0 {
            let i = left.trailing_zeros() as usize % 8;
            left &= left - 1;
            let mut mask = [!0; W];
            if circles.inside >> i & 1 == 0 {
                if circles.direction.0[i] >= 0.0 {
                    mask = *self.directions.mask(direction_cells[i]);
                }
                if let Some(ends) = self.ends
                    && circles.end.0[i] >= 0.0
                {
                    mask = and(&mask, ends.mask(end_cells[i]));
                }
            }
            visit(i, mask);
        }
    }

    /// The mask of one box, from `low` to `high` around the receiver in world axes, by its silhouette; `local` turns
    /// vectors into the pattern's axes.
    #[inline(always)]
    pub(crate) fn silhouette(&self, low: [f32; 3], high: [f32; 3], local: impl Fn(V8) -> V8) -> [u64; W] {
        let edges = self.silhouettes.of(low, high);
        let mut mask = [!0; W];
        if edges.is_empty() {
            return mask;
        }
        // Eight lanes, six used.
        let (mut from, mut to) = ([[1.0; 8]; 3], [[1.0; 8]; 3]);
        for (i, edge) in edges.iter().enumerate() {
            for axis in 0..3 {
                let ends = [low[axis], high[axis]];
                from[axis][i] = ends[edge[0] >> axis & 1];
                to[axis][i] = ends[edge[1] >> axis & 1];
            }
        }
        let normals = local(V8::from_rows(&from)).cross(local(V8::from_rows(&to)));
        let largest = normals.abs().largest();
        // An edge that points at the receiver has no plane.
        let usable = F8::splat(f32::MIN_POSITIVE).lt(largest) & largest.lt(F8::splat(f32::INFINITY));
        let cells = self.rims.cells(normals);
        for (i, &cell) in cells.iter().enumerate().take(edges.len()) {
            if usable >> i & 1 == 1 {
                mask = and(&mask, self.rims.mask(cell));
            }
        }
        mask
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::BackEnd;
    use proptest::prelude::*;
    use umbrage_geom::{Aabb, Ray, glam::Vec3};

    #[test]
    fn silhouettes_have_four_or_six_edges() {
        let silhouettes = Silhouettes::new();
        for (code, edges) in silhouettes.edges.iter().enumerate() {
            let outside = [code % 3, code / 3 % 3, code / 9].iter().filter(|&&c| c > 0).count();
            assert_eq!(edges.len(), [0, 4, 6, 6][outside]);
        }
    }

    /// Rays of random directions and lengths to 1, some of length 1.
    fn rays(equal: bool) -> Vec<Vec3> {
        let mut random = umbrage_geom::sampling::RandomStream::new(7, 0);
        let mut unit = || random.next_unit() * 2.0 - 1.0;
        let direction = |unit: &mut dyn FnMut() -> f32| loop {
            let v = Vec3::new(unit(), unit(), unit());
            if v.length_squared() > 0.01 && v.length_squared() < 1.0 {
                return v.normalize();
            }
        };
        (0..256).map(|_| direction(&mut unit) * if equal { 1.0 } else { unit().abs() }).collect()
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(400))]
        #[test]
        fn masks_hold_every_ray_that_meets_the_box(
            at in prop::array::uniform3(-1.5f32..1.5), half in prop::array::uniform3(-3f32..0.0), equal: bool,
        ) {
            let half = half.map(|x| if x < -2.7 { 0.0 } else { 10f32.powf(x) });
            thread_local! {
                static TABLES: [(Vec<Vec3>, [PlaneTable<4>; 2], EdgeTable<4>); 2] = [true, false].map(|equal| {
                    let ends = rays(equal);
                    let directions: Vec<Vec3> = ends.iter().map(|e| e.normalize()).collect();
                    let tables = [&directions, &ends].map(|v| PlaneTable::build(v, 20, BackEnd::best()));
                    let rims = EdgeTable::conservative(&directions, 20, BackEnd::best());
                    (ends, tables, rims)
                });
            }
            TABLES.with(|tables| {
                let (ends, [directions, lengths], rims) = &tables[usize::from(!equal)];
                let silhouettes = Silhouettes::new();
                let ends_table = (!equal).then_some(lengths);
                let lookup = NodeLookup { directions, ends: ends_table, rims, silhouettes: &silhouettes };
                let boxes = LocalBoxes {
                    low: V8::splat([0, 1, 2].map(|a| at[a] - half[a])),
                    high: V8::splat([0, 1, 2].map(|a| at[a] + half[a])),
                    center: V8::splat(at),
                    half_diagonal2: F8::splat(half.iter().map(|x| x * x).sum()),
                };
                let (low, high) = (boxes.low.lane(0), boxes.high.lane(0));
                let mut masks = vec![lookup.silhouette(low, high, |v| v)];
                lookup.circles(&boxes, 0b100, |_, mask| masks.push(mask));
                for (i, &end) in ends.iter().enumerate() {
                    let ray = Ray::new([0.0; 3], end).with_tfar(1.0);
                    let aabb = Aabb { min: low.into(), max: high.into() };
                    if aabb.may_hit(&ray) {
                        for (which, mask) in masks.iter().enumerate() {
                            prop_assert!(mask[i / 64] >> (i % 64) & 1 == 1, "ray {} mask {}", i, which);
                        }
                    }
                }
                Ok(())
            })?;
        }
    }
}
