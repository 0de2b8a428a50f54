//! What of a triangle lies in a cell.

use umbrage_geom::{Aabb, glam::DVec3};

/// Room around planes, relative to the largest coordinate: far more than `f64` can err by, far less than `f32` resolves.
const PLANE_MARGIN: f64 = 1.0 / (1u64 << 40) as f64;

/// A box around the part of the triangle in the closed `cell`, never too small; `None` only if the two are apart.
///
/// Sutherland and Hodgman 1974, in `f64`, against planes moved outwards by more than all rounding.
pub(crate) fn clip(corners: [[f32; 3]; 3], cell: &Aabb) -> Option<Aabb> {
    let bounds = Aabb::from_points(&corners);
    let room = f64::from(bounds.min.abs().max(bounds.max.abs()).max_element()) * PLANE_MARGIN;
    let mut polygon = [DVec3::ZERO; 10];
    let mut len = 3;
    for (to, from) in polygon.iter_mut().zip(corners) {
        *to = DVec3::new(from[0].into(), from[1].into(), from[2].into());
    }
    for axis in 0..3 {
        for (plane, side) in
            [(f64::from(cell.min[axis]) - room, 1.0), (-f64::from(cell.max[axis]) - room, -1.0)]
        {
            let height = |p: DVec3| p[axis] * side - plane;
            let touched = if side > 0.0 {
                bounds.min[axis] < cell.min[axis]
            } else {
                bounds.max[axis] > cell.max[axis]
            };
            if !touched {
                continue;
            }
            let mut clipped = [DVec3::ZERO; 10];
            let mut kept = 0;
            for i in 0..len {
                let (a, b) = (polygon[i], polygon[(i + 1) % len]);
                let (ha, hb) = (height(a), height(b));
                if ha >= 0.0 {
                    clipped[kept] = a;
                    kept += 1;
                }
                if (ha >= 0.0) != (hb >= 0.0) {
                    let mut p = a + (b - a) * (ha / (ha - hb));
                    p[axis] = plane * side;
                    clipped[kept] = p;
                    kept += 1;
                }
            }
            if kept == 0 {
                return None;
            }
            (polygon, len) = (clipped, kept);
        }
    }
    let mut low = DVec3::INFINITY;
    let mut high = DVec3::NEG_INFINITY;
    for p in &polygon[..len] {
        low = low.min(*p);
        high = high.max(*p);
    }
    let (low, high) = (low - room, high + room);
    let down = |x: f64| if f64::from(x as f32) <= x { x as f32 } else { (x as f32).next_down() };
    let up = |x: f64| if f64::from(x as f32) >= x { x as f32 } else { (x as f32).next_up() };
    let mut clipped = bounds;
    for axis in 0..3 {
        // The triangle's own bounds and the cell's are exact: planar triangles stay planar.
        clipped.min[axis] = down(low[axis]).max(bounds.min[axis]).max(cell.min[axis]);
        clipped.max[axis] = up(high[axis]).min(bounds.max[axis]).min(cell.max[axis]);
    }
    (!clipped.is_empty()).then_some(clipped)
}

#[cfg(test)]
mod tests {
    use super::*;
    use umbrage_geom::glam::Vec3;

    #[test]
    fn clips_to_the_cell_and_keeps_planes() {
        let cell = Aabb { min: Vec3::ZERO, max: Vec3::ONE };
        let big = clip([[-5.0, 0.5, -5.0], [5.0, 0.5, -5.0], [0.0, 0.5, 9.0]], &cell).unwrap();
        assert_eq!((big.min, big.max), (Vec3::new(0.0, 0.5, 0.0), Vec3::new(1.0, 0.5, 1.0)));
        assert!(clip([[2.0, 0.0, 0.0], [0.0, 2.5, 0.0], [2.0, 2.5, 1.0]], &cell).is_none());
        let corner = clip([[2.0, 0.0, 0.5], [0.0, 2.0, 0.5], [2.0, 2.0, 0.5]], &cell).unwrap();
        assert!((corner.min - Vec3::new(1.0, 1.0, 0.5)).abs().max_element() < 1e-6);
        let touching = clip([[1.0, 0.2, 0.2], [2.0, 0.2, 0.2], [2.0, 0.9, 0.9]], &cell).unwrap();
        assert_eq!(touching.min, Vec3::new(1.0, 0.2, 0.2));
        assert!(touching.max.x == 1.0 && (touching.max.y - 0.2).abs() < 1e-6, "{touching:?}");
    }
}
