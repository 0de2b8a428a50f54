//! What can be chosen of a study.

use super::StudyError;
use std::time::Duration;
use umbrage_bake::VAxis;
use umbrage_scene::Radius;

/// Which points ask.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Per {
    /// Vertices of the mesh, or of all instances, with smooth normals.
    Vertex,
    /// Texels that the texture coordinates cover, of an image of this size.
    Texel {
        /// Width and height, texels.
        size: [u32; 2],
        /// Which way v runs.
        v_axis: VAxis,
    },
    /// Points that the camera sees.
    Camera,
}

/// Settings of a study. Start from the default: vertices, 2000 receivers, radii unbounded and 10 % of the diagonal, one minute.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct StudyOptions {
    /// Which points ask.
    pub per: Per,
    /// How many of them are drawn, 16 to a million.
    pub receivers: usize,
    /// How far occluders count for the sky, a question each.
    pub radii: Vec<Radius>,
    /// About how long the study may take, structures included: methods that are not asked in time are named.
    pub budget: Duration,
    /// Names of methods to measure; empty for all.
    pub methods: Vec<String>,
    /// Whether to render pictures for the report.
    pub pictures: bool,
    /// Seed of all random choices.
    pub seed: u32,
}

impl Default for StudyOptions {
    fn default() -> Self {
        Self {
            per: Per::Vertex,
            receivers: 2000,
            radii: vec![Radius::Unbounded, Radius::OfDiagonal(0.1)],
            budget: Duration::from_secs(60),
            methods: Vec::new(),
            pictures: true,
            seed: 0,
        }
    }
}

impl StudyOptions {
    /// Sets [`Self::per`].
    #[must_use]
    pub fn with_per(self, per: Per) -> Self {
        Self { per, ..self }
    }

    /// Sets [`Self::receivers`].
    #[must_use]
    pub fn with_receivers(self, receivers: usize) -> Self {
        Self { receivers, ..self }
    }

    /// Sets [`Self::radii`].
    #[must_use]
    pub fn with_radii(self, radii: Vec<Radius>) -> Self {
        Self { radii, ..self }
    }

    /// Sets [`Self::budget`].
    #[must_use]
    pub fn with_budget(self, budget: Duration) -> Self {
        Self { budget, ..self }
    }

    /// Sets [`Self::methods`].
    #[must_use]
    pub fn with_methods(self, methods: Vec<String>) -> Self {
        Self { methods, ..self }
    }

    /// Sets [`Self::pictures`].
    #[must_use]
    pub fn with_pictures(self, pictures: bool) -> Self {
        Self { pictures, ..self }
    }

    /// Sets [`Self::seed`].
    #[must_use]
    pub fn with_seed(self, seed: u32) -> Self {
        Self { seed, ..self }
    }

    /// Checks every option.
    ///
    /// # Errors
    /// [`StudyError::Option`].
    pub fn validate(&self) -> Result<(), StudyError> {
        let bad = |what, value: String, range| Err(StudyError::Option { what, value, range });
        if !(16..=1_000_000).contains(&self.receivers) {
            return bad("number of receivers", self.receivers.to_string(), "16 to 1000000");
        }
        if self.budget < Duration::from_secs(1) || self.budget > Duration::from_secs(7 * 24 * 3600) {
            return bad("budget", format!("{:?}", self.budget), "one second to a week");
        }
        let lengths = self.radii.iter().map(|radius| match *radius {
            Radius::Absolute(length) | Radius::OfDiagonal(length) => length,
            _ => 1.0,
        });
        if let Some(length) = lengths.into_iter().find(|length| !(*length > 0.0 && length.is_finite())) {
            return bad("radius", length.to_string(), "more than 0");
        }
        let known: Vec<&str> = super::candidate::method_names();
        if let Some(name) = self.methods.iter().find(|name| !known.contains(&name.as_str())) {
            return bad("method", name.clone(), "a name of a shadow, ambient occlusion or surface method");
        }
        Ok(())
    }

    /// Whether a method is to be measured.
    pub(crate) fn wants(&self, method: &str) -> bool {
        self.methods.is_empty() || self.methods.iter().any(|name| name == method)
    }
}
