//! Instances kept apart: solid boxes in the space of each mesh, made when rays come near.

use super::{Options, PER_LIGHT, SIDE, scene};
use crate::rows::{Output, Row, Timed, alternate, median, note, paired_speedup};
use anyhow::Result;
use serde_json::json;
use std::{path::Path, sync::Arc, time::Instant};
use umbrage_accel::{BuildOptions, Bvh, Counters, InstancedBvh, Placement};
use umbrage_geom::{Ray, TriangleMesh, glam::Affine3A, sampling::RandomStream};
use umbrage_occlusion::volumetric::{LazySolidBvh, ObjectMesh, SolidBvhOptions, SolidInstances};

/// Name of the scene.
pub const NAME: &str = "36-instances";

/// Where rays start, as a part of their length: instances' surfaces are not where those of the flat mesh are, by rounding.
const START_SHARE: f32 = 1e-3;

/// The 36 objects as instances of 12 meshes, under the shadow rays of the same objects in one mesh, and a 13th mesh that no ray
/// comes near.
pub fn measure(folder: &Path, options: &Options, output: &mut Output) -> Result<()> {
    note(&format!("preparing {NAME}"));
    let flat = scene::many(NAME, folder, 0)?;
    let plain = Bvh::build(&flat.mesh.positions, &flat.mesh.triangles, &BuildOptions::default())?;
    let shadows = flat.shadows(&plain, SIDE, PER_LIGHT, if options.quick { 128 } else { 32 }, 0);
    let rays: Vec<Ray> = shadows.rays.iter().map(|ray| Ray { tnear: START_SHARE, ..*ray }).collect();
    let scene::Crowd { mut meshes, maps } = scene::crowd(folder, &mut RandomStream::new(7, 0))?;
    meshes.push(meshes[0].clone());
    let place = |(mesh, map): (usize, Affine3A)| Placement { bvh: mesh as u32, world_from_object: map };
    let mut placements: Vec<Placement> = maps.into_iter().map(place).collect();
    placements.push(place((meshes.len() - 1, Affine3A::from_translation([0.0, -1e4, 0.0].into()))));
    let build = |mesh: &TriangleMesh| Bvh::build(&mesh.positions, &mesh.triangles, &BuildOptions::default());
    let start = Instant::now();
    let bvhs = meshes.iter().map(|mesh| build(mesh).map(Arc::new)).collect::<Result<Vec<_>, _>>()?;
    let top = InstancedBvh::build(bvhs.clone(), &placements)?;
    let build_s = start.elapsed().as_secs_f64();
    let lazy = |(bvh, mesh): (&Arc<Bvh>, _)| lazy(bvh.clone(), mesh);
    let solid = SolidInstances::build(&top, bvhs.iter().zip(&meshes).map(lazy).collect::<Result<_>>()?)?;
    // What the first rays pay.
    let start = Instant::now();
    let mut scratch = solid.scratch();
    rays.iter().for_each(|ray| _ = solid.any_hit(ray, &mut scratch));
    let first_s = start.elapsed().as_secs_f64();
    let mut hits = [vec![false; rays.len()], vec![false; rays.len()]];
    let [of_plain, of_solid] = &mut hits;
    let mut plain = || rays.iter().zip(&mut *of_plain).for_each(|(ray, hit)| *hit = top.any_hit(ray));
    let mut boxes =
        || rays.iter().zip(&mut *of_solid).for_each(|(ray, hit)| *hit = solid.any_hit(ray, &mut scratch));
    let times = alternate(3, &mut [&mut plain as &mut dyn Timed, &mut boxes]);
    let (mut walk, mut counted) = (Counters::default(), Counters::default());
    for ray in &rays {
        top.any_hit_with(ray, &mut walk);
        solid.any_hit_with(ray, &mut scratch, &mut counted);
    }
    let prepared = solid.prepared();
    let counters = [
        json!({ "nodes": walk.nodes, "triangle_tests": walk.triangle_tests }),
        json!({
            "nodes": counted.nodes,
            "triangle_tests": counted.triangle_tests,
            "occluder_hits": counted.solid_hits,
            "objects": prepared.objects,
            "prepared": prepared.prepared,
            "occluders": prepared.boxes,
            "first_pass_s": first_s,
        }),
    ];
    let different = hits[0].iter().zip(&hits[1]).filter(|(a, b)| a != b).count();
    for (i, (method, mut counters)) in ["bvh", "bvh-volumetric"].into_iter().zip(counters).enumerate() {
        counters["different_bits"] = json!(different);
        let time_s = median(&times[i]);
        output.row(&Row {
            suite: "volumetric",
            scene: NAME.into(),
            method: method.into(),
            params: json!({ "call": "single", "rays": rays.len() }),
            time_s,
            build_s,
            mrays_s: rays.len() as f64 / time_s * 1e-6,
            rmse: 0.0,
            bias: 0.0,
            bytes: top.bytes(),
            counters,
            baseline: "bvh",
            speedup: paired_speedup(&times[0], &times[i]),
        })?;
    }
    Ok(())
}

fn lazy(bvh: Arc<Bvh>, mesh: &TriangleMesh) -> Result<LazySolidBvh<'_>> {
    let parts = ObjectMesh::new(&mesh.positions, &mesh.triangles);
    Ok(LazySolidBvh::build(bvh, &parts, &SolidBvhOptions::default())?)
}
