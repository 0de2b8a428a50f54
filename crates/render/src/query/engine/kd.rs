//! Methods `kd` and `kd-volumetric`: rays through a kd-tree, whose opaque cells inside solids may end them. Exact.

use super::{Engine, LightRay, Report, one_mesh};
use crate::query::{Occluders, QueryError, ShadowMethod};
use std::sync::{Arc, Mutex};
use umbrage_accel::{Counters, kdtree::Order};
use umbrage_occlusion::volumetric::{self, KdVolumetric, Query, Scratch};

pub(super) struct Kd {
    method: ShadowMethod,
    query: Query,
    tree: Arc<KdVolumetric>,
    /// What threads keep between calls.
    scratch: Mutex<Vec<Scratch>>,
}

/// How rays of `method` walk.
fn query(method: ShadowMethod) -> Query {
    let (order, guided) = match method {
        ShadowMethod::KdVolumetric => (Order::SOLID, true),
        ShadowMethod::KdVolumetricSolid => (Order::SOLID, false),
        ShadowMethod::KdVolumetricExtended => (Order::EXTENDED, false),
        ShadowMethod::KdVolumetricBreadth => (Order::BREADTH, false),
        ShadowMethod::KdVolumetricQuick => (Order::QUICK, false),
        _ => (Order::RAY, false),
    };
    Query::default().with_order(order).with_occluders(method != ShadowMethod::Kd).with_guide(guided)
}

impl Kd {
    pub(super) fn build(
        method: ShadowMethod,
        occluders: &Occluders,
        progress: Report<'_>,
    ) -> Result<Self, QueryError> {
        let tree = one_mesh(method.name(), occluders.kd_tree(progress)?)?;
        Ok(Self { method, query: query(method), tree, scratch: Mutex::default() })
    }
}

impl Engine for Kd {
    fn name(&self) -> &'static str {
        self.method.name()
    }

    fn transmittances(
        &self,
        rays: &[LightRay],
        light: Option<usize>,
        passed: &mut [f32],
        counters: Option<&mut Counters>,
    ) -> Result<(), QueryError> {
        let kept = || self.scratch.lock().unwrap_or_else(|poisoned| poisoned.into_inner());
        let mut scratch = kept().pop().unwrap_or_default();
        let query = self.query.with_light(light);
        let mut counted = volumetric::Counters::default();
        for (to_light, out) in rays.iter().zip(passed) {
            let hit = match counters {
                Some(_) => self.tree.any_hit_with(&to_light.ray, &query, &mut scratch, &mut counted),
                None => self.tree.any_hit(&to_light.ray, &query, &mut scratch),
            };
            *out = f32::from(u8::from(!hit));
        }
        if let Some(counters) = counters {
            counters.nodes += counted.kd.steps;
            counters.box_tests += counted.box_tests;
            counters.triangle_tests += counted.kd.triangle_tests;
        }
        kept().push(scratch);
        Ok(())
    }
}
