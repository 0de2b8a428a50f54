//! Procedural geometry: foliage, hair, buildings, closed creatures and control meshes, seeded and of selectable size.
//!
//! Here: the list of generators, their parameters and the checks on them. Not here: each generator's construction
//! (a file of its own) and where a scene places the result.
//!
//! Lengths are world units, y is up and the ground is `y = 0`. Faces are counter-clockwise seen from outside. The same
//! parameters give the same bits on every machine: trigonometry comes from `libm`, not from the system, and every
//! element draws from a random stream of its own.

mod bamboo;
mod builder;
mod bush;
mod cathedral;
mod city;
mod control;
mod creature;
mod implicit;
mod knots;
mod lumps;
mod particles;
mod random;
mod registry;
mod shapes;
mod stage;
mod strands;
mod subdivide;
#[cfg(test)]
mod tests;

pub use particles::PARTICLES_LIGHT;

use std::collections::BTreeMap;
use umbrage_geom::{PolygonMesh, TriangleMesh};

/// Most triangles that [`generate`] makes, subdivision included.
pub const MAX_TRIANGLES: usize = 1 << 27;

/// Largest subdivision level.
pub const MAX_LEVEL: u32 = 8;

/// What a named parameter may be.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub enum ParameterKind {
    /// A finite number.
    Number {
        /// Used when the parameter is not given.
        default: f64,
        /// Smallest value allowed.
        min: f64,
        /// Largest value allowed.
        max: f64,
    },
    /// A whole number.
    Integer {
        /// Used when the parameter is not given.
        default: u32,
        /// Smallest value allowed.
        min: u32,
        /// Largest value allowed.
        max: u32,
    },
    /// One of a few words; the first is the default.
    Choice {
        /// The words.
        options: &'static [&'static str],
    },
}

/// A named parameter of a generator.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ParameterInfo {
    /// Key in [`Parameters::values`].
    pub name: &'static str,
    /// What it may be.
    pub kind: ParameterKind,
    /// What it does, in a few words.
    pub meaning: &'static str,
}

impl ParameterInfo {
    /// The default, as one would write it.
    pub fn default_text(&self) -> String {
        match self.kind {
            ParameterKind::Number { default, .. } => default.to_string(),
            ParameterKind::Integer { default, .. } => default.to_string(),
            ParameterKind::Choice { options } => options[0].to_owned(),
        }
    }

    /// The values allowed, in words.
    pub fn range_text(&self) -> String {
        match self.kind {
            ParameterKind::Number { min, max, .. } => format!("a number from {min} to {max}"),
            ParameterKind::Integer { min, max, .. } => format!("a whole number from {min} to {max}"),
            ParameterKind::Choice { options } => {
                let quoted: Vec<_> = options.iter().map(|o| format!("'{o}'")).collect();
                quoted.join(" or ")
            }
        }
    }

    fn allows(&self, value: &ParameterValue) -> bool {
        match (self.kind, value) {
            (ParameterKind::Number { min, max, .. }, ParameterValue::Number(x)) => (min..=max).contains(x),
            (ParameterKind::Integer { min, max, .. }, ParameterValue::Number(x)) => {
                (f64::from(min)..=f64::from(max)).contains(x) && x.fract() == 0.0
            }
            (ParameterKind::Choice { options }, ParameterValue::Text(text)) => {
                options.contains(&text.as_str())
            }
            _ => false,
        }
    }
}

/// What a generator makes and takes.
#[derive(Clone, Copy, Debug)]
#[non_exhaustive]
pub struct GeneratorInfo {
    /// Name to give to [`generate`].
    pub name: &'static str,
    /// What it makes, one line.
    pub summary: &'static str,
    /// Parameters beside `seed`, `triangles` and `level`.
    pub parameters: &'static [ParameterInfo],
    /// Whether every object is a union of closed, outward oriented surfaces free of self-intersection.
    pub closed: bool,
    /// Triangles when [`Parameters::triangles`] is not given, at level 0; the result is within 10 % of it.
    pub default_triangles: usize,
    /// Smallest [`Parameters::triangles`] allowed. With the other parameters at their defaults the result is within 10 %
    /// of the request from twice that, and at least 5000, on.
    pub min_triangles: usize,
    /// Whether the triangle count is fixed: a control mesh, which takes neither `triangles` nor `level`.
    pub fixed: bool,
    /// Whether the seed changes the result.
    pub seeded: bool,
    build: fn(&Inputs) -> Generated,
}

/// A value of a named parameter.
#[derive(Clone, Debug, PartialEq)]
pub enum ParameterValue {
    /// A number.
    Number(f64),
    /// A word.
    Text(String),
}

/// What to generate.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Parameters {
    /// Seed of all random choices.
    pub seed: u32,
    /// Triangles wanted before subdivision; `None` is [`GeneratorInfo::default_triangles`].
    pub triangles: Option<usize>,
    /// Levels of linear subdivision: each makes four triangles of one and keeps the shape. `None` is 0.
    pub level: Option<u32>,
    /// Other parameters of the generator by name.
    pub values: BTreeMap<String, ParameterValue>,
}

/// A generated mesh.
#[derive(Clone, Debug, PartialEq)]
pub struct Generated {
    /// The triangles, validated by construction: finite, in named opaque objects.
    pub mesh: TriangleMesh,
    /// The control mesh of a subdivision surface, of which `mesh` is the triangulation.
    pub control: Option<PolygonMesh>,
}

impl From<TriangleMesh> for Generated {
    fn from(mesh: TriangleMesh) -> Self {
        Self { mesh, control: None }
    }
}

/// Why nothing was generated.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum GenerateError {
    /// There is no generator of that name.
    #[error("unknown generator '{name}' (known: {known})")]
    Unknown {
        /// The name asked for.
        name: String,
        /// The names there are.
        known: String,
    },
    /// The generator has no such parameter.
    #[error("generator '{generator}' has no parameter '{parameter}' (known: {known})")]
    UnknownParameter {
        /// The generator.
        generator: &'static str,
        /// The parameter given.
        parameter: String,
        /// The parameters there are.
        known: String,
    },
    /// A parameter has a value that isn't allowed.
    #[error("{parameter} = {value} of generator '{generator}' is not {range}")]
    OutOfRange {
        /// The generator.
        generator: &'static str,
        /// The parameter.
        parameter: String,
        /// The value given.
        value: String,
        /// What is allowed.
        range: String,
    },
    /// More than [`MAX_TRIANGLES`] would be made.
    #[error("generator '{generator}' would make {triangles} triangles, more than {MAX_TRIANGLES}")]
    TooLarge {
        /// The generator.
        generator: &'static str,
        /// Triangles asked for, subdivision included.
        triangles: u128,
    },
}

/// Checked parameters, as a generator sees them.
struct Inputs<'a> {
    info: &'static GeneratorInfo,
    seed: u32,
    triangles: usize,
    values: &'a BTreeMap<String, ParameterValue>,
}

impl Inputs<'_> {
    fn kind(&self, name: &str) -> ParameterKind {
        let parameter = self.info.parameters.iter().find(|p| p.name == name);
        parameter.expect("generators read only parameters they list").kind
    }

    fn number(&self, name: &str) -> f64 {
        match (self.values.get(name), self.kind(name)) {
            (Some(&ParameterValue::Number(x)), _) => x,
            (_, ParameterKind::Number { default, .. }) => default,
            (_, ParameterKind::Integer { default, .. }) => default.into(),
            (_, ParameterKind::Choice { .. }) => unreachable!("'{name}' is a word"),
        }
    }

    fn choice(&self, name: &str) -> &str {
        match (self.values.get(name), self.kind(name)) {
            (Some(ParameterValue::Text(text)), _) => text,
            (_, ParameterKind::Choice { options }) => options[0],
            _ => unreachable!("'{name}' is a number"),
        }
    }
}

/// All generators, in the order of the documentation.
pub fn generators() -> &'static [GeneratorInfo] {
    registry::GENERATORS
}

/// Makes the mesh of the generator `name`.
///
/// # Errors
/// [`GenerateError`] if the generator or a parameter is unknown, a value is out of range, or the result would be too
/// large. Nothing is generated before all of that is known.
pub fn generate(name: &str, parameters: &Parameters) -> Result<Generated, GenerateError> {
    let Some(info) = generators().iter().find(|g| g.name == name) else {
        let known = generators().iter().map(|g| g.name).collect::<Vec<_>>().join(", ");
        return Err(GenerateError::Unknown { name: name.to_owned(), known });
    };
    check_values(info, parameters)?;
    let (triangles, level) = check_size(info, parameters)?;
    let mut generated =
        (info.build)(&Inputs { info, seed: parameters.seed, triangles, values: &parameters.values });
    if level > 0 {
        generated.mesh = subdivide::linear(&generated.mesh, level);
    }
    Ok(generated)
}

fn check_values(info: &'static GeneratorInfo, parameters: &Parameters) -> Result<(), GenerateError> {
    let generator = info.name;
    let common: &[&str] = if info.fixed { &["seed"] } else { &["seed", "triangles", "level"] };
    let unknown = |parameter: &str| {
        let known: Vec<_> = common.iter().copied().chain(info.parameters.iter().map(|p| p.name)).collect();
        GenerateError::UnknownParameter {
            generator,
            parameter: parameter.to_owned(),
            known: known.join(", "),
        }
    };
    if info.fixed && parameters.triangles.is_some() {
        return Err(unknown("triangles"));
    }
    if info.fixed && parameters.level.is_some() {
        return Err(unknown("level"));
    }
    for (name, value) in &parameters.values {
        let known = info.parameters.iter().find(|p| p.name == name).ok_or_else(|| unknown(name))?;
        if !known.allows(value) {
            let value = match value {
                ParameterValue::Number(x) => x.to_string(),
                ParameterValue::Text(text) => format!("'{text}'"),
            };
            let range = known.range_text();
            return Err(GenerateError::OutOfRange { generator, parameter: name.clone(), value, range });
        }
    }
    Ok(())
}

/// Triangles before subdivision, and levels of it.
fn check_size(info: &'static GeneratorInfo, parameters: &Parameters) -> Result<(usize, u32), GenerateError> {
    let generator = info.name;
    let triangles = parameters.triangles.unwrap_or(info.default_triangles);
    let level = parameters.level.unwrap_or(0);
    let out_of_range = |parameter: &str, value: String, range: String| GenerateError::OutOfRange {
        generator,
        parameter: parameter.to_owned(),
        value,
        range,
    };
    if triangles < info.min_triangles {
        let range = format!("{} or more", info.min_triangles);
        return Err(out_of_range("triangles", triangles.to_string(), range));
    }
    if level > MAX_LEVEL {
        return Err(out_of_range(
            "level",
            level.to_string(),
            format!("a whole number from 0 to {MAX_LEVEL}"),
        ));
    }
    let total = (triangles as u128) << (2 * level);
    if total > MAX_TRIANGLES as u128 {
        return Err(GenerateError::TooLarge { generator, triangles: total });
    }
    Ok((triangles, level))
}
