//! Structures that are made when a method asks for them, and the list of what was made.

use super::{Occluders, PrefilteredParts as Parts};
use crate::{QueryError, engine::Report, far::FarOpacity, share_of};
use std::{
    collections::HashMap,
    sync::{Arc, Mutex, MutexGuard},
    time::{Duration, Instant},
};
use umbrage_aomask::{MaskTables, Pattern, TableOptions};
use umbrage_geom::{OpticalDepth, TriangleMesh};
use umbrage_occlusion::{
    prefilter::{PrefilterOptions, Prefiltered},
    volumetric::{KdVolumetric, KdVolumetricOptions, Object, ObjectMesh},
};

/// A structure over occluders.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Structure {
    /// The wide BVH, with two levels where instances are kept apart.
    Bvh,
    /// The kd-tree with its opaque cells.
    KdTree,
    /// Boxes inside solids, and packs of them at nodes of the wide BVH.
    SolidBoxes,
    /// Hierarchies whose nodes have stored opacity.
    Prefiltered,
    /// The grid of stored opacity far away.
    FarOpacity,
    /// Tables of masks.
    MaskTables,
}

impl Structure {
    /// Every structure.
    pub const ALL: [Self; 6] =
        [Self::Bvh, Self::KdTree, Self::SolidBoxes, Self::Prefiltered, Self::FarOpacity, Self::MaskTables];

    /// Its name in statistics.
    pub fn name(self) -> &'static str {
        match self {
            Self::Bvh => "bvh",
            Self::KdTree => "kd-tree",
            Self::SolidBoxes => "solid-boxes",
            Self::Prefiltered => "prefiltered",
            Self::FarOpacity => "far-opacity",
            Self::MaskTables => "mask-tables",
        }
    }
}

/// How a structure was made.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct BuildCost {
    /// How long it took; `None` for what grows while rays are traced.
    pub time: Option<Duration>,
    /// How much memory it holds; `None` for what grows while rays are traced.
    pub bytes: Option<usize>,
}

/// Prefiltered hierarchies over all parts.
#[derive(Clone)]
pub(crate) struct PrefilteredParts {
    /// One for each part and set of opacities in use.
    pub scenes: Vec<Arc<Prefiltered>>,
    /// Which of them each instance has; one number for one mesh.
    pub of_instance: Vec<u32>,
}

/// What was made so far.
#[derive(Default)]
pub(super) struct StructuresOnDemand {
    made: Mutex<[Option<BuildCost>; Structure::ALL.len()]>,
    kd_tree: Mutex<Option<Arc<KdVolumetric>>>,
    prefiltered: Mutex<Option<Parts>>,
    far_opacity: Mutex<Option<Arc<FarOpacity>>>,
}

fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(|poisoned| poisoned.into_inner())
}

impl StructuresOnDemand {
    /// Writes down that `structure` was made.
    pub(super) fn note(&self, structure: Structure, made: BuildCost) {
        locked(&self.made)[structure as usize] = Some(made);
    }

    /// Makes `structure`, of which `make` says the bytes, and writes that down.
    pub(super) fn time<T, E>(
        &self,
        structure: Structure,
        make: impl FnOnce() -> Result<(T, usize), E>,
    ) -> Result<T, E> {
        let start = Instant::now();
        let (value, bytes) = make()?;
        self.note(structure, BuildCost { time: Some(start.elapsed()), bytes: Some(bytes) });
        Ok(value)
    }

    /// What is in `slot`, made by the first call.
    fn once<T: Clone>(
        &self,
        slot: &Mutex<Option<T>>,
        structure: Structure,
        make: impl FnOnce() -> Result<(T, usize), QueryError>,
    ) -> Result<T, QueryError> {
        let mut slot = locked(slot);
        if let Some(value) = &*slot {
            return Ok(value.clone());
        }
        let value = self.time(structure, make)?;
        *slot = Some(value.clone());
        Ok(value)
    }
}

/// The objects of an opaque mesh, each of which may be a solid.
pub(crate) fn solids(mesh: &TriangleMesh) -> Vec<Object> {
    let objects = mesh.objects_or_whole().into_iter();
    objects.map(|object| Object { triangles: object.triangles, opaque: true }).collect()
}

impl Occluders {
    /// Every structure with how it was made; `None` for those that nobody has asked for.
    pub fn structures(&self) -> [(Structure, Option<BuildCost>); Structure::ALL.len()] {
        let made = locked(&self.demand.made);
        Structure::ALL.map(|structure| (structure, made[structure as usize]))
    }

    /// Writes down that an engine has made `structure` for itself.
    pub(crate) fn note(&self, structure: Structure, time: Option<Duration>, bytes: Option<usize>) {
        self.demand.note(structure, BuildCost { time, bytes });
    }

    /// The kd-tree of opaque triangles in one mesh; `None` for others. Built by the first call.
    pub(crate) fn kd_tree(&self, progress: Report<'_>) -> Result<Option<Arc<KdVolumetric>>, QueryError> {
        let Some((_, mesh)) = self.flat_opaque() else { return Ok(None) };
        let make = || {
            let options = KdVolumetricOptions::default();
            let parts = ObjectMesh::new(&mesh.positions, &mesh.triangles).with_objects(solids(mesh));
            let kd = KdVolumetric::build(&parts, &options, progress)?;
            let bytes = kd.bytes();
            Ok((Arc::new(kd), bytes))
        };
        self.demand.once(&self.demand.kd_tree, Structure::KdTree, make).map(Some)
    }

    /// Stored opacity of triangles in one mesh; `None` where instances are kept apart. Built by the first call.
    pub(crate) fn far_opacity(&self, progress: Report<'_>) -> Result<Option<Arc<FarOpacity>>, QueryError> {
        if self.flat().is_none() {
            return Ok(None);
        }
        let mesh = &self.parts[0].mesh;
        let make = || {
            let opacity = |prim| 1.0 - self.flat_depth(prim).transmittance();
            let count = if self.is_opaque() { 0 } else { mesh.triangles.len() as u32 };
            let opacities: Vec<f32> = (0..count).map(opacity).collect();
            let far = FarOpacity::build(mesh, &opacities, progress)?;
            let bytes = far.bytes();
            Ok((Arc::new(far), bytes))
        };
        self.demand.once(&self.demand.far_opacity, Structure::FarOpacity, make).map(Some)
    }

    /// Tables of a pattern, which belong to whoever asks.
    pub(crate) fn mask_tables(&self, pattern: Pattern) -> Result<Box<MaskTables>, QueryError> {
        self.demand.time(Structure::MaskTables, || {
            let tables = MaskTables::new(pattern, &TableOptions::default())?;
            let bytes = tables.bytes();
            Ok((Box::new(tables), bytes))
        })
    }

    /// Prefiltered hierarchies over all parts, with the opacities of their objects. Built by the first call.
    pub(crate) fn prefiltered(&self, progress: Report<'_>) -> Result<Parts, QueryError> {
        let make = || {
            let parts = self.prefilter_parts(progress)?;
            let bytes = |scene: &Arc<Prefiltered>| {
                let bytes = scene.bytes();
                bytes.hierarchy + bytes.opacities + bytes.triangle_opacities
            };
            let bytes = parts.scenes.iter().map(bytes).sum();
            Ok((parts, bytes))
        };
        self.demand.once(&self.demand.prefiltered, Structure::Prefiltered, make)
    }

    fn prefilter_parts(&self, progress: Report<'_>) -> Result<Parts, QueryError> {
        let mut known: HashMap<(usize, Vec<u32>), u32> = HashMap::new();
        let mut jobs: Vec<(usize, Vec<u32>)> = Vec::new();
        let mut of_instance = Vec::with_capacity(self.placed.len());
        for placed in &self.placed {
            let opacity = |o: &(u32, OpticalDepth)| (1.0 - o.1.transmittance()).to_bits();
            let key = (placed.part, placed.objects.iter().map(opacity).collect::<Vec<u32>>());
            let next = known.len() as u32;
            of_instance.push(*known.entry(key.clone()).or_insert_with(|| {
                jobs.push(key);
                next
            }));
        }
        let build = |(number, (part, opacities)): (usize, &(usize, Vec<u32>))| {
            let part = &self.parts[*part];
            let of_object = |&object: &u32| f32::from_bits(opacities[object as usize]);
            let of_triangle: Vec<f32> = part.object_of.iter().map(of_object).collect();
            let (mesh, options) = (&part.mesh, PrefilterOptions::default());
            let mut share = share_of(progress, number, jobs.len());
            let (positions, triangles) = (&mesh.positions, &mesh.triangles);
            let scene = Prefiltered::build(positions, triangles, &of_triangle, &options, &mut share)?;
            Ok(Arc::new(scene))
        };
        let scenes = jobs.iter().enumerate().map(build).collect::<Result<_, QueryError>>()?;
        Ok(Parts { scenes, of_instance })
    }
}
