//! Plots as SVG: points and lines over two logarithmic axes.

use std::fmt::Write;

/// Points of one kind, joined by a line in their order.
#[derive(Clone, Debug, PartialEq)]
pub struct Series {
    /// For the legend.
    pub name: String,
    /// Values of the axis across and of the axis up.
    pub points: Vec<[f64; 2]>,
    /// Discs instead of circles.
    pub filled: bool,
}

const WIDTH: f64 = 760.0;
const HEIGHT: f64 = 420.0;
/// Left, top, right, bottom of the frame.
const FRAME: [f64; 4] = [70.0, 40.0, 520.0, 370.0];
const COLORS: [&str; 14] = [
    "#1f77b4", "#ff7f0e", "#2ca02c", "#d62728", "#9467bd", "#8c564b", "#e377c2", "#7f7f7f", "#bcbd22",
    "#17becf", "#000000", "#005f5f", "#aa5500", "#3333aa",
];

/// Numbers to mark between `low` and `high`: 1, 2, 5 times powers of ten, and some between where these are too few.
fn ticks(low: f64, high: f64) -> Vec<f64> {
    let of = |digits: &[u32]| -> Vec<f64> {
        let powers = low.log10().floor() as i32..=high.log10().ceil() as i32;
        // By text, so that 15 times a thousandth is 0.015.
        let all =
            powers.flat_map(|e| digits.iter().filter_map(move |d| format!("{d}e{}", e - 1).parse().ok()));
        all.filter(|x| (low..=high).contains(x)).collect()
    };
    let few = of(&[10, 20, 50]);
    if few.len() < 3 { of(&[10, 15, 20, 30, 40, 50, 70]) } else { few }
}

/// What a value of an axis is called.
fn label(x: f64) -> String {
    if (1e-3..1e5).contains(&x) { x.to_string() } else { format!("{x:e}") }
}

/// Text as XML has it.
fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('\'', "&#39;")
}

/// A logarithmic axis: values and where they are drawn.
struct Axis {
    values: [f64; 2],
    places: [f64; 2],
}

impl Axis {
    fn new(values: impl Iterator<Item = f64> + Clone, places: [f64; 2]) -> Self {
        let (low, high) = (values.clone().fold(f64::INFINITY, f64::min), values.fold(0.0, f64::max));
        Self { values: [low / 1.25, high * 1.25], places }
    }

    fn at(&self, x: f64) -> f64 {
        let [(low, high), (from, to)] = [self.values, self.places].map(|[a, b]| (a, b));
        from + (to - from) * (x / low).ln() / (high / low).ln()
    }

    fn ticks(&self) -> Vec<f64> {
        ticks(self.values[0], self.values[1])
    }
}

/// Where the names of series stand.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Legend {
    /// Beside the plot, which has its title above.
    #[default]
    Right,
    /// Below the plot, which has no title and larger letters: for pages on narrow screens.
    Below,
}

/// The plot as an SVG document, with a ring around each of the points `marked`. Points with a number that is not positive are left out.
pub fn svg(
    title: &str,
    [x_label, y_label]: [&str; 2],
    series: &[Series],
    marked: &[[f64; 2]],
    legend: Legend,
) -> String {
    let (title, x_label, y_label) = (escaped(title), escaped(x_label), escaped(y_label));
    let positive = |points: &[[f64; 2]]| -> Vec<[f64; 2]> {
        points.iter().copied().filter(|p| p.iter().all(|&v| v > 0.0)).collect()
    };
    let series: Vec<(&Series, Vec<[f64; 2]>)> = series.iter().map(|s| (s, positive(&s.points))).collect();
    let values = |k: usize| series.iter().flat_map(move |(_, points)| points.iter().map(move |p| p[k]));
    let [left, top, right, bottom] = FRAME;
    let (across, up) = (Axis::new(values(0), [left, right]), Axis::new(values(1), [bottom, top]));
    let (width, height, font) = match legend {
        Legend::Right => (WIDTH, HEIGHT, 12),
        Legend::Below => (right + 10.0, HEIGHT + 10.0 + 20.0 * series.len() as f64, 14),
    };
    let mut out = format!(
        "<svg xmlns='http://www.w3.org/2000/svg' viewBox='0 0 {width} {height}' font-family='sans-serif' \
         font-size='{font}'>\n<title>{title}</title>\n<rect width='{width}' height='{height}' fill='white'/>\n"
    );
    let mut add = |line: String| {
        // Writing to a string does not fail.
        let _ = writeln!(out, "{line}");
    };
    if legend == Legend::Right {
        add(format!("<text x='{left}' y='24' font-size='15'>{title}</text>"));
    }
    for x in across.ticks() {
        let at = across.at(x);
        add(format!("<line x1='{at:.1}' y1='{top}' x2='{at:.1}' y2='{bottom}' stroke='#ddd'/>"));
        add(format!("<text x='{at:.1}' y='{}' text-anchor='middle'>{}</text>", bottom + 16.0, label(x)));
    }
    for y in up.ticks() {
        let at = up.at(y);
        add(format!("<line x1='{left}' y1='{at:.1}' x2='{right}' y2='{at:.1}' stroke='#ddd'/>"));
        add(format!("<text x='{}' y='{:.1}' text-anchor='end'>{}</text>", left - 6.0, at + 4.0, label(y)));
    }
    let (w, h) = (right - left, bottom - top);
    add(format!("<rect x='{left}' y='{top}' width='{w}' height='{h}' fill='none' stroke='#444'/>"));
    let middle = (0.5 * (left + right), 0.5 * (top + bottom));
    add(format!("<text x='{}' y='{}' text-anchor='middle'>{x_label}</text>", middle.0, bottom + 36.0));
    add(format!(
        "<text transform='translate(16 {}) rotate(-90)' text-anchor='middle'>{y_label}</text>",
        middle.1
    ));
    for (i, (series, points)) in series.iter().enumerate() {
        let color = COLORS[i % COLORS.len()];
        let fill = if series.filled { color } else { "white" };
        let [column, row] = match legend {
            Legend::Right => [right + 18.0, top + 12.0 + 20.0 * i as f64],
            Legend::Below => [left + 6.0, HEIGHT + 12.0 + 20.0 * i as f64],
        };
        let places: Vec<[f64; 2]> = points.iter().map(|&[x, y]| [across.at(x), up.at(y)]).collect();
        if places.len() > 1 {
            let line: Vec<String> = places.iter().map(|[x, y]| format!("{x:.1},{y:.1}")).collect();
            add(format!(
                "<polyline points='{}' fill='none' stroke='{color}' stroke-width='2'/>",
                line.join(" ")
            ));
        }
        for [x, y] in places.into_iter().chain([[column, row - 4.0]]) {
            add(format!(
                "<circle cx='{x:.1}' cy='{y:.1}' r='4.5' fill='{fill}' stroke='{color}' stroke-width='2'/>"
            ));
        }
        add(format!("<text x='{}' y='{row}'>{}</text>", column + 12.0, escaped(&series.name)));
    }
    for [x, y] in positive(marked) {
        let (x, y) = (across.at(x), up.at(y));
        add(format!("<circle cx='{x:.1}' cy='{y:.1}' r='8' fill='none' stroke='#222' stroke-width='1.2'/>"));
    }
    out + "</svg>\n"
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_lie_inside_the_frame() {
        let series = |name: &str, points: &[[f64; 2]]| Series {
            name: name.into(),
            points: points.to_vec(),
            filled: points[0][0] < 1.0,
        };
        let text = svg(
            "a < b",
            ["time", "error"],
            &[
                series("a", &[[0.5, 1e-3]]),
                series("b", &[[2.0, 1e-2], [3.0, 2e-2]]),
                series("c", &[[0.0, 1.0]]),
            ],
            &[[2.0, 1e-2], [-1.0, 1.0]],
            Legend::Right,
        );
        assert_eq!(text.matches("<circle").count(), 7);
        assert_eq!(text.matches("<polyline").count(), 1);
        assert!(text.contains("a &lt; b"));
        for part in text.split("<circle cx='").skip(1) {
            let x: f64 = part.split('\'').next().unwrap().parse().unwrap();
            assert!(x > FRAME[0] && x < WIDTH);
        }
        assert_eq!(ticks(0.9, 6.0), [1.0, 2.0, 5.0]);
        assert_eq!(ticks(0.011, 0.035), [0.015, 0.02, 0.03]);
        assert_eq!([label(2e6), label(0.02), label(5e-4)], ["2e6", "0.02", "5e-4"]);
    }
}
