//! From what rays met to what callers asked for: openness, bent normals, sectors, distances.

use crate::{MaskError, Outputs, Pattern, Receiver};
use umbrage_geom::{Frame, glam::Vec3};

/// What the rays of a block of receivers met, receiver by receiver.
#[derive(Default)]
pub(crate) struct Answers {
    /// [`Pattern::words`] words each: rays through which nothing passes.
    pub(crate) masks: Vec<u64>,
    /// Fraction that passes along each ray; empty where the masks say it all.
    pub(crate) passed: Vec<f32>,
    /// Distance to the nearest hit of each ray, infinite if there is none; empty unless asked for.
    pub(crate) distances: Vec<f32>,
}

impl Answers {
    /// Makes room in the masks for `receivers`.
    pub(crate) fn resize(&mut self, pattern: &Pattern, receivers: usize) {
        self.masks.resize(receivers * pattern.words(), 0);
    }
}

/// The outputs that a caller wants.
pub(crate) struct OutputRequest {
    masks: bool,
    bent_normals: bool,
    free_directions: bool,
    /// Pseudo-angles where sectors end; empty if none are wanted.
    sectors: Vec<f32>,
    distances: bool,
}

/// Outputs of a block of receivers.
pub(crate) struct Gathered {
    ao: Vec<f32>,
    masks: Vec<u64>,
    bent_normals: Vec<[f32; 3]>,
    free_directions: Vec<[f32; 3]>,
    sectors: Vec<f32>,
    distances: Vec<f32>,
}

/// Grows with the azimuth of (`x`, `y`), from 0 along x up to 4.
fn pseudo_angle(x: f32, y: f32) -> f32 {
    let along = x / (x.abs() + y.abs()).max(f32::MIN_POSITIVE);
    if y < 0.0 { 3.0 + along } else { 1.0 - along }
}

/// Where each of `count` equal sectors ends, as pseudo-angles.
fn sector_ends(count: u32) -> Vec<f32> {
    let end = |i| {
        let (sin, cos) = (std::f64::consts::TAU * f64::from(i) / f64::from(count)).sin_cos();
        pseudo_angle(cos as f32, sin as f32)
    };
    // The last one has what rounding leaves beyond all others.
    (1..count).map(end).chain([f32::INFINITY]).collect()
}

impl OutputRequest {
    pub(crate) fn new(outputs: &Outputs<'_>) -> Self {
        Self {
            masks: outputs.masks.is_some(),
            bent_normals: outputs.bent_normals.is_some(),
            free_directions: outputs.free_directions.is_some(),
            sectors: outputs.sectors.as_ref().map_or_else(Vec::new, |(count, _)| sector_ends(*count)),
            distances: outputs.hit_distances.is_some(),
        }
    }

    /// Makes outputs of `answers`; receivers that are `None` have been answered as open.
    pub(crate) fn gather<'a>(
        &self,
        pattern: &Pattern,
        receivers: impl Iterator<Item = Option<&'a Receiver>>,
        answers: &Answers,
    ) -> Gathered {
        let (words, rays) = (pattern.words(), pattern.len());
        let mut gathered = Gathered {
            ao: Vec::with_capacity(answers.masks.len() / words),
            masks: if self.masks { answers.masks.clone() } else { Vec::new() },
            bent_normals: Vec::new(),
            free_directions: Vec::new(),
            sectors: Vec::new(),
            distances: Vec::new(),
        };
        for (i, receiver) in receivers.enumerate() {
            let passed = match &answers.passed[..] {
                [] => RayOpenness::Bits(&answers.masks[i * words..][..words]),
                passed => RayOpenness::Fractions(&passed[i * rays..][..rays]),
            };
            gathered.ao.push(passed.openness(pattern));
            if self.free_directions {
                let mean = receiver.map_or(Vec3::ZERO, |receiver| passed.free_direction(pattern, receiver));
                gathered.free_directions.push(mean.to_array());
            }
            if self.bent_normals {
                let bent = receiver.map_or(Vec3::ZERO, |receiver| {
                    passed.free_direction(pattern, receiver).try_normalize().unwrap_or(receiver.normal())
                });
                gathered.bent_normals.push(bent.to_array());
            }
            if !self.sectors.is_empty() {
                self.sectors(pattern, receiver, passed, &mut gathered.sectors);
            }
            if self.distances {
                gathered.distances.push(mean_distance(&answers.distances[i * rays..][..rays]));
            }
        }
        gathered
    }

    fn sectors(
        &self,
        pattern: &Pattern,
        receiver: Option<&Receiver>,
        passed: RayOpenness<'_>,
        out: &mut Vec<f32>,
    ) {
        let Some(receiver) = receiver else {
            return out.resize(out.len() + self.sectors.len(), 1.0);
        };
        let (rays, around) = (pattern.frame_of(receiver), Frame::from_normal(receiver.normal()));
        let mut sums = vec![(0.0, 0u32); self.sectors.len()];
        for (i, &direction) in pattern.directions(pattern.member_of(receiver)).iter().enumerate() {
            let direction = rays.world_from_local(direction);
            let angle = pseudo_angle(direction.dot(around.tangent), direction.dot(around.bitangent));
            let (sum, count) = &mut sums[self.sectors.partition_point(|&end| end <= angle)];
            *sum += f64::from(passed.of(i));
            *count += 1;
        }
        let all = passed.openness(pattern);
        let mean = |(sum, count): (f64, u32)| if count == 0 { all } else { (sum / f64::from(count)) as f32 };
        out.extend(sums.into_iter().map(mean));
    }
}

impl Gathered {
    /// Writes the block's answers to the places `indices` of the outputs.
    pub(crate) fn write(&self, outputs: &mut Outputs<'_>, indices: impl Iterator<Item = usize>) {
        let copy = |all: &mut Option<&mut [u64]>, from: &[u64], at: usize, i: usize, each: usize| {
            if let Some(all) = all {
                all[at * each..][..each].copy_from_slice(&from[i * each..][..each]);
            }
        };
        let words = self.masks.len() / self.ao.len().max(1);
        for (i, at) in indices.enumerate() {
            outputs.ao[at] = self.ao[i];
            copy(&mut outputs.masks, &self.masks, at, i, words);
            if let Some(all) = &mut outputs.bent_normals {
                all[at] = self.bent_normals[i];
            }
            if let Some(all) = &mut outputs.free_directions {
                all[at] = self.free_directions[i];
            }
            if let Some((count, all)) = &mut outputs.sectors {
                let count = *count as usize;
                all[at * count..][..count].copy_from_slice(&self.sectors[i * count..][..count]);
            }
            if let Some(all) = &mut outputs.hit_distances {
                all[at] = self.distances[i];
            }
        }
    }
}

/// What passes along the rays of one receiver.
#[derive(Clone, Copy)]
enum RayOpenness<'a> {
    /// Bits of blocked rays.
    Bits(&'a [u64]),
    /// A fraction for each ray.
    Fractions(&'a [f32]),
}

impl RayOpenness<'_> {
    #[inline]
    fn of(self, ray: usize) -> f32 {
        match self {
            Self::Bits(mask) => f32::from(u8::from(mask[ray / 64] >> (ray % 64) & 1 == 0)),
            Self::Fractions(passed) => passed[ray],
        }
    }

    fn openness(self, pattern: &Pattern) -> f32 {
        match self {
            Self::Bits(mask) => openness(pattern, mask),
            Self::Fractions(passed) => {
                // Several sums at a time, none of which waits for the others.
                let mut sums = [0.0; 8];
                for eight in passed.chunks(8) {
                    eight.iter().zip(&mut sums).for_each(|(&x, sum)| *sum += f64::from(x));
                }
                (sums.iter().sum::<f64>() / passed.len() as f64) as f32
            }
        }
    }

    /// Mean over all rays of the direction times what passes.
    fn free_direction(self, pattern: &Pattern, receiver: &Receiver) -> Vec3 {
        if receiver.face().is_some() {
            let rays = pattern.rays_of(receiver, 1.0).enumerate();
            return rays.map(|(i, ray)| ray.direction * self.of(i)).sum::<Vec3>() / pattern.len() as f32;
        }
        let directions = pattern.directions(pattern.member_of(receiver));
        let sum: Vec3 = directions.iter().enumerate().map(|(i, &d)| d * self.of(i)).sum();
        pattern.frame_of(receiver).world_from_local(sum / pattern.len() as f32)
    }
}

/// Mean over the rays that hit something; infinite if none does.
fn mean_distance(distances: &[f32]) -> f32 {
    let hits = distances.iter().filter(|d| d.is_finite());
    let (sum, count) = hits.fold((0.0, 0u32), |(sum, count), &d| (sum + f64::from(d), count + 1));
    if count == 0 { f32::INFINITY } else { (sum / f64::from(count)) as f32 }
}

/// Fraction of rays whose bit is 0.
pub(crate) fn openness(pattern: &Pattern, mask: &[u64]) -> f32 {
    let blocked: u32 = mask.iter().map(|word| word.count_ones()).sum();
    (pattern.len() - blocked as usize) as f32 / pattern.len() as f32
}

impl Pattern {
    /// Mean over all rays of `receiver` of the direction times 1 where the ray is free, 0 where its bit in `mask` says that it is
    /// blocked; its direction is the bent normal.
    ///
    /// # Errors
    /// [`MaskError::Length`] unless `mask` has [`Self::words`] words.
    pub fn free_direction(&self, receiver: &Receiver, mask: &[u64]) -> Result<[f32; 3], MaskError> {
        if mask.len() != self.words() {
            let (actual, expected) = (mask.len(), self.words());
            return Err(MaskError::Length { what: "mask", actual, expected, points: 1 });
        }
        Ok(RayOpenness::Bits(mask).free_direction(self, receiver).to_array())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sectors_are_equal_and_in_order() {
        for count in [1u32, 2, 3, 8, 32] {
            let ends = sector_ends(count);
            for step in 0..360 {
                let degrees = f64::from(step) + 0.5;
                let (sin, cos) = degrees.to_radians().sin_cos();
                let sector = ends.partition_point(|&end| end <= pseudo_angle(cos as f32, sin as f32));
                assert_eq!(sector, (degrees / 360.0 * f64::from(count)) as usize);
            }
        }
    }
}
