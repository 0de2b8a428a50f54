//! The hierarchy that callers hold: build, refit, queries.

use super::{
    ConeQuery, Directions, PrefilterOptions,
    correlation::may_stop,
    depths::Depths,
    fan::Answer,
    opacity::{levels, measure, sphere_areas},
    published::Storage,
    storage::{Cube, Harmonics, Stored, averages, with_table},
};
use crate::OcclusionError;
use umbrage_accel::{BuildError, BuildOptions, Bvh, NodeNote, Statistics};
use umbrage_geom::{Aabb, Progress, Ray, mesh::validate_slices};

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
pub struct PrefilteredBytes {
    /// Nodes, leaves and indices: what exact queries need.
    pub hierarchy: usize,
    /// Opacities, and which nodes may have one.
    pub opacities: usize,
    /// Opacities of single triangles; 0 if all have the same.
    pub triangle_opacities: usize,
}

/// A [`Bvh`] with a directional opacity in every node that may end rays.
///
/// Approximate unless asked with [`ConeQuery::EXACT`], or for rays of solid angle 0: those answers are the bits of
/// [`Bvh::transmittance`]. Results don't depend on the number of threads.
///
/// # Source
/// `[Lacewell08]`; `docs/prefilter.md` lists the departures and what each one is worth.
#[derive(Clone, Debug)]
pub struct Prefiltered {
    /// Notes have where a node's row of opacities starts, and the share of its size that each child counts with.
    bvh: Bvh,
    depths: Depths,
    stored: Stored,
    directions: Directions,
    options: PrefilterOptions,
}

fn check_opacity(opacity: &[f32], triangles: usize) -> Result<(), OcclusionError> {
    if opacity.len() != 1 && opacity.len() != triangles {
        return Err(OcclusionError::OpacityCount { count: opacity.len(), triangles });
    }
    match opacity.iter().position(|a| !(0.0..=1.0).contains(a)) {
        Some(index) => Err(OcclusionError::Opacity { index, value: opacity[index] }),
        None => Ok(()),
    }
}

impl Prefiltered {
    /// Builds the tree over all `triangles` and measures its opacities. `opacity` is what one crossing of a triangle blocks:
    /// one value for all triangles, or one each. `progress` gets growing fractions that end at exactly 1 and returns `false`
    /// to cancel.
    ///
    /// # Errors
    /// [`OcclusionError::Mesh`] as from [`validate_slices`], an empty mesh among them; [`OcclusionError::Opacity`],
    /// [`OcclusionError::OpacityCount`]; those of [`PrefilterOptions::validate`]; [`OcclusionError::Build`];
    /// [`OcclusionError::Cancelled`].
    pub fn build(
        positions: &[[f32; 3]],
        triangles: &[[u32; 3]],
        opacity: &[f32],
        options: &PrefilterOptions,
        progress: &mut (dyn FnMut(f32) -> bool + Send),
    ) -> Result<Self, OcclusionError> {
        let directions = options.validate()?;
        validate_slices(positions, triangles)?;
        check_opacity(opacity, triangles.len())?;
        let mut bvh =
            Bvh::build(positions, triangles, &BuildOptions::default().with_quality(options.quality))?;
        let depths = Depths::new(opacity, &bvh);
        let masks = may_stop(options.correlation, &bvh, positions, triangles);
        let progress = Progress::new(masks.len() as u64, progress);
        let stored = stored(&mut bvh, &depths, directions, &masks, options, &progress)?;
        progress.finish()?;
        Ok(Self { bvh, depths, stored, directions, options: *options })
    }

    /// Moves the vertices, keeps the tree and measures opacities again; takes linear time. Which nodes may end rays stays as
    /// it was: that follows from what is connected, and from sizes at the build.
    ///
    /// # Errors
    /// [`OcclusionError::Build`] unless there are as many `positions` as at the build; [`OcclusionError::Mesh`] for
    /// coordinates as from [`umbrage_geom::mesh::validate_positions`]. Nothing has moved then. [`OcclusionError::Cancelled`]: vertices have
    /// moved, opacities have not; answers other than exact ones mean nothing until another refit succeeds.
    pub fn refit(
        &mut self,
        positions: &[[f32; 3]],
        progress: &mut (dyn FnMut(f32) -> bool + Send),
    ) -> Result<(), OcclusionError> {
        self.bvh.refit(positions).map_err(|error| match error {
            BuildError::Mesh(error) => OcclusionError::Mesh(error),
            error => OcclusionError::Build(error),
        })?;
        let view = self.bvh.view();
        let mask = |node: u32| {
            let marks = view.node(node).note().marks;
            (0..8).fold(0, |mask, slot| mask | u8::from(marks[slot] != 0) << slot)
        };
        let masks: Vec<u8> = (0..view.node_count() as u32).map(mask).collect();
        let progress = Progress::new(masks.len() as u64, progress);
        self.stored = stored(&mut self.bvh, &self.depths, self.directions, &masks, &self.options, &progress)?;
        progress.finish()?;
        Ok(())
    }

    /// Fraction of light that passes along `ray`, in `[0, 1]`.
    pub fn transmittance(&self, ray: &ConeRay, query: &ConeQuery) -> f32 {
        self.transmittance_with(ray, query, &mut ())
    }

    /// [`Self::transmittance`], counted.
    pub fn transmittance_with(&self, ray: &ConeRay, query: &ConeQuery, stats: &mut impl Statistics) -> f32 {
        let mut passed = [1.0];
        self.answer(std::slice::from_ref(ray), query, &mut passed, stats);
        passed[0]
    }

    /// [`Self::transmittance`] of each ray. With the `rayon` feature, over all threads of the caller's pool.
    ///
    /// # Panics
    /// If the slices differ in length.
    pub fn transmittances(&self, rays: &[ConeRay], query: &ConeQuery, passed: &mut [f32]) {
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
        query: &ConeQuery,
        passed: &mut [f32],
        stats: &mut impl Statistics,
    ) {
        assert_eq!(rays.len(), passed.len(), "as many answers as rays");
        self.answer(rays, query, passed, stats);
    }

    fn answer(&self, rays: &[ConeRay], query: &ConeQuery, passed: &mut [f32], stats: &mut impl Statistics) {
        with_table!(&self.stored, table => {
            Answer::new((&self.bvh, &self.depths, table), self.directions, query, rays, passed).run(stats);
        });
    }

    /// The hierarchy, for exact queries of other kinds.
    pub fn bvh(&self) -> &Bvh {
        &self.bvh
    }

    /// Smallest box around all triangles.
    pub fn bounds(&self) -> Aabb {
        self.bvh.bounds()
    }

    /// Number of triangles.
    pub fn prim_count(&self) -> usize {
        self.bvh.prim_count()
    }

    /// Nodes by level, the root's first: what [`Statistics::ended_at_node`] names.
    pub fn levels(&self) -> Vec<Vec<u32>> {
        levels(&self.bvh)
    }

    /// How it was built.
    pub fn options(&self) -> &PrefilterOptions {
        &self.options
    }

    /// Memory it holds.
    pub fn bytes(&self) -> PrefilteredBytes {
        PrefilteredBytes {
            hierarchy: self.bvh.bytes(),
            opacities: self.stored.bytes(),
            triangle_opacities: self.depths.bytes(),
        }
    }

    /// Part of the nodes' children, leaves included, that may end rays.
    pub fn stop_share(&self) -> f64 {
        let view = self.bvh.view();
        let (mut stops, mut all) = (0, 0);
        for node in (0..view.node_count() as u32).map(|index| view.node(index)) {
            stops += node.note().marks.iter().filter(|&&mark| mark != 0).count();
            all += node.len();
        }
        stops as f64 / all as f64
    }
}

/// Gives each node that may end rays its row; returns the slots of all rows. Rows have even lengths.
fn place_rows(bvh: &mut Bvh, masks: &[u8]) -> usize {
    let mut slots = 0u32;
    for (node, mask) in masks.iter().enumerate() {
        bvh.set_note(node as u32, NodeNote { index: slots, marks: [0; 8] });
        slots += (u8::BITS - mask.leading_zeros()).next_multiple_of(2);
    }
    slots as usize
}

/// Opacities in the form that `options` name.
fn stored(
    bvh: &mut Bvh,
    depths: &Depths,
    directions: Directions,
    masks: &[u8],
    options: &PrefilterOptions,
    progress: &Progress,
) -> Result<Stored, OcclusionError> {
    let rows = (masks, place_rows(bvh, masks));
    Ok(match options.storage {
        Storage::CubeU4 => Stored::U4(measure(bvh, depths, directions, rows, options, progress)?),
        Storage::CubeU8 => Stored::U8(measure(bvh, depths, directions, rows, options, progress)?),
        Storage::SphereArea => Stored::U8(sphere_areas(bvh, depths, rows)),
        form => {
            let cube: Cube<f32> = measure(bvh, depths, directions, rows, options, progress)?;
            match form {
                Storage::Harmonics2 => Stored::Harmonics2(Harmonics::project(&cube, directions)),
                Storage::Harmonics4 => Stored::Harmonics4(Harmonics::project(&cube, directions)),
                Storage::Average => Stored::U8(averages(&cube, directions)),
                _ => Stored::F32(cube),
            }
        }
    })
}
