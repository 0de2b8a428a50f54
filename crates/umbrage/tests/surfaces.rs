//! Subdivision surfaces by each ray's footprint and at rates chosen once, against their mesh.

use std::{fs, path::PathBuf, process::Command};
use tempfile::TempDir;

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

struct Folder(TempDir);

impl Folder {
    fn new() -> Self {
        let folder = Self(tempfile::tempdir().unwrap());
        fs::write(folder.path("cube.obj"), CUBE).unwrap();
        for mode in ["mesh", "once", "footprint"] {
            fs::write(folder.path(&format!("{mode}.toml")), SCENE.replace("SURFACES", mode)).unwrap();
        }
        folder
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    /// Runs the program; its standard output, or exit code and standard error.
    fn run(&self, arguments: &str) -> Result<String, (i32, String)> {
        let output = Command::new(env!("CARGO_BIN_EXE_umbrage"))
            .args(arguments.split_whitespace())
            .current_dir(self.0.path())
            .output()
            .unwrap();
        match output.status.success() {
            true => Ok(String::from_utf8(output.stdout).unwrap()),
            false => {
                Err((output.status.code().unwrap(), String::from_utf8_lossy(&output.stderr).into_owned()))
            }
        }
    }

    fn json(&self, name: &str) -> serde_json::Value {
        serde_json::from_slice(&fs::read(self.path(name)).unwrap()).unwrap()
    }

    /// RMSE of the layers beauty, shadow and ao.
    fn errors(&self, a: &str, b: &str) -> [f64; 3] {
        let text = self.run(&format!("compare {a} {b} --json")).unwrap();
        let comparison: serde_json::Value = serde_json::from_str(&text).unwrap();
        let layers = comparison["layers"].as_array().unwrap();
        ["beauty", "shadow", "ao"].map(|name| {
            let layer = layers.iter().find(|layer| layer["layer"] == name).unwrap();
            layer["rmse"].as_f64().unwrap()
        })
    }
}

#[test]
fn surfaces_look_like_their_mesh_however_they_are_traced() {
    let folder = Folder::new();
    for mode in ["mesh", "once", "footprint"] {
        folder
            .run(&format!(
                "render {mode}.toml -o {mode}.exr --ao rays --stats {mode}.json --heatmap {mode}.png"
            ))
            .unwrap();
    }
    // Micropolygons of a pixel: what differs are silhouettes and edges of shadows.
    for mode in ["once", "footprint"] {
        let [beauty, shadow, ao] = folder.errors("mesh.exr", &format!("{mode}.exr"));
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
fn threads_shards_and_the_command_line_change_nothing() {
    let folder = Folder::new();
    folder.run("render footprint.toml -o one.exr --threads 1").unwrap();
    folder.run("render mesh.toml --surfaces footprint -o two.exr --threads 3").unwrap();
    assert_eq!(fs::read(folder.path("one.exr")).unwrap(), fs::read(folder.path("two.exr")).unwrap());
    for i in 1..=2 {
        folder.run(&format!("render footprint.toml -o part{i}.exr --shard {i}/2")).unwrap();
    }
    folder.run("merge joined.exr part1.exr part2.exr").unwrap();
    assert_eq!(fs::read(folder.path("one.exr")).unwrap(), fs::read(folder.path("joined.exr")).unwrap());
    folder.run("render once.toml -o other.exr --shard 2/2").unwrap();
    assert!(folder.run("merge bad.exr part1.exr other.exr").unwrap_err().1.contains("differ"));
}

#[test]
fn what_needs_triangles_says_so() {
    let folder = Folder::new();
    for (arguments, words) in [
        ("render footprint.toml --shadows kd -o x.png", ["kd", "surfaces"]),
        ("render once.toml --ao mask -o x.png", ["mask", "surfaces"]),
        ("render mesh.toml --surfaces sometimes -o x.png", ["sometimes", "footprint"]),
    ] {
        let (code, error) = folder.run(arguments).unwrap_err();
        assert_eq!(code, 2, "{arguments}: {error}");
        assert!(words.iter().all(|word| error.contains(word)), "{arguments}: {error}");
    }
    let veil = SCENE
        .replace("SURFACES", "footprint")
        .replace("[[lights]]", "[materials.default]\nopacity = 0.5\n[[lights]]");
    fs::write(folder.path("veil.toml"), veil).unwrap();
    let (code, error) = folder.run("render veil.toml -o x.png").unwrap_err();
    assert!(code == 2 && error.contains("footprint") && error.contains("semi-transparent"), "{error}");
    let text = folder.run("inspect footprint.toml").unwrap();
    assert!(text.contains("kd                      does not fit: subdivision surfaces"), "{text}");
    // A bake has no rays of a camera: its surfaces are meshes.
    folder.run("bake footprint.toml -o ao.ply --rays 8").unwrap();
}
