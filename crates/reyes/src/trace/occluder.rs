//! Opaque cells of closed surfaces: a shadow ray through one is blocked, and nothing is diced (Djeu 2011, section 4.9.2).
//!
//! Cells of a lattice that no patch's box touches lie wholly inside or wholly outside of every tessellation, since those lie
//! within the boxes. A segment from a cell inside to a light outside must cross the tessellation that the ray sees, where
//! that is watertight.

use crate::{Surface, subdiv::NONE};
use umbrage_geom::{Aabb, Ray, glam::DVec3, glam::Vec3, winding_number};

/// Share of a cell, on each side, that a ray must stay clear of to count as inside: far more than rounding.
const CELL_MARGIN: f64 = 1e-3;

/// Levels of preemptive subdivision for the boxes that cells keep clear of.
const BOX_LEVELS: u32 = 2;

/// A lattice of cells known to be inside or outside.
pub(crate) struct OpaqueCells {
    min: DVec3,
    cell: DVec3,
    counts: [usize; 3],
    /// A bit a cell.
    inside: Vec<u64>,
    outside: Vec<u64>,
    pub(crate) opaque: usize,
}

fn bit(bits: &[u64], i: usize) -> bool {
    bits[i / 64] >> (i % 64) & 1 == 1
}

fn set(bits: &mut [u64], i: usize) {
    bits[i / 64] |= 1 << (i % 64);
}

impl OpaqueCells {
    /// With `resolution` cells along the longest side; `None` if the surface is not closed or no cell is inside.
    pub(crate) fn build(surface: &Surface, resolution: u32) -> Option<Self> {
        let closed = surface.patches.iter().all(|p| p.links.iter().flatten().all(|link| link.patch != NONE));
        let bounds = surface.bounds();
        let size = bounds.size().as_dvec3();
        if !closed || size.min_element() <= 0.0 || resolution == 0 {
            return None;
        }
        let wanted = size.max_element() / f64::from(resolution);
        let counts = (size / wanted).to_array().map(|n| n.ceil().max(1.0) as usize);
        let cell = size / DVec3::from(counts.map(|n| n as f64));
        let total: usize = counts.iter().product();
        let empty = vec![0u64; total.div_ceil(64)];
        let min = bounds.min.as_dvec3();
        let mut this = Self { min, cell, counts, inside: empty.clone(), outside: empty.clone(), opaque: 0 };
        let mut known = empty;
        for patch in &surface.patches {
            let bounds = patch.root.tight_bounds(BOX_LEVELS, &surface.context);
            this.for_each_in(&bounds, |i| set(&mut known, i));
        }
        let (coarse, _) = surface.tessellate(|_| [0, 0]).ok()?;
        for start in 0..total {
            if bit(&known, start) {
                continue;
            }
            // All cells connected with this one, found and asked about as one.
            let mut component = vec![start];
            set(&mut known, start);
            let mut next = 0;
            while let Some(&i) = component.get(next) {
                next += 1;
                this.for_each_neighbour(i, |j| {
                    if !bit(&known, j) {
                        set(&mut known, j);
                        component.push(j);
                    }
                });
            }
            let ray = Ray::new(this.center(start).as_vec3(), [0.123, 0.456, 0.789]);
            let triangles = (0..coarse.triangles.len()).map(|t| coarse.triangle(t));
            let is_inside = winding_number(&ray, triangles) != 0;
            for i in component {
                set(if is_inside { &mut this.inside } else { &mut this.outside }, i);
                this.opaque += usize::from(is_inside);
            }
        }
        (this.opaque > 0).then_some(this)
    }

    fn index(&self, [x, y, z]: [usize; 3]) -> usize {
        (z * self.counts[1] + y) * self.counts[0] + x
    }

    fn coordinates(&self, i: usize) -> [usize; 3] {
        [i % self.counts[0], i / self.counts[0] % self.counts[1], i / self.counts[0] / self.counts[1]]
    }

    fn center(&self, i: usize) -> DVec3 {
        self.min + self.cell * DVec3::from(self.coordinates(i).map(|x| x as f64 + 0.5))
    }

    /// Cells that a box touches, one more on each side against rounding.
    fn for_each_in(&self, aabb: &Aabb, mut visit: impl FnMut(usize)) {
        let at = |p: Vec3, axis: usize| (f64::from(p[axis]) - self.min[axis]) / self.cell[axis];
        let range = [0, 1, 2].map(|axis| {
            let first = (at(aabb.min, axis) - CELL_MARGIN).floor().max(0.0) as usize;
            let last = (at(aabb.max, axis) + CELL_MARGIN).floor().max(0.0) as usize;
            first..=last.min(self.counts[axis] - 1)
        });
        for z in range[2].clone() {
            for y in range[1].clone() {
                range[0].clone().for_each(|x| visit(self.index([x, y, z])));
            }
        }
    }

    fn for_each_neighbour(&self, i: usize, mut visit: impl FnMut(usize)) {
        let at = self.coordinates(i);
        for axis in 0..3 {
            for step in [usize::MAX, 1] {
                let mut to = at;
                to[axis] = to[axis].wrapping_add(step);
                if to[axis] < self.counts[axis] {
                    visit(self.index(to));
                }
            }
        }
    }

    /// Whether a point is surely outside of the surface.
    fn is_outside(&self, p: DVec3) -> bool {
        let at = (p - self.min) / self.cell;
        let inside_lattice = (0..3).all(|axis| at[axis] >= 0.0 && at[axis] < self.counts[axis] as f64);
        !inside_lattice || bit(&self.outside, self.index([at.x as usize, at.y as usize, at.z as usize]))
    }

    /// Whether the segment runs through a cell inside and ends outside, so that it must cross the surface.
    pub(crate) fn block(&self, ray: &Ray) -> bool {
        if !ray.is_valid() {
            return false;
        }
        let (origin, d) = (ray.origin.as_dvec3(), ray.direction.as_dvec3());
        let (from, to) = (f64::from(ray.tnear), f64::from(ray.tfar));
        if to.is_finite() && !self.is_outside(origin + d * to) {
            return false;
        }
        // In cells.
        let (o, d) = ((origin - self.min) / self.cell, d / self.cell);
        let (mut t0, mut t1) = (from, to);
        for axis in 0..3 {
            let (a, b) = (-o[axis] / d[axis], (self.counts[axis] as f64 - o[axis]) / d[axis]);
            // `max` and `min` drop NaN.
            (t0, t1) = (t0.max(a.min(b)), t1.min(a.max(b)));
        }
        if t0.partial_cmp(&t1) != Some(std::cmp::Ordering::Less) {
            return false;
        }
        let start = o + d * t0;
        let mut at = [0, 1, 2].map(|axis| (start[axis].max(0.0) as usize).min(self.counts[axis] - 1));
        loop {
            if bit(&self.inside, self.index(at)) && self.passes(o, d, at, t0, t1) {
                return true;
            }
            // To the next cell.
            let exits = [0, 1, 2].map(|axis| {
                let face = at[axis] as f64 + if d[axis] > 0.0 { 1.0 } else { 0.0 };
                if d[axis] == 0.0 { f64::INFINITY } else { (face - o[axis]) / d[axis] }
            });
            let axis = (0..3).fold(0, |best, axis| if exits[axis] < exits[best] { axis } else { best });
            let step = if d[axis] > 0.0 { 1 } else { usize::MAX };
            at[axis] = at[axis].wrapping_add(step);
            if exits[axis] >= t1 || at[axis] >= self.counts[axis] {
                return false;
            }
        }
    }

    /// Whether the segment has points well inside a cell.
    fn passes(&self, o: DVec3, d: DVec3, at: [usize; 3], mut t0: f64, mut t1: f64) -> bool {
        for axis in 0..3 {
            let (low, high) = (at[axis] as f64 + CELL_MARGIN, at[axis] as f64 + 1.0 - CELL_MARGIN);
            if d[axis] == 0.0 {
                if o[axis] <= low || o[axis] >= high {
                    return false;
                }
                continue;
            }
            let (a, b) = ((low - o[axis]) / d[axis], (high - o[axis]) / d[axis]);
            (t0, t1) = (t0.max(a.min(b)), t1.min(a.max(b)));
        }
        t0 < t1
    }

    pub(crate) fn bytes(&self) -> usize {
        size_of_val(&self.inside[..]) + size_of_val(&self.outside[..])
    }
}
