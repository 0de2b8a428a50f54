//! Prefiltered hierarchies placed several times: each is built once and shared.

use super::{ConeQuery, ConeRay, Prefiltered};
use crate::OcclusionError;
use std::{ops::ControlFlow, sync::Arc};
use umbrage_accel::{InstancedBvh, Statistics};
use umbrage_geom::{Ray, glam::DMat3};

/// Transmittance that counts as none: 10 bits.
const BLOCKED_TRANSMITTANCE: f32 = 1.0 / 1024.0;

/// Instances of prefiltered hierarchies, found by the top level of an [`InstancedBvh`].
///
/// A ray's solid angle is that which it has in the object's space, for any affine map.
#[derive(Clone, Debug)]
pub struct PrefilteredInstances<'a> {
    top: &'a InstancedBvh,
    scenes: Vec<Arc<Prefiltered>>,
    /// Scene of each instance, and determinant of its map to object space.
    instances: Vec<(u32, f64)>,
}

impl<'a> PrefilteredInstances<'a> {
    /// Instance `i` of `top` is dimmed by hierarchy `of_instance[i]` of `scenes`, which is over the same triangles as its
    /// [`umbrage_accel::Bvh`]. Several hierarchies may be over the same triangles with other opacities.
    ///
    /// # Errors
    /// [`OcclusionError::InstanceCount`], [`OcclusionError::Hierarchy`].
    pub fn new(
        top: &'a InstancedBvh,
        scenes: Vec<Arc<Prefiltered>>,
        of_instance: &[u32],
    ) -> Result<Self, OcclusionError> {
        let (count, instances) = (of_instance.len(), top.instance_count());
        if count != instances {
            return Err(OcclusionError::InstanceCount { count, instances });
        }
        let instance = |(instance, &hierarchy): (usize, &u32)| {
            let (bvh, map) = top.instance(instance as u32);
            match scenes.get(hierarchy as usize) {
                Some(scene) if scene.prim_count() == bvh.prim_count() => {
                    Ok((hierarchy, DMat3::determinant(&map.matrix3).abs()))
                }
                _ => Err(OcclusionError::Hierarchy { instance, hierarchy }),
            }
        };
        let instances = of_instance.iter().enumerate().map(instance).collect::<Result<_, _>>()?;
        Ok(Self { top, scenes, instances })
    }

    /// Fraction of light that passes along `ray`, in `[0, 1]`: the product over instances, 0 below 2^-10 if `query` is not
    /// exact.
    pub fn transmittance(&self, ray: &ConeRay, query: &ConeQuery) -> f32 {
        self.transmittance_with(ray, query, &mut ())
    }

    /// [`Self::transmittance`], counted.
    pub fn transmittance_with(&self, ray: &ConeRay, query: &ConeQuery, stats: &mut impl Statistics) -> f32 {
        let black = if query.threshold() < f32::INFINITY && ray.solid_angle > 0.0 {
            BLOCKED_TRANSMITTANCE
        } else {
            0.0
        };
        let mut passed = 1.0;
        // Two borrows of the statistics: the top level counts apart.
        let mut top = umbrage_accel::Counters::default();
        let visit = |instance: u32, seen: &Ray| {
            let (scene, determinant) = self.instances[instance as usize];
            // A small area across the direction shrinks by the determinant over the stretch along it, and the distance
            // grows by that stretch.
            let stretch = seen.direction.as_dvec3().length() / ray.ray.direction.as_dvec3().length();
            let solid_angle = f64::from(ray.solid_angle) * determinant / (stretch * stretch * stretch);
            let seen = ConeRay { ray: *seen, solid_angle: solid_angle as f32 };
            passed *= self.scenes[scene as usize].transmittance_with(&seen, query, stats);
            if passed <= black {
                passed = 0.0;
                return ControlFlow::Break(());
            }
            ControlFlow::Continue(())
        };
        self.top.for_each_entered(&ray.ray, visit, &mut top);
        (0..top.nodes).for_each(|_| stats.node((top.box_tests / top.nodes) as u32));
        passed
    }

    /// Bytes of the prefiltered hierarchies, each counted once, and of what belongs to instances.
    pub fn bytes(&self) -> usize {
        let scenes = self.scenes.iter().map(|scene| {
            let bytes = scene.bytes();
            bytes.hierarchy + bytes.opacities + bytes.triangle_opacities
        });
        scenes.sum::<usize>() + size_of_val(&self.instances[..])
    }
}
