//! File types, and writing that never leaves half a file.

use super::{Film, ImageError, names, openexr, png};
use std::{io::Write as _, path::Path};

/// Types of image files.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Format {
    /// OpenEXR: all layers, linear floats.
    Exr,
    /// PNG: one picture, 8-bit sRGB.
    Png,
}

impl Format {
    /// The type that the extension names, in either case.
    ///
    /// # Errors
    /// [`ImageError::Extension`] if it is none of them.
    pub fn of(path: &Path) -> Result<Self, ImageError> {
        let extension = path.extension().and_then(|e| e.to_str()).unwrap_or("").to_ascii_lowercase();
        match extension.as_str() {
            "exr" => Ok(Self::Exr),
            "png" => Ok(Self::Png),
            _ => Err(ImageError::Extension { path: path.into() }),
        }
    }
}

/// Writes `film` as its file name says, atomically: EXR with all layers, PNG with the beauty brightened by `exposure`
/// stops.
///
/// # Errors
/// Those of [`write_exr`](super::write_exr) and [`write_png`](super::write_png); [`ImageError::Extension`].
pub fn write(path: &Path, film: &Film, exposure: f32) -> Result<(), ImageError> {
    match Format::of(path)? {
        Format::Exr => openexr::write_exr(path, film),
        Format::Png => png::write_png(path, film, names::BEAUTY, exposure),
    }
}

/// Reads an image as its file name says.
///
/// # Errors
/// Those of [`read_exr`](super::read_exr) and [`read_png`](super::read_png); [`ImageError::Extension`].
pub fn read(path: &Path) -> Result<Film, ImageError> {
    match Format::of(path)? {
        Format::Exr => openexr::read_exr(path),
        Format::Png => png::read_png(path),
    }
}

/// Checks that an image can be written to `path` later, and says as what: the extension is known, the folder exists and
/// takes files, and `path` is no folder or read-only file. Leaves nothing behind.
///
/// # Errors
/// [`ImageError::Extension`], [`ImageError::Folder`], [`ImageError::IsFolder`], [`ImageError::Io`].
pub fn check_writable(path: &Path) -> Result<Format, ImageError> {
    let format = Format::of(path)?;
    check_folder(path)?;
    umbrage_scene::check_writable(path)
        .map_err(|e| ImageError::Io { path: path.into(), source: e.source })?;
    Ok(format)
}

/// Like [`check_writable`], for a part file.
///
/// # Errors
/// Those of [`check_writable`] and [`ImageError::PartExtension`].
pub fn check_part_writable(path: &Path) -> Result<(), ImageError> {
    match check_writable(path)? {
        Format::Exr => Ok(()),
        _ => Err(ImageError::PartExtension { path: path.into() }),
    }
}

/// Replaces the file at `path` in one step, so that readers see the old or the new content and a failure keeps the old.
pub(super) fn write_bytes(path: &Path, bytes: &[u8]) -> Result<(), ImageError> {
    check_folder(path)?;
    let written = umbrage_scene::write_atomically(path, |file| file.write_all(bytes));
    written.map_err(|e| ImageError::Io { path: path.into(), source: e.source })
}

pub(super) fn read_bytes(path: &Path) -> Result<Vec<u8>, ImageError> {
    std::fs::read(path).map_err(|source| ImageError::Io { path: path.into(), source })
}

/// An error if the folder that the file is to go to is not there, or the file itself is a folder.
fn check_folder(path: &Path) -> Result<(), ImageError> {
    if path.is_dir() {
        return Err(ImageError::IsFolder { path: path.into() });
    }
    let target = std::fs::canonicalize(path).unwrap_or_else(|_| path.into());
    let folder = match target.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent.to_path_buf(),
        _ => ".".into(),
    };
    if folder.is_dir() { Ok(()) } else { Err(ImageError::Folder { path: path.into(), folder }) }
}
