//! Soft unions of bones, balls and membranes, turned into closed triangle meshes.
//!
//! The surface is cut out of the tetrahedra of a body-centred cubic lattice. Its vertices stay strictly inside lattice
//! edges and its triangles inside tetrahedra, so that it is closed, oriented, free of self-intersection and without
//! degenerate triangles, whatever the shape.

use std::{
    collections::HashMap,
    hash::{BuildHasherDefault, Hasher},
};
use umbrage_geom::{
    TriangleMesh,
    glam::{DVec3, IVec3},
};

/// A part of a shape.
#[derive(Clone, Copy, Debug)]
enum Part {
    /// A segment with a radius at each end.
    Bone { a: DVec3, b: DVec3, radii: [f64; 2] },
    /// A triangle with a thickness.
    Membrane { corners: [DVec3; 3], radius: f64 },
}

impl Part {
    /// Distance from the surface, negative inside, and how fast it may change.
    fn distance(&self, p: DVec3, min_radius: f64) -> f64 {
        match *self {
            Self::Bone { a, b, radii } => {
                let axis = b - a;
                let t = ((p - a).dot(axis) / axis.length_squared().max(1e-12)).clamp(0.0, 1.0);
                p.distance(a + axis * t) - (radii[0] + (radii[1] - radii[0]) * t).max(min_radius)
            }
            Self::Membrane { corners, radius } => distance_to_triangle(p, corners) - radius.max(min_radius),
        }
    }

    /// Bound on the change of [`Self::distance`] over a unit of length.
    fn slope(&self) -> f64 {
        match *self {
            Self::Bone { a, b, radii } => 1.0 + (radii[0] - radii[1]).abs() / a.distance(b).max(1e-6),
            Self::Membrane { .. } => 1.0,
        }
    }

    fn bounds(&self) -> (DVec3, DVec3) {
        match *self {
            Self::Bone { a, b, radii } => {
                let r = radii[0].max(radii[1]);
                (a.min(b) - r, a.max(b) + r)
            }
            Self::Membrane { corners: [a, b, c], radius } => {
                (a.min(b).min(c) - radius, a.max(b).max(c) + radius)
            }
        }
    }
}

fn distance_to_triangle(p: DVec3, [a, b, c]: [DVec3; 3]) -> f64 {
    let normal = (b - a).cross(c - a);
    let inside = [(a, b), (b, c), (c, a)].iter().all(|&(u, v)| (v - u).cross(normal).dot(p - u) <= 0.0);
    if inside {
        return (p - a).dot(normal).abs() / normal.length();
    }
    let to_edge = |u: DVec3, v: DVec3| {
        let t = ((p - u).dot(v - u) / u.distance_squared(v)).clamp(0.0, 1.0);
        p.distance(u + (v - u) * t)
    };
    to_edge(a, b).min(to_edge(b, c)).min(to_edge(c, a))
}

/// A soft union of parts.
#[derive(Clone, Debug, Default)]
pub struct Shape {
    /// Parts and how far each reaches beyond its surface to melt into others.
    parts: Vec<(Part, f64)>,
}

impl Shape {
    /// Adds a segment with a radius at each end.
    pub fn bone(&mut self, a: DVec3, b: DVec3, radii: [f64; 2], melt: f64) {
        self.parts.push((Part::Bone { a, b, radii }, melt));
    }

    /// Adds a ball.
    pub fn ball(&mut self, center: DVec3, radius: f64, melt: f64) {
        self.bone(center, center, [radius; 2], melt);
    }

    /// Adds bones from each point to the next, with a radius at each.
    pub fn chain(&mut self, points: &[(DVec3, f64)], melt: f64) {
        for pair in points.windows(2) {
            self.bone(pair[0].0, pair[1].0, [pair[0].1, pair[1].1], melt);
        }
    }

    /// Adds a triangle with a thickness.
    pub fn membrane(&mut self, corners: [DVec3; 3], radius: f64, melt: f64) {
        self.parts.push((Part::Membrane { corners, radius }, melt));
    }

    /// The closed surface with about `triangles` triangles, only its largest piece.
    pub fn polygonise(&self, triangles: usize) -> TriangleMesh {
        // The count grows about with the inverse square of the spacing; thin parts make that inexact. A cheap trial
        // at a quarter of the count comes first.
        let mut spacing = 0.1;
        let mut best: Option<(f64, TriangleMesh)> = None;
        for trial in 0..6 {
            let mesh = Lattice::new(self, spacing).surface();
            let ratio = mesh.triangles.len().max(1) as f64 / triangles as f64;
            let error = (ratio - 1.0).abs();
            if best.as_ref().is_none_or(|(least, _)| error < *least) {
                best = Some((error, mesh));
            }
            if error < 0.06 {
                break;
            }
            let aim = if trial == 0 && ratio < 0.1 { 2.0 } else { 1.0 };
            spacing *= ratio.sqrt().clamp(0.05, 4.0) * aim;
        }
        best.expect("at least one trial").1
    }
}

/// Cells along an edge of a block, within which the parts that matter are looked up once.
const BLOCK: i32 = 8;

/// How near a vertex may come to the end of its lattice edge, as a fraction of it.
const MIN_EDGE_SHARE: f64 = 0.06;

/// The body-centred lattice: points with all coordinates even, and points with all odd, in units of half a spacing.
struct Lattice {
    parts: Vec<(Part, f64)>,
    /// Half the edge of a cubic cell.
    unit: f64,
    min_radius: f64,
    origin: DVec3,
    blocks: IVec3,
}

impl Lattice {
    fn new(shape: &Shape, spacing: f64) -> Self {
        // Parts thinner than the lattice would be torn.
        let min_radius = 0.55 * spacing;
        let empty = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        let (low, high) = shape.parts.iter().fold(empty, |(low, high), (part, melt)| {
            let (l, h) = part.bounds();
            (low.min(l - melt - min_radius), high.max(h + melt + min_radius))
        });
        let origin = low - 2.5 * spacing;
        let cells = (high + 2.5 * spacing - origin) / spacing;
        let blocks = (cells / f64::from(BLOCK)).ceil().as_ivec3();
        // A pseudo-distance that ends within a lattice edge would be interpolated in steps.
        let parts = shape.parts.iter().map(|&(part, melt)| (part, melt.max(1.1 * spacing))).collect();
        Self { parts, unit: spacing / 2.0, min_radius, origin, blocks }
    }

    fn point(&self, p: IVec3) -> DVec3 {
        self.origin + p.as_dvec3() * self.unit
    }

    /// Pseudo-distance of the soft union of `parts`: 0 on the surface, negative inside, 1 far away. A part out of reach
    /// adds exactly 0, so leaving it out changes no bit.
    fn value(&self, parts: &[(Part, f64)], p: IVec3) -> f64 {
        let p = self.point(p);
        let sum: f64 = parts
            .iter()
            .map(|(part, melt)| {
                let x = (1.0 - part.distance(p, self.min_radius) / melt).max(0.0);
                x * x * x
            })
            .sum();
        1.0 - libm::cbrt(sum)
    }

    /// The parts that reach into the block; none if the block lies all inside or all outside.
    fn parts_near(&self, block: IVec3) -> Vec<(Part, f64)> {
        let center = self.point(block * (2 * BLOCK) + BLOCK);
        // Lattice points belong to the block up to one unit beyond its faces.
        let reach = f64::from(BLOCK + 2) * self.unit * 3f64.sqrt();
        let mut near = Vec::new();
        for &(part, melt) in &self.parts {
            let distance = part.distance(center, self.min_radius);
            let change = reach * part.slope();
            if distance + change < 0.0 {
                return Vec::new();
            }
            if distance - change < melt {
                near.push((part, melt));
            }
        }
        near
    }

    fn surface(&self) -> TriangleMesh {
        let mut surface = Surface::default();
        for z in 0..self.blocks.z {
            for y in 0..self.blocks.y {
                for x in 0..self.blocks.x {
                    let block = IVec3::new(x, y, z);
                    let parts = self.parts_near(block);
                    if !parts.is_empty() {
                        self.cut_block(block, &parts, &mut surface);
                    }
                }
            }
        }
        surface.largest_piece()
    }

    /// Cuts the tetrahedra of a block: four around each edge between even points.
    fn cut_block(&self, block: IVec3, parts: &[(Part, f64)], surface: &mut Surface) {
        let base = block * (2 * BLOCK);
        let side = (BLOCK + 2) as usize;
        let samples = |parity: i32| -> Vec<f64> {
            let mut values = Vec::with_capacity(side * side * side);
            for z in -1..=BLOCK {
                for y in -1..=BLOCK {
                    for x in -1..=BLOCK {
                        values.push(self.value(parts, base + IVec3::new(x, y, z) * 2 + parity));
                    }
                }
            }
            values
        };
        // Even points of index -1 belong to the block before; shifting them by one cell saves a special case.
        let (even, odd) = (samples(2), samples(1));
        let at = |p: IVec3| -> f64 {
            // Even points start at index 0, odd ones at -1.
            let index: IVec3 = (p - base + 1) >> 1;
            let index = (index.x as usize) + side * (index.y as usize + side * index.z as usize);
            if p.x & 1 == 0 { even[index] } else { odd[index] }
        };
        let axes = [IVec3::X, IVec3::Y, IVec3::Z];
        for z in 0..BLOCK {
            for y in 0..BLOCK {
                for x in 0..BLOCK {
                    let a = base + IVec3::new(x, y, z) * 2;
                    for e in 0..3 {
                        let [e, f, g] = [axes[e], axes[(e + 1) % 3], axes[(e + 2) % 3]];
                        let ring = [f + g, g - f, -f - g, f - g].map(|d| a + e + d);
                        let b = a + e * 2;
                        let (va, vb) = (at(a), at(b));
                        let vr = ring.map(at);
                        let inside = u32::from(va < 0.0) + u32::from(vb < 0.0);
                        if vr.iter().all(|v| u32::from(*v < 0.0) * 2 == inside) {
                            continue;
                        }
                        for k in 0..4 {
                            let l = (k + 1) % 4;
                            self.cut(surface, [a, b, ring[k], ring[l]], [va, vb, vr[k], vr[l]]);
                        }
                    }
                }
            }
        }
    }

    /// Adds the part of the surface inside one positively oriented tetrahedron.
    fn cut(&self, surface: &mut Surface, corners: [IVec3; 4], values: [f64; 4]) {
        let inside = values.map(|v| v < 0.0);
        let mut on =
            |i: usize, j: usize| surface.vertex(self, [corners[i], corners[j]], [values[i], values[j]]);
        // Even permutations that bring the corners in question to the front.
        const FIRST: [[usize; 4]; 4] = [[0, 1, 2, 3], [1, 0, 3, 2], [2, 3, 0, 1], [3, 2, 1, 0]];
        const PAIRS: [[usize; 4]; 6] =
            [[0, 1, 2, 3], [0, 2, 3, 1], [0, 3, 1, 2], [1, 2, 0, 3], [1, 3, 2, 0], [2, 3, 0, 1]];
        match inside.iter().filter(|&&i| i).count() {
            count @ (1 | 3) => {
                let lone = (0..4).find(|&i| inside[i] == (count == 1)).unwrap_or(0);
                let [p, q, r, s] = FIRST[lone];
                let t = [on(p, q), on(p, r), on(p, s)];
                surface.triangles.push(if count == 1 { t } else { [t[0], t[2], t[1]] });
            }
            2 => {
                let pair = PAIRS.iter().find(|pair| inside[pair[0]] && inside[pair[1]]);
                let [p, q, r, s] = pair.copied().unwrap_or(PAIRS[0]);
                let quad = [on(p, r), on(p, s), on(q, s), on(q, r)];
                surface.quad(quad);
            }
            _ => {}
        }
    }
}

#[derive(Default)]
struct Surface {
    positions: Vec<DVec3>,
    triangles: Vec<[u32; 3]>,
    on_edges: HashMap<u64, u32, BuildHasherDefault<MixingHasher>>,
}

/// Hashes one `u64` by multiplication; the standard hasher takes most of the time otherwise.
#[derive(Default)]
struct MixingHasher(u64);

impl Hasher for MixingHasher {
    fn finish(&self) -> u64 {
        self.0
    }

    fn write(&mut self, bytes: &[u8]) {
        bytes.iter().for_each(|&b| self.write_u64(b.into()));
    }

    fn write_u64(&mut self, x: u64) {
        let product = (self.0 ^ x).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        self.0 = product ^ product >> 32;
    }
}

impl Surface {
    /// The vertex on a lattice edge. The sum of its ends names an edge uniquely.
    fn vertex(&mut self, lattice: &Lattice, [p, q]: [IVec3; 2], [vp, vq]: [f64; 2]) -> u32 {
        let positions = &mut self.positions;
        // Lattice points lie within a few thousand units of 0, their sums within 20 bits.
        let key = (p + q + (1 << 19)).to_array().into_iter().fold(0, |key, x| key << 20 | x as u64);
        *self.on_edges.entry(key).or_insert_with(|| {
            let t = (vp / (vp - vq)).clamp(MIN_EDGE_SHARE, 1.0 - MIN_EDGE_SHARE);
            let (a, b) = (lattice.point(p), lattice.point(q));
            positions.push(a + (b - a) * t);
            positions.len() as u32 - 1
        })
    }

    fn quad(&mut self, [a, b, c, d]: [u32; 4]) {
        let length = |i: u32, j: u32| self.positions[i as usize].distance_squared(self.positions[j as usize]);
        if length(a, c) <= length(b, d) {
            self.triangles.extend([[a, b, c], [a, c, d]]);
        } else {
            self.triangles.extend([[a, b, d], [b, c, d]]);
        }
    }

    /// The connected piece with most triangles.
    fn largest_piece(self) -> TriangleMesh {
        let mut parent: Vec<u32> = (0..self.positions.len() as u32).collect();
        for t in &self.triangles {
            let roots = t.map(|v| root(&mut parent, v));
            let low = roots[0].min(roots[1]).min(roots[2]);
            roots.iter().for_each(|&r| parent[r as usize] = low);
        }
        let mut sizes = vec![0u32; self.positions.len()];
        for t in &self.triangles {
            sizes[root(&mut parent, t[0]) as usize] += 1;
        }
        let Some(largest) = (0..sizes.len()).rev().max_by_key(|&i| sizes[i]) else {
            return TriangleMesh::default();
        };
        let mut mesh = TriangleMesh::default();
        let mut renumbered = vec![u32::MAX; self.positions.len()];
        for (i, p) in self.positions.iter().enumerate() {
            if root(&mut parent, i as u32) as usize == largest {
                renumbered[i] = mesh.positions.len() as u32;
                mesh.positions.push(p.as_vec3().to_array());
            }
        }
        let kept = self.triangles.iter().filter(|t| renumbered[t[0] as usize] != u32::MAX);
        mesh.triangles = kept.map(|t| t.map(|v| renumbered[v as usize])).collect();
        mesh
    }
}

fn root(parent: &mut [u32], mut v: u32) -> u32 {
    while parent[v as usize] != v {
        parent[v as usize] = parent[parent[v as usize] as usize];
        v = parent[v as usize];
    }
    v
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_ball_has_its_size_and_count() {
        let mut shape = Shape::default();
        shape.ball(DVec3::new(0.3, 0.7, -0.2), 0.8, 0.1);
        for triangles in [2_000, 30_000] {
            let mesh = shape.polygonise(triangles);
            let count = mesh.triangles.len();
            assert!((count as f64 / triangles as f64 - 1.0).abs() < 0.1, "{count} of {triangles}");
            let volume = super::super::tests::volume(&mesh);
            let exact = 4.0 / 3.0 * std::f64::consts::PI * 0.8f64.powi(3);
            assert!((volume / exact - 1.0).abs() < 0.03, "{volume} {exact}");
        }
    }

    #[test]
    fn distance_to_triangle_covers_face_edges_and_corners() {
        let triangle = [DVec3::ZERO, DVec3::X, DVec3::Y];
        for (p, expected) in [
            (DVec3::new(0.2, 0.2, 0.5), 0.5),
            (DVec3::new(0.5, -2.0, 0.0), 2.0),
            (DVec3::new(-3.0, -4.0, 0.0), 5.0),
            (DVec3::new(1.0, 1.0, 0.0), 0.5f64.sqrt()),
        ] {
            assert!((distance_to_triangle(p, triangle) - expected).abs() < 1e-12);
        }
    }
}
