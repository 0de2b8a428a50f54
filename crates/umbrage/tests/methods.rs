//! Every method on three kinds of scenes: it runs under its own name, or it fails with exit code 2 and the reason.

use std::fs;
use umbrage_testkit::Folder;

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

fn folder() -> Folder {
    let folder = Folder::new(env!("CARGO_BIN_EXE_umbrage"), &[]);
    for (name, text) in scenes() {
        folder.write(&format!("{name}.toml"), text);
    }
    folder
}

fn kind_of(folder: &Folder, scene: &str) -> SceneKind {
    SceneKind::of_scene(&Scene::load(&folder.path(&format!("{scene}.toml"))).unwrap())
}

/// Runs the program, which must do what `method` asks of `kind`: succeed and say so in its statistics, where `name_in` finds the name, or
/// fail with the reason. Returns whether it succeeded.
fn check(
    folder: &Folder,
    arguments: &str,
    method: impl Method,
    kind: &SceneKind,
    name_in: impl Fn(&serde_json::Value) -> String,
) -> bool {
    match method.needs().unmet(kind) {
        None => {
            folder.ok(arguments);
            assert_eq!(name_in(&folder.json("stats.json")), method.name(), "{arguments}");
            fs::remove_file(folder.path("stats.json")).unwrap();
            true
        }
        Some(reason) => {
            folder.fails(arguments, &[method.name(), reason]);
            false
        }
    }
}

fn text(value: &serde_json::Value) -> String {
    value.as_str().unwrap_or_default().into()
}

#[test]
fn every_method_renders_or_says_why_not() {
    let folder = folder();
    let mut ran = Vec::new();
    for (scene, _) in scenes() {
        let kind = kind_of(&folder, scene);
        let mut count = 0;
        for &method in ShadowMethod::ALL {
            let arguments =
                format!("render {scene}.toml -o out.png --ao rays --shadows {method} --stats stats.json");
            count += usize::from(check(&folder, &arguments, method, &kind, |stats| {
                text(&stats["shadows"]["method"])
            }));
        }
        for &method in AoMethod::ALL {
            let arguments =
                format!("render {scene}.toml -o out.png --shadows bvh --ao {method} --stats stats.json");
            count +=
                usize::from(check(&folder, &arguments, method, &kind, |stats| text(&stats["ao"]["method"])));
        }
        ran.push(count);
    }
    assert_eq!(ran[0], ShadowMethod::ALL.len() + AoMethod::ALL.len(), "opaque meshes suit every method");
    assert!(ran[1] < ran[0] && ran[2] < ran[0] && ran[1] >= 5 && ran[2] >= 5, "{ran:?}");
}

#[test]
fn every_method_bakes_or_says_why_not() {
    let folder = folder();
    let few =
        scenes()[0].1.replace("translate = [0, 0.5, 0]", "transforms = [{}, { translate = [2, 0, 0] }]");
    folder.write("copies.toml", few);
    for scene in ["opaque", "foliage", "copies"] {
        // Bakes copy instances into one mesh, and have no camera.
        let kind = SceneKind { instances_apart: false, view: View::NoCamera, ..kind_of(&folder, scene) };
        for &method in AoMethod::ALL {
            let arguments = format!(
                "bake {scene}.toml -o out.ply --rays 32 --radius 20% --method {method} --stats stats.json"
            );
            check(&folder, &arguments, method, &kind, |stats| text(&stats["method"]));
        }
    }
}

#[test]
fn the_help_lists_every_method_with_its_summary() {
    let folder = folder();
    let help = |command: &str| {
        // Lines are wrapped to the terminal's width.
        folder.ok(&format!("{command} --help")).split_whitespace().collect::<Vec<_>>().join(" ")
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
    let folder = folder();
    let (_, text) = &scenes()[0];
    for (key, known) in [("shadows", "bvh-volumetric"), ("ao", "mask-raster"), ("surfaces", "footprint")] {
        let bad = text.replace("[methods]", &format!("[methods]\n{key} = \"magic\""));
        folder.write("bad.toml", bad);
        folder.fails("render bad.toml -o out.png", &["bad.toml", "magic", known]);
    }
}

#[test]
fn nothing_answers_where_nothing_is_asked() {
    let folder = folder();
    let (_, text) = &scenes()[0];
    let dark = &text[..text.find("[ambient]").unwrap()];
    let objects = &text[text.find("[[objects]]").unwrap()..];
    folder.write("dark.toml", format!("{dark}{objects}"));
    folder.ok("render dark.toml -o out.png --shadows kd --stats stats.json");
    let stats = folder.json("stats.json");
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
