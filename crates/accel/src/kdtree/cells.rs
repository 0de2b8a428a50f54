//! The cells: leaves with their boxes, which of them meet, and where a point is.

use super::{KdTree, LeafState, node::Node};
use umbrage_geom::{Aabb, Ray, crosses_triangle, glam::DVec3};

/// A leaf and its cell.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Leaf {
    /// Place among the nodes; names the leaf in other calls.
    pub index: u32,
    /// The cell.
    pub bounds: Aabb,
    /// What it is.
    pub state: LeafState,
    /// Triangles that reach into it.
    pub triangles: u32,
    /// Inner nodes above it.
    pub depth: u32,
}

/// Where a point is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Location {
    /// Outside of the tree's bounds.
    Outside,
    /// Strictly inside the cell of a leaf of this state.
    Inside(LeafState),
    /// On a split plane or the bounds.
    Between,
}

/// Two parts of the tree on both sides of a plane, and where they may touch.
struct Pair {
    nodes: [u32; 2],
    /// Axis that the plane is perpendicular to.
    axis: usize,
    /// What of the plane both have, so far.
    shared: Aabb,
}

impl KdTree {
    /// Calls `visit` for every leaf, in the order of nodes.
    pub fn for_each_leaf(&self, mut visit: impl FnMut(Leaf)) {
        let mut stack = vec![(0u32, self.bounds, 0u32)];
        while let Some((index, bounds, depth)) = stack.pop() {
            let node = self.nodes[index as usize];
            if node.is_leaf() {
                let triangles = node.blocks().map(|block| self.block_len(block)).sum();
                visit(Leaf { index, bounds, state: node.state(), triangles, depth });
                continue;
            }
            let [left, right] = split(node, &bounds);
            stack.push((node.right() as u32, right, depth + 1));
            stack.push((index + 1, left, depth + 1));
        }
    }

    /// Says what an empty leaf is: `slot` is what [`super::Blocker::Cell`] will name it by if opaque. Leaves with triangles or
    /// guards stay as they are, and `Boundary` takes an empty leaf out of use.
    ///
    /// # Panics
    /// If `leaf` is not the index of a leaf.
    pub fn set_state(&mut self, leaf: u32, state: LeafState, slot: u32) {
        let node = &mut self.nodes[leaf as usize];
        assert!(node.is_leaf(), "node {leaf} is not a leaf");
        if node.state() != LeafState::Boundary {
            node.set_state(state, slot);
        }
    }

    /// Tells [`super::Search::Solid`] which children to visit first: those with more opaque surface area; among those
    /// without any, those with fewer triangles.
    pub fn prefer_opaque(&mut self) {
        let mut areas = vec![0f64; self.nodes.len()];
        self.for_each_leaf(|leaf| {
            if leaf.state == LeafState::Opaque {
                areas[leaf.index as usize] = leaf.bounds.area().into();
            }
        });
        // Children come after their parents.
        for index in (0..self.nodes.len()).rev() {
            let node = self.nodes[index];
            if !node.is_leaf() {
                let (left, right) = (areas[index + 1], areas[node.right()]);
                areas[index] = left + right;
                self.nodes[index].set_right_first(right > left);
            }
        }
    }

    /// Calls `visit` with the indices of every two empty leaves whose cells share part of a face with some area: no triangle
    /// or guard lies between the insides of the two.
    pub fn for_each_empty_pair(&self, mut visit: impl FnMut(u32, u32)) {
        let mut stack = vec![(0u32, self.bounds)];
        let mut pairs = Vec::new();
        while let Some((index, bounds)) = stack.pop() {
            let node = self.nodes[index as usize];
            if node.is_leaf() {
                continue;
            }
            let [left, right] = split(node, &bounds);
            pairs.push(Pair { nodes: [index + 1, node.right() as u32], axis: node.axis(), shared: left });
            while let Some(pair) = pairs.pop() {
                self.refine_pair(pair, &mut pairs, &mut visit);
            }
            stack.push((node.right() as u32, right));
            stack.push((index + 1, left));
        }
    }

    /// Takes a pair apart, or visits it.
    fn refine_pair(&self, pair: Pair, pairs: &mut Vec<Pair>, visit: &mut impl FnMut(u32, u32)) {
        let Pair { nodes, axis, shared } = pair;
        for side in 0..2 {
            let index = nodes[side];
            let node = self.nodes[index as usize];
            if node.is_leaf() {
                continue;
            }
            let with = |child: u32, shared: Aabb| {
                let mut nodes = nodes;
                nodes[side] = child;
                Pair { nodes, axis, shared }
            };
            if node.axis() == axis {
                // Only the child at the plane touches it.
                pairs.push(with(if side == 0 { node.right() as u32 } else { index + 1 }, shared));
            } else {
                let [left, right] = split(node, &shared);
                if left.min[node.axis()] < left.max[node.axis()] {
                    pairs.push(with(index + 1, left));
                }
                if right.min[node.axis()] < right.max[node.axis()] {
                    pairs.push(with(node.right() as u32, right));
                }
            }
            return;
        }
        let empty = |index: u32| self.nodes[index as usize].state() != LeafState::Boundary;
        if empty(nodes[0]) && empty(nodes[1]) {
            visit(nodes[0], nodes[1]);
        }
    }

    /// Where all points are that are no farther than `margin` from `point` along any axis: [`Location::Between`] unless one
    /// answer holds for all.
    pub fn locate(&self, point: DVec3, margin: f64) -> Location {
        let (min, max) = (self.bounds.min.as_dvec3(), self.bounds.max.as_dvec3());
        let (low, high) = (point - margin, point + margin);
        if high.cmplt(min).any() || low.cmpgt(max).any() {
            return Location::Outside;
        }
        if !(low.cmpgt(min).all() && high.cmplt(max).all()) {
            return Location::Between;
        }
        let mut index = 0;
        loop {
            let node = self.nodes[index];
            if node.is_leaf() {
                return Location::Inside(node.state());
            }
            let (axis, position) = (node.axis(), f64::from(node.position()));
            index = if high[axis] < position {
                index + 1
            } else if low[axis] > position {
                node.right()
            } else {
                return Location::Between;
            };
        }
    }

    /// Whether all leaves whose closed cells meet the closed `region` are in `state`, given that it lies strictly inside the
    /// bounds.
    pub fn all_in(&self, region: &Aabb, state: LeafState) -> bool {
        let inside = region.min.cmpgt(self.bounds.min).all() && region.max.cmplt(self.bounds.max).all();
        let mut stack = vec![0];
        while let Some(index) = stack.pop().filter(|_| inside) {
            let node = self.nodes[index];
            if node.is_leaf() {
                if node.state() != state {
                    return false;
                }
                continue;
            }
            if region.min[node.axis()] <= node.position() {
                stack.push(index + 1);
            }
            if region.max[node.axis()] >= node.position() {
                stack.push(node.right());
            }
        }
        inside
    }

    /// Where the face of `region` that looks up `axis` (or down it) can be moved to, so that no leaf that the box then has
    /// more of is in another state than `state`; no farther than the tree's bounds. The box's inside counts, not its rim.
    pub fn reach(&self, region: &Aabb, axis: usize, up: bool, state: LeafState) -> f32 {
        // Downwards with signs changed.
        let sign = if up { 1.0 } else { -1.0 };
        let face = if up { region.max[axis] } else { -region.min[axis] };
        let (first, last) =
            if up { (&self.bounds.min, &self.bounds.max) } else { (&self.bounds.max, &self.bounds.min) };
        let mut limit = sign * last[axis];
        // Nodes with where their cells start.
        let mut stack = vec![(0u32, sign * first[axis])];
        while let Some((index, start)) = stack.pop() {
            if start >= limit {
                continue;
            }
            let node = self.nodes[index as usize];
            if node.is_leaf() {
                if node.state() != state {
                    limit = start.max(face);
                }
                continue;
            }
            let (left, right) = (index + 1, node.right() as u32);
            let position = node.position();
            if node.axis() == axis {
                let (near, far) = if up { (left, right) } else { (right, left) };
                stack.push((far, start.max(sign * position)));
                if sign * position > face {
                    stack.push((near, start));
                }
            } else {
                if region.max[node.axis()] > position {
                    stack.push((right, start));
                }
                if region.min[node.axis()] < position {
                    stack.push((left, start));
                }
            }
        }
        sign * limit
    }

    /// Calls `visit` with the slot of every opaque leaf of whose cell part lies inside of `region`.
    pub fn for_each_opaque_in(&self, region: &Aabb, mut visit: impl FnMut(u32)) {
        let mut stack = vec![0];
        while let Some(index) = stack.pop() {
            let node = self.nodes[index];
            if node.is_leaf() {
                if node.state() == LeafState::Opaque {
                    visit(node.slot());
                }
                continue;
            }
            if region.min[node.axis()] < node.position() {
                stack.push(index + 1);
            }
            if region.max[node.axis()] > node.position() {
                stack.push(node.right());
            }
        }
    }

    /// Crossings of `ray` out minus in, over the triangles that `winding` gives a weight: how they turn (1 as given, -1
    /// reversed, 0 not counted). For a half line and closed surfaces this is the winding number around its start, see
    /// [`umbrage_geom::winding_number`]; exact.
    pub fn winding_number(&self, ray: &Ray, winding: impl Fn(u32) -> i32) -> i32 {
        let Some(slab) = umbrage_geom::SlabRay::new(ray) else { return 0 };
        let mut crossed = Vec::new();
        // The whole cell is tested, rather than an interval of `t`: simple, and fast enough for a ray a region.
        let mut stack = vec![(0usize, self.bounds)];
        while let Some((index, bounds)) = stack.pop() {
            if slab.entry(&bounds, slab.tfar).is_none() {
                continue;
            }
            let node = self.nodes[index];
            if !node.is_leaf() {
                let [left, right] = split(node, &bounds);
                stack.extend([(node.right(), right), (index + 1, left)]);
                continue;
            }
            for block in node.blocks() {
                for (lane, &prim) in self.prims[block].iter().enumerate().take_while(|(_, p)| **p != u32::MAX)
                {
                    if let Some(crossing) = crosses_triangle(ray, self.blocks[block].get(lane)) {
                        crossed.push((prim, crossing.winding()));
                    }
                }
            }
        }
        // A triangle may be in several leaves.
        crossed.sort_unstable();
        crossed.dedup();
        crossed.into_iter().map(|(prim, turns)| turns * winding(prim)).sum()
    }
}

/// Cells of a node's children.
fn split(node: Node, cell: &Aabb) -> [Aabb; 2] {
    let (mut left, mut right) = (*cell, *cell);
    left.max[node.axis()] = left.max[node.axis()].min(node.position());
    right.min[node.axis()] = right.min[node.axis()].max(node.position());
    [left, right]
}
