//! What `mask-prefilter` takes for occluders beyond the reach of its exact masks.

use umbrage_accel::Bvh;
use umbrage_aomask::{
    BackEnd, MaskError, MaskOptions, Outputs, Pattern, PatternOptions, Receiver,
    coarse::{
        self, Cones, FarField,
        field::{FieldCones, FieldOptions, MarchOptions, OpacityField},
    },
    exact,
};
use umbrage_geom::{
    Aabb, TriangleMesh,
    glam::Vec3,
    offset_origin,
    sampling::{combine, hash, unit},
    segment_hits_triangle,
};

/// How far masks are exact, the first that will do: shares of the radius, or of the diagonal if that is less.
const NEARS: [f32; 5] = [0.1, 0.15, 0.22, 0.33, 0.5];

/// Cells of the field over which masks are exact at least; more in proportion for larger shares.
const NEAR_CELLS: f32 = 2.25;

/// What the field may add to the RMS error of exact rays, and to their mean, at sampled points: walls and floors are darkened by
/// cells that hold themselves.
const MOST_RMSE: f64 = 0.0125;
const MOST_BIAS: f64 = 0.005;

/// Points that are sampled: half of them by area, half by number of triangles.
const SAMPLES: usize = 512;

/// Most triangles that are left to exact rays.
const LARGE: usize = 8;

/// Stored opacity of opaque triangles.
pub(crate) struct FarOpacity {
    field: OpacityField,
    diagonal: f32,
    /// Triangles without which all others lie close together, such as a wide ground: too large for the field.
    large: Vec<[[f32; 3]; 3]>,
    /// Where errors are looked at.
    samples: Vec<Receiver>,
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
        let mut rest = mesh.triangles.clone();
        // From the back, so that what is still to be taken stays in place.
        for &i in large.iter().rev() {
            rest.swap_remove(i);
        }
        let field = OpacityField::build(&mesh.positions, &rest, &FieldOptions::default(), progress)?;
        let diagonal = bounds_of(mesh, &rest).diagonal();
        let samples = samples(mesh, &rest)?;
        Ok(Self { field, diagonal, large: large.into_iter().map(|i| mesh.triangle(i)).collect(), samples })
    }

    /// Memory it holds.
    pub(crate) fn bytes(&self) -> usize {
        self.field.bytes() + size_of_val(&self.large[..]) + size_of_val(&self.samples[..])
    }

    /// How far masks of `pattern`, which has `options`, are to be exact so that the whole errs little at sampled points. `None` if
    /// the field is of no use, because it would have to begin too far away.
    ///
    /// # Errors
    /// Those of [`coarse::answer_receivers`].
    pub(crate) fn near(
        &self,
        bvh: &Bvh,
        pattern: &Pattern,
        options: &PatternOptions,
        masks: &MaskOptions,
    ) -> Result<Option<f32>, MaskError> {
        let (receivers, best) = (&self.samples[..], BackEnd::best());
        let (mut truth, mut ao) = (vec![0f32; receivers.len()], vec![0f32; receivers.len()]);
        let many = Pattern::new(&options.clone().with_rays(Pattern::MAX_MASK_RAYS))?;
        let exactly = |pattern: &Pattern, ao: &mut [f32]| {
            exact::answer_receivers(bvh, pattern, receivers, masks, best, Outputs::new(ao), &mut |_| true)
        };
        exactly(&many, &mut truth)?;
        exactly(pattern, &mut ao)?;
        let [bias, square] = errors(&ao, &truth);
        let extent = masks.radius.min(self.diagonal);
        for share in NEARS {
            let near = (share * extent).max(share / NEARS[0] * NEAR_CELLS * self.field.cell());
            if receivers.is_empty() || near >= extent {
                break;
            }
            let far = self.cones(pattern.len(), near, masks.radius)?;
            let outputs = Outputs::new(&mut ao);
            coarse::answer_receivers(bvh, &far, pattern, receivers, masks, best, outputs, &mut |_| true)?;
            let [own_bias, own_square] = errors(&ao, &truth);
            if (own_bias - bias).abs() <= MOST_BIAS && own_square <= square + MOST_RMSE.powi(2) {
                return Ok(Some(near));
            }
        }
        Ok(None)
    }

    /// For patterns of `rays` rays that end at `radius` (world units) or before, of which `near` has been answered.
    ///
    /// # Errors
    /// Those of [`FieldCones::new`].
    pub(crate) fn cones(&self, rays: usize, near: f32, radius: f32) -> Result<FarCones<'_>, MaskError> {
        let cones =
            FieldCones::new(&self.field, rays, near, radius, &MarchOptions::default(), BackEnd::best())?;
        Ok(FarCones { cones, large: &self.large })
    }
}

/// Mean and mean square of the differences.
fn errors(ao: &[f32], truth: &[f32]) -> [f64; 2] {
    let mut sums = [0.0; 2];
    for (ao, truth) in ao.iter().zip(truth) {
        let error = f64::from(ao - truth);
        sums = [sums[0] + error, sums[1] + error * error];
    }
    sums.map(|sum| sum / ao.len().max(1) as f64)
}

/// Points on the fronts of `triangles`, the same in every run.
fn samples(mesh: &TriangleMesh, triangles: &[[u32; 3]]) -> Result<Vec<Receiver>, MaskError> {
    let corners = |i: usize| triangles[i].map(|v| Vec3::from(mesh.positions[v as usize]).as_dvec3());
    let area = |i: usize| {
        let [a, b, c] = corners(i);
        (b - a).cross(c - a).length()
    };
    let half = SAMPLES / 2;
    let count = half.min(triangles.len());
    let mut chosen: Vec<usize> = (0..count).map(|i| i * triangles.len() / count).collect();
    let total: f64 = (0..triangles.len()).map(area).sum();
    let (mut sum, mut next) = (0.0, 0);
    for i in 0..triangles.len() {
        sum += area(i);
        while next < half && sum * half as f64 >= (next as f64 + 0.5) * total && total > 0.0 {
            chosen.push(i);
            next += 1;
        }
    }
    let mut receivers = Vec::with_capacity(chosen.len());
    for (number, i) in chosen.into_iter().enumerate() {
        let [a, b, c] = corners(i);
        let normal = (b - a).cross(c - a).normalize_or_zero().as_vec3();
        if normal == Vec3::ZERO {
            continue;
        }
        let seed = combine(number as u32, 3);
        let (root, v) = (f64::from(unit(seed)).sqrt(), f64::from(unit(hash(seed))));
        let point = (a * (1.0 - root) + b * (root * (1.0 - v)) + c * (root * v)).as_vec3();
        let magnitude = a.abs().max(b.abs()).max(c.abs()).max_element() as f32;
        let origin = offset_origin(point, normal, normal, magnitude);
        receivers.push(Receiver::new(number, origin.to_array(), normal.to_array(), seed)?);
    }
    Ok(receivers)
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
    use umbrage_accel::BuildOptions;
    use umbrage_scene::generate::{Parameters, generate};

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
        far.cones(256, 0.5, f32::INFINITY).unwrap().transmittances(&cones, &mut passed);
        assert_eq!(passed, [0.0, 1.0]);
        assert!(large(&TriangleMesh::default()).is_empty());
    }

    /// Where masks have to be exact up to, over the extent, for radius `radius`.
    fn share(mesh: &TriangleMesh, radius: f32) -> Option<f32> {
        let bvh = Bvh::build(&mesh.positions, &mesh.triangles, &BuildOptions::default()).unwrap();
        let far = FarOpacity::build(mesh, &mut |_| true).unwrap();
        let options = PatternOptions::default().with_rays(256);
        let pattern = Pattern::new(&options).unwrap();
        let masks = MaskOptions::default().with_radius(radius);
        let near = far.near(&bvh, &pattern, &options, &masks).unwrap();
        near.map(|near| near / radius.min(far.diagonal))
    }

    #[test]
    fn sampled_errors_say_where_the_field_begins() {
        let bush =
            generate("bush", &Parameters { triangles: Some(30_000), ..Parameters::default() }).unwrap().mesh;
        let diagonal = bush.bounds().diagonal();
        let shares = [0.3, f32::INFINITY].map(|radius| share(&bush, radius * diagonal));
        assert!(shares.iter().all(|share| share.is_some_and(|share| share < 0.2)), "{shares:?}");
        // So near that the field has nothing to answer.
        assert_eq!(share(&bush, 0.001 * diagonal), None);
        // A floor darkens itself by cells that hold it.
        let mut floor = TriangleMesh::default();
        for i in 0..400 {
            let (x, z) = ((i % 20) as f32, (i / 20) as f32);
            square(&mut floor, [[x, 0.0, z], [x, 0.0, z + 1.0], [x + 1.0, 0.0, z + 1.0], [x + 1.0, 0.0, z]]);
        }
        let shares = [0.1, 1.0].map(|radius| share(&floor, radius * floor.bounds().diagonal()));
        assert!(
            shares[0].is_none_or(|share| share > 0.2) && shares[1].is_some_and(|share| share < 0.2),
            "{shares:?}"
        );
    }
}
