//! Plots beside rows.

use anyhow::{Context, Result};
use std::path::Path;
pub use umbrage_study::plot::Series;
use umbrage_study::plot::{Legend, svg};

/// Writes the plot of `series` to `folder`, which is made if it is missing.
pub fn save(folder: &Path, file: &str, title: &str, labels: [&str; 2], series: &[Series]) -> Result<()> {
    std::fs::create_dir_all(folder).with_context(|| folder.display().to_string())?;
    let path = folder.join(file);
    std::fs::write(&path, svg(title, labels, series, &[], Legend::Right))
        .with_context(|| path.display().to_string())
}
