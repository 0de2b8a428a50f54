//! The algorithm as published: a binary hierarchy, one correlation height, pixels, Algorithm 1 with its interpolation.
//!
//! Here to be measured against, and to see what each departure of [`super::Prefiltered`] is worth. Scalar and recursive; a
//! cube map of `f32` in every node. And what else only comparisons need: published variants of parts of what ships, ablations and
//! other forms of storage (`variants.rs`).

mod variants;

pub use variants::{Blend, CellSampling, Correlation, SegmentEnds, Storage};

use super::{ConeRay, Directions, correlation::heights};
use crate::OcclusionError;
use umbrage_accel::{BinaryNode, BinaryTree, BuildQuality};
use umbrage_geom::{
    Aabb, Frame, Ray, SlabRay,
    glam::{Vec2, Vec3},
    mesh::validate_slices,
    segment_hits_triangle,
};

/// Pixels along an edge of a projected image.
const PIXELS: u32 = 10;

/// A binary hierarchy with a directional opacity in every node from the correlation height up.
///
/// # Source
/// `[Lacewell08]`, sections 3.2 and 3.3.
#[derive(Clone, Debug)]
pub struct Published {
    tree: BinaryTree,
    heights: Vec<f32>,
    /// Directions of each node in turn; 0 below the correlation height.
    opacities: Vec<f32>,
    directions: Directions,
    correlation_height: f32,
    corners: Vec<[[f32; 3]; 3]>,
    alpha: f32,
}

/// A ray on its way, with the published parameters.
struct Traced<'a> {
    ray: &'a Ray,
    slab: SlabRay,
    solid_angle: f32,
    threshold: f32,
    /// Cells to look in, with weights.
    cells: [(usize, f32); 4],
}

/// Parallel lines through the pixels of a box's orthographic image, those that meet the box.
fn pixels(aabb: &Aabb, direction: Vec3, mut each: impl FnMut(&Ray, &SlabRay)) {
    let frame = Frame::from_normal(direction);
    let (tangent, bitangent) = (frame.world_from_local(Vec3::X), frame.world_from_local(Vec3::Y));
    let flat = |p: Vec3| Vec2::new(p.dot(tangent), p.dot(bitangent));
    let center = aabb.center();
    let (mut low, mut high) = (Vec2::INFINITY, Vec2::NEG_INFINITY);
    for corner in 0..8 {
        let pick = |axis: usize| if corner >> axis & 1 == 1 { aabb.max[axis] } else { aabb.min[axis] };
        let p = flat(Vec3::new(pick(0), pick(1), pick(2)) - center);
        (low, high) = (low.min(p), high.max(p));
    }
    let start = center - direction * aabb.diagonal();
    for pixel in 0..PIXELS * PIXELS {
        let place = (Vec2::new((pixel % PIXELS) as f32, (pixel / PIXELS) as f32) + 0.5) / PIXELS as f32;
        let at = low + (high - low) * place;
        let ray = Ray::new(start + tangent * at.x + bitangent * at.y, direction);
        if let Some(slab) = SlabRay::new(&ray)
            && slab.entry(aabb, slab.tfar).is_some()
        {
            each(&ray, &slab);
        }
    }
}

impl Published {
    /// Builds and prefilters with correlation height `K` and `directions` cells along a cube face's edge (`N_C`, 3 in the
    /// paper). All triangles block the fraction `alpha`.
    ///
    /// # Errors
    /// [`OcclusionError::Mesh`], [`OcclusionError::CorrelationHeight`], [`OcclusionError::Setting`] for directions outside
    /// 1 to 12, [`OcclusionError::Opacity`].
    pub fn build(
        positions: &[[f32; 3]],
        triangles: &[[u32; 3]],
        alpha: f32,
        correlation_height: f32,
        directions: u8,
    ) -> Result<Self, OcclusionError> {
        validate_slices(positions, triangles)?;
        if !(0.0..=1.0).contains(&alpha) {
            return Err(OcclusionError::Opacity { index: 0, value: alpha });
        }
        let options = super::PrefilterOptions::default()
            .with_correlation(Correlation::Height(correlation_height))
            .with_directions(directions);
        let directions = options.validate()?;
        let corners: Vec<_> = triangles.iter().map(|t| t.map(|v| positions[v as usize])).collect();
        let boxes: Vec<Aabb> = corners.iter().map(|c| Aabb::from_points(c)).collect();
        let tree = BinaryTree::build(&boxes, BuildQuality::High)?;
        let opacities = vec![0.0; tree.nodes.len() * directions.cells()];
        let heights = heights(&tree);
        let mut this = Self { heights, opacities, directions, correlation_height, corners, alpha, tree };
        this.prefilter();
        Ok(this)
    }

    /// Node by node from the leaves: nothing below `K`, triangles at `K`, children above.
    fn prefilter(&mut self) {
        let cells = self.directions.cells();
        let is_low = |i: u32| self.heights[i as usize] <= self.correlation_height;
        let mut opacities = std::mem::take(&mut self.opacities);
        for (i, node) in self.tree.nodes.iter().enumerate().rev() {
            // Nodes at the correlation height are those low ones that a higher node composites, the root among them.
            let children = if node.is_leaf() { [i as u32; 2] } else { node.children };
            let composites = !is_low(i as u32);
            for child in children.into_iter().filter(|&child| composites && is_low(child)) {
                for cell in 0..cells {
                    opacities[child as usize * cells + cell] =
                        self.rendered(child, self.directions.center(cell));
                }
            }
            if composites {
                let [a, b] = node.children.map(|c| c as usize);
                for cell in 0..cells {
                    let below = [opacities[a * cells + cell], opacities[b * cells + cell]];
                    opacities[i * cells + cell] = self.composited(node, below, self.directions.center(cell));
                }
            }
        }
        self.opacities = opacities;
    }

    /// Opacity of the triangles below `node`, rendered.
    fn rendered(&self, node: u32, direction: Vec3) -> f32 {
        let (mut sum, mut count) = (0.0, 0);
        pixels(&self.tree.nodes[node as usize].aabb, direction, |ray, slab| {
            let mut passed = 1.0;
            self.each_hit(node, ray, slab, &mut |_| passed *= 1.0 - self.alpha);
            sum += 1.0 - passed;
            count += 1;
        });
        if count > 0 { sum / count as f32 } else { 0.0 }
    }

    /// Opacity of two children that are taken as independent, from the silhouettes of their boxes.
    fn composited(&self, node: &BinaryNode, below: [f32; 2], direction: Vec3) -> f32 {
        let boxes = node.children.map(|child| self.tree.nodes[child as usize].aabb);
        let (mut sum, mut count) = (0.0, 0);
        pixels(&node.aabb, direction, |_, slab| {
            let [a, b] =
                [0, 1].map(|k| if slab.entry(&boxes[k], slab.tfar).is_some() { below[k] } else { 0.0 });
            sum += a + b - a * b;
            count += 1;
        });
        if count > 0 { sum / count as f32 } else { 0.0 }
    }

    fn each_hit(&self, node: u32, ray: &Ray, slab: &SlabRay, visit: &mut impl FnMut(u32)) {
        let n = &self.tree.nodes[node as usize];
        if slab.entry(&n.aabb, slab.tfar).is_none() {
            return;
        }
        if n.is_leaf() {
            let prim = self.tree.order[n.first as usize];
            if segment_hits_triangle(ray, self.corners[prim as usize]) {
                visit(prim);
            }
        } else {
            n.children.into_iter().for_each(|child| self.each_hit(child, ray, slab, visit));
        }
    }

    /// Fraction of light that passes along `ray` with threshold `T`.
    ///
    /// # Errors
    /// [`OcclusionError::Threshold`] if it is not above 0.
    pub fn transmittance(&self, ray: &ConeRay, threshold: f32) -> Result<f32, OcclusionError> {
        if threshold.is_nan() || threshold <= 0.0 {
            return Err(OcclusionError::Threshold(threshold));
        }
        let Some(slab) = SlabRay::new(&ray.ray) else { return Ok(1.0) };
        let cells = self.directions.bilinear(ray.ray.direction);
        let solid_angle = ray.solid_angle.max(0.0);
        Ok(1.0 - self.occlusion(0, &Traced { ray: &ray.ray, slab, solid_angle, threshold, cells }))
    }

    /// Algorithm 1; the numbers are its lines.
    fn occlusion(&self, node: u32, traced: &Traced) -> f32 {
        let n = &self.tree.nodes[node as usize];
        // (1-5) The ray misses the box.
        if traced.slab.entry(&n.aabb, traced.slab.tfar).is_none() {
            return 0.0;
        }
        let composite = || {
            let [a, b] = n.children.map(|child| self.occlusion(child, traced));
            a + b - a * b
        };
        // (7-16) Below the correlation height nothing is prefiltered.
        if self.heights[node as usize] <= self.correlation_height {
            if !n.is_leaf() {
                return composite();
            }
            let prim = self.tree.order[n.first as usize] as usize;
            return if segment_hits_triangle(traced.ray, self.corners[prim]) { self.alpha } else { 0.0 };
        }
        // (18-22) The node fits inside the ray's cone: its stored opacity is the answer.
        let solid_angle = self.solid_angle(node, traced.ray.origin);
        if traced.threshold * solid_angle < traced.solid_angle {
            return self.stored(node, traced);
        }
        // (24-29) Otherwise composite the children ..
        let opacity = composite();
        let child = n.children.map(|child| self.solid_angle(child, traced.ray.origin));
        let smallest = traced.threshold * child[0].min(child[1]);
        // (31-40) .. and blend with the node's own opacity where a child already fits.
        if smallest < traced.solid_angle {
            let t = (traced.solid_angle - smallest) / (traced.threshold * solid_angle - smallest);
            let t = t.clamp(0.0, 1.0);
            return t * self.stored(node, traced) + (1.0 - t) * opacity;
        }
        opacity
    }

    /// Solid angle of a node's bounding sphere, as published: any number, for points inside too.
    fn solid_angle(&self, node: u32, point: Vec3) -> f32 {
        let aabb = &self.tree.nodes[node as usize].aabb;
        let radius = 0.5 * aabb.diagonal();
        std::f32::consts::PI * radius * radius / (aabb.center() - point).length_squared()
    }

    fn stored(&self, node: u32, traced: &Traced) -> f32 {
        let first = node as usize * self.directions.cells();
        traced.cells.iter().map(|&(cell, weight)| weight * self.opacities[first + cell]).sum()
    }

    /// Opacities of the whole scene by direction, see [`Directions`].
    pub fn root_opacities(&self) -> &[f32] {
        &self.opacities[..self.directions.cells()]
    }

    /// Opacities of the whole scene by rendering all triangles: what prefiltering approximates in linear time.
    pub fn rendered_opacities(&self) -> Vec<f32> {
        (0..self.directions.cells()).map(|cell| self.rendered(0, self.directions.center(cell))).collect()
    }

    /// All stored opacities, node by node.
    pub fn opacities(&self) -> &[f32] {
        &self.opacities
    }

    /// Height of the root, which heights `K` must stay below for anything to be prefiltered.
    pub fn height(&self) -> f32 {
        self.heights[0]
    }

    /// Bytes of nodes and triangles, and of opacities.
    pub fn bytes(&self) -> (usize, usize) {
        let tree = size_of_val(&self.tree.nodes[..]) + size_of_val(&self.tree.order[..]);
        let nodes = tree + size_of_val(&self.heights[..]) + size_of_val(&self.corners[..]);
        (nodes, size_of_val(&self.opacities[..]))
    }
}
