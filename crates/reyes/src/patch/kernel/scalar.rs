//! One point after the other: the oracle.

use umbrage_geom::glam::Vec3;

/// See [`super::Kernel::row`].
pub(super) fn row(curve: &[Vec3; 4], weights: &[[f32; 4]], row: &mut [Vec3]) {
    let [a, b, c, d] = *curve;
    for (p, w) in row.iter_mut().zip(weights) {
        *p = ((a * w[0] + b * w[1]) + c * w[2]) + d * w[3];
    }
}
