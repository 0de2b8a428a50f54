//! The hierarchy that callers hold: build, refit, queries.

use super::{
    Correlation, Directions, PrefilterError, PrefilterOptions, Query, Storage,
    correlation::may_stop,
    fan::{self, FAN, Fans, SMALLEST},
    kernel::{self, Job, Kernel, Prepared},
    opacity::{averages, measure, sphere_areas},
    packet::{PACKET, Packet},
    query::Cones,
    storage::{Harmonics, Stored, Table, with_table},
    walk::{Depths, Scene, StopStatistics},
    wide::Wide,
};
use std::ops::Range;
use umbrage_accel::{BinaryTree, BuildError};
use umbrage_geom::{
    Aabb, Progress, Ray,
    mesh::{validate_positions, validate_slices},
};

/// A ray that stands for a bundle of directions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ConeRay {
    /// The segment. Invalid ones pass, as everywhere.
    pub ray: Ray,
    /// Solid angle of the bundle, steradians; 0, negative and NaN mean a single direction, which is answered exactly.
    pub solid_angle: f32,
}

/// Memory of a prefiltered hierarchy.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Bytes {
    /// Nodes, leaves and indices: what exact queries need.
    pub hierarchy: usize,
    /// Opacities, and which nodes may have one.
    pub opacities: usize,
    /// Opacities of single triangles; 0 if all have the same.
    pub triangle_opacities: usize,
}

/// An 8-wide hierarchy over triangles with a directional opacity in every node that may end rays.
///
/// Approximate unless asked with [`Query::EXACT`], or for rays of solid angle 0: those answers are the bits of
/// [`umbrage_accel::Bvh::transmittance`]. Results don't depend on the number of threads.
///
/// # Source
/// `[Lacewell08]`; `docs/prefilter.md` lists the departures and what each one is worth.
#[derive(Clone, Debug)]
pub struct Prefiltered {
    pub(crate) wide: Wide,
    pub(crate) depths: Depths,
    pub(crate) stored: Stored,
    /// A bit for each child that may end rays.
    masks: Vec<u8>,
    directions: Directions,
    options: PrefilterOptions,
    triangles: usize,
    vertices: usize,
}

fn check_opacity(opacity: &[f32], triangles: usize) -> Result<(), PrefilterError> {
    if opacity.len() != 1 && opacity.len() != triangles {
        return Err(PrefilterError::OpacityCount { count: opacity.len(), triangles });
    }
    match opacity.iter().position(|a| !(0.0..=1.0).contains(a)) {
        Some(index) => Err(PrefilterError::Opacity { index, value: opacity[index] }),
        None => Ok(()),
    }
}

impl Prefiltered {
    /// Builds the tree over all `triangles` and measures its opacities. `opacity` is what one crossing of a triangle blocks:
    /// one value for all triangles, or one each. `progress` gets growing fractions that end at exactly 1 and returns `false`
    /// to cancel.
    ///
    /// # Errors
    /// [`PrefilterError::Mesh`] as from [`validate_slices`], an empty mesh among them; [`PrefilterError::Opacity`],
    /// [`PrefilterError::OpacityCount`]; those of [`PrefilterOptions::validate`]; [`PrefilterError::Build`];
    /// [`PrefilterError::Cancelled`].
    pub fn build(
        positions: &[[f32; 3]],
        triangles: &[[u32; 3]],
        opacity: &[f32],
        options: &PrefilterOptions,
        progress: &mut (dyn FnMut(f32) -> bool + Send),
    ) -> Result<Self, PrefilterError> {
        let directions = options.validate()?;
        validate_slices(positions, triangles)?;
        check_opacity(opacity, triangles.len())?;
        let corners = |prim: u32| triangles[prim as usize].map(|v| positions[v as usize]);
        let boxes: Vec<Aabb> =
            (0..triangles.len() as u32).map(|prim| Aabb::from_points(&corners(prim))).collect();
        let tree = BinaryTree::build(&boxes, options.quality)?;
        drop(boxes);
        let (mut wide, sources) = Wide::collapse(&tree, triangles);
        wide.fill(positions);
        let depths = Depths::new(opacity, &wide);
        let masks = may_stop(options.correlation, &wide, &tree, &sources, positions, triangles);
        drop((tree, sources));
        let progress = Progress::new(wide.nodes.len() as u64, progress);
        let stored = stored(&mut wide, &depths, directions, &masks, options, &progress)?;
        progress.finish()?;
        let (triangles, vertices) = (triangles.len(), positions.len());
        Ok(Self { wide, depths, stored, masks, directions, options: *options, triangles, vertices })
    }

    /// Moves the vertices, keeps the tree and measures opacities again; takes linear time. Which nodes may end rays stays as
    /// it was: that follows from what is connected, and from sizes at the build.
    ///
    /// # Errors
    /// [`PrefilterError::Build`] unless there are as many `positions` as at the build; [`PrefilterError::Mesh`] for
    /// coordinates as from [`validate_positions`]. Nothing has moved then. [`PrefilterError::Cancelled`]: vertices have
    /// moved, opacities have not; answers other than exact ones mean nothing until another refit succeeds.
    pub fn refit(
        &mut self,
        positions: &[[f32; 3]],
        progress: &mut (dyn FnMut(f32) -> bool + Send),
    ) -> Result<(), PrefilterError> {
        let (count, expected) = (positions.len(), self.vertices);
        if count != expected {
            return Err(BuildError::Count { what: "vertices", count, expected }.into());
        }
        validate_positions(positions)?;
        let wide = &mut self.wide;
        wide.fill(positions);
        let progress = Progress::new(wide.nodes.len() as u64, progress);
        self.stored = stored(wide, &self.depths, self.directions, &self.masks, &self.options, &progress)?;
        progress.finish()?;
        Ok(())
    }

    /// Fraction of light that passes along `ray`, in `[0, 1]`.
    pub fn transmittance(&self, ray: &ConeRay, query: &Query) -> f32 {
        self.transmittance_with(ray, query, &mut ())
    }

    /// [`Self::transmittance`], counted.
    pub fn transmittance_with(&self, ray: &ConeRay, query: &Query, stats: &mut impl StopStatistics) -> f32 {
        let mut passed = [1.0];
        self.answer(std::slice::from_ref(ray), query, &mut passed, stats);
        passed[0]
    }

    /// [`Self::transmittance`] of each ray. With the `rayon` feature, over all threads of the caller's pool.
    ///
    /// # Panics
    /// If the slices differ in length.
    pub fn transmittances(&self, rays: &[ConeRay], query: &Query, passed: &mut [f32]) {
        assert_eq!(rays.len(), passed.len(), "as many answers as rays");
        #[cfg(feature = "rayon")]
        {
            use rayon::prelude::*;
            let chunks = rays.par_chunks(1 << 11).zip(passed.par_chunks_mut(1 << 11));
            chunks.for_each(|(rays, passed)| self.answer(rays, query, passed, &mut ()));
        }
        #[cfg(not(feature = "rayon"))]
        self.answer(rays, query, passed, &mut ());
    }

    /// [`Self::transmittances`], counted, on this thread alone.
    ///
    /// # Panics
    /// If the slices differ in length.
    pub fn transmittances_with(
        &self,
        rays: &[ConeRay],
        query: &Query,
        passed: &mut [f32],
        stats: &mut impl StopStatistics,
    ) {
        assert_eq!(rays.len(), passed.len(), "as many answers as rays");
        self.answer(rays, query, passed, stats);
    }

    fn answer<S: StopStatistics>(&self, rays: &[ConeRay], query: &Query, passed: &mut [f32], stats: &mut S) {
        with_table!(&self.stored, table => {
            let scene = Scene { wide: &self.wide, depths: &self.depths, table };
            kernel::run(Answer { scene, directions: self.directions, rays, query, passed, stats });
        });
    }

    /// Smallest box around all triangles.
    pub fn bounds(&self) -> Aabb {
        self.wide.nodes[0].bounds()
    }

    /// Number of triangles.
    pub fn prim_count(&self) -> usize {
        self.triangles
    }

    /// Number of levels of nodes.
    pub fn levels(&self) -> usize {
        self.wide.levels.len()
    }

    /// How it was built.
    pub fn options(&self) -> &PrefilterOptions {
        &self.options
    }

    /// Memory it holds.
    pub fn bytes(&self) -> Bytes {
        Bytes {
            hierarchy: self.wide.bytes(),
            opacities: self.stored.bytes() + size_of_val(&self.masks[..]),
            triangle_opacities: self.depths.bytes(),
        }
    }

    /// Part of the nodes' children, leaves included, that may end rays.
    pub fn stop_share(&self) -> f64 {
        let stops: u32 = self.masks.iter().map(|m| m.count_ones()).sum();
        let all: usize = self.wide.nodes.iter().map(|node| node.len()).sum();
        f64::from(stops) / all as f64
    }
}

/// Opacities in the form that `options` name.
fn stored(
    wide: &mut Wide,
    depths: &Depths,
    directions: Directions,
    masks: &[u8],
    options: &PrefilterOptions,
    progress: &Progress,
) -> Result<Stored, PrefilterError> {
    let nodes = wide.nodes.len();
    Ok(match options.storage {
        Storage::CubeU8 => Stored::U8(measure(wide, depths, directions, masks, options, progress)?),
        Storage::SphereArea => Stored::U8(sphere_areas(wide, depths, masks)),
        form => {
            let cube = measure::<f32>(wide, depths, directions, masks, options, progress)?;
            match form {
                Storage::Harmonics2 => Stored::Harmonics2(Harmonics::project(&cube, directions)),
                Storage::Harmonics4 => Stored::Harmonics4(Harmonics::project(&cube, directions)),
                Storage::Average => Stored::U8(averages(&cube, directions, nodes)),
                _ => Stored::F32(cube),
            }
        }
    })
}

/// Answers rays: in fans where they share an origin, else in packets.
struct Answer<'a, T, S> {
    scene: Scene<'a, T>,
    directions: Directions,
    rays: &'a [ConeRay],
    query: &'a Query,
    passed: &'a mut [f32],
    stats: &'a mut S,
}

impl<T: Table, S: StopStatistics> Job for Answer<'_, T, S> {
    type Output = ();

    #[inline(always)]
    fn run<K: Kernel>(self, kernel: K) {
        let Self { scene, directions, rays, query, passed, stats } = self;
        if let ([cone], [passed]) = (rays, &mut *passed) {
            let Cones { kappa: [kappa], raise, cells: [cell], .. } = Cones::<1>::new(query, directions, rays);
            *passed = Prepared::new(&cone.ray, kappa, raise).map_or(1.0, |prepared| {
                let view = scene.table.view(cell, cone.ray.direction);
                scene.walk(kernel, 0, &cone.ray, &prepared, view, stats)
            });
            return;
        }
        let mut packet = Packet::new();
        let mut others = |range: Range<usize>, passed: &mut [f32], stats: &mut S| {
            packet.answer(kernel, &scene, directions, &rays[range.clone()], query, &mut passed[range], stats);
        };
        let mut fans = Fans::new();
        let mut ranges = Vec::new();
        let mut at = 0;
        while at < rays.len() {
            let rest = &rays[at..];
            let mut end = same_origin(rest);
            if end >= SMALLEST && rest[0].ray.origin.is_finite() {
                ranges.push(at..at + end);
            } else {
                while end < rest.len().min(PACKET) && same_origin(&rest[end..]) < SMALLEST {
                    end += 1;
                }
                end = end.min(PACKET);
                others(at..at + end, passed, stats);
            }
            at += end;
        }
        fan::answer(kernel, &scene, directions, rays, query, passed, &mut fans, ranges.into_iter(), stats);
        fans.left.iter().for_each(|&i| others(i..i + 1, passed, stats));
    }
}

/// Rays at the start of `rays` whose origins have the same bits, [`FAN`] at most.
#[inline]
fn same_origin(rays: &[ConeRay]) -> usize {
    let bits = |cone: &ConeRay| cone.ray.origin.to_array().map(f32::to_bits);
    let first = rays.first().map(bits);
    rays.iter().take(FAN).take_while(|cone| Some(bits(cone)) == first).count()
}

/// The correlation height of [`PrefilterOptions`] that lets every node end rays.
impl Correlation {
    /// Every node may end rays, single triangles excepted.
    pub const ANYWHERE: Self = Self::Height(0.0);
}
