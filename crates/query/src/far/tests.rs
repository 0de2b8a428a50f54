//! How far exact masks reach, and the errors that stored opacity adds, on bushes over grounds.

use super::*;
use umbrage_accel::BuildOptions;
use umbrage_geom::{
    MeshObject,
    sampling::{self, RandomStream},
};
use umbrage_scene::generate::{Parameters, generate};

const GROUND: [[f32; 3]; 4] = [[-9.0, -0.1, -9.0], [-9.0, -0.1, 9.0], [9.0, -0.1, 9.0], [9.0, -0.1, -9.0]];

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
    square(&mut mesh, GROUND);
    small(&mut mesh, 3);
    assert_eq!(large(&mesh), [40, 41]);
    let mut opacities = vec![1.0; mesh.triangles.len()];
    opacities[41] = 0.25;
    let far = FarOpacity::build(&mesh, &opacities, &mut |_| true).unwrap();
    let parts =
        [(40, 0.0), (41, 0.75)].map(|(i, passes)| LargeTriangle { corners: mesh.triangle(i), passes });
    assert!(far.diagonal < 2.0 && far.large == parts);
    // Straight down beside the small ones there is the ground alone, which the field doesn't have.
    let mut cones = Cones { origin: Vec3::new(-3.0, 4.0, 0.0), ..Cones::default() };
    for (row, x) in cones.directions.iter_mut().zip([0.0, -1.0, 0.0]) {
        *row = vec![x; 2];
    }
    (cones.lengths, cones.solid_angles) = (vec![f32::INFINITY, 4.0], vec![0.01; 2]);
    let mut down = |x: f32| {
        let mut passed = [0.5; 2];
        cones.origin.x = x;
        far.cones(256, 0.5, f32::INFINITY).unwrap().transmittances(&cones, &mut passed);
        passed
    };
    assert_eq!([down(-3.0), down(3.0)], [[0.0, 1.0], [0.75, 1.0]]);
    assert!(large(&TriangleMesh::default()).is_empty());
    // Receivers on it are a group of their own, however few there are if all of them are asked.
    let receiver = |i: usize| {
        let point = [i as f32 / 20.0, if i < 8 { 0.3 } else { -0.1 }, 3.0];
        Receiver::new(i, point, [0.0, 1.0, 0.0], 0).unwrap()
    };
    let receivers: Vec<Receiver> = (0..10).map(receiver).collect();
    let sizes = |of| {
        let groups = far.groups(&Pilot { receivers: receivers.clone(), of });
        groups.iter().map(|group| (group.receivers.len(), group.unseen)).collect::<Vec<_>>()
    };
    assert_eq!(sizes(10), [(8, 0.0), (2, 0.0)]);
    assert_eq!(sizes(40), [(10, 0.75)]);
}

#[test]
fn samples_are_spread_over_all_receivers() {
    assert_eq!(Pilot::indices(5).collect::<Vec<_>>(), [0, 1, 2, 3, 4]);
    assert_eq!(Pilot::indices(0).count(), 0);
    let some: Vec<usize> = Pilot::indices(10 * MAX_CANDIDATES).collect();
    assert!(some.iter().enumerate().all(|(i, at)| at / 10 == i));
    let group = Group::new(Vec::new(), 1.0);
    assert!(group.receivers.is_empty());
}

/// Everything in it has `opacity`.
fn generated(name: &str, triangles: usize, opacity: f32) -> TriangleMesh {
    let parameters = Parameters { triangles: Some(triangles), ..Parameters::default() };
    let mut mesh = generate(name, &parameters).unwrap().mesh;
    mesh.objects = mesh.objects_or_whole();
    mesh.objects.iter_mut().for_each(|object| object.opacity = opacity);
    mesh
}

/// With an opaque ground below that reaches far beyond.
fn on_ground(mut mesh: TriangleMesh) -> TriangleMesh {
    let (bounds, first) = (mesh.bounds(), mesh.triangles.len() as u32);
    let (y, reach) = (bounds.min.y - 1e-3 * bounds.diagonal(), 20.0 * bounds.diagonal());
    let corner = |x: f32, z: f32| [x * reach, y, z * reach];
    square(&mut mesh, [corner(-1.0, -1.0), corner(-1.0, 1.0), corner(1.0, 1.0), corner(1.0, -1.0)]);
    mesh.objects.push(MeshObject { name: "ground".into(), triangles: first..first + 2, opacity: 1.0 });
    mesh
}

/// A scene with what its masks need.
struct Case {
    mesh: TriangleMesh,
    opacities: Vec<f32>,
    bvh: Bvh,
    far: FarOpacity,
}

impl Case {
    fn new(mesh: TriangleMesh) -> Self {
        let mut opacities = vec![1.0; mesh.triangles.len()];
        for object in mesh.objects_or_whole() {
            opacities[object.triangles.start as usize..object.triangles.end as usize].fill(object.opacity);
        }
        let bvh = Bvh::build(&mesh.positions, &mesh.triangles, &BuildOptions::default()).unwrap();
        let far = FarOpacity::build(&mesh, &opacities, &mut |_| true).unwrap();
        Self { mesh, opacities, bvh, far }
    }

    fn blockers(&self) -> Blockers<'_, impl Fn(u32) -> OpticalDepth + Sync + '_> {
        let opaque = self.opacities.iter().all(|&opacity| opacity >= 1.0);
        let depth_of = move |prim: u32| OpticalDepth::from_opacity(self.opacities[prim as usize]);
        Blockers { bvh: &self.bvh, depth_of: (!opaque).then_some(depth_of) }
    }

    /// Receivers by area on what isn't large, and on large triangles near the rest.
    fn receivers(&self, seed: u32, on: usize, off: usize) -> [Vec<Receiver>; 2] {
        let mesh = &self.mesh;
        let (mut random, bounds) =
            (RandomStream::new(seed, 0), bounds_of(mesh, &mesh.triangles[..off_count(mesh, &self.far)]));
        let receiver = |i: usize, point: Vec3, normal: Vec3, magnitude: f32, seed: u32| {
            let origin = offset_origin(point, normal, normal, magnitude);
            Receiver::new(i, origin.to_array(), normal.to_array(), seed).unwrap()
        };
        let corners = |i: usize| mesh.triangle(i).map(Vec3::from);
        let mut sums = Vec::new();
        for i in 0..off_count(mesh, &self.far) {
            let [a, b, c] = corners(i);
            sums.push(sums.last().unwrap_or(&0.0) + f64::from((b - a).cross(c - a).length()));
        }
        let mut parts = [Vec::new(), Vec::new()];
        while parts[0].len() < off {
            let at = f64::from(random.next_unit()) * sums.last().unwrap();
            let [a, b, c] = corners(sums.partition_point(|&sum| sum <= at).min(sums.len() - 1));
            let uv = sampling::triangle([random.next_unit(), random.next_unit()].into());
            let Some(normal) = (b - a).cross(c - a).try_normalize() else { continue };
            let magnitude = a.abs().max(b.abs()).max(c.abs()).max_element();
            let (point, i) = (a + (b - a) * uv.x + (c - a) * uv.y, parts[0].len());
            parts[0].push(receiver(i, point, normal, magnitude, combine(seed, i as u32)));
        }
        if let [first, ..] = &self.far.large[..] {
            let y = first.corners[0][1];
            for i in 0..on {
                let [u, v] = [0; 2].map(|_| 2.0 * random.next_unit() - 0.5);
                let size = bounds.max - bounds.min;
                let point = Vec3::new(bounds.min.x + u * size.x, y, bounds.min.z + v * size.z);
                let magnitude = first.corners.iter().flatten().fold(0f32, |m, x| m.max(x.abs()));
                parts[1].push(receiver(off + i, point, Vec3::Y, magnitude, combine(seed, (off + i) as u32)));
            }
        }
        parts
    }

    fn ao(
        &self,
        far: Option<&FarCones<'_>>,
        radius: f32,
        pattern: &Pattern,
        receivers: &[Receiver],
    ) -> Vec<f32> {
        let mut ao = vec![0.0; receivers.len()];
        let (masks, outputs) = (MaskOptions::default().with_radius(radius), Outputs::new(&mut ao));
        self.blockers().answer(far, pattern, receivers, &masks, outputs, &mut |_| true).unwrap();
        ao
    }

    /// Where masks have to be exact up to for a sample of many such receivers.
    fn near(&self, radius: f32, rays: u32) -> Option<f32> {
        let options = PatternOptions::default().with_rays(rays);
        let pattern = Pattern::new(&options).unwrap();
        let masks = MaskOptions::default().with_radius(radius);
        let receivers = self.receivers(1, MAX_GROUP_SAMPLES, MAX_GROUP_SAMPLES).concat();
        let pilot = Pilot { of: 1 << 20, receivers };
        self.far.near(&self.blockers(), &pattern, &options, &masks, &pilot, &mut |_| true).unwrap()
    }

    /// [`Self::near`] over the extent.
    fn share(&self, radius: f32) -> Option<f32> {
        self.near(radius, 256).map(|near| near / radius.min(self.far.diagonal))
    }
}

/// Triangles before the ground.
fn off_count(mesh: &TriangleMesh, far: &FarOpacity) -> usize {
    mesh.triangles.len() - far.large.len()
}

#[test]
fn sampled_errors_say_where_the_field_begins() {
    let bush = Case::new(generated("bush", 30_000, 1.0));
    let diagonal = bush.mesh.bounds().diagonal();
    let shares = [0.3, f32::INFINITY].map(|radius| bush.share(radius * diagonal));
    assert!(shares.iter().all(|share| share.is_some_and(|share| share < 0.2)), "{shares:?}");
    // So near that the field has nothing to answer.
    assert_eq!(bush.share(0.001 * diagonal), None);
    // A floor darkens itself by cells that hold it.
    let mut floor = TriangleMesh::default();
    for i in 0..400 {
        let (x, z) = ((i % 20) as f32, (i / 20) as f32);
        square(&mut floor, [[x, 0.0, z], [x, 0.0, z + 1.0], [x + 1.0, 0.0, z + 1.0], [x + 1.0, 0.0, z]]);
    }
    let floor = Case::new(floor);
    let shares = [0.1, 1.0].map(|radius| floor.share(radius * floor.mesh.bounds().diagonal()));
    assert!(
        shares[0].is_none_or(|share| share > 0.2) && shares[1].is_some_and(|share| share < 0.2),
        "{shares:?}"
    );
}

/// Errors of the mean against exact masks with the same rays, on receivers that no sample had: off and on the ground.
fn held_out(case: &Case, radius: f32, near: f32) -> Vec<f64> {
    let pattern = Pattern::new(&PatternOptions::default().with_rays(64)).unwrap();
    let far = case.far.cones(pattern.len(), near, radius).unwrap();
    let parts = case.receivers(77, 1500, 1500);
    let of = |receivers: &Vec<Receiver>| {
        let [far, exact] = [Some(&far), None].map(|far| case.ao(far, radius, &pattern, receivers));
        let sum: f64 = far.iter().zip(&exact).map(|(a, b)| f64::from(a - b)).sum();
        sum / receivers.len() as f64
    };
    parts.iter().filter(|receivers| !receivers.is_empty()).map(of).collect()
}

#[test]
fn what_is_stated_holds_on_receivers_that_no_sample_had() {
    let mut fields = 0;
    for (name, triangles, ground) in [
        ("bush", 8_000, false),
        ("bush", 8_000, true),
        ("hairball", 8_000, true),
        ("city", 20_000, false),
        ("cathedral", 30_000, false),
    ] {
        let mesh = generated(name, triangles, 1.0);
        let case = Case::new(if ground { on_ground(mesh) } else { mesh });
        for radius in [0.1 * case.far.diagonal, f32::INFINITY] {
            let Some(near) = case.near(radius, 64) else { continue };
            let errors = held_out(&case, radius, near);
            fields += 1;
            assert_eq!(errors.len(), 1 + usize::from(ground));
            assert!(errors.iter().all(|e| e.abs() <= MAX_BIAS), "{name} {ground} {radius}: {errors:?}");
        }
    }
    assert!(fields >= 4, "nearly everything was exact: {fields}");
}

#[test]
fn semi_transparent_foliage_is_within_what_is_stated() {
    for opacity in [0.3, 0.7] {
        let case = Case::new(on_ground(generated("bush", 10_000, opacity)));
        assert!(case.blockers().depth_of.is_some());
        let radius = f32::INFINITY;
        let near = case.near(radius, 64).expect("foliage that the field can answer");
        let errors = held_out(&case, radius, near);
        assert!(errors.iter().all(|e| e.abs() <= MAX_BIAS), "{opacity}: {errors:?}");
        // What lies far away is not left out.
        let pattern = Pattern::new(&PatternOptions::default().with_rays(64)).unwrap();
        let [receivers, _] = case.receivers(5, 0, 200);
        let mean = |ao: Vec<f32>| ao.iter().sum::<f32>() / ao.len() as f32;
        let [all, near_only] = [radius, near].map(|radius| mean(case.ao(None, radius, &pattern, &receivers)));
        assert!(near_only - all > 0.05, "{near_only} {all}");
    }
}
