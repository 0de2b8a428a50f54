//! Rates by edges that may differ along a patch: DiagSplit (Fisher et al. 2009), for rays.
//!
//! An edge whose parts ask for different rates is split in the middle, and so are the patches on both sides; the question is
//! asked again for each half. An edge is looked at alone, with the same points from both sides, so both sides agree. Where a
//! patch is split in the middle of an edge that stays one segment, the middle moves to an end of it: the diagonal split.
//! Departure: rates are powers of two, as everywhere in this crate.

use crate::{
    mesh::dice::{GridKey, Stitch},
    patch::{Node, QUARTERS},
    rate::length::cell,
    surface::{Meeting, PARAMETER_END},
    trace::RayWalk,
};
use umbrage_geom::{Aabb, glam::Vec3};

/// Levels by which the parts of an edge may differ before it is split.
const MAX_LEVEL_DIFFERENCE: u8 = 0;

/// What an edge asks for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum EdgeRate {
    /// Vertices at the multiples of `2^-level` of the patch. With the depth of the part whose side it is, for lines inside
    /// the patch.
    Uniform(u8, Option<u8>),
    /// Its halves are asked.
    Split,
}

/// A part of a patch.
#[derive(Clone, Copy)]
struct Part {
    patch: u32,
    depth: u8,
    place: [u16; 2],
}

impl Part {
    fn quarter(self, k: usize) -> Self {
        let (a, b) = QUARTERS[k];
        let place = [2 * self.place[0] + a as u16, 2 * self.place[1] + b as u16];
        Self { depth: self.depth + 1, place, ..self }
    }

    fn key(self, levels: [u8; 2], stitch: Stitch) -> GridKey {
        GridKey { patch: self.patch, depth: self.depth, levels, place: self.place, stitch }
    }
}

impl RayWalk<'_, '_> {
    /// Looks for hits on a patch.
    pub(crate) fn diagsplit(&mut self, patch: u32) {
        let part = Part { patch, depth: 0, place: [0, 0] };
        let edges = [0, 1, 2, 3].map(|edge| self.edge_rate(part, edge));
        let tracer = self.tracer;
        self.diagsplit_part(&tracer.surface.patches[patch as usize].root, part, edges);
    }

    /// The rate of border `edge` of a part as the ray sees it.
    fn edge_rate(&mut self, part: Part, edge: usize) -> EdgeRate {
        let tracer = self.tracer;
        let patch = &tracer.surface.patches[part.patch as usize];
        // Parts of polygons are half as large as what they meet: their level 0 counts as 1.
        let unit = u8::from(patch.part.is_some());
        let outer = part.key([0, 0], Stitch::default()).touches(edge);
        if outer && part.depth == 0 && patch.links[edge][0].meeting == Meeting::OtherIsHalf {
            return EdgeRate::Split;
        }
        let points = self.border_points(part, edge);
        let room = tracer.options.max_level.saturating_sub(part.depth + unit);
        let asked = self.segment_levels(points, room);
        let (least, most) = asked.iter().fold((u8::MAX, 0), |(l, m), &a| (l.min(a), m.max(a)));
        // The fourth of an edge that is one segment or two needs no look at its halves.
        if most > least + MAX_LEVEL_DIFFERENCE && most > 2 && room > 2 {
            EdgeRate::Split
        } else {
            // Lines inside a patch keep a vertex between their ends, see `dice.rs`.
            let most = if outer { most } else { most.max(1) };
            EdgeRate::Uniform(part.depth + most, (!outer).then_some(part.depth))
        }
    }

    /// The levels, up to `room`, that each of four segments asks of the whole.
    fn segment_levels(&self, points: [Vec3; 5], room: u8) -> [u8; 4] {
        let ray = &self.whole.ray;
        let (d, origin) = (ray.direction.as_dvec3(), ray.origin.as_dvec3());
        let along = d / d.length_squared();
        let ends = [f64::from(ray.tnear), f64::from(ray.tfar)];
        let points = points.map(|p| p.as_dvec3());
        let places = points.map(|p| (p - origin).dot(along).clamp(ends[0], ends[1]));
        [0, 1, 2, 3].map(|i| {
            let length = 4.0 * points[i].distance(points[i + 1]);
            let width = self.width.least(places[i].min(places[i + 1]), places[i].max(places[i + 1]));
            (0..room).find(|&l| length * cell(l) <= width).unwrap_or(room)
        })
    }

    /// Points at quarters of a border.
    fn border_points(&mut self, part: Part, edge: usize) -> [Vec3; 5] {
        let tracer = self.tracer;
        let key = part.key([0, 0], Stitch::default());
        if part.depth == 0 {
            return tracer.surface.edge_points(part.patch, edge);
        }
        self.state.borders.get((part.patch, part.depth, part.place, edge as u8), || {
            let (corner, size) = key.corner();
            [0, 1, 2, 3, 4]
                .map(|i| tracer.surface.border_position(&key, edge, corner[edge % 2] + i * (size / 4)))
        })
    }

    /// Room for borders that are coarser than the part.
    fn with_coarse_borders(&self, part: Part, edges: [EdgeRate; 4], mut bounds: Aabb) -> Aabb {
        for (edge, rate) in edges.into_iter().enumerate() {
            let EdgeRate::Uniform(level, _) = rate else { continue };
            if level >= part.depth {
                continue;
            }
            let key = part.key([0, 0], Stitch::default());
            let (corner, step) = (key.corner().0[edge % 2], PARAMETER_END >> level);
            let start = corner / step * step;
            for at in [start, start + step] {
                bounds = bounds.with_point(self.tracer.surface.border_position(&key, edge, at));
            }
        }
        bounds
    }

    fn diagsplit_part(&mut self, node: &Node, part: Part, edges: [EdgeRate; 4]) -> bool {
        let tracer = self.tracer;
        let levels = edges.map(|rate| match rate {
            EdgeRate::Uniform(level, _) => Some(level),
            EdgeRate::Split => None,
        });
        let uniform = match levels {
            [Some(bottom), Some(right), Some(top), Some(left)] => {
                Some([bottom.max(top).max(part.depth), right.max(left).max(part.depth)])
            }
            _ => None,
        };
        if let Some(levels) = uniform
            && levels[0].max(levels[1]) <= part.depth + crate::mesh::grid::GRID_LEVEL
        {
            let mut stitch = Stitch::default();
            for (edge, rate) in edges.into_iter().enumerate() {
                let EdgeRate::Uniform(level, line) = rate else { continue };
                let shift = levels[edge % 2] - level;
                stitch = stitch.with(edge, [shift; 2]);
                if let (Some(depth), true) = (line, shift > 0) {
                    stitch = stitch.with_line(edge, depth);
                }
            }
            return self.grid_of(part.key(levels, stitch));
        }
        let parts = [0, 1, 2, 3].map(|k| part.quarter(k));
        // Rates of the four lines between quarters: from the middle to the bottom, right, top and left.
        let inner = match uniform {
            Some([u, v]) => {
                [v, u, v, u].map(|level| EdgeRate::Uniform(level.max(part.depth + 2), Some(part.depth + 1)))
            }
            None => [
                self.edge_rate(parts[0], 1),
                self.edge_rate(parts[1], 2),
                self.edge_rate(parts[3], 1),
                self.edge_rate(parts[0], 2),
            ],
        };
        let [bottom, right, top, left] = inner;
        let half = |this: &mut Self, k: usize, edge: usize| match edges[edge] {
            EdgeRate::Split => this.edge_rate(parts[k], edge),
            uniform => uniform,
        };
        let borders = [
            [half(self, 0, 0), bottom, left, half(self, 0, 3)],
            [half(self, 1, 0), half(self, 1, 1), right, bottom],
            [right, half(self, 2, 1), half(self, 2, 2), top],
            [left, top, half(self, 3, 2), half(self, 3, 3)],
        ];
        let children = node.split(&tracer.surface.context);
        for k in 0..4 {
            let bounds = self.with_coarse_borders(parts[k], borders[k], children[k].bounds);
            if self.ray.slab.entry(&bounds, self.ray.slab.tfar).is_some()
                && self.diagsplit_part(&children[k], parts[k], borders[k])
            {
                return true;
            }
        }
        false
    }
}
