//! Time against error: which rows are best, and what equal error costs.

use super::Row;

/// Errors that differ by this share count as equal: methods that cast the same rays differ by the number of passes.
const EQUAL_ERRORS: f64 = 1.02;

/// Times that differ by this share count as equal where exact and approximate methods compete.
const EQUAL_TIMES: f64 = 1.1;

/// Whether each row is as good as can be: no other is faster and at least as near to the reference.
pub fn pareto(rows: &[Row]) -> Vec<bool> {
    let beats = |a: &Row, b: &Row| a.time_s < b.time_s && a.rmse <= b.rmse * EQUAL_ERRORS;
    rows.iter().map(|row| !rows.iter().any(|other| beats(other, row))).collect()
}

/// The row to take for a root mean square error of at most `error`: the fastest, and of those that are within a tenth of its time an exact
/// one, then that which is built soonest.
pub fn fastest_within(rows: &[Row], error: f64) -> Option<&Row> {
    let near = || rows.iter().filter(|row| row.rmse <= error);
    let least = near().map(|row| row.time_s).reduce(f64::min)?;
    near()
        .filter(|row| row.time_s <= least * EQUAL_TIMES)
        .min_by(|a, b| b.exact.cmp(&a.exact).then((a.build_s + a.time_s).total_cmp(&(b.build_s + b.time_s))))
}

/// Seconds that `method` takes to a root mean square error of `error`: on the straight line in logarithms between the two of its rows
/// that lie around it, taken along the fastest rows of the method for each error. Its fastest row's time if that is enough; `None` if no
/// row is.
pub fn equal_error_time(rows: &[Row], method: &str, error: f64) -> Option<f64> {
    let mut own: Vec<&Row> = rows.iter().filter(|row| row.method == method).collect();
    own.sort_by(|a, b| a.time_s.total_cmp(&b.time_s));
    let mut last: Option<&Row> = None;
    for row in own {
        if last.is_some_and(|last| row.rmse >= last.rmse) {
            continue;
        }
        if row.rmse <= error {
            let Some(last) = last else { return Some(row.time_s) };
            let (y0, y1) = (last.rmse.ln(), row.rmse.max(1e-9).ln());
            let share = (y0 - error.ln()) / (y0 - y1);
            return Some((last.time_s.ln() + share * (row.time_s.ln() - last.time_s.ln())).exp());
        }
        last = Some(row);
    }
    None
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    pub(crate) fn row(method: &'static str, time_s: f64, rmse: f64) -> Row {
        Row {
            method,
            exact: true,
            settings: String::new(),
            rays: Some(8),
            threshold: None,
            pixels: None,
            build_s: 0.0,
            bytes: 0,
            time_s,
            time_quartiles_s: [time_s; 2],
            passes: 1,
            mrays_s: 1.0,
            bias: 0.0,
            bias_standard_error: 0.0,
            rmse,
            largest_error: rmse,
            work: None,
            pareto: false,
        }
    }

    #[test]
    fn curves_are_interpolated_in_logarithms() {
        let rows = [row("a", 1.0, 0.1), row("a", 4.0, 0.01), row("a", 2.0, 0.2), row("b", 3.0, 0.05)];
        assert_eq!(pareto(&rows), [true, true, false, true]);
        assert_eq!(fastest_within(&rows, 0.05).map(|row| row.time_s), Some(3.0));
        assert!(fastest_within(&rows, 0.001).is_none());
        let approximate = Row { exact: false, ..row("c", 2.9, 0.04) };
        let with_another = [rows.to_vec(), vec![approximate]].concat();
        assert_eq!(fastest_within(&with_another, 0.05).map(|row| row.method), Some("b"));
        // Half way between 0.1 and 0.01 in logarithms: half way between 1 and 4.
        let time = equal_error_time(&rows, "a", 0.1 / 10f64.sqrt()).unwrap();
        assert!((time - 2.0).abs() < 1e-12, "{time}");
        assert_eq!(equal_error_time(&rows, "b", 0.05), Some(3.0));
        assert_eq!(equal_error_time(&rows, "b", 0.01), None);
    }
}
