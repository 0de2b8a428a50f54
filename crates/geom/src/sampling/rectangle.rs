//! Rectangles sampled uniformly by solid angle.
//!
//! # Source
//! Ureña, Fajardo and King, An Area-Preserving Parametrization for Spherical Rectangles, 2013. Departures: the solid angle
//! comes from the two triangles of the rectangle (Van Oosterom and Strackee 1983), whose formula does not cancel however
//! small it is; angles are arc tangents instead of arc cosines; and where the closed form loses digits the map is inverted
//! by bisection.

use super::lights::{LightSample, SMALLEST_SOLID_ANGLE};
use super::trig::{atan2_upper, sin_cos};
use glam::{DVec3, Vec2, Vec3};
use std::f64::consts::PI;

/// A rectangle as a receiver sees it. All lengths in world units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SphericalRectangle {
    receiver: Vec3,
    /// Unit vectors along the edges and from the receiver's side towards the plane.
    axes: [DVec3; 3],
    /// Extent along the edges, from the foot of the receiver.
    x: [f64; 2],
    y: [f64; 2],
    /// Distance of the receiver from the plane.
    height: f64,
    front: bool,
    solid_angle: f64,
    inversion: Inversion,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Inversion {
    /// `k`, `b0`, `b1` of the paper.
    Closed([f64; 3]),
    Bisection,
}

impl SphericalRectangle {
    /// The rectangle with perpendicular edges `u` and `v` from `corner`, seen from `receiver`.
    ///
    /// Its solid angle is 0, and [`Self::sample`] gives nothing, if an edge is zero or anything is not finite, or if the
    /// receiver lies in its plane (to within 1e-12 of the distance of the farthest corner), hence also on it. If the edges
    /// are not perpendicular, `v` is replaced by its part across `u`; see [`Self::is_rectangular`].
    pub fn new(receiver: Vec3, corner: Vec3, u: Vec3, v: Vec3) -> Self {
        let (u, v) = (u.as_dvec3(), v.as_dvec3());
        let ex = u.normalize_or_zero();
        let across = v - ex * v.dot(ex);
        let ey = across.normalize_or_zero();
        let normal = ex.cross(ey);
        let to_corner = corner.as_dvec3() - receiver.as_dvec3();
        let signed = to_corner.dot(normal);
        let (x0, y0) = (to_corner.dot(ex), to_corner.dot(ey));
        let mut rectangle = Self {
            receiver,
            axes: [ex, ey, if signed < 0.0 { -normal } else { normal }],
            x: [x0, x0 + u.length()],
            y: [y0, y0 + across.length()],
            height: signed.abs(),
            front: signed < 0.0,
            solid_angle: 0.0,
            inversion: Inversion::Bisection,
        };
        let reach = rectangle.x.iter().chain(&rectangle.y).fold(0f64, |m, c| m.max(c.abs()));
        // Written so that NaN fails.
        if rectangle.height > 1e-12 * reach && reach.is_finite() && rectangle.height.is_finite() {
            let solid_angle = rectangle.solid_angle_up_to(rectangle.x[1]);
            if solid_angle >= SMALLEST_SOLID_ANGLE {
                rectangle.solid_angle = solid_angle;
                rectangle.inversion = rectangle.choose_inversion(reach);
            }
        }
        rectangle
    }

    /// Whether `u` and `v` are perpendicular to within `f32` rounding, so that [`Self::new`] takes them as they are.
    pub fn is_rectangular(u: Vec3, v: Vec3) -> bool {
        let (u, v) = (u.as_dvec3(), v.as_dvec3());
        u.dot(v).abs() <= 1e-6 * u.length() * v.length()
    }

    /// Steradians, in `[0, 2 pi)`, precise to `f32` for rectangles of any size and distance.
    pub fn solid_angle(&self) -> f32 {
        self.solid_angle as f32
    }

    /// Whether the receiver is on the side that `u x v` points to; `false` in the plane.
    pub fn is_front(&self) -> bool {
        self.front
    }

    /// A point of the rectangle, uniform by solid angle: the density is `1 / solid_angle` everywhere.
    pub fn sample(&self, square: Vec2) -> Option<LightSample> {
        if self.solid_angle == 0.0 {
            return None;
        }
        let x = match self.inversion {
            Inversion::Closed(constants) => self.invert(f64::from(square.x), constants),
            Inversion::Bisection => self.bisect(f64::from(square.x)),
        };
        // At fixed x the density along y is that of y / sqrt(d^2 + y^2).
        let d2 = x * x + self.height * self.height;
        let sine = |y: f64| y / (d2 + y * y).sqrt();
        let (low, high) = (sine(self.y[0]), sine(self.y[1]));
        let s = low + f64::from(square.y) * (high - low);
        let y = s * (d2 / (1.0 - s * s).max(f64::MIN_POSITIVE)).sqrt();
        let y = y.clamp(self.y[0], self.y[1]);
        let to_point = self.axes[0] * x + self.axes[1] * y + self.axes[2] * self.height;
        LightSample::new(self.receiver, to_point, 1.0 / self.solid_angle)
    }

    /// Solid angle of the part between the first edge and `x`.
    fn solid_angle_up_to(&self, x: f64) -> f64 {
        let ([x0, _], [y0, y1], h) = (self.x, self.y, self.height);
        let corner = |x, y| DVec3::new(x, y, h);
        let (a, b, c, d) = (corner(x0, y0), corner(x, y0), corner(x, y1), corner(x0, y1));
        let volume = h * (x - x0).max(0.0) * (y1 - y0);
        triangle_solid_angle(volume, a, b, c) + triangle_solid_angle(volume, a, c, d)
    }

    fn choose_inversion(&self, reach: f64) -> Inversion {
        let ([x0, _], [y0, y1], h) = (self.x, self.y, self.height);
        if self.solid_angle < 1e-6 || h < 1e-4 * reach {
            return Inversion::Bisection;
        }
        // Angles between the side planes: the paper's acos(-n_i.z n_j.z), with 1 - cos^2 worked out.
        let angle = |product: f64, p: f64, q: f64| atan2_upper(h * (p * p + q * q + h * h).sqrt(), product);
        let g2 = angle(x0 * y1, x0, y1);
        let g3 = angle(-x0 * y0, x0, y0);
        Inversion::Closed([2.0 * PI - g2 - g3, -y0 / length2(y0, h), y1 / length2(y1, h)])
    }

    /// The paper's steps for `x`.
    fn invert(&self, u: f64, [k, b0, b1]: [f64; 3]) -> f64 {
        let (sin, cos) = sin_cos(u * self.solid_angle + k);
        let f = (cos * b0 - b1) / sin;
        let c = (1f64.copysign(f) / (f * f + b0 * b0).sqrt()).clamp(-1.0, 1.0);
        let x = c * self.height / (1.0 - c * c).max(f64::MIN_POSITIVE).sqrt();
        x.clamp(self.x[0], self.x[1])
    }

    fn bisect(&self, u: f64) -> f64 {
        let target = u * self.solid_angle;
        let [mut low, mut high] = self.x;
        for _ in 0..64 {
            let middle = 0.5 * (low + high);
            if self.solid_angle_up_to(middle) < target { low = middle } else { high = middle }
        }
        low
    }
}

/// Solid angle of a triangle with corners relative to the receiver; `volume` is their determinant, at least 0.
fn triangle_solid_angle(volume: f64, a: DVec3, b: DVec3, c: DVec3) -> f64 {
    let (la, lb, lc) = (a.length(), b.length(), c.length());
    2.0 * atan2_upper(volume, la * lb * lc + a.dot(b) * lc + a.dot(c) * lb + b.dot(c) * la)
}

/// Length of a plane vector by a square root, which rounds the same everywhere, unlike `hypot`.
fn length2(x: f64, y: f64) -> f64 {
    (x * x + y * y).sqrt()
}
