//! The build: surface area heuristic over all candidate planes, in `O(n log n)`.
//!
//! WaldHavran06, section 4.3: the ends of all triangles' boxes are sorted once; every split takes the sorted lists apart,
//! clips the triangles that reach across, sorts only their new ends and merges them in. Costs are those of blocks of eight
//! triangles. A split off of empty space costs [`KdOptions::empty_bonus`] less (Djeu11, section 3.3; the idea of Hurley,
//! Kapustin, Reshetov and Soupikov 2002).
//!
//! Cells are also cut at *guards*: triangles that leaves don't hold. A leaf that only guards reach into has no blocks, but is
//! no empty cell.

use super::{
    KdOptions, clip,
    node::{MAX_LEAF_BLOCKS, MAX_NODES, Node},
};
use crate::BuildError;
use umbrage_geom::{
    Aabb, Progress,
    kernel::{LANES, TriangleBlock},
};

/// Deepest tree.
pub(crate) const MAX_DEPTH: u32 = 60;

/// Units of progress of a build.
pub(crate) const PROGRESS: u64 = 1 << 32;

/// End of a triangle's box on one axis, as a number that sorts: position, kind, triangle.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Event(u64);

/// Kinds, in the order in which a sweep must see them.
const END: u64 = 0;
const PLANAR: u64 = 1;
const START: u64 = 2;

impl Event {
    fn new(position: f32, kind: u64, prim: u32) -> Self {
        // Adding 0 makes -0 equal to 0.
        let bits = (position + 0.0).to_bits();
        let ordered = if bits >> 31 == 0 { bits | 1 << 31 } else { !bits };
        Self(u64::from(ordered) << 32 | kind << 30 | u64::from(prim))
    }

    fn place(self) -> u32 {
        (self.0 >> 32) as u32
    }

    fn position(self) -> f32 {
        let ordered = self.place();
        f32::from_bits(if ordered >> 31 == 1 { ordered & !(1 << 31) } else { !ordered })
    }

    fn kind(self) -> u64 {
        self.0 >> 30 & 3
    }

    fn prim(self) -> usize {
        (self.0 & ((1 << 30) - 1)) as usize
    }
}

/// Sorted ends on each axis.
type Events = [Vec<Event>; 3];

fn push_events(events: &mut Events, prim: u32, aabb: &Aabb) {
    for (axis, list) in events.iter_mut().enumerate() {
        let (low, high) = (aabb.min[axis], aabb.max[axis]);
        if low == high {
            list.push(Event::new(low, PLANAR, prim));
        } else {
            list.extend([Event::new(low, START, prim), Event::new(high, END, prim)]);
        }
    }
}

/// Where a triangle of a node goes.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Side {
    Both,
    Left,
    Right,
}

/// A candidate plane.
#[derive(Clone, Copy)]
struct Split {
    cost: f64,
    axis: usize,
    place: Event,
    /// Whether triangles in the plane go left.
    planar_left: bool,
}

/// What a build makes.
#[derive(Default)]
pub(crate) struct Built {
    pub(crate) nodes: Vec<Node>,
    pub(crate) blocks: Vec<TriangleBlock>,
    pub(crate) prims: Vec<[u32; LANES]>,
}

struct Builder<'a, 'p> {
    corners: &'a dyn Fn(u32) -> [[f32; 3]; 3],
    /// Triangles from here on are no occluders: cells are cut at them, and those that they touch are no empty cells, but
    /// leaves don't hold them.
    real: u32,
    options: &'a KdOptions,
    max_depth: u32,
    progress: &'a Progress<'p>,
    sides: Vec<Side>,
    built: Built,
}

/// Builds over triangles `0..count`, those from `real` on being [guards](super::KdTree::build_with_guards).
pub(crate) fn build(
    count: usize,
    real: usize,
    corners: &dyn Fn(u32) -> [[f32; 3]; 3],
    bounds: &Aabb,
    options: &KdOptions,
    progress: &Progress,
) -> Result<Built, BuildError> {
    let mut events = Events::default();
    for (axis, list) in events.iter_mut().enumerate() {
        list.reserve_exact(2 * count);
        for prim in 0..count as u32 {
            let c = corners(prim);
            let (a, b, c) = (c[0][axis], c[1][axis], c[2][axis]);
            let (low, high) = (a.min(b).min(c), a.max(b).max(c));
            if low == high {
                list.push(Event::new(low, PLANAR, prim));
            } else {
                list.extend([Event::new(low, START, prim), Event::new(high, END, prim)]);
            }
        }
        list.sort_unstable();
    }
    let max_depth = (8.0 + 1.3 * (count as f64).log2()) as u32;
    let mut builder = Builder {
        corners,
        real: real as u32,
        options,
        max_depth: max_depth.min(MAX_DEPTH),
        progress,
        sides: vec![Side::Both; count],
        built: Built::default(),
    };
    builder.subdivide(bounds, events, count, 0, PROGRESS)?;
    Ok(builder.built)
}

fn area(b: &Aabb) -> f64 {
    let s = b.max.as_dvec3() - b.min.as_dvec3();
    s.x * s.y + s.y * s.z + s.z * s.x
}

/// Both parts of `cell`.
fn halves(cell: &Aabb, axis: usize, position: f32) -> [Aabb; 2] {
    let (mut left, mut right) = (*cell, *cell);
    left.max[axis] = position;
    right.min[axis] = position;
    [left, right]
}

impl Builder<'_, '_> {
    /// Cost of testing `count` triangles, a block at a time.
    fn leaf_cost(&self, count: usize) -> f64 {
        f64::from(self.options.cost_intersect) * count.div_ceil(LANES) as f64
    }

    /// `budget` is this node's share of [`PROGRESS`].
    fn subdivide(
        &mut self,
        cell: &Aabb,
        events: Events,
        count: usize,
        depth: u32,
        budget: u64,
    ) -> Result<(), BuildError> {
        let split =
            if count == 0 || depth >= self.max_depth { None } else { self.best_split(cell, &events, count) };
        let Some(split) = split.filter(|split| split.cost < self.leaf_cost(count)) else {
            self.leaf(&events[0], count)?;
            return Ok(self.progress.advance(budget)?);
        };
        if self.built.nodes.len() + 2 >= MAX_NODES {
            return Err(BuildError::TooMany { what: "kd-tree nodes", count: MAX_NODES, limit: MAX_NODES });
        }
        let index = self.built.nodes.len();
        let cells = halves(cell, split.axis, split.place.position());
        self.built.nodes.push(Node::split(split.axis, split.place.position()));
        let [left, right] = self.take_apart(events, &split, &cells);
        let share = budget * left.1 as u64 / (left.1 + right.1).max(1) as u64;
        self.subdivide(&cells[0], left.0, left.1, depth + 1, share)?;
        let place = self.built.nodes.len();
        self.built.nodes[index].set_right(place);
        self.subdivide(&cells[1], right.0, right.1, depth + 1, budget - share)
    }

    fn leaf(&mut self, events: &[Event], count: usize) -> Result<(), BuildError> {
        let first = self.built.blocks.len();
        let starts = events.iter().filter(|event| event.kind() != END);
        let mut prims: Vec<u32> =
            starts.map(|event| event.prim() as u32).filter(|&prim| prim < self.real).collect();
        prims.sort_unstable();
        let mut rest = &prims[..];
        while !rest.is_empty() {
            let (mut block, mut vertices) = (TriangleBlock::EMPTY, 0);
            let mut lanes = [u32::MAX; LANES];
            let fit =
                rest.iter().take_while(|&&prim| block.push((self.corners)(prim), &mut vertices)).count();
            lanes[..fit].copy_from_slice(&rest[..fit]);
            self.built.blocks.push(block);
            self.built.prims.push(lanes);
            rest = &rest[fit..];
        }
        let blocks = self.built.blocks.len() - first;
        if self.built.blocks.len() > u32::MAX as usize || blocks >= MAX_LEAF_BLOCKS {
            let limit = MAX_LEAF_BLOCKS;
            return Err(BuildError::TooMany {
                what: "kd-tree references",
                count: self.built.blocks.len(),
                limit,
            });
        }
        let mut node = Node::leaf(first, blocks);
        if blocks == 0 && count > 0 {
            node.set_state(super::LeafState::Boundary, 0);
        }
        self.built.nodes.push(node);
        Ok(())
    }

    /// WaldHavran06, algorithm 5, one axis after the other.
    fn best_split(&self, cell: &Aabb, events: &Events, count: usize) -> Option<Split> {
        let whole = area(cell);
        if whole <= 0.0 {
            return None;
        }
        let KdOptions { cost_traverse, empty_bonus, .. } = *self.options;
        let mut best: Option<Split> = None;
        for (axis, list) in events.iter().enumerate() {
            // The area of a half is linear in the plane's position.
            let size = cell.max.as_dvec3() - cell.min.as_dvec3();
            let (across, around) =
                (size[(axis + 1) % 3] * size[(axis + 2) % 3], size[(axis + 1) % 3] + size[(axis + 2) % 3]);
            let (min, max) = (cell.min[axis], cell.max[axis]);
            let (mut left, mut right) = (0, count);
            let mut i = 0;
            while i < list.len() {
                let place = list[i].place();
                let mut counts = [0usize; 3];
                let first = list[i];
                while i < list.len() && list[i].place() == place {
                    counts[list[i].kind() as usize] += 1;
                    i += 1;
                }
                let [ends, planar, starts] = counts;
                right -= planar + ends;
                let position = first.position();
                if position > min && position < max {
                    let part =
                        |from: f32, to: f32| (across + (f64::from(to) - f64::from(from)) * around) / whole;
                    let (pl, pr) = (part(min, position), part(position, max));
                    let mut consider = |nl: usize, nr: usize, planar_left| {
                        let mut cost =
                            f64::from(cost_traverse) + pl * self.leaf_cost(nl) + pr * self.leaf_cost(nr);
                        if nl == 0 || nr == 0 {
                            cost *= 1.0 - f64::from(empty_bonus);
                        }
                        if best.is_none_or(|best| cost < best.cost) {
                            best = Some(Split { cost, axis, place: first, planar_left });
                        }
                    };
                    consider(left + planar, right, true);
                    if planar > 0 {
                        consider(left, right + planar, false);
                    }
                }
                left += starts + planar;
            }
        }
        best
    }

    /// WaldHavran06, section 4.3: sorted lists and counts of both children.
    fn take_apart(&mut self, events: Events, split: &Split, cells: &[Aabb; 2]) -> [(Events, usize); 2] {
        for event in &events[0] {
            self.sides[event.prim()] = Side::Both;
        }
        let place = split.place.place();
        for event in &events[split.axis] {
            let side = match event.kind() {
                END if event.place() <= place => Side::Left,
                START if event.place() >= place => Side::Right,
                PLANAR if event.place() < place || (event.place() == place && split.planar_left) => {
                    Side::Left
                }
                PLANAR => Side::Right,
                _ => continue,
            };
            self.sides[event.prim()] = side;
        }
        let mut counts = [0; 2];
        let mut new = [Events::default(), Events::default()];
        for event in events[0].iter().filter(|event| event.kind() != END) {
            match self.sides[event.prim()] {
                Side::Left => counts[0] += 1,
                Side::Right => counts[1] += 1,
                Side::Both => {
                    let prim = event.prim() as u32;
                    let corners = (self.corners)(prim);
                    for half in 0..2 {
                        if let Some(aabb) = clip::clip(corners, &cells[half]) {
                            push_events(&mut new[half], prim, &aabb);
                            counts[half] += 1;
                        }
                    }
                }
            }
        }
        let [mut left, mut right] = [Events::default(), Events::default()];
        for (axis, list) in events.into_iter().enumerate() {
            for (half, side, to) in [(0, Side::Left, &mut left), (1, Side::Right, &mut right)] {
                new[half][axis].sort_unstable();
                let old = list.iter().copied().filter(|event| self.sides[event.prim()] == side);
                to[axis] = merge(old, &new[half][axis], list.len());
            }
        }
        [(left, counts[0]), (right, counts[1])]
    }
}

/// One sorted list of two.
fn merge(old: impl Iterator<Item = Event>, new: &[Event], at_most: usize) -> Vec<Event> {
    let mut merged = Vec::with_capacity((at_most + new.len()) / 2);
    let mut new = new.iter().copied().peekable();
    for event in old {
        while let Some(next) = new.next_if(|next| *next < event) {
            merged.push(next);
        }
        merged.push(event);
    }
    merged.extend(new);
    merged
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn events_sort_by_position_then_kind() {
        let positions = [-3e20f32, -1.0, -1e-40, 0.0, 1e-45, 0.5, 2.0, 1e24];
        let events: Vec<Event> = positions.iter().map(|&p| Event::new(p, START, 7)).collect();
        assert!(events.is_sorted());
        assert!(events.iter().zip(positions).all(|(event, p)| event.position() == p && event.prim() == 7));
        assert_eq!(Event::new(-0.0, END, 1), Event::new(0.0, END, 1));
        assert!(Event::new(1.0, END, 9) < Event::new(1.0, PLANAR, 8));
        assert!(Event::new(1.0, PLANAR, 8) < Event::new(1.0, START, 0));
    }
}
