//! Method `mask-prefilter`: exact masks up to a distance, stored opacity beyond it. Approximate.
//!
//! Here: how both parts of a ray make one answer. Not here: the stored opacity, which is whatever implements [`FarField`], such as
//! `field.rs`.

pub mod field;
mod voxelize;

use crate::{MaskOptions, Pattern, Receiver, drive::Engine, exact::Walks, gather::Answers};
use umbrage_geom::{Ray, glam::Vec3};

/// Bundles of rays of one receiver.
#[derive(Clone, Debug, Default)]
pub struct Cones {
    /// Where all start.
    pub origin: Vec3,
    /// By axis: unit vectors.
    pub directions: [Vec<f32>; 3],
    /// Where they end, world units.
    pub lengths: Vec<f32>,
    /// Solid angles, steradians.
    pub solid_angles: Vec<f32>,
}

impl Cones {
    /// Each as a ray from `near` (world units) to its end, with its solid angle.
    pub fn rays(&self, near: f32) -> impl ExactSizeIterator<Item = (Ray, f32)> + '_ {
        let [x, y, z] = &self.directions;
        (0..self.lengths.len()).map(move |i| {
            let direction = Vec3::new(x[i], y[i], z[i]);
            // Both segments are open: no hit falls between them.
            let ray = Ray { origin: self.origin, direction, tnear: near.next_down(), tfar: self.lengths[i] };
            (ray, self.solid_angles[i])
        })
    }
}

/// Something that knows, approximately, how much light passes along bundles of rays.
pub trait FarField: Sync {
    /// Where exact answers end and those of the field start, world units.
    fn near(&self) -> f32;

    /// Most neighbouring rays that one cone may stand for, at least 1. Rays of different lengths are never bundled.
    fn bundle(&self) -> usize;

    /// Writes the fraction of light that passes along each cone from [`Self::near`] on.
    fn transmittances(&self, cones: &Cones, passed: &mut [f32]);
}

/// Rays of a pattern and the runs of neighbours that share a cone.
struct Bundles {
    /// Rays of each, a power of two.
    rays: usize,
    /// Bundles of a member.
    count: usize,
    /// Steradians, by member and bundle.
    solid_angles: Vec<f32>,
}

impl Bundles {
    fn new(pattern: &Pattern, most: usize) -> Self {
        let most = if pattern.has_equal_lengths() { most.clamp(1, 32) } else { 1 };
        // A power of two, of which a word of a mask and the pattern hold whole numbers.
        let rays = 1 << most.ilog2().min(pattern.len().trailing_zeros());
        let angle = |run: &[Vec3]| run.iter().map(|&d| pattern.solid_angle(d)).sum();
        let of_member = |member| pattern.directions(member).chunks(rays).map(angle);
        Self {
            rays,
            count: pattern.len() / rays,
            solid_angles: (0..pattern.members()).flat_map(of_member).collect(),
        }
    }
}

pub(crate) struct Coarse<'a, N> {
    /// Exact answers up to the far field.
    near: N,
    /// Whether `near` writes what passes along each ray, beside masks.
    dims: bool,
    pattern: &'a Pattern,
    /// World units.
    radius: f32,
    far: &'a dyn FarField,
    bundles: Bundles,
}

/// What a thread keeps.
pub(crate) struct Scratch {
    walks: Walks,
    cones: Cones,
    /// Numbers of the cones' bundles.
    which: Vec<usize>,
    /// Numbers of the rays along which they go.
    chosen: Vec<usize>,
    /// What passes along each cone.
    passed: Vec<f32>,
}

impl<N: Engine<Scratch = Walks>> Engine for Coarse<'_, N> {
    type Scratch = Scratch;

    fn scratch(&self) -> Scratch {
        Scratch {
            walks: self.near.scratch(),
            cones: Cones::default(),
            which: Vec::new(),
            chosen: Vec::new(),
            passed: Vec::new(),
        }
    }

    fn answer(&self, receivers: &[Receiver], answers: &mut Answers, scratch: &mut Scratch) {
        self.near.answer(receivers, answers, &mut scratch.walks);
        let (rays, words) = (self.pattern.len(), self.pattern.words());
        if !self.dims {
            answers.passed.clear();
            for mask in answers.masks.chunks(words) {
                let open = |i: usize| mask[i / 64] >> (i % 64) & 1 == 0;
                answers.passed.extend((0..rays).map(|i| f32::from(u8::from(open(i)))));
            }
        }
        let passed = answers.passed.chunks_mut(rays);
        for ((receiver, mask), passed) in receivers.iter().zip(answers.masks.chunks_mut(words)).zip(passed) {
            self.open(receiver, mask, scratch);
            self.far.transmittances(&scratch.cones, &mut scratch.passed);
            self.bundles.spread(mask, passed, scratch);
        }
    }
}

impl<'a, N> Coarse<'a, N> {
    /// `near` answers up to [`FarField::near`]; `dims` if it writes what passes along each ray, beside masks.
    pub(crate) fn new(
        near: N,
        dims: bool,
        pattern: &'a Pattern,
        options: &MaskOptions,
        far: &'a dyn FarField,
    ) -> Self {
        let bundles = Bundles::new(pattern, far.bundle());
        Self { near, dims, pattern, radius: options.radius, far, bundles }
    }

    /// Collects the cones of bundles that have a ray which `mask` leaves open: each along one of these. Rays that end before
    /// the far field have their answers.
    fn open(&self, receiver: &Receiver, mask: &[u64], scratch: &mut Scratch) {
        let Self { pattern, bundles, far, .. } = self;
        let member = pattern.member_of(receiver);
        let (directions, lengths) = (pattern.directions(member), pattern.lengths(member));
        let Scratch { cones, which, chosen, passed, .. } = scratch;
        let (n, near) = (bundles.rays, far.near());
        let all = u64::MAX >> (64 - n);
        which.clear();
        chosen.clear();
        for bundle in 0..bundles.count {
            let first = bundle * n;
            let open = !mask[first / 64] >> (first % 64) & all;
            if open != 0 && self.radius * lengths[first] > near {
                // The first one from a place that changes.
                let turn = (receiver.seed() as usize + bundle) % n;
                let turned = open >> turn | open << (n - turn);
                which.push(bundle);
                chosen.push(first + (turned.trailing_zeros() as usize + turn) % n);
            }
        }
        let frame = pattern.frame_of(receiver);
        for (axis, row) in cones.directions.iter_mut().enumerate() {
            let (t, b, n) = (frame.tangent[axis], frame.bitangent[axis], frame.normal[axis]);
            row.clear();
            row.extend(chosen.iter().map(|&i| {
                let d = directions[i];
                (t * d.x + b * d.y) + n * d.z
            }));
        }
        if receiver.face().is_some() {
            for cone in 0..chosen.len() {
                let above = receiver.above([0, 1, 2].map(|axis| cones.directions[axis][cone]).into());
                (0..3).for_each(|axis| cones.directions[axis][cone] = above[axis]);
            }
        }
        cones.origin = receiver.point();
        cones.lengths.clear();
        cones.lengths.extend(chosen.iter().map(|&i| self.radius * lengths[i]));
        cones.solid_angles.clear();
        cones.solid_angles.extend(which.iter().map(|&i| bundles.solid_angles[member * bundles.count + i]));
        passed.clear();
        passed.resize(which.len(), 1.0);
    }
}

impl Bundles {
    /// Dims the rays of `mask` that are open by what passes along their cones, and closes those that nothing passes.
    fn spread(&self, mask: &mut [u64], out: &mut [f32], scratch: &Scratch) {
        for (&bundle, &passed) in scratch.which.iter().zip(&scratch.passed) {
            let first = bundle * self.rays;
            let word = &mut mask[first / 64];
            out[first..first + self.rays].iter_mut().for_each(|out| *out *= passed);
            if passed == 0.0 {
                *word |= (u64::MAX >> (64 - self.rays)) << (first % 64);
            }
        }
    }
}
