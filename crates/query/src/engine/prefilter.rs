//! Method `prefilter`: rays end at prefiltered nodes that fit inside their cones. Approximate.

use super::{Engine, LightRay, Report};
use crate::{AoMethod, Occluders, QueryError, Structure};
use std::sync::Arc;
use umbrage_accel::{Counters, Statistics};
use umbrage_geom::Ray;
use umbrage_occlusion::prefilter::{ConeQuery, ConeRay, Prefiltered, PrefilteredInstances};

/// Threshold `T` of shadows: `docs/prefilter.md` has the errors.
pub(super) const SHADOW_THRESHOLD: f32 = 0.2;

/// Threshold `T` of ambient occlusion.
pub(super) const AO_THRESHOLD: f32 = 0.3;

/// Cones that are put together at a time, on the stack.
const MAX_BATCH_CONES: usize = 64;

pub(super) struct Prefilter<'a> {
    scene: Scene<'a>,
    query: ConeQuery,
}

enum Scene<'a> {
    Flat(Arc<Prefiltered>),
    Instanced(PrefilteredInstances<'a>),
}

impl<'a> Prefilter<'a> {
    pub(super) fn build(
        occluders: &'a Occluders,
        threshold: f32,
        progress: Report<'_>,
    ) -> Result<Self, QueryError> {
        let parts = occluders.prefiltered(progress)?;
        let scene = match occluders.instances() {
            None => Scene::Flat(parts.scenes[0].clone()),
            Some(top) => {
                Scene::Instanced(PrefilteredInstances::new(top, parts.scenes.clone(), &parts.of_instance)?)
            }
        };
        Ok(Self { scene, query: ConeQuery::new(threshold)? })
    }

    fn answer(&self, rays: &[ConeRay], passed: &mut [f32], stats: &mut impl Statistics) {
        match &self.scene {
            Scene::Flat(scene) => scene.transmittances_with(rays, &self.query, passed, stats),
            Scene::Instanced(scene) => rays
                .iter()
                .zip(passed)
                .for_each(|(ray, out)| *out = scene.transmittance_with(ray, &self.query, stats)),
        }
    }
}

impl Engine for Prefilter<'_> {
    fn name(&self) -> &'static str {
        AoMethod::Prefilter.name()
    }

    fn structures(&self) -> &'static [Structure] {
        &[Structure::Bvh, Structure::Prefiltered]
    }

    fn transmittances(
        &self,
        rays: &[LightRay],
        _: Option<usize>,
        passed: &mut [f32],
        mut counters: Option<&mut Counters>,
    ) -> Result<(), QueryError> {
        let mut cones = [ConeRay { ray: Ray::new([0.0; 3], [0.0; 3]), solid_angle: 0.0 }; MAX_BATCH_CONES];
        for (rays, passed) in rays.chunks(MAX_BATCH_CONES).zip(passed.chunks_mut(MAX_BATCH_CONES)) {
            for (cone, light) in cones.iter_mut().zip(rays) {
                *cone = ConeRay { ray: light.ray, solid_angle: light.solid_angle };
            }
            match &mut counters {
                None => self.answer(&cones[..rays.len()], passed, &mut ()),
                Some(counters) => self.answer(&cones[..rays.len()], passed, *counters),
            }
        }
        Ok(())
    }
}
