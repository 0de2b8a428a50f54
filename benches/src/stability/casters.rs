//! The methods compared: Umbrage, and what is commonly used instead.

use crate::peer::Peer;
use anyhow::Result;
use std::time::Instant;
use umbrage_accel::{BackEnd, BuildOptions, Bvh, brute};
use umbrage_geom::{Ray, TriangleMesh, glam::Vec3, segment_hits_triangle, winding_number};

/// Something that tells whether rays hit a mesh.
pub trait Caster {
    fn name(&self) -> &'static str;

    /// Seconds to build its structure.
    fn build_s(&self) -> f64;

    /// Bytes of its structure.
    fn bytes(&self) -> usize;

    /// Whether each ray hits, on this thread alone; returns the seconds that took.
    fn any_hits(&self, rays: &[Ray], hits: &mut [bool]) -> f64;

    /// Its test of one triangle; `None` if it has none of its own.
    fn hits_triangle(&self, ray: &Ray, corners: [[f32; 3]; 3]) -> Option<bool>;

    /// Whether its count of crossings fits the winding number around the ray's origin; `None` if it doesn't count.
    fn counts(&self, ray: &Ray, winding: i32) -> Option<bool>;

    /// Whether its structure answers as a loop over all triangles does; `None` if it has none.
    fn agrees_with_brute_force(&self, ray: &Ray) -> Option<bool>;
}

/// Umbrage: its hierarchy and exact predicate.
pub struct Umbrage<'a> {
    mesh: &'a TriangleMesh,
    bvh: Bvh,
    /// The same without SIMD, which must give the same answers.
    scalar: Bvh,
    build_s: f64,
}

impl<'a> Umbrage<'a> {
    pub fn new(mesh: &'a TriangleMesh) -> Result<Self> {
        let start = Instant::now();
        let bvh = Bvh::build(&mesh.positions, &mesh.triangles, &BuildOptions::default())?;
        let build_s = start.elapsed().as_secs_f64();
        let scalar = bvh.clone().with_back_end(BackEnd::Scalar)?;
        Ok(Self { mesh, bvh, scalar, build_s })
    }
}

impl Caster for Umbrage<'_> {
    fn name(&self) -> &'static str {
        "umbrage"
    }

    fn build_s(&self) -> f64 {
        self.build_s
    }

    fn bytes(&self) -> usize {
        self.bvh.bytes()
    }

    fn any_hits(&self, rays: &[Ray], hits: &mut [bool]) -> f64 {
        let start = Instant::now();
        self.bvh.any_hits_with(rays, hits, &mut ());
        start.elapsed().as_secs_f64()
    }

    fn hits_triangle(&self, ray: &Ray, corners: [[f32; 3]; 3]) -> Option<bool> {
        Some(segment_hits_triangle(ray, corners))
    }

    fn counts(&self, ray: &Ray, winding: i32) -> Option<bool> {
        Some(winding_number(ray, triangles(self.mesh)) == winding)
    }

    fn agrees_with_brute_force(&self, ray: &Ray) -> Option<bool> {
        let truth = brute::closest_hit(&self.mesh.positions, &self.mesh.triangles, ray);
        let agrees = |bvh: &Bvh| bvh.closest_hit(ray) == truth && bvh.any_hit(ray) == truth.is_some();
        Some(agrees(&self.bvh) && agrees(&self.scalar))
    }
}

/// The test of Moeller and Trumbore (1997) in `f32`, in a loop over all triangles: what a plain ray caster errs by, without
/// the errors of a hierarchy. Two-sided, ends open and edges closed as in Umbrage, and without the customary epsilon on the
/// determinant, which would lose small triangles.
pub struct MoellerTrumbore<'a> {
    pub mesh: &'a TriangleMesh,
}

fn moeller_trumbore(ray: &Ray, corners: [[f32; 3]; 3]) -> bool {
    let [a, b, c] = corners.map(Vec3::from);
    let (e1, e2) = (b - a, c - a);
    let p = ray.direction.cross(e2);
    let determinant = e1.dot(p);
    if determinant == 0.0 {
        return false;
    }
    let inverse = 1.0 / determinant;
    let s = ray.origin - a;
    let u = s.dot(p) * inverse;
    let q = s.cross(e1);
    let v = ray.direction.dot(q) * inverse;
    let t = e2.dot(q) * inverse;
    u >= 0.0 && v >= 0.0 && u + v <= 1.0 && t > ray.tnear && t < ray.tfar
}

impl Caster for MoellerTrumbore<'_> {
    fn name(&self) -> &'static str {
        "moeller-trumbore"
    }

    fn build_s(&self) -> f64 {
        0.0
    }

    fn bytes(&self) -> usize {
        0
    }

    fn any_hits(&self, rays: &[Ray], hits: &mut [bool]) -> f64 {
        let start = Instant::now();
        for (ray, hit) in rays.iter().zip(hits) {
            *hit = triangles(self.mesh).any(|corners| moeller_trumbore(ray, corners));
        }
        start.elapsed().as_secs_f64()
    }

    fn hits_triangle(&self, ray: &Ray, corners: [[f32; 3]; 3]) -> Option<bool> {
        Some(moeller_trumbore(ray, corners))
    }

    fn counts(&self, ray: &Ray, winding: i32) -> Option<bool> {
        let hits = triangles(self.mesh).filter(|&corners| moeller_trumbore(ray, corners)).count();
        Some(hits % 2 == winding.rem_euclid(2) as usize)
    }

    fn agrees_with_brute_force(&self, _: &Ray) -> Option<bool> {
        None
    }
}

/// One method of a peer, called in the first way it offers: for Embree ray by ray, high quality, incoherent.
pub struct Other<'a> {
    pub peer: &'a dyn Peer,
    pub method: &'static str,
    build_s: f64,
    bytes: usize,
}

impl<'a> Other<'a> {
    /// Each method of `peer` once.
    pub fn all(peer: &'a dyn Peer) -> Vec<Self> {
        let mut all: Vec<Self> = Vec::new();
        for entry in peer.any_hit(&[]) {
            let (method, build_s, bytes) = (entry.method(), entry.build_s(), entry.bytes());
            if all.iter().all(|other| other.method != method) {
                all.push(Self { peer, method, build_s, bytes });
            }
        }
        all
    }
}

impl Caster for Other<'_> {
    fn name(&self) -> &'static str {
        self.method
    }

    fn build_s(&self) -> f64 {
        self.build_s
    }

    fn bytes(&self) -> usize {
        self.bytes
    }

    fn any_hits(&self, rays: &[Ray], hits: &mut [bool]) -> f64 {
        let mut entries = self.peer.any_hit(rays).into_iter();
        let mut entry = entries.find(|entry| entry.method() == self.method).expect("offered before");
        entry.prepare();
        let start = Instant::now();
        entry.run(None);
        let seconds = start.elapsed().as_secs_f64();
        hits.copy_from_slice(&entry.answers());
        seconds
    }

    fn hits_triangle(&self, _: &Ray, _: [[f32; 3]; 3]) -> Option<bool> {
        None
    }

    fn counts(&self, _: &Ray, _: i32) -> Option<bool> {
        None
    }

    fn agrees_with_brute_force(&self, _: &Ray) -> Option<bool> {
        None
    }
}

fn triangles(mesh: &TriangleMesh) -> impl Iterator<Item = [[f32; 3]; 3]> + '_ {
    (0..mesh.triangles.len()).map(|i| mesh.triangle(i))
}
