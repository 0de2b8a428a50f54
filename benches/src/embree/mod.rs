//! Embree 3 as a peer: every occlusion call, both builds, both flags.
//!
//! Rays are written into Embree's layouts before each pass, which is not timed; nor are answers read back.

mod buffers;
mod ffi;
pub mod surface;

use self::buffers::Buffers;
use self::ffi::{Device, Feature, Packet, Quality, Query, Scene, Single};
use crate::{
    entry::{CHUNK, Entry},
    peer::{Builds, Peer},
};
use anyhow::Result;
use rayon::{ThreadPool, prelude::*};
use std::{
    cell::{OnceCell, RefCell},
    sync::Arc,
    time::Instant,
};
use umbrage_geom::{OpticalDepth, Ray, TriangleMesh};

struct Built {
    scene: Scene,
    quality: Quality,
    build_s: f64,
}

/// Embree's scenes over one mesh.
pub struct Embree {
    high: Built,
    medium: Built,
    robust: Built,
    /// Medium quality, since spatial splits would report a triangle more than once.
    filtered: Built,
    /// High quality with filters, for which more than one report does no harm; built when it is asked for.
    fronts: OnceCell<Built>,
    device: Arc<Device>,
    buffers: Arc<Buffers>,
    scratch: RefCell<Scratch>,
}

/// Rays in Embree's layouts, shared by all entries.
#[derive(Default)]
struct Scratch {
    singles: Vec<Single>,
    packets8: Vec<Packet<8>>,
    packets16: Vec<Packet<16>>,
}

impl Embree {
    /// Builds all scenes.
    ///
    /// # Errors
    /// What Embree reports.
    pub fn new(mesh: &TriangleMesh) -> Result<Self> {
        let device = Device::new()?;
        let buffers = Buffers::new(&mesh.positions, &mesh.triangles);
        let build = |quality, feature| Built::new(&device, &buffers, quality, feature);
        Ok(Self {
            high: build(Quality::High, Feature::None)?,
            medium: build(Quality::Medium, Feature::None)?,
            robust: build(Quality::High, Feature::Robust)?,
            filtered: build(Quality::Medium, Feature::Filter)?,
            fronts: OnceCell::new(),
            device,
            buffers,
            scratch: RefCell::default(),
        })
    }
}

impl Built {
    fn new(device: &Arc<Device>, buffers: &Arc<Buffers>, quality: Quality, feature: Feature) -> Result<Self> {
        let start = Instant::now();
        let scene = Scene::build(device, buffers, quality, feature)?;
        Ok(Self { scene, quality, build_s: start.elapsed().as_secs_f64() })
    }
}

impl Peer for Embree {
    fn name(&self) -> &'static str {
        "embree"
    }

    fn builds(&self) -> Builds {
        Builds {
            high_s: self.high.build_s,
            medium_s: self.medium.build_s,
            high_bytes: self.high.scene.bytes(),
            medium_bytes: self.medium.scene.bytes(),
        }
    }

    fn any_hit<'a>(&'a self, rays: &'a [Ray]) -> Vec<Box<dyn Entry<bool> + 'a>> {
        let mut entries: Vec<Box<dyn Entry<bool> + 'a>> = Vec::new();
        let builds = [("embree", &self.high, true), ("embree", &self.medium, true)];
        for (method, built, coherent_too) in
            builds.into_iter().chain([("embree-robust", &self.robust, false)])
        {
            for call in Call::ALL {
                for coherent in [false, true] {
                    if !coherent || coherent_too {
                        let (scratch, fronts) = (&self.scratch, false);
                        entries.push(Box::new(Occluded {
                            method,
                            built,
                            call,
                            coherent,
                            fronts,
                            rays,
                            scratch,
                        }));
                    }
                }
            }
        }
        entries
    }

    fn front_hit<'a>(&'a self, rays: &'a [Ray]) -> Result<Vec<Box<dyn Entry<bool> + 'a>>> {
        let high = match self.fronts.get() {
            Some(built) => built,
            None => {
                let built = Built::new(&self.device, &self.buffers, Quality::High, Feature::Filter)?;
                self.fronts.get_or_init(|| built)
            }
        };
        let mut entries: Vec<Box<dyn Entry<bool> + 'a>> = Vec::new();
        for built in [high, &self.filtered] {
            for call in Call::ALL {
                let (method, scratch) = ("embree", &self.scratch);
                // Incoherent only, as below.
                let (coherent, fronts) = (false, true);
                entries.push(Box::new(Occluded { method, built, call, coherent, fronts, rays, scratch }));
            }
        }
        Ok(entries)
    }

    fn transmittance<'a>(
        &'a self,
        rays: &'a [Ray],
        opacity: OpticalDepth,
    ) -> Vec<Box<dyn Entry<OpticalDepth> + 'a>> {
        // Incoherent only: the coherent packet path reports triangles more than once.
        Call::ALL
            .into_iter()
            .map(|call| {
                let (method, built, scratch) = ("embree", &self.filtered, &self.scratch);
                let (coherent, fronts) = (false, false);
                let inner = Occluded { method, built, call, coherent, fronts, rays, scratch };
                let depths = vec![OpticalDepth::CLEAR; rays.len()];
                Box::new(Filtered { inner, depths, opacity }) as Box<dyn Entry<OpticalDepth> + 'a>
            })
            .collect()
    }
}

/// An occlusion function.
#[derive(Clone, Copy)]
enum Call {
    Single,
    Packet8,
    Packet16,
    Stream,
}

impl Call {
    const ALL: [Self; 4] = [Self::Single, Self::Packet8, Self::Packet16, Self::Stream];
}

struct Occluded<'a> {
    method: &'static str,
    built: &'a Built,
    call: Call,
    coherent: bool,
    /// Whether rays pass through the backs of triangles.
    fronts: bool,
    rays: &'a [Ray],
    scratch: &'a RefCell<Scratch>,
}

/// What a call asks.
fn query(coherent: bool, fronts: bool) -> Query<'static> {
    if fronts { Query::front_hit(coherent) } else { Query::plain(coherent) }
}

impl Entry<bool> for Occluded<'_> {
    fn method(&self) -> &'static str {
        self.method
    }

    fn mode(&self) -> String {
        let call = match self.call {
            Call::Single => "1",
            Call::Packet8 => "8",
            Call::Packet16 => "16",
            Call::Stream => "1M",
        };
        let quality = match self.built.quality {
            Quality::High => "high",
            Quality::Medium => "medium",
        };
        let coherence = if self.coherent { "coherent" } else { "incoherent" };
        format!("occluded{call}-{quality}-{coherence}{}", if self.fronts { "-fronts" } else { "" })
    }

    fn build_s(&self) -> f64 {
        self.built.build_s
    }

    fn bytes(&self) -> usize {
        self.built.scene.bytes()
    }

    fn prepare(&mut self) {
        let scratch = &mut *self.scratch.borrow_mut();
        match self.call {
            Call::Single | Call::Stream => {
                scratch.singles.clear();
                scratch.singles.extend((0..).zip(self.rays).map(|(id, ray)| single(id, ray)));
            }
            Call::Packet8 => fill(&mut scratch.packets8, self.rays),
            Call::Packet16 => fill(&mut scratch.packets16, self.rays),
        }
    }

    fn run(&mut self, pool: Option<&ThreadPool>) {
        let scratch = &mut *self.scratch.borrow_mut();
        let (scene, coherent, fronts) = (&self.built.scene, self.coherent, self.fronts);
        match self.call {
            Call::Single => in_chunks(pool, &mut scratch.singles, 1, |rays| {
                scene.occluded1(&mut query(coherent, fronts), rays);
            }),
            Call::Stream => in_chunks(pool, &mut scratch.singles, 1, |rays| {
                scene.occluded_stream(&mut query(coherent, fronts), rays);
            }),
            Call::Packet8 => in_chunks(pool, &mut scratch.packets8, 8, |packets| {
                scene.occluded8(&mut query(coherent, fronts), packets);
            }),
            Call::Packet16 => in_chunks(pool, &mut scratch.packets16, 16, |packets| {
                scene.occluded16(&mut query(coherent, fronts), packets);
            }),
        }
    }

    fn answers(&self) -> Vec<bool> {
        let scratch = self.scratch.borrow();
        let ends: Vec<f32> = match self.call {
            Call::Single | Call::Stream => scratch.singles.iter().map(|ray| ray.tfar).collect(),
            Call::Packet8 => scratch.packets8.iter().flat_map(|packet| packet.tfar).collect(),
            Call::Packet16 => scratch.packets16.iter().flat_map(|packet| packet.tfar).collect(),
        };
        ends[..self.rays.len()].iter().map(|&tfar| tfar == f32::NEG_INFINITY).collect()
    }
}

/// The same calls with a filter that lets rays through.
struct Filtered<'a> {
    inner: Occluded<'a>,
    depths: Vec<OpticalDepth>,
    opacity: OpticalDepth,
}

impl Entry<OpticalDepth> for Filtered<'_> {
    fn method(&self) -> &'static str {
        self.inner.method()
    }

    fn mode(&self) -> String {
        self.inner.mode()
    }

    fn build_s(&self) -> f64 {
        self.inner.build_s()
    }

    fn bytes(&self) -> usize {
        self.inner.bytes()
    }

    fn prepare(&mut self) {
        self.inner.prepare();
        self.depths.fill(OpticalDepth::CLEAR);
    }

    /// On this thread: all rays write to one slice.
    fn run(&mut self, _pool: Option<&ThreadPool>) {
        let scratch = &mut *self.inner.scratch.borrow_mut();
        let scene = &self.inner.built.scene;
        let mut query = Query::transmittance(self.inner.coherent, &mut self.depths, self.opacity);
        match self.inner.call {
            Call::Single => scene.occluded1(&mut query, &mut scratch.singles),
            Call::Stream => scene.occluded_stream(&mut query, &mut scratch.singles),
            Call::Packet8 => scene.occluded8(&mut query, &mut scratch.packets8),
            Call::Packet16 => scene.occluded16(&mut query, &mut scratch.packets16),
        }
    }

    fn answers(&self) -> Vec<OpticalDepth> {
        let finish = |&depth: &OpticalDepth| if depth.is_opaque() { OpticalDepth::OPAQUE } else { depth };
        self.depths.iter().map(finish).collect()
    }
}

/// Calls `job` with all items, or with chunks of about `CHUNK` rays on the threads of `pool`.
fn in_chunks<T: Send>(
    pool: Option<&ThreadPool>,
    items: &mut [T],
    rays_per_item: usize,
    job: impl Fn(&mut [T]) + Sync + Send,
) {
    match pool {
        None => job(items),
        Some(pool) => pool.install(|| items.par_chunks_mut(CHUNK / rays_per_item).for_each(job)),
    }
}

fn single(id: u32, ray: &Ray) -> Single {
    Single {
        origin: ray.origin.to_array(),
        tnear: ray.tnear,
        direction: ray.direction.to_array(),
        time: 0.0,
        tfar: ray.tfar,
        mask: u32::MAX,
        id,
        flags: 0,
    }
}

/// Writes `rays` as packets; the last one is filled up with copies of its last ray that answer to nobody.
fn fill<const N: usize>(packets: &mut Vec<Packet<N>>, rays: &[Ray]) {
    packets.clear();
    packets.extend((0..).step_by(N).zip(rays.chunks(N)).map(|(first, rays)| {
        let lane = |i: usize| {
            single(if i < rays.len() { first + i as u32 } else { u32::MAX }, &rays[i.min(rays.len() - 1)])
        };
        let lanes: [Single; N] = std::array::from_fn(lane);
        Packet {
            origin: std::array::from_fn(|axis| lanes.map(|ray| ray.origin[axis])),
            tnear: lanes.map(|ray| ray.tnear),
            direction: std::array::from_fn(|axis| lanes.map(|ray| ray.direction[axis])),
            time: [0.0; N],
            tfar: lanes.map(|ray| ray.tfar),
            mask: [u32::MAX; N],
            id: lanes.map(|ray| ray.id),
            flags: [0; N],
        }
    }));
}

#[cfg(test)]
mod tests;
