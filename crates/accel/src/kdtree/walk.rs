//! Traversal orders (Djeu11, section 3.4), for single rays and packets.
//!
//! Here: which nodes a ray visits and when its triangles are tested. Not here: what makes a cell opaque, and which rays may
//! end there: that is for the caller ([`Cells`]) to say.
//!
//! Intervals of `t` are rounded outwards ([`SlabRay`]), so a ray visits every cell that its exact segment touches. Each lane
//! clips its interval to both halves of a node on its own, so packets need no common direction.

use super::{KdTree, LeafState, node::Node};
use crate::{Statistics, kernel::Kernel};
use umbrage_geom::{
    Ray, SlabRay,
    kernel::{BlockRay, LANES},
    segment_hits_triangle,
};

/// How nodes are searched.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum Search {
    /// Depth first, near before far: ray order, Djeu11, section 3.4.1.
    Near,
    /// Depth first, the child with more opaque area first ([`KdTree::prefer_opaque`]). Not from the dissertation: finds large
    /// occluders nearly as early as a breadth-first search does, with the cheaper bookkeeping of a stack.
    Solid,
    /// Breadth first, Djeu11, section 3.4.3.
    Breadth,
    /// Breadth first, but a single child is entered at once, Djeu11, section 3.4.4.
    Quick,
}

/// The order in which a ray visits cells and tests triangles. Answers don't depend on it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub struct Order {
    /// How nodes are searched.
    pub search: Search,
    /// Length of the deferment list (Djeu11, section 3.4.2): so many boundary leaves wait until opaque ones have been
    /// looked for. 0 tests them at once.
    pub deferred: u32,
    /// Whether the list is emptied whenever a clear cell is entered: aggressive flush, Djeu11, section 4.4.
    pub flush_at_clear: bool,
}

impl Order {
    /// Standard ray order.
    pub const RAY: Self = Self::new(Search::Near, 0);
    /// Extended ray order with a list of 512, for single objects (Djeu11, section 3.4.2).
    pub const EXTENDED: Self = Self::new(Search::Near, 512);
    /// Extended ray order as for large scenes: a list of 8, flushed aggressively (Djeu11, section 4.7.1).
    pub const EXTENDED_SPARSE: Self = Self { flush_at_clear: true, ..Self::new(Search::Near, 8) };
    /// Breadth-first order.
    pub const BREADTH: Self = Self::new(Search::Breadth, 0);
    /// Quick-descent breadth-first order.
    pub const QUICK: Self = Self::new(Search::Quick, 0);
    /// Most opaque area first, triangles last.
    pub const SOLID: Self = Self::new(Search::Solid, 512);

    /// A search with a deferment list.
    pub const fn new(search: Search, deferred: u32) -> Self {
        Self { search, deferred, flush_at_clear: false }
    }

    /// With or without aggressive flush.
    #[must_use]
    pub const fn with_flush(self, flush_at_clear: bool) -> Self {
        Self { flush_at_clear, ..self }
    }
}

/// What ended a ray.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Blocker {
    /// Nothing is in the way.
    Nothing,
    /// A triangle.
    Triangle,
    /// An opaque cell, by its slot.
    Cell(u32),
}

impl Blocker {
    /// Whether there is one.
    #[inline]
    pub fn any(self) -> bool {
        self != Self::Nothing
    }
}

/// What is known about a ray before it walks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Start {
    /// Opaque cells may end it.
    Cells,
    /// Opaque cells mean nothing to it: it walks in ray order if all rays of its packet do.
    Plain,
    /// The cell in this slot blocks it.
    Blocked(u32),
}

/// Decides whether opaque cells end rays. `()` never does.
pub trait Cells {
    /// Called for each valid ray that may touch the tree's bounds, before it walks.
    fn start(&mut self, lane: usize, ray: &Ray, slab: &SlabRay) -> Start;

    /// Whether the cell in `slot`, which the ray in `lane` may touch, surely blocks it. Not asked for rays that started
    /// [`Start::Plain`].
    fn blocks(&mut self, slot: u32, lane: usize, slab: &SlabRay) -> bool;
}

impl Cells for () {
    #[inline(always)]
    fn start(&mut self, _: usize, _: &Ray, _: &SlabRay) -> Start {
        Start::Plain
    }

    #[inline(always)]
    fn blocks(&mut self, _: u32, _: usize, _: &SlabRay) -> bool {
        false
    }
}

/// A node to visit with the interval of each lane.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Entry<const N: usize> {
    node: u32,
    near: [f32; N],
    far: [f32; N],
}

impl<const N: usize> Entry<N> {
    const EMPTY: Self = Self { node: 0, near: [1.0; N], far: [0.0; N] };

    /// Lanes whose interval isn't empty.
    #[inline(always)]
    fn lanes(&self) -> u32 {
        (0..N).fold(0, |mask, i| mask | u32::from(self.near[i] <= self.far[i]) << i)
    }
}

/// What traversals of `N` rays need, kept from one to the next.
#[derive(Clone, Debug)]
pub struct KdScratch<const N: usize> {
    entries: Vec<Entry<N>>,
    /// Leaves that wait, with the lanes that want them.
    deferred: Vec<(u32, u32)>,
}

impl<const N: usize> Default for KdScratch<N> {
    fn default() -> Self {
        Self { entries: vec![Entry::EMPTY; super::build::MAX_DEPTH as usize + 2], deferred: Vec::new() }
    }
}

/// Rays prepared to walk together.
struct Group<'a, const N: usize> {
    rays: [&'a Ray; N],
    slabs: [Option<SlabRay>; N],
    origin: [[f32; N]; 3],
    near: [[f32; N]; 3],
    far: [[f32; N]; 3],
    /// Whether the first valid ray goes towards larger coordinates.
    forward: [bool; 3],
}

impl<'a, const N: usize> Group<'a, N> {
    /// The rays and their intervals in the tree's bounds; empty for rays that are not valid.
    #[inline(always)]
    fn new(rays: [&'a Ray; N], tree: &KdTree) -> (Self, Entry<N>) {
        let mut group = Self {
            rays,
            slabs: [None; N],
            origin: [[0.0; N]; 3],
            near: [[1.0; N]; 3],
            far: [[1.0; N]; 3],
            forward: [true; 3],
        };
        let mut root = Entry::EMPTY;
        for lane in (0..N).rev() {
            let Some(slab) = SlabRay::new(rays[lane]) else { continue };
            group.slabs[lane] = Some(slab);
            let (mut t0, mut t1) = (slab.tnear, slab.tfar);
            for axis in 0..3 {
                let (origin, near, far) = (slab.origin_near[axis], slab.inv_near[axis], slab.inv_far[axis]);
                (group.origin[axis][lane], group.near[axis][lane], group.far[axis][lane]) =
                    (origin, near, far);
                group.forward[axis] = near >= 0.0;
                let (min, max) = (tree.bounds.min[axis], tree.bounds.max[axis]);
                let (first, last) = if near >= 0.0 { (min, max) } else { (max, min) };
                t0 = t0.max((first - origin) * near);
                t1 = t1.min((last - origin) * far);
            }
            (root.near[lane], root.far[lane]) = (t0, t1);
        }
        (group, root)
    }

    /// Both children with the intervals clipped to them.
    #[inline(always)]
    fn children(&self, entry: &Entry<N>, node: Node) -> [Entry<N>; 2] {
        let (axis, position) = (node.axis(), node.position());
        let (origin, near, far) = (&self.origin[axis], &self.near[axis], &self.far[axis]);
        let (mut left, mut right) = (*entry, *entry);
        for i in 0..N {
            let difference = position - origin[i];
            // At least and at most the `t` of the plane; NaN, for a ray in the plane, is dropped by the comparisons.
            let (least, most) = (difference * near[i], difference * far[i]);
            let end = if most < entry.far[i] { most } else { entry.far[i] };
            let start = if least > entry.near[i] { least } else { entry.near[i] };
            if near[i] >= 0.0 {
                (left.far[i], right.near[i]) = (end, start);
            } else {
                (left.near[i], right.far[i]) = (start, end);
            }
        }
        left.node = entry.node + 1;
        right.node = node.right() as u32;
        [left, right]
    }
}

/// State of one walk.
struct Walk<'a, const N: usize, K, S> {
    kernel: K,
    tree: &'a KdTree,
    group: &'a Group<'a, N>,
    stats: &'a mut S,
    found: [Blocker; N],
    /// Prepared for triangles when the first is tested: rays that end at cells don't need it.
    blocks: [Option<BlockRay>; N],
    /// Lanes without a blocker so far.
    alive: u32,
    /// Lanes that opaque cells may end.
    solid: u32,
}

impl<const N: usize, K: Kernel, S: Statistics> Walk<'_, N, K, S> {
    /// Tests the triangles of a leaf.
    #[inline(always)]
    fn test(&mut self, node: Node, lanes: u32) {
        let mut lanes = lanes & self.alive;
        while lanes != 0 {
            let lane = lanes.trailing_zeros() as usize % N;
            lanes &= lanes - 1;
            if self.blocks[lane].is_none() {
                self.blocks[lane] = BlockRay::new(self.group.rays[lane]);
            }
            let Some(ray) = &self.blocks[lane] else { continue };
            'blocks: for index in node.blocks() {
                let block = &self.tree.blocks[index];
                let mask = self.kernel.filter(block, ray);
                self.stats.triangles(self.tree.block_len(index));
                let mut hit = mask.certain != 0;
                let mut open = mask.uncertain;
                while open != 0 && !hit {
                    let place = open.trailing_zeros() as usize % LANES;
                    open &= open - 1;
                    hit = segment_hits_triangle(self.group.rays[lane], block.get(place));
                }
                if hit {
                    self.found[lane] = Blocker::Triangle;
                    self.alive &= !(1 << lane);
                    break 'blocks;
                }
            }
        }
    }

    /// Tests all leaves that wait.
    #[inline(always)]
    fn flush(&mut self, deferred: &mut Vec<(u32, u32)>) {
        for &(leaf, lanes) in deferred.iter() {
            self.test(self.tree.nodes[leaf as usize], lanes);
            if self.alive == 0 {
                break;
            }
        }
        deferred.clear();
    }

    #[inline(always)]
    fn leaf<C: Cells>(
        &mut self,
        index: u32,
        lanes: u32,
        order: Order,
        cells: &mut C,
        deferred: &mut Vec<(u32, u32)>,
    ) {
        let node = self.tree.nodes[index as usize];
        match node.state() {
            LeafState::Boundary if order.deferred == 0 => self.test(node, lanes),
            LeafState::Boundary => {
                if deferred.len() == order.deferred as usize {
                    self.flush(deferred);
                }
                deferred.push((index, lanes));
            }
            LeafState::Clear => {
                if order.flush_at_clear && !deferred.is_empty() {
                    self.flush(deferred);
                }
            }
            LeafState::Opaque => {
                let mut lanes = lanes & self.solid;
                while lanes != 0 {
                    let lane = lanes.trailing_zeros() as usize % N;
                    lanes &= lanes - 1;
                    if let Some(slab) = &self.group.slabs[lane]
                        && cells.blocks(node.slot(), lane, slab)
                    {
                        self.found[lane] = Blocker::Cell(node.slot());
                        self.alive &= !(1 << lane);
                    }
                }
            }
        }
    }
}

const SEARCH_NEAR: u8 = 0;
const SEARCH_SOLID: u8 = 1;
const SEARCH_BREADTH: u8 = 2;
const SEARCH_QUICK: u8 = 3;

/// What blocks each ray.
#[inline(always)]
pub(crate) fn walk<const N: usize, K: Kernel, C: Cells, S: Statistics>(
    kernel: K,
    tree: &KdTree,
    rays: [&Ray; N],
    order: Order,
    cells: &mut C,
    scratch: &mut KdScratch<N>,
    stats: &mut S,
) -> [Blocker; N] {
    let (group, root) = Group::new(rays, tree);
    let alive = root.lanes();
    let found = [Blocker::Nothing; N];
    let mut walk = Walk { kernel, tree, group: &group, stats, found, blocks: [None; N], alive, solid: 0 };
    for (lane, ray) in rays.into_iter().enumerate() {
        let Some(slab) = group.slabs[lane].as_ref().filter(|_| alive & 1 << lane != 0) else { continue };
        match cells.start(lane, ray, slab) {
            Start::Cells => walk.solid |= 1 << lane,
            Start::Plain => {}
            Start::Blocked(slot) => {
                walk.found[lane] = Blocker::Cell(slot);
                walk.alive &= !(1 << lane);
            }
        }
    }
    let order = if walk.solid & walk.alive == 0 { Order::RAY } else { order };
    match order.search {
        Search::Near => search::<N, SEARCH_NEAR, K, C, S>(walk, root, order, cells, scratch),
        Search::Solid => search::<N, SEARCH_SOLID, K, C, S>(walk, root, order, cells, scratch),
        Search::Breadth => search::<N, SEARCH_BREADTH, K, C, S>(walk, root, order, cells, scratch),
        Search::Quick => search::<N, SEARCH_QUICK, K, C, S>(walk, root, order, cells, scratch),
    }
}

#[inline(always)]
fn search<const N: usize, const SEARCH: u8, K: Kernel, C: Cells, S: Statistics>(
    mut walk: Walk<N, K, S>,
    mut entry: Entry<N>,
    order: Order,
    cells: &mut C,
    scratch: &mut KdScratch<N>,
) -> [Blocker; N] {
    let (tree, group) = (walk.tree, walk.group);
    let KdScratch { entries, deferred } = scratch;
    deferred.clear();
    // A stack ends at `tail`; a queue runs from `head` to `tail`.
    let (mut head, mut tail) = (0, 0);
    while walk.alive != 0 {
        let lanes = entry.lanes() & walk.alive;
        if lanes != 0 {
            let node = tree.nodes[entry.node as usize];
            walk.stats.kd_node(lanes.count_ones(), N as u32, node.is_leaf());
            if node.is_leaf() {
                walk.leaf(entry.node, lanes, order, cells, deferred);
            } else {
                let [left, right] = group.children(&entry, node);
                let (into_left, into_right) = (left.lanes() & lanes, right.lanes() & lanes);
                if SEARCH == SEARCH_BREADTH {
                    for (child, into) in [(left, into_left), (right, into_right)] {
                        if into != 0 {
                            push(entries, &mut tail, child);
                        }
                    }
                } else if into_right == 0 {
                    // Rounding alone could leave a ray without either half.
                    entry = left;
                    continue;
                } else if into_left == 0 {
                    entry = right;
                    continue;
                } else {
                    let left_first =
                        if SEARCH == SEARCH_SOLID { !node.right_first() } else { group.forward[node.axis()] };
                    let (first, second) = if left_first { (left, right) } else { (right, left) };
                    if SEARCH == SEARCH_QUICK {
                        push(entries, &mut tail, first);
                        push(entries, &mut tail, second);
                    } else {
                        push(entries, &mut tail, second);
                        entry = first;
                        continue;
                    }
                }
            }
        }
        if head == tail {
            break;
        }
        if SEARCH == SEARCH_BREADTH || SEARCH == SEARCH_QUICK {
            entry = entries[head];
            head += 1;
            if head == tail {
                (head, tail) = (0, 0);
            }
        } else {
            tail -= 1;
            entry = entries[tail];
        }
    }
    if walk.alive != 0 && !deferred.is_empty() {
        walk.flush(deferred);
    }
    walk.found
}

#[inline(always)]
fn push<const N: usize>(entries: &mut Vec<Entry<N>>, tail: &mut usize, entry: Entry<N>) {
    if *tail == entries.len() {
        entries.push(entry);
    } else {
        entries[*tail] = entry;
    }
    *tail += 1;
}
