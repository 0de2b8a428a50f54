//! One line for each mistake, and no file that it leaves behind.

mod common;

use common::{SCENE, folder};
use std::fs;

#[test]
fn every_mistake_is_one_line_that_names_the_culprit() {
    let folder = folder();
    let write = |name: &str, content: &[u8]| fs::write(folder.path(name), content).unwrap();
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
