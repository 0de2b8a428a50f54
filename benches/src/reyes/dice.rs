//! How fast points are evaluated: instructions on regular patches, and valences around extraordinary vertices.

use super::Options;
use crate::rows::{Output, Row, alternate, median, paired_speedup};
use anyhow::Result;
use serde_json::json;
use umbrage_accel::BackEnd;
use umbrage_geom::PolygonMesh;
use umbrage_reyes::{Surface, SurfaceOptions};

/// Name of the rows' figure.
pub const NAME: &str = "dice";

/// Levels of the grids.
const LEVELS: [u8; 4] = [3, 5, 7, 9];

/// Quadrilaterals around a vertex of valence `valence`, and others around them.
fn around(valence: u32) -> PolygonMesh {
    let mut mesh = PolygonMesh { positions: vec![[0.0, 0.0, 0.4]], ..PolygonMesh::default() };
    // Rings of twice as many vertices as edges.
    let (rings, count) = (4, 2 * valence);
    for ring in 1..=rings {
        for i in 0..count {
            let (sine, cosine) = (std::f32::consts::TAU * i as f32 / count as f32).sin_cos();
            let (x, y) = (ring as f32 * cosine, ring as f32 * sine);
            mesh.positions.push([x, y, 0.1 * (x * 1.3).sin() * (y * 0.7).cos()]);
        }
    }
    let at = |ring: u32, i: u32| 1 + (ring - 1) * count + i % count;
    for i in (0..count).step_by(2) {
        mesh.face_sizes.push(4);
        mesh.corners.extend([0, at(1, i), at(1, i + 1), at(1, i + 2)]);
    }
    for (ring, i) in (1..rings).flat_map(|ring| (0..count).map(move |i| (ring, i))) {
        mesh.face_sizes.push(4);
        mesh.corners.extend([at(ring, i), at(ring + 1, i), at(ring + 1, i + 1), at(ring, i + 1)]);
    }
    mesh
}

/// A wavy sheet of `n` by `n` quadrilaterals.
fn sheet(n: u32) -> PolygonMesh {
    let mut mesh = PolygonMesh::default();
    for (j, i) in (0..=n).flat_map(|j| (0..=n).map(move |i| (j, i))) {
        mesh.positions.push([i as f32, j as f32, (i as f32 * 1.1).sin() + (j as f32 * 0.8).cos()]);
    }
    for (j, i) in (0..n).flat_map(|j| (0..n).map(move |i| (j, i))) {
        let a = j * (n + 1) + i;
        mesh.face_sizes.push(4);
        mesh.corners.extend([a, a + 1, a + n + 2, a + n + 1]);
    }
    mesh
}

/// Rows of all meshes, levels and instructions. Nothing is kept between grids but the control mesh's patches.
pub fn run(options: &Options, output: &mut Output) -> Result<()> {
    if !options.wants(NAME) {
        return Ok(());
    }
    let back_ends = [("scalar", BackEnd::Scalar), ("avx2", BackEnd::Avx2), ("avx512", BackEnd::Avx512)];
    let back_ends: Vec<_> = back_ends.into_iter().filter(|(_, b)| b.is_supported()).collect();
    let valences = [3, 5, 6, 8, 12, 30, 60].map(|valence| (format!("valence {valence}"), around(valence)));
    let meshes = [("regular".to_owned(), sheet(8))].into_iter().chain(valences);
    for (scene, mesh) in meshes {
        let surfaces = back_ends.iter().map(|&(_, back_end)| {
            let surface = SurfaceOptions::default().with_tree_bytes(0).with_back_end(back_end);
            Surface::build(&mesh, &surface)
        });
        let surfaces = surfaces.collect::<Result<Vec<_>, _>>()?;
        // The inner patches of the sheet, or one at the vertex.
        let patches: Vec<u32> = if scene == "regular" { vec![18, 27, 36, 45] } else { vec![0] };
        for level in LEVELS {
            let repeats = ((1usize << 22) >> (2 * level)).clamp(1, 4096) / patches.len();
            let mut points = Vec::new();
            let mut runs: Vec<_> = surfaces
                .iter()
                .map(|surface| {
                    let (patches, mut points) = (&patches, std::mem::take(&mut points));
                    move || {
                        for _ in 0..repeats.max(1) {
                            for &patch in patches {
                                let done = surface.dice_patch(patch, [level; 2], &mut points);
                                std::hint::black_box((&points, done.is_ok()));
                            }
                        }
                    }
                })
                .collect();
            let mut timed: Vec<&mut dyn crate::rows::Timed> =
                runs.iter_mut().map(|run| run as &mut dyn crate::rows::Timed).collect();
            let times = alternate(if options.quick { 3 } else { 7 }, &mut timed);
            let cells = (repeats.max(1) * patches.len()) as f64 * f64::from(1u32 << (2 * level));
            for ((name, _), own) in back_ends.iter().zip(&times) {
                let time_s = median(own);
                output.row(&Row {
                    suite: "reyes",
                    scene: scene.clone(),
                    method: (*name).into(),
                    params: json!({ "figure": NAME, "level": level }),
                    time_s,
                    build_s: 0.0,
                    mrays_s: 0.0,
                    rmse: 0.0,
                    bias: 0.0,
                    bytes: 0,
                    counters: json!({ "micropolygons": cells, "micropolygons_s": cells / time_s }),
                    baseline: "scalar",
                    speedup: paired_speedup(&times[0], own),
                })?;
            }
        }
    }
    Ok(())
}
