//! `stage`: closed characters, an open trunk and leaves on a ground: many objects, few of them solid (Djeu11,
//! section 4.4).

use super::{
    Generated, Inputs,
    builder::{Builder, Leaf, leaf_triangles},
    creature::character,
    random::{GOLDEN_ANGLE, Stream, fractal_noise, heading, rotate},
    shapes::whole,
};
use std::f32::consts::TAU;
use umbrage_geom::{
    Frame, TriangleMesh,
    glam::{Affine3A, Vec3},
};

const CHARACTERS: usize = 3;
const BRANCHES: usize = 14;
const BRANCH_POINTS: usize = 8;
const BRANCH_SIDES: usize = 6;
const LEAF_ROWS: usize = 2;
const TRUNK_HEIGHT: f32 = 2.9;
const TRUNK: Vec3 = Vec3::new(-0.9, 0.0, -0.9);

pub fn stage(inputs: &Inputs) -> Generated {
    let budget = inputs.triangles;
    let mut mesh = ground(if budget < 50_000 { 8 } else { 24 });
    // Characters get nearly half, the trunk a twelfth, leaves what is left.
    for i in 0..CHARACTERS {
        mesh.append(&placed_character(inputs.seed, i, budget * 15 / 100));
    }
    let rows = ((budget as f32 / 12.0 / 4.0).sqrt() as usize).max(8);
    mesh.append(&trunk(inputs.seed, rows * 2, rows));
    let mut branches = Builder::default();
    branches.begin("branches");
    let paths: Vec<_> = (0..BRANCHES).map(|i| branch(inputs.seed, i, &mut branches)).collect();
    mesh.append(&branches.finish());
    let left = budget.saturating_sub(mesh.triangles.len());
    mesh.append(&leaves(inputs.seed, left / leaf_triangles(LEAF_ROWS, true), &paths));
    mesh.into()
}

fn ground(n: usize) -> TriangleMesh {
    let mut builder = Builder::default();
    builder.begin("ground");
    for j in 0..=n {
        for i in 0..=n {
            let at = |k: usize| (k as f32 / n as f32 - 0.5) * 9.0;
            builder.vertex(Vec3::new(at(i), 0.0, -at(j)));
        }
    }
    for j in 0..n {
        for i in 0..n {
            let a = (j * (n + 1) + i) as u32;
            let d = a + n as u32 + 1;
            builder.quad(a, a + 1, d + 1, d);
        }
    }
    builder.finish()
}

fn placed_character(seed: u32, index: usize, triangles: usize) -> TriangleMesh {
    let size = [1.25, 0.9, 0.75][index];
    let mut mesh = character(seed, index, index % 3, size, triangles);
    let place = [Vec3::new(0.35, 0.0, 0.15), Vec3::new(1.4, 0.0, 0.75), Vec3::new(-0.45, 0.0, 1.15)][index];
    let facing = [-0.9, -2.2, -0.5][index];
    mesh.transform(&(Affine3A::from_translation(place) * turn(facing)));
    whole(mesh, &format!("character {}", index + 1))
}

/// A turn around the vertical by `angle`, with the same bits everywhere.
fn turn(angle: f32) -> Affine3A {
    let x = heading(-angle);
    Affine3A::from_cols(x.into(), Vec3::Y.into(), Vec3::new(-x.z, 0.0, x.x).into(), Vec3::ZERO.into())
}

/// Bark: a wall of one sheet, open above and at the roots.
fn trunk(seed: u32, sides: usize, rows: usize) -> TriangleMesh {
    let mut builder = Builder::default();
    builder.begin("trunk");
    for j in 0..=rows {
        let t = j as f32 / rows as f32;
        let flare = (1.0 - t).powi(8) * 0.5 + 1.0 - 0.35 * t;
        for k in 0..sides {
            let out = heading(-TAU * k as f32 / sides as f32);
            let height = t * TRUNK_HEIGHT;
            // Ridges of bark run upwards; roots stand out below.
            let bark = fractal_noise(seed, out * 5.0 + Vec3::Y * (height * 0.8), 3);
            let root = (1.0 - t).powi(6) * fractal_noise(seed ^ 9, out * 2.0, 2);
            let radius = 0.34 * flare * (1.0 + 0.14 * bark + 0.6 * root);
            let bend = Vec3::new(0.12 * t * t, 0.0, 0.05 * t);
            builder.vertex(TRUNK + bend + out * radius + Vec3::Y * height);
        }
    }
    for j in 0..rows {
        builder.bridge((j * sides) as u32, ((j + 1) * sides) as u32, sides);
    }
    builder.finish()
}

fn branch(seed: u32, index: usize, out: &mut Builder) -> Vec<Vec3> {
    let mut random = Stream::new(seed, 1, index);
    let height = TRUNK_HEIGHT * random.range(0.72, 0.97);
    let away = heading(GOLDEN_ANGLE * index as f32);
    let mut point = TRUNK + Vec3::Y * height + away * 0.16;
    let away = if index.is_multiple_of(4) { away * 0.2 } else { away };
    let mut along = (away + Vec3::Y * random.range(0.05, 0.75)).normalize();
    let step = random.range(1.1, 1.9) / (BRANCH_POINTS - 1) as f32;
    let mut points = Vec::new();
    for _ in 0..BRANCH_POINTS {
        points.push(point);
        along = (along + random.direction() * 0.22 + Vec3::Y * 0.03).normalize();
        point += along * step;
    }
    let radii: Vec<f32> =
        (0..BRANCH_POINTS).map(|k| 0.075 * (1.0 - k as f32 / (BRANCH_POINTS - 1) as f32)).collect();
    out.tube(&points, &radii, BRANCH_SIDES);
    points
}

/// Leaves in clusters along the branches, and one in forty fallen to the ground.
fn leaves(seed: u32, count: usize, branches: &[Vec<Vec3>]) -> TriangleMesh {
    let mut builder = Builder::with_capacity(count * leaf_triangles(LEAF_ROWS, true));
    builder.begin("leaves");
    let size = (13.0 / (count.max(1) as f32).sqrt()).clamp(0.03, 0.4);
    for i in 0..count {
        let mut random = Stream::new(seed, 2, i);
        let fallen = i % 40 == 39;
        let path = &branches[i % branches.len()];
        let t = random.range(0.25, 1.0) * (path.len() - 1) as f32;
        let k = (t as usize).min(path.len() - 2);
        let near = path[k].lerp(path[k + 1], t - k as f32);
        let base = if fallen {
            let place = random.in_disc() * 3.2;
            place + Vec3::Y * 0.012
        } else {
            near + random.in_ball() * 0.55
        };
        let up = if fallen { Vec3::Y } else { (Vec3::Y + random.direction() * 0.7).normalize() };
        let frame = Frame::from_normal(up);
        let length = size * random.range(0.7, 1.3);
        builder.leaf(&Leaf {
            base,
            direction: rotate(frame.tangent, up, TAU * random.unit()),
            normal: up,
            length,
            width: length * 0.6,
            fold: 0.2,
            bend: if fallen { 0.0 } else { 0.5 },
            rows: LEAF_ROWS,
            midrib: true,
        });
    }
    builder.finish()
}

#[cfg(test)]
mod tests {
    use super::super::{Parameters, builder::tube_triangles, generate};
    use super::*;

    #[test]
    fn objects_are_as_documented_and_characters_apart() {
        let parameters = Parameters { triangles: Some(30_000), ..Parameters::default() };
        let mesh = generate("stage", &parameters).unwrap().mesh;
        let names: Vec<_> = mesh.objects.iter().map(|o| o.name.as_str()).collect();
        let expected = ["ground", "character 1", "character 2", "character 3", "trunk", "branches", "leaves"];
        assert_eq!(names, expected);
        assert_eq!(
            mesh.objects[5].triangles.len(),
            BRANCHES * tube_triangles(BRANCH_POINTS, BRANCH_SIDES, true)
        );
        for object in &mesh.objects[1..=CHARACTERS] {
            super::super::tests::assert_solid(&mesh, object.triangles.clone(), &object.name);
        }
    }
}
