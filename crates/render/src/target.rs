//! Numbers of samples for a target error, found by pilot pixels.
//!
//! The error of a number of samples is measured: half the mean squared difference of two renderings of the pilot pixels that see the
//! same surfaces by other rays. Errors between measured numbers are interpolated in logarithms. Pilots are spread over the whole
//! image, so that all shards choose the same numbers.

use crate::{
    RenderError,
    integrator::{Integrator, Pixel},
};
use rayon::prelude::*;
use umbrage_geom::{Progress, sampling::sobol_2d};
use umbrage_query::engine::Report;

/// Share of the target that the expected error is to have.
const TARGET_SHARE: f64 = 0.8;

/// Most pilot pixels.
const MAX_PILOTS: u32 = 1024;

/// Pilot pixels that are computed together.
const BLOCK_PILOTS: usize = 32;

/// Most samples that are tried.
const MAX_TRIED_SAMPLES: u32 = 1024;

/// Seeds of the two renderings.
const SALTS: [u32; 2] = [0x7461_7231, 0x7461_7232];

/// Chosen numbers of samples and the errors that are expected with them.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Samples {
    /// Samples of each area light a camera sample.
    pub shadow: u32,
    /// Rays into the sky a camera sample.
    pub ao: u32,
    /// Root mean square error of the layer `shadow` over pixels that light could reach; `None` without lights.
    pub shadow_error: Option<f64>,
    /// The same of the layer `ao` over pixels that see a surface; `None` without a sky.
    pub ao_error: Option<f64>,
}

/// Where pilot pixels are.
pub(crate) fn pilots(width: u32, height: u32) -> Vec<(u32, u32)> {
    let count = MAX_PILOTS.min(width.saturating_mul(height));
    let place = |i| {
        let square = sobol_2d(i, 0, 0x7069_6c6f);
        let at = |x: f32, size: u32| ((x * size as f32) as u32).min(size - 1);
        (at(square.x, width), at(square.y, height))
    };
    (0..count).map(place).collect()
}

/// Mean squared error of the layers `shadow` and `ao` at `pilots`, by what `with_salt` makes of a salt; `None` where no pilot has
/// the layer. `progress` gets growing fractions that end at exactly 1, and returns `false` to cancel.
pub(crate) fn squared_errors<'a>(
    with_salt: impl Fn(u32) -> Integrator<'a>,
    pilots: &[(u32, u32)],
    progress: Report<'_>,
) -> Result<[Option<f64>; 2], RenderError> {
    let progress = Progress::new(2 * pilots.len().div_ceil(BLOCK_PILOTS) as u64, progress);
    let rendered = |salt: u32| -> Result<Vec<Pixel>, RenderError> {
        let integrator = with_salt(salt);
        let block = |places: &[(u32, u32)]| {
            let mut scratch = integrator.scratch();
            integrator.open_pixels(places, &mut scratch, &progress);
            let pixels: Vec<Pixel> =
                places.iter().map(|&(x, y)| integrator.pixel(x, y, &mut scratch)).collect();
            progress.advance(1)?;
            scratch.failed.take().map_or(Ok(pixels), |error| Err(RenderError::from(error)))
        };
        let blocks: Vec<Vec<Pixel>> = pilots.par_chunks(BLOCK_PILOTS).map(block).collect::<Result<_, _>>()?;
        Ok(blocks.concat())
    };
    let [a, b] = [rendered(SALTS[0])?, rendered(SALTS[1])?];
    progress.finish()?;
    let mean = |counts: fn(&Pixel) -> bool, of: fn(&Pixel) -> f32| {
        let pairs = a.iter().zip(&b).filter(|(a, _)| counts(a));
        let squares = pairs.map(|(a, b)| 0.5 * f64::from(of(a) - of(b)).powi(2));
        let (sum, count) = squares.fold((0.0, 0u32), |(sum, count), x| (sum + x, count + 1));
        (count > 0).then(|| sum / f64::from(count))
    };
    Ok([mean(|p| p.lit, |p| p.shadow), mean(|p| p.seen, |p| p.ao)])
}

/// The smallest number of samples, a multiple of `step`, whose error is expected to be at most [`TARGET_SHARE`] times `target`, with that
/// error. `measure` measures the squared error of a number of samples; `None` if there is nothing to measure.
pub(crate) fn choose(
    target: f32,
    step: u32,
    mut measure: impl FnMut(u32) -> Result<Option<f64>, RenderError>,
) -> Result<(u32, Option<f64>), RenderError> {
    let wanted = (TARGET_SHARE * f64::from(target)).powi(2);
    let mut last: Option<(u32, f64)> = None;
    let mut samples = step;
    loop {
        let Some(squared) = measure(samples)? else { return Ok((step, None)) };
        if squared <= wanted || samples >= MAX_TRIED_SAMPLES {
            let Some((fewer, more_error)) = last.filter(|_| squared < wanted) else {
                return Ok((samples, Some(squared.sqrt())));
            };
            // A straight line in logarithms between the two.
            let (x0, x1) = (f64::from(fewer).ln(), f64::from(samples).ln());
            let (y0, y1) = (more_error.ln(), squared.max(1e-12).ln());
            let at = |n: u32| (y0 + (y1 - y0) * (f64::from(n).ln() - x0) / (x1 - x0)).exp();
            let between = (fewer..=samples).step_by(step as usize);
            let chosen = between.into_iter().find(|&n| at(n) <= wanted).unwrap_or(samples);
            return Ok((chosen, Some(at(chosen).sqrt())));
        }
        last = Some((samples, squared));
        samples *= 2;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_least_samples_are_found() {
        let falling = |n: u32| Ok(Some(1.0 / f64::from(n)));
        let (samples, error) = choose(0.1, 1, falling).unwrap();
        assert_eq!(samples, 157);
        assert!((error.unwrap() - 0.08).abs() < 1e-3);
        assert_eq!(choose(0.1, 8, falling).unwrap().0, 160);
        // One sample is enough; no number is; there is nothing to ask.
        assert_eq!(choose(10.0, 8, falling).unwrap().0, 8);
        assert_eq!(choose(1e-6, 8, falling).unwrap().0, MAX_TRIED_SAMPLES);
        assert_eq!(choose(0.1, 8, |_| Ok(None)).unwrap(), (8, None));
        // An error that vanishes.
        assert_eq!(choose(0.1, 1, |n| Ok(Some(if n < 4 { 1.0 } else { 0.0 }))).unwrap().0, 3);
    }

    #[test]
    fn pilots_are_all_over_the_image() {
        let pilots = pilots(640, 480);
        assert_eq!(pilots.len(), 1024);
        let left = pilots.iter().filter(|(x, _)| *x < 320).count();
        assert!((500..=524).contains(&left) && pilots.iter().all(|&(x, y)| x < 640 && y < 480));
        assert_eq!(super::pilots(3, 2).len(), 6);
    }
}
