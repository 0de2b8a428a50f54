//! Table 2 and figures 5, 6 and 7 of `[Laine10]`, on our scenes.

use super::{
    Case, Options, SIDES, TABLE1, measure,
    picture::{self, Picture},
    picture_passes, table_pattern,
    workload::{self, Workload},
};
use crate::{
    plot::{self, Series},
    rows::{Output, Row, median},
};
use anyhow::Result;
use serde_json::{Value, json};
use std::time::Instant;
use umbrage_aomask::{MaskOptions, Outputs, RasterOptions, Receiver, Sides, raster::simplified_levels};

/// A part of the suite.
type Part = fn(&Case, &Options, &mut Output) -> Result<()>;

/// Parts by name.
pub const PARTS: [(&str, Part); 4] =
    [("table2", table2), ("figure5", figure5), ("figure6", figure6), ("figure7", figure7)];

/// Tests of table 2, with the paper's relative numbers of fragments and performance at both radii.
const TABLE2: [(&str, [[f64; 2]; 2]); 6] = [
    ("depth test only", [[7.06, 0.30], [5.79, 0.30]]),
    ("+ 1. far depth", [[3.78, 0.47], [3.90, 0.40]]),
    ("+ 2. bounding sphere", [[3.22, 0.52], [3.11, 0.47]]),
    ("+ 3. triangle facing", [[2.11, 0.73], [1.95, 0.70]]),
    ("+ 4. plane distance", [[2.03, 0.74], [1.92, 0.70]]),
    ("+ 5. hemisphere facing", [[1.00, 1.00], [1.00, 1.00]]),
];

/// The radii of table 1 in world units, with what rows call them.
fn radii(case: &Case) -> Option<[(f64, f32); 2]> {
    let table = TABLE1.iter().find(|table| table.scene == case.name)?;
    let unit = if case.name == "sibenik" { 1.0 } else { f64::from(case.mesh.bounds().diagonal()) };
    Some(table.radii.map(|radius| (radius, (radius * unit) as f32)))
}

/// Culling tests switched on one after the other, sibenik, one-sided, 128 rays.
fn table2(case: &Case, options: &Options, output: &mut Output) -> Result<()> {
    if case.name != "sibenik" {
        return Ok(());
    }
    let pattern = table_pattern(128)?;
    let tables = picture::tables(case, &pattern)?;
    let picture = Picture::new(case, options.quick);
    for (which, (name, radius)) in radii(case).into_iter().flatten().enumerate() {
        let mask_options = MaskOptions::default().with_radius(radius).with_sides(Sides::Front);
        let mut answers = Vec::new();
        for tests in 0..=5 {
            let raster = RasterOptions::default().with_culling_tests(tests);
            let levels = [picture::scene_level(case)];
            answers.push(picture.rasterize(
                case,
                &tables,
                &levels,
                &mask_options,
                &raster,
                picture_passes(options),
            )?);
        }
        let all = &answers[5];
        for (answer, (tests, paper)) in answers.iter().zip(TABLE2) {
            let params =
                json!({ "part": "table2", "rays": 128, "radius": name, "sides": "front", "tests": tests });
            let mut row = picture::row(case, &picture, &pattern, answer, params);
            let different = answer.masks.iter().zip(&all.masks).filter(|(a, b)| a != b).count();
            row.counters["different_words"] = json!(different);
            row.counters["fragments_relative"] =
                json!(answer.counters.lookups as f64 / all.counters.lookups as f64);
            row.speedup = median(&all.times) / median(&answer.times);
            row.baseline = "all-tests";
            row.counters["paper_fragments_relative"] = json!(paper[which][0]);
            row.counters["paper_performance_relative"] = json!(paper[which][1]);
            output.row(&row)?;
        }
    }
    Ok(())
}

/// Agreement with exact rays after quantisation to 8 bits, as pictures and histograms: city, larger radius, 1024 rays.
fn figure5(case: &Case, options: &Options, output: &mut Output) -> Result<()> {
    if case.name != "city" {
        return Ok(());
    }
    let Some([_, (name, radius)]) = radii(case) else { return Ok(()) };
    let pattern = table_pattern(1024)?;
    let tables = picture::tables(case, &pattern)?;
    let picture = Picture::new(case, options.quick);
    let scene = picture::scene_level(case);
    let coarse = coarse_levels(case)?;
    let mut levels = vec![scene];
    levels.extend(coarse.iter().map(|level| level.level(&case.mesh.positions)));
    for (sides, side_name) in SIDES {
        let mask_options = MaskOptions::default().with_radius(radius).with_sides(sides);
        let exact: Vec<Option<f64>> =
            (0..picture.points.len()).map(|i| picture.exact(case, &pattern, &mask_options, i)).collect();
        let raster = RasterOptions::default();
        let rasterized = picture.rasterize(case, &tables, &[scene], &mask_options, &raster, 1)?;
        let with_levels = picture.rasterize(case, &tables, &levels, &mask_options, &raster, 1)?;
        let walked = walk(case, &picture, &tables, &mask_options)?;
        if let Some(folder) = &options.images {
            let file = format!("figure5-{side_name}-rays");
            picture.save(folder, &file, exact.iter().map(|ao| ao.unwrap_or(1.0)))?;
        }
        for (method, mode, ao, time_s) in [
            ("mask-table", "walk", &walked.0, walked.1),
            ("mask-raster", "scene", &rasterized.ao, rasterized.times[0]),
            ("mask-raster", "levels", &with_levels.ao, with_levels.times[0]),
        ] {
            let params = json!({
                "part": "figure5", "rays": 1024, "radius": name, "sides": side_name, "mode": mode,
            });
            let mut row = picture::row(case, &picture, &pattern, &rasterized, params);
            (row.method, row.time_s) = (method.into(), time_s);
            row.mrays_s = (picture.seen * pattern.len()) as f64 / time_s * 1e-6;
            row.counters = agreement(ao, &exact);
            output.row(&row)?;
            if let Some(folder) = &options.images {
                let file = format!("figure5-{side_name}-{method}-{mode}");
                picture.save(folder, &file, ao.iter().map(|&ao| f64::from(ao)))?;
                // White where they agree, black from a difference of 1/16.
                let difference = ao.iter().zip(&exact).map(|(&ao, exact)| {
                    exact.map_or(1.0, |exact| 1.0 - 16.0 * (f64::from(ao) - exact).abs())
                });
                picture.save(folder, &format!("{file}-difference"), difference)?;
            }
        }
    }
    Ok(())
}

/// How far the values of a picture are from those of exact rays.
fn agreement(ao: &[f32], exact: &[Option<f64>]) -> Value {
    let pairs: Vec<(f64, f64)> =
        ao.iter().zip(exact).filter_map(|(&ao, exact)| Some((f64::from(ao), (*exact)?))).collect();
    let differences: Vec<f64> = pairs.iter().map(|(ao, exact)| ao - exact).collect();
    let mut counters = json!({});
    measure::put_differences(&mut counters, &differences);
    // Differences in steps of 8 bits, from -8 to 8, what is beyond in the last ones.
    let mut histogram = [0u32; 17];
    for (ao, exact) in &pairs {
        let step = (ao * 255.0).round() - (exact * 255.0).round();
        histogram[(step.clamp(-8.0, 8.0) + 8.0) as usize] += 1;
    }
    counters["histogram"] = json!(histogram);
    counters["as_rays_after_quantisation"] = json!(f64::from(histogram[8]) / pairs.len().max(1) as f64);
    counters
}

/// `mask-table` on the receivers of a picture: values by pixel, and the time.
fn walk(
    case: &Case,
    picture: &Picture,
    tables: &umbrage_aomask::MaskTables,
    options: &MaskOptions,
) -> Result<(Vec<f32>, f64)> {
    // The jitter of each pixel, so that the rays are those of the other methods.
    let (pixels, receivers): (Vec<usize>, Vec<Receiver>) =
        (0..picture.points.len()).filter_map(|i| Some((i, picture.receiver(i, options)?))).unzip();
    let mut ao = vec![0.0; pixels.len()];
    let bvh = case.ours.bvh();
    let start = Instant::now();
    case.one.install(|| {
        tables.answer_receivers(bvh, &receivers, options, Outputs::new(&mut ao), &mut |_| true)
    })?;
    let time_s = start.elapsed().as_secs_f64();
    let mut all = vec![1.0; picture.points.len()];
    pixels.iter().zip(ao).for_each(|(&i, ao)| all[i] = ao);
    Ok((all, time_s))
}

/// Seconds that rasterization of a picture may have taken at one radius for the next one to be tried.
const MAX_PICTURE_SECONDS: f64 = 60.0;

/// Time of a picture against the radius, 128 rays: rasterization draws the picture, all others answer runs of neighbours among
/// its receivers, and times are those of as many rays as the picture has.
fn figure6(case: &Case, options: &Options, output: &mut Output) -> Result<()> {
    if radii(case).is_none() {
        return Ok(());
    }
    let pattern = table_pattern(128)?;
    let tables = picture::tables(case, &pattern)?;
    let picture = Picture::new(case, options.quick);
    let diagonal = f64::from(case.mesh.bounds().diagonal());
    let radii: &[f64] =
        if options.quick { &[0.005, 0.02, 0.08] } else { &[0.0025, 0.005, 0.01, 0.02, 0.04, 0.08] };
    let all_rays = (picture.seen * pattern.len()) as f64;
    for (sides, side_name) in SIDES {
        let mut series: Vec<Series> = Vec::new();
        let mut raster_s = 0.0;
        for &radius in radii {
            let length = (radius * diagonal) as f32;
            let params = json!({ "part": "figure6", "rays": 128, "radius": radius, "sides": side_name });
            let points = workload::seen(case, &[picture.view], 128, options.quick);
            let workload = Workload::new(points, &pattern, length, params.clone()).with_sides(sides);
            let picture_s = |row: &Row| all_rays / (row.mrays_s * 1e6);
            let extra = |row: &Row| json!({ "picture_s": picture_s(row) });
            let mut rows = measure::rows(case, &workload, super::passes(options), output, extra)?;
            if raster_s <= MAX_PICTURE_SECONDS {
                let mut row = picture::raster_row(case, &picture, &tables, &workload.options, 1, params)?;
                raster_s = row.time_s;
                row.counters["picture_s"] = json!(raster_s);
                output.row(&row)?;
                rows.push(row);
            }
            for row in &rows {
                let point = [100.0 * radius, 1e3 * picture_s(row)];
                match series.iter_mut().find(|series| series.name == row.method) {
                    Some(series) => series.points.push(point),
                    None => series.push(Series {
                        name: row.method.clone(),
                        points: vec![point],
                        filled: row.method.starts_with("mask"),
                    }),
                }
            }
        }
        if let Some(folder) = &options.plots {
            let [width, height] = picture.view.size;
            let title = format!("{}, {width} x {height} pixels, 128 rays, sides: {side_name}", case.name);
            let labels = ["radius, % of the diagonal", "milliseconds a picture"];
            let file = format!("aomask-figure6-{}-{side_name}.svg", case.name);
            plot::save(folder, &file, &title, labels, &series)?;
        }
    }
    Ok(())
}

/// Simplified meshes: the first error a thousandth of the diagonal, three levels.
fn coarse_levels(case: &Case) -> Result<Vec<umbrage_aomask::raster::SimplifiedLevel>> {
    let error = case.mesh.bounds().diagonal() * 1e-3;
    Ok(simplified_levels(&case.mesh.positions, &case.mesh.triangles, error, 3)?)
}

/// Levels of detail against the scene's own geometry, larger radius, 128 rays.
fn figure7(case: &Case, options: &Options, output: &mut Output) -> Result<()> {
    let Some([_, (name, radius)]) = radii(case) else { return Ok(()) };
    let pattern = table_pattern(128)?;
    let tables = picture::tables(case, &pattern)?;
    let picture = Picture::new(case, options.quick);
    let scene = picture::scene_level(case);
    let start = Instant::now();
    let coarse = coarse_levels(case)?;
    let levels_s = start.elapsed().as_secs_f64();
    let mut levels = vec![scene];
    levels.extend(coarse.iter().map(|level| level.level(&case.mesh.positions)));
    let raster = RasterOptions::default();
    let passes = picture_passes(options);
    for (sides, side_name) in SIDES {
        let mask_options = MaskOptions::default().with_radius(radius).with_sides(sides);
        let whole = picture.rasterize(case, &tables, &levels[..1], &mask_options, &raster, passes)?;
        let detailed = picture.rasterize(case, &tables, &levels, &mask_options, &raster, passes)?;
        for (mode, answer, build_s) in [("scene", &whole, 0.0), ("levels", &detailed, levels_s)] {
            let params = json!({
                "part": "figure7", "rays": 128, "radius": name, "sides": side_name, "mode": mode,
            });
            let mut row = picture::row(case, &picture, &pattern, answer, params);
            let differences = picture.differences(case, &pattern, &mask_options, &answer.ao);
            measure::put_differences(&mut row.counters, &differences);
            row.build_s = build_s;
            row.baseline = "scene";
            row.speedup = median(&whole.times) / median(&answer.times);
            let counts = coarse.iter().map(|level| level.triangles.len()).collect::<Vec<_>>();
            row.counters["level_triangles"] = json!(counts);
            row.counters["level_errors"] = json!(coarse.iter().map(|level| level.error).collect::<Vec<_>>());
            output.row(&row)?;
            if let Some(folder) = &options.images {
                let file = format!("figure7-{side_name}-{}-{mode}", case.name);
                picture.save(folder, &file, answer.ao.iter().map(|&ao| f64::from(ao)))?;
            }
        }
    }
    Ok(())
}
