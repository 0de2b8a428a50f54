//! Time of camera and shadow rays on a control mesh: `cargo run --release -p umbrage-reyes --example camera_speed -- MESH.obj
//! [SIZE]`. Prints each of three frames with the same tracer, the first of which makes the grids.

use std::{path::Path, sync::Arc, time::Instant};
use umbrage_geom::{Ray, glam::Vec3};
use umbrage_reyes::{
    Surface, SurfaceOptions, SurfaceTracer, TraceOptions, TraceState, camera_differential, light_differential,
};
use umbrage_scene::mesh_file::read_polygons;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let path = arguments.next().ok_or("name an OBJ file")?;
    let size: u32 = arguments.next().map_or(Ok(512), |s| s.parse())?;
    let surface = Arc::new(Surface::build(&read_polygons(Path::new(&path))?, &SurfaceOptions::default())?);
    let options = TraceOptions::default();
    let tracer = SurfaceTracer::new(Arc::clone(&surface), &options)?;
    let mut state = TraceState::new(&options);
    let bounds = surface.bounds();
    let eye = bounds.center() + Vec3::new(0.4, 0.35, 1.0).normalize() * bounds.diagonal() * 1.25;
    let forward = (bounds.center() - eye).normalize();
    let right = forward.cross(Vec3::Y).normalize() * (0.8 / size as f32);
    let down = forward.cross(right);
    let light = bounds.center() + Vec3::new(0.5, 1.0, 0.3) * bounds.diagonal();
    let spread = [Vec3::X * 0.1 * bounds.diagonal(), Vec3::Z * 0.1 * bounds.diagonal()];
    for frame in 0..3 {
        let start = Instant::now();
        let mut hits = Vec::new();
        for pixel in 0..size * size {
            let (x, y) = (pixel % size, pixel / size);
            let at = |i: u32| i as f32 + 0.5 - size as f32 / 2.0;
            let ray = Ray::new(eye, forward + right * at(x) + down * at(y));
            let differential = camera_differential(right, down);
            if let Some(hit) = tracer.closest_hit(&ray, &differential, &mut state) {
                hits.push((hit, differential.footprint(hit.t)));
            }
        }
        let camera = start.elapsed().as_secs_f64();
        let start = Instant::now();
        let mut shadowed = 0;
        for (hit, footprint) in &hits {
            let origin = tracer.leave(hit, light);
            let shadow = Ray::between(origin, light);
            let differential = light_differential(*footprint, spread);
            shadowed += u32::from(tracer.any_hit(&shadow, &differential, &mut state));
        }
        let shadow = start.elapsed().as_secs_f64();
        let rays = f64::from(size * size);
        println!(
            "frame {frame}: camera {:.2} M/s, shadow {:.2} M/s of {} rays, {shadowed} blocked, {:?}",
            rays / camera * 1e-6,
            hits.len() as f64 / shadow * 1e-6,
            hits.len(),
            tracer.counts()
        );
    }
    Ok(())
}
