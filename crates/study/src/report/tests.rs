use super::*;
use crate::{Per, StudyOptions, Subject, run};
use std::time::Duration;
use umbrage_scene::{
    Ground,
    generate::{Parameters, generate},
};

fn subject(name: &str) -> Subject {
    let parameters = Parameters { triangles: Some(6000), ..Parameters::default() };
    let mesh = generate(name, &parameters).unwrap().mesh;
    Subject::of_mesh(name, mesh, Ground::Absent, &mut |_| true).unwrap()
}

fn options() -> StudyOptions {
    StudyOptions::default().with_budget(Duration::from_secs(1)).with_receivers(200)
}

#[test]
fn every_method_is_measured_or_named_with_a_reason() {
    let subject = subject("dragonish");
    let mut seen = Vec::new();
    // Time for several numbers of rays, in a build without optimization too.
    let options = options().with_per(Per::Camera).with_budget(Duration::from_secs(6)).with_pictures(false);
    let study = run(&subject, &options, &mut |f| {
        seen.push(f);
        true
    });
    let study = study.unwrap();
    assert!(seen.windows(2).all(|w| w[0] <= w[1]) && seen.last() == Some(&1.0));
    assert!(seen[..seen.len() - 1].iter().all(|&f| f < 1.0));
    assert_eq!(
        study.questions.iter().map(|q| q.question.as_str()).collect::<Vec<_>>(),
        ["sky-inf", "sky-10%", "light-0"]
    );
    for (question, all) in study.questions.iter().zip([
        umbrage_query::AoMethod::ALL.iter().map(|m| m.name()).collect::<Vec<_>>(),
        umbrage_query::AoMethod::ALL.iter().map(|m| m.name()).collect(),
        umbrage_query::ShadowMethod::ALL.iter().map(|m| m.name()).collect(),
    ]) {
        for name in all {
            let measured = question.rows.iter().any(|row| row.method == name);
            let named = question.missing.iter().any(|missing| missing.method == name);
            assert!(measured != named, "{name} of {}", question.question);
        }
        // Exact methods are without bias: within four standard errors, and the ratio's own bias where rays are few.
        for row in question.rows.iter().filter(|row| row.exact && row.rays >= Some(64)) {
            let bound = 4.0 * row.bias_standard_error + 2e-3;
            assert!(row.bias.abs() < bound, "{} {}: {}", row.method, row.settings, row.bias);
        }
        // More rays come nearer, where there was time for them.
        let first = question.rows[0].method;
        let curve: Vec<_> = question.rows.iter().filter(|row| row.method == first).collect();
        assert!(curve.len() == 1 || curve[curve.len() - 1].rmse < curve[0].rmse, "{}", question.question);
        assert!(question.rows.iter().any(|row| row.pareto));
    }
}

#[test]
fn the_page_holds_all_and_needs_nothing() {
    let study = run(&subject("knots"), &options(), &mut |_| true).unwrap();
    let page = html(&study).unwrap();
    assert!(page.len() < 5_000_000 && page.starts_with("<!DOCTYPE html>"));
    // Nothing is loaded from elsewhere; names of XML are no addresses.
    let elsewhere = page.replace("http://www.w3.org/2000/svg", "");
    assert!(!elsewhere.contains("http") && !elsewhere.contains("<script"));
    for expected in
        ["Ambient occlusion, unbounded radius", "mask-table", "For an error of 0.02", "What was built"]
    {
        assert!(page.contains(expected), "{expected}");
    }
    assert_eq!(page.matches("<svg").count(), study.questions.len());
    // Every method has a picture or a reason; a picture comes with the exact one and the difference, and all with the work.
    let pictures = study.pictures.as_ref().unwrap();
    assert_eq!(pictures.methods.len() + pictures.missing.len(), umbrage_query::AoMethod::ALL.len());
    assert_eq!(page.matches("data:image/png").count(), 3 * pictures.methods.len() + 1);
    let csv = table::csv(&study);
    let rows = study.questions.iter().map(|q| q.rows.len()).sum::<usize>();
    assert_eq!((csv.lines().count(), table::json_lines(&study).lines().count()), (rows + 1, rows));
    let columns = |line: &str| line.split(',').count();
    assert!(csv.lines().all(|line| columns(line) == columns(csv.lines().next().unwrap())));
    let text = table::text(&study);
    assert!(text.contains("reference of"));
}

#[test]
fn names_are_escaped() {
    let mut study = run(&subject("knots"), &options().with_pictures(false), &mut |_| true).unwrap();
    study.subject = "<b>'&".into();
    let page = html(&study).unwrap();
    assert!(!page.contains("<b>") && page.contains("&lt;b&gt;"));
}

#[test]
fn a_study_ends_when_told_to() {
    let subject = subject("knots");
    for after in [0, 3, 40] {
        let mut calls = 0;
        let result = run(&subject, &options(), &mut |_| {
            calls += 1;
            calls <= after
        });
        assert!(matches!(result, Err(StudyError::Cancelled)), "after {after}");
    }
}

#[test]
fn options_out_of_range_are_named() {
    for (options, what) in [
        (options().with_receivers(1), "receivers"),
        (options().with_budget(Duration::ZERO), "budget"),
        (options().with_methods(vec!["maks".into()]), "maks"),
        (options().with_radii(vec![umbrage_scene::Radius::Absolute(-1.0)]), "radius"),
    ] {
        let error = options.validate().unwrap_err().to_string();
        assert!(error.contains(what), "{error}");
    }
}
