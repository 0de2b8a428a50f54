//! Nodes of eight bytes.
//!
//! An inner node keeps its split plane, the place of its right child, and which child [`super::Search::Solid`] visits
//! first; the left child follows the node. A leaf keeps its volumetric state (Djeu11, section 3.3) in two bits beside the
//! number of its blocks, and where these start; an opaque leaf, which has no blocks, keeps a slot instead.

/// What a leaf's cell is to a solid, Djeu11, section 3.3.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[repr(u8)]
pub enum LeafState {
    /// Triangles or guards may reach into the cell, or it is neither inside nor outside of solids for another reason.
    Boundary = 0,
    /// No triangle, outside of every solid.
    Clear = 1,
    /// No triangle, inside of a solid.
    Opaque = 2,
}

/// Low bits of a leaf's word; lower values are the axis of a split.
const LEAF: u32 = 3;

/// Most nodes: places have 29 bits.
pub(crate) const MAX_NODES: usize = 1 << 29;

/// Most blocks of a leaf.
pub(crate) const MAX_LEAF_BLOCKS: usize = 1 << 28;

/// A split or a leaf.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Node {
    /// Bits of the split position; of a boundary leaf its first block, of an opaque leaf its slot.
    value: u32,
    /// Inner: right child, "right first" bit, axis. Leaf: number of blocks, state, [`LEAF`].
    word: u32,
}

impl Node {
    pub(crate) fn split(axis: usize, position: f32) -> Self {
        Self { value: position.to_bits(), word: axis as u32 }
    }

    pub(crate) fn leaf(first_block: usize, blocks: usize) -> Self {
        let state = if blocks == 0 { LeafState::Clear } else { LeafState::Boundary };
        Self { value: first_block as u32, word: (blocks as u32) << 4 | (state as u32) << 2 | LEAF }
    }

    #[inline(always)]
    pub(crate) fn is_leaf(self) -> bool {
        self.word & 3 == LEAF
    }

    /// Axis of a split.
    #[inline(always)]
    pub(crate) fn axis(self) -> usize {
        // Written so that arrays of three need no check.
        (self.word & 3).min(2) as usize
    }

    #[inline(always)]
    pub(crate) fn position(self) -> f32 {
        f32::from_bits(self.value)
    }

    #[inline(always)]
    pub(crate) fn right(self) -> usize {
        (self.word >> 3) as usize
    }

    pub(crate) fn set_right(&mut self, right: usize) {
        self.word = self.word & 7 | (right as u32) << 3;
    }

    /// Whether [`super::Search::Solid`] visits the right child first.
    #[inline(always)]
    pub(crate) fn right_first(self) -> bool {
        self.word & 4 != 0
    }

    pub(crate) fn set_right_first(&mut self, right_first: bool) {
        self.word = self.word & !4 | u32::from(right_first) << 2;
    }

    /// State of a leaf.
    #[inline(always)]
    pub(crate) fn state(self) -> LeafState {
        match self.word >> 2 & 3 {
            0 => LeafState::Boundary,
            1 => LeafState::Clear,
            _ => LeafState::Opaque,
        }
    }

    /// Makes an empty leaf something else; `slot` is kept for opaque ones.
    pub(crate) fn set_state(&mut self, state: LeafState, slot: u32) {
        self.value = slot;
        self.word = (state as u32) << 2 | LEAF;
    }

    /// Blocks of a leaf; none of an opaque or clear one.
    #[inline(always)]
    pub(crate) fn blocks(self) -> std::ops::Range<usize> {
        let (first, count) = (self.value as usize, (self.word >> 4) as usize);
        first..first + count
    }

    /// Slot of an opaque leaf.
    #[inline(always)]
    pub(crate) fn slot(self) -> u32 {
        self.value
    }
}

const _: () = assert!(size_of::<Node>() == 8);
