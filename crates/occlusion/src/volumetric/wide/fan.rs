//! Any-hit of a fan: rays that share an origin, such as those of a receiver to one light, walk together.
//!
//! A node is first tested against the whole fan, by intervals of reciprocal directions; each child left is tested against each
//! ray, so that rays part at silhouettes. Where few rays are left they go on alone. What a leaf's triangles have in common for
//! all rays (cross products of corners seen from the origin) is computed once.
//!
//! # The filter
//! With `A = a - o` and so on, `u = 2^-24`, `M` the largest `|coordinate|` of `A`, `B`, `C` and `D` that of `d`: a component
//! of `B x C` errs by at most `8 u M^2` (three roundings a product, one of the difference), `d . (B x C)` by `3 D 8 u M^2`
//! plus `18 u D M^2` for its own operations: less than `E = 64 u D M^2`. `V = A . (B x C)` errs by less than `64 u M^3`
//! likewise, and the sum `S` of three edges by `4 E`. The hit is at `t = V / S`, so it is beyond `z` for certain if
//! `V - z S`, signed as `S`, is larger than `80 u M^3 + 5 z E`, and before it if smaller than minus that. `M` between `2^-30`
//! and `2^30` and `D` between `2^-20` and `2^20` keep all this from under- and overflow; what is not certain, the predicate
//! decides.

use super::{
    LightRoot, SolidBvh,
    kernel::Kernel,
    node::{LEAF, MAX_LEVELS, Node, WIDTH},
    walk::{self, Prepared},
};
use crate::volumetric::Ends;
use umbrage_geom::{
    Aabb, Ray, SlabRay,
    kernel::{LANES, TriangleBlock},
    segment_hits_triangle,
};

/// Most rays of a fan.
pub(super) const RAYS: usize = 24;

/// Rays that rather go on alone.
const FEW: u32 = 3;

const UNIT: f32 = 1.0 / (1u32 << 24) as f32;

type Lanes = [f32; RAYS];

/// Signs of a direction component over the fan.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Sign {
    Forward,
    Backward,
    Mixed,
}

/// Rays of one origin, one a lane.
pub(super) struct Fan {
    slabs: Vec<SlabRay>,
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
    /// Components of `B x C`, `C x A`, `A x B`.
    crosses: [[[f32; LANES]; 3]; 3],
    volume: [f32; LANES],
    /// `64 u M^2`: times `D` the bound of an edge.
    edge_error: [f32; LANES],
    /// `80 u M^3`.
    volume_error: [f32; LANES],
    /// Lanes whose numbers can be trusted.
    sane: [bool; LANES],
    used: u8,
}

impl Fan {
    pub(super) fn new() -> Self {
        Self {
            slabs: Vec::with_capacity(RAYS),
            places: [0; RAYS],
            origin: [0.0; 3],
            near: [[1.0; RAYS]; 3],
            far: [[1.0; RAYS]; 3],
            tnear: [1.0; RAYS],
            tfar: [-1.0; RAYS],
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
        (self.tnear, self.tfar) = ([1.0; RAYS], [-1.0; RAYS]);
        (self.start, self.end) = (f32::INFINITY, 0.0);
        for (lane, slab) in self.slabs.iter().enumerate() {
            (self.tnear[lane], self.tfar[lane]) = (slab.tnear, slab.tfar);
            (self.start, self.end) = (self.start.min(slab.tnear), self.end.max(slab.tfar));
        }
        for axis in 0..3 {
            let (mut forward, mut backward) = (false, false);
            let (mut least, mut most) = (f32::INFINITY, 0f32);
            for (lane, slab) in self.slabs.iter().enumerate() {
                let (near, far) = (slab.inv_near[axis], slab.inv_far[axis]);
                (self.near[axis][lane], self.far[axis][lane]) = (near, far);
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
                    let lane = lanes.trailing_zeros();
                    lanes &= lanes - 1;
                    let ray = Prepared::new(&rays[self.places[lane as usize % RAYS] as usize]);
                    let hit = ray.is_some_and(|ray| {
                        walk::any_hit(kernel, this, &ray, ends, child, light.as_deref_mut(), &mut ())
                    });
                    open &= !(u32::from(hit) << lane);
                }
                continue;
            }
            if child & LEAF != 0 {
                open &= !self.leaf_hits(&this.bvh.leaf_blocks()[(child & !LEAF) as usize], rays, lanes);
                continue;
            }
            let node = match &light {
                Some(light) if child == 0 => light.node,
                _ => this.nodes[child as usize],
            };
            let entered = self.shaft(&node) & node.used;
            let mut solid = entered & node.solid;
            while solid != 0 {
                let slot = solid.trailing_zeros() as usize % WIDTH;
                solid &= solid - 1;
                let crossed = self.surely_crossing(&node.aabb(slot)) & lanes & open;
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
                let into = self.entering(&node.aabb(slot)) & lanes;
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
    fn shaft(&self, node: &Node) -> u32 {
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
        (0..WIDTH).fold(0, |mask, i| mask | u32::from(entry[i] <= exit[i]) << i)
    }

    /// Lanes that may enter a box: [`SlabRay::entry`] of each.
    #[inline(always)]
    fn entering(&self, aabb: &Aabb) -> u32 {
        let (mut entry, mut exit) = (self.tnear, self.tfar);
        for axis in 0..3 {
            let (low, high) = (aabb.min[axis] - self.origin[axis], aabb.max[axis] - self.origin[axis]);
            let (near, far) = (&self.near[axis], &self.far[axis]);
            match self.signs[axis] {
                Sign::Mixed => {
                    for i in 0..RAYS {
                        let (first, last) = if near[i] >= 0.0 { (low, high) } else { (high, low) };
                        let (a, b) = (first * near[i], last * far[i]);
                        entry[i] = if a > entry[i] { a } else { entry[i] };
                        exit[i] = if b < exit[i] { b } else { exit[i] };
                    }
                }
                sign => {
                    let (first, last) = if sign == Sign::Forward { (low, high) } else { (high, low) };
                    for i in 0..RAYS {
                        let (a, b) = (first * near[i], last * far[i]);
                        entry[i] = if a > entry[i] { a } else { entry[i] };
                        exit[i] = if b < exit[i] { b } else { exit[i] };
                    }
                }
            }
        }
        (0..RAYS).fold(0, |mask, i| mask | u32::from(entry[i] <= exit[i]) << i)
    }

    /// Lanes that surely cross the inside of a box: [`SlabRay::surely_crosses`] of each.
    #[inline(always)]
    fn surely_crossing(&self, aabb: &Aabb) -> u32 {
        let (mut entry, mut exit) = (self.tnear, self.tfar);
        for i in 0..RAYS {
            let start = entry[i] * (1.0 + 2f32.powi(-19));
            entry[i] = if start > 2f32.powi(-100) { start } else { 2f32.powi(-100) };
            exit[i] *= 1.0 - 2f32.powi(-19);
        }
        for axis in 0..3 {
            let (low, high) = (aabb.min[axis] - self.origin[axis], aabb.max[axis] - self.origin[axis]);
            let (near, far) = (&self.near[axis], &self.far[axis]);
            for i in 0..RAYS {
                let (first, last) = if near[i] >= 0.0 { (low, high) } else { (high, low) };
                let (a, b) = (first * far[i], last * near[i]);
                // A ray in the plane of a face doesn't cross the box.
                let a = if a.is_nan() { f32::INFINITY } else { a };
                entry[i] = if a > entry[i] { a } else { entry[i] };
                exit[i] = if b < exit[i] { b } else { exit[i] };
            }
        }
        (0..RAYS).fold(0, |mask, i| mask | u32::from(entry[i] < exit[i]) << i)
    }

    /// Lanes of `lanes` that hit a triangle of the leaf.
    #[inline(always)]
    fn leaf_hits(&self, block: &TriangleBlock, rays: &[Ray], mut lanes: u32) -> u32 {
        let seen = SeenBlock::new(block, self.origin);
        let mut hits = 0;
        while lanes != 0 {
            let lane = lanes.trailing_zeros() as usize % RAYS;
            lanes &= lanes - 1;
            let ray = &rays[self.places[lane] as usize];
            let (certain, mut uncertain) = seen.filter(ray);
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
    fn new(block: &TriangleBlock, origin: [f32; 3]) -> Self {
        let mut corners = *block.corners();
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
        for (cross, (p, q)) in crosses.iter_mut().zip([(b, c), (c, a), (a, b)]) {
            for axis in 0..3 {
                let (j, k) = ((axis + 1) % 3, (axis + 2) % 3);
                for i in 0..LANES {
                    cross[axis][i] = p[j][i] * q[k][i] - p[k][i] * q[j][i];
                }
            }
        }
        let mut seen = Self {
            crosses,
            volume: [0.0; LANES],
            edge_error: [0.0; LANES],
            volume_error: [0.0; LANES],
            sane: [false; LANES],
            used: 0,
        };
        for i in 0..LANES {
            let [x, y, z] = [0, 1, 2].map(|axis| a[axis][i] * crosses[0][axis][i]);
            seen.volume[i] = x + y + z;
            let square = size[i] * size[i];
            seen.edge_error[i] = 64.0 * UNIT * square;
            seen.volume_error[i] = 80.0 * UNIT * square * size[i];
            seen.sane[i] = size[i] > 2f32.powi(-30) && size[i] < 2f32.powi(30);
        }
        // Lanes that are not used are NaN throughout.
        seen.used = (0..LANES).fold(0, |mask, i| mask | u8::from(a[0][i] == a[0][i]) << i);
        seen
    }

    /// Triangles that are hit for certain, and those left open.
    #[inline(always)]
    fn filter(&self, ray: &Ray) -> (u8, u8) {
        let d = ray.direction.to_array();
        let largest = ray.direction.abs().max_element();
        let mut edges = [[0f32; LANES]; 3];
        for (edge, cross) in edges.iter_mut().zip(&self.crosses) {
            for i in 0..LANES {
                edge[i] = d[0] * cross[0][i] + d[1] * cross[1][i] + d[2] * cross[2][i];
            }
        }
        let [u, v, w] = &edges;
        let (mut missed, mut hit) = ([false; LANES], [false; LANES]);
        // A segment without end is as good as one that ends far beyond everything.
        let (tnear, tfar) = (ray.tnear, ray.tfar);
        let (bounded, tfar) = (tfar != f32::INFINITY, if tfar == f32::INFINITY { 0.0 } else { tfar });
        for i in 0..LANES {
            let error = self.edge_error[i] * largest;
            let (positive, negative) = (
                (u[i] > error) | (v[i] > error) | (w[i] > error),
                (u[i] < -error) | (v[i] < -error) | (w[i] < -error),
            );
            let all_positive = (u[i] > error) & (v[i] > error) & (w[i] > error);
            let all_negative = (u[i] < -error) & (v[i] < -error) & (w[i] < -error);
            let sign = if all_negative { -1.0 } else { 1.0 };
            let (volume, sum) = (self.volume[i] * sign, (u[i] + v[i] + w[i]) * sign);
            let near = volume - tnear * sum;
            let near_error = self.volume_error[i] + 5.0 * tnear * error;
            let far = volume - tfar * sum;
            let far_error = self.volume_error[i] + 5.0 * tfar * error;
            let one_sided = all_positive | all_negative;
            let behind = near < -near_error;
            let beyond = bounded & (far > far_error);
            let between = (near > near_error) & (!bounded | (far < -far_error));
            missed[i] = self.sane[i] & ((positive & negative) | (one_sided & (behind | beyond)));
            hit[i] = self.sane[i] & one_sided & between;
        }
        let mask = |lanes: &[bool; LANES]| (0..LANES).fold(0u8, |mask, i| mask | u8::from(lanes[i]) << i);
        let hit = mask(&hit) & self.used;
        (hit, self.used & !mask(&missed) & !hit)
    }
}
