//! Hierarchies placed several times: two levels.
//!
//! Here: placements, what a ray is in object space, the conservative top level. Not here: the hierarchies below (`bvh.rs`).

mod queries;

use crate::{
    BackEnd, BuildError, BuildQuality, Bvh, Hit, Statistics,
    bvh::MAX_PRIMS,
    kernel::{self, Job, Kernel, NodeRay},
    node::{LEAF, Tree},
    solid::SolidBoxes,
    topology::Topology,
    traversal,
};
use queries::{AnyHit, AnyHitAmong, ClosestHit, Entered, ForEachHit, Transmittance};
use std::{ops::ControlFlow, sync::Arc};
use umbrage_geom::{
    Aabb, OpticalDepth, Ray, SlabRay, TriangleHit,
    glam::{Affine3A, DAffine3, DMat3, DVec3, Vec3},
    mesh::MAX_COORDINATE,
};

/// One instance of a hierarchy.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placement {
    /// Index of the hierarchy.
    pub bvh: u32,
    /// Any invertible map; mirroring turns [`TriangleHit::front`] around.
    pub world_from_object: Affine3A,
}

/// A hit on an instance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct InstanceHit {
    /// Index of the placement.
    pub instance: u32,
    /// The hit in its hierarchy; `t` is that of the world's ray, since directions keep their length.
    pub hit: Hit,
}

impl InstanceHit {
    /// The order that defines the closest hit: by `t`, then by `instance`, then by `prim_index`.
    #[inline]
    pub fn is_before(&self, other: &Self) -> bool {
        (self.hit.t, self.instance, self.hit.prim_index) < (other.hit.t, other.instance, other.hit.prim_index)
    }
}

/// Largest condition number that a transform may have.
const MAX_CONDITION: f64 = (1u32 << 24) as f64;

/// Rounding that boxes and origins are padded for, `2^-22`: see [`InstancedBvh`].
const PAD_ROUNDING: f64 = 1.0 / (1u32 << 22) as f64;

/// Largest sum of magnitudes in a row.
fn row_sum(m: &DMat3) -> f64 {
    let sums = m.x_axis.abs() + m.y_axis.abs() + m.z_axis.abs();
    sums.max_element()
}

/// The inverse of `world_from_object`, computed in `f64`; `None` if an entry is not finite or the condition number (in
/// the maximum norm) is over `2^24`.
///
/// The result as rounded is the definition of an instance's object space, see [`object_ray`].
pub fn object_from_world(world_from_object: &Affine3A) -> Option<DAffine3> {
    if !world_from_object.is_finite() {
        return None;
    }
    let m = world_from_object.matrix3;
    let [x, y, z] = [m.x_axis, m.y_axis, m.z_axis].map(|v| Vec3::from(v).as_dvec3());
    // Scaled so that no determinant of f32 entries leaves the range of f64.
    let largest = x.abs().max(y.abs()).max(z.abs()).max_element();
    if largest == 0.0 {
        return None;
    }
    let [x, y, z] = [x / largest, y / largest, z / largest];
    let inverse = DMat3::from_cols(y.cross(z), z.cross(x), x.cross(y)).transpose();
    let inverse = inverse * (1.0 / x.dot(y.cross(z)));
    let condition = row_sum(&DMat3::from_cols(x, y, z)) * row_sum(&inverse);
    if !inverse.is_finite() || condition > MAX_CONDITION {
        return None;
    }
    let matrix3 = inverse * (1.0 / largest);
    let t = Vec3::from(world_from_object.translation).as_dvec3();
    let translation = -linear(&matrix3, t);
    let result = DAffine3 { matrix3, translation };
    result.is_finite().then_some(result)
}

/// `m * v`, in an order of operations that no library version changes.
#[inline]
fn linear(m: &DMat3, v: DVec3) -> DVec3 {
    let row = |x: f64, y: f64, z: f64| (x * v.x + y * v.y) + z * v.z;
    DVec3::new(
        row(m.x_axis.x, m.y_axis.x, m.z_axis.x),
        row(m.x_axis.y, m.y_axis.y, m.z_axis.y),
        row(m.x_axis.z, m.y_axis.z, m.z_axis.z),
    )
}

/// THE ray that an instance sees: origin and direction mapped in `f64` and rounded to `f32` once, the same `tnear` and
/// `tfar`. An instance is hit where this ray hits its mesh.
///
/// What leaves the range of `f32` becomes infinite or zero, and a ray that is not [valid](Ray::is_valid) misses.
#[inline]
pub fn object_ray(ray: &Ray, object_from_world: &DAffine3) -> Ray {
    let origin = linear(&object_from_world.matrix3, ray.origin.as_dvec3()) + object_from_world.translation;
    let direction = linear(&object_from_world.matrix3, ray.direction.as_dvec3());
    Ray { origin: origin.as_vec3(), direction: direction.as_vec3(), ..*ray }
}

#[derive(Clone, Copy, Debug)]
struct Instance {
    bvh: u32,
    object_from_world: DAffine3,
}

/// Instances of hierarchies under one more 8-wide tree.
///
/// Every query answers exactly what a loop over all instances and triangles with [`object_ray`] answers
/// ([`crate::brute`]). No placements at all is allowed and hits nothing.
///
/// # Why the top level can't miss
/// Let `W`, `w` be a placement's map, `N`, `n` its rounded inverse, `K = |W| |N| <= 2^24` in maximum norms, `o`, `d` a
/// ray and `o'`, `d'` what [`object_ray`] makes of it. A hit at `t` lies at `p' = o' + t d'` in the object's box, whose
/// coordinates are at most `P`; let `p = o + t d`. Rounding moves `o'` by `2^-24 |o'|` and `t d'` by
/// `2^-24 |t d'| <= 2^-24 (|p'| + |o'|)`, given that `|d'|` is normal; `f64` adds `2^-51 |N| (|p| + 2 |o|)`; and
/// `W N` differs from the identity by less than `2^-25`, as `K` is bounded. With `|o'| <= |N| |o| + |n|`:
///
/// ```text
/// |W p' + w - p| <= 2^-22 (|W| (|n| + P) + |w|)  +  2^-22 K |o|
/// ```
///
/// with room to spare. The first part grows the instance's box; the second, for the largest `K`, pads the slab test of a
/// ray. So the box is entered no later than `t`, and culling by the closest `t` so far is right too. Directions so short
/// that some `|d'|` may be denormal are tried on all instances.
#[derive(Clone, Debug)]
pub struct InstancedBvh {
    bvhs: Vec<Arc<Bvh>>,
    instances: Vec<Instance>,
    tree: Tree,
    /// Largest `2^-22 K`.
    origin_pad: f64,
    /// Rays whose largest direction component is below this see every instance.
    shortest: f64,
    bounds: Aabb,
    back_end: BackEnd,
}

/// A placement checked and bounded.
struct Bounded {
    instance: Instance,
    aabb: Aabb,
    origin_pad: f64,
    norm: f64,
}

fn bound(index: usize, placement: &Placement, bvhs: &[Arc<Bvh>]) -> Result<Bounded, BuildError> {
    let Some(bvh) = bvhs.get(placement.bvh as usize) else {
        return Err(BuildError::BvhIndex { instance: index, bvh: placement.bvh, bvhs: bvhs.len() });
    };
    let map = &placement.world_from_object;
    if !map.is_finite() {
        return Err(BuildError::TransformNotFinite { instance: index });
    }
    let object_from_world =
        object_from_world(map).ok_or(BuildError::TransformSingular { instance: index })?;
    let [x, y, z] =
        [map.matrix3.x_axis, map.matrix3.y_axis, map.matrix3.z_axis].map(|v| Vec3::from(v).as_dvec3());
    let (matrix, w) = (DMat3::from_cols(x, y, z), Vec3::from(map.translation).as_dvec3());
    let object = bvh.bounds();
    let (mut min, mut max) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
    for corner in 0..8 {
        let pick = |axis: usize| {
            if corner >> axis & 1 == 1 { f64::from(object.max[axis]) } else { f64::from(object.min[axis]) }
        };
        let p = linear(&matrix, DVec3::new(pick(0), pick(1), pick(2))) + w;
        (min, max) = (min.min(p), max.max(p));
    }
    let (norm, inverse_norm) = (row_sum(&matrix), row_sum(&object_from_world.matrix3));
    let p = f64::from(object.min.abs().max(object.max.abs()).max_element());
    let n = object_from_world.translation.abs().max_element();
    let pad = PAD_ROUNDING * (norm * (n + p) + w.abs().max_element());
    let reach = min.abs().max(max.abs()).max_element() + pad;
    if reach.is_nan() || reach > f64::from(MAX_COORDINATE) {
        return Err(BuildError::TransformTooFar { instance: index });
    }
    // One unit outwards covers rounding to f32 and that of the sum.
    let outwards =
        |v: DVec3, step: fn(f32) -> f32| Vec3::new(step(v.x as f32), step(v.y as f32), step(v.z as f32));
    let aabb = Aabb { min: outwards(min - pad, f32::next_down), max: outwards(max + pad, f32::next_up) };
    let instance = Instance { bvh: placement.bvh, object_from_world };
    Ok(Bounded { instance, aabb, origin_pad: PAD_ROUNDING * norm * inverse_norm, norm })
}

impl InstancedBvh {
    /// Builds over `placements` of `bvhs`.
    ///
    /// # Errors
    /// [`BuildError::BvhIndex`], [`BuildError::TransformNotFinite`], [`BuildError::TransformSingular`],
    /// [`BuildError::TransformTooFar`], naming the instance; [`BuildError::TooMany`] beyond `2^30`.
    pub fn build(bvhs: Vec<Arc<Bvh>>, placements: &[Placement]) -> Result<Self, BuildError> {
        if placements.len() > MAX_PRIMS {
            let count = placements.len();
            return Err(BuildError::TooMany { what: "instances", count, limit: MAX_PRIMS });
        }
        let mut this = Self {
            bvhs,
            instances: Vec::new(),
            tree: Tree::new(Vec::new()),
            origin_pad: 0.0,
            shortest: 0.0,
            bounds: Aabb::EMPTY,
            back_end: BackEnd::best(),
        };
        let boxes = this.place(placements)?;
        if !boxes.is_empty() {
            // Half of what they are around is taken to be solid.
            let area = |i: u32| 0.25 * boxes[i as usize].area();
            let topology =
                Topology::build(&boxes, BuildQuality::High, area, |run| (run.len() == 1).then_some(()));
            this.tree = Tree::new(topology.nodes);
            // Leaves name instances directly.
            for child in this.tree.nodes.iter_mut().flat_map(|node| &mut node.children) {
                if *child & LEAF != 0 && *child != u32::MAX {
                    let leaf = &topology.leaves[(*child & !LEAF) as usize];
                    *child = LEAF | topology.order[leaf.0.start as usize];
                }
            }
            this.tree.refit(|instance| boxes[instance]);
            this.bounds = this.tree.bounds;
        }
        Ok(this)
    }

    /// Checks placements and takes them over; returns their boxes. Changes nothing on failure.
    fn place(&mut self, placements: &[Placement]) -> Result<Vec<Aabb>, BuildError> {
        let bounded = placements.iter().enumerate().map(|(i, p)| bound(i, p, &self.bvhs));
        let bounded = bounded.collect::<Result<Vec<_>, _>>()?;
        self.instances = bounded.iter().map(|b| b.instance).collect();
        self.origin_pad = bounded.iter().fold(0.0, |m, b| b.origin_pad.max(m));
        // |d| <= |W| |d'|, so from here on every |d'| is at least 2^-120.
        self.shortest = bounded.iter().fold(0.0, |m, b| b.norm.max(m)) * 2f64.powi(-120);
        Ok(bounded.into_iter().map(|b| b.aabb).collect())
    }

    /// Replaces hierarchies and placements, keeping the tree of instances: for motion, and after a [`Bvh::refit`].
    ///
    /// # Errors
    /// [`BuildError::Count`] unless there are as many placements as at the build; others as from [`Self::build`]. Nothing
    /// has changed then.
    pub fn refit(&mut self, bvhs: Vec<Arc<Bvh>>, placements: &[Placement]) -> Result<(), BuildError> {
        let (count, expected) = (placements.len(), self.instances.len());
        if count != expected {
            return Err(BuildError::Count { what: "instances", count, expected });
        }
        let before = std::mem::replace(&mut self.bvhs, bvhs);
        match self.place(placements) {
            Ok(boxes) if boxes.is_empty() => Ok(()),
            Ok(boxes) => {
                self.tree.refit(|instance| boxes[instance]);
                self.bounds = self.tree.bounds;
                Ok(())
            }
            Err(error) => {
                self.bvhs = before;
                Err(error)
            }
        }
    }

    /// Whether the open segment meets any triangle of any instance.
    pub fn any_hit(&self, ray: &Ray) -> bool {
        self.any_hit_with(ray, &mut ())
    }

    /// [`Self::any_hit`], counted.
    pub fn any_hit_with(&self, ray: &Ray, stats: &mut impl Statistics) -> bool {
        kernel::run(self.back_end, AnyHit { this: self, ray, stats })
    }

    /// [`Self::any_hit`] of a ray that may end inside of instances.
    pub fn any_hit_among_with(
        &self,
        ray: &Ray,
        insides: &mut impl InstanceBoxes,
        stats: &mut impl Statistics,
    ) -> bool {
        kernel::run(self.back_end, AnyHitAmong { this: self, ray, insides, stats })
    }

    /// [`Self::any_hit`] of each ray. With the `rayon` feature, over all threads of the caller's pool.
    ///
    /// # Panics
    /// If the slices differ in length.
    pub fn any_hits(&self, rays: &[Ray], hits: &mut [bool]) {
        assert_eq!(rays.len(), hits.len(), "as many answers as rays");
        let each = |(ray, hit): (&Ray, &mut bool)| *hit = self.any_hit(ray);
        #[cfg(feature = "rayon")]
        {
            use rayon::prelude::*;
            rays.par_iter().zip(hits.par_iter_mut()).with_min_len(1 << 10).for_each(each);
        }
        #[cfg(not(feature = "rayon"))]
        rays.iter().zip(hits).for_each(each);
    }

    /// The hit with the smallest `t`, ties going to the smallest instance, then to the smallest `prim_index`.
    pub fn closest_hit(&self, ray: &Ray) -> Option<InstanceHit> {
        self.closest_hit_with(ray, &mut ())
    }

    /// [`Self::closest_hit`], counted.
    pub fn closest_hit_with(&self, ray: &Ray, stats: &mut impl Statistics) -> Option<InstanceHit> {
        kernel::run(self.back_end, ClosestHit { this: self, ray, stats })
    }

    /// Calls `visit(instance, prim_index, hit)` exactly once for every triangle hit of every instance, in no promised
    /// order, until it breaks. Returns what the last visit returned.
    pub fn for_each_hit(
        &self,
        ray: &Ray,
        visit: impl FnMut(u32, u32, TriangleHit) -> ControlFlow<()>,
    ) -> ControlFlow<()> {
        self.for_each_hit_with(ray, visit, &mut ())
    }

    /// [`Self::for_each_hit`], counted.
    pub fn for_each_hit_with(
        &self,
        ray: &Ray,
        visit: impl FnMut(u32, u32, TriangleHit) -> ControlFlow<()>,
        stats: &mut impl Statistics,
    ) -> ControlFlow<()> {
        kernel::run(self.back_end, ForEachHit { this: self, ray, visit, stats })
    }

    /// Sum of `depth_of(instance, prim_index)` over all triangles hit; see [`Bvh::transmittance`].
    pub fn transmittance(&self, ray: &Ray, depth_of: impl Fn(u32, u32) -> OpticalDepth) -> OpticalDepth {
        self.transmittance_with(ray, depth_of, &mut ())
    }

    /// [`Self::transmittance`], counted.
    pub fn transmittance_with(
        &self,
        ray: &Ray,
        depth_of: impl Fn(u32, u32) -> OpticalDepth,
        stats: &mut impl Statistics,
    ) -> OpticalDepth {
        kernel::run(self.back_end, Transmittance { this: self, ray, depth_of, stats })
    }

    /// A box around all instances, a few units in the last place larger than needed; empty when there are none.
    pub fn bounds(&self) -> Aabb {
        self.bounds
    }

    /// Bytes that the top level and the hierarchies below hold, each counted once.
    pub fn bytes(&self) -> usize {
        let below: usize = self.bvhs.iter().map(|bvh| bvh.bytes()).sum();
        below + self.tree.bytes() + size_of_val(&self.instances[..])
    }

    /// The hierarchies, as given.
    pub fn bvhs(&self) -> &[Arc<Bvh>] {
        &self.bvhs
    }

    /// Number of placements.
    pub fn instance_count(&self) -> usize {
        self.instances.len()
    }

    /// The hierarchy of instance `instance`, and the map that [`object_ray`] wants.
    ///
    /// # Panics
    /// If `instance` is out of range.
    pub fn instance(&self, instance: u32) -> (&Bvh, &DAffine3) {
        let instance = &self.instances[instance as usize];
        (&self.bvhs[instance.bvh as usize], &instance.object_from_world)
    }

    /// What queries run on, in the hierarchies below too.
    pub fn back_end(&self) -> BackEnd {
        self.back_end
    }

    /// The same instances on another back end. Answers are the same.
    ///
    /// # Errors
    /// [`BuildError::BackEnd`] if this processor lacks it.
    pub fn with_back_end(self, back_end: BackEnd) -> Result<Self, BuildError> {
        if back_end.is_supported() {
            Ok(Self { back_end, ..self })
        } else {
            Err(BuildError::BackEnd(back_end))
        }
    }

    /// Calls `visit(instance, ray)` with every instance that the segment may enter and the ray that it sees ([`object_ray`]),
    /// in no promised order, until it breaks: for structures that keep something of their own for each hierarchy.
    pub fn for_each_entered(
        &self,
        ray: &Ray,
        mut visit: impl FnMut(u32, &Ray) -> ControlFlow<()>,
        stats: &mut impl Statistics,
    ) {
        let mut entered = Vec::new();
        // Collected first: a closure can't be inlined into the walk.
        kernel::run(self.back_end, Entered { this: self, ray, entered: &mut entered, stats });
        for index in entered {
            let (index, _, ray) = self.enter(index, ray);
            if visit(index, &ray).is_break() {
                return;
            }
        }
    }

    /// The ray prepared for the top level; `None` if it misses anyway.
    #[inline(always)]
    fn prepare(&self, ray: &Ray) -> Option<TopRay> {
        if self.instances.is_empty() || !ray.is_valid() {
            return None;
        }
        if f64::from(ray.direction.abs().max_element()) < self.shortest {
            return Some(TopRay::Everywhere);
        }
        let pad = (self.origin_pad * f64::from(ray.origin.abs().max_element())) as f32;
        let pad = if pad > 0.0 { pad.next_up() } else { 0.0 };
        SlabRay::with_padding(ray, Vec3::splat(pad)).map(|slab| TopRay::Slab(NodeRay::new(slab)))
    }

    /// The ray that instance `index` sees, and what it meets.
    #[inline(always)]
    fn enter(&self, index: usize, ray: &Ray) -> (u32, &Bvh, Ray) {
        let instance = &self.instances[index];
        let ray = object_ray(ray, &instance.object_from_world);
        (index as u32, &self.bvhs[instance.bvh as usize], ray)
    }

    /// Calls `visit` with instances that the segment may enter.
    #[inline(always)]
    fn walk<K: Kernel, S: Statistics>(
        &self,
        kernel: K,
        ray: &Ray,
        stats: &mut S,
        mut visitor: impl Visitor<S>,
    ) -> ControlFlow<()> {
        match self.prepare(ray) {
            None => {}
            Some(TopRay::Everywhere) => {
                for index in 0..self.instances.len() {
                    visitor.visit(kernel, self.enter(index, ray), stats)?;
                }
            }
            Some(TopRay::Slab(node)) => {
                let mut walk = traversal::Walk::new(kernel, &self.tree, &node, stats);
                while let Some(index) = walk.next(stats) {
                    visitor.visit(kernel, self.enter(index, ray), stats)?;
                }
            }
        }
        ControlFlow::Continue(())
    }
}

/// Solid boxes of the hierarchies below, each in its own space ([`InstancedBvh::any_hit_among_with`]).
pub trait InstanceBoxes {
    /// Those of one hierarchy.
    type SolidBoxes<'s>: SolidBoxes
    where
        Self: 's;

    /// A copy of hierarchy `bvh` with notes, and the boxes that these name; `None` if it has no boxes. `ray` is what the
    /// instance sees ([`object_ray`]), and may not touch anything.
    fn inside(&mut self, bvh: u32, ray: &Ray) -> Option<(&Bvh, Self::SolidBoxes<'_>)>;
}

/// What happens in an instance: a closure that can be inlined into a kernel's target features.
trait Visitor<S> {
    fn visit<K: Kernel>(&mut self, kernel: K, instance: (u32, &Bvh, Ray), stats: &mut S) -> ControlFlow<()>;
}

/// How a ray meets the top level.
enum TopRay {
    Slab(NodeRay),
    Everywhere,
}
