//! Rays of one origin walk together, each answered as if alone.
//!
//! Here: the walk of a fan. Not here: rays of different origins (`packet.rs`), boxes and triangles (`kernel`).
//!
//! Seen from one origin a node's boxes move, and their sizes are compared with their distances, once for all rays; so is a
//! leaf ([`umbrage_geom::kernel::fan`]). Rays are prepared sixteen at a time.

use super::{
    ConeRay, Directions, Query,
    kernel::{FanNode, Kernel, NO_RAYS, dot},
    query::Cones,
    storage::Table,
    walk::{Lost, Scene, StopStatistics},
    wide::{LEAF, MAX_LEVELS, WIDTH},
};
use std::ops::Range;
use umbrage_geom::{
    OpticalDepth,
    kernel::{LANES, fan::FanRays},
    segment_hits_triangle,
};

/// Rays in a fan.
pub(crate) const FAN: usize = 16;

/// Fewest rays that are worth a fan.
pub(crate) const SMALLEST: usize = 3;

/// Fans that take turns, so that one works while others wait for memory.
const TURNS: usize = 6;

/// One fan on its way.
pub(crate) struct Fan<V> {
    rays: FanRays<FAN>,
    cones: Cones<FAN>,
    views: [V; FAN],
    lost: [Lost; FAN],
    origin: [f32; 3],
    /// Largest `kappa` of any ray.
    widest: f32,
    /// Place of the first ray.
    first: usize,
    count: usize,
    /// Rays that the fan can take.
    fit: u16,
    /// Rays that are not blocked so far.
    alive: u16,
    /// Children to visit with the rays that enter them.
    children: [u32; (WIDTH - 1) * MAX_LEVELS + WIDTH],
    masks: [u16; (WIDTH - 1) * MAX_LEVELS + WIDTH],
    top: usize,
}

impl<V: Copy> Fan<V> {
    fn new(cones: Cones<FAN>, view: V) -> Self {
        Self {
            rays: FanRays::default(),
            cones,
            views: [view; FAN],
            lost: [Lost::nothing(0.0); FAN],
            origin: [0.0; 3],
            widest: 0.0,
            first: 0,
            count: 0,
            fit: 0,
            alive: 0,
            children: [0; (WIDTH - 1) * MAX_LEVELS + WIDTH],
            masks: [0; (WIDTH - 1) * MAX_LEVELS + WIDTH],
            top: 0,
        }
    }

    /// Takes up `cones` of one finite origin, at most [`FAN`], the first of which has the place `first`.
    #[inline(always)]
    fn start<T: Table<View = V>>(
        &mut self,
        table: &T,
        directions: Directions,
        query: &Query,
        first: usize,
        cones: &[ConeRay],
    ) {
        let mut rays = [cones[0].ray; FAN];
        for (ray, cone) in rays.iter_mut().zip(cones) {
            *ray = cone.ray;
        }
        let count = cones.len().min(FAN);
        self.fit = self.rays.prepare(0, &rays[..count]) as u16;
        self.cones = Cones::new(query, directions, cones);
        self.widest = 0.0;
        for i in 0..count {
            let kappa = self.cones.kappa[i];
            self.views[i] = table.view(self.cones.cells[i], self.cones.direction(i));
            self.lost[i] = Lost::nothing(kappa);
            self.widest = if kappa > self.widest { kappa } else { self.widest };
        }
        self.origin = rays[0].origin.to_array();
        (self.first, self.count, self.alive) = (first, count, self.fit);
        self.top = usize::from(self.fit != 0);
        (self.children[0], self.masks[0]) = (0, self.fit);
    }

    /// Visits one node or leaf; false if there was none left.
    #[inline(always)]
    fn step<K: Kernel, T: Table<View = V>, S: StopStatistics>(
        &mut self,
        kernel: K,
        scene: &Scene<T>,
        cones: &[ConeRay],
        stats: &mut S,
    ) -> bool {
        let (child, rest) = loop {
            if self.top == 0 {
                return false;
            }
            self.top -= 1;
            let rest = self.masks[self.top] & self.alive;
            if rest != 0 {
                break (self.children[self.top], rest);
            }
        };
        if child & LEAF != 0 {
            self.leaf(kernel, scene, (child & !LEAF) as usize, rest, cones, stats);
        } else {
            self.node(kernel, scene, child as usize, rest, stats);
        }
        true
    }

    #[inline(always)]
    fn leaf<K: Kernel, T: Table<View = V>, S: StopStatistics>(
        &mut self,
        kernel: K,
        scene: &Scene<T>,
        leaf: usize,
        mut rest: u16,
        cones: &[ConeRay],
        stats: &mut S,
    ) {
        let block = &scene.wide.blocks[leaf];
        let planes = kernel.planes(block, self.origin);
        while rest != 0 {
            let r = rest.trailing_zeros() as usize % FAN;
            rest &= rest - 1;
            let mask = kernel.fan_filter(&planes, &self.rays, r);
            stats.triangles(block.len() as u32);
            stats.uncertain(mask.uncertain.count_ones());
            let mut open = mask.certain | mask.uncertain;
            let mut depth = OpticalDepth::CLEAR;
            while open != 0 {
                let lane = open.trailing_zeros() as usize % LANES;
                open &= open - 1;
                let ray = &cones[self.first + r].ray;
                if mask.certain >> lane & 1 == 1 || segment_hits_triangle(ray, block.get(lane)) {
                    depth += scene.depths.of(leaf, lane);
                }
            }
            if depth != OpticalDepth::CLEAR {
                self.alive &= !(u16::from(self.lost[r].add_exact(depth)) << r);
            }
        }
    }

    #[inline(always)]
    fn node<K: Kernel, T: Table<View = V>, S: StopStatistics>(
        &mut self,
        kernel: K,
        scene: &Scene<T>,
        index: usize,
        mut rest: u16,
        stats: &mut S,
    ) {
        let node = &scene.wide.nodes[index];
        let seen: FanNode = kernel.look(node, self.origin);
        let mut columns = NO_RAYS;
        // Far up no child is small enough for any ray.
        let may_stop = kernel.any_below(&seen, self.widest);
        while rest != 0 {
            let r = rest.trailing_zeros() as usize % FAN;
            rest &= rest - 1;
            stats.node(node.len() as u32);
            if !may_stop {
                kernel.enter(&seen, &self.rays, r, &mut columns);
                continue;
            }
            let (kappa, raise) = (self.cones.kappa[r], self.cones.raise);
            let (stop, fraction) = kernel.enter_or_stop(&seen, &self.rays, r, kappa, raise, &mut columns);
            if stop != 0 {
                stats.stops(stop, || scene.wide.levels.partition_point(|level| level.end <= index));
                let depths = scene.table.depths(self.views[r], index);
                let black = self.lost[r].add_stored(dot(&depths, &fraction));
                self.alive &= !(u16::from(black) << r);
            }
        }
        // The last slot first on to the stack, so that nodes are visited in the order of a single ray.
        let mut entered = kernel.nonzero(&columns) & seen.used;
        assert!(self.top + WIDTH <= self.children.len(), "the tree has no more levels than the stack");
        while entered != 0 {
            let slot = (31 - entered.leading_zeros()) as usize % WIDTH;
            entered &= !(1 << slot);
            let child = node.children[slot];
            (self.children[self.top], self.masks[self.top]) = (child, columns.0[slot] as u16);
            self.top += 1;
            if child & LEAF != 0 {
                kernel.prefetch(&scene.wide.blocks, (child & !LEAF) as usize);
            } else {
                kernel.prefetch(&scene.wide.nodes, child as usize);
                scene.table.prefetch(kernel, self.views[0], child as usize);
            }
        }
    }
}

/// Answers fans; rays that they can't take are left as they are and listed. `next` gives the places of rays of one finite origin, at
/// most [`FAN`], until there are none.
#[inline(always)]
#[allow(clippy::too_many_arguments)] // the state of one loop
pub(crate) fn answer<K: Kernel, T: Table, S: StopStatistics>(
    kernel: K,
    scene: &Scene<T>,
    directions: Directions,
    cones: &[ConeRay],
    query: &Query,
    passed: &mut [f32],
    fans: &mut Fans<T::View>,
    mut next: impl Iterator<Item = Range<usize>>,
    stats: &mut S,
) {
    let Fans { fans, order, left } = fans;
    left.clear();
    let mut busy = 0;
    loop {
        while busy < TURNS {
            let Some(range) = next.next() else { break };
            let (first, cones) = (range.start, &cones[range]);
            if busy == fans.len() {
                let prepared = Cones::new(query, directions, cones);
                let view = scene.table.view(prepared.cells[0], prepared.direction(0));
                fans.push(Fan::new(prepared, view));
                order.push(busy);
            }
            fans[order[busy]].start(scene.table, directions, query, first, cones);
            busy += 1;
        }
        if busy == 0 {
            return;
        }
        let mut turn = 0;
        while turn < busy {
            let fan = &mut fans[order[turn]];
            if fan.step(kernel, scene, cones, stats) {
                turn += 1;
                continue;
            }
            for r in 0..fan.count {
                if fan.fit >> r & 1 == 0 {
                    left.push(fan.first + r);
                } else {
                    let blocked = fan.alive >> r & 1 == 0;
                    passed[fan.first + r] = if blocked { 0.0 } else { fan.lost[r].transmittance() };
                }
            }
            busy -= 1;
            order.swap(turn, busy);
        }
    }
}

/// What fans need, kept from one batch to the next.
pub(crate) struct Fans<V> {
    fans: Vec<Fan<V>>,
    order: Vec<usize>,
    /// Places of rays that no fan took.
    pub(crate) left: Vec<usize>,
}

impl<V> Fans<V> {
    pub(crate) fn new() -> Self {
        Self { fans: Vec::with_capacity(TURNS), order: Vec::with_capacity(TURNS), left: Vec::new() }
    }
}
