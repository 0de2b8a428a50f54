//! Any-hit of a single ray.

use super::{
    LightRoot, SolidBvh, Watch,
    kernel::{Kernel, NodeRay},
    node::{LEAF, MAX_LEVELS, Node, WIDTH},
};
use crate::volumetric::Ends;
use umbrage_geom::{
    Ray, SlabRay,
    kernel::{BlockMask, BlockRay, LANES},
    segment_hits_triangle,
};

/// A valid ray prepared for boxes and triangles.
pub(super) struct Prepared<'a> {
    pub(super) ray: &'a Ray,
    pub(super) node: NodeRay,
    pub(super) block: BlockRay,
}

impl<'a> Prepared<'a> {
    #[inline(always)]
    pub(super) fn new(ray: &'a Ray) -> Option<Self> {
        Some(Self { ray, node: NodeRay::new(SlabRay::new(ray)?), block: BlockRay::new(ray)? })
    }
}

/// Whether the ray hits anything below `start`, a child as nodes hold it.
#[inline(always)]
pub(super) fn any_hit<K: Kernel, W: Watch>(
    kernel: K,
    this: &SolidBvh,
    ray: &Prepared,
    ends: Ends,
    start: u32,
    mut light: Option<&mut LightRoot>,
    watch: &mut W,
) -> bool {
    if start & LEAF != 0 {
        watch.leaf();
        return leaf_hit(kernel, this, start & !LEAF, ray);
    }
    let mut stack = [(0u32, 0u32); MAX_LEVELS];
    let mut depth = 0;
    let mut index = start;
    let mut mask;
    // Whether solid boxes may still end the ray; cleared when the endpoint rule says no.
    let mut solids = true;
    loop {
        let node = match &light {
            Some(light) if index == 0 => &light.node,
            _ => &this.nodes[index as usize],
        };
        watch.node();
        mask = kernel.mask(node, &ray.node);
        let solid = mask & node.solid;
        mask &= !node.solid;
        if solid != 0
            && solids
            && let Some(slot) = first_crossed(node, solid, ray)
        {
            let (aabb, solid) = (node.aabb(slot), node.children[slot]);
            if this.vouches(solid, ray.ray, &ray.node.slab, ends) {
                watch.solid(index == 0);
                if index != 0
                    && let Some(light) = &mut light
                {
                    light.remember(&aabb, solid);
                }
                return true;
            }
            // The ends may be outside of another generator, but few rays are like this.
            solids = false;
        }
        let mut children = &node.children;
        // Leaves, up to the next node.
        index = loop {
            if mask == 0 {
                if depth == 0 {
                    return false;
                }
                depth -= 1;
                (index, mask) = stack[depth];
                children = match &light {
                    Some(light) if index == 0 => &light.node.children,
                    _ => &this.nodes[index as usize].children,
                };
            }
            let child = children[mask.trailing_zeros() as usize % WIDTH];
            mask &= mask - 1;
            if child & LEAF == 0 {
                if mask != 0 {
                    stack[depth] = (index, mask);
                    depth += 1;
                }
                break child;
            }
            watch.leaf();
            if leaf_hit(kernel, this, child & !LEAF, ray) {
                return true;
            }
        };
    }
}

/// The first of the `solid` slots whose box the segment surely crosses.
#[inline(always)]
fn first_crossed(node: &Node, mut solid: u32, ray: &Prepared) -> Option<usize> {
    while solid != 0 {
        let slot = solid.trailing_zeros() as usize % WIDTH;
        solid &= solid - 1;
        if ray.node.slab.surely_crosses(&node.aabb(slot)) {
            return Some(slot);
        }
    }
    None
}

/// Whether a triangle of the leaf is hit.
#[inline(always)]
pub(super) fn leaf_hit<K: Kernel>(kernel: K, this: &SolidBvh, leaf: u32, ray: &Prepared) -> bool {
    let block = &this.bvh.leaf_blocks()[leaf as usize];
    let BlockMask { certain, uncertain: mut open } = kernel.filter(block, &ray.block);
    if certain != 0 {
        return true;
    }
    while open != 0 {
        let lane = open.trailing_zeros() as usize % LANES;
        open &= open - 1;
        if segment_hits_triangle(ray.ray, block.get(lane)) {
            return true;
        }
    }
    false
}
