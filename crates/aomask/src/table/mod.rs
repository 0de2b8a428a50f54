//! Method `mask-table`: ambient occlusion by BVH traversal with masks from tables ([Laine10], sections 3 and 5).
//!
//! Here: the tables of a pattern and the call that answers receivers. The parts have files of their own.
//!
//! Approximate: planes are rounded to cells of a table. `docs/aomask.md` has measured errors.

mod node_mask;
mod plane;
mod statistics;
mod traversal;
mod triangle_mask;

pub use node_mask::NodeMasks;
pub use statistics::{TableCounters, TableStatistics};

use crate::{
    BackEnd, MaskError, MaskOptions, Outputs, Pattern, Receiver,
    drive::{self, Engine},
    kernel::Job,
};
use node_mask::{NodeLookup, Silhouettes};
use plane::PlaneTable;
use traversal::{Scene, Stack};
use umbrage_accel::Bvh;
use umbrage_geom::glam::Vec3;

/// Settings of [`MaskTables`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct TableOptions {
    /// Cells along each side of the table, 8 to 256; 0 chooses by the number of rays.
    pub resolution: u32,
    /// How the rays that may meet a node are found.
    pub node_masks: NodeMasks,
    /// What queries run on.
    pub back_end: BackEnd,
}

impl Default for TableOptions {
    fn default() -> Self {
        Self { resolution: 0, node_masks: NodeMasks::default(), back_end: BackEnd::best() }
    }
}

impl TableOptions {
    /// Sets [`Self::resolution`].
    #[must_use]
    pub fn with_resolution(self, resolution: u32) -> Self {
        Self { resolution, ..self }
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
enum Tables {
    W1(Pair<1>),
    W2(Pair<2>),
    W4(Pair<4>),
    W8(Pair<8>),
    W16(Pair<16>),
}

/// Calls `$body` with the pair, whatever its size.
macro_rules! with_pair {
    ($tables:expr, $pair:ident => $body:expr) => {
        match $tables {
            Tables::W1($pair) => $body,
            Tables::W2($pair) => $body,
            Tables::W4($pair) => $body,
            Tables::W8($pair) => $body,
            Tables::W16($pair) => $body,
        }
    };
}

#[derive(Clone, Debug)]
struct Pair<const W: usize> {
    /// By ends of rays, in radii.
    ends: PlaneTable<W>,
    /// By directions; `None` if all lengths are 1.
    directions: Option<PlaneTable<W>>,
}

impl<const W: usize> Pair<W> {
    fn build(pattern: &Pattern, options: &TableOptions) -> Self {
        let build = |ends: &[Vec3]| PlaneTable::build(ends, options.resolution, options.back_end);
        let ends: Vec<Vec3> =
            pattern.directions().iter().zip(pattern.lengths()).map(|(&d, &length)| d * length).collect();
        let directions = (!pattern.has_equal_lengths()).then(|| build(pattern.directions()));
        Self { ends: build(&ends), directions }
    }

    fn bytes(&self) -> usize {
        self.ends.bytes() + self.directions.as_ref().map_or(0, PlaneTable::bytes)
    }
}

impl MaskTables {
    /// Fills the tables of `pattern`, on all threads of the caller's pool.
    ///
    /// # Errors
    /// [`MaskError::Resolution`]; [`MaskError::BackEnd`] if this processor lacks the one asked for.
    pub fn new(pattern: Pattern, options: &TableOptions) -> Result<Self, MaskError> {
        let mut options = *options;
        if options.resolution == 0 {
            options.resolution = default_resolution(pattern.len());
        }
        if !(8..=256).contains(&options.resolution) {
            return Err(MaskError::Resolution(options.resolution));
        }
        if !options.back_end.is_supported() {
            return Err(MaskError::BackEnd(options.back_end));
        }
        let tables = match pattern.words().next_power_of_two() {
            1 => Tables::W1(Pair::build(&pattern, &options)),
            2 => Tables::W2(Pair::build(&pattern, &options)),
            4 => Tables::W4(Pair::build(&pattern, &options)),
            8 => Tables::W8(Pair::build(&pattern, &options)),
            _ => Tables::W16(Pair::build(&pattern, &options)),
        };
        Ok(Self { pattern, options, silhouettes: Silhouettes::new(), tables })
    }

    /// The pattern.
    pub fn pattern(&self) -> &Pattern {
        &self.pattern
    }

    /// Cells along each side of the table.
    pub fn resolution(&self) -> u32 {
        self.options.resolution
    }

    /// Bytes that the tables hold.
    pub fn bytes(&self) -> usize {
        with_pair!(&self.tables, pair => pair.bytes())
    }

    /// Ambient occlusion of receivers at `points` (world units, see [`Receiver::new`]) that look along `normals` among the
    /// triangles of `bvh`. Results depend on the arguments only, not on threads or back end. `progress` gets growing
    /// fractions that end at exactly 1, from any thread, and returns `false` to cancel.
    ///
    /// # Errors
    /// [`MaskError::Radius`], [`MaskError::FalloffWithoutRadius`], [`MaskError::Length`], [`MaskError::Point`],
    /// [`MaskError::Normal`], [`MaskError::Cancelled`]. The outputs are as they were then.
    pub fn answer(
        &self,
        bvh: &Bvh,
        points: &[[f32; 3]],
        normals: &[[f32; 3]],
        options: &MaskOptions,
        outputs: Outputs<'_>,
        progress: &mut (dyn FnMut(f32) -> bool + Send),
    ) -> Result<(), MaskError> {
        with_pair!(&self.tables, pair => {
            let engine = Walker { tables: self, scene: self.scene(pair, bvh, options) };
            drive::run(&engine, &self.pattern, options, points, normals, outputs, progress)
        })
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
    ) -> Result<TableCounters, MaskError> {
        options.validate(&self.pattern)?;
        let mut counters = TableCounters::default();
        with_pair!(&self.tables, pair => {
            let scene = self.scene(pair, bvh, options);
            let mut masks = vec![0; receivers.len() * self.pattern.words()];
            let stack = &mut Vec::new();
            let block = Block { tables: self, scene: &scene, receivers, masks: &mut masks, stack };
            self.options.back_end.run(Counted { block, stats: &mut counters });
        });
        Ok(counters)
    }

    fn scene<'a, const W: usize>(
        &'a self,
        pair: &'a Pair<W>,
        bvh: &'a Bvh,
        options: &MaskOptions,
    ) -> Scene<'a, W> {
        let nodes = match &pair.directions {
            Some(directions) => {
                NodeLookup { directions, ends: Some(&pair.ends), silhouettes: &self.silhouettes }
            }
            None => NodeLookup { directions: &pair.ends, ends: None, silhouettes: &self.silhouettes },
        };
        Scene {
            view: bvh.view(),
            bounds: bvh.bounds(),
            pattern: &self.pattern,
            table: &pair.ends,
            nodes,
            node_masks: self.options.node_masks,
            radius: options.radius,
            sides: options.sides,
        }
    }
}

/// Tables of about 8 MB or less: those of the next larger resolution were slower on our scenes for less than half the error.
fn default_resolution(rays: usize) -> u32 {
    match rays {
        0..=64 => 96,
        65..=128 => 80,
        129..=256 => 64,
        257..=512 => 48,
        _ => 40,
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

    fn masks(&self, receivers: &[Receiver], masks: &mut [u64], stack: &mut Stack<W>) {
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

impl<const W: usize, S: TableStatistics> Job for Counted<'_, '_, W, S> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Block { tables, scene, receivers, masks, stack } = self.block;
        let pattern = &tables.pattern;
        // Rays of no length and bits without a ray count as blocked from the start.
        let mut closed = [!0; W];
        for (i, _) in pattern.lengths().iter().enumerate().filter(|&(_, &length)| length > 0.0) {
            closed[i / 64] &= !(1 << (i % 64));
        }
        for (receiver, out) in receivers.iter().zip(masks.chunks_mut(pattern.words())) {
            let blocked = scene.blocked(receiver, closed, stack, self.stats);
            out.iter_mut().enumerate().for_each(|(w, out)| *out = blocked[w] & !closed[w]);
        }
    }
}
