//! Valid files of each format, what is written is read again, and a second reader agrees.

mod common;

use common::{OBJ, SCENE, glb, glb_of, gltf_parts, ply_ascii, ply_binary};
use proptest::prelude::*;
use std::path::Path;
use umbrage_geom::{Falloff, MeshObject, TriangleMesh};
use umbrage_scene::{
    Light, Radius, Scene, VertexAttributes, WriteMeshError, read_mesh, read_points, read_polygons, write_obj,
    write_ply,
};

fn read_bytes(name: &str, bytes: &[u8]) -> TriangleMesh {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(name);
    std::fs::write(&path, bytes).unwrap();
    read_mesh(&path).unwrap()
}

#[test]
fn every_form_of_ply_is_the_same_mesh() {
    let ascii = read_bytes("a.ply", &ply_ascii());
    assert_eq!(ascii.positions, [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.5], [0.0, 1.0, 0.0]]);
    assert_eq!(ascii.triangles, [[0, 1, 2], [0, 2, 3], [2, 1, 0]]);
    assert_eq!(read_bytes("a.PLY", &ply_binary(false)), ascii);
    assert_eq!(read_bytes("a.ply", &ply_binary(true)), ascii);
    let windows = String::from_utf8(ply_ascii()).unwrap().replace('\n', "\r\n");
    assert_eq!(read_bytes("a.ply", windows.as_bytes()), ascii);
}

#[test]
fn ply_vertex_attributes_go_to_corners() {
    let text = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float nx\nproperty float ny\nproperty float nz\n\
                property float x\nproperty float y\nproperty float z\nproperty float u\nproperty float v\n\
                element face 1\nproperty list uchar uint vertex_index\nend_header\n\
                0 0 2 0 0 0 0 1\n0 1 0 1 0 0 .5 .5\n0 0 0 0 1 0 1 0\n3 0 1 2\n";
    let mesh = read_bytes("a.ply", text.as_bytes());
    assert_eq!(mesh.corner_normals, [[[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]]);
    assert_eq!(mesh.corner_uvs, [[[0.0, 1.0], [0.5, 0.5], [1.0, 0.0]]]);
}

#[test]
fn gltf_nodes_place_meshes_and_sparse_values_replace() {
    let mesh = read_bytes("a.glb", &glb());
    assert_eq!(mesh.positions, [[10.0, 0.0, 0.0], [12.0, 0.0, 0.0], [10.0, 6.0, 0.0]]);
    assert_eq!(mesh.triangles, [[0, 1, 2]]);
    assert_eq!(mesh.objects[0].name, "leaf");
    let (json, bin) = gltf_parts();
    // No indices; and a buffer in a file of its own.
    let plain = json.replace(",\"indices\":1", "").replace("\"scale\":[2,2,2],", "\"scale\":[-2,2,2],");
    let mirrored = read_bytes("a.glb", &glb_of(&plain, &bin));
    assert_eq!(mirrored.positions[1], [8.0, 0.0, 0.0]);
    assert_eq!(mirrored.triangles, [[0, 2, 1]], "outside stays outside");
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("mesh data.bin"), &bin).unwrap();
    let path = folder.path().join("a.gltf");
    let external = json.replace("\"byteLength\":56", "\"byteLength\":56,\"uri\":\"mesh%20data.bin\"");
    std::fs::write(&path, external).unwrap();
    assert_eq!(read_mesh(&path).unwrap(), mesh);
}

fn two_part_mesh() -> TriangleMesh {
    let part = |name: &str, triangles| MeshObject { name: name.into(), triangles, opacity: 1.0 };
    let mut mesh = TriangleMesh::new(
        vec![[0.1, 1e-20, -3.0], [1.0 / 3.0, 0.0, 0.0], [0.0, 7e9, 0.0], [0.0, 0.0, 1.0]],
        vec![[0, 1, 2], [1, 2, 3], [0, 3, 1]],
    )
    .unwrap();
    mesh.objects = vec![part("a b", 0..1), part("c", 1..3)];
    mesh.corner_uvs = vec![[[0.25, 0.5], [1.0, 0.1], [0.0, 0.3]]; 3];
    mesh
}

#[test]
fn what_is_written_is_read_again() {
    let mesh = two_part_mesh();
    let ao = [0.0, 0.5, 1.0, 0.25f32];
    let normals = mesh.smooth_normals();
    let attributes = VertexAttributes {
        normals: Some(&normals),
        colors: Some(&[[255, 0, 51]; 4]),
        scalars: &[("ao", &ao)],
        comments: &["ao: 1 is open\nsecond line"],
    };
    let folder = tempfile::tempdir().unwrap();
    let ply = folder.path().join("out.ply");
    write_ply(&ply, &mesh, &attributes).unwrap();
    let read = read_mesh(&ply).unwrap();
    assert_eq!((&read.positions, &read.triangles), (&mesh.positions, &mesh.triangles));
    assert_eq!(read.corner_uvs, mesh.corner_uvs);
    for (corners, triangle) in read.corner_normals.iter().zip(&mesh.triangles) {
        for (normal, &v) in corners.iter().zip(triangle) {
            let off = normal.iter().zip(normals[v as usize]).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
            assert!(off < 1e-6);
        }
    }
    assert_eq!(read_points(&ply).unwrap().positions, mesh.positions);
    let obj = folder.path().join("out.obj");
    write_obj(&obj, &mesh, &attributes).unwrap();
    assert_eq!(read_mesh(&obj).unwrap(), mesh);
    let text = std::fs::read_to_string(&obj).unwrap();
    assert!(text.contains("v 0 7000000000 0 1 0 0.2\n"), "{text}");
    assert!(text.contains("# umbrage attribute ao 4\n#a 0\n#a 0.5\n#a 1\n#a 0.25\n"), "{text}");
}

/// The names and the values of the vertices of a PLY, as `ply-rs-bw` reads them.
#[test]
fn other_readers_find_the_attributes() {
    use ply_rs_bw::{parser::Parser, ply::DefaultElement, ply::Property};
    let mesh = two_part_mesh();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("out.ply");
    let scalars: [(&str, &[f32]); 2] = [("ao", &[0.0, 0.5, 1.0, 0.25]), ("bent_x", &[1.0; 4])];
    let colors = [[1, 2, 3]; 4];
    let attributes =
        VertexAttributes { colors: Some(&colors), scalars: &scalars, ..VertexAttributes::default() };
    write_ply(&path, &mesh, &attributes).unwrap();
    let ply = Parser::<DefaultElement>::new().read_ply(&mut std::fs::File::open(&path).unwrap()).unwrap();
    let vertex = &ply.payload["vertex"][3];
    assert_eq!(vertex["ao"], Property::Float(0.25));
    assert_eq!(vertex["bent_x"], Property::Float(1.0));
    assert_eq!(vertex["blue"], Property::UChar(3));
    assert_eq!(ply.payload["face"][2]["vertex_indices"], Property::ListUInt(vec![0, 3, 1]));
}

#[test]
fn bad_attributes_are_refused_and_nothing_is_written() {
    let mesh = two_part_mesh();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("out.ply");
    let write = |scalars: &[(&str, &[f32])]| {
        let attributes = VertexAttributes { scalars, ..VertexAttributes::default() };
        write_ply(&path, &mesh, &attributes).unwrap_err().to_string()
    };
    assert_eq!(write(&[("ao", &[0.0])]), "vertex attribute 'ao' has 1 entries for 4 vertices");
    for name in ["", "x", "two words", "1st", "ä", "a\nb"] {
        assert_eq!(write(&[(name, &[0.0; 4])]), format!("'{name}' can't name a vertex attribute"));
    }
    assert!(!path.exists());
    let nowhere = folder.path().join("no/out.obj");
    let error = write_obj(&nowhere, &mesh, &VertexAttributes::default()).unwrap_err();
    assert!(matches!(&error, WriteMeshError::Write(e) if e.path == nowhere), "{error}");
}

#[test]
fn scenes_say_what_their_files_say() {
    let scene = Scene::parse(SCENE, Path::new("")).unwrap();
    assert_eq!((scene.settings.width, scene.settings.height, scene.settings.spp), (320, 480, 4));
    assert_eq!(scene.background, [0.1; 3]);
    let ambient = scene.ambient.as_ref().unwrap();
    assert_eq!((ambient.radius, &ambient.falloff), (Radius::OfDiagonal(0.05), &Falloff::Linear));
    let names: Vec<_> = scene.instances.iter().map(|i| &i.name[..]).collect();
    assert_eq!(names, ["ball", "box[0]", "box[1]"]);
    let materials: Vec<_> =
        scene.instances.iter().map(|i| &scene.materials[i.materials[0]].name[..]).collect();
    assert_eq!(materials, ["leaf", "default", "default"]);
    assert_eq!(scene.triangle_count(), scene.meshes[0].mesh.triangles.len() as u64 + 24);
    let bounds = scene.bounds();
    assert!((bounds.max.y - 2.0).abs() < 1e-3 && bounds.max.x >= 1.5, "{bounds:?}");
    let Light::Rectangle { corner, u, v, .. } = scene.lights[0] else { panic!("{:?}", scene.lights) };
    let normal = umbrage_geom::glam::Vec3::from(u).cross(v.into());
    assert!((normal.y + 1.0).abs() < 1e-5, "faces its target: {normal}");
    assert!((corner[1] - 3.0).abs() < 1e-6);
}

#[test]
fn scattered_instances_are_inside_their_area_and_repeatable() {
    let text = "[[objects]]\nmesh = { generator = \"box\" }\n\
                scatter = { count = 200, area = [-5, 1, 5, 3], seed = 7, scale = [0.5, 2] }\n";
    let scene = Scene::parse(text, Path::new("")).unwrap();
    assert_eq!(scene.instances.len(), 200);
    for instance in &scene.instances {
        let t = instance.world_from_object.translation;
        assert!((-5.0..=5.0).contains(&t.x) && t.y == 0.0 && (1.0..=3.0).contains(&t.z), "{t}");
        let scale = instance.world_from_object.matrix3.determinant().cbrt();
        assert!((0.499..2.001).contains(&scale), "{scale}");
    }
    let again = Scene::parse(text, Path::new("")).unwrap();
    let places = |s: &Scene| s.instances.iter().map(|i| i.world_from_object).collect::<Vec<_>>();
    assert_eq!(places(&scene), places(&again));
    assert_ne!(places(&scene), places(&Scene::parse(&text.replace("7", "8"), Path::new("")).unwrap()));
}

/// Corner positions of all triangles, which is what two OBJ readers can agree on.
fn with_tobj(path: &Path) -> Vec<[[f32; 3]; 3]> {
    let options = tobj::LoadOptions { triangulate: true, ..tobj::LoadOptions::default() };
    let (models, _) = tobj::load_obj(path, &options).unwrap();
    let mut corners = Vec::new();
    for model in models {
        let p = &model.mesh.positions;
        for t in model.mesh.indices.chunks_exact(3) {
            corners.push([t[0], t[1], t[2]].map(|v| std::array::from_fn(|i| p[3 * v as usize + i])));
        }
    }
    corners
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn tobj_agrees(
        positions in prop::collection::vec(prop::array::uniform3(-1e3f32..1e3), 3..20),
        faces in prop::collection::vec((prop::collection::vec(any::<prop::sample::Index>(), 3..6), any::<bool>()), 1..10),
    ) {
        let mut text = String::new();
        for [x, y, z] in &positions {
            text += &format!("v {x} {y:e} {z}\n");
        }
        for (i, (face, back)) in faces.iter().enumerate() {
            if i % 3 == 1 {
                text += &format!("g part{i}\n");
            }
            text += "f";
            for corner in face {
                let v = corner.index(positions.len()) as i64;
                text += &format!(" {}", if *back { v - positions.len() as i64 } else { v + 1 });
            }
            text += "\n";
        }
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.obj");
        std::fs::write(&path, &text).unwrap();
        let ours = read_mesh(&path).unwrap();
        let corners: Vec<_> = (0..ours.triangles.len()).map(|i| ours.triangle(i)).collect();
        prop_assert_eq!(corners, with_tobj(&path));
        let polygons = read_polygons(&path).unwrap();
        prop_assert_eq!(&polygons.positions, &positions);
        prop_assert_eq!(polygons.triangulate().unwrap().triangles, ours.triangles);
    }
}

#[test]
fn the_sample_obj_is_read() {
    let mesh = read_bytes("a.obj", OBJ.as_bytes());
    assert_eq!(mesh.triangles, [[0, 1, 2], [0, 2, 3], [0, 1, 2]]);
    let objects: Vec<_> = mesh.objects.iter().map(|o| (&o.name[..], o.triangles.clone())).collect();
    assert_eq!(objects, [("quad", 0..2), ("tip", 2..3)]);
}
