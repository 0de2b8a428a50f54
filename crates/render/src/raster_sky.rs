//! Ambient occlusion of a whole image, before its pixels are shaded, by engines that answer images.

use crate::{
    RenderError,
    integrator::{Integrator, Scratch},
};
use rayon::prelude::*;
use umbrage_aomask::{Outputs, RasterView};
use umbrage_geom::{glam::Vec3, sampling::combine};
use umbrage_query::{Answers, Engine, QueryError, engine::Report};

/// Camera samples may lie anywhere in their pixel.
const PIXEL_RADIUS: f32 = 0.71;

/// Openness of the sky, 1 is open, for each camera sample and pixel of the image, row by row; nothing for engines that don't
/// answer images. `progress` is asked whether to go on.
///
/// # Errors
/// [`RenderError::Query`], [`RenderError::Cancelled`].
pub(crate) fn openness(
    integrator: &Integrator<'_>,
    engine: &dyn Engine,
    [width, height]: [u32; 2],
    progress: Report<'_>,
) -> Result<Vec<Vec<f32>>, RenderError> {
    if engine.answers() != Answers::Images {
        return Ok(Vec::new());
    }
    let reason = "its camera can't be rasterized";
    let unsupported = QueryError::Unsupported { method: engine.name(), reason };
    let camera = integrator.camera.raster(width, height).ok_or(unsupported)?;
    (0..integrator.spp)
        .map(|sample| {
            let pixels = 0..width as usize * height as usize;
            let (points, normals): (Vec<_>, Vec<_>) = pixels
                .into_par_iter()
                .map_init(Scratch::default, |scratch, i| {
                    let (x, y) = (i as u32 % width, i as u32 / width);
                    let receiver = integrator.receiver(x, y, sample, scratch);
                    receiver.map_or(([f32::NAN; 3], [0.0; 3]), |(p, n): (Vec3, Vec3)| (p.into(), n.into()))
                })
                .unzip();
            let view = RasterView::new(camera, width, height, &points, &normals).with_footprint(PIXEL_RADIUS);
            let mut open = vec![1.0; points.len()];
            let seed = combine(integrator.seed, sample);
            engine.image(&view, seed, Outputs::new(&mut open), &mut |_| progress(0.0))?;
            Ok(open)
        })
        .collect()
}
