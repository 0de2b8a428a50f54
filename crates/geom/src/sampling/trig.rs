//! Sine, cosine and arc tangent by series, with the same bits on every machine, which a system's libm does not promise.

use std::f64::consts::{FRAC_PI_2, PI};

/// Sine and cosine of `x` in `[-pi/4, pi/4]`; off by less than 1.5 units in the last place of 1.
#[inline]
pub fn sin_cos_octant(x: f32) -> (f32, f32) {
    let q = x * x;
    let sin = x * (1.0 + q * (-1.0 / 6.0 + q * (1.0 / 120.0 + q * (-1.0 / 5040.0 + q * (1.0 / 362_880.0)))));
    let cos = 1.0
        + q * (-0.5 + q * (1.0 / 24.0 + q * (-1.0 / 720.0 + q * (1.0 / 40_320.0 - q * (1.0 / 3_628_800.0)))));
    (sin, cos)
}

/// Sine and cosine of `x` radians, `|x|` up to about 1e6, off by a few 2^-53 (more for large `x`).
#[inline]
pub fn sin_cos(x: f64) -> (f64, f64) {
    let quarter = (x / FRAC_PI_2).round();
    let r = x - quarter * FRAC_PI_2;
    let q = r * r;
    // Taylor series: the terms left out are below 2^-53 for |r| <= pi/4.
    let (mut sin, mut cos) = (0.0, 0.0);
    for k in (1..9u32).rev() {
        let k = f64::from(2 * k);
        sin = (1.0 + sin) * -q / (k * (k + 1.0));
        cos = (1.0 + cos) * -q / (k * (k - 1.0));
    }
    let (sin, cos) = (r * (1.0 + sin), 1.0 + cos);
    match (quarter as i64).rem_euclid(4) {
        0 => (sin, cos),
        1 => (cos, -sin),
        2 => (-sin, -cos),
        _ => (-cos, sin),
    }
}

/// Arc tangent of `x` in `[0, 1]`, off by a few 2^-53 of itself.
fn atan_unit(x: f64) -> f64 {
    // Half the angle twice: |x| shrinks to at most 0.199, where twelve terms are enough.
    let halved = |x: f64| x / (1.0 + (1.0 + x * x).sqrt());
    let x = halved(halved(x));
    let q = x * x;
    let mut sum = 0.0;
    for k in (1..12u32).rev() {
        sum = -q * (1.0 / f64::from(2 * k + 1) + sum);
    }
    4.0 * x * (1.0 + sum)
}

/// Angle of the point `(x, y)` with `y >= 0`, in `[0, pi]`; 0 for the origin. Off by a few 2^-53 of itself.
pub fn atan2_upper(y: f64, x: f64) -> f64 {
    let ax = x.abs();
    let angle = if y == 0.0 {
        0.0
    } else if y <= ax {
        atan_unit(y / ax)
    } else {
        FRAC_PI_2 - atan_unit(ax / y)
    };
    if x < 0.0 { PI - angle } else { angle }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn series_agree_with_the_system(x in -1e3f64..1e3, y in 0f64..1e3, small in -0.785f32..0.785) {
            let (sin, cos) = sin_cos(x);
            prop_assert!((sin - x.sin()).abs() < 1e-12 && (cos - x.cos()).abs() < 1e-12);
            prop_assert!((atan2_upper(y, x) - y.atan2(x)).abs() < 1e-15 * 4.0);
            let (sin, cos) = sin_cos_octant(small);
            prop_assert!((f64::from(sin) - f64::from(small).sin()).abs() < 9e-8);
            prop_assert!((f64::from(cos) - f64::from(small).cos()).abs() < 9e-8);
        }

        #[test]
        fn small_angles_keep_their_relative_precision(y in 0f64..1e-3) {
            prop_assert!((atan2_upper(y * y, 1.0) - (y * y).atan()).abs() <= 1e-15 * y * y);
        }
    }

    #[test]
    fn axes() {
        assert_eq!(atan2_upper(0.0, 1.0), 0.0);
        assert_eq!(atan2_upper(0.0, 0.0), 0.0);
        assert_eq!(atan2_upper(0.0, -1.0), PI);
        assert_eq!(atan2_upper(1.0, 0.0), FRAC_PI_2);
        assert_eq!(sin_cos(0.0), (0.0, 1.0));
    }
}
