//! Which nodes get solid boxes, and which.
//!
//! A pack of eight costs a ray as much as one more node, so a node gets one where it stops enough of the rays that come so far.
//! That is asked of random lines through the node.

use crate::volumetric::{boxes::BoxPack, carve};
use umbrage_accel::{Bvh, Child, SolidPack};
use umbrage_geom::{Aabb, SlabRay};

/// Lines through a node.
const LINES: usize = 512;

/// Most boxes that a node chooses from: those of which most lies inside.
const CANDIDATES: usize = 64;

/// Least share of the lines not stopped further up that a pack must stop.
const MIN_PACK_SHARE: f32 = 0.1;

/// Least share of them that a box must stop.
const MIN_BOX_SHARE: f32 = 0.004;

/// Least area of the part of a box inside of a node, relative to the node's, or
const MIN_AREA_OF_NODE: f32 = 0.02;

/// relative to the box's.
const MIN_AREA_OF_BOX: f32 = 0.25;

/// Levels that are looked at: further down, triangles are as good.
const LEVELS: usize = 10;

/// The solid boxes of a node.
pub(super) struct Place {
    pub(super) node: u32,
    pub(super) solids: Vec<u32>,
    /// Index of the first place on the way from the root.
    pub(super) top: u32,
}

struct Chooser<'a> {
    bvh: &'a Bvh,
    solids: &'a [Aabb],
    /// Solid boxes on the way from the root.
    above: Vec<u32>,
    /// The first place on the way.
    top: Option<u32>,
    places: Vec<Place>,
}

/// Places for `solids` in `bvh`, from the root down; none twice on a way.
pub(super) fn choose(bvh: &Bvh, solids: &[Aabb]) -> Vec<Place> {
    let mut chooser = Chooser { bvh, solids, above: Vec::new(), top: None, places: Vec::new() };
    if !solids.is_empty() {
        chooser.visit(0, &bvh.bounds(), (0..solids.len() as u32).collect(), 0);
    }
    chooser.places
}

fn common_area(a: &Aabb, b: &Aabb) -> f32 {
    Aabb { min: a.min.max(b.min), max: a.max.min(b.max) }.area()
}

/// Which of the `lines` each of `solids` stops, a bit each.
fn stops(solids: &[Aabb], of: &[u32], lines: &[SlabRay]) -> Vec<[u64; LINES / 64]> {
    let mut stops = vec![[0u64; LINES / 64]; of.len()];
    for (chunk, bits) in of.chunks(8).zip(stops.chunks_mut(8)) {
        let mut pack = BoxPack::<8>::EMPTY;
        chunk.iter().enumerate().for_each(|(i, &solid)| pack.set(i, &solids[solid as usize]));
        for (l, slab) in lines.iter().enumerate() {
            let crossed = u64::from(pack.surely_crossed(slab));
            bits.iter_mut().enumerate().for_each(|(i, b)| b[l / 64] |= (crossed >> i & 1) << (l % 64));
        }
    }
    stops
}

impl Chooser<'_> {
    fn visit(&mut self, node: u32, bounds: &Aabb, mut candidates: Vec<u32>, level: usize) {
        let inside = |solid: &u32| common_area(&self.solids[*solid as usize], bounds);
        let least = |solid: &u32| {
            f32::min(MIN_AREA_OF_NODE * bounds.area(), MIN_AREA_OF_BOX * self.solids[*solid as usize].area())
        };
        candidates.retain(|solid| inside(solid) > least(solid));
        candidates.sort_by(|a, b| inside(b).total_cmp(&inside(a)));
        if candidates.is_empty() {
            return;
        }
        let picked = self.pick(bounds, &candidates[..candidates.len().min(CANDIDATES)]);
        candidates.retain(|solid| !picked.contains(solid));
        self.above.extend(&picked);
        let (top, taken) = (self.top, picked.len());
        if taken > 0 {
            let top = *self.top.get_or_insert(self.places.len() as u32);
            self.places.push(Place { node, solids: picked, top });
        }
        if level + 1 < LEVELS {
            let bvh = self.bvh;
            for (aabb, child) in bvh.children(node) {
                if let Child::Node(child) = child {
                    self.visit(child, &aabb, candidates.clone(), level + 1);
                }
            }
        }
        self.above.truncate(self.above.len() - taken);
        self.top = top;
    }

    /// Greedily the boxes that stop most lines; none if all of them are not worth it.
    fn pick(&self, bounds: &Aabb, candidates: &[u32]) -> Vec<u32> {
        let lines = carve::lines(bounds, LINES);
        let mut open = [0u64; LINES / 64];
        (0..lines.len()).for_each(|l| open[l / 64] |= 1 << (l % 64));
        for stopped in stops(self.solids, &self.above, &lines) {
            open.iter_mut().zip(&stopped).for_each(|(open, stopped)| *open &= !stopped);
        }
        let count = |bits: &[u64; LINES / 64]| bits.iter().map(|b| b.count_ones()).sum::<u32>();
        let (stops, all) = (stops(self.solids, candidates, &lines), count(&open) as f32);
        let mut picked = Vec::new();
        let mut stopped = 0;
        while picked.len() < SolidPack::LANES {
            let gain =
                |bits: &[u64; LINES / 64]| bits.iter().zip(&open).map(|(a, b)| (a & b).count_ones()).sum();
            let gains = stops.iter().map(gain).enumerate();
            let Some((best, gain)) = gains.max_by_key(|&(i, gain): &(usize, u32)| (gain, usize::MAX - i))
            else {
                break;
            };
            if (gain as f32) < MIN_BOX_SHARE * all || gain == 0 {
                break;
            }
            open.iter_mut().zip(&stops[best]).for_each(|(open, stopped)| *open &= !stopped);
            stopped += gain;
            picked.push(candidates[best]);
        }
        if (stopped as f32) < MIN_PACK_SHARE * all {
            picked.clear();
        }
        picked
    }
}
