//! Embree's subdivision surfaces, for frames of camera and shadow rays.

use super::{
    ffi::{ControlBuffers, Device, Hit, Packet, Query, Scene, Single, SingleHit},
    fill, single,
};
use anyhow::Result;
use std::sync::Arc;
use umbrage_geom::{PolygonMesh, Ray, glam::Vec3};

/// How the shadow rays of a pixel are traced.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Shadows {
    Single,
    Packet4,
    Packet8,
    Packet16,
}

impl Shadows {
    pub const ALL: [Self; 4] = [Self::Single, Self::Packet4, Self::Packet8, Self::Packet16];
}

/// A tessellated surface.
pub struct EmbreeSurface {
    device: Arc<Device>,
    scene: Scene,
    singles: Vec<Single>,
    packets4: Vec<Packet<4>>,
    packets8: Vec<Packet<8>>,
    packets16: Vec<Packet<16>>,
}

impl EmbreeSurface {
    /// Tessellates; `levels` are the segments of the edge from each corner to its face's next.
    ///
    /// # Errors
    /// What Embree reports.
    pub fn new(control: &PolygonMesh, levels: &[f32]) -> Result<Self> {
        let device = Device::new()?;
        let scene = Scene::build_subdivision(&device, &ControlBuffers::new(control, levels)?)?;
        Ok(Self {
            device,
            scene,
            singles: Vec::new(),
            packets4: Vec::new(),
            packets8: Vec::new(),
            packets16: Vec::new(),
        })
    }

    /// The most bytes that Embree held since the start of building.
    pub fn peak_bytes(&self) -> usize {
        self.device.peak_bytes()
    }

    /// `t` and unit geometric normal of the closest hit.
    pub fn closest_hit(&self, ray: &Ray) -> Option<(f32, Vec3)> {
        let mut ray = SingleHit { ray: single(0, ray), hit: Hit::NONE };
        self.scene.intersect1(&mut Query::any_hit(false), &mut ray);
        let normal = Vec3::from(ray.hit.normal).normalize_or_zero();
        (ray.hit.geometry != u32::MAX).then_some((ray.ray.tfar, normal))
    }

    /// How many of `rays` meet the surface.
    pub fn count_blocked(&mut self, rays: &[Ray], shadows: Shadows) -> usize {
        let mut query = Query::any_hit(true);
        match shadows {
            Shadows::Single => {
                self.singles.clear();
                self.singles.extend((0..).zip(rays).map(|(id, ray)| single(id, ray)));
                self.scene.occluded1(&mut query, &mut self.singles);
                count(self.singles.iter().map(|ray| ray.tfar))
            }
            Shadows::Packet4 => {
                fill(&mut self.packets4, rays);
                self.scene.occluded4(&mut query, &mut self.packets4);
                count(self.packets4.iter().flat_map(|packet| packet.tfar).take(rays.len()))
            }
            Shadows::Packet8 => {
                fill(&mut self.packets8, rays);
                self.scene.occluded8(&mut query, &mut self.packets8);
                count(self.packets8.iter().flat_map(|packet| packet.tfar).take(rays.len()))
            }
            Shadows::Packet16 => {
                fill(&mut self.packets16, rays);
                self.scene.occluded16(&mut query, &mut self.packets16);
                count(self.packets16.iter().flat_map(|packet| packet.tfar).take(rays.len()))
            }
        }
    }
}

fn count(ends: impl Iterator<Item = f32>) -> usize {
    ends.filter(|&tfar| tfar == f32::NEG_INFINITY).count()
}
