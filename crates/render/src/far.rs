//! What `mask-prefilter` takes for occluders beyond the reach of its exact masks.

use umbrage_aomask::{
    BackEnd, MaskError,
    coarse::{
        Cones, FarField,
        field::{FieldCones, FieldOptions, MarchOptions, OpacityField},
    },
};
use umbrage_geom::{Aabb, TriangleMesh, glam::Vec3, segment_hits_triangle};

/// Masks are exact at least up to this share of the radius, or of the diagonal if that is less,
const NEAR: f32 = 0.1;

/// and over so many of the field's cells, so that it errs as `docs/aomask-exact.md` says at any radius.
const NEAR_CELLS: f32 = 2.25;

/// Most triangles that are left to exact rays.
const LARGE: usize = 8;

/// Stored opacity of opaque triangles.
pub(crate) struct FarOpacity {
    field: OpacityField,
    diagonal: f32,
    /// Triangles without which all others lie close together, such as a wide ground: too large for the field.
    large: Vec<[[f32; 3]; 3]>,
}

impl FarOpacity {
    /// Makes the field; `progress` as in [`OpacityField::build`].
    ///
    /// # Errors
    /// Those of [`OpacityField::build`].
    pub(crate) fn build(
        mesh: &TriangleMesh,
        progress: &mut (dyn FnMut(f32) -> bool + Send),
    ) -> Result<Self, MaskError> {
        let large = large(mesh);
        let options = FieldOptions::default();
        let (field, bounds);
        if large.is_empty() {
            bounds = mesh.bounds();
            field = OpacityField::build(&mesh.positions, &mesh.triangles, &options, progress)?;
        } else {
            let mut rest = mesh.triangles.clone();
            // From the back, so that what is still to be taken stays in place.
            for &i in large.iter().rev() {
                rest.swap_remove(i);
            }
            bounds = bounds_of(mesh, &rest);
            field = OpacityField::build(&mesh.positions, &rest, &options, progress)?;
        }
        let large = large.into_iter().map(|i| mesh.triangle(i)).collect();
        Ok(Self { field, diagonal: bounds.diagonal(), large })
    }

    /// For patterns of `rays` rays that end at `radius` (world units) or before.
    ///
    /// # Errors
    /// Those of [`FieldCones::new`].
    pub(crate) fn cones(&self, rays: usize, radius: f32) -> Result<FarCones<'_>, MaskError> {
        let near = (NEAR * radius.min(self.diagonal)).max(NEAR_CELLS * self.field.cell());
        let march = MarchOptions::default();
        let cones = FieldCones::new(&self.field, rays, near, radius, &march, BackEnd::best())?;
        Ok(FarCones { cones, large: &self.large })
    }
}

/// [`FarOpacity`] for one pattern.
pub(crate) struct FarCones<'a> {
    cones: FieldCones<'a>,
    large: &'a [[[f32; 3]; 3]],
}

impl FarField for FarCones<'_> {
    fn near(&self) -> f32 {
        self.cones.near()
    }

    fn bundle(&self) -> usize {
        self.cones.bundle()
    }

    fn transmittances(&self, cones: &Cones, passed: &mut [f32]) {
        self.cones.transmittances(cones, passed);
        if self.large.is_empty() {
            return;
        }
        for ((ray, _), passed) in cones.rays(self.near()).zip(passed) {
            if *passed > 0.0 && self.large.iter().any(|&triangle| segment_hits_triangle(&ray, triangle)) {
                *passed = 0.0;
            }
        }
    }
}

fn bounds_of(mesh: &TriangleMesh, triangles: &[[u32; 3]]) -> Aabb {
    let corners = triangles.iter().flatten();
    corners.fold(Aabb::EMPTY, |aabb, &v| aabb.with_point(mesh.positions[v as usize]))
}

/// The fewest triangles, at most [`LARGE`], without which the diagonal of all others is less than half: their numbers, rising.
fn large(mesh: &TriangleMesh) -> Vec<usize> {
    let extent = |&i: &usize| {
        let [a, b, c] = mesh.triangle(i).map(Vec3::from);
        a.distance_squared(b).max(b.distance_squared(c)).max(c.distance_squared(a))
    };
    let mut largest: Vec<usize> = Vec::with_capacity(LARGE + 1);
    for i in 0..mesh.triangles.len() {
        let size = extent(&i);
        if largest.len() == LARGE && size <= extent(&largest[LARGE - 1]) {
            continue;
        }
        let at = largest.partition_point(|other| extent(other) >= size);
        largest.insert(at, i);
        largest.truncate(LARGE);
    }
    // Bounds of what is left without the first `n`, growing as triangles come back.
    let mut taken = largest.clone();
    taken.sort_unstable();
    let mut rest = Aabb::EMPTY;
    for (i, triangle) in mesh.triangles.iter().enumerate() {
        if taken.binary_search(&i).is_err() {
            rest = triangle.iter().fold(rest, |aabb, &v| aabb.with_point(mesh.positions[v as usize]));
        }
    }
    let half = 0.5 * bounds_of(mesh, &mesh.triangles).diagonal();
    let fits = |rest: &Aabb| !rest.is_empty() && rest.diagonal() < half;
    if !fits(&rest) {
        return Vec::new();
    }
    while let Some(&last) = largest.last() {
        let with = mesh.triangle(last).into_iter().fold(rest, |aabb, p| aabb.with_point(p));
        if !fits(&with) {
            break;
        }
        rest = with;
        largest.pop();
    }
    largest.sort_unstable();
    largest
}

#[cfg(test)]
mod tests {
    use super::*;

    fn square(mesh: &mut TriangleMesh, corners: [[f32; 3]; 4]) {
        let base = mesh.positions.len() as u32;
        mesh.positions.extend(corners);
        mesh.triangles.extend([[base, base + 1, base + 2], [base, base + 2, base + 3]]);
    }

    fn small(mesh: &mut TriangleMesh, count: u32) {
        for i in 0..count {
            let x = i as f32 / count as f32;
            square(mesh, [[x, 0.0, 0.0], [x + 0.1, 0.0, 0.0], [x + 0.1, 0.1, 0.5], [x, 0.1, 0.5]]);
        }
    }

    #[test]
    fn a_wide_ground_is_told_from_the_rest() {
        let mut mesh = TriangleMesh::default();
        small(&mut mesh, 20);
        assert!(large(&mesh).is_empty());
        square(&mut mesh, [[-9.0, -0.1, -9.0], [-9.0, -0.1, 9.0], [9.0, -0.1, 9.0], [9.0, -0.1, -9.0]]);
        small(&mut mesh, 3);
        assert_eq!(large(&mesh), [40, 41]);
        let far = FarOpacity::build(&mesh, &mut |_| true).unwrap();
        assert!(far.diagonal < 2.0 && far.large == [mesh.triangle(40), mesh.triangle(41)]);
        // Straight down beside the small ones there is the ground alone, which the field doesn't have.
        let mut cones = Cones { origin: Vec3::new(-3.0, 4.0, 0.0), ..Cones::default() };
        for (row, x) in cones.directions.iter_mut().zip([0.0, -1.0, 0.0]) {
            *row = vec![x; 2];
        }
        (cones.lengths, cones.solid_angles) = (vec![f32::INFINITY, 4.0], vec![0.01; 2]);
        let mut passed = [0.5; 2];
        far.cones(256, f32::INFINITY).unwrap().transmittances(&cones, &mut passed);
        assert_eq!(passed, [0.0, 1.0]);
        assert!(large(&TriangleMesh::default()).is_empty());
    }
}
