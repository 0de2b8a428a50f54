//! Ambient occlusion of a whole image by rasterization, before its pixels are shaded.

use crate::{
    RenderError,
    geometry::Geometry,
    integrator::{Integrator, Scratch},
    method::{MASK_RASTER, SkyRays},
};
use rayon::prelude::*;
use umbrage_aomask::{
    MaskOptions, MaskTables, Outputs, Pattern, PatternOptions, RasterLevel, RasterOptions, RasterView,
    TableOptions, rasterize,
};
use umbrage_geom::{glam::Vec3, sampling::combine};

/// Camera samples may lie anywhere in their pixel.
const FOOTPRINT: f32 = 0.71;

/// Openness of the sky, 1 is open, for each camera sample and pixel of the image, row by row.
///
/// # Errors
/// [`RenderError::MaskGeometry`], [`RenderError::RasterLens`], [`RenderError::Mask`].
pub(crate) fn openness(
    integrator: &Integrator<'_>,
    geometry: &Geometry,
    sky: &SkyRays,
    [width, height]: [u32; 2],
) -> Result<Vec<Vec<f32>>, RenderError> {
    let (_, mesh) = geometry.flat_opaque().ok_or(RenderError::MaskGeometry(MASK_RASTER))?;
    let camera = integrator.camera.raster(width, height).ok_or(RenderError::RasterLens)?;
    let pattern = PatternOptions::default()
        .with_rays(sky.samples)
        .with_falloff(sky.falloff.clone())
        .with_seed(sky.seed);
    let tables = MaskTables::new(Pattern::new(&pattern)?, &TableOptions::default())?;
    let level = RasterLevel::exact(&mesh.positions, &mesh.triangles);
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
            let view = RasterView::new(camera, width, height, &points, &normals).with_footprint(FOOTPRINT);
            let options = MaskOptions::default().with_radius(sky.radius).with_seed(combine(sky.seed, sample));
            let mut open = vec![1.0; points.len()];
            let outputs = Outputs::new(&mut open);
            rasterize(&tables, &[level], &view, &options, &RasterOptions::default(), outputs, &mut |_| true)?;
            Ok(open)
        })
        .collect()
}
