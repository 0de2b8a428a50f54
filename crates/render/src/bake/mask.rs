//! Baking by masks of `umbrage-aomask`: all rays of a receiver at once.

use super::receivers::Lobe;
use super::{
    BakeError, BakeOptions, Jitter, Occluders, Receivers, Shard, Sides,
    integrate::{MIN_HEIGHT, above, shard_of},
};
use std::io::{self, Write};
use umbrage_aomask::{
    self as aomask, BackEnd, MaskOptions, MaskTables, Outputs, Pattern, PatternOptions, Receiver,
    TableOptions, coarse,
    exact::{self, adaptive::Adaptive, fans},
};
use umbrage_geom::{OpticalDepth, Ray, glam::Vec3, offset_origin, sampling::combine};

/// Receivers whose rays are listed at a time.
const LISTED: usize = 1 << 10;

/// How masks are found.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum MaskMethod {
    /// Exactly: the bits of single rays.
    #[default]
    Exact,
    /// Exactly up to a tenth of the radius (of the diagonal where there is none), or as far as sampled points ask for, by stored
    /// opacity ([`aomask::coarse::field`]) beyond it: approximate. Opaque occluders with [`Occluders::with_far_opacity`].
    Prefilter,
    /// From tables, approximately (`docs/aomask.md` has the errors); opaque occluders only. Rays that would start into the
    /// receiver's own triangle, as around a shading normal, are blocked by it.
    Table,
}

/// What [`bake_masks`] gives besides openness.
#[derive(Default)]
pub struct MaskExtras<'d, 'b> {
    /// Gets every ray in the order of receivers: 36 bytes each, little-endian `f32`s origin, `tnear`, direction, `tfar`, and
    /// a `u32` that is 1 if nothing passed.
    pub dump: Option<&'d mut dyn Write>,
    /// One for each receiver, of unit length: the mean of the rays' directions, each as often as it is free. The mean normal
    /// where nothing passes, zero for receivers without a direction; those of other shards stay as they are.
    pub bent_normals: Option<&'b mut [[f32; 3]]>,
}

/// Computes `ao` of the receivers of `shard` as [`super::bake`] does, by one pattern of rays for all receivers, turned and
/// tilted a little at random unless jitter is off.
///
/// # Errors
/// Those of [`super::bake`]; [`BakeError::Mask`] for a number of rays that is not a multiple of 32 up to 1024;
/// [`BakeError::SemiTransparent`]; [`BakeError::Dump`]. After an error `ao` and bent normals are as they were.
#[allow(clippy::too_many_arguments)] // what there is to say
pub fn bake_masks(
    occluders: &Occluders,
    receivers: &Receivers,
    options: &BakeOptions,
    method: MaskMethod,
    shard: Shard,
    ao: &mut [f32],
    extras: MaskExtras<'_, '_>,
    progress: &mut (dyn FnMut(f32) -> bool + Send),
) -> Result<(), BakeError> {
    options.validate()?;
    if !occluders.is_opaque() && (method != MaskMethod::Exact || options.sides == Sides::FrontFirst) {
        return Err(BakeError::SemiTransparent);
    }
    if options.target_error.is_some() {
        if method != MaskMethod::Exact || extras.dump.is_some() || extras.bent_normals.is_some() {
            return Err(BakeError::TargetError("only ao, by method mask, can be baked to a target error"));
        }
        if !occluders.is_opaque() {
            return Err(BakeError::SemiTransparent);
        }
    }
    let MaskExtras { dump, bent_normals } = extras;
    if let Some(bent) = bent_normals.as_ref().filter(|bent| bent.len() != receivers.len()) {
        let (actual, expected) = (bent.len(), receivers.len());
        return Err(BakeError::Length { what: "bent normals", actual, expected });
    }
    let mine: Vec<u32> = shard_of(receivers, shard, ao)?.concat();
    let pattern_options = pattern_options(options);
    let pattern = Pattern::new(&pattern_options)?;
    let sides = match options.sides {
        Sides::Both => aomask::Sides::Both,
        Sides::Front => aomask::Sides::Front,
        Sides::FrontFirst => aomask::Sides::FrontFirst,
    };
    let mask_options =
        MaskOptions::default().with_radius(options.radius.resolve(occluders.diagonal())).with_sides(sides);
    let asked = lobes(receivers, &mine, options)?;
    let adaptive = match options.target_error {
        Some(target) => Some((Adaptive::new(&pattern_options)?, target)),
        None => None,
    };
    let (directions, masks) = (bent_normals.is_some(), dump.is_some());
    let job = Job {
        occluders,
        pattern: &pattern,
        pattern_options: &pattern_options,
        options: &mask_options,
        asked: &asked,
        directions,
        masks,
        adaptive,
    };
    let answers = match method {
        MaskMethod::Exact => job.exact(progress)?,
        MaskMethod::Table => job.table(progress)?,
        MaskMethod::Prefilter => job.prefilter(progress)?,
    };
    if let Some(out) = dump {
        job.dump(&answers, method, out).map_err(BakeError::Dump)?;
    }
    write(&mine, &asked, &answers, ao, bent_normals);
    Ok(())
}

fn pattern_options(options: &BakeOptions) -> PatternOptions {
    let pattern = PatternOptions::default()
        .with_rays(options.rays)
        .with_falloff(options.falloff.clone())
        .with_seed(options.seed);
    match options.jitter {
        Jitter::Pattern => pattern,
        Jitter::Rotation => pattern.with_jitter(1.0, 0.0),
        Jitter::Off => pattern.with_jitter(0.0, 0.0),
    }
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
}

struct Job<'a> {
    occluders: &'a Occluders,
    pattern: &'a Pattern,
    pattern_options: &'a PatternOptions,
    options: &'a MaskOptions,
    asked: &'a [Asked],
    /// Whether directions are wanted.
    directions: bool,
    /// Whether masks are wanted.
    masks: bool,
    /// Patterns for a target error.
    adaptive: Option<(Adaptive, f32)>,
}

impl Job<'_> {
    fn room(&self, count: usize) -> Answers {
        Answers {
            open: vec![1.0; count],
            directions: vec![Vec3::ZERO; if self.directions { count } else { 0 }],
            masks: vec![0; if self.masks { count * self.pattern.words() } else { 0 }],
        }
    }

    /// Answers of `call` for the lobes `which`, whose rays are the pattern's.
    fn by_masks(
        &self,
        which: &[usize],
        call: impl FnOnce(&[Receiver], Outputs<'_>) -> Result<(), aomask::MaskError>,
    ) -> Result<Answers, BakeError> {
        let receivers: Vec<Receiver> = which.iter().map(|&i| self.asked[i].receiver).collect();
        let mut answers = self.room(which.len());
        let words = self.pattern.words();
        answers.masks.resize(if self.masks || self.directions { which.len() * words } else { 0 }, 0);
        let mut outputs = Outputs::new(&mut answers.open);
        if !answers.masks.is_empty() {
            outputs = outputs.with_masks(&mut answers.masks);
        }
        call(&receivers, outputs)?;
        let masks = answers.masks.chunks(words);
        for ((direction, receiver), mask) in answers.directions.iter_mut().zip(&receivers).zip(masks) {
            *direction = self.pattern.free_direction(receiver, mask)?.into();
        }
        Ok(answers)
    }

    fn table(&self, progress: &mut (dyn FnMut(f32) -> bool + Send)) -> Result<Answers, BakeError> {
        let tables = MaskTables::new(self.pattern.clone(), &TableOptions::default())?;
        let all: Vec<usize> = (0..self.asked.len()).collect();
        self.by_masks(&all, |receivers, outputs| {
            tables.answer_receivers(self.occluders.bvh(), receivers, self.options, outputs, progress)
        })
    }

    fn prefilter(&self, progress: &mut (dyn FnMut(f32) -> bool + Send)) -> Result<Answers, BakeError> {
        let far = self.occluders.far(self.pattern, self.pattern_options, self.options)?;
        let (bvh, best) = (self.occluders.bvh(), BackEnd::best());
        let all: Vec<usize> = (0..self.asked.len()).collect();
        // The same rays either way: none is mirrored.
        self.by_masks(&all, |receivers, outputs| {
            let (pattern, options) = (self.pattern, self.options);
            match &far {
                Some(far) => {
                    coarse::answer_receivers(bvh, far, pattern, receivers, options, best, outputs, progress)
                }
                None => exact::answer_receivers(bvh, pattern, receivers, options, best, outputs, progress),
            }
        })
    }

    /// Where the pattern's rays are taken as they are they walk as such; where some are mirrored, or their fractions are
    /// needed, they are listed.
    fn exact(&self, progress: &mut (dyn FnMut(f32) -> bool + Send)) -> Result<Answers, BakeError> {
        let &Self { occluders, pattern, options, .. } = self;
        let fractions = self.directions && !occluders.is_opaque();
        let (listed, plain): (Vec<usize>, Vec<usize>) =
            (0..self.asked.len()).partition(|&i| fractions || self.dips(&self.asked[i]));
        let share = if listed.is_empty() { 1.0 } else { plain.len() as f32 / self.asked.len() as f32 };
        let part = self.by_masks(&plain, |receivers, outputs| {
            let mut progress = |fraction: f32| progress(fraction * share);
            let (bvh, best) = (occluders.bvh(), BackEnd::best());
            if let Some((adaptive, target)) = &self.adaptive {
                let mut used = vec![0; receivers.len()];
                adaptive.answer_receivers(
                    bvh,
                    receivers,
                    options,
                    *target,
                    best,
                    outputs,
                    &mut used,
                    &mut progress,
                )
            } else if occluders.is_opaque() {
                exact::answer_receivers(bvh, pattern, receivers, options, best, outputs, &mut progress)
            } else {
                let depth = |prim| occluders.depth_of(prim);
                exact::transmit(bvh, depth, pattern, receivers, options, best, outputs, &mut progress)
            }
        })?;
        if listed.is_empty() {
            return Ok(part);
        }
        let mut answers = self.room(self.asked.len());
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
        let (bvh, best, sides, n) =
            (self.occluders.bvh(), BackEnd::best(), self.options.sides, self.pattern.len());
        let rays: Vec<Ray> = which.iter().flat_map(|&i| self.rays(&self.asked[i])).collect();
        let passed: Vec<f32> = if self.occluders.is_opaque() {
            let mut hits = vec![false; rays.len()];
            fans::any_hits(bvh, &rays, n, sides, best, &mut hits)?;
            hits.into_iter().map(|hit| f32::from(u8::from(!hit))).collect()
        } else {
            let mut sums = vec![OpticalDepth::CLEAR; rays.len()];
            let depth = |prim| self.occluders.depth_of(prim);
            fans::transmittances(bvh, &rays, n, sides, depth, best, &mut sums)?;
            sums.into_iter().map(OpticalDepth::transmittance).collect()
        };
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
        asked.face != asked.receiver.normal()
            && self.pattern.rays_of(&asked.receiver, self.options.radius).any(low)
    }

    /// Rays of a lobe, mirrored at its face as those of [`super::bake`].
    fn rays(&self, asked: &Asked) -> impl Iterator<Item = Ray> {
        let face = asked.face;
        self.pattern
            .rays_of(&asked.receiver, self.options.radius)
            .map(move |ray| Ray { direction: above(ray.direction, face), ..ray })
    }

    fn dump(&self, answers: &Answers, method: MaskMethod, out: &mut dyn Write) -> io::Result<()> {
        for (asked, mask) in self.asked.iter().zip(answers.masks.chunks(self.pattern.words())) {
            let mirrored = method == MaskMethod::Exact && self.dips(asked);
            let plain = self.pattern.rays_of(&asked.receiver, self.options.radius);
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
