//! Renders the pictures of the docs: every scene in `docs/pictures`, and the grove of the README.

use crate::{cargo, root, run};
use anyhow::{Context, Result};

/// Renders those whose name contains `only`.
pub fn run_all(only: Option<&str>) -> Result<()> {
    let folder = root().join("docs/pictures");
    let entries = folder.read_dir().with_context(|| folder.display().to_string())?;
    let mut scenes: Vec<_> = entries.map(|entry| Ok(entry?.path())).collect::<Result<_>>()?;
    scenes.retain(|path| path.extension().is_some_and(|e| e == "toml"));
    scenes.push(root().join("scenes/grove.toml"));
    scenes.sort();
    for scene in scenes {
        let name = scene.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        if only.is_some_and(|only| !name.contains(only)) {
            continue;
        }
        let output = root().join("docs/images").join(&name).with_extension("png");
        run(cargo(&["run", "--release", "--locked", "--quiet", "--", "render"])
            .arg(&scene)
            .arg("-o")
            .arg(&output))?;
    }
    Ok(())
}
