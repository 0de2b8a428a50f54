//! Estimates of openness and of the light that arrives, for receivers and a way to trace rays.

use super::{Reference, generator::Generator};
use rayon::prelude::*;
use umbrage_geom::Ray;

/// Least height of a ray above the plane of a face, as a cosine: what `umbrage_aomask::Receiver` documents.
const LEAST_HEIGHT: f64 = 5e-4;

/// Who asks.
#[derive(Clone, Copy, Debug)]
pub struct Receivers<'a> {
    /// Where rays start, exactly.
    pub points: &'a [[f32; 3]],
    /// Unit normals that rays are distributed around.
    pub normals: &'a [[f32; 3]],
    /// Unit normals of the surfaces that receivers lie on: rays that lead below are mirrored at the surface, and light from below
    /// does not count. Empty if they are the normals.
    pub faces: &'a [[f32; 3]],
}

/// A light. Its radiance is the same everywhere on it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Emitter {
    /// Corner and two sides; shines against the direction of `u x v`, to both sides if asked.
    Parallelogram {
        /// A corner, world units.
        corner: [f32; 3],
        /// One side, world units.
        u: [f32; 3],
        /// The other side, world units.
        v: [f32; 3],
        /// Whether both sides shine.
        two_sided: bool,
    },
    /// A flat disc that shines along `normal`, to both sides if asked.
    Disc {
        /// The middle, world units.
        center: [f32; 3],
        /// Of any length but 0.
        normal: [f32; 3],
        /// World units.
        radius: f32,
        /// Whether both sides shine.
        two_sided: bool,
    },
    /// A sphere that shines outwards.
    Sphere {
        /// The middle, world units.
        center: [f32; 3],
        /// World units.
        radius: f32,
    },
    /// A point.
    Point {
        /// World units.
        position: [f32; 3],
    },
    /// A disc at an infinite distance.
    Distant {
        /// From receivers to the light, of any length but 0.
        towards: [f32; 3],
        /// Half the angle of the disc, radians.
        half_angle: f64,
    },
}

impl Receivers<'_> {
    fn face(&self, index: usize) -> [f64; 3] {
        self.faces.get(index).unwrap_or(&self.normals[index]).map(f64::from)
    }

    /// How open a cosine-weighted hemisphere of `radius` (world units, may be infinite) is above each receiver, by `rays` random rays;
    /// `passed` says which fraction of light passes along a ray. Runs on all threads of the caller's pool.
    pub fn openness(
        &self,
        radius: f32,
        rays: u32,
        seed: u64,
        passed: &(dyn Fn(&Ray) -> f64 + Sync),
    ) -> Reference {
        let one = |index: usize| {
            let (point, normal, face) =
                (self.points[index], self.normals[index].map(f64::from), self.face(index));
            let [tangent, bitangent] = plane(normal);
            let mut generator = Generator::new(seed, index as u64);
            let (mut sum, mut squares) = (0.0, 0.0);
            for _ in 0..rays {
                let [x, y, z] = generator.cosine_direction();
                let direction = [0, 1, 2].map(|i| tangent[i] * x + bitangent[i] * y + normal[i] * z);
                let direction = if self.faces.is_empty() { direction } else { above(direction, face) };
                let passed = passed(&Ray::new(point, direction.map(|x| x as f32)).with_tfar(radius));
                sum += passed;
                squares += passed * passed;
            }
            let n = f64::from(rays);
            let mean = sum / n;
            (mean, (squares / n - mean * mean).max(0.0) / (n - 1.0).max(1.0))
        };
        let (ao, variances) = (0..self.points.len()).into_par_iter().map(one).unzip();
        Reference { ao, variances }
    }

    /// Which fraction of the irradiance from `emitter` arrives at each receiver, by rays to `rays` random points of its area; 1 where
    /// none would arrive without occluders, which the second value tells. `passed` as for [`Self::openness`].
    ///
    /// The estimate is a ratio of two means over the same rays, whose bias is of the order of `1 / rays`.
    pub fn lit_fraction(
        &self,
        emitter: &Emitter,
        rays: u32,
        seed: u64,
        passed: &(dyn Fn(&Ray) -> f64 + Sync),
    ) -> (Reference, Vec<bool>) {
        let one = |index: usize| {
            let (normal, face) = (self.normals[index].map(f64::from), self.face(index));
            let mut generator = Generator::new(seed, index as u64);
            let mut samples = Vec::with_capacity(rays as usize);
            for _ in 0..rays {
                let (ray, weight) = emitter.ray(self.points[index], &mut generator);
                let direction = unit([ray.direction.x, ray.direction.y, ray.direction.z].map(f64::from));
                let cosine = if dot(direction, face) > 0.0 { dot(direction, normal).max(0.0) } else { 0.0 };
                let weight = weight * cosine;
                if weight > 0.0 {
                    samples.push((weight, passed(&ray)));
                }
            }
            let total: f64 = samples.iter().map(|(weight, _)| weight).sum();
            if total <= 0.0 {
                return ((1.0, 0.0), false);
            }
            let mean = samples.iter().map(|(weight, passed)| weight * passed).sum::<f64>() / total;
            let square = |(weight, passed): &(f64, f64)| (weight * (passed - mean)).powi(2);
            ((mean, samples.iter().map(square).sum::<f64>() / (total * total)), true)
        };
        let answers: Vec<_> = (0..self.points.len()).into_par_iter().map(one).collect();
        let lit = answers.iter().map(|answer| answer.1).collect();
        let (ao, variances) = answers.into_iter().map(|answer| answer.0).unzip();
        (Reference { ao, variances }, lit)
    }
}

impl Emitter {
    /// A ray from `receiver` to a random point, and the light that it stands for but for the cosine at the receiver.
    fn ray(&self, receiver: [f32; 3], generator: &mut Generator) -> (Ray, f64) {
        let (a, b) = (generator.unit(), generator.unit());
        let (point, normal, two_sided) = match *self {
            Self::Point { position } => {
                let to = sub(position.map(f64::from), receiver.map(f64::from));
                return (Ray::new(receiver, to.map(|x| x as f32)).with_tfar(1.0), 1.0);
            }
            Self::Distant { towards, half_angle } => {
                let axis = unit(towards.map(f64::from));
                let z = 1.0 - a * (1.0 - half_angle.cos());
                let direction = around(axis, (1.0 - z * z).max(0.0).sqrt(), z, b);
                return (Ray::new(receiver, direction.map(|x| x as f32)).with_tfar(f32::INFINITY), 1.0);
            }
            Self::Parallelogram { corner, u, v, two_sided } => {
                let [corner, u, v] = [corner, u, v].map(|p| p.map(f64::from));
                ([0, 1, 2].map(|i| corner[i] + a * u[i] + b * v[i]), unit(cross(u, v)), two_sided)
            }
            Self::Disc { center, normal, radius, two_sided } => {
                let (center, normal) = (center.map(f64::from), unit(normal.map(f64::from)));
                let place = around(normal, f64::from(radius) * a.sqrt(), 0.0, b);
                ([0, 1, 2].map(|i| center[i] + place[i]), normal, two_sided)
            }
            Self::Sphere { center, radius } => {
                let to = sub(center.map(f64::from), receiver.map(f64::from));
                let (distance, radius) = (dot(to, to).sqrt(), f64::from(radius));
                let sin = radius / distance;
                if sin >= 1.0 || sin.is_nan() {
                    return (Ray::new(receiver, [1.0, 0.0, 0.0]), 0.0);
                }
                // A direction of the cone that the sphere fills, as far as its near side.
                let z = 1.0 - a * (1.0 - (1.0 - sin * sin).sqrt());
                let direction = around(unit(to), (1.0 - z * z).max(0.0).sqrt(), z, b);
                let middle = distance * z;
                let near = middle - (radius * radius - distance * distance * (1.0 - z * z)).max(0.0).sqrt();
                let to = direction.map(|x| (x * near) as f32);
                return (Ray::new(receiver, to).with_tfar(1.0), 1.0);
            }
        };
        let to = sub(point, receiver.map(f64::from));
        let squared = dot(to, to);
        let facing = -dot(to, normal);
        let facing = if two_sided { facing.abs() } else { facing.max(0.0) };
        // Cosine at the light over the squared distance.
        let weight = if squared > 0.0 { facing / (squared * squared.sqrt()) } else { 0.0 };
        (Ray::new(receiver, to.map(|x| x as f32)).with_tfar(1.0), weight)
    }
}

/// `direction`, mirrored at the plane of `face` if it leads below.
fn above(direction: [f64; 3], face: [f64; 3]) -> [f64; 3] {
    let height = dot(direction, face);
    if height >= LEAST_HEIGHT {
        return direction;
    }
    let lift = height.abs().max(LEAST_HEIGHT) - height;
    unit([0, 1, 2].map(|i| direction[i] + face[i] * lift))
}

/// A vector with length `across` at right angles to the unit vector `axis` and `along` along it, at the share `turn` of a turn.
fn around(axis: [f64; 3], across: f64, along: f64, turn: f64) -> [f64; 3] {
    let [tangent, bitangent] = plane(axis);
    let (sin, cos) = (turn * std::f64::consts::TAU).sin_cos();
    [0, 1, 2].map(|i| across * (cos * tangent[i] + sin * bitangent[i]) + along * axis[i])
}

/// Two unit vectors at right angles to the unit vector `n` and to each other.
fn plane(n: [f64; 3]) -> [[f64; 3]; 2] {
    let least = (0..3).min_by(|&a, &b| n[a].abs().total_cmp(&n[b].abs())).unwrap_or(0);
    let mut other = [0.0; 3];
    other[least] = 1.0;
    let tangent = unit(cross(n, other));
    [tangent, unit(cross(n, tangent))]
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a.iter().zip(&b).map(|(x, y)| x * y).sum()
}

fn sub(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [0, 1, 2].map(|i| a[i] - b[i])
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

fn unit(v: [f64; 3]) -> [f64; 3] {
    let length = dot(v, v).sqrt();
    v.map(|x| x / length)
}

#[cfg(test)]
mod tests {
    use super::*;

    const UP: Receivers<'static> =
        Receivers { points: &[[0.0; 3]; 20], normals: &[[0.0, 0.0, 1.0]; 20], faces: &[] };

    /// Blocks what leads to negative x.
    fn half(ray: &Ray) -> f64 {
        f64::from(u8::from(ray.direction.x > 0.0))
    }

    #[test]
    fn a_half_space_hides_half_of_every_light_above() {
        let above = [0.0, 0.0, 2.0];
        let emitters = [
            Emitter::Parallelogram {
                corner: [-1.0, -1.0, 2.0],
                u: [0.0, 2.0, 0.0],
                v: [2.0, 0.0, 0.0],
                two_sided: false,
            },
            Emitter::Disc { center: above, normal: [0.0, 0.0, -2.0], radius: 1.0, two_sided: false },
            Emitter::Sphere { center: above, radius: 1.0 },
            Emitter::Distant { towards: above, half_angle: 0.3 },
        ];
        for emitter in emitters {
            let (answer, lit) = UP.lit_fraction(&emitter, 2000, 1, &half);
            assert!(lit.iter().all(|&lit| lit), "{emitter:?}");
            let bias = answer.bias(vec![0.5; 20]);
            assert!(bias.abs() < 4.0 * answer.standard_error_of_mean(), "{emitter:?}: {bias}");
            assert!((0.008..0.025).contains(&answer.standard_error()), "{emitter:?}");
        }
        // A light that shines away from the receivers, and one behind them.
        let away = Emitter::Disc { center: above, normal: [0.0, 0.0, 1.0], radius: 1.0, two_sided: false };
        assert!(UP.lit_fraction(&away, 100, 1, &half).1.iter().all(|lit| !lit));
        let below = Emitter::Point { position: [0.0, 0.0, -1.0] };
        assert!(UP.lit_fraction(&below, 10, 1, &half).1.iter().all(|lit| !lit));
        let beside = Emitter::Point { position: [-1.0, 0.0, 1.0] };
        assert_eq!(UP.lit_fraction(&beside, 10, 1, &half).0.ao, [0.0; 20]);
    }

    /// A disc light seen from the side: the weights are those of the integral of cosines over distances squared.
    #[test]
    fn weights_are_irradiance() {
        let disc = Emitter::Disc {
            center: [0.0, 0.0, 1.0],
            normal: [0.0, 0.0, -1.0],
            radius: 3.0,
            two_sided: false,
        };
        // Directions within 45 degrees pass: of the irradiance of a disc that ends at tan = 3, sin^2 45 / sin^2 atan 3.
        let passed = |ray: &Ray| {
            let d = ray.direction;
            f64::from(u8::from(d.z * d.z > d.x * d.x + d.y * d.y))
        };
        let (answer, _) = UP.lit_fraction(&disc, 20_000, 5, &passed);
        let bias = answer.bias(vec![0.5 / 0.9; 20]);
        assert!(bias.abs() < 4.0 * answer.standard_error_of_mean() + 1e-4, "{bias}");
    }

    #[test]
    fn rays_below_a_face_are_mirrored() {
        let tilted = Receivers { faces: &[[0.6, 0.0, 0.8]; 20], ..UP };
        let below = |ray: &Ray| {
            let d = ray.direction.as_dvec3();
            f64::from(u8::from(0.6 * d.x + 0.8 * d.z > 0.0))
        };
        assert_eq!(tilted.openness(1.0, 500, 2, &below).ao, [1.0; 20]);
        assert!(UP.openness(1.0, 500, 2, &below).ao.iter().all(|&ao| ao < 1.0));
    }

    #[test]
    fn rounds_join_to_one_answer() {
        let [a, b] = [1, 2].map(|seed| UP.openness(1.0, 400, seed, &half));
        let both = a.clone().joined(&b, 0.5);
        assert!((both.ao[3] - 0.5 * (a.ao[3] + b.ao[3])).abs() < 1e-12);
        let ratio = both.standard_error() / a.standard_error();
        assert!((ratio - 0.5f64.sqrt()).abs() < 0.02, "{ratio}");
    }
}
