//! Ways to answer the shadow rays of a scene.

use super::scene::{Scene, Shadows};
use crate::rows::{Timed, median};
use anyhow::Result;
use serde_json::{Value, json};
use std::{sync::Arc, time::Instant};
use umbrage_accel::{BuildOptions, Bvh, Counters, KdTree, Statistics, kdtree::Order};
use umbrage_occlusion::volumetric::{
    Ends, KdQuery, KdVolumetric, KdVolumetricOptions, KdVolumetricScratch, ObjectMesh, ShadowRays, SolidBvh,
    SolidBvhOptions, Solids, published::Classifier,
};
use umbrage_query::{
    Engine, Occluders,
    engine::{self, LightRay},
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

/// The choice between the plain hierarchy and the one with boxes.
pub const AUTO: &str = "auto";

/// Of these, with a guide.
const GUIDED: [&str; 2] = ["extended", "solid"];

/// Methods of the renderer that walk a kd-tree, with the suite's names for what they do.
const OF_RENDERER: [(&str, &str); 5] = [
    ("kd", "kd"),
    ("kd-volumetric:extended", "kd-volumetric:extended+cache"),
    ("kd-volumetric:qdbfs", "kd-volumetric:qdbfs+cache"),
    ("kd-volumetric:solid", "kd-volumetric:solid+cache"),
    ("kd-volumetric:guided", "kd-volumetric:solid+guide"),
];

/// The structures of a scene, with the times that they took, seconds.
pub struct Structures {
    pub bvh: Arc<Bvh>,
    pub bvh_s: f64,
    pub solid: SolidBvh,
    pub solid_s: f64,
    /// What the method `auto` has for single rays and for fans, if it has boxes, and the times that it took to decide.
    pub auto: [(Option<SolidBvh>, f64); 2],
    pub kd: KdVolumetric,
    /// Of the tree alone.
    pub kd_s: f64,
    /// To find generators: the audit.
    pub audit_s: f64,
    /// To classify cells.
    pub classify_s: f64,
    /// To classify each cell by its own test ray.
    pub test_rays_s: f64,
}

/// Less is measured several times, seconds.
const MIN_BUILD_SECONDS: f64 = 0.2;

/// What is made of what was prepared, and the seconds that it took: the median of five if it is quick.
fn timed<P, T>(prepare: impl Fn() -> P, make: impl Fn(P) -> T) -> (T, f64) {
    let once = || {
        let prepared = prepare();
        let start = Instant::now();
        let made = make(prepared);
        (made, start.elapsed().as_secs_f64())
    };
    let (made, first) = once();
    if first > MIN_BUILD_SECONDS {
        return (made, first);
    }
    let times: Vec<f64> = std::iter::once(first).chain((1..5).map(|_| once().1)).collect();
    (made, median(&times))
}

impl Structures {
    /// For images of so many rays, so many of them from each point to each light.
    pub fn build(scene: &Scene, count: f64, fans: f64) -> Result<Self> {
        let (positions, triangles) = (&scene.mesh.positions, &scene.mesh.triangles);
        let (bvh, bvh_s) = timed(|| (), |()| Bvh::build(positions, triangles, &BuildOptions::default()));
        let bvh = Arc::new(bvh?);
        let parts = ObjectMesh::new(positions, triangles).with_objects(&scene.objects);
        let options = SolidBvhOptions::default();
        let (solid, solid_s) = timed(|| bvh.clone(), |bvh| SolidBvh::build(bvh, &parts, &options));
        let lights: Vec<_> = scene.lights.iter().map(|light| light.bounds().center()).collect();
        let auto = [1.0, fans].map(|together| {
            let rays = ShadowRays { lights: &lights, count, together };
            timed(
                || (),
                |()| SolidBvh::build_if_it_pays(&bvh, &parts, &rays, &options).expect("checked meshes"),
            )
        });
        let options = KdVolumetricOptions::default();
        let (solids, audit_s) = timed(|| (), |()| Solids::find(&parts, &options.solids));
        let solids = solids?;
        let (tree, kd_s) = timed(
            || (),
            |()| KdTree::build_guarded(positions, triangles, solids.caps(), &options.tree, &mut |_| true),
        );
        let built = (tree?, solids);
        let classified =
            |by| timed(|| built.clone(), |(tree, solids)| KdVolumetric::from_parts(tree, solids, by));
        let (_, test_rays_s) = classified(Classifier::TestRays);
        let (kd, classify_s) = classified(Classifier::Flood);
        Ok(Self { bvh, bvh_s, solid: solid?, solid_s, auto, kd: kd?, kd_s, audit_s, classify_s, test_rays_s })
    }
}

/// How a caster calls.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Call {
    Single,
    /// Packets of four in the kd-tree, the fan of a receiver and a light in the hierarchy, with solid boxes or without.
    Together,
    /// As the renderer's shadow pass: all rays of a receiver to a light in one call of its method, which makes packets of four.
    Renderer,
}

impl Call {
    pub const ALL: [Self; 3] = [Self::Single, Self::Together, Self::Renderer];

    /// What rows call it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Single => "single",
            Self::Together => "together",
            Self::Renderer => "renderer",
        }
    }
}

/// What a caster is.
#[derive(Clone, Copy)]
pub enum Kind<'a> {
    Bvh(&'a Bvh),
    /// With boxes remembered by light or not.
    Solid(&'a SolidBvh, bool),
    /// Order, and how occluders are used.
    Kd(&'a KdVolumetric, Order, Use),
    /// A method of the renderer.
    Renderer(&'a dyn Engine),
}

/// How a kd-tree's occluders are used.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Use {
    Not,
    Plain,
    Cached,
    /// By what the light's last rays met ([`KdQuery::with_guide`]).
    Guided,
}

/// A way to answer all rays.
pub struct Caster<'a> {
    pub method: String,
    pub call: Call,
    pub kind: Kind<'a>,
    pub build_s: f64,
    pub bytes: usize,
}

/// Methods of the renderer that walk a kd-tree, with the suite's names.
pub fn of_renderer(occluders: &Occluders) -> Result<Vec<Named<'_>>> {
    let method =
        |(name, ours): (&str, _)| Ok((ours, engine::shadows(name.parse()?, occluders, &mut |_| true)?));
    OF_RENDERER.into_iter().map(method).collect()
}

/// A method of the renderer, and what rows call it.
pub type Named<'a> = (&'static str, Box<dyn Engine + 'a>);

/// The casters that walk a kd-tree, by our calls and the renderer's.
pub fn kd_casters<'a>(s: &'a Structures, renderer: &'a [Named<'a>]) -> Vec<Caster<'a>> {
    let pre_s = s.kd_s + s.audit_s + s.classify_s;
    let mut casters = Vec::new();
    let mut add = |method: &str, call, kind, build_s, bytes| {
        casters.push(Caster { method: method.into(), call, kind, build_s, bytes });
    };
    for call in [Call::Single, Call::Together] {
        add("kd", call, Kind::Kd(&s.kd, Order::RAY, Use::Not), s.kd_s, s.kd.tree().bytes());
        for (name, order) in ORDERS {
            for (how, suffix) in [(Use::Plain, ""), (Use::Cached, "+cache"), (Use::Guided, "+guide")] {
                if (how == Use::Guided && !GUIDED.contains(&name)) || (how == Use::Cached && name == "ray") {
                    continue;
                }
                let method = format!("kd-volumetric:{name}{suffix}");
                add(&method, call, Kind::Kd(&s.kd, order, how), pre_s, s.kd.bytes());
            }
        }
    }
    for (name, method) in renderer {
        add(name, Call::Renderer, Kind::Renderer(method.as_ref()), pre_s, s.kd.bytes());
    }
    casters
}

/// The casters that walk the wide hierarchy.
pub fn wide_casters(s: &Structures) -> Vec<Caster<'_>> {
    let mut casters = Vec::new();
    let mut add = |method: &str, call, kind, build_s, bytes| {
        casters.push(Caster { method: method.into(), call, kind, build_s, bytes });
    };
    for call in [Call::Single, Call::Together] {
        add("bvh", call, Kind::Bvh(&s.bvh), s.bvh_s, s.bvh.bytes());
    }
    for (name, call, remembered) in [
        ("bvh-volumetric", Call::Single, false),
        ("bvh-volumetric+cache", Call::Single, true),
        ("bvh-volumetric", Call::Together, false),
        ("bvh-volumetric+cache", Call::Together, true),
    ] {
        let build_s = s.bvh_s + s.solid_s;
        add(name, call, Kind::Solid(&s.solid, remembered), build_s, s.solid.bytes());
    }
    // As `umbrage render` calls it.
    for (call, (auto, auto_s)) in [Call::Single, Call::Together].into_iter().zip(&s.auto) {
        let kind = auto.as_ref().map_or(Kind::Bvh(&s.bvh), |solid| Kind::Solid(solid, true));
        add(AUTO, call, kind, s.bvh_s + auto_s, auto.as_ref().map_or(s.bvh.bytes(), SolidBvh::bytes));
    }
    casters
}

impl Caster<'_> {
    /// Answers every ray.
    fn run(&self, scene: &Scene, shadows: &Shadows, hits: &mut [bool]) {
        match self.kind {
            Kind::Bvh(bvh) => match self.call {
                Call::Single => {
                    shadows.rays.iter().zip(hits).for_each(|(ray, hit)| *hit = bvh.any_hit(ray));
                }
                _ => bvh.any_hits_with(&shadows.rays, hits, &mut ()),
            },
            Kind::Solid(solid, remembered) => {
                let mut scratch = solid.scratch();
                let ends = ends(scene, |region| solid.is_outside(region));
                for (light, range) in shadows.runs(self.call == Call::Together) {
                    let (rays, hits) = (&shadows.rays[range.clone()], &mut hits[range]);
                    let ends = ends_of(&ends, light);
                    let light = light.filter(|_| remembered);
                    match self.call {
                        Call::Single => rays
                            .iter()
                            .zip(hits)
                            .for_each(|(ray, hit)| *hit = solid.any_hit(ray, ends, light, &mut scratch)),
                        _ => solid.any_hits(rays, hits, ends, light, &mut scratch),
                    }
                }
            }
            Kind::Kd(..) => self.run_kd(scene, shadows, hits, &mut ()),
            Kind::Renderer(method) => run_method(method, shadows, hits, None),
        }
    }

    fn run_kd(&self, scene: &Scene, shadows: &Shadows, hits: &mut [bool], stats: &mut impl Statistics) {
        let Kind::Kd(kd, order, how) = self.kind else { return };
        let mut scratch = KdVolumetricScratch::default();
        let ends = ends(scene, |region| kd.is_outside(region));
        for (light, range) in shadows.runs(self.call == Call::Together) {
            let (rays, hits) = (&shadows.rays[range.clone()], &mut hits[range]);
            let query = KdQuery::default()
                .with_order(order)
                .with_ends(ends_of(&ends, light))
                .with_light(light.filter(|_| [Use::Cached, Use::Guided].contains(&how)))
                .with_guide(how == Use::Guided)
                .with_occluders(how != Use::Not);
            match self.call {
                Call::Single => rays
                    .iter()
                    .zip(hits)
                    .for_each(|(ray, hit)| *hit = kd.any_hit_with(ray, &query, &mut scratch, stats)),
                _ => kd.any_hits_with(rays, hits, &query, &mut scratch, stats),
            }
        }
    }

    /// Whether whole images are counted with it, where any are.
    pub fn counts_images(&self) -> bool {
        let kind = match self.kind {
            Kind::Bvh(_) => self.method != AUTO,
            Kind::Solid(_, remembered) => remembered && self.method != AUTO,
            Kind::Kd(_, order, how) => match how {
                Use::Not | Use::Cached => true,
                Use::Guided => order == Order::SOLID,
                Use::Plain => false,
            },
            Kind::Renderer(_) => false,
        };
        kind && self.call == Call::Single
    }

    /// An empty tally.
    pub fn tally(&self) -> Tally {
        match self.kind {
            Kind::Bvh(_) | Kind::Renderer(_) => Tally::Bvh(Counters::default()),
            Kind::Solid(..) => Tally::Solid(Counters::default()),
            Kind::Kd(..) => Tally::Kd(Counters::default()),
        }
    }

    /// Answers every ray and counts the work.
    pub fn count(&self, scene: &Scene, shadows: &Shadows, tally: &mut Tally) {
        match (self.kind, tally) {
            (Kind::Bvh(bvh), Tally::Bvh(counters)) => {
                for ray in &shadows.rays {
                    bvh.any_hit_with(ray, counters);
                }
            }
            (Kind::Solid(solid, remembered), Tally::Solid(counters)) => {
                let mut scratch = solid.scratch();
                for (light, range) in shadows.runs(false) {
                    let light = light.filter(|_| remembered);
                    for ray in &shadows.rays[range] {
                        solid.any_hit_with(ray, Ends::Unknown, light, &mut scratch, counters);
                    }
                }
            }
            (Kind::Kd(..), Tally::Kd(counters)) => {
                let mut hits = vec![false; shadows.rays.len()];
                self.run_kd(scene, shadows, &mut hits, counters);
            }
            (Kind::Renderer(method), Tally::Bvh(counters)) => {
                let mut hits = vec![false; shadows.rays.len()];
                run_method(method, shadows, &mut hits, Some(counters));
            }
            _ => unreachable!("tallies are made for their casters"),
        }
    }

    /// What was counted over `rays` rays.
    pub fn report(&self, scene: &Scene, tally: &Tally, rays: usize) -> (Counters, Value) {
        match (self.kind, tally) {
            (Kind::Solid(solid, _), Tally::Solid(counters)) => {
                let lights: Vec<_> = scene.lights.iter().map(|light| light.bounds().center()).collect();
                let forecast = solid.forecast(&lights);
                let value = json!({
                    "counted_rays": rays,
                    "nodes": counters.nodes,
                    "triangle_tests": counters.triangle_tests,
                    "box_tests": counters.box_tests,
                    "occluders": solid.occluders().len(),
                    "packs": solid.pack_count(),
                    "forecast_triangles": forecast.triangles,
                    "forecast_coverage": forecast.coverage,
                    "forecast_area_ratio": forecast.area_ratio,
                    "forecast_occurrence": forecast.occurrence,
                    "forecast_pays": forecast.pays(),
                    "occluder_hits": counters.solid_hits,
                    "cache_hits": counters.remembered_hits,
                    "generators": solid.solid_count(),
                });
                (Counters::default(), value)
            }
            (Kind::Kd(kd, ..), Tally::Kd(c)) => {
                let lanes = if self.call == Call::Single { 1.0 } else { 4.0 };
                let value = json!({
                    "counted_rays": rays,
                    "nodes": c.nodes,
                    "triangle_tests": c.triangle_tests,
                    "box_tests": c.box_tests,
                    "occluders": kd.occluders().len(),
                    "grown": kd.grown().len(),
                    "occurrence_rate": kd.occurrence_rate(),
                    "occluder_hits": c.cell_hits,
                    "triangle_hits": c.triangle_hits,
                    "misses": c.misses,
                    "cache_hits": c.cache_hits,
                    "cache_hit_rate": c.cache_hits as f64 / c.cache_lookups.max(1) as f64,
                    "mean_occluder_area": c.cell_area / c.cell_hits.max(1) as f64,
                    "packet_use": c.rays_at_nodes as f64 / (lanes * c.nodes.max(1) as f64),
                    "packet_use_at_leaves": c.rays_at_leaves as f64 / (lanes * c.leaves.max(1) as f64),
                });
                (*c, value)
            }
            (_, Tally::Bvh(counters)) => {
                let value = json!({
                    "counted_rays": rays, "nodes": counters.nodes, "triangle_tests": counters.triangle_tests,
                    "box_tests": counters.box_tests,
                });
                (Counters::default(), value)
            }
            _ => unreachable!("tallies are made for their casters"),
        }
    }
}

/// Answers every ray as the integrator asks: a receiver and a light at a time.
fn run_method(
    method: &dyn Engine,
    shadows: &Shadows,
    hits: &mut [bool],
    mut counters: Option<&mut Counters>,
) {
    let (mut rays, mut passed) = (Vec::new(), Vec::new());
    for fan in &shadows.fans {
        let range = fan.start as usize..fan.end as usize;
        rays.clear();
        // Only prefiltered rays ask for solid angles.
        rays.extend(shadows.rays[range.clone()].iter().map(|&ray| LightRay::new(ray, 0.0)));
        passed.clear();
        passed.resize(rays.len(), 1.0);
        let light = Some(fan.light as usize);
        let answered = method.transmittances(&rays, light, &mut passed, counters.as_deref_mut());
        answered.expect("shadow methods answer rays");
        hits[range].iter_mut().zip(&passed).for_each(|(hit, &passed)| *hit = passed == 0.0);
    }
}

/// Work of a caster over parts of an image.
pub enum Tally {
    Bvh(Counters),
    Solid(Counters),
    Kd(Counters),
}

/// Lights are classified once.
fn ends(scene: &Scene, is_outside: impl Fn(&umbrage_geom::Aabb) -> bool) -> Vec<Ends> {
    let known = |outside| if outside { Ends::Outside } else { Ends::Unknown };
    scene.lights.iter().map(|light| known(is_outside(&light.bounds()))).collect()
}

/// What is known of the ends of rays to a light, or to all of them.
fn ends_of(ends: &[Ends], light: Option<usize>) -> Ends {
    let all_outside = || ends.iter().all(|&ends| ends == Ends::Outside);
    match light {
        Some(light) => ends[light],
        None if all_outside() => Ends::Outside,
        None => Ends::Unknown,
    }
}

/// A caster under the clock.
pub struct Run<'a> {
    pub caster: &'a Caster<'a>,
    pub scene: &'a Scene,
    pub shadows: &'a Shadows,
    pub hits: Vec<bool>,
}

impl Timed for Run<'_> {
    fn run(&mut self) {
        self.caster.run(self.scene, self.shadows, &mut self.hits);
    }
}
