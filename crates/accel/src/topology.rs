//! From boxes to the shape of an 8-wide tree.
//!
//! Here: what `obvhs` is given, its binary tree, the collapse to eight children. Not here: the boxes of the result, which
//! `node.rs` takes from the primitives themselves; so nothing here can make an answer wrong.

use crate::{
    BuildQuality,
    node::{LEAF, MAX_LEVELS, Node, WIDTH},
};
use obvhs::{
    bvh2::{Bvh2, reinsertion::ReinsertionOptimizer},
    ploc::{PlocBuilder, PlocSearchDistance, SortPrecision},
};
use std::ops::Range;
use umbrage_geom::{Aabb, glam::DVec3};

/// Level from which a subtree is cut into equal parts, whatever `obvhs` made of it: the rest then has at most 11 levels.
const BALANCE_FROM: usize = MAX_LEVELS - 12;

/// An 8-wide tree without boxes.
pub(crate) struct Topology<L> {
    pub(crate) nodes: Vec<Node>,
    /// Each leaf's part of `order`, and what its owner made of it.
    pub(crate) leaves: Vec<(Range<u32>, L)>,
    /// The primitives, leaf by leaf.
    pub(crate) order: Vec<u32>,
}

/// Mixes bits (the finalizer of MurmurHash3) into a number in `[0, 1)`.
fn hash(seed: u32) -> f32 {
    let mut h = seed;
    h = (h ^ h >> 16).wrapping_mul(0x85eb_ca6b);
    h = (h ^ h >> 13).wrapping_mul(0xc2b2_ae35);
    (h ^ h >> 16) as f32 / 2f32.powi(32)
}

/// Boxes fit for `obvhs`: scaled so that no area over- or underflows, and each face moved out by a random part of 1/256 of
/// the box.
///
/// PLOC merges what are mutually nearest. Where many unions have equal areas (grids, copies of one triangle) each
/// cluster prefers its successor, one pair is merged a round and the build takes quadratic time; unequal boxes prevent that.
fn hints(boxes: &[Aabb]) -> Vec<obvhs::aabb::Aabb> {
    let largest =
        boxes.iter().fold(0f32, |m, b| m.max(b.min.abs().max_element()).max(b.max.abs().max_element()));
    let largest = f64::from(largest.max(f32::from_bits(1)));
    let scale = 2f64.powi(40 - largest.log2().ceil() as i32);
    boxes
        .iter()
        .enumerate()
        .map(|(i, b)| {
            let (min, max) = (b.min.as_dvec3() * scale, b.max.as_dvec3() * scale);
            let (extent, size) = ((max - min).max_element(), min.abs().max(max.abs()).max_element());
            // Boxes of a few units in the last place need more room for different values.
            let coarse = if extent < size * 2f64.powi(-22) { size * 2f64.powi(-14) } else { 0.0 };
            let pad = (extent / 256.0).max(coarse).max(2f64.powi(8));
            let face = |k: u32| pad * f64::from(hash((i as u32).wrapping_mul(6).wrapping_add(k)));
            let low = DVec3::new(face(0), face(1), face(2));
            let high = DVec3::new(face(3), face(4), face(5)) + 2f64.powi(6);
            obvhs::aabb::Aabb::new((min - low).as_vec3a(), (max + high).as_vec3a())
        })
        .collect()
}

/// Subtrees of the binary tree cover runs of the primitives in its depth-first order.
pub(crate) struct Binary {
    pub(crate) bvh: Bvh2,
    /// First of `order` below each node.
    pub(crate) first: Vec<u32>,
    /// Primitives below each node.
    pub(crate) count: Vec<u32>,
    pub(crate) order: Vec<u32>,
}

/// Largest number of nodes on a path from the root.
fn depth(bvh: &Bvh2) -> usize {
    let (mut deepest, mut stack) = (0, vec![(0u32, 1)]);
    while let Some((index, level)) = stack.pop() {
        deepest = deepest.max(level);
        let node = &bvh.nodes[index as usize];
        if !node.is_leaf() {
            stack.extend([(node.first_index, level + 1), (node.first_index + 1, level + 1)]);
        }
    }
    deepest
}

impl Binary {
    pub(crate) fn build(boxes: &[Aabb], quality: BuildQuality) -> Self {
        let hints = hints(boxes);
        let indices = (0..boxes.len() as u32).collect();
        let search = match quality {
            BuildQuality::Fast => PlocSearchDistance::Low,
            BuildQuality::High => PlocSearchDistance::Medium,
        };
        let mut bvh = PlocBuilder::new().build(search, &hints, indices, SortPrecision::U64, 1);
        if quality == BuildQuality::High {
            let mut optimizer = ReinsertionOptimizer::default();
            for round in 0..8 {
                // Its stack is as large as this says; each round may deepen the tree.
                bvh.max_depth = depth(&bvh) + 1;
                optimizer.run(&mut bvh, 0.2, Some(vec![1.0 / (2 * round + 1) as f32]));
            }
        }
        Self::order(bvh)
    }

    fn order(bvh: Bvh2) -> Self {
        let len = bvh.nodes.len();
        let mut this = Self { first: vec![0; len], count: vec![0; len], order: Vec::new(), bvh };
        this.order.resize(this.bvh.primitive_indices.len(), 0);
        if this.bvh.children_are_ordered_after_parents {
            this.number(|len| 0..len);
        } else {
            let preorder = this.preorder();
            this.number(|_| preorder.iter().map(|&index| index as usize));
        }
        this
    }

    /// All nodes, parents before their children.
    fn preorder(&self) -> Vec<u32> {
        let mut preorder = Vec::with_capacity(self.bvh.nodes.len());
        let mut stack = vec![0u32];
        while let Some(index) = stack.pop() {
            preorder.push(index);
            let node = &self.bvh.nodes[index as usize];
            if !node.is_leaf() {
                stack.extend([node.first_index + 1, node.first_index]);
            }
        }
        preorder
    }

    /// Counts from the leaves up, then lays the primitives out from the root down; `nodes` are those of so many, parents
    /// before their children.
    fn number<I: DoubleEndedIterator<Item = usize>>(&mut self, nodes: impl Fn(usize) -> I) {
        let len = self.bvh.nodes.len();
        for i in nodes(len).rev() {
            let node = &self.bvh.nodes[i];
            let child = node.first_index as usize;
            self.count[i] =
                if node.is_leaf() { node.prim_count } else { self.count[child] + self.count[child + 1] };
        }
        for i in nodes(len) {
            let node = &self.bvh.nodes[i];
            let (first, child) = (self.first[i] as usize, node.first_index as usize);
            if node.is_leaf() {
                let len = node.prim_count as usize;
                self.order[first..first + len]
                    .copy_from_slice(&self.bvh.primitive_indices[child..child + len]);
            } else {
                (self.first[child], self.first[child + 1]) = (first as u32, first as u32 + self.count[child]);
            }
        }
    }
}

/// What becomes one child.
#[derive(Clone, Copy)]
enum Part {
    /// A subtree of the binary tree.
    Node(u32),
    /// A run of its order.
    Run { first: u32, count: u32 },
}

impl Part {
    fn range(self, binary: &Binary) -> Range<u32> {
        match self {
            Self::Node(i) => binary.first[i as usize]..binary.first[i as usize] + binary.count[i as usize],
            Self::Run { first, count } => first..first + count,
        }
    }

    /// Area of a subtree; runs only meet each other and go by length.
    fn priority(self, binary: &Binary) -> f32 {
        match self {
            Self::Node(i) => binary.bvh.nodes[i as usize].aabb().half_area(),
            Self::Run { count, .. } => count as f32,
        }
    }

    /// The two halves of a part that is more than one primitive.
    fn split(self, binary: &Binary) -> [Self; 2] {
        match self {
            Self::Node(i) if !binary.bvh.nodes[i as usize].is_leaf() => {
                let child = binary.bvh.nodes[i as usize].first_index;
                [Self::Node(child), Self::Node(child + 1)]
            }
            _ => {
                let Range { start, end } = self.range(binary);
                let middle = start + (end - start) / 2;
                [
                    Self::Run { first: start, count: middle - start },
                    Self::Run { first: middle, count: end - middle },
                ]
            }
        }
    }
}

/// A part with what decides its fate: its priority and, if it fits one, its leaf.
struct Child<L> {
    part: Part,
    priority: f32,
    leaf: Option<L>,
}

/// Up to eight parts of `part`, opening the one of largest area first.
fn open<L>(part: Part, binary: &Binary, leaf_of: &impl Fn(Part) -> Option<L>, children: &mut Vec<Child<L>>) {
    let child = |part: Part| Child { part, priority: part.priority(binary), leaf: leaf_of(part) };
    children.clear();
    children.push(child(part));
    while children.len() < WIDTH {
        let candidates = children.iter().enumerate().filter(|(_, child)| child.leaf.is_none());
        let largest = candidates.max_by(|a, b| a.1.priority.total_cmp(&b.1.priority));
        let Some((index, largest)) = largest else { break };
        let [left, right] = largest.part.split(binary);
        children[index] = child(left);
        children.push(child(right));
    }
}

impl<L> Topology<L> {
    /// A tree over `boxes`, of which there is at least one; `fits` makes a leaf of some primitives if it can, and always
    /// of one. `area` is that of a primitive's surface, one side counted.
    pub(crate) fn build(
        boxes: &[Aabb],
        quality: BuildQuality,
        area: impl Fn(u32) -> f32,
        fits: impl Fn(&[u32]) -> Option<L>,
    ) -> Self {
        let binary = Binary::build(boxes, quality);
        let leaf_of = |part: Part| {
            let Range { start, end } = part.range(&binary);
            fits(&binary.order[start as usize..end as usize])
        };
        // About as many as there will be.
        let mut nodes = Vec::with_capacity(boxes.len() / 16 + 1);
        nodes.push(Node::EMPTY);
        let mut leaves = Vec::with_capacity(boxes.len() / 4 + 1);
        let mut ends = Vec::with_capacity(boxes.len() / 4 + 1);
        // (part, index of its node, level)
        let mut stack = vec![(Part::Node(0), 0, 1)];
        let mut children = Vec::with_capacity(WIDTH);
        while let Some((part, index, level)) = stack.pop() {
            let part = if level < BALANCE_FROM {
                part
            } else {
                let range = part.range(&binary);
                Part::Run { first: range.start, count: range.len() as u32 }
            };
            open(part, &binary, &leaf_of, &mut children);
            let bottom = stack.len();
            for (slot, child) in children.drain(..).enumerate() {
                nodes[index].children[slot] = if let Some(leaf) = child.leaf {
                    let range = child.part.range(&binary);
                    // Here, where what it reads has just been read.
                    let run = &binary.order[range.start as usize..range.end as usize];
                    ends.push(Subtree::leaf(run, boxes, &area));
                    leaves.push((range, leaf));
                    LEAF | (leaves.len() - 1) as u32
                } else {
                    stack.push((child.part, nodes.len(), level + 1));
                    nodes.push(Node::EMPTY);
                    (nodes.len() - 1) as u32
                };
            }
            stack[bottom..].reverse();
        }
        let mut this = Self { nodes, leaves, order: binary.order };
        this.arrange(&ends);
        this
    }

    /// Orders the children of each node: first what stops a ray with the greatest probability for its cost.
    ///
    /// `[Ize11]`, RTSAH, for eight children and taken from the surface: a triangle stops a ray that enters its
    /// leaf with the probability of their mean shadows' ratio. Optical depths add up to opaque after so many triangles that
    /// their form for attenuating ones makes no difference to sums.
    fn arrange(&mut self, leaves: &[Subtree]) {
        let mut below = vec![Subtree::default(); self.nodes.len()];
        for i in (0..self.nodes.len()).rev() {
            let node = &mut self.nodes[i];
            let mut parts = [(Subtree::default(), u32::MAX); WIDTH];
            let mut all = Aabb::EMPTY;
            let used = node.children.iter().take_while(|&&child| child != u32::MAX).count();
            for (part, &child) in parts.iter_mut().zip(&node.children[..used]) {
                let index = (child & !LEAF) as usize;
                let subtree = if child & LEAF == 0 { below[index] } else { leaves[index] };
                all = all.union(subtree.aabb);
                *part = (subtree, child);
            }
            // By multiplication, so that nothing divides by 0.
            parts[..used].sort_by(|(a, _), (b, _)| (b.stop * a.cost).total_cmp(&(a.stop * b.cost)));
            let (mut cost, mut pass) = (1.0, 1.0);
            for (slot, (subtree, child)) in parts[..used].iter().enumerate() {
                let share = if all.area() > 0.0 { subtree.aabb.area() / all.area() } else { 1.0 };
                cost += pass * share * subtree.cost;
                pass *= 1.0 - share * subtree.stop;
                node.children[slot] = *child;
                node.set_merit(slot, subtree.stop / subtree.cost);
            }
            below[i] = Subtree { aabb: all, cost, stop: 1.0 - pass };
        }
    }
}

/// What a ray meets in a subtree.
#[derive(Clone, Copy)]
struct Subtree {
    aabb: Aabb,
    /// Expected steps of a ray that enters.
    cost: f32,
    /// Probability that a ray that enters ends inside.
    stop: f32,
}

impl Default for Subtree {
    fn default() -> Self {
        Self { aabb: Aabb::EMPTY, cost: 1.0, stop: 0.0 }
    }
}

impl Subtree {
    fn leaf(prims: &[u32], boxes: &[Aabb], area: &impl Fn(u32) -> f32) -> Self {
        let aabb = prims.iter().fold(Aabb::EMPTY, |all, &prim| all.union(boxes[prim as usize]));
        // Half the area of a triangle and a quarter of that of a box: their mean shadows.
        let share = |&prim: &u32| (2.0 * area(prim) / aabb.area().max(f32::MIN_POSITIVE)).clamp(0.0, 1.0);
        let pass: f32 = prims.iter().map(|prim| 1.0 - share(prim)).product();
        Self { aabb, cost: 1.0, stop: 1.0 - pass }
    }
}
