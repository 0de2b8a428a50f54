//! The 8-wide tree that rays walk, level by level in memory.
//!
//! Here: layout, collapse of the binary tree, boxes. Not here: which nodes may end rays (`correlation.rs`), their opacities
//! (`opacity.rs`), walking (`walk.rs`).

use std::ops::Range;
use umbrage_accel::{BinaryNode, BinaryTree, LeafVertices};
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
    /// Leaf by leaf; the tag is where the leaf starts in `order`.
    pub(crate) blocks: Vec<TriangleBlock>,
    /// The caller's triangles, leaf by leaf.
    order: Vec<u32>,
    /// The caller's vertices in each leaf, for refits; `u32::MAX` after the last.
    vertices: Vec<[u32; LANES]>,
    /// Nodes of each level, the root's first.
    pub(crate) levels: Vec<Range<usize>>,
}

/// Up to eight parts of the subtree at `root`, opening the one of largest area first, largest first in the result.
fn open(tree: &BinaryTree, root: u32, is_leaf: &impl Fn(u32) -> bool) -> Vec<u32> {
    let node = |i: u32| -> &BinaryNode { &tree.nodes[i as usize] };
    let mut parts = vec![root];
    while parts.len() < WIDTH {
        let inner = parts.iter().enumerate().filter(|&(_, &i)| !is_leaf(i));
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
    /// Collapses `tree`, which has at least one of `triangles`. Also returns the node of `tree` that each child stands for.
    pub(crate) fn collapse(tree: &BinaryTree, triangles: &[[u32; 3]]) -> (Self, Vec<[u32; WIDTH]>) {
        let run = |i: u32| {
            let BinaryNode { first, count, .. } = tree.nodes[i as usize];
            &tree.order[first as usize..(first + count) as usize]
        };
        let is_leaf = |i: u32| run(i).len() <= LANES && LeafVertices::of(triangles, run(i)).is_some();
        let (mut nodes, mut sources) = (vec![Node::EMPTY], vec![[u32::MAX; WIDTH]]);
        let (mut blocks, mut vertices, mut levels) = (Vec::new(), Vec::new(), Vec::new());
        let mut order = Vec::with_capacity(tree.order.len());
        let mut roots = vec![0u32];
        while !roots.is_empty() {
            let first = nodes.len() - roots.len();
            levels.push(first..nodes.len());
            let mut next = Vec::new();
            for (at, &root) in roots.iter().enumerate() {
                for (slot, part) in open(tree, root, &is_leaf).into_iter().enumerate() {
                    sources[first + at][slot] = part;
                    let leaf = if is_leaf(part) { LeafVertices::of(triangles, run(part)) } else { None };
                    nodes[first + at].children[slot] = if let Some(leaf) = leaf {
                        let corners = &leaf.corners[..run(part).len()];
                        let mut block =
                            TriangleBlock::new(&[[0.0; 3]; LANES], corners).expect("at most eight");
                        block.tag = order.len() as u32;
                        order.extend_from_slice(run(part));
                        blocks.push(block);
                        vertices.push(leaf.ids);
                        LEAF | (blocks.len() - 1) as u32
                    } else {
                        next.push(part);
                        nodes.push(Node::EMPTY);
                        sources.push([u32::MAX; WIDTH]);
                        (nodes.len() - 1) as u32
                    };
                }
            }
            roots = next;
        }
        (Self { nodes, blocks, order, vertices, levels }, sources)
    }

    /// Triangles of a leaf.
    #[inline]
    pub(crate) fn leaf_prims(&self, leaf: usize) -> &[u32] {
        let block = &self.blocks[leaf];
        &self.order[block.tag as usize..][..block.len()]
    }

    /// Writes vertices into leaves and boxes into nodes.
    pub(crate) fn fill(&mut self, positions: &[[f32; 3]]) {
        let used = |ids: &[u32; LANES]| ids.iter().position(|&id| id == u32::MAX).unwrap_or(LANES);
        for (block, ids) in self.blocks.iter_mut().zip(&self.vertices) {
            let mut moved = [[0.0; 3]; LANES];
            let ids = &ids[..used(ids)];
            moved.iter_mut().zip(ids).for_each(|(v, &id)| *v = positions[id as usize]);
            block.move_vertices(&moved[..ids.len()]);
        }
        for i in (0..self.nodes.len()).rev() {
            let mut node = self.nodes[i];
            for slot in 0..node.len() {
                let child = node.children[slot];
                let aabb = if child & LEAF != 0 {
                    let ids = &self.vertices[(child & !LEAF) as usize];
                    let corners = ids[..used(ids)].iter().map(|&id| positions[id as usize]);
                    corners.fold(Aabb::EMPTY, Aabb::with_point)
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
        size_of_val(&self.nodes[..])
            + size_of_val(&self.blocks[..])
            + size_of_val(&self.order[..])
            + size_of_val(&self.vertices[..])
    }
}
