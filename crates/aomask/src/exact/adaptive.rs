//! Few rays where they are enough: every receiver gets as many as its estimated error asks for.
//!
//! A pattern has one ray in each of equal shares of the disc. Shares that are open or blocked as a whole add no error, those
//! that an outline crosses do: the error of `ao` is about `sqrt(outline * VARIANCE) / rays`, where `outline` counts the rays
//! with a neighbour of the other kind. Receivers pool what they count with their neighbours, so that occluders which a few
//! rays miss are still seen by some of them.

use super::answer_receivers;
use crate::{BackEnd, MaskError, MaskOptions, Outputs, Pattern, PatternOptions, Receiver, drive};
use umbrage_accel::Bvh;
use umbrage_geom::morton;

/// Variance of one ray whose share of the disc an outline crosses, as measured (`docs/aomask-exact.md`).
const VARIANCE: f32 = 0.07;

/// Outline that even a receiver without any is taken to have.
const LEAST_OUTLINE: f32 = 0.25;

/// Receivers that pool their outlines.
const POOL: usize = 16;

/// Neighbours of a ray: as many as a share of the disc has sides, on average.
const NEIGHBOURS: usize = 6;

/// Patterns of growing numbers of rays, for receivers that need different ones.
#[derive(Clone, Debug)]
pub struct Adaptive {
    levels: Vec<Level>,
}

#[derive(Clone, Debug)]
struct Level {
    pattern: Pattern,
    /// Nearest directions of each ray.
    neighbours: Vec<[u16; NEIGHBOURS]>,
}

impl Level {
    fn new(pattern: Pattern) -> Self {
        let directions = pattern.directions();
        let nearest = |i: usize| {
            let mut others: Vec<u16> =
                (0..directions.len() as u16).filter(|&k| usize::from(k) != i).collect();
            let distance =
                |k: &u16| directions[i].truncate().distance_squared(directions[usize::from(*k)].truncate());
            others.select_nth_unstable_by(NEIGHBOURS, |a, b| distance(a).total_cmp(&distance(b)));
            let mut nearest = [0; NEIGHBOURS];
            nearest.copy_from_slice(&others[..NEIGHBOURS]);
            nearest
        };
        Self { neighbours: (0..directions.len()).map(nearest).collect(), pattern }
    }

    /// Rays with a neighbour of the other kind.
    fn outline(&self, mask: &[u64]) -> f32 {
        let bit = |i: usize| mask[i / 64] >> (i % 64) & 1;
        let mixed = |&(i, near): &(usize, &[u16; NEIGHBOURS])| near.iter().any(|&k| bit(k.into()) != bit(i));
        self.neighbours.iter().enumerate().filter(mixed).count() as f32
    }

    /// Standard error of `ao` for an outline.
    fn error(&self, outline: f32) -> f32 {
        ((outline + LEAST_OUTLINE) * VARIANCE).sqrt() / self.pattern.len() as f32
    }
}

impl Adaptive {
    /// Patterns as `options` have it, of 32 rays and more up to [`PatternOptions::rays`]; takes tens of milliseconds.
    ///
    /// # Errors
    /// As for [`Pattern::new`].
    pub fn new(options: &PatternOptions) -> Result<Self, MaskError> {
        let most = Pattern::new(options)?;
        let mut levels = Vec::new();
        for rays in (5..10).map(|bits| 1 << bits).take_while(|&rays| rays < options.rays) {
            levels.push(Level::new(Pattern::new(&options.clone().with_rays(rays))?));
        }
        levels.push(Level::new(most));
        Ok(Self { levels })
    }

    /// Like [`super::answer`], with as many rays for each receiver as it takes until the estimated standard error of its `ao`
    /// is at most `target_error`, or there are no more. `used`, one for each receiver, gets their number. Bits are exact; how
    /// many there are depends on the receivers around.
    ///
    /// # Errors
    /// As for [`super::answer`]; [`MaskError::TargetError`] unless `target_error` is more than 0;
    /// [`MaskError::Unsupported`] if masks are asked for, which would have different lengths.
    #[allow(clippy::too_many_arguments)] // what there is to say
    pub fn answer(
        &self,
        bvh: &Bvh,
        points: &[[f32; 3]],
        normals: &[[f32; 3]],
        options: &MaskOptions,
        target_error: f32,
        back_end: BackEnd,
        outputs: Outputs<'_>,
        used: &mut [u32],
        progress: &mut (dyn FnMut(f32) -> bool + Send),
    ) -> Result<(), MaskError> {
        let receivers = drive::receivers(points, normals, options.seed)?;
        self.answer_receivers(bvh, &receivers, options, target_error, back_end, outputs, used, progress)
    }

    /// [`Self::answer`] for receivers with seeds of their own; [`MaskOptions::seed`] is not used.
    ///
    /// # Errors
    /// As for [`Self::answer`], but for points and normals.
    #[allow(clippy::too_many_arguments)] // what there is to say
    pub fn answer_receivers(
        &self,
        bvh: &Bvh,
        receivers: &[Receiver],
        options: &MaskOptions,
        target_error: f32,
        back_end: BackEnd,
        mut outputs: Outputs<'_>,
        used: &mut [u32],
        progress: &mut (dyn FnMut(f32) -> bool + Send),
    ) -> Result<(), MaskError> {
        // NaN is refused too.
        if target_error.is_nan() || target_error <= 0.0 {
            return Err(MaskError::TargetError(target_error));
        }
        if outputs.masks.is_some() {
            return Err(MaskError::Unsupported("masks of different lengths"));
        }
        outputs.validate(receivers.len(), 0)?;
        if used.len() != receivers.len() {
            let (actual, points) = (used.len(), receivers.len());
            return Err(MaskError::Length { what: "used", actual, expected: points, points });
        }
        let places: Vec<[f32; 3]> = receivers.iter().map(|receiver| receiver.point().to_array()).collect();
        // By level: receivers to answer, in Morton order.
        let mut waiting = vec![Vec::new(); self.levels.len()];
        waiting[0] = morton::order(&places);
        let mut found = Room::new(&outputs, receivers.len(), 0);
        let mut rays = vec![0; receivers.len()];
        for (number, level) in self.levels.iter().enumerate() {
            let order = std::mem::take(&mut waiting[number]);
            let asked: Vec<Receiver> = order.iter().map(|&i| receivers[i as usize]).collect();
            let mut room = Room::new(&outputs, asked.len(), level.pattern.words());
            let (from, share) = (number as f32 / self.levels.len() as f32, 1.0 / self.levels.len() as f32);
            let last = number + 1 == self.levels.len();
            let mut part =
                |fraction: f32| progress(if last && fraction == 1.0 { 1.0 } else { from + fraction * share });
            answer_receivers(bvh, &level.pattern, &asked, options, back_end, room.outputs(), &mut part)?;
            let outlines: Vec<f32> =
                room.masks.chunks(level.pattern.words()).map(|mask| level.outline(mask)).collect();
            for (pool, (at, order)) in outlines.chunks(POOL).zip((0..).step_by(POOL).zip(order.chunks(POOL)))
            {
                let mean = pool.iter().sum::<f32>() / pool.len() as f32;
                for (i, (&outline, &receiver)) in pool.iter().zip(order).enumerate() {
                    let receiver = receiver as usize;
                    found.take(receiver, &room, at + i);
                    rays[receiver] = level.pattern.len() as u32;
                    if let Some(next) = self.next(number, outline.max(mean), target_error) {
                        waiting[next].push(receiver as u32);
                    }
                }
            }
            // Pools are of neighbours.
            if let Some(next) = waiting.get_mut(number + 1) {
                let points: Vec<[f32; 3]> = next.iter().map(|&i| places[i as usize]).collect();
                *next = morton::order(&points).iter().map(|&k| next[k as usize]).collect();
            }
        }
        used.copy_from_slice(&rays);
        found.write(&mut outputs);
        Ok(())
    }

    /// The level that a receiver with so much outline at level `number` should try next, if it needs one.
    fn next(&self, number: usize, outline: f32, target: f32) -> Option<usize> {
        let level = &self.levels[number];
        let error = level.error(outline);
        if error <= target {
            return None;
        }
        let rays = level.pattern.len() as f32;
        // Smooth outlines cross a number of shares that grows as the root of all; where half are crossed, all may be.
        let power = if outline > 0.5 * rays { 0.5 } else { 0.75 };
        let wanted = rays * (error / target).powf(1.0 / power);
        let levels = self.levels.iter().enumerate().skip(number + 1);
        let enough = levels.clone().find(|(_, level)| level.pattern.len() as f32 >= 0.75 * wanted);
        enough.or_else(|| levels.last()).map(|(next, _)| next)
    }
}

/// Answers on their way to the caller's outputs.
struct Room {
    ao: Vec<f32>,
    masks: Vec<u64>,
    bent_normals: Option<Vec<[f32; 3]>>,
    sectors: Option<(u32, Vec<f32>)>,
    hit_distances: Option<Vec<f32>>,
}

impl Room {
    /// As `outputs` want it, with masks of `words` words each.
    fn new(outputs: &Outputs<'_>, count: usize, words: usize) -> Self {
        let sectors = outputs.sectors.as_ref().map(|&(n, _)| (n, vec![0.0; count * n as usize]));
        Self {
            ao: vec![0.0; count],
            masks: vec![0; count * words],
            bent_normals: outputs.bent_normals.as_ref().map(|_| vec![[0.0; 3]; count]),
            sectors,
            hit_distances: outputs.hit_distances.as_ref().map(|_| vec![0.0; count]),
        }
    }

    fn outputs(&mut self) -> Outputs<'_> {
        let mut outputs = Outputs::new(&mut self.ao).with_masks(&mut self.masks);
        outputs.bent_normals = self.bent_normals.as_deref_mut();
        outputs.sectors = self.sectors.as_mut().map(|(n, values)| (*n, &mut values[..]));
        outputs.hit_distances = self.hit_distances.as_deref_mut();
        outputs
    }

    /// Takes what `other` has at `from`, but for masks.
    fn take(&mut self, to: usize, other: &Self, from: usize) {
        self.ao[to] = other.ao[from];
        if let (Some(own), Some(other)) = (&mut self.bent_normals, &other.bent_normals) {
            own[to] = other[from];
        }
        if let (Some((n, own)), Some((_, other))) = (&mut self.sectors, &other.sectors) {
            let n = *n as usize;
            own[to * n..][..n].copy_from_slice(&other[from * n..][..n]);
        }
        if let (Some(own), Some(other)) = (&mut self.hit_distances, &other.hit_distances) {
            own[to] = other[from];
        }
    }

    fn write(self, outputs: &mut Outputs<'_>) {
        outputs.ao.copy_from_slice(&self.ao);
        if let (Some(to), Some(from)) = (&mut outputs.bent_normals, &self.bent_normals) {
            to.copy_from_slice(from);
        }
        if let (Some((_, to)), Some((_, from))) = (&mut outputs.sectors, &self.sectors) {
            to.copy_from_slice(from);
        }
        if let (Some(to), Some(from)) = (&mut outputs.hit_distances, &self.hit_distances) {
            to.copy_from_slice(from);
        }
    }
}
