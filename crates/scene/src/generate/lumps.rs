//! `blob` and `rocks`: closed star-shaped lumps.
//!
//! A lump is a grid on the sphere whose points move along their radius. The grid never folds on the sphere, so the lump
//! never intersects itself, whatever the radius does.

use super::{
    Generated, Inputs,
    random::{Stream, fractal_noise},
    shapes::{cube_grid, cube_segments, put_on_ground, sphere_point, whole},
};
use umbrage_geom::{
    TriangleMesh,
    glam::{DVec3, Vec3},
};

pub fn blob(inputs: &Inputs) -> Generated {
    let strength = inputs.number("bumps") as f32;
    let mut random = Stream::new(inputs.seed, 0, 0);
    let lobes: Vec<(Vec3, f32, f32)> =
        (0..14).map(|_| (random.direction(), random.range(-0.35, 0.6), random.range(2.5, 9.0))).collect();
    let radius = |d: Vec3| {
        let lobes: f32 =
            lobes.iter().map(|&(at, height, narrow)| height * libm::expf(narrow * (at.dot(d) - 1.0))).sum();
        let grain = fractal_noise(inputs.seed, d * 2.2, 3);
        (1.0 + strength * (lobes + 0.3 * grain)).max(0.2)
    };
    let mut mesh = cube_grid(cube_segments(inputs.triangles), "blob", |p| {
        let d = sphere_point(p);
        d * f64::from(radius(d.as_vec3()))
    });
    put_on_ground(&mut mesh, Vec3::ZERO);
    mesh.into()
}

/// A stone: blocks cut off by planes, roughened and stretched.
struct Stone {
    cuts: Vec<(Vec3, f32)>,
    stretch: Vec3,
    seed: u32,
}

impl Stone {
    fn new(seed: u32, index: usize, size: f32) -> Self {
        let mut random = Stream::new(seed, 1, index);
        let mut cuts: Vec<_> = (0..18).map(|_| (random.direction(), random.range(0.72, 1.0))).collect();
        // A foot to stand on.
        cuts.push((Vec3::NEG_Y, random.range(0.35, 0.6)));
        let stretch =
            Vec3::new(random.range(0.8, 1.25), random.range(0.55, 0.9), random.range(0.8, 1.25)) * size;
        Self { cuts, stretch, seed: seed.wrapping_mul(31).wrapping_add(index as u32 * 7919) }
    }

    fn point(&self, d: DVec3) -> DVec3 {
        let d32 = d.as_vec3();
        // Distance to the nearest of the cutting planes, at most that of a ball.
        let cut = |&(normal, distance): &(Vec3, f32)| distance / normal.dot(d32).max(0.05);
        let block = self.cuts.iter().map(cut).fold(1.15, f32::min);
        let rough = 1.0 + 0.10 * fractal_noise(self.seed, d32 * 2.5, 5);
        d * f64::from(block * rough) * self.stretch.as_dvec3()
    }

    /// Bound on the horizontal reach.
    fn reach(&self) -> f32 {
        1.15 * 1.10 * self.stretch.x.max(self.stretch.z)
    }
}

pub fn rocks(inputs: &Inputs) -> Generated {
    let count = inputs.number("count") as usize;
    let stones: Vec<Stone> = (0..count)
        .map(|i| {
            let rank = Stream::new(inputs.seed, 0, i).unit();
            Stone::new(inputs.seed, i, if i == 0 { 0.9 } else { 0.12 + 0.45 * rank * rank * rank })
        })
        .collect();
    let places = scatter(inputs.seed, &stones);
    let weights: Vec<f64> = stones.iter().map(|s| f64::from(s.stretch.x * s.stretch.x) + 0.02).collect();
    let (total, mut left) = (weights.iter().sum::<f64>(), 0.0);
    let mut mesh = TriangleMesh::default();
    for ((stone, place), weight) in stones.iter().zip(places).zip(weights) {
        // What one stone gets too little or too much passes on to the next.
        let share = inputs.triangles as f64 * weight / total + left;
        let segments = cube_segments(share.max(0.0) as usize).max(2);
        left = share - (12 * segments * segments) as f64;
        let mut one = cube_grid(segments, "rocks", |p| stone.point(sphere_point(p)));
        one.corner_uvs = Vec::new();
        put_on_ground(&mut one, place);
        let base = mesh.positions.len() as u32;
        mesh.positions.append(&mut one.positions);
        mesh.triangles.extend(one.triangles.iter().map(|t| t.map(|v| v + base)));
    }
    whole(mesh, "rocks").into()
}

/// Places on the ground where no two stones touch, largest stones first served in the middle.
fn scatter(seed: u32, stones: &[Stone]) -> Vec<Vec3> {
    let mut places: Vec<Vec3> = Vec::with_capacity(stones.len());
    for (i, stone) in stones.iter().enumerate() {
        let mut random = Stream::new(seed, 2, i);
        let mut spread = if i == 0 { 0.0 } else { 0.6 };
        let place = loop {
            let place = random.in_disc() * spread;
            let free = places
                .iter()
                .zip(stones)
                .all(|(other, s)| place.distance(*other) > (stone.reach() + s.reach()) * 1.01);
            if free {
                break place;
            }
            spread += 0.02;
        };
        places.push(place);
    }
    places
}
