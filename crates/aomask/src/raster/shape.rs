//! Shapes that bound a triangle's region of influence (`[Laine10]`, section 4.1, figures 2 and 3).
//!
//! Here: hexagonal prisms and hemisphere billboards, as planes of their far side and as an outline in the image. Not here:
//! which pixels an outline covers (`outline.rs`), what is done with them (`tile.rs`).

use super::camera::RasterCamera;
use crate::Sides;
use umbrage_geom::glam::DVec3;

/// Ratio of a triangle's bounding radius to the radius of influence from which it gets a prism, the `alpha` of the paper.
const MIN_PRISM_RATIO: f64 = 0.2;

/// Corners of the polygons that stand for circles.
const CORNERS: usize = 12;

/// Share of the radius that regions are larger than needed, for rounding and for surfaces on concave edges.
const REGION_PADDING: f64 = 1e-3;

/// Cosines and sines of [`CORNERS`] angles.
const ANGLES: [[f64; 2]; CORNERS] = {
    const H: f64 = 0.866_025_403_784_438_6;
    [
        [1.0, 0.0],
        [H, 0.5],
        [0.5, H],
        [0.0, 1.0],
        [-0.5, H],
        [-H, 0.5],
        [-1.0, 0.0],
        [-H, -0.5],
        [-0.5, -H],
        [0.0, -1.0],
        [0.5, -H],
        [H, -0.5],
    ]
};
/// `1 / cos(15 degrees)`: a regular polygon with corners on a circle larger by this holds the circle.
const CIRCUMSCRIBED_RADIUS: f64 = 1.035_276_180_410_083;

/// A triangle set up for rasterization.
#[derive(Clone, Debug)]
pub(super) struct Influence {
    corners: [DVec3; 3],
    /// Unit, to the front.
    normal: DVec3,
    /// Bounding sphere of the triangle.
    pub(super) center: DVec3,
    pub(super) bound: f64,
    /// How far the triangle's influence goes, padded.
    reach: f64,
    sides: Sides,
}

/// What bounds a region of influence, as seen by a camera.
#[derive(Clone, Debug, Default)]
pub(super) struct Shape {
    /// Planes `n . x <= d` of the far side: a receiver beyond one of them fails the inverted depth test.
    pub(super) far: Vec<(DVec3, f64)>,
    /// Corners of the outline in the image: `u` and `v`; the outline is their convex hull.
    pub(super) outline: Vec<[f64; 2]>,
    /// Least depth of the shape.
    pub(super) nearest: f64,
}

impl Influence {
    /// `None` for a triangle without area, which blocks nothing.
    pub(super) fn new(corners: [DVec3; 3], radius: f64, sides: Sides) -> Option<Self> {
        let [a, b, c] = corners;
        let normal = (b - a).cross(c - a).try_normalize()?;
        let (center, bound) = bounding_sphere(corners);
        let largest = a.abs().max(b.abs()).max(c.abs()).max_element();
        let reach = radius * (1.0 + REGION_PADDING) + largest * 1e-6;
        Some(Self { corners, normal, center, bound, reach, sides })
    }

    /// Whether the triangle is large enough for a prism, or the eye too close for a billboard.
    pub(super) fn takes_prism(&self, camera: &RasterCamera) -> bool {
        let sphere = self.bound + self.reach;
        self.bound > MIN_PRISM_RATIO * self.reach || self.center.distance(camera.eye()) <= 1.05 * sphere
    }

    /// Writes the shape that the paper would draw; nothing nearer than `near` matters.
    pub(super) fn shape(&self, camera: &RasterCamera, near: f64, shape: &mut Shape) {
        shape.far.clear();
        shape.outline.clear();
        if self.takes_prism(camera) {
            self.prism(camera, near, shape);
        } else {
            self.billboard(camera, shape);
        }
    }

    /// Figure 2: lines at distance `reach` along the edges, and across the corners of the larger triangle they make.
    fn prism(&self, camera: &RasterCamera, near: f64, shape: &mut Shape) {
        let Self { corners, normal: n, reach, .. } = *self;
        let top = n * reach;
        let bottom = match self.sides {
            Sides::Both => -top,
            Sides::Front | Sides::FrontFirst => n * (-REGION_PADDING * reach),
        };
        let mut base = [DVec3::ZERO; 6];
        for i in 0..3 {
            let [before, v, after] = [corners[(i + 2) % 3], corners[i], corners[(i + 1) % 3]];
            let (to_before, to_after) = ((before - v).normalize(), (after - v).normalize());
            // Outwards along the bisector to line P, then along P to the lines of the two edges: `reach` times
            // tan(45 degrees - a quarter of the angle between them).
            let cosine = to_before.dot(to_after).clamp(-1.0, 1.0);
            let (half_sine, half_cosine) = ((0.5 * (1.0 - cosine)).sqrt(), (0.5 * (1.0 + cosine)).sqrt());
            let out = -(to_before + to_after).normalize_or(to_before.cross(n));
            let aside = n.cross(out) * (half_cosine / (1.0 + half_sine));
            base[2 * i] = v + (out - aside) * reach;
            base[2 * i + 1] = v + (out + aside) * reach;
        }
        let eye = camera.eye();
        let mut face = |normal: DVec3, point: DVec3| {
            let offset = normal.dot(point);
            if normal.dot(eye) <= offset {
                shape.far.push((normal, offset));
            }
        };
        face(n, corners[0] + top);
        face(-n, corners[0] + bottom);
        for i in 0..6 {
            face((base[(i + 1) % 6] - base[i]).cross(n).normalize_or_zero(), base[i]);
        }
        let points: [DVec3; 12] = std::array::from_fn(|i| base[i % 6] + if i < 6 { bottom } else { top });
        outline_of_prism(&points, camera, near, shape);
    }

    /// Figure 3: the outline of a sphere, or of the half of it that is in front of the triangle. The paper's two polygons,
    /// which meet along a line, are one here.
    fn billboard(&self, camera: &RasterCamera, shape: &mut Shape) {
        let sphere = self.bound + self.reach;
        let to_center = self.center - camera.eye();
        let distance = to_center.length();
        let axis = to_center / distance;
        let (x, y) = axis.any_orthonormal_pair();
        shape.nearest = camera.project(self.center).depth - sphere * camera.depth_per_length();
        // Just behind the sphere.
        shape.far.push((axis, axis.dot(self.center) + sphere));
        let mut add = |p: DVec3| {
            let seen = camera.project(p);
            shape.outline.push(seen.uv.map(|x| x / seen.depth));
        };
        // The circle where cone from the eye touches the sphere.
        let back = sphere * sphere / distance;
        let rim = (sphere * sphere - back * back).sqrt();
        let touching = |[cos, sin]: [f64; 2]| {
            self.center - axis * back + (x * cos + y * sin) * (rim * CIRCUMSCRIBED_RADIUS)
        };
        if self.sides == Sides::Both {
            ANGLES.into_iter().for_each(|angle| add(touching(angle)));
            return;
        }
        // In front of the triangle's plane, and as much behind as the next corner may be: arcs are covered to their ends.
        let slack = -rim * CIRCUMSCRIBED_RADIUS * 0.52;
        ANGLES
            .into_iter()
            .map(touching)
            .filter(|p| self.normal.dot(*p - self.center) > slack)
            .for_each(&mut add);
        let (x, y) = self.normal.any_orthonormal_pair();
        let lowered = self.center - self.normal * (REGION_PADDING * self.reach);
        ANGLES
            .into_iter()
            .for_each(|[cos, sin]| add(lowered + (x * cos + y * sin) * (sphere * CIRCUMSCRIBED_RADIUS)));
    }
}

/// The outline of a prism with corners `points`, base first, clipped at depth `near`.
fn outline_of_prism(points: &[DVec3; 12], camera: &RasterCamera, near: f64, shape: &mut Shape) {
    let seen = points.map(|p| camera.project(p));
    shape.nearest = seen.iter().fold(f64::INFINITY, |least, p| least.min(p.depth));
    let Shape { outline, .. } = shape;
    outline.extend(seen.iter().filter(|p| p.depth >= near).map(|p| p.uv.map(|x| x / p.depth)));
    if shape.nearest >= near {
        return;
    }
    let edges = (0..6).flat_map(|i| [(i, (i + 1) % 6), (i + 6, (i + 1) % 6 + 6), (i, i + 6)]);
    for (from, to) in edges {
        let (a, b) = (seen[from], seen[to]);
        if (a.depth >= near) != (b.depth >= near) {
            let t = (near - a.depth) / (b.depth - a.depth);
            outline.push([0, 1].map(|i| (a.uv[i] + (b.uv[i] - a.uv[i]) * t) / near));
        }
    }
}

/// Smallest sphere around a triangle.
fn bounding_sphere(corners: [DVec3; 3]) -> (DVec3, f64) {
    for i in 0..3 {
        let [p, q, r] = [corners[i], corners[(i + 1) % 3], corners[(i + 2) % 3]];
        // A right or obtuse angle at `r`: the longest side is a diameter.
        if (p - r).dot(q - r) <= 0.0 {
            return ((p + q) * 0.5, p.distance(q) * 0.5);
        }
    }
    let [a, b, c] = corners;
    let (ab, ac) = (b - a, c - a);
    let n = ab.cross(ac);
    let to_center =
        (n.cross(ab) * ac.length_squared() + ac.cross(n) * ab.length_squared()) / (2.0 * n.length_squared());
    (a + to_center, to_center.length())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn vector(size: f64) -> impl Strategy<Value = DVec3> {
        prop::array::uniform3(-size..size).prop_map(DVec3::from)
    }

    fn inside_hull(points: &[[f64; 2]], p: [f64; 2]) -> bool {
        super::super::outline::Hull::new(&mut points.to_vec()).contains(p)
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(3000))]
        #[test]
        fn shapes_hold_every_receiver_that_the_triangle_reaches(
            corners in prop::array::uniform3(vector(1.0)), size in -2i32..2, radius in 0.1f64..2.0,
            direction in vector(1.0), at in (0f64..1.0, 0f64..1.0, 0f64..1.0), front: bool, eye in vector(6.0),
        ) {
            let corners = corners.map(|c| c * 10f64.powi(size));
            let sides = if front { Sides::Front } else { Sides::Both };
            let Some(influence) = Influence::new(corners, radius, sides) else { return Ok(()) };
            // A receiver from which some point of the triangle is within the radius, on the side that counts.
            let (u, v) = if at.0 + at.1 > 1.0 { (1.0 - at.0, 1.0 - at.1) } else { (at.0, at.1) };
            let on = corners[0] + (corners[1] - corners[0]) * u + (corners[2] - corners[0]) * v;
            let mut offset = direction.normalize_or_zero() * (radius * at.2);
            if front && offset.dot(influence.normal) < 0.0 {
                offset = -offset;
            }
            let receiver = on + offset;
            let forward = (receiver - eye).normalize_or_zero() + vector_like(direction) * 0.3;
            let (right, up) = forward.normalize_or_zero().any_orthonormal_pair();
            prop_assume!(forward.length() > 0.1);
            let f = |v: DVec3| v.as_vec3().to_array();
            let camera =
                RasterCamera::new(f(eye), f(forward), f(right), f(up)).unwrap();
            let seen = camera.project(receiver);
            prop_assume!(seen.depth > 1e-3);
            let mut shape = Shape::default();
            influence.shape(&camera, seen.depth * 0.5, &mut shape);
            for (normal, offset) in &shape.far {
                prop_assert!(normal.dot(receiver) <= offset + 1e-9, "depth");
            }
            prop_assert!(shape.nearest <= seen.depth + 1e-9, "near end");
            prop_assert!(inside_hull(&shape.outline, seen.uv.map(|x| x / seen.depth)), "outline");
            // And the sphere of test 2.
            prop_assert!(receiver.distance(influence.center) <= influence.bound + radius * (1.0 + 1e-9));
        }
    }

    fn vector_like(v: DVec3) -> DVec3 {
        DVec3::new(v.y, v.z, v.x)
    }

    #[test]
    fn spheres_are_smallest() {
        let flat = [DVec3::ZERO, DVec3::X * 2.0, DVec3::new(1.0, 0.1, 0.0)];
        assert_eq!(bounding_sphere(flat), (DVec3::X, 1.0));
        let equal = [DVec3::X, DVec3::Y, DVec3::Z];
        let (center, radius) = bounding_sphere(equal);
        assert!((center - DVec3::splat(1.0 / 3.0)).length() < 1e-12);
        assert!((radius - (2.0f64 / 3.0).sqrt()).abs() < 1e-12);
    }
}
