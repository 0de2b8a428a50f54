//! Any-hit for many rays: sixteen walk together, each answered as if alone.
//!
//! Here: the walk of a packet. Not here: single rays (`traversal.rs`), boxes and triangles (`kernel`).
//!
//! A node's boxes are tested against one ray after the other, and the results turned into one mask of rays for each child.
//! Nothing waits for anything within a node, where a single ray waits for each node before it knows the next. Rays that
//! share an origin, or start close together, share most of their nodes; packets of unrelated rays cost little more than
//! single ones. Moving a node to the origin that a packet shares, once for all rays, was 20 % slower on AVX2: its rows go
//! through memory.

use crate::{
    Bvh, Statistics,
    kernel::{Kernel, Prepared},
    node::{LEAF, MAX_LEVELS, WIDTH},
};
use umbrage_geom::{Ray, kernel::LANES, segment_hits_triangle};

/// Rays in a packet.
pub(crate) const PACKET: usize = 16;

/// What packets need, kept from one to the next.
pub(crate) struct Scratch {
    prepared: Vec<Prepared>,
    /// Place of each prepared ray in the packet: rays that are not valid are left out.
    places: [u8; PACKET],
    /// Children to visit with the rays that enter them.
    stack: [(u32, u16); (WIDTH - 1) * MAX_LEVELS + 1],
}

impl Scratch {
    pub(crate) fn new() -> Self {
        Self {
            prepared: Vec::with_capacity(PACKET),
            places: [0; PACKET],
            stack: [(0, 0); (WIDTH - 1) * MAX_LEVELS + 1],
        }
    }
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

/// Answers up to [`PACKET`] rays.
#[inline(always)]
pub(crate) fn any_hits<K: Kernel, S: Statistics>(
    kernel: K,
    bvh: &Bvh,
    rays: &[Ray],
    hits: &mut [bool],
    scratch: &mut Scratch,
    stats: &mut S,
) {
    let Scratch { prepared, places, stack } = scratch;
    prepared.clear();
    for (place, (ray, hit)) in rays.iter().zip(hits.iter_mut()).enumerate().take(PACKET) {
        *hit = false;
        if let Some(ray) = Prepared::new(ray) {
            places[prepared.len()] = place as u8;
            prepared.push(ray);
        }
    }
    let prepared = &prepared[..];
    // Rays without a hit so far.
    let mut alive = ((1u32 << prepared.len()) - 1) as u16;
    let mut top = 1;
    stack[0] = (0, alive);
    while top > 0 {
        top -= 1;
        let (child, mask) = stack[top];
        let mut rest = mask & alive;
        if rest == 0 {
            continue;
        }
        if child & LEAF != 0 {
            let leaf = (child & !LEAF) as usize;
            alive &= !leaf_hits(kernel, bvh, leaf, rest, prepared, rays, places, stats);
            continue;
        }
        let node = &bvh.tree.nodes[child as usize];
        // Bytes are rays, bits children; the first eight rays and the others.
        let (mut rows, mut entered) = ([0u64; 2], 0);
        while rest != 0 {
            let r = rest.trailing_zeros() as usize;
            rest &= rest - 1;
            let ray = &prepared[r].node;
            let children = kernel.mask(node, ray, ray.slab.tfar);
            stats.node(node.len() as u32);
            entered |= children;
            rows[r / 8 % 2] |= u64::from(children) << (r % 8 * 8);
        }
        let columns = rows.map(transpose);
        // Small boxes first on to the stack, so that large ones are visited first.
        while entered != 0 {
            let slot = (31 - entered.leading_zeros()) as usize % WIDTH;
            entered &= !(1 << slot);
            let column = |half: usize| (columns[half] >> (8 * slot)) as u16 & 0xff;
            stack[top] = (node.children[slot], column(0) | column(1) << 8);
            top += 1;
        }
    }
    let dead = !alive;
    for (r, &place) in places.iter().enumerate().take(prepared.len()) {
        hits[place as usize] = dead >> r & 1 == 1;
    }
}

/// Which of the rays in `rest` hit a triangle of the leaf.
#[inline(always)]
#[allow(clippy::too_many_arguments)] // the state of one loop
fn leaf_hits<K: Kernel, S: Statistics>(
    kernel: K,
    bvh: &Bvh,
    leaf: usize,
    mut rest: u16,
    prepared: &[Prepared],
    rays: &[Ray],
    places: &[u8; PACKET],
    stats: &mut S,
) -> u16 {
    let block = &bvh.blocks[leaf];
    let mut hits = 0;
    while rest != 0 {
        let r = rest.trailing_zeros() as usize;
        rest &= rest - 1;
        let mask = kernel.filter(block, &prepared[r].block);
        stats.triangles(bvh.blocks[leaf].len() as u32);
        stats.uncertain(mask.uncertain.count_ones());
        let mut hit = mask.certain != 0;
        let mut open = mask.uncertain;
        while open != 0 && !hit {
            let lane = open.trailing_zeros() as usize % LANES;
            open &= open - 1;
            hit = segment_hits_triangle(&rays[places[r] as usize], block.get(lane));
        }
        hits |= u16::from(hit) << r;
    }
    hits
}

#[cfg(test)]
mod tests {
    use super::transpose;

    #[test]
    fn transposing_swaps_rows_and_columns() {
        for r in 0..8 {
            for c in 0..8 {
                assert_eq!(transpose(1 << (8 * r + c)), 1 << (8 * c + r));
            }
        }
        assert_eq!(transpose(transpose(0x0123_4567_89ab_cdef)), 0x0123_4567_89ab_cdef);
    }
}
