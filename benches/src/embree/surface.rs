//! Embree's subdivision surfaces, for frames of camera and shadow rays.
//!
//! Rays are written into Embree's layouts before the clock starts, and answers are read after it stops.

use super::{
    buffers::ControlBuffers,
    ffi::{Device, Hit, Packet, PacketHit, PacketHits, Query, Scene, Single, SingleHit},
    fill, single,
};
use anyhow::Result;
use std::{sync::Arc, time::Instant};
use umbrage_geom::{PolygonMesh, Ray, glam::Vec3};

/// How many rays a call takes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Width {
    One,
    Four,
    Eight,
    Sixteen,
    Stream,
}

/// One of Embree's calls, and whether its rays are said to be coherent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Call {
    width: Width,
    coherent: bool,
}

impl Call {
    /// One ray at a time.
    pub const SINGLE: Self = Self { width: Width::One, coherent: false };

    /// All calls with both flags.
    pub fn all() -> Vec<Self> {
        let widths = [Width::One, Width::Four, Width::Eight, Width::Sixteen, Width::Stream];
        widths.into_iter().flat_map(|width| [false, true].map(|coherent| Self { width, coherent })).collect()
    }

    /// The call's number of rays and its flag, such as `16 coherent`.
    pub fn name(self) -> String {
        let width = match self.width {
            Width::One => "1",
            Width::Four => "4",
            Width::Eight => "8",
            Width::Sixteen => "16",
            Width::Stream => "1M",
        };
        format!("{width} {}", if self.coherent { "coherent" } else { "incoherent" })
    }
}

/// A tessellated surface.
pub struct EmbreeSurface {
    device: Arc<Device>,
    scene: Scene,
    single_hits: Vec<SingleHit>,
    hits4: Vec<PacketHit<4>>,
    hits8: Vec<PacketHit<8>>,
    hits16: Vec<PacketHit<16>>,
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
            single_hits: Vec::new(),
            hits4: Vec::new(),
            hits8: Vec::new(),
            hits16: Vec::new(),
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

    /// Appends `t` and unit geometric normal of the closest hit of each ray to `hits`. Returns the seconds of Embree's calls.
    pub fn closest_hits(&mut self, rays: &[Ray], call: Call, hits: &mut Vec<Option<(f32, Vec3)>>) -> f64 {
        let (scene, mut query) = (&self.scene, Query::plain(call.coherent));
        match call.width {
            Width::One | Width::Stream => {
                self.single_hits.clear();
                let rays =
                    (0..).zip(rays).map(|(id, ray)| SingleHit { ray: single(id, ray), hit: Hit::NONE });
                self.single_hits.extend(rays);
                let start = Instant::now();
                if call.width == Width::One {
                    scene.intersect1(&mut query, &mut self.single_hits);
                } else {
                    scene.intersect_stream(&mut query, &mut self.single_hits);
                }
                let seconds = start.elapsed().as_secs_f64();
                let found = self.single_hits.iter();
                hits.extend(found.map(|ray| answer(ray.hit.geometry, ray.ray.tfar, ray.hit.normal)));
                seconds
            }
            Width::Four => {
                packed(&mut self.packets4, &mut self.hits4, rays, hits, |p| scene.intersect4(&mut query, p))
            }
            Width::Eight => {
                packed(&mut self.packets8, &mut self.hits8, rays, hits, |p| scene.intersect8(&mut query, p))
            }
            Width::Sixteen => packed(&mut self.packets16, &mut self.hits16, rays, hits, |p| {
                scene.intersect16(&mut query, p)
            }),
        }
    }

    /// Appends whether each ray meets the surface to `blocked`. Returns the seconds of Embree's calls.
    pub fn any_hits(&mut self, rays: &[Ray], call: Call, blocked: &mut Vec<bool>) -> f64 {
        let (scene, mut query) = (&self.scene, Query::plain(call.coherent));
        let is_blocked = |tfar: f32| tfar == f32::NEG_INFINITY;
        match call.width {
            Width::One | Width::Stream => {
                self.singles.clear();
                self.singles.extend((0..).zip(rays).map(|(id, ray)| single(id, ray)));
                let start = Instant::now();
                if call.width == Width::One {
                    scene.occluded1(&mut query, &mut self.singles);
                } else {
                    scene.occluded_stream(&mut query, &mut self.singles);
                }
                let seconds = start.elapsed().as_secs_f64();
                blocked.extend(self.singles.iter().map(|ray| is_blocked(ray.tfar)));
                seconds
            }
            Width::Four => {
                let seconds = filled(&mut self.packets4, rays, |p| scene.occluded4(&mut query, p));
                let ends = self.packets4.iter().flat_map(|packet| packet.tfar);
                blocked.extend(ends.take(rays.len()).map(is_blocked));
                seconds
            }
            Width::Eight => {
                let seconds = filled(&mut self.packets8, rays, |p| scene.occluded8(&mut query, p));
                let ends = self.packets8.iter().flat_map(|packet| packet.tfar);
                blocked.extend(ends.take(rays.len()).map(is_blocked));
                seconds
            }
            Width::Sixteen => {
                let seconds = filled(&mut self.packets16, rays, |p| scene.occluded16(&mut query, p));
                let ends = self.packets16.iter().flat_map(|packet| packet.tfar);
                blocked.extend(ends.take(rays.len()).map(is_blocked));
                seconds
            }
        }
    }
}

fn answer(geometry: u32, t: f32, normal: [f32; 3]) -> Option<(f32, Vec3)> {
    (geometry != u32::MAX).then(|| (t, Vec3::from(normal).normalize_or_zero()))
}

/// Fills packets with `rays` and traces them; seconds of tracing alone.
fn filled<const N: usize>(
    packets: &mut Vec<Packet<N>>,
    rays: &[Ray],
    trace: impl FnOnce(&mut [Packet<N>]),
) -> f64 {
    fill(packets, rays);
    let start = Instant::now();
    trace(packets);
    start.elapsed().as_secs_f64()
}

/// The same for closest hits, which are appended to `hits`.
fn packed<const N: usize>(
    packets: &mut Vec<Packet<N>>,
    packet_hits: &mut Vec<PacketHit<N>>,
    rays: &[Ray],
    hits: &mut Vec<Option<(f32, Vec3)>>,
    trace: impl FnOnce(&mut [PacketHit<N>]),
) -> f64 {
    fill(packets, rays);
    packet_hits.clear();
    packet_hits.extend(packets.iter().map(|&rays| PacketHit { rays, hits: PacketHits::NONE }));
    let start = Instant::now();
    trace(packet_hits);
    let seconds = start.elapsed().as_secs_f64();
    let lanes = packet_hits.iter().flat_map(|packet| (0..N).map(move |i| (packet, i)));
    hits.extend(lanes.take(rays.len()).map(|(packet, i)| {
        answer(packet.hits.geometry[i], packet.rays.tfar[i], packet.hits.normal.map(|axis| axis[i]))
    }));
    seconds
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two quadrilaterals above one another: every call finds the same closest hits and occluders.
    #[test]
    fn every_call_sees_the_same_surface() {
        let square = |z: f32| [[0.0, 0.0, z], [1.0, 0.0, z], [1.0, 1.0, z], [0.0, 1.0, z]];
        let control = PolygonMesh {
            positions: [square(0.0), square(1.0)].concat(),
            face_sizes: vec![4; 2],
            corners: (0..8).collect(),
            ..PolygonMesh::default()
        };
        let mut surface = EmbreeSurface::new(&control, &[4.0; 8]).expect("Embree is installed");
        let rays: Vec<Ray> = (0..37)
            .map(|i| {
                Ray::new([i as f32 / 30.0, 0.45, -1.0], [0.0, 0.0, 1.0]).with_tfar(if i % 3 == 0 {
                    0.5
                } else {
                    9.0
                })
            })
            .collect();
        let (mut first, mut count) = (None, 0);
        for call in Call::all() {
            let (mut hits, mut blocked) = (Vec::new(), Vec::new());
            assert!(surface.closest_hits(&rays, call, &mut hits) > 0.0);
            assert!(surface.any_hits(&rays, call, &mut blocked) > 0.0);
            assert!(hits.iter().map(Option::is_some).eq(blocked.iter().copied()), "{}", call.name());
            count = blocked.iter().filter(|&&b| b).count();
            let distances: Vec<_> =
                hits.iter().map(|hit| hit.map(|(t, normal)| (t, normal.z.abs()))).collect();
            assert!(distances.iter().flatten().all(|&(t, z)| (t - 1.0).abs() < 1e-5 && z > 0.999));
            assert_eq!(first.get_or_insert(blocked.clone()), &blocked, "{}", call.name());
        }
        assert!((15..25).contains(&count), "{count}");
    }
}
