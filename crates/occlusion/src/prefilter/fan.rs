//! Rays of one origin walk together, each answered as if alone.
//!
//! Here: the walk of a fan. Not here: rays of different origins (`packet.rs`), boxes and triangles (`kernel`).
//!
//! Seen from one origin a node's boxes move, and their sizes are compared with their distances, once for all rays; so is a
//! leaf ([`umbrage_geom::kernel::fan`]). Rays are prepared sixteen at a time.

use super::{
    ConeRay, Directions, Query,
    kernel::{FanNode, Kernel, WIDE, dot},
    query::Cones,
    storage::Table,
    walk::{Lost, Scene, StopStatistics},
    wide::{LEAF, MAX_LEVELS, WIDTH},
};
use umbrage_geom::{
    OpticalDepth,
    kernel::{LANES, fan::FanRays},
    segment_hits_triangle,
};

/// Rays in a fan.
pub(crate) const FAN: usize = 16;

/// Fewest rays that are worth a fan.
pub(crate) const SMALLEST: usize = 3;

/// What fans need, kept from one to the next.
pub(crate) struct Fan {
    rays: FanRays<FAN>,
    /// Children to visit with the rays that enter them.
    children: [u32; (WIDTH - 1) * MAX_LEVELS + WIDTH],
    masks: [u16; (WIDTH - 1) * MAX_LEVELS + WIDTH],
}

impl Fan {
    pub(crate) fn new() -> Self {
        let (children, masks) =
            ([0; (WIDTH - 1) * MAX_LEVELS + WIDTH], [0; (WIDTH - 1) * MAX_LEVELS + WIDTH]);
        Self { rays: FanRays::default(), children, masks }
    }

    /// Answers `rays` of one finite origin, at most [`FAN`]; returns those that it can't take, which are left as they are.
    #[inline(always)]
    #[allow(clippy::too_many_arguments)] // the state of one loop
    pub(crate) fn answer<K: Kernel, T: Table, S: StopStatistics>(
        &mut self,
        kernel: K,
        scene: &Scene<T>,
        directions: Directions,
        cones: &[ConeRay],
        query: &Query,
        passed: &mut [f32],
        stats: &mut S,
    ) -> u32 {
        let mut rays = [cones[0].ray; FAN];
        for (ray, cone) in rays.iter_mut().zip(cones) {
            *ray = cone.ray;
        }
        let count = cones.len().min(FAN);
        let fit = self.rays.prepare(0, &rays[..count]);
        let prepared = Cones::<FAN>::new(query, directions, cones);
        let mut views = [scene.table.view(prepared.cells[0], prepared.direction(0)); FAN];
        let mut lost = [Lost::nothing(prepared.kappa[0]); FAN];
        for i in 1..count {
            views[i] = scene.table.view(prepared.cells[i], prepared.direction(i));
            lost[i] = Lost::nothing(prepared.kappa[i]);
        }
        let widest = prepared.kappa[..count].iter().fold(0f32, |m, &k| if k > m { k } else { m });
        let origin = rays[0].origin.to_array();
        let mut alive = fit as u16;
        let mut top = usize::from(fit != 0);
        (self.children[0], self.masks[0]) = (0, alive);
        while top > 0 {
            top -= 1;
            let (child, mut rest) = (self.children[top], self.masks[top] & alive);
            if rest == 0 {
                continue;
            }
            if child & LEAF != 0 {
                let leaf = (child & !LEAF) as usize;
                let block = &scene.wide.blocks[leaf];
                let planes = kernel.planes(block, origin);
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
                        if mask.certain >> lane & 1 == 1 || segment_hits_triangle(&rays[r], block.get(lane)) {
                            depth += scene.depths.of(leaf, lane);
                        }
                    }
                    if depth != OpticalDepth::CLEAR {
                        alive &= !(u16::from(lost[r].add_exact(depth)) << r);
                    }
                }
                continue;
            }
            let index = child as usize;
            let node = &scene.wide.nodes[index];
            let seen: FanNode = kernel.look(node, origin);
            let mut columns = WIDE;
            // Far up no child is small enough for any ray.
            let may_stop = kernel.any_below(&seen, widest);
            while rest != 0 {
                let r = rest.trailing_zeros() as usize % FAN;
                rest &= rest - 1;
                stats.node(node.len() as u32);
                if !may_stop {
                    kernel.enter(&seen, &self.rays, r, &mut columns);
                    continue;
                }
                let (kappa, raise) = (prepared.kappa[r], prepared.raise);
                let (stop, fraction) = kernel.enter_or_stop(&seen, &self.rays, r, kappa, raise, &mut columns);
                if stop != 0 {
                    stats.stops(stop, || scene.wide.levels.partition_point(|level| level.end <= index));
                    let depths = scene.table.depths(views[r], index);
                    let black = lost[r].add_stored(dot(&depths, &fraction));
                    alive &= !(u16::from(black) << r);
                }
            }
            // The last slot first on to the stack, so that nodes are visited in the order of a single ray.
            let mut entered = kernel.nonzero(&columns) & seen.used;
            assert!(top + WIDTH <= self.children.len(), "the tree has no more levels than the stack");
            while entered != 0 {
                let slot = (31 - entered.leading_zeros()) as usize % WIDTH;
                entered &= !(1 << slot);
                (self.children[top], self.masks[top]) = (node.children[slot], columns.0[slot] as u16);
                top += 1;
            }
        }
        for (r, passed) in passed.iter_mut().enumerate().take(count) {
            if fit >> r & 1 == 1 {
                *passed = if alive >> r & 1 == 0 { 0.0 } else { lost[r].transmittance() };
            }
        }
        !fit & ((1u32 << count) - 1)
    }
}
