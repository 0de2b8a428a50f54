//! The program as a user runs it: pictures, bakes, parts, and one line for each mistake.

use std::{fs, path::Path};
use umbrage::scene::read_ply_vertices;
use umbrage_testkit::Folder;

const SCENE: &str = r#"
[image]
width = 70
height = 40
spp = 2
[camera]
position = [3, 2, 4]
target = [0, 0.3, 0]
[ambient]
radiance = 0.4
radius = 1.0
[[objects]]
mesh = { generator = "plane", width = 8, depth = 8 }
[[objects]]
mesh = { generator = "blob", triangles = 500 }
translate = [0, 0.5, 0]
[[lights]]
type = "sphere"
center = [2, 4, 1]
radius = 0.4
radiance = 30
"#;

/// A tetrahedron with texture coordinates.
const OBJ: &str = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nvt 0 0\nvt 1 0\nvt 0 1\n\
    f 1/1 3/2 2/3\nf 1/1 2/2 4/3\nf 1/1 4/2 3/3\nf 2/1 3/2 4/3\n";

fn folder() -> Folder {
    Folder::new(env!("CARGO_BIN_EXE_umbrage"), &[("scene.toml", SCENE), ("mesh.obj", OBJ)])
}

#[test]
fn a_picture_does_not_depend_on_threads_or_shards() {
    let folder = folder();
    folder.ok("render scene.toml -o one.exr --threads 1 --stats stats.json --heatmap heat.png");
    folder.ok("render scene.toml -o two.exr --threads 2");
    assert_eq!(folder.bytes("one.exr"), folder.bytes("two.exr"));
    for i in 1..=3 {
        folder.ok(&format!("render scene.toml -o part{i}.exr --shard {i}/3"));
    }
    folder.ok("merge joined.exr part2.exr part1.exr part3.exr");
    assert_eq!(folder.bytes("one.exr"), folder.bytes("joined.exr"));
    folder.ok("render scene.toml -o one.png");
    folder.ok("merge joined.png part2.exr part1.exr part3.exr");
    assert_eq!(folder.bytes("one.png"), folder.bytes("joined.png"));
    let stats: serde_json::Value = serde_json::from_slice(&folder.bytes("stats.json")).unwrap();
    assert_eq!(stats["width"], 70);
    assert_eq!(stats["shadows"]["method"], "bvh");
    assert_eq!(stats["rays"]["camera"], 70 * 40 * 2);
    assert!(stats["counters"]["triangle_tests"].as_u64().unwrap() > 0);
    assert!(stats["mrays_s"].as_f64().unwrap() > 0.0);
    folder.fails("merge bad.exr part1.exr part3.exr", &["3 shards", "missing: 2"]);
    folder.fails("merge bad.exr part1.exr part1.exr part3.exr", &["part1.exr"]);
    folder.ok("render scene.toml -o other.exr --shard 2/3 --spp 3");
    folder.fails("merge bad.exr part1.exr other.exr part3.exr", &["other.exr", "differ"]);
    folder.fails("merge bad.exr one.exr", &["one.exr"]);
}

#[test]
fn parts_of_differently_coloured_scenes_are_strangers() {
    let folder = folder();
    let triangle =
        |color: &str| ["0 0 0", "1 0 0", "0 1 0"].map(|p| format!("v {p} {color}\n")).concat() + "f 1 2 3\n";
    folder.write("red.obj", triangle("1 0 0"));
    folder.write("blue.obj", triangle("0 0 1"));
    for (name, shard) in [("red", "1/2"), ("red", "2/2"), ("blue", "2/2")] {
        let output = format!("{name}{}.exr", &shard[..1]);
        folder.ok(&format!("render {name}.obj -o {output} --shard {shard} --size 40x30 --spp 1"));
    }
    folder.ok("merge joined.exr red1.exr red2.exr");
    folder.fails("merge bad.exr red1.exr blue2.exr", &["blue2.exr", "differ"]);
}

#[test]
fn a_mesh_alone_makes_a_picture() {
    let folder = folder();
    folder.ok("render mesh.obj --size 64x48 --spp 1");
    let comparison = folder.ok("compare mesh.png mesh.png --json");
    let comparison: serde_json::Value = serde_json::from_str(&comparison).unwrap();
    assert_eq!((comparison["width"].as_u64(), comparison["rmse"].as_f64()), (Some(64), Some(0.0)));
}

#[test]
fn the_sky_by_masks_looks_like_the_sky_by_rays() {
    let folder = folder();
    let scene =
        |samples: u32| SCENE.replace("[camera]", &format!("[methods]\nao_samples = {samples}\n[camera]"));
    folder.write("many.toml", scene(64));
    folder.ok("render many.toml -o rays.exr --ao rays");
    folder.ok("render many.toml -o masks.exr --ao mask-table --threads 2");
    folder.ok("render many.toml -o again.exr --ao mask-table --threads 1");
    assert_eq!(folder.bytes("masks.exr"), folder.bytes("again.exr"));
    let comparison = folder.ok("compare rays.exr masks.exr --json");
    let comparison: serde_json::Value = serde_json::from_str(&comparison).unwrap();
    let (rmse, bias) = (comparison["rmse"].as_f64().unwrap(), comparison["bias"].as_f64().unwrap());
    assert!(rmse > 0.0 && rmse < 0.03 && bias.abs() < 0.01, "{comparison}");
    // Exact masks are what `auto` takes where it can.
    folder.ok("render many.toml -o exact.exr --ao mask --threads 2");
    folder.ok("render many.toml -o auto.exr --stats auto.json");
    assert_eq!(folder.bytes("exact.exr"), folder.bytes("auto.exr"));
    for i in 1..=2 {
        folder.ok(&format!("render many.toml -o e{i}.exr --ao mask --shard {i}/2"));
    }
    folder.ok("merge joined-exact.exr e1.exr e2.exr");
    assert_eq!(folder.bytes("exact.exr"), folder.bytes("joined-exact.exr"));
    let stats: serde_json::Value = serde_json::from_slice(&folder.bytes("auto.json")).unwrap();
    assert_eq!(stats["ao"]["method"], "mask");
    // Single rays are the same rays.
    let comparison = folder.ok("compare rays.exr exact.exr --json");
    let comparison: serde_json::Value = serde_json::from_str(&comparison).unwrap();
    let layers = comparison["layers"].as_array().unwrap();
    for layer in layers.iter().filter(|layer| layer["layer"] != "cost") {
        assert_eq!(layer["different_pixels"], 0, "{layer}");
    }
    // Near by masks, far by stored opacity.
    folder.ok("render many.toml -o far.exr --ao mask-prefilter");
    let comparison = folder.ok("compare exact.exr far.exr --json");
    let comparison: serde_json::Value = serde_json::from_str(&comparison).unwrap();
    let (rmse, bias) = (comparison["rmse"].as_f64().unwrap(), comparison["bias"].as_f64().unwrap());
    assert!(rmse < 0.03 && bias.abs() < 0.01, "{comparison}");
    // By rasterization, as a whole and in parts.
    folder.ok("render many.toml -o raster.exr --ao mask-raster");
    folder.ok("render many.toml -o part1.exr --ao mask-raster --shard 1/2");
    folder.ok("render many.toml -o part2.exr --ao mask-raster --shard 2/2");
    folder.ok("merge joined.exr part1.exr part2.exr");
    assert_eq!(folder.bytes("raster.exr"), folder.bytes("joined.exr"));
    let comparison = folder.ok("compare rays.exr raster.exr --json");
    let comparison: serde_json::Value = serde_json::from_str(&comparison).unwrap();
    let (rmse, bias) = (comparison["rmse"].as_f64().unwrap(), comparison["bias"].as_f64().unwrap());
    assert!(rmse > 0.0 && rmse < 0.03 && bias.abs() < 0.01, "{comparison}");
    folder.write("odd.toml", scene(33));
    folder.fails("render odd.toml -o odd.exr --ao mask-table", &["33 rays", "multiple of 8"]);
}

#[test]
fn comparing_reports_errors_and_thresholds() {
    let folder = folder();
    folder.ok("render scene.toml -o a.exr");
    folder.ok("render scene.toml -o b.exr --spp 3");
    let json = folder.ok("compare a.exr b.exr --json --difference d.png");
    let comparison: serde_json::Value = serde_json::from_str(&json).unwrap();
    let rmse = comparison["rmse"].as_f64().unwrap();
    assert!(rmse > 0.0 && comparison["flip"].as_f64().unwrap() > 0.0);
    assert!(folder.path("d.png").exists());
    assert_eq!(folder.run("compare a.exr b.exr --max-rmse 1e-9").status.code(), Some(1));
    folder.ok("compare a.exr b.exr --max-rmse 10");
    folder.ok("render scene.toml -o small.exr --size 8x8");
    folder.fails("compare a.exr small.exr", &["70 x 40", "8 x 8"]);
    folder.fails("compare a.exr none.exr", &["none.exr"]);
}

/// The `ao` values of a baked PLY.
fn ao(path: &Path) -> Vec<f32> {
    umbrage::scene::read_ply_vertices(path).unwrap().ao
}

#[test]
fn bakes_do_not_depend_on_threads_or_shards() {
    let folder = folder();
    // A blob on a ground has all kinds of values, in more than one block of receivers.
    folder.write("blob.toml", SCENE.replace("triangles = 500", "triangles = 900"));
    let bake = "bake blob.toml --rays 64 --radius 50% --falloff linear";
    folder.ok(&format!("{bake} -o one.ply --threads 1 --stats stats.json"));
    folder.ok(&format!("{bake} -o two.ply --threads 2"));
    assert_eq!(folder.bytes("one.ply"), folder.bytes("two.ply"));
    for i in 1..=2 {
        folder.ok(&format!("{bake} -o part{i}.ply --shard {i}/2"));
    }
    folder.ok("merge joined.ply part2.ply part1.ply");
    assert_eq!(folder.bytes("one.ply"), folder.bytes("joined.ply"));
    let values = ao(&folder.path("one.ply"));
    assert!(values.iter().all(|v| (0.0..=1.0).contains(v)));
    assert!(values.iter().any(|&v| v > 0.95) && values.iter().any(|&v| v < 0.7));
    let stats: serde_json::Value = serde_json::from_slice(&folder.bytes("stats.json")).unwrap();
    assert_eq!(stats["receivers"].as_u64().unwrap() as usize, values.len());
    folder.fails("merge bad.ply part1.ply", &["missing: 2"]);
    folder.fails("merge bad.ply one.ply part2.ply", &["one.ply"]);
    folder.fails("merge bad.png part1.ply part2.ply", &["bad.png", ".ply or .obj"]);
}

#[test]
fn bakes_reach_every_kind_of_output() {
    let folder = folder();
    // A tetrahedron is convex: nothing is occluded, but for the ground.
    folder.ok("bake mesh.obj -o mesh.ply");
    assert_eq!(ao(&folder.path("mesh.ply")), [1.0; 4]);
    let mesh = umbrage::scene::read_mesh(&folder.path("mesh.ply")).unwrap();
    assert_eq!(mesh.vertex_colors, vec![[1.0; 3]; 4]);
    folder.ok("bake mesh.obj -o ground.ply --ground --normals geometric");
    assert!(ao(&folder.path("ground.ply")).iter().all(|&v| v < 1.0));
    folder.ok("bake mesh.obj -o shade.ply --occluder mesh.ply --sides front --seed 3 --bias 1e-4");
    folder.ok("bake mesh.obj -o mesh-ao.obj");
    assert!(String::from_utf8(folder.bytes("mesh-ao.obj")).unwrap().contains("v 0 0 0 1 1 1"));
    folder.ok("bake mesh.obj -o texels.png --per texel --size 32");
    folder.ok("bake mesh.obj -o texels.exr --per texel --size 32x16 --rays 8 --ground");
    for i in 1..=2 {
        folder.ok(&format!(
            "bake mesh.obj -o t{i}.ply --per texel --size 32x16 --rays 8 --ground --shard {i}/2"
        ));
    }
    folder.ok("merge joined.exr t1.ply t2.ply");
    assert_eq!(folder.bytes("texels.exr"), folder.bytes("joined.exr"));
    let points = "ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\nproperty float z\n\
        property float nx\nproperty float ny\nproperty float nz\nend_header\n\
        0.2 0.2 0.2 0 1 0\n5 5 5 0 0 1\n";
    folder.write("points.ply", points);
    folder.ok("bake mesh.obj -o points-ao.ply --points points.ply");
    // The first lies inside the tetrahedron.
    assert_eq!(ao(&folder.path("points-ao.ply")), [0.0, 1.0]);
}

#[test]
fn masks_bake_given_points_and_write_down_their_rays() {
    let folder = folder();
    let points = "ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\nproperty float z\n\
        property float nx\nproperty float ny\nproperty float nz\nend_header\n0.2 0.2 -0.5 0 0 1\n5 5 5 0 1 0\n";
    folder.write("points.ply", points);
    let bake = "bake mesh.obj --points points.ply --method mask";
    folder.ok(&format!(
        "{bake} -o ao.ply --rays 64 --radius 2 --dump-rays rays.bin --bent-normals --stats stats.json"
    ));
    let header = folder.bytes("ao.ply");
    assert!(String::from_utf8_lossy(&header).contains("property float bent_y"));
    let values = ao(&folder.path("ao.ply"));
    assert!(values[0] < 0.9 && values[1] == 1.0, "{values:?}");
    assert_eq!(folder.bytes("rays.bin").len(), 2 * 64 * 36);
    let blocked: u32 = folder.bytes("rays.bin").chunks(36).map(|ray| u32::from(ray[32])).sum();
    assert_eq!(values[0], (64 - blocked) as f32 / 64.0);
    let stats: serde_json::Value = serde_json::from_slice(&folder.bytes("stats.json")).unwrap();
    assert_eq!(stats["method"], "mask");
    folder.ok(&format!("{bake}-table -o table.ply --rays 64 --radius 2"));
    assert!((ao(&folder.path("table.ply"))[0] - values[0]).abs() < 0.1);
    folder.ok(&format!("{bake}-prefilter -o far.ply --rays 64 --radius 2"));
    assert!((ao(&folder.path("far.ply"))[0] - values[0]).abs() < 0.1);
    // A ground without end is no part of what is stored.
    folder.ok(&format!("{bake} -o on.ply --rays 256 --ground"));
    folder.ok(&format!("{bake}-prefilter -o far-on.ply --rays 256 --ground"));
    let (near, far) = (ao(&folder.path("on.ply"))[0], ao(&folder.path("far-on.ply"))[0]);
    assert!(near < 0.6 && (near - far).abs() < 0.05, "{near} {far}");
    folder.ok(&format!("{bake} -o few.ply --rays 1024 --radius 2 --target-error 0.01"));
    assert!((ao(&folder.path("few.ply"))[0] - values[0]).abs() < 0.05);
    folder.fails(&format!("{bake} -o x.ply --target-error 0"), &["target error"]);
    folder.ok(&format!("{bake} -o bent.ply --target-error 0.1 --bent-normals"));
    folder.fails("bake mesh.obj -o x.ply --method rays --target-error 0.1", &["target error", "mask"]);
    folder.ok("bake mesh.obj -o bent.exr --per texel --size 8 --rays 32 --bent-normals");
    // Other numbers of rays are left to single rays.
    folder.ok("bake mesh.obj -o rays.ply --points points.ply --rays 33 --stats rays.json");
    let stats: serde_json::Value = serde_json::from_slice(&folder.bytes("rays.json")).unwrap();
    assert_eq!(stats["method"], "rays");
    folder.fails(&format!("{bake} -o x.ply --bent-normals --shard 1/2"), &["--bent-normals", "--shard"]);
    folder.fails(&format!("{bake} -o x.ply --rays 33"), &["33 rays", "multiple of 8"]);
    folder
        .fails("bake mesh.obj -o x.ply --method rays --dump-rays rays2.bin", &["--dump-rays", "mask-table"]);
}

/// A scene file's surface at the rate of the picture, its objects of the OBJ with materials of their own.
#[test]
fn scene_files_have_surfaces() {
    let folder = folder();
    let text = OBJ.replace("f 1/1 3/2", "g base\nf 1/1 3/2").replace("f 2/1", "g front\nf 2/1");
    folder.write("parts.obj", text);
    let scene = |subdivide: &str| {
        let text = format!(
            r#"
            camera = {{ position = [2, 2, 3], target = [0.3, 0.3, 0.3], fov = 20 }}
            image = {{ width = 48, height = 48, spp = 1 }}
            background = 0.1
            materials.dark = {{ albedo = 0 }}
            [ambient]
            [[objects]]
            mesh = {{ file = "parts.obj", subdivide = {subdivide} }}
            materials = {{ front = "dark" }}
            "#
        );
        folder.write("surface.toml", text);
    };
    let triangles = |name: &str| {
        let stats: serde_json::Value = serde_json::from_slice(&folder.bytes(name)).unwrap();
        stats["triangles"].as_u64().unwrap()
    };
    scene("1");
    folder.ok("render surface.toml -o a.exr --stats a.json");
    folder.ok("render surface.toml -o b.exr --size 96x96 --stats b.json");
    assert!(triangles("b.json") > 3 * triangles("a.json") && triangles("a.json") > 300);
    // The front is seen from here and black; the ground would be, were it not behind.
    let film = umbrage::image::read_exr(&folder.path("a.exr")).unwrap();
    let (beauty, depth) = (film.require("beauty").unwrap(), film.require("depth").unwrap());
    let seen: Vec<f32> =
        (0..film.pixels()).filter(|&i| depth.pixel(i)[0] < 1e9).map(|i| beauty.pixel(i)[0]).collect();
    let black = seen.iter().filter(|&&x| x == 0.0).count();
    assert!(black > 100 && seen.len() > black + 30, "{black} of {} are black", seen.len());
    scene("{ level = 1 }");
    let json: serde_json::Value = serde_json::from_str(&folder.ok("inspect surface.toml --json")).unwrap();
    assert_eq!(json["triangles"], 12 * 4 * 2);
    folder.ok("bake surface.toml -o ao.ply --rays 8 --stats bake.json");
    assert_eq!(triangles("bake.json"), 12 * 4 * 2);
    scene("-1");
    folder.fails("render surface.toml -o c.png", &["surface.toml:8:", "subdivide must be above 0"]);
    // A face that is there twice.
    let twice = format!("{OBJ}f 1/1 3/2 2/3\n");
    folder.write("parts.obj", twice.replace("f 2/1", "g front\nf 2/1"));
    scene("1");
    folder.fails("render surface.toml -o c.png", &["surface.toml", "parts", "not manifold"]);
}

/// Catmull-Clark surfaces: finer pictures have more triangles, shards make the same picture, bakes have vertices on the surface.
#[test]
fn control_meshes_become_surfaces() {
    let folder = folder();
    let triangles = |name: &str| {
        let stats: serde_json::Value = serde_json::from_slice(&folder.bytes(name)).unwrap();
        stats["triangles"].as_u64().unwrap()
    };
    folder.ok("render mesh.obj --subdivide -o a.exr --size 48x40 --spp 1 --stats a.json");
    folder.ok("render mesh.obj --subdivide=4 -o b.exr --size 48x40 --spp 1 --stats b.json");
    assert!(triangles("a.json") > 4 * triangles("b.json") && triangles("b.json") > 20);
    for part in [1, 2] {
        folder
            .ok(&format!("render mesh.obj --subdivide -o p{part}.exr --size 48x40 --spp 1 --shard {part}/2"));
    }
    folder.ok("merge whole.exr p1.exr p2.exr");
    assert_eq!(folder.bytes("whole.exr"), folder.bytes("a.exr"));
    folder.ok("bake mesh.obj --subdivide=2 -o ao.ply --rays 16 --stats bake.json");
    // Each corner of four triangles is a quadrilateral, cut into 4 x 4 cells.
    assert_eq!(triangles("bake.json"), 12 * 16 * 2);
    assert!(ao(&folder.path("ao.ply")).iter().all(|&ao| ao > 0.9), "the surface is convex");
    folder.fails("render scene.toml --subdivide -o c.png", &["scene.toml"]);
    folder.fails("render mesh.obj --subdivide=0 -o c.png", &["mesh.obj", "width"]);
    folder.fails("bake mesh.obj --subdivide=13 -o c.ply", &["mesh.obj", "level"]);
}

/// The boundary rule and the crease method of the file, or of the scene file where it names them.
#[test]
fn surfaces_obey_the_tags_of_the_file() {
    const QUAD: &str = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3 4\n";
    let folder = folder();
    let write = |text: String| folder.write("tagged.obj", text);
    let corners = |from: &str| {
        folder.ok(&format!("bake {from} -o corners.ply --rays 8"));
        read_ply_vertices(&folder.path("corners.ply")).unwrap().positions
    };
    let has = |positions: &[[f32; 3]], x: f32| {
        positions.iter().any(|p| (p[0] - x).abs() < 1e-6 && (p[1] - x).abs() < 1e-6)
    };
    // The corner itself, or the end of the boundary's cubic B-spline: a sixth of each neighbour.
    for (tag, at, not_at) in [
        ("", 1.0 / 6.0, 0.0),
        ("t interpolateboundary 1/0/0 2", 1.0 / 6.0, 0.0),
        ("t interpolateboundary 1/0/0 1", 0.0, 1.0 / 6.0),
        ("#t interpolateboundary 1/0/0 1", 0.0, 1.0 / 6.0),
    ] {
        write(format!("{QUAD}{tag}\n"));
        let positions = corners("tagged.obj --subdivide=0");
        assert!(has(&positions, at) && !has(&positions, not_at), "{tag}: {positions:?}");
    }
    let scene = |subdivide: &str| {
        let text = format!(
            "camera = {{ position = [2, 2, 3], target = [0, 0, 0] }}\n[ambient]\n[[objects]]\n\
             mesh = {{ file = \"tagged.obj\", subdivide = {{ level = 0{subdivide} }} }}\n"
        );
        folder.write("tagged.toml", text);
        corners("tagged.toml")
    };
    assert!(has(&scene(""), 0.0));
    assert!(has(&scene(", boundary = \"edge-only\""), 1.0 / 6.0));
    // A ridge whose sharpness changes.
    let mut sheet: String =
        (0..25).map(|i| format!("v {} {} {}\n", i % 5, i / 5, if i / 5 == 2 { 1 } else { 0 })).collect();
    for a in (1..20).filter(|a| a % 5 != 0) {
        sheet += &format!("f {} {} {} {}\n", a, a + 1, a + 6, a + 5);
    }
    sheet += "t crease 2/1/0 11 12 1\nt crease 2/1/0 12 13 2\n";
    let mut methods = ["", "t creasemethod 0/0/1 normal\n", "t creasemethod 0/0/1 chaikin\n"].map(|tag| {
        write(format!("{sheet}{tag}"));
        corners("tagged.obj --subdivide=1")
    });
    assert_eq!(methods[0], methods[1]);
    let heights = methods.each_mut().map(|positions| {
        positions.sort_by(|a, b| a[0].total_cmp(&b[0]).then(a[1].total_cmp(&b[1])));
        positions.iter().find(|p| (p[0] - 2.0).abs() < 0.1 && (p[1] - 2.0).abs() < 1e-6).unwrap()[2]
    });
    // Sharpness 1 and 2 becomes 0.25 and 0.75 instead of 0 and 1: the second level is half a ridge's.
    assert!((heights[0] - 61.0 / 72.0).abs() < 1e-5 && (heights[2] - 0.875).abs() < 1e-5, "{heights:?}");
    for command in ["bake tagged.obj --subdivide -o x.ply", "render tagged.obj --subdivide -o x.png"] {
        write(format!("{QUAD}t creasemethod 0/0/1 foo\n"));
        folder.fails(command, &["tagged.obj:6:", "'foo'", "'normal' or 'chaikin'"]);
        write(format!("{QUAD}t interpolateboundary 1/0/0 3\n"));
        folder.fails(command, &["tagged.obj:6:", "interpolateboundary", "0, 1 or 2"]);
        write(format!("{QUAD}t hole 1/0/0 0\n"));
        folder.fails(command, &["tagged.obj:6:", "tag 'hole' is not implemented"]);
    }
}

#[test]
fn inspect_and_scenes_talk_to_people_and_scripts() {
    let folder = folder();
    assert!(folder.ok("inspect mesh.obj").contains('4'));
    let json: serde_json::Value = serde_json::from_str(&folder.ok("inspect mesh.obj --json")).unwrap();
    assert_eq!(json["triangles"], 4);
    assert_eq!(json["degenerate_triangles"], 0);
    folder.ok("inspect scene.toml --json");
    let list: serde_json::Value = serde_json::from_str(&folder.ok("scenes --json")).unwrap();
    for name in [
        "bush",
        "tentacles",
        "bamboo",
        "particles",
        "hairball",
        "city",
        "cathedral",
        "dragonish",
        "rocks",
        "blob",
        "knots",
        "stage",
        "plane",
        "sphere",
        "box",
        "cube-sphere",
    ] {
        assert!(list.as_array().unwrap().iter().any(|g| g["name"] == name), "{name}");
    }
    assert!(folder.ok("scenes bush").contains("leaves"));
    folder.fails("scenes tree", &["tree", "bush"]);
}

#[test]
fn every_mistake_is_one_line_that_names_the_culprit() {
    let folder = folder();
    let write = |name: &str, content: &[u8]| folder.write(name, content);
    write("zero.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 0 1 2\n");
    write("past.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 4\n");
    write("nan.obj", b"v 0 0 0\nv nan 0 0\nv 0 1 0\nf 1 2 3\n");
    write("inf.obj", b"v 0 0 0\nv inf 0 0\nv 0 1 0\nf 1 2 3\n");
    write("empty.obj", b"");
    write("garbage.obj", &[0xff, 0x00, 0x13, 0x37].repeat(100));
    write("garbage.ply", &[0xff, 0x00, 0x13, 0x37].repeat(100));
    write("garbage.glb", &[0xff, 0x00, 0x13, 0x37].repeat(100));
    write(
        "short.ply",
        b"ply\nformat binary_little_endian 1.0\nelement vertex 4000000000\nproperty float x\nend_header\n",
    );
    write("short.glb", b"glTF\x02\x00\x00\x00\xff\xff\x00\x00");
    fs::create_dir(folder.path("folder.obj")).unwrap();
    let mistakes: &[(&str, &[&str])] = &[
        ("bake missing.obj -o out.ply", &["missing.obj"]),
        ("bake folder.obj -o out.ply", &["folder.obj"]),
        ("bake zero.obj -o out.ply", &["zero.obj", "4"]),
        ("bake past.obj -o out.ply", &["past.obj", "4"]),
        ("bake nan.obj -o out.ply", &["nan.obj", "2"]),
        ("bake inf.obj -o out.ply", &["inf.obj", "2"]),
        ("bake empty.obj -o out.ply", &["empty.obj"]),
        ("bake garbage.obj -o out.ply", &["garbage.obj"]),
        ("bake garbage.ply -o out.ply", &["garbage.ply"]),
        ("bake garbage.glb -o out.ply", &["garbage.glb"]),
        ("bake short.ply -o out.ply", &["short.ply"]),
        ("bake short.glb -o out.ply", &["short.glb"]),
        ("render missing.toml -o out.png", &["missing.toml"]),
        ("render missing.obj -o out.png", &["missing.obj"]),
        ("render scene.toml -o out.jpg", &["out.jpg"]),
        ("render scene.toml -o no/out.png", &["no"]),
        ("render scene.toml -o folder.obj", &["folder.obj"]),
        ("render scene.toml -o out.png --size 0x10", &["0x10"]),
        ("render scene.toml -o out.png --size 100000x10", &["100000"]),
        ("render scene.toml -o out.png --spp 0", &["spp"]),
        ("render scene.toml -o out.png --shadows magic", &["magic", "bvh"]),
        ("render scene.toml -o out.png --ao magic", &["magic", "rays"]),
        ("render scene.toml -o out.exr --shard 3/2", &["3/2"]),
        ("render scene.toml -o out.exr --shard 1/1000", &["1000", "6 tiles"]),
        ("render scene.toml -o out.png --shard 1/2", &["out.png", "exr"]),
        ("bake mesh.obj -o out.ply --rays 0", &["rays"]),
        ("bake mesh.obj -o out.ply --radius 0", &["radius"]),
        ("bake mesh.obj -o out.ply --radius -1", &["-1"]),
        ("bake mesh.obj -o out.ply --radius nan", &["radius"]),
        ("bake mesh.obj -o out.ply --falloff 0,1", &["falloff"]),
        ("bake mesh.obj -o out.ply --falloff linear", &["radius"]),
        ("bake mesh.obj -o out.ply --falloff cubic", &["cubic"]),
        ("bake mesh.obj -o out.png", &["out.png", ".ply"]),
        ("bake mesh.obj -o out.ply --per texel", &["out.ply", ".png"]),
        ("bake mesh.obj -o no/out.ply", &["no"]),
        ("bake mesh.obj -o out.ply --shard 1/2", &["2 shards"]),
        ("bake mesh.obj -o out.ply --normals file", &["mesh.obj", "normals"]),
        ("bake mesh.obj -o out.ply --points mesh.ply", &["mesh.ply"]),
        ("bake mesh.obj -o out.ply --points mesh.ply --per texel", &["--points"]),
        ("bake mesh.obj -o out.ply --stats no/stats.json", &["no/stats.json"]),
        ("render scene.toml -o out.png --stats no/stats.json", &["no/stats.json"]),
        ("inspect missing.ply", &["missing.ply"]),
        ("merge out.exr", &["PART"]),
        ("frobnicate", &["frobnicate"]),
    ];
    for (arguments, words) in mistakes {
        folder.fails(arguments, words);
    }
}

#[test]
fn mistakes_in_scenes_are_named_with_their_line() {
    let folder = folder();
    let with = |from: &str, to: &str| {
        assert!(SCENE.contains(from));
        folder.write("bad.toml", SCENE.replace(from, to));
    };
    let cases: &[(&str, &str, &[&str])] = &[
        ("radius = 0.4", "radiuss = 0.4", &["bad.toml:", "radiuss"]),
        ("\"blob\"", "\"bolb\"", &["bad.toml:15", "bolb"]),
        ("target = [0, 0.3, 0]", "target = [3, 2, 4]", &["bad.toml:", "camera"]),
        ("width = 70", "width = 0", &["bad.toml:3", "width"]),
        ("radius = 1.0", "radius = 0", &["bad.toml:11", "radius"]),
        ("radius = 1.0", "radius = -2", &["bad.toml:11", "radius"]),
        ("generator = \"blob\", triangles = 500", "file = \"none.obj\"", &["bad.toml:", "none.obj"]),
        ("radiance = 30", "radiance = ", &["bad.toml:"]),
    ];
    for (from, to, words) in cases {
        with(from, to);
        folder.fails("render bad.toml -o out.png", words);
    }
}

#[cfg(unix)]
#[test]
fn an_earlier_file_survives_and_a_read_only_one_is_refused() {
    use std::os::unix::fs::PermissionsExt;
    let folder = folder();
    folder.write("out.png", b"earlier");
    folder.fails("render missing.toml -o out.png", &["missing.toml"]);
    assert_eq!(folder.bytes("out.png"), b"earlier");
    fs::set_permissions(folder.path("out.png"), fs::Permissions::from_mode(0o444)).unwrap();
    folder.fails("render scene.toml -o out.png", &["out.png"]);
    assert_eq!(folder.bytes("out.png"), b"earlier");
}

#[test]
fn prefiltered_pictures_and_bakes_are_close_to_exact_ones() {
    let folder = folder();
    let bush =
        SCENE.replace("generator = \"blob\", triangles = 500", "generator = \"bush\", triangles = 20000");
    folder.write("bush.toml", bush);
    folder.ok("render bush.toml -o exact.exr --shadows bvh --ao rays");
    folder.ok("render bush.toml -o fast.exr --shadows prefilter --ao prefilter --stats stats.json");
    folder.ok("compare exact.exr fast.exr --max-rmse 0.25");
    assert!(String::from_utf8(folder.bytes("stats.json")).unwrap().contains("\"prefilter\""));
    // Convex: nothing in the way.
    folder.ok("bake mesh.obj -o ao.ply --method prefilter --rays 16 --stats bake.json");
    assert!(String::from_utf8(folder.bytes("bake.json")).unwrap().contains("\"ao_mean\": 1.0"));
    folder.fails("bake mesh.obj -o ao2.ply --method prefilter --sides front", &["both sides"]);
}
