//! Builds tell how far they have come, and end when they are told to.

use umbrage_aomask::PatternOptions;
use umbrage_query::{AoMethod, Occluders, QueryError, ShadowMethod, Sky, engine, subdivide};
use umbrage_scene::Scene;

const SCENE: &str = r#"
    camera = { position = [3, 4, 6], target = [0, 0, 0] }
    image = { width = 32, height = 24 }
    methods = { surfaces = "SURFACES" }
    meshes.cube = { generator = "cube-sphere", subdivide = { pixels = 2 } }
    meshes.star = { generator = "star-tube", subdivide = { level = 2 } }
    [[objects]]
    mesh = "cube"
    transforms = [{}, { translate = [3, 0, 0] }]
    [[objects]]
    mesh = "star"
    translate = [0, 0, -3]
    [[objects]]
    mesh = { generator = "bush", triangles = 1000 }
    [[objects]]
    mesh = { generator = "plane", width = 12, depth = 12 }
"#;

fn scene(surfaces: &str) -> Scene {
    Scene::parse(&SCENE.replace("SURFACES", surfaces), "".as_ref()).unwrap()
}

/// Runs `build` to its end, which must get growing fractions that end at 1 if there are any, and cancels it at some of its calls.
/// The number of calls.
fn check(what: &str, mut build: impl FnMut(engine::Report<'_>) -> Result<(), QueryError>) -> usize {
    let mut fractions = Vec::new();
    build(&mut |fraction| {
        fractions.push(fraction);
        true
    })
    .unwrap();
    let ends_at_one = fractions.last().is_none_or(|&last| last == 1.0);
    assert!(fractions.is_sorted() && ends_at_one, "{what}: {fractions:?}");
    let last = fractions.len().saturating_sub(1);
    for at in [0, last / 2, last].into_iter().filter(|&at| at < fractions.len()) {
        let mut calls = 0;
        let result = build(&mut |_| {
            calls += 1;
            calls <= at
        });
        assert!(matches!(result, Err(QueryError::Cancelled)), "{what}, call {at}: {result:?}");
    }
    fractions.len()
}

#[test]
fn occluders_can_be_cancelled() {
    for mode in ["once", "footprint"] {
        let calls = check(mode, |progress| Occluders::of_scene(&scene(mode), progress).map(drop));
        assert!(calls > 2, "{mode}: {calls}");
    }
}

#[test]
fn subdivision_can_be_cancelled() {
    assert!(check("refine", |progress| subdivide::refine(&mut scene("mesh"), progress)) > 10);
    let control = scene("mesh").meshes[0].subdivision.take().unwrap().control;
    check("scene_around", |progress| subdivide::scene_around("x", &control, 4.0, |_| (), progress).map(drop));
}

#[test]
fn engines_can_be_cancelled() {
    let mut scene = scene("mesh");
    subdivide::refine(&mut scene, &mut |_| true).unwrap();
    let occluders = || Occluders::of_scene(&scene, &mut |_| true).unwrap();
    for method in [ShadowMethod::Bvh, ShadowMethod::Kd, ShadowMethod::BvhVolumetric, ShadowMethod::Prefilter]
    {
        check(method.name(), |progress| engine::shadows(method, &occluders(), progress).map(drop));
    }
    let sky = Sky::new(PatternOptions::default().with_rays(16), f32::INFINITY);
    for &method in AoMethod::ALL.iter().filter(|&&method| method != AoMethod::MaskRaster) {
        let calls =
            check(method.name(), |progress| engine::sky(method, &occluders(), &sky, progress).map(drop));
        // Stored opacity, and the choice of how far masks are exact.
        assert!(method != AoMethod::MaskPrefilter || calls > 10, "{calls}");
    }
}
