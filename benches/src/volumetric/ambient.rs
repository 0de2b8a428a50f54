//! Part `ambient`: solid boxes for ambient rays of any length, against the same hierarchy without them.

use super::{Options, scene};
use crate::{
    rows::{Output, Row, Timed, alternate, median, note, paired_speedup},
    scenes::{self, Receivers},
};
use anyhow::Result;
use serde_json::json;
use std::{sync::Arc, time::Instant};
use umbrage_accel::{BuildOptions, Bvh, Counters};
use umbrage_aomask::{MaskCall, MaskOptions, Outputs, Pattern, PatternOptions, Receiver};
use umbrage_geom::{Ray, TriangleMesh, glam::Vec3};
use umbrage_occlusion::volumetric::{Ends, ObjectMesh, SolidBvh, SolidBvhOptions};

/// Closed meshes, on a ground.
const MESHES: [&str; 3] = ["bunny_60k", "armadillo_86k", "dragon_871k"];

/// Of the mesh's diagonal.
const RADII: [f32; 3] = [0.03, 0.1, f32::INFINITY];
const RAYS: [u32; 2] = [64, 256];

/// Receivers that stay together, as neighbours in a bake of the whole surface, and those of the whole surface.
const RUN_RECEIVERS: usize = 32;
const SURFACE_RECEIVERS: usize = 1 << 17;

/// The ways to answer.
const METHODS: [&str; 4] = ["bvh", "bvh-volumetric", "bvh-volumetric+cache", "mask"];

/// The structures of a mesh on a ground.
struct Built {
    bvh: Arc<Bvh>,
    bvh_s: f64,
    solid: SolidBvh,
    solid_s: f64,
}

/// Rows for receivers on the mesh and on the ground around it.
pub fn rows(options: &Options, output: &mut Output) -> Result<()> {
    for name in MESHES {
        if options.only.as_ref().is_some_and(|only| !name.contains(only.as_str())) {
            continue;
        }
        let Some(mesh) = scene::closed_mesh(name, options.quick)? else {
            eprintln!("no folder of meshes: {name} is skipped");
            continue;
        };
        note(&format!("preparing {name}"));
        let scene = scene::single(name, &mesh);
        let (positions, triangles) = (&scene.mesh.positions, &scene.mesh.triangles);
        let start = Instant::now();
        let bvh = Arc::new(Bvh::build(positions, triangles, &BuildOptions::default())?);
        let bvh_s = start.elapsed().as_secs_f64();
        let start = Instant::now();
        let options_of = SolidBvhOptions::default();
        let parts = ObjectMesh::new(positions, triangles).with_objects(&scene.objects);
        let solid = SolidBvh::build(bvh.clone(), &parts, &options_of)?;
        let built = Built { bvh, bvh_s, solid, solid_s: start.elapsed().as_secs_f64() };
        // The ground is the last object.
        let body = scene.objects.first().map_or(0..0, |object| object.triangles.clone());
        let body = TriangleMesh {
            positions: scene.mesh.positions.clone(),
            triangles: scene.mesh.triangles[body.start as usize..body.end as usize].to_vec(),
            ..TriangleMesh::default()
        };
        for (place, surface) in [("mesh", &body), ("ground", &around(&body, scene.mesh.bounds().min.y))] {
            for rays in RAYS {
                let receivers = thin(scenes::receivers(surface, SURFACE_RECEIVERS, 1), rays, options.quick);
                for radius in RADII {
                    measure(name, place, &built, &receivers, rays, radius, options, output)?;
                }
            }
        }
    }
    output.geomeans(&["part", "receivers", "radius"])
}

/// The part of the ground at `y` that lies below `body` and within half its size around.
fn around(body: &TriangleMesh, y: f32) -> TriangleMesh {
    let (bounds, mut ground) = (body.bounds(), TriangleMesh::default());
    let margin = 0.5 * (bounds.max - bounds.min);
    let (low, high) = (bounds.min - margin, bounds.max + margin);
    ground.positions =
        [[low.x, low.z], [high.x, low.z], [high.x, high.z], [low.x, high.z]].map(|[x, z]| [x, y, z]).to_vec();
    ground.triangles = vec![[0, 2, 1], [0, 3, 2]];
    ground
}

/// Evenly spaced runs of neighbours, for about half a million rays; a quarter of that in the quick form.
fn thin(receivers: Receivers, rays: u32, quick: bool) -> Receivers {
    let count = (if quick { 1 << 17 } else { 1 << 19 }) / rays as usize;
    let (runs, wanted) = (receivers.points.len() / RUN_RECEIVERS, (count / RUN_RECEIVERS).max(1));
    let pick = |v: &[Vec3]| {
        (0..wanted)
            .flat_map(|i| v[i * runs / wanted * RUN_RECEIVERS..][..RUN_RECEIVERS].iter().copied())
            .collect()
    };
    Receivers { points: pick(&receivers.points), normals: pick(&receivers.normals) }
}

#[allow(clippy::too_many_arguments)] // what tells a workload from others
fn measure(
    name: &str,
    place: &str,
    built: &Built,
    receivers: &Receivers,
    per_receiver: u32,
    radius: f32,
    options: &Options,
    output: &mut Output,
) -> Result<()> {
    let pattern = Pattern::new(&PatternOptions::default().with_rays(per_receiver))?;
    let masks = MaskOptions::default().with_radius(radius);
    let list = |v: &[Vec3]| v.iter().map(Vec3::to_array).collect::<Vec<_>>();
    let (points, normals) = (list(&receivers.points), list(&receivers.normals));
    let mut rays: Vec<Ray> = Vec::with_capacity(points.len() * pattern.len());
    for (i, (&point, &normal)) in points.iter().zip(&normals).enumerate() {
        let receiver = Receiver::new(i, point, normal, Receiver::seed_of(point, normal, masks.seed))?;
        rays.extend(pattern.rays_of(&receiver, radius));
    }
    let mut hits = [0; 3].map(|_| vec![false; rays.len()]);
    let [plain, boxes, cached] = &mut hits;
    let (mut scratch, mut kept) = (built.solid.scratch(), built.solid.scratch());
    let (mut ao, mut words) = (vec![0.0; points.len()], vec![0; points.len() * pattern.words()]);
    let one = rayon::ThreadPoolBuilder::new().num_threads(1).build()?;
    let mut by_bvh = || built.bvh.any_hits_with(&rays, plain, &mut ());
    let mut by_boxes = || built.solid.any_hits(&rays, boxes, Ends::Unknown, None, &mut scratch);
    let mut by_cache = || built.solid.any_hits(&rays, cached, Ends::Unknown, Some(0), &mut kept);
    let mut by_masks = || {
        one.install(|| {
            let outputs = Outputs::new(&mut ao).with_masks(&mut words);
            Receiver::from_slices(&points, &normals, masks.seed)
                .and_then(|asked| {
                    MaskCall::new(&built.bvh, &pattern, &asked, &masks).answer(outputs, &mut |_| true)
                })
                .expect("valid arguments");
        });
    };
    let passes = if options.quick { 5 } else { 9 };
    let timed: &mut [&mut dyn Timed] = &mut [&mut by_bvh, &mut by_boxes, &mut by_cache, &mut by_masks];
    let times = alternate(passes, timed);
    let masked: Vec<bool> = (0..rays.len())
        .map(|i| {
            let (receiver, ray) = (i / pattern.len(), i % pattern.len());
            words[receiver * pattern.words() + ray / 64] >> (ray % 64) & 1 == 1
        })
        .collect();
    let (mut walk, mut counted) = (Counters::default(), Counters::default());
    let mut scratch = built.solid.scratch();
    for ray in &rays {
        built.bvh.any_hit_with(ray, &mut walk);
        built.solid.any_hit_with(ray, Ends::Unknown, None, &mut scratch, &mut counted);
    }
    let occluded = hits[0].iter().filter(|&&hit| hit).count();
    for (i, method) in METHODS.into_iter().enumerate() {
        let answers = hits.get(i).unwrap_or(&masked);
        let different = answers.iter().zip(&hits[0]).filter(|(a, b)| a != b).count();
        let mut counters = json!({ "different_bits": different, "occluded": occluded, "rays": rays.len() });
        if i == 0 {
            counters["nodes"] = json!(walk.nodes);
            counters["triangle_tests"] = json!(walk.triangle_tests);
        } else if i == 1 {
            counters["nodes"] = json!(counted.nodes);
            counters["triangle_tests"] = json!(counted.triangle_tests);
            counters["occluder_hits"] = json!(counted.solid_hits);
        }
        let time_s = median(&times[i]);
        let boxes = [1, 2].contains(&i);
        let radius =
            if radius.is_finite() { json!((f64::from(radius) * 1e3).round() / 1e3) } else { json!("inf") };
        output.row(&Row {
            suite: "volumetric",
            scene: name.into(),
            method: method.into(),
            params: json!({ "part": "ambient", "receivers": place, "rays": per_receiver, "radius": radius }),
            time_s,
            build_s: built.bvh_s + if boxes { built.solid_s } else { 0.0 },
            mrays_s: rays.len() as f64 / time_s * 1e-6,
            rmse: 0.0,
            bias: 0.0,
            bytes: if boxes { built.solid.bytes() } else { built.bvh.bytes() },
            counters,
            baseline: "bvh",
            speedup: paired_speedup(&times[0], &times[i]),
        })?;
    }
    Ok(())
}
