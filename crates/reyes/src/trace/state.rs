//! What a thread keeps between rays.

use crate::{TraceOptions, mesh::dice::GridKey, mesh::grid::Grid, trace::cache};
use std::sync::Arc;
use umbrage_geom::glam::Vec3;

/// Bytes of a large grid, roughly.
const GRID_BYTES: usize = 2 << 10;
/// Most grids that a thread holds.
const MAX_GRIDS: usize = 1 << 10;
/// Borders whose points are remembered.
const MAX_BORDERS: usize = 1 << 12;
/// Patches whose rates are remembered during a ray.
const MEMO_PATCHES: usize = 64;

/// A thread's own memory of a tracer: grids it used lately, found without locking. Answers don't depend on it.
///
/// Belongs to the tracer that it was made for.
pub struct TraceState {
    pub(crate) grids: RecentGrids,
    pub(crate) levels: LevelMemo,
    pub(crate) occluder_hits: u64,
    pub(crate) grid_tests: u64,
    pub(crate) borders: RecentBorders,
    /// Patches to try, the next one last.
    pub(crate) deferred: Vec<u32>,
}

impl TraceState {
    /// For a tracer with these options.
    pub fn new(options: &TraceOptions) -> Self {
        let count = (options.cache_bytes / (16 * GRID_BYTES)).clamp(1, MAX_GRIDS);
        let count = if count.is_power_of_two() { count } else { count.next_power_of_two() / 2 };
        Self {
            grids: RecentGrids { slots: vec![None; count].into() },
            levels: LevelMemo::default(),
            occluder_hits: 0,
            grid_tests: 0,
            borders: RecentBorders::default(),
            deferred: Vec::new(),
        }
    }

    /// Shadow rays so far that opaque cells blocked.
    pub fn occluder_hits(&self) -> u64 {
        self.occluder_hits
    }

    /// Grids so far that rays were tested against.
    pub fn grid_tests(&self) -> u64 {
        self.grid_tests
    }

    /// A new ray begins.
    pub(crate) fn begin(&mut self) {
        self.levels.stamp = self.levels.stamp.wrapping_add(1);
        if self.levels.stamp == 0 {
            self.levels = LevelMemo::default();
        }
    }
}

type Recent = (GridKey, Arc<Grid>);

/// A direct-mapped cache.
pub(crate) struct RecentGrids {
    slots: Box<[Option<Recent>]>,
}

impl RecentGrids {
    pub(crate) fn get(&mut self, key: &GridKey, find: impl FnOnce() -> Arc<Grid>) -> &Grid {
        let index = cache::hash(key) as usize % self.slots.len();
        let slot = &mut self.slots[index];
        if slot.as_ref().is_none_or(|(known, _)| known != key) {
            *slot = None;
        }
        &slot.get_or_insert_with(|| (*key, find())).1
    }
}

/// Rates of patches as the current ray sees them.
pub(crate) struct LevelMemo {
    stamp: u32,
    slots: [(u32, u32, Option<[u8; 2]>); MEMO_PATCHES],
}

impl Default for LevelMemo {
    fn default() -> Self {
        Self { stamp: 1, slots: [(0, 0, None); MEMO_PATCHES] }
    }
}

impl LevelMemo {
    pub(crate) fn get(&self, patch: u32) -> Option<Option<[u8; 2]>> {
        let (stamp, known, levels) = self.slots[patch as usize % MEMO_PATCHES];
        (stamp == self.stamp && known == patch).then_some(levels)
    }

    pub(crate) fn set(&mut self, patch: u32, levels: Option<[u8; 2]>) {
        self.slots[patch as usize % MEMO_PATCHES] = (self.stamp, patch, levels);
    }
}

/// Patch, depth, place and edge of a part's border.
type BorderKey = (u32, u8, [u16; 2], u8);

/// Points of borders that were looked at lately, direct-mapped; empty until it is used.
#[derive(Default)]
pub(crate) struct RecentBorders {
    slots: Vec<Option<(BorderKey, [Vec3; 5])>>,
}

impl RecentBorders {
    pub(crate) fn get(&mut self, key: BorderKey, make: impl FnOnce() -> [Vec3; 5]) -> [Vec3; 5] {
        self.slots.resize(MAX_BORDERS, None);
        let slot = &mut self.slots[cache::hash(&key) as usize % MAX_BORDERS];
        match slot {
            Some((known, points)) if *known == key => *points,
            _ => slot.insert((key, make())).1,
        }
    }
}
