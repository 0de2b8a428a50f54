//! Pixels where a ray slips through a surface, and how far tessellations lie from the limit surface.

use super::{
    frame::{Method, Reference, rate},
    scenes::{Scene, View},
};
use anyhow::Result;
use std::sync::Arc;
use umbrage_geom::Ray;
use umbrage_reyes::{Surface, SurfaceTracer, TraceState};

/// What random views showed.
#[derive(Default)]
pub struct Found {
    pub rays: usize,
    /// Rays that pass a surface which all rays around them hit.
    pub cracks: usize,
    /// Distance from the limit surface along the ray, in footprint edges: mean and largest over rays that face the surface.
    pub mean_error: f64,
    pub max_error: f64,
    /// Rays whose error is more than two footprint edges, cracks left out.
    pub failures: usize,
}

/// Traces `views` random views of `size` x `size` pixels.
pub fn count(scene: &Scene, method: &Method, reference: &Reference, views: u32, size: u32) -> Result<Found> {
    let surface = Arc::new(Surface::build(&scene.control, &method.surface)?);
    let tracer = SurfaceTracer::new(Arc::clone(&surface), &method.trace)?;
    let mut state = TraceState::new(&method.trace);
    let mut found = Found::default();
    let mut compared = 0usize;
    for seed in 0..views {
        let view = scene.random_view(seed, size);
        let once = method.once.map(|once| rate(Arc::clone(&surface), &view, once)).transpose()?;
        for (x, y) in view.pixels() {
            let (ray, differential) = view.ray(x, y);
            let hit = match &once {
                Some(rated) => rated.closest_hit(&ray).map(|hit| hit.hit),
                None => tracer.closest_hit(&ray, &differential, &mut state),
            };
            found.rays += 1;
            let truth = reference.closest_hit(&ray);
            let Some((t, facing)) = truth else { continue };
            let pixel =
                differential.footprint(t).map(|edge| edge.length()).into_iter().fold(f32::MAX, f32::min);
            let error = hit.map_or(f32::INFINITY, |hit| (hit.t - t).abs() * ray.direction.length() / pixel);
            // A ray that slips through sees the inside, or nothing.
            if hit.is_none_or(|hit| !hit.front) && is_smooth_around(&view, reference, x, y, t) {
                found.cracks += 1;
            } else if facing > 0.3
                && error.is_finite()
                && (error <= 2.0 || is_smooth_around(&view, reference, x, y, t))
            {
                compared += 1;
                found.mean_error += f64::from(error);
                found.max_error = found.max_error.max(error.into());
                found.failures += usize::from(error > 2.0);
            }
        }
    }
    found.mean_error /= compared.max(1) as f64;
    Ok(found)
}

/// Whether rays around a pixel hit the same layer of the limit surface, from the front as it does.
fn is_smooth_around(view: &View, reference: &Reference, x: u32, y: u32, t: f32) -> bool {
    let (ray, d) = view.ray(x, y);
    let [right, down] = d.d_direction;
    [(1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0), (1.0, 1.0), (-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0)]
        .into_iter()
        .all(|(a, b)| {
            let beside = Ray::new(ray.origin, ray.direction + 1.5 * (a * right + b * down));
            reference.closest_hit(&beside).is_some_and(|(other, facing)| {
                let pixel = d.footprint(t).map(|edge| edge.length()).into_iter().fold(0f32, f32::max);
                facing > 0.1 && (other - t).abs() * ray.direction.length() < 40.0 * pixel
            })
        })
}
