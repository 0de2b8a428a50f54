//! Method `bvh-volumetric`: rays through the wide BVH that also end at boxes inside of solids. Exact.
//!
//! Each object gets its boxes when the first ray comes near it (Djeu11, section 4.8.5); instances share those of their mesh.

use super::{
    Engine, LightRay, one_mesh,
    tile::{Remembers, Tile},
};
use crate::{Occluders, QueryError, ShadowMethod, Structure, occluders::solids};
use std::sync::{Arc, Mutex};
use umbrage_accel::{Bvh, Counters};
use umbrage_geom::{Ray, TriangleMesh};
use umbrage_occlusion::volumetric::{
    Ends, LazyScratch, LazySolidBvh, ObjectMesh, Prepared, ShadowRays, SolidBvh, SolidBvhOptions,
    SolidInstances, SolidInstancesScratch,
};

pub(super) enum Solid<'a> {
    OneMesh(OneMesh<'a>),
    Instances(Instances<'a>),
}

pub(super) struct OneMesh<'a> {
    solid: Box<LazySolidBvh<'a>>,
    memories: Mutex<Vec<LazyScratch>>,
}

pub(super) struct Instances<'a> {
    solid: SolidInstances<'a>,
    memories: Mutex<Vec<SolidInstancesScratch>>,
}

fn lazy<'a>(bvh: &Arc<Bvh>, mesh: &'a TriangleMesh) -> Result<LazySolidBvh<'a>, QueryError> {
    let parts = ObjectMesh::new(&mesh.positions, &mesh.triangles).with_objects(solids(mesh));
    Ok(LazySolidBvh::build(bvh.clone(), &parts, &SolidBvhOptions::default())?)
}

fn fraction(blocked: bool) -> f32 {
    f32::from(u8::from(!blocked))
}

impl<'a> Solid<'a> {
    pub(super) fn new(occluders: &'a Occluders) -> Result<Self, QueryError> {
        occluders.note(Structure::SolidBoxes, None, None);
        if let Some(top) = occluders.instances() {
            let meshes = top.bvhs().iter().zip(occluders.meshes());
            let meshes = meshes.map(|(bvh, mesh)| lazy(bvh, mesh)).collect::<Result<_, _>>()?;
            let solid = SolidInstances::build(top, meshes)?;
            return Ok(Self::Instances(Instances { solid, memories: Mutex::default() }));
        }
        let name = ShadowMethod::BvhVolumetric.name();
        let (bvh, mesh) = one_mesh(name, occluders.flat_opaque())?;
        Ok(Self::OneMesh(OneMesh { solid: Box::new(lazy(bvh, mesh)?), memories: Mutex::default() }))
    }

    /// With all boxes made, for occluders whose shadow `rays` are expected to gain by them.
    pub(super) fn where_it_pays(occluders: &'a Occluders, rays: &ShadowRays) -> Option<Self> {
        let (bvh, mesh) = occluders.flat_opaque()?;
        let parts = ObjectMesh::new(&mesh.positions, &mesh.triangles).with_objects(solids(mesh));
        let options = SolidBvhOptions::default();
        let start = std::time::Instant::now();
        let solid = SolidBvh::build_if_it_pays(bvh, &parts, rays, &options).ok()??;
        let own_bytes = solid.bytes().saturating_sub(bvh.bytes());
        occluders.note(Structure::SolidBoxes, Some(start.elapsed()), Some(own_bytes));
        let solid = Box::new(LazySolidBvh::ready(solid));
        Some(Self::OneMesh(OneMesh { solid, memories: Mutex::default() }))
    }
}

impl Engine for Solid<'_> {
    fn name(&self) -> &'static str {
        ShadowMethod::BvhVolumetric.name()
    }

    fn structures(&self) -> &'static [Structure] {
        &[Structure::Bvh, Structure::SolidBoxes]
    }

    fn prepared(&self) -> Option<Prepared> {
        Some(match self {
            Self::OneMesh(part) => part.solid.prepared(),
            Self::Instances(part) => part.solid.prepared(),
        })
    }

    fn prepare_all(&self) {
        match self {
            Self::OneMesh(part) => part.solid.prepare_all(),
            Self::Instances(part) => part.solid.prepare_all(),
        }
    }

    fn for_tile(&self, counted: bool) -> Option<Box<dyn Engine + '_>> {
        Some(match self {
            Self::OneMesh(part) => Box::new(Tile::new(part, counted)),
            Self::Instances(part) => Box::new(Tile::new(part, counted)),
        })
    }

    fn transmittances(
        &self,
        rays: &[LightRay],
        light: Option<usize>,
        passed: &mut [f32],
        counters: Option<&mut Counters>,
    ) -> Result<(), QueryError> {
        match self {
            Self::OneMesh(part) => {
                Tile::new(part, counters.is_some()).transmittances(rays, light, passed, counters)
            }
            Self::Instances(part) => {
                Tile::new(part, counters.is_some()).transmittances(rays, light, passed, counters)
            }
        }
    }
}

impl Remembers for OneMesh<'_> {
    type Memory = LazyScratch;

    fn name(&self) -> &'static str {
        ShadowMethod::BvhVolumetric.name()
    }

    fn memories(&self) -> &Mutex<Vec<LazyScratch>> {
        &self.memories
    }

    fn fresh(&self) -> LazyScratch {
        self.solid.scratch()
    }

    fn trace(
        &self,
        rays: &[LightRay],
        light: Option<usize>,
        passed: &mut [f32],
        counters: Option<&mut Counters>,
        scratch: &mut LazyScratch,
    ) {
        let solid = &self.solid;
        if let Some(counters) = counters {
            for (to_light, out) in rays.iter().zip(passed) {
                let ray = &to_light.ray;
                *out = fraction(solid.any_hit_with(ray, Ends::Unknown, light, scratch, counters));
            }
        } else {
            let rays: Vec<Ray> = rays.iter().map(|light| light.ray).collect();
            let mut hits = vec![false; rays.len()];
            solid.any_hits(&rays, &mut hits, Ends::Unknown, light, scratch);
            hits.iter().zip(passed).for_each(|(&hit, out)| *out = fraction(hit));
        }
    }
}

impl Remembers for Instances<'_> {
    type Memory = SolidInstancesScratch;

    fn name(&self) -> &'static str {
        ShadowMethod::BvhVolumetric.name()
    }

    fn memories(&self) -> &Mutex<Vec<SolidInstancesScratch>> {
        &self.memories
    }

    fn fresh(&self) -> SolidInstancesScratch {
        self.solid.scratch()
    }

    fn trace(
        &self,
        rays: &[LightRay],
        _: Option<usize>,
        passed: &mut [f32],
        mut counters: Option<&mut Counters>,
        scratch: &mut SolidInstancesScratch,
    ) {
        let solid = &self.solid;
        for (to_light, out) in rays.iter().zip(passed) {
            let hit = match &mut counters {
                Some(counters) => solid.any_hit_with(&to_light.ray, scratch, *counters),
                None => solid.any_hit(&to_light.ray, scratch),
            };
            *out = fraction(hit);
        }
    }
}
