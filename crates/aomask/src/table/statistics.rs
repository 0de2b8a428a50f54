//! Counting what a traversal does.

/// Watches a traversal. Every method does nothing unless overridden, so that `&mut ()` costs nothing.
pub trait TableStatistics {
    /// A node was entered; `boxes` of its children were tested against the hemisphere, `alive` met it.
    #[inline(always)]
    fn node(&mut self, boxes: u32, alive: u32) {
        let _ = (boxes, alive);
    }

    /// `children` met the hemisphere, but no new ray.
    #[inline(always)]
    fn culled_nodes(&mut self, children: u32) {
        let _ = children;
    }

    /// A leaf of `triangles` was tested; so many were left after each of the four culling tests.
    #[inline(always)]
    fn leaf(&mut self, triangles: u32, after: [u32; 4]) {
        let _ = (triangles, after);
    }
}

impl TableStatistics for () {}

/// Totals over receivers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct TableCounters {
    /// Nodes entered.
    pub nodes: u64,
    /// Child boxes tested against the hemisphere.
    pub box_tests: u64,
    /// Child boxes whose masks were looked up.
    pub node_masks: u64,
    /// Of these, boxes that could block no new ray.
    pub culled_nodes: u64,
    /// Triangles tested.
    pub triangle_tests: u64,
    /// Triangles left after the horizon, facing, plane distance and bounding sphere tests; the masks of the last were
    /// looked up.
    pub triangles_after: [u64; 4],
}

impl TableStatistics for TableCounters {
    #[inline]
    fn node(&mut self, boxes: u32, alive: u32) {
        self.nodes += 1;
        self.box_tests += u64::from(boxes);
        self.node_masks += u64::from(alive);
    }

    #[inline]
    fn culled_nodes(&mut self, children: u32) {
        self.culled_nodes += u64::from(children);
    }

    #[inline]
    fn leaf(&mut self, triangles: u32, after: [u32; 4]) {
        self.triangle_tests += u64::from(triangles);
        for (sum, left) in self.triangles_after.iter_mut().zip(after) {
            *sum += u64::from(left);
        }
    }
}
