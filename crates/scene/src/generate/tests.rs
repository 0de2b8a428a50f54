//! Laws that every generator obeys, and an audit of the closed ones.

use super::*;
use std::collections::HashMap;
use umbrage_geom::glam::{DVec3, Vec3};

/// Signed volume, positive when faces point outwards.
pub fn volume(mesh: &TriangleMesh) -> f64 {
    mesh.triangles.iter().map(|t| signed_volume(mesh, t)).sum()
}

fn corner(mesh: &TriangleMesh, v: u32) -> DVec3 {
    Vec3::from(mesh.positions[v as usize]).as_dvec3()
}

fn signed_volume(mesh: &TriangleMesh, t: &[u32; 3]) -> f64 {
    let [a, b, c] = t.map(|v| corner(mesh, v));
    a.dot(b.cross(c)) / 6.0
}

fn sized(name: &str, triangles: usize) -> Parameters {
    let fixed = generators().iter().any(|g| g.name == name && g.fixed);
    Parameters { triangles: (!fixed).then_some(triangles), ..Parameters::default() }
}

fn mesh(name: &str, triangles: usize) -> TriangleMesh {
    generate(name, &sized(name, triangles)).unwrap().mesh
}

/// Checks that the triangles `range` of `mesh` form closed, consistently oriented surfaces and that each has a
/// positive volume.
fn assert_closed(mesh: &TriangleMesh, range: std::ops::Range<u32>, what: &str) {
    let triangles = &mesh.triangles[range.start as usize..range.end as usize];
    let mut edges: HashMap<(u32, u32), u32> = HashMap::new();
    for t in triangles {
        for i in 0..3 {
            *edges.entry((t[i], t[(i + 1) % 3])).or_default() += 1;
        }
    }
    for (&(a, b), &count) in &edges {
        assert_eq!((count, edges.get(&(b, a))), (1, Some(&1)), "{what}: edge {a}-{b}");
    }
    let mut parent: Vec<u32> = (0..mesh.positions.len() as u32).collect();
    fn root(parent: &mut [u32], mut v: u32) -> u32 {
        while parent[v as usize] != v {
            parent[v as usize] = parent[parent[v as usize] as usize];
            v = parent[v as usize];
        }
        v
    }
    for t in triangles {
        let (a, b, c) = (root(&mut parent, t[0]), root(&mut parent, t[1]), root(&mut parent, t[2]));
        parent[b as usize] = a;
        parent[c as usize] = a;
    }
    let mut volumes: HashMap<u32, f64> = HashMap::new();
    for t in triangles {
        *volumes.entry(root(&mut parent, t[0])).or_default() += signed_volume(mesh, t);
    }
    assert!(volumes.values().all(|&v| v > 0.0), "{what}: {volumes:?}");
}

fn assert_no_duplicates(mesh: &TriangleMesh, what: &str) {
    let mut seen = HashMap::new();
    for (i, p) in mesh.positions.iter().enumerate() {
        let key = p.map(|x| (x + 0.0).to_bits());
        assert_eq!(seen.insert(key, i), None, "{what}: vertex {i}");
    }
    assert!(mesh.degenerate_triangles().is_empty(), "{what}");
}

/// Whether the open segment `p`-`q` passes through the inside of the triangle.
fn pierces(p: DVec3, q: DVec3, [a, b, c]: [DVec3; 3]) -> bool {
    let volume = |a: DVec3, b: DVec3, c: DVec3, d: DVec3| (b - a).cross(c - a).dot(d - a);
    if volume(a, b, c, p) * volume(a, b, c, q) >= 0.0 {
        return false;
    }
    let sides = [volume(p, q, a, b), volume(p, q, b, c), volume(p, q, c, a)];
    sides.iter().all(|&v| v > 0.0) || sides.iter().all(|&v| v < 0.0)
}

/// Looks for triangles without a common vertex of which one's edge pierces the other, by a grid.
fn assert_no_self_intersection(mesh: &TriangleMesh, range: std::ops::Range<u32>, what: &str) {
    let mean_edge = range
        .clone()
        .map(|t| {
            let [a, b, _] = mesh.triangle(t as usize).map(Vec3::from);
            a.distance(b)
        })
        .sum::<f32>()
        / range.len() as f32;
    let cell = 2.0 * mean_edge;
    let mut grid: HashMap<[i32; 3], Vec<u32>> = HashMap::new();
    for t in range {
        let p = mesh.triangle(t as usize).map(Vec3::from);
        let low = (p[0].min(p[1]).min(p[2]) / cell).floor().as_ivec3();
        let high = (p[0].max(p[1]).max(p[2]) / cell).floor().as_ivec3();
        for x in low.x..=high.x {
            for y in low.y..=high.y {
                for z in low.z..=high.z {
                    grid.entry([x, y, z]).or_default().push(t);
                }
            }
        }
    }
    for near in grid.values() {
        for &s in near {
            let t_s = mesh.triangles[s as usize];
            let corners = t_s.map(|v| corner(mesh, v));
            for &t in near.iter().filter(|&&t| t != s) {
                let other = mesh.triangles[t as usize];
                for i in 0..3 {
                    let (a, b) = (other[i], other[(i + 1) % 3]);
                    if !t_s.contains(&a) && !t_s.contains(&b) {
                        assert!(
                            !pierces(corner(mesh, a), corner(mesh, b), corners),
                            "{what}: triangles {s} and {t}"
                        );
                    }
                }
            }
        }
    }
}

/// Checks that a part of a mesh is closed, oriented and free of self-intersection.
pub fn assert_solid(mesh: &TriangleMesh, range: std::ops::Range<u32>, what: &str) {
    assert_closed(mesh, range.clone(), what);
    assert_no_self_intersection(mesh, range, what);
}

fn closed() -> impl Iterator<Item = &'static GeneratorInfo> {
    generators().iter().filter(|g| g.closed)
}

#[test]
fn closed_generators_are_closed() {
    for info in closed() {
        for triangles in [6_000, 25_000] {
            let mesh = mesh(info.name, triangles);
            for object in &mesh.objects {
                assert_closed(&mesh, object.triangles.clone(), info.name);
            }
            assert_no_duplicates(&mesh, info.name);
        }
    }
}

#[test]
fn closed_generators_do_not_intersect_themselves() {
    for info in closed() {
        for seed in 0..3 {
            let mesh = generate(info.name, &Parameters { seed, ..sized(info.name, 6_000) }).unwrap().mesh;
            assert_no_self_intersection(&mesh, 0..mesh.triangles.len() as u32, info.name);
        }
    }
}

#[test]
fn a_self_intersection_would_be_found() {
    let mut two = mesh("blob", 1200);
    let mut other = two.clone();
    other.positions.iter_mut().for_each(|p| p[0] += 0.5);
    two.append(&other);
    let result = std::panic::catch_unwind(|| assert_no_self_intersection(&two, 0..2400, "two"));
    assert!(result.is_err());
}

#[test]
fn counts_are_near_the_target() {
    for info in generators().iter().filter(|g| !g.fixed) {
        for target in [info.min_triangles.max(2_500) * 2, 60_000] {
            let count = mesh(info.name, target).triangles.len();
            let error = (count as f64 / target as f64 - 1.0).abs();
            assert!(error < 0.1, "{}: {count} of {target}", info.name);
        }
    }
}

#[test]
fn defaults_are_near_their_counts() {
    for info in generators() {
        let mesh = generate(info.name, &Parameters::default()).unwrap().mesh;
        let error = (mesh.triangles.len() as f64 / info.default_triangles as f64 - 1.0).abs();
        assert!(error < 0.1, "{}: {} of {}", info.name, mesh.triangles.len(), info.default_triangles);
    }
}

#[test]
fn meshes_are_valid_and_have_named_opaque_objects() {
    for info in generators() {
        for seed in [1, u32::MAX] {
            let parameters = Parameters { seed, ..sized(info.name, info.min_triangles) };
            let generated = generate(info.name, &parameters).unwrap();
            generated.mesh.validate().unwrap();
            assert!(!generated.mesh.objects.is_empty(), "{}", info.name);
            assert!(
                generated.mesh.objects.iter().all(|o| !o.name.is_empty() && o.opacity == 1.0),
                "{}",
                info.name
            );
            assert_eq!(generated.control.is_some(), info.fixed);
            let low = generated.mesh.positions.iter().map(|p| p[1]).fold(f32::INFINITY, f32::min);
            assert!(low > -0.5, "{} reaches down to {low}", info.name);
        }
    }
}

#[test]
fn seeds_decide_the_bits() {
    for info in generators() {
        let with = |seed| {
            generate(info.name, &Parameters { seed, ..sized(info.name, info.min_triangles.max(6_000)) })
                .unwrap()
        };
        let three = with(3);
        assert_eq!(three, with(3), "{}", info.name);
        assert_eq!(three != with(4), info.seeded, "{}", info.name);
    }
}

#[test]
fn levels_multiply_by_four_and_keep_the_shape() {
    for info in generators().iter().filter(|g| !g.fixed) {
        let coarse = mesh(info.name, info.min_triangles.max(5_000));
        let parameters = Parameters { level: Some(1), ..sized(info.name, info.min_triangles.max(5_000)) };
        let fine = generate(info.name, &parameters).unwrap().mesh;
        fine.validate().unwrap();
        assert_eq!(fine.triangles.len(), 4 * coarse.triangles.len());
        assert_eq!(fine.positions[..coarse.positions.len()], coarse.positions);
        assert_eq!(fine.objects.len(), coarse.objects.len());
    }
}

#[test]
fn texture_charts_do_not_leave_the_unit_square() {
    for name in ["plane", "sphere", "box", "blob"] {
        let mesh = mesh(name, 5_000);
        assert_eq!(mesh.corner_uvs.len(), mesh.triangles.len());
        assert!(mesh.corner_uvs.iter().flatten().flatten().all(|x| (0.0..=1.0).contains(x)), "{name}");
    }
}

#[test]
fn extreme_parameters_stay_closed() {
    let with = |values: &[(&str, f64)]| Parameters {
        values: values.iter().map(|&(k, v)| (k.to_owned(), ParameterValue::Number(v))).collect(),
        ..sized("", 9_000)
    };
    let cases = [
        ("blob", with(&[("bumps", 1.5)])),
        ("rocks", with(&[("count", 1.0)])),
        ("rocks", with(&[("count", 100.0)])),
        ("knots", with(&[("turns", 2.0), ("windings", 3.0), ("thickness", 0.9)])),
        ("knots", with(&[("turns", 3.0), ("windings", 3.0), ("thickness", 0.05)])),
        ("knots", with(&[("turns", 20.0), ("windings", 39.0), ("thickness", 0.9)])),
        ("box", with(&[("width", 1e-3), ("height", 1e6)])),
    ];
    for (name, parameters) in cases {
        let mesh = generate(name, &parameters).unwrap().mesh;
        assert_closed(&mesh, 0..mesh.triangles.len() as u32, name);
        assert_no_duplicates(&mesh, name);
        if name != "box" {
            assert_no_self_intersection(&mesh, 0..mesh.triangles.len() as u32, name);
        }
    }
}

#[test]
fn bad_requests_are_named() {
    let value =
        |name: &str, value| Parameters { values: [(name.to_owned(), value)].into(), ..Parameters::default() };
    let message = |name: &str, parameters: Parameters| generate(name, &parameters).unwrap_err().to_string();
    let unknown = message("bish", Parameters::default());
    assert!(
        unknown.starts_with("unknown generator 'bish' (known: ") && unknown.contains("hairball"),
        "{unknown}"
    );
    assert_eq!(
        message("sphere", value("colour", ParameterValue::Number(1.0))),
        "generator 'sphere' has no parameter 'colour' (known: seed, triangles, level)"
    );
    assert_eq!(
        message("cube-sphere", Parameters { level: Some(1), ..Parameters::default() }),
        "generator 'cube-sphere' has no parameter 'level' (known: seed)"
    );
    for bad in
        [ParameterValue::Number(f64::NAN), ParameterValue::Number(-1.0), ParameterValue::Text("x".into())]
    {
        let result = generate("plane", &value("width", bad));
        assert!(matches!(result, Err(GenerateError::OutOfRange { generator: "plane", .. })));
    }
    assert_eq!(
        message("rocks", value("count", ParameterValue::Number(2.5))),
        "count = 2.5 of generator 'rocks' is not a whole number from 1 to 400"
    );
    assert_eq!(
        message("particles", value("mode", ParameterValue::Text("both".into()))),
        "mode = 'both' of generator 'particles' is not 'transmit' or 'block'"
    );
    assert_eq!(message("knots", sized("knots", 1)), "triangles = 1 of generator 'knots' is not 6000 or more");
    for info in generators().iter().filter(|g| !g.fixed) {
        for huge in [1_000_000_000, usize::MAX] {
            let result = generate(info.name, &sized(info.name, huge));
            assert!(matches!(result, Err(GenerateError::TooLarge { .. })), "{}", info.name);
        }
        let level = Parameters { level: Some(MAX_LEVEL + 1), ..sized(info.name, 10_000) };
        assert!(matches!(generate(info.name, &level), Err(GenerateError::OutOfRange { .. })));
    }
}

#[test]
fn defaults_are_allowed_values() {
    for p in generators().iter().flat_map(|g| g.parameters) {
        let value = match p.kind {
            ParameterKind::Choice { .. } => ParameterValue::Text(p.default_text()),
            _ => ParameterValue::Number(p.default_text().parse().unwrap()),
        };
        assert!(p.allows(&value), "{}: {} is not {}", p.name, p.default_text(), p.range_text());
    }
}
