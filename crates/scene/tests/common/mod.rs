#![allow(dead_code, reason = "each test program uses some of it")]
//! Small valid files of each format, and where the real meshes are.

use std::path::PathBuf;

pub const OBJ: &str = "# a quad and a triangle\no quad\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 1\nvn 0 0 1\n\
                       f 1/1/1 2/2/1 3/1/1 4/2/1\ng tip\nf -4 -3 -2\n";

pub const PLY_HEADER: &str = "ply\nformat FORMAT 1.0\ncomment test\nelement vertex 4\nproperty float x\n\
                              property float y\nproperty double z\nproperty uchar red\nelement face 2\n\
                              property uchar flag\nproperty list uchar int vertex_indices\nend_header\n";

pub fn ply_ascii() -> Vec<u8> {
    let body = "0 0 0 255\n1 0 0 0\n1 1 0.5 0\n\n0 1 0 7\n9 4 0 1 2 3\n9 3 2 1 0\n";
    (PLY_HEADER.replace("FORMAT", "ascii") + body).into_bytes()
}

pub fn ply_binary(big: bool) -> Vec<u8> {
    let format = if big { "binary_big_endian" } else { "binary_little_endian" };
    let mut bytes = PLY_HEADER.replace("FORMAT", format).into_bytes();
    let mut put = |little: &[u8]| {
        let ordered: Vec<u8> = if big { little.iter().rev().copied().collect() } else { little.to_vec() };
        bytes.extend(ordered);
    };
    for ([x, y, z], red) in
        [([0.0, 0.0, 0.0], 255), ([1.0, 0.0, 0.0], 0), ([1.0, 1.0, 0.5], 0), ([0f32, 1.0, 0.0], 7)]
    {
        put(&x.to_le_bytes());
        put(&y.to_le_bytes());
        put(&f64::from(z).to_le_bytes());
        put(&[red]);
    }
    for corners in [&[0i32, 1, 2, 3][..], &[2, 1, 0]] {
        put(&[9]);
        put(&[corners.len() as u8]);
        corners.iter().for_each(|c| put(&c.to_le_bytes()));
    }
    bytes
}

/// A GLB with one triangle at z = 0 under two nodes, and a binary chunk of positions, indices and sparse replacements:
/// vertex 2 becomes (0, 3, 0).
pub fn glb() -> Vec<u8> {
    let (json, bin) = gltf_parts();
    glb_of(&json, &bin)
}

pub fn gltf_parts() -> (String, Vec<u8>) {
    let mut bin = Vec::new();
    for x in [0f32, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0] {
        bin.extend(x.to_le_bytes());
    }
    for i in [0u16, 1, 2, 2] {
        bin.extend(i.to_le_bytes());
    }
    for x in [0f32, 3.0, 0.0] {
        bin.extend(x.to_le_bytes());
    }
    let json = r#"{"asset":{"version":"2.0"},"scene":0,"scenes":[{"nodes":[0]}],
        "nodes":[{"children":[1],"translation":[10,0,0]},{"mesh":0,"scale":[2,2,2],"name":"leaf"}],
        "meshes":[{"primitives":[{"attributes":{"POSITION":0},"indices":1}]}],
        "accessors":[
            {"bufferView":0,"componentType":5126,"count":3,"type":"VEC3","min":[0,0,0],"max":[1,3,0],
             "sparse":{"count":1,"indices":{"bufferView":1,"byteOffset":4,"componentType":5123},
                       "values":{"bufferView":2}}},
            {"bufferView":1,"componentType":5123,"count":3,"type":"SCALAR"}],
        "bufferViews":[{"buffer":0,"byteLength":36},{"buffer":0,"byteOffset":36,"byteLength":8},
                       {"buffer":0,"byteOffset":44,"byteLength":12}],
        "buffers":[{"byteLength":56}]}"#;
    (json.into(), bin)
}

pub fn glb_of(json: &str, bin: &[u8]) -> Vec<u8> {
    let mut json = json.as_bytes().to_vec();
    json.resize(json.len().next_multiple_of(4), b' ');
    let mut glb = b"glTF\x02\0\0\0".to_vec();
    glb.extend((28 + json.len() as u32 + bin.len() as u32).to_le_bytes());
    for (kind, chunk) in [(b"JSON", &json[..]), (b"BIN\0", bin)] {
        glb.extend((chunk.len() as u32).to_le_bytes());
        glb.extend(kind);
        glb.extend(chunk);
    }
    glb
}

pub const SCENE: &str = r#"
background = [0.1, 0.1, 0.1]
[image]
width = 320
spp = 4
[camera]
position = [0, 1, 5]
target = [0, 0, 0]
[ambient]
radius = "5%"
falloff = "linear"
[materials.leaf]
albedo = [0.2, 0.5, 0.1]
opacity = 0.9
[meshes.ball]
generator = "sphere"
triangles = 200
[[objects]]
mesh = "ball"
material = "leaf"
rotate = { axis = [0, 1, 0], angle = 30 }
[[objects]]
mesh = { generator = "box" }
transforms = [{ translate = [1, 0, 0] }, { scale = [1, 2, 1] }]
[[lights]]
type = "rectangle"
center = [0, 3, 0]
target = [0, 0, 0]
size = [1, 1]
radiance = 5
[[lights]]
name = "sun"
type = "directional"
direction = [0, -1, 0.5]
irradiance = [1, 1, 0.9]
angle = 0.53
"#;

/// The folder of real meshes, if there is one; says so if not.
pub fn real_meshes() -> Option<PathBuf> {
    let folder = match std::env::var_os("UMBRAGE_MESHES") {
        Some(folder) => PathBuf::from(folder),
        None => PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../../shared/meshes"),
    };
    let found = folder.join("closed").is_dir();
    if !found {
        eprintln!("SKIPPED: no meshes at {} (set UMBRAGE_MESHES)", folder.display());
    }
    found.then_some(folder)
}
