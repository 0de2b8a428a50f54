//! Pictures of tessellations, coloured by rate.

use super::{
    frame::Method,
    scenes::{Scene, View},
};
use anyhow::{Context, Result};
use image::RgbImage;
use std::{path::Path, sync::Arc};
use umbrage_geom::glam::Vec3;
use umbrage_reyes::{
    FootprintRule, PatchBounds, Surface, SurfaceOptions, SurfaceTracer, TraceOptions, TraceState, published,
};

/// Micropolygons of so many pixels, so that they can be seen.
const EDGE: f32 = 12.0;

/// Colours of levels 0, 1, ..
const COLORS: [[f32; 3]; 8] = [
    [0.35, 0.35, 0.75],
    [0.25, 0.55, 0.85],
    [0.25, 0.75, 0.65],
    [0.45, 0.75, 0.3],
    [0.85, 0.8, 0.3],
    [0.9, 0.55, 0.25],
    [0.85, 0.3, 0.3],
    [0.7, 0.3, 0.7],
];

/// Writes `SCENE-entry.png` and `SCENE-default.png`, with visible micropolygons, and `SCENE-close.png`.
pub fn write(scene: &Scene, size: u32, folder: &Path) -> Result<()> {
    std::fs::create_dir_all(folder).with_context(|| folder.display().to_string())?;
    let entry = Method::new(
        "entry",
        SurfaceOptions::default().with_bounds(PatchBounds::Hull).with_tight_levels(0),
        published::trace_options(FootprintRule::Entry).with_edge(EDGE),
    );
    let default = Method::new("default", SurfaceOptions::default(), TraceOptions::default().with_edge(EDGE));
    for (method, close, name) in
        [(&entry, false, "entry"), (&default, false, "default"), (&default, true, "close")]
    {
        let picture = draw(scene, &scene.view(close, size), method)?;
        let path = folder.join(format!("{}-{name}.png", scene.name));
        picture.save(&path).with_context(|| path.display().to_string())?;
    }
    Ok(())
}

fn draw(scene: &Scene, view: &View, method: &Method) -> Result<RgbImage> {
    let surface = Arc::new(Surface::build(&scene.control, &method.surface)?);
    let tracer = SurfaceTracer::new(surface, &method.trace)?;
    let mut state = TraceState::new(&method.trace);
    let mut picture = RgbImage::from_pixel(view.size, view.size, image::Rgb([245; 3]));
    for (x, y) in view.pixels() {
        let (ray, differential) = view.ray(x, y);
        let Some(hit) = tracer.closest_hit(&ray, &differential, &mut state) else { continue };
        let light =
            0.35 + 0.65 * tracer.limit(&hit).normal.dot(Vec3::new(0.4, 0.7, 0.6).normalize()).max(0.0);
        let rate = usize::from(hit.levels[0].max(hit.levels[1])).min(COLORS.len() - 1);
        // Cells as a chequerboard, patches by lines.
        let cell = [hit.u, hit.v]
            .iter()
            .zip(hit.levels)
            .map(|(&p, l)| (p * f32::from(1u16 << l)) as u32)
            .sum::<u32>();
        let shade = if cell % 2 == 0 { 1.0 } else { 0.8 };
        let border = hit.u.min(1.0 - hit.u).min(hit.v.min(1.0 - hit.v)) < 0.02;
        let shade = if border { 0.35 } else { shade } * light;
        let color = COLORS[rate].map(|c| (255.0 * (c * shade).clamp(0.0, 1.0)) as u8);
        picture.put_pixel(x, y, image::Rgb(color));
    }
    Ok(picture)
}
