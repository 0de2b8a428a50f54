//! Entry points of our own hierarchy.

use crate::entry::{Entry, in_chunks};
use anyhow::Result;
use rayon::ThreadPool;
use serde_json::{Value, json};
use std::time::Instant;
use umbrage_accel::{BackEnd, BuildOptions, BuildQuality, Bvh, Counters};
use umbrage_geom::{OpticalDepth, Ray, TriangleMesh};

/// A build on a back end.
pub struct Ours {
    name: &'static str,
    /// Whether SIMD was turned off.
    pub scalar: bool,
    bvh: Bvh,
    pub build_s: f64,
}

impl Ours {
    /// Builds, timed.
    pub fn build(
        name: &'static str,
        mesh: &TriangleMesh,
        quality: BuildQuality,
        scalar: bool,
    ) -> Result<Self> {
        let options = BuildOptions::default().with_quality(quality);
        let start = Instant::now();
        let bvh = Bvh::build(&mesh.positions, &mesh.triangles, &options)?;
        let build_s = start.elapsed().as_secs_f64();
        let bvh = if scalar { bvh.with_back_end(BackEnd::Scalar)? } else { bvh };
        Ok(Self { name, scalar, bvh, build_s })
    }

    /// The hierarchy.
    pub fn bvh(&self) -> &Bvh {
        &self.bvh
    }

    /// Any hit of a slice and, but for the slow scalar form, ray by ray.
    pub fn any_hit<'a>(&'a self, rays: &'a [Ray]) -> Vec<Box<dyn Entry<bool> + 'a>> {
        let calls: &[bool] = if self.scalar { &[true] } else { &[true, false] };
        let entry = |&slice: &bool| -> Box<dyn Entry<bool> + 'a> {
            let hits = vec![false; rays.len()];
            Box::new(AnyHit { ours: self, rays, slice, hits })
        };
        calls.iter().map(entry).collect()
    }

    /// Transmittance of a slice, and ray by ray.
    pub fn transmittance<'a>(
        &'a self,
        rays: &'a [Ray],
        opacity: OpticalDepth,
    ) -> Vec<Box<dyn Entry<OpticalDepth> + 'a>> {
        let entry = |slice: bool| -> Box<dyn Entry<OpticalDepth> + 'a> {
            let depths = vec![OpticalDepth::CLEAR; rays.len()];
            Box::new(Transmittance { ours: self, rays, slice, opacity, depths })
        };
        vec![entry(true), entry(false)]
    }
}

fn counted(rays: &[Ray], mut query: impl FnMut(&Ray, &mut Counters)) -> Value {
    let mut counters = Counters::default();
    rays.iter().for_each(|ray| query(ray, &mut counters));
    json!({
        "nodes": counters.nodes,
        "box_tests": counters.box_tests,
        "triangle_tests": counters.triangle_tests,
        "uncertain": counters.uncertain,
    })
}

struct AnyHit<'a> {
    ours: &'a Ours,
    rays: &'a [Ray],
    slice: bool,
    hits: Vec<bool>,
}

impl Entry<bool> for AnyHit<'_> {
    fn method(&self) -> &'static str {
        self.ours.name
    }

    fn mode(&self) -> String {
        if self.slice { "slice" } else { "single" }.into()
    }

    fn build_s(&self) -> f64 {
        self.ours.build_s
    }

    fn bytes(&self) -> usize {
        self.ours.bvh.bytes()
    }

    fn run(&mut self, pool: Option<&ThreadPool>) {
        let (bvh, slice) = (&self.ours.bvh, self.slice);
        in_chunks(pool, self.rays, &mut self.hits, |rays, hits| {
            if slice {
                bvh.any_hits_with(rays, hits, &mut ());
            } else {
                rays.iter().zip(hits).for_each(|(ray, hit)| *hit = bvh.any_hit(ray));
            }
        });
    }

    fn answers(&self) -> Vec<bool> {
        self.hits.clone()
    }

    fn counters(&self) -> Value {
        counted(self.rays, |ray, counters| {
            self.ours.bvh.any_hit_with(ray, counters);
        })
    }
}

struct Transmittance<'a> {
    ours: &'a Ours,
    rays: &'a [Ray],
    slice: bool,
    opacity: OpticalDepth,
    depths: Vec<OpticalDepth>,
}

impl Entry<OpticalDepth> for Transmittance<'_> {
    fn method(&self) -> &'static str {
        self.ours.name
    }

    fn mode(&self) -> String {
        if self.slice { "slice" } else { "single" }.into()
    }

    fn build_s(&self) -> f64 {
        self.ours.build_s
    }

    fn bytes(&self) -> usize {
        self.ours.bvh.bytes()
    }

    fn run(&mut self, pool: Option<&ThreadPool>) {
        let (bvh, opacity, slice) = (&self.ours.bvh, self.opacity, self.slice);
        in_chunks(pool, self.rays, &mut self.depths, |rays, depths| {
            if slice {
                bvh.transmittances_with(rays, |_| opacity, depths, &mut ());
            } else {
                let each = rays.iter().zip(depths);
                each.for_each(|(ray, depth)| *depth = bvh.transmittance(ray, |_| opacity));
            }
        });
    }

    fn answers(&self) -> Vec<OpticalDepth> {
        self.depths.clone()
    }

    fn counters(&self) -> Value {
        counted(self.rays, |ray, counters| {
            self.ours.bvh.transmittance_with(ray, |_| self.opacity, counters);
        })
    }
}
