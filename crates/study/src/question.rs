//! What receivers ask, and the reference's answer.

use super::{StudyError, Subject};
use std::time::{Duration, Instant};
use umbrage_aomask::Receiver;
use umbrage_geom::Ray;
use umbrage_query::engine::Report;
use umbrage_reference::{Emitter, Receivers, Reference};
use umbrage_scene::{Light, Radius};

/// Random rays of a receiver in one round of the reference.
const ROUND: u32 = 128;

/// Rounds after which more rays tell nothing that matters: with so many rays the standard error of a receiver is below 0.004.
const MOST_ROUNDS: u32 = 128;

/// What is asked.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Question {
    /// How open the sky is, up to a radius in world units.
    Sky { radius: f32, name: Radius },
    /// Which fraction of a light arrives.
    Light { index: usize },
}

/// A question with those who ask and the true answers.
pub(crate) struct Asked {
    pub question: Question,
    pub receivers: Vec<Receiver>,
    pub reference: Reference,
    pub reference_rays: u64,
}

impl Question {
    /// All questions of a study.
    pub(crate) fn all(subject: &Subject, radii: &[Radius]) -> Vec<Self> {
        let diagonal = subject.occluders().diagonal();
        let sky = radii.iter().map(|&name| Self::Sky { radius: name.resolve(diagonal), name });
        sky.chain((0..subject.scene().lights.len()).map(|index| Self::Light { index })).collect()
    }

    /// Short name.
    pub(crate) fn name(&self) -> String {
        match self {
            Self::Sky { name: Radius::OfDiagonal(share), .. } => format!("sky-{}%", share * 100.0),
            Self::Sky { name: Radius::Absolute(length), .. } => format!("sky-{length}"),
            Self::Sky { .. } => "sky-inf".into(),
            Self::Light { index } => format!("light-{index}"),
        }
    }

    /// In words.
    pub(crate) fn title(&self, subject: &Subject) -> String {
        match self {
            Self::Sky { name: Radius::OfDiagonal(share), .. } => {
                format!("Ambient occlusion, radius {} % of the diagonal", share * 100.0)
            }
            Self::Sky { name: Radius::Absolute(length), .. } => format!("Ambient occlusion, radius {length}"),
            Self::Sky { .. } => "Ambient occlusion, unbounded radius".into(),
            Self::Light { index } => {
                let kind = match subject.scene().lights[*index] {
                    Light::Rectangle { .. } => "rectangle",
                    Light::Disc { .. } => "disc",
                    Light::Sphere { .. } => "sphere",
                    Light::Point { .. } => "point",
                    Light::Spot { .. } => "spot",
                    Light::Directional { .. } => "directional",
                };
                format!("Shadow of light {} ({kind})", index + 1)
            }
        }
    }

    /// Asks the reference for `time`, at least one round, and until its own error is small.
    pub(crate) fn ask(
        self,
        subject: &Subject,
        receivers: &[Receiver],
        (time, seed): (Duration, u32),
        progress: Report<'_>,
    ) -> Result<Option<Asked>, StudyError> {
        let start = Instant::now();
        let mut receivers = receivers.to_vec();
        if let Self::Light { index } = self {
            // Light that arrives nowhere is not asked about.
            let (_, lit) = round(subject, &self, &receivers, 32, seed.into());
            let ours = super::candidate::LightQuestion::new(subject, index);
            let mut lit = lit.into_iter();
            receivers.retain(|receiver| lit.next() == Some(true) && ours.reaches(receiver));
        }
        if receivers.is_empty() {
            return Ok(None);
        }
        let mut reference: Option<Reference> = None;
        let mut rounds = 0;
        while rounds < MOST_ROUNDS && (rounds == 0 || start.elapsed() < time) {
            if !progress(0.0) {
                return Err(StudyError::Cancelled);
            }
            let seed = (u64::from(seed) << 32) | (u64::from(rounds) + 1);
            let (next, _) = round(subject, &self, &receivers, ROUND, seed);
            rounds += 1;
            reference = Some(match reference {
                None => next,
                Some(known) => known.joined(&next, 1.0 / f64::from(rounds)),
            });
        }
        let reference_rays = u64::from(rounds) * u64::from(ROUND);
        Ok(reference.map(|reference| Asked { question: self, receivers, reference, reference_rays }))
    }
}

/// One round of the reference; whether light would arrive at each receiver.
fn round(
    subject: &Subject,
    question: &Question,
    receivers: &[Receiver],
    rays: u32,
    seed: u64,
) -> (Reference, Vec<bool>) {
    let list = |of: &dyn Fn(&Receiver) -> [f32; 3]| receivers.iter().map(of).collect::<Vec<_>>();
    let points = list(&|r| r.point().to_array());
    let normals = list(&|r| r.normal().to_array());
    let faces = list(&|r| r.face().unwrap_or(r.normal()).to_array());
    let asks = Receivers { points: &points, normals: &normals, faces: &faces };
    let passed = |ray: &Ray| f64::from(subject.occluders().transmittance(ray, &mut ()));
    match *question {
        Question::Sky { radius, .. } => {
            (asks.openness(radius, rays, seed, &passed), vec![true; receivers.len()])
        }
        Question::Light { index } => {
            asks.lit_fraction(&emitter(&subject.scene().lights[index]), rays, seed, &passed)
        }
    }
}

/// A light as the reference knows it. The cone of a spot only decides which receivers it reaches.
fn emitter(light: &Light) -> Emitter {
    match *light {
        Light::Rectangle { corner, u, v, two_sided, .. } => {
            Emitter::Parallelogram { corner, u, v, two_sided }
        }
        Light::Disc { center, normal, radius, two_sided, .. } => {
            Emitter::Disc { center, normal, radius, two_sided }
        }
        Light::Sphere { center, radius, .. } => Emitter::Sphere { center, radius },
        Light::Point { position, .. } | Light::Spot { position, .. } => Emitter::Point { position },
        Light::Directional { direction, angle, .. } => Emitter::Distant {
            towards: direction.map(|x| -x),
            half_angle: 0.5 * f64::from(angle).to_radians(),
        },
    }
}
