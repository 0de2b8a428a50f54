//! `tentacles` (curling tapered strands on the ground) and `hairball` (a ball of long tangled hair).

use super::{
    Generated, Inputs,
    builder::{Builder, tube_triangles},
    random::{GOLDEN_ANGLE, Stream, heading, noise, rotate, smoothstep},
};
use std::f32::consts::TAU;
use umbrage_geom::{Frame, glam::Vec3};

/// How a budget of triangles becomes strands.
struct Plan {
    strands: usize,
    points: usize,
    sides: usize,
}

impl Plan {
    /// About `triangles` triangles, where `full` triangles are shared by `strands` strands; smaller budgets mean fewer
    /// and coarser strands.
    fn new(triangles: usize, full: f64, strands: f64, pointed: bool, sides: [usize; 2]) -> Self {
        let share = triangles as f64 / full;
        // Hair, whose ends are open, winds more and needs more points.
        let wanted = (strands * libm::pow(share, if pointed { 0.75 } else { 0.88 })).max(12.0);
        let each = triangles as f64 / wanted;
        let sides = if each < 120.0 { sides[0] } else { sides[1] };
        let points = ((each / (2 * sides) as f64).round() as usize + 1).clamp(6, 256);
        let strands = (triangles as f64 / tube_triangles(points, sides, pointed) as f64).round() as usize;
        Self { strands: strands.max(1), points, sides }
    }

    fn triangles(&self, pointed: bool) -> usize {
        self.strands * tube_triangles(self.points, self.sides, pointed)
    }
}

pub fn tentacles(inputs: &Inputs) -> Generated {
    let plan = Plan::new(inputs.triangles, 3.8e6, 5_000.0, true, [4, 8]);
    let curl = inputs.number("curl") as f32;
    let mut builder = Builder::with_capacity(plan.triangles(true));
    builder.begin("tentacles");
    let (mut points, mut radii) = (Vec::new(), Vec::new());
    let thickness = 0.95 / (plan.strands as f32).sqrt();
    for i in 0..plan.strands {
        let mut random = Stream::new(inputs.seed, 0, i);
        // Sunflower spiral: even cover of a disc of radius 2.
        let out = ((i as f32 + 0.5) / plan.strands as f32).sqrt();
        let jitter = heading(TAU * random.unit()) * (random.unit() * 1.2 / (plan.strands as f32).sqrt());
        let base = heading(GOLDEN_ANGLE * i as f32) * (2.0 * out) + jitter;
        let length = (1.15 - 0.45 * out * out) * random.range(0.75, 1.2);
        points.clear();
        radii.clear();
        grow_tentacle(inputs.seed, base, length, curl, &plan, &mut random, &mut points);
        let root = thickness * random.range(0.75, 1.15);
        radii.extend((0..plan.points).map(|k| {
            let t = k as f32 / (plan.points - 1) as f32;
            if k + 1 == plan.points {
                0.0
            } else {
                root * (1.0 - 0.85 * t) * (1.0 + 0.25 * (1.0 - t).powi(6))
            }
        }));
        builder.tube(&points, &radii, plan.sides);
    }
    builder.finish().into()
}

/// A path that rises, sways with its neighbours and rolls up towards its tip.
fn grow_tentacle(
    seed: u32,
    base: Vec3,
    length: f32,
    curl: f32,
    plan: &Plan,
    random: &mut Stream,
    points: &mut Vec<Vec3>,
) {
    let lean = heading(TAU * random.unit()) * 0.25 + base * 0.22;
    let mut along = (Vec3::Y + lean).normalize();
    let roll = rotate(Frame::from_normal(along).tangent, along, TAU * random.unit());
    let turns = curl * random.range(0.35, 1.15) * if random.chance(0.5) { 1.0 } else { -1.0 };
    let step = length / (plan.points - 1) as f32;
    let mut point = base;
    for k in 0..plan.points {
        points.push(point);
        let t = k as f32 / (plan.points - 1) as f32;
        let sway = Vec3::new(
            noise(seed, point * 1.3),
            0.3 * noise(seed ^ 1, point * 1.3),
            noise(seed ^ 2, point * 1.3),
        );
        along = (along + sway * (2.2 * step)).normalize();
        along = rotate(along, roll, turns * TAU * 4.5 * t * t * step / length);
        // Strands lift off the ground instead of passing through it.
        if point.y < 0.06 && k > 2 {
            along = (along + Vec3::Y * (0.3 * smoothstep(0.06, 0.0, point.y) + 0.05)).normalize();
        }
        point += along * step;
        point.y = point.y.max(0.0);
    }
}

pub fn hairball(inputs: &Inputs) -> Generated {
    let plan = Plan::new(inputs.triangles, 2.88e6, 9_000.0, false, [3, 3]);
    let mut builder = Builder::with_capacity(plan.triangles(false));
    builder.begin("hair");
    let (mut points, mut radii) = (Vec::new(), Vec::new());
    let thickness = inputs.number("thickness") as f32 * 0.32 / (plan.strands as f32).sqrt();
    for i in 0..plan.strands {
        points.clear();
        radii.clear();
        let mut random = Stream::new(inputs.seed, 0, i);
        wind_hair(plan.points, &mut random, &mut points);
        let radius = thickness * random.range(0.8, 1.2);
        // Thin ends, but not pointed: an end of no width would cost triangles that nobody sees.
        radii.extend((0..plan.points).map(|k| {
            let t = k as f32 / (plan.points - 1) as f32;
            radius * (0.35 + 0.65 * smoothstep(0.0, 0.1, t) * smoothstep(1.0, 0.8, t))
        }));
        builder.tube(&points, &radii, plan.sides);
    }
    builder.finish().into()
}

/// A hair that leaves the core of a ball of radius 1 on a winding way, wraps around below the surface and may stick
/// out at its end. The ball touches the ground.
fn wind_hair(count: usize, random: &mut Stream, points: &mut Vec<Vec3>) {
    let mut direction = random.direction();
    let mut axis = rotate(Frame::from_normal(direction).tangent, direction, TAU * random.unit());
    let shell = 0.55 + 0.42 * random.unit().sqrt();
    let sweep = random.range(0.9, 2.6);
    let wave = [random.range(2.0, 6.0), TAU * random.unit(), random.range(0.02, 0.07)];
    let wobble = [random.range(1.0, 3.5), TAU * random.unit(), random.range(0.5, 1.6)];
    let loose = if random.chance(0.06) { random.range(0.02, 0.12) } else { 0.0 };
    let step = 1.0 / (count - 1) as f32;
    for k in 0..count {
        let t = k as f32 * step;
        let (ripple, _) = super::random::sin_cos(TAU * wave[0] * t + wave[1]);
        let radius =
            0.12 + (shell - 0.12) * smoothstep(0.0, 0.35, t) + ripple * wave[2] * smoothstep(0.05, 0.4, t);
        let radius = radius + loose * smoothstep(0.8, 1.0, t);
        points.push(direction * radius + Vec3::Y * 1.1);
        // The axis turns with the hair, so that its way on the sphere isn't a plain circle.
        let (turn, _) = super::random::sin_cos(TAU * wobble[0] * t + wobble[1]);
        axis = rotate(axis, direction, turn * wobble[2] * TAU * step);
        direction = rotate(direction, axis, sweep * std::f32::consts::PI * step).normalize();
    }
}
