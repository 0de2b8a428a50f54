//! Nodes of a wide hierarchy, some of whose slots are solid boxes.

use umbrage_geom::Aabb;

/// Slots of a node.
pub(super) const WIDTH: usize = 8;

/// Marks a child that is a leaf; the other bits are the index of a leaf or node.
pub(super) const LEAF: u32 = 1 << 31;

/// Most levels of nodes.
pub(super) const MAX_LEVELS: usize = 72;

/// Eight boxes: children first, from the largest, then solid boxes from the end. 232 bytes, 256 with padding to whole cache
/// lines.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
pub(super) struct Node {
    /// Rows: smallest x, largest x, smallest y, ..; one slot a lane. Empty slots have boxes that no ray enters.
    pub(super) bounds: [[f32; WIDTH]; 6],
    /// Of a solid box: its index.
    pub(super) children: [u32; WIDTH],
    /// Slots that are solid boxes.
    pub(super) solid: u32,
    /// Slots in use.
    pub(super) used: u32,
}

impl Node {
    pub(super) const EMPTY: Self = {
        let (inf, neg) = ([f32::INFINITY; WIDTH], [f32::NEG_INFINITY; WIDTH]);
        Self { bounds: [inf, neg, inf, neg, inf, neg], children: [u32::MAX; WIDTH], solid: 0, used: 0 }
    };

    pub(super) fn set(&mut self, slot: usize, aabb: &Aabb, child: u32) {
        for axis in 0..3 {
            self.bounds[2 * axis][slot] = aabb.min[axis];
            self.bounds[2 * axis + 1][slot] = aabb.max[axis];
        }
        self.children[slot] = child;
        self.used |= 1 << slot;
    }

    pub(super) fn set_solid(&mut self, slot: usize, aabb: &Aabb, index: u32) {
        self.set(slot, aabb, index);
        self.solid |= 1 << slot;
    }

    /// The box in `slot`.
    #[inline]
    pub(super) fn aabb(&self, slot: usize) -> Aabb {
        let at = |row: usize| self.bounds[row][slot];
        Aabb { min: [at(0), at(2), at(4)].into(), max: [at(1), at(3), at(5)].into() }
    }
}
