//! Small fixed scenes against stored images.
//!
//! A pixel differs if a layer's value is off by more than 1e-3 of 1 plus its size; at most one pixel in 500 may differ, for
//! machines whose `tan` or `exp` differ in the last bit and move a sample across an edge. On one machine none does.
//! `UMBRAGE_BLESS=1` (`cargo xtask golden --bless`) stores what is rendered now.

use std::{
    fs,
    path::{Path, PathBuf},
};
use umbrage_image::compare::{CompareOptions, DifferencePicture, write_difference};
use umbrage_image::{Film, read_exr, write_exr};
use umbrage_query::Occluders;
use umbrage_query::subdivide;
use umbrage_render::{RenderOptions, render};
use umbrage_scene::{Scene, Settings, read_polygons};

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("golden")
}

/// Pixels of a layer that differ by more than the tolerance.
fn different_pixels(stored: &Film, actual: &Film, layer: &str) -> usize {
    let (a, b) = (stored.require(layer).unwrap(), actual.require(layer).unwrap());
    (0..stored.pixels())
        .filter(|&i| a.pixel(i).iter().zip(b.pixel(i)).any(|(a, b)| (a - b).abs() > 1e-3 * (1.0 + a.abs())))
        .count()
}

fn check(name: &str) {
    check_scene(name, &Scene::load(&folder().join(name).with_extension("toml")).unwrap());
}

fn check_scene(name: &str, scene: &Scene) {
    let occluders = Occluders::of_scene(scene, &mut |_| true).unwrap();
    let actual = render(scene, &occluders, &RenderOptions::default(), &mut |_| true).unwrap().film;
    let path = folder().join(name).with_extension("exr");
    if std::env::var_os("UMBRAGE_BLESS").is_some() {
        write_exr(&path, &actual).unwrap();
        println!("stored {}", path.display());
        return;
    }
    let stored =
        read_exr(&path).unwrap_or_else(|e| panic!("{e}; `cargo xtask golden --bless` stores an image"));
    assert!(stored.same_shape(&actual), "{name}: size or layers are not those stored");
    let limit = stored.pixels() / 500;
    let differing: Vec<(&str, usize)> = stored
        .layers()
        .iter()
        .map(|layer| (layer.name(), different_pixels(&stored, &actual, layer.name())))
        .filter(|&(_, count)| count > limit)
        .collect();
    if !differing.is_empty() {
        let left = Path::new(env!("CARGO_TARGET_TMPDIR")).join("golden");
        fs::create_dir_all(&left).unwrap();
        let (exr, png) = (left.join(format!("{name}.exr")), left.join(format!("{name}-difference.png")));
        write_exr(&exr, &actual).unwrap();
        write_difference(&png, &stored, &actual, &CompareOptions::default(), DifferencePicture::Flip)
            .unwrap();
        panic!(
            "{name}: too many different pixels: {differing:?}; see {} and {}",
            exr.display(),
            png.display()
        );
    }
}

#[test]
fn lights() {
    check("lights");
}

#[test]
fn leaves() {
    check("leaves");
}

#[test]
fn cathedral() {
    check("cathedral");
}

/// A Catmull-Clark surface with boundaries between faces of three and four corners, creases and a tip, as `render --subdivide`
/// shows it.
#[test]
fn surface() {
    let control = read_polygons(&folder().join("surface.obj")).unwrap();
    let size = |settings: &mut Settings| (settings.width, settings.height, settings.spp) = (96, 72, 4);
    let scene = subdivide::scene_around("surface", &control, 1.0, size, &mut |_| true);
    check_scene("surface", &scene.unwrap());
}
