//! Baking by masks of `umbrage-aomask`: all rays of a receiver at once.

use super::receivers::Lobe;
use super::{
    BakeError, BakeExtras, BakeOptions, Receivers, Shard,
    integrate::{MIN_HEIGHT, above, shard_of},
};
use crate::query::{Engine, QueryError};
use std::io::{self, Write};
use umbrage_aomask::{Outputs, Pattern, Receiver, exact::adaptive::Spent};
use umbrage_geom::{Ray, glam::Vec3, offset_origin, sampling::combine};

/// Receivers whose rays are listed at a time.
const LISTED: usize = 1 << 10;

/// [`super::bake`] by an engine that answers receivers.
pub(super) fn bake_receivers(
    engine: &dyn Engine,
    radius: f32,
    receivers: &Receivers,
    options: &BakeOptions,
    shard: Shard,
    (ao, extras): (&mut [f32], BakeExtras<'_, '_>),
    progress: &mut (dyn FnMut(f32) -> bool + Send),
) -> Result<Option<Spent>, BakeError> {
    if options.target_error.is_some() && (extras.dump.is_some() || extras.bent_normals.is_some()) {
        return Err(BakeError::TargetError("only ao, by method mask, can be baked to a target error"));
    }
    let BakeExtras { dump, bent_normals } = extras;
    if let Some(bent) = bent_normals.as_ref().filter(|bent| bent.len() != receivers.len()) {
        let (actual, expected) = (bent.len(), receivers.len());
        return Err(BakeError::Length { what: "bent normals", actual, expected });
    }
    let mine: Vec<u32> = shard_of(receivers, shard, ao)?.concat();
    let reason = "it does not answer receivers";
    let unsupported = QueryError::Unsupported { method: engine.name(), reason };
    let pattern = engine.pattern().ok_or(unsupported)?;
    let asked = lobes(receivers, &mine, options)?;
    let (directions, masks) = (bent_normals.is_some(), dump.is_some());
    let job = Job { engine, pattern, radius, asked: &asked, directions, masks };
    let answers = if engine.answers_listed() { job.exact(progress)? } else { job.all(progress)? };
    if let Some(out) = dump {
        job.dump(&answers, out).map_err(BakeError::Dump)?;
    }
    write(&mine, &asked, &answers, ao, bent_normals);
    Ok(answers.spent)
}

/// A lobe of a receiver.
struct Asked {
    receiver: Receiver,
    /// Normal of the surface, below which no ray may start.
    face: Vec3,
    /// Index into the receivers of the shard.
    slot: usize,
    /// Share of the receiver's rays.
    share: f32,
}

fn lobes(receivers: &Receivers, mine: &[u32], options: &BakeOptions) -> Result<Vec<Asked>, BakeError> {
    let mut asked = Vec::new();
    for (slot, &index) in mine.iter().enumerate() {
        let index = index as usize;
        let lobes = receivers.lobes(index);
        for (number, lobe) in lobes.iter().enumerate() {
            let origin = offset_origin(lobe.point, lobe.face, lobe.face, receivers.magnitudes[index])
                + lobe.face * options.bias;
            let seed = combine(combine(options.seed, index as u32), number as u32);
            let receiver = Receiver::new(index, origin.to_array(), lobe.normal.to_array(), seed)?;
            asked.push(Asked { receiver, face: lobe.face, slot, share: Lobe::share(lobes, number) });
        }
    }
    Ok(asked)
}

/// What was found, by lobe.
struct Answers {
    open: Vec<f32>,
    /// Mean over all rays of direction times what passes; empty unless wanted.
    directions: Vec<Vec3>,
    /// Bits of rays that nothing passes; empty unless wanted.
    masks: Vec<u64>,
    /// What a target error took.
    spent: Option<Spent>,
}

struct Job<'a> {
    engine: &'a dyn Engine,
    pattern: &'a Pattern,
    /// World units.
    radius: f32,
    asked: &'a [Asked],
    /// Whether directions are wanted.
    directions: bool,
    /// Whether masks are wanted.
    masks: bool,
}

impl Job<'_> {
    fn room(&self, count: usize) -> Answers {
        Answers {
            open: vec![1.0; count],
            directions: vec![Vec3::ZERO; if self.directions { count } else { 0 }],
            masks: vec![0; if self.masks { count * self.pattern.words() } else { 0 }],
            spent: None,
        }
    }

    /// Answers for the lobes `which`, whose rays are the pattern's.
    fn by_masks(
        &self,
        which: &[usize],
        progress: &mut (dyn FnMut(f32) -> bool + Send),
    ) -> Result<Answers, BakeError> {
        let receivers: Vec<Receiver> = which.iter().map(|&i| self.asked[i].receiver).collect();
        let mut answers = self.room(which.len());
        let words = self.pattern.words();
        answers.masks.resize(if self.masks || self.directions { which.len() * words } else { 0 }, 0);
        let mut outputs = Outputs::new(&mut answers.open);
        if !answers.masks.is_empty() {
            outputs = outputs.with_masks(&mut answers.masks);
        }
        answers.spent = self.engine.sky(&receivers, outputs, progress)?;
        let masks = answers.masks.chunks(words);
        for ((direction, receiver), mask) in answers.directions.iter_mut().zip(&receivers).zip(masks) {
            *direction = self.pattern.free_direction(receiver, mask)?.into();
        }
        Ok(answers)
    }

    /// Every lobe by the pattern's rays: none is mirrored.
    fn all(&self, progress: &mut (dyn FnMut(f32) -> bool + Send)) -> Result<Answers, BakeError> {
        let all: Vec<usize> = (0..self.asked.len()).collect();
        self.by_masks(&all, progress)
    }

    /// Where the pattern's rays are taken as they are they walk as such; where some are mirrored, or their fractions are
    /// needed, they are listed.
    fn exact(&self, progress: &mut (dyn FnMut(f32) -> bool + Send)) -> Result<Answers, BakeError> {
        let pattern = self.pattern;
        let fractions = self.directions && self.engine.has_fractions();
        let (listed, plain): (Vec<usize>, Vec<usize>) =
            (0..self.asked.len()).partition(|&i| fractions || self.dips(&self.asked[i]));
        let share = if listed.is_empty() { 1.0 } else { plain.len() as f32 / self.asked.len() as f32 };
        let part = self.by_masks(&plain, &mut |fraction: f32| progress(fraction * share))?;
        if listed.is_empty() {
            return Ok(part);
        }
        let mut answers = self.room(self.asked.len());
        answers.spent = part.spent.map(|mut spent| {
            spent.rays += (listed.len() * pattern.len()) as u64;
            spent
        });
        let words = pattern.words();
        for (i, &to) in plain.iter().enumerate() {
            answers.open[to] = part.open[i];
            if self.directions {
                answers.directions[to] = part.directions[i];
            }
            if self.masks {
                answers.masks[to * words..][..words].copy_from_slice(&part.masks[i * words..][..words]);
            }
        }
        let mut done = plain.len();
        for lobes in listed.chunks(LISTED) {
            self.by_list(lobes, &mut answers)?;
            done += lobes.len();
            if !progress(if done == self.asked.len() { 1.0 } else { done as f32 / self.asked.len() as f32 }) {
                return Err(BakeError::Cancelled);
            }
        }
        Ok(answers)
    }

    /// Answers the lobes `which`, ray by ray.
    fn by_list(&self, which: &[usize], answers: &mut Answers) -> Result<(), BakeError> {
        let n = self.pattern.len();
        let rays: Vec<Ray> = which.iter().flat_map(|&i| self.rays(&self.asked[i])).collect();
        let mut passed = vec![1.0; rays.len()];
        self.engine.listed(&rays, n, &mut passed)?;
        for (&i, (rays, passed)) in which.iter().zip(rays.chunks(n).zip(passed.chunks(n))) {
            let sum: f64 = passed.iter().map(|&x| f64::from(x)).sum();
            answers.open[i] = (sum / n as f64) as f32;
            if self.directions {
                let sum: Vec3 = rays.iter().zip(passed).map(|(ray, &x)| ray.direction * x).sum();
                answers.directions[i] = sum / n as f32;
            }
            if self.masks {
                let mask = &mut answers.masks[i * self.pattern.words()..];
                for (k, _) in passed.iter().enumerate().filter(|&(_, &x)| x == 0.0) {
                    mask[k / 64] |= 1 << (k % 64);
                }
            }
        }
        Ok(())
    }

    /// Whether rays of the pattern would start into the receiver's own triangle.
    fn dips(&self, asked: &Asked) -> bool {
        let low = |ray: Ray| ray.direction.dot(asked.face) < MIN_HEIGHT;
        asked.face != asked.receiver.normal() && self.pattern.rays_of(&asked.receiver, self.radius).any(low)
    }

    /// Rays of a lobe, mirrored at its face as those of [`super::bake`].
    fn rays(&self, asked: &Asked) -> impl Iterator<Item = Ray> {
        let face = asked.face;
        self.pattern
            .rays_of(&asked.receiver, self.radius)
            .map(move |ray| Ray { direction: above(ray.direction, face), ..ray })
    }

    fn dump(&self, answers: &Answers, out: &mut dyn Write) -> io::Result<()> {
        for (asked, mask) in self.asked.iter().zip(answers.masks.chunks(self.pattern.words())) {
            let mirrored = self.engine.answers_listed() && self.dips(asked);
            let plain = self.pattern.rays_of(&asked.receiver, self.radius);
            for (i, (plain, above)) in plain.zip(self.rays(asked)).enumerate() {
                let ray = if mirrored { above } else { plain };
                let [ox, oy, oz] = ray.origin.to_array();
                let [dx, dy, dz] = ray.direction.to_array();
                for x in [ox, oy, oz, ray.tnear, dx, dy, dz, ray.tfar] {
                    out.write_all(&x.to_le_bytes())?;
                }
                out.write_all(&((mask[i / 64] >> (i % 64) & 1) as u32).to_le_bytes())?;
            }
        }
        out.flush()
    }
}

/// Means over the lobes of each receiver; receivers without a direction are open.
fn write(
    mine: &[u32],
    asked: &[Asked],
    answers: &Answers,
    ao: &mut [f32],
    bent_normals: Option<&mut [[f32; 3]]>,
) {
    let mut open = vec![1.0; mine.len()];
    let mut means = vec![(Vec3::ZERO, Vec3::ZERO); mine.len()];
    let mut last = usize::MAX;
    for (i, &Asked { receiver, slot, share, .. }) in asked.iter().enumerate() {
        if slot != last {
            open[slot] = 0.0;
        }
        open[slot] += share * answers.open[i];
        last = slot;
        if let Some(&direction) = answers.directions.get(i) {
            means[slot].0 += direction * share;
            means[slot].1 += receiver.normal() * share;
        }
    }
    mine.iter().zip(open).for_each(|(&i, open)| ao[i as usize] = open);
    if let Some(bent) = bent_normals {
        for (&i, (direction, normal)) in mine.iter().zip(means) {
            let mean = direction.try_normalize().unwrap_or(normal.normalize_or_zero());
            bent[i as usize] = mean.to_array();
        }
    }
}
