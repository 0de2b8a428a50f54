//! The filter one lane at a time, in plain operations.

use super::{
    BlockMask, BlockRay, DEPTH_ERROR, DEPTH_UNDERFLOW, EDGE_ERROR, LANES, LARGEST, Lanes, SHEAR_ERROR,
};

/// Filters a block; see the [module](super).
#[inline]
pub fn filter(block: &impl Lanes, ray: &BlockRay) -> BlockMask {
    let mut mask = BlockMask::default();
    for lane in (0..LANES).filter(|lane| block.used() >> lane & 1 == 1) {
        match hit(block.triangle(lane), ray) {
            Some(true) => mask.certain |= 1 << lane,
            Some(false) => {}
            None => mask.uncertain |= 1 << lane,
        }
    }
    mask
}

/// Whether the segment hits the triangle, if that is certain.
#[inline]
fn hit(corners: [[f32; 3]; 3], ray: &BlockRay) -> Option<bool> {
    let corner = |c: usize| {
        let p = [0, 1, 2].map(|i| corners[c][ray.axes[i]] - ray.origin[i]);
        let z = p[2] * ray.sign;
        [p[0] - ray.slopes[0] * z, p[1] - ray.slopes[1] * z, z]
    };
    let [a, b, c] = [corner(0), corner(1), corner(2)];
    let (least, greatest) = (a[2].min(b[2]).min(c[2]), a[2].max(b[2]).max(c[2]));
    if greatest < ray.near.below || least > ray.far.above {
        return Some(false);
    }
    let across = [a[0], a[1], b[0], b[1], c[0], c[1]].map(f32::abs).into_iter().fold(0.0, f32::max);
    let depth = greatest.max(-least);
    let size = across + depth;
    // Sheared coordinates are NaN only where `depth` is infinite.
    if size.is_nan() || size >= LARGEST {
        return None;
    }
    let error = EDGE_ERROR * size * (across + SHEAR_ERROR * size) + f32::MIN_POSITIVE;
    let edges = [c[0] * b[1] - c[1] * b[0], a[0] * c[1] - a[1] * c[0], b[0] * a[1] - b[1] * a[0]];
    let (positive, negative) = (edges.map(|e| e > error), edges.map(|e| e < -error));
    if positive.contains(&true) && negative.contains(&true) {
        return Some(false);
    }
    let side = match (positive, negative) {
        ([true, true, true], _) => 1.0,
        (_, [true, true, true]) => -1.0,
        _ => return None,
    };
    if least > ray.near.above && greatest < ray.far.below {
        return Some(true);
    }
    let volume = (edges[0] * a[2] + edges[1] * b[2] + edges[2] * c[2]) * side;
    let sum = (edges[0] + edges[1] + edges[2]) * side;
    let relative = 3.0 * error + DEPTH_ERROR * sum;
    // How far beyond `z` for certain, positive or negative; NaN is neither.
    let beyond = |z: f32| (volume - z * sum, (depth + z) * relative + DEPTH_UNDERFLOW);
    let (near, near_error) = beyond(ray.near.rounded);
    let (far, far_error) =
        if ray.far.rounded == f32::INFINITY { (-1.0, 0.0) } else { beyond(ray.far.rounded) };
    if near < -near_error || far > far_error {
        Some(false)
    } else if near > near_error && far < -far_error {
        Some(true)
    } else {
        None
    }
}
