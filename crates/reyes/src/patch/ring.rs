//! Irregular patches in generic topology: a quadrilateral with a fan at each corner.

use super::Bicubic;
use crate::subdiv::{CreaseMethod, Fan, INFINITE_SHARPNESS, Spoke};
use umbrage_geom::{Aabb, glam::DVec3};

/// A quadrilateral and the quadrilaterals around it. Corners 0 to 3 are at `(u, v)` = (0, 0), (1, 0), (1, 1), (0, 1).
#[derive(Clone, Debug)]
pub(crate) struct Ring {
    pub(crate) fans: [Fan; 4],
    /// Index of the quadrilateral itself in each fan.
    pub(crate) own: [usize; 4],
}

/// How each edge of the face looks to a bicubic patch.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Side {
    Smooth,
    /// Infinitely sharp, or a boundary: the patch ends there.
    Sharp,
}

/// Rotations of the 4 x 4 net by which corner `k` becomes corner 0: maps `(i, j)` seen from that corner.
fn net_index(k: usize, i: usize, j: usize) -> (usize, usize) {
    match k {
        0 => (i, j),
        1 => (3 - j, i),
        2 => (3 - i, 3 - j),
        _ => (j, 3 - i),
    }
}

impl Ring {
    /// Box of all control points; holds the surface but for rounding, since every rule is a convex combination.
    pub(crate) fn hull(&self) -> Aabb {
        let mut aabb = Aabb::EMPTY;
        for fan in &self.fans {
            aabb = aabb.with_point(fan.center.as_vec3());
            for (i, spoke) in fan.spokes.iter().enumerate() {
                aabb = aabb.with_point(spoke.edge.as_vec3());
                if i < fan.faces() {
                    aabb = aabb.with_point(spoke.diagonal.as_vec3());
                }
            }
        }
        aabb
    }

    pub(crate) fn limit(&self, corner: usize, method: CreaseMethod) -> DVec3 {
        self.fans[corner].limit(method)
    }

    pub(crate) fn tangents(&self, corner: usize, method: CreaseMethod) -> [DVec3; 2] {
        self.fans[corner].tangents(self.own[corner], method)
    }

    /// The four quarters, in the order of corners, each with its corners in the order of the whole.
    pub(crate) fn split(&self, method: CreaseMethod) -> [Self; 4] {
        let fine = [0, 1, 2, 3].map(|k| self.fans[k].refine(method));
        [0, 1, 2, 3].map(|k| self.quarter(k, &fine))
    }

    /// The point of edge `k`, from corner `k` to the next, of the refined ring.
    fn edge_point(&self, k: usize, fine: &[Fan; 4]) -> DVec3 {
        fine[k].spokes[self.own[k]].edge
    }

    /// Quarter `k` from the refined fans.
    fn quarter(&self, k: usize, fine: &[Fan; 4]) -> Self {
        let [a, b, c] = [(k + 1) % 4, (k + 2) % 4, (k + 3) % 4];
        let middle = fine[k].spokes[self.own[k]].diagonal;
        let edge = |k: usize| self.edge_point(k, fine);
        let center = |k: usize| fine[k].center;
        let around_middle = Fan::closed(
            middle,
            [
                (edge(c), 0.0, center(k)),
                (edge(k), 0.0, center(a)),
                (edge(a), 0.0, center(b)),
                (edge(b), 0.0, center(c)),
            ],
        );
        let (next, next_own) = self.around_edge(k, fine, false);
        let (previous, previous_own) = self.around_edge(c, fine, true);
        let mut corners: [(Fan, usize); 4] =
            [k, a, b, c].map(|_| (Fan::closed(middle, [(middle, 0.0, middle); 4]), 0));
        corners[k] = (fine[k].clone(), self.own[k]);
        corners[a] = (next, next_own);
        corners[b] = (around_middle, 0);
        corners[c] = (previous, previous_own);
        let own = [0, 1, 2, 3].map(|i| corners[i].1);
        Self { fans: corners.map(|(fan, _)| fan), own }
    }

    /// The fan around the point of edge `k`, and the index in it of the quarter at corner `k`, or, if `at_end`, of the
    /// quarter at the next corner.
    fn around_edge(&self, k: usize, fine: &[Fan; 4], at_end: bool) -> (Fan, usize) {
        let (a, c) = ((k + 1) % 4, (k + 3) % 4);
        let (start, end) = (&fine[k], &fine[a]);
        let center = self.edge_point(k, fine);
        let middle = start.spokes[self.own[k]].diagonal;
        // The halves of the edge, as each end sees them.
        let to_start = start.spokes[self.own[k]].sharpness;
        let to_end = end.spoke(self.own[a] + 1).sharpness;
        let (towards_start, towards_end) = (start.center, end.center);
        // Points of this face's other edges next to both ends.
        let (beside_start, beside_end) = (self.edge_point(c, fine), self.edge_point(a, fine));
        let Some(across) = self.fans[k].before(self.own[k]) else {
            let spoke = |edge, sharpness, diagonal| Spoke { edge, sharpness, diagonal };
            let spokes = Box::new([
                spoke(towards_end, to_end, beside_end),
                spoke(middle, 0.0, beside_start),
                spoke(towards_start, to_start, DVec3::NAN),
            ]);
            return (Fan { center, sharpness: 0.0, closed: false, spokes }, usize::from(!at_end));
        };
        // The face across, its edges at both ends.
        let far_middle = start.spokes[across].diagonal;
        let far_start = start.spokes[across].edge;
        let far_end = end.spoke(self.own[a] + 2).edge;
        let around = [
            (middle, 0.0, beside_start),
            (towards_start, to_start, far_start),
            (far_middle, 0.0, far_end),
            (towards_end, to_end, beside_end),
        ];
        (Fan::closed(center, around), if at_end { 3 } else { 0 })
    }

    /// The bicubic patch that this is, if the face is regular: quadrilaterals around four smooth or infinitely sharp corners.
    pub(crate) fn regular(&self) -> Option<Bicubic> {
        let sides = [0, 1, 2, 3].map(|k| self.side(k));
        let sides = [sides[0]?, sides[1]?, sides[2]?, sides[3]?];
        (0..4).all(|k| self.is_regular_corner(k, sides[k], sides[(k + 3) % 4])).then(|| self.net(sides))
    }

    /// `None` for a crease that decays.
    fn side(&self, k: usize) -> Option<Side> {
        match self.fans[k].spokes[self.own[k]].sharpness {
            0.0 => Some(Side::Smooth),
            s if s >= INFINITE_SHARPNESS => Some(Side::Sharp),
            _ => None,
        }
    }

    fn is_regular_corner(&self, k: usize, next: Side, previous: Side) -> bool {
        let (fan, own) = (&self.fans[k], self.own[k]);
        let sharp = || fan.spokes.iter().map(|s| s.sharpness).filter(|&s| s > 0.0);
        let infinite = sharp().filter(|&s| s >= INFINITE_SHARPNESS).count();
        let creased = fan.sharpness == 0.0 && sharp().count() == 2 && infinite == 2;
        match (next, previous) {
            (Side::Smooth, Side::Smooth) => {
                fan.closed && fan.spokes.len() == 4 && fan.sharpness == 0.0 && sharp().next().is_none()
            }
            // Two faces on this side of the crease.
            (Side::Sharp, Side::Smooth) => {
                creased && fan.after(own).is_some() && fan.spoke(own + 2).sharpness > 0.0
            }
            (Side::Smooth, Side::Sharp) => {
                creased && fan.before(own).is_some_and(|before| fan.spokes[before].sharpness > 0.0)
            }
            (Side::Sharp, Side::Sharp) => fan.sharpness >= INFINITE_SHARPNESS || infinite >= 3,
        }
    }

    /// The control net; rows beyond sharp sides continue it straight, which keeps the boundary curve.
    fn net(&self, sides: [Side; 4]) -> Bicubic {
        let mut net = [[DVec3::ZERO; 4]; 4];
        for k in 0..4 {
            let (fan, own) = (&self.fans[k], self.own[k]);
            let mut set = |i: usize, j: usize, p: DVec3| {
                let (i, j) = net_index(k, i, j);
                net[j][i] = p;
            };
            set(1, 1, fan.center);
            // Seen from the corner, `u` runs along the next edge and `v` along the previous one.
            if let (Side::Smooth, Some(after)) = (sides[(k + 3) % 4], fan.after(own)) {
                set(0, 2, fan.spokes[after].diagonal);
                set(0, 1, fan.spoke(own + 2).edge);
            }
            if let (Side::Smooth, Some(before)) = (sides[k], fan.before(own)) {
                set(2, 0, fan.spokes[before].diagonal);
                set(1, 0, fan.spokes[before].edge);
            }
            if sides[k] == Side::Smooth && sides[(k + 3) % 4] == Side::Smooth {
                set(0, 0, fan.spoke(own + 2).diagonal);
            }
        }
        let beyond = |near: DVec3, far: DVec3| 2.0 * near - far;
        if sides[0] == Side::Sharp {
            net[0] = [0, 1, 2, 3].map(|i| beyond(net[1][i], net[2][i]));
        }
        if sides[2] == Side::Sharp {
            net[3] = [0, 1, 2, 3].map(|i| beyond(net[2][i], net[1][i]));
        }
        for row in &mut net {
            if sides[3] == Side::Sharp {
                row[0] = beyond(row[1], row[2]);
            }
            if sides[1] == Side::Sharp {
                row[3] = beyond(row[2], row[1]);
            }
        }
        Bicubic::from_doubles(net)
    }
}
