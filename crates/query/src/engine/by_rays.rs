//! Openness of receivers by engines that answer single rays.

use super::{Engine, LightRay, Report};
use crate::QueryError;
use rayon::prelude::*;
use umbrage_aomask::{Pattern, Receiver};
use umbrage_geom::Progress;

/// Receivers that one thread answers in turn.
const BLOCK: usize = 64;

/// Writes how open the sky is over each receiver, by the rays that `pattern` gives it up to `radius` (world units, may be infinite):
/// what engines that answer receivers do, for those that answer rays. Runs on all threads of the caller's pool.
///
/// # Errors
/// Those of [`Engine::transmittances`]; [`QueryError::Cancelled`].
pub fn openness_by_rays(
    engine: &dyn Engine,
    (pattern, radius): (&Pattern, f32),
    receivers: &[Receiver],
    open: &mut [f32],
    progress: Report<'_>,
) -> Result<(), QueryError> {
    let progress = Progress::new(receivers.len().div_ceil(BLOCK) as u64, progress);
    receivers.par_chunks(BLOCK).zip(open.par_chunks_mut(BLOCK)).try_for_each(|(receivers, open)| {
        progress.check()?;
        let (mut rays, mut passed) = (Vec::new(), Vec::new());
        for (receiver, open) in receivers.iter().zip(open) {
            let directions = pattern.directions(pattern.member_of(receiver));
            let all = pattern.rays_of(receiver, radius).zip(directions);
            rays.clear();
            rays.extend(all.map(|(ray, &d)| LightRay::new(ray, pattern.solid_angle(d))));
            passed.clear();
            passed.resize(rays.len(), 1.0);
            engine.transmittances(&rays, None, &mut passed, None)?;
            *open = (passed.iter().map(|&x| f64::from(x)).sum::<f64>() / rays.len() as f64) as f32;
        }
        progress.advance(1)?;
        Ok::<_, QueryError>(())
    })?;
    progress.finish()?;
    Ok(())
}
