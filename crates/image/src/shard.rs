//! Images made in pieces: which tiles a shard holds, part files, and joining them.
//!
//! Tiles are numbered along rows from the top left. Shard `I/N` (from 1) holds the tiles with `number % N == I - 1`, so
//! that neighbouring tiles, which cost about the same, go to different shards.

use super::{Film, ImageError, file, openexr};
use std::{
    fmt,
    path::{Path, PathBuf},
    str::FromStr,
};

/// Attribute of part files: one, so that the order of attributes cannot vary.
const ATTRIBUTE: &str = "umbrage:shard";

/// Why shards can't be made or joined.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ShardError {
    /// The text is not two numbers with a slash.
    #[error("'{0}' is not a shard: two numbers I/N are needed, as in 1/4")]
    Syntax(String),
    /// Shards are counted from 1 to N.
    #[error("shard {index}/{count} does not exist: shards are counted from 1/N to N/N")]
    Range {
        /// I.
        index: u32,
        /// N.
        count: u32,
    },
    /// Some shards would hold nothing.
    #[error("{shards} shards are more than the image's {tiles} tiles")]
    TooMany {
        /// How many shards.
        shards: u32,
        /// How many tiles.
        tiles: u32,
    },
    /// The tile size is 0.
    #[error("tiles of 0 pixels do not exist")]
    TileSize,
    /// No part files were given.
    #[error("there are no parts to merge")]
    NoParts,
    /// The file is an image, but not one that a shard wrote.
    #[error("{}: is not a part of an image: the attribute {ATTRIBUTE} is missing or damaged", .path.display())]
    NotAPart {
        /// The file.
        path: PathBuf,
    },
    /// Two parts come from different runs.
    #[error("{}: does not fit to {}: the two differ in {what}", .path.display(), .first.display())]
    Mismatch {
        /// The file.
        path: PathBuf,
        /// The part that it was compared with.
        first: PathBuf,
        /// What differs.
        what: &'static str,
    },
    /// Two files hold the same shard.
    #[error("{}: holds shard {shard}, and so does {}", .path.display(), .first.display())]
    Duplicate {
        /// The second file.
        path: PathBuf,
        /// The first file.
        first: PathBuf,
        /// The shard.
        shard: Shard,
    },
    /// Some shards are in no file.
    #[error("of {count} shards, {} missing: {}", are(.missing), list(.missing))]
    Missing {
        /// How many shards there are.
        count: u32,
        /// Numbers of the missing ones, from 1.
        missing: Vec<u32>,
    },
}

fn are(missing: &[u32]) -> String {
    format!("{} {}", missing.len(), if missing.len() == 1 { "is" } else { "are" })
}

fn list(missing: &[u32]) -> String {
    let shown: Vec<_> = missing.iter().take(10).map(u32::to_string).collect();
    format!("{}{}", shown.join(", "), if missing.len() > 10 { ", ..." } else { "" })
}

/// One shard of several, written `I/N`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shard {
    index: u32,
    count: u32,
}

impl Shard {
    /// The one shard that is the whole image.
    pub const WHOLE: Self = Self { index: 1, count: 1 };

    /// Shard `index` (from 1) of `count`.
    ///
    /// # Errors
    /// [`ShardError::Range`].
    pub fn new(index: u32, count: u32) -> Result<Self, ShardError> {
        if index == 0 || index > count {
            return Err(ShardError::Range { index, count });
        }
        Ok(Self { index, count })
    }

    /// I, from 1.
    pub fn index(self) -> u32 {
        self.index
    }

    /// N.
    pub fn count(self) -> u32 {
        self.count
    }

    /// Whether the shard holds tile number `tile`.
    pub fn holds(self, tile: u32) -> bool {
        tile % self.count == self.index - 1
    }

    /// Checks that every shard holds a tile.
    ///
    /// # Errors
    /// [`ShardError::TooMany`] if there are more shards than tiles.
    pub fn check(self, grid: &TileGrid) -> Result<(), ShardError> {
        let tiles = grid.count();
        if self.count > tiles { Err(ShardError::TooMany { shards: self.count, tiles }) } else { Ok(()) }
    }

    /// Numbers of the shard's tiles, growing.
    ///
    /// # Errors
    /// Those of [`Self::check`].
    pub fn tiles(self, grid: &TileGrid) -> Result<impl Iterator<Item = u32> + use<>, ShardError> {
        self.check(grid)?;
        Ok((self.index - 1..grid.count()).step_by(self.count as usize))
    }
}

impl FromStr for Shard {
    type Err = ShardError;

    fn from_str(text: &str) -> Result<Self, ShardError> {
        // `u32` would take a plus sign.
        let number = |digits: &str| {
            let only_digits = !digits.is_empty() && digits.bytes().all(|b| b.is_ascii_digit());
            only_digits.then(|| digits.parse().ok()).flatten()
        };
        let parts = text.split_once('/').and_then(|(i, n)| Some((number(i)?, number(n)?)));
        let (index, count) = parts.ok_or_else(|| ShardError::Syntax(text.into()))?;
        Self::new(index, count)
    }
}

impl fmt::Display for Shard {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.index, self.count)
    }
}

/// A rectangle of pixels; ends are excluded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Tile {
    /// First column.
    pub x: u32,
    /// First row.
    pub y: u32,
    /// One past the last column.
    pub x_end: u32,
    /// One past the last row.
    pub y_end: u32,
}

impl Tile {
    /// Pixels across.
    pub fn width(&self) -> u32 {
        self.x_end - self.x
    }

    /// Pixels down.
    pub fn height(&self) -> u32 {
        self.y_end - self.y
    }
}

/// How an image is cut into square tiles; those at the right and bottom may be cut off.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TileGrid {
    width: u32,
    height: u32,
    tile_size: u32,
}

impl TileGrid {
    /// Tiles of `tile_size` pixels across and down.
    ///
    /// # Errors
    /// [`ShardError::TileSize`] if that is 0; [`ImageError::Size`] as for [`Film::new`].
    pub fn new(width: u32, height: u32, tile_size: u32) -> Result<Self, ImageError> {
        super::film::check_size(width.into(), height.into())?;
        if tile_size == 0 {
            return Err(ShardError::TileSize.into());
        }
        Ok(Self { width, height, tile_size })
    }

    /// Pixels along a side of a whole tile.
    pub fn tile_size(&self) -> u32 {
        self.tile_size
    }

    /// Number of tiles.
    pub fn count(&self) -> u32 {
        self.width.div_ceil(self.tile_size) * self.height.div_ceil(self.tile_size)
    }

    /// Tile number `index`: along rows, from the top left.
    ///
    /// # Panics
    /// If `index` is not below [`Self::count`].
    pub fn tile(&self, index: u32) -> Tile {
        assert!(index < self.count(), "tile {index} of {}", self.count());
        let across = self.width.div_ceil(self.tile_size);
        let (x, y) = (index % across * self.tile_size, index / across * self.tile_size);
        let end = |start: u32, size: u32| start.saturating_add(self.tile_size).min(size);
        Tile { x, y, x_end: end(x, self.width), y_end: end(y, self.height) }
    }
}

/// What a part file says about itself.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Part {
    /// The shard that the part holds.
    pub shard: Shard,
    /// Pixels along a side of a tile.
    pub tile_size: u32,
    /// Hash of the scene and of all settings that decide about pixels; only parts with the same one are joined.
    pub fingerprint: u64,
    /// Stops for a PNG made of the joined image; finite.
    pub exposure: f32,
}

impl fmt::Display for Part {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { shard, tile_size, fingerprint, exposure } = self;
        write!(f, "{shard} tile={tile_size} fingerprint={fingerprint:016x} exposure={exposure}")
    }
}

impl Part {
    fn parse(text: &str) -> Option<Self> {
        let mut words = text.split(' ');
        let shard = words.next()?.parse().ok()?;
        let tile_size = words.next()?.strip_prefix("tile=")?.parse().ok()?;
        let fingerprint = u64::from_str_radix(words.next()?.strip_prefix("fingerprint=")?, 16).ok()?;
        let exposure: f32 = words.next()?.strip_prefix("exposure=")?.parse().ok()?;
        let complete = words.next().is_none() && tile_size > 0 && exposure.is_finite();
        complete.then_some(Self { shard, tile_size, fingerprint, exposure })
    }

    /// What differs from a part of the same run.
    fn difference(&self, other: &Self) -> Option<&'static str> {
        [
            (self.shard.count != other.shard.count, "the number of shards"),
            (self.tile_size != other.tile_size, "tile size"),
            (self.fingerprint != other.fingerprint, "scene or settings"),
            (self.exposure.to_bits() != other.exposure.to_bits(), "exposure"),
        ]
        .into_iter()
        .find_map(|(differs, what)| differs.then_some(what))
    }
}

/// Writes a shard's part file, atomically: an EXR with the layers of the whole image, of which only the shard's tiles
/// count.
///
/// # Errors
/// [`ImageError::PartExtension`], [`ImageError::Encode`] for an exposure that is not finite, and those of
/// [`write_exr`](super::write_exr).
pub fn write_part(path: &Path, film: &Film, part: &Part) -> Result<(), ImageError> {
    check_extension(path)?;
    if !part.exposure.is_finite() {
        return Err(ImageError::Encode(format!("exposure {} is not finite", part.exposure)));
    }
    let bytes = openexr::encode(film, Some((ATTRIBUTE, &part.to_string())))?;
    file::write_bytes(path, &bytes)
}

/// Reads what a part file says about itself, and its image's size, but no pixels.
///
/// # Errors
/// [`ImageError::PartExtension`], [`ImageError::Io`], [`ImageError::Decode`]; [`ShardError::NotAPart`].
pub fn read_part(path: &Path) -> Result<(Part, (u32, u32)), ImageError> {
    check_extension(path)?;
    let (size, text) = openexr::read_header(path, ATTRIBUTE)?;
    let part = text.as_deref().and_then(Part::parse);
    Ok((part.ok_or_else(|| ShardError::NotAPart { path: path.into() })?, size))
}

fn check_extension(path: &Path) -> Result<(), ImageError> {
    match file::Format::of(path) {
        Ok(file::Format::Exr) => Ok(()),
        _ => Err(ImageError::PartExtension { path: path.into() }),
    }
}

/// The image joined from its parts.
#[derive(Clone, Debug)]
pub struct Merged {
    /// The image, bit for bit that of a run without shards.
    pub film: Film,
    /// Stops for a PNG of it.
    pub exposure: f32,
    /// The fingerprint that all parts share.
    pub fingerprint: u64,
}

/// Joins part files, given in any order.
///
/// All of them are checked before pixels are read, and only one at a time is held in memory beside the result.
///
/// # Errors
/// [`ShardError`] if a part is missing, comes twice, is none or comes from another run; [`ImageError::Io`],
/// [`ImageError::Decode`].
pub fn merge(parts: &[PathBuf]) -> Result<Merged, ImageError> {
    let (first_path, rest) = parts.split_first().ok_or(ShardError::NoParts)?;
    let (first, size) = read_part(first_path)?;
    let mut order = vec![(first.shard, first_path)];
    for path in rest {
        let (part, part_size) = read_part(path)?;
        let differs = first.difference(&part).or((part_size != size).then_some("size"));
        if let Some(what) = differs {
            return Err(ShardError::Mismatch { path: path.clone(), first: first_path.clone(), what }.into());
        }
        order.push((part.shard, path));
    }
    order.sort_by_key(|(shard, _)| shard.index);
    if let Some(two) = order.windows(2).find(|two| two[0].0 == two[1].0) {
        let (first, path) = (two[0].1.clone(), two[1].1.clone());
        return Err(ShardError::Duplicate { path, first, shard: two[0].0 }.into());
    }
    let grid = TileGrid::new(size.0, size.1, first.tile_size)?;
    first.shard.check(&grid)?;
    let count = first.shard.count;
    if (order.len() as u64) < u64::from(count) {
        let present = |i: &u32| order.binary_search_by_key(i, |(shard, _)| shard.index).is_ok();
        let missing = (1..=count).filter(|i| !present(i)).collect();
        return Err(ShardError::Missing { count, missing }.into());
    }
    let mut film: Option<Film> = None;
    for (shard, path) in &order {
        let part = openexr::read_exr(path)?;
        let tiles = shard.tiles(&grid)?;
        match &mut film {
            None => film = Some(part),
            Some(film) if !film.same_shape(&part) => {
                let (path, first) = ((*path).clone(), order[0].1.clone());
                return Err(ShardError::Mismatch { path, first, what: "layers" }.into());
            }
            Some(film) => tiles.for_each(|i| film.copy_tile(&part, &grid.tile(i))),
        }
    }
    let film = film.expect("at least one part");
    Ok(Merged { film, exposure: first.exposure, fingerprint: first.fingerprint })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shards_are_two_numbers() {
        assert_eq!("2/3".parse(), Shard::new(2, 3));
        assert_eq!("3/3".parse::<Shard>().unwrap().to_string(), "3/3");
        for text in
            ["", "1", "/", "1/", "/2", "a/b", "1/2/3", "-1/2", "+1/2", " 1/2", "1/4294967296", "1.0/2"]
        {
            assert_eq!(text.parse::<Shard>(), Err(ShardError::Syntax(text.into())));
        }
        for (text, index, count) in [("0/2", 0, 2), ("3/2", 3, 2), ("0/0", 0, 0), ("1/0", 1, 0)] {
            assert_eq!(text.parse::<Shard>(), Err(ShardError::Range { index, count }));
        }
    }

    #[test]
    fn shards_share_out_all_tiles_and_tiles_all_pixels() {
        let grid = TileGrid::new(70, 33, 16).unwrap();
        assert_eq!(grid.count(), 15);
        let mut seen = vec![0; 70 * 33];
        for i in 1..=4 {
            let shard = Shard::new(i, 4).unwrap();
            for index in shard.tiles(&grid).unwrap() {
                assert!(shard.holds(index));
                let tile = grid.tile(index);
                for y in tile.y..tile.y_end {
                    (tile.x..tile.x_end).for_each(|x| seen[(y * 70 + x) as usize] += 1);
                }
            }
        }
        assert!(seen.iter().all(|&n| n == 1));
        assert!(Shard::new(1, 15).unwrap().tiles(&grid).is_ok());
        let too_many = Shard::new(1, 16).unwrap().tiles(&grid).map(|_| ());
        assert_eq!(too_many, Err(ShardError::TooMany { shards: 16, tiles: 15 }));
        assert!(TileGrid::new(1, 1, 0).is_err());
        assert_eq!(TileGrid::new(10, 10, u32::MAX).unwrap().count(), 1);
    }

    #[test]
    fn parts_read_back_what_they_say() {
        let shard = Shard::new(2, 7).unwrap();
        let part = Part { shard, tile_size: 32, fingerprint: 0xfeed, exposure: -0.1 };
        assert_eq!(Part::parse(&part.to_string()), Some(part));
        for text in ["", "2/7", "8/7 tile=1 fingerprint=0 exposure=0", "1/1 tile=0 fingerprint=0 exposure=0"]
        {
            assert_eq!(Part::parse(text), None, "{text}");
        }
        assert_eq!(Part::parse("1/1 tile=1 fingerprint=0 exposure=NaN"), None);
        assert_eq!(Part::parse(&format!("{part} more=1")), None);
    }
}
