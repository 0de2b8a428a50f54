//! What blocks rays: a scene's triangles, instances and opacities, and every structure that is made of them.
//!
//! Here: which structure a scene gets, one flat BVH or two levels where instances save memory. Not here: structures that are made
//! when a method asks for them (`demand.rs`), what rays find (`hits.rs`), traversal (`umbrage-accel`).

mod demand;
mod hits;
mod surfaces;

pub use demand::{BuildCost, Structure};
pub(crate) use demand::{PrefilteredParts, solids};
pub use hits::ShadingPoint;
pub use surfaces::SurfaceWork;

use super::{QueryError, SceneKind, SurfaceMode, View, engine::Report, share_of};
use demand::StructuresOnDemand;
use std::sync::Arc;
use surfaces::Surfaces;
use umbrage_accel::{BuildOptions, Bvh, InstancedBvh, Placement};
use umbrage_geom::{
    Aabb, MeshError, OpticalDepth, Progress, TriangleMesh,
    glam::*,
    mesh::{MAX_COORDINATE, MAX_ELEMENTS},
};
use umbrage_scene::{Ground, Scene};

/// Up to so many triangles in all, repeated meshes are copied into one flat BVH, whose rays are faster.
const FLATTEN_TRIANGLES: usize = 2_000_000;

/// Triangles that block rays, ready for every method.
pub struct Occluders {
    hierarchy: Hierarchy,
    /// Subdivision surfaces that are traced as such.
    surfaces: Option<Surfaces>,
    parts: Vec<OccluderMesh>,
    placed: Vec<PlacedPart>,
    /// Albedo of each material.
    albedos: Vec<Vec3>,
    opaque: bool,
    bounds: Aabb,
    demand: StructuresOnDemand,
}

enum Hierarchy {
    /// There are no triangles.
    Absent,
    Flat(Arc<Bvh>),
    Instanced(InstancedBvh),
}

/// One mesh as the hierarchy holds it: a mesh of the scene, or all of them in world space.
struct OccluderMesh {
    mesh: TriangleMesh,
    /// Index of each triangle's object within the part.
    object_of: Vec<u32>,
}

struct PlacedPart {
    part: usize,
    world_from_object: Affine3A,
    normal_matrix: Mat3A,
    /// Material and optical depth of each object of the part.
    objects: Vec<(u32, OpticalDepth)>,
}

/// A triangle in the scene: index of the placed part and of the triangle in it.
type Address = (u32, u32);

impl Occluders {
    /// All instances of a scene. Meshes that are used more than once are copied into one mesh up to two million triangles in
    /// all, and kept apart beyond. `progress` gets growing fractions that end at exactly 1, and returns `false` to cancel
    /// before the next hierarchy is built.
    ///
    /// Where the scene's settings ask for surfaces `once` or by `footprint`, instances of control meshes are traced as subdivision
    /// surfaces; [`super::subdivide::refine`] leaves them as they are.
    ///
    /// # Errors
    /// [`QueryError::Build`] with the name of the mesh; [`QueryError::Surface`], [`QueryError::Unsupported`] for surfaces that can't
    /// be traced as such; [`QueryError::UnknownMethod`], [`QueryError::Cancelled`].
    pub fn of_scene(scene: &Scene, progress: Report<'_>) -> Result<Self, QueryError> {
        let mode = SurfaceMode::of_scene(scene)?;
        let split = Surfaces::split(scene, mode, &mut share_of(progress, 0, 2))?;
        match split {
            None => Self::of_triangles(scene, progress),
            Some((surfaces, rest)) => {
                let mut occluders = Self::of_triangles(&rest, &mut share_of(progress, 1, 2))?;
                occluders.bounds = occluders.bounds.union(surfaces.bounds());
                occluders.surfaces = Some(surfaces);
                Ok(occluders)
            }
        }
    }

    fn of_triangles(scene: &Scene, progress: Report<'_>) -> Result<Self, QueryError> {
        let demand = StructuresOnDemand::default();
        let (parts, placed, hierarchy);
        if scene.instances.is_empty() {
            (parts, placed, hierarchy) = (Vec::new(), Vec::new(), Hierarchy::Absent);
            Progress::new(0, progress).finish()?;
        } else if keeps_instances_apart(scene) {
            (parts, placed) = instanced_parts(scene);
            let progress = Progress::new(parts.len() as u64, progress);
            let build = |(part, mesh): (&OccluderMesh, &umbrage_scene::NamedMesh)| {
                progress.check()?;
                let bvh = Arc::new(build_bvh(&part.mesh, &mesh.name)?);
                progress.advance(1)?;
                Ok(bvh)
            };
            let top = demand.time(Structure::Bvh, || {
                let bvhs = parts.iter().zip(&scene.meshes).map(build).collect::<Result<_, QueryError>>()?;
                let top = build_top(bvhs, &placed)?;
                let bytes = top.bytes();
                Ok::<_, QueryError>((top, bytes))
            })?;
            hierarchy = Hierarchy::Instanced(top);
            progress.finish()?;
        } else {
            (parts, placed) = flat_part(scene);
            hierarchy = flat_hierarchy(&parts[0].mesh, &demand, progress)?;
        }
        let bounds = match &hierarchy {
            Hierarchy::Absent => Aabb::EMPTY,
            Hierarchy::Flat(bvh) => bvh.bounds(),
            Hierarchy::Instanced(bvh) => bvh.bounds(),
        };
        let opaque = is_opaque(&placed);
        let albedos = scene.materials.iter().map(|m| m.albedo.into()).collect();
        Ok(Self { hierarchy, surfaces: None, parts, placed, albedos, opaque, bounds, demand })
    }

    /// Meshes in world space (usually the baked mesh first, then others that only occlude) and the ground, as one mesh. Objects
    /// block by their [`opacity`](umbrage_geom::MeshObject::opacity). `progress` as in [`Self::of_scene`].
    ///
    /// The ground has sides of 2000 diagonals. It lies 1e-4 of the diagonal (or 1e-5 of the largest coordinate, if that is more)
    /// below the lowest vertex, so that surfaces that rest on it are occluded rather than under it. It counts neither for the diagonal
    /// nor for the bounds.
    ///
    /// # Errors
    /// [`QueryError::NoOccluder`], [`QueryError::Mesh`], [`QueryError::Build`], [`QueryError::Cancelled`].
    pub fn of_meshes(
        meshes: &[&TriangleMesh],
        ground: Ground,
        progress: Report<'_>,
    ) -> Result<Self, QueryError> {
        if meshes.is_empty() {
            return Err(QueryError::NoOccluder);
        }
        let mut part = OccluderMesh { mesh: TriangleMesh::default(), object_of: Vec::new() };
        let mut objects = Vec::new();
        for (index, mesh) in meshes.iter().enumerate() {
            let failed = |source| QueryError::Mesh { index, source };
            mesh.validate().map_err(failed)?;
            part.append(mesh, &mut objects).map_err(failed)?;
        }
        let bounds = part.mesh.bounds();
        if ground == Ground::Below {
            add_ground(&mut part.mesh, &bounds);
            part.object_of.resize(part.mesh.triangles.len(), objects.len() as u32);
            objects.push((0, OpticalDepth::OPAQUE));
        }
        let demand = StructuresOnDemand::default();
        let hierarchy = flat_hierarchy(&part.mesh, &demand, progress)?;
        let placed = vec![PlacedPart::in_place(objects)];
        let (opaque, albedos) = (is_opaque(&placed), vec![Vec3::splat(0.5)]);
        let parts = vec![part];
        Ok(Self { hierarchy, surfaces: None, parts, placed, albedos, opaque, bounds, demand })
    }

    /// World bounds, without a [`Ground`].
    pub fn bounds(&self) -> Aabb {
        self.bounds
    }

    /// Diagonal of [`Self::bounds`], what a radius given as a fraction refers to.
    pub fn diagonal(&self) -> f32 {
        self.bounds.diagonal()
    }

    /// Triangles of all instances together.
    pub fn triangle_count(&self) -> usize {
        self.placed.iter().map(|p| self.parts[p.part].mesh.triangles.len()).sum()
    }

    /// Bytes of the wide BVH, and of the triangles and attributes beside it.
    pub fn bytes(&self) -> (usize, usize) {
        let hierarchy = match &self.hierarchy {
            Hierarchy::Absent => 0,
            Hierarchy::Flat(bvh) => bvh.bytes(),
            Hierarchy::Instanced(bvh) => bvh.bytes(),
        };
        (hierarchy, self.parts.iter().map(|p| p.mesh.bytes() + 4 * p.object_of.len()).sum())
    }

    /// What decides which methods can answer, for receivers seen from `view`.
    pub fn kind(&self, view: View) -> SceneKind {
        let (instances_apart, surfaces) = (self.is_instanced(), self.surfaces.is_some());
        SceneKind { opaque: self.opaque, instances_apart, surfaces, view }
    }

    /// Whether there are subdivision surfaces that are traced as such.
    pub fn has_surfaces(&self) -> bool {
        self.surfaces.is_some()
    }

    /// What was made of subdivision surfaces so far, if they are traced as such.
    pub fn surface_work(&self) -> Option<SurfaceWork> {
        self.surfaces.as_ref().map(Surfaces::work)
    }

    /// Whether every triangle blocks all light.
    pub fn is_opaque(&self) -> bool {
        self.opaque
    }

    /// Whether instances are kept apart.
    pub fn is_instanced(&self) -> bool {
        matches!(self.hierarchy, Hierarchy::Instanced(_))
    }

    /// The two levels, if instances are kept apart.
    pub fn instances(&self) -> Option<&InstancedBvh> {
        match &self.hierarchy {
            Hierarchy::Absent | Hierarchy::Flat(_) => None,
            Hierarchy::Instanced(bvh) => Some(bvh),
        }
    }

    /// The hierarchy over all triangles, if they are one mesh.
    pub fn flat(&self) -> Option<&Bvh> {
        match &self.hierarchy {
            Hierarchy::Flat(bvh) => Some(bvh),
            Hierarchy::Absent | Hierarchy::Instanced(_) => None,
        }
    }

    /// Hierarchy and mesh, if all triangles are one mesh and opaque.
    pub(crate) fn flat_opaque(&self) -> Option<(&Arc<Bvh>, &TriangleMesh)> {
        match &self.hierarchy {
            Hierarchy::Flat(bvh) if self.opaque => Some((bvh, &self.parts[0].mesh)),
            _ => None,
        }
    }

    /// The meshes below the hierarchy, in the order of its own.
    pub(crate) fn meshes(&self) -> impl Iterator<Item = &TriangleMesh> {
        self.parts.iter().map(|part| &part.mesh)
    }
}

impl SceneKind {
    /// Of a scene, as [`Occluders::of_scene`] will hold it, seen by its camera.
    pub fn of_scene(scene: &Scene) -> Self {
        let depths = scene.instances.iter().flat_map(|instance| objects_of(scene, instance));
        Self {
            opaque: depths.into_iter().all(|(_, depth)| depth.is_opaque()),
            instances_apart: keeps_instances_apart(scene),
            surfaces: scene.settings.surfaces != SurfaceMode::Mesh.name()
                && scene.instances.iter().any(|i| scene.meshes[i.mesh].subdivision.is_some()),
            view: if scene.camera.lens_radius > 0.0 { View::Lens } else { View::Pinhole },
        }
    }

    /// Of a mesh alone.
    pub fn of_mesh(mesh: &TriangleMesh, view: View) -> Self {
        let objects = mesh.objects_or_whole();
        let opaque = objects.iter().all(|object| OpticalDepth::from_opacity(object.opacity).is_opaque());
        Self { opaque, instances_apart: false, surfaces: false, view }
    }
}

/// Whether copies of repeated meshes would be too many triangles for one mesh.
fn keeps_instances_apart(scene: &Scene) -> bool {
    let mut uses = vec![0usize; scene.meshes.len()];
    scene.instances.iter().for_each(|i| uses[i.mesh] += 1);
    let effective: usize = scene.instances.iter().map(|i| scene.meshes[i.mesh].mesh.triangles.len()).sum();
    uses.iter().any(|&n| n > 1) && effective > FLATTEN_TRIANGLES
}

impl OccluderMesh {
    /// Adds the triangles of `mesh`, and its objects to `objects`.
    fn append(
        &mut self,
        mesh: &TriangleMesh,
        objects: &mut Vec<(u32, OpticalDepth)>,
    ) -> Result<(), MeshError> {
        let own = &mut self.mesh;
        // Indices are 32-bit: several meshes may be too much where each one is not. The ground takes 4 vertices.
        let vertices = own.positions.len() + mesh.positions.len() + 4;
        let triangles = own.triangles.len() + mesh.triangles.len() + 2;
        for (what, count) in [("vertices", vertices), ("triangles", triangles)] {
            if count > MAX_ELEMENTS {
                return Err(MeshError::TooMany { what, count });
            }
        }
        let base = own.positions.len() as u32;
        own.positions.extend_from_slice(&mesh.positions);
        own.triangles.extend(mesh.triangles.iter().map(|t| t.map(|v| v + base)));
        for object in mesh.objects_or_whole() {
            self.object_of.extend(std::iter::repeat_n(objects.len() as u32, object.triangles.len()));
            objects.push((0, OpticalDepth::from_opacity(object.opacity)));
        }
        Ok(())
    }
}

impl PlacedPart {
    /// A part that is in world space already.
    fn in_place(objects: Vec<(u32, OpticalDepth)>) -> Self {
        let (world_from_object, normal_matrix) = (Affine3A::IDENTITY, Mat3A::IDENTITY);
        Self { part: 0, world_from_object, normal_matrix, objects }
    }
}

fn is_opaque(placed: &[PlacedPart]) -> bool {
    placed.iter().flat_map(|p| &p.objects).all(|o| o.1 == OpticalDepth::OPAQUE)
}

fn build_bvh(mesh: &TriangleMesh, object: &str) -> Result<Bvh, QueryError> {
    Bvh::build(&mesh.positions, &mesh.triangles, &BuildOptions::default())
        .map_err(|source| QueryError::Build { object: object.into(), source })
}

fn flat_hierarchy(
    mesh: &TriangleMesh,
    demand: &StructuresOnDemand,
    progress: Report<'_>,
) -> Result<Hierarchy, QueryError> {
    let progress = Progress::new(1, progress);
    let bvh = demand.time(Structure::Bvh, || {
        let bvh = build_bvh(mesh, "scene")?;
        let bytes = bvh.bytes();
        Ok::<_, QueryError>((bvh, bytes))
    })?;
    progress.finish()?;
    Ok(Hierarchy::Flat(Arc::new(bvh)))
}

fn build_top(bvhs: Vec<Arc<Bvh>>, placed: &[PlacedPart]) -> Result<InstancedBvh, QueryError> {
    let placements: Vec<Placement> = placed
        .iter()
        .map(|p| Placement { bvh: p.part as u32, world_from_object: p.world_from_object })
        .collect();
    InstancedBvh::build(bvhs, &placements)
        .map_err(|source| QueryError::Build { object: "instances".into(), source })
}

fn objects_of(scene: &Scene, instance: &umbrage_scene::Instance) -> Vec<(u32, OpticalDepth)> {
    let objects = scene.meshes[instance.mesh].mesh.objects_or_whole();
    let with_material = objects.iter().zip(&instance.materials);
    with_material
        .map(|(object, &m)| {
            let opacity = object.opacity * scene.materials[m].opacity;
            (m as u32, OpticalDepth::from_opacity(opacity))
        })
        .collect()
}

fn object_indices(mesh: &TriangleMesh) -> Vec<u32> {
    let objects = mesh.objects_or_whole();
    objects.iter().enumerate().flat_map(|(i, o)| std::iter::repeat_n(i as u32, o.triangles.len())).collect()
}

fn instanced_parts(scene: &Scene) -> (Vec<OccluderMesh>, Vec<PlacedPart>) {
    let parts = scene
        .meshes
        .iter()
        .map(|m| OccluderMesh { mesh: m.mesh.clone(), object_of: object_indices(&m.mesh) })
        .collect();
    let placed = scene
        .instances
        .iter()
        .map(|i| PlacedPart {
            part: i.mesh,
            world_from_object: i.world_from_object,
            normal_matrix: i.world_from_object.matrix3.inverse().transpose(),
            objects: objects_of(scene, i),
        })
        .collect();
    (parts, placed)
}

/// All instances moved to world space, in one mesh.
fn flat_part(scene: &Scene) -> (Vec<OccluderMesh>, Vec<PlacedPart>) {
    let mesh = scene.flatten();
    let objects = scene.instances.iter().flat_map(|i| objects_of(scene, i)).collect();
    (vec![OccluderMesh { object_of: object_indices(&mesh), mesh }], vec![PlacedPart::in_place(objects)])
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
