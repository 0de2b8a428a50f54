//! The 8-wide tree: nodes, and filling in their boxes from the leaves up.
//!
//! Here: layout, refit. Not here: which primitives share a node (`topology.rs`), walking (`traversal.rs`, `fan.rs`).

use crate::memory;
use umbrage_geom::Aabb;

/// Children of a node.
pub(crate) const WIDTH: usize = 8;

/// Most levels of nodes; `topology.rs` balances what would get deeper.
pub(crate) const MAX_LEVELS: usize = 40;

/// Marks a child that is a leaf; the other bits are the index of a leaf or node.
pub(crate) const LEAF: u32 = 1 << 31;

/// What a node keeps for the owner of the hierarchy: it lies in the node's cache lines. All 0 after a build.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct NodeNote {
    /// For the whole node.
    pub index: u32,
    /// For each slot.
    pub marks: [u8; WIDTH],
}

/// Boxes and references of eight children, in two cache lines.
///
/// Boxes are rounded outwards to a grid of 256 planes an axis over all of them. They only have to hold what is inside, and
/// half the memory is worth more than what they grow by: large scenes wait for memory, not for arithmetic.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(128))]
pub(crate) struct Node {
    /// Nodes come after their parents. Slots fill from 0, in the order of [`Self::merit`]; `u32::MAX` in empty ones.
    pub(crate) children: [u32; WIDTH],
    /// Rows: smallest x, largest x, smallest y, ..; one child a lane.
    pub(crate) grid: [[u8; WIDTH]; 6],
    /// Plane 0 of each axis.
    pub(crate) base: [f32; 3],
    /// Way from plane to plane, of 16 significant bits: its product with the number of a plane is exact.
    pub(crate) step: [f32; 3],
    /// One bit for each slot in use.
    pub(crate) used: u32,
    /// Probability that a child stops a ray that enters it, over the expected cost: see [`Self::merit`].
    pub(crate) merits: [u8; WIDTH],
    pub(crate) note: NodeNote,
}

/// `x >= 0` with its significand rounded up to 16 bits; at least the smallest normal number, unless 0.
fn coarsen(x: f64) -> f32 {
    if x == 0.0 {
        return 0.0;
    }
    let bits = (x as f32).next_up().max(f32::MIN_POSITIVE).to_bits();
    f32::from_bits(bits.div_ceil(1 << 8) << 8)
}

impl Node {
    pub(crate) const EMPTY: Self = Self {
        children: [u32::MAX; WIDTH],
        grid: [[0; WIDTH]; 6],
        base: [0.0; 3],
        step: [0.0; 3],
        used: 0,
        merits: [0; WIDTH],
        note: NodeNote { index: 0, marks: [0; WIDTH] },
    };

    /// What [`Self::set_merit`] was given, from `2^-31` to almost 2, with three bits after the first; their bits are those of
    /// a float.
    #[inline]
    pub(crate) fn merit(&self, slot: usize) -> f32 {
        f32::from_bits((u32::from(self.merits[slot]) + Self::LEAST_MERIT) << 20)
    }

    /// [`Self::merit`] of a slot.
    pub(crate) fn set_merit(&mut self, slot: usize, merit: f32) {
        let bits = (merit.max(0.0).to_bits() >> 20).saturating_sub(Self::LEAST_MERIT);
        self.merits[slot] = bits.min(u32::from(u8::MAX)) as u8;
    }

    /// `2^-31` in the upper twelve bits of a float.
    pub(crate) const LEAST_MERIT: u32 = 96 << 3;

    /// Plane `number` of an axis, rounded once.
    #[inline]
    fn plane(&self, axis: usize, number: u8) -> f32 {
        self.base[axis] + f32::from(number) * self.step[axis]
    }

    /// Sets the boxes of the first slots.
    pub(crate) fn set_boxes(&mut self, boxes: &[Aabb]) {
        let all = boxes.iter().fold(Aabb::EMPTY, |all, b| all.union(*b));
        for axis in 0..3 {
            let (least, greatest) = (all.min[axis], all.max[axis]);
            self.base[axis] = least;
            let mut share = (f64::from(greatest) - f64::from(least)) / 255.0;
            loop {
                self.step[axis] = coarsen(share);
                if self.plane(axis, u8::MAX) >= greatest {
                    break;
                }
                share = f64::from(self.step[axis].next_up());
            }
            let inverse = if self.step[axis] > 0.0 { 1.0 / f64::from(self.step[axis]) } else { 0.0 };
            for (slot, aabb) in boxes.iter().enumerate() {
                let (low, high) = (aabb.min[axis], aabb.max[axis]);
                let number = |x: f32| (f64::from(x) - f64::from(least)) * inverse;
                let mut below = number(low).floor().clamp(0.0, 255.0) as u8;
                while self.plane(axis, below) > low {
                    below -= 1;
                }
                let mut above = number(high).ceil().clamp(0.0, 255.0) as u8;
                while self.plane(axis, above) < high {
                    above += 1;
                }
                self.grid[2 * axis][slot] = below;
                self.grid[2 * axis + 1][slot] = above;
            }
        }
        self.used = (1 << boxes.len()) - 1;
    }

    /// The planes of row `row`, one child a lane; of no meaning in empty slots.
    #[inline(always)]
    pub(crate) fn row(&self, row: usize) -> [f32; WIDTH] {
        self.grid[row].map(|number| self.plane(row / 2, number))
    }

    /// Slots in use.
    #[inline]
    pub(crate) fn len(&self) -> usize {
        self.used.count_ones() as usize
    }
}

/// Nodes over leaves that only their owner knows. Node 0 is the root.
#[derive(Clone, Debug)]
pub(crate) struct Tree {
    pub(crate) nodes: Vec<Node>,
    /// Smallest box around all leaves.
    pub(crate) bounds: Aabb,
}

impl Tree {
    /// A tree whose boxes are not set yet.
    pub(crate) fn new(nodes: Vec<Node>) -> Self {
        Self { nodes: memory::settle(nodes), bounds: Aabb::EMPTY }
    }

    /// Sets every box to the union of what is below it.
    pub(crate) fn refit(&mut self, leaf_box: impl Fn(usize) -> Aabb) {
        let mut unions = vec![Aabb::EMPTY; self.nodes.len()];
        for (i, node) in self.nodes.iter_mut().enumerate().rev() {
            let mut boxes = [Aabb::EMPTY; WIDTH];
            let mut len = 0;
            for (aabb, &child) in boxes.iter_mut().zip(&node.children).take_while(|&(_, &c)| c != u32::MAX) {
                let index = (child & !LEAF) as usize;
                *aabb = if child & LEAF != 0 { leaf_box(index) } else { unions[index] };
                len += 1;
            }
            node.set_boxes(&boxes[..len]);
            unions[i] = boxes[..len].iter().fold(Aabb::EMPTY, |all, b| all.union(*b));
        }
        self.bounds = unions[0];
    }

    pub(crate) fn bytes(&self) -> usize {
        size_of_val(&self.nodes[..])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn coordinate() -> impl Strategy<Value = f32> {
        prop_oneof![
            4 => -1f32..1.0,
            1 => (-4i8..5).prop_map(f32::from),
            1 => prop::sample::select(vec![0.0, -0.0, 1e-45, -1e-40, 1e24, -1e24, 1e6, 16_777_216.0]),
        ]
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(4000))]
        #[test]
        fn boxes_hold_what_is_inside_and_grow_little(
            corners in prop::collection::vec(([coordinate(), coordinate(), coordinate()],
                [coordinate(), coordinate(), coordinate()]), 1..=8),
            scale in prop::sample::select(vec![1f32, 1e-38, 1e-30, 1e-4]),
            shift in prop::sample::select(vec![0f32, 1.0, 1e6]),
        ) {
            let place = |p: [f32; 3]| p.map(|x| x * scale + shift);
            let boxes: Vec<Aabb> =
                corners.iter().map(|&(a, b)| Aabb::EMPTY.with_point(place(a)).with_point(place(b))).collect();
            let mut node = Node::EMPTY;
            node.set_boxes(&boxes);
            let all = boxes.iter().fold(Aabb::EMPTY, |all, b| all.union(*b));
            for axis in 0..3 {
                let (low, high) = (node.row(2 * axis), node.row(2 * axis + 1));
                let extent = f64::from(all.max[axis]) - f64::from(all.min[axis]);
                // A plane more, 2^-15 of them wider, a unit in the last place, and the smallest step.
                let slack = extent / 254.0 + f64::from(all.max.abs().max(all.min.abs())[axis]) * 3e-7 + 1e-37;
                for (i, b) in boxes.iter().enumerate() {
                    prop_assert!(low[i] <= b.min[axis] && high[i] >= b.max[axis]);
                    prop_assert!(f64::from(b.min[axis]) - f64::from(low[i]) <= slack);
                    prop_assert!(f64::from(high[i]) - f64::from(b.max[axis]) <= slack);
                }
            }
        }
    }
}
