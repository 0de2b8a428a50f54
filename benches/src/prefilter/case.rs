//! Scenes of the suite: geometry on a ground, the receivers of a small image, their rays, exact answers.

use crate::scenes::generated;
use anyhow::Result;
use std::time::Instant;
use umbrage_accel::{BuildOptions, Bvh};
use umbrage_geom::{
    Frame, OpticalDepth, Ray, TriangleMesh,
    glam::Vec3,
    offset_origin,
    sampling::{SphericalRectangle, combine, cosine_hemisphere, hash, stratified, unit},
};
use umbrage_occlusion::prefilter::{ConeQuery, ConeRay, PrefilterOptions, Prefiltered};

/// Rays of the exact answers that errors refer to.
const REFERENCE_RAYS: u32 = 576;

/// Receivers from one to the next whose exact answer is found twice, to know its own error.
const RECEIVERS_A_CHECK: usize = 32;

/// What is asked of a scene.
#[derive(Clone, Copy)]
pub enum Workload {
    /// Shadows of a square light.
    Shadow,
    /// Ambient occlusion up to this part of the diagonal.
    Ambient(f32),
}

/// A scene of the paper.
#[derive(Clone, Copy)]
pub struct Source {
    pub name: &'static str,
    /// What makes it.
    pub generator: &'static str,
    pub triangles: usize,
    pub alpha: f32,
    pub workload: Workload,
    /// Of the camera from the scene's middle, in diagonals.
    pub distance: f32,
}

/// The three scenes of figures 1, 7 and 8; the second also with unbounded ambient occlusion.
pub const SOURCES: [Source; 4] = [
    Source {
        name: "bush",
        generator: "bush",
        triangles: 2_000_000,
        alpha: 0.85,
        workload: Workload::Shadow,
        distance: 1.0,
    },
    Source {
        name: "tentacles",
        generator: "tentacles",
        triangles: 3_800_000,
        alpha: 1.0,
        workload: Workload::Ambient(0.1),
        distance: 0.55,
    },
    Source {
        name: "tentacles-far",
        generator: "tentacles",
        triangles: 3_800_000,
        alpha: 1.0,
        workload: Workload::Ambient(f32::INFINITY),
        distance: 0.55,
    },
    Source {
        name: "bamboo",
        generator: "bamboo",
        triangles: 5_200_000,
        alpha: 1.0,
        workload: Workload::Shadow,
        distance: 0.8,
    },
];

/// A point that light arrives at.
pub struct Receiver {
    pub point: Vec3,
    pub normal: Vec3,
    pub pixel: [u32; 2],
    /// Whether it is on the ground, not in the foliage.
    pub on_ground: bool,
}

pub struct Case {
    pub source: Source,
    pub mesh: TriangleMesh,
    /// By triangle.
    pub opacity: Vec<f32>,
    pub depths: Vec<OpticalDepth>,
    pub bvh: Bvh,
    pub bvh_build_s: f64,
    pub receivers: Vec<Receiver>,
    /// Exact visibility of each receiver.
    pub truth: Vec<f64>,
    /// Root mean square of the sampling error of [`Self::truth`].
    pub reference_rmse: f64,
    /// Pixels across; three quarters of it are the height.
    width: u32,
    light: [Vec3; 3],
    radius: f32,
}

/// Which receivers count.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    Whole,
    Ground,
    Foliage,
}

impl Kind {
    pub const ALL: [Self; 3] = [Self::Whole, Self::Ground, Self::Foliage];

    pub fn name(self) -> &'static str {
        match self {
            Self::Whole => "whole",
            Self::Ground => "ground",
            Self::Foliage => "foliage",
        }
    }

    pub fn holds(self, receiver: &Receiver) -> bool {
        match self {
            Self::Whole => true,
            Self::Ground => receiver.on_ground,
            Self::Foliage => !receiver.on_ground,
        }
    }
}

impl Case {
    /// The scene with about `triangles` triangles, seen by an image of `width` x 3/4 `width` pixels.
    pub fn new(source: Source, mesh: TriangleMesh, width: u32) -> Result<Self> {
        let mut case = Self::seen(source, mesh, width)?;
        case.refer();
        Ok(case)
    }

    /// The same scene seen by an image of another width.
    pub fn resize(&mut self, width: u32) {
        self.look(width);
        self.refer();
    }

    /// Width and height of the image.
    pub fn pixels(&self) -> [u32; 2] {
        [self.width, self.width * 3 / 4]
    }

    /// The same for people.
    pub fn size(&self) -> String {
        let [width, height] = self.pixels();
        format!("{width} x {height}")
    }

    /// The same without the exact answers.
    pub fn seen(source: Source, mesh: TriangleMesh, width: u32) -> Result<Self> {
        let mut mesh = mesh;
        let bounds = mesh.bounds();
        let (center, size) = (bounds.center(), bounds.diagonal());
        let own = mesh.triangles.len();
        let base = mesh.positions.len() as u32;
        let (y, half) = (bounds.min.y - 1e-4 * size, 2.0 * size);
        for (x, z) in [(-half, -half), (-half, half), (half, half), (half, -half)] {
            mesh.positions.push([center.x + x, y, center.z + z]);
        }
        mesh.triangles.extend([[base, base + 1, base + 2], [base, base + 2, base + 3]]);
        mesh.objects.clear();
        let mut opacity = vec![source.alpha; own];
        opacity.extend([1.0; 2]);
        let depths = opacity.iter().map(|&a| OpticalDepth::from_opacity(a)).collect();
        let start = Instant::now();
        let bvh = Bvh::build(&mesh.positions, &mesh.triangles, &BuildOptions::default())?;
        let bvh_build_s = start.elapsed().as_secs_f64();
        let middle = center + Vec3::new(0.2, 1.0, 0.15) * size;
        let side = 0.3 * size;
        let light = [
            middle - Vec3::new(0.5 * side, 0.0, 0.5 * side),
            Vec3::new(side, 0.0, 0.0),
            Vec3::new(0.0, 0.0, side),
        ];
        let radius =
            if let Workload::Ambient(radius) = source.workload { radius * size } else { f32::INFINITY };
        let (receivers, truth, reference_rmse) = (Vec::new(), Vec::new(), 0.0);
        let mut case = Self {
            source,
            mesh,
            opacity,
            depths,
            bvh,
            bvh_build_s,
            receivers,
            truth,
            reference_rmse,
            width,
            light,
            radius,
        };
        case.look(width);
        Ok(case)
    }

    /// The scene without the ground.
    pub fn mesh_alone(&self) -> Result<TriangleMesh> {
        let (positions, triangles) = (&self.mesh.positions, &self.mesh.triangles);
        let own = (positions[..positions.len() - 4].to_vec(), triangles[..triangles.len() - 2].to_vec());
        Ok(TriangleMesh::new(own.0, own.1)?)
    }

    /// The receiver on the ground that is nearest to half visible, and a hundredth of the solid angle of its light.
    pub fn half_shadow(&self) -> Option<(usize, f32)> {
        let half = |i: &usize| (self.truth[*i] - 0.5).abs();
        let grounded = (0..self.receivers.len()).filter(|&i| self.receivers[i].on_ground);
        let receiver = grounded.min_by(|a, b| half(a).total_cmp(&half(b)))?;
        let mut cones = Vec::new();
        self.fan(receiver, 100, 1, &mut cones);
        Some((receiver, cones[0].solid_angle))
    }

    /// A case over the generator's mesh.
    pub fn generate(source: Source, triangles: usize, width: u32) -> Result<Self> {
        Self::new(source, generated(source.generator, triangles)?, width)
    }

    /// Finds what a camera of `width` pixels across sees; pixels in tiles, so that neighbours follow each other.
    fn look(&mut self, width: u32) {
        self.width = width;
        self.receivers.clear();
        // The ground is the last two triangles.
        let own = self.mesh.triangles.len() - 2;
        let [corner, u, v] = self.light;
        let light = corner + 0.5 * (u + v);
        let bounds = self.mesh.bounds();
        let (low, own_bounds) = (
            bounds.min.y,
            umbrage_geom::Aabb::from_points(&self.mesh.positions[..self.mesh.positions.len() - 4]),
        );
        let size = own_bounds.diagonal();
        let center = own_bounds.center();
        let target = Vec3::new(center.x, low + 0.35 * (own_bounds.max.y - low), center.z);
        let forward = -Vec3::new(0.55, 0.45, 0.7).normalize();
        let eye = target - forward * size * self.source.distance;
        let right = forward.cross(Vec3::Y).normalize();
        let up = right.cross(forward);
        let [_, height] = self.pixels();
        for tile in 0..(width / 8) * (height / 8) {
            for i in 0..64 {
                let (x, y) = (tile % (width / 8) * 8 + i % 8, tile / (width / 8) * 8 + i / 8);
                let place = |at: u32, of: u32, angle: f32| ((at as f32 + 0.5) / of as f32 - 0.5) * angle;
                let direction = forward + right * place(x, width, 1.1) - up * place(y, height, 0.85);
                let Some(hit) = self.bvh.closest_hit(&Ray::new(eye, direction)) else { continue };
                let corners = self.mesh.triangle(hit.prim_index as usize).map(Vec3::from);
                let mut normal = (corners[1] - corners[0]).cross(corners[2] - corners[0]).normalize_or_zero();
                // Leaves are lit from both sides.
                let towards = match self.source.workload {
                    Workload::Shadow => light - corners[0],
                    Workload::Ambient(_) => -direction,
                };
                if normal.dot(towards) < 0.0 {
                    normal = -normal;
                }
                let along = eye + direction * hit.t;
                let in_plane = along - normal * (along - corners[0]).dot(normal);
                let point = offset_origin(in_plane, normal, normal, 2.0 * size);
                let on_ground = hit.prim_index as usize >= own;
                self.receivers.push(Receiver { point, normal, pixel: [x, y], on_ground });
            }
        }
    }

    /// Appends `rays` stratified rays of receiver `index`, each with its share of solid angle.
    pub fn fan(&self, index: usize, rays: u32, seed: u32, out: &mut Vec<ConeRay>) {
        let receiver = &self.receivers[index];
        let squares = stratified(rays, combine(seed, index as u32));
        match self.source.workload {
            Workload::Ambient(_) => {
                let frame = Frame::from_normal(receiver.normal);
                let share = std::f32::consts::PI / rays as f32;
                out.extend(squares.iter().map(|&s| {
                    let local = cosine_hemisphere(s);
                    let ray = Ray::new(receiver.point, frame.world_from_local(local)).with_tfar(self.radius);
                    ConeRay { ray, solid_angle: share / local.z.max(1e-3) }
                }));
            }
            Workload::Shadow => {
                let [corner, u, v] = self.light;
                let view = SphericalRectangle::new(receiver.point, corner, u, v);
                let share = view.solid_angle() / rays as f32;
                out.extend(squares.iter().map(|&s| {
                    let at = view.sample(s).map_or(corner, |sample| sample.point);
                    ConeRay { ray: Ray::between(receiver.point, at), solid_angle: share }
                }));
            }
        }
    }

    /// Rays of all receivers of a kind.
    pub fn rays(&self, kind: Kind, rays: u32, seed: u32) -> Vec<ConeRay> {
        let mut out = Vec::new();
        let chosen = self.receivers.iter().enumerate().filter(|(_, r)| kind.holds(r));
        chosen.for_each(|(i, _)| self.fan(i, rays, seed, &mut out));
        out
    }

    /// Exact answers to rays, in batches.
    pub fn exact(&self, rays: &[Ray], passed: &mut [f32], scratch: &mut (Vec<bool>, Vec<OpticalDepth>)) {
        if self.source.alpha == 1.0 {
            scratch.0.resize(rays.len(), false);
            self.bvh.any_hits_with(rays, &mut scratch.0, &mut ());
            passed.iter_mut().zip(&scratch.0).for_each(|(out, &hit)| *out = f32::from(u8::from(!hit)));
        } else {
            scratch.1.resize(rays.len(), OpticalDepth::CLEAR);
            self.bvh.transmittances_with(rays, |prim| self.depths[prim as usize], &mut scratch.1, &mut ());
            passed.iter_mut().zip(&scratch.1).for_each(|(out, depth)| *out = depth.transmittance());
        }
    }

    /// Answers where each crossing blocks with the probability of its opacity: noisier, without bias, and cheaper.
    pub fn stochastic(&self, rays: &[Ray], passed: &mut [f32], scratch: &mut (Vec<bool>, Vec<OpticalDepth>)) {
        let count = std::cell::Cell::new(0u32);
        let depth_of = |prim: u32| {
            count.set(count.get().wrapping_add(1));
            let blocks = unit(hash(count.get())) < self.opacity[prim as usize];
            if blocks { OpticalDepth::OPAQUE } else { OpticalDepth::CLEAR }
        };
        scratch.1.resize(rays.len(), OpticalDepth::CLEAR);
        self.bvh.transmittances_with(rays, depth_of, &mut scratch.1, &mut ());
        passed.iter_mut().zip(&scratch.1).for_each(|(out, depth)| *out = depth.transmittance());
    }

    /// Finds the exact visibility of all receivers, and its own error by that of some receivers once more with other rays.
    fn refer(&mut self) {
        let all: Vec<usize> = (0..self.receivers.len()).collect();
        self.truth = self.visibility(&all, 77);
        let checked: Vec<usize> = all.into_iter().step_by(RECEIVERS_A_CHECK).collect();
        let again = self.visibility(&checked, 78);
        let squares: f64 = checked.iter().zip(&again).map(|(&i, x)| (self.truth[i] - x).powi(2)).sum();
        // Both have the same error, independently.
        self.reference_rmse = (0.5 * squares / checked.len().max(1) as f64).sqrt();
    }

    /// Visibility of `receivers` by [`REFERENCE_RAYS`] exact rays each.
    fn visibility(&self, receivers: &[usize], seed: u32) -> Vec<f64> {
        use rayon::prelude::*;
        receivers
            .par_iter()
            .map_init(Default::default, |scratch, &i| {
                let mut cones = Vec::new();
                self.fan(i, REFERENCE_RAYS, seed, &mut cones);
                let rays: Vec<Ray> = cones.iter().map(|c| c.ray).collect();
                let mut passed = vec![0.0; rays.len()];
                self.exact(&rays, &mut passed, scratch);
                passed.iter().map(|&x| f64::from(x)).sum::<f64>() / f64::from(REFERENCE_RAYS)
            })
            .collect()
    }

    /// RMSE and bias of mean visibilities from `passed`, `rays` answers for each receiver of a kind.
    pub fn errors(&self, kind: Kind, rays: u32, passed: &[f32]) -> (f64, f64) {
        let truths = self.receivers.iter().zip(&self.truth).filter(|(r, _)| kind.holds(r)).map(|(_, &t)| t);
        let (mut squares, mut sum, mut count) = (0.0, 0.0, 0.0f64);
        for (truth, answers) in truths.zip(passed.chunks(rays as usize)) {
            let error = answers.iter().map(|&x| f64::from(x)).sum::<f64>() / f64::from(rays) - truth;
            squares += error * error;
            sum += error;
            count += 1.0;
        }
        ((squares / count.max(1.0)).sqrt(), sum / count.max(1.0))
    }

    pub fn mean_visibility(&self) -> f64 {
        self.truth.iter().sum::<f64>() / self.truth.len().max(1) as f64
    }

    /// A prefiltered hierarchy over the case, and the time to build it.
    pub fn prefiltered(&self, options: &PrefilterOptions) -> Result<(Prefiltered, f64)> {
        let start = Instant::now();
        let (positions, triangles) = (&self.mesh.positions, &self.mesh.triangles);
        let scene = Prefiltered::build(positions, triangles, &self.opacity, options, &mut |_| true)?;
        Ok((scene, start.elapsed().as_secs_f64()))
    }

    /// Threshold that the renderer uses for the workload.
    pub fn query(&self) -> ConeQuery {
        let threshold = if let Workload::Shadow = self.source.workload { 0.2 } else { 0.3 };
        ConeQuery::new(threshold).expect("above 0")
    }
}
