//! Part `prefilter`: masks near, stored opacity far, on foliage and hair, against exact masks.
//!
//! Two kinds of stored opacity: prefiltered nodes that cones find in the hierarchy, and the field that they march through.

use super::{Case, Options, passes, workload};
use crate::rows::{Output, Row, Timed, alternate, median, paired_speedup};
use anyhow::Result;
use serde_json::json;
use std::time::Instant;
use umbrage_aomask::{
    BackEnd, MaskOptions, Outputs, Pattern, PatternOptions, Receiver,
    coarse::{
        self, Cones, FarField,
        field::{FieldCones, FieldOptions, MarchOptions, OpacityField},
    },
    exact,
};
use umbrage_geom::{Falloff, glam::Vec3};
use umbrage_occlusion::prefilter::{ConeRay, PrefilterOptions, Prefiltered, Query};
use umbrage_reference::Question;

/// Scenes of loose geometry.
const SCENES: [&str; 2] = ["bush", "hairball"];

/// Of the diagonal.
const RADIUS: f64 = 0.1;

/// What answers, up to where rays are exact in radii, and the knob of the far part.
#[derive(Clone, Copy)]
enum Setting {
    Exact,
    /// Prefiltered nodes up to a threshold.
    Nodes(f64, f32),
    /// So many cones through the field.
    Field(f64, usize),
}

impl Setting {
    /// Its name in rows. `mask-prefilter`, which chooses how far masks are exact, is measured by the parts `truth` and `far-bounds`.
    fn name(self) -> &'static str {
        match self {
            Self::Exact => "mask",
            Self::Nodes(..) => "mask+nodes",
            Self::Field(..) => "mask+field",
        }
    }
}

const SETTINGS: [Setting; 10] = [
    Setting::Exact,
    Setting::Nodes(0.001, 0.3),
    Setting::Nodes(0.1, 0.3),
    Setting::Nodes(0.1, 0.05),
    Setting::Field(0.05, 128),
    Setting::Field(0.07, 128),
    Setting::Field(0.1, 64),
    Setting::Field(0.1, 128),
    Setting::Field(0.15, 128),
    Setting::Field(0.2, 256),
];

/// Random rays of the reference for each receiver.
const REFERENCE_RAYS: u32 = 8192;

/// Prefiltered nodes beyond a distance.
struct Nodes<'a> {
    scene: &'a Prefiltered,
    query: Query,
    near: f32,
}

impl FarField for Nodes<'_> {
    fn near(&self) -> f32 {
        self.near
    }

    fn bundle(&self) -> usize {
        1
    }

    fn transmittances(&self, cones: &Cones, passed: &mut [f32]) {
        let cones: Vec<ConeRay> =
            cones.rays(self.near).map(|(ray, solid_angle)| ConeRay { ray, solid_angle }).collect();
        self.scene.transmittances_with(&cones, &self.query, passed, &mut ());
    }
}

enum Far<'a> {
    None,
    Nodes(Nodes<'a>),
    Field(FieldCones<'a>),
}

/// A setting and its answers.
struct Run<'a> {
    case: &'a Case,
    pattern: &'a Pattern,
    receivers: &'a [Receiver],
    options: &'a MaskOptions,
    far: Far<'a>,
    ao: Vec<f32>,
}

impl Timed for Run<'_> {
    fn run(&mut self) {
        let Self { case, pattern, receivers, options, far, ao } = self;
        let (bvh, best, outputs) = (case.ours.bvh(), BackEnd::best(), Outputs::new(ao));
        let silent = &mut |_| true;
        case.one
            .install(|| match far {
                Far::None => exact::answer_receivers(bvh, pattern, receivers, options, best, outputs, silent),
                Far::Nodes(far) => {
                    coarse::answer_receivers(bvh, far, pattern, receivers, options, best, outputs, silent)
                }
                Far::Field(far) => {
                    coarse::answer_receivers(bvh, far, pattern, receivers, options, best, outputs, silent)
                }
            })
            .expect("valid arguments");
    }
}

/// Both kinds of stored opacity and how long they took.
struct Stored {
    nodes: Prefiltered,
    nodes_s: f64,
    field: OpacityField,
    field_s: f64,
}

impl Stored {
    fn build(case: &Case) -> Result<Self> {
        let (positions, triangles) = (&case.mesh.positions, &case.mesh.triangles);
        case.one.install(|| {
            let start = Instant::now();
            let options = PrefilterOptions::default();
            let nodes = Prefiltered::build(positions, triangles, &[1.0], &options, &mut |_| true)?;
            let nodes_s = start.elapsed().as_secs_f64();
            let start = Instant::now();
            let field = OpacityField::build(positions, triangles, &FieldOptions::default(), &mut |_| true)?;
            Ok(Self { nodes, nodes_s, field, field_s: start.elapsed().as_secs_f64() })
        })
    }

    fn far(&self, setting: Setting, rays: u32, radius: f32) -> Result<Far<'_>> {
        let near = |near: f64| (near * f64::from(radius)) as f32;
        Ok(match setting {
            Setting::Exact => Far::None,
            Setting::Nodes(share, threshold) => {
                Far::Nodes(Nodes { scene: &self.nodes, query: Query::new(threshold)?, near: near(share) })
            }
            Setting::Field(share, cones) => {
                let (near, march) = (near(share), MarchOptions::default().with_cones(cones));
                let best = BackEnd::best();
                Far::Field(FieldCones::new(&self.field, rays as usize, near, radius, &march, best)?)
            }
        })
    }
}

/// Rows with errors against the reference.
pub fn rows(case: &Case, options: &Options, output: &mut Output) -> Result<()> {
    if !SCENES.contains(&case.name) {
        return Ok(());
    }
    let stored = Stored::build(case)?;
    let radius = (RADIUS * f64::from(case.mesh.bounds().diagonal())) as f32;
    for rays in [128, 256, 1024] {
        let points = workload::surface(&case.mesh, rays, options.quick);
        let receiver = |i: usize| {
            let (point, normal) = (points.points[i].to_array(), points.normals[i].to_array());
            Receiver::new(i, point, normal, Receiver::seed_of(point, normal, 0))
        };
        let receivers: Vec<Receiver> = (0..points.points.len()).map(receiver).collect::<Result<_, _>>()?;
        let mask_options = MaskOptions::default().with_radius(radius);
        let list = |v: &[Vec3]| v.iter().map(Vec3::to_array).collect::<Vec<_>>();
        let question = Question {
            mesh: &case.mesh,
            depths: &[],
            points: &list(&points.points),
            normals: &list(&points.normals),
            radius,
            falloff: &Falloff::Constant,
        };
        let reference = question.cached(REFERENCE_RAYS, 1)?;
        let pattern = Pattern::new(&PatternOptions::default().with_rays(rays))?;
        let run = |setting| -> Result<Run<'_>> {
            let far = stored.far(setting, rays, radius)?;
            let (receivers, options) = (&receivers[..], &mask_options);
            Ok(Run { case, pattern: &pattern, receivers, options, far, ao: vec![0.0; receivers.len()] })
        };
        let mut runs = SETTINGS.map(run).into_iter().collect::<Result<Vec<_>>>()?;
        let mut timed: Vec<&mut dyn Timed> = runs.iter_mut().map(|run| run as &mut dyn Timed).collect();
        let times = alternate(passes(options), &mut timed);
        for ((run, own), setting) in runs.iter().zip(&times).zip(SETTINGS) {
            let ao = || run.ao.iter().map(|&x| f64::from(x));
            let (rmse, bias) = (reference.rmse(ao()), reference.bias(ao()));
            let time_s = median(own);
            let mut params = json!({ "part": "prefilter", "rays": rays, "radius": RADIUS });
            let (extra_s, bytes) = match setting {
                Setting::Exact => (0.0, 0),
                Setting::Nodes(near, threshold) => {
                    params["near"] = json!(near);
                    params["threshold"] = json!((f64::from(threshold) * 1e3).round() / 1e3);
                    (stored.nodes_s, stored.nodes.bytes().opacities)
                }
                Setting::Field(near, cones) => {
                    params["near"] = json!(near);
                    params["cones"] = json!(cones);
                    (stored.field_s, stored.field.bytes())
                }
            };
            output.row(&Row {
                suite: "aomask",
                scene: case.name.into(),
                method: setting.name().into(),
                params,
                time_s,
                build_s: case.ours.build_s + extra_s,
                mrays_s: (receivers.len() * pattern.len()) as f64 / time_s * 1e-6,
                rmse,
                bias,
                bytes,
                counters: json!({
                    "receivers": receivers.len(),
                    "reference_standard_error": reference.standard_error(),
                    "reference_standard_error_of_mean": reference.standard_error_of_mean(),
                }),
                baseline: "mask",
                speedup: paired_speedup(&times[0], own),
            })?;
        }
    }
    Ok(())
}
