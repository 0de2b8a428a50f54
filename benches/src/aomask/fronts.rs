//! Single rays among one-sided triangles: what `rays` are where rays pass through backs.

use crate::{
    anyhit::ours::Ours,
    entry::{Entry, in_chunks},
};
use rayon::ThreadPool;
use std::ops::ControlFlow;
use umbrage_accel::{Bvh, FanGoal, FanRay};
use umbrage_geom::{
    Ray, intersect_triangle,
    kernel::{BlockMask, LANES, TriangleBlock},
};

/// Any hit of a front, of a slice and ray by ray.
pub fn entries<'a>(ours: &'a Ours, rays: &'a [Ray]) -> Vec<Box<dyn Entry<bool> + 'a>> {
    let entry = |slice| -> Box<dyn Entry<bool> + 'a> {
        Box::new(FrontHit { ours, rays, slice, hits: vec![false; rays.len()] })
    };
    vec![entry(true), entry(false)]
}

/// Whether each ray meets a front; those that share an origin walk together.
pub fn front_hits(bvh: &Bvh, rays: &[Ray], hits: &mut [bool]) {
    hits.fill(false);
    bvh.walk_fans_with(rays, &mut Fronts { rays, hits }, &mut ());
}

struct Fronts<'a> {
    rays: &'a [Ray],
    hits: &'a mut [bool],
}

impl FanGoal for Fronts<'_> {
    #[inline(always)]
    fn leaf(&mut self, ray: FanRay, _: u32, block: &TriangleBlock, mask: BlockMask) -> bool {
        let mut open = mask.certain | mask.uncertain;
        while open != 0 {
            let lane = open.trailing_zeros() as usize % LANES;
            open &= open - 1;
            let hit = intersect_triangle(&self.rays[ray.index], block.get(lane));
            if hit.is_some_and(|hit| hit.front) {
                self.hits[ray.index] = true;
                return true;
            }
        }
        false
    }
}

struct FrontHit<'a> {
    ours: &'a Ours,
    rays: &'a [Ray],
    slice: bool,
    hits: Vec<bool>,
}

impl Entry<bool> for FrontHit<'_> {
    fn method(&self) -> &'static str {
        "rays"
    }

    fn mode(&self) -> String {
        if self.slice { "slice-fronts" } else { "single-fronts" }.into()
    }

    fn build_s(&self) -> f64 {
        self.ours.build_s
    }

    fn bytes(&self) -> usize {
        self.ours.bvh().bytes()
    }

    fn run(&mut self, pool: Option<&ThreadPool>) {
        let (bvh, slice) = (self.ours.bvh(), self.slice);
        in_chunks(pool, self.rays, &mut self.hits, |rays, hits| {
            if slice {
                front_hits(bvh, rays, hits);
            } else {
                let front = |ray| {
                    bvh.for_each_hit(ray, |_, hit| match hit.front {
                        true => ControlFlow::Break(()),
                        false => ControlFlow::Continue(()),
                    })
                };
                rays.iter().zip(hits).for_each(|(ray, hit)| *hit = front(ray).is_break());
            }
        });
    }

    fn answers(&self) -> Vec<bool> {
        self.hits.clone()
    }
}
