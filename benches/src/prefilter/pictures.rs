//! Pictures of figures 1, 7, 8 (few rays, prefiltered rays, many rays), 4 (what rays see of the scene) and 6 (convergence, and the levels at which rays end).

use super::{
    case::{Case, Workload},
    figures::Levels,
};
use anyhow::{Context, Result};
use image::{Rgb, RgbImage};
use std::path::Path;
use umbrage_geom::{Ray, glam::Vec3};
use umbrage_occlusion::prefilter::{ConeQuery, ConeRay, PrefilterOptions, Prefiltered};

/// Pixels between the pictures of a sheet.
const GAP: u32 = 4;

/// Pictures side by side and below each other, all of one size.
fn sheet(rows: &[Vec<RgbImage>]) -> RgbImage {
    let (width, height) = rows[0][0].dimensions();
    let columns = rows.iter().map(Vec::len).max().unwrap_or(0) as u32;
    let (wide, high) = (columns * (width + GAP) - GAP, rows.len() as u32 * (height + GAP) - GAP);
    let mut sheet = RgbImage::from_pixel(wide, high, Rgb([255; 3]));
    for (j, row) in rows.iter().enumerate() {
        for (i, picture) in row.iter().enumerate() {
            let at = (i64::from(i as u32 * (width + GAP)), i64::from(j as u32 * (height + GAP)));
            image::imageops::replace(&mut sheet, picture, at.0, at.1);
        }
    }
    sheet
}

/// Grey of a linear value in `[0, 1]`.
fn grey(value: f32) -> Rgb<u8> {
    Rgb([(255.0 * value.clamp(0.0, 1.0).powf(1.0 / 2.2)).round() as u8; 3])
}

/// From blue over green and yellow to red for `[0, 1]`.
fn heat(value: f32) -> Rgb<u8> {
    let stops = [
        [40.0, 40.0, 160.0],
        [0.0, 150.0, 170.0],
        [90.0, 190.0, 60.0],
        [250.0, 210.0, 40.0],
        [200.0, 30.0, 30.0],
    ];
    let at = value.clamp(0.0, 1.0) * (stops.len() - 1) as f32;
    let first = (at as usize).min(stops.len() - 2);
    let mix = |k: usize| stops[first][k] + (at - first as f32) * (stops[first + 1][k] - stops[first][k]);
    Rgb([mix(0) as u8, mix(1) as u8, mix(2) as u8])
}

fn save(picture: &RgbImage, folder: &Path, name: &str) -> Result<()> {
    std::fs::create_dir_all(folder).with_context(|| folder.display().to_string())?;
    let path = folder.join(name);
    picture.save(&path).with_context(|| path.display().to_string())
}

/// Figure 4: the view up from a receiver in half shadow; triangles, T = 2, T = 0.1.
pub fn worms_eye(case: &Case, scene: &Prefiltered, size: u32, folder: &Path) -> Result<()> {
    let Some((receiver, solid_angle)) = case.half_shadow() else { return Ok(()) };
    let origin = case.receivers[receiver].point;
    let forward = (case.mesh.bounds().center() - origin).normalize().lerp(Vec3::Y, 0.5).normalize();
    let right = forward.cross(Vec3::X).normalize();
    let up = right.cross(forward);
    let pixel = |i: u32| {
        let place = |at: u32| ((at as f32 + 0.5) / size as f32 - 0.5) * 1.6;
        let direction = forward + right * place(i % size) - up * place(i / size);
        ConeRay { ray: Ray::new(origin, direction), solid_angle }
    };
    let cones: Vec<ConeRay> = (0..size * size).map(pixel).collect();
    let mut row = Vec::new();
    for query in [ConeQuery::EXACT, ConeQuery::new(2.0)?, ConeQuery::new(0.1)?] {
        let mut passed = vec![0.0; cones.len()];
        scene.transmittances(&cones, &query, &mut passed);
        row.push(RgbImage::from_fn(size, size, |x, y| grey(passed[(y * size + x) as usize])));
    }
    save(&sheet(&[row]), folder, &format!("prefilter-worm-{}.png", case.source.name))
}

/// Figure 6: visibility with 4, 16 and 64 rays a pixel, and below the mean level at which rays end, from the root (blue) to
/// the lowest leaves and triangles (red).
pub fn convergence(case: &Case, width: u32, folder: &Path) -> Result<()> {
    let (scene, _) = case.prefiltered(&PrefilterOptions::default())?;
    let height = width * 3 / 4;
    let (mut above, mut below) = (Vec::new(), Vec::new());
    for rays in [4, 16, 64] {
        let mut light = RgbImage::from_pixel(width, height, Rgb([255; 3]));
        let mut level = light.clone();
        let mut cones = Vec::new();
        let mut levels = Levels::new(&scene);
        for (i, receiver) in case.receivers.iter().enumerate() {
            cones.clear();
            case.fan(i, rays, 5, &mut cones);
            let mut passed = vec![0.0; cones.len()];
            levels.restart();
            scene.transmittances_with(&cones, &case.query(), &mut passed, &mut levels);
            let [x, y] = receiver.pixel;
            light.put_pixel(x, y, grey(passed.iter().sum::<f32>() / passed.len() as f32));
            level.put_pixel(x, y, levels.mean().map_or(Rgb([0; 3]), heat));
        }
        above.push(light);
        below.push(level);
    }
    save(&sheet(&[above, below]), folder, &format!("prefilter-levels-{}.png", case.source.name))
}

/// Mean visibilities of all receivers, a picture each, side by side; each receiver has the same number of answers.
pub fn panels(case: &Case, answers: &[Vec<f32>], folder: &Path) -> Result<()> {
    let [width, height] = case.pixels();
    let picture = |passed: &Vec<f32>| {
        let mut picture = RgbImage::from_pixel(width, height, Rgb([255; 3]));
        let rays = passed.len() / case.receivers.len().max(1);
        for (receiver, passed) in case.receivers.iter().zip(passed.chunks(rays.max(1))) {
            let [x, y] = receiver.pixel;
            picture.put_pixel(x, y, grey(passed.iter().sum::<f32>() / passed.len() as f32));
        }
        picture
    };
    let row = answers.iter().map(picture).collect();
    save(&sheet(&[row]), folder, &format!("prefilter-equal-{}.png", case.source.name))
}

/// Figures 4 and 6 of a scene.
pub fn run(case: &Case, width: u32, folder: &Path) -> Result<()> {
    if matches!(case.source.workload, Workload::Shadow) {
        let (scene, _) = case.prefiltered(&PrefilterOptions::default())?;
        worms_eye(case, &scene, width, folder)?;
    }
    let seen = Case::seen(case.source, case.mesh_alone()?, width)?;
    convergence(&seen, width, folder)
}
