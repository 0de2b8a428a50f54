//! Scene files: TOML to [`Scene`].
//!
//! Here: errors, and the settings at the top of a file. Not here: reading values with their places (`fields.rs`), meshes
//! and objects (`objects.rs`), transforms (`placement.rs`), lights (`lights.rs`). The format is in the crate's README.

mod fields;
mod lights;
mod objects;
mod placement;

use crate::mesh_file::one_line;
use crate::scene::{Ambient, Camera, Radius, Scene, Settings};
use fields::{FieldError, Fields, Value};
use std::path::{Path, PathBuf};
use std::{fs, io};
use toml::de::{DeTable, DeValue};
use umbrage_geom::Falloff;
use umbrage_geom::glam::Vec3;

/// Most pixels along one side of an image.
pub const MAX_SIDE: u32 = 65_536;

/// Most samples of one kind in a pixel.
pub const MAX_SAMPLES: u32 = 1 << 20;

/// Why a scene file can't be used. The text is one line and names the file, the line and the key.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SceneError {
    /// The file could not be read.
    #[error("{}: cannot read it: {source}", .path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// What the system says.
        source: io::Error,
    },
    /// The path is a folder.
    #[error("{}: it is a folder, not a scene file", .path.display())]
    Folder {
        /// The folder.
        path: PathBuf,
    },
    /// Something in the file is wrong.
    #[error("{}:{line}:{column}: {message}", .path.display())]
    At {
        /// The file, or `scene` for a scene that was not read from a file.
        path: PathBuf,
        /// Number of the line, from 1.
        line: usize,
        /// Number of the character in the line, from 1.
        column: usize,
        /// What is wrong.
        message: String,
    },
}

impl Scene {
    /// Reads a scene file and the meshes it names.
    ///
    /// # Errors
    /// [`SceneError`], which names the file, the line and the key.
    pub fn load(path: &Path) -> Result<Self, SceneError> {
        if path.is_dir() {
            return Err(SceneError::Folder { path: path.into() });
        }
        let read = |source| SceneError::Read { path: path.into(), source };
        let bytes = fs::read(path).map_err(read)?;
        let text = std::str::from_utf8(&bytes).map_err(|e| {
            let valid = String::from_utf8_lossy(&bytes[..e.valid_up_to()]).into_owned();
            let end = valid.len();
            FieldError::new(end..end, "not UTF-8 text: this is not a scene file").at(path, &valid)
        })?;
        let folder = path.parent().unwrap_or(Path::new(""));
        parse(text, folder).map_err(|flaw| flaw.at(path, text))
    }

    /// Reads a scene from text; mesh files are relative to `folder`.
    ///
    /// # Errors
    /// [`SceneError::At`], with `scene` in place of a file.
    pub fn parse(text: &str, folder: &Path) -> Result<Self, SceneError> {
        parse(text, folder).map_err(|flaw| flaw.at(Path::new("scene"), text))
    }
}

impl FieldError {
    fn at(self, path: &Path, text: &str) -> SceneError {
        let before = text.get(..self.span.start).unwrap_or(text);
        let line = before.bytes().filter(|&b| b == b'\n').count() + 1;
        let column = before.chars().rev().take_while(|&c| c != '\n').count() + 1;
        SceneError::At { path: path.into(), line, column, message: one_line(&self.message) }
    }
}

fn parse(text: &str, folder: &Path) -> Result<Scene, FieldError> {
    let table = DeTable::parse(text).map_err(|e| FieldError::new(e.span().unwrap_or(0..0), e.message()))?;
    let top = Fields::new("scene", table.get_ref(), 0..0);
    let mut settings = Settings::default();
    if let Some(image) = top.table("image")? {
        read_image(image, &mut settings)?;
    }
    if let Some(methods) = top.table("methods")? {
        read_methods(methods, &mut settings)?;
    }
    let camera = top.table("camera")?.map(read_camera).transpose()?;
    let ambient = top.table("ambient")?.map(read_ambient).transpose()?;
    let background = top.value("background").map(|v| v.color()).transpose()?.unwrap_or([0.0; 3]);
    let lights = lights::read(&top)?;
    let geometry = objects::read(&top, folder)?;
    top.finish()?;
    let mut scene = Scene {
        camera: Camera::default(),
        meshes: geometry.meshes,
        instances: geometry.instances,
        materials: geometry.materials,
        lights,
        ambient,
        background,
        settings,
    };
    scene.camera = camera.unwrap_or_else(|| Camera::around(scene.bounds()));
    Ok(scene)
}

fn read_image(image: Fields<'_>, settings: &mut Settings) -> Result<(), FieldError> {
    image.whole_into("width", 1..=MAX_SIDE, &mut settings.width)?;
    image.whole_into("height", 1..=MAX_SIDE, &mut settings.height)?;
    image.whole_into("spp", 1..=MAX_SAMPLES, &mut settings.spp)?;
    image.whole_into("seed", 0..=u32::MAX, &mut settings.seed)?;
    if let Some(value) = image.value("exposure") {
        settings.exposure = value.number_in(-100.0..=100.0)?;
    }
    image.finish()
}

fn read_methods(methods: Fields<'_>, settings: &mut Settings) -> Result<(), FieldError> {
    let names =
        [("shadows", &mut settings.shadows), ("ao", &mut settings.ao), ("surfaces", &mut settings.surfaces)];
    for (key, name) in names {
        if let Some(value) = methods.value(key) {
            let text = value.text()?;
            if text.is_empty() {
                return Err(value.flaw("must name a method"));
            }
            *name = text.into();
        }
    }
    if let Some(value) = methods.value("grid_cache") {
        settings.grid_cache = value.text()?.parse().map_err(|e| value.flaw(format!("can't be used: {e}")))?;
    }
    methods.whole_into("shadow_samples", 1..=MAX_SAMPLES, &mut settings.shadow_samples)?;
    methods.whole_into("ao_samples", 1..=MAX_SAMPLES, &mut settings.ao_samples)?;
    methods.finish()
}

fn read_camera(camera: Fields<'_>) -> Result<Camera, FieldError> {
    let mut read = Camera {
        position: camera.required("position")?.vector()?,
        target: camera.required("target")?.vector()?,
        ..Camera::default()
    };
    let view = Vec3::from(read.target) - Vec3::from(read.position);
    if view.length() == 0.0 || !view.length().is_finite() {
        return Err(camera.required("target")?.flaw("must not be the position: the camera looks at itself"));
    }
    let up = camera.value("up");
    if let Some(up) = &up {
        read.up = up.direction()?;
    }
    // An angle below a few millionths can't be told from 0 in single precision.
    let across = Vec3::from(read.up).normalize_or_zero().cross(view.normalize_or_zero());
    if across.length() < 1e-5 {
        let place = up.map_or_else(|| camera.required("target"), Ok)?;
        return Err(place.flaw("leaves 'up' along the view; set 'up' to another direction"));
    }
    if let Some(value) = camera.value("fov") {
        read.fov = value.number()?;
        if !(read.fov > 0.0 && read.fov < 180.0) {
            return Err(value.flaw(format!("must be above 0 and below 180 degrees, not {}", read.fov)));
        }
    }
    if let Some(value) = camera.value("lens_radius") {
        read.lens_radius = value.number_in(0.0..=1e12)?;
    }
    read.focus_distance = camera.value("focus_distance").map(|v| v.positive()).transpose()?;
    camera.finish()?;
    Ok(read)
}

fn read_ambient(ambient: Fields<'_>) -> Result<Ambient, FieldError> {
    let radiance = ambient.value("radiance").map(|v| v.color()).transpose()?.unwrap_or([1.0; 3]);
    let radius = ambient.value("radius").map(|v| read_radius(&v)).transpose()?.unwrap_or_default();
    let falloff = ambient.value("falloff").map(|v| read_falloff(&v).map(|f| (f, v))).transpose()?;
    let falloff = match falloff {
        Some((falloff, value)) if radius == Radius::Unbounded && falloff != Falloff::Constant => {
            return Err(value.flaw("needs a radius to fade over"));
        }
        Some((falloff, _)) => falloff,
        None => Falloff::default(),
    };
    ambient.finish()?;
    Ok(Ambient { radiance, radius, falloff })
}

fn read_radius(value: &Value<'_>) -> Result<Radius, FieldError> {
    const EXPECTED: &str = "a length above 0, or a share of the diagonal such as \"5%\"";
    match value.raw() {
        DeValue::String(text) => {
            let percent = text.strip_suffix('%').and_then(|t| t.trim().parse::<f32>().ok());
            match percent {
                Some(percent) if percent > 0.0 && percent.is_finite() => {
                    Ok(Radius::OfDiagonal(percent / 100.0))
                }
                Some(percent) => Err(value.flaw(format!("must be above 0, not {percent}%"))),
                None => Err(value.expected(EXPECTED)),
            }
        }
        DeValue::Integer(_) | DeValue::Float(_) => Ok(Radius::Absolute(value.positive()?)),
        _ => Err(value.expected(EXPECTED)),
    }
}

fn read_falloff(value: &Value<'_>) -> Result<Falloff, FieldError> {
    let falloff = match value.raw() {
        DeValue::String(text) => text.parse(),
        DeValue::Array(_) => {
            Falloff::table(value.items()?.iter().map(Value::number).collect::<Result<_, _>>()?)
        }
        _ => return Err(value.expected("the name of a falloff or an array of weights")),
    };
    falloff.map_err(|e| value.flaw(format!("can't be used: {e}")))
}
