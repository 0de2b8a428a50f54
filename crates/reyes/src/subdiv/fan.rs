//! A vertex with the quadrilaterals around it: refinement of that alone, its limit position and tangents.

use super::{
    CreaseMethod,
    rules::{self, Star, VertexRule, child_sharpness, decay, is_infinite},
};
use std::{borrow::Cow, f64::consts::PI};
use umbrage_geom::glam::DVec3;

/// A dart is refined until its one-ring is this small, but no more than so many levels: the smooth stencil moves its center
/// by less.
const DART_SIZE: f64 = 1e-8;
const DART_LEVELS: u32 = 200;

/// Levels after which edges of a corner hardly turn.
const CORNER_LEVELS: u32 = 100;

/// An edge from the center of a fan, and the face that follows it counter-clockwise.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Spoke {
    /// The other end of the edge.
    pub(crate) edge: DVec3,
    /// The corner of the face opposite the center; not used in the last spoke of an open fan.
    pub(crate) diagonal: DVec3,
    pub(crate) sharpness: f32,
}

/// All quadrilaterals around a vertex, counter-clockwise. A closed fan has a face for each edge, an open one a face less.
#[derive(Clone, Debug)]
pub(crate) struct Fan {
    pub(crate) center: DVec3,
    pub(crate) sharpness: f32,
    pub(crate) closed: bool,
    pub(crate) spokes: Box<[Spoke]>,
}

impl Star for Fan {
    fn edges(&self) -> usize {
        self.spokes.len()
    }

    fn neighbour(&self, i: usize) -> DVec3 {
        self.spokes[i].edge
    }

    fn sharpness(&self, i: usize) -> f32 {
        self.spokes[i].sharpness
    }

    fn face_points(&self) -> DVec3 {
        (0..self.faces()).map(|i| self.face_point(i)).sum()
    }
}

impl Fan {
    /// A closed fan of smooth edges, all but `sharpness` in turn.
    pub(crate) fn closed(center: DVec3, around: [(DVec3, f32, DVec3); 4]) -> Self {
        let spokes = around.map(|(edge, sharpness, diagonal)| Spoke { edge, sharpness, diagonal });
        Self { center, sharpness: 0.0, closed: true, spokes: Box::new(spokes) }
    }

    pub(crate) fn faces(&self) -> usize {
        if self.closed { self.spokes.len() } else { self.spokes.len() - 1 }
    }

    /// Spoke `i` of a closed fan in any turn.
    pub(crate) fn spoke(&self, i: usize) -> &Spoke {
        &self.spokes[i % self.spokes.len()]
    }

    /// Index of the face before face `i`, clockwise; `None` at the end of an open fan.
    pub(crate) fn before(&self, i: usize) -> Option<usize> {
        match i {
            0 if !self.closed => None,
            0 => Some(self.spokes.len() - 1),
            _ => Some(i - 1),
        }
    }

    /// Index of the face after face `i`, counter-clockwise; `None` at the end of an open fan.
    pub(crate) fn after(&self, i: usize) -> Option<usize> {
        if i + 1 < self.faces() { Some(i + 1) } else { self.closed.then_some(0) }
    }

    fn face_point(&self, i: usize) -> DVec3 {
        let (a, b) = (&self.spokes[i], self.spoke(i + 1));
        0.25 * (self.center + a.edge + a.diagonal + b.edge)
    }

    fn sharpnesses(&self) -> impl Iterator<Item = f32> + Clone {
        self.spokes.iter().map(|s| s.sharpness)
    }

    pub(crate) fn rule(&self) -> VertexRule {
        VertexRule::new(self.sharpnesses(), self.sharpness)
    }

    /// The fan after one level.
    pub(crate) fn refine(&self, method: CreaseMethod) -> Self {
        let faces = self.faces();
        let spokes = self.spokes.iter().enumerate().map(|(i, spoke)| {
            let diagonal = if i < faces { self.face_point(i) } else { DVec3::NAN };
            let around = self.before(i).filter(|_| i < faces).map(|b| [self.face_point(b), diagonal]);
            Spoke {
                edge: rules::edge_point(self.center, spoke.edge, spoke.sharpness, around),
                diagonal,
                sharpness: child_sharpness(self.sharpnesses(), i, method),
            }
        });
        Self {
            center: rules::vertex_point(self.center, self.sharpness, self),
            sharpness: decay(self.sharpness),
            closed: self.closed,
            spokes: spokes.collect(),
        }
    }

    /// Whether some sharpness is still to decay.
    fn is_semi_sharp(&self) -> bool {
        let semi = |s: f32| s > 0.0 && !is_infinite(s);
        !is_infinite(self.sharpness) && (semi(self.sharpness) || self.sharpnesses().any(semi))
    }

    /// Whether one edge alone is sharp: then the center follows the smooth rule and that edge does not, and no stencil in
    /// closed form has the limit.
    fn is_dart(&self) -> bool {
        self.sharpness == 0.0 && self.sharpnesses().filter(|&s| s > 0.0).count() == 1
    }

    /// Refined until no sharpness is left to decay, and a dart until it stands still.
    fn settled(&self, method: CreaseMethod) -> Cow<'_, Self> {
        let mut fan = Cow::Borrowed(self);
        while fan.is_semi_sharp() {
            fan = Cow::Owned(fan.refine(method));
        }
        if fan.is_dart() {
            let size =
                |fan: &Self| fan.spokes.iter().map(|s| s.edge.distance(fan.center)).fold(0.0, f64::max);
            let still = size(&fan) * DART_SIZE;
            for _ in 0..DART_LEVELS {
                if size(&fan) <= still {
                    break;
                }
                fan = Cow::Owned(fan.refine(method));
            }
        }
        fan
    }

    /// Limit position (Djeu 2011, figure 5.3).
    pub(crate) fn limit(&self, method: CreaseMethod) -> DVec3 {
        let fan = self.settled(method);
        match fan.rule() {
            VertexRule::Corner => fan.center,
            VertexRule::Crease(a, b) => (4.0 * fan.center + fan.spokes[a].edge + fan.spokes[b].edge) / 6.0,
            VertexRule::Smooth => {
                let n = fan.spokes.len() as f64;
                let around: DVec3 = fan.spokes.iter().map(|s| 4.0 * s.edge + s.diagonal).sum();
                (n * n * fan.center + around) / (n * (n + 5.0))
            }
        }
    }

    /// Two limit tangents of the side that face `face` lies on, of no particular length, with their cross product to the
    /// front (Djeu 2011, figure 5.4).
    ///
    /// Departures: a crease with one face has no tangent across; there the corner's own plane is the limit. The figure's
    /// stencil across a crease belongs to an iteration stencil of eigenvalue 1/2; ours is that of the iteration in use, and
    /// the same for two faces. (With five and more faces on a side the limit has no tangent plane at the vertex; the one
    /// returned holds the crease.)
    pub(crate) fn tangents(&self, face: usize, method: CreaseMethod) -> [DVec3; 2] {
        let fan = self.settled(method);
        match fan.rule() {
            VertexRule::Corner => fan.corner_tangents(face, method),
            VertexRule::Crease(a, b) => fan.crease_tangents(face, a, b),
            VertexRule::Smooth => fan.smooth_tangents(face),
        }
    }

    /// Tangents of the edges of face `face` at a corner. Smooth edges there turn from level to level, ever less.
    fn corner_tangents(&self, face: usize, method: CreaseMethod) -> [DVec3; 2] {
        let is_smooth = self.sharpnesses().any(|s| s == 0.0);
        // Around the origin, where ever shorter edges keep their precision.
        let mut turned = self.clone();
        turned.center = DVec3::ZERO;
        for spoke in &mut turned.spokes {
            spoke.edge -= self.center;
            spoke.diagonal -= self.center;
        }
        for _ in 0..if is_smooth { CORNER_LEVELS } else { 0 } {
            turned = turned.refine(method);
        }
        [face, face + 1].map(|i| turned.spoke(i).edge - turned.center)
    }

    /// Tangents roughly along the edges before and after face `face`.
    fn smooth_tangents(&self, face: usize) -> [DVec3; 2] {
        let n = self.spokes.len() as f64;
        let cosine = |i: f64| (2.0 * PI * i / n).cos();
        let c0 = 1.0 + cosine(1.0) + (PI / n).cos() * (2.0 * (9.0 + cosine(1.0))).sqrt();
        // The second tangent is the first, a step further round.
        [0.0, 1.0].map(|turn| {
            let terms = self.spokes.iter().enumerate().map(|(i, spoke)| {
                let i = i as f64 - face as f64 - turn;
                c0 * cosine(i) * spoke.edge + (cosine(i) + cosine(i + 1.0)) * spoke.diagonal
            });
            terms.sum()
        })
    }

    /// Tangents at a vertex with sharp edges `a` < `b`, on the side of face `face`.
    fn crease_tangents(&self, face: usize, a: usize, b: usize) -> [DVec3; 2] {
        // The side runs counter-clockwise from `first` to `last`.
        let (first, last) = if (a..b).contains(&face) { (a, b) } else { (b, a) };
        let count = self.spokes.len();
        let faces = (last + count - first) % count;
        let (start, end) = (self.spokes[first].edge, self.spokes[last].edge);
        if faces < 2 {
            return [start - self.center, end - self.center];
        }
        let step = PI / faces as f64;
        let edge = |i: usize| (step * i as f64).sin();
        // Subdominant eigenvalue of the iteration stencil, less 1/4.
        let c = (1.0 + step.cos()) / 8.0;
        let mu = 0.5 * (c + (c * c + c).sqrt());
        let face = |i: usize| (edge(i) + edge(i + 1)) / (16.0 * mu);
        let sum = (0..faces).map(|i| edge(i) + face(i)).sum::<f64>();
        let crease = (edge(1) / 16.0 + face(0) / 4.0 - sum / 8.0) / mu;
        let mut across = (start + end) * crease - self.center * (2.0 * crease + sum);
        for i in 0..faces {
            let spoke = self.spoke(first + i);
            across += edge(i) * spoke.edge + face(i) * spoke.diagonal;
        }
        [start - end, across]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::subdiv::INFINITE_SHARPNESS;

    fn fan(edges: usize, closed: bool, sharpness: impl Fn(usize) -> f32) -> Fan {
        let spoke = |i: usize| {
            let angle = PI * i as f64 / edges as f64 * if closed { 2.0 } else { 1.0 };
            let at = |r: f64, turn: f64| {
                let (y, x) = (angle + turn).sin_cos();
                DVec3::new(r * x, r * y, (3.0 * i as f64 + r).sin() * 0.4)
            };
            Spoke { edge: at(1.0, 0.0), diagonal: at(1.4, PI / edges as f64), sharpness: sharpness(i) }
        };
        let center = DVec3::new(0.1, -0.05, 0.3);
        Fan { center, sharpness: 0.0, closed, spokes: (0..edges).map(spoke).collect() }
    }

    /// Every valence and rule: the stencil is where refinement alone ends up, and tangents span its plane.
    #[test]
    fn limits_are_where_refinement_goes() {
        let mut fans = Vec::new();
        for edges in [2, 3, 4, 5, 7, 12, 60] {
            fans.push(fan(edges, true, |_| 0.0));
            fans.push(fan(edges, true, |i| if i == 1 { INFINITE_SHARPNESS } else { 0.0 }));
            fans.push(fan(edges, true, |i| if i % 3 == 0 { 2.6 } else { 0.0 }));
            let half = edges / 2;
            fans.push(fan(edges, true, |i| if i == 0 || i == half { INFINITE_SHARPNESS } else { 0.0 }));
            fans.push(fan(edges, false, |i| if i == 0 || i == edges - 1 { INFINITE_SHARPNESS } else { 0.0 }));
        }
        let mut corner = fan(5, true, |_| 0.0);
        corner.sharpness = INFINITE_SHARPNESS;
        fans.push(corner.clone());
        corner.sharpness = 1.3;
        fans.push(corner);
        for (index, fan) in fans.iter().enumerate() {
            let levels = (0..70).scan(fan.clone(), |fan, _| {
                *fan = fan.refine(CreaseMethod::Uniform);
                Some(fan.clone())
            });
            let levels: Vec<Fan> = levels.collect();
            let limit = fan.limit(CreaseMethod::Uniform);
            let off = limit.distance(levels[69].center);
            assert!(off < 1e-7, "fan {index}: {off:e}");
            // Chords of a fine fan, seen against the tangent plane, as long as rounding leaves them.
            if fan.spokes.len() == 2 || fan.spokes.len() > 12 {
                continue;
            }
            let late = &levels[if fan.sharpness > 0.0 { 45 } else { 28 }];
            for face in 0..fan.faces() {
                let [a, b] = fan.tangents(face, CreaseMethod::Uniform);
                let normal = a.cross(b).normalize();
                for i in [face, face + 1] {
                    let chord = (late.spoke(i).edge - limit).normalize();
                    // High valences and single faces converge slowly, or have no tangent plane.
                    let slow = if fan.spokes.len() > 5 || fan.faces() == 1 { 0.5 } else { 2e-3 };
                    assert!(chord.dot(normal).abs() < slow, "fan {index}: {}", chord.dot(normal));
                }
            }
        }
    }
}
