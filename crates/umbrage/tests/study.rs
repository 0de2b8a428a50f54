//! `umbrage study`.

use umbrage_testkit::Folder;

/// A control mesh: a box with a smaller one on top.
const BOXES: &str = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 0 0 1\nv 1 0 1\nv 1 1 1\nv 0 1 1\n\
    f 4 3 2 1\nf 5 6 7 8\nf 1 2 6 5\nf 2 3 7 6\nf 3 4 8 7\nf 4 1 5 8\n";

const SCENE: &str = r#"
[camera]
position = [3, 2, 4]
target = [0.5, 0.5, 0.5]
fov = 40
[image]
width = 64
height = 48
[ambient]
[[objects]]
mesh = { file = "boxes.obj", subdivide = 2 }
[[lights]]
type = "sphere"
center = [2, 4, 2]
radius = 1
radiance = [5, 5, 5]
"#;

#[test]
fn a_scene_is_studied_and_all_files_are_written() {
    let files = [("boxes.obj", BOXES), ("boxes.toml", SCENE)];
    let folder = Folder::new(env!("CARGO_BIN_EXE_umbrage"), &files);
    let outputs = "-o boxes.html --csv boxes.csv --json boxes.jsonl";
    let out = folder.ok(&format!("study boxes.toml --receivers 100 --budget 3s {outputs}"));
    for expected in [
        "Ambient occlusion, unbounded radius",
        "Shadow of light 1",
        "subdivision surfaces",
        "For an error of",
    ] {
        assert!(out.contains(expected), "{expected}: {out}");
    }
    let read = |name: &str| String::from_utf8(folder.bytes(name)).expect("text");
    assert!(read("boxes.html").contains("<svg"));
    assert!(read("boxes.csv").starts_with("subject,question,method,"));
    for line in read("boxes.jsonl").lines() {
        let row: serde_json::Value = serde_json::from_str(line).expect("JSON");
        for key in ["suite", "scene", "method", "params", "time_s", "rmse", "bias", "bytes", "counters"] {
            assert!(!row[key].is_null(), "{key}: {line}");
        }
    }
    let surfaces = read("boxes.csv").lines().filter(|line| line.contains(",surfaces,")).count();
    assert!(surfaces >= 1, "{surfaces}");
}

#[test]
fn what_can_t_be_studied_is_said() {
    let folder = Folder::new(env!("CARGO_BIN_EXE_umbrage"), &[("boxes.obj", BOXES)]);
    for (arguments, expected) in [
        ("study boxes.obj --method maks", "maks"),
        ("study boxes.obj -o boxes.pdf", ".html"),
        ("study boxes.obj --budget soon", "soon"),
        ("study boxes.obj --receivers 3", "receivers"),
        ("study missing.obj", "missing.obj"),
        ("study boxes.obj --per texel", "texture coordinates"),
    ] {
        folder.fails(arguments, &[expected]);
    }
}
