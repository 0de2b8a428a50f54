//! Every kind of bad input gives one line that names the file, the place and the culprit.

mod common;

use common::{SCENE, glb, glb_of, gltf_parts, ply_ascii, ply_binary};
use std::path::Path;
use umbrage_scene::{Scene, read_mesh, read_points, read_polygons};

/// Writes `bytes` as `name` and returns what `read` says about it, with the folder left out.
fn complaint<T, E: std::error::Error>(
    name: &str,
    bytes: &[u8],
    read: impl Fn(&Path) -> Result<T, E>,
) -> String {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(name);
    std::fs::write(&path, bytes).unwrap();
    let message = match read(&path) {
        Ok(_) => panic!("{name} was accepted: {}", String::from_utf8_lossy(bytes)),
        Err(error) => error.to_string(),
    };
    assert!(!message.contains('\n'), "{message}");
    message.replace(&format!("{}/", folder.path().display()), "")
}

/// What differs from what is expected, all of it.
#[derive(Default)]
struct Differences(Vec<String>);

impl Differences {
    fn check(&mut self, said: &str, expected: &str) {
        if said != expected {
            self.0.push(format!("  said     {said}\n  expected {expected}\n"));
        }
    }
}

impl Drop for Differences {
    fn drop(&mut self) {
        if !std::thread::panicking() {
            assert!(self.0.is_empty(), "\n{}", self.0.join("\n"));
        }
    }
}

#[test]
fn obj() {
    let mut differences = Differences::default();
    const V: &str = "v 0 0 0\nv 1 0 0\nv 0 1 0\n";
    let cases: &[(&str, &str)] = &[
        ("", "a.obj: the mesh has no triangles"),
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\n", "a.obj: the mesh has no triangles"),
        ("Vf 0 1 2\n", "a.obj:4: vertex index 0 (indices start at 1)"),
        ("Vf 1 2 4\n", "a.obj:4: vertex index 4 is past the end (the file has 3)"),
        ("Vf 1 2 -4\n", "a.obj:4: vertex index -4 reaches back past the first of 3"),
        ("Vf 1 2 99999999999999999999\n", "a.obj:4: '99999999999999999999' is not a vertex index"),
        ("Vf 1 2 4294967295\n", "a.obj:4: vertex index 4294967295 is past the end"),
        ("Vf 1 2 4294967296\n", "a.obj:4: vertex index 4294967296 is past the end"),
        ("Vf 1 2 x\n", "a.obj:4: 'x' is not a vertex index"),
        ("Vf 1 2 3.0\n", "a.obj:4: '3.0' is not a vertex index"),
        ("Vf 1 2\n", "a.obj:4: face has 2 corners, expected at least 3"),
        ("Vf 1/1 2 3\n", "a.obj:4: texture coordinate index 1 is past the end (the file has 0)"),
        ("Vf 1//0 2 3\n", "a.obj:4: normal index 0 (indices start at 1)"),
        ("Vf 1/1/1/1 2 3\n", "a.obj:4: '1/1/1/1' has more than three indices"),
        ("Vvt 0\nf 1/1//1 2 3\n", "a.obj:5: '1/1//1' has more than three indices"),
        ("v 0 0\n", "a.obj:1: vertex has 2 coordinates, expected 3"),
        ("v 0 0 zero\n", "a.obj:1: vertex: 'zero' is not a number"),
        ("Vv 0 nan 0\nf 1 2 3\n", "a.obj:4: vertex: nan is not finite"),
        ("Vv 0 -inf 0\nf 1 2 3\n", "a.obj:4: vertex: -inf is not finite"),
        ("Vv 0 1e39 0\nf 1 2 3\n", "a.obj:4: vertex: 1e39 is not finite"),
        ("Vv 0 1e30 0\nf 1 2 3\n", "a.obj:4: vertex has a coordinate beyond 1e24"),
        ("Vvn 0 0\n", "a.obj:4: normal has 2 coordinates, expected 3"),
        ("Vvt inf\n", "a.obj:4: texture coordinate: inf is not finite"),
        ("\u{7f}ELF\u{2}\u{1}\u{1}\0\0\0", "a.obj:1: not text: this is not an OBJ file"),
    ];
    for (text, expected) in cases {
        let text = text.replace('V', V);
        differences.check(&complaint("a.obj", text.as_bytes(), read_mesh), expected);
        differences.check(&complaint("a.obj", text.as_bytes(), read_polygons), expected);
    }
    let tags = [
        ("#t crease 2/1/0 0 7 1", "a.obj: a tag names vertex 7, but there are only 3 (from 0)"),
        ("t crease 2/1/0 0 x 1", "a.obj:5: crease tag: 'x' is not a vertex"),
        ("t crease", "a.obj:5: crease tag without counts such as 2/1/0"),
        ("t corner 1/1/0 0 nan", "a.obj:5: corner tag: 'nan' is not a sharpness"),
        ("t crease 3/3/0 0 1 2 1 1 1", "a.obj:5: crease tag with 3 vertices and 3 numbers"),
    ];
    for (tag, expected) in tags {
        let text = format!("{V}f 1 2 3\n{tag}\n");
        differences.check(&complaint("a.obj", text.as_bytes(), read_polygons), expected);
    }
}

#[test]
fn ply() {
    let mut differences = Differences::default();
    let ascii = String::from_utf8(ply_ascii()).unwrap();
    let little = ply_binary(false);
    let header = little.len() - (4 * 17 + 18 + 14);
    let cases: Vec<(Vec<u8>, &str)> = vec![
        (b"".into(), "a.ply:1: it does not start with 'ply'"),
        (b"\x89PNG\r\n\x1a\n".into(), "a.ply:1: it does not start with 'ply'"),
        (
            ascii[..ascii.find("property double").unwrap()].into(),
            "a.ply:7: PLY header: Unexpected end of file while reading header (missing 'end_header')",
        ),
        (
            ascii.replace("ascii", "morse").into(),
            "a.ply:2: PLY header: 'format morse 1.0' is not a header line",
        ),
        (ascii.replace("1 0 0 0", "1 0 nan 0").into(), "a.ply:14: vertex 1: z is NaN, not a finite number"),
        (ascii.replace("1 0 0 0", "1 1e39 0 0").into(), "a.ply:14: vertex 1: y is inf, not a finite number"),
        (
            ascii.replace("1 0 0 0", "1 0 1e300 0").into(),
            "a.ply:14: vertex 1: z is 1e300, not a finite number",
        ),
        (
            ascii.replace("1 0 0 0", "1 0 -1e30 0").into(),
            "a.ply: vertex 1 has a coordinate beyond 1e24: (1, 0, -1000000000000000000000000000000)",
        ),
        (ascii.replace("1 0 0 0", "1 0 0").into(), "a.ply:14: vertex 1: the line has too few values"),
        (
            ascii.replace("1 0 0 0", "1 0 0 0 5").into(),
            "a.ply:14: vertex 1: surplus '5' at the end of the line",
        ),
        (ascii.replace("1 0 0 0", "1 0 x 0").into(), "a.ply:14: vertex 1: 'x' is not a number"),
        (
            ascii.replace("3 2 1 0", "3 2 1 4").into(),
            "a.ply: triangle 2 uses vertex 4, but there are only 4 (indices from 0)",
        ),
        (ascii.replace("3 2 1 0", "3 2 1 -1").into(), "a.ply:19: face 1: -1 is not a vertex"),
        (ascii.replace("3 2 1 0", "2 2 1").into(), "a.ply:19: face 1: 2 corners, expected at least 3"),
        (ascii.replace("3 2 1 0", "-3 2 1 0").into(), "a.ply:19: face 1: a list of -3 values"),
        (ascii.replace("3 2 1 0", "3 2 1.5 0").into(), "a.ply:19: face 1: '1.5' is not an integer"),
        (ascii.replace("9 3 2 1 0\n", "").into(), "a.ply: it ends after 1 of 2 elements 'face'"),
        (
            ascii.replace("vertex 4", "vertex 4000000000").into(),
            "a.ply: the header promises 4000000000 elements 'vertex', at least 32000000000 bytes, but only 59 follow",
        ),
        (
            ascii.replace("face 2", "face 18446744073709551615").into(),
            "a.ply: the header promises 18446744073709551615 elements 'face', at least 73786976294838206460 bytes, \
             but only 22 follow",
        ),
        (
            ascii.replace("element face 2\n", "element edge 2\n").into(),
            "a.ply: it has no element 'face' (is it a point cloud?)",
        ),
        (
            ascii.replace("vertex_indices", "indices").into(),
            "a.ply: element 'face' has no list of integers 'vertex_indices' or 'vertex_index'",
        ),
        (ascii.replace("float x", "float a").into(), "a.ply: it has no element 'vertex' with x, y and z"),
        (ascii.replace("face 2", "face 0").into(), "a.ply: the mesh has no triangles"),
        (
            little[..header + 30].into(),
            "a.ply: the header promises 4 elements 'vertex', at least 68 bytes, but only 30 follow",
        ),
        (little[..little.len() - 5].into(), "a.ply: face 1: the file ends here"),
    ];
    for (bytes, expected) in cases {
        differences.check(&complaint("a.ply", &bytes, read_mesh), expected);
    }
    let points = |properties: &str, line: &str| {
        let text = format!("ply\nformat ascii 1.0\nelement vertex 1\n{properties}end_header\n{line}\n");
        complaint("a.ply", text.as_bytes(), read_points)
    };
    let xyz = "property float x\nproperty float y\nproperty float z\n";
    let all = format!("{xyz}{}", xyz.replace("float ", "float n"));
    assert_eq!(points(xyz, "1 2 3"), "a.ply: its points have no normals (properties nx, ny and nz)");
    assert_eq!(points(&all, "1 2 3 0 0 0"), "a.ply: the normal of point 0 has no length: (0, 0, 0)");
    assert_eq!(points(&all, "1 2 3 0 nan 0"), "a.ply:11: vertex 0: ny is NaN, not a finite number");
}

#[test]
fn gltf() {
    let mut differences = Differences::default();
    let (json, bin) = gltf_parts();
    let with = |from: &str, to: &str| {
        assert!(json.contains(from), "{from}");
        glb_of(&json.replace(from, to), &bin)
    };
    let cases: Vec<(&str, Vec<u8>, &str)> = vec![
        ("a.glb", b"".into(), "a.glb: not valid glTF: EOF while parsing a value at line 1 column 0"),
        ("a.glb", b"\x7fELF".into(), "a.glb: not valid glTF: expected value at line 1 column 1"),
        ("a.gltf", b"{}".into(), "a.gltf: not valid glTF: missing field `asset` at line 1 column 2"),
        (
            "a.gltf",
            json.replace("\"byteLength\":56", "\"byteLength\":56,\"uri\":\"mesh%20data.bin\"").into(),
            "a.gltf: buffer 0: cannot read mesh data.bin: No such file or directory (os error 2)",
        ),
        (
            "a.gltf",
            json.replace("\"byteLength\":56", "\"byteLength\":56,\"uri\":\"%ff\"").into(),
            "a.gltf: buffer 0: '%ff' is not a relative path",
        ),
        (
            "a.gltf",
            json.replace("\"byteLength\":56", "\"byteLength\":56,\"uri\":\"https://example.org/a\"").into(),
            "a.gltf: buffer 0: 'https://example.org/a' is not a relative path",
        ),
        (
            "a.gltf",
            json.replace("\"byteLength\":56", "\"byteLength\":56,\"uri\":\"data:;base64,AAAA\"").into(),
            "a.gltf: buffer 0 should have 56 bytes, but has 4",
        ),
        ("a.gltf", json.clone().into(), "a.gltf: buffer 0 has no binary chunk"),
        (
            "a.glb",
            with("\"byteLength\":56", "\"byteLength\":60"),
            "a.glb: buffer 0 should have 60 bytes, but has 56",
        ),
        ("a.glb", with("\"scene\":0,\"scenes\":[{\"nodes\":[0]}],", ""), "a.glb: it has no scene (1 meshes)"),
        (
            "a.glb",
            with("\"scenes\":[{\"nodes\":[0]}]", "\"scenes\":[{\"nodes\":[]}]"),
            "a.glb: the mesh has no triangles",
        ),
        (
            "a.glb",
            with("\"mesh\":0,", "\"mesh\":0,\"children\":[0],"),
            "a.glb: node 0 has more than one parent",
        ),
        // The library's own validation would panic on these two.
        ("a.glb", with("{\"POSITION\":0}", "{\"POSITION\":2}"), "a.glb: mesh 0: there is no accessor 2"),
        ("a.glb", with("\"accessors\"", "\"accessories\""), "a.glb: mesh 0: there is no accessor 0"),
        (
            "a.glb",
            with("\"count\":3,\"type\":\"VEC3\"", "\"count\":4000000000,\"type\":\"VEC3\""),
            "a.glb: mesh 0 primitive 0: POSITION reaches past the end of its buffer",
        ),
        (
            "a.glb",
            with(
                "{\"bufferView\":0,\"componentType\":5126,\"count\":3",
                "{\"componentType\":5126,\"count\":4000000000",
            ),
            "a.glb: mesh 0 primitive 0: POSITION has 4000000000 values without data",
        ),
        (
            "a.glb",
            with("\"sparse\":{\"count\":1", "\"sparse\":{\"count\":9"),
            "a.glb: mesh 0 primitive 0: POSITION replaces 9 of 3 values",
        ),
        (
            "a.glb",
            with("\"count\":3,\"type\":\"SCALAR\"", "\"count\":3,\"type\":\"VEC2\""),
            "a.glb: mesh 0 primitive 0: indices is Vec2 of U16, expected Scalar of [U8, U16, U32]",
        ),
        (
            "a.glb",
            with("\"translation\":[10,0,0]", "\"translation\":[1e30,0,0]"),
            "a.glb: mesh 0 primitive 0: after the transforms of its nodes, vertex 0 has a coordinate beyond 1e24: \
             (1000000000000000000000000000000, 0, 0)",
        ),
    ];
    for (name, bytes, expected) in cases {
        differences.check(&complaint(name, &bytes, read_mesh), expected);
    }
    let mut bad_index = bin.clone();
    bad_index[36] = 3;
    assert_eq!(
        complaint("a.glb", &glb_of(&json, &bad_index), read_mesh),
        "a.glb: mesh 0 primitive 0: index 3 is past the end (3 vertices, from 0)"
    );
    let mut nan = bin;
    nan[..4].copy_from_slice(&f32::NAN.to_le_bytes());
    assert_eq!(
        complaint("a.glb", &glb_of(&json, &nan), read_mesh),
        "a.glb: mesh 0 primitive 0: vertex 0 is not finite: (NaN, 0, 0)"
    );
    assert!(read_error("a.glb", &glb()[..60]).starts_with("a.glb: not valid glTF: "));
}

fn read_error(name: &str, bytes: &[u8]) -> String {
    complaint(name, bytes, read_mesh)
}

#[test]
fn paths() {
    let folder = tempfile::tempdir().unwrap();
    let said = |name: &str| {
        let message = read_mesh(&folder.path().join(name)).unwrap_err().to_string();
        message.replace(&format!("{}/", folder.path().display()), "")
    };
    std::fs::create_dir(folder.path().join("folder.obj")).unwrap();
    std::fs::write(folder.path().join("a.stl"), "solid").unwrap();
    assert_eq!(said("no.obj"), "no.obj: cannot read it: No such file or directory (os error 2)");
    assert_eq!(said("folder.obj"), "folder.obj: it is a folder, not a mesh file");
    assert_eq!(said("a.stl"), "a.stl: unknown extension, expected .obj, .ply, .gltf or .glb");
    assert_eq!(said("mesh"), "mesh: unknown extension, expected .obj, .ply, .gltf or .glb");
    let scene = Scene::load(folder.path()).unwrap_err().to_string();
    assert_eq!(scene, format!("{}: it is a folder, not a scene file", folder.path().display()));
    let scene = Scene::load(Path::new("no.toml")).unwrap_err().to_string();
    assert_eq!(scene, "no.toml: cannot read it: No such file or directory (os error 2)");
}

#[test]
fn scenes() {
    let mut differences = Differences::default();
    // What to replace in the valid scene, by what, and what is said then.
    let cases: &[(&str, &str, &str)] = &[
        (SCENE, "", "scene:1:1: scene: there are no objects: add [[objects]]"),
        (SCENE, "a = ", "scene:1:5: string values must be quoted, expected literal string"),
        (
            "width = 320",
            "widht = 320",
            "scene:4:1: image: unknown key 'widht', expected one of exposure, height, seed, spp, width",
        ),
        ("width = 320", "width = 0", "scene:4:9: image: width must be a whole number from 1 to 65536, not 0"),
        (
            "width = 320",
            "width = 65537",
            "scene:4:9: image: width must be a whole number from 1 to 65536, not 65537",
        ),
        (
            "width = 320",
            "width = 3.5",
            "scene:4:9: image: width must be a whole number from 1 to 65536, not 3.5",
        ),
        ("spp = 4", "spp = 0", "scene:5:7: image: spp must be a whole number from 1 to 1048576, not 0"),
        ("spp = 4", "spp = 4\nspp = 5", "scene:6:1: duplicate key"),
        ("spp = 4", "exposure = nan", "scene:5:12: image: exposure must be finite, not NaN"),
        (
            "[image]",
            "[images]",
            "scene:3:2: scene: unknown key 'images', expected one of ambient, background, camera, image, lights, materials, meshes, methods, objects",
        ),
        (
            "target = [0, 0, 0]\n[ambient]",
            "target = [0, 1, 5]\n[ambient]",
            "scene:8:10: camera: target must not be the position: the camera looks at itself",
        ),
        ("target = [0, 0, 0]\n[ambient]", "[ambient]", "scene:6:1: camera: 'target' is missing"),
        (
            "target = [0, 0, 0]\n[ambient]",
            "target = [0, 9, 5]\n[ambient]",
            "scene:8:10: camera: target leaves 'up' along the view; set 'up' to another direction",
        ),
        (
            "target = [0, 0, 0]\n[ambient]",
            "target = [0, 0, 0]\nup = [0, 2, 10]\n[ambient]",
            "scene:9:6: camera: up leaves 'up' along the view; set 'up' to another direction",
        ),
        (
            "target = [0, 0, 0]\n[ambient]",
            "target = [0, 0, 0]\nup = [0, 0, 0]\n[ambient]",
            "scene:9:6: camera: up must not have length 0",
        ),
        (
            "target = [0, 0, 0]\n[ambient]",
            "target = [0, 0, 0]\nfov = 180\n[ambient]",
            "scene:9:7: camera: fov must be above 0 and below 180 degrees, not 180",
        ),
        (
            "target = [0, 0, 0]\n[ambient]",
            "target = [0, 0, inf]\n[ambient]",
            "scene:8:17: camera: target must be finite, not inf",
        ),
        (
            "target = [0, 0, 0]\n[ambient]",
            "target = [0, 0]\n[ambient]",
            "scene:8:10: camera: target must be an array of 3 numbers, not an array of 2",
        ),
        ("radius = \"5%\"", "radius = \"0%\"", "scene:10:10: ambient: radius must be above 0, not 0%"),
        ("radius = \"5%\"", "radius = -1", "scene:10:10: ambient: radius must be above 0, not -1"),
        (
            "radius = \"5%\"",
            "radius = \"far\"",
            "scene:10:10: ambient: radius must be a length above 0, or a share of the diagonal such as \"5%\", not \"far\"",
        ),
        ("radius = \"5%\"", "", "scene:11:11: ambient: falloff needs a radius to fade over"),
        (
            "\"linear\"",
            "\"cubic\"",
            "scene:11:11: ambient: falloff can't be used: unknown falloff 'cubic': expected constant, linear, quadratic, exponential or a table of weights",
        ),
        (
            "\"linear\"",
            "[1, 2]",
            "scene:11:11: ambient: falloff can't be used: falloff weight 1 is 2, which is not between 0 and 1",
        ),
        (
            "[0.2, 0.5, 0.1]",
            "[0.2, 1.5, 0.1]",
            "scene:13:10: material 'leaf': albedo must be between 0 and 1",
        ),
        (
            "[0.2, 0.5, 0.1]",
            "[0.2, -0.5, 0.1]",
            "scene:13:10: material 'leaf': albedo must not be negative, but holds -0.5",
        ),
        (
            "opacity = 0.9",
            "opacity = 1.1",
            "scene:14:11: material 'leaf': opacity must be between 0 and 1, not 1.1",
        ),
        (
            "opacity = 0.9",
            "opacity = \"full\"",
            "scene:14:11: material 'leaf': opacity must be a number, not \"full\"",
        ),
        (
            "triangles = 200",
            "triangles = 0",
            "scene:17:13: mesh 'ball': triangles must be a whole number from 1 to 4294967295, not 0",
        ),
        (
            "triangles = 200",
            "size = 200",
            "scene:17:1: mesh 'ball': generator 'sphere' has no parameter 'size' (known: seed, triangles, level)",
        ),
        (
            "triangles = 200",
            "file = \"a.obj\"",
            "scene:15:1: mesh 'ball': needs either 'file' or 'generator'",
        ),
        (
            "triangles = 200",
            "triangles = 4000000000",
            "scene:16:1: mesh 'ball': generator 'sphere' would make 4000000000 triangles, more than 134217728",
        ),
        (
            "generator = \"sphere\"\ntriangles = 200",
            "file = \"no.obj\"",
            "scene:16:8: mesh 'ball': file can't be used: no.obj: cannot read it: No such file or directory (os error 2)",
        ),
        (
            "triangles = 200",
            "subdivide = 1",
            "scene:17:13: mesh 'ball': subdivide needs a generator of control meshes",
        ),
        ("triangles = 200", "subdivide = 0", "scene:17:13: mesh 'ball': subdivide must be above 0, not 0"),
        (
            "triangles = 200",
            "subdivide = true",
            "scene:17:13: mesh 'ball': subdivide must be a length in pixels or a table, not true",
        ),
        (
            "triangles = 200",
            "subdivide = { level = 13 }",
            "scene:17:23: subdivide: level must be a whole number from 0 to 12, not 13",
        ),
        (
            "triangles = 200",
            "subdivide = { level = 3, pixels = 1 }",
            "scene:17:13: subdivide: takes 'pixels' or 'level', not both",
        ),
        (
            "triangles = 200",
            "subdivide = { boundary = \"round\" }",
            "scene:17:26: subdivide: boundary must be 'edge-only' or 'edge-and-corner', not \"round\"",
        ),
        (
            "triangles = 200",
            "subdivide = { creases = \"sharp\" }",
            "scene:17:25: subdivide: creases must be 'uniform' or 'chaikin', not \"sharp\"",
        ),
        (
            "triangles = 200",
            "subdivide = { rate = 2 }",
            "scene:17:15: subdivide: unknown key 'rate', expected one of boundary, creases, level, pixels",
        ),
        (
            "generator = \"sphere\"\ntriangles = 200",
            "file = \"no.ply\"\nsubdivide = 1",
            "scene:16:8: mesh 'ball': file can't be used: no.ply: unknown extension, expected .obj",
        ),
        (
            "mesh = \"ball\"",
            "mesh = \"bal\"",
            "scene:19:8: object 1: mesh 'bal' is not one of the meshes (ball)",
        ),
        (
            "material = \"leaf\"",
            "material = \"lead\"",
            "scene:20:12: object 1: material 'lead' is not one of the materials (leaf)",
        ),
        (
            "material = \"leaf\"",
            "materials = { skin = \"leaf\" }",
            "scene:20:15: object 1: its mesh has no object 'skin' (sphere)",
        ),
        ("material = \"leaf\"", "scale = 0", "scene:20:9: object 1: scale must not be 0"),
        (
            "material = \"leaf\"",
            "scale = [1, 1e-8, 1]",
            "scene:18:1: object 1: its transform can't be inverted (a scale or a matrix flattens it, or is too large or small)",
        ),
        (
            "rotate = { axis",
            "matrix = [[1, 0, 0, 0], [0, 1, 0, 0], [1, 0, 0, 0]] #",
            "scene:18:1: object 1: its transform can't be inverted (a scale or a matrix flattens it, or is too large or small)",
        ),
        (
            "rotate = { axis",
            "matrix = [[1, 0, 0, 0], [0, 1, 0, 0]] #",
            "scene:21:10: object 1: matrix must be three rows of four numbers, not an array of 2",
        ),
        (
            "rotate = { axis",
            "translate = [1e30, 0, 0] #",
            "scene:18:1: object 1: its transform moves it beyond 1e24",
        ),
        ("axis = [0, 1, 0]", "axis = [0, 0, 0]", "scene:21:19: rotate: axis must not have length 0"),
        (
            "transforms = [{ translate = [1, 0, 0] }, { scale = [1, 2, 1] }]",
            "transforms = []",
            "scene:24:14: object 2: transforms must have 1 to 1000000 entries, not 0",
        ),
        (
            "{ scale = [1, 2, 1] }",
            "{ scael = 1 }",
            "scene:24:44: object 2 transform 2: unknown key 'scael', expected one of matrix, rotate, scale, translate",
        ),
        (
            "size = [1, 1]",
            "size = [1, 0]",
            "scene:29:8: light 1: size must be two lengths above 0, not 1 and 0",
        ),
        (
            "center = [0, 3, 0]",
            "center = [0, 0, 0]",
            "scene:28:10: light 1: target must not be where the light is",
        ),
        (
            "center = [0, 3, 0]",
            "corner = [0, 0, 0]\nu = [1, 0, 0]\nv = [2, 0, 0]",
            "scene:29:5: light 1: v must not be parallel to u: the light would have no area",
        ),
        (
            "radiance = 5",
            "radiance = -5",
            "scene:30:12: light 1: radiance must not be negative, but holds -5",
        ),
        ("radiance = 5", "radiance = nan", "scene:30:12: light 1: radiance must be finite, not NaN"),
        (
            "type = \"rectangle\"",
            "type = \"square\"",
            "scene:26:8: light 1: type must be \"rectangle\", \"disc\", \"sphere\", \"point\", \"spot\" or \"directional\", not \"square\"",
        ),
        (
            "direction = [0, -1, 0.5]",
            "direction = [0, 0, 0]",
            "scene:34:13: light 'sun': direction must not have length 0",
        ),
        ("angle = 0.53", "angle = -1", "scene:36:9: light 'sun': angle must be between 0 and 180, not -1"),
        (
            "angle = 0.53",
            "radiuss = 1",
            "scene:36:1: light 'sun': unknown key 'radiuss', expected one of angle, direction, irradiance, name, type",
        ),
    ];
    for (from, to, expected) in cases {
        assert!(SCENE.contains(from), "{from}");
        let text = SCENE.replacen(from, to, 1);
        match Scene::parse(&text, Path::new("")) {
            Ok(_) => panic!("accepted: {to}"),
            Err(error) => differences.check(&error.to_string(), expected),
        }
    }
    let sun = "[[lights]]\nname = \"sun\"\ntype = \"sphere\"\ncenter = [0, 0, 0]\nradius = 0\nradiance = 1\n";
    for (extra, expected) in [
        (sun.to_string(), "light 3: name 'sun' is taken by another light"),
        (sun.replace("sun", "bulb"), "light 'bulb': radius must be above 0, not 0"),
        (
            "[[lights]]\ntype = \"spot\"\nposition = [0, 0, 0]\ndirection = [0, -1, 0]\nouter_angle = 30\n\
             inner_angle = 40\nintensity = 1"
                .into(),
            "light 3: inner_angle must be from 0 to outer_angle (30), not 40",
        ),
    ] {
        let error = Scene::parse(&format!("{SCENE}{extra}"), Path::new("")).unwrap_err().to_string();
        assert!(error.ends_with(expected), "{error}");
    }
    let said = complaint("a.toml", b"background = \"\xff\"", Scene::load);
    assert_eq!(said, "a.toml:1:15: not UTF-8 text: this is not a scene file");
    let unknown = SCENE.replace("\"sphere\"", "\"spher\"");
    let error = Scene::parse(&unknown, Path::new("")).unwrap_err().to_string();
    assert!(error.starts_with("scene:16:1: mesh 'ball': unknown generator 'spher' (known: "), "{error}");
}
