//! Method `mask-raster`: ambient occlusion of all receivers of an image by rasterizing what each triangle may occlude, without
//! any hierarchy (`[Laine10]`, section 4).
//!
//! Here: the call, levels of detail, tiles over threads. The far side of a shape is not drawn polygon by polygon: its
//! outline gives the pixels, and the inverted depth test asks on which side of the planes of the far side the receiver is,
//! which is the same question.
//!
//! Approximate, as `mask-table` is.
//!
//! Departure: as worded, the first culling test ("depth of the fragment is greater than depth of receiver point plus ambient
//! occlusion radius") would drop receivers beside a long triangle seen along its length. What is tested here is that the
//! receiver lies in front of the whole shape.

mod camera;
mod lod;
mod outline;
mod shape;
#[cfg(feature = "simplify")]
mod simplify;
mod tile;

pub use camera::RasterCamera;
pub use lod::{RasterLevel, RasterOptions};
#[cfg(feature = "simplify")]
pub use simplify::{SimplifiedLevel, simplified_levels};

use crate::{
    MaskError, MaskOptions, MaskTables, Outputs, Receiver,
    gather::{Answers, OutputRequest},
    table::TableSet,
};
use tile::{Draw, Level, Scratch, Setting, TILE, Tile};
use umbrage_accel::Counters;
use umbrage_geom::{Aabb, Progress, glam::Vec3, sampling::combine};

/// An image of receivers.
#[derive(Clone, Copy, Debug)]
#[non_exhaustive]
pub struct RasterView<'a> {
    /// What sees the receivers.
    pub camera: RasterCamera,
    /// Pixels across.
    pub width: u32,
    /// Pixels down.
    pub height: u32,
    /// The receiver in each pixel, row by row; not a number where there is none.
    pub points: &'a [[f32; 3]],
    /// Their normals.
    pub normals: &'a [[f32; 3]],
    /// How far from the centre of its pixel a receiver may be seen, in pixels: 0 if at the centre (a thousandth is added for
    /// rounding), 0.71 if anywhere in the pixel.
    pub footprint: f32,
}

impl<'a> RasterView<'a> {
    /// `width` x `height` receivers at the centres of their pixels.
    pub fn new(
        camera: RasterCamera,
        width: u32,
        height: u32,
        points: &'a [[f32; 3]],
        normals: &'a [[f32; 3]],
    ) -> Self {
        Self { camera, width, height, points, normals, footprint: 0.0 }
    }

    /// Sets [`Self::footprint`].
    #[must_use]
    pub fn with_footprint(self, footprint: f32) -> Self {
        Self { footprint, ..self }
    }

    /// Checked receivers; pixel `i` has the seed `combine(seed, i)`.
    fn receivers(&self, seed: u32) -> Result<Vec<Option<Receiver>>, MaskError> {
        // NaN is refused too.
        if !(self.footprint >= 0.0 && self.footprint.is_finite()) {
            let (name, value) = ("footprint", self.footprint);
            return Err(MaskError::Option { name, value, expected: "a finite number from 0" });
        }
        let points = (self.width as usize).saturating_mul(self.height as usize);
        for (what, actual) in [("points", self.points.len()), ("normals", self.normals.len())] {
            if actual != points {
                return Err(MaskError::Length { what, actual, expected: points, points });
            }
        }
        let pairs = self.points.iter().zip(self.normals).enumerate();
        pairs
            .map(|(i, (&point, &normal))| {
                if point.iter().any(|x| x.is_nan()) {
                    return Ok(None);
                }
                Receiver::new(i, point, normal, combine(seed, i as u32)).map(Some)
            })
            .collect()
    }
}

/// All receivers of an image and the triangles that may occlude them.
#[derive(Clone, Copy)]
#[must_use = "nothing is rasterized before `run`"]
pub struct RasterCall<'a> {
    tables: &'a MaskTables,
    levels: &'a [RasterLevel<'a>],
    view: &'a RasterView<'a>,
    options: MaskOptions,
    raster: RasterOptions,
}

impl<'a> RasterCall<'a> {
    /// The receivers of `view` among the triangles of `levels`, the first of which is the scene itself; the others, if any, stand
    /// for it at a distance ([`RasterLevel`]). Options are the defaults.
    pub fn new(tables: &'a MaskTables, levels: &'a [RasterLevel<'a>], view: &'a RasterView<'a>) -> Self {
        Self { tables, levels, view, options: MaskOptions::default(), raster: RasterOptions::default() }
    }

    /// Sets radius, sides and seed.
    pub fn with_options(self, options: MaskOptions) -> Self {
        Self { options, ..self }
    }

    /// Sets what is said of rasterization.
    pub fn with_raster(self, raster: RasterOptions) -> Self {
        Self { raster, ..self }
    }

    /// Ambient occlusion of all receivers. Where there is no receiver, or it is behind the camera, `ao` is 1 and masks and bent
    /// normals are 0. Results depend on what was said only, not on threads. `progress` gets growing fractions that end at
    /// exactly 1, from any thread, and returns `false` to cancel. Returns the work.
    ///
    /// # Errors
    /// [`MaskError::Build`] for geometry that can't be used; [`MaskError::Level`], [`MaskError::Radius`],
    /// [`MaskError::Option`], [`MaskError::FalloffWithoutRadius`], [`MaskError::Length`], [`MaskError::Point`],
    /// [`MaskError::Normal`], [`MaskError::Unsupported`], [`MaskError::Cancelled`]. The outputs are as they were then.
    pub fn run(
        self,
        mut outputs: Outputs<'_>,
        progress: &mut (dyn FnMut(f32) -> bool + Send),
    ) -> Result<Counters, MaskError> {
        let Self { tables, levels, view, options, raster } = &self;
        let pattern = tables.pattern();
        options.validate_for_tables(pattern)?;
        outputs.validate_for_tables()?;
        raster.validate()?;
        let receivers = view.receivers(options.seed)?;
        outputs.validate(receivers.len(), pattern.words())?;
        let levels = lod::prepare(levels, &bounds(levels, &receivers), options, raster, pattern)?;
        let result = crate::table::with_set!(tables.sets(), set => {
            Raster { tables, set, levels: &levels, view, options, raster, receivers: &receivers }.run(progress)
        });
        let (masks, counters) = result?;
        let answers = Answers { masks, ..Answers::default() };
        let gathered =
            OutputRequest::new(&outputs).gather(pattern, receivers.iter().map(Option::as_ref), &answers);
        gathered.write(&mut outputs, 0..receivers.len());
        Ok(counters)
    }
}

/// Box around everything.
fn bounds(levels: &[RasterLevel<'_>], receivers: &[Option<Receiver>]) -> Aabb {
    let points = receivers.iter().flatten().fold(Aabb::EMPTY, |aabb, r| aabb.with_point(r.point()));
    levels.iter().flat_map(|level| level.positions).fold(points, |aabb, &p| aabb.with_point(p))
}

/// Triangles of a tile after which the callback is asked again.
const TRIANGLES_BETWEEN_POLLS: usize = 256;

/// A call.
struct Raster<'a, const W: usize> {
    tables: &'a MaskTables,
    set: &'a TableSet<W>,
    levels: &'a [Level<'a>],
    view: &'a RasterView<'a>,
    options: &'a MaskOptions,
    raster: &'a RasterOptions,
    receivers: &'a [Option<Receiver>],
}

/// First and last tile, both included, across and down, that a triangle may touch; first after last for none.
#[derive(Clone, Copy, Debug)]
struct Reach {
    columns: [u16; 2],
    rows: [u16; 2],
}

impl<const W: usize> Raster<'_, W> {
    fn run(&self, progress: &mut (dyn FnMut(f32) -> bool + Send)) -> Result<(Vec<u64>, Counters), MaskError> {
        let size = [self.view.width as usize, self.view.height as usize];
        let [columns, rows] = size.map(|n| n.div_ceil(TILE));
        let setting = Setting {
            camera: self.view.camera,
            size,
            footprint: f64::from(self.view.footprint) + 1e-3,
            sides: self.options.sides,
            tests: self.raster.culling_tests.into(),
            tables: self.set.triangle_tables(),
        };
        let progress = Progress::new((columns * rows) as u64, progress);
        let reaches: Vec<Vec<Reach>> = self.levels.iter().map(|level| reaches(level, &setting)).collect();
        progress.check()?;
        // By level, for each row of tiles.
        let bands: Vec<Vec<Vec<u32>>> = reaches.iter().map(|reaches| bands(reaches, rows)).collect();
        let tiles = each(columns * rows, |index| {
            progress.check()?;
            let (column, row) = (index % columns, index / columns);
            let tile = self.tile(&setting, [column, row], (&reaches, &bands), &progress);
            progress.advance(1)?;
            Ok::<_, MaskError>(tile)
        });
        let words = self.tables.pattern().words();
        let mut masks = vec![0; size[0] * size[1] * words];
        let mut counters = Counters::default();
        for tile in tiles {
            let (tile, tile_masks, tile_counters) = tile?;
            counters += tile_counters;
            for row in 0..tile.height {
                for column in 0..tile.width {
                    let from = &tile_masks[row * tile.stride() + column];
                    let pixel = (tile.y + row) * size[0] + tile.x + column;
                    masks[pixel * words..][..words].copy_from_slice(&from[..words]);
                }
            }
        }
        progress.finish()?;
        Ok((masks, counters))
    }

    fn tile(
        &self,
        setting: &Setting<'_, W>,
        [column, row]: [usize; 2],
        (reaches, bands): (&[Vec<Reach>], &[Vec<Vec<u32>>]),
        progress: &Progress<'_>,
    ) -> (Tile, Vec<[u64; W]>, Counters) {
        let at = [column * TILE, row * TILE];
        let pattern = self.tables.pattern();
        let tile = Tile::new(at, setting.size, self.receivers, pattern, &setting.camera);
        let mut masks = vec![[0; W]; tile.stride() * tile.height];
        let mut counters = Counters::default();
        let mut scratch = Scratch::default();
        if tile.near < f64::INFINITY {
            for ((level, reaches), bands) in self.levels.iter().zip(reaches).zip(bands) {
                let touches = |&&triangle: &&u32| {
                    let [first, last] = reaches[triangle as usize].columns;
                    (first..=last).contains(&(column as u16))
                };
                let triangles = bands[row].iter().filter(touches).enumerate();
                // A tile may take long: it ends early, unfinished, when the call is cancelled.
                let mut triangles = triangles.map_while(|(number, &triangle)| {
                    let goes_on = number % TRIANGLES_BETWEEN_POLLS != 0 || progress.poll().is_ok();
                    goes_on.then_some(triangle as usize)
                });
                self.tables.options().back_end.run(Draw {
                    setting,
                    tile: &tile,
                    level,
                    triangles: &mut triangles,
                    masks: &mut masks,
                    scratch: &mut scratch,
                    counters: &mut counters,
                });
            }
        }
        // Rays of no length meet the planes of triangles that hold the receiver.
        let closed = self.tables.closed_rays::<W>();
        for mask in &mut masks {
            mask.iter_mut().zip(closed).for_each(|(word, closed)| *word &= !closed);
        }
        (tile, masks, counters)
    }
}

/// The tiles that each triangle's bounding sphere of influence may touch.
fn reaches<const W: usize>(level: &Level<'_>, setting: &Setting<'_, W>) -> Vec<Reach> {
    each(level.triangles.len(), |triangle| {
        let corners = level.corners(triangle).map(|c| Vec3::from(c).as_dvec3());
        let low = corners[0].min(corners[1]).min(corners[2]);
        let high = corners[0].max(corners[1]).max(corners[2]);
        let center = 0.5 * (low + high);
        // As far as shapes reach, their corners included.
        let radius =
            (0.5 * (high - low).length() + f64::from(level.reach)) * 1.05 + high.abs().max_element() * 1e-6;
        let spans = [0, 1].map(|axis| {
            let tiles = setting.size[axis].div_ceil(TILE) as f64;
            let Some([low, high]) = setting.camera.sphere(center, radius, axis) else {
                return [0, tiles as u16 - 1];
            };
            let ends = [low, high].map(|x| setting.pixels([x, x])[axis]);
            let (first, last) = (ends[0].min(ends[1]), ends[0].max(ends[1]));
            let margin = setting.footprint + 1.0;
            let tile = |x: f64| (x / TILE as f64).floor();
            // An empty range where the sphere is outside the image.
            let first = tile(first - margin).clamp(0.0, tiles);
            let last = tile(last + margin);
            if last < 0.0 { [1, 0] } else { [first as u16, last.min(tiles - 1.0) as u16] }
        });
        let behind = setting.camera.project(center).depth + radius * setting.camera.depth_per_length() <= 0.0;
        if behind {
            Reach { columns: [1, 0], rows: [1, 0] }
        } else {
            Reach { columns: spans[0], rows: spans[1] }
        }
    })
}

/// Triangles that may touch each row of tiles.
fn bands(reaches: &[Reach], rows: usize) -> Vec<Vec<u32>> {
    each(rows, |row| {
        let touches = |reach: &Reach| (reach.rows[0]..=reach.rows[1]).contains(&(row as u16));
        (0..).zip(reaches).filter(|(_, reach)| touches(reach)).map(|(triangle, _)| triangle).collect()
    })
}

/// `f` of every index, over all threads where there are some.
fn each<T: Send>(count: usize, f: impl Fn(usize) -> T + Sync + Send) -> Vec<T> {
    #[cfg(feature = "rayon")]
    {
        use rayon::prelude::*;
        (0..count).into_par_iter().map(f).collect()
    }
    #[cfg(not(feature = "rayon"))]
    (0..count).map(f).collect()
}
