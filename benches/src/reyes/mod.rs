//! Suite `reyes`: subdivision surfaces by ray footprint, as in Djeu 2011, chapter 6, and beyond.

mod cracks;
mod dice;
#[cfg(feature = "embree")]
mod embree;
mod figures;
mod frame;
mod pictures;
mod scenes;
mod study;

use crate::{
    peer::PeerName,
    rows::{Output, note},
};
use anyhow::Result;
use frame::Shadows;
use std::path::PathBuf;

/// What to run.
#[derive(Clone, Debug)]
pub struct Options {
    /// Smaller images, fewer passes.
    pub quick: bool,
    /// Only scenes whose name contains this.
    pub only: Option<String>,
    /// Pixels along a side of images.
    pub size: u32,
    /// Only figures whose name contains this.
    pub figure: Option<String>,
    /// Ray casters of others to measure against.
    pub peers: Vec<PeerName>,
    /// Folder for plots.
    pub plots: Option<PathBuf>,
    /// Folder for pictures, instead of rows.
    pub pictures: Option<PathBuf>,
}

/// Pixels along a side of images that many ways are compared on.
const COMPARISON_SIDE: u32 = 128;

impl Options {
    fn wants(&self, figure: &str) -> bool {
        self.figure.as_ref().is_none_or(|wanted| figure.contains(wanted.as_str()))
    }

    /// Pixels along a side: rays without width at their start cost many times as much.
    fn size_for(&self, shadows: Shadows) -> u32 {
        if shadows == Shadows::FromPixel { self.size } else { self.size.min(2 * COMPARISON_SIDE) / 2 }
    }

    /// Passes of frames: large ones take minutes each.
    fn passes(&self) -> usize {
        if self.quick || self.size > 2 * COMPARISON_SIDE { 1 } else { 3 }
    }
}

/// Runs the suite.
///
/// # Errors
/// If a mesh can't be read or a row not written.
pub fn run(options: &Options, output: &mut Output) -> Result<()> {
    if options.pictures.is_none() && options.only.is_none() {
        dice::run(options, output)?;
        if options.figure.as_deref() == Some(dice::NAME) {
            return Ok(());
        }
    }
    for scene in scenes::all()? {
        if options.only.as_ref().is_none_or(|only| scene.name.contains(only.as_str())) {
            note(scene.name);
            if let Some(folder) = &options.pictures {
                pictures::write(&scene, options.size, folder)?;
                continue;
            }
            // Against a peer, what is left of the reference's own error counts.
            let level = match scene.control.face_sizes.len() {
                // Few faces, which large images see up close.
                0..100 if options.size > 512 && !options.peers.is_empty() => 10,
                0..100 => 8,
                100..5000 if !options.peers.is_empty() => 6,
                100..5000 => 4,
                _ if !options.peers.is_empty() => 5,
                _ => 4,
            };
            figures::patches(&scene, options, output)?;
            let reference = frame::Reference::new(&scene, level)?;
            figures::run(&scene, options, &reference, output)?;
            study::run(&scene, options, &reference, output)?;
            study::cracks(&scene, options, &reference, output)?;
            if options.peers.contains(&PeerName::Embree) && options.wants("embree") {
                #[cfg(feature = "embree")]
                embree::run(&scene, options, &reference, output)?;
                #[cfg(not(feature = "embree"))]
                return Err(crate::peer::missing());
            }
        }
    }
    Ok(())
}
