//! Up to 256 rays of one origin, and the cones around groups of eight of them.
//!
//! Here: the prepared rays and how a pattern's rays get there. Directions are scaled by a power of two so that the sizes of
//! their components add up to about 1/2 to 1, as [`umbrage_geom::kernel::fan`] wants it.

use super::walk::FEW;
use crate::Pattern;
use umbrage_geom::{
    Frame, Ray,
    glam::Vec3,
    kernel::fan::{CHUNK, FanRays},
};

/// Rays of a group.
pub(crate) const GROUP: usize = 8;

/// Most groups of a walk.
pub(crate) const GROUPS: usize = 32;

/// Most rays of a walk.
pub(crate) const RAYS: usize = GROUP * GROUPS;

/// More than rounding, and a frame's lack of orthogonality, move a unit vector by.
const SLACK: f32 = 4e-6;

/// Chord from which a cone is no longer told from a half-space: about 83 degrees.
const WIDE: f32 = 1.33;

/// Components of unit vectors as small as this have no use for a group: their reciprocals say too little.
const STEEP: f32 = 1e-4;

/// Smallest component of a scaled direction, but 0, whose reciprocal is safe: `2^-79`.
const SMALLEST: f32 = 1.0 / (1u128 << 79) as f32;

/// Prepared rays, all from the same point; `tnear` is 0.
#[derive(Clone, Debug)]
#[repr(C, align(64))]
pub(crate) struct RaySet {
    /// By axis, scaled.
    pub(crate) direction: [[f32; RAYS]; 3],
    /// By axis: reciprocal of the scaled direction.
    pub(crate) inverse: [[f32; RAYS]; 3],
    /// End of the segment in units of the scaled direction, exact.
    pub(crate) far: [f32; RAYS],
    /// What undoes the scaling of the direction, a power of two.
    unscale: [f32; RAYS],
    /// By axis: unit vector in the middle of each group.
    pub(crate) axis: [[f32; GROUPS]; 3],
    /// Cosine of each group's half-angle, or less.
    pub(crate) cos: [f32; GROUPS],
    /// Sine of each group's half-angle; the angle may be larger than it is.
    pub(crate) sin: [f32; GROUPS],
    /// At least the distance of any unit direction of the group from its axis.
    pub(crate) chord: [f32; GROUPS],
    /// By axis: the reciprocals of the smallest and largest component of unit directions of each group, or more; NaN where
    /// their signs differ.
    pub(crate) ends: [[[f32; GROUPS]; 2]; 3],
    /// Groups in use.
    pub(crate) groups: usize,
    /// Bits without a ray, or with a ray that no walk may answer.
    pub(crate) closed: [u8; GROUPS],
}

impl RaySet {
    pub(crate) fn new() -> Self {
        let (row, groups) = ([0.0; RAYS], [0.0; GROUPS]);
        Self {
            direction: [row; 3],
            inverse: [row; 3],
            far: row,
            unscale: [2.0; RAYS],
            axis: [groups; 3],
            cos: groups,
            sin: groups,
            chord: groups,
            ends: [[groups; 2]; 3],
            groups: 0,
            closed: [u8::MAX; GROUPS],
        }
    }

    /// The group's numbers of a row.
    #[inline(always)]
    pub(crate) fn of_group<'a>(&self, row: &'a [f32; RAYS], group: usize) -> &'a [f32; GROUP] {
        let at = group % GROUPS * GROUP;
        (&row[at..at + GROUP]).try_into().expect("a group")
    }

    /// Ray number `ray` as it was before scaling, bit for bit.
    pub(crate) fn ray(&self, ray: usize, origin: [f32; 3]) -> Ray {
        let direction = Vec3::from(self.direction.map(|row| row[ray])) * self.unscale[ray];
        Ray { origin: origin.into(), direction, tnear: 0.0, tfar: self.far[ray] / self.unscale[ray] }
    }

    /// Ends ray number `ray` soon after `t`, in units of its direction before scaling.
    pub(crate) fn shorten(&mut self, ray: usize, t: f32) {
        let end = t * self.unscale[ray] * (1.0 + 1e-5) + f32::MIN_POSITIVE;
        self.far[ray] = self.far[ray].min(end);
    }

    /// The groups with an open ray, a bit each.
    #[inline(always)]
    pub(crate) fn open(&self) -> u32 {
        let mut open = 0;
        for g in 0..self.groups {
            open |= u32::from(self.closed[g] != u8::MAX) << g;
        }
        open
    }

    /// Reciprocals of the first directions; whether some component is so small that its ray can't walk.
    #[inline(always)]
    fn invert(&mut self) -> bool {
        // By lanes, so that it is SIMD.
        let mut least = [1f32; GROUP];
        for axis in 0..3 {
            let (row, inverse) = (&self.direction[axis], &mut self.inverse[axis]);
            for g in 0..self.groups.min(GROUPS) {
                let at = g * GROUP;
                for i in 0..GROUP {
                    let x = row[at + i].abs();
                    inverse[at + i] = 1.0 / row[at + i];
                    let x = if x == 0.0 { 1.0 } else { x };
                    least[i] = if x < least[i] { x } else { least[i] };
                }
            }
        }
        least.into_iter().any(|x| x < SMALLEST)
    }

    /// Closes rays that can't walk.
    #[cold]
    fn close_small(&mut self) {
        for i in 0..self.groups * GROUP {
            let small = self.direction.iter().any(|row| row[i] != 0.0 && row[i].abs() < SMALLEST);
            self.closed[i / GROUP] |= u8::from(small) << (i % GROUP);
        }
    }

    /// Takes up `rays` of one origin in the given order. Rays that aren't valid or can't walk are closed.
    #[inline(always)]
    pub(crate) fn load(&mut self, rays: &[Ray]) {
        self.groups = rays.len().div_ceil(GROUP);
        self.closed = [u8::MAX; GROUPS];
        let mut chunk = FanRays::<CHUNK>::default();
        for (c, rays) in rays.chunks(CHUNK).enumerate() {
            let fit = chunk.prepare(0, rays);
            let at = c * CHUNK;
            for i in 0..CHUNK {
                self.far[at + i] = chunk.far[i];
                for axis in 0..3 {
                    self.direction[axis][at + i] = chunk.direction[axis][i];
                }
            }
            for (i, ray) in rays.iter().enumerate() {
                let size = ray.direction.abs();
                let exponent = (size.x + size.y + size.z).to_bits() >> 23 & 0xff;
                self.unscale[at + i] = f32::from_bits((exponent + 1).min(254) << 23);
                if fit >> i & 1 == 1 && ray.tnear == 0.0 {
                    self.closed[(at + i) / GROUP] &= !(1 << (i % GROUP));
                }
            }
        }
        if self.invert() {
            self.close_small();
        }
        // The cones of few groups aren't asked about.
        if self.groups > FEW as usize {
            for (g, group) in rays.chunks(GROUP).enumerate() {
                let closed = self.closed[g];
                let open = group.iter().enumerate().filter(|&(i, _)| closed >> i & 1 == 0);
                self.set_cone(g, &Cone::around(open.map(|(_, ray)| unit(ray.direction))));
            }
            self.set_ends();
        }
    }

    /// Sets [`Self::ends`] from the cones.
    #[inline(always)]
    fn set_ends(&mut self) {
        for axis in 0..3 {
            let [low, high] = &mut self.ends[axis];
            for g in 0..GROUPS {
                let (middle, reach) = (self.axis[axis][g], self.chord[g]);
                let one_sign = middle.abs() > reach + STEEP;
                low[g] = if one_sign { 1.0 / (middle - reach) } else { f32::NAN };
                high[g] = if one_sign { 1.0 / (middle + reach) } else { f32::NAN };
            }
        }
    }

    fn set_cone(&mut self, g: usize, cone: &Cone) {
        for axis in 0..3 {
            self.axis[axis][g] = cone.axis[axis];
        }
        ([self.cos[g], self.sin[g]], self.chord[g]) = (cone.angle, cone.chord);
    }
}

/// `v`, not 0, at unit length; its squared length may be out of range.
#[inline(always)]
pub(crate) fn unit(v: Vec3) -> Vec3 {
    let v = v / v.abs().max_element();
    v / v.length()
}

/// A cone around directions.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Cone {
    pub(crate) axis: Vec3,
    /// Cosine and sine of a half-angle that is at least the cone's.
    pub(crate) angle: [f32; 2],
    chord: f32,
}

impl Cone {
    /// Around unit vectors.
    #[inline(always)]
    pub(crate) fn around(directions: impl Iterator<Item = Vec3> + Clone) -> Self {
        let axis = directions.clone().sum::<Vec3>().try_normalize().unwrap_or(Vec3::Z);
        let chord = directions.map(|d| d.distance(axis)).fold(0f32, f32::max) + SLACK;
        let half = 0.5 * chord;
        // A wide cone meets everything.
        let narrow = [1.0 - 2.0 * half * half, 2.0 * half * (1.0 - half * half).max(0.0).sqrt()];
        Self { axis, angle: if chord < WIDE { narrow } else { [-1e30, 1.0] }, chord }
    }
}

/// A run of a pattern's rays, [`RAYS`] at most, ready to be turned to receivers.
#[derive(Clone, Debug)]
pub(crate) struct Part {
    /// Number of the first ray.
    pub(crate) first: usize,
    /// Number of rays.
    pub(crate) len: usize,
    /// By axis, in the pattern's frame.
    local: [[f32; RAYS]; 3],
    /// Directions, scaled, are replaced receiver by receiver; all else stays.
    set: RaySet,
    /// Middle of each group in the pattern's frame.
    axes: [[f32; GROUPS]; 3],
    /// At least the length of any ray, world units.
    pub(crate) reach: f32,
    /// Around all rays, in the pattern's frame.
    pub(crate) cone: Cone,
}

/// The runs that a pattern is cut into: halves of halves, as it was ordered. Rays are no longer than `limit`, world units.
pub(crate) fn parts(pattern: &Pattern, radius: f32, limit: f32) -> Vec<Part> {
    let mut parts = Vec::new();
    let lengths: Vec<f32> = pattern.lengths().iter().map(|length| (radius * length).min(limit)).collect();
    cut(pattern, &lengths, 0, pattern.len(), &mut parts);
    parts
}

fn cut(pattern: &Pattern, lengths: &[f32], first: usize, len: usize, parts: &mut Vec<Part>) {
    if len > RAYS {
        let half = Pattern::half(len);
        cut(pattern, lengths, first, half, parts);
        cut(pattern, lengths, first + half, len - half, parts);
    } else {
        parts.push(Part::new(pattern, lengths, first, len));
    }
}

impl Part {
    /// `lengths` of the pattern's rays, world units.
    fn new(pattern: &Pattern, lengths: &[f32], first: usize, len: usize) -> Self {
        let directions = &pattern.directions()[first..first + len];
        let mut part = Self {
            first,
            len,
            local: [[0.0; RAYS]; 3],
            set: RaySet::new(),
            axes: [[0.0; GROUPS]; 3],
            reach: 0.0,
            cone: Cone::around(directions.iter().map(|d| d.normalize())),
        };
        part.set.groups = len / GROUP;
        for (i, (d, &tfar)) in directions.iter().zip(&lengths[first..]).enumerate() {
            for axis in 0..3 {
                part.local[axis][i] = d[axis];
            }
            part.reach = part.reach.max(tfar);
            part.set.far[i] = tfar * 2.0;
            let walks = part.set.far[i] >= f32::MIN_POSITIVE;
            part.set.closed[i / GROUP] &= !(u8::from(walks) << (i % GROUP));
        }
        for (g, group) in directions.chunks(GROUP).enumerate() {
            let cone = Cone::around(group.iter().map(|d| d.normalize()));
            part.set.set_cone(g, &cone);
        }
        part.axes = part.set.axis;
        part
    }

    /// What does not change from receiver to receiver.
    pub(crate) fn begin(&self, rays: &mut RaySet) {
        let (set, n) = (&self.set, self.len);
        rays.far[..n].copy_from_slice(&set.far[..n]);
        rays.unscale[..n].copy_from_slice(&set.unscale[..n]);
        (rays.cos, rays.sin, rays.chord) = (set.cos, set.sin, set.chord);
        (rays.groups, rays.closed) = (set.groups, set.closed);
    }

    /// Turns the directions to `frame`; `rays` must have begun with this part. The arithmetic is that of
    /// [`Pattern::rays_of`].
    #[inline(always)]
    pub(crate) fn turn(&self, frame: &Frame, rays: &mut RaySet) {
        let Frame { tangent, bitangent, normal } = frame;
        let [x, y, z] = &self.local;
        for axis in 0..3 {
            let (t, b, n) = (tangent[axis], bitangent[axis], normal[axis]);
            let row = &mut rays.direction[axis];
            for g in 0..self.set.groups.min(GROUPS) {
                for i in g * GROUP..(g + 1) * GROUP {
                    row[i] = ((t * x[i] + b * y[i]) + n * z[i]) * 0.5;
                }
            }
            let row = &mut rays.axis[axis];
            for (g, x) in row.iter_mut().enumerate() {
                *x = (t * self.axes[0][g] + b * self.axes[1][g]) + n * self.axes[2][g];
            }
        }
        rays.set_ends();
        rays.closed = self.set.closed;
        if rays.invert() {
            rays.close_small();
        }
    }
}
