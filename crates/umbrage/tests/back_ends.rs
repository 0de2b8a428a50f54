//! A forced back end changes no byte of what the program writes.

use std::process::Output;
use umbrage_geom::simd::{BackEnd, VARIABLE};
use umbrage_testkit::ProgramFolder;

/// Opaque and semi-transparent objects, instances, a light of each kind and ambient light.
const SCENE: &str = r#"
[image]
width = 40
height = 30
spp = 1
[camera]
position = [3, 2, 4]
target = [0, 0.3, 0]
[ambient]
radiance = 0.4
radius = 1.0
[methods]
ao_samples = 16
shadow_samples = 2
[materials.leaf]
albedo = 0.5
opacity = 0.6
[meshes.blob]
generator = "blob"
triangles = 500
[[objects]]
mesh = { generator = "plane", width = 8, depth = 8 }
[[objects]]
mesh = "blob"
translate = [0, 0.5, 0]
MORE
[[lights]]
type = "sphere"
center = [2, 4, 1]
radius = 0.4
radiance = 30
[[lights]]
type = "point"
position = [-2, 3, 1]
intensity = 30
"#;

const LEAVES: &str = r#"[[objects]]
mesh = { generator = "bush", triangles = 1000 }
material = "leaf"
translate = [1, 0, 0]"#;

/// A cube with creases as a control mesh.
const CUBE: &str = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 0 0 1\nv 1 0 1\nv 1 1 1\nv 0 1 1\n\
    f 1 4 3 2\nf 5 6 7 8\nf 1 2 6 5\nf 2 3 7 6\nf 3 4 8 7\nf 4 1 5 8\n";

fn folder() -> ProgramFolder {
    ProgramFolder::new(env!("CARGO_BIN_EXE_umbrage"), &[])
}

fn run(folder: &ProgramFolder, back_end: &str, arguments: &str) -> Output {
    folder.command(arguments).env(VARIABLE, back_end).output().unwrap()
}

#[test]
fn every_back_end_writes_the_same_bytes() {
    let folder = folder();
    folder.write("opaque.toml", SCENE.replace("MORE", ""));
    folder.write("leaves.toml", SCENE.replace("MORE", LEAVES));
    folder.write("cube.obj", CUBE);
    let opaque =
        |shadows: &str, ao: &str| format!("render opaque.toml --shadows {shadows} --ao {ao} -o OUT.exr");
    let mut commands: Vec<String> =
        ["bvh", "kd", "kd-volumetric", "bvh-volumetric", "prefilter"].map(|m| opaque(m, "rays")).into();
    commands.extend(["mask", "mask-table", "mask-prefilter", "mask-raster"].map(|m| opaque("bvh", m)));
    commands.push("render leaves.toml --ao mask -o OUT.exr".into());
    commands.push("render cube.obj --subdivide=4 -o OUT.exr".into());
    commands.extend(["rays", "mask"].map(|m| format!("bake cube.obj --method {m} --rays 64 -o OUT.ply")));
    for command in &commands {
        let bytes = |back_end: BackEnd| {
            let name = format!("{back_end}.{}", if command.ends_with("exr") { "exr" } else { "ply" });
            let arguments = command.replace("OUT.exr", &name).replace("OUT.ply", &name);
            let output = run(&folder, &back_end.to_string(), &arguments);
            assert!(output.status.success(), "{arguments}: {}", String::from_utf8_lossy(&output.stderr));
            folder.bytes(&name)
        };
        let expected = bytes(BackEnd::Scalar);
        for back_end in BackEnd::ALL.into_iter().filter(|b| b.is_supported()) {
            assert!(bytes(back_end) == expected, "{command} differs on {back_end}");
        }
    }
}

#[test]
fn what_can_not_be_forced_is_an_error() {
    let folder = folder();
    let missing = BackEnd::ALL.into_iter().filter(|b| !b.is_supported()).map(|b| b.to_string());
    for name in ["sse", "AVX2", ""].map(str::to_owned).into_iter().chain(missing) {
        let output = run(&folder, &name, "scenes");
        let error = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(2), "{name}: {error}");
        assert!(error.starts_with("umbrage: UMBRAGE_BACKEND: ") && error.lines().count() == 1, "{error}");
        assert!(output.stdout.is_empty());
    }
    assert!(run(&folder, "scalar", "scenes").status.success());
}
