//! Binding to Embree 3 (`libembree3`): devices, committed scenes of one mesh or subdivision surface, calls for occlusion and for
//! closest hits. All unsafe code of this crate is here; what is public is safe to call. Memory of meshes is in `buffers.rs`.
//!
//! The control register of floating point stays as it is: denormals are not flushed, here or in our own code.

use super::buffers::{Buffers, ControlBuffers};
use anyhow::{Result, bail};
use std::{
    any::Any,
    ffi::{c_char, c_int, c_uint, c_void},
    marker::PhantomData,
    mem::offset_of,
    ptr,
    sync::{
        Arc,
        atomic::{AtomicIsize, Ordering},
    },
};
use umbrage_geom::OpticalDepth;

type Handle = *mut c_void;

/// `RTCIntersectContext`.
#[repr(C)]
struct Context {
    flags: c_uint,
    filter: Option<unsafe extern "C" fn(*const FilterArguments)>,
    instance: c_uint,
}

/// `RTCFilterFunctionNArguments`.
#[repr(C)]
struct FilterArguments {
    valid: *mut c_int,
    geometry_user: *mut c_void,
    context: *mut Context,
    ray: *const c_uint,
    /// Components of `RTCHit`, the geometric normal first, each of all lanes.
    hit: *const f32,
    lanes: c_uint,
}

/// `RTCRay`.
#[derive(Clone, Copy, Default)]
#[repr(C, align(16))]
pub struct Single {
    pub origin: [f32; 3],
    pub tnear: f32,
    pub direction: [f32; 3],
    pub time: f32,
    /// Negative infinity after a call that found an occluder.
    pub tfar: f32,
    pub mask: u32,
    pub id: u32,
    pub flags: u32,
}

/// `RTCRayHit`.
#[derive(Clone, Copy)]
#[repr(C)]
pub struct SingleHit {
    /// `tfar` is that of the hit, if there is one.
    pub ray: Single,
    pub hit: Hit,
}

/// `RTCHit`.
#[derive(Clone, Copy)]
#[repr(C, align(16))]
pub struct Hit {
    /// Not normalized.
    pub normal: [f32; 3],
    pub u: f32,
    pub v: f32,
    pub primitive: u32,
    /// `u32::MAX` for a miss.
    pub geometry: u32,
    pub instance: u32,
}

impl Hit {
    /// No hit yet.
    pub const NONE: Self = Self {
        normal: [0.0; 3],
        u: 0.0,
        v: 0.0,
        primitive: u32::MAX,
        geometry: u32::MAX,
        instance: u32::MAX,
    };
}

/// `RTCRay4`, `RTCRay8`, `RTCRay16`: the components of [`Single`], each for all lanes.
#[derive(Clone, Copy)]
#[repr(C, align(64))]
pub struct Packet<const N: usize> {
    pub origin: [[f32; N]; 3],
    pub tnear: [f32; N],
    pub direction: [[f32; N]; 3],
    pub time: [f32; N],
    pub tfar: [f32; N],
    pub mask: [u32; N],
    pub id: [u32; N],
    pub flags: [u32; N],
}

/// `RTCHit4`, `RTCHit8`, `RTCHit16`: the components of [`Hit`], each for all lanes.
#[derive(Clone, Copy)]
#[repr(C, align(64))]
pub struct PacketHits<const N: usize> {
    pub normal: [[f32; N]; 3],
    pub u: [f32; N],
    pub v: [f32; N],
    pub primitive: [u32; N],
    pub geometry: [u32; N],
    pub instance: [u32; N],
}

impl<const N: usize> PacketHits<N> {
    /// No hits yet.
    pub const NONE: Self = Self {
        normal: [[0.0; N]; 3],
        u: [0.0; N],
        v: [0.0; N],
        primitive: [u32::MAX; N],
        geometry: [u32::MAX; N],
        instance: [u32::MAX; N],
    };
}

/// `RTCRayHit4`, `RTCRayHit8`, `RTCRayHit16`.
#[derive(Clone, Copy)]
#[repr(C)]
pub struct PacketHit<const N: usize> {
    pub rays: Packet<N>,
    pub hits: PacketHits<N>,
}

/// Index of a ray's `id` among its twelve components, in single rays and packets alike.
const ID: usize = offset_of!(Single, id) / 4;
/// The same of the first coordinate of its direction; the other two follow.
const DIRECTION: usize = offset_of!(Single, direction) / 4;
const _: () = assert!(size_of::<Single>() == 48 && offset_of!(Packet<8>, id) == ID * 8 * 4);
const _: () = assert!(size_of::<Packet<8>>() == 48 * 8 && size_of::<Packet<16>>() == 48 * 16);
const _: () = assert!(size_of::<SingleHit>() == 80 && offset_of!(SingleHit, hit) == 48);
const _: () = assert!(size_of::<PacketHit<4>>() == 80 * 4 && offset_of!(PacketHit<4>, hits) == 48 * 4);
const _: () = assert!(size_of::<PacketHit<8>>() == 80 * 8 && size_of::<PacketHit<16>>() == 80 * 16);

/// The mask of a packet without inactive lanes.
#[repr(align(64))]
struct AllLanes([c_int; 16]);
static ALL_LANES: AllLanes = AllLanes([-1; 16]);

const TYPE_TRIANGLE: c_uint = 0;
const TYPE_SUBDIVISION: c_uint = 8;
const BUFFER_INDEX: c_uint = 0;
const BUFFER_VERTEX: c_uint = 1;
const BUFFER_FACE: c_uint = 16;
const BUFFER_LEVEL: c_uint = 17;
const FORMAT_UINT: c_uint = 0x5001;
const FORMAT_FLOAT: c_uint = 0x9001;
const FORMAT_UINT3: c_uint = 0x5003;
const FORMAT_FLOAT3: c_uint = 0x9003;
const SCENE_ROBUST: c_uint = 1 << 2;
const SCENE_CONTEXT_FILTER: c_uint = 1 << 3;
const CONTEXT_COHERENT: c_uint = 1;

#[link(name = "embree3")]
unsafe extern "C" {
    fn rtcNewDevice(config: *const c_char) -> Handle;
    fn rtcReleaseDevice(device: Handle);
    fn rtcGetDeviceError(device: Handle) -> c_uint;
    fn rtcSetDeviceMemoryMonitorFunction(
        device: Handle,
        monitor: Option<unsafe extern "C" fn(*mut c_void, isize, bool) -> bool>,
        user: *mut c_void,
    );
    fn rtcNewGeometry(device: Handle, kind: c_uint) -> Handle;
    fn rtcReleaseGeometry(geometry: Handle);
    fn rtcCommitGeometry(geometry: Handle);
    fn rtcSetGeometryBuildQuality(geometry: Handle, quality: c_uint);
    fn rtcSetSharedGeometryBuffer(
        geometry: Handle,
        kind: c_uint,
        slot: c_uint,
        format: c_uint,
        data: *const c_void,
        offset: usize,
        stride: usize,
        count: usize,
    );
    fn rtcNewScene(device: Handle) -> Handle;
    fn rtcReleaseScene(scene: Handle);
    fn rtcCommitScene(scene: Handle);
    fn rtcSetSceneBuildQuality(scene: Handle, quality: c_uint);
    fn rtcSetSceneFlags(scene: Handle, flags: c_uint);
    fn rtcAttachGeometry(scene: Handle, geometry: Handle) -> c_uint;
    fn rtcIntersect1(scene: Handle, context: *mut Context, ray: *mut SingleHit);
    fn rtcIntersect4(valid: *const c_int, scene: Handle, context: *mut Context, rays: *mut PacketHit<4>);
    fn rtcIntersect8(valid: *const c_int, scene: Handle, context: *mut Context, rays: *mut PacketHit<8>);
    fn rtcIntersect16(valid: *const c_int, scene: Handle, context: *mut Context, rays: *mut PacketHit<16>);
    fn rtcIntersect1M(
        scene: Handle,
        context: *mut Context,
        rays: *mut SingleHit,
        count: c_uint,
        stride: usize,
    );
    fn rtcOccluded1(scene: Handle, context: *mut Context, ray: *mut Single);
    fn rtcOccluded4(valid: *const c_int, scene: Handle, context: *mut Context, rays: *mut Packet<4>);
    fn rtcOccluded8(valid: *const c_int, scene: Handle, context: *mut Context, rays: *mut Packet<8>);
    fn rtcOccluded16(valid: *const c_int, scene: Handle, context: *mut Context, rays: *mut Packet<16>);
    fn rtcOccluded1M(scene: Handle, context: *mut Context, rays: *mut Single, count: c_uint, stride: usize);
}

/// A device whose builds run on one thread.
pub struct Device {
    handle: Handle,
    /// Bytes that Embree holds now; behind the `Arc` around the device, so its address is fixed.
    bytes: AtomicIsize,
    /// The most that it held.
    peak: AtomicIsize,
}

// SAFETY: Embree's device functions may be called from any thread, and the counter is atomic.
unsafe impl Send for Device {}
// SAFETY: as above.
unsafe impl Sync for Device {}

unsafe extern "C" fn count_bytes(user: *mut c_void, bytes: isize, _after: bool) -> bool {
    // SAFETY: `user` points to a device that outlives all its allocations, see `Device::new`.
    let device = unsafe { &*user.cast::<Device>() };
    let held = device.bytes.fetch_add(bytes, Ordering::Relaxed) + bytes;
    device.peak.fetch_max(held, Ordering::Relaxed);
    true
}

impl Device {
    /// # Errors
    /// If Embree can't start on this machine.
    pub fn new() -> Result<Arc<Self>> {
        // SAFETY: the string ends with NUL.
        let handle = unsafe { rtcNewDevice(c"threads=1".as_ptr()) };
        if handle.is_null() {
            bail!("Embree doesn't start on this machine");
        }
        let device = Arc::new(Self { handle, bytes: AtomicIsize::new(0), peak: AtomicIsize::new(0) });
        let user = Arc::as_ptr(&device).cast_mut().cast();
        // SAFETY: the counters lie behind an `Arc`, hence don't move, and live until the device has been released.
        unsafe { rtcSetDeviceMemoryMonitorFunction(handle, Some(count_bytes), user) }
        Ok(device)
    }

    /// The most bytes that Embree held at a time.
    pub fn peak_bytes(&self) -> usize {
        usize::try_from(self.peak.load(Ordering::Relaxed)).unwrap_or(0)
    }

    fn check(&self, doing: &str) -> Result<()> {
        // SAFETY: the handle is valid as long as `self`.
        match unsafe { rtcGetDeviceError(self.handle) } {
            0 => Ok(()),
            code => bail!("Embree: error {code} while {doing}"),
        }
    }
}

impl Drop for Device {
    fn drop(&mut self) {
        // SAFETY: scenes hold the device by `Arc`, so none is left.
        unsafe {
            rtcSetDeviceMemoryMonitorFunction(self.handle, None, ptr::null_mut());
            rtcReleaseDevice(self.handle);
        }
    }
}

/// `RTCBuildQuality`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Quality {
    Medium = 1,
    High = 2,
}

/// What a scene must be able to do besides answering.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Feature {
    None,
    /// `RTC_SCENE_FLAG_ROBUST`.
    Robust,
    /// `RTC_SCENE_FLAG_CONTEXT_FILTER_FUNCTION`.
    Filter,
}

/// A committed scene of one mesh or surface.
pub struct Scene {
    handle: Handle,
    bytes: usize,
    // Released after the scene.
    _device: Arc<Device>,
    _buffers: Arc<dyn Any + Send + Sync>,
}

// SAFETY: Embree's scenes may be used from any thread.
unsafe impl Send for Scene {}
// SAFETY: a committed scene is never changed, and queries on it may run at the same time.
unsafe impl Sync for Scene {}

impl Scene {
    /// Builds and commits.
    ///
    /// # Errors
    /// What Embree reports, such as a lack of memory.
    pub fn build(
        device: &Arc<Device>,
        buffers: &Arc<Buffers>,
        quality: Quality,
        feature: Feature,
    ) -> Result<Self> {
        let before = device.bytes.load(Ordering::Relaxed);
        let flags = match feature {
            Feature::None => 0,
            Feature::Robust => SCENE_ROBUST,
            Feature::Filter => SCENE_CONTEXT_FILTER,
        };
        // SAFETY: handles are used as long as they live. The shared buffers have the stated number of elements, the vertex
        // buffer is padded as Embree asks, and both are kept by the scene.
        let handle = unsafe {
            let geometry = rtcNewGeometry(device.handle, TYPE_TRIANGLE);
            rtcSetGeometryBuildQuality(geometry, quality as c_uint);
            let (positions, triangles) = (&buffers.positions, &buffers.triangles);
            let (data, count) = (positions.as_ptr().cast(), positions.len() - 1);
            rtcSetSharedGeometryBuffer(geometry, BUFFER_VERTEX, 0, FORMAT_FLOAT3, data, 0, 12, count);
            let (data, count) = (triangles.as_ptr().cast(), triangles.len());
            rtcSetSharedGeometryBuffer(geometry, BUFFER_INDEX, 0, FORMAT_UINT3, data, 0, 12, count);
            rtcCommitGeometry(geometry);
            let scene = rtcNewScene(device.handle);
            rtcSetSceneBuildQuality(scene, quality as c_uint);
            rtcSetSceneFlags(scene, flags);
            rtcAttachGeometry(scene, geometry);
            rtcReleaseGeometry(geometry);
            rtcCommitScene(scene);
            scene
        };
        let bytes = device.bytes.load(Ordering::Relaxed) - before;
        let scene = Self {
            handle,
            bytes: usize::try_from(bytes).unwrap_or(0),
            _device: Arc::clone(device),
            _buffers: Arc::clone(buffers) as _,
        };
        device.check("building a scene")?;
        Ok(scene)
    }

    /// Tessellates a Catmull-Clark surface, boundaries as creases, builds and commits.
    ///
    /// # Errors
    /// What Embree reports, such as a lack of memory.
    pub fn build_subdivision(device: &Arc<Device>, buffers: &Arc<ControlBuffers>) -> Result<Self> {
        let before = device.bytes.load(Ordering::Relaxed);
        // SAFETY: as in `build`; `ControlBuffers` has checked counts and indices.
        let handle = unsafe {
            let geometry = rtcNewGeometry(device.handle, TYPE_SUBDIVISION);
            let share = |kind, format, data: *const c_void, stride, count| {
                rtcSetSharedGeometryBuffer(geometry, kind, 0, format, data, 0, stride, count);
            };
            let ControlBuffers { positions, face_sizes, corners, levels } = &**buffers;
            share(BUFFER_VERTEX, FORMAT_FLOAT3, positions.as_ptr().cast(), 12, positions.len() - 1);
            share(BUFFER_FACE, FORMAT_UINT, face_sizes.as_ptr().cast(), 4, face_sizes.len());
            share(BUFFER_INDEX, FORMAT_UINT, corners.as_ptr().cast(), 4, corners.len());
            share(BUFFER_LEVEL, FORMAT_FLOAT, levels.as_ptr().cast(), 4, levels.len());
            rtcCommitGeometry(geometry);
            let scene = rtcNewScene(device.handle);
            rtcAttachGeometry(scene, geometry);
            rtcReleaseGeometry(geometry);
            rtcCommitScene(scene);
            scene
        };
        let bytes = device.bytes.load(Ordering::Relaxed) - before;
        let scene = Self {
            handle,
            bytes: usize::try_from(bytes).unwrap_or(0),
            _device: Arc::clone(device),
            _buffers: Arc::clone(buffers) as _,
        };
        device.check("building a surface")?;
        Ok(scene)
    }

    /// `rtcIntersect1` of each ray.
    pub fn intersect1(&self, query: &mut Query, rays: &mut [SingleHit]) {
        for ray in rays {
            // SAFETY: scene and context live; the ray is aligned by its type.
            unsafe { rtcIntersect1(self.handle, &mut query.context, ray) }
        }
    }

    /// `rtcIntersect4` of each packet.
    pub fn intersect4(&self, query: &mut Query, packets: &mut [PacketHit<4>]) {
        for packet in packets {
            // SAFETY: as above; the mask has four lanes and more.
            unsafe { rtcIntersect4(ALL_LANES.0.as_ptr(), self.handle, &mut query.context, packet) }
        }
    }

    /// `rtcIntersect8` of each packet.
    pub fn intersect8(&self, query: &mut Query, packets: &mut [PacketHit<8>]) {
        for packet in packets {
            // SAFETY: as above; the mask has eight lanes and more.
            unsafe { rtcIntersect8(ALL_LANES.0.as_ptr(), self.handle, &mut query.context, packet) }
        }
    }

    /// `rtcIntersect16` of each packet.
    pub fn intersect16(&self, query: &mut Query, packets: &mut [PacketHit<16>]) {
        for packet in packets {
            // SAFETY: as above; the mask has sixteen lanes.
            unsafe { rtcIntersect16(ALL_LANES.0.as_ptr(), self.handle, &mut query.context, packet) }
        }
    }

    /// `rtcIntersect1M` of all rays.
    pub fn intersect_stream(&self, query: &mut Query, rays: &mut [SingleHit]) {
        let count = u32::try_from(rays.len()).expect("workloads have fewer than 2^32 rays");
        // SAFETY: as above; `rays` holds `count` of them, densely.
        unsafe {
            rtcIntersect1M(self.handle, &mut query.context, rays.as_mut_ptr(), count, size_of::<SingleHit>())
        }
    }

    /// Bytes that Embree took for the scene and still held after the commit, shared buffers not counted.
    pub fn bytes(&self) -> usize {
        self.bytes
    }

    /// `rtcOccluded1` of each ray.
    pub fn occluded1(&self, query: &mut Query, rays: &mut [Single]) {
        for ray in rays {
            // SAFETY: scene and context live; the ray is aligned by its type.
            unsafe { rtcOccluded1(self.handle, &mut query.context, ray) }
        }
    }

    /// `rtcOccluded4` of each packet.
    pub fn occluded4(&self, query: &mut Query, packets: &mut [Packet<4>]) {
        for packet in packets {
            // SAFETY: as above; the mask has four lanes and more.
            unsafe { rtcOccluded4(ALL_LANES.0.as_ptr(), self.handle, &mut query.context, packet) }
        }
    }

    /// `rtcOccluded8` of each packet.
    pub fn occluded8(&self, query: &mut Query, packets: &mut [Packet<8>]) {
        for packet in packets {
            // SAFETY: as above; the mask has eight lanes and more.
            unsafe { rtcOccluded8(ALL_LANES.0.as_ptr(), self.handle, &mut query.context, packet) }
        }
    }

    /// `rtcOccluded16` of each packet.
    pub fn occluded16(&self, query: &mut Query, packets: &mut [Packet<16>]) {
        for packet in packets {
            // SAFETY: as above; the mask has sixteen lanes.
            unsafe { rtcOccluded16(ALL_LANES.0.as_ptr(), self.handle, &mut query.context, packet) }
        }
    }

    /// `rtcOccluded1M` of all rays.
    pub fn occluded_stream(&self, query: &mut Query, rays: &mut [Single]) {
        let count = u32::try_from(rays.len()).expect("workloads have fewer than 2^32 rays");
        // SAFETY: as above; `rays` holds `count` of them, densely.
        unsafe {
            rtcOccluded1M(self.handle, &mut query.context, rays.as_mut_ptr(), count, size_of::<Single>())
        }
    }
}

impl Drop for Scene {
    fn drop(&mut self) {
        // SAFETY: nobody else has the handle.
        unsafe { rtcReleaseScene(self.handle) }
    }
}

/// How a call traverses, and what it gathers.
#[repr(C)]
pub struct Query<'a> {
    /// First, so that the filter finds the rest behind it.
    context: Context,
    depths: *mut OpticalDepth,
    count: usize,
    opacity: OpticalDepth,
    gathers: PhantomData<&'a mut [OpticalDepth]>,
}

impl<'a> Query<'a> {
    /// For occlusion, which stops at the first occluder, and for closest hits.
    pub fn plain(coherent: bool) -> Self {
        let flags = if coherent { CONTEXT_COHERENT } else { 0 };
        Self {
            context: Context { flags, filter: None, instance: u32::MAX },
            depths: ptr::null_mut(),
            count: 0,
            opacity: OpticalDepth::OPAQUE,
            gathers: PhantomData,
        }
    }

    /// Stops at the first occluder whose front the ray meets. Scenes need [`Feature::Filter`].
    pub fn front_hit(coherent: bool) -> Self {
        let mut query = Self::plain(coherent);
        query.context.filter = Some(let_backs_pass);
        query
    }

    /// Adds `opacity` to the depth that a ray's `id` points to, for every report of a triangle, until it is opaque. Scenes
    /// need [`Feature::Filter`].
    pub fn transmittance(coherent: bool, depths: &'a mut [OpticalDepth], opacity: OpticalDepth) -> Self {
        let mut query = Self::plain(coherent);
        query.context.filter = Some(add_depth);
        Self { depths: depths.as_mut_ptr(), count: depths.len(), opacity, ..query }
    }
}

unsafe extern "C" fn let_backs_pass(arguments: *const FilterArguments) {
    // SAFETY: Embree passes a live structure; rays and hits have all their components for as many lanes as stated.
    unsafe {
        let arguments = &*arguments;
        let lanes = arguments.lanes as usize;
        let rays = arguments.ray.cast::<f32>();
        for lane in (0..lanes).filter(|&lane| *arguments.valid.add(lane) == -1) {
            let along = |axis: usize| {
                *rays.add((DIRECTION + axis) * lanes + lane) * *arguments.hit.add(axis * lanes + lane)
            };
            if along(0) + along(1) + along(2) >= 0.0 {
                *arguments.valid.add(lane) = 0;
            }
        }
    }
}

unsafe extern "C" fn add_depth(arguments: *const FilterArguments) {
    // SAFETY: Embree passes a live structure, whose context is that of the call: the head of a `Query`, since only
    // `Query::transmittance` installs this function. Lanes are as many as stated, in rays as in `valid`.
    unsafe {
        let arguments = &*arguments;
        let query = arguments.context.cast::<Query>();
        let lanes = arguments.lanes as usize;
        for lane in (0..lanes).filter(|&lane| *arguments.valid.add(lane) == -1) {
            let id = *arguments.ray.add(ID * lanes + lane) as usize;
            let keep_going = if id < (*query).count {
                let depth = &mut *(*query).depths.add(id);
                *depth += (*query).opacity;
                !depth.is_opaque()
            } else {
                false
            };
            if keep_going {
                *arguments.valid.add(lane) = 0;
            }
        }
    }
}
