//! Every method on three kinds of scenes: it runs under its own name, or it fails with exit code 2 and the reason.

use std::{fs, process::Command};
use umbrage::query::{AoMethod, Exactness, Method, SceneKind, ShadowMethod, SurfaceMode, View};
use umbrage::scene::Scene;
use umbrage_testkit::ProgramFolder;

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

struct Folder(ProgramFolder);

impl Folder {
    fn new() -> Self {
        let folder = ProgramFolder::new(env!("CARGO_BIN_EXE_umbrage"), &[]);
        scenes().iter().for_each(|(name, text)| folder.write(&format!("{name}.toml"), text));
        Self(folder)
    }

    fn kind(&self, scene: &str) -> SceneKind {
        SceneKind::of_scene(&Scene::load(&self.0.path(format!("{scene}.toml"))).unwrap())
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
        let output = self.0.run(arguments);
        let error = String::from_utf8_lossy(&output.stderr).into_owned();
        match method.needs().unmet(kind) {
            None => {
                assert!(output.status.success(), "{arguments}: {error}");
                let stats = self.0.bytes("stats.json");
                assert_eq!(name_in(&serde_json::from_slice(&stats).unwrap()), method.name(), "{arguments}");
            }
            Some(reason) => {
                assert_eq!(output.status.code(), Some(2), "{arguments}: {error}");
                assert!(error.contains(method.name()) && error.contains(reason), "{arguments}: {error}");
                assert!(!self.0.path("stats.json").exists(), "{arguments} left something behind");
            }
        }
        let _ = fs::remove_file(self.0.path("stats.json"));
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
    folder.0.write("copies.toml", few);
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

/// Stored opacity of semi-transparent leaves: close to exact masks, and parts make the whole.
#[test]
fn stored_opacity_of_leaves_is_close_to_masks() {
    let folder = Folder::new();
    let ground = "[[objects]]\nmesh = { generator = \"plane\", width = 8, depth = 8 }\n";
    folder.0.write("bush.toml", scenes()[1].1.clone() + ground);
    let bake = |method: &str, arguments: &str| {
        let options = "--rays 64 --radius 50% --stats stats.json";
        folder.0.ok(&format!("bake bush.toml --method {method} {options} {arguments}"));
        let stats: serde_json::Value = serde_json::from_slice(&folder.0.bytes("stats.json")).unwrap();
        stats["ao_mean"].as_f64().unwrap()
    };
    let exact = bake("mask", "-o exact.ply");
    let stored = bake("mask-prefilter", "-o whole.ply");
    assert!((exact - stored).abs() < 0.005 && exact < 0.9, "{exact} {stored}");
    for i in 1..=3 {
        bake("mask-prefilter", &format!("-o part{i}.ply --shard {i}/3"));
    }
    folder.0.ok("merge joined.ply part1.ply part2.ply part3.ply");
    assert_eq!(folder.0.bytes("whole.ply"), folder.0.bytes("joined.ply"));
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
        folder.0.write("bad.toml", bad);
        folder.0.fails("render bad.toml -o out.png", &["bad.toml", "magic", known]);
    }
}

#[test]
fn nothing_answers_where_nothing_is_asked() {
    let folder = Folder::new();
    let (_, text) = &scenes()[0];
    let dark = &text[..text.find("[ambient]").unwrap()];
    let objects = &text[text.find("[[objects]]").unwrap()..];
    folder.0.write("dark.toml", format!("{dark}{objects}"));
    folder.0.ok("render dark.toml -o out.png --shadows kd --stats stats.json");
    let stats: serde_json::Value = serde_json::from_slice(&folder.0.bytes("stats.json")).unwrap();
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
