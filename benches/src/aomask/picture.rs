//! Whole images of receivers: what rasterization answers, and its rows.

use super::{Case, camera, measure};
use crate::rows::{Row, median};
use anyhow::{Context, Result};
use serde_json::{Value, json};
use std::{path::Path, time::Instant};
use umbrage_accel::Counters;
use umbrage_aomask::{
    MaskOptions, MaskTables, Outputs, Pattern, RasterCall, RasterLevel, RasterOptions, RasterView, Receiver,
    TableOptions,
};
use umbrage_geom::{glam::Vec3, sampling::combine};

/// Pixels between those whose exact answer is found.
const STRIDE: usize = 29;

/// A view with the receivers behind its pixels.
pub struct Picture {
    pub view: camera::View,
    pub points: Vec<[f32; 3]>,
    pub normals: Vec<[f32; 3]>,
    /// Pixels with a receiver.
    pub seen: usize,
}

/// Answers for a picture and what they took.
pub struct Answer {
    pub ao: Vec<f32>,
    pub masks: Vec<u64>,
    pub times: Vec<f64>,
    pub counters: Counters,
}

impl Picture {
    /// The first view of a scene, at half the paper's size across and down, a quarter in the quick form.
    pub fn new(case: &Case, quick: bool) -> Self {
        let size = if quick { [256, 192] } else { [512, 384] };
        let view = camera::views(case)[0].resized(size);
        let pixels = view.pixels(case);
        let list = |f: fn(&(Vec3, Vec3)) -> Vec3, none: Vec3| {
            pixels.iter().map(|p| p.as_ref().map_or(none, f).to_array()).collect::<Vec<_>>()
        };
        let seen = pixels.iter().flatten().count();
        let (points, normals) = (list(|p| p.0, Vec3::NAN), list(|p| p.1, Vec3::ZERO));
        Self { view, points, normals, seen }
    }

    pub fn rasterize(
        &self,
        case: &Case,
        tables: &MaskTables,
        levels: &[RasterLevel<'_>],
        options: &MaskOptions,
        raster: &RasterOptions,
        passes: usize,
    ) -> Result<Answer> {
        let [width, height] = self.view.size;
        let view = RasterView::new(self.view.raster(), width, height, &self.points, &self.normals);
        let mut answer = Answer {
            ao: vec![0.0; self.points.len()],
            masks: vec![0; self.points.len() * tables.pattern().words()],
            times: Vec::new(),
            counters: Counters::default(),
        };
        for _ in 0..passes {
            let start = Instant::now();
            let outputs = Outputs::new(&mut answer.ao).with_masks(&mut answer.masks);
            let call = RasterCall::new(tables, levels, &view).with_options(*options).with_raster(*raster);
            answer.counters = case.one.install(|| call.run(outputs, &mut |_| true))?;
            answer.times.push(start.elapsed().as_secs_f64());
        }
        Ok(answer)
    }

    /// The receiver of pixel `i` with the jitter that rasterization gives it.
    pub fn receiver(&self, i: usize, options: &MaskOptions) -> Option<Receiver> {
        let seed = combine(options.seed, i as u32);
        Receiver::new(i, self.points[i], self.normals[i], seed).ok()
    }

    /// Exact ambient occlusion of pixel `i` by single rays.
    pub fn exact(&self, case: &Case, pattern: &Pattern, options: &MaskOptions, i: usize) -> Option<f64> {
        let receiver = self.receiver(i, options)?;
        let rays: Vec<_> = pattern.rays_of(&receiver, options.radius).collect();
        let mut hits = vec![false; rays.len()];
        measure::cast(case, &rays, options.sides, &mut hits);
        Some(hits.iter().filter(|&&hit| !hit).count() as f64 / hits.len() as f64)
    }

    /// Differences from exact rays of every [`STRIDE`]-th pixel.
    pub fn differences(&self, case: &Case, pattern: &Pattern, options: &MaskOptions, ao: &[f32]) -> Vec<f64> {
        (0..ao.len())
            .step_by(STRIDE)
            .filter_map(|i| Some(f64::from(ao[i]) - self.exact(case, pattern, options, i)?))
            .collect()
    }

    /// Writes values from 0 (black) to 1 (white).
    pub fn save(&self, folder: &Path, name: &str, values: impl Iterator<Item = f64>) -> Result<()> {
        std::fs::create_dir_all(folder).with_context(|| folder.display().to_string())?;
        let pixels: Vec<u8> = values.map(|v| (v.clamp(0.0, 1.0) * 255.0).round() as u8).collect();
        let path = folder.join(name).with_extension("png");
        let [width, height] = self.view.size;
        image::save_buffer(&path, &pixels, width, height, image::ColorType::L8)
            .with_context(|| path.display().to_string())
    }
}

/// Default tables, filled on one thread.
pub fn tables(case: &Case, pattern: &Pattern) -> Result<MaskTables> {
    Ok(case.one.install(|| MaskTables::new(pattern.clone(), &TableOptions::default()))?)
}

/// The scene itself as a level.
pub fn scene_level(case: &Case) -> RasterLevel<'_> {
    RasterLevel::exact(&case.mesh.positions, &case.mesh.triangles)
}

/// A row of `mask-raster`.
pub fn row(case: &Case, picture: &Picture, pattern: &Pattern, answer: &Answer, params: Value) -> Row {
    let time_s = median(&answer.times);
    let counters = answer.counters;
    Row {
        suite: "aomask",
        scene: case.name.into(),
        method: "mask-raster".into(),
        params,
        time_s,
        build_s: 0.0,
        mrays_s: (picture.seen * pattern.len()) as f64 / time_s * 1e-6,
        rmse: f64::NAN,
        bias: f64::NAN,
        bytes: 0,
        counters: json!({
            "receivers": picture.seen,
            "triangles": case.mesh.triangles.len(),
            "prisms": counters.prisms,
            "billboards": counters.billboards,
            "fragments": counters.fragments,
            "fragments_after": counters.fragments_after,
            "lookups": counters.fragment_masks,
        }),
        baseline: "rays",
        speedup: 0.0,
    }
}

/// A row of `mask-raster` on a whole picture. Its speedup is against the rate of `rays` on every [`STRIDE`]-th receiver of the
/// same image, in turn with it.
pub fn raster_row(
    case: &Case,
    picture: &Picture,
    tables: &MaskTables,
    mask_options: &MaskOptions,
    passes: usize,
    params: Value,
) -> Result<Row> {
    let pattern = tables.pattern();
    let (mut answer, mut ratios) = (None, Vec::new());
    let mut times = Vec::new();
    for _ in 0..passes {
        let raster = RasterOptions::default();
        let done = picture.rasterize(case, tables, &[scene_level(case)], mask_options, &raster, 1)?;
        let ours = (picture.seen * pattern.len()) as f64 / done.times[0];
        ratios.push(ours / measure::rays_per_second(case, picture, pattern, mask_options, STRIDE));
        times.extend(&done.times);
        answer = Some(done);
    }
    let answer = answer.map(|answer| Answer { times, ..answer }).context("at least one pass")?;
    let mut row = row(case, picture, pattern, &answer, params);
    row.speedup = median(&ratios);
    row.bytes = tables.bytes();
    let differences = picture.differences(case, pattern, mask_options, &answer.ao);
    measure::put_differences(&mut row.counters, &differences);
    Ok(row)
}
