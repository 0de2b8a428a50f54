//! The binary tree below every hierarchy, for structures that keep something of their own in its nodes.

use crate::{BuildError, BuildQuality, bvh::MAX_PRIMS, topology::Binary};
use umbrage_geom::Aabb;

/// Level from which a subtree is cut into equal parts, whatever the build made of it.
const BALANCE_FROM: usize = 56;

/// A node: its box, its run of [`BinaryTree::order`], and its children unless it is a leaf.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BinaryNode {
    /// Union of the boxes below.
    pub aabb: Aabb,
    /// Where its primitives start in the order.
    pub first: u32,
    /// How many there are; 1 in leaves.
    pub count: u32,
    /// First child; the second follows the first one's subtree. 0 in leaves.
    pub children: [u32; 2],
}

impl BinaryNode {
    /// Whether it holds one primitive.
    #[inline]
    pub fn is_leaf(&self) -> bool {
        self.count == 1
    }
}

/// A binary hierarchy with one primitive a leaf, as [`crate::Bvh`] collapses it to eight children.
#[derive(Clone, Debug)]
pub struct BinaryTree {
    /// Depth first: parents come before their children, the root is node 0. Empty without primitives.
    pub nodes: Vec<BinaryNode>,
    /// Primitives, subtree by subtree.
    pub order: Vec<u32>,
}

impl BinaryTree {
    /// Most nodes on a path from the root.
    pub const MAX_DEPTH: usize = BALANCE_FROM + 31;

    /// Builds over the boxes of primitives, none of them empty.
    ///
    /// # Errors
    /// [`BuildError::TooMany`] beyond `2^30` boxes.
    pub fn build(boxes: &[Aabb], quality: BuildQuality) -> Result<Self, BuildError> {
        if boxes.len() > MAX_PRIMS {
            let count = boxes.len();
            return Err(BuildError::TooMany { what: "primitives", count, limit: MAX_PRIMS });
        }
        let mut this = Self { nodes: Vec::new(), order: Vec::new() };
        if boxes.is_empty() {
            return Ok(this);
        }
        let binary = Binary::build(boxes, quality);
        this.nodes.reserve(2 * boxes.len());
        // (run, node of `binary` unless balanced from here on, place in the parent, level)
        let mut stack = vec![((0, boxes.len() as u32), Some(0u32), None, 1usize)];
        while let Some(((first, count), source, parent, level)) = stack.pop() {
            let index = this.nodes.len() as u32;
            if let Some((parent, side)) = parent {
                let parent: &mut BinaryNode = &mut this.nodes[parent as usize];
                parent.children[side as usize] = index;
            }
            this.nodes.push(BinaryNode { aabb: Aabb::EMPTY, first, count, children: [0; 2] });
            if count == 1 {
                continue;
            }
            let node = source.map(|i| &binary.bvh.nodes[i as usize]).filter(|n| !n.is_leaf());
            let children = match node {
                Some(node) if level < BALANCE_FROM => [0, 1].map(|side| {
                    let child = node.first_index + side;
                    ((binary.first[child as usize], binary.count[child as usize]), Some(child))
                }),
                _ => [((first, count / 2), None), ((first + count / 2, count - count / 2), None)],
            };
            for side in [1, 0] {
                let (run, source) = children[side as usize];
                stack.push((run, source, Some((index, side)), level + 1));
            }
        }
        this.order = binary.order;
        this.refit(|prim| boxes[prim as usize]);
        Ok(this)
    }

    /// Sets every box to the union of what is below it; takes linear time.
    pub fn refit(&mut self, box_of: impl Fn(u32) -> Aabb) {
        for i in (0..self.nodes.len()).rev() {
            let node = self.nodes[i];
            self.nodes[i].aabb = if node.is_leaf() {
                box_of(self.order[node.first as usize])
            } else {
                let [a, b] = node.children.map(|child| self.nodes[child as usize].aabb);
                a.union(b)
            };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nodes_cover_their_runs_and_nothing_else() {
        for count in [0usize, 1, 2, 3, 100, 3000] {
            // Copies among them, which get deep chains from some builders.
            let boxes: Vec<Aabb> = (0..count)
                .map(|i| {
                    Aabb::from_points(&[[(i % 97) as f32, (i % 5) as f32, 0.0], [(i % 97) as f32, 9.0, 1.0]])
                })
                .collect();
            let tree = BinaryTree::build(&boxes, BuildQuality::High).expect("few boxes");
            let mut order = tree.order.clone();
            order.sort_unstable();
            assert!(order.iter().copied().eq(0..count as u32));
            assert_eq!(tree.nodes.len(), (2 * count).saturating_sub(1));
            for (i, node) in tree.nodes.iter().enumerate() {
                let run = &tree.order[node.first as usize..(node.first + node.count) as usize];
                let around = run.iter().fold(Aabb::EMPTY, |b, &prim| b.union(boxes[prim as usize]));
                assert_eq!(node.aabb, around);
                if !node.is_leaf() {
                    let [a, b] = node.children.map(|child| &tree.nodes[child as usize]);
                    assert_eq!(node.children[0] as usize, i + 1);
                    assert_eq!(
                        (a.first, a.first + a.count, a.count + b.count),
                        (node.first, b.first, node.count)
                    );
                }
            }
        }
    }
}
