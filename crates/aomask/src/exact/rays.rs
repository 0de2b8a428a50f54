//! Up to 256 rays of one origin, and the cones around groups of eight of them.
//!
//! Here: the prepared rays and how a pattern's rays get there. Directions are scaled by a power of two so that the sizes of
//! their components add up to about 1/2 to 1, as [`umbrage_geom::kernel::fan`] wants it.

use super::walk::MAX_GROUPS_OF_SINGLE_RAYS;
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
const UNIT_VECTOR_ERROR: f32 = 4e-6;

/// Chord from which a cone is no longer told from a half-space: about 83 degrees.
const HALF_SPACE_CHORD: f32 = 1.33;

/// Components of unit vectors as small as this have no use for a group: their reciprocals say too little.
const MIN_UNIT_COMPONENT: f32 = 1e-4;

/// Smallest component of a scaled direction, but 0, whose reciprocal is safe: `2^-79`.
const MIN_SCALED_COMPONENT: f32 = 1.0 / (1u128 << 79) as f32;

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
        least.into_iter().any(|x| x < MIN_SCALED_COMPONENT)
    }

    /// Closes rays that can't walk.
    #[cold]
    fn close_small(&mut self) {
        for i in 0..self.groups * GROUP {
            let small = self.direction.iter().any(|row| row[i] != 0.0 && row[i].abs() < MIN_SCALED_COMPONENT);
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
        if self.groups > MAX_GROUPS_OF_SINGLE_RAYS as usize {
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
                let one_sign = middle.abs() > reach + MIN_UNIT_COMPONENT;
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
#[derive(Clone, Copy, Debug, PartialEq)]
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
        let chord = directions.map(|d| d.distance(axis)).fold(0f32, f32::max) + UNIT_VECTOR_ERROR;
        let half = 0.5 * chord;
        // A wide cone meets everything.
        let narrow = [1.0 - 2.0 * half * half, 2.0 * half * (1.0 - half * half).max(0.0).sqrt()];
        Self { axis, angle: if chord < HALF_SPACE_CHORD { narrow } else { [-1e30, 1.0] }, chord }
    }
}

/// A run of a pattern's rays, [`RAYS`] at most, by member, in the pattern's frame.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Shape {
    /// Number of the first ray.
    first: usize,
    /// Number of rays.
    len: usize,
    members: Box<[Member]>,
}

/// The directions of one member.
#[derive(Clone, Debug, PartialEq)]
struct Member {
    /// By axis, one row after the other.
    local: Box<[f32]>,
    /// Middle of each group.
    axes: [[f32; GROUPS]; 3],
    /// Cosine of each group's half-angle, or less.
    cos: [f32; GROUPS],
    /// Sine of each group's half-angle; the angle may be larger than it is.
    sin: [f32; GROUPS],
    /// At least the distance of any unit direction of the group from its axis.
    chord: [f32; GROUPS],
    /// Around all rays.
    cone: Cone,
}

impl Member {
    fn new(directions: &[Vec3]) -> Self {
        let row = [0.0; GROUPS];
        let mut member = Self {
            local: (0..3).flat_map(|axis| directions.iter().map(move |d| d[axis])).collect(),
            axes: [row; 3],
            cos: row,
            sin: row,
            chord: row,
            cone: Cone::around(directions.iter().map(|d| d.normalize())),
        };
        for (g, group) in directions.chunks(GROUP).enumerate() {
            let cone = Cone::around(group.iter().map(|d| d.normalize()));
            for axis in 0..3 {
                member.axes[axis][g] = cone.axis[axis];
            }
            ([member.cos[g], member.sin[g]], member.chord[g]) = (cone.angle, cone.chord);
        }
        member
    }
}

/// The runs that a pattern is cut into: halves of halves, as it was ordered.
pub(crate) fn shapes(pattern: &Pattern) -> Box<[Shape]> {
    let mut shapes = Vec::new();
    cut(pattern, 0, pattern.len(), &mut shapes);
    shapes.into()
}

fn cut(pattern: &Pattern, first: usize, len: usize, shapes: &mut Vec<Shape>) {
    if len > RAYS {
        let half = Pattern::half(len);
        cut(pattern, first, half, shapes);
        cut(pattern, first + half, len - half, shapes);
    } else {
        let member = |number| Member::new(&pattern.directions(number)[first..first + len]);
        shapes.push(Shape { first, len, members: (0..pattern.members()).map(member).collect() });
    }
}

/// Ends of the rays of a run.
#[derive(Clone, Debug)]
struct Ends {
    /// In units of scaled directions, by ray.
    far: Box<[f32]>,
    /// Bits without a ray, or with a ray too short to walk.
    closed: [u8; GROUPS],
    /// At least the length of any ray, world units.
    reach: f32,
}

impl Ends {
    /// Of rays with the given lengths, world units.
    fn new(lengths: impl Iterator<Item = f32> + Clone) -> Self {
        let far: Box<[f32]> = lengths.clone().map(|tfar| tfar * 2.0).collect();
        let mut closed = [u8::MAX; GROUPS];
        for (i, &far) in far.iter().enumerate() {
            closed[i / GROUP] &= !(u8::from(far >= f32::MIN_POSITIVE) << (i % GROUP));
        }
        Self { far, closed, reach: lengths.fold(0.0, f32::max) }
    }
}

/// A run of a pattern's rays with their lengths, ready to be turned to receivers.
pub(crate) struct Part<'p> {
    shape: &'p Shape,
    /// By member, or one for all.
    ends: Vec<Ends>,
}

/// The runs of `pattern`. Rays are no longer than `limit`, world units.
pub(crate) fn parts(pattern: &Pattern, radius: f32, limit: f32) -> Vec<Part<'_>> {
    let runs = if pattern.has_shared_lengths() { 1 } else { pattern.members() };
    let part = |shape| {
        let &Shape { first, len, .. } = shape;
        let ends = |member| {
            let lengths = pattern.lengths(member)[first..first + len].iter();
            Ends::new(lengths.map(|length| (radius * length).min(limit)))
        };
        Part { shape, ends: (0..runs).map(ends).collect() }
    };
    pattern.shapes().iter().map(part).collect()
}

impl Part<'_> {
    /// Number of the first ray.
    #[inline(always)]
    pub(crate) fn first(&self) -> usize {
        self.shape.first
    }

    /// Number of rays.
    #[inline(always)]
    pub(crate) fn len(&self) -> usize {
        self.shape.len
    }

    #[inline(always)]
    fn ends(&self, member: usize) -> &Ends {
        &self.ends[member % self.ends.len()]
    }

    /// At least the length of any ray of `member`, world units.
    #[inline(always)]
    pub(crate) fn reach(&self, member: usize) -> f32 {
        self.ends(member).reach
    }

    /// Cone around all rays of `member`, in the pattern's frame.
    #[inline(always)]
    pub(crate) fn cone(&self, member: usize) -> &Cone {
        &self.shape.members[member].cone
    }

    /// Whether members differ in the lengths of their rays.
    #[inline(always)]
    pub(crate) fn has_many_ends(&self) -> bool {
        self.ends.len() > 1
    }

    /// What does not change from receiver to receiver, nor, unless [`Self::has_many_ends`], from member to member.
    pub(crate) fn begin(&self, member: usize, rays: &mut RaySet) {
        let (ends, n) = (self.ends(member), self.len());
        rays.far[..n].copy_from_slice(&ends.far);
        rays.unscale[..n].fill(2.0);
        (rays.groups, rays.closed) = (n / GROUP, ends.closed);
    }

    /// Turns the directions of `member` to `frame`; `rays` must have begun with this part. The arithmetic is that of
    /// [`Pattern::rays_of`].
    #[inline(always)]
    pub(crate) fn turn(&self, member: usize, frame: &Frame, rays: &mut RaySet) {
        let Frame { tangent, bitangent, normal } = frame;
        let (len, member_) = (self.len(), &self.shape.members[member]);
        let (x, rest) = member_.local.split_at(len);
        let (y, z) = rest.split_at(len);
        for axis in 0..3 {
            let (t, b, n) = (tangent[axis], bitangent[axis], normal[axis]);
            let row = rays.direction[axis].chunks_exact_mut(GROUP);
            let local = x.chunks_exact(GROUP).zip(y.chunks_exact(GROUP).zip(z.chunks_exact(GROUP)));
            for (row, (x, (y, z))) in row.zip(local) {
                for i in 0..GROUP {
                    row[i] = ((t * x[i] + b * y[i]) + n * z[i]) * 0.5;
                }
            }
            let row = &mut rays.axis[axis];
            for (g, x) in row.iter_mut().enumerate() {
                *x = (t * member_.axes[0][g] + b * member_.axes[1][g]) + n * member_.axes[2][g];
            }
        }
        (rays.cos, rays.sin, rays.chord) = (member_.cos, member_.sin, member_.chord);
        rays.set_ends();
        rays.closed = self.ends(member).closed;
        if rays.invert() {
            rays.close_small();
        }
    }
}
