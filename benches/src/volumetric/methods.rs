//! Ways to answer the shadow rays of a scene.

use super::scene::{Scene, Shadows};
use anyhow::Result;
use std::sync::Arc;
use std::time::Instant;
use umbrage_accel::{BuildOptions, Bvh, KdTree, kdtree::Order};
use umbrage_occlusion::volumetric::{
    Classifier, Counters, Ends, KdVolumetric, KdVolumetricOptions, Query, Scratch, SolidBvh, SolidBvhOptions,
    SolidScratch, Solids, Statistics,
};

/// Orders under their names.
pub const ORDERS: [(&str, Order); 6] = [
    ("ray", Order::RAY),
    ("extended", Order::EXTENDED),
    ("extended-8", Order::EXTENDED_SPARSE),
    ("bfs", Order::BREADTH),
    ("qdbfs", Order::QUICK),
    ("solid", Order::SOLID),
];

/// The structures of a scene, with the times that they took.
pub struct Structures {
    pub bvh: Arc<Bvh>,
    pub solid: SolidBvh,
    pub solid_s: f64,
    pub bvh_s: f64,
    pub kd: KdVolumetric,
    /// Of the tree alone.
    pub kd_s: f64,
    /// To find generators: the audit.
    pub audit_s: f64,
    /// To classify cells.
    pub classify_s: f64,
}

impl Structures {
    pub fn build(scene: &Scene) -> Result<Self> {
        let (positions, triangles) = (&scene.mesh.positions, &scene.mesh.triangles);
        let seconds = |start: Instant| start.elapsed().as_secs_f64();
        let start = Instant::now();
        let bvh = Arc::new(Bvh::build(positions, triangles, &BuildOptions::default())?);
        let bvh_s = seconds(start);
        let start = Instant::now();
        let solid =
            SolidBvh::build(bvh.clone(), positions, triangles, &scene.objects, &SolidBvhOptions::default());
        let solid_s = seconds(start);
        let options = KdVolumetricOptions::default();
        let start = Instant::now();
        let solids = Solids::find(positions, triangles, &scene.objects, &options.solids);
        let audit_s = seconds(start);
        let start = Instant::now();
        let tree = KdTree::build_guarded(positions, triangles, solids.caps(), &options.tree, &mut |_| true)?;
        let kd_s = seconds(start);
        let start = Instant::now();
        let kd = KdVolumetric::new(tree, solids, Classifier::Flood);
        let classify_s = seconds(start);
        Ok(Self { bvh, solid, solid_s, bvh_s, kd, kd_s, audit_s, classify_s })
    }
}

/// How a caster calls.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Call {
    Single,
    Packets,
}

/// A way to answer all rays.
pub struct Caster<'a> {
    pub method: String,
    pub call: Call,
    pub build_s: f64,
    pub bytes: usize,
    pub kind: Kind<'a>,
}

pub enum Kind<'a> {
    Bvh(&'a Bvh),
    Solid(&'a SolidBvh, bool),
    /// A tree, an order, whether occluders are used, whether they are cached.
    Kd(&'a KdVolumetric, Order, bool, bool),
}

impl Caster<'_> {
    /// Answers every ray.
    pub fn run(&self, scene: &Scene, shadows: &Shadows, hits: &mut [bool]) {
        self.run_with(scene, shadows, hits, &mut ());
    }

    pub fn run_with(&self, scene: &Scene, shadows: &Shadows, hits: &mut [bool], stats: &mut impl Statistics) {
        match self.kind {
            Kind::Bvh(bvh) => match self.call {
                Call::Single => shadows.rays.iter().zip(hits).for_each(|(ray, hit)| *hit = bvh.any_hit(ray)),
                Call::Packets => bvh.any_hits_with(&shadows.rays, hits, &mut ()),
            },
            Kind::Solid(solid, cached) => {
                let mut scratch = SolidScratch::default();
                let ends: Vec<Ends> = scene
                    .lights
                    .iter()
                    .map(
                        |light| {
                            if solid.is_outside(&light.bounds()) { Ends::Outside } else { Ends::Unknown }
                        },
                    )
                    .collect();
                for fan in &shadows.fans {
                    let range = fan.start as usize..fan.end as usize;
                    let (rays, hits) = (&shadows.rays[range.clone()], &mut hits[range]);
                    let light = cached.then_some(fan.light as usize);
                    let ends = ends[fan.light as usize];
                    match self.call {
                        Call::Single => rays
                            .iter()
                            .zip(hits)
                            .for_each(|(ray, hit)| *hit = solid.any_hit(ray, ends, light, &mut scratch)),
                        Call::Packets => solid.any_hits(rays, hits, ends, light, &mut scratch),
                    }
                }
            }
            Kind::Kd(kd, order, occluders, cached) => {
                let mut scratch = Scratch::default();
                // Lights are classified once.
                let ends: Vec<Ends> = scene
                    .lights
                    .iter()
                    .map(|light| if kd.is_outside(&light.bounds()) { Ends::Outside } else { Ends::Unknown })
                    .collect();
                for fan in &shadows.fans {
                    let range = fan.start as usize..fan.end as usize;
                    let (rays, hits) = (&shadows.rays[range.clone()], &mut hits[range]);
                    let query = Query::default()
                        .with_order(order)
                        .with_ends(ends[fan.light as usize])
                        .with_light(cached.then_some(fan.light as usize))
                        .with_occluders(occluders);
                    match self.call {
                        Call::Single => rays
                            .iter()
                            .zip(hits)
                            .for_each(|(ray, hit)| *hit = kd.any_hit_with(ray, &query, &mut scratch, stats)),
                        Call::Packets => kd.any_hits_in_packets(rays, hits, &query, &mut scratch, stats),
                    }
                }
            }
        }
    }

    /// What a pass does.
    pub fn counters(&self, scene: &Scene, shadows: &Shadows) -> Counters {
        let mut counters = Counters::default();
        let mut hits = vec![false; shadows.rays.len()];
        self.run_with(scene, shadows, &mut hits, &mut counters);
        counters
    }
}
