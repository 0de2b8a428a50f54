//! As many rays as a target error asks for.
//!
//! Nothing is taken on trust: the error of a number of rays is *measured*, on pilot receivers, as half the mean squared difference
//! of two independent answers. All receivers are put into classes by how much two cheap answers of their neighbourhood differ; the
//! numbers of rays of the classes are those with which the root mean square error over all receivers is expected to be
//! 0.8 times the target in the least rays. The rays that choose a class are not used again, so that the choice brings no bias.

use crate::{MaskError, Outputs, Pattern, PatternOptions, Receiver};
use umbrage_geom::{morton, sampling::combine};

/// Share of the target that the expected error is to have: what is left is for the error of the estimate.
const EXPECTED_SHARE: f64 = 0.8;

/// Numbers of rays to choose from.
const RAY_COUNTS: [u32; 15] = [8, 16, 24, 32, 48, 64, 96, 128, 192, 256, 384, 512, 640, 768, 1024];

/// Levels whose error is measured; those between are interpolated in logarithms.
const MEASURED_COUNTS: [usize; 5] = [0, 3, 7, 11, 14];

/// Neighbours, in Morton order, that share a class.
const POOL_RECEIVERS: usize = 8;

/// Pilot receivers: one in so many, within the bounds below.
const PILOT_STRIDE: usize = 16;
const MIN_PILOTS: usize = 256;
const MAX_PILOTS: usize = 2048;

/// Classes of neighbourhoods whose cheap answers differ, beside the one where they don't.
const CLASSES: usize = 5;

/// Where measured errors may stop: at this share of the squared error to reach. Beyond, curves go on as they fell before.
const MEASURED_ERROR_SHARE: f64 = 1.0;

/// Seeds of the answers that choose classes, and of those that measure errors.
const SALTS: [u32; 4] = [0x636c_6131, 0x636c_6132, 0x6572_7231, 0x6572_7232];

/// Answers receivers by the rays of a pattern: a method without its numbers of rays.
pub type Ask<'a> = dyn FnMut(&Pattern, &[Receiver], Outputs<'_>, &mut (dyn FnMut(f32) -> bool + Send)) -> Result<(), MaskError>
    + 'a;

/// Patterns of growing numbers of rays, for receivers that need different ones.
#[derive(Clone, Debug)]
pub struct Adaptive {
    levels: Vec<Pattern>,
}

/// What a target error took.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Spent {
    /// All rays cast: for answers, to choose classes, and by pilot receivers.
    pub rays: u64,
    /// Numbers of rays and how many receivers were answered by so many, growing.
    pub receivers: Vec<(u32, u64)>,
    /// Expected root mean square error of `ao` over all receivers; `None` where no target was set.
    pub estimated_error: Option<f64>,
}

impl Spent {
    /// The same number of rays for `count` receivers.
    pub fn uniform(rays: u32, count: u64) -> Self {
        Self { rays: u64::from(rays) * count, receivers: vec![(rays, count)], estimated_error: None }
    }
}

/// How many rays receivers of each class get.
#[derive(Clone, Debug, PartialEq)]
struct RayPlan {
    /// Smallest squared difference of each class but the first.
    bounds: Vec<f64>,
    /// By class.
    levels: Vec<usize>,
    /// Expected squared error.
    squared_error: f64,
}

impl RayPlan {
    fn class(&self, difference: f64) -> usize {
        self.bounds.partition_point(|&bound| bound <= difference)
    }

    fn is_uniform(&self) -> bool {
        self.levels.iter().all(|&level| level == self.levels[0])
    }
}

/// A call on its way.
struct Run<'a, 'b> {
    adaptive: &'a Adaptive,
    receivers: &'a [Receiver],
    ask: &'a mut Ask<'b>,
    /// Told the number of rays that have been cast so far.
    progress: &'a mut (dyn FnMut(f32) -> bool + Send),
    spent: Spent,
}

impl Adaptive {
    /// Patterns as `options` have it, of 8 rays and more up to [`PatternOptions::rays`] (a multiple of 8 up to
    /// [`Pattern::MAX_MASK_RAYS`]); takes about 20 milliseconds.
    ///
    /// # Errors
    /// As for [`Pattern::new`]; [`MaskError::Rays`].
    pub fn new(options: &PatternOptions) -> Result<Self, MaskError> {
        let most = Pattern::new(options)?;
        most.check_masks()?;
        let fewer = RAY_COUNTS.into_iter().filter(|&rays| rays < options.rays);
        let mut levels = fewer
            .map(|rays| Pattern::new(&options.clone().with_rays(rays)))
            .collect::<Result<Vec<_>, _>>()?;
        levels.push(most);
        Ok(Self { levels })
    }

    /// Answers `receivers` by `ask`, with as many rays for each as it takes until the expected root mean square error of `ao`
    /// over all of them is 0.8 of `target_error`, or there are no more. Where eight rays are enough, the error is smaller.
    ///
    /// # Errors
    /// Those of `ask`; [`MaskError::TargetError`] unless `target_error` is more than 0; [`MaskError::Unsupported`] if masks are
    /// asked for, which would have different lengths. The outputs are as they were then.
    pub fn answer(
        &self,
        receivers: &[Receiver],
        target_error: f32,
        ask: &mut Ask<'_>,
        mut outputs: Outputs<'_>,
        progress: &mut (dyn FnMut(f32) -> bool + Send),
    ) -> Result<Spent, MaskError> {
        // NaN is refused too.
        if target_error.is_nan() || target_error <= 0.0 {
            return Err(MaskError::TargetError(target_error));
        }
        if outputs.masks.is_some() {
            return Err(MaskError::Unsupported("masks of different lengths"));
        }
        outputs.validate(receivers.len(), 0)?;
        let places: Vec<[f32; 3]> = receivers.iter().map(|receiver| receiver.point().to_array()).collect();
        let order: Vec<usize> = morton::order(&places).into_iter().map(|i| i as usize).collect();
        let mut run = Run { adaptive: self, receivers, ask, progress, spent: Spent::default() };
        let wanted = (EXPECTED_SHARE * f64::from(target_error)).powi(2);
        let plan = run.plan(&order, wanted)?;
        let levels = run.levels(&order, &plan)?;
        let mut found = OutputBuffers::new(&outputs, receivers.len());
        let total: u64 = levels.iter().map(|&level| self.levels[level].len() as u64).sum();
        let (mut done, before) = (0, if plan.is_uniform() { 0.1 } else { 0.3 });
        for (number, pattern) in self.levels.iter().enumerate() {
            let mine: Vec<usize> = order.iter().copied().filter(|&i| levels[i] == number).collect();
            if mine.is_empty() {
                continue;
            }
            let asked: Vec<Receiver> = mine.iter().map(|&i| receivers[i]).collect();
            let rays = (mine.len() * pattern.len()) as u64;
            let (from, share) = (done as f32 / total as f32, rays as f32 / total as f32);
            let last = done + rays == total;
            let Run { ask, progress, .. } = &mut run;
            let mut part = |fraction: f32| {
                let all = before + (1.0 - before) * (from + fraction * share);
                progress(if last && fraction == 1.0 { 1.0 } else { all.min(1.0f32.next_down()) })
            };
            let mut room = OutputBuffers::new(&outputs, asked.len());
            ask(pattern, &asked, room.outputs(), &mut part)?;
            mine.iter().enumerate().for_each(|(from, &to)| found.take(to, &room, from));
            run.spent.receivers.push((pattern.len() as u32, mine.len() as u64));
            done += rays;
        }
        if receivers.is_empty() && !(run.progress)(1.0) {
            return Err(MaskError::Cancelled);
        }
        found.write(&mut outputs);
        run.spent.rays += total;
        run.spent.estimated_error = Some(plan.squared_error.sqrt());
        Ok(run.spent)
    }
}

impl Run<'_, '_> {
    /// `ao` of the receivers `which` by the rays of a level, under seeds of their own.
    fn ao(&mut self, which: &[usize], level: usize, salt: u32) -> Result<Vec<f32>, MaskError> {
        let receivers = self.receivers;
        let asked = which.iter().map(|&i| receivers[i].with_seed(combine(receivers[i].seed(), salt)));
        let asked: Vec<Receiver> = asked.collect();
        let mut ao = vec![0.0; asked.len()];
        let progress = &mut self.progress;
        (self.ask)(&self.adaptive.levels[level], &asked, Outputs::new(&mut ao), &mut |_| progress(0.0))?;
        self.spent.rays += (asked.len() * self.adaptive.levels[level].len()) as u64;
        Ok(ao)
    }

    /// Squared errors of `ao` of each of `which` at a level: half the squared difference of two answers.
    fn squared_errors(
        &mut self,
        which: &[usize],
        level: usize,
        salts: [u32; 2],
    ) -> Result<Vec<f64>, MaskError> {
        let [a, b] = [self.ao(which, level, salts[0])?, self.ao(which, level, salts[1])?];
        Ok(a.into_iter().zip(b).map(|(a, b)| 0.5 * f64::from(a - b).powi(2)).collect())
    }

    /// By pool of `which`, the mean squared error of the smallest number of rays.
    fn differences(&mut self, which: &[usize]) -> Result<Vec<f64>, MaskError> {
        let squares = self.squared_errors(which, 0, [SALTS[0], SALTS[1]])?;
        Ok(squares.chunks(POOL_RECEIVERS).map(|pool| pool.iter().sum::<f64>() / pool.len() as f64).collect())
    }

    /// Finds the numbers of rays by pilot receivers.
    fn plan(&mut self, order: &[usize], wanted: f64) -> Result<RayPlan, MaskError> {
        let pools = order.len().div_ceil(POOL_RECEIVERS);
        let pilots = (order.len() / PILOT_STRIDE).clamp(MIN_PILOTS, MAX_PILOTS);
        let chosen = (pilots / POOL_RECEIVERS).min(pools);
        let pool = |i: usize| order.chunks(POOL_RECEIVERS).nth(i * pools / chosen.max(1)).unwrap_or(&[]);
        let pilots: Vec<usize> = (0..chosen).flat_map(pool).copied().collect();
        // Pools of a slice that starts anywhere are whole, but for the last.
        let differences = self.differences(&pilots)?;
        let bounds = bounds(&differences);
        let mut plan = RayPlan { bounds, levels: Vec::new(), squared_error: 0.0 };
        let classes: Vec<usize> =
            (0..pilots.len()).map(|i| plan.class(differences[i / POOL_RECEIVERS])).collect();
        let count = plan.bounds.len() + 1;
        let shares = sums(&classes, &vec![1.0 / pilots.len() as f64; pilots.len()], count);
        let levels = self.adaptive.levels.len();
        let measured = MEASURED_COUNTS.into_iter().filter(|&level| level + 1 < levels).chain([levels - 1]);
        // Share of the class times its squared error, by level.
        let mut curves: Vec<(usize, Vec<f64>)> = Vec::new();
        for level in measured {
            let squares = self.squared_errors(&pilots, level, [SALTS[2], SALTS[3]])?;
            let sums = sums(&classes, &squares, count).into_iter().map(|sum| sum / pilots.len() as f64);
            let sums: Vec<f64> = sums.collect();
            let total: f64 = sums.iter().sum();
            curves.push((level, sums));
            if total < MEASURED_ERROR_SHARE * wanted {
                break;
            }
        }
        let rays: Vec<f64> = self.adaptive.levels.iter().map(|pattern| pattern.len() as f64).collect();
        let errors: Vec<Vec<f64>> = (0..count).map(|class| curve(&curves, class, &rays)).collect();
        let chosen = choose(&errors, &shares, &rays, wanted);
        let cost = |levels: &[usize]| -> f64 {
            levels.iter().zip(&shares).map(|(&level, share)| rays[level] * share).sum()
        };
        let total = |level: usize| errors.iter().map(|errors| errors[level]).sum::<f64>();
        let uniform = (0..rays.len()).find(|&level| total(level) <= wanted).unwrap_or(rays.len() - 1);
        plan.levels =
            if rays[uniform] <= cost(&chosen) + 2.0 * rays[0] { vec![uniform; count] } else { chosen };
        plan.squared_error = plan.levels.iter().zip(&errors).map(|(&level, errors)| errors[level]).sum();
        Ok(plan)
    }

    /// The level of each receiver.
    fn levels(&mut self, order: &[usize], plan: &RayPlan) -> Result<Vec<usize>, MaskError> {
        if plan.is_uniform() {
            return Ok(vec![plan.levels[0]; order.len()]);
        }
        let mut levels = vec![0; order.len()];
        for (pool, difference) in order.chunks(POOL_RECEIVERS).zip(self.differences(order)?) {
            pool.iter().for_each(|&i| levels[i] = plan.levels[plan.class(difference)]);
        }
        Ok(levels)
    }
}

/// Bounds of classes: those without any difference, and the others in groups of about the same size.
fn bounds(differences: &[f64]) -> Vec<f64> {
    let mut sorted: Vec<f64> = differences.iter().copied().filter(|&d| d > 0.0).collect();
    sorted.sort_by(f64::total_cmp);
    let mut bounds: Vec<f64> =
        (0..CLASSES).filter_map(|i| sorted.get(i * sorted.len() / CLASSES).copied()).collect();
    bounds.dedup();
    bounds
}

/// Sums of `values` by class.
fn sums(classes: &[usize], values: &[f64], count: usize) -> Vec<f64> {
    let mut sums = vec![0.0; count];
    classes.iter().zip(values).for_each(|(&class, value)| sums[class] += value);
    sums
}

/// Squared errors of a class at each level, from those measured: straight lines in logarithms.
fn curve(measured: &[(usize, Vec<f64>)], class: usize, rays: &[f64]) -> Vec<f64> {
    // Where pilots saw no error there may still be some; at least one that falls with the rays.
    let mut points: Vec<(f64, f64)> = Vec::new();
    for (level, errors) in measured {
        let least = points
            .last()
            .map_or(1e-12, |&(r, e): &(f64, f64)| (e.exp() * (r.exp() / rays[*level]).powi(2)).max(1e-12));
        points.push((rays[*level].ln(), errors[class].max(least).ln()));
    }
    let at = |rays: f64| {
        let x = rays.ln();
        let i = points.partition_point(|&(known, _)| known < x).clamp(1, points.len().max(2) - 1);
        match (points.get(i - 1), points.get(i)) {
            (Some(&(x0, y0)), Some(&(x1, y1))) => {
                // Beyond what was measured errors fall at least as the reciprocal of the rays.
                let slope = ((y1 - y0) / (x1 - x0)).clamp(-2.0, if x > x1 { -1.0 } else { 0.0 });
                if x > x1 { y1 + slope * (x - x1) } else { y0 + slope * (x - x0) }
            }
            // With one point there is one number of rays, or the least is enough.
            (point, _) => point.map_or(0.0, |&(x0, y0)| y0 - (x - x0)),
        }
        .exp()
    };
    rays.iter().map(|&rays| at(rays)).collect()
}

/// The level of each class with which the sum of `errors` is at most `wanted` in the least rays: the next level goes to where a ray
/// takes away most.
fn choose(errors: &[Vec<f64>], shares: &[f64], rays: &[f64], wanted: f64) -> Vec<usize> {
    let mut levels = vec![0; errors.len()];
    loop {
        let total: f64 = levels.iter().zip(errors).map(|(&level, errors)| errors[level]).sum();
        // Curves need not be convex: the best of all higher levels.
        let gain = |class: usize, to: usize| {
            let from = levels[class];
            let cost = (rays[to] - rays[from]) * shares[class].max(1e-9);
            (errors[class][from] - errors[class][to]) / cost
        };
        let steps =
            (0..errors.len()).flat_map(|class| (levels[class] + 1..rays.len()).map(move |to| (class, to)));
        let best = steps.max_by(|&a, &b| gain(a.0, a.1).total_cmp(&gain(b.0, b.1)));
        match best {
            Some((class, to)) if total > wanted => levels[class] = to,
            _ => return levels,
        }
    }
}

/// Answers on their way to the caller's outputs.
struct OutputBuffers {
    ao: Vec<f32>,
    bent_normals: Option<Vec<[f32; 3]>>,
    free_directions: Option<Vec<[f32; 3]>>,
    sectors: Option<(u32, Vec<f32>)>,
    hit_distances: Option<Vec<f32>>,
}

impl OutputBuffers {
    /// As `outputs` want it.
    fn new(outputs: &Outputs<'_>, count: usize) -> Self {
        let sectors = outputs.sectors.as_ref().map(|&(n, _)| (n, vec![0.0; count * n as usize]));
        Self {
            ao: vec![0.0; count],
            bent_normals: outputs.bent_normals.as_ref().map(|_| vec![[0.0; 3]; count]),
            free_directions: outputs.free_directions.as_ref().map(|_| vec![[0.0; 3]; count]),
            sectors,
            hit_distances: outputs.hit_distances.as_ref().map(|_| vec![0.0; count]),
        }
    }

    fn outputs(&mut self) -> Outputs<'_> {
        let mut outputs = Outputs::new(&mut self.ao);
        outputs.bent_normals = self.bent_normals.as_deref_mut();
        outputs.free_directions = self.free_directions.as_deref_mut();
        outputs.sectors = self.sectors.as_mut().map(|(n, values)| (*n, &mut values[..]));
        outputs.hit_distances = self.hit_distances.as_deref_mut();
        outputs
    }

    /// Takes what `other` has at `from`.
    fn take(&mut self, to: usize, other: &Self, from: usize) {
        self.ao[to] = other.ao[from];
        if let (Some(own), Some(other)) = (&mut self.bent_normals, &other.bent_normals) {
            own[to] = other[from];
        }
        if let (Some(own), Some(other)) = (&mut self.free_directions, &other.free_directions) {
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
        if let (Some(to), Some(from)) = (&mut outputs.free_directions, &self.free_directions) {
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
