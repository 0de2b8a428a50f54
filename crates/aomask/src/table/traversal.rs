//! Ambient occlusion by BVH traversal (`[Laine10]`, section 5), one receiver at a time.
//!
//! Here: culling by the hemisphere, the order of nodes, the end when all rays are blocked. Not here: masks of nodes and
//! triangles (`node_mask.rs`, `triangle_mask.rs`). The paper's speculative while-while loop keeps GPU lanes together and has no
//! use on one CPU thread.

use super::{
    lanes::{F8, V8, gain},
    node_mask::{LocalBoxes, NodeLookup, NodeMasks},
    triangle_mask::{Local, TriangleTables, Triangles},
};
use crate::{Pattern, Receiver, Sides};
use umbrage_accel::{Child, Statistics, View};
use umbrage_geom::Aabb;

/// What all receivers of a call share.
pub(crate) struct Scene<'a, const W: usize> {
    pub(crate) view: View<'a>,
    pub(crate) bounds: Aabb,
    pub(crate) pattern: &'a Pattern,
    pub(crate) triangles: TriangleTables<'a, W>,
    pub(crate) nodes: NodeLookup<'a, W>,
    pub(crate) node_masks: NodeMasks,
    pub(crate) radius: f32,
    pub(crate) sides: Sides,
}

/// A node or leaf to visit, with the rays it may block.
#[derive(Clone, Copy)]
pub(crate) struct Entry<const W: usize> {
    child: Child,
    mask: [u64; W],
}

/// Room for a walk.
pub(crate) type Stack<const W: usize> = Vec<Entry<W>>;

impl<const W: usize> Scene<'_, W> {
    /// Mask of the rays of `receiver` that are blocked. Rays not in `blocked` at the start are asked about.
    #[inline(always)]
    pub(crate) fn blocked<S: Statistics>(
        &self,
        receiver: &Receiver,
        mut blocked: [u64; W],
        stack: &mut Stack<W>,
        stats: &mut S,
    ) -> [u64; W] {
        let local = self.local(receiver);
        stack.clear();
        stack.push(Entry { child: Child::Node(0), mask: [!0; W] });
        while let Some(Entry { child, mask }) = stack.pop() {
            // Occlusion has built up since the node was pushed.
            if gain(&mask, &blocked) == 0 {
                continue;
            }
            match child {
                Child::Node(node) => self.node(node, &local, &blocked, stack, stats),
                Child::Leaf(leaf) => {
                    self.leaf(leaf, &local, &mut blocked, stats);
                    if blocked == [!0; W] {
                        break;
                    }
                }
            }
        }
        blocked
    }

    /// The pattern's axes, and a radius that ends behind the scene.
    ///
    /// With rays of equal length a radius beyond the farthest corner of the scene changes no answer, but the table would
    /// spend its distances on nothing.
    fn local(&self, receiver: &Receiver) -> Local {
        let mut radius = self.radius.max(1e-30);
        if self.pattern.has_equal_lengths() {
            let p = receiver.point();
            let farthest = (self.bounds.min - p).abs().max((self.bounds.max - p).abs());
            radius = radius.min((farthest.as_dvec3().length() * 1.001) as f32).max(1e-30);
        }
        Local::new(receiver.point(), &self.pattern.frame_of(receiver), radius)
    }

    #[inline(always)]
    fn node<S: Statistics>(
        &self,
        index: u32,
        local: &Local,
        blocked: &[u64; W],
        stack: &mut Stack<W>,
        stats: &mut S,
    ) {
        let node = self.view.node(index);
        let (boxes, alive) = hemisphere(node.bounds(), node.used(), local);
        stats.node(node.len() as u32);
        let mut order = [(0u32, 0usize); 8];
        let mut masks = [[0; W]; 8];
        let mut count = 0;
        // Few new rays first: the stack is last in, first out.
        let mut visit = |i: usize, mask: [u64; W]| {
            let gain = gain(&mask, blocked);
            if gain > 0 {
                masks[i] = mask;
                let mut at = count;
                while at > 0 && order[at - 1].0 > gain {
                    order[at] = order[at - 1];
                    at -= 1;
                }
                order[at] = (gain, i);
                count += 1;
            }
        };
        match self.node_masks {
            NodeMasks::Circle => self.nodes.circles(&boxes, alive, visit),
            NodeMasks::Silhouette => {
                for i in (0..8).filter(|i| alive >> i & 1 == 1) {
                    let (low, high) = (boxes.low.lane(i), boxes.high.lane(i));
                    visit(i, self.nodes.silhouette(low, high, |v| local.turn(v)));
                }
            }
        }
        stats.node_masks(alive.count_ones(), alive.count_ones() - count as u32);
        for &(_, i) in &order[..count] {
            stack.push(Entry { child: node.child(i), mask: masks[i] });
        }
    }

    #[inline(always)]
    fn leaf<S: Statistics>(&self, index: u32, local: &Local, blocked: &mut [u64; W], stats: &mut S) {
        let block = self.view.leaf(index);
        let [a, b, c] = block.corners();
        let corners = [local.points(&a), local.points(&b), local.points(&c)];
        let mut triangles = Triangles::new(corners, V8::splat(local.up()), self.sides);
        // Comparisons with unused lanes, which are not a number, are false.
        let used = corners[0].x.le(F8::splat(f32::INFINITY));
        let large = triangles.large & used;
        for i in (0..8).filter(|i| large >> i & 1 == 1) {
            let corners = block.get(i).map(|p| local.point(p));
            triangles.redo_large(i, corners, local.up().into(), self.sides);
        }
        // The order of the paper.
        let mut alive = used;
        let mut after = [0; 4];
        let tests = [triangles.above, triangles.facing, triangles.close, triangles.reached];
        for (test, after) in tests.into_iter().zip(&mut after) {
            alive &= test;
            *after = alive.count_ones();
        }
        stats.triangles(used.count_ones());
        stats.triangles_after(after);
        if alive != 0 {
            triangles.masks(
                alive,
                self.triangles,
                |v| local.turn(v),
                0.0,
                |_, mask| {
                    for w in 0..W {
                        blocked[w] |= mask[w];
                    }
                },
            );
        }
    }
}

/// Children whose boxes meet the hemisphere: not beyond the radius, not wholly below the horizon.
#[inline(always)]
fn hemisphere(bounds: [[f32; 8]; 6], used: u32, local: &Local) -> (LocalBoxes, u32) {
    let [x0, x1, y0, y1, z0, z1] = bounds;
    let (low, high) = (local.points(&[x0, y0, z0]), local.points(&[x1, y1, z1]));
    let half = F8::splat(0.5);
    let center = local.turn((low + high).scale(half));
    let extent = (high - low).scale(half);
    let zero = V8::splat([0.0; 3]);
    let gap = low.max(zero - high).max(zero);
    let rise = V8::splat(local.up().map(f32::abs)).dot(extent);
    let near = gap.dot(gap).le(F8::splat(1.0 + 1e-5));
    let alive = used & near & F8::ZERO.le(center.z + rise * F8::splat(1.0 + 1e-5));
    (LocalBoxes { low, high, center, half_diagonal2: extent.dot(extent) }, alive)
}
