//! The 8-wide tree: nodes, and filling in their boxes from the leaves up.
//!
//! Here: layout, refit. Not here: which primitives share a node (`topology.rs`), walking (`traversal.rs`).

use umbrage_geom::Aabb;

/// Children of a node.
pub(crate) const WIDTH: usize = 8;

/// Most levels of nodes; `topology.rs` balances what would get deeper.
pub(crate) const MAX_LEVELS: usize = 40;

/// Marks a child that is a leaf; the other bits are the index of a leaf or node.
pub(crate) const LEAF: u32 = 1 << 31;

/// Boxes and references of eight children: 224 bytes, 256 with padding to whole cache lines.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
pub(crate) struct Node {
    /// Rows: smallest x, largest x, smallest y, ..; one child a lane. Empty slots have the box `[inf, -inf]`, which no
    /// ray enters.
    pub(crate) bounds: [[f32; WIDTH]; 6],
    /// Nodes come after their parents. Slots fill from 0, larger boxes first.
    pub(crate) children: [u32; WIDTH],
}

impl Node {
    pub(crate) const EMPTY: Self = {
        let (inf, neg) = ([f32::INFINITY; WIDTH], [f32::NEG_INFINITY; WIDTH]);
        Self { bounds: [inf, neg, inf, neg, inf, neg], children: [u32::MAX; WIDTH] }
    };

    pub(crate) fn set_box(&mut self, slot: usize, aabb: &Aabb) {
        for axis in 0..3 {
            self.bounds[2 * axis][slot] = aabb.min[axis];
            self.bounds[2 * axis + 1][slot] = aabb.max[axis];
        }
    }

    /// Box around all children.
    pub(crate) fn bounds(&self) -> Aabb {
        let fold = |row: usize, f: fn(f32, f32) -> f32| self.bounds[row].into_iter().reduce(f).unwrap_or(0.0);
        Aabb {
            min: [fold(0, f32::min), fold(2, f32::min), fold(4, f32::min)].into(),
            max: [fold(1, f32::max), fold(3, f32::max), fold(5, f32::max)].into(),
        }
    }

    /// Slots in use.
    #[inline]
    pub(crate) fn len(&self) -> usize {
        self.children.iter().position(|&c| c == u32::MAX).unwrap_or(WIDTH)
    }
}

/// Nodes over leaves that only their owner knows. Node 0 is the root.
#[derive(Clone, Debug)]
pub(crate) struct Tree {
    pub(crate) nodes: Vec<Node>,
}

impl Tree {
    /// Sets every box to the union of what is below it.
    pub(crate) fn refit(&mut self, leaf_box: impl Fn(usize) -> Aabb) {
        for i in (0..self.nodes.len()).rev() {
            let mut node = self.nodes[i];
            for slot in 0..node.len() {
                let child = node.children[slot];
                let index = (child & !LEAF) as usize;
                let aabb = if child & LEAF != 0 { leaf_box(index) } else { self.nodes[index].bounds() };
                node.set_box(slot, &aabb);
            }
            self.nodes[i] = node;
        }
    }

    pub(crate) fn bounds(&self) -> Aabb {
        self.nodes[0].bounds()
    }

    pub(crate) fn bytes(&self) -> usize {
        size_of_val(&self.nodes[..])
    }
}
