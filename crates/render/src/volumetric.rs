//! Shadow methods that end rays inside of solids: `kd`, `kd-volumetric`, `bvh-volumetric`.
//!
//! Structures are built when the first ray asks; `bvh-volumetric` prepares each object when the first ray comes near it
//! (Djeu11, section 4.8.5), and shares what it has made among the object's instances. Semi-transparent scenes, and
//! instances kept apart with a kd-tree, are traced by single rays instead. Exact: pictures don't change.

use crate::{
    geometry::Geometry,
    method::{LightRay, Method},
};
use std::sync::{Arc, Mutex, OnceLock};
use umbrage_accel::{Bvh, Counters, kdtree::Order};
use umbrage_geom::{Ray, TriangleMesh};
use umbrage_occlusion::volumetric::{
    self as occluders, Ends, KdVolumetric, KdVolumetricOptions, LazyScratch, LazySolidBvh, Object, Prepared,
    Query, Scratch, ShadowRays, SolidBvh, SolidBvhOptions, SolidCounters, SolidInstances,
    SolidInstancesScratch,
};

/// How rays are traced.
#[derive(Clone, Copy)]
enum Way {
    /// Kd-tree in an order, with occluders or without, and with a guide or without.
    Kd(Order, bool, bool),
    /// Solid boxes in the wide hierarchy.
    Wide,
}

/// Rays that walk a kd-tree together.
const PACKET: usize = 4;

/// Name of the wide hierarchy's method.
const WIDE: &str = "bvh-volumetric";

/// Names of the methods here.
pub(crate) const NAMES: [&str; 9] = [
    "kd",
    "kd-volumetric",
    "kd-volumetric:ray",
    "kd-volumetric:extended",
    "kd-volumetric:bfs",
    "kd-volumetric:qdbfs",
    "kd-volumetric:solid",
    "kd-volumetric:guided",
    WIDE,
];

fn way(name: &str) -> Option<Way> {
    Some(match name {
        "kd" => Way::Kd(Order::RAY, false, false),
        "kd-volumetric:ray" => Way::Kd(Order::RAY, true, false),
        "kd-volumetric:extended" => Way::Kd(Order::EXTENDED, true, false),
        "kd-volumetric:bfs" => Way::Kd(Order::BREADTH, true, false),
        "kd-volumetric" | "kd-volumetric:guided" => Way::Kd(Order::SOLID, true, true),
        "kd-volumetric:qdbfs" => Way::Kd(Order::QUICK, true, false),
        "kd-volumetric:solid" => Way::Kd(Order::SOLID, true, false),
        WIDE => Way::Wide,
        _ => return None,
    })
}

/// What the first ray builds.
enum Structure<'a> {
    Kd(Box<KdVolumetric>),
    Wide(Box<LazySolidBvh<'a>>),
    Instances(SolidInstances<'a>),
    /// The scene's own hierarchy serves.
    Plain,
}

/// What a thread keeps between calls.
enum Kept {
    Kd(Box<Scratch>),
    Wide(Box<LazyScratch>),
    Instances(SolidInstancesScratch),
}

struct Volumetric<'a> {
    name: &'static str,
    way: Way,
    geometry: &'a Geometry,
    structure: OnceLock<Structure<'a>>,
    kept: Mutex<Vec<Kept>>,
}

/// The method called `name`; `None` if it isn't one of [`NAMES`].
pub(crate) fn method<'a>(name: &str, geometry: &'a Geometry) -> Option<Box<dyn Method + 'a>> {
    let name = NAMES.into_iter().find(|known| *known == name)?;
    let way = way(name)?;
    Some(Box::new(Volumetric {
        name,
        way,
        geometry,
        structure: OnceLock::new(),
        kept: Mutex::new(Vec::new()),
    }))
}

/// `bvh-volumetric`, built, for a scene whose shadow `rays` are expected to gain by it.
pub(crate) fn where_it_pays<'a>(geometry: &'a Geometry, rays: &ShadowRays) -> Option<Box<dyn Method + 'a>> {
    let (bvh, mesh) = geometry.flat_opaque()?;
    let (positions, triangles) = (&mesh.positions, &mesh.triangles);
    let options = SolidBvhOptions::default();
    let solid = SolidBvh::build_if_it_pays(bvh, positions, triangles, &objects(mesh), rays, &options)?;
    let structure = OnceLock::from(Structure::Wide(Box::new(LazySolidBvh::ready(solid))));
    let kept = Mutex::new(Vec::new());
    Some(Box::new(Volumetric { name: WIDE, way: Way::Wide, geometry, structure, kept }))
}

fn objects(mesh: &TriangleMesh) -> Vec<Object> {
    let objects = mesh.objects_or_whole().into_iter();
    objects.map(|object| Object { triangles: object.triangles, opaque: true }).collect()
}

fn lazy<'a>(bvh: &Arc<Bvh>, mesh: &'a TriangleMesh) -> LazySolidBvh<'a> {
    let options = SolidBvhOptions::default();
    LazySolidBvh::new(bvh.clone(), &mesh.positions, &mesh.triangles, &objects(mesh), &options)
}

impl<'a> Volumetric<'a> {
    fn build(&self) -> Structure<'a> {
        let geometry = self.geometry;
        match (self.way, geometry.flat_opaque()) {
            (Way::Kd(..), Some((_, mesh))) => {
                let options = KdVolumetricOptions::default();
                // The mesh is valid, as it has a hierarchy; only its size could be too much for this tree.
                KdVolumetric::build(&mesh.positions, &mesh.triangles, &objects(mesh), &options)
                    .map_or(Structure::Plain, |kd| Structure::Kd(Box::new(kd)))
            }
            (Way::Wide, Some((bvh, mesh))) => Structure::Wide(Box::new(lazy(bvh, mesh))),
            (Way::Wide, None) => match geometry.instances() {
                Some(top) if geometry.is_opaque() => {
                    let meshes = top.bvhs().iter().zip(geometry.meshes());
                    Structure::Instances(SolidInstances::new(
                        top,
                        meshes.map(|(bvh, mesh)| lazy(bvh, mesh)).collect(),
                    ))
                }
                _ => Structure::Plain,
            },
            _ => Structure::Plain,
        }
    }

    fn take(&self) -> Option<Kept> {
        self.kept.lock().unwrap_or_else(|poisoned| poisoned.into_inner()).pop()
    }

    fn give(&self, kept: Kept) {
        self.kept.lock().unwrap_or_else(|poisoned| poisoned.into_inner()).push(kept);
    }
}

fn fraction(blocked: bool) -> f32 {
    if blocked { 0.0 } else { 1.0 }
}

/// Answers the rays of a receiver to a light in packets of four (Djeu11, section 3.7.1), a ray that is alone by itself.
fn in_packets(
    kd: &KdVolumetric,
    rays: &[LightRay],
    query: &Query,
    scratch: &mut Scratch,
    passed: &mut [f32],
    stats: &mut impl occluders::Statistics,
) {
    let none = Ray::new([0.0; 3], [0.0; 3]);
    for (rays, passed) in rays.chunks(PACKET).zip(passed.chunks_mut(PACKET)) {
        let (mut packet, mut hits) = ([none; PACKET], [false; PACKET]);
        packet.iter_mut().zip(rays).for_each(|(to, from)| *to = from.ray);
        match rays {
            [alone] => hits[0] = kd.any_hit_with(&alone.ray, query, scratch, stats),
            _ => {
                let (packet, hits) = (&packet[..rays.len()], &mut hits[..rays.len()]);
                kd.any_hits_in_packets(packet, hits, query, scratch, stats);
            }
        }
        passed.iter_mut().zip(hits).for_each(|(out, hit)| *out = fraction(hit));
    }
}

impl Method for Volumetric<'_> {
    fn name(&self) -> &'static str {
        self.name
    }

    fn prepared(&self) -> Option<Prepared> {
        match self.structure.get()? {
            Structure::Wide(solid) => Some(solid.prepared()),
            Structure::Instances(solid) => Some(solid.prepared()),
            _ => None,
        }
    }

    fn transmittances(
        &self,
        rays: &[LightRay],
        light: Option<usize>,
        passed: &mut [f32],
        counters: Option<&mut Counters>,
    ) {
        match (self.structure.get_or_init(|| self.build()), self.way) {
            (Structure::Kd(kd), Way::Kd(order, occluders, guided)) => {
                let mut scratch = match self.take() {
                    Some(Kept::Kd(scratch)) => scratch,
                    _ => Box::default(),
                };
                let query = Query::default()
                    .with_order(order)
                    .with_occluders(occluders)
                    .with_light(light)
                    .with_guide(guided);
                match counters {
                    Some(counters) => {
                        let mut counted = occluders::Counters::default();
                        in_packets(kd, rays, &query, &mut scratch, passed, &mut counted);
                        counters.nodes += counted.kd.steps;
                        counters.box_tests += counted.box_tests;
                        counters.triangle_tests += counted.kd.triangle_tests;
                    }
                    None => in_packets(kd, rays, &query, &mut scratch, passed, &mut ()),
                }
                self.give(Kept::Kd(scratch));
            }
            (Structure::Wide(solid), _) => {
                let mut scratch = match self.take() {
                    Some(Kept::Wide(scratch)) => scratch,
                    _ => Box::new(solid.scratch()),
                };
                match counters {
                    Some(counters) => {
                        let mut counted = SolidCounters::default();
                        for (to_light, out) in rays.iter().zip(passed) {
                            let (ray, ends) = (&to_light.ray, Ends::Unknown);
                            *out =
                                fraction(solid.any_hit_counted(ray, ends, light, &mut scratch, &mut counted));
                        }
                        *counters += counted.walk;
                    }
                    None => {
                        let rays: Vec<Ray> = rays.iter().map(|light| light.ray).collect();
                        let mut hits = vec![false; rays.len()];
                        solid.any_hits(&rays, &mut hits, Ends::Unknown, light, &mut scratch);
                        hits.iter().zip(passed).for_each(|(&hit, out)| *out = fraction(hit));
                    }
                }
                self.give(Kept::Wide(scratch));
            }
            (Structure::Instances(solid), _) => {
                let mut scratch = match self.take() {
                    Some(Kept::Instances(scratch)) => scratch,
                    _ => solid.scratch(),
                };
                let mut counted = SolidCounters::default();
                for (to_light, out) in rays.iter().zip(passed) {
                    let hit = match counters {
                        Some(_) => solid.any_hit_counted(&to_light.ray, &mut scratch, &mut counted),
                        None => solid.any_hit(&to_light.ray, &mut scratch),
                    };
                    *out = fraction(hit);
                }
                if let Some(counters) = counters {
                    *counters += counted.walk;
                }
                self.give(Kept::Instances(scratch));
            }
            _ => {
                let mut counters = counters;
                for (to_light, out) in rays.iter().zip(passed) {
                    *out = match counters.as_deref_mut() {
                        Some(counters) => self.geometry.transmittance(&to_light.ray, counters),
                        None => self.geometry.transmittance(&to_light.ray, &mut ()),
                    };
                }
            }
        }
    }
}
