//! Making room for solid boxes in a hierarchy.
//!
//! A node gives up to two of its eight slots to solid boxes that cover enough of it; the children that have no slot any more
//! share one, as children of a new node. The root keeps a few slots free for what each light met last.

use super::node::{LEAF, Node, WIDTH};
use umbrage_accel::{Bvh, Child};
use umbrage_geom::Aabb;

/// Solid boxes of a node.
const MOST_SOLIDS: usize = 2;

/// Least surface area that a solid box must add to those above, relative to the node's.
const LEAST_AREA: f32 = 0.1;

/// Levels that get solid boxes: below, triangles are as good. Also bounds what nodes for shared slots add to the depth.
const SOLID_LEVELS: usize = 10;

/// A child before it has a place.
enum Draft {
    Leaf(u32),
    Node(u32),
    /// Children that share a slot.
    Group(Vec<(Aabb, Draft)>),
}

struct Builder<'a> {
    bvh: &'a Bvh,
    solids: &'a [Aabb],
    nodes: Vec<Node>,
    /// Solid boxes on the way from the root.
    taken: Vec<u32>,
}

fn intersection(a: &Aabb, b: &Aabb) -> Aabb {
    Aabb { min: a.min.max(b.min), max: a.max.min(b.max) }
}

/// The nodes of `bvh` with `solids` among them; `reserved` slots of the root stay free.
pub(super) fn build(bvh: &Bvh, solids: &[Aabb], reserved: usize) -> Vec<Node> {
    let mut builder = Builder { bvh, solids, nodes: Vec::new(), taken: Vec::new() };
    let children = drafts(bvh, 0);
    builder.emit(children, (0..solids.len() as u32).collect(), 0, reserved);
    builder.nodes
}

fn drafts(bvh: &Bvh, node: u32) -> Vec<(Aabb, Draft)> {
    let draft = |child| match child {
        Child::Leaf(leaf) => Draft::Leaf(leaf),
        Child::Node(node) => Draft::Node(node),
    };
    bvh.children(node).map(|(aabb, child)| (aabb, draft(child))).collect()
}

impl Builder<'_> {
    /// Writes a node and all below it; returns its index.
    fn emit(
        &mut self,
        mut children: Vec<(Aabb, Draft)>,
        candidates: Vec<u32>,
        level: usize,
        reserved: usize,
    ) -> u32 {
        let index = self.nodes.len();
        self.nodes.push(Node::EMPTY);
        let bounds = children.iter().fold(Aabb::EMPTY, |b, (aabb, _)| b.union(*aabb));
        // The root's free slots hold better boxes than it could know of.
        let most = if level < SOLID_LEVELS && reserved == 0 { MOST_SOLIDS } else { 0 };
        let picked = self.pick(&bounds, &candidates, most);
        share_slots(&mut children, WIDTH - reserved.max(picked.len()));
        for (i, &solid) in picked.iter().enumerate() {
            self.nodes[index].set_solid(WIDTH - 1 - i, &self.solids[solid as usize], solid);
        }
        self.taken.extend(&picked);
        // Larger boxes first, as in the hierarchy.
        children.sort_by(|a, b| b.0.area().total_cmp(&a.0.area()));
        for (slot, (aabb, draft)) in children.into_iter().enumerate() {
            let inner = match draft {
                Draft::Leaf(leaf) => {
                    self.nodes[index].set(slot, &aabb, leaf | LEAF);
                    continue;
                }
                Draft::Node(node) => drafts(self.bvh, node),
                Draft::Group(children) => children,
            };
            let useful = |&solid: &u32| {
                let area = intersection(&self.solids[solid as usize], &aabb).area();
                !self.taken.contains(&solid)
                    && level + 1 < SOLID_LEVELS
                    && area > 0.2 * LEAST_AREA * aabb.area()
            };
            let below: Vec<u32> = candidates.iter().copied().filter(useful).collect();
            let child = self.emit(inner, below, level + 1, 0);
            self.nodes[index].set(slot, &aabb, child);
        }
        self.taken.truncate(self.taken.len() - picked.len());
        index as u32
    }

    /// The solid boxes worth a slot of a node.
    fn pick(&self, bounds: &Aabb, candidates: &[u32], most: usize) -> Vec<u32> {
        let mut picked: Vec<u32> = Vec::new();
        while picked.len() < most {
            let mut best = (LEAST_AREA * bounds.area(), u32::MAX);
            for &c in candidates.iter().filter(|c| !picked.contains(c)) {
                let inside = intersection(&self.solids[c as usize], bounds);
                let area = inside.area();
                if area > best.0 {
                    let known = self.taken.iter().chain(&picked);
                    let overlap = known.map(|&k| intersection(&inside, &self.solids[k as usize]).area());
                    let gain = area - overlap.fold(0.0, f32::max);
                    if gain > best.0 {
                        best = (gain, c);
                    }
                }
            }
            if best.1 == u32::MAX {
                break;
            }
            picked.push(best.1);
        }
        picked
    }
}

/// Joins pairs of children whose common box is smallest until there are at most `slots`.
fn share_slots(children: &mut Vec<(Aabb, Draft)>, slots: usize) {
    while children.len() > slots {
        let mut best = (f32::INFINITY, 0, 1);
        for i in 0..children.len() {
            for j in 0..i {
                let area = children[i].0.union(children[j].0).area();
                if area < best.0 {
                    best = (area, j, i);
                }
            }
        }
        let b = children.swap_remove(best.2);
        let a = children.swap_remove(best.1);
        let aabb = a.0.union(b.0);
        // A group with room takes one more.
        let group = match (a, b) {
            ((_, Draft::Group(mut group)), other) | (other, (_, Draft::Group(mut group)))
                if group.len() < WIDTH =>
            {
                group.push(other);
                group
            }
            (a, b) => vec![a, b],
        };
        children.push((aabb, Draft::Group(group)));
    }
}
