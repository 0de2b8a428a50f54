//! PNG files: pictures in sRGB, grey pictures and heat maps of single numbers.

use super::{ColorMap, Film, ImageError, Layer, RGB, color, file, film::check_size, names};
use ::image::{
    ExtendedColorType, ImageDecoder as _, ImageEncoder as _,
    codecs::png::{CompressionType, FilterType, PngDecoder, PngEncoder},
};
use std::{io::Cursor, path::Path};

/// The numbers that the two ends of a colour or grey scale stand for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ValueRange {
    /// Darkest, or first colour of the map.
    pub min: f32,
    /// Brightest, or last colour of the map.
    pub max: f32,
}

impl ValueRange {
    /// From 0 to 1.
    pub const UNIT: Self = Self { min: 0.0, max: 1.0 };

    /// Smallest and largest finite value; 0 to 0 if there is none.
    pub fn of(values: &[f32]) -> Self {
        let finite = || values.iter().copied().filter(|v| v.is_finite());
        let min = finite().fold(f32::INFINITY, f32::min);
        let max = finite().fold(f32::NEG_INFINITY, f32::max);
        if min <= max { Self { min, max } } else { Self { min: 0.0, max: 0.0 } }
    }

    /// Where `value` lies: 0 at the minimum, 1 at the maximum, not clamped; 0 for any number if the two are equal.
    pub fn position(self, value: f32) -> f32 {
        if value.is_nan() {
            return f32::NAN;
        }
        let (min, max) = (f64::from(self.min), f64::from(self.max));
        if max > min { ((f64::from(value) - min) / (max - min)) as f32 } else { 0.0 }
    }
}

/// The bytes of a PNG file of `width` x `height` 8-bit sRGB pixels.
///
/// # Errors
/// [`ImageError::Encode`], [`ImageError::Size`].
pub fn encode_png(width: u32, height: u32, rgb: &[[u8; 3]]) -> Result<Vec<u8>, ImageError> {
    encode(width, height, rgb.as_flattened(), ExtendedColorType::Rgb8)
}

/// Writes a layer as a picture, atomically: values times `2^exposure`, clamped to `[0, 1]`, sRGB curve. NaN is black.
///
/// # Errors
/// [`ImageError::NoLayer`]; [`ImageError::Channels`] if the layer is no colour (see [`Layer::color_channels`]);
/// [`ImageError::Folder`], [`ImageError::Io`].
pub fn write_png(path: &Path, film: &Film, layer: &str, exposure: f32) -> Result<(), ImageError> {
    let layer = film.require(layer)?;
    let channels = layer.color_channels().ok_or_else(|| channels_error(layer, "in colour"))?;
    let scale = exposure.exp2();
    let pixels: Vec<[u8; 3]> = (0..film.pixels())
        .map(|i| {
            let pixel = layer.pixel(i);
            channels.map(|c| color::linear_to_srgb8(pixel[c] * scale))
        })
        .collect();
    write_picture(path, film.width(), film.height(), &pixels)
}

/// Writes 8-bit sRGB pixels, atomically.
///
/// # Errors
/// Those of [`encode_png`], [`ImageError::Folder`], [`ImageError::Io`].
pub fn write_picture(path: &Path, width: u32, height: u32, rgb: &[[u8; 3]]) -> Result<(), ImageError> {
    file::write_bytes(path, &encode_png(width, height, rgb)?)
}

/// Writes a layer with one channel as a grey picture, atomically: the ends of `range` (default: that of the finite
/// values) become black and white, linearly and without an sRGB curve. NaN is black. Returns the range.
///
/// # Errors
/// [`ImageError::NoLayer`]; [`ImageError::Channels`] if the layer has several channels; [`ImageError::Folder`],
/// [`ImageError::Io`].
pub fn write_grey(
    path: &Path,
    film: &Film,
    layer: &str,
    range: Option<ValueRange>,
) -> Result<ValueRange, ImageError> {
    let values = scalar(film, layer)?;
    let range = range.unwrap_or_else(|| ValueRange::of(values));
    // The cast saturates and takes NaN to 0.
    let bytes: Vec<u8> = values.iter().map(|&v| (range.position(v) * 255.0 + 0.5) as u8).collect();
    file::write_bytes(path, &encode(film.width(), film.height(), &bytes, ExtendedColorType::L8)?)?;
    Ok(range)
}

/// Writes a layer with one channel in the colours of `map`, atomically; the ends of `range` (default: that of the
/// finite values) get its first and last colour, NaN is grey. Returns the range.
///
/// # Errors
/// Those of [`write_grey`].
pub fn write_heat_map(
    path: &Path,
    film: &Film,
    layer: &str,
    map: ColorMap,
    range: Option<ValueRange>,
) -> Result<ValueRange, ImageError> {
    let values = scalar(film, layer)?;
    let range = range.unwrap_or_else(|| ValueRange::of(values));
    let pixels: Vec<[u8; 3]> = values.iter().map(|&v| map.color(range.position(v))).collect();
    write_picture(path, film.width(), film.height(), &pixels)?;
    Ok(range)
}

/// Reads a PNG file of any depth into a layer `beauty` of linear light: samples are taken as sRGB, in `[0, 1]`; grey
/// becomes red, green and blue; alpha is dropped.
///
/// # Errors
/// [`ImageError::Io`]; [`ImageError::Decode`] if the file is not PNG, is damaged, truncated or too large.
pub fn read_png(path: &Path) -> Result<Film, ImageError> {
    let bytes = file::read_bytes(path)?;
    decode(&bytes).map_err(|reason| ImageError::Decode { path: path.into(), reason })
}

fn decode(bytes: &[u8]) -> Result<Film, String> {
    let text = |e: ::image::ImageError| e.to_string();
    let decoder = PngDecoder::new(Cursor::new(bytes)).map_err(text)?;
    let (width, height) = decoder.dimensions();
    check_size(width.into(), height.into()).map_err(|e| e.to_string())?;
    let picture = ::image::DynamicImage::from_decoder(decoder).map_err(text)?;
    let mut film = Film::new(width, height).map_err(|e| e.to_string())?;
    let layer = film.add_layer(names::BEAUTY, RGB).map_err(|e| e.to_string())?;
    let linear: Vec<f32> =
        (0..=u16::MAX).map(|v| color::srgb_to_linear(f64::from(v) / 65_535.0) as f32).collect();
    // 8-bit samples widen to 257 times their value, which divides to exactly the same fraction.
    for (value, sample) in layer.values_mut().iter_mut().zip(picture.into_rgb16().as_raw()) {
        *value = linear[usize::from(*sample)];
    }
    Ok(film)
}

fn encode(width: u32, height: u32, bytes: &[u8], color: ExtendedColorType) -> Result<Vec<u8>, ImageError> {
    check_size(width.into(), height.into())?;
    if bytes.len() as u64 * 8 != u64::from(width) * u64::from(height) * u64::from(color.bits_per_pixel()) {
        return Err(ImageError::Encode(format!("{} bytes are not {width} x {height} pixels", bytes.len())));
    }
    let mut file = Vec::new();
    PngEncoder::new_with_quality(&mut file, CompressionType::Default, FilterType::Adaptive)
        .write_image(bytes, width, height, color)
        .map_err(|e| ImageError::Encode(e.to_string()))?;
    Ok(file)
}

fn scalar<'a>(film: &'a Film, layer: &str) -> Result<&'a [f32], ImageError> {
    let layer = film.require(layer)?;
    if layer.channels().len() == 1 {
        Ok(layer.values())
    } else {
        Err(channels_error(layer, "as one number a pixel"))
    }
}

fn channels_error(layer: &Layer, how: &'static str) -> ImageError {
    ImageError::Channels { layer: layer.name().into(), channels: layer.channels().join(", "), how }
}
