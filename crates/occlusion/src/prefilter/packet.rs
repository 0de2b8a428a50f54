//! Rays of different origins: sixteen walk together, each answered as if alone.
//!
//! Here: the walk of a packet. Not here: rays of one origin (`fan.rs`). A node's boxes are loaded once, and nothing waits for
//! anything within a node.

use super::{
    ConeRay, Directions, Query,
    kernel::{Kernel, Prepared, Step, dot},
    query::Cones,
    storage::Table,
    walk::{Lost, Scene, StopStatistics, leaf_depth},
    wide::{LEAF, MAX_LEVELS, WIDTH},
};
use umbrage_geom::OpticalDepth;

/// Rays in a packet.
pub(crate) const PACKET: usize = 16;

/// A valid ray on its way.
struct Traveller<V> {
    prepared: Prepared,
    view: V,
    lost: Lost,
    /// Its place in the packet: rays that are not valid are left out.
    place: u8,
}

/// What packets need, kept from one to the next.
pub(crate) struct Packet<V> {
    travellers: Vec<Traveller<V>>,
    /// Children to visit with the rays that enter them.
    stack: Vec<(u32, u16)>,
}

/// Turns rows into columns: bit `c` of byte `r` becomes bit `r` of byte `c` (Warren, Hacker's Delight, section 7-3).
#[inline(always)]
fn transpose(mut x: u64) -> u64 {
    let mut swap = |shift: u32, mask: u64| {
        let t = (x ^ (x >> shift)) & mask;
        x ^= t ^ (t << shift);
    };
    swap(7, 0x00aa_00aa_00aa_00aa);
    swap(14, 0x0000_cccc_0000_cccc);
    swap(28, 0x0000_0000_f0f0_f0f0);
    x
}

impl<V: Copy> Packet<V> {
    pub(crate) fn new() -> Self {
        Self {
            travellers: Vec::with_capacity(PACKET),
            stack: Vec::with_capacity((WIDTH - 1) * MAX_LEVELS + 1),
        }
    }

    /// Answers up to [`PACKET`] rays.
    #[inline(always)]
    #[allow(clippy::too_many_arguments)] // the state of one loop
    pub(crate) fn answer<K: Kernel, T: Table<View = V>, S: StopStatistics>(
        &mut self,
        kernel: K,
        scene: &Scene<T>,
        directions: Directions,
        rays: &[ConeRay],
        query: &Query,
        passed: &mut [f32],
        stats: &mut S,
    ) {
        let Self { travellers, stack } = self;
        travellers.clear();
        for (place, (cone, passed)) in rays.iter().zip(passed.iter_mut()).enumerate().take(PACKET) {
            *passed = 1.0;
            let Cones { kappa: [kappa], raise, cells: [cell], .. } =
                Cones::<1>::new(query, directions, &[*cone]);
            if let Some(prepared) = Prepared::new(&cone.ray, kappa, raise) {
                let view = scene.table.view(cell, cone.ray.direction);
                let lost = Lost::nothing(kappa);
                travellers.push(Traveller { prepared, view, lost, place: place as u8 });
            }
        }
        let travellers = &mut travellers[..];
        // Rays that are not blocked so far.
        let mut alive = ((1u32 << travellers.len()) - 1) as u16;
        stack.push((0, alive));
        while let Some((child, mask)) = stack.pop() {
            let mut rest = mask & alive;
            if child & LEAF != 0 {
                while rest != 0 {
                    let r = rest.trailing_zeros() as usize;
                    rest &= rest - 1;
                    let Traveller { prepared, lost, place, .. } = &mut travellers[r];
                    let ray = &rays[*place as usize].ray;
                    let leaf = (child & !LEAF) as usize;
                    let added = leaf_depth(kernel, scene.wide, scene.depths, leaf, ray, prepared, stats);
                    if added != OpticalDepth::CLEAR {
                        alive &= !(u16::from(lost.add_exact(added)) << r);
                    }
                }
                continue;
            }
            if rest == 0 {
                continue;
            }
            let node = &scene.wide.nodes[child as usize];
            let mut origin = travellers[rest.trailing_zeros() as usize].prepared.origin;
            let mut sizes = kernel.sizes(node, origin);
            // Bytes are rays, bits children; the first eight rays and the others.
            let (mut rows, mut entered) = ([0u64; 2], 0);
            while rest != 0 {
                let r = rest.trailing_zeros() as usize;
                rest &= rest - 1;
                let Traveller { prepared, view, lost, .. } = &mut travellers[r];
                if prepared.origin != origin {
                    origin = prepared.origin;
                    sizes = kernel.sizes(node, origin);
                }
                let Step { mut descend, stop, fraction } = kernel.step(node, prepared, &sizes);
                stats.node(node.len() as u32);
                if stop != 0 {
                    stats.stops(stop, || {
                        scene.wide.levels.partition_point(|level| level.end <= child as usize)
                    });
                    let depths = scene.table.depths(*view, child as usize);
                    if lost.add_stored(dot(&depths, &fraction)) {
                        alive &= !(1 << r);
                        descend = 0;
                    }
                }
                entered |= descend;
                rows[r / 8 % 2] |= u64::from(descend) << (r % 8 * 8);
            }
            let columns = rows.map(transpose);
            // The last slot first on to the stack, so that nodes are visited in the order of a single ray.
            while entered != 0 {
                let slot = (31 - entered.leading_zeros()) as usize % WIDTH;
                entered &= !(1 << slot);
                let column = |half: usize| (columns[half] >> (8 * slot)) as u16 & 0xff;
                stack.push((node.children[slot], column(0) | column(1) << 8));
            }
        }
        for (r, traveller) in travellers.iter().enumerate() {
            let blocked = alive >> r & 1 == 0;
            passed[traveller.place as usize] = if blocked { 0.0 } else { traveller.lost.transmittance() };
        }
    }
}
