//! Rays against what must be true of them: leaks and self-shadows of many, exact answers for a sample.

use super::{
    casters::Caster,
    oracle::{self, Oracle},
    rays::{Aim, Expect, Shot, Target},
};
use rayon::prelude::*;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use umbrage_geom::sampling::RandomStream;

/// Rays that are shot and traced at a time.
const CHUNK: usize = 1 << 12;

/// A method, and whether more than one thread may ask it at a time.
pub enum Threading<'a> {
    Any(&'a (dyn Caster + Sync)),
    One(&'a dyn Caster),
}

impl Threading<'_> {
    pub fn caster(&self) -> &dyn Caster {
        match self {
            Self::Any(caster) => *caster,
            Self::One(caster) => *caster,
        }
    }
}

/// What many rays showed.
#[derive(Clone, Default)]
pub struct Counts {
    pub rays: usize,
    /// Rays from inside a closed surface that hit nothing, and their aims.
    pub leaks: BTreeMap<&'static str, usize>,
    /// Rays that hit the convex surface, or the triangle, that they leave.
    pub self_shadow: usize,
    /// Rays that were to tell.
    pub leaving: usize,
    /// Processor seconds in the method alone.
    pub seconds: f64,
}

impl Counts {
    fn add(mut self, other: Self) -> Self {
        self.rays += other.rays;
        self.self_shadow += other.self_shadow;
        self.leaving += other.leaving;
        self.seconds += other.seconds;
        for (aim, leaks) in other.leaks {
            *self.leaks.entry(aim).or_default() += leaks;
        }
        self
    }

    pub fn leak_count(&self) -> usize {
        self.leaks.values().sum()
    }
}

/// Shoots about `rays` rays, as many of each aim. The same rays for every method, for any thread count.
pub fn shoot_many(target: &Target, caster: &Threading, rays: usize) -> Counts {
    let aims = target.aims();
    let per_aim = rays.div_ceil(aims.len()).max(1);
    let jobs = per_aim.div_ceil(CHUNK) * aims.len();
    let count = |k: usize| CHUNK.min(per_aim - k / aims.len() * CHUNK);
    let aim = |k: usize| aims[k % aims.len()];
    match caster {
        Threading::Any(caster) => {
            let shoot = |k| shoot_chunk(target, *caster, aim(k), k as u32, count(k));
            (0..jobs).into_par_iter().map(shoot).reduce(Counts::default, Counts::add)
        }
        Threading::One(caster) => {
            let shoot = |k| shoot_chunk(target, *caster, aim(k), k as u32, count(k));
            (0..jobs).map(shoot).fold(Counts::default(), Counts::add)
        }
    }
}

fn shoot_chunk(target: &Target, caster: &dyn Caster, aim: Aim, chunk: u32, count: usize) -> Counts {
    let mut random = RandomStream::new(29, chunk);
    let shots: Vec<_> = (0..count).map(|_| target.shoot(aim, &mut random)).collect();
    let rays: Vec<_> = shots.iter().map(|shot| shot.ray).collect();
    let mut hits = vec![false; rays.len()];
    let seconds = caster.any_hits(&rays, &mut hits);
    let mut counts = Counts { rays: count, seconds, ..Counts::default() };
    match aim.expect(target.convex) {
        Expect::Hit => {
            let leaks = hits.iter().filter(|&&hit| !hit).count();
            counts.leaks.insert(aim.name(), leaks);
        }
        Expect::Miss => {
            counts.leaving = count;
            counts.self_shadow = hits.iter().filter(|&&hit| hit).count();
        }
        Expect::MissOwn => {
            for shot in &shots {
                let own = shot.left.map(|i| target.mesh.triangle(i));
                let hit = own.and_then(|corners| caster.hits_triangle(&shot.ray, corners));
                counts.leaving += usize::from(hit.is_some());
                counts.self_shadow += usize::from(hit == Some(true));
            }
        }
        Expect::Unknown => {}
    }
    counts
}

/// What the exact answers of a sample showed, for one method.
#[derive(Clone, Default)]
pub struct Sample {
    pub rays: usize,
    /// Rays that the method, but not exact arithmetic, has hit; and the other way round.
    pub false_hits: usize,
    pub false_misses: usize,
    /// Pairs of ray and triangle, and those on which the method's own test is wrong; `None` if it has none.
    pub pairs: usize,
    pub wrong_pairs: Option<usize>,
    /// Rays from inside, and those whose crossings don't fit the winding number.
    pub counted: usize,
    pub miscounted: Option<usize>,
    /// Rays on which the hierarchy differs from a loop over all triangles.
    pub brute_differences: Option<usize>,
}

fn add_to(sum: &mut Option<usize>, wrong: Option<bool>) {
    if let Some(wrong) = wrong {
        *sum.get_or_insert(0) += usize::from(wrong);
    }
}

impl Sample {
    fn add(mut self, other: Self) -> Self {
        let sum = |a: Option<usize>, b: Option<usize>| a.map_or(b, |a| Some(a + b.unwrap_or(0)));
        self.rays += other.rays;
        self.false_hits += other.false_hits;
        self.false_misses += other.false_misses;
        self.pairs += other.pairs;
        self.wrong_pairs = sum(self.wrong_pairs, other.wrong_pairs);
        self.counted += other.counted;
        self.miscounted = sum(self.miscounted, other.miscounted);
        self.brute_differences = sum(self.brute_differences, other.brute_differences);
        self
    }

    /// Every way to differ from the exact answer: rays and, beside them, single triangles.
    pub fn disagreements(&self) -> usize {
        self.false_hits + self.false_misses + self.wrong_pairs.unwrap_or(0)
    }
}

/// A ray with its exact answers.
pub struct Answered {
    shot: Shot,
    /// The triangles near the ray, and whether it hits them.
    near: Vec<([[f32; 3]; 3], bool)>,
}

/// Answers `count` rays in exact arithmetic.
pub fn answer(target: &Target, oracle: &Oracle, count: usize) -> Vec<Answered> {
    let aims = target.aims();
    let one = |k: usize| {
        let shot = target.shoot(aims[k % aims.len()], &mut RandomStream::new(31, k as u32));
        let near = oracle.candidates(&shot.ray).map(|i| target.mesh.triangle(i));
        let near = near.map(|corners| (corners, oracle::hits(&shot.ray, corners))).collect();
        Answered { shot, near }
    };
    (0..count).into_par_iter().map(one).collect()
}

/// Compares a method with exact answers.
pub fn compare(caster: &Threading, answered: &[Answered]) -> Sample {
    match caster {
        Threading::Any(caster) => {
            let one = |answered| compare_one(*caster, answered);
            answered.par_iter().map(one).reduce(Sample::default, Sample::add)
        }
        Threading::One(caster) => {
            let one = |answered| compare_one(*caster, answered);
            answered.iter().map(one).fold(Sample::default(), Sample::add)
        }
    }
}

fn compare_one(caster: &dyn Caster, Answered { shot, near }: &Answered) -> Sample {
    let ray = &shot.ray;
    let truth = near.iter().any(|&(_, hit)| hit);
    let mut hit = [false];
    caster.any_hits(&[*ray], &mut hit);
    let mut sample = Sample {
        rays: 1,
        false_hits: usize::from(hit[0] && !truth),
        false_misses: usize::from(!hit[0] && truth),
        pairs: near.len(),
        ..Sample::default()
    };
    for &(corners, exact) in near {
        add_to(&mut sample.wrong_pairs, caster.hits_triangle(ray, corners).map(|hit| hit != exact));
    }
    if let Some(winding) = shot.winding {
        sample.counted = 1;
        add_to(&mut sample.miscounted, caster.counts(ray, winding).map(|right| !right));
    }
    add_to(&mut sample.brute_differences, caster.agrees_with_brute_force(ray).map(|same| !same));
    sample
}

/// The counters of a row.
pub fn counters(target: &Target, counts: &Counts, sample: &Sample) -> Value {
    json!({
        "triangles": target.mesh.triangles.len(),
        "convex": target.convex,
        "origins": target.origins.len(),
        "leaks": counts.leak_count(),
        "leaks_by_aim": counts.leaks,
        "disagreements": sample.disagreements(),
        "self_shadow": (counts.leaving > 0).then_some(counts.self_shadow),
        "leaving": counts.leaving,
        "exact_checked": sample.rays,
        "false_hits": sample.false_hits,
        "false_misses": sample.false_misses,
        "pairs_checked": sample.pairs,
        "wrong_pairs": sample.wrong_pairs,
        "counted": sample.counted,
        "miscounted": sample.miscounted,
        "different_bits": sample.brute_differences,
    })
}
