//! Engines that remember something from ray to ray: the rays of one tile have a memory of their own.
//!
//! Memories make rays faster and change no answer, but they change how much work a ray takes. Where work is counted, each tile
//! starts with an empty memory, so that counts depend on neither threads nor shards.

use super::{Engine, LightRay};
use crate::QueryError;
use std::sync::{Mutex, MutexGuard};
use umbrage_accel::Counters;

/// An engine that remembers something from ray to ray.
pub(super) trait Remembers: Sync {
    /// What it remembers.
    type Memory: Send;

    /// See [`Engine::name`].
    fn name(&self) -> &'static str;

    /// Memories that no tile uses at the moment.
    fn memories(&self) -> &Mutex<Vec<Self::Memory>>;

    /// An empty memory.
    fn fresh(&self) -> Self::Memory;

    /// See [`Engine::transmittances`].
    fn trace(
        &self,
        rays: &[LightRay],
        light: Option<usize>,
        passed: &mut [f32],
        counters: Option<&mut Counters>,
        memory: &mut Self::Memory,
    );
}

/// The rays of one tile.
pub(super) struct Tile<'e, E: Remembers + ?Sized> {
    engine: &'e E,
    counted: bool,
    /// Taken out when the tile is done.
    memory: Mutex<Option<E::Memory>>,
}

impl<'e, E: Remembers + ?Sized> Tile<'e, E> {
    /// Goes on with what an earlier tile remembered, unless work is counted.
    pub(super) fn new(engine: &'e E, counted: bool) -> Self {
        let known = if counted { None } else { locked(engine.memories()).pop() };
        Self { engine, counted, memory: Mutex::new(Some(known.unwrap_or_else(|| engine.fresh()))) }
    }
}

impl<E: Remembers + ?Sized> Drop for Tile<'_, E> {
    fn drop(&mut self) {
        if !self.counted {
            locked(self.engine.memories()).extend(locked(&self.memory).take());
        }
    }
}

impl<E: Remembers + ?Sized> Engine for Tile<'_, E> {
    fn name(&self) -> &'static str {
        self.engine.name()
    }

    fn transmittances(
        &self,
        rays: &[LightRay],
        light: Option<usize>,
        passed: &mut [f32],
        counters: Option<&mut Counters>,
    ) -> Result<(), QueryError> {
        let mut memory = locked(&self.memory);
        let memory = memory.get_or_insert_with(|| self.engine.fresh());
        self.engine.trace(rays, light, passed, counters, memory);
        Ok(())
    }
}

fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(|poisoned| poisoned.into_inner())
}
