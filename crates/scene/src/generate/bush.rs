//! `bush`: stems, branches and twigs with leaves, denser towards the outside (`[Lacewell08]`, figure 1).

use super::{
    Generated, Inputs,
    builder::{Builder, Leaf, leaf_triangles, tube_triangles},
    random::{GOLDEN_ANGLE, Stream, heading, noise, rotate, smoothstep},
};
use std::f32::consts::TAU;
use umbrage_geom::{Frame, glam::Vec3};

/// Parts, each with random streams of its own.
const STEM: u32 = 0;
const BRANCH: u32 = 1;
const TWIG: u32 = 2;

const STEM_POINTS: usize = 12;
const STEM_SIDES: usize = 7;
const BRANCH_POINTS: usize = 6;
const BRANCH_SIDES: usize = 4;
const TWIG_POINTS: usize = 4;
const TWIG_SIDES: usize = 3;
const TWIGS_PER_BRANCH: f64 = 10.0;
const LEAVES_PER_TWIG: usize = 14;

/// Centre and half axes of the crown.
const CROWN: Vec3 = Vec3::new(0.0, 1.08, 0.0);
const REACH: Vec3 = Vec3::new(1.12, 0.92, 1.12);

/// How many of everything a budget of triangles buys.
struct Plan {
    stems: usize,
    branches: usize,
    twigs: usize,
    leaf_rows: usize,
}

impl Plan {
    fn new(triangles: usize) -> Self {
        let leaf_rows = if triangles < 100_000 { 2 } else { 3 };
        let stems = (triangles / 30_000).clamp(5, 15);
        let stem = tube_triangles(STEM_POINTS, STEM_SIDES, true);
        let branch = tube_triangles(BRANCH_POINTS, BRANCH_SIDES, true) as f64;
        let twig =
            tube_triangles(TWIG_POINTS, TWIG_SIDES, true) + LEAVES_PER_TWIG * leaf_triangles(leaf_rows, true);
        let each = twig as f64 + branch / TWIGS_PER_BRANCH;
        let twigs = (triangles.saturating_sub(stems * stem) as f64 / each).round().max(1.0);
        let branches = (twigs / TWIGS_PER_BRANCH).round().max(1.0);
        Self { stems, branches: branches as usize, twigs: twigs as usize, leaf_rows }
    }
}

/// A path and where it grows from.
struct Shoot {
    points: Vec<Vec3>,
}

impl Shoot {
    /// Position and direction at `t` in `[0, 1]`.
    fn at(&self, t: f32) -> (Vec3, Vec3) {
        let s = t * (self.points.len() - 1) as f32;
        let i = (s as usize).min(self.points.len() - 2);
        let (a, b) = (self.points[i], self.points[i + 1]);
        (a.lerp(b, s - i as f32), (b - a).normalize_or(Vec3::Y))
    }
}

pub fn bush(inputs: &Inputs) -> Generated {
    let plan = Plan::new(inputs.triangles);
    let mut twigs = Builder::default();
    let mut leaves = Builder::with_capacity(inputs.triangles);
    twigs.begin("twigs");
    leaves.begin("leaves");
    let stems: Vec<Shoot> = (0..plan.stems).map(|i| stem(inputs.seed, i, plan.stems, &mut twigs)).collect();
    let branches: Vec<Shoot> =
        (0..plan.branches).map(|i| branch(inputs.seed, i, &plan, &stems, &mut twigs)).collect();
    let leaf_count = (plan.twigs * LEAVES_PER_TWIG) as f32;
    // Some 40 square units of leaves, however many share them.
    let size = inputs.number("leaf-size") as f32 * (14.0 / leaf_count.sqrt()).min(0.3);
    let twig_length = (3.6 / libm::cbrtf(plan.twigs as f32)).clamp(0.16, 0.5);
    for i in 0..plan.twigs {
        let mut random = Stream::new(inputs.seed, TWIG, i);
        let shoot = twig(i, twig_length, &plan, &branches, &mut random);
        let root = 0.022 * twig_length;
        twigs.tube(&shoot.points, &[root, root * 0.8, root * 0.6, 0.0], TWIG_SIDES);
        add_leaves(&shoot, size, plan.leaf_rows, &mut random, &mut leaves);
    }
    leaves.append(twigs);
    leaves.finish().into()
}

/// A stem that rises from the middle of the ground and leans outwards.
fn stem(seed: u32, index: usize, count: usize, out: &mut Builder) -> Shoot {
    let mut random = Stream::new(seed, STEM, index);
    let around = TAU * (index as f32 + random.range(-0.3, 0.3)) / count as f32;
    let spread = if index.is_multiple_of(2) { random.range(0.0, 0.28) } else { random.range(0.4, 0.85) };
    let mut point = heading(around) * random.range(0.02, 0.1);
    let mut along = (Vec3::Y + heading(around) * spread).normalize();
    let length = random.range(1.25, 1.6) * (1.0 - 0.15 * spread);
    let step = length / (STEM_POINTS - 1) as f32;
    let mut points = Vec::new();
    for k in 0..STEM_POINTS {
        points.push(point);
        let sway = Vec3::new(noise(seed, point * 4.0 + along), 0.0, noise(seed ^ 5, point * 4.0 - along));
        along = (along + sway * 0.22 + Vec3::Y * 0.04).normalize();
        point += along * step * if k == 0 { 0.6 } else { 1.0 };
    }
    let root = 0.042 / (count as f32 / 14.0).sqrt().max(0.6);
    let radii: Vec<f32> = (0..STEM_POINTS)
        .map(|k| if k + 1 == STEM_POINTS { 0.0 } else { root * (1.0 - 0.85 * k as f32 / STEM_POINTS as f32) })
        .collect();
    out.tube(&points, &radii, STEM_SIDES);
    Shoot { points }
}

/// A branch that leaves a stem in golden-angle turns and bends up.
fn branch(seed: u32, index: usize, plan: &Plan, stems: &[Shoot], out: &mut Builder) -> Shoot {
    let mut random = Stream::new(seed, BRANCH, index);
    let per_stem = (plan.branches as f32 / plan.stems as f32).max(1.0);
    let rank = (index / plan.stems) as f32 + random.unit();
    let t = 0.16 + 0.82 * (rank / per_stem).min(1.0);
    let (mut point, stem_along) = stems[index % plan.stems].at(t);
    let frame = Frame::from_normal(stem_along);
    let outwards =
        rotate(frame.tangent, stem_along, GOLDEN_ANGLE * (index / plan.stems) as f32 + index as f32);
    let away = ((point - CROWN) / REACH).normalize_or(Vec3::Y);
    let mut along = (outwards * 0.8 + stem_along * 0.45 + away * 0.55).normalize();
    // As long as it takes to come near the edge of the crown.
    let room = room(point, along);
    let length = room * random.range(0.55, 0.92);
    let step = length / (BRANCH_POINTS - 1) as f32;
    let mut points = Vec::new();
    for _ in 0..BRANCH_POINTS {
        points.push(point);
        along = (along + Vec3::Y * 0.1 + random.direction() * 0.12).normalize();
        point += along * step;
        point.y = point.y.max(0.05);
    }
    let root = 0.016 * length.max(0.15).sqrt();
    let radii = [root, root * 0.9, root * 0.75, root * 0.6, root * 0.45, 0.0];
    out.tube(&points, &radii, BRANCH_SIDES);
    Shoot { points }
}

/// Distance from `point` along the unit vector `along` to the edge of the crown, at least 0.1.
fn room(point: Vec3, along: Vec3) -> f32 {
    let (p, d) = ((point - CROWN) / REACH, along / REACH);
    let (a, b, c) = (d.dot(d), p.dot(d), p.dot(p) - 1.0);
    let discriminant = (b * b - a * c).max(0.0);
    ((discriminant.sqrt() - b) / a).max(0.1)
}

fn twig(index: usize, length: f32, plan: &Plan, branches: &[Shoot], random: &mut Stream) -> Shoot {
    let per_branch = plan.twigs as f32 / plan.branches as f32;
    let rank = (index / plan.branches) as f32;
    // Most twigs sit on the outer half of their branch, the first at its very end.
    let t = 1.0 - 0.8 * (rank + random.unit() * 0.8) / per_branch.max(1.0);
    let (mut point, branch_along) = branches[index % plan.branches].at(t.clamp(0.05, 1.0));
    let frame = Frame::from_normal(branch_along);
    let outwards = rotate(frame.tangent, branch_along, GOLDEN_ANGLE * rank + TAU * random.unit() * 0.3);
    let away = ((point - CROWN) / REACH).normalize_or(Vec3::Y);
    let mut along = (outwards * 0.7 + branch_along * 0.5 + away * 0.5 + Vec3::Y * 0.15).normalize();
    let length = length * random.range(0.7, 1.2);
    let step = length / (TWIG_POINTS - 1) as f32;
    let mut points = Vec::new();
    for _ in 0..TWIG_POINTS {
        points.push(point);
        along = (along + random.direction() * 0.2).normalize();
        point += along * step;
        point.y = point.y.max(0.04);
    }
    Shoot { points }
}

/// Leaves in golden-angle turns along a twig, turned to the light above and outside.
fn add_leaves(twig: &Shoot, size: f32, rows: usize, random: &mut Stream, out: &mut Builder) {
    for k in 0..LEAVES_PER_TWIG {
        let t = (k + 1) as f32 / LEAVES_PER_TWIG as f32;
        let (base, along) = twig.at(0.15 + 0.85 * t);
        let frame = Frame::from_normal(along);
        let side = rotate(frame.tangent, along, GOLDEN_ANGLE * k as f32 + TAU * 0.1 * random.unit());
        let direction =
            (side * (1.1 - 0.7 * t) + along * (0.35 + 0.6 * t) + random.direction() * 0.25).normalize();
        let length = size * random.range(0.7, 1.2) * (0.75 + 0.25 * smoothstep(0.0, 0.4, 1.0 - t));
        // Near the ground leaves point up and stay above it.
        let base = base.max(Vec3::new(f32::NEG_INFINITY, 0.4 * length, f32::NEG_INFINITY));
        let direction = if base.y < 1.2 * length { direction.with_y(direction.y.abs()) } else { direction };
        let light = Vec3::Y + ((base - CROWN) / REACH) * 0.7 + random.direction() * 0.45;
        let normal = (light - direction * light.dot(direction)).normalize_or(Vec3::Y);
        out.leaf(&Leaf {
            base,
            direction,
            normal,
            length,
            width: length * random.range(0.42, 0.55),
            fold: random.range(0.1, 0.45),
            bend: random.range(0.1, 0.9) * if base.y < 1.2 * length { 0.3 } else { 1.0 },
            rows,
            midrib: true,
        });
    }
}
