//! Which nodes may end rays: the correlation height `K`, by hand or from connectivity (`[Lacewell08]`, section 3.3).
//!
//! A node's opacity says nothing about where in the node light is blocked, so a wall cut into nodes would leak. The published
//! remedy is one height below which no node ends rays. Here each connected surface has a *length*, how far apart its ends
//! are along it, and a *width*, its area over that: a leaf's or a strand's width, however it curls, and a wall's height. A
//! node may end rays only if its radius is [`RADIUS_IN_WIDTHS`] times the largest width of any surface in it (for strands less,
//! [`RADIUS_IN_STRAND_WIDTHS`]): pieces of a wall, of whatever size, never are; strands and stems are as soon as they are thin against
//! the node. Closed surfaces that are not much longer than wide hold light or keep it out and so are never given an opacity.
//!
//! Triangles are connected when they share the position of a vertex, so soups and indexed meshes are the same.

use super::published::Correlation;
use std::{
    collections::HashMap,
    hash::{BuildHasherDefault, Hasher},
};
use umbrage_accel::{BinaryTree, Bvh, Child};
use umbrage_geom::{
    glam::Vec3,
    sampling::{combine, hash},
};

/// A node's radius over the widths of what is in it.
const RADIUS_IN_WIDTHS: f32 = 1.5;

/// The same for strands.
const RADIUS_IN_STRAND_WIDTHS: f32 = 1.25;

/// Length over width from which a surface is on the way to a strand, and from which it is one.
const STRAND_LENGTH_OVER_WIDTH: [f32; 2] = [6.0, 14.0];

/// Closed surfaces whose width is more than this part of their length are solid.
const SOLID_WIDTH_OVER_LENGTH: f32 = 0.25;

/// Hash of three coordinates, mixed as numbers.
#[derive(Default)]
struct PositionHasher(u64);

impl Hasher for PositionHasher {
    fn finish(&self) -> u64 {
        // The upper bits choose the group, the lower ones the place.
        let (low, high) = (self.0 as u32, (self.0 >> 32) as u32);
        u64::from(hash(low)) << 32 | u64::from(hash(high ^ low))
    }

    fn write(&mut self, bytes: &[u8]) {
        bytes.iter().for_each(|&b| self.write_u32(b.into()));
    }

    fn write_u32(&mut self, x: u32) {
        let (low, high) = (self.0 as u32, (self.0 >> 32) as u32);
        self.0 = u64::from(high.rotate_left(13) ^ low) << 32 | u64::from(combine(low, x));
    }
}

/// Index of the first vertex at the same place, for each vertex.
fn welded(positions: &[[f32; 3]]) -> Vec<u32> {
    let mut first: HashMap<[u32; 3], u32, BuildHasherDefault<PositionHasher>> = HashMap::default();
    first.reserve(positions.len());
    let places = positions.iter().enumerate().map(|(i, p)| {
        // Zeros of both signs are one place.
        *first.entry(p.map(|x| (x + 0.0).to_bits())).or_insert(i as u32)
    });
    places.collect()
}

/// Vertices with the triangles around each.
struct Graph<'a> {
    positions: &'a [[f32; 3]],
    /// Welded.
    triangles: Vec<[u32; 3]>,
    /// Where each vertex's run of `around` starts.
    starts: Vec<u32>,
    around: Vec<u32>,
}

impl<'a> Graph<'a> {
    fn new(positions: &'a [[f32; 3]], triangles: &[[u32; 3]]) -> Self {
        let same = welded(positions);
        let triangles: Vec<[u32; 3]> = triangles.iter().map(|t| t.map(|v| same[v as usize])).collect();
        let mut starts = vec![0u32; positions.len() + 1];
        triangles.iter().flatten().for_each(|&v| starts[v as usize + 1] += 1);
        for i in 0..positions.len() {
            starts[i + 1] += starts[i];
        }
        let mut next = starts.clone();
        let mut around = vec![0u32; 3 * triangles.len()];
        for (i, &v) in triangles.iter().enumerate().flat_map(|(i, t)| t.iter().map(move |v| (i, v))) {
            around[next[v as usize] as usize] = i as u32;
            next[v as usize] += 1;
        }
        Self { positions, triangles, starts, around }
    }

    /// Walks over the surface of `start` in breadth. Returns its vertices, and the one farthest along the walk with its
    /// distance. `distances` of its vertices must be negative before, and are the distances afterwards.
    fn walk(&self, start: u32, distances: &mut [f32], queue: &mut Vec<u32>) -> (u32, f32) {
        queue.clear();
        queue.push(start);
        distances[start as usize] = 0.0;
        let (mut farthest, mut at) = ((start, 0.0), 0);
        while let Some(&vertex) = queue.get(at) {
            at += 1;
            let (here, distance) = (Vec3::from(self.positions[vertex as usize]), distances[vertex as usize]);
            let run = self.starts[vertex as usize] as usize..self.starts[vertex as usize + 1] as usize;
            for &other in self.around[run].iter().flat_map(|&t| &self.triangles[t as usize]) {
                if distances[other as usize] < 0.0 {
                    let d = distance + here.distance(self.positions[other as usize].into());
                    distances[other as usize] = d;
                    queue.push(other);
                    if d > farthest.1 {
                        farthest = (other, d);
                    }
                }
            }
        }
        farthest
    }
}

/// Radius that a node needs to end rays although it holds a surface.
fn needed_radius(area: f32, length: f32, is_closed: bool) -> f32 {
    let width = if length > 0.0 { area / length } else { 0.0 };
    if is_closed && width > SOLID_WIDTH_OVER_LENGTH * length {
        return f32::INFINITY;
    }
    let slender = ((length - STRAND_LENGTH_OVER_WIDTH[0] * width)
        / ((STRAND_LENGTH_OVER_WIDTH[1] - STRAND_LENGTH_OVER_WIDTH[0]) * width))
        .clamp(0.0, 1.0);
    if width > 0.0 {
        width * (RADIUS_IN_WIDTHS + (RADIUS_IN_STRAND_WIDTHS - RADIUS_IN_WIDTHS) * slender)
    } else {
        0.0
    }
}

/// The radius needed for each triangle.
fn needed_radii(positions: &[[f32; 3]], triangles: &[[u32; 3]]) -> Vec<f32> {
    let graph = Graph::new(positions, triangles);
    let mut radii = vec![-1f32; triangles.len()];
    let mut distances = vec![-1f32; positions.len()];
    let (mut queue, mut members) = (Vec::new(), Vec::new());
    for first in 0..triangles.len() {
        if radii[first] >= 0.0 {
            continue;
        }
        // From anywhere to one end, and from there to the other.
        let (end, _) = graph.walk(graph.triangles[first][0], &mut distances, &mut queue);
        queue.iter().for_each(|&v| distances[v as usize] = -1.0);
        let (_, length) = graph.walk(end, &mut distances, &mut queue);
        // Edges of a closed surface come in pairs, so that their hashes cancel.
        let (mut area, mut open) = (0.0, 0u64);
        members.clear();
        for &vertex in &queue {
            let run = graph.starts[vertex as usize] as usize..graph.starts[vertex as usize + 1] as usize;
            for &t in &graph.around[run] {
                if radii[t as usize] >= 0.0 {
                    continue;
                }
                radii[t as usize] = 0.0;
                members.push(t);
                let v = graph.triangles[t as usize];
                let [a, b, c] = v.map(|v| Vec3::from(positions[v as usize]));
                area += 0.5 * (b - a).cross(c - a).length();
                for (p, q) in [(v[0], v[1]), (v[1], v[2]), (v[2], v[0])] {
                    let (p, q) = (p.min(q), p.max(q));
                    open ^= u64::from(combine(p, q)) << 32 | u64::from(combine(q ^ 0x55, p));
                }
            }
        }
        let radius = needed_radius(area, length, open == 0);
        members.iter().for_each(|&t| radii[t as usize] = radius);
    }
    radii
}

/// Heights as published: leaves 0, others 1 more than the mean of their children.
pub(crate) fn heights(tree: &BinaryTree) -> Vec<f32> {
    let mut heights = vec![0f32; tree.nodes.len()];
    for (i, node) in tree.nodes.iter().enumerate().rev() {
        if !node.is_leaf() {
            let [a, b] = node.children.map(|child| heights[child as usize]);
            heights[i] = 1.0 + 0.5 * (a + b);
        }
    }
    heights
}

/// The same of nodes with up to eight children: a binary tree over `n` things has `log2 n` levels.
struct Heights(Vec<f32>);

impl Heights {
    fn of(&self, bvh: &Bvh, child: Child) -> f32 {
        match child {
            Child::Node(node) => self.0[node as usize],
            Child::Leaf(leaf) => (bvh.view().leaf(leaf).len() as f32).log2(),
        }
    }

    fn new(bvh: &Bvh) -> Self {
        let mut this = Self(vec![0.0; bvh.view().node_count()]);
        for node in (0..this.0.len()).rev() {
            let (mut sum, mut count) = (0.0, 0.0f32);
            for (_, child) in bvh.children(node as u32) {
                sum += this.of(bvh, child);
                count += 1.0;
            }
            this.0[node] = sum / count.max(1.0) + count.max(1.0).log2();
        }
        this
    }
}

/// A bit for each child that may end rays, node by node.
pub(crate) fn may_stop(
    correlation: Correlation,
    bvh: &Bvh,
    positions: &[[f32; 3]],
    triangles: &[[u32; 3]],
) -> Vec<u8> {
    let view = bvh.view();
    let mut masks = vec![0u8; view.node_count()];
    match correlation {
        Correlation::Height(height) => {
            let heights = Heights::new(bvh);
            for (node, mask) in masks.iter_mut().enumerate() {
                for (slot, (_, child)) in bvh.children(node as u32).enumerate() {
                    *mask |= u8::from(heights.of(bvh, child) > height) << slot;
                }
            }
        }
        Correlation::Automatic => {
            let needed = needed_radii(positions, triangles);
            // Largest radius needed below each node.
            let mut below = vec![0f32; masks.len()];
            for node in (0..masks.len()).rev() {
                for (slot, (aabb, child)) in bvh.children(node as u32).enumerate() {
                    let radius = match child {
                        Child::Leaf(leaf) => {
                            view.prims(leaf).iter().fold(0f32, |m, &prim| m.max(needed[prim as usize]))
                        }
                        Child::Node(child) => below[child as usize],
                    };
                    below[node] = below[node].max(radius);
                    masks[node] |= u8::from(0.5 * aabb.diagonal() >= radius) << slot;
                }
            }
        }
    }
    masks
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn widths_tell_walls_from_leaves() {
        // A wall of 2 x 8 squares of 1, as a soup; a far-off sliver; a closed tetrahedron.
        let mut positions: Vec<[f32; 3]> = Vec::new();
        for i in 0..8 {
            for j in 0..2 {
                let at = |x: usize, y: usize| [(i + x) as f32, (j + y) as f32, 0.0];
                positions.extend([at(0, 0), at(1, 0), at(1, 1), at(0, 0), at(1, 1), at(0, 1)]);
            }
        }
        let wall = positions.len() / 3;
        positions.extend([[50.0, 0.0, 0.0], [60.0, 0.0, 0.0], [60.0, 0.1, 0.0]]);
        let corners = [[0.0, 0.0, 9.0], [1.0, 0.0, 9.0], [0.0, 1.0, 9.0], [0.0, 0.0, 10.0]];
        for face in [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]] {
            positions.extend(face.map(|k: usize| corners[k]));
        }
        let triangles: Vec<[u32; 3]> =
            (0..positions.len() as u32 / 3).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
        let radii = needed_radii(&positions, &triangles);
        // As wide as a wall's length lets it be, at least.
        assert!(radii[..wall].iter().all(|&r| r == radii[0]));
        assert!((1.5..3.0).contains(&radii[0]), "{}", radii[0]);
        assert!((radii[wall] - RADIUS_IN_STRAND_WIDTHS * 0.05).abs() < 1e-3);
        assert!(radii[wall + 1..].iter().all(|&r| r == f32::INFINITY));
    }
}
