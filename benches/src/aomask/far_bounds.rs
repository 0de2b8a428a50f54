//! Part `far-bounds`: whether `mask-prefilter` keeps what it states on receivers that its sample did not have, on surfaces and on
//! grounds apart.

use super::{Options, workload::Source};
use crate::{
    rows::{Output, Row, Timed, alternate, median, note, paired_speedup},
    scenes,
};
use anyhow::Result;
use serde_json::json;
use std::time::Instant;
use umbrage_aomask::{Outputs, PatternOptions, Receiver};
use umbrage_geom::{
    Aabb, MeshObject, TriangleMesh,
    glam::Vec3,
    sampling::{RandomStream, combine},
};
use umbrage_query::{AoMethod, Engine, Ground, Occluders, Pilot, Sky, engine};

/// A scene: its generator or file, triangles, opacity of everything but the ground, and whether there is a ground.
type Scene = (&'static str, usize, f32, bool);

const SCENES: [Scene; 14] = [
    ("bush", 100_000, 1.0, false),
    ("bush", 100_000, 1.0, true),
    ("bush", 100_000, 0.6, true),
    ("bush", 100_000, 0.2, true),
    ("hairball", 200_000, 1.0, false),
    ("hairball", 200_000, 1.0, true),
    ("hairball", 200_000, 0.4, true),
    ("tentacles", 100_000, 1.0, true),
    ("bamboo", 200_000, 1.0, true),
    ("city", 100_000, 1.0, false),
    ("cathedral", 120_000, 1.0, false),
    ("sibenik", 0, 1.0, false),
    ("knots", 30_000, 1.0, true),
    ("rocks", 60_000, 1.0, true),
];

/// Of the diagonal.
const RADII: [f32; 2] = [0.1, f32::INFINITY];
const RAYS: [u32; 2] = [64, 256];

/// Receivers of each kind, for the sample and, others, for the measurement.
const RECEIVERS: usize = 4096;

/// Half the ground's side, and the part of it that has receivers, in diagonals of what is on it.
const GROUND: f32 = 20.0;
const NEAR_GROUND: f32 = 0.75;

/// Rows with the mean error and the RMS error of the field against exact masks with the same rays.
pub fn rows(options: &Options, output: &mut Output) -> Result<()> {
    for (name, triangles, opacity, ground) in SCENES {
        if options.only.as_ref().is_some_and(|only| !name.contains(only.as_str())) {
            continue;
        }
        let mut mesh = match (name, Source::find(name, options.quick)) {
            ("sibenik", Some(source)) => source.load()?,
            ("sibenik", None) => continue,
            _ => scenes::generated(name, triangles / if options.quick { 4 } else { 1 })?,
        };
        let veil = if opacity < 1.0 { "-veil" } else { "" };
        let title = format!("{name}{veil}{}", if ground { "-ground" } else { "" });
        note(&format!("preparing {title}"));
        let bounds = mesh.bounds();
        let count = mesh.triangles.len() as u32;
        mesh.objects = vec![MeshObject { name: name.into(), triangles: 0..count, opacity }];
        let count = RECEIVERS / if options.quick { 2 } else { 1 };
        let [sample, asked] = [11, 12].map(|seed| scenes::receivers(&mesh, count, seed));
        let [mut sample, mut asked]: [Places; 2] =
            [sample, asked].map(|r| r.points.into_iter().zip(r.normals).collect());
        let on_mesh = asked.len();
        if ground {
            let y = add_ground(&mut mesh, &bounds);
            sample.extend(ground_receivers(&bounds, y, count, 13));
            asked.extend(ground_receivers(&bounds, y, count, 14));
        }
        let [sample, asked] = [(sample, 1), (asked, 2)].map(|(places, seed)| receivers(&places, seed));
        let scene = Measured {
            title,
            opacity,
            mesh,
            sample: sample?,
            asked: asked?,
            on_mesh,
            diagonal: bounds.diagonal(),
        };
        scene.measure(output)?;
    }
    Ok(())
}

type Places = Vec<(Vec3, Vec3)>;

fn receivers(places: &Places, seed: u32) -> Result<Vec<Receiver>> {
    let receiver = |(i, &(point, normal)): (usize, &(Vec3, Vec3))| {
        Receiver::new(i, point.to_array(), normal.to_array(), combine(seed, i as u32))
    };
    Ok(places.iter().enumerate().map(receiver).collect::<Result<_, _>>()?)
}

/// A ground of two triangles below what has `bounds`; where it lies.
fn add_ground(mesh: &mut TriangleMesh, bounds: &Aabb) -> f32 {
    let (center, diagonal) = (bounds.center(), bounds.diagonal());
    let (base, first) = (mesh.positions.len() as u32, mesh.triangles.len() as u32);
    let (y, half) = (bounds.min.y - 1e-3 * diagonal, GROUND * diagonal);
    let corner = |x: f32, z: f32| [center.x + x * half, y, center.z + z * half];
    mesh.positions.extend([corner(-1.0, -1.0), corner(-1.0, 1.0), corner(1.0, 1.0), corner(1.0, -1.0)]);
    mesh.triangles.extend([[base, base + 1, base + 2], [base, base + 2, base + 3]]);
    mesh.objects.push(MeshObject { name: "ground".into(), triangles: first..first + 2, opacity: 1.0 });
    y
}

fn ground_receivers(bounds: &Aabb, y: f32, count: usize, seed: u32) -> Places {
    let (center, half) = (bounds.center(), NEAR_GROUND * bounds.diagonal());
    let mut random = RandomStream::new(seed, 0);
    let place = |_| {
        let [u, v] = [0; 2].map(|_| (2.0 * random.next_unit() - 1.0) * half);
        (Vec3::new(center.x + u, y + 1e-4 * half, center.z + v), Vec3::Y)
    };
    (0..count).map(place).collect()
}

/// A scene with its receivers: those of the sample, and those that are measured.
struct Measured {
    title: String,
    /// Of what stands on the ground.
    opacity: f32,
    mesh: TriangleMesh,
    sample: Vec<Receiver>,
    asked: Vec<Receiver>,
    /// How many of those asked come first that are not on the ground.
    on_mesh: usize,
    /// Of what stands on the ground.
    diagonal: f32,
}

/// A method under the clock.
struct Run<'a> {
    engine: Box<dyn Engine + 'a>,
    receivers: &'a [Receiver],
    ao: Vec<f32>,
}

impl Timed for Run<'_> {
    fn run(&mut self) {
        let outputs = Outputs::new(&mut self.ao);
        self.engine.sky(self.receivers, outputs, &mut |_| true).expect("valid arguments");
    }
}

impl Measured {
    fn measure(&self, output: &mut Output) -> Result<()> {
        let occluders = Occluders::of_meshes(&[&self.mesh], Ground::Absent, &mut |_| true)?;
        for rays in RAYS {
            for radius in RADII {
                let pattern = PatternOptions::default().with_rays(rays);
                // A sample of very many.
                let pilot = Pilot::new(self.sample.clone(), usize::MAX);
                let sky = Sky::new(pattern, radius * self.diagonal).with_pilot(pilot);
                let run = |method| -> Result<(Run<'_>, f64)> {
                    let start = Instant::now();
                    let engine = engine::sky(method, &occluders, &sky, &mut |_| true)?;
                    let build_s = start.elapsed().as_secs_f64();
                    Ok((Run { engine, receivers: &self.asked, ao: vec![0.0; self.asked.len()] }, build_s))
                };
                let ((mut exact, _), (mut far, build_s)) =
                    (run(AoMethod::Mask)?, run(AoMethod::MaskPrefilter)?);
                let times = alternate(1, &mut [&mut exact as &mut dyn Timed, &mut far]);
                self.rows(&exact.ao, &far.ao, (rays, radius, build_s), &times, output)?;
            }
        }
        Ok(())
    }

    /// One row for receivers on the mesh, one for those on the ground.
    fn rows(
        &self,
        exact: &[f32],
        far: &[f32],
        (rays, radius, build_s): (u32, f32, f64),
        times: &[Vec<f64>],
        output: &mut Output,
    ) -> Result<()> {
        let of_diagonal = if radius.is_finite() { json!(0.1) } else { json!("inf") };
        for (place, range) in [("mesh", 0..self.on_mesh), ("ground", self.on_mesh..self.asked.len())] {
            if range.is_empty() {
                continue;
            }
            let n = range.len() as f64;
            let differences: Vec<f64> = range.map(|i| f64::from(far[i]) - f64::from(exact[i])).collect();
            let mean = differences.iter().sum::<f64>() / n;
            let variance = differences.iter().map(|d| (d - mean).powi(2)).sum::<f64>() / (n - 1.0);
            let time_s = median(&times[1]);
            output.row(&Row {
                suite: "aomask",
                scene: self.title.clone(),
                method: "mask-prefilter".into(),
                params: json!({
                    "part": "far-bounds", "receivers": place, "rays": rays, "radius": of_diagonal,
                    "opacity": (f64::from(self.opacity) * 1e3).round() / 1e3,
                }),
                time_s,
                build_s,
                mrays_s: (self.asked.len() * rays as usize) as f64 / time_s * 1e-6,
                rmse: f64::NAN,
                bias: f64::NAN,
                bytes: 0,
                counters: json!({
                    "receivers": n, "all_exact": exact == far,
                    "mean_difference": mean, "mean_difference_standard_error": (variance / n).sqrt(),
                    "rms_difference": (differences.iter().map(|d| d * d).sum::<f64>() / n).sqrt(),
                }),
                baseline: "mask",
                speedup: paired_speedup(&times[0], &times[1]),
            })?;
        }
        Ok(())
    }
}
