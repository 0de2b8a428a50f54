//! A grid of voxels over one generator: which are cut by its surface, which are inside, which outside.
//!
//! The other source of occluders beside the cells of a kd-tree, for structures that have none (Djeu11, section 3.9 leaves
//! bounding volume hierarchies out). Planes are `f32` numbers, and every voxel whose closed box a triangle may touch is
//! marked, so that boxes of unmarked voxels are empty exactly.

use umbrage_geom::{
    Aabb,
    glam::{DVec3, Vec3},
};

/// State of a voxel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Voxel {
    /// Triangles may touch it, or nothing is known.
    Boundary,
    /// Empty, of winding number 0.
    Outside,
    /// Empty, of another winding number.
    Inside,
}

/// Fewest voxels of a region that is worth a test ray.
const SMALLEST_REGION: usize = 8;

/// Most regions that get one, largest first; what is left is taken for boundary.
const MOST_REGIONS: usize = 32;

/// Planes of one axis, evenly spaced and strictly growing.
#[derive(Clone, Debug)]
struct Planes(Vec<f32>);

impl Planes {
    /// First voxel that reaches `x` or more, as a closed interval.
    fn first(&self, x: f32) -> usize {
        self.0.partition_point(|&p| p < x).saturating_sub(1)
    }

    /// Last voxel that starts at `x` or less.
    fn last(&self, x: f32) -> usize {
        self.0.partition_point(|&p| p <= x).saturating_sub(1).min(self.0.len() - 2)
    }

    fn count(&self) -> usize {
        self.0.len() - 1
    }
}

/// The grid.
#[derive(Clone, Debug)]
pub(crate) struct Voxels {
    planes: [Planes; 3],
    pub(crate) size: [usize; 3],
    state: Vec<Voxel>,
}

impl Voxels {
    /// A grid of about `resolution` voxels along the longest side of `bounds`, with the states that `winding` gives; `None`
    /// if coordinates are too coarse for one. `caps` mark voxels as `triangles` do.
    pub(crate) fn build(
        bounds: &Aabb,
        resolution: usize,
        triangles: &mut dyn Iterator<Item = [[f32; 3]; 3]>,
        winding: &dyn Fn(Vec3) -> i32,
    ) -> Option<Self> {
        let extent = (bounds.max.as_dvec3() - bounds.min.as_dvec3()).max_element();
        let step = extent / resolution as f64;
        let planes = [0, 1, 2].map(|axis| {
            // One empty layer around everything.
            let (low, high) =
                (f64::from(bounds.min[axis]) - 1.25 * step, f64::from(bounds.max[axis]) + 1.25 * step);
            let count = ((high - low) / step).ceil() as usize;
            Planes((0..=count).map(|i| (low + step * i as f64) as f32).collect())
        });
        let sound = |p: &Planes| p.0.iter().all(|x| x.is_finite()) && p.0.windows(2).all(|w| w[0] < w[1]);
        if step <= 0.0 || !step.is_finite() || !planes.iter().all(sound) {
            return None;
        }
        let size = [0, 1, 2].map(|axis| planes[axis].count());
        let mut voxels = Self { planes, size, state: vec![Voxel::Outside; size.iter().product()] };
        triangles.for_each(|corners| voxels.mark(corners));
        voxels.label(winding);
        Some(voxels)
    }

    pub(crate) fn index(&self, [i, j, k]: [usize; 3]) -> usize {
        (k * self.size[1] + j) * self.size[0] + i
    }

    fn place(&self, index: usize) -> [usize; 3] {
        [index % self.size[0], index / self.size[0] % self.size[1], index / self.size[0] / self.size[1]]
    }

    pub(crate) fn state(&self, at: [usize; 3]) -> Voxel {
        self.state[self.index(at)]
    }

    /// The closed box of voxels `low .. high`.
    pub(crate) fn aabb(&self, low: [usize; 3], high: [usize; 3]) -> Aabb {
        let at = |place: [usize; 3]| Vec3::from([0, 1, 2].map(|axis| self.planes[axis].0[place[axis]]));
        Aabb { min: at(low), max: at(high) }
    }

    /// Marks every voxel that a triangle may touch.
    fn mark(&mut self, corners: [[f32; 3]; 3]) {
        let bounds = Aabb::from_points(&corners);
        let first = [0, 1, 2].map(|axis| self.planes[axis].first(bounds.min[axis]));
        let last = [0, 1, 2].map(|axis| self.planes[axis].last(bounds.max[axis]));
        let single = first == last;
        let test = (!single).then(|| BoxTest::new(corners));
        for k in first[2]..=last[2] {
            for j in first[1]..=last[1] {
                for i in first[0]..=last[0] {
                    let aabb = self.aabb([i, j, k], [i + 1, j + 1, k + 1]);
                    if test.as_ref().is_none_or(|test| test.may_touch(&aabb)) {
                        let index = self.index([i, j, k]);
                        self.state[index] = Voxel::Boundary;
                    }
                }
            }
        }
    }

    /// Floods regions of unmarked voxels and asks once for each: neighbours share a closed face that no triangle touches.
    fn label(&mut self, winding: &dyn Fn(Vec3) -> i32) {
        if self.state[0] == Voxel::Boundary {
            // Planes were rounded on to the surface: the empty layer isn't one, so nothing is known.
            self.state.fill(Voxel::Boundary);
            return;
        }
        let strides = [1, self.size[0], self.size[0] * self.size[1]];
        let mut seen = vec![false; self.state.len()];
        let mut regions: Vec<Vec<u32>> = Vec::new();
        for start in 0..self.state.len() {
            if seen[start] || self.state[start] == Voxel::Boundary {
                continue;
            }
            seen[start] = true;
            let mut region = vec![start as u32];
            let mut next = 0;
            while next < region.len() {
                let index = region[next] as usize;
                next += 1;
                let place = self.place(index);
                for axis in 0..3 {
                    let before = (place[axis] > 0).then(|| index - strides[axis]);
                    let after = (place[axis] + 1 < self.size[axis]).then(|| index + strides[axis]);
                    for neighbour in [before, after].into_iter().flatten() {
                        if !seen[neighbour] && self.state[neighbour] != Voxel::Boundary {
                            seen[neighbour] = true;
                            region.push(neighbour as u32);
                        }
                    }
                }
            }
            regions.push(region);
        }
        // The first region is the one around everything: its first voxel is the corner of the empty layer.
        regions[1..].sort_by_key(|region| std::cmp::Reverse(region.len()));
        for (i, region) in regions.iter().enumerate().skip(1) {
            let small = region.len() < SMALLEST_REGION || i > MOST_REGIONS;
            let place = self.place(region[region.len() / 2] as usize);
            let aabb = self.aabb(place, place.map(|x| x + 1));
            let middle = aabb.min * 0.5 + aabb.max * 0.5;
            let strictly = middle.cmpgt(aabb.min).all() && middle.cmplt(aabb.max).all();
            let state = match small || !strictly {
                true => Voxel::Boundary,
                false if winding(middle) != 0 => Voxel::Inside,
                false => Voxel::Outside,
            };
            region.iter().for_each(|&voxel| self.state[voxel as usize] = state);
        }
    }

    /// Whether all points no farther than `margin` from `point` along any axis are outside.
    pub(crate) fn is_outside(&self, point: DVec3, margin: f64) -> bool {
        let (low, high) = (point - margin, point + margin);
        let span = |axis: usize| {
            let planes = &self.planes[axis].0;
            // Voxels whose closed interval may hold one of the points.
            let first = planes.partition_point(|&p| f64::from(p) < low[axis]).checked_sub(1)?;
            let last = planes.partition_point(|&p| f64::from(p) <= high[axis]).checked_sub(1)?;
            (last < planes.len() - 1).then_some(first..=last)
        };
        // Beyond the planes there is nothing.
        let (Some(x), Some(y), Some(z)) = (span(0), span(1), span(2)) else {
            return (0..3).any(|axis| {
                let planes = &self.planes[axis].0;
                high[axis] < f64::from(planes[0]) || low[axis] > f64::from(planes[planes.len() - 1])
            });
        };
        z.into_iter().all(|k| y.clone().all(|j| x.clone().all(|i| self.state([i, j, k]) == Voxel::Outside)))
    }

    /// Whether the closed `region` is surely outside.
    pub(crate) fn region_is_outside(&self, region: &Aabb) -> bool {
        let middle = (region.min.as_dvec3() + region.max.as_dvec3()) * 0.5;
        let half = (region.max.as_dvec3() - region.min.as_dvec3()) * 0.5;
        // A cube around it: simple, and lights are small.
        self.is_outside(middle, half.max_element() * (1.0 + 1e-9) + middle.abs().max_element() * 1e-12)
    }

    pub(crate) fn bytes(&self) -> usize {
        size_of_val(&self.state[..])
    }
}

/// Separating axes of a triangle and boxes (Akenine-Moeller 2001), in `f64` with room for rounding.
struct BoxTest {
    corners: [DVec3; 3],
    /// The plane's normal and the products of edges and axes, each with the interval of the triangle and a bound on rounding.
    axes: Vec<(DVec3, f64, f64)>,
}

impl BoxTest {
    fn new(corners: [[f32; 3]; 3]) -> Self {
        let corners = corners.map(|p| DVec3::from(p.map(f64::from)));
        let edges = [corners[1] - corners[0], corners[2] - corners[1], corners[0] - corners[2]];
        let units = [DVec3::X, DVec3::Y, DVec3::Z];
        let crosses = edges.into_iter().flat_map(|edge| units.map(|unit| edge.cross(unit)));
        let axes = std::iter::once(edges[0].cross(edges[1])).chain(crosses);
        // Axes of length 0 separate nothing: all intervals are 0 there.
        let axes = axes.map(|axis| {
            let heights = corners.map(|p| axis.dot(p));
            (axis, heights[0].min(heights[1]).min(heights[2]), heights[0].max(heights[1]).max(heights[2]))
        });
        Self { corners, axes: axes.collect() }
    }

    fn may_touch(&self, aabb: &Aabb) -> bool {
        let (min, max) = (aabb.min.as_dvec3(), aabb.max.as_dvec3());
        let (middle, half) = ((min + max) * 0.5, (max - min) * 0.5);
        let size = self.corners.iter().fold(min.abs().max(max.abs()), |m, p| m.max(p.abs()));
        self.axes.iter().all(|&(axis, low, high)| {
            let room = axis.abs().dot(size) * 2f64.powi(-40);
            let (center, radius) = (axis.dot(middle), axis.abs().dot(half) + room);
            low <= center + radius && high >= center - radius
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A tetrahedron of right angles.
    fn corner() -> [[[f32; 3]; 3]; 4] {
        let [o, x, y, z] = [[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        [[o, y, x], [o, z, y], [o, x, z], [x, y, z]]
    }

    #[test]
    fn voxels_of_a_tetrahedron_are_where_they_should_be() {
        let bounds = Aabb { min: Vec3::ZERO, max: Vec3::ONE };
        let winding = |p: Vec3| i32::from(p.min_element() > 0.0 && p.element_sum() < 1.0);
        let voxels = Voxels::build(&bounds, 20, &mut corner().into_iter(), &winding).unwrap();
        let (mut inside, mut boundary) = (0, 0);
        for index in 0..voxels.state.len() {
            let place = voxels.place(index);
            let aabb = voxels.aabb(place, place.map(|x| x + 1));
            let all_in = aabb.min.min_element() > 0.0 && aabb.max.element_sum() < 1.0;
            let all_out = aabb.max.min_element() < 0.0 || aabb.min.element_sum() > 1.0;
            match voxels.state[index] {
                Voxel::Inside => assert!(all_in),
                Voxel::Outside => assert!(all_out),
                Voxel::Boundary => assert!(!all_in && !all_out, "{aabb:?}"),
            }
            inside += u32::from(voxels.state[index] == Voxel::Inside);
            boundary += u32::from(voxels.state[index] == Voxel::Boundary);
        }
        assert!(inside > 600 && boundary > 300, "{inside} {boundary}");
        assert!(voxels.is_outside(DVec3::splat(0.8), 0.01) && voxels.is_outside(DVec3::splat(-9.0), 0.0));
        assert!(!voxels.is_outside(DVec3::splat(0.2), 0.0) && !voxels.is_outside(DVec3::splat(0.8), 0.8));
        assert!(!voxels.is_outside(DVec3::splat(0.2), 100.0));
        assert!(voxels.region_is_outside(&Aabb { min: Vec3::splat(0.7), max: Vec3::splat(0.75) }));
    }

    #[test]
    fn coarse_numbers_make_no_grid() {
        let min = Vec3::splat(1e7);
        assert!(Voxels::build(&Aabb { min, max: min + 4.0 }, 64, &mut std::iter::empty(), &|_| 0).is_none());
        assert!(Voxels::build(&Aabb { min, max: min }, 64, &mut std::iter::empty(), &|_| 0).is_none());
    }
}
