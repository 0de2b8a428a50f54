//! A study as one HTML page that needs nothing else.

use super::{Answers, Pictures, Row, Study, StudyError, TARGET_ERRORS, curve, pictures, plot, table};
use base64::{Engine as _, prelude::BASE64_STANDARD};
use minijinja::{AutoEscape, Environment, context};
use serde::Serialize;

const PAGE: &str = include_str!("page.html");

/// The page: plots, tables, settings for usual errors, pictures with a slider, and what was built.
///
/// # Errors
/// [`StudyError::Page`].
pub fn html(study: &Study) -> Result<String, StudyError> {
    let failed = |error: minijinja::Error| StudyError::Page(error.to_string());
    let mut environment = Environment::new();
    environment.set_auto_escape_callback(|_| AutoEscape::Html);
    environment.add_template("page.html", PAGE).map_err(failed)?;
    let page = environment.get_template("page.html").map_err(failed)?;
    let questions: Vec<Section> = study.questions.iter().map(section).collect();
    let pictures = study.pictures.as_ref().map(gallery);
    page.render(context! { study, questions, pictures, targets => TARGET_ERRORS }).map_err(failed)
}

/// A question as the template shows it.
#[derive(Serialize)]
struct Section {
    title: String,
    about: Option<String>,
    plot: Option<String>,
    advice: Vec<String>,
    equal: Vec<EqualError>,
    rows: Vec<Line>,
    missing: Vec<String>,
}

/// What a method costs at equal error: a cell for each of [`TARGET_ERRORS`].
#[derive(Serialize)]
struct EqualError {
    method: &'static str,
    cells: Vec<String>,
}

/// A row as text.
#[derive(Serialize)]
struct Line {
    pareto: bool,
    method: &'static str,
    exactness: &'static str,
    settings: String,
    cells: Vec<String>,
}

fn section(answers: &Answers) -> Section {
    let about = (answers.reference_rays > 1).then(|| {
        format!(
            "{} receivers; mean {:.4}. Reference: {} random rays a receiver, standard error {:.4} for a receiver and {:.5} for the mean.",
            answers.receivers,
            answers.mean,
            answers.reference_rays,
            answers.reference_standard_error,
            answers.reference_standard_error_of_mean
        )
    });
    Section {
        title: answers.title.clone(),
        about,
        plot: (!answers.rows.is_empty()).then(|| chart(answers)),
        advice: table::advice(answers),
        equal: equal_errors(answers),
        rows: answers.rows.iter().map(line).collect(),
        missing: answers.missing.iter().map(|m| format!("{}: {}.", m.method, m.reason)).collect(),
    }
}

/// Methods in the order of their first rows.
fn methods(answers: &Answers) -> Vec<&'static str> {
    let mut methods: Vec<&'static str> = Vec::new();
    for row in &answers.rows {
        if !methods.contains(&row.method) {
            methods.push(row.method);
        }
    }
    methods
}

fn chart(answers: &Answers) -> String {
    let point = |row: &Row| [row.time_s * 1e3, row.rmse];
    let mut series = Vec::new();
    for method in methods(answers) {
        let own: Vec<&Row> = answers.rows.iter().filter(|row| row.method == method).collect();
        let mut thresholds: Vec<Option<f32>> = Vec::new();
        for row in &own {
            if !thresholds.contains(&row.threshold) {
                thresholds.push(row.threshold);
            }
        }
        for threshold in thresholds {
            let name = threshold.map_or(method.to_owned(), |t| format!("{method}, threshold {t}"));
            let points = own.iter().filter(|row| row.threshold == threshold).map(|row| point(row));
            let filled = own[0].exact;
            series.push(plot::Series { name, points: points.collect(), filled });
        }
    }
    let marked: Vec<[f64; 2]> = answers.rows.iter().filter(|row| row.pareto).map(point).collect();
    let error = if answers.question == "surfaces" { "RMSE, pixels" } else { "RMSE" };
    plot::svg(
        &answers.title,
        ["milliseconds for all receivers", error],
        &series,
        &marked,
        plot::Legend::Below,
    )
}

fn equal_errors(answers: &Answers) -> Vec<EqualError> {
    let methods = methods(answers);
    let times: Vec<Vec<Option<f64>>> = TARGET_ERRORS
        .iter()
        .map(|&error| methods.iter().map(|m| curve::equal_error_time(&answers.rows, m, error)).collect())
        .collect();
    let best = |at: &[Option<f64>]| at.iter().flatten().copied().reduce(f64::min);
    let cell = |at: &[Option<f64>], i: usize| match (at[i], best(at)) {
        (Some(time), Some(best)) => format!("{:.3} ms ({:.2} x)", time * 1e3, time / best),
        _ => "not reached".into(),
    };
    let row = |(i, method)| EqualError { method, cells: times.iter().map(|at| cell(at, i)).collect() };
    methods.into_iter().enumerate().map(row).collect()
}

fn line(row: &Row) -> Line {
    let [low, high] = row.time_quartiles_s;
    let work = row.work.map_or(String::new(), |[nodes, tests]| format!("{nodes:.1} / {tests:.1}"));
    Line {
        pareto: row.pareto,
        method: row.method,
        exactness: if row.exact { "exact" } else { "approximate" },
        settings: row.settings.clone(),
        cells: vec![
            format!("{:.3}", row.time_s * 1e3),
            format!("{:.3} to {:.3}", low * 1e3, high * 1e3),
            row.passes.to_string(),
            format!("{:.5}", row.rmse),
            format!("{:+.5} ± {:.5}", row.bias, row.bias_standard_error),
            format!("{:.4}", row.largest_error),
            format!("{:.2}", row.mrays_s),
            format!("{:.3}", row.build_s),
            format!("{:.2}", row.bytes as f64 * 1e-6),
            work,
        ],
    }
}

/// Pictures as the template shows them.
#[derive(Serialize)]
struct Gallery {
    title: String,
    width: u32,
    height: u32,
    exact: Image,
    methods: Vec<Pair>,
    missing: Vec<String>,
    cost: Option<Image>,
    strongest: f32,
}

#[derive(Serialize)]
struct Image {
    caption: String,
    data: String,
}

#[derive(Serialize)]
struct Pair {
    picture: Image,
    difference: String,
    errors: String,
}

fn gallery(pictures: &Pictures) -> Gallery {
    let encode = |png: &[u8]| BASE64_STANDARD.encode(png);
    let pair = |one: &pictures::Picture| Pair {
        picture: Image { caption: one.caption.clone(), data: encode(&one.picture) },
        difference: encode(&one.difference),
        errors: format!(
            "mean difference {:+.4}, root mean square difference {:.4}",
            one.mean_difference, one.rms_difference
        ),
    };
    Gallery {
        title: pictures.title.clone(),
        width: pictures.width,
        height: pictures.height,
        exact: Image { caption: pictures.exact.0.clone(), data: encode(&pictures.exact.1) },
        methods: pictures.methods.iter().map(pair).collect(),
        missing: pictures.missing.iter().map(|m| format!("{}: {}.", m.method, m.reason)).collect(),
        cost: pictures.cost.as_ref().map(|(png, most)| Image {
            caption: format!(
                "Nodes entered and triangles tested by single rays; yellow is {most:.0} a pixel"
            ),
            data: encode(png),
        }),
        strongest: pictures::STRONGEST_DIFFERENCE,
    }
}

#[cfg(test)]
mod tests;
