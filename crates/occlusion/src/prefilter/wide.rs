//! The 8-wide tree that rays walk, level by level in memory.
//!
//! Here: layout, collapse of the binary tree, boxes. Not here: which nodes may end rays (`correlation.rs`), their opacities
//! (`opacity.rs`), walking (`walk.rs`).

use std::ops::Range;
use umbrage_accel::{BinaryNode, BinaryTree};
use umbrage_geom::{
    Aabb,
    kernel::{LANES, TriangleBlock},
};

/// Children of a node.
pub(crate) const WIDTH: usize = 8;

/// Marks a child that is a leaf; the other bits are the index of a leaf or node.
pub(crate) const LEAF: u32 = 1 << 31;

/// Most nodes on a path: each takes at least one level of the binary tree.
pub(crate) const MAX_LEVELS: usize = BinaryTree::MAX_DEPTH + 1;

/// Boxes, references and sizes of eight children: four cache lines.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
pub(crate) struct Node {
    /// Rows: smallest x, largest x, smallest y, ..; one child a lane. Empty slots have the box `[inf, -inf]`, which no
    /// ray enters.
    pub(crate) bounds: [[f32; WIDTH]; 6],
    /// Nodes come after their parents; slots fill from 0, large boxes first. Empty slots have `u32::MAX`.
    pub(crate) children: [u32; WIDTH],
    /// Squared radius of each child as far as it matters for ending rays; infinite where none may end.
    pub(crate) reach: [f32; WIDTH],
}

impl Node {
    const EMPTY: Self = {
        let (inf, neg) = ([f32::INFINITY; WIDTH], [f32::NEG_INFINITY; WIDTH]);
        Self {
            bounds: [inf, neg, inf, neg, inf, neg],
            children: [u32::MAX; WIDTH],
            reach: [f32::INFINITY; WIDTH],
        }
    };

    /// A node over boxes alone, all with one `reach`.
    #[cfg(test)]
    pub(crate) fn with_children(boxes: &[Aabb], reach: f32) -> Self {
        let mut node = Self::EMPTY;
        for (slot, aabb) in boxes.iter().enumerate() {
            node.set_box(slot, aabb);
            (node.children[slot], node.reach[slot]) = (slot as u32, reach);
        }
        node
    }

    fn set_box(&mut self, slot: usize, aabb: &Aabb) {
        for axis in 0..3 {
            self.bounds[2 * axis][slot] = aabb.min[axis];
            self.bounds[2 * axis + 1][slot] = aabb.max[axis];
        }
    }

    /// Box of one child.
    pub(crate) fn child_box(&self, slot: usize) -> Aabb {
        let row = |r: usize| self.bounds[r][slot];
        Aabb { min: [row(0), row(2), row(4)].into(), max: [row(1), row(3), row(5)].into() }
    }

    /// Box around all children.
    pub(crate) fn bounds(&self) -> Aabb {
        (0..self.len()).fold(Aabb::EMPTY, |b, slot| b.union(self.child_box(slot)))
    }

    /// Slots in use.
    #[inline]
    pub(crate) fn len(&self) -> usize {
        self.children.iter().position(|&c| c == u32::MAX).unwrap_or(WIDTH)
    }
}

/// Nodes over leaves of up to eight triangles. Node 0 is the root.
#[derive(Clone, Debug)]
pub(crate) struct Wide {
    pub(crate) nodes: Vec<Node>,
    pub(crate) blocks: Vec<TriangleBlock>,
    /// Index of each lane's triangle; unused lanes, which come last, have `u32::MAX`.
    pub(crate) prims: Vec<[u32; LANES]>,
    /// Nodes of each level, the root's first.
    pub(crate) levels: Vec<Range<usize>>,
}

/// Up to eight parts of the subtree at `root`, opening the one of largest area first, largest first in the result.
fn open(tree: &BinaryTree, root: u32) -> Vec<u32> {
    let node = |i: u32| -> &BinaryNode { &tree.nodes[i as usize] };
    let mut parts = vec![root];
    while parts.len() < WIDTH {
        let inner = parts.iter().enumerate().filter(|&(_, &i)| node(i).count as usize > LANES);
        let largest = inner.max_by(|a, b| node(*a.1).aabb.area().total_cmp(&node(*b.1).aabb.area()));
        let Some((at, &largest)) = largest else { break };
        let [a, b] = node(largest).children;
        parts[at] = a;
        parts.push(b);
    }
    parts.sort_by(|&a, &b| node(b).aabb.area().total_cmp(&node(a).aabb.area()));
    parts
}

impl Wide {
    /// Collapses `tree`, which has at least one primitive. Also returns the node of `tree` that each child stands for.
    pub(crate) fn collapse(tree: &BinaryTree) -> (Self, Vec<[u32; WIDTH]>) {
        let mut wide =
            Self { nodes: vec![Node::EMPTY], blocks: Vec::new(), prims: Vec::new(), levels: Vec::new() };
        let mut sources = vec![[u32::MAX; WIDTH]];
        let mut roots = vec![0u32];
        while !roots.is_empty() {
            let first = wide.nodes.len() - roots.len();
            wide.levels.push(first..wide.nodes.len());
            let mut next = Vec::new();
            for (at, &root) in roots.iter().enumerate() {
                for (slot, part) in open(tree, root).into_iter().enumerate() {
                    sources[first + at][slot] = part;
                    let BinaryNode { first: start, count, .. } = tree.nodes[part as usize];
                    wide.nodes[first + at].children[slot] = if count as usize <= LANES {
                        let mut lanes = [u32::MAX; LANES];
                        let run = &tree.order[start as usize..(start + count) as usize];
                        lanes[..run.len()].copy_from_slice(run);
                        wide.prims.push(lanes);
                        LEAF | (wide.prims.len() - 1) as u32
                    } else {
                        next.push(part);
                        wide.nodes.push(Node::EMPTY);
                        sources.push([u32::MAX; WIDTH]);
                        (wide.nodes.len() - 1) as u32
                    };
                }
            }
            roots = next;
        }
        wide.blocks = vec![TriangleBlock::EMPTY; wide.prims.len()];
        (wide, sources)
    }

    /// Triangles of a leaf.
    #[inline]
    pub(crate) fn leaf_prims(&self, leaf: usize) -> impl Iterator<Item = u32> + '_ {
        self.prims[leaf].iter().copied().take_while(|&prim| prim != u32::MAX)
    }

    /// Writes corners into leaves and boxes into nodes.
    pub(crate) fn fill(&mut self, corners: impl Fn(u32) -> [[f32; 3]; 3]) {
        for (block, prims) in self.blocks.iter_mut().zip(&self.prims) {
            for (lane, &prim) in prims.iter().enumerate().take_while(|&(_, &prim)| prim != u32::MAX) {
                block.set(lane, corners(prim));
            }
        }
        for i in (0..self.nodes.len()).rev() {
            let mut node = self.nodes[i];
            for slot in 0..node.len() {
                let child = node.children[slot];
                let aabb = if child & LEAF != 0 {
                    let leaf = (child & !LEAF) as usize;
                    let prims = self.leaf_prims(leaf);
                    prims.flat_map(&corners).fold(Aabb::EMPTY, Aabb::with_point)
                } else {
                    self.nodes[child as usize].bounds()
                };
                node.set_box(slot, &aabb);
            }
            self.nodes[i] = node;
        }
    }

    /// Bytes of nodes and leaves.
    pub(crate) fn bytes(&self) -> usize {
        size_of_val(&self.nodes[..]) + size_of_val(&self.blocks[..]) + size_of_val(&self.prims[..])
    }
}
