//! The scene files that ship with the repository can be read.

use std::path::Path;
use umbrage_scene::Scene;

#[test]
fn all_load() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../scenes");
    let mut names = Vec::new();
    for entry in std::fs::read_dir(&folder).unwrap() {
        let path = entry.unwrap().path();
        if path.extension().is_some_and(|e| e == "toml") {
            let scene = Scene::load(&path).unwrap_or_else(|e| panic!("{e}"));
            assert!(!scene.lights.is_empty() && scene.bounds().diagonal() > 0.0, "{}", path.display());
            names.push(path.file_stem().unwrap().to_string_lossy().into_owned());
        }
    }
    for name in [
        "grove",
        "bush",
        "stage",
        "city",
        "cathedral",
        "hairball",
        "knots",
        "dragonish",
        "instances",
        "lights",
    ] {
        assert!(names.iter().any(|n| n == name), "{name}.toml is missing");
    }
}
