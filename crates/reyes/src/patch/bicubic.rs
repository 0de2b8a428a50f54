//! Regular patches: uniform bicubic B-splines.

use umbrage_geom::{
    Aabb,
    glam::{DVec3, Vec3},
};

/// A bicubic B-spline over `[0, 1] x [0, 1]`, `points[j][i]` with `i` along `u` and `j` along `v`; rows and columns 1 and
/// 2 belong to the face itself.
#[derive(Clone, Debug, PartialEq)]
pub struct Bicubic {
    /// Control points, world units.
    pub points: [[Vec3; 4]; 4],
}

/// Uniform cubic B-spline weights at `t` in `[0, 1]`, rounded once from `f64`.
pub(crate) fn weights(t: f64) -> [f32; 4] {
    let s = 1.0 - t;
    let tt = t * t;
    [
        s * s * s / 6.0,
        (3.0 * tt * t - 6.0 * tt + 4.0) / 6.0,
        (3.0 * (t + tt - tt * t) + 1.0) / 6.0,
        tt * t / 6.0,
    ]
    .map(|w| w as f32)
}

fn slopes(t: f64) -> [f32; 4] {
    let s = 1.0 - t;
    [-0.5 * s * s, 1.5 * t * t - 2.0 * t, 0.5 + t - 1.5 * t * t, 0.5 * t * t].map(|w| w as f32)
}

fn combine(points: [Vec3; 4], w: [f32; 4]) -> Vec3 {
    ((points[0] * w[0] + points[1] * w[1]) + points[2] * w[2]) + points[3] * w[3]
}

/// Bounds on how fast a surface moves along its parameters, world units for a whole patch.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Speeds {
    /// Largest `|S_u|`.
    pub(crate) u: f64,
    /// Largest `|S_v|`.
    pub(crate) v: f64,
    /// Largest `|S_u . S_v|`.
    pub(crate) dot: f64,
    /// Largest `|S_uu|`, `|S_uv|`, `|S_vv|`.
    pub(crate) bends: [f64; 3],
}

impl Speeds {
    pub(crate) fn max(self, other: Self) -> Self {
        Self {
            u: self.u.max(other.u),
            v: self.v.max(other.v),
            dot: self.dot.max(other.dot),
            bends: [0, 1, 2].map(|i| self.bends[i].max(other.bends[i])),
        }
    }

    /// The same of a patch of which this one is a part, `2^depth` times as small.
    pub(crate) fn of_whole(self, depth: u8) -> Self {
        let scale = 2f64.powi(depth.into());
        Self {
            u: self.u * scale,
            v: self.v * scale,
            dot: self.dot * scale * scale,
            bends: self.bends.map(|b| b * scale * scale),
        }
    }

    /// Bound on the distance of cells, as pairs of triangles, from the surface at the same parameters.
    pub(crate) fn deviation(&self, levels: [u8; 2]) -> f64 {
        let [a, b] = levels.map(crate::rate::length::cell);
        0.125 * (a * a * self.bends[0] + 2.0 * a * b * self.bends[1] + b * b * self.bends[2])
    }

    /// Bound on the longest edge, both diagonals included, of cells of `2^-levels[0]` by `2^-levels[1]`.
    pub(crate) fn longest(&self, levels: [u8; 2]) -> f64 {
        let [a, b] = levels.map(crate::rate::length::cell);
        let (u, v) = (self.u * a, self.v * b);
        (u * u + v * v + 2.0 * self.dot * a * b).sqrt().max(u).max(v)
    }
}

impl Bicubic {
    /// The four control points of the curve at constant `v`, given its weights.
    pub(crate) fn curve(&self, w: [f32; 4]) -> [Vec3; 4] {
        [0, 1, 2, 3].map(|i| combine([0, 1, 2, 3].map(|j| self.points[j][i]), w))
    }

    /// Position at `(u, v)`.
    pub fn position(&self, u: f64, v: f64) -> Vec3 {
        combine(self.curve(weights(v)), weights(u))
    }

    /// Derivatives by `u` and by `v`.
    pub fn derivatives(&self, u: f64, v: f64) -> [Vec3; 2] {
        [combine(self.curve(weights(v)), slopes(u)), combine(self.curve(slopes(v)), weights(u))]
    }

    /// The halves `u < 1/2` and `u > 1/2`, each over `[0, 1] x [0, 1]` again.
    pub fn split_u(&self) -> [Self; 2] {
        let rows = self.points.map(split_curve);
        [0, 1].map(|side| Self { points: [0, 1, 2, 3].map(|j| rows[j][side]) })
    }

    /// The halves `v < 1/2` and `v > 1/2`.
    pub fn split_v(&self) -> [Self; 2] {
        let columns = self.transposed().points.map(split_curve);
        [0, 1].map(|side| Self { points: [0, 1, 2, 3].map(|i| columns[i][side]) }.transposed())
    }

    fn transposed(&self) -> Self {
        Self { points: [0, 1, 2, 3].map(|i| [0, 1, 2, 3].map(|j| self.points[j][i])) }
    }

    /// The quarters, in the order of corners: `(0, 0)`, `(1, 0)`, `(1, 1)`, `(0, 1)`.
    pub(crate) fn split(&self) -> [Self; 4] {
        let [low, high] = self.split_v();
        let [a, b] = low.split_u();
        let [d, c] = high.split_u();
        [a, b, c, d]
    }

    /// Box of the control points: holds the surface but for rounding.
    pub fn hull(&self) -> Aabb {
        self.points.as_flattened().iter().fold(Aabb::EMPTY, |b, &p| b.with_point(p))
    }

    /// Box of the Bezier control points: holds the surface but for rounding, and is smaller than the hull.
    pub fn bezier_hull(&self) -> Aabb {
        let bezier = |p: [Vec3; 4]| {
            let (a, b) = ((2.0 * p[1] + p[2]) / 3.0, (p[1] + 2.0 * p[2]) / 3.0);
            let start = 0.5 * ((p[0] + 2.0 * p[1]) / 3.0 + a);
            let end = 0.5 * (b + (2.0 * p[2] + p[3]) / 3.0);
            [start, a, b, end]
        };
        let rows = Self { points: self.points.map(bezier) }.transposed();
        Self { points: rows.points.map(bezier) }.hull()
    }

    /// Bounds on the derivatives over the whole patch, from differences of control points after `splits` splits.
    ///
    /// `S_u` is a convex combination of differences along rows. Taking one de Boor step along `v`, it and `S_v` are
    /// combinations, with the same weights, of the differences along the sides of each of the nine cells of the net.
    pub(crate) fn speeds(&self, splits: u32) -> Speeds {
        if splits > 0 {
            let parts = self.split().map(|part| part.speeds(splits - 1));
            let worst = parts.into_iter().fold(Speeds::default(), Speeds::max);
            return worst.of_whole(1);
        }
        let p = self.points.map(|row| row.map(|p| p.as_dvec3()));
        let mut worst = Speeds::default();
        for j in 0..3 {
            for i in 0..3 {
                let along = [p[j][i + 1] - p[j][i], p[j + 1][i + 1] - p[j + 1][i]];
                let across = [p[j + 1][i] - p[j][i], p[j + 1][i + 1] - p[j][i + 1]];
                for a in along {
                    worst.u = worst.u.max(a.length());
                    for b in across {
                        worst.v = worst.v.max(b.length());
                        worst.dot = worst.dot.max(a.dot(b).abs());
                    }
                }
                worst.bends[1] = worst.bends[1].max((along[1] - along[0]).length());
            }
        }
        let bend = |p: [DVec3; 3]| (p[0] - 2.0 * p[1] + p[2]).length();
        for (i, j) in (0..4).flat_map(|j| [(0, j), (1, j)]) {
            worst.bends[0] = worst.bends[0].max(bend([p[j][i], p[j][i + 1], p[j][i + 2]]));
            worst.bends[2] = worst.bends[2].max(bend([p[i][j], p[i + 1][j], p[i + 2][j]]));
        }
        worst
    }

    /// Largest coordinate in size.
    pub(crate) fn magnitude(&self) -> f32 {
        self.points.as_flattened().iter().fold(0.0, |m, p| m.max(p.abs().max_element()))
    }

    pub(crate) fn from_doubles(points: [[DVec3; 4]; 4]) -> Self {
        Self { points: points.map(|row| row.map(|p| p.as_vec3())) }
    }
}

/// Control points of both halves of a curve.
fn split_curve(p: [Vec3; 4]) -> [[Vec3; 4]; 2] {
    let edge = |i: usize| 0.5 * (p[i] + p[i + 1]);
    let vertex = |i: usize| 0.125 * (p[i - 1] + p[i + 1]) + 0.75 * p[i];
    let (a, b, c, d, e) = (edge(0), vertex(1), edge(1), vertex(2), edge(2));
    [[a, b, c, d], [b, c, d, e]]
}
