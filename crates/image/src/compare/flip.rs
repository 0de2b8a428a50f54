//! LDR-FLIP, the visible difference of two images shown in turn at the same place (`[Andersson20]`).
//!
//! Here: the error map of two images of linear light in `[0, 1]`. Not here: means, files, exposure.
//!
//! All filters are products of functions of x and of y, or sums of two such products, and run as such: rows, then
//! columns. Outside the image the nearest pixel goes on.

use rayon::prelude::*;
use std::f32::consts::PI;

/// Pixels per degree of a 0.7 m wide screen of 3840 pixels seen from 0.7 m, the setting that FLIP values are quoted for.
pub const PIXELS_PER_DEGREE: f32 = 67.0;

/// Contrast sensitivity, section 4.1.1: sums of Gaussians `a * exp(-b f^2)`; `(a, b)` for achromatic, red-green and
/// blue-yellow.
const CSF: [&[(f32, f32)]; 3] = [&[(1.0, 0.0047)], &[(1.0, 0.0053)], &[(34.1, 0.04), (13.5, 0.025)]];

/// Exponent of the colour error, and where the redistribution bends: section 4.1.4.
const QC: f32 = 0.7;
const PC: f32 = 0.4;
const PT: f32 = 0.95;
/// Width of the features that the eye finds, in degrees, and exponent of the feature error: section 4.2.
const FEATURE_WIDTH: f32 = 0.082;
const QF: f32 = 0.5;

/// White point D65 for sRGB, and XYZ from linear sRGB (IEC 61966-2-1).
const WHITE: [f32; 3] = [0.950_456, 1.0, 1.089_058];
const XYZ_FROM_RGB: [[f32; 3]; 3] =
    [[0.412_391, 0.357_584, 0.180_481], [0.212_639, 0.715_169, 0.072_192], [0.019_331, 0.119_195, 0.950_532]];
const RGB_FROM_XYZ: [[f32; 3]; 3] = [
    [3.240_97, -1.537_383, -0.498_611],
    [-0.969_244, 1.875_968, 0.041_555],
    [0.055_630, -0.203_977, 1.056_972],
];

/// Error of every pixel, in `[0, 1]`; the same if `a` and `b` are swapped.
///
/// Images are rows from the top; values outside `[0, 1]` are clamped, NaN counts as 0.
///
/// # Panics
/// If an image has not `width * height` pixels, or there are none.
pub fn flip(width: usize, height: usize, a: &[[f32; 3]], b: &[[f32; 3]], pixels_per_degree: f32) -> Vec<f32> {
    assert!(width > 0 && a.len() == width * height && b.len() == a.len());
    let size = (width, height);
    let [(color_a, features_a), (color_b, features_b)] = [a, b].map(|image| {
        let opponent = Planes::new(image);
        (opponent.perceived(size, pixels_per_degree), features(&opponent.0[0], size, pixels_per_degree))
    });
    // The largest colour error there is: green against blue.
    let largest = hyab(hunt_lab([0.0, 1.0, 0.0]), hunt_lab([0.0, 0.0, 1.0])).powf(QC);
    (0..a.len())
        .into_par_iter()
        .map(|i| {
            let color = redistribute(hyab(color_a[i], color_b[i]).powf(QC), largest);
            let [(edge_a, point_a), (edge_b, point_b)] = [features_a[i], features_b[i]];
            let difference = (edge_a - edge_b).abs().max((point_a - point_b).abs());
            let feature = (difference * std::f32::consts::FRAC_1_SQRT_2).powf(QF);
            color.powf((1.0 - feature).max(0.0))
        })
        .collect()
}

/// YCxCz: lightness, red-green and blue-yellow, each a plane of the image.
struct Planes([Vec<f32>; 3]);

impl Planes {
    fn new(linear: &[[f32; 3]]) -> Self {
        let mut planes = [const { Vec::new() }; 3];
        planes.iter_mut().for_each(|plane| plane.reserve_exact(linear.len()));
        for &rgb in linear {
            let shown = rgb.map(|v| if v.is_nan() { 0.0 } else { v.clamp(0.0, 1.0) });
            let opponent = opponent_from_xyz(multiply(&XYZ_FROM_RGB, shown));
            planes.iter_mut().zip(opponent).for_each(|(plane, value)| plane.push(value));
        }
        Self(planes)
    }

    /// What the eye sees of the image: blurred by the contrast sensitivity, as Lab with Hunt's effect.
    fn perceived(&self, size: (usize, usize), pixels_per_degree: f32) -> Vec<[f32; 3]> {
        // The widest Gaussian decides about the radius of all.
        let deviation = (0.04 / (2.0 * PI * PI)).sqrt();
        let radius = (3.0 * deviation * pixels_per_degree).ceil() as i32;
        let [y, cx, cz] = [0, 1, 2].map(|c| {
            // In space `a exp(-b f^2)` is `a sqrt(pi / b) exp(-pi^2 d^2 / b)`, d in degrees; weights sum to 1.
            let terms: Vec<(f32, Vec<f32>)> = CSF[c]
                .iter()
                .map(|&(a, b)| {
                    let gaussian = kernel(radius, |x| (-(PI * x / pixels_per_degree).powi(2) / b).exp());
                    (a * (PI / b).sqrt(), gaussian)
                })
                .collect();
            let total: f32 = terms.iter().map(|(a, g)| a * g.iter().sum::<f32>().powi(2)).sum();
            let mut sum = vec![0.0; self.0[c].len()];
            for (a, gaussian) in &terms {
                let blurred = separable(&self.0[c], size, gaussian, gaussian);
                sum.iter_mut().zip(blurred).for_each(|(s, v)| *s += v * (a / total));
            }
            sum
        });
        (0..y.len())
            .into_par_iter()
            .map(|i| {
                let rgb = multiply(&RGB_FROM_XYZ, xyz_from_opponent([y[i], cx[i], cz[i]]));
                hunt_lab(rgb.map(|v| v.clamp(0.0, 1.0)))
            })
            .collect()
    }
}

/// How much of an edge and of a point each pixel is, from lightness: section 4.2.
fn features(lightness: &[f32], size: (usize, usize), pixels_per_degree: f32) -> Vec<(f32, f32)> {
    let deviation = 0.5 * FEATURE_WIDTH * pixels_per_degree;
    let radius = (3.0 * deviation).ceil() as i32;
    let gaussian = |x: f32| (-x * x / (2.0 * deviation * deviation)).exp();
    let blur = kernel(radius, gaussian);
    let total: f32 = blur.iter().sum();
    let blur: Vec<f32> = blur.into_iter().map(|w| w / total).collect();
    let edge = balanced(kernel(radius, |x| -x * gaussian(x)));
    let point = balanced(kernel(radius, |x| (x * x / (deviation * deviation) - 1.0) * gaussian(x)));
    let normalized: Vec<f32> = lightness.iter().map(|y| (y + 16.0) / 116.0).collect();
    let magnitude = |along: &[f32]| -> Vec<f32> {
        let x = separable(&normalized, size, along, &blur);
        let y = separable(&normalized, size, &blur, along);
        x.into_iter().zip(y).map(|(x, y)| x.hypot(y)).collect()
    };
    magnitude(&edge).into_iter().zip(magnitude(&point)).collect()
}

fn kernel(radius: i32, weight: impl Fn(f32) -> f32) -> Vec<f32> {
    (-radius..=radius).map(|x| weight(x as f32)).collect()
}

/// Positive weights sum to 1, negative ones to -1.
fn balanced(kernel: Vec<f32>) -> Vec<f32> {
    let positive: f32 = kernel.iter().filter(|w| **w > 0.0).sum();
    let negative: f32 = -kernel.iter().filter(|w| **w < 0.0).sum::<f32>();
    kernel.into_iter().map(|w| if w > 0.0 { w / positive } else { w / negative }).collect()
}

/// Correlation with `along_x` and then `along_y`, both of odd length.
fn separable(plane: &[f32], (width, height): (usize, usize), along_x: &[f32], along_y: &[f32]) -> Vec<f32> {
    let mut rows = vec![0.0; plane.len()];
    rows.par_chunks_exact_mut(width).zip(plane.par_chunks_exact(width)).for_each(|(out, row)| {
        let radius = along_x.len() / 2;
        let mut padded = vec![row[0]; radius];
        padded.extend_from_slice(row);
        padded.resize(width + 2 * radius, row[width - 1]);
        for (value, window) in out.iter_mut().zip(padded.windows(along_x.len())) {
            *value = window.iter().zip(along_x).map(|(v, w)| v * w).sum();
        }
    });
    let mut columns = vec![0.0; plane.len()];
    columns.par_chunks_exact_mut(width).enumerate().for_each(|(y, out)| {
        for (i, weight) in along_y.iter().enumerate() {
            let row = (y + i).saturating_sub(along_y.len() / 2).min(height - 1);
            out.iter_mut().zip(&rows[row * width..][..width]).for_each(|(value, v)| *value += v * weight);
        }
    });
    columns
}

fn multiply(m: &[[f32; 3]; 3], v: [f32; 3]) -> [f32; 3] {
    m.map(|row| row[0] * v[0] + row[1] * v[1] + row[2] * v[2])
}

fn opponent_from_xyz(xyz: [f32; 3]) -> [f32; 3] {
    let [x, y, z] = std::array::from_fn(|i| xyz[i] / WHITE[i]);
    [116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)]
}

fn xyz_from_opponent([lightness, cx, cz]: [f32; 3]) -> [f32; 3] {
    let y = (lightness + 16.0) / 116.0;
    [(y + cx / 500.0) * WHITE[0], y * WHITE[1], (y - cz / 200.0) * WHITE[2]]
}

/// CIE Lab of linear sRGB, with chroma in proportion to lightness (the Hunt effect).
fn hunt_lab(rgb: [f32; 3]) -> [f32; 3] {
    const DELTA: f32 = 6.0 / 29.0;
    let xyz = multiply(&XYZ_FROM_RGB, rgb);
    let [x, y, z] = std::array::from_fn(|i| {
        let t = xyz[i] / WHITE[i];
        if t > DELTA.powi(3) { t.cbrt() } else { t / (3.0 * DELTA * DELTA) + 4.0 / 29.0 }
    });
    let lightness = 116.0 * y - 16.0;
    let hunt = 0.01 * lightness;
    [lightness, 500.0 * (x - y) * hunt, 200.0 * (y - z) * hunt]
}

fn hyab(a: [f32; 3], b: [f32; 3]) -> f32 {
    (a[0] - b[0]).abs() + (a[1] - b[1]).hypot(a[2] - b[2])
}

/// Small errors get most of the range from 0 to 1, the rare large ones the end of it.
fn redistribute(error: f32, largest: f32) -> f32 {
    let bend = PC * largest;
    let value =
        if error < bend { error * PT / bend } else { PT + (error - bend) / (largest - bend) * (1.0 - PT) };
    value.clamp(0.0, 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::color::srgb_to_linear;

    const SIZE: (usize, usize) = (96, 64);

    fn image(byte: impl Fn(usize, usize, usize) -> usize) -> Vec<[f32; 3]> {
        let pixel = |i: usize| {
            std::array::from_fn(|c| {
                let value = byte(i % SIZE.0, i / SIZE.0, c).min(255) as f64;
                srgb_to_linear(value / 255.0) as f32
            })
        };
        (0..SIZE.0 * SIZE.1).map(pixel).collect()
    }

    fn mean(a: &[[f32; 3]], b: &[[f32; 3]]) -> f64 {
        let map = flip(SIZE.0, SIZE.1, a, b, PIXELS_PER_DEGREE);
        assert!(map.iter().all(|e| (0.0..=1.0).contains(e)));
        map.iter().copied().map(f64::from).sum::<f64>() / map.len() as f64
    }

    fn gradient() -> Vec<[f32; 3]> {
        image(|x, y, c| [x * 2 + 20, y * 3 + 10, (x + y) + 40][c])
    }

    /// Noise that needs no generator.
    fn noise(x: usize, y: usize, c: usize) -> usize {
        (x * 7919 + y * 104_729 + c * 1_299_709) % 251
    }

    #[test]
    fn equal_images_have_no_error_and_opposite_ones_the_largest() {
        let gradient = gradient();
        assert_eq!(mean(&gradient, &gradient), 0.0);
        let (black, white) = (image(|_, _, _| 0), image(|_, _, _| 255));
        assert!(mean(&black, &white) > 0.95);
        let (green, blue) = (image(|_, _, c| [0, 255, 0][c]), image(|_, _, c| [0, 0, 255][c]));
        assert!((mean(&green, &blue) - 1.0).abs() < 1e-5);
    }

    #[test]
    fn order_does_not_matter_and_light_outside_the_screen_is_clamped() {
        let (a, b) = (gradient(), image(noise));
        assert_eq!(mean(&a, &b), mean(&b, &a));
        let odd = |v: f32| vec![[v; 3]; SIZE.0 * SIZE.1];
        assert_eq!(mean(&odd(1.0), &odd(f32::INFINITY)), 0.0);
        assert_eq!(mean(&odd(0.0), &odd(-3.0)), 0.0);
        assert_eq!(mean(&odd(0.0), &odd(f32::NAN)), 0.0);
    }

    #[test]
    fn one_pixel_is_an_image() {
        let map = flip(1, 1, &[[0.0; 3]], &[[1.0; 3]], PIXELS_PER_DEGREE);
        assert!(map[0] > 0.95 && map[0] <= 1.0);
    }

    #[test]
    fn coarser_error_is_more_visible_than_fine_error_of_the_same_size() {
        let grey = image(|_, _, _| 128);
        let checks = |size: usize| {
            image(move |x, y, _| if (x / size + y / size).is_multiple_of(2) { 118 } else { 138 })
        };
        assert!(mean(&grey, &checks(1)) < 0.5 * mean(&grey, &checks(16)));
    }

    /// Numbers from NVIDIA's implementation (nv-flip 0.1.2) for the same 8-bit images.
    #[test]
    fn agrees_with_the_authors_implementation() {
        let gradient = gradient();
        let cases =
            [
                ("noise", image(noise), 0.693_127),
                ("offset", image(|x, y, c| [x * 2 + 25, y * 3 + 10, (x + y) + 40][c]), 0.073_817),
                (
                    "edge",
                    image(|x, y, c| [x * 2 + 20, y * 3 + 10, x + y + 40][c] + 60 * usize::from(x > 50)),
                    0.314_069,
                ),
                (
                    "dots",
                    image(|x, y, c| {
                        if x % 16 == 8 && y % 16 == 8 { 255 } else { [x * 2 + 20, y * 3 + 10, x + y + 40][c] }
                    }),
                    0.025_076,
                ),
            ];
        for (name, other, expected) in cases {
            let found = mean(&gradient, &other);
            assert!((found - expected).abs() < 5e-5, "{name}: {found} is not {expected}");
        }
    }
}
