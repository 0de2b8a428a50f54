//! `knots`: a long thin closed tube along a torus knot, whose inside is nowhere thick.

use super::{Generated, Inputs, builder::transport, random::Stream, shapes::whole};
use std::f64::consts::{PI, TAU};
use umbrage_geom::{
    Frame, TriangleMesh,
    glam::{DVec3, Vec3},
};

/// A closed curve with a sway that depends on the seed.
struct Curve {
    turns: f64,
    windings: f64,
    sway: [[f64; 3]; 3],
}

impl Curve {
    fn new(inputs: &Inputs) -> Self {
        let turns = inputs.number("turns") as u32;
        let mut windings = inputs.number("windings") as u32;
        // With a common factor the curve would run over itself.
        while gcd(turns, windings) != 1 {
            windings += 1;
        }
        let mut random = Stream::new(inputs.seed, 0, 0);
        let sway = std::array::from_fn(|_| {
            [
                random.range(0.9, 2.1).into(),
                (TAU as f32 * random.unit()).into(),
                random.range(0.04, 0.14).into(),
            ]
        });
        Self { turns: turns.into(), windings: windings.into(), sway }
    }

    /// The point at `t` in `[0, 1]`.
    fn point(&self, t: f64) -> DVec3 {
        let (around, through) = (TAU * self.turns * t, TAU * self.windings * t);
        let reach = 1.0 + 0.45 * libm::cos(through);
        let p = DVec3::new(reach * libm::cos(around), 0.45 * libm::sin(through), reach * libm::sin(around));
        // A smooth bend of space, weak enough to keep strands apart.
        let [x, y, z] = self.sway;
        p + DVec3::new(
            x[2] * libm::sin(x[0] * p.y + x[1]),
            y[2] * libm::sin(y[0] * 2.0 * p.x + y[1]),
            z[2] * libm::sin(z[0] * p.y + z[1]),
        ) + DVec3::Y
    }
}

fn gcd(a: u32, b: u32) -> u32 {
    if b == 0 { a } else { gcd(b, a % b) }
}

/// Length of the closed polygon through `points`, and a bound on the radius of a tube around it.
///
/// The tube of radius `r` is free of self-intersection if `r` is below the smallest radius of curvature `c` and below
/// half the distance of any two points more than `pi c` apart along the curve; points nearer along the curve are at
/// least as far apart as on a circle of radius `c` (Schur's theorem).
fn length_and_thickness(points: &[DVec3]) -> (f64, f64) {
    let n = points.len();
    let mut along = vec![0.0];
    let mut curvature = f64::INFINITY;
    for i in 0..n {
        let (a, b, c) = (points[i], points[(i + 1) % n], points[(i + 2) % n]);
        along.push(along[i] + a.distance(b));
        let circle = a.distance(b) * b.distance(c) * c.distance(a) / (2.0 * (b - a).cross(c - a).length());
        curvature = curvature.min(circle);
    }
    let length = along[n];
    let mut nearest = f64::INFINITY;
    for i in 0..n {
        for j in i + 1..n {
            let arc = along[j] - along[i];
            if arc.min(length - arc) > PI * curvature {
                nearest = nearest.min(points[i].distance_squared(points[j]));
            }
        }
    }
    // The nearest points lie up to half a step from the samples on either strand.
    let nearest = (nearest.sqrt() - length / n as f64).max(0.0);
    (length, curvature.min(nearest / 2.0))
}

pub fn knots(inputs: &Inputs) -> Generated {
    let curve = Curve::new(inputs);
    let loops = curve.turns.max(curve.windings) as usize;
    let samples = 200 * loops.max(20);
    let points: Vec<DVec3> = (0..samples).map(|i| curve.point(i as f64 / samples as f64)).collect();
    let (length, thickness) = length_and_thickness(&points);
    let radius = thickness * inputs.number("thickness");
    // Facets about as long as wide.
    let square = (inputs.triangles as f64 * PI * radius / length).sqrt();
    let sides = (square.round() as usize).max(5);
    // Fewer rings would cut corners into other strands; what they still cut is taken off the radius.
    let rings = (inputs.triangles / (2 * sides)).max(32 * loops);
    let at = |i: usize, half: f64| curve.point((i as f64 + half) / rings as f64);
    let sag = (0..rings).map(|i| ((at(i, 0.0) + at(i, 1.0)) / 2.0).distance(at(i, 0.5))).fold(0.0, f64::max);
    let radius = radius.min(0.95 * thickness - sag).max(0.1 * thickness);
    tube(&curve, radius, rings, sides).into()
}

fn tube(curve: &Curve, radius: f64, rings: usize, sides: usize) -> TriangleMesh {
    let at = |i: usize| curve.point((i % rings) as f64 / rings as f64);
    let step = 0.25 / rings as f64;
    let tangent = |i: usize| {
        let t = (i % rings) as f64 / rings as f64;
        (curve.point(t + step) - curve.point(t - step)).normalize().as_vec3()
    };
    // Frames without twist come back turned by some angle, which is spread over the whole way.
    let start = Frame::from_normal(tangent(0));
    let mut frames = vec![start];
    for i in 1..=rings {
        frames.push(transport(&frames[i - 1], tangent(i)));
    }
    let back = frames[rings].tangent;
    let twist = f64::from(libm::atan2f(back.dot(start.bitangent), back.dot(start.tangent)));
    let mut mesh = TriangleMesh::default();
    mesh.positions.reserve_exact(rings * sides);
    mesh.triangles.reserve_exact(rings * sides * 2);
    for (i, frame) in frames[..rings].iter().enumerate() {
        let center = at(i);
        for k in 0..sides {
            let angle = TAU * k as f64 / sides as f64 - twist * i as f64 / rings as f64;
            let offset: Vec3 =
                frame.tangent * libm::cos(angle) as f32 + frame.bitangent * libm::sin(angle) as f32;
            mesh.positions.push((center + offset.as_dvec3() * radius).as_vec3().to_array());
        }
    }
    let vertex = |i: usize, k: usize| ((i % rings) * sides + k % sides) as u32;
    for i in 0..rings {
        for k in 0..sides {
            let [a, b, c, d] = [vertex(i, k), vertex(i, k + 1), vertex(i + 1, k + 1), vertex(i + 1, k)];
            mesh.triangles.extend([[a, b, c], [a, c, d]]);
        }
    }
    whole(mesh, "knots")
}
