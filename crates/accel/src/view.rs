//! A read-only view of the hierarchy, for engines that walk it their own way.

use crate::{
    Bvh,
    node::{LEAF, Node, NodeNote, WIDTH},
};
use umbrage_geom::{Aabb, kernel::TriangleBlock};

/// Nodes and leaves of a [`Bvh`]. Node 0 is the root; children come after their parents.
#[derive(Clone, Copy, Debug)]
pub struct View<'a> {
    nodes: &'a [Node],
    blocks: &'a [TriangleBlock],
    prims: &'a [u32],
}

/// One node of eight slots.
#[derive(Clone, Copy, Debug)]
pub struct NodeView<'a>(&'a Node);

/// What a slot of a node holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Child {
    /// The index of a node.
    Node(u32),
    /// The index of a leaf.
    Leaf(u32),
}

impl Bvh {
    /// The hierarchy's nodes and leaves.
    pub fn view(&self) -> View<'_> {
        View { nodes: &self.tree.nodes, blocks: &self.blocks, prims: &self.prims }
    }
}

impl Bvh {
    /// Children of node `node` with their boxes: first those that are likely to stop a ray for what they cost.
    ///
    /// # Panics
    /// If there is no such node.
    pub fn children(&self, node: u32) -> impl Iterator<Item = (Aabb, Child)> + '_ {
        let node = self.view().node(node);
        let rows = node.bounds();
        (0..node.len()).map(move |slot| {
            let at = |row: usize| rows[row][slot];
            let aabb = Aabb { min: [at(0), at(2), at(4)].into(), max: [at(1), at(3), at(5)].into() };
            (aabb, node.child(slot))
        })
    }

    /// Keeps `note` in node `node`, through refits too. Only queries that are given boxes or goals look at it.
    ///
    /// # Panics
    /// If there is no such node.
    pub fn set_note(&mut self, node: u32, note: NodeNote) {
        self.tree.nodes[node as usize].note = note;
    }
}

impl<'a> View<'a> {
    /// Most nodes on a way from the root to a leaf.
    pub const MAX_LEVELS: usize = crate::node::MAX_LEVELS;

    /// Marks references to leaves in [`NodeView::children`]; the other bits are the index of a leaf or node.
    pub const LEAF: u32 = LEAF;

    /// Size of a node and of a leaf.
    pub const CHILD_BYTES: usize = size_of::<Node>();

    /// Number of nodes, at least 1.
    #[inline]
    pub fn node_count(self) -> usize {
        self.nodes.len()
    }

    /// Number of leaves.
    #[inline]
    pub fn leaf_count(self) -> usize {
        self.blocks.len()
    }

    /// Node `index`.
    ///
    /// # Panics
    /// If there is no such node.
    #[inline(always)]
    pub fn node(self, index: u32) -> NodeView<'a> {
        NodeView(&self.nodes[index as usize])
    }

    /// Triangles of leaf `index`.
    ///
    /// # Panics
    /// If there is no such leaf.
    #[inline(always)]
    pub fn leaf(self, index: u32) -> &'a TriangleBlock {
        &self.blocks[index as usize]
    }

    /// Where `child`, as in [`NodeView::children`], lies, for prefetching [`Self::CHILD_BYTES`]; not to be read through, and
    /// not in memory at all for what is no child.
    #[inline(always)]
    pub fn address(self, child: u32) -> *const u8 {
        let index = (child & !LEAF) as usize;
        let node = self.nodes.as_ptr().wrapping_add(index).cast::<u8>();
        let block = self.blocks.as_ptr().wrapping_add(index).cast::<u8>();
        if child & LEAF != 0 { block } else { node }
    }

    /// Index of each lane's triangle in the caller's array.
    ///
    /// # Panics
    /// If there is no such leaf.
    #[inline(always)]
    pub fn prims(self, leaf: u32) -> &'a [u32] {
        let block = &self.blocks[leaf as usize];
        let first = block.tag as usize;
        &self.prims[first..first + block.len()]
    }
}

impl<'a> NodeView<'a> {
    /// Boxes of the children, one a lane, in rows: smallest x, largest x, smallest y, ..; of no meaning in empty slots.
    #[inline(always)]
    pub fn bounds(self) -> [[f32; WIDTH]; 6] {
        [0, 1, 2, 3, 4, 5].map(|row| self.0.row(row))
    }

    /// [`Self::bounds`] as numbers of planes: plane `n` of an axis is at `base + n * step`, the product being exact.
    #[inline(always)]
    pub fn grid(self) -> &'a [[u8; WIDTH]; 6] {
        &self.0.grid
    }

    /// Plane 0 of each axis.
    #[inline(always)]
    pub fn base(self) -> [f32; 3] {
        self.0.base
    }

    /// Way from plane to plane on each axis.
    #[inline(always)]
    pub fn step(self) -> [f32; 3] {
        self.0.step
    }

    /// References to what the slots hold, marked by [`View::LEAF`]; of no meaning in empty slots.
    #[inline(always)]
    pub fn children(self) -> &'a [u32; WIDTH] {
        &self.0.children
    }

    /// One bit for each slot in use.
    #[inline(always)]
    pub fn used(self) -> u32 {
        self.0.used
    }

    /// What the hierarchy's owner keeps in the node.
    #[inline(always)]
    pub fn note(self) -> &'a NodeNote {
        &self.0.note
    }

    /// What `slot` (below 8) holds; must not be asked of empty slots, which come last.
    #[inline(always)]
    pub fn child(self, slot: usize) -> Child {
        let child = self.0.children[slot % WIDTH];
        if child & LEAF != 0 { Child::Leaf(child & !LEAF) } else { Child::Node(child) }
    }

    /// Slots in use.
    #[allow(clippy::len_without_is_empty)] // only the root over no triangle would be empty, and there is none
    #[inline]
    pub fn len(self) -> usize {
        self.0.len()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::BuildOptions;

    #[test]
    fn a_walk_finds_every_triangle_once_inside_its_boxes() {
        let positions: Vec<[f32; 3]> =
            (0..300).map(|i| [(i * 7 % 31) as f32, (i % 17) as f32, i as f32]).collect();
        let triangles: Vec<[u32; 3]> = (0..100).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
        let bvh = Bvh::build(&positions, &triangles, &BuildOptions::default()).unwrap();
        let view = bvh.view();
        let mut found = vec![0; triangles.len()];
        let mut stack = vec![0];
        let mut visited = [0, 0];
        while let Some(index) = stack.pop() {
            visited[0] += 1;
            let node = view.node(index);
            for slot in 0..node.len() {
                match node.child(slot) {
                    Child::Node(child) => stack.push(child),
                    Child::Leaf(leaf) => {
                        visited[1] += 1;
                        for (lane, &prim) in view.prims(leaf).iter().enumerate() {
                            found[prim as usize] += 1;
                            let corners = view.leaf(leaf).get(lane);
                            assert_eq!(corners, triangles[prim as usize].map(|v| positions[v as usize]));
                            for (axis, x) in corners.iter().flat_map(|c| c.iter().enumerate()) {
                                let rows = node.bounds();
                                assert!(rows[2 * axis][slot] <= *x && *x <= rows[2 * axis + 1][slot]);
                            }
                        }
                    }
                }
            }
        }
        assert_eq!(visited, [view.node_count(), view.leaf_count()]);
        assert!(found.iter().all(|&n| n == 1));
    }
}
