//! Counting what shadow rays do.

use umbrage_accel::kdtree::{KdCounters, KdStatistics};

/// Watches shadow rays. Every method does nothing unless overridden, so that `&mut ()` costs nothing.
pub trait Statistics: KdStatistics {
    /// A ray was tested against `tests` boxes that are no nodes: of generators, guards, occluders.
    #[inline(always)]
    fn boxes(&mut self, tests: u32) {
        let _ = tests;
    }

    /// A ray looked into the cache of its light.
    #[inline(always)]
    fn looked_up(&mut self, found: bool) {
        let _ = found;
    }

    /// A ray ended at an opaque cell of this surface area.
    #[inline(always)]
    fn ended_in_cell(&mut self, area: f32) {
        let _ = area;
    }

    /// A ray ended at a triangle, or nowhere.
    #[inline(always)]
    fn ended(&mut self, at_triangle: bool) {
        let _ = at_triangle;
    }
}

impl Statistics for () {}

/// Totals over shadow rays.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Counters {
    /// Traversal steps and triangle tests.
    pub kd: KdCounters,
    /// Boxes tested, nodes of the tree not counted.
    pub box_tests: u64,
    /// Rays that looked into a cache.
    pub cache_lookups: u64,
    /// Rays that ended there.
    pub cache_hits: u64,
    /// Rays that ended at an opaque cell, in a cache or in the tree.
    pub cell_hits: u64,
    /// Sum of the surface areas of these cells.
    pub cell_area: f64,
    /// Rays that ended at a triangle.
    pub triangle_hits: u64,
    /// Rays that met nothing.
    pub misses: u64,
}

impl KdStatistics for Counters {
    #[inline]
    fn step(&mut self, active: u32, lanes: u32, is_leaf: bool) {
        self.kd.step(active, lanes, is_leaf);
    }

    #[inline]
    fn triangles(&mut self, tests: u32) {
        self.kd.triangles(tests);
    }
}

impl Statistics for Counters {
    #[inline]
    fn boxes(&mut self, tests: u32) {
        self.box_tests += u64::from(tests);
    }

    #[inline]
    fn looked_up(&mut self, found: bool) {
        self.cache_lookups += 1;
        self.cache_hits += u64::from(found);
    }

    #[inline]
    fn ended_in_cell(&mut self, area: f32) {
        self.cell_hits += 1;
        self.cell_area += f64::from(area);
    }

    #[inline]
    fn ended(&mut self, at_triangle: bool) {
        self.triangle_hits += u64::from(at_triangle);
        self.misses += u64::from(!at_triangle);
    }
}
