//! The walk of up to 256 rays of one origin through the hierarchy.
//!
//! Here: what is visited with which rays. Near the root an entry stands for groups of eight rays, tested as cones; once no more
//! than four groups are left, for single rays. Not here: the tests (`kernel`), what a hit means ([`Goal`]).

use super::{
    kernel::{Hull, Kernel, LANES, LeafRows, Rows, Stack, ray_of},
    rays::{GROUP, GROUPS, RaySet},
};
use umbrage_accel::{Bvh, View};
use umbrage_geom::{
    Ray,
    kernel::{BlockMask, TriangleBlock},
};

/// Most groups of an entry that knows single rays.
pub(crate) const MAX_GROUPS_OF_SINGLE_RAYS: u32 = 4;

/// Most groups whose rays are tested before they are pushed.
pub(crate) const MAX_GROUPS_TESTED_BY_RAY: u32 = 12;

/// Fewest rays for which a node is first tested against the hull.
const MIN_RAYS_FOR_HULL: u32 = 4;

/// What is asked about the rays.
pub(crate) trait Goal {
    /// Whether rays get shorter on their way.
    const SHRINKS: bool;

    /// Takes the triangles of `leaf` that the filter found on ray number `ray`. Whether the ray needs no more.
    fn lanes(&mut self, walk: &mut GoalContext<'_>, leaf: u32, ray: usize, mask: BlockMask) -> bool;

    /// Takes the rays of `group` that the filter found to meet the triangle in `lane` of `leaf`. The rays that need no more.
    fn rays(
        &mut self,
        walk: &mut GoalContext<'_>,
        leaf: u32,
        lane: usize,
        group: usize,
        mask: BlockMask,
    ) -> u8;

    /// Triangles of a leaf that can be skipped, a bit each, by the sides on which the origin is for certain.
    fn skipped(&self, sides: impl FnOnce() -> (u32, u32)) -> u32;

    /// Answers ray number `index` of all walks, which could not walk. Whether it is blocked.
    fn alone(&mut self, bvh: &Bvh, index: usize, ray: &Ray) -> bool;
}

/// What a goal may look at.
pub(crate) struct GoalContext<'a> {
    pub(crate) bvh: &'a Bvh,
    pub(crate) rays: &'a mut RaySet,
    pub(crate) origin: [f32; 3],
    /// Number of the walk's first ray among those of all walks.
    pub(crate) item: usize,
}

impl GoalContext<'_> {
    pub(crate) fn block(&self, leaf: u32) -> &TriangleBlock {
        self.bvh.view().leaf(leaf)
    }
}

/// Rays on their way.
pub(crate) struct Walk {
    pub(crate) rays: RaySet,
    /// First ray of the part of a pattern that [`Self::rays`] has begun with.
    pub(crate) part: Option<usize>,
    /// By group: rays that need no more.
    pub(crate) done: [u8; GROUPS],
    /// Groups with rays that do.
    open: u32,
    /// See [`GoalContext::item`].
    pub(crate) item: usize,
    origin: [f32; 3],
    hull: Hull,
    stack: Stack,
    top: usize,
}

impl Walk {
    pub(crate) fn new() -> Self {
        Self {
            rays: RaySet::new(),
            part: None,
            done: [u8::MAX; GROUPS],
            open: 0,
            item: 0,
            origin: [0.0; 3],
            hull: Hull::new(0.0, [0.0; 3], [0.0; 3], [0.0; 2]),
            stack: Stack::new(),
            top: 0,
        }
    }

    /// Starts at the root with what has been put into [`Self::rays`].
    #[inline(always)]
    pub(crate) fn start(&mut self, item: usize, origin: [f32; 3], hull: Hull) {
        (self.item, self.origin, self.hull) = (item, origin, hull);
        self.done = self.rays.closed;
        self.open = self.rays.open();
        self.top = 1;
        self.stack.children[0] = 0;
        if self.rays.groups <= MAX_GROUPS_OF_SINGLE_RAYS as usize {
            (self.stack.groups[0], self.stack.rays[0]) = (0x0302_0100, u32::MAX);
        } else {
            (self.stack.groups[0], self.stack.rays[0]) = (u32::MAX, 0);
        }
    }

    /// Rays of the groups `ids` that need no more.
    #[inline(always)]
    fn done_of(&self, ids: u32) -> u32 {
        let of = |i: u32| u32::from(self.done[(ids >> (8 * i)) as usize % GROUPS]) << (8 * i);
        of(0) | of(1) | of(2) | of(3)
    }

    #[inline(always)]
    fn finish(&mut self, group: usize, rays: u8) {
        self.done[group] |= rays;
        if self.done[group] == u8::MAX {
            self.open &= !(1 << group);
            if self.open == 0 {
                self.top = 0;
            }
        }
    }

    /// Visits one node or leaf; false if there was none left.
    #[inline(always)]
    pub(crate) fn step<K: Kernel>(&mut self, kernel: K, bvh: &Bvh, goal: &mut impl Goal) -> bool {
        let (child, groups, rays) = loop {
            if self.top == 0 {
                return false;
            }
            self.top -= 1;
            let (groups, rays) = (self.stack.groups[self.top], self.stack.rays[self.top]);
            let live = if rays == 0 { groups & self.open } else { rays & !self.done_of(groups) };
            if live != 0 {
                break if rays == 0 {
                    (self.stack.children[self.top], live, 0)
                } else {
                    (self.stack.children[self.top], groups, live)
                };
            }
        };
        let leaf = child & View::LEAF != 0;
        match (leaf, rays) {
            (false, 0) => self.node_of_groups(kernel, bvh, child, groups),
            (false, _) => self.node_of_rays(kernel, bvh, child, groups, rays),
            (true, 0) => self.leaf_of_groups(kernel, bvh, child & !View::LEAF, groups, goal),
            (true, _) => self.leaf_of_rays(kernel, bvh, child & !View::LEAF, groups, rays, goal),
        }
        // Without a loop over what was pushed, whose length nothing predicts.
        let view = bvh.view();
        for &child in &self.stack.children[self.top.saturating_sub(3)..self.top] {
            kernel.prefetch(view.address(child), View::CHILD_BYTES);
        }
        true
    }

    #[inline(always)]
    fn node_of_groups<K: Kernel>(&mut self, kernel: K, bvh: &Bvh, node: u32, live: u32) {
        let node = bvh.view().node(node);
        let rows = kernel.rows(node, self.origin);
        let mut wanted = node.used() & kernel.inside(&rows, &self.hull);
        if wanted == 0 {
            return;
        }
        let bottom = self.top;
        let around = wanted & kernel.around(&rows);
        wanted &= !around;
        if wanted != 0 {
            let spheres = kernel.spheres(&rows);
            wanted &= kernel.ahead(&spheres, &self.hull);
            while wanted != 0 {
                // Highest first: larger boxes come first in a node, and shall be visited first.
                let child = 31 - wanted.leading_zeros() as usize;
                wanted ^= 1 << child;
                let mut groups = kernel.cones(&spheres, child, &self.rays) & live;
                if groups.count_ones() > MAX_GROUPS_OF_SINGLE_RAYS {
                    groups &= kernel.box_groups(&rows, child, &self.rays, &self.hull);
                }
                if groups.count_ones() > MAX_GROUPS_TESTED_BY_RAY {
                    self.push(bottom, node.children()[child], groups, 0, GROUP as u32 * groups.count_ones());
                } else if groups != 0 {
                    self.narrow(kernel, &rows, child, node.children()[child], groups, bottom);
                }
            }
        }
        let mut around = around;
        while around != 0 {
            let child = 31 - around.leading_zeros() as usize;
            around ^= 1 << child;
            if live.count_ones() > MAX_GROUPS_OF_SINGLE_RAYS {
                let top = self.top;
                (self.stack.children[top], self.stack.groups[top], self.stack.rays[top]) =
                    (node.children()[child], live, 0);
                self.top += 1;
            } else {
                self.narrow(kernel, &rows, child, node.children()[child], live, bottom);
            }
        }
    }

    /// Pushes an entry among those above `bottom`, the one with most rays on top.
    #[inline(always)]
    fn push(&mut self, bottom: usize, child: u32, groups: u32, rays: u32, count: u32) {
        let mut at = self.top;
        self.top += 1;
        while at > bottom {
            let below = at - 1;
            let (groups, rays) = (self.stack.groups[below], self.stack.rays[below]);
            let others = if rays == 0 { GROUP as u32 * groups.count_ones() } else { rays.count_ones() };
            if others <= count {
                break;
            }
            (self.stack.children[at], self.stack.groups[at], self.stack.rays[at]) =
                (self.stack.children[below], groups, rays);
            at = below;
        }
        (self.stack.children[at], self.stack.groups[at], self.stack.rays[at]) = (child, groups, rays);
    }

    /// Pushes the child in slot `slot` with those of the `groups` that have a ray that may enter it: as groups if they have
    /// many rays, else as rays, [`MAX_GROUPS_OF_SINGLE_RAYS`] groups at a time.
    #[inline(always)]
    fn narrow<K: Kernel>(
        &mut self,
        kernel: K,
        rows: &Rows,
        slot: usize,
        child: u32,
        mut groups: u32,
        bottom: usize,
    ) {
        let mut entered = [0; GROUPS];
        let (mut kept, mut count) = (0u32, 0);
        while groups != 0 {
            let group = groups.trailing_zeros() as usize % GROUPS;
            groups &= groups - 1;
            entered[group] = kernel.box_rays(rows, slot, &self.rays, group) & !u32::from(self.done[group]);
            kept |= u32::from(entered[group] != 0) << group;
            count += entered[group].count_ones();
        }
        // About where testing rays one by one gets cheaper than a test of each group and child.
        if kept.count_ones() > MAX_GROUPS_OF_SINGLE_RAYS && count > 12 + 5 * kept.count_ones() / 2 {
            return self.push(bottom, child, kept, 0, count);
        }
        while kept != 0 {
            let (mut ids, mut rays) = (0, 0);
            for i in 0..MAX_GROUPS_OF_SINGLE_RAYS {
                // Beyond the last group the number is that of some group, and there are no rays.
                let group = kept.trailing_zeros() % GROUPS as u32;
                let left = if kept != 0 { entered[group as usize] } else { 0 };
                ids |= group << (8 * i);
                rays |= left << (8 * i);
                kept &= kept.wrapping_sub(1);
            }
            self.push(bottom, child, ids, rays, rays.count_ones());
        }
    }

    #[inline(always)]
    fn node_of_rays<K: Kernel>(&mut self, kernel: K, bvh: &Bvh, node: u32, ids: u32, rays: u32) {
        let node = bvh.view().node(node);
        let rows = kernel.rows(node, self.origin);
        let mut wanted = node.used();
        if rays.count_ones() >= MIN_RAYS_FOR_HULL {
            wanted &= kernel.inside(&rows, &self.hull);
        }
        let children = node.children();
        self.top =
            kernel.push_rays(children, &rows, &self.rays, ids, rays, wanted, &mut self.stack, self.top);
    }

    #[inline(always)]
    fn leaf_of_rays<K: Kernel>(
        &mut self,
        kernel: K,
        bvh: &Bvh,
        leaf: u32,
        ids: u32,
        mut left: u32,
        goal: &mut impl Goal,
    ) {
        let block = bvh.view().leaf(leaf);
        // Of few rays each is tested sooner than the horizon.
        let above = if left.count_ones() < MIN_RAYS_FOR_HULL {
            0xff
        } else {
            kernel.above(block, self.origin, &self.hull)
        };
        if above == 0 {
            return;
        }
        let mut planes = kernel.planes(block, self.origin);
        let mut groups = 0;
        for i in 0..4 {
            groups |= u32::from(left >> (8 * i) & 0xff != 0) << (ids >> (8 * i) & 31);
        }
        // Each test takes eight triangles, or eight rays.
        if left.count_ones() > groups.count_ones() * above.count_ones() {
            return self.triangles(kernel, bvh, leaf, &planes, above, groups, goal);
        }
        let skipped = !above as u8 | goal.skipped(|| kernel.leaf_rows(&planes).planes.sides()) as u8;
        let mut asked = skipped;
        while left != 0 {
            let ray = ray_of(ids, left.trailing_zeros());
            left &= left - 1;
            let BlockMask { certain, uncertain } = loop {
                let mask = kernel.ray_lanes(&planes, &self.rays, ray);
                let ask = mask.uncertain & !asked;
                if ask == 0 {
                    break mask;
                }
                asked |= ask;
                kernel.ask_sides(&mut planes, block, self.origin, ask);
            };
            let mask = BlockMask { certain: certain & !skipped, uncertain: uncertain & !skipped };
            if mask.certain | mask.uncertain != 0 {
                let Self { rays, origin, item, .. } = self;
                let mut ground = GoalContext { bvh, rays, origin: *origin, item: *item };
                if goal.lanes(&mut ground, leaf, ray, mask) {
                    self.finish(ray / GROUP, 1 << (ray % GROUP));
                }
            }
        }
    }

    #[inline(always)]
    fn leaf_of_groups<K: Kernel>(
        &mut self,
        kernel: K,
        bvh: &Bvh,
        leaf: u32,
        groups: u32,
        goal: &mut impl Goal,
    ) {
        let block = bvh.view().leaf(leaf);
        let above = kernel.above(block, self.origin, &self.hull);
        if above != 0 {
            let planes = kernel.planes(block, self.origin);
            self.triangles(kernel, bvh, leaf, &planes, above, groups, goal);
        }
    }

    /// Tests groups against the triangles `lanes` of a leaf, one by one.
    #[allow(clippy::too_many_arguments)] // the state of one visit
    #[inline(always)]
    fn triangles<K: Kernel>(
        &mut self,
        kernel: K,
        bvh: &Bvh,
        leaf: u32,
        planes: &K::Planes,
        lanes: u32,
        groups: u32,
        goal: &mut impl Goal,
    ) {
        let mut rows: LeafRows = kernel.leaf_rows(planes);
        let mut lanes = lanes & kernel.near(&rows, &self.hull) & !goal.skipped(|| rows.planes.sides());
        while lanes != 0 {
            let lane = lanes.trailing_zeros() as usize % LANES;
            lanes &= lanes - 1;
            let mut asked = false;
            let mut groups = groups & self.open;
            if groups.count_ones() > MAX_GROUPS_OF_SINGLE_RAYS {
                groups &= kernel.lane_groups(&rows, lane, &self.rays);
            }
            while groups != 0 {
                let group = groups.trailing_zeros() as usize % GROUPS;
                groups &= groups - 1;
                let open = !self.done[group];
                let BlockMask { certain, uncertain } = loop {
                    let mask = kernel.lane_rays(&rows, lane, &self.rays, group);
                    if asked || mask.uncertain & open == 0 {
                        break mask;
                    }
                    asked = true;
                    rows.planes.ask_sides(bvh.view().leaf(leaf), self.origin, 1 << lane);
                };
                if rows.planes.used() >> lane & 1 == 0 {
                    break;
                }
                let mask = BlockMask { certain: certain & open, uncertain: uncertain & open };
                if mask.certain | mask.uncertain != 0 {
                    let Self { rays, origin, item, .. } = self;
                    let mut ground = GoalContext { bvh, rays, origin: *origin, item: *item };
                    let done = goal.rays(&mut ground, leaf, lane, group, mask);
                    self.finish(group, done);
                }
            }
        }
    }
}
