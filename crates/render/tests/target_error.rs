//! A target error is met, and not by far: pictures against the same surfaces with many more samples.

use std::{fs, path::Path};
use umbrage_image::Film;
use umbrage_query::Occluders;
use umbrage_render::{RenderError, RenderOptions, Rendered, render};
use umbrage_scene::Scene;

/// Blobs and leaves on a ground that fills the picture, below a wide lamp and a sky.
const SCENE: &str = r#"
[image]
width = 48
height = 36
spp = 2
[camera]
position = [0.5, 6, 3]
target = [0, 0, 0]
fov = 40
[ambient]
radiance = 0.4
radius = "RADIUS"
[methods]
ao = "AO"
[[objects]]
mesh = { generator = "plane", width = 40, depth = 40 }
[[objects]]
mesh = { generator = "blob", triangles = 2000 }
translate = [-0.8, 0.5, 0]
[[objects]]
mesh = { generator = "bush", triangles = 3000 }
translate = [1, 0, 0.3]
[[lights]]
type = "sphere"
center = [2, 5, -1]
radius = 0.8
radiance = 30
"#;

fn scene(folder: &Path, radius: &str, ao: &str) -> Scene {
    let path = folder.join("scene.toml");
    fs::write(&path, SCENE.replace("RADIUS", radius).replace("AO", ao)).unwrap();
    Scene::load(&path).unwrap()
}

fn picture(scene: &Scene, target: Option<f32>) -> Result<Rendered, RenderError> {
    let occluders = Occluders::of_scene(scene, &mut |_| true).unwrap();
    render(scene, &occluders, &RenderOptions::default().with_target_error(target), &mut |_| true)
}

fn rmse(a: &Film, b: &Film, layer: &str) -> f64 {
    let values = |film: &Film| film.layer(layer).unwrap().values().to_vec();
    let (a, b) = (values(a), values(b));
    let squares = a.iter().zip(&b).map(|(a, b)| f64::from(a - b).powi(2));
    (squares.sum::<f64>() / a.len() as f64).sqrt()
}

#[test]
fn targets_are_met_by_sky_and_lights() {
    let folder = tempfile::tempdir().unwrap();
    for (radius, ao) in [("100%", "mask"), ("10%", "rays")] {
        let mut many = scene(folder.path(), radius, ao);
        (many.settings.shadow_samples, many.settings.ao_samples) = (1024, 1024);
        let truth = picture(&many, None).unwrap().film;
        let mut last = u64::MAX;
        for target in [0.02, 0.04] {
            let rendered = picture(&scene(folder.path(), radius, ao), Some(target)).unwrap();
            let samples = rendered.samples.unwrap();
            for (layer, estimate) in [("shadow", samples.shadow_error), ("ao", samples.ao_error)] {
                let error = rmse(&rendered.film, &truth, layer);
                println!("{ao} {radius} {target} {layer}: {error:.4}, expected {estimate:?}, {samples:?}");
                // Eight rays may be more than the target asks for.
                let least = if layer == "ao" && samples.ao == 8 { 0.2 } else { 0.5 };
                let target = f64::from(target);
                assert!(error < 1.05 * target && error > least * target, "{layer}: {error} for {target}");
                assert!((estimate.unwrap() / error - 1.0).abs() < 0.5, "{layer}: {error}, {estimate:?}");
            }
            let rays = rendered.rays.shadow + rendered.rays.ambient;
            assert!(rays < last);
            last = rays;
        }
    }
}

#[test]
fn what_can_not_be_aimed_at_is_an_error() {
    let folder = tempfile::tempdir().unwrap();
    for target in [0.0, -1.0, f32::NAN] {
        let refused = picture(&scene(folder.path(), "10%", "mask"), Some(target));
        assert!(matches!(refused, Err(RenderError::TargetError(_))));
    }
    let refused = picture(&scene(folder.path(), "10%", "prefilter"), Some(0.1));
    assert!(matches!(refused, Err(RenderError::TargetError(_))));
}
