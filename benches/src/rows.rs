//! Rows of results, and timing that alternates between methods.

use anyhow::Result;
use serde::Serialize;
use serde_json::{Value, json};
use std::{
    collections::BTreeMap,
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
    pub params: Value,
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
    pub counters: Value,
    pub baseline: &'static str,
    /// Median over passes of baseline time / this time.
    pub speedup: f64,
}

/// Prints rows as a table and writes them as JSON lines.
pub struct Output {
    file: Option<File>,
    /// All rows so far.
    rows: Vec<Row>,
}

impl Output {
    pub fn new(file: Option<File>) -> Self {
        Self { file, rows: Vec::new() }
    }

    /// Shows and writes one row.
    pub fn row(&mut self, row: &Row) -> Result<()> {
        if self.rows.is_empty() {
            println!(
                "{:<12} {:<13} {:<78} {:>9} {:>8} {:>8} {:>9} {:>7}  baseline",
                "scene", "method", "params", "time ms", "build s", "Mrays/s", "RMSE", "speedup"
            );
        }
        let params = row.params.as_object().map_or_else(String::new, |map| {
            let shown = map.iter().filter(|(_, value)| !value.is_null());
            shown.map(|(k, v)| format!("{k}={v}")).collect::<Vec<_>>().join(" ").replace('"', "")
        });
        println!(
            "{:<12} {:<13} {:<78} {:>9.2} {:>8.2} {:>8.2} {:>9.1e} {:>6.2}x  {}",
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
        self.rows.push(row.clone());
        Ok(())
    }

    /// A row with scene `geomean` for each method, baseline and value of the params `keys`: geometric means of times, rates
    /// and speedups, the largest error, mean bias and bytes, and the row that did worst.
    pub fn geomeans(&mut self, keys: &[&str]) -> Result<()> {
        let mut groups: BTreeMap<_, Vec<&Row>> = BTreeMap::new();
        for row in self.rows.iter().filter(|row| row.method != row.baseline) {
            let params = keys.iter().map(|&key| (key.to_owned(), row.params[key].clone()));
            let params = Value::Object(params.collect());
            let group = (row.baseline, params.to_string(), row.method.clone());
            groups.entry(group).or_default().push(row);
        }
        let means: Vec<Row> = groups
            .iter()
            .map(|((_, params, _), rows)| Ok(summary(rows, serde_json::from_str(params)?)))
            .collect::<Result<_>>()?;
        means.iter().try_for_each(|row| self.row(row))
    }
}

/// The mean row of [`Output::geomeans`].
fn summary(rows: &[&Row], params: Value) -> Row {
    let mean = |of: fn(&Row) -> f64| geomean(rows.iter().map(|row| of(row)));
    let average = |of: fn(&Row) -> f64| rows.iter().map(|row| of(row)).sum::<f64>() / rows.len() as f64;
    let worst = rows.iter().min_by(|a, b| a.speedup.total_cmp(&b.speedup)).expect("groups have rows");
    let mut counters = json!({
        "rows": rows.len(),
        "worst": worst.speedup,
        "worst_scene": worst.scene,
        "worst_params": worst.params,
    });
    // Rows against a peer: how many times as long it builds and how many times as much it holds.
    for (name, peer, own) in [
        ("build_ratio", "peer_build_high_s", "build_s"),
        ("fast_build_ratio", "peer_build_medium_s", "fast_build_s"),
        ("bytes_ratio", "peer_bytes", "bytes"),
    ] {
        let ratios =
            rows.iter().filter_map(|row| Some(row.counters[peer].as_f64()? / row.counters[own].as_f64()?));
        let ratios: Vec<f64> = ratios.collect();
        if !ratios.is_empty() {
            counters[name] = json!(geomean(ratios.into_iter()));
        }
    }
    Row {
        suite: worst.suite,
        scene: "geomean".into(),
        method: worst.method.clone(),
        params,
        time_s: mean(|row| row.time_s),
        build_s: mean(|row| row.build_s),
        mrays_s: mean(|row| row.mrays_s),
        rmse: rows.iter().fold(0.0, |max, row| row.rmse.max(max)),
        bias: average(|row| row.bias),
        bytes: average(|row| row.bytes as f64) as usize,
        counters,
        baseline: worst.baseline,
        speedup: mean(|row| row.speedup),
    }
}

/// Geometric mean; not a number for no values.
pub fn geomean(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) = values.fold((0.0, 0), |(sum, count), x| (sum + x.ln(), count + 1));
    (sum / f64::from(count)).exp()
}

/// Says on a terminal what is being prepared.
pub fn note(text: &str) {
    if std::io::stderr().is_terminal() {
        eprintln!("{text}");
    }
}

/// Something whose passes are timed.
pub trait Timed {
    /// What has to be done before a pass and is not timed.
    fn prepare(&mut self) {}

    /// One pass.
    fn run(&mut self);

    /// What has to be done after a pass and is not timed.
    fn finish(&mut self) {}
}

impl<F: FnMut()> Timed for F {
    fn run(&mut self) {
        self();
    }
}

/// Times of each method, pass by pass: in every pass all methods run once, in turn, so that a slow moment of the machine
/// meets all of them. The first, untimed pass warms up.
pub fn alternate(passes: usize, methods: &mut [&mut dyn Timed]) -> Vec<Vec<f64>> {
    let mut times = vec![Vec::with_capacity(passes); methods.len()];
    for pass in 0..=passes {
        for (method, times) in methods.iter_mut().zip(&mut times) {
            method.prepare();
            let start = Instant::now();
            method.run();
            let time = start.elapsed().as_secs_f64();
            method.finish();
            if pass > 0 {
                times.push(time);
            }
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

    #[test]
    fn summaries_take_methods_and_baselines_apart() {
        let row = |method: &str, baseline, speedup, threads| Row {
            suite: "test",
            scene: "a".into(),
            method: method.into(),
            params: json!({ "threads": threads, "rays": 7 }),
            time_s: 1.0,
            build_s: 1.0,
            mrays_s: 1.0,
            rmse: 0.0,
            bias: 0.0,
            bytes: 3,
            counters: json!({ "peer_bytes": 6, "bytes": 3 }),
            baseline,
            speedup,
        };
        let mut output = Output::new(None);
        for (method, baseline, speedup, threads) in [
            ("bvh", "bvh", 1.0, 1),
            ("bvh", "embree", 2.0, 1),
            ("bvh", "embree", 0.5, 1),
            ("bvh", "embree", 3.0, 2),
            ("bvh-fast", "bvh", 0.25, 1),
        ] {
            output.row(&row(method, baseline, speedup, threads)).expect("no file to fail");
        }
        output.geomeans(&["threads"]).expect("no file to fail");
        let means: Vec<_> =
            output.rows[5..].iter().map(|row| (row.method.as_str(), row.baseline, row.speedup)).collect();
        assert_eq!(means.len(), 3);
        for (mean, expected) in
            means.iter().zip([("bvh-fast", "bvh", 0.25), ("bvh", "embree", 1.0), ("bvh", "embree", 3.0)])
        {
            assert_eq!((mean.0, mean.1), (expected.0, expected.1));
            assert!((mean.2 - expected.2).abs() < 1e-12);
        }
        assert_eq!(output.rows[6].counters["worst"], 0.5);
        assert_eq!(output.rows[6].counters["bytes_ratio"].as_f64().map(|r| (r * 1e6).round()), Some(2e6));
    }
}
