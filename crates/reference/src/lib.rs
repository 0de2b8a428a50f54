//! Ambient occlusion and shadows by independent random rays: what every `rmse` and `bias` of the project is measured against.
//!
//! Here: plain random rays (no strata, no pattern, a generator and a frame of their own). A [`Question`] decides them by the exact
//! predicate, one by one through [`Bvh::any_hit`], [`Bvh::closest_hit`] or [`Bvh::transmittance`], and keeps answers in a folder by their
//! content, so that a suite asks for each only once. [`Receivers`] ask about whatever the caller traces, in rounds that can be joined. The
//! estimate has no bias; its standard error is known and part of the answer.

#![forbid(unsafe_code)]

mod estimate;
mod generator;

pub use estimate::{Emitter, Receivers};

use generator::mix;
use std::{
    fs,
    path::{Path, PathBuf},
};
use umbrage_accel::{BuildError, BuildOptions, Bvh};
use umbrage_geom::{Falloff, OpticalDepth, Ray, TriangleMesh};

/// Counts as part of every key: what is computed has changed when this has.
const VERSION: u64 = 1;

/// What is asked: receivers of a mesh, and how far occluders count.
#[derive(Clone, Copy, Debug)]
pub struct Question<'a> {
    /// Occluders.
    pub mesh: &'a TriangleMesh,
    /// Optical depth of a crossing of each triangle; empty if all are opaque.
    pub depths: &'a [OpticalDepth],
    /// Where rays start, exactly.
    pub points: &'a [[f32; 3]],
    /// Unit normals.
    pub normals: &'a [[f32; 3]],
    /// Length of rays, world units; may be infinite.
    pub radius: f32,
    /// How occlusion fades with the distance of the nearest hit; anything but constant needs opaque triangles and a radius.
    pub falloff: &'a Falloff,
}

/// Openness of each receiver, with its error.
#[derive(Clone, Debug, PartialEq)]
pub struct Reference {
    /// Mean of the rays: 1 is open.
    pub ao: Vec<f64>,
    /// Variance of each mean, by the spread of its rays.
    pub variances: Vec<f64>,
}

impl Reference {
    /// Root mean square of the standard errors of the receivers.
    pub fn standard_error(&self) -> f64 {
        (self.variances.iter().sum::<f64>() / self.variances.len().max(1) as f64).sqrt()
    }

    /// Standard error of the mean over all receivers.
    pub fn standard_error_of_mean(&self) -> f64 {
        self.variances.iter().sum::<f64>().sqrt() / self.variances.len().max(1) as f64
    }

    /// The mean of this answer and of an `other` one to the same question by other rays; `share` of the rays are the other's.
    #[must_use]
    pub fn joined(self, other: &Self, share: f64) -> Self {
        let join = |own: Vec<f64>, other: &[f64], a: f64, b: f64| -> Vec<f64> {
            own.into_iter().zip(other).map(|(x, y)| a * x + b * y).collect()
        };
        let own = 1.0 - share;
        Self {
            ao: join(self.ao, &other.ao, own, share),
            variances: join(self.variances, &other.variances, own * own, share * share),
        }
    }

    /// Mean of `ao` minus that of the reference.
    pub fn bias(&self, ao: impl IntoIterator<Item = f64>) -> f64 {
        let sum: f64 = ao.into_iter().zip(&self.ao).map(|(a, b)| a - b).sum();
        sum / self.ao.len().max(1) as f64
    }

    /// Root mean square error of `ao`, without what the reference itself errs by; 0 where that is more.
    pub fn rmse(&self, ao: impl IntoIterator<Item = f64>) -> f64 {
        let squares: f64 = ao.into_iter().zip(&self.ao).map(|(a, b)| (a - b).powi(2)).sum();
        let own: f64 = self.variances.iter().sum();
        ((squares - own).max(0.0) / self.ao.len().max(1) as f64).sqrt()
    }
}

impl Question<'_> {
    /// Answers by `rays` random rays a receiver, on all threads of the caller's pool.
    ///
    /// # Errors
    /// [`BuildError`] if no hierarchy can be built.
    pub fn answer(&self, rays: u32, seed: u64) -> Result<Reference, BuildError> {
        let bvh = Bvh::build(&self.mesh.positions, &self.mesh.triangles, &BuildOptions::default())?;
        let receivers = Receivers { points: self.points, normals: self.normals, faces: &[] };
        Ok(receivers.openness(self.radius, rays, seed, &|ray| self.passed(&bvh, ray)))
    }

    /// [`Self::answer`], from the folder `target/reference` of the workspace where it is known, else kept there.
    ///
    /// # Errors
    /// As for [`Self::answer`]. A folder that can't be read or written only costs time.
    pub fn cached(&self, rays: u32, seed: u64) -> Result<Reference, BuildError> {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../target/reference");
        let path: PathBuf = folder.join(format!("{:016x}.bin", self.key(rays, seed)));
        if let Some(known) = fs::read(&path).ok().and_then(|bytes| parse(&bytes, self.points.len())) {
            return Ok(known);
        }
        let answer = self.answer(rays, seed)?;
        let numbers = answer.ao.iter().chain(&answer.variances);
        let bytes: Vec<u8> = numbers.flat_map(|x| x.to_le_bytes()).collect();
        // Written under another name first: two processes may ask at once.
        let part = folder.join(format!("{:016x}.{}", self.key(rays, seed), std::process::id()));
        let written = fs::create_dir_all(&folder).and_then(|()| fs::write(&part, bytes));
        let _ = written.and_then(|()| fs::rename(&part, &path));
        Ok(answer)
    }

    fn key(&self, rays: u32, seed: u64) -> u64 {
        let mut key = mix(VERSION ^ u64::from(rays) << 32 ^ seed.rotate_left(17));
        let mut add = |word: u64| key = mix(key.rotate_left(5) ^ word);
        add(u64::from(self.radius.to_bits()));
        format!("{:?}", self.falloff).bytes().for_each(|b| add(b.into()));
        for list in [&self.mesh.positions[..], self.points, self.normals] {
            add(list.len() as u64);
            list.iter().flatten().for_each(|x| add(x.to_bits().into()));
        }
        self.mesh.triangles.iter().flatten().for_each(|&i| add(i.into()));
        self.depths.iter().for_each(|depth| add(depth.transmittance().to_bits().into()));
        key
    }

    fn passed(&self, bvh: &Bvh, ray: &Ray) -> f64 {
        if !self.depths.is_empty() {
            let depth = |prim: u32| self.depths[prim as usize];
            return f64::from(bvh.transmittance(ray, depth).transmittance());
        }
        if *self.falloff == Falloff::Constant {
            return f64::from(u8::from(!bvh.any_hit(ray)));
        }
        bvh.closest_hit(ray).map_or(1.0, |hit| 1.0 - f64::from(self.falloff.weight(hit.t / self.radius)))
    }
}

fn parse(bytes: &[u8], receivers: usize) -> Option<Reference> {
    if bytes.len() != receivers * 16 {
        return None;
    }
    let number = |eight: &[u8]| f64::from_le_bytes(eight.try_into().unwrap_or_default());
    let mut numbers: Vec<f64> = bytes.chunks(8).map(number).collect();
    let variances = numbers.split_off(receivers);
    Some(Reference { ao: numbers, variances })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A wall 0.2 high all around the origin, at distance 1 or a little more.
    fn wall() -> TriangleMesh {
        let (mut positions, mut triangles) = (Vec::new(), Vec::new());
        let n = 512u32;
        for i in 0..n {
            let (sin, cos) = (f64::from(i) / f64::from(n) * std::f64::consts::TAU).sin_cos();
            positions.extend([[cos as f32, sin as f32, -0.1], [cos as f32, sin as f32, 0.2]]);
            let (a, b) = (2 * i, 2 * ((i + 1) % n));
            triangles.extend([[a, b, a + 1], [b, b + 1, a + 1]]);
        }
        TriangleMesh::new(positions, triangles).unwrap()
    }

    #[test]
    fn a_wall_hides_what_analysis_says() {
        let mesh = wall();
        let question = Question {
            mesh: &mesh,
            depths: &[],
            points: &[[0.0; 3]; 50],
            normals: &[[0.0, 0.0, 1.0]; 50],
            radius: f32::INFINITY,
            falloff: &Falloff::Constant,
        };
        let answer = question.answer(2000, 3).unwrap();
        // Directions below atan(0.2) have sin^2 = 1 / 26 of the projected solid angle.
        let expected = 25.0 / 26.0;
        let bias = answer.bias(vec![expected; 50]);
        assert!(bias.abs() < 4.0 * answer.standard_error_of_mean(), "{bias}");
        // The stated error is the real one: binomial.
        let binomial = (expected * (1.0 - expected) / 2000.0).sqrt();
        assert!((answer.standard_error() / binomial - 1.0).abs() < 0.05);
        // Receivers have rays of their own.
        assert_ne!(answer.ao[0], answer.ao[1]);
        // Half of the distance: nothing is hit; a linear falloff of twice the distance counts hits by half.
        let near = Question { radius: 0.5, ..question };
        assert!(near.answer(100, 3).unwrap().ao.iter().all(|&ao| ao == 1.0));
        let falling = Question { radius: 2.0, falloff: &Falloff::Linear, ..question };
        let answer = falling.answer(2000, 3).unwrap();
        let mean = answer.ao.iter().sum::<f64>() / 50.0;
        assert!((mean - (1.0 - 0.5 / 26.0)).abs() < 2e-3, "{mean}");
        // Two crossings of half-transparent walls are one here.
        let depths = vec![OpticalDepth::from_opacity(0.5); mesh.triangles.len()];
        let veiled = Question { depths: &depths, ..question };
        let mean = veiled.answer(2000, 3).unwrap().ao.iter().sum::<f64>() / 50.0;
        assert!((mean - (1.0 - 0.5 / 26.0)).abs() < 2e-3, "{mean}");
    }

    #[test]
    fn errors_leave_out_what_the_reference_errs_by() {
        let reference = Reference { ao: vec![0.5; 4], variances: vec![0.01; 4] };
        assert!((reference.rmse([0.7, 0.3, 0.7, 0.3]) - 0.03f64.sqrt()).abs() < 1e-12);
        assert_eq!(reference.rmse([0.5; 4]), 0.0);
        assert!((reference.bias([0.7, 0.5, 0.7, 0.5]) - 0.1).abs() < 1e-12);
    }

    #[test]
    fn answers_are_kept_and_keys_tell_questions_apart() {
        let mesh = wall();
        let (points, normals) = ([[0.0; 3]; 3], [[0.0, 0.0, 1.0]; 3]);
        let question = Question {
            mesh: &mesh,
            depths: &[],
            points: &points,
            normals: &normals,
            radius: 2.0,
            falloff: &Falloff::Constant,
        };
        let first = question.cached(64, 9).unwrap();
        assert_eq!(first, question.answer(64, 9).unwrap());
        assert_eq!(first, question.cached(64, 9).unwrap());
        let other = Question { radius: 3.0, ..question };
        let keys = [question.key(64, 9), question.key(65, 9), question.key(64, 10), other.key(64, 9)];
        assert!((0..4).all(|i| (0..i).all(|k| keys[i] != keys[k])));
    }
}
