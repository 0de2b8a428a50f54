//! Whether solid boxes pay in a scene: the rules of thumb of Djeu11, section 3.8.2 as numbers, known before any ray is traced.

use super::Carved;
use crate::volumetric::Solid;
use umbrage_geom::{
    Aabb, Ray, SlabRay,
    glam::{DVec3, Vec3},
    sampling::RandomStream,
};

/// Lines from each light through each generator.
const LINES: u32 = 256;

/// Least share of a scene's triangles that generators must have: others block rays without boxes.
const MIN_TRIANGLE_SHARE: f32 = 0.65;

/// Fewest triangles of generators: less is traced as fast without.
const MIN_TRIANGLES: usize = 4_000;

/// The same where few rays share an origin: each asks the boxes by itself, which a few fewer nodes don't make up for.
const MIN_TRIANGLES_FOR_SINGLE_RAYS: usize = 16_000;

/// Least share of the lines from lights through generators that boxes must stop: the shadow shape test.
const MIN_COVERAGE: f32 = 0.1;

/// Least area of boxes, in those of triangles: the internal volume against tessellation test.
const MIN_AREA_RATIO: f32 = 100.0;

/// Shadow rays that are expected.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ShadowRays<'a> {
    /// Where they go: points, far away for distant lights.
    pub lights: &'a [Vec3],
    /// About how many.
    pub count: f64,
    /// About how many with the same origin are traced by one call ([`super::SolidBvh::any_hits`]); 1 for single rays.
    pub together: f64,
}

/// What is known of a scene with its generators.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Forecast {
    /// Share of the triangles that generators have.
    pub triangles: f32,
    /// Share of the lines from the lights through the generators' bounds that boxes stop, large bounds counting more: how many
    /// rays towards a generator are likely to end at its boxes.
    pub coverage: f32,
    /// Mean area of the boxes, in mean areas of the generators' triangles (both sides counted).
    pub area_ratio: f32,
    /// Volume of the boxes, overlaps counted twice, in those of the generators' bounds: what the occurrence rate of opaque cells
    /// is to a kd-tree (Djeu11, section 4.8.2).
    pub occurrence: f32,
}

impl Forecast {
    /// Whether boxes could pay, by the generators of a scene of so many triangles alone.
    pub(super) fn may_pay(generators: &[Solid], triangles: usize, rays: &ShadowRays) -> bool {
        let own: usize = generators.iter().map(|generator| generator.triangles as usize).sum();
        let smallest = if rays.together < 2.0 { MIN_TRIANGLES_FOR_SINGLE_RAYS } else { MIN_TRIANGLES };
        own as f32 >= MIN_TRIANGLE_SHARE * triangles as f32 && own >= smallest
    }

    /// Whether boxes are expected to save more than they cost, in scenes that aren't small.
    pub fn pays(&self) -> bool {
        self.triangles >= MIN_TRIANGLE_SHARE
            && self.coverage >= MIN_COVERAGE
            && self.area_ratio >= MIN_AREA_RATIO
    }
}

fn volume(aabb: &Aabb) -> f64 {
    aabb.size().as_dvec3().element_product()
}

impl Carved {
    /// See [`super::SolidBvh::forecast`]; `triangles` are those of the scene.
    pub(super) fn forecast(&self, lights: &[Vec3], triangles: usize) -> Forecast {
        let (mut stopped, mut all) = (0.0, 0.0);
        let (mut inside, mut outside) = (0.0, 0.0);
        let mut random = RandomStream::new(17, 0);
        for (index, interior) in self.interiors.iter().enumerate() {
            let bounds = interior.bounds;
            let own = self.owners.iter().zip(&self.solids).filter(|(owner, _)| **owner == index as u32);
            let boxes: Vec<Aabb> = own.map(|(_, aabb)| *aabb).collect();
            inside += boxes.iter().map(volume).sum::<f64>();
            outside += volume(&bounds);
            let weight = f64::from(bounds.area());
            for &light in lights {
                for _ in 0..LINES {
                    let at = Vec3::new(random.next_unit(), random.next_unit(), random.next_unit());
                    let through = bounds.min + bounds.size() * at;
                    let ray = Ray::between(light, through).with_tfar(f32::INFINITY);
                    let Some(slab) = SlabRay::new(&ray) else { continue };
                    all += weight;
                    if boxes.iter().any(|aabb| slab.surely_crosses(aabb)) {
                        stopped += weight;
                    }
                }
            }
        }
        let box_area: f64 = self.solids.iter().map(|aabb| f64::from(aabb.area())).sum();
        let mean_box = box_area / self.solids.len().max(1) as f64;
        let count: usize = self.interiors.iter().map(|interior| interior.triangles as usize).sum();
        let area: f64 = self.interiors.iter().map(|interior| interior.area).sum();
        let mean_triangle = 2.0 * area / count.max(1) as f64;
        Forecast {
            triangles: count as f32 / triangles.max(1) as f32,
            coverage: (stopped / f64::max(all, f64::MIN_POSITIVE)) as f32,
            area_ratio: (mean_box / mean_triangle.max(f64::MIN_POSITIVE)) as f32,
            occurrence: (inside / f64::max(outside, f64::MIN_POSITIVE)) as f32,
        }
    }
}

/// Area of triangles, one side.
pub(super) fn area(triangles: impl Iterator<Item = [[f32; 3]; 3]>) -> f64 {
    let one = |corners: [[f32; 3]; 3]| {
        let [a, b, c] = corners.map(|p| DVec3::from(p.map(f64::from)));
        0.5 * (b - a).cross(c - a).length()
    };
    triangles.map(one).sum()
}
