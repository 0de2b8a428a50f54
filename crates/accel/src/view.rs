//! A read-only view of a hierarchy, for structures that are built from one.

use crate::{
    Bvh,
    node::{LEAF, Node},
};
use umbrage_geom::{Aabb, kernel::TriangleBlock};

/// What a node refers to.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Child {
    /// A node, by index; 0 is the root.
    Node(u32),
    /// A leaf, by index into [`Bvh::leaf_blocks`].
    Leaf(u32),
}

impl Bvh {
    /// Children of node `node` with their boxes, larger boxes first.
    ///
    /// # Panics
    /// If there is no such node.
    pub fn children(&self, node: u32) -> impl Iterator<Item = (Aabb, Child)> + '_ {
        let node: &Node = &self.tree.nodes[node as usize];
        (0..node.len()).map(|slot| {
            let at = |row: usize| node.bounds[row][slot];
            let aabb = Aabb { min: [at(0), at(2), at(4)].into(), max: [at(1), at(3), at(5)].into() };
            let child = node.children[slot];
            let child = if child & LEAF != 0 { Child::Leaf(child & !LEAF) } else { Child::Node(child) };
            (aabb, child)
        })
    }

    /// The triangles of each leaf; lanes that are not used are NaN.
    pub fn leaf_blocks(&self) -> &[TriangleBlock] {
        &self.blocks
    }
}
