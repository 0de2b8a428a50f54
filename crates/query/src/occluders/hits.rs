//! What rays find among occluders: how much light passes, and the nearest surface.

use super::{Address, Hierarchy, Occluders, PlacedPart};
use crate::LightRay;
use umbrage_accel::Statistics;
use umbrage_aomask::Sides;
use umbrage_geom::{OpticalDepth, Ray, RayDifferential, TriangleHit, glam::*, intersect_triangle};

/// The surface that a ray meets.
#[derive(Clone, Copy, Debug)]
pub struct ShadingPoint {
    /// The point, rounded; see [`Self::magnitude`].
    pub point: Vec3,
    /// Unit normal of the triangle, towards where the ray came from.
    pub geometric_normal: Vec3,
    /// Interpolated unit normal if the mesh has one, on the same side.
    pub shading_normal: Vec3,
    /// Largest coordinate that took part in computing the point, for [`umbrage_geom::offset_origin`].
    pub magnitude: f32,
    /// Fraction of light reflected, linear RGB.
    pub albedo: Vec3,
    /// Fraction of light that the surface blocks.
    pub opacity: f32,
    /// Ray parameter.
    pub t: f32,
    /// Width of the ray there, world units; 0 without subdivision surfaces.
    pub width: f32,
}

impl PlacedPart {
    /// Bound on what rounding world points to and from object space is relative to, in world units: four times the
    /// largest sum of magnitudes in the transform of a corner (two transforms, each with up to four roundings, where a
    /// flat mesh has none).
    fn magnitude(&self, corners: [[f32; 3]; 3]) -> f32 {
        let m = self.world_from_object.matrix3;
        let largest = corners.iter().fold(Vec3A::ZERO, |l, &p| l.max(Vec3A::from(p).abs()));
        let sum = m.x_axis.abs() * largest.x + m.y_axis.abs() * largest.y + m.z_axis.abs() * largest.z;
        4.0 * (sum + self.world_from_object.translation.abs()).max_element()
    }
}

impl Occluders {
    /// Fraction of light that passes along the open segment of `ray`; exact in the sense of
    /// [`OpticalDepth`]: the same bits whatever the structure.
    pub fn transmittance(&self, ray: &Ray, stats: &mut impl Statistics) -> f32 {
        if self.opaque {
            let hit = match &self.hierarchy {
                Hierarchy::Absent => false,
                Hierarchy::Flat(bvh) => bvh.any_hit_with(ray, stats),
                Hierarchy::Instanced(bvh) => bvh.any_hit_with(ray, stats),
            };
            return if hit { 0.0 } else { 1.0 };
        }
        let depth = match &self.hierarchy {
            Hierarchy::Absent => OpticalDepth::CLEAR,
            Hierarchy::Flat(bvh) => bvh.transmittance_with(ray, |prim| self.depth_of((0, prim)), stats),
            Hierarchy::Instanced(bvh) => {
                bvh.transmittance_with(ray, |instance, prim| self.depth_of((instance, prim)), stats)
            }
        };
        depth.transmittance()
    }

    /// [`Self::transmittance`] of each ray, blocked by `sides` of triangles; fastest for rays that share their origin. Sides other
    /// than both are for occluders that are one mesh; where instances are kept apart, both block.
    pub fn transmittances(
        &self,
        rays: &[Ray],
        sides: Sides,
        passed: &mut [f32],
        stats: &mut impl Statistics,
    ) {
        match (&self.hierarchy, sides) {
            (Hierarchy::Flat(bvh), Sides::FrontFirst) => {
                for (ray, out) in rays.iter().zip(passed) {
                    let blocked = bvh.closest_hit_with(ray, stats).is_some_and(|hit| hit.front);
                    *out = f32::from(u8::from(!blocked));
                }
            }
            (Hierarchy::Flat(bvh), Sides::Front) => {
                for (ray, out) in rays.iter().zip(passed) {
                    let depth = |prim| self.depth_of_front(prim, ray);
                    *out = bvh.transmittance_with(ray, depth, stats).transmittance();
                }
            }
            (Hierarchy::Flat(bvh), Sides::Both) if self.opaque => {
                let mut hits = vec![false; rays.len()];
                bvh.any_hits_with(rays, &mut hits, stats);
                passed.iter_mut().zip(hits).for_each(|(out, hit)| *out = f32::from(u8::from(!hit)));
            }
            (Hierarchy::Flat(bvh), Sides::Both) => {
                let mut sums = vec![OpticalDepth::CLEAR; rays.len()];
                bvh.transmittances_with(rays, |prim| self.flat_depth(prim), &mut sums, stats);
                passed.iter_mut().zip(sums).for_each(|(out, sum)| *out = sum.transmittance());
            }
            (Hierarchy::Absent, _) => passed.fill(1.0),
            (Hierarchy::Instanced(_), _) => {
                rays.iter().zip(passed).for_each(|(ray, out)| *out = self.transmittance(ray, stats));
            }
        }
    }

    /// Depth of a crossing of triangle `prim` of one mesh.
    pub(crate) fn flat_depth(&self, prim: u32) -> OpticalDepth {
        self.depth_of((0, prim))
    }

    /// Depth of triangle `prim` of one mesh, which `ray` hits; clear from behind.
    fn depth_of_front(&self, prim: u32, ray: &Ray) -> OpticalDepth {
        let triangle = self.parts[0].mesh.triangle(prim as usize);
        match intersect_triangle(ray, triangle) {
            Some(hit) if hit.front => self.flat_depth(prim),
            _ => OpticalDepth::CLEAR,
        }
    }

    /// [`Self::transmittances`] with subdivision surfaces, which see each ray as wide as its share of solid angle makes it.
    pub(crate) fn transmittances_with_surfaces(
        &self,
        rays: &[LightRay],
        passed: &mut [f32],
        stats: &mut impl Statistics,
    ) {
        let plain: Vec<Ray> = rays.iter().map(|light| light.ray).collect();
        self.transmittances(&plain, Sides::Both, passed, stats);
        let Some(surfaces) = &self.surfaces else { return };
        let mut blocked: Vec<bool> = passed.iter().map(|&passed| passed == 0.0).collect();
        surfaces.block(&plain, |i| rays[i].differential(), &mut blocked, stats);
        passed.iter_mut().zip(blocked).filter(|(_, blocked)| *blocked).for_each(|(out, _)| *out = 0.0);
    }

    /// The nearest surface along `ray`; `differential` says how wide subdivision surfaces see it.
    pub fn closest_hit(
        &self,
        ray: &Ray,
        differential: &RayDifferential,
        stats: &mut impl Statistics,
    ) -> Option<ShadingPoint> {
        let triangle = self.closest_triangle(ray, stats);
        let Some(surfaces) = &self.surfaces else { return triangle };
        let rest = triangle.as_ref().map_or(*ray, |surface| ray.with_tfar(surface.t));
        let nearest = surfaces.closest_hit(&rest, differential, &self.albedos, stats).or(triangle)?;
        let edges = differential.footprint(nearest.t).map(|edge| edge.length());
        Some(ShadingPoint { width: edges[0].min(edges[1]), ..nearest })
    }

    fn closest_triangle(&self, ray: &Ray, stats: &mut impl Statistics) -> Option<ShadingPoint> {
        let (instance, hit) = match &self.hierarchy {
            Hierarchy::Absent => return None,
            Hierarchy::Flat(bvh) => (0, bvh.closest_hit_with(ray, stats)?),
            Hierarchy::Instanced(bvh) => {
                let hit = bvh.closest_hit_with(ray, stats)?;
                (hit.instance, hit.hit)
            }
        };
        let triangle = TriangleHit { t: hit.t, u: hit.u, v: hit.v, front: hit.front };
        Some(self.surface((instance, hit.prim_index), &triangle, ray))
    }

    fn object_of(&self, (placed, triangle): Address) -> (u32, OpticalDepth) {
        let placed = &self.placed[placed as usize];
        placed.objects[self.parts[placed.part].object_of[triangle as usize] as usize]
    }

    fn depth_of(&self, address: Address) -> OpticalDepth {
        self.object_of(address).1
    }

    fn surface(&self, address: Address, hit: &TriangleHit, ray: &Ray) -> ShadingPoint {
        let placed = &self.placed[address.0 as usize];
        let mesh = &self.parts[placed.part].mesh;
        let index = address.1 as usize;
        let corners =
            mesh.triangle(index).map(|p| placed.world_from_object.transform_point3a(Vec3A::from(p)));
        let (e, f) = (corners[1] - corners[0], corners[2] - corners[0]);
        let normal64 = e.as_dvec3().cross(f.as_dvec3());
        let face = Vec3A::from(normal64.normalize_or_zero().as_vec3());
        let towards = |n: Vec3A, reference: Vec3A| if n.dot(reference) < 0.0 { -n } else { n };
        let geometric = towards(face, -Vec3A::from(ray.direction));
        let weights = [1.0 - hit.u - hit.v, hit.u, hit.v];
        let shading = mesh.corner_normals.get(index).and_then(|normals| {
            let n = (0..3).fold(Vec3A::ZERO, |n, i| n + Vec3A::from(normals[i]) * weights[i]);
            (placed.normal_matrix * n).try_normalize()
        });
        let (point, magnitude) = match &self.hierarchy {
            // Computed in f64 and put back into the plane, so that only the final rounding is left, however large the
            // triangle.
            Hierarchy::Flat(_) => {
                let along = ray.origin.as_dvec3() + f64::from(hit.t) * ray.direction.as_dvec3();
                let normal = normal64.normalize_or_zero();
                let point = along - normal * (along - corners[0].as_dvec3()).dot(normal);
                (point.as_vec3(), point.abs().max_element() as f32)
            }
            Hierarchy::Absent | Hierarchy::Instanced(_) => {
                ((corners[0] + e * hit.u + f * hit.v).into(), placed.magnitude(mesh.triangle(index)))
            }
        };
        let (material, depth) = self.object_of(address);
        let mut albedo = Vec3A::from(self.albedos[material as usize]);
        if !mesh.vertex_colors.is_empty() {
            let colors = mesh.triangles[index].map(|v| Vec3A::from(mesh.vertex_colors[v as usize]));
            albedo *= colors[0] * weights[0] + colors[1] * weights[1] + colors[2] * weights[2];
        }
        ShadingPoint {
            point,
            geometric_normal: geometric.into(),
            shading_normal: shading.map_or(geometric, |n| towards(n, geometric)).into(),
            magnitude,
            albedo: albedo.into(),
            opacity: 1.0 - depth.transmittance(),
            t: hit.t,
            width: 0.0,
        }
    }
}
