//! How a surface is traced.

use crate::{SurfaceError, rate::MAX_LEVEL};

/// Where along the ray the footprint that sets a patch's rate is taken (Djeu 2011, section 6.7).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum FootprintRule {
    /// Where the ray enters the patch's box, or leaves it if it converges (Christensen et al. 2006; Djeu 2011, 6.8).
    #[default]
    Entry,
    /// Where it meets the two triangles between the patch's corners, and at entry where it misses them
    /// (Djeu 2011, section 6.10). The threshold is met but for the curvature of the patch.
    FinalApproach,
    /// Where it enters the first of the patch's parts, split while that lowers the rate (Djeu 2011, section 6.9).
    ExactFinalApproach,
    /// By the edges of the patch, each at the place of the ray nearest to it (Owens et al. 2002): as many segments as their
    /// length in footprints. The inside of a patch is divided as its edges are and meets no threshold. Neighbours agree on
    /// their edge whatever [`Borders`] says.
    Edges,
    /// The same with lengths as the ray sees them, across its direction: an edge along the ray counts for nothing.
    ProjectedEdges,
    /// By edges, split where their parts ask for different rates (DiagSplit, Fisher et al. 2009).
    DiagSplit,
}

impl FootprintRule {
    /// Whether rates are those of edges, on which neighbours agree.
    pub fn is_by_edges(self) -> bool {
        matches!(self, Self::Edges | Self::ProjectedEdges | Self::DiagSplit)
    }
}

/// What happens between patches of different rates.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum Borders {
    /// Both patches keep their rates: a ray may slip through between them, as published.
    Open,
    /// A shared edge has the vertices of the coarser of the two patches as the ray sees them. Every ray sees one watertight
    /// mesh.
    #[default]
    Stitched,
}

/// How the two parameters of a regular patch are divided.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum Rates {
    /// Alike, as published.
    Equal,
    /// Each as it needs.
    #[default]
    Anisotropic,
}

/// Options of [`crate::SurfaceTracer::new`].
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct TraceOptions {
    /// Which footprint sets a patch's rate.
    pub footprint: FootprintRule,
    /// What happens between patches.
    pub borders: Borders,
    /// How patches are divided.
    pub rates: Rates,
    /// Longest micropolygon edge in footprint edges; 1 is the Reyes quality threshold.
    pub edge: f32,
    /// Most times that a patch is halved, at most [`MAX_LEVEL`]: the rate where footprints have no size.
    pub max_level: u8,
    /// Bytes of grids kept; each thread's [`crate::TraceState`] holds up to a sixteenth of it more.
    pub cache_bytes: usize,
    /// Cells along the longest side of a lattice whose cells inside a closed surface block shadow rays, at most 512; 0 for
    /// none. Not used where [`Self::borders`] are open.
    pub occluder_cells: u32,
}

impl Default for TraceOptions {
    fn default() -> Self {
        Self {
            footprint: FootprintRule::default(),
            borders: Borders::default(),
            rates: Rates::default(),
            edge: 1.0,
            max_level: 10,
            cache_bytes: 256 << 20,
            occluder_cells: 0,
        }
    }
}

impl TraceOptions {
    /// With another [`Self::footprint`].
    #[must_use]
    pub fn with_footprint(self, footprint: FootprintRule) -> Self {
        Self { footprint, ..self }
    }

    /// With another [`Self::borders`].
    #[must_use]
    pub fn with_borders(self, borders: Borders) -> Self {
        Self { borders, ..self }
    }

    /// With another [`Self::rates`].
    #[must_use]
    pub fn with_rates(self, rates: Rates) -> Self {
        Self { rates, ..self }
    }

    /// With another [`Self::edge`].
    #[must_use]
    pub fn with_edge(self, edge: f32) -> Self {
        Self { edge, ..self }
    }

    /// With another [`Self::max_level`].
    #[must_use]
    pub fn with_max_level(self, max_level: u8) -> Self {
        Self { max_level, ..self }
    }

    /// With another [`Self::cache_bytes`].
    #[must_use]
    pub fn with_cache_bytes(self, cache_bytes: usize) -> Self {
        Self { cache_bytes, ..self }
    }

    /// With another [`Self::occluder_cells`].
    #[must_use]
    pub fn with_occluder_cells(self, occluder_cells: u32) -> Self {
        Self { occluder_cells, ..self }
    }

    /// Whether borders are moved to where neighbours have vertices.
    pub(crate) fn has_seams(&self) -> bool {
        self.borders == Borders::Stitched || self.footprint.is_by_edges()
    }

    pub(crate) fn check(&self) -> Result<(), SurfaceError> {
        if !(self.edge > 0.0 && self.edge.is_finite()) {
            let value = self.edge.into();
            return Err(SurfaceError::Option { name: "edge", value, expected: "a positive number" });
        }
        if self.max_level > MAX_LEVEL {
            let value = self.max_level.into();
            return Err(SurfaceError::Option { name: "max_level", value, expected: "0 to 12" });
        }
        if self.occluder_cells > 512 {
            let value = self.occluder_cells.into();
            return Err(SurfaceError::Option { name: "occluder_cells", value, expected: "0 to 512" });
        }
        Ok(())
    }
}
