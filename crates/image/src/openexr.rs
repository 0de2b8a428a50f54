//! EXR files.
//!
//! One part, scan lines, ZIP compression, 32-bit floats. The beauty's `R`, `G`, `B` and the depth's `Z` carry no
//! prefix, other channels are called `layer.channel`: any viewer finds the picture, and Blender, Nuke and tev show
//! the other layers by name, which fewer of them do with one part a layer.

use super::{Film, ImageError, file, film::check_size, names};
use ::exr::prelude::{
    AnyChannel, AnyChannels, Encoding, FlatSamples, Image, LayerAttributes, MetaData, ReadChannels as _,
    ReadLayers as _, Text, Vec2, WritableImage as _, read as exr_read,
};
use ::exr::{image::Layer as ExrLayer, meta::attribute::AttributeValue};
use std::{collections::BTreeMap, io::Cursor, path::Path};

/// The bytes of an EXR file; the same image gives the same bytes whatever the order of its layers.
///
/// # Errors
/// [`ImageError::Encode`] if the image has no layer.
pub fn encode_exr(film: &Film) -> Result<Vec<u8>, ImageError> {
    encode(film, None)
}

/// Writes an EXR file, atomically.
///
/// # Errors
/// Those of [`encode_exr`], [`ImageError::Folder`], [`ImageError::Io`].
pub fn write_exr(path: &Path, film: &Film) -> Result<(), ImageError> {
    file::write_bytes(path, &encode_exr(film)?)
}

/// Reads all flat layers of an EXR file.
///
/// `R`, `G`, `B`, `A` and `Y` without a prefix go to the layer `beauty`, `Z` to `depth`; the layers of a file with
/// several parts are called like the parts. Half floats and integers become floats.
///
/// # Errors
/// [`ImageError::Io`]; [`ImageError::Decode`] if the file is not EXR, is damaged, truncated, deep, or has layers of
/// different sizes or channels of lower resolution.
pub fn read_exr(path: &Path) -> Result<Film, ImageError> {
    let bytes = file::read_bytes(path)?;
    decode(&bytes).map_err(|reason| ImageError::Decode { path: path.into(), reason })
}

/// At most one attribute of our own: their order in a file follows a hash that changes from run to run.
pub(super) fn encode(film: &Film, attribute: Option<(&str, &str)>) -> Result<Vec<u8>, ImageError> {
    if film.layers().is_empty() {
        return Err(ImageError::Encode("it has no layers".into()));
    }
    let pixels = film.pixels();
    let mut channels = Vec::new();
    for layer in film.layers() {
        let n = layer.channels().len();
        for (c, channel) in layer.channels().iter().enumerate() {
            let mut samples = Vec::with_capacity(pixels);
            samples.extend(layer.values().iter().skip(c).step_by(n));
            let name = Text::new_or_none(file_name(layer.name(), channel))
                .ok_or_else(|| ImageError::Name { name: channel.clone() })?;
            channels.push(AnyChannel::new(name, FlatSamples::F32(samples)));
        }
    }
    let mut attributes = LayerAttributes::default();
    if let Some((name, value)) = attribute {
        attributes.other.insert(Text::from(name), AttributeValue::Text(Text::from(value)));
    }
    let size = Vec2(film.width() as usize, film.height() as usize);
    let list = AnyChannels::sort(channels.into());
    let image = Image::from_layer(ExrLayer::new(size, attributes, Encoding::SMALL_LOSSLESS, list));
    let mut bytes = Vec::new();
    // Compressed by several threads, but scan lines that are to increase are written in order.
    image.write().to_buffered(Cursor::new(&mut bytes)).map_err(|e| ImageError::Encode(e.to_string()))?;
    Ok(bytes)
}

/// Header of a file, read without its pixels: size and the text of attribute `name`.
pub(super) fn read_header(path: &Path, name: &str) -> Result<((u32, u32), Option<String>), ImageError> {
    let decode = |reason: String| ImageError::Decode { path: path.into(), reason };
    let file = std::fs::File::open(path).map_err(|source| ImageError::Io { path: path.into(), source })?;
    let meta = MetaData::read_from_unbuffered(file, false).map_err(|e| decode(e.to_string()))?;
    let Some(header) = meta.headers.first() else { return Err(decode("it has no layers".into())) };
    let Vec2(width, height) = header.layer_size;
    check_size(width as u64, height as u64).map_err(|e| decode(e.to_string()))?;
    let text = header.own_attributes.other.get(&Text::from(name)).and_then(|value| match value {
        AttributeValue::Text(text) => Some(text.to_string()),
        _ => None,
    });
    Ok(((width as u32, height as u32), text))
}

fn decode(bytes: &[u8]) -> Result<Film, String> {
    let text = |e: ::exr::error::Error| e.to_string();
    // Sizes first: nothing is allocated for a header that promises more than an image may have.
    let meta = MetaData::read_from_buffered(Cursor::new(bytes), false).map_err(text)?;
    let Vec2(width, height) = meta.headers.first().ok_or("it has no layers")?.layer_size;
    check_size(width as u64, height as u64).map_err(|e| e.to_string())?;
    if meta.headers.iter().any(|header| header.layer_size != Vec2(width, height)) {
        return Err("its layers differ in size".into());
    }
    let image = exr_read()
        .no_deep_data()
        .largest_resolution_level()
        .all_channels()
        .all_layers()
        .all_attributes()
        .from_buffered(Cursor::new(bytes))
        .map_err(text)?;
    let mut film = Film::new(width as u32, height as u32).map_err(|e| e.to_string())?;
    let mut layers = BTreeMap::new();
    for part in image.layer_data {
        let part_name = part.attributes.layer_name.map(|n| n.to_string());
        for channel in part.channel_data.list {
            let name = channel.name.to_string();
            let samples = to_floats(channel.sample_data);
            if samples.len() != film.pixels() {
                return Err(format!("channel '{name}' has a lower resolution than the image"));
            }
            let (layer, channel) = split_name(part_name.as_deref(), &name);
            let layer: &mut Channels = layers.entry((rank(&names::ALL, &layer), layer)).or_default();
            if layer.insert((rank(&CHANNELS, &channel), channel), samples).is_some() {
                return Err(format!("channel '{name}' appears twice"));
            }
        }
    }
    for ((_, name), channels) in layers {
        interleave(&mut film, &name, &channels).map_err(|e| e.to_string())?;
    }
    Ok(film)
}

/// Samples of each channel of a layer, by rank and name.
type Channels = BTreeMap<(usize, String), Vec<f32>>;

/// Usual order of channels.
const CHANNELS: [&str; 7] = ["R", "G", "B", "A", "X", "Y", "Z"];

fn rank(order: &[&str], name: &str) -> usize {
    order.iter().position(|n| *n == name).unwrap_or(order.len())
}

fn interleave(film: &mut Film, name: &str, channels: &Channels) -> Result<(), ImageError> {
    let channel_names: Vec<&str> = channels.keys().map(|(_, c)| c.as_str()).collect();
    let layer = film.add_layer(name, &channel_names)?;
    for (c, samples) in channels.values().enumerate() {
        layer.values_mut().iter_mut().skip(c).step_by(channels.len()).zip(samples).for_each(|(v, s)| *v = *s);
    }
    Ok(())
}

fn to_floats(samples: FlatSamples) -> Vec<f32> {
    match samples {
        FlatSamples::F32(values) => values,
        FlatSamples::F16(values) => values.into_iter().map(|v| v.to_f32()).collect(),
        FlatSamples::U32(values) => values.into_iter().map(|v| v as f32).collect(),
    }
}

fn is_bare(layer: &str, channel: &str) -> bool {
    (layer == names::BEAUTY && matches!(channel, "R" | "G" | "B" | "A" | "Y"))
        || (layer == names::DEPTH && channel == "Z")
}

fn file_name(layer: &str, channel: &str) -> String {
    if is_bare(layer, channel) { channel.into() } else { format!("{layer}.{channel}") }
}

fn split_name(part: Option<&str>, name: &str) -> (String, String) {
    let (layer, channel) = match (name.rsplit_once('.'), part) {
        (Some((layer, channel)), _) => (layer, channel),
        (None, Some(part)) if !part.is_empty() => (part, name),
        (None, _) => (if name == "Z" { names::DEPTH } else { names::BEAUTY }, name),
    };
    (layer.into(), channel.into())
}
