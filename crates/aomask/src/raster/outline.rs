//! Convex outlines and the pixels they cover.

/// A convex polygon in the plane, counter-clockwise.
#[derive(Clone, Debug)]
pub(super) struct Hull {
    corners: Vec<[f64; 2]>,
}

/// Twice the area of the triangle `o`, `a`, `b`; positive if counter-clockwise.
fn turn(o: [f64; 2], a: [f64; 2], b: [f64; 2]) -> f64 {
    (a[0] - o[0]) * (b[1] - o[1]) - (a[1] - o[1]) * (b[0] - o[0])
}

impl Hull {
    /// The convex hull of `points`, which get sorted (Andrew's monotone chain).
    pub(super) fn new(points: &mut [[f64; 2]]) -> Self {
        points.sort_unstable_by(|a, b| a[0].total_cmp(&b[0]).then(a[1].total_cmp(&b[1])));
        let mut corners: Vec<[f64; 2]> = Vec::with_capacity(2 * points.len());
        let mut chain = |points: &mut dyn Iterator<Item = [f64; 2]>| {
            let start = corners.len();
            for p in points {
                while corners.len() >= start + 2
                    && turn(corners[corners.len() - 2], corners[corners.len() - 1], p) <= 0.0
                {
                    corners.pop();
                }
                corners.push(p);
            }
            // The last point starts the other half.
            corners.pop();
        };
        chain(&mut points.iter().copied());
        chain(&mut points.iter().rev().copied());
        if corners.is_empty() {
            corners.extend(points.first());
        }
        Self { corners }
    }

    /// Smallest and largest `y`; empty for no point.
    pub(super) fn rows(&self) -> [f64; 2] {
        self.corners
            .iter()
            .fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], c| [low.min(c[1]), high.max(c[1])])
    }

    /// Smallest and largest `x` of what lies between the horizontal lines at `low` and `high`.
    pub(super) fn span(&self, low: f64, high: f64) -> Option<[f64; 2]> {
        let mut span: Option<[f64; 2]> = None;
        let mut add = |x: f64| {
            span = Some(span.map_or([x, x], |[least, most]| [least.min(x), most.max(x)]));
        };
        for (i, &a) in self.corners.iter().enumerate() {
            let b = self.corners[(i + 1) % self.corners.len()];
            let (from, to) = (a[1].min(b[1]), a[1].max(b[1]));
            if to < low || from > high {
                continue;
            }
            for end in [a, b] {
                if (low..=high).contains(&end[1]) {
                    add(end[0]);
                }
            }
            for line in [low, high] {
                if from < line && line < to {
                    add(a[0] + (b[0] - a[0]) * ((line - a[1]) / (b[1] - a[1])));
                }
            }
        }
        span
    }

    #[cfg(test)]
    pub(super) fn contains(&self, p: [f64; 2]) -> bool {
        let n = self.corners.len();
        n > 2 && (0..n).all(|i| turn(self.corners[i], self.corners[(i + 1) % n], p) >= -1e-9)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn hulls_hold_their_points_and_spans_their_slices(
            mut points in prop::collection::vec(prop::array::uniform2(-2f64..2.0), 3..20), at in -2f64..2.0,
        ) {
            let all = points.clone();
            let hull = Hull::new(&mut points);
            prop_assert!(all.iter().all(|&p| hull.contains(p)));
            let [low, high] = hull.rows();
            prop_assert!(all.iter().all(|p| (low..=high).contains(&p[1])));
            match hull.span(at, at) {
                None => prop_assert!(at < low || at > high),
                Some([least, most]) => {
                    let middle = [0.5 * (least + most), at];
                    prop_assert!(hull.contains(middle));
                    prop_assert!(!hull.contains([most + 1e-3, at]) && !hull.contains([least - 1e-3, at]));
                }
            }
            let [least, most] = hull.span(-3.0, 3.0).unwrap();
            prop_assert!(all.iter().all(|p| (least..=most).contains(&p[0])));
        }
    }

    #[test]
    fn degenerate_hulls() {
        assert_eq!(Hull::new(&mut []).span(-1.0, 1.0), None);
        assert_eq!(Hull::new(&mut [[1.0, 2.0]; 3]).span(0.0, 3.0), Some([1.0, 1.0]));
        let line = Hull::new(&mut [[0.0, 0.0], [2.0, 2.0], [1.0, 1.0]]);
        assert_eq!(line.span(0.5, 0.5), Some([0.5, 0.5]));
    }
}
