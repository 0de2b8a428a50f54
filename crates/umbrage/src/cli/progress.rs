//! A progress bar on a terminal, and Ctrl-C.

use super::Interrupted;
use anyhow::Result;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::sync::{
    OnceLock,
    atomic::{AtomicBool, Ordering},
};

/// Set once by Ctrl-C; the process has one signal handler, so this can't belong to anything smaller.
static INTERRUPTED: OnceLock<&'static AtomicBool> = OnceLock::new();

/// Shows how far a long call has come (on a terminal only) and ends it on Ctrl-C.
pub struct Bar {
    bar: ProgressBar,
    interrupted: &'static AtomicBool,
}

impl Bar {
    /// A bar labelled `what`. From now on Ctrl-C ends the call instead of the process.
    pub fn new(what: &'static str) -> Result<Self> {
        let interrupted = match INTERRUPTED.get() {
            Some(flag) => flag,
            None => {
                let flag: &'static AtomicBool = Box::leak(Box::new(AtomicBool::new(false)));
                ctrlc::set_handler(|| flag.store(true, Ordering::Relaxed))?;
                INTERRUPTED.get_or_init(|| flag)
            }
        };
        let style = ProgressStyle::with_template("{msg} {wide_bar} {percent}% {eta}")?;
        // Hidden by itself where standard error is no terminal.
        let bar = ProgressBar::with_draw_target(Some(1000), ProgressDrawTarget::stderr());
        bar.set_style(style);
        bar.set_message(what);
        Ok(Self { bar, interrupted })
    }

    /// The callback for a library call.
    pub fn report(&mut self, fraction: f32) -> bool {
        self.bar.set_position((fraction * 1000.0) as u64);
        !self.interrupted.load(Ordering::Relaxed)
    }

    /// Takes the bar away.
    pub fn finish(self) {
        self.bar.finish_and_clear();
    }

    /// Fails if Ctrl-C was pressed, between calls that can't be cancelled.
    ///
    /// # Errors
    /// [`Interrupted`].
    pub fn check(&self) -> Result<()> {
        if self.interrupted.load(Ordering::Relaxed) { Err(Interrupted.into()) } else { Ok(()) }
    }
}
