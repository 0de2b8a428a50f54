//! Refined levels against OpenSubdiv's regression shapes, as point sets, from OBJ files with the tags of the source.

mod common;

use common::mesh_folder;
use serde_json::Value;
use std::{collections::HashMap, path::Path};
use umbrage_geom::{Aabb, PolygonMesh, glam::DVec3};
use umbrage_reyes::{BoundaryRule, CreaseMethod, SubdivisionMesh};
use umbrage_scene::read_polygons;

/// Vertices and centroids of faces of an OBJ, in doubles.
fn read_level(path: &Path) -> (Vec<DVec3>, Vec<DVec3>) {
    let text = std::fs::read_to_string(path).unwrap();
    let (mut points, mut centers) = (Vec::new(), Vec::new());
    for line in text.lines() {
        let mut words = line.split_whitespace();
        match words.next() {
            Some("v") => {
                let p: Vec<f64> = words.map(|w| w.parse().unwrap()).collect();
                points.push(DVec3::new(p[0], p[1], p[2]));
            }
            Some("f") => {
                let face: Vec<DVec3> = words
                    .map(|w| points[w.split('/').next().unwrap().parse::<usize>().unwrap() - 1])
                    .collect();
                centers.push(face.iter().sum::<DVec3>() / face.len() as f64);
            }
            _ => {}
        }
    }
    (points, centers)
}

/// Largest distance, along one axis, from a point of `a` to the nearest of `b`; infinite beyond `cell`.
fn distance(a: &[DVec3], b: &[DVec3], cell: f64) -> f64 {
    let index = |p: DVec3| (p / cell).floor().to_array().map(|x| x as i64);
    let mut cells: HashMap<[i64; 3], Vec<DVec3>> = HashMap::new();
    b.iter().for_each(|&p| cells.entry(index(p)).or_default().push(p));
    let mut worst = 0f64;
    for &p in a {
        let [x, y, z] = index(p);
        let mut best = f64::INFINITY;
        for (i, j, k) in (0..27).map(|n| (n % 3 - 1, n / 3 % 3 - 1, n / 9 - 1)) {
            for q in cells.get(&[x + i, y + j, z + k]).into_iter().flatten() {
                best = best.min((p - *q).abs().max_element());
            }
        }
        worst = worst.max(best);
    }
    worst
}

/// The control mesh that an OBJ with tags as statements gives: the files here have them as comments.
fn read_with_statements(path: &Path, name: &str) -> PolygonMesh {
    let text = std::fs::read_to_string(path).unwrap();
    let copy = std::env::temp_dir().join(format!("umbrage-opensubdiv-{}-{name}.obj", std::process::id()));
    std::fs::write(&copy, text.replace("#t ", "t ")).unwrap();
    let mesh = read_polygons(&copy).unwrap();
    std::fs::remove_file(&copy).unwrap();
    mesh
}

#[test]
fn refined_levels_are_those_of_opensubdiv() {
    let Some(folder) = mesh_folder() else { return };
    let mut shapes = 0;
    for entry in std::fs::read_dir(folder.join("opensubdiv")).unwrap() {
        let path = entry.unwrap().path();
        if path.extension().is_none_or(|e| e != "json") {
            continue;
        }
        let about: Value = serde_json::from_str(&std::fs::read_to_string(&path).unwrap()).unwrap();
        let name = about["name"].as_str().unwrap();
        let source = path.with_file_name(about["control"].as_str().unwrap());
        let control = read_with_statements(&source, name);
        assert_eq!(control, read_polygons(&source).unwrap(), "{name}");
        let number = |v: &Value| v.as_f64().unwrap();
        let list = |key: &str| about[key].as_array().unwrap().clone();
        let creases: Vec<_> = list("creases")
            .iter()
            .map(|c| ([number(&c[0]) as u32, number(&c[1]) as u32], number(&c[2]) as f32))
            .collect();
        let corners: Vec<_> =
            list("corners").iter().map(|c| (number(&c[0]) as u32, number(&c[1]) as f32)).collect();
        let boundary = match about["boundary"].as_str() {
            Some("edge_and_corner") => BoundaryRule::EdgeAndCorner,
            _ => BoundaryRule::EdgeOnly,
        };
        let method = match about["crease_method"].as_str() {
            Some("chaikin") => CreaseMethod::Chaikin,
            _ => CreaseMethod::Uniform,
        };
        assert_eq!((&control.creases, &control.sharp_vertices), (&creases, &corners), "{name}");
        assert_eq!((control.boundary, control.crease_method), (boundary, method), "{name}");
        let mut mesh = SubdivisionMesh::new(&control).unwrap();
        let extent = Aabb::from_points(&control.positions).diagonal();
        let tolerance = f64::from(extent) * if name.ends_with("flap") { 3e-6 } else { 1e-6 };
        for level in list("levels") {
            mesh = mesh.refine();
            let (points, centers) = read_level(&path.with_file_name(level["file"].as_str().unwrap()));
            let ours: Vec<DVec3> = mesh
                .faces()
                .map(|f| f.iter().map(|&v| mesh.positions()[v as usize]).sum::<DVec3>() / 4.0)
                .collect();
            assert_eq!(mesh.positions().len(), points.len(), "{name}");
            assert_eq!(ours.len(), centers.len(), "{name}");
            let cell = 2.0 * tolerance;
            for (what, a, b) in
                [("points", mesh.positions(), &points[..]), ("faces", &ours[..], &centers[..])]
            {
                let worst = distance(a, b, cell).max(distance(b, a, cell));
                assert!(worst <= tolerance, "{name} {}: {what} off by {worst}", level["file"]);
            }
        }
        shapes += 1;
    }
    assert!(shapes >= 15, "{shapes} shapes");
}
