//! `cargo run --release -p umbrage-aomask --example mask_speed -- MESH.obj|GENERATOR [RAYS [PERCENT]]`: method `mask` against the
//! same rays through `Bvh::any_hits`, in turn, on this thread. Receivers are runs of 32 neighbours, as in the suite.

use std::time::Instant;
use umbrage_accel::{BuildOptions, Bvh};
use umbrage_aomask::{MaskCall, MaskOptions, Outputs, Pattern, PatternOptions, Receiver};
use umbrage_geom::{
    Ray, TriangleMesh,
    glam::{Vec2, Vec3},
    morton, offset_origin,
    sampling::{RandomStream, combine, triangle},
};

const RUN: usize = 32;
const WHOLE: usize = 1 << 17;

type Points = (Vec<[f32; 3]>, Vec<[f32; 3]>);

/// Runs of neighbours from points spread evenly over the surface.
fn receivers(mesh: &TriangleMesh, count: usize) -> Points {
    let mut areas = Vec::with_capacity(mesh.triangles.len());
    let mut sum = 0.0;
    for i in 0..mesh.triangles.len() {
        let [a, b, c] = mesh.triangle(i).map(Vec3::from);
        sum += f64::from((b - a).cross(c - a).length());
        areas.push(sum);
    }
    let mut random = RandomStream::new(1, 1);
    let mut points = Vec::new();
    while points.len() < WHOLE {
        let at = areas.partition_point(|&a| a <= f64::from(random.next_unit()) * sum);
        let [a, b, c] = mesh.triangle(at.min(areas.len() - 1)).map(Vec3::from);
        let normal = (b - a).as_dvec3().cross((c - a).as_dvec3()).normalize_or_zero().as_vec3();
        let uv = triangle(Vec2::new(random.next_unit(), random.next_unit()));
        let magnitude = a.abs().max(b.abs()).max(c.abs()).max_element();
        let point = offset_origin(a + (b - a) * uv.x + (c - a) * uv.y, normal, normal, magnitude);
        if normal != Vec3::ZERO {
            points.push((point.to_array(), normal.to_array()));
        }
    }
    let places: Vec<_> = points.iter().map(|p| p.0).collect();
    let order = morton::order(&places);
    let runs = (count / RUN).max(1);
    let run = |i: usize| &order[i * (WHOLE / RUN) / runs * RUN..][..RUN];
    (0..runs).flat_map(run).map(|&i| points[i as usize]).unzip()
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let name = arguments.next().ok_or("usage: mask_speed MESH.obj|GENERATOR [RAYS [PERCENT]]")?;
    let rays: u32 = arguments.next().map_or(Ok(128), |text| text.parse())?;
    let percent: f32 = arguments.next().map_or(Ok(3.0), |text| text.parse())?;
    let mesh = if name.contains('.') {
        umbrage_scene::read_mesh(name.as_ref())?
    } else {
        let parameters =
            umbrage_scene::generate::Parameters { triangles: Some(300_000), ..Default::default() };
        umbrage_scene::generate::generate(&name, &parameters)?.mesh
    };
    let bvh = Bvh::build(&mesh.positions, &mesh.triangles, &BuildOptions::default())?;
    let pattern = Pattern::new(&PatternOptions::default().with_rays(rays))?;
    let (points, normals) = receivers(&mesh, (1 << 18) / rays as usize);
    let options = MaskOptions::default().with_radius(percent / 100.0 * mesh.bounds().diagonal());
    let mut all: Vec<Ray> = Vec::new();
    for (i, (&point, &normal)) in points.iter().zip(&normals).enumerate() {
        let receiver = Receiver::new(i, point, normal, combine(options.seed, i as u32))?;
        all.extend(pattern.rays_of(&receiver, options.radius));
    }
    let mut hits = vec![false; all.len()];
    let (mut ao, mut masks) = (vec![0.0; points.len()], vec![0; points.len() * pattern.words()]);
    let (mut times, mut single) = (Vec::new(), Vec::new());
    for _ in 0..9 {
        let start = Instant::now();
        bvh.any_hits(&all, &mut hits);
        single.push(start.elapsed().as_secs_f64());
        let start = Instant::now();
        let outputs = Outputs::new(&mut ao).with_masks(&mut masks);
        let receivers = Receiver::from_slices(&points, &normals, options.seed)?;
        MaskCall::new(&bvh, &pattern, &receivers, &options).answer(outputs, &mut |_| true)?;
        times.push(start.elapsed().as_secs_f64());
    }
    let masks = masks.chunks(pattern.words());
    let bits = masks.flat_map(|mask| (0..pattern.len()).map(|i| mask[i / 64] >> (i % 64) & 1 == 1));
    let differ = bits.zip(&hits).filter(|(a, b)| a != *b).count();
    let mean = ao.iter().sum::<f32>() / ao.len() as f32;
    times.sort_by(f64::total_cmp);
    single.sort_by(f64::total_cmp);
    let rate = |times: &[f64]| all.len() as f64 / times[4] * 1e-6;
    println!(
        "{name} {rays} rays {percent} %: any_hits {:.1}, mask {:.1} Mrays/s ({:.2}), mean ao {mean:.3}, {differ} bits differ",
        rate(&single),
        rate(&times),
        single[4] / times[4],
    );
    Ok(())
}
