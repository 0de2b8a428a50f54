//! What blocks the rays of a bake.

use super::{BakeError, Sides};
use crate::{
    far::{FarCones, FarOpacity},
    query::engine::prefilter::AO_THRESHOLD,
};
use umbrage_accel::{BuildOptions, Bvh};
use umbrage_aomask::{MaskOptions, Pattern, PatternOptions};
use umbrage_geom::{
    Aabb, MeshError, OpticalDepth, Ray, TriangleMesh, intersect_triangle,
    mesh::{MAX_COORDINATE, MAX_ELEMENTS},
};
use umbrage_occlusion::prefilter::{ConeRay, PrefilterOptions, Prefiltered, Query};

/// An opaque ground under everything.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Ground {
    /// None.
    #[default]
    Absent,
    /// A square below the lowest y, facing up, with sides of 2000 diagonals.
    ///
    /// It lies 1e-4 of the diagonal (or 1e-5 of the largest coordinate, if that is more) below the lowest vertex, so that
    /// surfaces that rest on it are occluded rather than under it. It counts neither for the diagonal nor for the bounds.
    Below,
}

/// Occluders of a bake: triangles in a BVH, with the optical depth of each.
pub struct Occluders {
    bvh: Bvh,
    mesh: TriangleMesh,
    /// Depth of a crossing of each triangle; empty if all are opaque.
    depths: Vec<OpticalDepth>,
    bounds: Aabb,
    /// What answers instead of exact rays, if asked for.
    prefiltered: Option<(Prefiltered, Query)>,
    /// What answers beyond exact masks, if asked for.
    far: Option<FarOpacity>,
}

/// Buffers of [`Occluders::light`].
#[derive(Default)]
pub(super) struct Answers {
    blocked: Vec<bool>,
    cones: Vec<ConeRay>,
    passed: Vec<f32>,
}

impl Occluders {
    /// Puts `meshes` (world space; usually the baked mesh first, then others that only occlude) and the ground into a BVH.
    /// Objects block by their [`opacity`](umbrage_geom::MeshObject::opacity).
    ///
    /// # Errors
    /// [`BakeError::NoOccluder`], [`BakeError::Mesh`], [`BakeError::Build`].
    pub fn build(meshes: &[&TriangleMesh], ground: Ground) -> Result<Self, BakeError> {
        if meshes.is_empty() {
            return Err(BakeError::NoOccluder);
        }
        let mut mesh = TriangleMesh::default();
        let mut depths = Vec::new();
        for (index, part) in meshes.iter().enumerate() {
            part.validate().map_err(|source| BakeError::Mesh { index, source })?;
            // Indices are 32-bit: several meshes may be too much where each one is not. The ground takes 4 vertices.
            let vertices = mesh.positions.len() + part.positions.len() + 4;
            let triangles = mesh.triangles.len() + part.triangles.len() + 2;
            for (what, count) in [("vertices", vertices), ("triangles", triangles)] {
                if count > MAX_ELEMENTS {
                    let source = MeshError::TooMany { what, count };
                    return Err(BakeError::Mesh { index, source });
                }
            }
            let base = mesh.positions.len() as u32;
            mesh.positions.extend_from_slice(&part.positions);
            mesh.triangles.extend(part.triangles.iter().map(|t| t.map(|v| v + base)));
            for object in part.objects_or_whole() {
                let depth = OpticalDepth::from_opacity(object.opacity);
                depths.extend(std::iter::repeat_n(depth, object.triangles.len()));
            }
        }
        let bounds = mesh.bounds();
        if ground == Ground::Below {
            add_ground(&mut mesh, &bounds);
            depths.resize(mesh.triangles.len(), OpticalDepth::OPAQUE);
        }
        if depths.iter().all(|d| d.is_opaque()) {
            depths = Vec::new();
        }
        let bvh = Bvh::build(&mesh.positions, &mesh.triangles, &BuildOptions::default())?;
        Ok(Self { bvh, mesh, depths, bounds, prefiltered: None, far: None })
    }

    /// Prefilters the occluders: faster for loose geometry, and approximate.
    ///
    /// # Errors
    /// [`BakeError::Prefilter`].
    pub fn prefiltered(mut self) -> Result<Self, BakeError> {
        let opacities: Vec<f32> = match &self.depths[..] {
            [] => vec![1.0],
            depths => depths.iter().map(|depth| 1.0 - depth.transmittance()).collect(),
        };
        let (positions, triangles) = (&self.mesh.positions, &self.mesh.triangles);
        let options = PrefilterOptions::default();
        let scene = Prefiltered::build(positions, triangles, &opacities, &options, &mut |_| true)?;
        self.prefiltered = Some((scene, Query::new(AO_THRESHOLD)?));
        Ok(self)
    }

    /// Stores the occluders' opacity for [`super::MaskMethod::Prefilter`]. `progress` gets growing fractions that end at exactly
    /// 1, from any thread, and returns `false` to cancel.
    ///
    /// # Errors
    /// [`BakeError::SemiTransparent`]; [`BakeError::Mask`]; [`BakeError::Cancelled`].
    pub fn with_far_opacity(
        mut self,
        progress: &mut (dyn FnMut(f32) -> bool + Send),
    ) -> Result<Self, BakeError> {
        if !self.is_opaque() {
            return Err(BakeError::SemiTransparent);
        }
        self.far = Some(FarOpacity::build(&self.mesh, progress)?);
        Ok(self)
    }

    /// Whether exact rays are not used.
    pub fn is_prefiltered(&self) -> bool {
        self.prefiltered.is_some()
    }

    /// What lies beyond exact masks of `pattern`, which has `options`; `None` if stored opacity is of no use.
    pub(super) fn far(
        &self,
        pattern: &Pattern,
        options: &PatternOptions,
        masks: &MaskOptions,
    ) -> Result<Option<FarCones<'_>>, BakeError> {
        let far = self.far.as_ref().ok_or(BakeError::NoFarOpacity)?;
        let near = far.near(&self.bvh, pattern, options, masks)?;
        Ok(near.map(|near| far.cones(pattern.len(), near, masks.radius)).transpose()?)
    }

    /// Bounds of the meshes, without the ground.
    pub fn bounds(&self) -> Aabb {
        self.bounds
    }

    /// Diagonal of [`Self::bounds`], what a radius given as a fraction refers to.
    pub fn diagonal(&self) -> f32 {
        self.bounds.diagonal()
    }

    /// Whether every triangle blocks all light.
    pub fn is_opaque(&self) -> bool {
        self.depths.is_empty()
    }

    pub(super) fn bvh(&self) -> &Bvh {
        &self.bvh
    }

    /// Sum over `rays` of the fraction of light that passes. Each stands for a solid angle of `angles`.
    pub(super) fn light(&self, rays: &[Ray], angles: &[f32], sides: Sides, answers: &mut Answers) -> f64 {
        let Answers { blocked, cones, passed } = answers;
        if let Some((scene, query)) = &self.prefiltered {
            cones.clear();
            cones.extend(rays.iter().zip(angles).map(|(&ray, &solid_angle)| ConeRay { ray, solid_angle }));
            passed.clear();
            passed.resize(rays.len(), 1.0);
            scene.transmittances_with(cones, query, passed, &mut ());
            return passed.iter().map(|&x| f64::from(x)).sum();
        }
        blocked.clear();
        blocked.resize(rays.len(), false);
        if self.depths.is_empty() && sides == Sides::Both {
            self.bvh.any_hits_with(rays, blocked, &mut ());
            return blocked.iter().filter(|&&b| !b).count() as f64;
        }
        if sides == Sides::FrontFirst {
            let blocked = |ray: &&Ray| self.bvh.closest_hit(ray).is_some_and(|hit| hit.front);
            return (rays.len() - rays.iter().filter(blocked).count()) as f64;
        }
        rays.iter()
            .map(|ray| self.bvh.transmittance(ray, |prim| self.depth(prim, ray, sides)))
            .map(|depth| f64::from(depth.transmittance()))
            .sum()
    }

    /// Depth of triangle `prim`, which `ray` hits.
    fn depth(&self, prim: u32, ray: &Ray, sides: Sides) -> OpticalDepth {
        let prim = prim as usize;
        if sides == Sides::Front
            && !intersect_triangle(ray, self.mesh.triangle(prim)).is_some_and(|hit| hit.front)
        {
            return OpticalDepth::CLEAR;
        }
        self.depth_of(prim as u32)
    }

    /// Depth of a crossing of triangle `prim`.
    pub(super) fn depth_of(&self, prim: u32) -> OpticalDepth {
        self.depths.get(prim as usize).copied().unwrap_or(OpticalDepth::OPAQUE)
    }
}

fn add_ground(mesh: &mut TriangleMesh, bounds: &Aabb) {
    let diagonal = bounds.diagonal();
    let largest = bounds.min.abs().max(bounds.max.abs()).max_element();
    let y = bounds.min.y - (1e-4 * diagonal).max(1e-5 * largest);
    let (center, half) = (bounds.center(), 1e3 * diagonal);
    let limit = |x: f32| x.clamp(-MAX_COORDINATE, MAX_COORDINATE);
    let corner = |sx: f32, sz: f32| [limit(center.x + sx * half), limit(y), limit(center.z + sz * half)];
    let base = mesh.positions.len() as u32;
    mesh.positions.extend([corner(-1.0, -1.0), corner(-1.0, 1.0), corner(1.0, 1.0), corner(1.0, -1.0)]);
    mesh.triangles.extend([[base, base + 1, base + 2], [base, base + 2, base + 3]]);
}
