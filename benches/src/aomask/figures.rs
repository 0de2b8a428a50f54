//! Table 2 and figures 5, 6 and 7 of `[Laine10]`, on our scenes.

use super::{
    Case, Options, TABLE1, measure,
    picture::{self, Picture},
    picture_passes,
};
use crate::rows::{Output, Row, median};
use anyhow::Result;
use serde_json::json;
use std::time::Instant;
use umbrage_aomask::{
    MaskOptions, Outputs, Pattern, PatternOptions, RasterOptions, Receiver, Sides, raster::simplified_levels,
};

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

fn pattern(rays: u32) -> Result<Pattern> {
    Ok(Pattern::new(&PatternOptions::default().with_rays(rays))?)
}

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
    let pattern = pattern(128)?;
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
            let params = json!({ "part": "table2", "rays": 128, "radius": name, "tests": tests });
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

/// Errors against exact rays after quantisation to 8 bits, as pictures and histograms: city, larger radius, 1024 rays.
fn figure5(case: &Case, options: &Options, output: &mut Output) -> Result<()> {
    if case.name != "city" {
        return Ok(());
    }
    let Some([_, (name, radius)]) = radii(case) else { return Ok(()) };
    let pattern = pattern(1024)?;
    let tables = picture::tables(case, &pattern)?;
    let picture = Picture::new(case, options.quick);
    let mask_options = MaskOptions::default().with_radius(radius);
    let exact: Vec<Option<f64>> =
        (0..picture.points.len()).map(|i| picture.exact(case, &pattern, &mask_options, i)).collect();
    let scene = picture::scene_level(case);
    let coarse = coarse_levels(case)?;
    let raster = RasterOptions::default();
    let rasterized = picture.rasterize(case, &tables, &[scene], &mask_options, &raster, 1)?;
    let mut levels = vec![scene];
    levels.extend(coarse.iter().map(|level| level.level(&case.mesh.positions)));
    let with_levels = picture.rasterize(case, &tables, &levels, &mask_options, &raster, 1)?;
    let walked = walk(case, &picture, &tables, &mask_options)?;
    if let Some(folder) = &options.images {
        picture.save(folder, "figure5-rays", exact.iter().map(|ao| ao.unwrap_or(1.0)))?;
    }
    for (method, mode, ao, time_s) in [
        ("mask-table", "walk", &walked.0, walked.1),
        ("mask-raster", "scene", &rasterized.ao, rasterized.times[0]),
        ("mask-raster", "levels", &with_levels.ao, with_levels.times[0]),
    ] {
        let params = json!({ "part": "figure5", "rays": 1024, "radius": name, "mode": mode });
        let mut row = picture::row(case, &picture, &pattern, &rasterized, params);
        (row.method, row.time_s) = (method.into(), time_s);
        row.mrays_s = (picture.seen * pattern.len()) as f64 / time_s * 1e-6;
        let pairs: Vec<(f64, f64)> =
            ao.iter().zip(&exact).filter_map(|(&ao, exact)| Some((f64::from(ao), (*exact)?))).collect();
        let errors: Vec<f64> = pairs.iter().map(|(ao, exact)| ao - exact).collect();
        row.counters = json!({});
        picture::put_errors(&mut row, &errors);
        // Differences in steps of 8 bits, from -8 to 8, what is beyond in the last ones.
        let mut histogram = [0u32; 17];
        for (ao, exact) in &pairs {
            let step = (ao * 255.0).round() - (exact * 255.0).round();
            histogram[(step.clamp(-8.0, 8.0) + 8.0) as usize] += 1;
        }
        row.counters["histogram"] = json!(histogram);
        row.counters["exact_after_quantisation"] = json!(f64::from(histogram[8]) / pairs.len().max(1) as f64);
        row.baseline = "rays";
        output.row(&row)?;
        if let Some(folder) = &options.images {
            let file = format!("figure5-{method}-{mode}");
            picture.save(folder, &file, ao.iter().map(|&ao| f64::from(ao)))?;
            // White where right, black from an error of 1/16.
            let error = ao
                .iter()
                .zip(&exact)
                .map(|(&ao, exact)| exact.map_or(1.0, |exact| 1.0 - 16.0 * (f64::from(ao) - exact).abs()));
            picture.save(folder, &format!("{file}-error"), error)?;
        }
    }
    Ok(())
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

/// Time of an image against the radius, 128 rays.
fn figure6(case: &Case, options: &Options, output: &mut Output) -> Result<()> {
    if radii(case).is_none() {
        return Ok(());
    }
    let pattern = pattern(128)?;
    let tables = picture::tables(case, &pattern)?;
    let picture = Picture::new(case, options.quick);
    let diagonal = f64::from(case.mesh.bounds().diagonal());
    let radii: &[f64] =
        if options.quick { &[0.005, 0.02, 0.08] } else { &[0.0025, 0.005, 0.01, 0.02, 0.04, 0.08] };
    for &radius in radii {
        let mask_options = MaskOptions::default().with_radius((radius * diagonal) as f32);
        let rays_s = measure::rays_per_second(case, &picture, &pattern, &mask_options, 7);
        let all_rays = (picture.seen * pattern.len()) as f64;
        let walked = walk(case, &picture, &tables, &mask_options)?.1;
        let raster = RasterOptions::default();
        let levels = [picture::scene_level(case)];
        let rasterized = picture.rasterize(case, &tables, &levels, &mask_options, &raster, 1)?;
        for (method, time_s) in
            [("rays", all_rays / rays_s), ("mask-table", walked), ("mask-raster", rasterized.times[0])]
        {
            let params = json!({ "part": "figure6", "rays": 128, "radius": radius });
            let row = picture::row(case, &picture, &pattern, &rasterized, params);
            let counters = if method == "mask-raster" { row.counters.clone() } else { json!({}) };
            let speedup = all_rays / rays_s / time_s;
            let mrays_s = all_rays / time_s * 1e-6;
            output.row(&Row { method: method.into(), time_s, mrays_s, speedup, counters, ..row })?;
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
    let pattern = pattern(128)?;
    let tables = picture::tables(case, &pattern)?;
    let picture = Picture::new(case, options.quick);
    let mask_options = MaskOptions::default().with_radius(radius);
    let scene = picture::scene_level(case);
    let start = Instant::now();
    let coarse = coarse_levels(case)?;
    let build_s = start.elapsed().as_secs_f64();
    let mut levels = vec![scene];
    levels.extend(coarse.iter().map(|level| level.level(&case.mesh.positions)));
    let raster = RasterOptions::default();
    let passes = picture_passes(options);
    let whole = picture.rasterize(case, &tables, &levels[..1], &mask_options, &raster, passes)?;
    let detailed = picture.rasterize(case, &tables, &levels, &mask_options, &raster, passes)?;
    for (mode, answer, build_s) in [("scene", &whole, 0.0), ("levels", &detailed, build_s)] {
        let params = json!({ "part": "figure7", "rays": 128, "radius": name, "mode": mode });
        let mut row = picture::row(case, &picture, &pattern, answer, params);
        picture::put_errors(&mut row, &picture.errors(case, &pattern, &mask_options, &answer.ao));
        row.build_s = build_s;
        row.baseline = "scene";
        row.speedup = median(&whole.times) / median(&answer.times);
        let counts = coarse.iter().map(|level| level.triangles.len()).collect::<Vec<_>>();
        row.counters["level_triangles"] = json!(counts);
        row.counters["level_errors"] = json!(coarse.iter().map(|level| level.error).collect::<Vec<_>>());
        output.row(&row)?;
        if let Some(folder) = &options.images {
            let file = format!("figure7-{}-{mode}", case.name);
            picture.save(folder, &file, answer.ao.iter().map(|&ao| f64::from(ao)))?;
        }
    }
    Ok(())
}
