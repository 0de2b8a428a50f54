//! Counting what queries do: one trait to watch them, one type for totals.
//!
//! Here: all events of all structures of the workspace, so that one watcher fits every call that ends in `_with`. Not here:
//! counts of builds and of caches, which belong to what was built.

/// Watches queries. Every method does nothing unless overridden, so that `&mut ()` costs nothing. A structure reports what it
/// does and leaves out the rest.
pub trait Statistics {
    /// A node of a wide hierarchy was entered and `boxes` of its children tested, in one step.
    #[inline(always)]
    fn node(&mut self, boxes: u32) {
        let _ = boxes;
    }

    /// A node of a kd-tree was visited with `active` of the `lanes` of a packet.
    #[inline(always)]
    fn kd_node(&mut self, active: u32, lanes: u32, is_leaf: bool) {
        let _ = (active, lanes, is_leaf);
    }

    /// `tests` triangles were tested, in one step.
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
    fn ended_at_node(&mut self, node: u32, slots: u32) {
        let _ = (node, slots);
    }

    /// A ray was tested against `tests` boxes that are no nodes: of generators, guards, cached occluders.
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

    /// A ray ended at a box inside of a solid; `remembered` if the ray's light has met boxes there before.
    #[inline(always)]
    fn ended_in_solid(&mut self, remembered: bool) {
        let _ = remembered;
    }

    /// A ray through a kd-tree ended at a triangle, or nowhere.
    #[inline(always)]
    fn ended(&mut self, at_triangle: bool) {
        let _ = at_triangle;
    }

    /// The masks of `children` of a node were looked up, and `culled` of them held no new ray.
    #[inline(always)]
    fn node_masks(&mut self, children: u32, culled: u32) {
        let _ = (children, culled);
    }

    /// So many triangles of a leaf were left after each of the four culling tests of a mask table; the masks of the last were
    /// looked up.
    #[inline(always)]
    fn triangles_after(&mut self, after: [u32; 4]) {
        let _ = after;
    }
}

impl Statistics for () {}

/// The struct and its sums, so that no field is left out of them.
macro_rules! counters {
    ($($(#[$doc:meta])* $name:ident: $type:ty,)*) => {
        /// Totals over queries. Counts depend on the structure and may depend on the back end, answers never do. What a structure
        /// doesn't do stays 0.
        #[derive(Clone, Copy, Debug, Default, PartialEq)]
        #[non_exhaustive]
        pub struct Counters {
            $($(#[$doc])* pub $name: $type,)*
        }

        impl std::ops::AddAssign for Counters {
            fn add_assign(&mut self, other: Self) {
                $(Sum::add(&mut self.$name, other.$name);)*
            }
        }
    };
}

counters! {
    /// Nodes entered; by rays that walk together, once for all of them.
    nodes: u64,
    /// Boxes tested: children of wide nodes, empty slots not counted; boxes of generators, guards and caches.
    box_tests: u64,
    /// Triangles tested.
    triangle_tests: u64,
    /// Triangles that the float filter could not decide.
    uncertain: u64,
    /// Leaves among the nodes, in kd-trees.
    leaves: u64,
    /// Rays that wanted the nodes visited, in kd-trees.
    rays_at_nodes: u64,
    /// Rays that wanted the leaves visited, in kd-trees.
    rays_at_leaves: u64,
    /// Rays that could have been there, in full packets.
    lanes: u64,
    /// Rays that looked into a light's cache.
    cache_lookups: u64,
    /// Rays that ended there.
    cache_hits: u64,
    /// Rays that ended at an opaque cell, in a cache or in the tree.
    cell_hits: u64,
    /// Sum of the surface areas of these cells.
    cell_area: f64,
    /// Rays that ended at a triangle, in kd-trees.
    triangle_hits: u64,
    /// Rays that met nothing, in kd-trees.
    misses: u64,
    /// Rays that ended at a box inside of a solid.
    solid_hits: u64,
    /// Of these among the boxes that their light has met before, or that were there in their places.
    remembered_hits: u64,
    /// Boxes whose masks were looked up.
    node_masks: u64,
    /// Of these, boxes that could block no new ray.
    culled_nodes: u64,
    /// Triangles left after the horizon, facing, plane distance and bounding sphere tests.
    triangles_after: [u64; 4],
    /// Triangles rasterized as hexagonal prisms, counted in every tile they touch.
    prisms: u64,
    /// Triangles rasterized as billboards, counted in every tile they touch.
    billboards: u64,
    /// Fragments that pass the inverted depth test.
    fragments: u64,
    /// Fragments left after far depth, bounding sphere, facing, plane distance and hemisphere.
    fragments_after: [u64; 5],
    /// Fragments whose masks were looked up: as many as the tests in use leave.
    fragment_masks: u64,
}

/// Sums of numbers and of rows of numbers.
trait Sum {
    fn add(&mut self, other: Self);
}

impl Sum for u64 {
    fn add(&mut self, other: Self) {
        *self += other;
    }
}

impl Sum for f64 {
    fn add(&mut self, other: Self) {
        *self += other;
    }
}

impl<const N: usize> Sum for [u64; N] {
    fn add(&mut self, other: Self) {
        self.iter_mut().zip(other).for_each(|(sum, n)| *sum += n);
    }
}

impl Statistics for Counters {
    #[inline]
    fn node(&mut self, boxes: u32) {
        self.nodes += 1;
        self.box_tests += u64::from(boxes);
    }

    #[inline]
    fn kd_node(&mut self, active: u32, lanes: u32, is_leaf: bool) {
        self.nodes += 1;
        self.rays_at_nodes += u64::from(active);
        self.lanes += u64::from(lanes);
        if is_leaf {
            self.leaves += 1;
            self.rays_at_leaves += u64::from(active);
        }
    }

    #[inline]
    fn triangles(&mut self, tests: u32) {
        self.triangle_tests += u64::from(tests);
    }

    #[inline]
    fn uncertain(&mut self, lanes: u32) {
        self.uncertain += u64::from(lanes);
    }

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
    fn ended_in_solid(&mut self, remembered: bool) {
        self.solid_hits += 1;
        self.remembered_hits += u64::from(remembered);
    }

    #[inline]
    fn ended(&mut self, at_triangle: bool) {
        self.triangle_hits += u64::from(at_triangle);
        self.misses += u64::from(!at_triangle);
    }

    #[inline]
    fn node_masks(&mut self, children: u32, culled: u32) {
        self.node_masks += u64::from(children);
        self.culled_nodes += u64::from(culled);
    }

    #[inline]
    fn triangles_after(&mut self, after: [u32; 4]) {
        Sum::add(&mut self.triangles_after, after.map(u64::from));
    }
}
