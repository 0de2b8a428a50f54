//! What `mask-prefilter` takes for occluders beyond the reach of its exact masks.
//!
//! Here: the field with what is too large for it, and how far masks have to be exact for what is stated to hold. The choice is
//! made on a sample of the very receivers that are asked where it is known ([`Pilot`]), and takes the sample's own error into
//! account.

use crate::{engine::Report, share_of};
use umbrage_accel::Bvh;
use umbrage_aomask::{
    MaskCall, MaskError, MaskOptions, Outputs, Pattern, PatternOptions, Receiver,
    coarse::{
        Cones, FarField,
        field::{FieldCones, FieldOptions, MarchOptions, OpacityField},
    },
};
use umbrage_geom::{
    Aabb, OpticalDepth, TriangleMesh,
    glam::{DVec3, Vec3},
    offset_origin,
    sampling::{combine, hash, unit},
    segment_hits_triangle,
};

/// How far masks are exact, the first that will do: shares of the radius, or of the diagonal if that is less.
const EXACT_SHARES: [f32; 5] = [0.1, 0.15, 0.22, 0.33, 0.5];

/// Cells of the field over which masks are exact at least; more in proportion for larger shares.
const MIN_EXACT_CELLS: f32 = 2.25;

/// What the field may add to the mean of exact rays, and to their RMS error, over the receivers of a group. Walls and floors are
/// darkened by cells that hold themselves.
const MAX_BIAS: f64 = 0.005;
const MAX_ADDED_RMSE: f64 = 0.0125;

/// Standard errors of the sample by which it has to stay below these limits: it speaks for receivers that are not in it.
const BOUND_STANDARD_ERRORS: f64 = 3.0;

/// Receivers that are looked at to find those of a group, and most that are sampled of each.
const MAX_CANDIDATES: usize = 8192;
const MAX_GROUP_SAMPLES: usize = 512;

/// Fewer say little of a standard error: such a group counts with the other.
const MIN_GROUP_SAMPLES: usize = 32;

/// Most triangles that are left to exact rays.
const MAX_LARGE_TRIANGLES: usize = 8;

/// Distance from a large triangle within which a receiver counts as on it, in diagonals of all others.
const ON_LARGE_DISTANCE: f64 = 1e-3;

/// The triangles of a scene as masks see them.
pub(crate) struct Blockers<'a, D> {
    pub(crate) bvh: &'a Bvh,
    /// What a crossing of the triangle with an index adds; nothing if all are opaque.
    pub(crate) depth_of: Option<D>,
}

impl<D: Fn(u32) -> OpticalDepth + Sync> Blockers<'_, D> {
    /// Masks of `receivers`: exact, or with `far` from where it begins.
    ///
    /// # Errors
    /// Those of [`MaskCall::answer`].
    pub(crate) fn answer(
        &self,
        far: Option<&FarCones<'_>>,
        pattern: &Pattern,
        receivers: &[Receiver],
        options: &MaskOptions,
        outputs: Outputs<'_>,
        progress: &mut (dyn FnMut(f32) -> bool + Send),
    ) -> Result<(), MaskError> {
        let mut call = MaskCall::new(self.bvh, pattern, receivers, options);
        if let Some(far) = far {
            call = call.with_far(far);
        }
        match &self.depth_of {
            None => call.answer(outputs, progress),
            Some(depth_of) => call.transmit(depth_of, outputs, progress),
        }
    }
}

/// Receivers at which a method looks at its errors before it answers.
#[derive(Clone, Debug, Default)]
pub struct Pilot {
    receivers: Vec<Receiver>,
    /// How many will be asked.
    of: usize,
}

impl Pilot {
    /// Of `of` receivers that will be asked, `receivers` are those with the numbers [`Self::indices`], less any that turned out
    /// to have nothing to ask.
    pub fn new(receivers: Vec<Receiver>, of: usize) -> Self {
        Self { receivers, of }
    }

    /// Numbers of a sample of `count` receivers, rising: one at random of each of equal runs, or all of few.
    pub fn indices(count: usize) -> impl Iterator<Item = usize> {
        let n = MAX_CANDIDATES.min(count);
        (0..n).map(move |i| {
            let run = count as f64 / n as f64;
            let at = (i as f64 + f64::from(unit(hash(i as u32)))) * run;
            if n == count { i } else { (at as usize).min(count - 1) }
        })
    }
}

/// Receivers that have a mean of their own.
struct Group {
    receivers: Vec<Receiver>,
    /// Share of the group's receivers that the sample leaves out.
    unseen: f64,
}

impl Group {
    fn new(candidates: Vec<Receiver>, share: f64) -> Self {
        let (all, n) = (candidates.len(), candidates.len().min(MAX_GROUP_SAMPLES));
        let receivers: Vec<Receiver> = (0..n).map(|i| candidates[i * all / n]).collect();
        Self { unseen: 1.0 - share * n as f64 / all.max(1) as f64, receivers }
    }

    /// Mean of the values at the sample and its standard error.
    fn estimate(&self, value: impl Fn(usize) -> f64) -> [f64; 2] {
        let n = self.receivers.len() as f64;
        let mean = (0..self.receivers.len()).map(&value).sum::<f64>() / n;
        let squares: f64 = (0..self.receivers.len()).map(|i| (value(i) - mean).powi(2)).sum();
        [mean, (self.unseen * squares / (n - 1.0).max(1.0) / n).sqrt()]
    }
}

/// A triangle that is left to exact rays.
#[derive(Clone, Debug, PartialEq)]
struct LargeTriangle {
    corners: [[f32; 3]; 3],
    /// Fraction of light that a crossing lets through.
    passes: f32,
}

impl LargeTriangle {
    /// Whether `point` is above or below the triangle by `most` or less.
    fn has(&self, point: Vec3, most: f64) -> bool {
        let [a, b, c] = self.corners.map(|p| Vec3::from(p).as_dvec3());
        let (p, n) = (point.as_dvec3(), (b - a).cross(c - a).normalize_or_zero());
        let inside = [(a, b), (b, c), (c, a)].iter().all(|&(a, b)| (b - a).cross(p - a).dot(n) >= 0.0);
        inside && (p - a).dot(n).abs() <= most
    }
}

/// Stored opacity of triangles.
pub(crate) struct FarOpacity {
    field: OpacityField,
    diagonal: f32,
    /// Triangles without which all others lie close together, such as a wide ground: too large for the field.
    large: Vec<LargeTriangle>,
    /// Where errors are looked at when it isn't known who will ask.
    samples: Pilot,
}

impl FarOpacity {
    /// Makes the field. `opacities` has the fraction that a crossing of each triangle blocks, or nothing if all are opaque;
    /// `progress` as in [`OpacityField::build`].
    ///
    /// # Errors
    /// Those of [`OpacityField::build_transparent`].
    pub(crate) fn build(
        mesh: &TriangleMesh,
        opacities: &[f32],
        progress: &mut (dyn FnMut(f32) -> bool + Send),
    ) -> Result<Self, MaskError> {
        let large = large(mesh);
        let (mut rest, mut of_rest) = (mesh.triangles.clone(), opacities.to_vec());
        // From the back, so that what is still to be taken stays in place.
        for &i in large.iter().rev() {
            rest.swap_remove(i);
            if !opacities.is_empty() {
                of_rest.swap_remove(i);
            }
        }
        let options = FieldOptions::default();
        let field = OpacityField::build_transparent(&mesh.positions, &rest, &of_rest, &options, progress)?;
        let diagonal = bounds_of(mesh, &rest).diagonal();
        let passes = |i: usize| opacities.get(i).map_or(0.0, |opacity| 1.0 - opacity.clamp(0.0, 1.0));
        let large = large.into_iter().map(|i| LargeTriangle { corners: mesh.triangle(i), passes: passes(i) });
        let large: Vec<LargeTriangle> = large.collect();
        let samples = samples(mesh, &rest, &large)?;
        Ok(Self { field, diagonal, large, samples })
    }

    /// Memory it holds.
    pub(crate) fn bytes(&self) -> usize {
        let samples = size_of_val(&self.samples.receivers[..]);
        self.field.bytes() + size_of_val(&self.large[..]) + samples
    }

    /// How far masks of `pattern`, which has `options`, are to be exact so that the whole errs little at the receivers that the
    /// pilot stands for: over those on large triangles and over all others, the field adds at most [`MAX_BIAS`] to the mean and
    /// [`MAX_ADDED_RMSE`] to the RMS error, both with [`BOUND_STANDARD_ERRORS`] standard errors to spare. A pilot without receivers stands for the
    /// surfaces of the scene. `None` if the field is of no use, because it would have to begin too far away. `progress` gets growing
    /// fractions below 1, and returns `false` to cancel.
    ///
    /// # Errors
    /// Those of [`MaskCall::answer`].
    pub(crate) fn near<D: Fn(u32) -> OpticalDepth + Sync>(
        &self,
        blockers: &Blockers<'_, D>,
        pattern: &Pattern,
        options: &PatternOptions,
        masks: &MaskOptions,
        pilot: &Pilot,
        progress: Report<'_>,
    ) -> Result<Option<f32>, MaskError> {
        let many = Pattern::new(&options.clone().with_rays(Pattern::MAX_MASK_RAYS))?;
        let groups = self.groups(if pilot.receivers.is_empty() { &self.samples } else { pilot });
        let (mut asked, most_asked) = (0, groups.len() * (2 + EXACT_SHARES.len()) + 1);
        let mut ask = |far: Option<&FarCones<'_>>, pattern: &Pattern, group: &Group| {
            asked += 1;
            let mut progress = share_of(progress, asked - 1, most_asked);
            let mut ao = vec![0f32; group.receivers.len()];
            let outputs = Outputs::new(&mut ao);
            blockers.answer(far, pattern, &group.receivers, masks, outputs, &mut progress)?;
            Ok::<_, MaskError>(ao)
        };
        let mut known = Vec::with_capacity(groups.len());
        for group in &groups {
            known.push((group, ask(None, &many, group)?, ask(None, pattern, group)?));
        }
        let extent = masks.radius.min(self.diagonal);
        'nears: for share in EXACT_SHARES {
            let near = (share * extent).max(share / EXACT_SHARES[0] * MIN_EXACT_CELLS * self.field.cell());
            if known.is_empty() || near >= extent {
                break;
            }
            let far = self.cones(pattern.len(), near, masks.radius)?;
            for (group, truth, exact) in &known {
                let ao = ask(Some(&far), pattern, group)?;
                let error = |ao: f32, i: usize| f64::from(ao - truth[i]);
                let [bias, bias_error] = group.estimate(|i| f64::from(ao[i]) - f64::from(exact[i]));
                let [added, added_error] =
                    group.estimate(|i| error(ao[i], i).powi(2) - error(exact[i], i).powi(2));
                if bias.abs() + BOUND_STANDARD_ERRORS * bias_error > MAX_BIAS
                    || added + BOUND_STANDARD_ERRORS * added_error > MAX_ADDED_RMSE.powi(2)
                {
                    continue 'nears;
                }
            }
            return Ok(Some(near));
        }
        Ok(None)
    }

    /// Receivers on large triangles, and all others; one group if either has few.
    fn groups(&self, pilot: &Pilot) -> Vec<Group> {
        let most = ON_LARGE_DISTANCE * f64::from(self.diagonal);
        let on_large = |receiver: &Receiver| self.large.iter().any(|large| large.has(receiver.point(), most));
        let all = &pilot.receivers;
        let (on, off): (Vec<Receiver>, Vec<Receiver>) = all.iter().copied().partition(on_large);
        let share = (all.len() as f64 / pilot.of.max(1) as f64).min(1.0);
        let parts = match on.len().min(off.len()) {
            0..MIN_GROUP_SAMPLES if share < 1.0 || on.is_empty() || off.is_empty() => vec![all.clone()],
            _ => vec![off, on],
        };
        let parts = parts.into_iter().filter(|part| !part.is_empty());
        parts.map(|part| Group::new(part, share)).collect()
    }

    /// For patterns of `rays` rays that end at `radius` (world units) or before, of which `near` has been answered.
    ///
    /// # Errors
    /// Those of [`FieldCones::new`].
    pub(crate) fn cones(&self, rays: usize, near: f32, radius: f32) -> Result<FarCones<'_>, MaskError> {
        let cones = FieldCones::new(&self.field, rays, near, radius, &MarchOptions::default())?;
        Ok(FarCones { cones, large: &self.large })
    }
}

/// Points on the fronts of `rest`, half of them by area and half by number of triangles, and on large triangles near the rest,
/// on its side of them; the same in every run.
fn samples(mesh: &TriangleMesh, rest: &[[u32; 3]], large: &[LargeTriangle]) -> Result<Pilot, MaskError> {
    let corners = |i: usize| rest[i].map(|v| Vec3::from(mesh.positions[v as usize]).as_dvec3());
    let area = |i: usize| {
        let [a, b, c] = corners(i);
        (b - a).cross(c - a).length()
    };
    let half = MAX_GROUP_SAMPLES / 2;
    let count = half.min(rest.len());
    let mut chosen: Vec<usize> = (0..count).map(|i| i * rest.len() / count).collect();
    let total: f64 = (0..rest.len()).map(area).sum();
    let (mut sum, mut next) = (0.0, 0);
    for i in 0..rest.len() {
        sum += area(i);
        while next < half && sum * half as f64 >= (next as f64 + 0.5) * total && total > 0.0 {
            chosen.push(i);
            next += 1;
        }
    }
    let mut receivers = Vec::with_capacity(chosen.len() + MAX_GROUP_SAMPLES);
    let mut add = |point: DVec3, normal: DVec3, magnitude: f64, seed: u32| {
        let normal = normal.as_vec3();
        if normal != Vec3::ZERO {
            let origin = offset_origin(point.as_vec3(), normal, normal, magnitude as f32);
            receivers.push(Receiver::new(0, origin.to_array(), normal.to_array(), seed)?);
        }
        Ok::<(), MaskError>(())
    };
    let size = |[a, b, c]: [DVec3; 3]| a.abs().max(b.abs()).max(c.abs()).max_element();
    for (number, i) in chosen.into_iter().enumerate() {
        let [a, b, c] = corners(i);
        let seed = combine(number as u32, 3);
        let (root, v) = (f64::from(unit(seed)).sqrt(), f64::from(unit(hash(seed))));
        let point = a * (1.0 - root) + b * (root * (1.0 - v)) + c * (root * v);
        add(point, (b - a).cross(c - a).normalize_or_zero(), size([a, b, c]), seed)?;
    }
    let near = bounds_of(mesh, rest);
    for number in 0..if large.is_empty() { 0 } else { MAX_GROUP_SAMPLES as u32 } {
        let seed = combine(number, 4);
        let [u, v, w] = [0, 1, 2].map(|axis| f64::from(unit(combine(seed, axis))));
        let spread = (DVec3::new(u, v, w) * 2.0 - 0.5) * (near.max - near.min).as_dvec3();
        let large = &large[number as usize % large.len()];
        let [a, b, c] = large.corners.map(|p| Vec3::from(p).as_dvec3());
        let normal = (b - a).cross(c - a).normalize_or_zero();
        // Above and below the box of the rest and its surroundings.
        let point = near.min.as_dvec3() + spread;
        let point = point - normal * (point - a).dot(normal);
        if large.has(point.as_vec3(), ON_LARGE_DISTANCE * f64::from(near.diagonal())) {
            let side = if (near.center().as_dvec3() - a).dot(normal) < 0.0 { -normal } else { normal };
            add(point, side, size([a, b, c]), seed)?;
        }
    }
    Ok(Pilot { receivers, of: usize::MAX })
}

/// [`FarOpacity`] for one pattern.
pub(crate) struct FarCones<'a> {
    cones: FieldCones<'a>,
    large: &'a [LargeTriangle],
}

impl FarField for FarCones<'_> {
    fn near(&self) -> f32 {
        self.cones.near()
    }

    fn bundle(&self) -> usize {
        self.cones.bundle()
    }

    fn transmittances(&self, cones: &Cones, passed: &mut [f32]) {
        self.cones.transmittances(cones, passed);
        if self.large.is_empty() {
            return;
        }
        for ((ray, _), passed) in cones.rays(self.near()).zip(passed) {
            for large in self.large {
                if *passed > 0.0 && segment_hits_triangle(&ray, large.corners) {
                    *passed *= large.passes;
                }
            }
        }
    }
}

fn bounds_of(mesh: &TriangleMesh, triangles: &[[u32; 3]]) -> Aabb {
    let corners = triangles.iter().flatten();
    corners.fold(Aabb::EMPTY, |aabb, &v| aabb.with_point(mesh.positions[v as usize]))
}

/// The fewest triangles, at most [`MAX_LARGE_TRIANGLES`], without which the diagonal of all others is less than half: their numbers, rising.
fn large(mesh: &TriangleMesh) -> Vec<usize> {
    let extent = |&i: &usize| {
        let [a, b, c] = mesh.triangle(i).map(Vec3::from);
        a.distance_squared(b).max(b.distance_squared(c)).max(c.distance_squared(a))
    };
    let mut largest: Vec<usize> = Vec::with_capacity(MAX_LARGE_TRIANGLES + 1);
    for i in 0..mesh.triangles.len() {
        let size = extent(&i);
        if largest.len() == MAX_LARGE_TRIANGLES && size <= extent(&largest[MAX_LARGE_TRIANGLES - 1]) {
            continue;
        }
        let at = largest.partition_point(|other| extent(other) >= size);
        largest.insert(at, i);
        largest.truncate(MAX_LARGE_TRIANGLES);
    }
    // Bounds of what is left without the first `n`, growing as triangles come back.
    let mut taken = largest.clone();
    taken.sort_unstable();
    let mut rest = Aabb::EMPTY;
    for (i, triangle) in mesh.triangles.iter().enumerate() {
        if taken.binary_search(&i).is_err() {
            rest = triangle.iter().fold(rest, |aabb, &v| aabb.with_point(mesh.positions[v as usize]));
        }
    }
    let half = 0.5 * bounds_of(mesh, &mesh.triangles).diagonal();
    let fits = |rest: &Aabb| !rest.is_empty() && rest.diagonal() < half;
    if !fits(&rest) {
        return Vec::new();
    }
    while let Some(&last) = largest.last() {
        let with = mesh.triangle(last).into_iter().fold(rest, |aabb, p| aabb.with_point(p));
        if !fits(&with) {
            break;
        }
        rest = with;
        largest.pop();
    }
    largest.sort_unstable();
    largest
}

#[cfg(test)]
mod tests;
