//! Runs a study: each question in turn, its methods taking turns pass by pass.

use super::{
    Answers, Machine, Missing, Per, Row, Study, StudyError, StudyOptions, Subject,
    candidate::{Candidate, Running},
    curve, pictures,
    question::{Asked, Question},
    study::StructureMade,
    surfaces,
};
use std::time::{Duration, Instant};
use umbrage_query::{Occluders, QueryError, Structure, engine::Report};

/// Share of a question's time for the reference, at most.
const REFERENCE_SHARE: f64 = 0.3;

/// Share of all time for pictures.
const PICTURE_SHARE: f64 = 0.2;

/// Passes after which more tell little.
const MOST_PASSES: u32 = 15;

/// A method so many times as slow as one that comes nearer is not asked with more rays.
const HOPELESS_TIME: f64 = 8.0;

/// Why a method was not asked.
pub(crate) const BUDGET_ENDED: &str = "the budget ended";

/// Tells the draw of receivers apart from their rays.
const RECEIVERS: u32 = 0x7374_7564;

/// Time that is left, and how far the study has come by it.
pub(crate) struct Clock<'r> {
    start: Instant,
    budget: Duration,
    report: Report<'r>,
}

impl Clock<'_> {
    /// Whether to go on, at the share of the budget that is spent; 1 is kept for the end.
    pub(crate) fn go_on(&mut self) -> bool {
        let share = self.start.elapsed().as_secs_f64() / self.budget.as_secs_f64();
        (self.report)(share.min(0.99) as f32)
    }

    fn check(&mut self) -> Result<(), StudyError> {
        if self.go_on() { Ok(()) } else { Err(StudyError::Cancelled) }
    }

    fn left(&self) -> Duration {
        self.budget.saturating_sub(self.start.elapsed())
    }
}

/// Asks every method that fits about `subject`.
///
/// Runs on the threads of the current `rayon` pool. `progress` gets growing fractions of the budget that end at exactly 1, and returns
/// `false` to cancel.
///
/// # Errors
/// Those of [`StudyOptions::validate`]; [`StudyError::NoReceiver`]; what fails of structures and calls; [`StudyError::Cancelled`].
pub fn run(subject: &Subject, options: &StudyOptions, progress: Report<'_>) -> Result<Study, StudyError> {
    options.validate()?;
    let mut clock = Clock { start: Instant::now(), budget: options.budget, report: progress };
    clock.check()?;
    let receivers = subject.receivers(options.per, options.receivers, options.seed ^ RECEIVERS)?;
    let questions = Question::all(subject, &options.radii);
    let for_pictures = if options.pictures { PICTURE_SHARE } else { 0.0 };
    let has_surfaces = subject.control().is_some();
    let mut answers = Vec::new();
    for (number, question) in questions.iter().enumerate() {
        let still = questions.len() - number + usize::from(has_surfaces);
        let time = (clock.left().mul_f64(1.0 - for_pictures)) / still as u32;
        let given = (time.mul_f64(REFERENCE_SHARE), options.seed);
        let asked = question.ask(subject, &receivers, given, &mut |_| clock.go_on())?;
        match asked {
            Some(asked) => answers.push(answer(subject, &asked, options, time, &mut clock)?),
            None => answers.push(nobody(question, subject)),
        }
    }
    if let Some(control) = subject.control() {
        let time = clock.left().mul_f64(1.0 - for_pictures);
        answers.push(surfaces::answer(control, options, time, &mut || clock.go_on())?);
    }
    let pictures = match options.pictures {
        true => Some(pictures::render_all(subject, &answers, clock.left(), &mut || clock.go_on())?),
        false => None,
    };
    let seconds = clock.start.elapsed().as_secs_f64();
    if !(clock.report)(1.0) {
        return Err(StudyError::Cancelled);
    }
    Ok(Study {
        subject: subject.name().into(),
        triangles: subject.occluders().triangle_count(),
        opaque: subject.occluders().is_opaque(),
        per: match options.per {
            Per::Vertex => "vertex",
            Per::Texel { .. } => "texel",
            Per::Camera => "camera",
        },
        machine: Machine::this(),
        seconds,
        budget: options.budget.as_secs_f64(),
        questions: answers,
        structures: structures(subject.occluders()),
        pictures,
    })
}

/// The answer to a question that concerns no receiver.
fn nobody(question: &Question, subject: &Subject) -> Answers {
    Answers {
        question: question.name(),
        title: question.title(subject),
        radius: None,
        receivers: 0,
        mean: 1.0,
        reference_rays: 0,
        reference_standard_error: 0.0,
        reference_standard_error_of_mean: 0.0,
        rows: Vec::new(),
        missing: vec![Missing { method: "all".into(), reason: "the light reaches no receiver".into() }],
    }
}

fn structures(occluders: &Occluders) -> Vec<StructureMade> {
    let all = occluders.structures().into_iter();
    all.map(|(structure, made)| StructureMade {
        name: structure.name(),
        made: made.is_some(),
        build_s: made.and_then(|made| made.time).map(|time| time.as_secs_f64()),
        bytes: made.and_then(|made| made.bytes),
    })
    .collect()
}

/// Seconds and bytes of `wanted` structures.
fn spent_on(occluders: &Occluders, wanted: &[Structure]) -> (f64, usize) {
    let made = occluders.structures().into_iter().filter(|(structure, _)| wanted.contains(structure));
    made.filter_map(|(_, made)| made).fold((0.0, 0), |(time, bytes), made| {
        (time + made.time.unwrap_or_default().as_secs_f64(), bytes + made.bytes.unwrap_or(0))
    })
}

/// Errors of a candidate over its passes.
#[derive(Default)]
struct Errors {
    sum: f64,
    squares: f64,
    largest: f64,
    count: u64,
}

impl Errors {
    fn add(&mut self, answers: &[f32], truth: &[f64]) {
        for (&answer, truth) in answers.iter().zip(truth) {
            let error = f64::from(answer) - truth;
            self.sum += error;
            self.squares += error * error;
            self.largest = self.largest.max(error.abs());
            self.count += 1;
        }
    }
}

/// A candidate with what was measured of it.
struct Entry<'a> {
    running: Running<'a>,
    build_s: f64,
    bytes: usize,
    errors: Errors,
}

/// Measures all candidates for one question within `time`.
fn answer(
    subject: &Subject,
    asked: &Asked,
    options: &StudyOptions,
    time: Duration,
    clock: &mut Clock<'_>,
) -> Result<Answers, StudyError> {
    let start = Instant::now();
    let (mut entries, mut missing) = (Vec::<Entry>::new(), Vec::<Missing>::new());
    // Curves that get no more rays.
    let mut closed = Vec::new();
    for candidate in Candidate::all(&asked.question, options) {
        let method = candidate.method.name();
        if missing.iter().any(|missing| missing.method == method) || closed.contains(&candidate.curve()) {
            continue;
        }
        let is_known = entries.iter().any(|entry| entry.running.candidate.method == candidate.method);
        let reason = match hopeless(&entries, &candidate) {
            None if !entries.is_empty() && start.elapsed() > time => Some(BUDGET_ENDED.to_owned()),
            reason => reason,
        };
        if let Some(reason) = reason {
            let with = format!("{method} with {} and more", candidate.settings());
            missing.push(Missing { method: if is_known { with } else { method.into() }, reason });
            closed.push(candidate.curve());
            continue;
        }
        let before = spent_on(subject.occluders(), &Structure::ALL).0;
        // Structures may take twice the question's time; the first method, which is exact, always gets its answer.
        let (mut interrupted, is_first) = (false, entries.is_empty());
        let running = Running::new(candidate, subject, asked, options.seed, &mut |_| {
            interrupted = !clock.go_on();
            !interrupted && (is_first || start.elapsed() < 2 * time)
        });
        let mut running = match running {
            Ok(running) => running,
            Err(QueryError::Cancelled) if !interrupted => {
                let reason = "its structures took longer to build than the budget allows".into();
                missing.push(Missing { method: method.into(), reason });
                continue;
            }
            Err(QueryError::Unsupported { reason, .. }) => {
                missing.push(Missing { method: method.into(), reason: reason.into() });
                continue;
            }
            Err(other) => return Err(other.into()),
        };
        // Later candidates of a method find the structures that the first has made.
        let made_now = spent_on(subject.occluders(), &Structure::ALL).0 - before;
        let (structures_s, bytes) = spent_on(subject.occluders(), running.structures());
        let build_s = structures_s + (running.made_in.as_secs_f64() - made_now.max(0.0)).max(0.0);
        let mut errors = Errors::default();
        // The first pass warms up; its errors count, its time only if there is no other.
        let seconds = running.pass(0, &mut |_| clock.go_on())?;
        running.times.push(seconds);
        errors.add(&running.answers, &asked.reference.ao);
        entries.push(Entry { running, build_s, bytes, errors });
    }
    for pass in 1..=MOST_PASSES {
        for entry in &mut entries {
            clock.check()?;
            let expected = entry.running.times.last().copied().unwrap_or(0.0);
            if start.elapsed().as_secs_f64() + expected > time.as_secs_f64() {
                continue;
            }
            let seconds = entry.running.pass(pass, &mut |_| clock.go_on())?;
            if pass == 1 {
                entry.running.times.clear();
            }
            entry.running.times.push(seconds);
            entry.errors.add(&entry.running.answers, &asked.reference.ao);
        }
    }
    let mut rows = entries.iter().map(|entry| row(entry, asked)).collect::<Result<Vec<_>, _>>()?;
    // Curve by curve, methods in the order of their first rows.
    let order: Vec<_> = rows.iter().map(|row| row.method).collect();
    let place = |row: &Row| order.iter().position(|&method| method == row.method);
    rows.sort_by(|a, b| {
        place(a)
            .cmp(&place(b))
            .then(a.threshold.partial_cmp(&b.threshold).unwrap_or(std::cmp::Ordering::Equal))
    });
    mark_pareto(&mut rows);
    let truth = &asked.reference.ao;
    Ok(Answers {
        question: asked.question.name(),
        title: asked.question.title(subject),
        radius: match asked.question {
            Question::Sky { name, .. } => Some(name),
            Question::Light { .. } => None,
        },
        receivers: asked.receivers.len(),
        mean: truth.iter().sum::<f64>() / truth.len() as f64,
        reference_rays: asked.reference_rays,
        reference_standard_error: asked.reference.standard_error(),
        reference_standard_error_of_mean: asked.reference.standard_error_of_mean(),
        rows,
        missing,
    })
}

/// Why more rays of a method can't help: with fewer it was far slower than something that came nearer.
fn hopeless(entries: &[Entry<'_>], candidate: &Candidate) -> Option<String> {
    let same = |entry: &&Entry<'_>| entry.running.candidate.curve() == candidate.curve();
    let last = entries.iter().rfind(same)?;
    let time = |entry: &Entry<'_>| entry.running.times.last().copied().unwrap_or(0.0);
    let better = |other: &&Entry<'_>| {
        other.errors.squares <= last.errors.squares && time(other) * HOPELESS_TIME < time(last)
    };
    let better = entries.iter().filter(better).min_by(|a, b| time(a).total_cmp(&time(b)))?;
    Some(format!(
        "with {} it took {:.0} times as long as {} with {}, which came nearer",
        last.running.candidate.settings(),
        time(last) / time(better),
        better.running.candidate.method.name(),
        better.running.candidate.settings()
    ))
}

fn row(entry: &Entry<'_>, asked: &Asked) -> Result<Row, StudyError> {
    let Entry { running, build_s, bytes, errors } = entry;
    let candidate = running.candidate;
    let times = quartiles(&running.times);
    let n = errors.count.max(1) as f64;
    let own: f64 = asked.reference.variances.iter().sum::<f64>() / asked.receivers.len() as f64;
    let mean_square = errors.squares / n;
    let of_mean = asked.reference.standard_error_of_mean();
    Ok(Row {
        method: candidate.method.name(),
        exact: candidate.method.is_exact(),
        settings: candidate.settings(),
        rays: Some(candidate.rays),
        threshold: candidate.threshold,
        pixels: None,
        build_s: *build_s,
        bytes: *bytes,
        time_s: times[1],
        time_quartiles_s: [times[0], times[2]],
        passes: running.times.len(),
        mrays_s: (asked.receivers.len() * candidate.rays as usize) as f64 / times[1] * 1e-6,
        bias: errors.sum / n,
        bias_standard_error: ((mean_square - own).max(0.0) / n + of_mean * of_mean).sqrt(),
        rmse: (mean_square - own).max(0.0).sqrt(),
        largest_error: errors.largest,
        work: running.work()?,
        pareto: false,
    })
}

/// Sets [`Row::pareto`].
pub(crate) fn mark_pareto(rows: &mut [Row]) {
    let best = curve::pareto(rows);
    rows.iter_mut().zip(best).for_each(|(row, best)| row.pareto = best);
}

/// First quartile, median and third quartile.
pub(crate) fn quartiles(values: &[f64]) -> [f64; 3] {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let last = (sorted.len() - 1) as f64;
    [0.25, 0.5, 0.75].map(|share| {
        let at = share * last;
        let (low, high) = (at.floor() as usize, at.ceil() as usize);
        sorted[low] + (sorted[high] - sorted[low]) * (at - at.floor())
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quartiles_are_interpolated() {
        assert_eq!(quartiles(&[4.0, 1.0, 3.0, 2.0, 5.0]), [2.0, 3.0, 4.0]);
        assert_eq!(quartiles(&[7.0]), [7.0; 3]);
        assert_eq!(quartiles(&[1.0, 2.0]), [1.25, 1.5, 1.75]);
    }
}
