//! Counting what a query does.

/// Watches a query. Every method does nothing unless overridden, so that `&mut ()` costs nothing.
pub trait Statistics {
    /// A node was entered and `boxes` of its children tested, in one step.
    #[inline(always)]
    fn node(&mut self, boxes: u32) {
        let _ = boxes;
    }

    /// A leaf of `tests` triangles was tested, in one step.
    #[inline(always)]
    fn triangles(&mut self, tests: u32) {
        let _ = tests;
    }

    /// The float filter left `lanes` triangles of a leaf to the exact predicate.
    #[inline(always)]
    fn uncertain(&mut self, lanes: u32) {
        let _ = lanes;
    }

    /// A ray ended at the `slots` (a bit each) of node `node` instead of entering them.
    #[inline(always)]
    fn ends(&mut self, node: u32, slots: u32) {
        let _ = (node, slots);
    }
}

impl Statistics for () {}

/// Totals over queries. Counts depend on the structure and may depend on the back end, answers never do.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counters {
    /// Nodes entered; by rays that walk together, once for all of them.
    pub nodes: u64,
    /// Child boxes tested, empty slots not counted.
    pub box_tests: u64,
    /// Triangles tested.
    pub triangle_tests: u64,
    /// Triangles that the float filter could not decide.
    pub uncertain: u64,
}

impl Statistics for Counters {
    #[inline]
    fn node(&mut self, boxes: u32) {
        self.nodes += 1;
        self.box_tests += u64::from(boxes);
    }

    #[inline]
    fn triangles(&mut self, tests: u32) {
        self.triangle_tests += u64::from(tests);
    }

    #[inline]
    fn uncertain(&mut self, lanes: u32) {
        self.uncertain += u64::from(lanes);
    }
}

impl std::ops::AddAssign for Counters {
    fn add_assign(&mut self, other: Self) {
        self.nodes += other.nodes;
        self.box_tests += other.box_tests;
        self.triangle_tests += other.triangle_tests;
        self.uncertain += other.uncertain;
    }
}
