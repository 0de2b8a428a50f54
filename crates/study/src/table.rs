//! Results as text, CSV and JSON lines.

use super::{Answers, Row, Study, TARGET_ERRORS, curve};
use serde_json::{Value, json};
use std::fmt::Write;

/// Tables for people, one for each question, and the settings for usual errors.
pub fn text(study: &Study) -> String {
    let mut out = String::new();
    // Writing to a string does not fail.
    let _ = writeln!(
        out,
        "{}: {} triangles; {} of {}, {}, {} threads; {:.1} s",
        study.subject,
        study.triangles,
        study.machine.processor,
        study.machine.system,
        study.machine.instructions,
        study.machine.threads,
        study.seconds
    );
    for answers in &study.questions {
        let _ = writeln!(out, "\n{}", answers.title);
        if answers.reference_rays > 1 {
            let _ = writeln!(
                out,
                "{} receivers, mean {:.4} +- {:.4}; reference of {} random rays a receiver, standard error {:.4}",
                answers.receivers,
                answers.mean,
                answers.reference_standard_error_of_mean,
                answers.reference_rays,
                answers.reference_standard_error
            );
        }
        let _ = writeln!(
            out,
            "  {:<24} {:<26} {:>9} {:>7} {:>9} {:>9} {:>8} {:>8} {:>9}",
            "method", "settings", "time ms", "spread", "RMSE", "bias", "largest", "build s", "MB"
        );
        for row in &answers.rows {
            let _ = writeln!(out, "{}", line(row));
        }
        for missing in &answers.missing {
            let _ = writeln!(out, "  {}: not measured, {}", missing.method, missing.reason);
        }
        for sentence in advice(answers) {
            let _ = writeln!(out, "  {sentence}");
        }
    }
    let never: Vec<&str> = study.structures.iter().filter(|s| !s.made).map(|s| s.name).collect();
    if !never.is_empty() {
        let _ = writeln!(out, "\nNever built: {}", never.join(", "));
    }
    out
}

fn line(row: &Row) -> String {
    let [low, high] = row.time_quartiles_s;
    format!(
        "{} {:<24} {:<26} {:>9.3} {:>6.1}% {:>9.5} {:>+9.5} {:>8.4} {:>8.3} {:>9.2}",
        if row.pareto { "*" } else { " " },
        row.method,
        row.settings,
        row.time_s * 1e3,
        (high - low) / row.time_s * 100.0,
        row.rmse,
        row.bias,
        row.largest_error,
        row.build_s,
        row.bytes as f64 * 1e-6
    )
}

/// Which settings to use for usual errors, in words.
pub fn advice(answers: &Answers) -> Vec<String> {
    let unit = if answers.question == "surfaces" { " pixels" } else { "" };
    let say = |&error: &f64| match curve::fastest_within(&answers.rows, error) {
        Some(row) => format!(
            "For an error of {error}{unit}: {}, {} (root mean square error {:.4}, {:.3} ms).",
            row.method,
            row.settings,
            row.rmse,
            row.time_s * 1e3
        ),
        None => format!("For an error of {error}{unit}: nothing that was measured comes so near."),
    };
    if answers.rows.is_empty() { Vec::new() } else { TARGET_ERRORS.iter().map(say).collect() }
}

/// One JSON object a row, with the keys of the suites of `cargo xtask bench`.
pub fn json_lines(study: &Study) -> String {
    let mut out = String::new();
    for (answers, row) in rows(study) {
        let _ = writeln!(out, "{}", object(study, answers, row));
    }
    out
}

fn object(study: &Study, answers: &Answers, row: &Row) -> Value {
    let baseline = answers.rows.first().map_or("rays", |row| row.method);
    let same =
        |other: &&Row| other.method == baseline && other.rays == row.rays && other.pixels == row.pixels;
    let speedup = answers.rows.iter().find(same).map(|base| base.time_s / row.time_s);
    json!({
        "suite": "study",
        "scene": study.subject,
        "method": row.method,
        "params": {
            "question": answers.question,
            "per": study.per,
            "rays": row.rays,
            "threshold": row.threshold,
            "pixels": row.pixels,
        },
        "time_s": row.time_s,
        "build_s": row.build_s,
        "mrays_s": row.mrays_s,
        "rmse": row.rmse,
        "bias": row.bias,
        "bytes": row.bytes,
        "counters": {
            "exact": row.exact,
            "receivers": answers.receivers,
            "passes": row.passes,
            "time_quartiles_s": row.time_quartiles_s,
            "bias_standard_error": row.bias_standard_error,
            "largest_error": row.largest_error,
            "reference_rays": answers.reference_rays,
            "reference_standard_error": answers.reference_standard_error,
            "reference_standard_error_of_mean": answers.reference_standard_error_of_mean,
            "nodes": row.work.map(|work| work[0]),
            "triangle_tests": row.work.map(|work| work[1]),
            "pareto": row.pareto,
            "processor": study.machine.processor,
            "instructions": study.machine.instructions,
            "threads": study.machine.threads,
            "version": study.machine.version,
            "commit": study.machine.commit,
        },
        "baseline": baseline,
        "speedup": speedup,
    })
}

/// A header and one line a row, separated by commas.
pub fn csv(study: &Study) -> String {
    let mut out = String::from(
        "subject,question,method,exact,rays,threshold,pixels,receivers,time_s,time_q1_s,time_q3_s,passes,build_s,bytes,mrays_s,\
         rmse,bias,bias_standard_error,largest_error,reference_rays,reference_standard_error,pareto\n",
    );
    let text = |text: &str| {
        if text.contains(['"', ',', '\n']) {
            format!("\"{}\"", text.replace('"', "\"\""))
        } else {
            text.into()
        }
    };
    for (answers, row) in rows(study) {
        let or_nothing = |x: Option<String>| x.unwrap_or_default();
        let [low, high] = row.time_quartiles_s;
        let values = [
            text(&study.subject),
            text(&answers.question),
            row.method.into(),
            row.exact.to_string(),
            or_nothing(row.rays.map(|x| x.to_string())),
            or_nothing(row.threshold.map(|x| x.to_string())),
            or_nothing(row.pixels.map(|x| x.to_string())),
            answers.receivers.to_string(),
            row.time_s.to_string(),
            low.to_string(),
            high.to_string(),
            row.passes.to_string(),
            row.build_s.to_string(),
            row.bytes.to_string(),
            row.mrays_s.to_string(),
            row.rmse.to_string(),
            row.bias.to_string(),
            row.bias_standard_error.to_string(),
            row.largest_error.to_string(),
            answers.reference_rays.to_string(),
            answers.reference_standard_error.to_string(),
            row.pareto.to_string(),
        ];
        let _ = writeln!(out, "{}", values.join(","));
    }
    out
}

fn rows(study: &Study) -> impl Iterator<Item = (&Answers, &Row)> {
    study.questions.iter().flat_map(|answers| answers.rows.iter().map(move |row| (answers, row)))
}
