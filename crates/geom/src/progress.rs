//! Progress of long calls, which the caller may cancel.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

/// A long call was stopped by its progress callback; nothing it made may be used.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("cancelled")]
pub struct Cancelled;

/// Counts finished work over threads and reports it to a callback as a fraction.
///
/// The callback gets a number that never shrinks and ends at exactly 1, and returns `false` to cancel. It may be called
/// from any thread, but never by two at once.
pub struct Progress<'a> {
    callback: Option<std::sync::Mutex<State<'a>>>,
    total: u64,
    done: AtomicU64,
    cancelled: AtomicBool,
}

struct State<'a> {
    report: &'a mut (dyn FnMut(f32) -> bool + Send),
    reported: u64,
}

impl<'a> Progress<'a> {
    /// Progress of `total` units of work, reported to `callback`.
    pub fn new(total: u64, callback: &'a mut (dyn FnMut(f32) -> bool + Send)) -> Self {
        let state = State { report: callback, reported: 0 };
        Self { callback: Some(state.into()), total, done: 0.into(), cancelled: false.into() }
    }

    /// Progress that nobody watches and nobody cancels.
    pub fn silent() -> Self {
        Self { callback: None, total: 0, done: 0.into(), cancelled: false.into() }
    }

    /// Adds `units` of finished work.
    ///
    /// # Errors
    /// [`Cancelled`] once the callback has returned `false`; the caller should stop soon.
    pub fn advance(&self, units: u64) -> Result<(), Cancelled> {
        let Some(callback) = &self.callback else { return Ok(()) };
        let done = self.done.fetch_add(units, Ordering::Relaxed) + units;
        let mut state = callback.lock().unwrap_or_else(|poisoned| poisoned.into_inner());
        // 1 is kept for `finish`, so that a caller sees it only when the call has succeeded.
        if done > state.reported && done < self.total {
            state.reported = done;
            if !(state.report)((done as f64 / self.total as f64) as f32) {
                self.cancelled.store(true, Ordering::Relaxed);
            }
        }
        drop(state);
        self.check()
    }

    /// Asks the callback again whether to go on, within a long unit of work. Skipped while another thread asks.
    ///
    /// # Errors
    /// [`Cancelled`] once the callback has returned `false`.
    pub fn poll(&self) -> Result<(), Cancelled> {
        if let Some(callback) = &self.callback
            && let Ok(mut state) = callback.try_lock()
            && state.reported < self.total
        {
            let fraction = (state.reported as f64 / self.total as f64) as f32;
            if !(state.report)(fraction) {
                self.cancelled.store(true, Ordering::Relaxed);
            }
        }
        self.check()
    }

    /// Whether work should go on.
    ///
    /// # Errors
    /// [`Cancelled`] once the callback has returned `false`.
    pub fn check(&self) -> Result<(), Cancelled> {
        if self.cancelled.load(Ordering::Relaxed) { Err(Cancelled) } else { Ok(()) }
    }

    /// Reports exactly 1.
    ///
    /// # Errors
    /// [`Cancelled`] if the callback has returned `false`, now or before.
    pub fn finish(self) -> Result<(), Cancelled> {
        self.check()?;
        match self.callback {
            None => Ok(()),
            Some(callback) => {
                let state = callback.into_inner().unwrap_or_else(|poisoned| poisoned.into_inner());
                if (state.report)(1.0) { Ok(()) } else { Err(Cancelled) }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_long_unit_can_be_cancelled() {
        let mut seen = Vec::new();
        let mut callback = |f| {
            seen.push(f);
            seen.len() < 3
        };
        let progress = Progress::new(4, &mut callback);
        progress.advance(1).unwrap();
        progress.poll().unwrap();
        assert!(progress.poll().is_err() && progress.check().is_err() && progress.finish().is_err());
        assert_eq!(seen, [0.25; 3]);
    }

    #[test]
    fn fractions_grow_and_end_at_one() {
        let mut seen = Vec::new();
        let mut callback = |f| {
            seen.push(f);
            true
        };
        let progress = Progress::new(3, &mut callback);
        (0..3).for_each(|_| progress.advance(1).unwrap());
        progress.finish().unwrap();
        assert_eq!(seen, [1.0 / 3.0, 2.0 / 3.0, 1.0]);
    }

    #[test]
    fn a_false_cancels_for_good() {
        let mut callback = |f: f32| f < 0.5;
        let progress = Progress::new(4, &mut callback);
        assert_eq!(progress.advance(1), Ok(()));
        assert_eq!(progress.advance(1), Err(Cancelled));
        assert_eq!(progress.advance(1), Err(Cancelled));
        assert_eq!(progress.finish(), Err(Cancelled));
    }
}
