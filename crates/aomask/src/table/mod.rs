//! Method `mask-table`: ambient occlusion by BVH traversal with masks from tables (`[Laine10]`, sections 3 and 5).
//!
//! Here: the tables of a pattern and the call that answers receivers. The parts have files of their own.
//!
//! Approximate: planes are rounded to cells of a table. `docs/aomask.md` has measured errors.

mod edge;
mod lanes;
pub(crate) mod node_mask;
mod plane;
mod traversal;
mod triangle_mask;

use node_mask::NodeMasks;

pub(crate) use lanes::{F8, V8};
pub(crate) use triangle_mask::{TriangleTables, Triangles};

use crate::{
    BackEnd, MaskError, MaskOptions, Outputs, Pattern, Receiver,
    drive::{self, Engine},
    gather::{self, Answers},
};
use edge::EdgeTable;
use node_mask::{NodeLookup, Silhouettes};
use plane::PlaneTable;
use traversal::{Scene, Stack};
use umbrage_accel::{Bvh, Counters, Statistics};
use umbrage_geom::{glam::Vec3, simd::Job};

/// Cells along each side of the cube map of silhouettes.
const RIMS: u32 = 40;

/// Settings of [`MaskTables`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct TableOptions {
    /// Cells along each side of the cube of planes, 8 to 256; 0 chooses by the number of rays.
    pub planes: u32,
    /// Cells along each side of the cube map of edges, 8 to 1024; 0 chooses by the number of rays. Equal to
    /// [`Self::planes`], edges have the cells that the paper gives them.
    pub edges: u32,
    /// How the rays that may meet a node are found; a comparison of the paper.
    pub node_masks: NodeMasks,
    /// What queries run on.
    pub back_end: BackEnd,
}

impl Default for TableOptions {
    fn default() -> Self {
        Self { planes: 0, edges: 0, node_masks: NodeMasks::default(), back_end: BackEnd::best() }
    }
}

impl TableOptions {
    /// Sets [`Self::planes`] and [`Self::edges`].
    #[must_use]
    pub fn with_resolutions(self, planes: u32, edges: u32) -> Self {
        Self { planes, edges, ..self }
    }

    /// Sets [`Self::node_masks`].
    #[must_use]
    pub fn with_node_masks(self, node_masks: NodeMasks) -> Self {
        Self { node_masks, ..self }
    }

    /// Sets [`Self::back_end`].
    #[must_use]
    pub fn with_back_end(self, back_end: BackEnd) -> Self {
        Self { back_end, ..self }
    }
}

/// The tables of a pattern. They know nothing of the scene or the radius.
#[derive(Clone, Debug)]
pub struct MaskTables {
    pattern: Pattern,
    options: TableOptions,
    silhouettes: Silhouettes,
    tables: Tables,
}

/// Tables with masks of as many words as the pattern needs, rounded up to a power of two.
#[derive(Clone, Debug)]
pub(crate) enum Tables {
    W1(TableSet<1>),
    W2(TableSet<2>),
    W4(TableSet<4>),
    W8(TableSet<8>),
    W16(TableSet<16>),
}

/// Calls `$body` with the set, whatever its size.
macro_rules! with_set {
    ($tables:expr, $set:ident => $body:expr) => {
        match $tables {
            $crate::table::Tables::W1($set) => $body,
            $crate::table::Tables::W2($set) => $body,
            $crate::table::Tables::W4($set) => $body,
            $crate::table::Tables::W8($set) => $body,
            $crate::table::Tables::W16($set) => $body,
        }
    };
}
pub(crate) use with_set;

#[derive(Clone, Debug)]
pub(crate) struct TableSet<const W: usize> {
    /// Edges of triangles, by directions.
    edges: EdgeTable<W>,
    /// Planes of triangles, by ends of rays in radii.
    planes: PlaneTable<W>,
    /// Circles around nodes, by directions; `None` if all lengths are 1 and [`Self::planes`] serves.
    circles: Option<PlaneTable<W>>,
    /// Silhouettes of nodes, by directions.
    rims: EdgeTable<W>,
}

impl<const W: usize> TableSet<W> {
    fn build(pattern: &Pattern, options: &TableOptions) -> Self {
        let planes = |ends: &[Vec3]| PlaneTable::build(ends, options.planes, options.back_end);
        let directions = pattern.directions(0);
        let ends: Vec<Vec3> =
            directions.iter().zip(pattern.lengths(0)).map(|(&d, &length)| d * length).collect();
        Self {
            edges: EdgeTable::nearest(directions, options.edges, options.back_end),
            planes: planes(&ends),
            circles: (!pattern.has_equal_lengths()).then(|| planes(directions)),
            rims: EdgeTable::conservative(directions, RIMS, options.back_end),
        }
    }

    fn directions(&self) -> &PlaneTable<W> {
        self.circles.as_ref().unwrap_or(&self.planes)
    }

    pub(crate) fn triangle_tables(&self) -> TriangleTables<'_, W> {
        TriangleTables { edges: &self.edges, planes: &self.planes, directions: self.directions() }
    }

    fn bytes(&self) -> usize {
        let circles = self.circles.as_ref().map_or(0, PlaneTable::bytes);
        self.edges.bytes() + self.planes.bytes() + circles + self.rims.bytes()
    }
}

impl MaskTables {
    /// Fills the tables of `pattern`, which has one member ([`crate::Points::Middles`] or [`crate::Points::Relaxed`]), on all
    /// threads of the caller's pool.
    ///
    /// # Errors
    /// [`MaskError::Family`], [`MaskError::Rays`], [`MaskError::Resolution`]; [`MaskError::BackEnd`] if this processor lacks the one asked for.
    pub fn new(pattern: Pattern, options: &TableOptions) -> Result<Self, MaskError> {
        pattern.check_masks()?;
        if pattern.members() > 1 {
            return Err(MaskError::Family(pattern.members()));
        }
        let mut options = *options;
        let (planes, edges) = default_resolutions(pattern.len());
        for (what, value, default, limit) in
            [("planes", &mut options.planes, planes, 256), ("edges", &mut options.edges, edges, 1024)]
        {
            if *value == 0 {
                *value = default;
            }
            if !(8..=limit).contains(value) {
                return Err(MaskError::Resolution { what, value: *value, limit });
            }
        }
        if !options.back_end.is_supported() {
            return Err(MaskError::BackEnd(options.back_end));
        }
        let tables = match pattern.words().next_power_of_two() {
            1 => Tables::W1(TableSet::build(&pattern, &options)),
            2 => Tables::W2(TableSet::build(&pattern, &options)),
            4 => Tables::W4(TableSet::build(&pattern, &options)),
            8 => Tables::W8(TableSet::build(&pattern, &options)),
            _ => Tables::W16(TableSet::build(&pattern, &options)),
        };
        Ok(Self { pattern, options, silhouettes: Silhouettes::new(), tables })
    }

    /// The pattern.
    pub fn pattern(&self) -> &Pattern {
        &self.pattern
    }

    /// The options, resolutions chosen.
    pub fn options(&self) -> TableOptions {
        self.options
    }

    /// Bytes that the tables hold.
    pub fn bytes(&self) -> usize {
        with_set!(&self.tables, set => set.bytes())
    }

    /// Ambient occlusion of `receivers` among the triangles of `bvh`; [`MaskOptions::seed`] is not used. Results depend on the
    /// arguments only, not on threads or back end. `progress` gets growing fractions that end at exactly 1, from any thread, and
    /// returns `false` to cancel.
    ///
    /// # Errors
    /// [`MaskError::Radius`], [`MaskError::FalloffWithoutRadius`], [`MaskError::Length`], [`MaskError::Unsupported`],
    /// [`MaskError::Cancelled`]. The outputs are as they were then.
    pub fn answer(
        &self,
        bvh: &Bvh,
        receivers: &[Receiver],
        options: &MaskOptions,
        outputs: Outputs<'_>,
        progress: &mut (dyn FnMut(f32) -> bool + Send),
    ) -> Result<(), MaskError> {
        options.validate_for_tables(&self.pattern)?;
        outputs.validate_for_tables()?;
        with_set!(&self.tables, set => {
            let engine = Walker { tables: self, scene: self.scene(set, bvh, options) };
            drive::run(&engine, &self.pattern, options, receivers, outputs, progress)
        })
    }

    /// Ambient occlusion (1 is open) of one receiver, for callers with threads of their own.
    ///
    /// # Errors
    /// [`MaskError::Radius`], [`MaskError::FalloffWithoutRadius`].
    pub fn ao(&self, bvh: &Bvh, receiver: &Receiver, options: &MaskOptions) -> Result<f32, MaskError> {
        options.validate_for_tables(&self.pattern)?;
        let mut mask = [0; Pattern::MAX_MASK_RAYS as usize / 64];
        let masks = &mut mask[..self.pattern.words()];
        with_set!(&self.tables, set => {
            let scene = self.scene(set, bvh, options);
            let receivers = std::slice::from_ref(receiver);
            let block = Block { tables: self, scene: &scene, receivers, masks, stack: &mut Vec::new() };
            self.options.back_end.run(Counted { block, stats: &mut () });
        });
        Ok(gather::openness(&self.pattern, masks))
    }

    /// Work of [`Self::answer`] on one thread.
    ///
    /// # Errors
    /// [`MaskError::Radius`], [`MaskError::FalloffWithoutRadius`].
    pub fn count(
        &self,
        bvh: &Bvh,
        receivers: &[Receiver],
        options: &MaskOptions,
    ) -> Result<Counters, MaskError> {
        options.validate_for_tables(&self.pattern)?;
        let mut counters = Counters::default();
        with_set!(&self.tables, set => {
            let scene = self.scene(set, bvh, options);
            let mut masks = vec![0; receivers.len() * self.pattern.words()];
            let stack = &mut Vec::new();
            let block = Block { tables: self, scene: &scene, receivers, masks: &mut masks, stack };
            self.options.back_end.run(Counted { block, stats: &mut counters });
        });
        Ok(counters)
    }

    pub(crate) fn sets(&self) -> &Tables {
        &self.tables
    }

    /// Rays of no length, and bits without a ray: they count as blocked from the start.
    pub(crate) fn closed_rays<const W: usize>(&self) -> [u64; W] {
        let mut closed = [!0; W];
        for (i, _) in self.pattern.lengths(0).iter().enumerate().filter(|&(_, &length)| length > 0.0) {
            closed[i / 64] &= !(1 << (i % 64));
        }
        closed
    }

    fn scene<'a, const W: usize>(
        &'a self,
        set: &'a TableSet<W>,
        bvh: &'a Bvh,
        options: &MaskOptions,
    ) -> Scene<'a, W> {
        let (directions, ends) = (set.directions(), set.circles.as_ref().map(|_| &set.planes));
        Scene {
            view: bvh.view(),
            bounds: bvh.bounds(),
            pattern: &self.pattern,
            triangles: set.triangle_tables(),
            nodes: NodeLookup { directions, ends, rims: &set.rims, silhouettes: &self.silhouettes },
            node_masks: self.options.node_masks,
            radius: options.radius,
            sides: options.sides,
        }
    }
}

/// Cells along each side of the tables of planes and of edges: as many as a mean error below 1/255 at a tenth of the
/// scene's diagonal needs in sibenik. The planes are what that error depends on.
fn default_resolutions(rays: usize) -> (u32, u32) {
    match rays {
        0..=128 => (96, 192),
        129..=256 => (72, 160),
        257..=512 => (72, 144),
        _ => (72, 128),
    }
}

/// Receivers walking the BVH.
struct Walker<'a, const W: usize> {
    tables: &'a MaskTables,
    scene: Scene<'a, W>,
}

impl<const W: usize> Engine for Walker<'_, W> {
    type Scratch = Stack<W>;

    fn scratch(&self) -> Stack<W> {
        Vec::new()
    }

    fn answer(&self, receivers: &[Receiver], answers: &mut Answers, stack: &mut Stack<W>) {
        let masks = &mut answers.masks[..];
        let block = Block { tables: self.tables, scene: &self.scene, receivers, masks, stack };
        self.tables.options.back_end.run(Counted { block, stats: &mut () });
    }
}

/// A block of receivers, [`Pattern::words`] words of `masks` each.
struct Block<'a, 's, const W: usize> {
    tables: &'a MaskTables,
    scene: &'a Scene<'s, W>,
    receivers: &'a [Receiver],
    masks: &'a mut [u64],
    stack: &'a mut Stack<W>,
}

struct Counted<'a, 's, const W: usize, S> {
    block: Block<'a, 's, W>,
    stats: &'a mut S,
}

impl<const W: usize, S: Statistics> Job for Counted<'_, '_, W, S> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Block { tables, scene, receivers, masks, stack } = self.block;
        let pattern = &tables.pattern;
        let closed = tables.closed_rays();
        for (receiver, out) in receivers.iter().zip(masks.chunks_mut(pattern.words())) {
            let blocked = scene.blocked(receiver, closed, stack, self.stats);
            out.iter_mut().enumerate().for_each(|(w, out)| *out = blocked[w] & !closed[w]);
        }
    }
}
