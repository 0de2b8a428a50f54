//! Methods `kd` and `kd-volumetric`: rays through a kd-tree, whose opaque cells inside solids may end them. Exact.

use super::{
    Engine, LightRay, Report, one_mesh,
    tile::{Remembers, Tile},
};
use crate::{Occluders, QueryError, ShadowMethod, Structure};
use std::sync::{Arc, Mutex};
use umbrage_accel::{Counters, Statistics, kdtree::Order};
use umbrage_geom::Ray;
use umbrage_occlusion::volumetric::{KdQuery, KdVolumetric, KdVolumetricScratch};

/// Rays that walk together.
const PACKET: usize = 4;

pub(super) struct Kd {
    method: ShadowMethod,
    query: KdQuery,
    tree: Arc<KdVolumetric>,
    memories: Mutex<Vec<KdVolumetricScratch>>,
}

/// How rays of `method` walk.
fn query(method: ShadowMethod) -> KdQuery {
    let (order, guided) = match method {
        ShadowMethod::KdVolumetric => (Order::SOLID, true),
        ShadowMethod::KdVolumetricSolid => (Order::SOLID, false),
        ShadowMethod::KdVolumetricExtended => (Order::EXTENDED, false),
        ShadowMethod::KdVolumetricBreadth => (Order::BREADTH, false),
        ShadowMethod::KdVolumetricQuick => (Order::QUICK, false),
        _ => (Order::RAY, false),
    };
    KdQuery::default().with_order(order).with_occluders(method != ShadowMethod::Kd).with_guide(guided)
}

impl Kd {
    pub(super) fn build(
        method: ShadowMethod,
        occluders: &Occluders,
        progress: Report<'_>,
    ) -> Result<Self, QueryError> {
        let tree = one_mesh(method.name(), occluders.kd_tree(progress)?)?;
        Ok(Self { method, query: query(method), tree, memories: Mutex::default() })
    }
}

/// Answers the rays of a receiver to a light in packets of four (Djeu11, section 3.7.1), a ray that is alone by itself.
fn in_packets(
    tree: &KdVolumetric,
    rays: &[LightRay],
    query: &KdQuery,
    scratch: &mut KdVolumetricScratch,
    passed: &mut [f32],
    stats: &mut impl Statistics,
) {
    let none = Ray::new([0.0; 3], [0.0; 3]);
    for (rays, passed) in rays.chunks(PACKET).zip(passed.chunks_mut(PACKET)) {
        let (mut packet, mut hits) = ([none; PACKET], [false; PACKET]);
        packet.iter_mut().zip(rays).for_each(|(to, from)| *to = from.ray);
        match rays {
            [alone] => hits[0] = tree.any_hit_with(&alone.ray, query, scratch, stats),
            _ => {
                let (packet, hits) = (&packet[..rays.len()], &mut hits[..rays.len()]);
                tree.any_hits_with(packet, hits, query, scratch, stats);
            }
        }
        passed.iter_mut().zip(hits).for_each(|(out, hit)| *out = f32::from(u8::from(!hit)));
    }
}

impl Engine for Kd {
    fn name(&self) -> &'static str {
        self.method.name()
    }

    fn structures(&self) -> &'static [Structure] {
        &[Structure::KdTree]
    }

    fn for_tile(&self, counted: bool) -> Option<Box<dyn Engine + '_>> {
        Some(Box::new(Tile::new(self, counted)))
    }

    fn transmittances(
        &self,
        rays: &[LightRay],
        light: Option<usize>,
        passed: &mut [f32],
        counters: Option<&mut Counters>,
    ) -> Result<(), QueryError> {
        Tile::new(self, counters.is_some()).transmittances(rays, light, passed, counters)
    }
}

impl Remembers for Kd {
    type Memory = KdVolumetricScratch;

    fn name(&self) -> &'static str {
        self.method.name()
    }

    fn memories(&self) -> &Mutex<Vec<KdVolumetricScratch>> {
        &self.memories
    }

    fn fresh(&self) -> KdVolumetricScratch {
        KdVolumetricScratch::default()
    }

    fn trace(
        &self,
        rays: &[LightRay],
        light: Option<usize>,
        passed: &mut [f32],
        counters: Option<&mut Counters>,
        scratch: &mut KdVolumetricScratch,
    ) {
        let query = self.query.with_light(light);
        match counters {
            Some(counters) => in_packets(&self.tree, rays, &query, scratch, passed, counters),
            None => in_packets(&self.tree, rays, &query, scratch, passed, &mut ()),
        }
    }
}
