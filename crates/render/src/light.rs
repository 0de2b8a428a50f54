//! Lights as a receiver sees them: where to aim, and how much would arrive if nothing stood in the way.

use umbrage_geom::{
    Aabb,
    glam::{Vec2, Vec3},
    sampling::{Cone, LightSample, SphereLight, SphericalRectangle, disc_light, parallelogram_light},
};
use umbrage_scene as scene;

/// A light ready to be sampled.
#[derive(Clone, Debug)]
pub struct LightSampler {
    kind: Kind,
    /// Radiance, intensity or irradiance, as the kind says; linear RGB.
    strength: Vec3,
}

#[derive(Clone, Debug)]
enum Kind {
    Rectangle {
        corner: Vec3,
        u: Vec3,
        v: Vec3,
        normal: Vec3,
        two_sided: bool,
    },
    Disc {
        center: Vec3,
        normal: Vec3,
        radius: f32,
        two_sided: bool,
    },
    Sphere {
        center: Vec3,
        radius: f32,
    },
    Point {
        position: Vec3,
    },
    Spot {
        position: Vec3,
        axis: Vec3,
        cos_inner: f32,
        cos_outer: f32,
    },
    Directional(Cone),
    /// A direction of no length, which scene files reject.
    Nowhere,
}

/// One sample of a light.
#[derive(Clone, Copy, Debug)]
pub struct Incoming {
    /// From the receiver to the sample: to its point, or a unit vector if `distant`.
    pub to_light: Vec3,
    /// Whether the light is infinitely far away.
    pub distant: bool,
    /// Unit vector towards the light.
    pub direction: Vec3,
    /// Irradiance on a surface that faces the sample, this sample's share of the light.
    pub irradiance: Vec3,
    /// Share of the light's solid angle, steradians; 0 for point lights.
    pub solid_angle: f32,
}

impl LightSampler {
    /// The light that `description` means.
    pub fn new(description: &scene::Light) -> Self {
        let unit = |v: [f32; 3]| Vec3::from(v).as_dvec3().normalize_or_zero().as_vec3();
        match *description {
            scene::Light::Rectangle { corner, u, v, radiance, two_sided } => {
                let (u, v) = (Vec3::from(u), Vec3::from(v));
                let normal = u.as_dvec3().cross(v.as_dvec3()).normalize_or_zero().as_vec3();
                let kind = Kind::Rectangle { corner: corner.into(), u, v, normal, two_sided };
                Self { kind, strength: radiance.into() }
            }
            scene::Light::Disc { center, normal, radius, radiance, two_sided } => Self {
                kind: Kind::Disc { center: center.into(), normal: unit(normal), radius, two_sided },
                strength: radiance.into(),
            },
            scene::Light::Sphere { center, radius, radiance } => {
                Self { kind: Kind::Sphere { center: center.into(), radius }, strength: radiance.into() }
            }
            scene::Light::Point { position, intensity } => {
                Self { kind: Kind::Point { position: position.into() }, strength: intensity.into() }
            }
            scene::Light::Spot { position, direction, inner_angle, outer_angle, intensity } => Self {
                kind: Kind::Spot {
                    position: position.into(),
                    axis: unit(direction),
                    cos_inner: inner_angle.to_radians().cos(),
                    cos_outer: outer_angle.to_radians().cos(),
                },
                strength: intensity.into(),
            },
            scene::Light::Directional { direction, angle, irradiance } => {
                let towards = -unit(direction);
                let cone = Cone::new(towards, 0.5 * angle.to_radians());
                Self { kind: cone.map_or(Kind::Nowhere, Kind::Directional), strength: irradiance.into() }
            }
        }
    }

    /// A point that stands for all of it, if it shines at all: for distant lights, one ten diagonals away from `bounds`.
    pub fn place(&self, bounds: &Aabb) -> Option<Vec3> {
        match &self.kind {
            &Kind::Rectangle { corner, u, v, .. } => Some(corner + 0.5 * (u + v)),
            &Kind::Disc { center, .. } | &Kind::Sphere { center, .. } => Some(center),
            &Kind::Point { position } | &Kind::Spot { position, .. } => Some(position),
            Kind::Directional(cone) => {
                Some(bounds.center() + cone.sample(Vec2::splat(0.5)) * (10.0 * bounds.diagonal()))
            }
            Kind::Nowhere => None,
        }
    }

    /// How many samples are worth taking where area lights get `wanted`.
    pub fn samples(&self, wanted: u32) -> u32 {
        match &self.kind {
            Kind::Point { .. } | Kind::Spot { .. } => 1,
            Kind::Directional(cone) if cone.solid_angle() == 0.0 => 1,
            _ => wanted,
        }
    }

    /// Samples the light as seen from `receiver`, at points of the unit square; what can't shine there is left out.
    ///
    /// `squares` must hold [`Self::samples`] points: each sample carries an equal share.
    pub fn sample(&self, receiver: Vec3, squares: &[Vec2], out: &mut impl FnMut(usize, Incoming)) {
        let share = 1.0 / squares.len() as f32;
        let mut area = |sample: Option<LightSample>, i: usize, emits: &dyn Fn(Vec3) -> bool| {
            let Some(sample) = sample.filter(|s| emits(s.direction)) else { return };
            let solid_angle = share / sample.pdf;
            let irradiance = self.strength * solid_angle;
            let to_light = sample.point - receiver;
            out(
                i,
                Incoming { to_light, distant: false, direction: sample.direction, irradiance, solid_angle },
            );
        };
        match &self.kind {
            &Kind::Rectangle { corner, u, v, normal, two_sided } => {
                let emits = |d: Vec3| two_sided || d.dot(normal) < 0.0;
                if SphericalRectangle::is_rectangular(u, v) {
                    let view = SphericalRectangle::new(receiver, corner, u, v);
                    if view.is_front() || two_sided {
                        squares.iter().enumerate().for_each(|(i, &s)| area(view.sample(s), i, &emits));
                    }
                } else {
                    squares.iter().enumerate().for_each(|(i, &s)| {
                        area(parallelogram_light(receiver, corner, u, v, s), i, &emits);
                    });
                }
            }
            &Kind::Disc { center, normal, radius, two_sided } => {
                let emits = |d: Vec3| two_sided || d.dot(normal) < 0.0;
                squares
                    .iter()
                    .enumerate()
                    .for_each(|(i, &s)| area(disc_light(receiver, center, normal, radius, s), i, &emits));
            }
            &Kind::Sphere { center, radius } => {
                let view = SphereLight::new(receiver, center, radius);
                if !view.is_inside() {
                    squares.iter().enumerate().for_each(|(i, &s)| area(view.sample(s), i, &|_| true));
                }
            }
            &Kind::Point { position } => {
                self.point(receiver, position, |_| 1.0).into_iter().for_each(|s| out(0, s));
            }
            &Kind::Spot { position, axis, cos_inner, cos_outer } => {
                let fade = |direction: Vec3| {
                    let x = ((-direction).dot(axis) - cos_outer) / (cos_inner - cos_outer).max(1e-6);
                    let x = x.clamp(0.0, 1.0);
                    x * x * (3.0 - 2.0 * x)
                };
                self.point(receiver, position, fade).into_iter().for_each(|s| out(0, s));
            }
            Kind::Nowhere => {}
            Kind::Directional(cone) => squares.iter().enumerate().for_each(|(i, &s)| {
                let direction = cone.sample(s);
                let irradiance = self.strength * share;
                let solid_angle = cone.solid_angle() * share;
                out(i, Incoming { to_light: direction, distant: true, direction, irradiance, solid_angle });
            }),
        }
    }

    fn point(&self, receiver: Vec3, position: Vec3, fade: impl Fn(Vec3) -> f32) -> Option<Incoming> {
        let to_light = position - receiver;
        let direction = to_light.as_dvec3().try_normalize()?.as_vec3();
        let fade = fade(direction);
        let irradiance = self.strength * (fade / to_light.length_squared());
        (fade > 0.0 && irradiance.is_finite()).then_some(Incoming {
            to_light,
            distant: false,
            direction,
            irradiance,
            solid_angle: 0.0,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use umbrage_geom::sampling::sobol_2d;

    fn irradiance(light: &scene::Light, receiver: Vec3, normal: Vec3) -> f32 {
        let squares: Vec<Vec2> = (0..4096).map(|i| sobol_2d(i, 0, 1)).collect();
        let light = LightSampler::new(light);
        let mut sum = 0.0;
        light.sample(receiver, &squares[..light.samples(4096) as usize], &mut |_, s: Incoming| {
            sum += s.irradiance.x * s.direction.dot(normal).max(0.0);
        });
        sum
    }

    #[test]
    fn irradiance_agrees_with_closed_forms() {
        // A disc of radius R at height h above a parallel surface: pi L R^2 / (R^2 + h^2).
        let disc = |two_sided| scene::Light::Disc {
            center: [0.0, 0.0, 2.0],
            normal: [0.0, 0.0, -3.0],
            radius: 1.0,
            radiance: [2.0; 3],
            two_sided,
        };
        let expected = std::f32::consts::PI * 2.0 / 5.0;
        assert!((irradiance(&disc(false), Vec3::ZERO, Vec3::Z) / expected - 1.0).abs() < 1e-3);
        let above = Vec3::new(0.0, 0.0, 4.0);
        assert_eq!(irradiance(&disc(false), above, Vec3::NEG_Z), 0.0);
        assert!((irradiance(&disc(true), above, Vec3::NEG_Z) / expected - 1.0).abs() < 1e-3);
        // A sphere of radius R at distance h straight above: pi L R^2 / h^2.
        let sphere = scene::Light::Sphere { center: [0.0, 0.0, 3.0], radius: 1.0, radiance: [1.0; 3] };
        let expected = std::f32::consts::PI / 9.0;
        assert!((irradiance(&sphere, Vec3::ZERO, Vec3::Z) / expected - 1.0).abs() < 1e-3);
        // A huge square is half the sphere of directions: pi L.
        let square = scene::Light::Rectangle {
            corner: [-1e4, 1e4, 1.0],
            u: [2e4, 0.0, 0.0],
            v: [0.0, -2e4, 0.0],
            radiance: [1.0; 3],
            two_sided: false,
        };
        assert!((irradiance(&square, Vec3::ZERO, Vec3::Z) / std::f32::consts::PI - 1.0).abs() < 5e-3);
        // The sun's disc changes nothing about the irradiance it is given.
        let sun = scene::Light::Directional { direction: [0.0, 0.0, -1.0], angle: 0.5, irradiance: [3.0; 3] };
        assert!((irradiance(&sun, Vec3::ZERO, Vec3::Z) / 3.0 - 1.0).abs() < 1e-4);
        let spot = scene::Light::Spot {
            position: [0.0, 0.0, 2.0],
            direction: [0.0, 0.0, -1.0],
            inner_angle: 20.0,
            outer_angle: 30.0,
            intensity: [8.0; 3],
        };
        assert!((irradiance(&spot, Vec3::ZERO, Vec3::Z) - 2.0).abs() < 1e-5);
        assert_eq!(irradiance(&spot, Vec3::new(1.3, 0.0, 0.0), Vec3::Z), 0.0);
    }

    #[test]
    fn skewed_parallelograms_agree_with_their_rectangle_halves() {
        // A parallelogram sheared within its own plane and split: same as sampling the area by brute force.
        let light = scene::Light::Rectangle {
            corner: [-1.0, -1.0, 2.0],
            u: [0.0, 2.0, 0.0],
            v: [2.0, 1.0, 0.0],
            radiance: [1.0; 3],
            two_sided: true,
        };
        let n = 400;
        let brute: f64 = (0..n * n)
            .map(|i| {
                let (a, b) =
                    ((f64::from(i % n) + 0.5) / f64::from(n), (f64::from(i / n) + 0.5) / f64::from(n));
                let (x, y) = (-1.0 + 2.0 * b, -1.0 + 2.0 * a + b);
                let d2 = x * x + y * y + 4.0;
                4.0 / (d2 * d2) * 4.0 / f64::from(n * n)
            })
            .sum();
        assert!((f64::from(irradiance(&light, Vec3::ZERO, Vec3::Z)) / brute - 1.0).abs() < 2e-3);
    }
}
