//! Methods with settings, ready to answer.

use super::{
    StudyError, StudyOptions, Subject,
    question::{Asked, Question},
};
use rayon::prelude::*;
use std::time::{Duration, Instant};
use umbrage_accel::Counters;
use umbrage_aomask::{Outputs, Pattern, PatternOptions, Receiver};
use umbrage_geom::{
    Ray,
    glam::Vec2,
    sampling::{combine, sobol_2d},
};
use umbrage_query::{
    Answers, AoMethod, Engine, Exactness, LightRay, QueryError, ShadowMethod, Sky, Structure, SurfaceMode,
    engine::{self, Report, ShadowOptions},
};
use umbrage_render::LightSampler;

/// Rays into the sky.
const SKY_RAYS: [u32; 7] = [16, 32, 64, 128, 256, 512, 1024];

/// Samples of a light.
const LIGHT_RAYS: [u32; 5] = [1, 4, 16, 64, 256];

/// Thresholds of prefiltering.
const THRESHOLDS: [f32; 3] = [0.1, 0.3, 1.0];

/// Receivers that a thread answers in turn.
const BLOCK: usize = 64;

/// Names of everything that a study can measure.
pub(crate) fn method_names() -> Vec<&'static str> {
    let shadows = ShadowMethod::ALL.iter().map(|method| method.name());
    let sky = AoMethod::ALL.iter().map(|method| method.name());
    let surfaces = SurfaceMode::ALL.iter().map(|mode| mode.name());
    shadows.chain(sky).chain(surfaces).collect()
}

/// A method with settings.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Candidate {
    pub method: Method,
    pub rays: u32,
    pub threshold: Option<f32>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Method {
    Sky(AoMethod),
    Light(ShadowMethod),
}

impl Candidate {
    /// All methods with all settings for a question, fewer rays first.
    pub(crate) fn all(question: &Question, options: &StudyOptions) -> Vec<Self> {
        let methods: Vec<(Method, bool)> = match question {
            Question::Sky { .. } => {
                AoMethod::ALL.iter().map(|&m| (Method::Sky(m), m == AoMethod::Prefilter)).collect()
            }
            Question::Light { .. } => {
                ShadowMethod::ALL.iter().map(|&m| (Method::Light(m), m == ShadowMethod::Prefilter)).collect()
            }
        };
        let rays: &[u32] = match question {
            Question::Sky { .. } => &SKY_RAYS,
            Question::Light { .. } => &LIGHT_RAYS,
        };
        let mut all = Vec::new();
        for &rays in rays {
            for &(method, has_threshold) in methods.iter().filter(|(method, _)| options.wants(method.name()))
            {
                if has_threshold {
                    all.extend(THRESHOLDS.map(|t| Self { method, rays, threshold: Some(t) }));
                } else {
                    all.push(Self { method, rays, threshold: None });
                }
            }
        }
        all
    }

    /// What it is but for the number of rays.
    pub(crate) fn curve(&self) -> (Method, Option<u32>) {
        (self.method, self.threshold.map(f32::to_bits))
    }

    /// For people.
    pub(crate) fn settings(&self) -> String {
        let rays = if self.rays == 1 { "1 ray".into() } else { format!("{} rays", self.rays) };
        self.threshold.map_or(rays.clone(), |threshold| format!("{rays}, threshold {threshold}"))
    }
}

impl Method {
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Sky(method) => method.name(),
            Self::Light(method) => method.name(),
        }
    }

    pub(crate) fn is_exact(self) -> bool {
        let exactness = match self {
            Self::Sky(method) => method.exactness(),
            Self::Light(method) => method.exactness(),
        };
        exactness == Exactness::Exact
    }
}

/// A candidate at work.
pub(crate) struct Running<'a> {
    pub candidate: Candidate,
    engine: Box<dyn Engine + 'a>,
    work: Work,
    receivers: Vec<Receiver>,
    asked: &'a Asked,
    seed: u32,
    pub answers: Vec<f32>,
    /// Time to make it, with structures that no candidate had made before.
    pub made_in: Duration,
    pub times: Vec<f64>,
}

/// What is asked of the engine.
enum Work {
    Sky { pattern: Pattern, radius: f32 },
    Light(LightQuestion),
}

impl<'a> Running<'a> {
    /// Makes a candidate ready; `Err(Unsupported)` if it can't answer.
    pub(crate) fn new(
        candidate: Candidate,
        subject: &'a Subject,
        asked: &'a Asked,
        seed: u32,
        progress: Report<'_>,
    ) -> Result<Self, QueryError> {
        let (start, occluders) = (Instant::now(), subject.occluders());
        let (engine, work) = match (candidate.method, asked.question) {
            (Method::Sky(method), Question::Sky { radius, .. }) => {
                let pattern = PatternOptions::default().with_rays(candidate.rays).with_seed(seed);
                let mut sky = Sky::new(pattern.clone(), radius).with_threshold(candidate.threshold);
                if method.wants_pilot() {
                    sky.pilot = pilot(asked);
                }
                let engine = engine::sky(method, occluders, &sky, progress)?;
                if engine.answers() == Answers::Images {
                    let reason = "it answers all pixels of an image together: see the pictures";
                    return Err(QueryError::Unsupported { method: method.name(), reason });
                }
                (engine, Work::Sky { pattern: Pattern::new(&pattern)?, radius })
            }
            (Method::Light(method), Question::Light { index }) => {
                let options = ShadowOptions::default().with_threshold(candidate.threshold);
                let engine = engine::shadows_with(method, occluders, &options, progress)?;
                engine.prepare_all();
                (engine, Work::Light(LightQuestion::new(subject, index)))
            }
            _ => {
                let reason = "the question is of another kind";
                return Err(QueryError::Unsupported { method: candidate.method.name(), reason });
            }
        };
        Ok(Self {
            candidate,
            engine,
            work,
            receivers: asked.receivers.clone(),
            asked,
            seed,
            answers: vec![1.0; asked.receivers.len()],
            made_in: start.elapsed(),
            times: Vec::new(),
        })
    }

    /// Answers all receivers once by rays of their own for each `pass`.
    pub(crate) fn pass(&mut self, pass: u32, progress: Report<'_>) -> Result<f64, StudyError> {
        let seed = combine(self.seed, pass);
        for (receiver, original) in self.receivers.iter_mut().zip(&self.asked.receivers) {
            *receiver = original.with_seed(combine(original.seed(), seed));
        }
        let start = Instant::now();
        match &self.work {
            Work::Sky { pattern, radius } => match self.engine.answers() {
                Answers::Receivers => {
                    self.engine.sky(&self.receivers, Outputs::new(&mut self.answers), progress)?;
                }
                Answers::Rays | Answers::Images => engine::openness_by_rays(
                    &*self.engine,
                    (pattern, *radius),
                    &self.receivers,
                    &mut self.answers,
                    progress,
                )?,
            },
            Work::Light(sampler) => {
                if !progress(0.0) {
                    return Err(StudyError::Cancelled);
                }
                let (engine, rays) = (&*self.engine, self.candidate.rays);
                let blocks = self.receivers.par_chunks(BLOCK).zip(self.answers.par_chunks_mut(BLOCK));
                blocks.try_for_each(|(receivers, answers)| {
                    let remembers = engine.for_tile(false);
                    let engine = remembers.as_deref().unwrap_or(engine);
                    sampler.lit_fractions(engine, receivers, rays, answers)
                })?;
            }
        }
        Ok(start.elapsed().as_secs_f64())
    }

    /// The structures that it asks.
    pub(crate) fn structures(&self) -> &'static [Structure] {
        self.engine.structures()
    }

    /// Nodes entered and triangles tested for each ray, by engines that count.
    pub(crate) fn work(&self) -> Result<Option<[f64; 2]>, QueryError> {
        let mut counters = Counters::default();
        let mut count = 0usize;
        for receiver in self.receivers.iter().step_by(self.receivers.len().div_ceil(100)) {
            let (rays, light) = match &self.work {
                Work::Sky { .. } if self.engine.answers() != Answers::Rays => return Ok(None),
                Work::Sky { pattern, radius } => {
                    let directions = pattern.directions(pattern.member_of(receiver));
                    let all = pattern.rays_of(receiver, *radius).zip(directions);
                    (
                        all.map(|(ray, &d)| LightRay::new(ray, pattern.solid_angle(d))).collect::<Vec<_>>(),
                        None,
                    )
                }
                Work::Light(sampler) => {
                    let mut rays = Vec::new();
                    sampler.rays(receiver, self.candidate.rays, &mut |ray, _| rays.push(ray));
                    (rays, Some(sampler.index))
                }
            };
            let mut passed = vec![1.0; rays.len()];
            self.engine.transmittances(&rays, light, &mut passed, Some(&mut counters))?;
            count += rays.len();
        }
        let per_ray = |x: u64| x as f64 / count.max(1) as f64;
        let counted = counters.nodes + counters.triangle_tests > 0;
        Ok(counted.then(|| [per_ray(counters.nodes), per_ray(counters.triangle_tests)]))
    }
}

/// The pilot of methods that look at a sample of the receivers first.
fn pilot(asked: &Asked) -> umbrage_query::Pilot {
    let of = asked.receivers.len();
    let some = umbrage_query::Pilot::indices(of).map(|i| asked.receivers[i]).collect();
    umbrage_query::Pilot::new(some, of)
}

/// Rays to one light, as the renderer samples it.
pub(crate) struct LightQuestion {
    index: usize,
    light: LightSampler,
}

impl LightQuestion {
    pub(crate) fn new(subject: &Subject, index: usize) -> Self {
        let light = LightSampler::new(&subject.scene().lights[index]);
        Self { index, light }
    }

    /// Whether light would arrive at `receiver`.
    pub(crate) fn reaches(&self, receiver: &Receiver) -> bool {
        let mut total = 0.0;
        self.rays(receiver, 16, &mut |_, weight| total += weight);
        total > 0.0
    }

    /// At most `samples` rays, with the luminance that each would bring.
    fn rays(&self, receiver: &Receiver, samples: u32, out: &mut dyn FnMut(LightRay, f64)) {
        let samples = self.light.samples(samples);
        let squares: Vec<Vec2> = (0..samples).map(|i| sobol_2d(i, 0, receiver.seed())).collect();
        let (normal, face) = (receiver.normal(), receiver.face().unwrap_or(receiver.normal()));
        self.light.sample(receiver.point(), &squares, &mut |_, incoming| {
            let cosine = normal.dot(incoming.direction);
            if cosine <= 0.0 || face.dot(incoming.direction) <= 0.0 {
                return;
            }
            let tfar = if incoming.distant { f32::INFINITY } else { 1.0 };
            let ray = Ray::new(receiver.point(), incoming.to_light).with_tfar(tfar);
            let weight = f64::from(incoming.irradiance.element_sum()) * f64::from(cosine);
            out(LightRay::new(ray, incoming.solid_angle), weight);
        });
    }

    fn lit_fractions(
        &self,
        engine: &dyn Engine,
        receivers: &[Receiver],
        samples: u32,
        answers: &mut [f32],
    ) -> Result<(), QueryError> {
        let (mut rays, mut weights, mut passed) = (Vec::new(), Vec::new(), Vec::new());
        for (receiver, answer) in receivers.iter().zip(answers) {
            rays.clear();
            weights.clear();
            self.rays(receiver, samples, &mut |ray, weight| {
                rays.push(ray);
                weights.push(weight);
            });
            passed.clear();
            passed.resize(rays.len(), 1.0);
            engine.transmittances(&rays, Some(self.index), &mut passed, None)?;
            let total: f64 = weights.iter().sum();
            let lit: f64 = weights.iter().zip(&passed).map(|(weight, &x)| weight * f64::from(x)).sum();
            *answer = if total > 0.0 { (lit / total) as f32 } else { 1.0 };
        }
        Ok(())
    }
}
