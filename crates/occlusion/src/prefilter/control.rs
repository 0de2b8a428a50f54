//! Error control: which threshold and how many rays a target error needs, from a pilot.
//!
//! A sample of receivers is answered exactly with many rays, and then with one setting after the other; the cheapest one that
//! keeps the error wins. Cost is counted in steps of traversal, not timed, so that the choice is the same every time.

use super::{ConeQuery, ConeRay, Prefiltered};
use crate::OcclusionError;
use umbrage_accel::Statistics;

/// Rays of the pilot's exact answers.
const REFERENCE_RAYS: u32 = 400;

/// Thresholds tried, from fast to accurate.
const THRESHOLDS: [f32; 5] = [0.05, 0.1, 0.2, 0.4, 0.8];

/// Numbers of rays tried.
const RAY_COUNTS: [u32; 13] = [1, 2, 4, 6, 9, 12, 16, 25, 36, 49, 64, 100, 144];

/// Steps that a ray costs before its first node.
const STEPS_OF_PREPARATION: f64 = 3.0;

/// Work in steps: a node for all rays of a fan is one, a leaf for a ray, or a ray that ends at a node, half of one.
#[derive(Default)]
struct Steps(f64);

impl Statistics for Steps {
    fn node(&mut self, _: u32) {
        self.0 += 1.0;
    }

    fn triangles(&mut self, _: u32) {
        self.0 += 0.5;
    }

    fn ended_at_node(&mut self, _: u32, _: u32) {
        self.0 += 0.5;
    }
}

/// What a pilot chose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RayPlan {
    /// How to ask. Exact if no threshold reaches the target.
    pub query: ConeQuery,
    /// Rays a receiver.
    pub rays: u32,
    /// RMSE of visibility that the pilot measured, without the error of its own reference.
    pub error: f32,
    /// Work a receiver, in steps: nodes, leaves, ends of rays, preparations.
    pub steps: f64,
}

/// Error and cost of one setting.
struct Trial {
    error: f64,
    steps: f64,
}

impl Prefiltered {
    /// The cheapest setting whose RMSE of visibility a receiver stays below `target`, over a pilot of `receivers`.
    ///
    /// `fan(receiver, rays, seed, out)` adds that many rays of a receiver to `out`, each with its share of solid angle;
    /// different seeds must give unrelated patterns. If even the most rays, answered exactly, don't reach the target, they
    /// are what is returned, with the error that they have.
    ///
    /// # Errors
    /// [`OcclusionError::Target`] if the target is not above 0 or there are no receivers.
    pub fn plan(
        &self,
        target: f32,
        receivers: usize,
        mut fan: impl FnMut(usize, u32, u32, &mut Vec<ConeRay>),
    ) -> Result<RayPlan, OcclusionError> {
        if target.is_nan() || target <= 0.0 || receivers == 0 {
            return Err(OcclusionError::Target { target, receivers });
        }
        let mut cones = Vec::new();
        let mut mean = |receiver: usize, rays: u32, seed: u32, query: &ConeQuery, steps: &mut Steps| {
            cones.clear();
            fan(receiver, rays, seed, &mut cones);
            let mut passed = vec![1.0; cones.len()];
            self.transmittances_with(&cones, query, &mut passed, steps);
            passed.iter().map(|&x| f64::from(x)).sum::<f64>() / (cones.len() as f64).max(1.0)
        };
        let mut unused = Steps::default();
        // Two halves, whose difference is the reference's own error.
        let halves: Vec<[f64; 2]> = (0..receivers)
            .map(|i| [1, 2].map(|seed| mean(i, REFERENCE_RAYS / 2, seed, &ConeQuery::EXACT, &mut unused)))
            .collect();
        let own = halves.iter().map(|[a, b]| (0.5 * (a - b)).powi(2)).sum::<f64>() / receivers as f64;
        let mut trial = |query: &ConeQuery, rays: u32| {
            let mut steps = Steps::default();
            let squares: f64 = (0..receivers)
                .map(|i| (mean(i, rays, 3, query, &mut steps) - 0.5 * (halves[i][0] + halves[i][1])).powi(2))
                .sum();
            let error = (squares / receivers as f64 - own).max(0.0).sqrt();
            Trial { error, steps: steps.0 / receivers as f64 + STEPS_OF_PREPARATION * f64::from(rays) }
        };
        let mut best: Option<RayPlan> = None;
        let queries = THRESHOLDS.map(|t| ConeQuery::new(t).expect("above 0"));
        for query in queries.into_iter().chain([ConeQuery::EXACT]) {
            for rays in RAY_COUNTS {
                let Trial { error, steps } = trial(&query, rays);
                if best.is_some_and(|best| steps >= best.steps) {
                    break;
                }
                if error <= f64::from(target) {
                    best = Some(RayPlan { query, rays, error: error as f32, steps });
                    break;
                }
            }
        }
        Ok(best.unwrap_or_else(|| {
            let rays = RAY_COUNTS[RAY_COUNTS.len() - 1];
            let Trial { error, steps } = trial(&ConeQuery::EXACT, rays);
            RayPlan { query: ConeQuery::EXACT, rays, error: error as f32, steps }
        }))
    }
}
