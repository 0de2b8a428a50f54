//! `bamboo`: a grove of segmented culms with thin branches and hanging leaves (`[Lacewell08]`, figure 8).

use super::{
    Generated, Inputs,
    builder::{Builder, Leaf, leaf_triangles, tube_triangles},
    random::{GOLDEN_ANGLE, Stream, heading, noise, rotate},
};
use std::f32::consts::TAU;
use umbrage_geom::{Frame, glam::Vec3};

const BRANCH_POINTS: usize = 4;
const BRANCH_SIDES: usize = 3;
const LEAVES_PER_BRANCH: usize = 12;
const LEAF_ROWS: usize = 3;
const INTERNODES: usize = 17;
const DEFAULT_TRIANGLES: f64 = 5.2e6;

/// How a budget of triangles becomes culms.
struct Plan {
    culms: usize,
    sides: usize,
    /// Rings of vertices for each internode.
    rings: usize,
    /// Branches of the whole grove.
    branches: usize,
}

impl Plan {
    fn new(triangles: usize) -> Self {
        let share = triangles as f64 / DEFAULT_TRIANGLES;
        let culms = (480.0 * libm::pow(share, 0.6)).round().max(4.0) as usize;
        let each = triangles / culms;
        let (sides, rings) = match each {
            0..=1500 => (5, 2),
            1501..=5000 => (7, 3),
            _ => (10, 3),
        };
        let culm = tube_triangles(INTERNODES * rings + 1, sides, true);
        let branch = tube_triangles(BRANCH_POINTS, BRANCH_SIDES, true)
            + LEAVES_PER_BRANCH * leaf_triangles(LEAF_ROWS, false);
        let branches = triangles.saturating_sub(culms * culm) as f64 / branch as f64;
        Self { culms, sides, rings, branches: branches.round() as usize }
    }
}

/// A culm: its nodes from the ground up, and its radius at the ground.
struct Culm {
    nodes: Vec<Vec3>,
    radius: f32,
}

impl Culm {
    fn radius(&self, node: f32) -> f32 {
        let t = node / INTERNODES as f32;
        self.radius * (1.0 - 0.82 * t * t)
    }
}

pub fn bamboo(inputs: &Inputs) -> Generated {
    let plan = Plan::new(inputs.triangles);
    let mut culms = Builder::with_capacity(inputs.triangles / 4);
    let mut leaves = Builder::with_capacity(inputs.triangles);
    culms.begin("culms");
    leaves.begin("leaves");
    let spacing = 0.42 * inputs.number("spacing") as f32;
    // Leaves grow where there are few of them.
    let per_culm = plan.branches as f32 / plan.culms as f32;
    let leaf_length = 0.2 * (100.0 / per_culm.max(4.0)).sqrt().clamp(0.8, 2.2);
    for i in 0..plan.culms {
        let culm = grow(inputs.seed, i, spacing);
        add_culm(&culm, &plan, &mut culms);
        let first = plan.branches * i / plan.culms;
        let last = plan.branches * (i + 1) / plan.culms;
        for b in 0..last - first {
            let mut random = Stream::new(inputs.seed, 1 + i as u32, b);
            add_branch(&culm, b, last - first, leaf_length, &mut random, &mut culms, &mut leaves);
        }
    }
    culms.append(leaves);
    culms.finish().into()
}

/// Culms stand on a sunflower spiral with some disorder, in clumps, and lean apart towards their tops.
fn grow(seed: u32, index: usize, spacing: f32) -> Culm {
    let mut random = Stream::new(seed, 0, index);
    let place = heading(GOLDEN_ANGLE * index as f32) * ((index as f32 + 0.3).sqrt() * spacing);
    let drift = Vec3::new(noise(seed, place * 0.8), 0.0, noise(seed ^ 1, place * 0.8));
    let mut point = place + drift * (spacing * 1.1) + random.in_disc() * (spacing * 0.4);
    let height = random.range(4.6, 7.4);
    let mut along = (Vec3::Y + random.in_disc() * 0.08 + drift * 0.05).normalize();
    let droop = heading(TAU * random.unit()) * random.range(0.01, 0.07);
    let mut nodes = vec![point];
    for k in 0..INTERNODES {
        // Internodes are short near the ground and near the top.
        let t = k as f32 / INTERNODES as f32;
        let length = height / INTERNODES as f32 * (0.55 + 1.8 * t * (1.0 - t) * (1.3 - 0.3 * t));
        point += along * length * 1.18;
        nodes.push(point);
        along = (along + droop * (3.0 * t * t) + random.in_disc() * 0.012).normalize();
    }
    Culm { nodes, radius: random.range(0.032, 0.058) }
}

fn add_culm(culm: &Culm, plan: &Plan, out: &mut Builder) {
    let (mut points, mut radii) = (Vec::new(), Vec::new());
    for k in 0..INTERNODES {
        let (a, b) = (culm.nodes[k], culm.nodes[k + 1]);
        let r = culm.radius(k as f32);
        // A swollen ring at the node, then the slimmer internode.
        let near = [(0.0, 1.22), (0.07, 0.97), (0.93, 0.93)];
        let rings = if plan.rings == 2 { &[near[0], near[1]][..] } else { &near[..] };
        for &(t, scale) in rings {
            points.push(a.lerp(b, t));
            radii.push(r * scale);
        }
    }
    points.push(culm.nodes[INTERNODES]);
    radii.push(0.0);
    out.tube(&points, &radii, plan.sides);
}

/// A branch at a node of the upper part, with leaves along its outer half.
fn add_branch(
    culm: &Culm,
    index: usize,
    count: usize,
    leaf_length: f32,
    random: &mut Stream,
    culms: &mut Builder,
    leaves: &mut Builder,
) {
    // Nodes from a third of the height on bear branches, more of them higher up.
    let from = 5.0 / INTERNODES as f32;
    let t = from + (1.0 - from) * ((index as f32 + random.unit()) / count as f32).sqrt();
    let node = ((t * INTERNODES as f32) as usize).clamp(5, INTERNODES - 1);
    let base = culm.nodes[node];
    let stem = (culm.nodes[node + 1] - base).normalize();
    let frame = Frame::from_normal(stem);
    let side = rotate(frame.tangent, stem, GOLDEN_ANGLE * index as f32 + random.unit());
    let mut along = (side + stem * random.range(0.35, 0.9)).normalize();
    let length = random.range(0.35, 0.85) * (1.25 - 0.6 * node as f32 / INTERNODES as f32);
    let step = length / (BRANCH_POINTS - 1) as f32;
    let mut points = [base; BRANCH_POINTS];
    for k in 1..BRANCH_POINTS {
        points[k] = points[k - 1] + along * step;
        along = (along + Vec3::NEG_Y * 0.22 + random.direction() * 0.12).normalize();
    }
    let root = (0.18 * culm.radius(node as f32)).max(0.003);
    culms.tube(&points, &[root, root * 0.8, root * 0.6, 0.0], BRANCH_SIDES);
    for k in 0..LEAVES_PER_BRANCH {
        let t = 0.25 + 0.75 * (k + 1) as f32 / LEAVES_PER_BRANCH as f32;
        let s = t * (BRANCH_POINTS - 1) as f32;
        let i = (s as usize).min(BRANCH_POINTS - 2);
        let at = points[i].lerp(points[i + 1], s - i as f32);
        let out = (points[i + 1] - points[i]).normalize();
        let side = heading(TAU * random.unit());
        let direction = (out * 0.7 + side * 0.8 + Vec3::NEG_Y * random.range(0.1, 0.7)).normalize();
        let up = Vec3::Y + random.direction() * 0.4;
        let normal = (up - direction * up.dot(direction)).normalize_or(Frame::from_normal(direction).tangent);
        let size = leaf_length * random.range(0.65, 1.2);
        leaves.leaf(&Leaf {
            base: at,
            direction,
            normal,
            length: size,
            width: size * 0.13,
            fold: 0.0,
            bend: random.range(0.3, 1.1),
            rows: LEAF_ROWS,
            midrib: false,
        });
    }
}
