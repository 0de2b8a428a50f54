//! Scenes of suite `methods`, and where rays start.

use crate::scenes::receivers;
use anyhow::Result;
use umbrage_geom::{
    Ray,
    glam::{Affine3A, Vec3},
    sampling::sobol_2d,
};
use umbrage_query::{Ground, LightRay, Occluders};
use umbrage_scene::{
    Scene,
    generate::{Parameters, generate},
};

/// Scenes by name: opaque and closed, semi-transparent foliage, and so many copies that they are kept apart.
pub fn all(quick: bool) -> Result<[(&'static str, Scene); 3]> {
    let mesh = |name: &str, triangles: usize| -> Result<_> {
        let parameters = Parameters { triangles: Some(triangles), ..Parameters::default() };
        Ok(generate(name, &parameters)?.mesh)
    };
    let triangles = if quick { 20_000 } else { 200_000 };
    let opaque = Scene::around_mesh("dragonish", mesh("dragonish", triangles)?, Ground::Below)?;
    let mut foliage = Scene::around_mesh("bush", mesh("bush", triangles)?, Ground::Below)?;
    foliage.materials[0].opacity = 0.7;
    let mut copies = Scene::around_mesh("blob", mesh("blob", 6_000)?, Ground::Absent)?;
    let size = copies.meshes[0].mesh.bounds().diagonal();
    let first = copies.instances[0].clone();
    copies.instances = (0..400u32)
        .map(|i| {
            let at = Vec3::new((i % 20) as f32, 0.0, (i / 20) as f32) * (0.7 * size);
            let world_from_object = Affine3A::from_translation(at) * Affine3A::from_rotation_y(i as f32);
            umbrage_scene::Instance { name: format!("blob{i}"), world_from_object, ..first.clone() }
        })
        .collect();
    Ok([("dragonish", opaque), ("bush", foliage), ("blobs", copies)])
}

/// A scene ready for methods.
pub struct Case {
    pub occluders: Occluders,
    /// Points off the surface with normals.
    pub places: Vec<(Vec3, Vec3)>,
}

impl Case {
    /// With about `count` receivers.
    pub fn new(scene: &Scene, count: usize) -> Result<Self> {
        let occluders = Occluders::of_scene(scene, &mut |_| true)?;
        // Receivers of the mesh itself; a ground would have most of them.
        let mut own = scene.clone();
        own.instances.retain(|instance| instance.mesh == 0);
        let receivers = receivers(&own.flatten(), count, 7);
        let places = receivers.points.into_iter().zip(receivers.normals).collect();
        Ok(Self { occluders, places })
    }

    /// `count` rays from each receiver to a square light above the scene.
    pub fn shadow_rays(&self, count: u32) -> Vec<LightRay> {
        let bounds = self.occluders.bounds();
        let (center, size) = (bounds.center(), bounds.diagonal());
        let (middle, side) = (center + Vec3::new(0.3, 1.0, 0.2) * size, 0.25 * size);
        let mut rays = Vec::with_capacity(self.places.len() * count as usize);
        for (i, &(point, _)) in self.places.iter().enumerate() {
            rays.extend((0..count).map(|k| {
                let at = (sobol_2d(k, 0, i as u32) - 0.5) * side;
                let to_light = middle + Vec3::new(at.x, 0.0, at.y) - point;
                let cosine = to_light.y.abs() / to_light.length();
                let solid_angle = side * side * cosine / (to_light.length_squared() * count as f32);
                LightRay::new(Ray::new(point, to_light).with_tfar(1.0), solid_angle)
            }));
        }
        rays
    }
}
