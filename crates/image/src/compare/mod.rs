//! How much two images differ: numbers with stable names, and a picture.

mod flip;

pub use flip::{PIXELS_PER_DEGREE, flip};

use crate::{ColorMap, Film, Format, ImageError, Layer, ValueRange, names, write_picture};
use serde::Serialize;
use std::{
    fmt,
    path::{Path, PathBuf},
};

/// Why two images can't be compared.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CompareError {
    /// The images have different sizes.
    #[error("images of {} x {} and {} x {} pixels cannot be compared", .a.0, .a.1, .b.0, .b.1)]
    Size {
        /// Width and height of the first.
        a: (u32, u32),
        /// Width and height of the second.
        b: (u32, u32),
    },
    /// One file holds light, the other what a screen shows of it.
    #[error("{} and {} are of different types: an EXR holds light, a PNG what a screen shows of it", .a.display(), .b.display())]
    Formats {
        /// The first file.
        a: PathBuf,
        /// The second file.
        b: PathBuf,
    },
    /// No channel of the layer, or of any layer, is in both images.
    #[error("the images have no {0} in common")]
    NothingInCommon(String),
    /// FLIP needs colours.
    #[error("layer '{0}' is no colour, FLIP has no meaning for it")]
    NoColor(String),
    /// The number of pixels per degree is not between 1 and 1000.
    #[error("{0} pixels per degree of view is not between 1 and 1000")]
    PixelsPerDegree(f32),
    /// The exposure is not finite.
    #[error("an exposure of {0} stops is not finite")]
    Exposure(f32),
    /// A file can't be read or written.
    #[error(transparent)]
    Image(#[from] ImageError),
}

/// What is compared, and how FLIP looks at it.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct CompareOptions {
    /// The only layer to compare; `None` compares all that both images have.
    pub layer: Option<String>,
    /// Stops of brightness added before FLIP clamps light to what a screen shows. Other numbers don't change.
    pub exposure: f32,
    /// Pixels per degree of view, for FLIP; from 1 to 1000.
    pub pixels_per_degree: f32,
}

impl Default for CompareOptions {
    fn default() -> Self {
        Self { layer: None, exposure: 0.0, pixels_per_degree: PIXELS_PER_DEGREE }
    }
}

impl CompareOptions {
    /// Compares one layer only.
    pub fn with_layer(self, layer: impl Into<String>) -> Self {
        Self { layer: Some(layer.into()), ..self }
    }

    /// Brightens by so many stops for FLIP.
    pub fn with_exposure(self, stops: f32) -> Self {
        Self { exposure: stops, ..self }
    }
}

/// How one layer of two images differs.
///
/// Differences are `b - a` of every value, in the file's units (linear light; PNG is decoded to it). Two values that are
/// equal, both NaN or the same infinity differ by 0. Differences that are otherwise not finite are left out of the means
/// and the maximum; their pixels are counted.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LayerDifference {
    /// Name of the layer.
    pub layer: String,
    /// The channels that both images have.
    pub channels: Vec<String>,
    /// Root of the mean squared difference.
    pub rmse: f64,
    /// Mean of the absolute difference.
    pub mean_abs: f64,
    /// Largest absolute difference.
    pub max_abs: f64,
    /// First pixel (x, y) with the largest difference; `None` (null) if no value differs.
    pub max_at: Option<[u32; 2]>,
    /// Mean of `b - a`.
    pub bias: f64,
    /// Pixels with a difference in any channel.
    pub different_pixels: u64,
    /// Pixels with a difference that is not finite.
    pub non_finite_pixels: u64,
    /// Mean LDR-FLIP in `[0, 1]`; `None` (null) for layers that are no colours.
    pub flip: Option<f64>,
    /// Largest LDR-FLIP of a pixel.
    pub flip_max: Option<f64>,
}

/// How two images differ. As JSON: `width`, `height`, `identical`, the fields of [`LayerDifference`] for the main layer,
/// `layers`, `only_in_a`, `only_in_b`. All numbers are finite.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Comparison {
    /// Pixels across.
    pub width: u32,
    /// Pixels down.
    pub height: u32,
    /// Whether no pixel differs in any compared layer and both images have the same layers and channels.
    pub identical: bool,
    /// The layer asked for, else the beauty, else the first.
    #[serde(flatten)]
    pub main: LayerDifference,
    /// All compared layers, in the order of the first image.
    pub layers: Vec<LayerDifference>,
    /// Layers, or channels as `layer.channel`, that only the first image has.
    pub only_in_a: Vec<String>,
    /// Those that only the second has.
    pub only_in_b: Vec<String>,
}

impl fmt::Display for LayerDifference {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { layer, rmse, mean_abs, max_abs, bias, different_pixels, .. } = self;
        write!(f, "{layer:<8} rmse {rmse:.3e}  mean {mean_abs:.3e}  max {max_abs:.3e}")?;
        if let Some([x, y]) = self.max_at {
            write!(f, " at ({x}, {y})")?;
        }
        write!(f, "  bias {bias:+.3e}")?;
        if let Some(flip) = self.flip {
            write!(f, "  FLIP {flip:.5}")?;
        }
        write!(f, "  different pixels {different_pixels}")?;
        match self.non_finite_pixels {
            0 => Ok(()),
            n => write!(f, ", {n} of them not finite"),
        }
    }
}

impl fmt::Display for Comparison {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let same = if self.identical { "identical" } else { "different" };
        write!(f, "{} x {} pixels, {same}", self.width, self.height)?;
        for layer in &self.layers {
            write!(f, "\n{layer}")?;
        }
        for (which, names) in [("first", &self.only_in_a), ("second", &self.only_in_b)] {
            if !names.is_empty() {
                write!(f, "\nonly in the {which}: {}", names.join(", "))?;
            }
        }
        Ok(())
    }
}

/// Compares two images of the same size.
///
/// # Errors
/// [`CompareError::Size`]; [`CompareError::NothingInCommon`]; [`ImageError::NoLayer`] if an image lacks the layer that
/// the options name; [`CompareError::PixelsPerDegree`], [`CompareError::Exposure`].
pub fn compare(a: &Film, b: &Film, options: &CompareOptions) -> Result<Comparison, CompareError> {
    let pairs = common_layers(a, b, options)?;
    let mut layers = Vec::new();
    let (mut only_in_a, mut only_in_b) = (Vec::new(), Vec::new());
    for (layer_a, layer_b) in pairs {
        only_in_a.extend(missing_channels(layer_a, layer_b));
        only_in_b.extend(missing_channels(layer_b, layer_a));
        layers.push(compare_layer(a, layer_a, layer_b, options));
    }
    if options.layer.is_none() {
        only_in_a.extend(missing_layers(a, b));
        only_in_b.extend(missing_layers(b, a));
    }
    let main = layers.iter().find(|l| l.layer == names::BEAUTY).unwrap_or(&layers[0]).clone();
    let equal = layers.iter().all(|l| l.different_pixels == 0);
    let identical = equal && only_in_a.is_empty() && only_in_b.is_empty();
    Ok(Comparison { width: a.width(), height: a.height(), identical, main, layers, only_in_a, only_in_b })
}

/// Reads and compares two EXR files, or two PNG files.
///
/// # Errors
/// [`CompareError::Formats`] for one of each; [`CompareError::Image`]; those of [`compare`].
pub fn compare_files(a: &Path, b: &Path, options: &CompareOptions) -> Result<Comparison, CompareError> {
    let [film_a, film_b] = read_two(a, b)?;
    compare(&film_a, &film_b, options)
}

/// Reads two EXR files, or two PNG files.
///
/// # Errors
/// [`CompareError::Formats`] for one of each; [`CompareError::Image`].
pub fn read_two(a: &Path, b: &Path) -> Result<[Film; 2], CompareError> {
    if Format::of(a)? != Format::of(b)? {
        return Err(CompareError::Formats { a: a.into(), b: b.into() });
    }
    Ok([crate::read(a)?, crate::read(b)?])
}

/// What a difference picture shows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub enum DifferencePicture {
    /// LDR-FLIP from 0 (black) to 1 (light yellow).
    #[default]
    Flip,
    /// Mean of `b - a` over the channels: blue where `b` is less, white where equal, red where more; the largest
    /// difference has the full colour. Grey where it is not finite.
    Signed,
}

/// Writes a picture of the differences in one layer as PNG, atomically: the layer of the options, else the beauty, else
/// the first that both have. Returns what the ends of the colour map stand for.
///
/// # Errors
/// Those of [`compare`]; [`CompareError::NoColor`] for FLIP of a layer that is no colour; [`ImageError::Extension`]
/// unless `path` ends in `.png`; those of [`write_picture`].
pub fn write_difference(
    path: &Path,
    a: &Film,
    b: &Film,
    options: &CompareOptions,
    picture: DifferencePicture,
) -> Result<ValueRange, CompareError> {
    if Format::of(path)? != Format::Png {
        return Err(ImageError::Extension { path: path.into() }.into());
    }
    let pairs = common_layers(a, b, options)?;
    let (layer_a, layer_b) =
        pairs.iter().find(|(layer, _)| layer.name() == names::BEAUTY).copied().unwrap_or(pairs[0]);
    let (values, range, map) = match picture {
        DifferencePicture::Flip => {
            let values = flip_map(a, layer_a, layer_b, options)
                .ok_or_else(|| CompareError::NoColor(layer_a.name().into()))?;
            (values, ValueRange::UNIT, ColorMap::Magma)
        }
        DifferencePicture::Signed => {
            let channels = common_channels(layer_a, layer_b);
            let mean = |i: usize| {
                let (x, y) = (layer_a.pixel(i), layer_b.pixel(i));
                let sum: f64 = channels.iter().map(|&(_, c, d)| difference(x[c], y[d])).sum();
                (sum / channels.len() as f64) as f32
            };
            let values: Vec<f32> = (0..a.pixels()).map(mean).collect();
            let values: Vec<f32> =
                values.into_iter().map(|v| if v.is_finite() { v } else { f32::NAN }).collect();
            let largest = values.iter().fold(0.0f32, |m, v| m.max(v.abs()));
            // Equal images are white, so the range must not be empty.
            let largest = if largest > 0.0 { largest } else { 1.0 };
            (values, ValueRange { min: -largest, max: largest }, ColorMap::Diverging)
        }
    };
    let pixels: Vec<[u8; 3]> = values.iter().map(|&v| map.color(range.position(v))).collect();
    write_picture(path, a.width(), a.height(), &pixels)?;
    Ok(range)
}

/// Pairs of layers of one name with a channel in common; at least one pair.
fn common_layers<'a>(
    a: &'a Film,
    b: &'a Film,
    options: &CompareOptions,
) -> Result<Vec<(&'a Layer, &'a Layer)>, CompareError> {
    let size = |film: &Film| (film.width(), film.height());
    if size(a) != size(b) {
        return Err(CompareError::Size { a: size(a), b: size(b) });
    }
    if !(1.0..=1000.0).contains(&options.pixels_per_degree) {
        return Err(CompareError::PixelsPerDegree(options.pixels_per_degree));
    }
    if !options.exposure.is_finite() {
        return Err(CompareError::Exposure(options.exposure));
    }
    let mut pairs: Vec<(&Layer, &Layer)> = match &options.layer {
        Some(name) => vec![(a.require(name)?, b.require(name)?)],
        None => a.layers().iter().filter_map(|l| Some((l, b.layer(l.name())?))).collect(),
    };
    pairs.retain(|(layer_a, layer_b)| !common_channels(layer_a, layer_b).is_empty());
    if pairs.is_empty() {
        let what = options.layer.as_ref().map_or("layer".into(), |l| format!("channel of layer '{l}'"));
        return Err(CompareError::NothingInCommon(what));
    }
    Ok(pairs)
}

fn common_channels<'a>(a: &'a Layer, b: &Layer) -> Vec<(&'a str, usize, usize)> {
    let channels = a.channels().iter().enumerate();
    channels.filter_map(|(i, name)| Some((name.as_str(), i, b.channel(name)?))).collect()
}

fn missing_channels(of: &Layer, in_layer: &Layer) -> Vec<String> {
    let missing = of.channels().iter().filter(|c| in_layer.channel(c).is_none());
    missing.map(|c| format!("{}.{c}", of.name())).collect()
}

fn missing_layers(of: &Film, in_film: &Film) -> Vec<String> {
    let missing = of
        .layers()
        .iter()
        .filter(|a| in_film.layer(a.name()).is_none_or(|b| common_channels(a, b).is_empty()));
    missing.map(|l| l.name().into()).collect()
}

/// `b - a`, 0 for values that are the same though not finite.
fn difference(a: f32, b: f32) -> f64 {
    if a == b || (a.is_nan() && b.is_nan()) { 0.0 } else { f64::from(b) - f64::from(a) }
}

fn compare_layer(film: &Film, a: &Layer, b: &Layer, options: &CompareOptions) -> LayerDifference {
    let channels = common_channels(a, b);
    let (mut squares, mut absolute, mut sum, mut count) = (0.0, 0.0, 0.0, 0u64);
    let (mut different_pixels, mut non_finite_pixels) = (0, 0);
    let (mut max_abs, mut max_at) = (0.0, None);
    for i in 0..film.pixels() {
        let (x, y) = (a.pixel(i), b.pixel(i));
        let (mut differs, mut not_finite) = (false, false);
        for &(_, c, d) in &channels {
            let delta = difference(x[c], y[d]);
            differs |= delta != 0.0;
            if !delta.is_finite() {
                not_finite = true;
                continue;
            }
            squares += delta * delta;
            absolute += delta.abs();
            sum += delta;
            count += 1;
            if delta.abs() > max_abs {
                max_abs = delta.abs();
                max_at = Some([i as u32 % film.width(), i as u32 / film.width()]);
            }
        }
        different_pixels += u64::from(differs);
        non_finite_pixels += u64::from(not_finite);
    }
    let mean = |total: f64| if count > 0 { total / count as f64 } else { 0.0 };
    let map = flip_map(film, a, b, options);
    LayerDifference {
        layer: a.name().into(),
        channels: channels.iter().map(|(name, ..)| (*name).into()).collect(),
        rmse: mean(squares).sqrt(),
        mean_abs: mean(absolute),
        max_abs,
        max_at,
        bias: mean(sum),
        different_pixels,
        non_finite_pixels,
        flip: map.as_ref().map(|m| m.iter().copied().map(f64::from).sum::<f64>() / m.len() as f64),
        flip_max: map.as_ref().map(|m| m.iter().copied().fold(0.0, f32::max).into()),
    }
}

/// `None` unless the layer is a colour in both images.
fn flip_map(film: &Film, a: &Layer, b: &Layer, options: &CompareOptions) -> Option<Vec<f32>> {
    let scale = options.exposure.exp2();
    let colors = |layer: &Layer| -> Option<Vec<[f32; 3]>> {
        let channels = layer.color_channels()?;
        let color = |i| channels.map(|c| layer.pixel(i)[c] * scale);
        Some((0..film.pixels()).map(color).collect())
    };
    let (a, b) = (colors(a)?, colors(b)?);
    Some(flip(film.width() as usize, film.height() as usize, &a, &b, options.pixels_per_degree))
}
