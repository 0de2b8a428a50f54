//! A surface at one rate a patch, chosen once for all rays, such as by the camera of a picture.

use crate::{
    EyeRates, Surface, SurfaceError, SurfaceHit,
    mesh::cells::Cells,
    mesh::dice::{GridKey, Stitch},
    mesh::grid::GridRay,
    surface::LimitPoint,
};
use std::{collections::HashMap, ops::ControlFlow, sync::Arc};
use umbrage_accel::{BoxBvh, BoxFanVisitor, BoxVisitor, BuildQuality, FAN};
use umbrage_geom::{
    MeshObject, Progress, Ray, TriangleHit, TriangleMesh,
    glam::{Affine3A, Vec3},
    kernel::fan::FanRays,
};

/// Fewest rays of one origin that walk together.
const MIN_FAN_RAYS: usize = 3;

/// Boxes up to which the hierarchy is built with care.
const MAX_HIGH_QUALITY_BOXES: usize = 1 << 15;

/// Where a ray meets a [`RatedSurface`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RatedHit {
    /// The hit.
    pub hit: SurfaceHit,
    /// Triangle of the patch: two for each cell, cells row by row.
    pub triangle: u32,
}

/// A surface whose patches have one rate each, the same for all rays: one watertight mesh.
///
/// Against [`crate::SurfaceTracer`], which chooses rates by each ray's footprint and makes what rays reach, all is made at the
/// start, nothing has to be decided along a ray, and a micropolygon takes some 15 bytes. Rates by a camera suit pictures;
/// occluders far from it may be coarser than a ray that starts beside them would ask for.
pub struct RatedSurface {
    surface: Arc<Surface>,
    bvh: BoxBvh,
    levels: Vec<[u8; 2]>,
    cells: Cells,
}

impl RatedSurface {
    /// Each patch divided into `2^levels` cells along `u` and `v`, raised to what quadrilaterals beside other faces need.
    /// `progress` gets growing fractions that end at exactly 1, and returns `false` to cancel.
    ///
    /// # Errors
    /// [`SurfaceError::Option`] for a level beyond [`crate::MAX_LEVEL`]; [`SurfaceError::Mesh`] for more vertices than indices;
    /// [`SurfaceError::Build`], [`SurfaceError::Cancelled`].
    pub fn build(
        surface: Arc<Surface>,
        levels_of: impl Fn(u32) -> [u8; 2],
        progress: &mut (dyn FnMut(f32) -> bool + Send),
    ) -> Result<Self, SurfaceError> {
        let levels = surface.checked_levels(levels_of)?;
        let progress = Progress::new(surface.patch_count() as u64, progress);
        let mut cells = Cells::new(&levels);
        let mut boxes = Vec::new();
        let (mut positions, mut parameters) = (Vec::new(), Vec::new());
        for patch in 0..surface.patch_count() as u32 {
            let key = key(&surface, &levels, patch);
            let counts = key.levels.map(|l| (1usize << l) + 1);
            positions.resize(counts[0] * counts[1], Vec3::ZERO);
            parameters.resize(positions.len(), [0.0; 2]);
            surface.place_vertices(&key, counts, &mut positions, &mut parameters);
            cells.push(&positions, !key.stitch.is_none(), &mut boxes);
            progress.advance(1)?;
        }
        let quality =
            if boxes.len() <= MAX_HIGH_QUALITY_BOXES { BuildQuality::High } else { BuildQuality::Fast };
        let bvh = BoxBvh::build(&boxes, quality)?;
        progress.finish()?;
        Ok(Self { bvh, cells, levels, surface })
    }

    /// Rates by a camera: of lines along the edges and in the middle of each patch, the one that needs most counts. Edges are
    /// between 0.7 and 1.4 times as long as `rates` say where patches are evenly parametrized.
    ///
    /// # Errors
    /// As [`Self::build`]; [`SurfaceError::Option`] if the width is not positive, the eye not finite, the level beyond
    /// [`crate::MAX_LEVEL`] or the turn negative or not finite.
    pub fn for_eye(
        surface: Arc<Surface>,
        rates: &EyeRates,
        progress: &mut (dyn FnMut(f32) -> bool + Send),
    ) -> Result<Self, SurfaceError> {
        Self::for_eye_on(surface, &[Affine3A::IDENTITY], rates, progress)
    }

    /// [`Self::for_eye`] for a surface that stands in the eye's world at several places: each patch gets the finest rate that
    /// any of them needs. Without places, rates are the coarsest.
    ///
    /// # Errors
    /// As [`Self::for_eye`].
    pub fn for_eye_on(
        surface: Arc<Surface>,
        world_from_object: &[Affine3A],
        rates: &EyeRates,
        progress: &mut (dyn FnMut(f32) -> bool + Send),
    ) -> Result<Self, SurfaceError> {
        rates.validate()?;
        let patches = Arc::clone(&surface);
        Self::build(surface, |patch| patches.levels_for_eye(patch, world_from_object, rates), progress)
    }

    /// The surface.
    pub fn surface(&self) -> &Surface {
        &self.surface
    }

    /// Rates of a patch.
    ///
    /// # Panics
    /// If `patch` is out of range.
    pub fn levels(&self, patch: u32) -> [u8; 2] {
        self.levels[patch as usize]
    }

    /// Number of micropolygons.
    pub fn micropolygons(&self) -> u64 {
        self.levels.iter().map(|l| 1 << (l[0] + l[1])).sum()
    }

    /// Bytes of micropolygons and their hierarchy, the surface left out.
    pub fn bytes(&self) -> usize {
        size_of_val(&self.levels[..]) + self.bvh.bytes() + self.cells.bytes()
    }

    /// Whether the open segment meets the mesh, by `geom`'s exact predicate. Rays that are not [valid](Ray::is_valid) miss.
    pub fn any_hit(&self, ray: &Ray) -> bool {
        let Some(grid_ray) = GridRay::new(ray) else { return false };
        let mut visitor = Visitor::<true> { surface: self, ray: grid_ray, closest: None };
        self.bvh.walk_unsorted(ray, &mut visitor).is_break()
    }

    /// [`Self::any_hit`] of each ray; fastest for rays in a row that share their origin.
    ///
    /// # Panics
    /// If there are not as many `hits` as `rays`.
    pub fn any_hits(&self, rays: &[Ray], hits: &mut [bool]) {
        assert_eq!(rays.len(), hits.len(), "one answer a ray");
        let mut start = 0;
        while let Some(first) = rays.get(start) {
            let bits = |ray: &Ray, axis: usize| ray.origin[axis].to_bits() ^ first.origin[axis].to_bits();
            let same = |ray: &&Ray| bits(ray, 0) | bits(ray, 1) | bits(ray, 2) == 0;
            let end = start + rays[start..].iter().take(FAN).take_while(same).count();
            let (fan, answers) = (&rays[start..end], &mut hits[start..end]);
            let mut answered = 0;
            if fan.len() >= MIN_FAN_RAYS {
                let mut visitor =
                    FanVisitor { surface: self, rays: fan, origin: first.origin.to_array(), hits: 0 };
                answered = self.bvh.walk_fan(fan, &mut visitor);
                for (r, hit) in answers.iter_mut().enumerate() {
                    *hit = visitor.hits >> r & 1 == 1;
                }
            }
            for r in (0..fan.len()).filter(|r| answered >> r & 1 == 0) {
                answers[r] = self.any_hit(&fan[r]);
            }
            start = end;
        }
    }

    /// The hit with the smallest `t`; ties go to the first patch.
    pub fn closest_hit(&self, ray: &Ray) -> Option<RatedHit> {
        let mut visitor = Visitor::<false> { surface: self, ray: GridRay::new(ray)?, closest: None };
        let _ = self.bvh.walk_with(ray, &mut visitor);
        let (patch, hit, triangle) = visitor.closest?;
        let (u, v) = self.parameters(patch, triangle, hit.u, hit.v);
        let levels = self.levels[patch as usize];
        Some(RatedHit { hit: SurfaceHit { t: hit.t, patch, u, v, levels, front: hit.front }, triangle })
    }

    /// The triangle that was hit.
    pub fn corners(&self, hit: &RatedHit) -> [[f32; 3]; 3] {
        self.cells.corners(self.cells.patch(hit.hit.patch), hit.triangle)
    }

    /// The limit surface at a hit.
    pub fn limit(&self, hit: &RatedHit) -> LimitPoint {
        self.surface.limit(hit.hit.patch, hit.hit.u, hit.hit.v)
    }

    /// All micropolygons as one mesh with the limit surface's normals and texture coordinates: vertices of the same bits are
    /// one, and cells that stitching collapsed are left out. Triangles of a face of the control mesh are together, in its
    /// order, and objects are those of its faces.
    pub fn to_mesh(&self) -> TriangleMesh {
        let mut mesh = TriangleMesh::default();
        let mut known: HashMap<[u32; 3], u32> = HashMap::new();
        let has_uvs = self.surface.uv(0, 0.0, 0.0).is_some();
        let mut objects = self.surface.objects.iter().peekable();
        for patch in 0..self.levels.len() as u32 {
            let (cells, key) = (self.cells.patch(patch), key(&self.surface, &self.levels, patch));
            let (face, start) = (self.surface.face_of(patch).0, mesh.triangles.len() as u32);
            while let Some(next) = objects.next_if(|o| o.faces.start <= face) {
                mesh.objects.push(MeshObject {
                    name: next.name.clone(),
                    triangles: start..start,
                    opacity: 1.0,
                });
            }
            let columns = (1usize << key.levels[0]) + 1;
            let rows = (1usize << key.levels[1]) + 1;
            let mut indices = Vec::with_capacity(columns * rows);
            let mut normals = Vec::with_capacity(columns * rows);
            let mut uvs = Vec::new();
            for v in 0..columns * rows {
                // Adding 0 makes one of both zeros.
                let position = self.cells.vertex(cells, v).map(|x| x + 0.0);
                indices.push(*known.entry(position.map(f32::to_bits)).or_insert_with(|| {
                    mesh.positions.push(position);
                    mesh.positions.len() as u32 - 1
                }));
                let [s, t] = key.moved([v % columns, v / columns]);
                normals.push(self.surface.limit(patch, s, t).normal.to_array());
                uvs.extend(self.surface.uv(patch, s, t).map(|uv| uv.to_array()));
            }
            for triangle in 0..2 << (key.levels[0] + key.levels[1]) {
                let corners = cells.triangle(triangle);
                let [a, b, c] = corners.map(|v| indices[v]);
                if a == b || b == c || c == a {
                    continue;
                }
                mesh.triangles.push([a, b, c]);
                mesh.corner_normals.push(corners.map(|v| normals[v]));
                if has_uvs {
                    mesh.corner_uvs.push(corners.map(|v| uvs[v]));
                }
            }
        }
        let end = mesh.triangles.len() as u32;
        // Those of no face at the end.
        mesh.objects.extend(objects.map(|o| MeshObject {
            name: o.name.clone(),
            triangles: end..end,
            opacity: 1.0,
        }));
        let ends = mesh.objects.iter().skip(1).map(|o| o.triangles.start).chain([end]).collect::<Vec<_>>();
        mesh.objects.iter_mut().zip(ends).for_each(|(object, end)| object.triangles.end = end);
        mesh
    }

    /// Parameters at barycentric weights of the second and third corner of a triangle.
    fn parameters(&self, patch: u32, triangle: u32, second: f32, third: f32) -> (f32, f32) {
        let key = key(&self.surface, &self.levels, patch);
        let columns = (1usize << key.levels[0]) + 1;
        let [a, b, c] =
            self.cells.patch(patch).triangle(triangle).map(|v| key.moved([v % columns, v / columns]));
        let mix = |k: usize| a[k] * (1.0 - second - third) + b[k] * second + c[k] * third;
        (mix(0).clamp(0.0, 1.0), mix(1).clamp(0.0, 1.0))
    }
}

/// The whole patch, its borders as coarse as its neighbours'.
fn key(surface: &Surface, levels: &[[u8; 2]], patch: u32) -> GridKey {
    let mut stitch = Stitch::default();
    for edge in 0..4 {
        stitch = stitch.with(edge, surface.static_shifts(patch as usize, edge, levels));
    }
    GridKey { patch, depth: 0, levels: levels[patch as usize], place: [0, 0], stitch }
}

/// Looks for hits node by node.
struct Visitor<'a, const ANY: bool> {
    surface: &'a RatedSurface,
    ray: GridRay,
    /// Patch, hit, triangle.
    closest: Option<(u32, TriangleHit, u32)>,
}

impl<const ANY: bool> BoxVisitor for Visitor<'_, ANY> {
    #[inline(always)]
    fn visit(&mut self, node: u32) -> ControlFlow<(), f32> {
        let cells = &self.surface.cells;
        let mut found = None;
        if cells.trace::<ANY>(node, &mut self.ray, &mut found) && ANY {
            return ControlFlow::Break(());
        }
        if let Some((hit, triangle)) = found {
            let patch = cells.patch_of(node);
            let nearer = match &self.closest {
                Some((old_patch, old, old_triangle)) => {
                    hit.t < old.t || (hit.t == old.t && (patch, triangle) < (*old_patch, *old_triangle))
                }
                None => true,
            };
            if nearer {
                self.closest = Some((patch, hit, triangle));
            }
        }
        ControlFlow::Continue(match &self.closest {
            Some((_, hit, _)) => hit.t,
            None => self.ray.ray.tfar,
        })
    }
}

/// Looks for any hits of rays of one origin.
struct FanVisitor<'a> {
    surface: &'a RatedSurface,
    rays: &'a [Ray],
    origin: [f32; 3],
    /// A bit each.
    hits: u32,
}

impl BoxFanVisitor for FanVisitor<'_> {
    #[inline(always)]
    fn visit(&mut self, node: u32, rays: u32, fan: &FanRays<FAN>) -> u32 {
        let hits = self.surface.cells.trace_fan(node, rays, fan, self.origin, self.rays);
        self.hits |= hits;
        hits
    }
}
