//! Scenes as a whole: bounds, counts, and a default view of a bare mesh.

use crate::scene::{Ambient, Camera, Instance, Light, Material, NamedMesh, Radius, Scene, Settings};
use umbrage_geom::glam::{Affine3A, Vec3};
use umbrage_geom::{Aabb, MeshError, TriangleMesh};

/// What a mesh stands on.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Ground {
    /// Nothing.
    #[default]
    Absent,
    /// A large opaque square just below the lowest point, facing up; whoever adds it says how large.
    Below,
}

impl Default for Material {
    /// Named `default`: grey of albedo 0.7, opaque.
    fn default() -> Self {
        Self { name: "default".into(), albedo: [0.7; 3], opacity: 1.0 }
    }
}

impl Default for Camera {
    /// From `(0, 0, 1)` at the origin, y up, 40 degrees, no lens.
    fn default() -> Self {
        Self {
            position: [0.0, 0.0, 1.0],
            target: [0.0; 3],
            up: [0.0, 1.0, 0.0],
            fov: 40.0,
            lens_radius: 0.0,
            focus_distance: None,
        }
    }
}

impl Camera {
    /// A view of all of `bounds` from the front, to the right and above, in an image at least as wide as high.
    pub fn around(bounds: Aabb) -> Self {
        let mut camera = Self::default();
        let bounds = if bounds.is_empty() { Aabb::from_points(&[[0.0; 3]]) } else { bounds };
        let half_angle = (0.5 * camera.fov).to_radians();
        let center = bounds.center();
        // Far from the origin a small box must still be seen from outside of itself.
        let radius = (0.5 * bounds.diagonal()).max(1e-4 * center.length());
        let radius = if radius > 0.0 { radius } else { 1.0 };
        let direction = Vec3::new(0.6, 0.45, 1.0).normalize();
        camera.target = center.to_array();
        camera.position = (center + direction * (radius / half_angle.sin())).to_array();
        camera
    }
}

impl Scene {
    /// A box around all instances in world space: the union of their meshes' boxes, transformed.
    pub fn bounds(&self) -> Aabb {
        let boxes: Vec<_> = self.meshes.iter().map(|m| m.mesh.bounds()).collect();
        self.instances.iter().fold(Aabb::EMPTY, |all, instance| {
            let Some(&bounds) = boxes.get(instance.mesh).filter(|b| !b.is_empty()) else { return all };
            if instance.world_from_object == Affine3A::IDENTITY {
                return all.union(bounds);
            }
            let world = &instance.world_from_object;
            corners(bounds).into_iter().fold(all, |all, c| all.with_point(world.transform_point3(c)))
        })
    }

    /// Triangles of all instances; a mesh counts once for each.
    pub fn triangle_count(&self) -> u64 {
        let counts = self.instances.iter().filter_map(|i| self.meshes.get(i.mesh));
        counts.map(|m| m.mesh.triangles.len() as u64).sum()
    }

    /// A scene that shows one mesh: a camera around it, one rectangle light above, and ambient occlusion within a tenth
    /// of its diagonal.
    ///
    /// # Errors
    /// Those of [`TriangleMesh::validate`].
    pub fn around_mesh(name: &str, mesh: TriangleMesh, ground: Ground) -> Result<Self, MeshError> {
        mesh.validate()?;
        let bounds = mesh.bounds();
        let camera = Camera::around(bounds);
        let center = bounds.center();
        let size = if bounds.diagonal() > 0.0 { bounds.diagonal() } else { 1.0 };
        let objects = mesh.objects_or_whole().len();
        let mut meshes = vec![NamedMesh::new(name, mesh)];
        if ground == Ground::Below {
            let name = if name == "ground" { "ground plane" } else { "ground" };
            meshes.push(NamedMesh::new(name, ground_plane(bounds, size)?));
        }
        let instances = meshes
            .iter()
            .enumerate()
            .map(|(mesh, named)| Instance {
                name: named.name.clone(),
                mesh,
                world_from_object: Affine3A::IDENTITY,
                materials: vec![mesh; if mesh == 0 { objects } else { 1 }],
            })
            .collect();
        let material = Material::default();
        let materials = match ground {
            Ground::Below => {
                vec![material, Material { name: "ground".into(), albedo: [0.5; 3], opacity: 1.0 }]
            }
            Ground::Absent => vec![material],
        };
        Ok(Self {
            camera,
            meshes,
            instances,
            materials,
            lights: vec![default_light(center, size)],
            ambient: Some(Ambient {
                radiance: [0.6, 0.65, 0.7],
                // Of the mesh, not of the ground under it.
                radius: Radius::Absolute(0.1 * size),
                falloff: umbrage_geom::Falloff::Linear,
            }),
            background: [0.6, 0.65, 0.7],
            settings: Settings::default(),
        })
    }
}

/// A square above, to the left and in front, facing `center`, that gives an irradiance of about 2.
fn default_light(center: Vec3, size: f32) -> Light {
    let toward = -Vec3::new(-0.7, 1.2, 0.6).normalize();
    let (side, distance) = (0.8 * size, 1.6 * size);
    let u = side * Vec3::Y.cross(toward).normalize();
    let v = toward.cross(u);
    let corner = center - toward * distance - 0.5 * (u + v);
    Light::Rectangle {
        corner: corner.to_array(),
        u: u.to_array(),
        v: v.to_array(),
        radiance: [8.0, 7.8, 7.4],
        two_sided: false,
    }
}

fn ground_plane(bounds: Aabb, size: f32) -> Result<TriangleMesh, MeshError> {
    let center = bounds.center();
    let y = bounds.min.y;
    let corner = |x: f32, z: f32| [center.x + 8.0 * size * x, y, center.z + 8.0 * size * z];
    TriangleMesh::new(
        vec![corner(-1.0, -1.0), corner(-1.0, 1.0), corner(1.0, 1.0), corner(1.0, -1.0)],
        vec![[0, 1, 2], [0, 2, 3]],
    )
}

/// The eight corners of a box.
pub(crate) fn corners(bounds: Aabb) -> [Vec3; 8] {
    std::array::from_fn(|i| {
        let pick = |axis: usize| if i >> axis & 1 == 0 { bounds.min[axis] } else { bounds.max[axis] };
        Vec3::new(pick(0), pick(1), pick(2))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn triangle(scale: f32) -> TriangleMesh {
        let p = [[0.0, 1.0, 0.0], [scale, 1.0, 0.0], [0.0, 1.0 + scale, scale]];
        TriangleMesh::new(p.to_vec(), vec![[0, 1, 2]]).unwrap()
    }

    #[test]
    fn a_bare_mesh_is_seen_and_lit() {
        for scale in [1e-6, 1.0, 1e9] {
            let scene = Scene::around_mesh("shape", triangle(scale), Ground::Below).unwrap();
            let [position, target] = [scene.camera.position, scene.camera.target].map(Vec3::from);
            let bounds = scene.meshes[0].mesh.bounds();
            let view = (target - position).normalize();
            for corner in corners(bounds) {
                let angle = (corner - position).normalize().dot(view).acos().to_degrees();
                assert!(angle <= 0.5 * scene.camera.fov + 0.01, "{angle} at scale {scale}");
            }
            let Light::Rectangle { corner, u, v, .. } = scene.lights[0] else { panic!("{:?}", scene.lights) };
            let normal = Vec3::from(u).cross(v.into());
            assert!(normal.dot(bounds.center() - Vec3::from(corner)) > 0.0);
            let plane = &scene.meshes[1].mesh;
            let [a, b, c] = plane.triangle(0).map(Vec3::from);
            assert!((b - a).cross(c - a).y > 0.0, "the ground faces up");
            assert_eq!(scene.triangle_count(), 3);
        }
    }

    #[test]
    fn bounds_cover_instances() {
        let mut scene = Scene::around_mesh("shape", triangle(1.0), Ground::Absent).unwrap();
        scene.instances.push(Instance {
            name: "moved".into(),
            world_from_object: Affine3A::from_translation(Vec3::new(10.0, 0.0, 0.0)),
            ..scene.instances[0].clone()
        });
        let bounds = scene.bounds();
        assert_eq!((bounds.min.to_array(), bounds.max.to_array()), ([0.0, 1.0, 0.0], [11.0, 2.0, 1.0]));
        assert_eq!(scene.triangle_count(), 2);
    }
}
