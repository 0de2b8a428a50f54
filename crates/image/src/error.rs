use super::shard::ShardError;
use std::path::PathBuf;

/// Why an image could not be made, written, read or merged. Every message is one line.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ImageError {
    /// The file name does not end in `.exr` or `.png`.
    #[error("{}: unsupported image type, the name must end in .exr or .png", .path.display())]
    Extension {
        /// The file.
        path: PathBuf,
    },
    /// Part files of a sharded image must be EXR.
    #[error("{}: a part of an image must be an .exr file", .path.display())]
    PartExtension {
        /// The file.
        path: PathBuf,
    },
    /// The folder that the file should go to does not exist, or is no folder.
    #[error("{}: the folder {} does not exist", .path.display(), .folder.display())]
    Folder {
        /// The file.
        path: PathBuf,
        /// The folder.
        folder: PathBuf,
    },
    /// The file to write is a folder.
    #[error("{}: is a folder", .path.display())]
    IsFolder {
        /// The folder.
        path: PathBuf,
    },
    /// The file system refused.
    #[error("{}: {source}", .path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What it said.
        source: std::io::Error,
    },
    /// The file is not an image of the type its name says, is truncated or of a kind not supported.
    #[error("{}: {reason}", .path.display())]
    Decode {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        reason: String,
    },
    /// The image could not be turned into a file.
    #[error("the image cannot be encoded: {0}")]
    Encode(String),
    /// The size is zero or larger than [`MAX_SIDE`](super::MAX_SIDE) or [`MAX_PIXELS`](super::MAX_PIXELS) allow.
    #[error("{width} x {height} pixels is not a size an image can have")]
    Size {
        /// Pixels across.
        width: u64,
        /// Pixels down.
        height: u64,
    },
    /// There is not enough memory for a layer.
    #[error("not enough memory for layer '{layer}' of {width} x {height} pixels")]
    Memory {
        /// Name of the layer.
        layer: String,
        /// Pixels across.
        width: u32,
        /// Pixels down.
        height: u32,
    },
    /// A layer or channel name is empty, contains a dot or something other than printable ASCII, or is used twice.
    #[error("'{name}' cannot be the name of another layer or channel")]
    Name {
        /// The name.
        name: String,
    },
    /// The image has no such layer.
    #[error("there is no layer '{layer}', only {present}")]
    NoLayer {
        /// The layer asked for.
        layer: String,
        /// The layers there are.
        present: String,
    },
    /// The layer has several channels where one is needed, or cannot be shown as a colour.
    #[error("layer '{layer}' with channels {channels} cannot be shown {how}")]
    Channels {
        /// Name of the layer.
        layer: String,
        /// Its channels.
        channels: String,
        /// `in colour` or `as one number a pixel`.
        how: &'static str,
    },
    /// Part files don't fit together.
    #[error(transparent)]
    Shard(#[from] ShardError),
}
