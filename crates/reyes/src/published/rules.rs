//! Rules by which others set rates: final approach, plain and exact (Djeu 2011, sections 6.9 and 6.10), and the edges of patches
//! (Owens et al. 2002). Their names are variants of [`FootprintRule`]; edges that are split are in `diagsplit.rs`.

use crate::{
    FootprintRule, Surface, SurfaceTracer,
    mesh::grid::GridRay,
    patch::{Children, Node},
    rate::{footprint::Width, length::cell},
    subdiv::NONE,
    surface::Meeting,
};
use std::sync::Arc;
use umbrage_geom::{Ray, intersect_triangle};

/// Parts that exact final approach keeps open at most.
const MAX_FRONTIER: usize = 64;

impl SurfaceTracer {
    /// The rate of an edge as the ray sees it: the same for both patches, in levels of the patch.
    pub(crate) fn edge_level(&self, patch: u32, edge: usize, ray: &GridRay, width: &Width) -> u8 {
        let own = &self.surface.patches[patch as usize];
        let link = own.links[edge][0];
        match link.meeting {
            // Halves of an edge agree with the whole.
            Meeting::OwnIsHalf { .. } if link.patch != NONE => {
                return self.edge_level(link.patch, usize::from(link.edge), ray, width).max(1) - 1;
            }
            _ => {}
        }
        let d = ray.ray.direction.as_dvec3();
        let along = d / d.length_squared();
        let origin = ray.ray.origin.as_dvec3();
        let points = self.surface.edge_points(patch, edge).map(|p| p.as_dvec3());
        let least = own.least_level();
        let projected = self.options.footprint == FootprintRule::ProjectedEdges;
        let segments = [0, 1, 2, 3].map(|i| points[i + 1] - points[i]);
        let longest = segments.map(|s| if projected { (s - s.dot(along) * d).length() } else { s.length() });
        let longest = longest.into_iter().fold(0.0, f64::max) * segments.len() as f64;
        // The narrowest footprint beside the edge.
        let (mut from, mut to) = (f64::INFINITY, f64::NEG_INFINITY);
        for p in points {
            let t = (p - origin).dot(along).clamp(ray.ray.tnear.into(), ray.ray.tfar.into());
            (from, to) = (from.min(t), to.max(t));
        }
        let width = width.least(from, to);
        if width.is_nan() || width <= 0.0 {
            return self.options.max_level.max(least);
        }
        let fits = |&l: &u8| longest * cell(l) <= width;
        (least..self.options.max_level.max(least)).find(fits).unwrap_or(self.options.max_level.max(least))
    }

    /// Where the ray meets the two triangles between the corners of a patch first and last: a ray that diverges is narrowest at
    /// the first, one that converges at the last (Djeu 2011, section 6.8).
    pub(crate) fn coarse_hits(&self, patch: u32, ray: &Ray) -> Option<[f64; 2]> {
        let [a, b, c, d] = [0, 1, 2, 3].map(|k| self.surface.corner(patch, k).to_array());
        let hits = [[a, b, c], [a, c, d]].map(|corners| intersect_triangle(ray, corners));
        let hits = hits.into_iter().flatten().map(|hit| [f64::from(hit.t); 2]);
        hits.reduce(|[first, last], [t, _]| [first.min(t), last.max(t)])
    }

    /// Djeu 2011, section 6.9, with one rate for the whole patch: the footprint is that over all parts the ray enters.
    pub(crate) fn exact_approach(
        &self,
        patch: u32,
        ray: &GridRay,
        width: &Width,
        interval: [f64; 2],
    ) -> [u8; 2] {
        let mut levels = self.levels_for(patch, width.least(interval[0], interval[1]));
        let mut frontier = vec![NodeRef::Stored(&self.surface.patches[patch as usize].root)];
        let mut splits = 0;
        while splits < levels[0].min(levels[1]) && frontier.len() <= MAX_FRONTIER {
            let mut parts = Vec::new();
            let (mut first, mut last) = (f64::INFINITY, f64::NEG_INFINITY);
            for node in &frontier {
                for child in node.quarters(&self.surface) {
                    if ray.slab.entry(&child.node().bounds, ray.slab.tfar).is_some() {
                        let [t0, t1] = width.interval(&child.node().bounds);
                        (first, last) = (first.min(t0), last.max(t1));
                        parts.push(child);
                    }
                }
            }
            splits += 1;
            if parts.is_empty() {
                break;
            }
            let tighter = self.levels_for(patch, width.least(first, last));
            if tighter == levels {
                break;
            }
            levels = tighter;
            frontier = parts;
        }
        levels
    }
}

/// A node of a tree, or one that was made for the occasion.
enum NodeRef<'a> {
    Stored(&'a Node),
    Made(Arc<[Node; 4]>, usize),
}

impl<'a> NodeRef<'a> {
    fn node(&self) -> &Node {
        match self {
            Self::Stored(node) => node,
            Self::Made(nodes, k) => &nodes[*k],
        }
    }

    fn quarters(&self, surface: &Surface) -> [NodeRef<'a>; 4] {
        let made = |nodes: Box<[Node; 4]>| {
            let nodes: Arc<[Node; 4]> = Arc::from(nodes);
            [0, 1, 2, 3].map(|k| NodeRef::Made(Arc::clone(&nodes), k))
        };
        match self {
            Self::Stored(node) => match node.split(&surface.context) {
                Children::Stored(nodes) => [0, 1, 2, 3].map(|k| NodeRef::Stored(&nodes[k])),
                Children::Made(nodes) => made(nodes),
            },
            // What was made is below the limit no more than its parent: it is not stored either.
            Self::Made(nodes, k) => match nodes[*k].split(&surface.context) {
                Children::Made(nodes) => made(nodes),
                Children::Stored(_) => made(Box::new(nodes[*k].fresh_quarters(&surface.context))),
            },
        }
    }
}
