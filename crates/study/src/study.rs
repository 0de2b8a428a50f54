//! What a study found.

use super::Pictures;
use serde::Serialize;
use umbrage_scene::Radius;

/// Everything that a study measured.
#[derive(Clone, Debug, Serialize)]
pub struct Study {
    /// Name of the mesh or scene.
    pub subject: String,
    /// Triangles of all instances.
    pub triangles: usize,
    /// Whether every triangle blocks all light.
    pub opaque: bool,
    /// Which points asked: `vertex`, `texel` or `camera`.
    pub per: &'static str,
    /// Where it ran.
    pub machine: Machine,
    /// Seconds that it took.
    pub seconds: f64,
    /// Seconds that were given.
    pub budget: f64,
    /// What was asked, and how methods answered.
    pub questions: Vec<Answers>,
    /// Structures, with those that were never made.
    pub structures: Vec<StructureMade>,
    /// Pictures, if asked for.
    #[serde(skip)]
    pub pictures: Option<Pictures>,
}

/// The machine and the program.
#[derive(Clone, Debug, Serialize)]
pub struct Machine {
    /// As the system names it.
    pub processor: String,
    /// Instructions in use: `scalar`, `avx2` or `avx512`.
    pub instructions: String,
    /// Threads that answered.
    pub threads: usize,
    /// `linux` and the like.
    pub system: &'static str,
    /// Version of the crate.
    pub version: &'static str,
    /// Commit that the caller says the program was made of.
    pub commit: Option<String>,
}

/// One question and its answers.
#[derive(Clone, Debug, Serialize)]
pub struct Answers {
    /// Short name: `sky-inf`, `sky-10%`, `light-0`, `surfaces`.
    pub question: String,
    /// In words.
    pub title: String,
    /// How far occluders count, if the sky was asked about.
    #[serde(skip)]
    pub radius: Option<Radius>,
    /// Points that asked.
    pub receivers: usize,
    /// Mean of the reference.
    pub mean: f64,
    /// Random rays of the reference for each receiver.
    pub reference_rays: u64,
    /// Root mean square of the reference's standard errors.
    pub reference_standard_error: f64,
    /// Standard error of the reference's mean.
    pub reference_standard_error_of_mean: f64,
    /// Methods with settings, measured.
    pub rows: Vec<Row>,
    /// Methods that were not measured.
    pub missing: Vec<Missing>,
}

/// A method with its settings.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    /// Name.
    pub method: &'static str,
    /// Whether each ray has the answer of a loop over all triangles.
    pub exact: bool,
    /// For people: `64 rays, threshold 0.3`.
    pub settings: String,
    /// Rays of a receiver.
    pub rays: Option<u32>,
    /// Threshold of prefiltering.
    pub threshold: Option<f32>,
    /// Edges of micropolygons, pixels.
    pub pixels: Option<f32>,
    /// Seconds to build everything that it needs, the wide BVH included.
    pub build_s: f64,
    /// Bytes of that.
    pub bytes: usize,
    /// Median seconds of a pass over all receivers.
    pub time_s: f64,
    /// Quartiles of the passes, seconds.
    pub time_quartiles_s: [f64; 2],
    /// Timed passes.
    pub passes: usize,
    /// Million rays a second.
    pub mrays_s: f64,
    /// Mean signed error over all passes; more than 0 is too bright.
    pub bias: f64,
    /// Standard error of [`Self::bias`], the reference's included.
    pub bias_standard_error: f64,
    /// Root mean square error of a receiver, without what the reference errs by.
    pub rmse: f64,
    /// Largest error of a receiver in any pass, that of the reference included.
    pub largest_error: f64,
    /// Nodes entered and triangles tested for each ray, by methods that count.
    pub work: Option<[f64; 2]>,
    /// Whether no other row is both faster and nearer to the reference.
    pub pareto: bool,
}

/// A method that was not measured.
#[derive(Clone, Debug, Serialize)]
pub struct Missing {
    /// Name, with settings if others were measured.
    pub method: String,
    /// Why.
    pub reason: String,
}

/// A structure over the occluders.
#[derive(Clone, Debug, Serialize)]
pub struct StructureMade {
    /// Name.
    pub name: &'static str,
    /// Whether some method asked for it.
    pub made: bool,
    /// Seconds to build it, unless it grows while rays are traced.
    pub build_s: Option<f64>,
    /// Bytes, unless it grows while rays are traced.
    pub bytes: Option<usize>,
}

impl Machine {
    /// This machine, with the current pool of threads.
    pub(crate) fn this() -> Self {
        let named = std::fs::read_to_string("/proc/cpuinfo").ok().and_then(|text| {
            let line = text.lines().find(|line| line.starts_with("model name"))?;
            Some(line.split_once(':')?.1.trim().to_owned())
        });
        Self {
            processor: named.unwrap_or_else(|| std::env::consts::ARCH.into()),
            instructions: umbrage_geom::simd::BackEnd::best().to_string(),
            threads: rayon::current_num_threads(),
            system: std::env::consts::OS,
            version: env!("CARGO_PKG_VERSION"),
            commit: None,
        }
    }
}
