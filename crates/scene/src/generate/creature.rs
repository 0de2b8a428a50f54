//! `dragonish`, and the characters of `stage`.

use super::{
    Generated, Inputs,
    implicit::Shape,
    random::Stream,
    shapes::{put_on_ground, whole},
};
use umbrage_geom::{
    TriangleMesh,
    glam::{DVec3, Vec3, dvec3},
};

/// Random proportions, each within a fraction of 1.
struct Proportions(Stream);

impl Proportions {
    fn around(&mut self, value: f64, fraction: f64) -> f64 {
        value * (1.0 + fraction * f64::from(self.0.signed()))
    }
}

/// `p` on one side or the other of the plane z = 0.
fn mirrored(p: DVec3, side: f64) -> DVec3 {
    dvec3(p.x, p.y, p.z * side)
}

fn chain(shape: &mut Shape, side: f64, melt: f64, points: &[(f64, f64, f64, f64)]) {
    let points: Vec<_> = points.iter().map(|&(x, y, z, r)| (mirrored(dvec3(x, y, z), side), r)).collect();
    shape.chain(&points, melt);
}

pub fn dragonish(inputs: &Inputs) -> Generated {
    let mut mesh = dragon(inputs.seed).polygonise(inputs.triangles);
    put_on_ground(&mut mesh, Vec3::ZERO);
    whole(mesh, "dragonish").into()
}

/// A winged four-legged creature with a curled tail, about 2 long, that looks along x.
fn dragon(seed: u32) -> Shape {
    let mut vary = Proportions(Stream::new(seed, 0, 0));
    let mut shape = Shape::default();
    let (turn, rise) = (vary.around(0.0, 0.0) + 0.12 * f64::from(vary.0.signed()), vary.around(1.0, 0.08));
    let neck = [
        (0.20, 0.64, 0.0, 0.22),
        (0.44, 0.84, 0.2 * turn, 0.135),
        (0.58, 1.04 * rise, 0.7 * turn, 0.10),
        (0.66, 1.22 * rise, turn, 0.095),
    ];
    chain(&mut shape, 1.0, 0.10, &[(-0.48, 0.56, 0.0, 0.19), (-0.12, 0.57, 0.0, 0.235), neck[0]]);
    chain(&mut shape, 1.0, 0.08, &neck);
    let tail = [
        (-0.48, 0.56, 0.0, 0.18),
        (-0.78, 0.42, 0.06, 0.125),
        (-1.02, 0.25, 0.22, 0.09),
        (-1.14, 0.13, 0.46, 0.07),
        (-1.04, 0.09, 0.70, 0.055),
        (-0.80, 0.09, 0.82, 0.042),
        (-0.56, 0.14, 0.78, 0.028),
        (-0.42, 0.24, 0.68, 0.016),
    ];
    chain(&mut shape, if vary.0.chance(0.5) { 1.0 } else { -1.0 }, 0.05, &tail);
    head(&mut shape, dvec3(0.70, 1.27 * rise, turn));
    for side in [-1.0, 1.0] {
        legs(&mut shape, side, &mut vary);
        wing(&mut shape, side, &mut vary);
    }
    crest(&mut shape, &[&tail[1..2], &[(-0.48, 0.56, 0.0, 0.18), (-0.12, 0.57, 0.0, 0.235)], &neck].concat());
    shape
}

fn head(shape: &mut Shape, at: DVec3) {
    let mut bone = |a: DVec3, b: DVec3, radii, melt| shape.bone(at + a, at + b, radii, melt);
    bone(DVec3::ZERO, dvec3(0.12, 0.01, 0.0), [0.105, 0.085], 0.05);
    bone(dvec3(0.10, 0.01, 0.0), dvec3(0.32, -0.04, 0.0), [0.075, 0.05], 0.04);
    bone(dvec3(0.04, -0.08, 0.0), dvec3(0.26, -0.17, 0.0), [0.055, 0.032], 0.03);
    for side in [-1.0, 1.0] {
        let mut bone = |a: DVec3, b: DVec3, radii| {
            shape.bone(at + mirrored(a, side), at + mirrored(b, side), radii, 0.025);
        };
        bone(dvec3(-0.04, 0.07, 0.05), dvec3(-0.16, 0.19, 0.10), [0.04, 0.026]);
        bone(dvec3(-0.16, 0.19, 0.10), dvec3(-0.32, 0.22, 0.13), [0.026, 0.008]);
        bone(dvec3(-0.06, -0.03, 0.09), dvec3(-0.20, -0.02, 0.17), [0.03, 0.008]);
        bone(dvec3(0.08, 0.075, 0.055), dvec3(0.15, 0.07, 0.045), [0.032, 0.02]);
        bone(dvec3(0.31, 0.0, 0.025), dvec3(0.31, 0.012, 0.03), [0.022, 0.02]);
    }
}

fn legs(shape: &mut Shape, side: f64, vary: &mut Proportions) {
    let stride = 0.10 * side + 0.02 * f64::from(vary.0.signed());
    let front = [
        (0.22, 0.56, 0.15, 0.14),
        (0.16 + stride, 0.34, 0.25, 0.085),
        (0.26 + stride, 0.11, 0.25, 0.058),
        (0.34 + stride, 0.045, 0.26, 0.05),
    ];
    let back = [
        (-0.46, 0.50, 0.14, 0.17),
        (-0.30 - stride, 0.32, 0.26, 0.105),
        (-0.50 - stride, 0.14, 0.27, 0.06),
        (-0.38 - stride, 0.045, 0.28, 0.052),
    ];
    for leg in [front, back] {
        chain(shape, side, 0.06, &leg);
        let (x, y, z, _) = leg[3];
        for toe in [-1.0, 0.0, 1.0] {
            let tip = (x + 0.13 - 0.02 * toe * toe, y - 0.015, z + 0.055 * toe, 0.018);
            chain(
                shape,
                side,
                0.02,
                &[(x, y, z + 0.02 * toe, 0.038), (x + 0.08, y + 0.005, z + 0.045 * toe, 0.032), tip],
            );
        }
    }
}

fn wing(shape: &mut Shape, side: f64, vary: &mut Proportions) {
    let lift = 0.08 * f64::from(vary.0.signed());
    let point = |x: f64, y: f64, z: f64| mirrored(dvec3(x, y + lift * z, z), side);
    let (shoulder, elbow) = (point(0.10, 0.76, 0.12), point(-0.08, 1.12, 0.36));
    let wrist = point(0.10, 1.42, 0.66);
    let tips = [
        point(-0.18, 1.66, 1.22),
        point(-0.52, 1.30, 1.18),
        point(-0.70, 1.00, 0.90),
        point(-0.66, 0.80, 0.52),
    ];
    let root = point(-0.42, 0.70, 0.10);
    shape.chain(&[(shoulder, 0.07), (elbow, 0.048), (wrist, 0.04)], 0.04);
    for tip in tips {
        // Fingers bow outwards; a membrane of two triangles hangs between each two.
        shape.chain(&[(wrist, 0.03), (wrist.lerp(tip, 0.55) + DVec3::Y * 0.05, 0.022), (tip, 0.01)], 0.02);
    }
    for pair in tips.windows(2) {
        let sag = pair[0].lerp(pair[1], 0.5).lerp(wrist, 0.22);
        shape.membrane([wrist, pair[0], sag], 0.011, 0.012);
        shape.membrane([wrist, sag, pair[1]], 0.011, 0.012);
    }
    let inner = tips[3].lerp(root, 0.5).lerp(elbow, 0.2);
    for corners in
        [[wrist, tips[3], elbow], [elbow, tips[3], inner], [elbow, inner, root], [elbow, root, shoulder]]
    {
        shape.membrane(corners, 0.011, 0.012);
    }
    shape.bone(wrist, wrist + dvec3(0.10, 0.06, 0.0), [0.025, 0.008], 0.02);
}

/// Spikes along the back, given as points of the spine.
fn crest(shape: &mut Shape, spine: &[(f64, f64, f64, f64)]) {
    for pair in spine.windows(2) {
        for i in 0..3 {
            let t = f64::from(i) / 3.0;
            let mix = |a: f64, b: f64| a + (b - a) * t;
            let (a, b) = (pair[0], pair[1]);
            let (p, r) = (dvec3(mix(a.0, b.0), mix(a.1, b.1), mix(a.2, b.2)), mix(a.3, b.3));
            let along = (dvec3(b.0, b.1, b.2) - dvec3(a.0, a.1, a.2)).normalize_or_zero();
            let up = dvec3(-along.y, along.x.abs(), 0.0).normalize_or(DVec3::Y);
            let foot = p + up * (r * 0.92);
            shape.bone(foot, foot + (up - along * 0.6) * (0.05 + 0.18 * r), [0.035, 0.008], 0.02);
        }
    }
}

/// A plump character that stands on the ground and looks along x; `kind` 0, 1, 2 has long ears, a bushy tail, or a mane
/// of spikes. About 1.1 `size` high.
pub fn character(seed: u32, index: usize, kind: usize, size: f64, triangles: usize) -> TriangleMesh {
    let mut vary = Proportions(Stream::new(seed, 100, index));
    let mut shape = Shape::default();
    let girth = vary.around([0.30, 0.22, 0.25][kind], 0.1);
    let hip = dvec3(0.0, 0.24 + 0.55 * girth, 0.0);
    let chest = hip + dvec3(0.02, vary.around(0.26, 0.15), 0.0);
    shape.bone(hip, chest, [girth, girth * 0.72], 0.10);
    let skull = chest + dvec3(0.06, girth * 0.72 + vary.around(0.14, 0.2), 0.0);
    shape.ball(skull, 0.17, 0.06);
    shape.bone(skull + dvec3(0.08, -0.03, 0.0), skull + dvec3(0.21, -0.06, 0.0), [0.095, 0.06], 0.05);
    for side in [-1.0, 1.0] {
        let raise = vary.around(0.0, 0.0) + 0.2 * f64::from(vary.0.signed());
        let shoulder = chest + dvec3(0.0, 0.05, side * girth * 0.62);
        let elbow = shoulder + dvec3(0.10, -0.12 + raise * 0.5, side * 0.14);
        let hand = elbow + dvec3(0.13, 0.02 + raise, side * 0.01);
        shape.chain(&[(shoulder, 0.085), (elbow, 0.06), (hand, 0.055)], 0.05);
        for finger in [-1.0, 0.0, 1.0] {
            shape.bone(hand, hand + dvec3(0.075, 0.02, 0.04 * finger), [0.03, 0.02], 0.02);
        }
        let knee = dvec3(0.08, 0.20, side * girth * 0.62);
        let foot = dvec3(0.05, 0.065, side * girth * 0.68);
        shape.chain(
            &[(hip + dvec3(0.0, -0.06, side * girth * 0.45), 0.13), (knee, 0.10), (foot, 0.065)],
            0.06,
        );
        shape.bone(foot, foot + dvec3(0.17, -0.005, side * 0.03), [0.065, 0.055], 0.04);
        shape.ball(skull + dvec3(0.13, 0.055, side * 0.075), 0.045, 0.02);
        ears(&mut shape, skull, side, kind);
    }
    match kind {
        0 => shape.ball(hip + dvec3(-girth * 1.05, 0.0, 0.0), 0.09, 0.04),
        1 => shape.chain(
            &[
                (hip + dvec3(-girth, -0.02, 0.0), 0.06),
                (hip + dvec3(-girth - 0.18, 0.10, 0.02), 0.11),
                (hip + dvec3(-girth - 0.20, 0.34, 0.03), 0.14),
                (hip + dvec3(-girth - 0.32, 0.56, 0.04), 0.08),
            ],
            0.06,
        ),
        _ => {
            for i in 0..5 {
                let at = skull.lerp(hip, f64::from(i) * 0.22) + dvec3(-0.12 - 0.03 * f64::from(i), 0.08, 0.0);
                shape.bone(at, at + dvec3(-0.14, 0.09, 0.0), [0.06, 0.012], 0.03);
            }
        }
    }
    let mut mesh = shape.polygonise(triangles);
    for p in &mut mesh.positions {
        *p = p.map(|x| x * size as f32);
    }
    put_on_ground(&mut mesh, Vec3::ZERO);
    mesh
}

fn ears(shape: &mut Shape, skull: DVec3, side: f64, kind: usize) {
    let base = skull + dvec3(-0.02, 0.12, side * 0.07);
    match kind {
        0 => shape.chain(
            &[
                (base, 0.045),
                (base + dvec3(-0.03, 0.18, side * 0.05), 0.055),
                (base + dvec3(-0.09, 0.34, side * 0.11), 0.025),
            ],
            0.03,
        ),
        1 => shape.bone(base, base + dvec3(-0.02, 0.09, side * 0.03), [0.055, 0.02], 0.03),
        _ => shape.ball(base + dvec3(0.0, 0.01, side * 0.05), 0.065, 0.03),
    }
}
