//! Method `mask-prefilter` on semi-transparent foliage, as the program runs it.

use umbrage_testkit::Folder;

const SCENE: &str = r#"
camera = { position = [2.6, 2.4, 5.2], target = [-0.1, 1.0, 0], fov = 36 }
image = { width = 96, height = 96, spp = 1 }
methods = { ao_samples = 64 }
ambient = { radiance = 0.5, radius = "10%" }
materials = { leaf = { albedo = 0.4, opacity = 0.5 } }
[[objects]]
mesh = { generator = "plane", width = 12, depth = 12 }
[[objects]]
mesh = { generator = "bush", triangles = 6000 }
material = "leaf"
"#;

#[test]
fn shards_of_pictures_and_bakes_are_the_whole() {
    let folder = Folder::new(env!("CARGO_BIN_EXE_umbrage"), &[("leaves.toml", SCENE)]);
    let commands = [
        ("render leaves.toml --ao mask-prefilter", "exr"),
        ("bake leaves.toml --method mask-prefilter --rays 64 --radius 10%", "ply"),
    ];
    for (command, extension) in commands {
        folder.ok(&format!("{command} -o whole.{extension} --stats stats.json"));
        let parts: Vec<String> = (1..=3).map(|i| format!("part{i}.{extension}")).collect();
        for (i, part) in (1..=3).zip(&parts) {
            folder.ok(&format!("{command} -o {part} --shard {i}/3"));
        }
        folder.ok(&format!("merge joined.{extension} {}", parts.join(" ")));
        let [whole, joined] = ["whole", "joined"].map(|name| folder.bytes(&format!("{name}.{extension}")));
        assert!(whole == joined, "{command}");
        let stats = folder.json("stats.json");
        let method = if extension == "exr" { &stats["ao"]["method"] } else { &stats["method"] };
        assert_eq!(method, "mask-prefilter");
    }
    // Its mean is near that of exact masks.
    folder.ok("render leaves.toml --ao mask -o exact.exr");
    let text = folder.ok("compare exact.exr whole.exr --layer ao --json");
    let comparison: serde_json::Value = serde_json::from_str(&text).unwrap();
    let bias = comparison["layers"][0]["bias"].as_f64().unwrap_or(f64::NAN);
    assert!(bias.abs() < 0.005, "{comparison}");
}
