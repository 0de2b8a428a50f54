//! Any-hit of a fan: rays that share an origin, such as those of a receiver to one light, walk together.
//!
//! A node is first tested against the whole fan, by intervals of reciprocal directions; each child left is tested against each
//! ray, so that rays part at silhouettes. Where few rays are left they go on alone. What a leaf's triangles have in common for
//! all rays (cross products of corners seen from the origin) is computed once.
//!
//! # The filter
//! With `A = a - o` and so on, `e` the side from `B` to `C`, `u = 2^-24`, `M` the largest `|coordinate|` of `A`, `B`, `C`, `L`
//! that of the sides and `D` that of `d`: a component of `B x e = B x C` errs by at most `8 u M L` (three roundings a product,
//! one of the difference), `d . (B x e)` by `3 D 8 u M L` plus `16 u D M L` for its own operations: less than
//! `E = 64 u D M L`. `V = A . (B x e)` errs by less than `64 u M^2 L` likewise, and the sum `S` of three edges by `4 E`. The
//! hit is at `t = V / S`, so it is beyond `z` for certain if `V - z S`, signed as `S`, is larger than `80 u M^2 L + 5 z E`,
//! and before it if smaller than minus that. `M` and `L` between `2^-30` and `2^30` and `D` between `2^-20` and `2^20` keep
//! all this from under- and overflow; what is not certain, the predicate decides. (With `B x C` itself, `L` would be `M`, far
//! too much for small triangles.)

use super::{
    LightRoot, SolidBvh,
    kernel::{Kernel, NodeRay},
    node::{LEAF, MAX_LEVELS, Node, WIDTH},
    walk::{self, Prepared},
};
use crate::volumetric::Ends;
use umbrage_geom::{
    Aabb, Ray, SlabRay,
    kernel::{BlockRay, LANES, TriangleBlock},
    plane_side, segment_hits_triangle,
};

/// Most rays of a fan.
pub(super) const RAYS: usize = 24;

/// Rays that rather go on alone.
const FEW: u32 = 3;

/// Intervals of lanes that are not used: empty.
const NO_START: Lanes = [[1.0; WIDTH]; RAYS / WIDTH];
const NO_END: Lanes = [[-1.0; WIDTH]; RAYS / WIDTH];

const UNIT: f32 = 1.0 / (1u32 << 24) as f32;

/// Lanes in groups of eight.
type Lanes = [[f32; WIDTH]; RAYS / WIDTH];

/// Signs of a direction component over the fan.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Sign {
    Forward,
    Backward,
    Mixed,
}

/// Rays of one origin, one a lane.
#[derive(Clone, Debug)]
pub(super) struct Fan {
    slabs: Vec<SlabRay>,
    /// Rays that went on alone, prepared once.
    alone: [Option<BlockRay>; RAYS],
    /// Ray of each lane.
    places: [u8; RAYS],
    origin: [f32; 3],
    near: [Lanes; 3],
    far: [Lanes; 3],
    tnear: Lanes,
    tfar: Lanes,
    signs: [Sign; 3],
    /// Least and largest reciprocal of each axis whose sign isn't mixed.
    least: [f32; 3],
    most: [f32; 3],
    /// Least start and largest end.
    start: f32,
    end: f32,
    stack: Vec<(u32, u32)>,
}

/// Triangles of a leaf as the fan's origin sees them.
struct SeenBlock {
    /// Components of `B x C`, `C x A`, `A x B`, from a corner and a side each.
    crosses: [[[f32; LANES]; 3]; 3],
    volume: [f32; LANES],
    /// `64 u M L`: times `D` the bound of an edge.
    edge_error: [f32; LANES],
    /// `80 u M^2 L`.
    volume_error: [f32; LANES],
    /// Lanes whose volume is positive, and negative; exact.
    volume_signs: [u32; 2],
    /// Lanes whose numbers can be trusted.
    sane: u32,
    used: u32,
}

impl Fan {
    pub(super) fn new() -> Self {
        Self {
            slabs: Vec::with_capacity(RAYS),
            alone: [None; RAYS],
            places: [0; RAYS],
            origin: [0.0; 3],
            near: [[[1.0; WIDTH]; RAYS / WIDTH]; 3],
            far: [[[1.0; WIDTH]; RAYS / WIDTH]; 3],
            tnear: NO_START,
            tfar: NO_END,
            signs: [Sign::Mixed; 3],
            least: [0.0; 3],
            most: [0.0; 3],
            start: 0.0,
            end: 0.0,
            stack: vec![(0, 0); (WIDTH - 1) * MAX_LEVELS + 1],
        }
    }

    /// Answers up to [`RAYS`] rays that share an origin.
    #[inline(always)]
    pub(super) fn any_hits<K: Kernel>(
        &mut self,
        kernel: K,
        this: &SolidBvh,
        rays: &[Ray],
        hits: &mut [bool],
        ends: Ends,
        mut light: Option<&mut LightRoot>,
    ) {
        hits.fill(false);
        if rays.len() <= FEW as usize || !self.prepare(rays) {
            for (ray, hit) in rays.iter().zip(hits) {
                *hit = Prepared::new(ray).is_some_and(|ray| {
                    walk::any_hit(kernel, this, &ray, ends, 0, light.as_deref_mut(), &mut ())
                });
            }
            return;
        }
        let all = ((1u64 << self.slabs.len()) - 1) as u32;
        let open = self.walk(kernel, this, rays, all, ends, light);
        for (lane, &place) in self.places.iter().enumerate().take(self.slabs.len()) {
            hits[place as usize] = open >> lane & 1 == 0;
        }
    }

    /// Takes over the valid rays; `false` if they can't walk together.
    #[inline(always)]
    fn prepare(&mut self, rays: &[Ray]) -> bool {
        self.slabs.clear();
        for (place, ray) in rays.iter().enumerate() {
            if let Some(slab) = SlabRay::new(ray) {
                let size = ray.direction.abs().max_element();
                if !(2f32.powi(-20)..2f32.powi(20)).contains(&size) {
                    return false;
                }
                self.places[self.slabs.len()] = place as u8;
                self.slabs.push(slab);
            }
        }
        if self.slabs.is_empty() || !SlabRay::share_scale(&mut self.slabs) {
            return self.slabs.is_empty();
        }
        self.origin = self.slabs[0].origin_near.to_array();
        self.alone = [None; RAYS];
        (self.tnear, self.tfar) = (NO_START, NO_END);
        (self.start, self.end) = (f32::INFINITY, 0.0);
        for (lane, slab) in self.slabs.iter().enumerate() {
            let (group, i) = (lane / WIDTH % (RAYS / WIDTH), lane % WIDTH);
            (self.tnear[group][i], self.tfar[group][i]) = (slab.tnear, slab.tfar);
            (self.start, self.end) = (self.start.min(slab.tnear), self.end.max(slab.tfar));
        }
        for axis in 0..3 {
            let (mut forward, mut backward) = (false, false);
            let (mut least, mut most) = (f32::INFINITY, 0f32);
            for (lane, slab) in self.slabs.iter().enumerate() {
                let (near, far) = (slab.inv_near[axis], slab.inv_far[axis]);
                let (group, i) = (lane / WIDTH % (RAYS / WIDTH), lane % WIDTH);
                (self.near[axis][group][i], self.far[axis][group][i]) = (near, far);
                (forward, backward) = (forward | (near >= 0.0), backward | (near < 0.0));
                (least, most) = (least.min(near.abs()), most.max(far.abs()));
            }
            self.signs[axis] = match (forward, backward) {
                (true, false) => Sign::Forward,
                (false, true) => Sign::Backward,
                _ => Sign::Mixed,
            };
            (self.least[axis], self.most[axis]) = (least, most);
        }
        true
    }

    /// Rays of `open` that meet nothing.
    #[inline(always)]
    fn walk<K: Kernel>(
        &mut self,
        kernel: K,
        this: &SolidBvh,
        rays: &[Ray],
        mut open: u32,
        ends: Ends,
        mut light: Option<&mut LightRoot>,
    ) -> u32 {
        let mut top = 1;
        self.stack[0] = (0, open);
        while top > 0 && open != 0 {
            top -= 1;
            let (child, lanes) = self.stack[top];
            let mut lanes = lanes & open;
            if lanes == 0 {
                continue;
            }
            if lanes.count_ones() <= FEW {
                while lanes != 0 {
                    let lane = lanes.trailing_zeros() as usize % RAYS;
                    lanes &= lanes - 1;
                    let ray = &rays[self.places[lane] as usize];
                    let Some(block) = self.alone[lane].or_else(|| BlockRay::new(ray)) else { continue };
                    self.alone[lane] = Some(block);
                    let ray = Prepared { ray, node: NodeRay::new(self.slabs[lane]), block };
                    let light = light.as_deref_mut();
                    let hit = walk::any_hit(kernel, this, &ray, ends, child, light, &mut ());
                    open &= !(u32::from(hit) << lane);
                }
                continue;
            }
            if child & LEAF != 0 {
                open &=
                    !self.leaf_hits(kernel, &this.bvh.leaf_blocks()[(child & !LEAF) as usize], rays, lanes);
                continue;
            }
            let root;
            let node = match &light {
                Some(light) if child == 0 => {
                    root = light.node;
                    &root
                }
                _ => &this.nodes[child as usize],
            };
            let entered = self.shaft(kernel, node) & node.used;
            let mut solid = entered & node.solid;
            while solid != 0 {
                let slot = solid.trailing_zeros() as usize % WIDTH;
                solid &= solid - 1;
                let crossed = self.surely_crossing(kernel, &node.aabb(slot)) & lanes & open;
                if crossed != 0 {
                    let blocked = self.vouched(this, node.children[slot], rays, crossed, ends);
                    open &= !blocked;
                    if child != 0
                        && blocked != 0
                        && let Some(light) = &mut light
                    {
                        light.remember(&node.aabb(slot), node.children[slot]);
                    }
                }
            }
            lanes &= open;
            if lanes == 0 {
                continue;
            }
            // Small boxes first on to the stack, so that large ones are visited first.
            let mut children = entered & !node.solid;
            while children != 0 {
                let slot = (31 - children.leading_zeros()) as usize % WIDTH;
                children &= !(1 << slot);
                let into = self.entering(kernel, &node.aabb(slot), lanes) & lanes;
                if into != 0 {
                    self.stack[top] = (node.children[slot], into);
                    top += 1;
                }
            }
        }
        open
    }

    /// Lanes of `crossed` that the solid box surely blocks.
    #[inline(always)]
    fn vouched(&self, this: &SolidBvh, solid: u32, rays: &[Ray], crossed: u32, ends: Ends) -> u32 {
        let mut blocked = 0;
        let mut rest = crossed;
        while rest != 0 {
            let lane = rest.trailing_zeros() as usize % RAYS;
            rest &= rest - 1;
            let ray = &rays[self.places[lane] as usize];
            blocked |= u32::from(this.vouches(solid, ray, &self.slabs[lane], ends)) << lane;
        }
        blocked
    }

    /// Boxes of a node that some ray may enter: intervals of `t` over all rays.
    #[inline(always)]
    fn shaft<K: Kernel>(&self, kernel: K, node: &Node) -> u32 {
        let (mut entry, mut exit) = ([self.start; WIDTH], [self.end; WIDTH]);
        for axis in 0..3 {
            let (origin, least, most) = (self.origin[axis], self.least[axis], self.most[axis]);
            let (low, high) = (&node.bounds[2 * axis], &node.bounds[2 * axis + 1]);
            // Distances along the fan's side of the axis. Where a plane is behind the origin, every reciprocal says so.
            match self.signs[axis] {
                Sign::Forward => {
                    for i in 0..WIDTH {
                        let (a, b) = ((low[i] - origin) * least, (high[i] - origin) * most);
                        entry[i] = if a > entry[i] { a } else { entry[i] };
                        exit[i] = if b < exit[i] { b } else { exit[i] };
                    }
                }
                Sign::Backward => {
                    for i in 0..WIDTH {
                        let (a, b) = ((origin - high[i]) * least, (origin - low[i]) * most);
                        entry[i] = if a > entry[i] { a } else { entry[i] };
                        exit[i] = if b < exit[i] { b } else { exit[i] };
                    }
                }
                Sign::Mixed => {}
            }
        }
        kernel.at_most(&entry, &exit)
    }

    /// Those of `lanes` that may enter a box, and maybe others: [`SlabRay::entry`] of each.
    #[inline(always)]
    fn entering<K: Kernel>(&self, kernel: K, aabb: &Aabb, lanes: u32) -> u32 {
        let mut mask = 0;
        for group in 0..RAYS / WIDTH {
            if lanes >> (WIDTH * group) & 0xff == 0 {
                continue;
            }
            let (mut entry, mut exit) = (self.tnear[group], self.tfar[group]);
            for axis in 0..3 {
                let (low, high) = (aabb.min[axis] - self.origin[axis], aabb.max[axis] - self.origin[axis]);
                let (near, far) = (&self.near[axis][group], &self.far[axis][group]);
                if self.signs[axis] == Sign::Mixed {
                    for i in 0..WIDTH {
                        let (first, last) = if near[i] >= 0.0 { (low, high) } else { (high, low) };
                        let (a, b) = (first * near[i], last * far[i]);
                        entry[i] = if a > entry[i] { a } else { entry[i] };
                        exit[i] = if b < exit[i] { b } else { exit[i] };
                    }
                } else {
                    let (first, last) =
                        if self.signs[axis] == Sign::Forward { (low, high) } else { (high, low) };
                    for i in 0..WIDTH {
                        let (a, b) = (first * near[i], last * far[i]);
                        entry[i] = if a > entry[i] { a } else { entry[i] };
                        exit[i] = if b < exit[i] { b } else { exit[i] };
                    }
                }
            }
            mask |= kernel.at_most(&entry, &exit) << (WIDTH * group);
        }
        mask
    }

    /// Lanes that surely cross the inside of a box: [`SlabRay::surely_crosses`] of each.
    #[inline(always)]
    fn surely_crossing<K: Kernel>(&self, kernel: K, aabb: &Aabb) -> u32 {
        let mut mask = 0;
        for group in 0..RAYS / WIDTH {
            let (mut entry, mut exit) = (self.tnear[group], self.tfar[group]);
            for i in 0..WIDTH {
                let start = entry[i] * (1.0 + 2f32.powi(-19));
                entry[i] = if start > 2f32.powi(-100) { start } else { 2f32.powi(-100) };
                exit[i] *= 1.0 - 2f32.powi(-19);
            }
            for axis in 0..3 {
                let (low, high) = (aabb.min[axis] - self.origin[axis], aabb.max[axis] - self.origin[axis]);
                let (near, far) = (&self.near[axis][group], &self.far[axis][group]);
                for i in 0..WIDTH {
                    let (first, last) = if near[i] >= 0.0 { (low, high) } else { (high, low) };
                    let (a, b) = (first * far[i], last * near[i]);
                    // A ray in the plane of a face doesn't cross the box.
                    let a = if a.is_nan() { f32::INFINITY } else { a };
                    entry[i] = if a > entry[i] { a } else { entry[i] };
                    exit[i] = if b < exit[i] { b } else { exit[i] };
                }
            }
            mask |= kernel.less(&entry, &exit) << (WIDTH * group);
        }
        mask
    }

    /// Lanes of `lanes` that hit a triangle of the leaf.
    #[inline(always)]
    fn leaf_hits<K: Kernel>(&self, kernel: K, block: &TriangleBlock, rays: &[Ray], mut lanes: u32) -> u32 {
        let seen = SeenBlock::new(kernel, block, self.origin);
        let mut hits = 0;
        while lanes != 0 {
            let lane = lanes.trailing_zeros() as usize % RAYS;
            lanes &= lanes - 1;
            let ray = &rays[self.places[lane] as usize];
            let (certain, mut uncertain) = seen.filter(kernel, ray);
            let mut hit = certain != 0;
            while uncertain != 0 && !hit {
                let place = uncertain.trailing_zeros() as usize % LANES;
                uncertain &= uncertain - 1;
                hit = segment_hits_triangle(ray, block.get(place));
            }
            hits |= u32::from(hit) << lane;
        }
        hits
    }
}

impl SeenBlock {
    #[inline(always)]
    fn new<K: Kernel>(kernel: K, block: &TriangleBlock, origin: [f32; 3]) -> Self {
        let given = block.corners();
        let mut corners = given;
        let mut size = [0f32; LANES];
        for corner in &mut corners {
            for axis in 0..3 {
                for i in 0..LANES {
                    corner[axis][i] -= origin[axis];
                    let x = corner[axis][i].abs();
                    size[i] = if x > size[i] { x } else { size[i] };
                }
            }
        }
        let [a, b, c] = &corners;
        let mut crosses = [[[0f32; LANES]; 3]; 3];
        let mut length = [0f32; LANES];
        for (cross, (p, from, to)) in crosses.iter_mut().zip([(b, 1, 2), (c, 2, 0), (a, 0, 1)]) {
            // The side from corners as given, which is closer than from those that are rounded already.
            let mut side = [[0f32; LANES]; 3];
            for axis in 0..3 {
                for i in 0..LANES {
                    side[axis][i] = given[to][axis][i] - given[from][axis][i];
                    let x = side[axis][i].abs();
                    length[i] = if x > length[i] { x } else { length[i] };
                }
            }
            for (axis, row) in cross.iter_mut().enumerate() {
                let (j, k) = ((axis + 1) % 3, (axis + 2) % 3);
                for i in 0..LANES {
                    row[i] = p[j][i] * side[k][i] - p[k][i] * side[j][i];
                }
            }
        }
        let mut seen = Self {
            crosses,
            volume: [0.0; LANES],
            edge_error: [0.0; LANES],
            volume_error: [0.0; LANES],
            volume_signs: [0; 2],
            sane: kernel.less(&[2f32.powi(-30); LANES], &size)
                & kernel.less(&size, &[2f32.powi(30); LANES])
                & kernel.less(&[2f32.powi(-30); LANES], &length),
            // Lanes that are not used are NaN throughout.
            used: kernel.at_most(&a[0], &a[0]),
        };
        for i in 0..LANES {
            let cross = &crosses[0];
            seen.volume[i] = a[0][i] * cross[0][i] + a[1][i] * cross[1][i] + a[2][i] * cross[2][i];
            let product = size[i] * length[i];
            seen.edge_error[i] = 64.0 * UNIT * product;
            seen.volume_error[i] = 80.0 * UNIT * product * size[i];
        }
        let minus = seen.volume_error.map(|x| -x);
        seen.volume_signs =
            [kernel.less(&seen.volume_error, &seen.volume), kernel.less(&seen.volume, &minus)];
        // Surfaces that the fan starts from: once here instead of once a ray.
        let mut open = seen.used & !(seen.sane & (seen.volume_signs[0] | seen.volume_signs[1]));
        while open != 0 {
            let lane = open.trailing_zeros() as usize % LANES;
            open &= open - 1;
            let side = plane_side(origin.into(), block.get(lane));
            seen.volume_signs[0] = seen.volume_signs[0] & !(1 << lane) | u32::from(side > 0) << lane;
            seen.volume_signs[1] = seen.volume_signs[1] & !(1 << lane) | u32::from(side < 0) << lane;
        }
        seen
    }

    /// Triangles that are hit for certain, and those left open.
    #[inline(always)]
    fn filter<K: Kernel>(&self, kernel: K, ray: &Ray) -> (u32, u32) {
        let d = ray.direction.to_array();
        let largest = ray.direction.abs().max_element();
        let mut edges = [[0f32; LANES]; 3];
        for (edge, cross) in edges.iter_mut().zip(&self.crosses) {
            for i in 0..LANES {
                edge[i] = d[0] * cross[0][i] + d[1] * cross[1][i] + d[2] * cross[2][i];
            }
        }
        let (mut error, mut minus, mut low, mut high) =
            ([0f32; LANES], [0f32; LANES], [0f32; LANES], [0f32; LANES]);
        let [u, v, w] = &edges;
        for i in 0..LANES {
            error[i] = self.edge_error[i] * largest;
            minus[i] = -error[i];
            let (x, y) = if u[i] < v[i] { (u[i], v[i]) } else { (v[i], u[i]) };
            low[i] = if w[i] < x { w[i] } else { x };
            high[i] = if w[i] > y { w[i] } else { y };
        }
        // Edges of both signs for certain: missed.
        let both = kernel.less(&error, &high) & kernel.less(&low, &minus);
        let open = self.used & !(both & self.sane);
        if open == 0 {
            return (0, 0);
        }
        let (positive, negative) = (kernel.less(&error, &low), kernel.less(&high, &minus));
        let (mut volume, mut sum) = (self.volume, [0f32; LANES]);
        for i in 0..LANES {
            let s = u[i] + v[i] + w[i];
            let backwards = s < 0.0;
            volume[i] = if backwards { -volume[i] } else { volume[i] };
            sum[i] = s.abs();
        }
        // Where `t` is beyond `z` for certain, and where before it.
        let compare = |z: f32| {
            let (mut difference, mut bound, mut minus) = ([0f32; LANES], [0f32; LANES], [0f32; LANES]);
            for i in 0..LANES {
                difference[i] = volume[i] - z * sum[i];
                bound[i] = self.volume_error[i] + 5.0 * z * error[i];
                minus[i] = -bound[i];
            }
            (kernel.less(&bound, &difference), kernel.less(&difference, &minus))
        };
        let (after_near, before_near) = if ray.tnear == 0.0 {
            // `t` has the sign of `V S`, and 0 is outside of the segment.
            let after = self.volume_signs[0] & positive | self.volume_signs[1] & negative;
            (after, !after)
        } else {
            compare(ray.tnear)
        };
        let (after_far, before_far) = if ray.tfar == f32::INFINITY { (0, 0xff) } else { compare(ray.tfar) };
        let one_sided = open & self.sane & (positive | negative);
        let hit = one_sided & after_near & before_far;
        (hit, open & !hit & !(one_sided & (before_near | after_far)))
    }
}
