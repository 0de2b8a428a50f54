//! Part `bits`: masks of many receivers against single rays, bit by bit, on every back end.

use super::{Case, Options, TARGET_RADII, TARGET_RAYS, methods::bits, workload};
use crate::rows::{Output, Row};
use anyhow::Result;
use serde_json::json;
use std::time::Instant;
use umbrage_aomask::{BackEnd, MaskCall, Outputs, Pattern, PatternOptions, Receiver};
use workload::Workload;

/// Rays of each number of rays and radius: over all scenes more than 10^8.
const RAYS: usize = 7 << 18;

/// Rows with the number of bits in which `mask` differs from `Bvh::any_hits`.
pub fn rows(case: &Case, options: &Options, output: &mut Output) -> Result<()> {
    let diagonal = f64::from(case.mesh.bounds().diagonal());
    for rays in TARGET_RAYS {
        let pattern = Pattern::new(&PatternOptions::default().with_rays(rays))?;
        for radius in TARGET_RADII {
            let count = if options.quick { RAYS / 16 } else { RAYS } / rays as usize;
            let points = workload::surface_of(&case.mesh, count);
            let params = json!({ "part": "bits", "rays": rays, "radius": radius });
            let workload = Workload::new(points, &pattern, (radius * diagonal) as f32, params);
            let mut hits = vec![false; workload.rays.len()];
            let start = Instant::now();
            let bvh = case.ours.bvh();
            case.one.install(|| bvh.any_hits(&workload.rays, &mut hits));
            let rays_s = start.elapsed().as_secs_f64();
            for back_end in BackEnd::ALL.into_iter().filter(|b| b.is_supported()) {
                output.row(&row(case, &workload, &hits, rays_s, back_end)?)?;
            }
        }
    }
    Ok(())
}

fn row(case: &Case, workload: &Workload, hits: &[bool], rays_s: f64, back_end: BackEnd) -> Result<Row> {
    let Workload { points, normals, pattern, options, .. } = workload;
    let (mut ao, mut masks) = (vec![0.0; points.len()], vec![0; points.len() * pattern.words()]);
    let bvh = case.ours.bvh();
    let start = Instant::now();
    case.one.install(|| {
        let outputs = Outputs::new(&mut ao).with_masks(&mut masks);
        let receivers = Receiver::from_slices(points, normals, options.seed)?;
        let call = MaskCall::new(bvh, pattern, &receivers, options).with_back_end(back_end);
        call.answer(outputs, &mut |_| true)
    })?;
    let time_s = start.elapsed().as_secs_f64();
    let answers = bits(&masks, pattern.words(), pattern.len());
    let different = answers.iter().zip(hits).filter(|(a, b)| a != b).count();
    let mut params = workload.params.clone();
    params["mode"] = json!(format!("{back_end:?}").to_lowercase());
    Ok(Row {
        suite: "aomask",
        scene: case.name.into(),
        method: "mask".into(),
        params,
        time_s,
        build_s: case.ours.build_s,
        mrays_s: hits.len() as f64 / time_s * 1e-6,
        rmse: 0.0,
        bias: 0.0,
        bytes: case.ours.bvh().bytes(),
        counters: json!({ "bits": hits.len(), "different_bits": different }),
        baseline: "rays",
        speedup: rays_s / time_s,
    })
}
