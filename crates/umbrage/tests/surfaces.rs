//! Subdivision surfaces by each ray's footprint and at rates chosen once, against their mesh.

use umbrage_testkit::Folder;

/// A cube with a sharp edge, on a ground of its own.
const CUBE: &str = "v -1 -1 -1\nv 1 -1 -1\nv -1 1 -1\nv 1 1 -1\nv -1 -1 1\nv 1 -1 1\nv -1 1 1\nv 1 1 1\n\
    f 2 4 8 6\nf 1 5 7 3\nf 3 7 8 4\nf 1 2 6 5\nf 5 6 8 7\nf 1 3 4 2\nt crease 2/1/0 6 7 4.0\n";

const SCENE: &str = r#"
camera = { position = [3, 4, 6], target = [0, 0, 0], fov = 40 }
image = { width = 64, height = 48, spp = 4 }
methods = { surfaces = "SURFACES", shadow_samples = 4, ao_samples = 8 }
ambient = { radiance = 0.3, radius = 2 }
[[lights]]
type = "sphere"
center = [3, 6, 2]
radius = 0.5
radiance = 60
[[objects]]
mesh = { file = "cube.obj", subdivide = { pixels = 1 } }
transforms = [{}, { translate = [1.6, -0.5, 1], rotate = [0, 30, 0], scale = [0.5, 0.6, 0.5] }, { scale = [-0.4, 0.4, 0.4], translate = [-2, -0.6, 1] }]
[[objects]]
mesh = { generator = "plane", width = 12, depth = 12 }
translate = [0, -1, 0]
"#;

fn folder() -> Folder {
    let folder = Folder::new(env!("CARGO_BIN_EXE_umbrage"), &[("cube.obj", CUBE)]);
    for mode in ["mesh", "once", "footprint"] {
        folder.write(&format!("{mode}.toml"), SCENE.replace("SURFACES", mode));
    }
    folder
}

/// RMSE of the layers beauty, shadow and ao.
fn errors(folder: &Folder, a: &str, b: &str) -> [f64; 3] {
    let comparison: serde_json::Value =
        serde_json::from_str(&folder.ok(&format!("compare {a} {b} --json"))).unwrap();
    let layers = comparison["layers"].as_array().unwrap();
    ["beauty", "shadow", "ao"].map(|name| {
        let layer = layers.iter().find(|layer| layer["layer"] == name).unwrap();
        layer["rmse"].as_f64().unwrap()
    })
}

#[test]
fn surfaces_look_like_their_mesh_however_they_are_traced() {
    let folder = folder();
    for mode in ["mesh", "once", "footprint"] {
        folder.ok(&format!(
            "render {mode}.toml -o {mode}.exr --ao rays --stats {mode}.json --heatmap {mode}.png"
        ));
    }
    // Micropolygons of a pixel: what differs are silhouettes and edges of shadows.
    for mode in ["once", "footprint"] {
        let [beauty, shadow, ao] = errors(&folder, "mesh.exr", &format!("{mode}.exr"));
        assert!(beauty < 0.01 && shadow < 0.01 && ao < 0.03, "{mode}: {beauty} {shadow} {ao}");
        assert!(beauty > 0.0, "{mode} is the mesh");
        let stats = folder.json(&format!("{mode}.json"));
        let surfaces = &stats["surfaces"];
        assert_eq!((surfaces["mode"].as_str(), surfaces["patches"].as_u64()), (Some(mode), Some(6)));
        assert!(surfaces["grids"].as_u64().unwrap() > 0 && surfaces["bytes"].as_u64().unwrap() > 0);
        assert!(surfaces["micropolygons"].as_u64() > surfaces["grids"].as_u64(), "{surfaces}");
        assert_eq!(stats["shadows"]["method"], "bvh");
        assert_eq!(stats["ao"]["method"], "rays");
    }
    assert_eq!(folder.json("footprint.json")["surfaces"]["evicted"], 0);
    assert!(folder.json("mesh.json")["surfaces"].is_null());
}

#[test]
fn a_small_cache_makes_grids_again_and_changes_no_bit() {
    let folder = folder();
    let fine = SCENE.replace("SURFACES", "footprint").replace("pixels = 1", "pixels = 0.1");
    folder.write("fine.toml", fine);
    folder.ok("render fine.toml -o large.exr --ao rays --stats large.json");
    folder.ok("render fine.toml -o small.exr --ao rays --stats small.json --grid-cache 1MiB");
    assert_eq!(folder.bytes("large.exr"), folder.bytes("small.exr"));
    let [large, small] = ["large.json", "small.json"].map(|name| folder.json(name)["surfaces"].clone());
    assert_eq!(large["evicted"], 0);
    let count = |stats: &serde_json::Value, key: &str| stats[key].as_u64().unwrap();
    assert!(count(&small, "evicted") > 0, "{small}");
    assert!(count(&small, "grids") > count(&large, "grids"), "{small} {large}");
    assert!(count(&small, "bytes") < count(&large, "bytes"), "{small} {large}");
    folder.fails("render fine.toml -o x.exr --grid-cache 0", &["grid-cache"]);
}

#[test]
fn threads_shards_and_the_command_line_change_nothing() {
    let folder = folder();
    folder.ok("render footprint.toml -o one.exr --threads 1");
    folder.ok("render mesh.toml --surfaces footprint -o two.exr --threads 3");
    assert_eq!(folder.bytes("one.exr"), folder.bytes("two.exr"));
    for i in 1..=2 {
        folder.ok(&format!("render footprint.toml -o part{i}.exr --shard {i}/2"));
    }
    folder.ok("merge joined.exr part1.exr part2.exr");
    assert_eq!(folder.bytes("one.exr"), folder.bytes("joined.exr"));
    folder.ok("render once.toml -o other.exr --shard 2/2");
    folder.fails("merge bad.exr part1.exr other.exr", &["differ"]);
}

#[test]
fn what_needs_triangles_says_so() {
    let folder = folder();
    for (arguments, words) in [
        ("render footprint.toml --shadows kd -o x.png", ["kd", "surfaces"]),
        ("render once.toml --ao mask -o x.png", ["mask", "surfaces"]),
        ("render mesh.toml --surfaces sometimes -o x.png", ["sometimes", "footprint"]),
    ] {
        folder.fails(arguments, &words);
    }
    let veil = SCENE
        .replace("SURFACES", "footprint")
        .replace("[[lights]]", "[materials.default]\nopacity = 0.5\n[[lights]]");
    folder.write("veil.toml", veil);
    folder.fails("render veil.toml -o x.png", &["footprint", "semi-transparent"]);
    let text = folder.ok("inspect footprint.toml");
    assert!(text.contains("kd                      does not fit: subdivision surfaces"), "{text}");
    // A bake has no rays of a camera: its surfaces are meshes.
    folder.ok("bake footprint.toml -o ao.ply --rays 8");
}
