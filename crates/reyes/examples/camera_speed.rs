//! Time of camera and shadow rays on a control mesh: `cargo run --release -p umbrage-reyes --example camera_speed -- MESH.obj
//! [SIZE]`. Prints each of three frames, the first of which makes what is needed: at rates chosen per ray, and at rates chosen
//! once.

use std::{path::Path, sync::Arc, time::Instant};
use umbrage_geom::{Ray, glam::Vec3, offset_origin};
use umbrage_reyes::{
    EyeRates, RatedSurface, Surface, SurfaceOptions, SurfaceTracer, TraceOptions, TraceState,
    camera_differential, light_differential,
};
use umbrage_scene::read_polygons;

struct Camera {
    eye: Vec3,
    forward: Vec3,
    right: Vec3,
    down: Vec3,
    size: u32,
    light: Vec3,
}

impl Camera {
    fn rays(&self) -> impl Iterator<Item = Ray> {
        (0..self.size * self.size).map(|pixel| {
            let at = |i: u32| i as f32 + 0.5 - self.size as f32 / 2.0;
            let (x, y) = (at(pixel % self.size), at(pixel / self.size));
            Ray::new(self.eye, self.forward + self.right * x + self.down * y)
        })
    }

    fn report(&self, name: &str, camera: f64, shadow: f64, shadows: usize, blocked: usize) {
        println!(
            "{name}: camera {:.2} M/s, shadow {:.2} M/s of {shadows} rays, {blocked} blocked",
            f64::from(self.size * self.size) / camera * 1e-6,
            shadows as f64 / shadow * 1e-6,
        );
    }
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let path = arguments.next().ok_or("name an OBJ file")?;
    let size: u32 = arguments.next().map_or(Ok(512), |s| s.parse())?;
    let control = read_polygons(Path::new(&path))?;
    let surface = Arc::new(Surface::build(
        &control,
        &SurfaceOptions::default()
            .with_tight_levels(std::env::var("TIGHT").map_or(1, |t| t.parse().unwrap())),
    )?);
    let bounds = surface.bounds();
    let eye = bounds.center() + Vec3::new(0.4, 0.35, 1.0).normalize() * bounds.diagonal() * 1.25;
    let forward = (bounds.center() - eye).normalize();
    let right = forward.cross(Vec3::Y).normalize() * (0.8 / size as f32);
    let down = forward.cross(right);
    let light = bounds.center() + Vec3::new(0.5, 1.0, 0.3) * bounds.diagonal();
    let camera = Camera { eye, forward, right, down, size, light };
    if std::env::var_os("ONCE").is_none() {
        by_ray(&camera, Arc::clone(&surface), bounds.diagonal())?;
    }
    once(&camera, surface)
}

fn by_ray(camera: &Camera, surface: Arc<Surface>, diagonal: f32) -> Result<(), Box<dyn std::error::Error>> {
    let options = TraceOptions::default();
    let tracer = SurfaceTracer::new(surface, &options)?;
    let mut state = TraceState::new(&options);
    let spread = [Vec3::X * 0.1 * diagonal, Vec3::Z * 0.1 * diagonal];
    let differential = camera_differential(camera.right, camera.down);
    for _ in 0..3 {
        let start = Instant::now();
        let closest = |ray| tracer.closest_hit(&ray, &differential, &mut state);
        let hits: Vec<_> = camera.rays().filter_map(closest).collect();
        let seconds = start.elapsed().as_secs_f64();
        let start = Instant::now();
        let mut blocked = 0;
        for hit in &hits {
            let shadow = Ray::between(tracer.leave(hit, camera.light), camera.light);
            let differential = light_differential(differential.footprint(hit.t), spread);
            blocked += usize::from(tracer.any_hit(&shadow, &differential, &mut state));
        }
        camera.report("by ray", seconds, start.elapsed().as_secs_f64(), hits.len(), blocked);
    }
    println!("{:?}", tracer.counts());
    Ok(())
}

fn once(camera: &Camera, surface: Arc<Surface>) -> Result<(), Box<dyn std::error::Error>> {
    let start = Instant::now();
    let rated =
        RatedSurface::for_eye(surface, &EyeRates::new(camera.eye, 2.0 * camera.right.length()), &mut |_| {
            true
        })?;
    println!("once: {:.3} s to make", start.elapsed().as_secs_f64());
    for _ in 0..3 {
        let start = Instant::now();
        let hits: Vec<_> =
            camera.rays().filter_map(|ray| Some((ray.at(rated.closest_hit(&ray)?.hit.t), ray))).collect();
        let seconds = start.elapsed().as_secs_f64();
        let start = Instant::now();
        let mut blocked = 0;
        for (point, ray) in &hits {
            let origin = offset_origin(*point, -ray.direction, -ray.direction, 64.0 * camera.eye.length());
            blocked += usize::from(rated.any_hit(&Ray::between(origin, camera.light)));
        }
        camera.report("once", seconds, start.elapsed().as_secs_f64(), hits.len(), blocked);
    }
    println!("{} micropolygons, {} bytes", rated.micropolygons(), rated.bytes());
    Ok(())
}
