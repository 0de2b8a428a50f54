//! Rows of results, and timing that alternates between methods.

use anyhow::Result;
use serde::Serialize;
use std::{
    fs::File,
    io::{IsTerminal, Write},
    time::Instant,
};

/// One result. Keys are those of `docs/benchmarks.md`; scripts depend on them.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    pub suite: &'static str,
    pub scene: String,
    pub method: String,
    pub params: serde_json::Value,
    /// Median time of a pass over all rays, seconds.
    pub time_s: f64,
    /// Time to build the method's structure, seconds.
    pub build_s: f64,
    /// Million rays a second, from the median.
    pub mrays_s: f64,
    /// Error of the answers against the exact ones.
    pub rmse: f64,
    /// Mean signed error.
    pub bias: f64,
    /// Bytes of the method's structure.
    pub bytes: usize,
    pub counters: serde_json::Value,
    pub baseline: &'static str,
    /// Median over passes of baseline time / this time.
    pub speedup: f64,
}

/// Prints rows as a table and writes them as JSON lines.
pub struct Output {
    file: Option<File>,
    header: bool,
}

impl Output {
    pub fn new(file: Option<File>) -> Self {
        Self { file, header: true }
    }

    /// Shows and writes one row.
    pub fn row(&mut self, row: &Row) -> Result<()> {
        if std::mem::take(&mut self.header) {
            println!(
                "{:<12} {:<13} {:<34} {:>9} {:>8} {:>8} {:>9} {:>7}  baseline",
                "scene", "method", "params", "time ms", "build s", "Mrays/s", "RMSE", "speedup"
            );
        }
        let params = row.params.as_object().map_or_else(String::new, |map| {
            map.iter().map(|(k, v)| format!("{k}={v}")).collect::<Vec<_>>().join(" ").replace('"', "")
        });
        println!(
            "{:<12} {:<13} {:<34} {:>9.2} {:>8.2} {:>8.2} {:>9.1e} {:>6.2}x  {}",
            row.scene,
            row.method,
            params,
            row.time_s * 1e3,
            row.build_s,
            row.mrays_s,
            row.rmse,
            row.speedup,
            row.baseline
        );
        if let Some(file) = &mut self.file {
            writeln!(file, "{}", serde_json::to_string(row)?)?;
        }
        Ok(())
    }
}

/// Says on a terminal what is being prepared.
pub fn note(text: &str) {
    if std::io::stderr().is_terminal() {
        eprintln!("{text}");
    }
}

/// Times of each method, pass by pass: in every pass all methods run once, in turn, so that a slow moment of the machine
/// meets all of them. The first, untimed pass warms up.
pub fn alternate(passes: usize, methods: &mut [&mut dyn FnMut()]) -> Vec<Vec<f64>> {
    methods.iter_mut().for_each(|run| run());
    let mut times = vec![Vec::with_capacity(passes); methods.len()];
    for _ in 0..passes {
        for (method, times) in methods.iter_mut().zip(&mut times) {
            let start = Instant::now();
            method();
            times.push(start.elapsed().as_secs_f64());
        }
    }
    times
}

/// The middle value; the mean of the two in the middle for an even number.
pub fn median(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let n = sorted.len();
    if n % 2 == 1 { sorted[n / 2] } else { 0.5 * (sorted[n / 2 - 1] + sorted[n / 2]) }
}

/// Median of the ratios of two methods' times in the same pass.
pub fn paired_speedup(baseline: &[f64], method: &[f64]) -> f64 {
    median(&baseline.iter().zip(method).map(|(b, m)| b / m).collect::<Vec<_>>())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn medians_and_pairs() {
        assert_eq!(median(&[3.0, 1.0, 2.0]), 2.0);
        assert_eq!(median(&[4.0, 1.0, 2.0, 3.0]), 2.5);
        assert_eq!(paired_speedup(&[2.0, 4.0, 6.0], &[1.0, 1.0, 6.0]), 2.0);
    }

    #[test]
    fn methods_take_turns() {
        let order = std::cell::RefCell::new(String::new());
        let (mut a, mut b) = (|| order.borrow_mut().push('a'), || order.borrow_mut().push('b'));
        let times = alternate(2, &mut [&mut a, &mut b]);
        assert_eq!(*order.borrow(), "ababab");
        assert!(times.iter().all(|t| t.len() == 2));
    }
}
