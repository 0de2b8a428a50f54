//! The fan filter one lane at a time, in plain operations.

use super::{
    super::{BlockMask, DEPTH_UNDERFLOW, LANES, LARGEST, Lanes},
    DEPTH_ERROR, EDGE_ERROR, REACH, VOLUME_ERROR,
};
use crate::triangle::plane_side;

/// A block of triangles seen from one origin.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
pub struct Planes {
    /// Normals of the three edges' planes, by axis, lane.
    pub(super) normals: [[[f32; LANES]; 3]; 3],
    /// `E`; infinite where nothing is certain.
    pub(super) error: [f32; LANES],
    /// `T`.
    pub(super) volume: [f32; LANES],
    pub(super) volume_error: [f32; LANES],
    /// `T`, or infinite with its sign where [`Self::ask_sides`] has found that.
    pub(super) side: [f32; LANES],
    /// No hit is further.
    pub(super) reach: [f32; LANES],
    /// Triangles that may be hit, a bit each.
    pub(super) used: u8,
}

fn cross(a: [f32; 3], b: [f32; 3]) -> [f32; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn largest(vectors: [[f32; 3]; 3]) -> f32 {
    vectors.as_flattened().iter().fold(0.0, |m, x| x.abs().max(m))
}

/// See [`Planes::ask_sides`]. By value, so that vectors can stay in registers where this isn't called. Also the lanes where `T`
/// is 0.
#[cold]
pub(super) fn sides(
    mut side: [f32; LANES],
    block: &impl Lanes,
    origin: [f32; 3],
    mut lanes: u8,
) -> ([f32; LANES], u8) {
    let mut on = 0;
    while lanes != 0 {
        let lane = lanes.trailing_zeros() as usize % LANES;
        lanes &= lanes - 1;
        match plane_side(origin.into(), block.triangle(lane)) {
            0 => on |= 1 << lane,
            behind if behind > 0 => side[lane] = f32::NEG_INFINITY,
            _ => side[lane] = f32::INFINITY,
        }
    }
    (side, on)
}

impl Planes {
    pub(super) const EMPTY: Self = {
        let row = [0.0; LANES];
        Self {
            normals: [[row; 3]; 3],
            error: row,
            volume: row,
            volume_error: row,
            side: row,
            reach: row,
            used: 0,
        }
    };

    /// Looks at `block` from the finite point `origin`.
    #[inline]
    pub fn new(block: &impl Lanes, origin: [f32; 3]) -> Self {
        let mut this = Self { used: block.used(), ..Self::EMPTY };
        for lane in 0..LANES {
            let corners = block.triangle(lane);
            let minus = |a: [f32; 3], b: [f32; 3]| [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
            let edges =
                [minus(corners[1], corners[2]), minus(corners[2], corners[0]), minus(corners[0], corners[1])];
            let [a, b, c] = [minus(corners[0], origin), minus(corners[1], origin), minus(corners[2], origin)];
            for (normal, (corner, edge)) in this.normals.iter_mut().zip([c, a, b].into_iter().zip(edges)) {
                for (row, x) in normal.iter_mut().zip(cross(corner, edge)) {
                    row[lane] = x;
                }
            }
            let (far, long) = (largest([a, b, c]), largest(edges));
            let sane = far < LARGEST;
            this.error[lane] =
                if sane { EDGE_ERROR * (far * long) + f32::MIN_POSITIVE } else { f32::INFINITY };
            this.volume[lane] = -dot(a, cross(edges[1], edges[2]));
            this.volume_error[lane] = VOLUME_ERROR * (far * (long * long)) + DEPTH_UNDERFLOW;
            this.reach[lane] = REACH * far;
        }
        this.side = this.volume;
        this
    }

    /// Finds out exactly on which side of the triangles `lanes`, a bit each, `origin` lies: that of the planes, as is `block`.
    /// From then on the planes are for rays that start at their origin (`tnear` 0).
    ///
    /// The plane of a large triangle passes so close to a point on it that `T` is uncertain for all rays from there. Its sign
    /// says whether they leave it behind. Where `T` is 0 none can hit.
    #[inline(always)]
    pub fn ask_sides(&mut self, block: &impl Lanes, origin: [f32; 3], lanes: u8) {
        let on;
        (self.side, on) = sides(self.side, block, origin, lanes);
        self.used &= !on;
    }

    /// Filters the block for one prepared ray from the same origin; see the [module](super).
    #[inline]
    pub fn filter(&self, direction: [f32; 3], near: f32, far: f32) -> BlockMask {
        let mut mask = BlockMask::default();
        for lane in (0..LANES).filter(|lane| self.used >> lane & 1 == 1) {
            match self.hit(lane, direction, near, far) {
                Some(true) => mask.certain |= 1 << lane,
                Some(false) => {}
                None => mask.uncertain |= 1 << lane,
            }
        }
        mask
    }

    /// Filters the triangle in `lane` for eight prepared rays from the same origin that start there (`tnear` 0): one bit a
    /// ray.
    #[inline]
    pub fn filter_rays(&self, lane: usize, direction: [&[f32; LANES]; 3], far: &[f32; LANES]) -> BlockMask {
        let mut mask = BlockMask::default();
        for (i, &far) in far.iter().enumerate() {
            match self.hit(lane, [direction[0][i], direction[1][i], direction[2][i]], 0.0, far) {
                Some(true) => mask.certain |= 1 << i,
                Some(false) => {}
                None => mask.uncertain |= 1 << i,
            }
        }
        mask
    }

    /// Normals of the planes through the origin and the edges, by edge, axis, lane: the direction `d` passes inside edge
    /// `k` of a triangle if all `d . normal` have one sign.
    #[inline(always)]
    pub fn normals(&self) -> &[[[f32; LANES]; 3]; 3] {
        &self.normals
    }

    /// Bound on the error of those products, by lane, for directions whose sizes of components add up to at most 1.
    #[inline(always)]
    pub fn error(&self) -> &[f32; LANES] {
        &self.error
    }

    /// Six times the signed volume between the origin and each triangle, by lane: a ray meets the plane where its parameter
    /// times the sum of the products with [`Self::normals`] is this.
    #[inline(always)]
    pub fn volume(&self) -> &[f32; LANES] {
        &self.volume
    }

    /// Bound on the error of [`Self::volume`].
    #[inline(always)]
    pub fn volume_error(&self) -> &[f32; LANES] {
        &self.volume_error
    }

    /// One bit for each triangle that may be hit.
    #[inline(always)]
    pub fn used(&self) -> u32 {
        self.used.into()
    }

    /// Triangles of which the origin is for certain on the front side, and on the back side, one bit each.
    #[inline(always)]
    pub fn sides(&self) -> (u32, u32) {
        let (mut front, mut back) = (0, 0);
        for lane in 0..LANES {
            // NaN is neither.
            let (volume, error) = (self.volume[lane], self.volume_error[lane]);
            let sane = self.error[lane] < f32::INFINITY;
            front |= u32::from(sane && volume > error) << lane;
            back |= u32::from(sane && volume < -error) << lane;
        }
        (front & self.used(), back & self.used())
    }

    #[inline]
    fn hit(&self, lane: usize, direction: [f32; 3], near: f32, far: f32) -> Option<bool> {
        // Spelled out: `array::map` is a call here, a fifth of the time of scalar rays.
        let edge = |k: usize| {
            let normal = &self.normals[k];
            dot(direction, [normal[0][lane], normal[1][lane], normal[2][lane]])
        };
        let edges = [edge(0), edge(1), edge(2)];
        let error = self.error[lane];
        let positive = [edges[0] > error, edges[1] > error, edges[2] > error];
        let negative = [edges[0] < -error, edges[1] < -error, edges[2] < -error];
        if positive.contains(&true) && negative.contains(&true) {
            return Some(false);
        }
        let side = match (positive, negative) {
            ([true, true, true], _) => 1.0,
            (_, [true, true, true]) => -1.0,
            _ => return None,
        };
        let sum = (edges[0] + edges[1] + edges[2]) * side;
        let relative = 3.1 * error + DEPTH_ERROR * sum;
        // How far beyond `z` for certain, positive or negative; NaN is neither.
        let beyond = |volume: f32, z: f32| (volume * side - z * sum, z * relative + self.volume_error[lane]);
        let (after_near, near_error) = beyond(self.side[lane], near);
        let (after_far, far_error) =
            if self.reach[lane] < far { (-1.0, 0.0) } else { beyond(self.volume[lane], far) };
        if after_near < -near_error || after_far > far_error {
            Some(false)
        } else if after_near > near_error && after_far < -far_error {
            Some(true)
        } else {
            None
        }
    }
}
