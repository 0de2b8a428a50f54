//! An image in memory.

use super::{ImageError, Tile};

/// Most pixels across or down.
pub const MAX_SIDE: u32 = 65_536;
/// Most pixels in an image.
pub const MAX_PIXELS: u64 = 1 << 28;

/// Channels of a colour.
pub const RGB: &[&str] = &["R", "G", "B"];
/// Channels of a direction.
pub const XYZ: &[&str] = &["X", "Y", "Z"];
/// The channel of a number that is neither colour nor depth.
pub const GREY: &[&str] = &["Y"];
/// The channel of a depth.
pub const Z: &[&str] = &["Z"];

/// Names of the layers that rendering makes.
pub mod names {
    /// Radiance, linear RGB.
    pub const BEAUTY: &str = "beauty";
    /// Fraction of the lights' radiance that arrives, 1 is unshadowed.
    pub const SHADOW: &str = "shadow";
    /// Ambient occlusion, 1 is open.
    pub const AO: &str = "ao";
    /// Unit normal in world space.
    pub const NORMAL: &str = "normal";
    /// Distance from the camera, world units; 1e10 where nothing is hit.
    pub const DEPTH: &str = "depth";
    /// Work done for the pixel.
    pub const COST: &str = "cost";
    /// All of them, in the order in which files are read.
    pub const ALL: [&str; 6] = [BEAUTY, SHADOW, AO, NORMAL, DEPTH, COST];
}

/// One kind of value for every pixel.
#[derive(Clone, Debug)]
pub struct Layer {
    name: String,
    channels: Vec<String>,
    values: Vec<f32>,
}

impl Layer {
    /// Name, unique in the image.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Names of the channels.
    pub fn channels(&self) -> &[String] {
        &self.channels
    }

    /// All values: rows from the top, pixels from the left, the channels of a pixel together.
    pub fn values(&self) -> &[f32] {
        &self.values
    }

    /// All values, to be changed.
    pub fn values_mut(&mut self) -> &mut [f32] {
        &mut self.values
    }

    /// Channels of pixel `index`, which is `y * width + x`.
    ///
    /// # Panics
    /// If `index` is out of range.
    pub fn pixel(&self, index: usize) -> &[f32] {
        let n = self.channels.len();
        &self.values[index * n..][..n]
    }

    /// Position of the channel called `name`.
    pub fn channel(&self, name: &str) -> Option<usize> {
        self.channels.iter().position(|c| c == name)
    }

    /// How each pixel becomes a linear colour: which channels are red, green and blue. Layers with one `Y` are grey;
    /// directions, depth and cost are no colours.
    pub fn color_channels(&self) -> Option<[usize; 3]> {
        match (self.channel("R"), self.channel("G"), self.channel("B")) {
            (Some(r), Some(g), Some(b)) => Some([r, g, b]),
            _ if self.channels == GREY && self.name != names::COST => Some([0; 3]),
            _ => None,
        }
    }
}

/// An image of named layers, all of one size.
#[derive(Clone, Debug)]
pub struct Film {
    width: u32,
    height: u32,
    layers: Vec<Layer>,
}

impl Film {
    /// An image without layers.
    ///
    /// # Errors
    /// [`ImageError::Size`] if a side is 0 or the image is larger than [`MAX_SIDE`] or [`MAX_PIXELS`].
    pub fn new(width: u32, height: u32) -> Result<Self, ImageError> {
        check_size(width.into(), height.into())?;
        Ok(Self { width, height, layers: Vec::new() })
    }

    /// Pixels across.
    pub fn width(&self) -> u32 {
        self.width
    }

    /// Pixels down.
    pub fn height(&self) -> u32 {
        self.height
    }

    /// How many pixels there are.
    pub fn pixels(&self) -> usize {
        self.width as usize * self.height as usize
    }

    /// The layers, in the order in which they were added or, from a file, in the order of [`names::ALL`] and then
    /// by name.
    pub fn layers(&self) -> &[Layer] {
        &self.layers
    }

    /// The layers, to be changed.
    pub fn layers_mut(&mut self) -> &mut [Layer] {
        &mut self.layers
    }

    /// The layer called `name`.
    pub fn layer(&self, name: &str) -> Option<&Layer> {
        self.layers.iter().find(|l| l.name == name)
    }

    /// The layer called `name`, to be changed.
    pub fn layer_mut(&mut self, name: &str) -> Option<&mut Layer> {
        self.layers.iter_mut().find(|l| l.name == name)
    }

    /// The layer called `name`.
    ///
    /// # Errors
    /// [`ImageError::NoLayer`] if there is none.
    pub fn require(&self, name: &str) -> Result<&Layer, ImageError> {
        self.layer(name).ok_or_else(|| ImageError::NoLayer {
            layer: name.into(),
            present: self.layers.iter().map(|l| l.name.as_str()).collect::<Vec<_>>().join(", "),
        })
    }

    /// Adds a layer of zeros.
    ///
    /// # Errors
    /// [`ImageError::Name`] for a bad or repeated name of the layer or of a channel, or no channel at all;
    /// [`ImageError::Memory`].
    pub fn add_layer(&mut self, name: &str, channels: &[&str]) -> Result<&mut Layer, ImageError> {
        let count = self.pixels() * channels.len();
        let mut values = Vec::new();
        values.try_reserve_exact(count).map_err(|_| ImageError::Memory {
            layer: name.into(),
            width: self.width,
            height: self.height,
        })?;
        values.resize(count, 0.0);
        let channels = channels.iter().map(|c| (*c).into()).collect();
        self.push_layer(Layer { name: name.into(), channels, values })
    }

    /// Adds a layer with the given values, ordered as in [`Layer::values`].
    ///
    /// # Errors
    /// [`ImageError::Name`] as in [`Self::add_layer`]; [`ImageError::Encode`] if the number of values is not pixels
    /// times channels.
    pub fn add_layer_with(
        &mut self,
        name: &str,
        channels: &[&str],
        values: Vec<f32>,
    ) -> Result<&mut Layer, ImageError> {
        let expected = self.pixels() * channels.len();
        if values.len() != expected {
            let found = values.len();
            return Err(ImageError::Encode(format!(
                "layer '{name}' has {found} values in place of {expected}"
            )));
        }
        let channels = channels.iter().map(|c| (*c).into()).collect();
        self.push_layer(Layer { name: name.into(), channels, values })
    }

    fn push_layer(&mut self, layer: Layer) -> Result<&mut Layer, ImageError> {
        let bad = |name: &str| Err(ImageError::Name { name: name.into() });
        if !valid_layer_name(&layer.name) || self.layer(&layer.name).is_some() || layer.channels.is_empty() {
            return bad(&layer.name);
        }
        for (i, channel) in layer.channels.iter().enumerate() {
            if !valid_channel_name(channel) || layer.channels[..i].contains(channel) {
                return bad(channel);
            }
        }
        self.layers.push(layer);
        Ok(self.layers.last_mut().expect("just pushed"))
    }

    /// Whether size, layers, channels and every bit of every value are the same; order of layers does not matter.
    pub fn same_bits(&self, other: &Self) -> bool {
        self.same_shape(other)
            && self.layers.iter().all(|a| {
                other.layer(&a.name).is_some_and(|b| {
                    a.values.iter().map(|v| v.to_bits()).eq(b.values.iter().map(|v| v.to_bits()))
                })
            })
    }

    /// Whether size, layers and channels are the same; order of layers does not matter.
    pub fn same_shape(&self, other: &Self) -> bool {
        (self.width, self.height, self.layers.len()) == (other.width, other.height, other.layers.len())
            && self.layers.iter().all(|a| other.layer(&a.name).is_some_and(|b| a.channels == b.channels))
    }

    /// Puts the values of a tile into layer number `layer`: rows from the top, pixels from the left, the channels of a
    /// pixel together.
    ///
    /// # Panics
    /// If there is no such layer, the tile is not inside the image or the number of values does not fit.
    pub fn put_tile(&mut self, layer: usize, tile: &Tile, values: &[f32]) {
        let width = self.width as usize;
        let layer = &mut self.layers[layer];
        let n = layer.channels.len();
        let row = tile.width() as usize * n;
        assert_eq!(values.len(), row * tile.height() as usize);
        for (y, source) in (tile.y..tile.y_end).zip(values.chunks_exact(row)) {
            let start = (y as usize * width + tile.x as usize) * n;
            layer.values[start..][..row].copy_from_slice(source);
        }
    }

    /// Copies a tile of all layers from `other`.
    ///
    /// # Panics
    /// If the two images differ in shape or the tile is not inside them.
    pub fn copy_tile(&mut self, other: &Self, tile: &Tile) {
        let width = self.width as usize;
        for layer in &mut self.layers {
            let source = other.layer(&layer.name).expect("images of the same shape");
            let n = layer.channels.len();
            let row = tile.width() as usize * n;
            for y in tile.y..tile.y_end {
                let start = (y as usize * width + tile.x as usize) * n;
                layer.values[start..][..row].copy_from_slice(&source.values[start..][..row]);
            }
        }
    }
}

/// # Errors
/// [`ImageError::Size`].
pub(super) fn check_size(width: u64, height: u64) -> Result<(), ImageError> {
    let side = 1..=u64::from(MAX_SIDE);
    if side.contains(&width) && side.contains(&height) && width * height <= MAX_PIXELS {
        Ok(())
    } else {
        Err(ImageError::Size { width, height })
    }
}

fn valid_channel_name(name: &str) -> bool {
    valid_layer_name(name) && !name.contains('.')
}

/// Layers of other programs may be nested (`ViewLayer.Combined`), so that only channels must have no dot.
fn valid_layer_name(name: &str) -> bool {
    !name.is_empty() && name.len() < 128 && name.bytes().all(|b| (32..127).contains(&b))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn absurd_sizes_and_names_are_refused() {
        for (width, height) in [(0, 1), (1, 0), (MAX_SIDE + 1, 1), (MAX_SIDE, MAX_SIDE)] {
            assert!(matches!(Film::new(width, height), Err(ImageError::Size { .. })), "{width} {height}");
        }
        let mut film = Film::new(2, 2).unwrap();
        film.add_layer("ao", GREY).unwrap();
        for (name, channels) in
            [("", GREY), ("ao", GREY), ("a\0", GREY), ("b", &["x.y"]), ("b", &["R", "R"]), ("b", &[])]
        {
            assert!(matches!(film.add_layer(name, channels), Err(ImageError::Name { .. })), "{name}");
        }
        assert!(film.add_layer_with("b", RGB, vec![0.0; 11]).is_err());
        assert_eq!(film.require("b").unwrap_err().to_string(), "there is no layer 'b', only ao");
    }

    #[test]
    fn tiles_land_where_they_belong() {
        let mut film = Film::new(3, 2).unwrap();
        film.add_layer("xy", &["X", "Y"]).unwrap();
        let tile = Tile { x: 1, y: 0, x_end: 3, y_end: 2 };
        film.put_tile(0, &tile, &[1., 2., 3., 4., 5., 6., 7., 8.]);
        assert_eq!(film.layers()[0].values(), [0., 0., 1., 2., 3., 4., 0., 0., 5., 6., 7., 8.]);
        let mut copy = Film::new(3, 2).unwrap();
        copy.add_layer("xy", &["X", "Y"]).unwrap();
        assert!(!copy.same_bits(&film));
        copy.copy_tile(&film, &tile);
        assert!(copy.same_bits(&film));
    }
}
