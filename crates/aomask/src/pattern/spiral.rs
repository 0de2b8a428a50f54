//! Points of the disc with one point in each of `n` rings of equal area, successive rings a golden angle apart.
//!
//! Ring `k` of `n` has `z^2` (one minus the squared distance from the middle of the disc) between `k / n` and `(k + 1) / n`, so that
//! ring 0 is the horizon. A *family* is a number of such sets, its *members*: for each ring, the places inside the ring that the
//! members take are evenly spread over it, in an order that differs from ring to ring. A random member, turned by a random angle,
//! therefore has every ray uniformly distributed in its ring, and their mean is cosine-weighted occlusion without bias.
//!
//! # Source
//! The spiral is Vogel's (A better way to construct the sunflower head, 1979). That it has the least error of six candidates is
//! measured by `cargo xtask bench aomask --part patterns`.

use umbrage_geom::{
    glam::{Vec2, Vec3},
    sampling::{RandomStream, Rotation},
};

/// Members times rays of a family, at least: `z^2` takes this many evenly spread values over all members.
const LEVELS: usize = 1 << 13;
/// Fewest members of a family.
const FEWEST_MEMBERS: usize = 4;
/// Smallest `z^2` of a ray: keeps every turned direction above the tangent plane whatever the rounding. The area lost is a
/// millionth of the disc.
const LEAST_Z2: f64 = 1e-6;
/// The golden angle, `(3 - sqrt(5)) / 2` of a turn, in units of 2^-64 turns.
const GOLDEN_ANGLE: u64 = 0x61c8_8646_80b5_83eb;

/// How many members the family of `n` rays has, a power of two.
pub(super) fn members(n: usize) -> usize {
    (LEVELS / n).max(FEWEST_MEMBERS).next_power_of_two()
}

/// The unit direction of ring `ring` of `n`, at the fraction `place` (0 to 1) of the ring's area from its rim inwards.
fn direction(ring: usize, n: usize, place: f64) -> Vec3 {
    let turns = (ring as u64).wrapping_mul(GOLDEN_ANGLE);
    // The upper 24 bits are exact in `f32`.
    let turns = (turns >> 40) as f32 / (1 << 24) as f32;
    let z2 = ((ring as f64 + place) / n as f64).clamp(LEAST_Z2, 1.0);
    let azimuth: Vec2 = Rotation::from_turns(turns).apply(Vec3::X).truncate();
    (azimuth * (1.0 - z2).sqrt() as f32).extend(z2.sqrt() as f32)
}

/// One set of `n` directions, in the middle of the rings.
pub(super) fn middles(n: usize) -> Vec<Vec3> {
    (0..n).map(|ring| direction(ring, n, 0.5)).collect()
}

/// The members of the family of `n` rays, ring by ring.
pub(super) fn family(n: usize, seed: u32) -> Vec<Vec<Vec3>> {
    let members = members(n);
    let bits = members.trailing_zeros();
    let mut random = RandomStream::new(seed, 0x7370_6972);
    let shifts: Vec<usize> = (0..n).map(|_| random.next_below(members as u32) as usize).collect();
    let mut member = |number: usize| {
        // Successive members take places far from each other.
        let spread = number.reverse_bits() >> (usize::BITS - bits);
        let mut direction = |(ring, shift): (usize, &usize)| {
            let cell = (spread + shift) % members;
            let place = (cell as f64 + f64::from(random.next_unit())) / members as f64;
            direction(ring, n, place)
        };
        shifts.iter().enumerate().map(&mut direction).collect()
    };
    (0..members).map(&mut member).collect()
}
