//! Method `mask-table` against the pattern's rays, cast one by one.

mod common;

use common::*;
use umbrage_aomask::{
    BackEnd, MaskError, MaskOptions, MaskTables, Outputs, Pattern, PatternOptions, Sides, TableOptions,
    published::NodeMasks,
};
use umbrage_geom::{Falloff, TriangleMesh, glam::Vec3};

fn tables(pattern: &Pattern, options: TableOptions) -> MaskTables {
    MaskTables::new(pattern.clone(), &options).expect("valid options")
}

fn masks(tables: &MaskTables, scene: &Scene, points: &Points, options: &MaskOptions) -> Vec<u64> {
    let mut ao = vec![f32::NAN; points.0.len()];
    let mut masks = vec![!0; points.0.len() * tables.pattern().words()];
    let outputs = Outputs::new(&mut ao).with_masks(&mut masks);
    common::table(tables, &scene.bvh, (&points.0, &points.1), options, outputs, true)
        .expect("valid receivers");
    for (ao, mask) in ao.iter().zip(masks.chunks(tables.pattern().words())) {
        let blocked: u32 = mask.iter().map(|w| w.count_ones()).sum();
        let rays = tables.pattern().len() as u32;
        assert_eq!(*ao, (rays - blocked) as f32 / rays as f32);
    }
    masks
}

#[test]
fn errors_are_small_on_scenes() {
    for (name, triangles, limit) in [("city", 20_000, 1.2), ("cathedral", 30_000, 1.2), ("bush", 5000, 3.0)] {
        let scene = scene(name, triangles);
        let points = receivers(&scene.mesh, 150, 3);
        let diagonal = scene.mesh.bounds().diagonal();
        // Where lengths differ, distances are relative to the longest.
        for (rays, falloff, limit) in [(128, Falloff::Constant, limit), (96, Falloff::Linear, 2.5 * limit)] {
            let pattern = table_pattern(rays, falloff);
            for node_masks in [NodeMasks::Circle, NodeMasks::Silhouette] {
                let tables = tables(&pattern, TableOptions::default().with_node_masks(node_masks));
                for radius in [0.02, 0.1] {
                    let options = MaskOptions::default().with_radius(radius * diagonal);
                    let exact = exact(&scene, &pattern, &points, &options);
                    let difference = difference(&pattern, &masks(&tables, &scene, &points, &options), &exact);
                    let text = format!(
                        "{name} {rays} {node_masks:?} {radius}: rays {}, bias {}, mean {}",
                        difference.rays,
                        difference.bias * 255.0,
                        difference.mean_abs * 255.0
                    );
                    assert!(exact.iter().any(|&word| word != 0), "{text}");
                    assert!(difference.mean_abs * 255.0 < limit, "{text}");
                    assert!(difference.bias.abs() * 255.0 < 0.6 * limit, "{text}");
                }
            }
        }
    }
}

#[test]
fn families_have_no_tables() {
    let family = pattern(64, Falloff::Constant);
    let refused = MaskTables::new(family.clone(), &TableOptions::default());
    assert!(matches!(refused, Err(MaskError::Family(n)) if n == family.members()));
}

#[test]
fn finer_tables_err_less() {
    let scene = scene("cathedral", 30_000);
    let points = receivers(&scene.mesh, 200, 5);
    let pattern = table_pattern(256, Falloff::Constant);
    let options = MaskOptions::default().with_radius(0.05 * scene.mesh.bounds().diagonal());
    let exact = exact(&scene, &pattern, &points, &options);
    let error = |planes, edges| {
        let tables = tables(&pattern, TableOptions::default().with_resolutions(planes, edges));
        difference(&pattern, &masks(&tables, &scene, &points, &options), &exact).mean_abs
    };
    let [coarse, fine] = [error(16, 24), error(64, 200)];
    assert!(fine < 0.5 * coarse, "{coarse} {fine}");
}

#[test]
fn one_sided_triangles_block_from_the_front_only() {
    let scene = scene("city", 20_000);
    let pattern = table_pattern(64, Falloff::Constant);
    let tables = tables(&pattern, TableOptions::default());
    // Receivers both outside and, looking the other way, inside of things.
    let (mut points, mut normals) = receivers(&scene.mesh, 60, 9);
    for i in 0..30 {
        let n = Vec3::from(normals[i]);
        points[i] = (Vec3::from(points[i]) - n * 0.01).to_array();
        normals[i] = (-n).to_array();
    }
    let points = (points, normals);
    for sides in [Sides::Front, Sides::Both] {
        let options =
            MaskOptions::default().with_radius(0.1 * scene.mesh.bounds().diagonal()).with_sides(sides);
        let exact = exact(&scene, &pattern, &points, &options);
        let difference = difference(&pattern, &masks(&tables, &scene, &points, &options), &exact);
        assert!(difference.mean_abs < 0.01, "{sides:?}: {}", difference.mean_abs);
    }
}

#[test]
fn back_ends_and_threads_give_the_same_bits() {
    let scene = scene("bush", 3000);
    let points = receivers(&scene.mesh, 130, 4);
    let options = MaskOptions::default().with_radius(0.2 * scene.mesh.bounds().diagonal()).with_seed(3);
    for rays in [32, 96, 192, 320, 1024] {
        let pattern = table_pattern(rays, Falloff::Quadratic);
        let all: Vec<Vec<u64>> = BackEnd::ALL
            .into_iter()
            .filter(|b| b.is_supported())
            .flat_map(|back_end| [NodeMasks::Circle, NodeMasks::Silhouette].map(|n| (back_end, n)))
            .map(|(back_end, node_masks)| {
                let options_ = TableOptions::default()
                    .with_resolutions(16, 24)
                    .with_back_end(back_end)
                    .with_node_masks(node_masks);
                masks(&tables(&pattern, options_), &scene, &points, &options)
            })
            .collect();
        for pair in all.chunks(2) {
            assert_eq!(pair, &all[..2], "{rays}");
        }
        // Bits beyond the last ray stay clear.
        let last = rays as usize % 64;
        let words = pattern.words();
        assert!(last == 0 || all[0].chunks(words).all(|mask| mask[words - 1] >> last == 0));
    }
}

#[test]
fn convex_is_open_and_the_inside_is_closed() {
    let sphere = scene("sphere", 2000);
    let pattern = table_pattern(128, Falloff::Constant);
    let tables = tables(&pattern, TableOptions::default());
    let outside = receivers(&sphere.mesh, 100, 1);
    let open = masks(&tables, &sphere, &outside, &MaskOptions::default());
    assert!(open.iter().all(|&w| w == 0));
    let center = sphere.mesh.bounds().center().to_array();
    let inside = (vec![center; 3], vec![[0.0, 0.0, 1.0], [0.3, -0.8, 0.1], [-1.0, 0.0, 0.0]]);
    let diagonal = sphere.mesh.bounds().diagonal();
    for radius in [f32::INFINITY, 1e9 * diagonal, diagonal] {
        let closed = masks(&tables, &sphere, &inside, &MaskOptions::default().with_radius(radius));
        let blocked: u32 = closed.iter().map(|w| w.count_ones()).sum();
        assert!(blocked >= 3 * 126, "{radius}: {blocked}");
    }
    let short = masks(&tables, &sphere, &inside, &MaskOptions::default().with_radius(0.1 * diagonal));
    assert!(short.iter().all(|&w| w == 0));
}

#[test]
fn strange_receivers_radii_and_triangles_are_harmless() {
    let mut triangles = vec![
        [[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
        [[0.5; 3]; 3],
        [[0.0; 3], [0.5, 0.5, 0.5], [1.0; 3]],
        [[-1e20, -1e20, 1.5], [1e20, -1e20, 1.5], [0.0, 1e20, 1.5]],
        [[0.2, 0.2, 0.3], [0.2, 0.2 + 1e-30, 0.3], [0.2 + 1e-30, 0.2, 0.3]],
    ];
    triangles.push([[1e23, 0.0, 0.0], [0.0, 1e24, 0.0], [0.0, 0.0, -1e24]]);
    let scene = soup(&triangles);
    let points: Vec<[f32; 3]> = vec![
        [0.0; 3],
        [0.5, 0.0, 0.0],
        [0.25, 0.25, 0.0],
        [0.5; 3],
        [0.3, 0.3, -1e-8],
        [1e24; 3],
        [-1e-40; 3],
    ];
    let normals = vec![[0.0, 0.0, 1.0]; points.len()];
    for falloff in [Falloff::Constant, Falloff::Linear, Falloff::table(vec![0.5, 0.0]).unwrap()] {
        let pattern = table_pattern(64, falloff);
        for node_masks in [NodeMasks::Circle, NodeMasks::Silhouette] {
            let options = TableOptions::default().with_resolutions(12, 12).with_node_masks(node_masks);
            let tables = tables(&pattern, options);
            for radius in [1e-45, 1e-20, 1.0, 3.0, 1e20, f32::MAX] {
                let options = MaskOptions::default().with_radius(radius);
                masks(&tables, &scene, &(points.clone(), normals.clone()), &options);
            }
        }
    }
    // The huge triangle covers the sky at 1.5, which rays of length 3 mostly reach.
    let pattern = table_pattern(128, Falloff::Constant);
    let tables = tables(&pattern, TableOptions::default());
    let options = MaskOptions::default().with_radius(3.0);
    let one = (vec![[5.0, 5.0, 1e-3]], vec![[0.0, 0.0, 1.0]]);
    let difference = difference(
        &pattern,
        &masks(&tables, &scene, &one, &options),
        &exact(&scene, &pattern, &one, &options),
    );
    assert!(difference.rays < 0.03, "{} {}", difference.rays, difference.bias);
}

#[test]
fn bad_input_is_named() {
    let scene = scene("sphere", 1000);
    let tables = tables(&table_pattern(32, Falloff::Linear), TableOptions::default().with_resolutions(8, 8));
    let (points, normals) = receivers(&scene.mesh, 4, 1);
    let mut ao = vec![-1.0; 4];
    let mut call = |points: &[[f32; 3]], normals: &[[f32; 3]], radius: f32| {
        let options = MaskOptions::default().with_radius(radius);
        common::table(&tables, &scene.bvh, (points, normals), &options, Outputs::new(&mut ao), true)
    };
    for radius in [0.0, -1.0, f32::NAN] {
        assert!(matches!(call(&points, &normals, radius), Err(MaskError::Radius(_))));
    }
    assert_eq!(call(&points, &normals, f32::INFINITY), Err(MaskError::FalloffWithoutRadius));
    assert!(matches!(call(&points, &normals[1..], 1.0), Err(MaskError::Length { what: "normals", .. })));
    assert!(matches!(call(&points[1..], &normals[1..], 1.0), Err(MaskError::Length { what: "ao", .. })));
    let mut bad = normals.clone();
    bad[2] = [0.0; 3];
    assert!(matches!(call(&points, &bad, 1.0), Err(MaskError::Normal { index: 2, .. })));
    let mut bad = points.clone();
    bad[3][1] = f32::NAN;
    assert!(matches!(call(&bad, &normals, 1.0), Err(MaskError::Point { index: 3, .. })));
    let cancelled = {
        let outputs = Outputs::new(&mut ao);
        let options = MaskOptions::default().with_radius(1.0);
        common::table(&tables, &scene.bvh, (&points, &normals), &options, outputs, false)
    };
    assert_eq!(cancelled, Err(MaskError::Cancelled));
    assert_eq!(ao, [-1.0; 4]);
    let pattern = table_pattern(32, Falloff::Constant);
    for (planes, edges) in [(7, 8), (257, 8), (8, 7), (8, 1025)] {
        let options = TableOptions::default().with_resolutions(planes, edges);
        let error = MaskTables::new(pattern.clone(), &options).unwrap_err();
        assert!(matches!(error, MaskError::Resolution { .. }));
    }
    let none = common::table(
        &tables,
        &scene.bvh,
        (&[], &[]),
        &MaskOptions::default().with_radius(1.0),
        Outputs::new(&mut []),
        true,
    );
    assert_eq!(none, Ok(()));
}

#[test]
fn lengths_by_falloff_agree_with_weighted_distances() {
    let scene = scene("city", 20_000);
    let points = receivers(&scene.mesh, 40, 2);
    let radius = 0.2 * scene.mesh.bounds().diagonal();
    let options = MaskOptions::default().with_radius(radius);
    for falloff in [Falloff::Linear, Falloff::Quadratic, Falloff::Exponential] {
        let cut = table_pattern(256, falloff.clone());
        let whole = table_pattern(256, Falloff::Constant);
        let exact = exact(&scene, &cut, &points, &options);
        let (mut sampled, mut direct) = (0.0, 0.0);
        for i in 0..points.0.len() {
            let blocked: u32 = exact[i * cut.words()..][..cut.words()].iter().map(|w| w.count_ones()).sum();
            sampled += 1.0 - f64::from(blocked) / 256.0;
            direct += weighted(&scene, &rays(&whole, &points, &options, i), radius, &falloff);
        }
        let n = points.0.len() as f64;
        // 40 * 256 rays: a standard error of 0.005 at most, less by stratification.
        assert!((sampled - direct).abs() / n < 0.005, "{falloff:?}: {} {}", sampled / n, direct / n);
    }
}

#[test]
fn rotating_the_scene_keeps_the_mean() {
    let scene = scene("city", 20_000);
    let points = receivers(&scene.mesh, 300, 8);
    let pattern = table_pattern(128, Falloff::Constant);
    let tables = tables(&pattern, TableOptions::default());
    let options = MaskOptions::default().with_radius(0.1 * scene.mesh.bounds().diagonal());
    let mean = |masks: &[u64]| {
        masks.iter().map(|w| f64::from(w.count_ones())).sum::<f64>() / (points.0.len() * pattern.len()) as f64
    };
    let before = mean(&masks(&tables, &scene, &points, &options));
    let turn = umbrage_geom::glam::Quat::from_axis_angle(Vec3::new(0.6, 0.0, 0.8), 1.1);
    let turned = |v: &[f32; 3]| (turn * Vec3::from(*v)).to_array();
    let mesh = TriangleMesh {
        positions: scene.mesh.positions.iter().map(turned).collect(),
        triangles: scene.mesh.triangles.clone(),
        ..TriangleMesh::default()
    };
    let (p, n) = &points;
    // Turning rounds: receivers go off their surface again.
    let lift = 1e-5 * scene.mesh.bounds().diagonal();
    let n: Vec<[f32; 3]> = n.iter().map(turned).collect();
    let p =
        p.iter().zip(&n).map(|(p, n)| (Vec3::from(turned(p)) + Vec3::from(*n) * lift).to_array()).collect();
    let after = mean(&masks(&tables, &from_mesh(mesh), &(p, n), &options));
    assert!((before - after).abs() < 0.004, "{before} {after}");
}

#[test]
fn more_triangles_and_longer_rays_block_no_less() {
    let all = scene("city", 20_000);
    let half = TriangleMesh {
        positions: all.mesh.positions.clone(),
        triangles: all.mesh.triangles.iter().copied().step_by(2).collect(),
        ..TriangleMesh::default()
    };
    let half = from_mesh(half);
    let points = receivers(&all.mesh, 100, 6);
    let pattern = Pattern::new(&PatternOptions::default().with_rays(64).fixed()).unwrap();
    let tables = tables(&pattern, TableOptions::default());
    let diagonal = all.mesh.bounds().diagonal();
    let blocked = |scene: &Scene, radius: f32| {
        let options = MaskOptions::default().with_radius(radius * diagonal);
        let masks = masks(&tables, scene, &points, &options);
        masks.iter().map(|w| w.count_ones()).collect::<Vec<_>>()
    };
    let (few, many, longer) = (blocked(&half, 0.05), blocked(&all, 0.05), blocked(&all, 0.1));
    // Each triangle's mask is the same in both scenes; where nodes differ, only rays that miss their boxes can be lost.
    assert!(few.iter().zip(&many).all(|(few, many)| *few <= many + 1));
    let [few, many, longer] = [few, many, longer].map(|v| v.iter().sum::<u32>());
    assert!(few < many && many < longer, "{few} {many} {longer}");
}
