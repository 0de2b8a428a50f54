//! A surface at one rate a patch, chosen once for all rays, such as by the camera of a picture.

use crate::{
    Surface, SurfaceError, SurfaceHit,
    dice::{GridKey, Stitch},
    grid::GridRay,
    length::{MAX_LEVEL, cell},
    patch_mesh::{Avx2, PatchMesh},
    surface::{LimitPoint, SIZE},
};
use std::{
    ops::ControlFlow,
    sync::{
        Arc, OnceLock,
        atomic::{AtomicU64, AtomicUsize, Ordering::Relaxed},
    },
};
use umbrage_accel::{BoxBvh, BoxVisitor, BuildQuality};
use umbrage_geom::{Aabb, Ray, TriangleHit, glam::Vec3};

/// Segments of an edge or middle line by which its length is measured.
const SEGMENTS: u32 = 4;

/// Where a ray meets a [`RatedSurface`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RatedHit {
    /// The hit.
    pub hit: SurfaceHit,
    /// Triangle of the patch: two for each cell, cells row by row.
    pub triangle: u32,
}

/// A surface whose patches have one rate each, the same for all rays: one watertight mesh, of which only the patches are made
/// whose boxes some ray enters.
///
/// Against [`crate::SurfaceTracer`], which chooses rates by each ray's footprint, nothing has to be decided along a ray, and
/// nothing is kept but vertices and small boxes. Rates by a camera suit pictures; occluders far from it may be coarser
/// than a ray that starts beside them would ask for.
pub struct RatedSurface {
    surface: Arc<Surface>,
    bvh: BoxBvh,
    levels: Vec<[u8; 2]>,
    meshes: Vec<OnceLock<Box<PatchMesh>>>,
    avx2: Option<Avx2>,
    micropolygons: AtomicU64,
    mesh_bytes: AtomicUsize,
}

impl RatedSurface {
    /// Each patch divided into `2^levels` cells along `u` and `v`, raised to what quadrilaterals beside other faces need.
    ///
    /// # Errors
    /// [`SurfaceError::Option`] for a level beyond [`MAX_LEVEL`]; [`SurfaceError::Build`].
    pub fn new(surface: Arc<Surface>, levels_of: impl Fn(u32) -> [u8; 2]) -> Result<Self, SurfaceError> {
        let levels: Vec<[u8; 2]> = (0..surface.patch_count() as u32)
            .map(|i| levels_of(i).map(|l| l.max(surface.least_level(i))))
            .collect();
        if let Some(&level) = levels.as_flattened().iter().find(|&&l| l > MAX_LEVEL) {
            let value = level.into();
            return Err(SurfaceError::Option { name: "level", value, expected: "0 to 12" });
        }
        let boxes: Vec<Aabb> = surface.patches.iter().map(|p| p.bounds).collect();
        Ok(Self {
            bvh: BoxBvh::build(&boxes, BuildQuality::High)?,
            meshes: levels.iter().map(|_| OnceLock::new()).collect(),
            levels,
            surface,
            avx2: Avx2::detect(),
            micropolygons: 0.into(),
            mesh_bytes: 0.into(),
        })
    }

    /// Rates by a camera at `eye`, for which `width` is the size of a micropolygon at distance 1: their edges are about that
    /// long (between 0.7 and 1.4 times as long where patches are evenly parametrized), measured along the edges and middle
    /// lines of each patch. At most `max_level` halvings, also where the eye is on the surface.
    ///
    /// # Errors
    /// As [`Self::new`]; [`SurfaceError::Option`] if the width is not positive or the eye not finite.
    pub fn for_eye(
        surface: Arc<Surface>,
        eye: Vec3,
        width: f32,
        max_level: u8,
    ) -> Result<Self, SurfaceError> {
        if !(width > 0.0 && width.is_finite() && eye.is_finite()) {
            let value = width.into();
            return Err(SurfaceError::Option { name: "width", value, expected: "a positive number" });
        }
        let rates = Arc::clone(&surface);
        Self::new(surface, |patch| rates.levels_for_eye(patch, eye, f64::from(width), max_level))
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

    /// Patches and micropolygons made so far.
    pub fn counts(&self) -> (usize, u64) {
        let made = self.meshes.iter().filter(|mesh| mesh.get().is_some()).count();
        (made, self.micropolygons.load(Relaxed))
    }

    /// Bytes of the hierarchy and of what was made so far, the surface left out.
    pub fn bytes(&self) -> usize {
        size_of_val(&self.levels[..])
            + size_of_val(&self.meshes[..])
            + self.bvh.bytes()
            + self.mesh_bytes.load(Relaxed)
    }

    /// Whether the open segment meets the mesh, by `geom`'s exact predicate. Rays that are not [valid](Ray::is_valid) miss.
    pub fn any_hit(&self, ray: &Ray) -> bool {
        let Some(grid_ray) = GridRay::new(ray) else { return false };
        let mut visitor = Visitor::<true> { surface: self, ray: grid_ray, closest: None };
        self.bvh.walk_with(ray, &mut visitor).is_break()
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
        self.mesh(hit.hit.patch).corners(hit.triangle)
    }

    /// The limit surface at a hit.
    pub fn limit(&self, hit: &RatedHit) -> LimitPoint {
        self.surface.limit(hit.hit.patch, hit.hit.u, hit.hit.v)
    }

    fn key(&self, patch: u32) -> GridKey {
        let levels = self.levels[patch as usize];
        let mut stitch = Stitch::default();
        for edge in 0..4 {
            stitch = stitch.with(edge, self.surface.static_shifts(patch as usize, edge, &self.levels));
        }
        GridKey { patch, depth: 0, levels, place: [0, 0], stitch }
    }

    #[inline]
    fn mesh(&self, patch: u32) -> &PatchMesh {
        match self.meshes[patch as usize].get() {
            Some(mesh) => mesh,
            None => self.make(patch),
        }
    }

    /// Threads may make the same patch; one of the meshes, which are equal, is kept.
    #[cold]
    fn make(&self, patch: u32) -> &PatchMesh {
        self.meshes[patch as usize].get_or_init(|| {
            let key = self.key(patch);
            let counts = key.levels.map(|l| (1usize << l) + 1);
            let mut positions = vec![Vec3::ZERO; counts[0] * counts[1]];
            let mut parameters = vec![[0.0; 2]; positions.len()];
            self.surface.place_vertices(&key, counts, &mut positions, &mut parameters);
            let mesh = Box::new(PatchMesh::new(key.levels, &positions, !key.stitch.is_none()));
            self.micropolygons.fetch_add(mesh.cells(), Relaxed);
            self.mesh_bytes.fetch_add(mesh.bytes(), Relaxed);
            mesh
        })
    }

    /// Parameters at barycentric weights of the second and third corner of a triangle.
    fn parameters(&self, patch: u32, triangle: u32, second: f32, third: f32) -> (f32, f32) {
        let mesh = self.mesh(patch);
        let key = self.key(patch);
        let columns = (1usize << mesh.levels()[0]) + 1;
        let [a, b, c] = mesh.triangle(triangle).map(|v| key.moved([v % columns, v / columns]));
        let mix = |k: usize| a[k] * (1.0 - second - third) + b[k] * second + c[k] * third;
        (mix(0).clamp(0.0, 1.0), mix(1).clamp(0.0, 1.0))
    }
}

/// Looks for hits patch by patch.
struct Visitor<'a, const ANY: bool> {
    surface: &'a RatedSurface,
    ray: GridRay,
    /// Patch, hit, triangle.
    closest: Option<(u32, TriangleHit, u32)>,
}

impl<const ANY: bool> BoxVisitor for Visitor<'_, ANY> {
    #[inline(always)]
    fn visit(&mut self, patch: u32) -> ControlFlow<(), f32> {
        let mesh = self.surface.mesh(patch);
        let mut found = None;
        if mesh.trace::<ANY>(&mut self.ray, &mut found, self.surface.avx2) && ANY {
            return ControlFlow::Break(());
        }
        if let Some((hit, triangle)) = found {
            let nearer = match &self.closest {
                Some((old_patch, old, _)) => hit.t < old.t || (hit.t == old.t && patch < *old_patch),
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

impl Surface {
    /// Levels at which the edges of micropolygons are about as long as `width` times their distance from `eye`.
    fn levels_for_eye(&self, patch: u32, eye: Vec3, width: f64, max_level: u8) -> [u8; 2] {
        let least = self.least_level(patch);
        let mut levels = [least; 2];
        for axis in 0..2 {
            // Edges and the line between them, `axis` along it.
            for line in 0..3 {
                let point = |i: u32| {
                    let s = i * (SIZE / SEGMENTS);
                    match line {
                        0 => self.edge_position(patch, axis, s),
                        1 => self.edge_position(patch, axis + 2, SIZE - s),
                        _ => {
                            let (u, v) = if axis == 0 { (s, SIZE / 2) } else { (SIZE / 2, s) };
                            self.patches[patch as usize].root.position(u, v, SIZE, &self.context)
                        }
                    }
                };
                let mut before = point(0).as_dvec3();
                let (mut longest, mut nearest) = (0f64, before.distance(eye.as_dvec3()));
                for i in 1..=SEGMENTS {
                    let next = point(i).as_dvec3();
                    longest = longest.max(next.distance(before));
                    nearest = nearest.min(next.distance(eye.as_dvec3()));
                    before = next;
                }
                let length = longest * f64::from(SEGMENTS) * std::f64::consts::FRAC_1_SQRT_2;
                let most = max_level.max(least);
                let fits = |&l: &u8| length * cell(l) <= nearest * width;
                levels[axis] = levels[axis].max((least..most).find(fits).unwrap_or(most));
            }
        }
        levels
    }
}
