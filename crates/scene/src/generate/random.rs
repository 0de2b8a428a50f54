//! Reproducible random streams, noise and trigonometry.

use rand_pcg::{Pcg32, rand_core::Rng};
use std::f32::consts::{PI, TAU};
use umbrage_geom::glam::Vec3;

/// A stream of random numbers that belongs to one element of one part of one mesh.
pub struct Stream(Pcg32);

impl Stream {
    /// The stream of element `index` of the part `part`. Streams of different elements are independent, so that more
    /// detail in one element never changes another.
    pub fn new(seed: u32, part: u32, index: usize) -> Self {
        let state = mix(u64::from(seed) << 32 | u64::from(part));
        Self(Pcg32::new(mix(state ^ index as u64), mix(state.wrapping_add(index as u64))))
    }

    /// Uniform in `[0, 1)`.
    pub fn unit(&mut self) -> f32 {
        (self.0.next_u32() >> 8) as f32 * (1.0 / 16_777_216.0)
    }

    /// Uniform in `[low, high)`.
    pub fn range(&mut self, low: f32, high: f32) -> f32 {
        low + (high - low) * self.unit()
    }

    /// Uniform in `[-1, 1)`.
    pub fn signed(&mut self) -> f32 {
        self.range(-1.0, 1.0)
    }

    /// Uniform in `0..count`, for a small `count`.
    pub fn below(&mut self, count: usize) -> usize {
        ((u64::from(self.0.next_u32()) * count as u64) >> 32) as usize
    }

    /// `true` with the given probability.
    pub fn chance(&mut self, probability: f32) -> bool {
        self.unit() < probability
    }

    /// A direction, uniform on the unit sphere.
    pub fn direction(&mut self) -> Vec3 {
        let y = self.signed();
        let (s, c) = sin_cos(TAU * self.unit());
        let r = (1.0 - y * y).max(0.0).sqrt();
        Vec3::new(r * c, y, r * s)
    }

    /// A point, uniform in the unit disc of the ground plane.
    pub fn in_disc(&mut self) -> Vec3 {
        let r = self.unit().sqrt();
        let (s, c) = sin_cos(TAU * self.unit());
        Vec3::new(r * c, 0.0, r * s)
    }

    /// A point, uniform in the unit ball.
    pub fn in_ball(&mut self) -> Vec3 {
        self.direction() * libm::cbrtf(self.unit())
    }
}

/// Finalizer of SplitMix64: every input bit reaches every output bit.
fn mix(mut z: u64) -> u64 {
    z = z.wrapping_add(0x9e37_79b9_7f4a_7c15);
    z = (z ^ z >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ z >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ z >> 31
}

/// Sine and cosine, the same bits on every machine.
pub fn sin_cos(angle: f32) -> (f32, f32) {
    libm::sincosf(angle)
}

/// A unit vector in the ground plane at `angle` from x towards z.
pub fn heading(angle: f32) -> Vec3 {
    let (s, c) = sin_cos(angle);
    Vec3::new(c, 0.0, s)
}

/// `v` turned by `angle` around the unit vector `axis` (Rodrigues).
pub fn rotate(v: Vec3, axis: Vec3, angle: f32) -> Vec3 {
    let (s, c) = sin_cos(angle);
    v * c + axis.cross(v) * s + axis * (axis.dot(v) * (1.0 - c))
}

/// 0 below `low`, 1 above `high`, smooth between.
pub fn smoothstep(low: f32, high: f32, x: f32) -> f32 {
    let t = ((x - low) / (high - low)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

/// Angle of golden-ratio phyllotaxis, radians.
pub const GOLDEN_ANGLE: f32 = PI * 0.763_932;

/// Smooth value noise in about `[-1, 1]`, with one random value at each integer point.
pub fn noise(seed: u32, p: Vec3) -> f32 {
    let cell = p.floor();
    let t = p - cell;
    let f = t * t * t * (t * (t * 6.0 - 15.0) + 10.0);
    let base = [cell.x as i32, cell.y as i32, cell.z as i32];
    let corner = |dx: i32, dy: i32, dz: i32| {
        let [x, y, z] = [base[0].wrapping_add(dx), base[1].wrapping_add(dy), base[2].wrapping_add(dz)];
        let low = u64::from(x as u32) | u64::from(y as u32) << 32;
        let bits = mix(low ^ mix(u64::from(z as u32) | u64::from(seed) << 32));
        (bits >> 40) as f32 * (2.0 / 16_777_216.0) - 1.0
    };
    let lerp = |a: f32, b: f32, t: f32| a + (b - a) * t;
    let plane = |dz| {
        lerp(
            lerp(corner(0, 0, dz), corner(1, 0, dz), f.x),
            lerp(corner(0, 1, dz), corner(1, 1, dz), f.x),
            f.y,
        )
    };
    lerp(plane(0), plane(1), f.z)
}

/// Sum of `octaves` of [`noise`], each twice as fine and half as strong; about `[-1, 1]`.
pub fn fractal_noise(seed: u32, p: Vec3, octaves: u32) -> f32 {
    let (mut sum, mut scale) = (0.0, 1.0);
    for octave in 0..octaves {
        sum += noise(seed.wrapping_add(octave), p * scale) / scale;
        scale *= 2.0;
    }
    sum * 0.5
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn streams_are_reproducible_and_independent() {
        let draw = |seed, part, index| Stream::new(seed, part, index).unit();
        assert_eq!(draw(1, 2, 3), draw(1, 2, 3));
        let others = [draw(2, 2, 3), draw(1, 3, 3), draw(1, 2, 4)];
        assert!(others.iter().all(|&x| x != draw(1, 2, 3)));
    }

    #[test]
    fn samples_have_the_right_mean() {
        let mut stream = Stream::new(0, 0, 0);
        let n = 20_000;
        let mean = (0..n).map(|_| stream.in_ball()).sum::<Vec3>() / n as f32;
        assert!(mean.length() < 0.02, "{mean}");
        let radius = (0..n).map(|_| stream.in_disc().length()).sum::<f32>() / n as f32;
        assert!((radius - 2.0 / 3.0).abs() < 0.01, "{radius}");
    }

    #[test]
    fn noise_is_continuous_across_cells() {
        for i in 0..50 {
            let p = Vec3::new(i as f32, 0.3 * i as f32, -0.7 * i as f32);
            let step = Vec3::splat(1e-4);
            assert!((noise(7, p - step) - noise(7, p + step)).abs() < 1e-3);
        }
    }
}
