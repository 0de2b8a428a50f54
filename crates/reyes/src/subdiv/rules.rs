//! Iteration stencils (Djeu 2011, figure 5.2) with semi-sharp creases (DeRose, Kass and Truong 1998).
//!
//! Here: one vertex or edge, from the points around it. Not here: where those come from (`mesh.rs` for whole meshes, `fan.rs`
//! for one-rings), limits (`fan.rs`).

use umbrage_geom::{CreaseMethod, glam::DVec3};

/// Sharpness from which a crease or corner stays sharp for good.
pub const INFINITE_SHARPNESS: f32 = 10.0;

pub(crate) fn is_infinite(sharpness: f32) -> bool {
    sharpness >= INFINITE_SHARPNESS
}

/// Sharpness after a level, by the uniform rule.
pub(crate) fn decay(sharpness: f32) -> f32 {
    if is_infinite(sharpness) { sharpness } else { (sharpness - 1.0).max(0.0) }
}

/// Sharpness after a level of the half of edge `index` next to a vertex, whose edges have the sharpness `all`.
pub(crate) fn child_sharpness(
    all: impl Iterator<Item = f32> + Clone,
    index: usize,
    method: CreaseMethod,
) -> f32 {
    let own = all.clone().nth(index).unwrap_or(0.0);
    if method == CreaseMethod::Chaikin && own > 0.0 && !is_infinite(own) {
        let semi = all.filter(|&s| s > 0.0 && !is_infinite(s));
        let (sum, count) = semi.fold((0.0, 0), |(sum, count), s| (sum + s, count + 1));
        if count > 1 {
            let others = (sum - own) / (count - 1) as f32;
            return (0.75 * own + 0.25 * others - 1.0).max(0.0);
        }
    }
    decay(own)
}

/// Which stencil a vertex follows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum VertexRule {
    /// No more than one sharp edge (one: a dart).
    Smooth,
    /// Sharp edges at these two indices.
    Crease(usize, usize),
    /// Stays where it is.
    Corner,
}

impl VertexRule {
    pub(crate) fn new(sharpness: impl Iterator<Item = f32>, vertex: f32) -> Self {
        if vertex > 0.0 {
            return Self::Corner;
        }
        let mut sharp = sharpness.enumerate().filter(|&(_, s)| s > 0.0).map(|(i, _)| i);
        match (sharp.next(), sharp.next(), sharp.next()) {
            (Some(a), Some(b), None) => Self::Crease(a, b),
            (Some(_), Some(_), Some(_)) => Self::Corner,
            _ => Self::Smooth,
        }
    }
}

/// The edges around a vertex.
pub(crate) trait Star {
    /// Number of edges.
    fn edges(&self) -> usize;
    /// The other end of edge `i`.
    fn neighbour(&self, i: usize) -> DVec3;
    fn sharpness(&self, i: usize) -> f32;
    /// Sum of the new points of all faces.
    fn face_points(&self) -> DVec3;
}

/// Where vertex `v` of sharpness `vertex` goes.
///
/// A vertex whose rule changes with this level takes a mean of both rules' points, weighted by the sharpness that runs out.
pub(crate) fn vertex_point(v: DVec3, vertex: f32, star: &impl Star) -> DVec3 {
    let sharpness = (0..star.edges()).map(|i| star.sharpness(i));
    let apply = |rule: VertexRule| match rule {
        VertexRule::Corner => v,
        VertexRule::Crease(a, b) => 0.75 * v + 0.125 * (star.neighbour(a) + star.neighbour(b)),
        VertexRule::Smooth => {
            let n = star.edges() as f64;
            let edges: DVec3 = (0..star.edges()).map(|i| star.neighbour(i)).sum();
            (v * (n * (n - 2.0)) + edges + star.face_points()) / (n * n)
        }
    };
    let parent = VertexRule::new(sharpness.clone(), vertex);
    let child = VertexRule::new(sharpness.clone().map(decay), decay(vertex));
    if parent == child {
        return apply(parent);
    }
    let running_out = sharpness.chain([vertex]).filter(|&s| s > 0.0 && s < 1.0);
    let (sum, count) = running_out.fold((0.0, 0.0), |(sum, count), s| (sum + f64::from(s), count + 1.0));
    let weight = if count > 0.0 { sum / count } else { 1.0 };
    apply(parent) * weight + apply(child) * (1.0 - weight)
}

/// The point of an edge of the given sharpness between `a` and `b`; `faces` are the new points of its two faces.
pub(crate) fn edge_point(a: DVec3, b: DVec3, sharpness: f32, faces: Option<[DVec3; 2]>) -> DVec3 {
    let middle = 0.5 * (a + b);
    match faces {
        Some([f, g]) if sharpness < 1.0 => {
            let smooth = 0.25 * (a + b + f + g);
            if sharpness > 0.0 { smooth.lerp(middle, f64::from(sharpness)) } else { smooth }
        }
        _ => middle,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn creases_decay_by_the_method() {
        let edges = [0.0, 1.0, 2.0, 3.0, INFINITE_SHARPNESS];
        let children = |edges: &[f32], method| -> Vec<f32> {
            (0..edges.len()).map(|i| child_sharpness(edges.iter().copied(), i, method)).collect()
        };
        assert_eq!(children(&edges, CreaseMethod::Uniform), [0.0, 0.0, 1.0, 2.0, INFINITE_SHARPNESS]);
        // A quarter of the mean of the other two that decay.
        assert_eq!(children(&edges, CreaseMethod::Chaikin), [0.0, 0.375, 1.0, 1.625, INFINITE_SHARPNESS]);
        // An end has nothing to be smoothed with, and nothing is below 0.
        assert_eq!(children(&[0.0, 2.5, 0.0], CreaseMethod::Chaikin), [0.0, 1.5, 0.0]);
        assert_eq!(children(&[0.5, 0.5], CreaseMethod::Chaikin), [0.0, 0.0]);
    }
}
