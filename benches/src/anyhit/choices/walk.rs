//! One ray through a tree, with either test at the leaves.

use super::tree::{LEAF, Leaf, Tree};
use umbrage_geom::{
    OpticalDepth, Ray, SlabRay,
    kernel::{BlockRay, LANES},
    segment_hits_triangle,
    simd::{Avx2, BackEnd, Job},
};

/// Most children waiting: seven a level of a binary tree of at most 87, and the last node's.
const STACK: usize = 7 * 87 + 8;

/// What is asked about each ray.
#[derive(Clone, Copy)]
pub enum Question {
    /// Whether anything is hit.
    AnyHit,
    /// Whether nothing gets through where every eighth triangle has the first depth, the others the second.
    Mixed([OpticalDepth; 2]),
}

/// Answers of a pass and the work they took.
#[derive(Clone, Debug, Default)]
pub struct Answers {
    /// Whether nothing gets through.
    pub hits: Vec<bool>,
    pub nodes: u64,
    pub leaf_tests: u64,
}

/// A test of a leaf's triangles.
pub trait Leaves: Copy + 'static {
    type Ray;

    /// What the test needs of a valid ray.
    fn prepare(self, ray: &Ray) -> Option<Self::Ray>;

    /// Lanes that are hit; with `any` perhaps only some of them.
    fn test(self, leaf: &Leaf, prepared: &Self::Ray, ray: &Ray, any: bool) -> u8;
}

/// The workspace's predicate with its filter.
#[derive(Clone, Copy)]
pub struct Exact(pub Avx2);

impl Leaves for Exact {
    type Ray = BlockRay;

    #[inline(always)]
    fn prepare(self, ray: &Ray) -> Option<BlockRay> {
        BlockRay::new(ray)
    }

    #[inline(always)]
    fn test(self, leaf: &Leaf, prepared: &BlockRay, ray: &Ray, any: bool) -> u8 {
        let mask = self.0.filter(&leaf.lanes, prepared);
        let (mut hits, mut open) = (mask.certain, mask.uncertain);
        while open != 0 && !(any && hits != 0) {
            let lane = open.trailing_zeros() as usize % LANES;
            open &= open - 1;
            let corners = [0, 1, 2].map(|c| [0, 1, 2].map(|axis| leaf.corners[c][axis][lane]));
            hits |= u8::from(segment_hits_triangle(ray, corners)) << lane;
        }
        hits
    }
}

/// Woop, Benthin and Wald 2013 in `f32` and nothing else: no bound, no second precision.
#[derive(Clone, Copy)]
pub struct Woop;

/// A ray for [`Woop`].
pub struct Sheared {
    axes: [usize; 3],
    origin: [f32; 3],
    shear: [f32; 3],
    ends: [f32; 2],
}

impl Leaves for Woop {
    type Ray = Sheared;

    #[inline(always)]
    fn prepare(self, ray: &Ray) -> Option<Sheared> {
        let size = ray.direction.abs();
        let (z, larger) = if size.x > size.y { (0, size.x) } else { (1, size.y) };
        let z = if larger > size.z { z } else { 2 };
        let axes = [(z + 1) % 3, (z + 2) % 3, z];
        let (o, d) = (ray.origin.to_array(), ray.direction.to_array());
        let inverse = 1.0 / d[z];
        Some(Sheared {
            axes,
            origin: [o[axes[0]], o[axes[1]], o[axes[2]]],
            shear: [d[axes[0]] * inverse, d[axes[1]] * inverse, inverse],
            ends: [ray.tnear, ray.tfar],
        })
    }

    #[inline(always)]
    fn test(self, leaf: &Leaf, ray: &Sheared, _: &Ray, _: bool) -> u8 {
        let mut p = [[[0f32; LANES]; 3]; 3];
        for (c, sheared) in p.iter_mut().enumerate() {
            let rows = &leaf.corners[c];
            let (x, y, z) = (&rows[ray.axes[0] % 3], &rows[ray.axes[1] % 3], &rows[ray.axes[2] % 3]);
            for i in 0..LANES {
                let depth = z[i] - ray.origin[2];
                sheared[0][i] = (-ray.shear[0]).mul_add(depth, x[i] - ray.origin[0]);
                sheared[1][i] = (-ray.shear[1]).mul_add(depth, y[i] - ray.origin[1]);
                sheared[2][i] = ray.shear[2] * depth;
            }
        }
        let [a, b, c] = &p;
        let mut bits = [0u32; LANES];
        for i in 0..LANES {
            let u = c[0][i].mul_add(b[1][i], -(c[1][i] * b[0][i]));
            let v = a[0][i].mul_add(c[1][i], -(a[1][i] * c[0][i]));
            let w = b[0][i].mul_add(a[1][i], -(b[1][i] * a[0][i]));
            let inside = (u >= 0.0) & (v >= 0.0) & (w >= 0.0) | (u <= 0.0) & (v <= 0.0) & (w <= 0.0);
            let det = u + v + w;
            let size = det.abs();
            let depth = u.mul_add(a[2][i], v.mul_add(b[2][i], w * c[2][i]));
            let depth = if det < 0.0 { -depth } else { depth };
            let hit = inside & (det != 0.0) & (depth > ray.ends[0] * size) & (depth < ray.ends[1] * size);
            bits[i] = u32::from(hit) << i;
        }
        bits.iter().fold(0, |mask, bit| mask | bit) as u8
    }
}

/// Walks; children in the order of their slots, or near boxes first.
#[inline(always)]
fn walk<const W: usize, L: Leaves, const NEAR_FIRST: bool>(
    tree: &Tree<W>,
    ray: &Ray,
    leaves: L,
    question: Question,
    answers: &mut Answers,
) -> bool {
    let (Some(slab), Some(prepared)) = (SlabRay::new(ray), leaves.prepare(ray)) else { return false };
    let (near, far) = (slab.origin_near.to_array(), slab.origin_far.to_array());
    let (inv_near, inv_far) = (slab.inv_near.to_array(), slab.inv_far.to_array());
    let first = [0, 1, 2].map(|axis| 2 * axis + usize::from(inv_near[axis] < 0.0));
    let any = matches!(question, Question::AnyHit);
    let mut depth = OpticalDepth::CLEAR;
    let mut stack = [(0f32, 0u32); STACK];
    let mut top = 1;
    while top > 0 {
        top -= 1;
        let child = stack[top].1;
        if child & LEAF != 0 {
            let leaf = &tree.leaves[(child & !LEAF) as usize];
            answers.leaf_tests += 1;
            let mut hits = leaves.test(leaf, &prepared, ray, any);
            match question {
                Question::AnyHit if hits != 0 => return true,
                Question::AnyHit => {}
                Question::Mixed(depths) => {
                    while hits != 0 {
                        let lane = hits.trailing_zeros() as usize % LANES;
                        hits &= hits - 1;
                        depth += depths[usize::from(!leaf.prims[lane].is_multiple_of(8))];
                    }
                    if depth.is_opaque() {
                        return true;
                    }
                }
            }
            continue;
        }
        let node = &tree.nodes[child as usize];
        answers.nodes += 1;
        let (mut entry, mut exit) = ([slab.tnear; W], [slab.tfar; W]);
        for axis in 0..3 {
            let (nears, fars) = (&node.rows[first[axis] % 6], &node.rows[(first[axis] ^ 1) % 6]);
            for i in 0..W {
                let (t0, t1) =
                    ((nears[i] - near[axis]) * inv_near[axis], (fars[i] - far[axis]) * inv_far[axis]);
                entry[i] = if t0 > entry[i] { t0 } else { entry[i] };
                exit[i] = if t1 < exit[i] { t1 } else { exit[i] };
            }
        }
        let bottom = top;
        for slot in (0..W).rev() {
            stack[top] = (entry[slot], node.children[slot]);
            top += usize::from(entry[slot] <= exit[slot]);
            if NEAR_FIRST {
                // Insertion, nearest on top.
                let mut at = top.max(bottom + 1) - 1;
                while at > bottom && stack[at - 1].0 < stack[at].0 {
                    stack.swap(at, at - 1);
                    at -= 1;
                }
            }
        }
    }
    false
}

/// A pass over all rays.
struct Pass<'a, const W: usize, L, const NEAR_FIRST: bool> {
    tree: &'a Tree<W>,
    rays: &'a [Ray],
    leaves: L,
    question: Question,
}

impl<const W: usize, L: Leaves, const NEAR_FIRST: bool> Job for Pass<'_, W, L, NEAR_FIRST> {
    type Output = Answers;

    #[inline(always)]
    fn run(self) -> Answers {
        let Self { tree, rays, leaves, question } = self;
        let mut answers = Answers { hits: Vec::with_capacity(rays.len()), ..Answers::default() };
        for ray in rays {
            let hit = walk::<W, L, NEAR_FIRST>(tree, ray, leaves, question, &mut answers);
            answers.hits.push(hit);
        }
        answers
    }
}

/// Answers all rays.
pub fn answer<const W: usize, L: Leaves>(
    tree: &Tree<W>,
    rays: &[Ray],
    leaves: L,
    question: Question,
    near_first: bool,
) -> Answers {
    if near_first {
        BackEnd::Avx2.run(Pass::<W, L, true> { tree, rays, leaves, question })
    } else {
        BackEnd::Avx2.run(Pass::<W, L, false> { tree, rays, leaves, question })
    }
}
