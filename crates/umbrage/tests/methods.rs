//! Every method on three kinds of scenes: it runs under its own name, or it fails with exit code 2 and the reason.

use std::{fs, path::PathBuf, process::Command};
use tempfile::TempDir;
use umbrage::query::{AoMethod, Exactness, Method, SceneKind, ShadowMethod, SurfaceMode, View};
use umbrage::scene::Scene;

const VIEW: &str = r#"
[image]
width = 24
height = 16
spp = 1
[methods]
ao_samples = 32
[camera]
position = [3, 2, 4]
target = [0, 0.3, 0]
[ambient]
radiance = 0.4
radius = 1.0
[[lights]]
type = "sphere"
center = [2, 4, 1]
radius = 0.4
radiance = 30
"#;

/// Opaque meshes, semi-transparent foliage, and so many copies that instances are kept apart.
fn scenes() -> [(&'static str, String); 3] {
    let copies = |size: f32| {
        let place = |i: u32| ((i % 20) as f32 * size, (i / 20) as f32 * size);
        (0..400)
            .map(|i| format!("{{ translate = [{}, 0, {}] }}", -place(i).0, -place(i).1))
            .collect::<Vec<_>>()
    };
    let opaque = "[[objects]]\nmesh = { generator = \"plane\", width = 8, depth = 8 }\n\
        [[objects]]\nmesh = { generator = \"blob\", triangles = 500 }\ntranslate = [0, 0.5, 0]\n";
    let foliage = "materials.leaf = { albedo = 0.5, opacity = 0.5 }\n\
        [[objects]]\nmesh = { generator = \"bush\", triangles = 3000 }\nmaterial = \"leaf\"\n";
    let instances = format!(
        "[[objects]]\nmesh = {{ generator = \"blob\", triangles = 6000 }}\ntransforms = [{}]\n",
        copies(1.2).join(", ")
    );
    [
        ("opaque", format!("{VIEW}{opaque}")),
        // Keys before tables.
        ("foliage", foliage.replacen("[[objects]]", &format!("{VIEW}[[objects]]"), 1)),
        ("instances", format!("{VIEW}{instances}")),
    ]
}

struct Folder(TempDir);

impl Folder {
    fn new() -> Self {
        let folder = Self(tempfile::tempdir().unwrap());
        for (name, text) in scenes() {
            fs::write(folder.path(&format!("{name}.toml")), text).unwrap();
        }
        folder
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn kind(&self, scene: &str) -> SceneKind {
        SceneKind::of_scene(&Scene::load(&self.path(&format!("{scene}.toml"))).unwrap())
    }

    /// Runs the program, which must do what `method` asks of `kind`: succeed and say so in its statistics under `key`, or fail
    /// with the reason. Returns whether it succeeded.
    fn check(
        &self,
        arguments: &str,
        method: impl Method,
        kind: &SceneKind,
        name_in: impl Fn(&serde_json::Value) -> String,
    ) -> bool {
        let output = Command::new(env!("CARGO_BIN_EXE_umbrage"))
            .args(arguments.split_whitespace())
            .current_dir(self.0.path())
            .output()
            .unwrap();
        let error = String::from_utf8_lossy(&output.stderr).into_owned();
        match method.needs().unmet(kind) {
            None => {
                assert!(output.status.success(), "{arguments}: {error}");
                let stats = fs::read(self.path("stats.json")).unwrap();
                assert_eq!(name_in(&serde_json::from_slice(&stats).unwrap()), method.name(), "{arguments}");
            }
            Some(reason) => {
                assert_eq!(output.status.code(), Some(2), "{arguments}: {error}");
                assert!(error.contains(method.name()) && error.contains(reason), "{arguments}: {error}");
                assert!(!self.path("stats.json").exists(), "{arguments} left something behind");
            }
        }
        let _ = fs::remove_file(self.path("stats.json"));
        output.status.success()
    }
}

fn text(value: &serde_json::Value) -> String {
    value.as_str().unwrap_or_default().into()
}

#[test]
fn every_method_renders_or_says_why_not() {
    let folder = Folder::new();
    let mut ran = Vec::new();
    for (scene, _) in scenes() {
        let kind = folder.kind(scene);
        let mut count = 0;
        for &method in ShadowMethod::ALL {
            let arguments =
                format!("render {scene}.toml -o out.png --ao rays --shadows {method} --stats stats.json");
            count += usize::from(
                folder.check(&arguments, method, &kind, |stats| text(&stats["shadows"]["method"])),
            );
        }
        for &method in AoMethod::ALL {
            let arguments =
                format!("render {scene}.toml -o out.png --shadows bvh --ao {method} --stats stats.json");
            count +=
                usize::from(folder.check(&arguments, method, &kind, |stats| text(&stats["ao"]["method"])));
        }
        ran.push(count);
    }
    assert_eq!(ran[0], ShadowMethod::ALL.len() + AoMethod::ALL.len(), "opaque meshes suit every method");
    assert!(ran[1] < ran[0] && ran[2] < ran[0] && ran[1] >= 5 && ran[2] >= 5, "{ran:?}");
}

#[test]
fn every_method_bakes_or_says_why_not() {
    let folder = Folder::new();
    let few =
        scenes()[0].1.replace("translate = [0, 0.5, 0]", "transforms = [{}, { translate = [2, 0, 0] }]");
    fs::write(folder.path("copies.toml"), few).unwrap();
    for scene in ["opaque", "foliage", "copies"] {
        // Bakes copy instances into one mesh, and have no camera.
        let kind = SceneKind { instances_apart: false, view: View::NoCamera, ..folder.kind(scene) };
        for &method in AoMethod::ALL {
            let arguments = format!(
                "bake {scene}.toml -o out.ply --rays 32 --radius 20% --method {method} --stats stats.json"
            );
            folder.check(&arguments, method, &kind, |stats| text(&stats["method"]));
        }
    }
}

#[test]
fn the_help_lists_every_method_with_its_summary() {
    let help = |command: &str| {
        let output = Command::new(env!("CARGO_BIN_EXE_umbrage")).args([command, "--help"]).output().unwrap();
        // Lines are wrapped to the terminal's width.
        String::from_utf8(output.stdout).unwrap().split_whitespace().collect::<Vec<_>>().join(" ")
    };
    let [render, bake] = ["render", "bake"].map(help);
    for &method in ShadowMethod::ALL {
        assert!(render.contains(&format!("- {method}: {}", method.summary())), "{method}: {render}");
    }
    for &mode in SurfaceMode::ALL {
        assert!(render.contains(&format!("- {mode}: {}", mode.summary())), "{mode}: {render}");
    }
    for &method in AoMethod::ALL {
        for help in [&render, &bake] {
            assert!(help.contains(&format!("- {method}: {}", method.summary())), "{method}: {help}");
        }
    }
}

#[test]
fn scene_files_name_methods_that_exist() {
    let folder = Folder::new();
    let (_, text) = &scenes()[0];
    for (key, known) in [("shadows", "bvh-volumetric"), ("ao", "mask-raster"), ("surfaces", "footprint")] {
        let bad = text.replace("[methods]", &format!("[methods]\n{key} = \"magic\""));
        fs::write(folder.path("bad.toml"), bad).unwrap();
        let output = Command::new(env!("CARGO_BIN_EXE_umbrage"))
            .args(["render", "bad.toml", "-o", "out.png"])
            .current_dir(folder.0.path())
            .output()
            .unwrap();
        let error = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(2), "{key}: {error}");
        assert!(["bad.toml", "magic", known].iter().all(|word| error.contains(word)), "{key}: {error}");
    }
}

#[test]
fn nothing_answers_where_nothing_is_asked() {
    let folder = Folder::new();
    let (_, text) = &scenes()[0];
    let dark = &text[..text.find("[ambient]").unwrap()];
    let objects = &text[text.find("[[objects]]").unwrap()..];
    fs::write(folder.path("dark.toml"), format!("{dark}{objects}")).unwrap();
    let output = Command::new(env!("CARGO_BIN_EXE_umbrage"))
        .args(["render", "dark.toml", "-o", "out.png", "--shadows", "kd", "--stats", "stats.json"])
        .current_dir(folder.0.path())
        .output()
        .unwrap();
    assert!(output.status.success());
    let stats: serde_json::Value =
        serde_json::from_slice(&fs::read(folder.path("stats.json")).unwrap()).unwrap();
    for key in ["shadows", "ao"] {
        assert!(stats[key]["method"].is_null(), "{stats}");
        assert!(stats[key]["reason"].as_str().unwrap().contains("scene has no"), "{stats}");
    }
    assert!(stats["structures"]["bvh"]["bytes"].as_u64().unwrap() > 0);
    assert!(stats["structures"]["kd-tree"].is_null());
}

/// The rows of one kind of methods in `docs/command-line.md`.
fn table<M: Method>() -> String {
    let mut table = String::from("| method | answers | needs | |\n|---|---|---|---|\n");
    for &method in M::all() {
        let also = method.alias().map_or(String::new(), |alias| format!(", `{alias}`"));
        let exactness = match method.exactness() {
            Exactness::Exact => "exact".into(),
            Exactness::Approximate(error) => format!("approximate: {error}"),
        };
        let exactness = exactness.trim_end_matches('.');
        table += &format!("| `{method}`{also} | {} | {} | {exactness} |\n", method.summary(), method.needs());
    }
    table
}

/// Puts `table` in the place of what is between the marks called `name`.
fn with_table(text: &str, name: &str, table: &str) -> String {
    let [start, end] = ["begin", "end"].map(|word| format!("<!-- {name}: {word} -->\n"));
    let (before, rest) = text.split_once(&start).expect("a mark where the table begins");
    let (_, after) = rest.split_once(&end).expect("a mark where the table ends");
    format!("{before}{start}{table}{end}{after}")
}

/// `UMBRAGE_BLESS=1` writes the tables.
#[test]
fn the_docs_have_the_tables_of_methods() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/command-line.md");
    let text = fs::read_to_string(path).unwrap();
    let expected = with_table(&text, "shadow methods", &table::<ShadowMethod>());
    let expected = with_table(&expected, "ambient occlusion methods", &table::<AoMethod>());
    let expected = with_table(&expected, "surface modes", &table::<SurfaceMode>());
    if std::env::var_os("UMBRAGE_BLESS").is_some() {
        fs::write(path, &expected).unwrap();
    } else {
        assert_eq!(text, expected, "docs/command-line.md; UMBRAGE_BLESS=1 writes the tables again");
    }
}
