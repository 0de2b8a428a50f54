//! A scatter plot as SVG: methods by time and error, both logarithmic.

use std::fmt::Write;

/// A method in a plot.
pub struct Point {
    pub name: String,
    pub x: f64,
    pub y: f64,
    /// Whether it is free of cracks.
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

/// The plot as an SVG document. Points with a number that is not positive are left out.
pub fn svg(title: &str, [x_label, y_label]: [&str; 2], points: &[Point]) -> String {
    let points: Vec<&Point> = points.iter().filter(|p| p.x > 0.0 && p.y > 0.0).collect();
    let range = |of: fn(&Point) -> f64| {
        let values = || points.iter().map(|p| of(p));
        let (low, high) = (values().fold(f64::INFINITY, f64::min), values().fold(0.0, f64::max));
        (low / 1.25, high * 1.25)
    };
    let ((x0, x1), (y0, y1)) = (range(|p| p.x), range(|p| p.y));
    let [left, top, right, bottom] = FRAME;
    let at_x = |x: f64| left + (right - left) * (x / x0).ln() / (x1 / x0).ln();
    let at_y = |y: f64| bottom - (bottom - top) * (y / y0).ln() / (y1 / y0).ln();
    let mut out = format!(
        "<svg xmlns='http://www.w3.org/2000/svg' viewBox='0 0 {WIDTH} {HEIGHT}' font-family='sans-serif' \
         font-size='12'>\n<rect width='{WIDTH}' height='{HEIGHT}' fill='white'/>\n\
         <text x='{left}' y='24' font-size='15'>{title}</text>\n"
    );
    let mut add = |line: String| {
        // Writing to a string does not fail.
        let _ = writeln!(out, "{line}");
    };
    for x in ticks(x0, x1) {
        let at = at_x(x);
        add(format!("<line x1='{at:.1}' y1='{top}' x2='{at:.1}' y2='{bottom}' stroke='#ddd'/>"));
        add(format!("<text x='{at:.1}' y='{}' text-anchor='middle'>{x}</text>", bottom + 16.0));
    }
    for y in ticks(y0, y1) {
        let at = at_y(y);
        add(format!("<line x1='{left}' y1='{at:.1}' x2='{right}' y2='{at:.1}' stroke='#ddd'/>"));
        add(format!("<text x='{}' y='{:.1}' text-anchor='end'>{y}</text>", left - 6.0, at + 4.0));
    }
    let (w, h) = (right - left, bottom - top);
    add(format!("<rect x='{left}' y='{top}' width='{w}' height='{h}' fill='none' stroke='#444'/>"));
    let middle = (0.5 * (left + right), 0.5 * (top + bottom));
    add(format!("<text x='{}' y='{}' text-anchor='middle'>{x_label}</text>", middle.0, bottom + 36.0));
    add(format!(
        "<text transform='translate(16 {}) rotate(-90)' text-anchor='middle'>{y_label}</text>",
        middle.1
    ));
    for (i, point) in points.iter().enumerate() {
        let color = COLORS[i % COLORS.len()];
        let fill = if point.filled { color } else { "white" };
        let (x, y, row) = (at_x(point.x), at_y(point.y), top + 12.0 + 20.0 * i as f64);
        for (x, y) in [(x, y), (right + 18.0, row - 4.0)] {
            add(format!(
                "<circle cx='{x:.1}' cy='{y:.1}' r='5' fill='{fill}' stroke='{color}' stroke-width='2'/>"
            ));
        }
        add(format!("<text x='{}' y='{row}'>{}</text>", right + 30.0, point.name));
    }
    out + "</svg>\n"
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_lie_inside_the_frame() {
        let point = |name: &str, x, y| Point { name: name.into(), x, y, filled: x < 1.0 };
        let text = svg(
            "title",
            ["time", "error"],
            &[point("a", 0.5, 1e-3), point("b", 2.0, 1e-2), point("c", 0.0, 1.0)],
        );
        assert_eq!(text.matches("<circle").count(), 4);
        for part in text.split("<circle cx='").skip(1) {
            let x: f64 = part.split('\'').next().unwrap().parse().unwrap();
            assert!(x > FRAME[0] && x < WIDTH);
        }
        assert_eq!(ticks(0.9, 6.0), [1.0, 2.0, 5.0]);
        assert_eq!(ticks(0.011, 0.035), [0.015, 0.02, 0.03]);
    }
}
