//! Grids kept within a budget of bytes, shared by threads.
//!
//! A grid depends on its key alone and lives as long as somebody holds it, so eviction costs time and never an answer.

use crate::{mesh::dice::GridKey, mesh::grid::Grid};
use std::{
    collections::{HashMap, VecDeque},
    hash::{BuildHasherDefault, Hash, Hasher},
    sync::{
        Arc, Mutex, MutexGuard,
        atomic::{AtomicUsize, Ordering::Relaxed},
    },
};

/// Bytes from which the cache is divided so that threads rarely wait for each other.
const MIN_DIVIDED_BYTES: usize = 1 << 20;
const DIVISIONS: usize = 16;

/// A multiplicative hash; keys are small integers.
#[derive(Default)]
pub(crate) struct KeyHasher(u64);

impl Hasher for KeyHasher {
    fn finish(&self) -> u64 {
        self.0 ^ self.0 >> 29
    }

    fn write(&mut self, bytes: &[u8]) {
        bytes.iter().for_each(|&b| self.write_u64(b.into()));
    }

    fn write_u8(&mut self, x: u8) {
        self.write_u64(x.into());
    }

    fn write_u16(&mut self, x: u16) {
        self.write_u64(x.into());
    }

    fn write_u32(&mut self, x: u32) {
        self.write_u64(x.into());
    }

    fn write_u64(&mut self, x: u64) {
        self.0 = (self.0.rotate_left(23) ^ x).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    }

    fn write_usize(&mut self, x: usize) {
        self.write_u64(x as u64);
    }
}

pub(crate) fn hash(key: &impl Hash) -> u64 {
    let mut hasher = KeyHasher::default();
    key.hash(&mut hasher);
    hasher.finish()
}

struct Slot {
    grid: Arc<Grid>,
    bytes: usize,
    /// Asked for since it last was the oldest.
    used: bool,
}

#[derive(Default)]
struct Division {
    slots: HashMap<GridKey, Slot, BuildHasherDefault<KeyHasher>>,
    /// Oldest first.
    order: VecDeque<GridKey>,
    bytes: usize,
}

/// See the [module](self).
pub(crate) struct GridCache {
    shards: Box<[Mutex<Division>]>,
    /// Of each shard.
    budget: usize,
    bytes: AtomicUsize,
    peak: AtomicUsize,
    pub(crate) evicted: AtomicUsize,
}

/// Bytes that a slot takes beside its grid: key twice, slot, and room to grow.
const SLOT_BYTES: usize = 2 * size_of::<GridKey>() + size_of::<Slot>() + 24;

impl GridCache {
    pub(crate) fn new(budget: usize) -> Self {
        let count = if budget >= MIN_DIVIDED_BYTES { DIVISIONS } else { 1 };
        Self {
            shards: (0..count).map(|_| Mutex::default()).collect(),
            budget: budget / count,
            bytes: 0.into(),
            peak: 0.into(),
            evicted: 0.into(),
        }
    }

    fn shard(&self, key: &GridKey) -> MutexGuard<'_, Division> {
        let shard = &self.shards[(hash(key) >> 48) as usize % self.shards.len()];
        // A panic elsewhere leaves no slot half made.
        shard.lock().unwrap_or_else(|poisoned| poisoned.into_inner())
    }

    /// The grid of `key`, made by `make` if it is not there.
    pub(crate) fn get(&self, key: &GridKey, make: impl FnOnce() -> Grid) -> Arc<Grid> {
        if let Some(slot) = self.shard(key).slots.get_mut(key) {
            slot.used = true;
            return Arc::clone(&slot.grid);
        }
        // Made without the lock: others may make the same, which has the same bits.
        let grid = Arc::new(make());
        let bytes = grid.bytes() + SLOT_BYTES;
        if bytes > self.budget {
            return grid;
        }
        let mut shard = self.shard(key);
        let before = shard.bytes;
        while shard.bytes + bytes > self.budget {
            self.evict(&mut shard);
        }
        let slot = Slot { grid: Arc::clone(&grid), bytes, used: false };
        match shard.slots.insert(*key, slot) {
            Some(old) => shard.bytes -= old.bytes,
            None => shard.order.push_back(*key),
        }
        shard.bytes += bytes;
        let after = shard.bytes;
        // Under the lock, so that each division has told of no more than its budget at any time, and so have all together.
        let total = if after >= before {
            self.bytes.fetch_add(after - before, Relaxed) + (after - before)
        } else {
            self.bytes.fetch_sub(before - after, Relaxed) - (before - after)
        };
        self.peak.fetch_max(total, Relaxed);
        drop(shard);
        grid
    }

    /// Drops the oldest grid that was not asked for lately.
    fn evict(&self, shard: &mut Division) {
        while let Some(key) = shard.order.pop_front() {
            let Some(slot) = shard.slots.get_mut(&key) else { continue };
            if std::mem::take(&mut slot.used) {
                shard.order.push_back(key);
                continue;
            }
            shard.bytes -= slot.bytes;
            shard.slots.remove(&key);
            self.evicted.fetch_add(1, Relaxed);
            return;
        }
    }

    /// Most bytes held at any time.
    pub(crate) fn peak_bytes(&self) -> usize {
        self.peak.load(Relaxed)
    }
}
