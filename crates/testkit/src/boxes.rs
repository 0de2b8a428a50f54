//! Segments against boxes in exact rational arithmetic.

use num_rational::BigRational;

/// Points `origin + t * direction` with `t` from `ends[0]` to `ends[1]`, which may be infinite. All other numbers are finite.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Segment {
    /// Where `t` is 0.
    pub origin: [f32; 3],
    /// Way for a `t` of 1. It need not be a unit vector.
    pub direction: [f32; 3],
    /// First and last `t`.
    pub ends: [f32; 2],
}

/// Whether the closed segment has a point in the closed box from corner `min` to corner `max`.
///
/// # Panics
/// If a number is NaN, or one other than the last `t` is infinite.
pub fn segment_touches_box(segment: &Segment, [min, max]: [[f32; 3]; 2]) -> bool {
    clip(segment, [min, max], |a, b| a <= b)
}

/// Whether the open segment has a point in the open box from corner `min` to corner `max`.
///
/// # Panics
/// If a number is NaN, or one other than the last `t` is infinite.
pub fn segment_meets_interior(segment: &Segment, [min, max]: [[f32; 3]; 2]) -> bool {
    clip(segment, [min, max], |a, b| a < b)
}

/// Whether `before` holds for all bounds of what the box's slabs leave of the segment.
fn clip(
    segment: &Segment,
    [min, max]: [[f32; 3]; 2],
    before: impl Fn(&BigRational, &BigRational) -> bool,
) -> bool {
    let q = |x: f32| BigRational::from_float(x).expect("a finite number");
    let mut t0 = q(segment.ends[0]);
    let mut t1 = (segment.ends[1] < f32::INFINITY).then(|| q(segment.ends[1]));
    for axis in 0..3 {
        let (o, d) = (q(segment.origin[axis]), q(segment.direction[axis]));
        let (low, high) = (q(min[axis]), q(max[axis]));
        if d == q(0.0) {
            if !before(&low, &o) || !before(&o, &high) {
                return false;
            }
            continue;
        }
        let (a, b) = ((low - &o) / &d, (high - &o) / &d);
        let (near, far) = if a < b { (a, b) } else { (b, a) };
        t0 = t0.max(near);
        t1 = Some(t1.map_or(far.clone(), |t| t.min(far)));
    }
    t1.is_none_or(|t1| before(&t0, &t1))
}

#[cfg(test)]
mod tests {
    use super::*;

    const UNIT: [[f32; 3]; 2] = [[0.0; 3], [1.0; 3]];

    #[test]
    fn touching_is_not_meeting() {
        let along =
            |y: f32, ends: [f32; 2]| Segment { origin: [-1.0, y, 0.5], direction: [1.0, 0.0, 0.0], ends };
        let both = |s: Segment| [segment_touches_box(&s, UNIT), segment_meets_interior(&s, UNIT)];
        assert_eq!(both(along(0.5, [0.0, f32::INFINITY])), [true, true]);
        assert_eq!(both(along(1.0, [0.0, f32::INFINITY])), [true, false]);
        assert_eq!(both(along(1.0f32.next_up(), [0.0, f32::INFINITY])), [false, false]);
        assert_eq!(both(along(0.5, [0.0, 1.0])), [true, false]);
        assert_eq!(both(along(0.5, [2.0, 3.0])), [true, false]);
        assert_eq!(both(along(0.5, [2.0f32.next_up(), 3.0])), [false, false]);
    }

    #[test]
    fn flat_boxes_are_touched_but_have_no_interior() {
        let down = Segment { origin: [0.25, 0.25, 1.0], direction: [0.0, 0.0, -1.0], ends: [0.0, 4.0] };
        let flat = [[0.0; 3], [1.0, 1.0, 0.0]];
        assert!(segment_touches_box(&down, flat) && !segment_meets_interior(&down, flat));
    }
}
