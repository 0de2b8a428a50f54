//! Which nodes may end rays: the correlation height `K`, by hand or from connectivity ([Lacewell08], section 3.3).
//!
//! A node's opacity says nothing about where in the node light is blocked, so a wall cut into nodes would leak. The published
//! remedy is one height below which no node ends rays. Here each connected surface has a *width*, its area over the diagonal
//! of its box: about a leaf's or a strand's width, but a wall's height. A node may end rays only if its radius is
//! [`WIDTHS`] times the largest width of any surface in it; pieces of a wall, of whatever size, never are, and strands and
//! stems are as soon as they are thin against the node. Closed surfaces that are not much longer than wide hold light or
//! keep it out and so are never given an opacity at all.
//!
//! Triangles are connected when they share the position of a vertex, so soups and indexed meshes are the same.

use super::{
    Correlation,
    wide::{LEAF, WIDTH, Wide},
};
use std::{
    collections::HashMap,
    hash::{BuildHasherDefault, Hasher},
};
use umbrage_accel::BinaryTree;
use umbrage_geom::{
    Aabb,
    glam::Vec3,
    sampling::{combine, hash},
};

/// A node's radius over the widths of what is in it.
const WIDTHS: f32 = 1.5;

/// Closed surfaces whose width is more than this part of their diagonal are solid.
const SOLID: f32 = 0.25;

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

/// Union and find over indices.
struct Sets(Vec<u32>);

impl Sets {
    fn find(&mut self, mut i: u32) -> u32 {
        while self.0[i as usize] != i {
            let up = self.0[self.0[i as usize] as usize];
            self.0[i as usize] = up;
            i = up;
        }
        i
    }

    fn join(&mut self, a: u32, b: u32) {
        let (a, b) = (self.find(a), self.find(b));
        // The smaller index is the root, so that results don't depend on the order of unions.
        self.0[a.max(b) as usize] = a.min(b);
    }
}

/// A connected surface.
#[derive(Clone, Copy)]
struct Surface {
    aabb: Aabb,
    area: f32,
    /// Edges met an odd number of times: 0 if closed. Counted by a sum of hashes that cancel in pairs.
    open: u64,
}

/// Radius that a node needs to end rays although it holds a triangle, for each triangle.
fn needed_radii(positions: &[[f32; 3]], triangles: &[[u32; 3]]) -> Vec<f32> {
    let mut sets = Sets((0..positions.len() as u32).collect());
    for &[a, b, c] in triangles {
        sets.join(a, b);
        sets.join(b, c);
    }
    let mut first: HashMap<[u32; 3], u32, BuildHasherDefault<PositionHasher>> = HashMap::default();
    first.reserve(positions.len());
    let mut same = vec![0u32; positions.len()];
    for (i, p) in positions.iter().enumerate() {
        // Zeros of both signs are one place.
        let key = p.map(|x| (x + 0.0).to_bits());
        let one = *first.entry(key).or_insert(i as u32);
        same[i] = one;
        sets.join(one, i as u32);
    }
    let empty = Surface { aabb: Aabb::EMPTY, area: 0.0, open: 0 };
    let mut surfaces: HashMap<u32, Surface, BuildHasherDefault<PositionHasher>> = HashMap::default();
    let roots: Vec<u32> = triangles.iter().map(|t| sets.find(t[0])).collect();
    for (&root, t) in roots.iter().zip(triangles) {
        let surface = surfaces.entry(root).or_insert(empty);
        let [a, b, c] = t.map(|v| Vec3::from(positions[v as usize]));
        surface.area += 0.5 * (b - a).cross(c - a).length();
        surface.aabb = surface.aabb.with_point(a).with_point(b).with_point(c);
        let v = t.map(|v| same[v as usize]);
        for (p, q) in [(v[0], v[1]), (v[1], v[2]), (v[2], v[0])] {
            let (p, q) = (p.min(q), p.max(q));
            surface.open ^= u64::from(combine(p, q)) << 32 | u64::from(combine(q ^ 0x55, p));
        }
    }
    let radius = |s: &Surface| {
        let diagonal = s.aabb.diagonal();
        let width = if diagonal > 0.0 { s.area / diagonal } else { 0.0 };
        if s.open == 0 && width > SOLID * diagonal { f32::INFINITY } else { WIDTHS * width }
    };
    roots.iter().map(|root| surfaces.get(root).map_or(0.0, radius)).collect()
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

/// A bit for each child that may end rays, node by node. `sources` are the nodes of `tree` that the children stand for.
pub(crate) fn may_stop(
    correlation: Correlation,
    wide: &Wide,
    tree: &BinaryTree,
    sources: &[[u32; WIDTH]],
    positions: &[[f32; 3]],
    triangles: &[[u32; 3]],
) -> Vec<u8> {
    match correlation {
        Correlation::Height(height) => {
            let heights = heights(tree);
            let tall = |source: u32| heights.get(source as usize).is_some_and(|&h| h > height);
            let masks = sources.iter().map(|row| (0..WIDTH).fold(0, |m, i| m | u8::from(tall(row[i])) << i));
            masks.collect()
        }
        Correlation::Automatic => {
            let needed = needed_radii(positions, triangles);
            let mut masks = vec![0u8; wide.nodes.len()];
            // Largest radius needed below each node.
            let mut below = vec![0f32; wide.nodes.len()];
            for (i, node) in wide.nodes.iter().enumerate().rev() {
                for slot in 0..node.len() {
                    let child = node.children[slot];
                    let radius = if child & LEAF != 0 {
                        let prims = wide.leaf_prims((child & !LEAF) as usize);
                        prims.fold(0f32, |m, prim| m.max(needed[prim as usize]))
                    } else {
                        below[child as usize]
                    };
                    below[i] = below[i].max(radius);
                    masks[i] |= u8::from(0.5 * node.child_box(slot).diagonal() >= radius) << slot;
                }
            }
            masks
        }
    }
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
        let width = 16.0 / 68f32.sqrt();
        assert!(radii[..wall].iter().all(|r| (r - WIDTHS * width).abs() < 1e-4));
        assert!((radii[wall] - WIDTHS * 0.05).abs() < 1e-3);
        assert!(radii[wall + 1..].iter().all(|&r| r == f32::INFINITY));
    }
}
