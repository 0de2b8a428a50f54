//! A scene's triangles, ready for rays: one flat BVH, or two levels where instances save memory.
//!
//! Here: which structure a scene gets, and what a hit means (point, normals, material). Not here: traversal
//! (`umbrage-accel`).

use crate::RenderError;
use std::{
    collections::HashMap,
    sync::{Arc, OnceLock},
};
use umbrage_accel::{BuildOptions, Bvh, InstancedBvh, Placement, Statistics};
use umbrage_geom::{Aabb, OpticalDepth, Ray, TriangleHit, TriangleMesh, glam::*};
use umbrage_occlusion::prefilter::{PrefilterOptions, Prefiltered};
use umbrage_scene::Scene;

/// Up to so many triangles in all, repeated meshes are copied into one flat BVH, whose rays are faster.
const FLATTEN_TRIANGLES: usize = 2_000_000;

/// All triangles of a scene.
pub struct Geometry {
    structure: Structure,
    parts: Vec<Part>,
    placed: Vec<Placed>,
    /// Albedo of each material.
    albedos: Vec<Vec3>,
    opaque: bool,
    bounds: Aabb,
    prefiltered: OnceLock<PrefilteredParts>,
}

/// Prefiltered hierarchies, built when first asked for.
pub struct PrefilteredParts {
    /// One for each part and set of opacities in use.
    pub scenes: Vec<Arc<Prefiltered>>,
    /// Which of them each instance has; one number for a flat scene.
    pub of_instance: Vec<u32>,
}

enum Structure {
    Flat(Arc<Bvh>),
    Instanced(InstancedBvh),
}

/// One mesh as the structure holds it: a mesh of the scene, or all of them in world space.
struct Part {
    mesh: TriangleMesh,
    /// Index of each triangle's object within the part.
    object_of: Vec<u32>,
}

struct Placed {
    part: usize,
    world_from_object: Affine3A,
    normal_matrix: Mat3A,
    /// Material and optical depth of each object of the part.
    objects: Vec<(u32, OpticalDepth)>,
}

/// The surface that a ray meets.
#[derive(Clone, Copy, Debug)]
pub struct Surface {
    /// The point, rounded; see [`Self::magnitude`].
    pub point: Vec3,
    /// Unit normal of the triangle, towards where the ray came from.
    pub geometric_normal: Vec3,
    /// Interpolated unit normal if the mesh has one, on the same side.
    pub shading_normal: Vec3,
    /// Largest coordinate that took part in computing the point, for [`umbrage_geom::offset_origin`].
    pub magnitude: f32,
    /// Fraction of light reflected, linear RGB.
    pub albedo: Vec3,
    /// Fraction of light that the surface blocks.
    pub opacity: f32,
    /// Ray parameter.
    pub t: f32,
}

/// A triangle in the scene: index of the placed part and of the triangle in it.
type Address = (u32, u32);

impl Placed {
    /// Bound on what rounding world points to and from object space is relative to, in world units: four times the
    /// largest sum of magnitudes in the transform of a corner (two transforms, each with up to four roundings, where a
    /// flat mesh has none).
    fn magnitude(&self, corners: [[f32; 3]; 3]) -> f32 {
        let m = self.world_from_object.matrix3;
        let largest = corners.iter().fold(Vec3A::ZERO, |l, &p| l.max(Vec3A::from(p).abs()));
        let sum = m.x_axis.abs() * largest.x + m.y_axis.abs() * largest.y + m.z_axis.abs() * largest.z;
        4.0 * (sum + self.world_from_object.translation.abs()).max_element()
    }
}

impl Geometry {
    /// Builds what the scene needs.
    ///
    /// # Errors
    /// [`RenderError::Build`] with the name of the object.
    pub fn build(scene: &Scene) -> Result<Self, RenderError> {
        let mut uses = vec![0usize; scene.meshes.len()];
        scene.instances.iter().for_each(|i| uses[i.mesh] += 1);
        let effective: usize =
            scene.instances.iter().map(|i| scene.meshes[i.mesh].mesh.triangles.len()).sum();
        let repeated = uses.iter().any(|&n| n > 1);
        let build = |part: &Part, object: &str| {
            Bvh::build(&part.mesh.positions, &part.mesh.triangles, &BuildOptions::default())
                .map_err(|source| RenderError::Build { object: object.into(), source })
        };
        let (parts, placed, structure);
        if repeated && effective > FLATTEN_TRIANGLES {
            (parts, placed) = instanced_parts(scene);
            let bvhs =
                parts.iter().zip(&scene.meshes).map(|(part, mesh)| build(part, &mesh.name).map(Arc::new));
            structure = Structure::Instanced(build_top(bvhs.collect::<Result<_, _>>()?, &placed)?);
        } else {
            (parts, placed) = flat_part(scene);
            structure = Structure::Flat(Arc::new(build(&parts[0], "scene")?));
        }
        let bounds = match &structure {
            Structure::Flat(bvh) => bvh.bounds(),
            Structure::Instanced(bvh) => bvh.bounds(),
        };
        let opaque = placed.iter().flat_map(|p| &p.objects).all(|o| o.1 == OpticalDepth::OPAQUE);
        let albedos = scene.materials.iter().map(|m| m.albedo.into()).collect();
        Ok(Self { structure, parts, placed, albedos, opaque, bounds, prefiltered: OnceLock::new() })
    }

    /// World bounds.
    pub fn bounds(&self) -> Aabb {
        self.bounds
    }

    /// Triangles of all instances together.
    pub fn triangle_count(&self) -> usize {
        self.placed.iter().map(|p| self.parts[p.part].mesh.triangles.len()).sum()
    }

    /// Bytes of the acceleration structure, and of the triangles and attributes beside it.
    pub fn bytes(&self) -> (usize, usize) {
        let structure = match &self.structure {
            Structure::Flat(bvh) => bvh.bytes(),
            Structure::Instanced(bvh) => bvh.bytes(),
        };
        (structure, self.parts.iter().map(|p| p.mesh.bytes() + 4 * p.object_of.len()).sum())
    }

    /// The hierarchy and mesh of a scene that is one flat mesh of opaque triangles; `None` for others.
    pub(crate) fn flat_opaque(&self) -> Option<(&Arc<Bvh>, &TriangleMesh)> {
        match &self.structure {
            Structure::Flat(bvh) if self.opaque => Some((bvh, &self.parts[0].mesh)),
            _ => None,
        }
    }

    /// The meshes below the structure, in the order of its hierarchies.
    pub(crate) fn meshes(&self) -> impl Iterator<Item = &TriangleMesh> {
        self.parts.iter().map(|part| &part.mesh)
    }

    /// The hierarchy of a scene whose instances are one flat mesh.
    pub(crate) fn flat(&self) -> Option<&Bvh> {
        match &self.structure {
            Structure::Flat(bvh) => Some(bvh),
            Structure::Instanced(_) => None,
        }
    }

    /// Whether every triangle blocks all light.
    pub fn is_opaque(&self) -> bool {
        self.opaque
    }

    /// Depth of a crossing of triangle `prim` of a flat scene.
    pub(crate) fn flat_depth(&self, prim: u32) -> OpticalDepth {
        self.depth_of((0, prim))
    }

    /// Whether instances are kept apart.
    pub fn is_instanced(&self) -> bool {
        matches!(self.structure, Structure::Instanced(_))
    }

    /// The two levels, if instances are kept apart.
    pub fn instances(&self) -> Option<&InstancedBvh> {
        match &self.structure {
            Structure::Flat(_) => None,
            Structure::Instanced(bvh) => Some(bvh),
        }
    }

    /// Prefiltered hierarchies over all parts, with the opacities of their objects. Built by the first call.
    ///
    /// # Errors
    /// [`RenderError::Prefilter`].
    pub fn prefiltered(&self) -> Result<&PrefilteredParts, RenderError> {
        if let Some(parts) = self.prefiltered.get() {
            return Ok(parts);
        }
        let mut known: HashMap<(usize, Vec<u32>), u32> = HashMap::new();
        let mut scenes = Vec::new();
        let mut of_instance = Vec::with_capacity(self.placed.len());
        for placed in &self.placed {
            let opacity = |o: &(u32, OpticalDepth)| (1.0 - o.1.transmittance()).to_bits();
            let opacities: Vec<u32> = placed.objects.iter().map(opacity).collect();
            let key = (placed.part, opacities);
            let next = scenes.len() as u32;
            if let Some(&scene) = known.get(&key) {
                of_instance.push(scene);
                continue;
            }
            let part = &self.parts[placed.part];
            let of_triangle: Vec<f32> =
                part.object_of.iter().map(|&object| f32::from_bits(key.1[object as usize])).collect();
            let Part { mesh, .. } = part;
            let options = PrefilterOptions::default();
            let scene =
                Prefiltered::build(&mesh.positions, &mesh.triangles, &of_triangle, &options, &mut |_| true)
                    .map_err(|source| RenderError::Prefilter { object: "scene".into(), source })?;
            scenes.push(Arc::new(scene));
            known.insert(key, next);
            of_instance.push(next);
        }
        Ok(self.prefiltered.get_or_init(|| PrefilteredParts { scenes, of_instance }))
    }

    /// Fraction of light that passes along the open segment of `ray`; exact in the sense of
    /// [`OpticalDepth`]: the same bits whatever the structure.
    pub fn transmittance(&self, ray: &Ray, stats: &mut impl Statistics) -> f32 {
        if self.opaque {
            let hit = match &self.structure {
                Structure::Flat(bvh) => bvh.any_hit_with(ray, stats),
                Structure::Instanced(bvh) => bvh.any_hit_with(ray, stats),
            };
            return if hit { 0.0 } else { 1.0 };
        }
        let depth = match &self.structure {
            Structure::Flat(bvh) => bvh.transmittance_with(ray, |prim| self.depth_of((0, prim)), stats),
            Structure::Instanced(bvh) => {
                bvh.transmittance_with(ray, |instance, prim| self.depth_of((instance, prim)), stats)
            }
        };
        depth.transmittance()
    }

    /// [`Self::transmittance`] of each ray; fastest for rays that share their origin.
    pub fn transmittances(&self, rays: &[Ray], passed: &mut [f32], stats: &mut impl Statistics) {
        match &self.structure {
            Structure::Flat(bvh) if self.opaque => {
                let mut hits = vec![false; rays.len()];
                bvh.any_hits_with(rays, &mut hits, stats);
                passed.iter_mut().zip(hits).for_each(|(out, hit)| *out = f32::from(u8::from(!hit)));
            }
            Structure::Flat(bvh) => {
                let mut sums = vec![OpticalDepth::CLEAR; rays.len()];
                bvh.transmittances_with(rays, |prim| self.depth_of((0, prim)), &mut sums, stats);
                passed.iter_mut().zip(sums).for_each(|(out, sum)| *out = sum.transmittance());
            }
            Structure::Instanced(_) => {
                rays.iter().zip(passed).for_each(|(ray, out)| *out = self.transmittance(ray, stats));
            }
        }
    }

    /// The nearest surface along `ray`.
    pub fn closest_hit(&self, ray: &Ray, stats: &mut impl Statistics) -> Option<Surface> {
        let (instance, hit) = match &self.structure {
            Structure::Flat(bvh) => (0, bvh.closest_hit_with(ray, stats)?),
            Structure::Instanced(bvh) => {
                let hit = bvh.closest_hit_with(ray, stats)?;
                (hit.instance, hit.hit)
            }
        };
        let triangle = TriangleHit { t: hit.t, u: hit.u, v: hit.v, front: hit.front };
        Some(self.surface((instance, hit.prim_index), &triangle, ray))
    }

    fn object_of(&self, (placed, triangle): Address) -> (u32, OpticalDepth) {
        let placed = &self.placed[placed as usize];
        placed.objects[self.parts[placed.part].object_of[triangle as usize] as usize]
    }

    fn depth_of(&self, address: Address) -> OpticalDepth {
        self.object_of(address).1
    }

    fn surface(&self, address: Address, hit: &TriangleHit, ray: &Ray) -> Surface {
        let placed = &self.placed[address.0 as usize];
        let mesh = &self.parts[placed.part].mesh;
        let index = address.1 as usize;
        let corners =
            mesh.triangle(index).map(|p| placed.world_from_object.transform_point3a(Vec3A::from(p)));
        let (e, f) = (corners[1] - corners[0], corners[2] - corners[0]);
        let normal64 = e.as_dvec3().cross(f.as_dvec3());
        let face = Vec3A::from(normal64.normalize_or_zero().as_vec3());
        let towards = |n: Vec3A, reference: Vec3A| if n.dot(reference) < 0.0 { -n } else { n };
        let geometric = towards(face, -Vec3A::from(ray.direction));
        let weights = [1.0 - hit.u - hit.v, hit.u, hit.v];
        let shading = mesh.corner_normals.get(index).and_then(|normals| {
            let n = (0..3).fold(Vec3A::ZERO, |n, i| n + Vec3A::from(normals[i]) * weights[i]);
            (placed.normal_matrix * n).try_normalize()
        });
        let (point, magnitude) = match &self.structure {
            // Computed in f64 and put back into the plane, so that only the final rounding is left, however large the
            // triangle.
            Structure::Flat(_) => {
                let along = ray.origin.as_dvec3() + f64::from(hit.t) * ray.direction.as_dvec3();
                let normal = normal64.normalize_or_zero();
                let point = along - normal * (along - corners[0].as_dvec3()).dot(normal);
                (point.as_vec3(), point.abs().max_element() as f32)
            }
            Structure::Instanced(_) => {
                ((corners[0] + e * hit.u + f * hit.v).into(), placed.magnitude(mesh.triangle(index)))
            }
        };
        let (material, depth) = self.object_of(address);
        let mut albedo = Vec3A::from(self.albedos[material as usize]);
        if !mesh.vertex_colors.is_empty() {
            let colors = mesh.triangles[index].map(|v| Vec3A::from(mesh.vertex_colors[v as usize]));
            albedo *= colors[0] * weights[0] + colors[1] * weights[1] + colors[2] * weights[2];
        }
        Surface {
            point,
            geometric_normal: geometric.into(),
            shading_normal: shading.map_or(geometric, |n| towards(n, geometric)).into(),
            magnitude,
            albedo: albedo.into(),
            opacity: 1.0 - depth.transmittance(),
            t: hit.t,
        }
    }
}

fn build_top(bvhs: Vec<Arc<Bvh>>, placed: &[Placed]) -> Result<InstancedBvh, RenderError> {
    let placements: Vec<Placement> = placed
        .iter()
        .map(|p| Placement { bvh: p.part as u32, world_from_object: p.world_from_object })
        .collect();
    InstancedBvh::build(bvhs, &placements)
        .map_err(|source| RenderError::Build { object: "instances".into(), source })
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

fn instanced_parts(scene: &Scene) -> (Vec<Part>, Vec<Placed>) {
    let parts = scene
        .meshes
        .iter()
        .map(|m| Part { mesh: m.mesh.clone(), object_of: object_indices(&m.mesh) })
        .collect();
    let placed = scene
        .instances
        .iter()
        .map(|i| Placed {
            part: i.mesh,
            world_from_object: i.world_from_object,
            normal_matrix: i.world_from_object.matrix3.inverse().transpose(),
            objects: objects_of(scene, i),
        })
        .collect();
    (parts, placed)
}

/// All instances moved to world space, in one mesh.
fn flat_part(scene: &Scene) -> (Vec<Part>, Vec<Placed>) {
    let mesh = scene.flatten();
    let placed = Placed {
        part: 0,
        world_from_object: Affine3A::IDENTITY,
        normal_matrix: Mat3A::IDENTITY,
        objects: scene.instances.iter().flat_map(|i| objects_of(scene, i)).collect(),
    };
    (vec![Part { object_of: object_indices(&mesh), mesh }], vec![placed])
}
