//! Part `prefilter`: masks near, prefiltered opacity far, on foliage and hair, against exact masks.

use super::{Case, Options, passes, workload};
use crate::rows::{Output, Row, Timed, alternate, median, paired_speedup};
use anyhow::Result;
use serde_json::json;
use umbrage_aomask::{
    BackEnd, MaskOptions, Outputs, Pattern, PatternOptions, Receiver, coarse, coarse::FarField, exact,
};
use umbrage_geom::{Ray, sampling::combine};
use umbrage_occlusion::prefilter::{ConeRay, PrefilterOptions, Prefiltered, Query};

/// Scenes of loose geometry.
const SCENES: [&str; 2] = ["bush", "hairball"];

/// Of the diagonal.
const RADIUS: f64 = 0.1;

/// Up to where rays are exact, in radii, and thresholds of prefiltered nodes.
const SETTINGS: [(f64, f32); 6] =
    [(0.001, 0.3), (0.03, 0.3), (0.1, 0.3), (0.001, 0.05), (0.03, 0.05), (0.1, 0.05)];

/// Patterns of 1024 rays whose mean is the truth.
const TRUTH: u32 = 8;

struct Far<'a> {
    scene: &'a Prefiltered,
    query: Query,
}

impl FarField for Far<'_> {
    fn transmittances(&self, rays: &[Ray], solid_angles: &[f32], passed: &mut [f32]) {
        let cones: Vec<ConeRay> =
            rays.iter().zip(solid_angles).map(|(&ray, &solid_angle)| ConeRay { ray, solid_angle }).collect();
        self.scene.transmittances_with(&cones, &self.query, passed, &mut ());
    }
}

/// A setting, or exact masks, and its answers.
struct Run<'a> {
    case: &'a Case,
    pattern: &'a Pattern,
    receivers: &'a [Receiver],
    options: &'a MaskOptions,
    far: Option<(Far<'a>, f32)>,
    ao: Vec<f32>,
}

impl Timed for Run<'_> {
    fn run(&mut self) {
        let Self { case, pattern, receivers, options, far, ao } = self;
        let (bvh, best, outputs) = (case.ours.bvh(), BackEnd::best(), Outputs::new(ao));
        case.one
            .install(|| match far {
                None => {
                    exact::answer_receivers(bvh, pattern, receivers, options, best, outputs, &mut |_| true)
                }
                Some((far, near)) => coarse::answer_receivers(
                    bvh,
                    far,
                    *near,
                    pattern,
                    receivers,
                    options,
                    best,
                    outputs,
                    &mut |_| true,
                ),
            })
            .expect("valid arguments");
    }
}

/// Rows with error against the truth.
pub fn rows(case: &Case, options: &Options, output: &mut Output) -> Result<()> {
    if !SCENES.contains(&case.name) {
        return Ok(());
    }
    let scene = Prefiltered::build(
        &case.mesh.positions,
        &case.mesh.triangles,
        &[1.0],
        &PrefilterOptions::default(),
        &mut |_| true,
    )?;
    let radius = (RADIUS * f64::from(case.mesh.bounds().diagonal())) as f32;
    for rays in [128, 1024] {
        let points = workload::surface(&case.mesh, rays, options.quick);
        let receiver = |i: usize| {
            let (point, normal) = (points.points[i].to_array(), points.normals[i].to_array());
            Receiver::new(i, point, normal, combine(0, i as u32))
        };
        let receivers: Vec<Receiver> = (0..points.points.len()).map(receiver).collect::<Result<_, _>>()?;
        let mask_options = MaskOptions::default().with_radius(radius);
        let truth = truth(case, &receivers, &mask_options)?;
        let pattern = Pattern::new(&PatternOptions::default().with_rays(rays))?;
        let run = |far| Run {
            case,
            pattern: &pattern,
            receivers: &receivers,
            options: &mask_options,
            far,
            ao: vec![0.0; receivers.len()],
        };
        let mut runs = vec![run(None)];
        for (near, threshold) in SETTINGS {
            let far = Far { scene: &scene, query: Query::new(threshold)? };
            runs.push(run(Some((far, (near * f64::from(radius)) as f32))));
        }
        let mut timed: Vec<&mut dyn Timed> = runs.iter_mut().map(|run| run as &mut dyn Timed).collect();
        let times = alternate(passes(options), &mut timed);
        let settings = std::iter::once(None).chain(SETTINGS.map(Some));
        for ((run, own), setting) in runs.iter().zip(&times).zip(settings) {
            let errors: Vec<f64> =
                run.ao.iter().zip(&truth).map(|(&ao, truth)| f64::from(ao) - truth).collect();
            let mean = |f: fn(f64) -> f64| errors.iter().map(|&e| f(e)).sum::<f64>() / errors.len() as f64;
            let time_s = median(own);
            let mut params = json!({ "part": "prefilter", "rays": rays, "radius": RADIUS });
            if let Some((near, threshold)) = setting {
                params["near"] = json!(near);
                params["threshold"] = json!((f64::from(threshold) * 1e3).round() / 1e3);
            }
            output.row(&Row {
                suite: "aomask",
                scene: case.name.into(),
                method: if setting.is_none() { "mask" } else { "mask-prefilter" }.into(),
                params,
                time_s,
                build_s: case.ours.build_s,
                mrays_s: (receivers.len() * pattern.len()) as f64 / time_s * 1e-6,
                rmse: mean(|e| e * e).sqrt(),
                bias: mean(|e| e),
                bytes: scene.bytes().opacities,
                counters: json!({ "receivers": receivers.len() }),
                baseline: "mask",
                speedup: paired_speedup(&times[0], own),
            })?;
        }
    }
    Ok(())
}

fn truth(case: &Case, receivers: &[Receiver], options: &MaskOptions) -> Result<Vec<f64>> {
    let mut sums = vec![0.0; receivers.len()];
    for seed in 1..=TRUTH {
        let pattern = PatternOptions::default().with_rays(1024).with_jitter(1.0, 0.2).with_seed(seed);
        let (pattern, mut ao) = (Pattern::new(&pattern)?, vec![0.0; receivers.len()]);
        let (bvh, best, outputs) = (case.ours.bvh(), BackEnd::best(), Outputs::new(&mut ao));
        exact::answer_receivers(bvh, &pattern, receivers, options, best, outputs, &mut |_| true)?;
        sums.iter_mut().zip(ao).for_each(|(sum, ao)| *sum += f64::from(ao) / f64::from(TRUTH));
    }
    Ok(sums)
}
