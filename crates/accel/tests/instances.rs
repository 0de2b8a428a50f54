//! Rounding between world and object space: rays that it moves into an instance hit it.

use std::sync::Arc;
use umbrage_accel::{BuildOptions, Bvh, InstancedBvh, Placement, brute};
use umbrage_geom::{
    Ray,
    glam::{Affine3A, Mat3A, Quat, Vec3, Vec3A},
    sampling::RandomStream,
};

/// A square of two triangles around `center`, across z.
fn square(center: Vec3, half: f32) -> (Vec<[f32; 3]>, Vec<[u32; 3]>) {
    let corner = |x: f32, y: f32| (center + Vec3::new(x, y, 0.0) * half).to_array();
    (
        vec![corner(-1.0, -1.0), corner(1.0, -1.0), corner(1.0, 1.0), corner(-1.0, 1.0)],
        vec![[0, 1, 2], [0, 2, 3]],
    )
}

/// Asks rays of the placed mesh and compares with a loop over all triangles. Returns how many hit, and how many of these miss
/// the mesh as placed in `f64`, so that rounding alone makes them hit.
fn compare(
    mesh: &(Vec<[f32; 3]>, Vec<[u32; 3]>),
    world_from_object: Affine3A,
    rays: impl Iterator<Item = Ray>,
) -> [usize; 2] {
    let bvh = Arc::new(Bvh::build(&mesh.0, &mesh.1, &BuildOptions::default()).unwrap());
    let placements = [Placement { bvh: 0, world_from_object }];
    let instanced = InstancedBvh::build(vec![bvh], &placements).unwrap();
    let matrix = world_from_object.matrix3;
    let place = |p: [f32; 3]| {
        let [x, y, z] = p.map(f64::from);
        Vec3::from(matrix.x_axis).as_dvec3() * x
            + Vec3::from(matrix.y_axis).as_dvec3() * y
            + Vec3::from(matrix.z_axis).as_dvec3() * z
            + Vec3::from(world_from_object.translation).as_dvec3()
    };
    let corners: Vec<_> = mesh.0.iter().map(|&p| place(p)).collect();
    let mut counts = [0; 2];
    for ray in rays {
        let truth = brute::closest_instance_hit(&[(&mesh.0, &mesh.1)], &placements, &ray);
        assert_eq!(instanced.closest_hit(&ray), truth, "{ray:?}");
        assert_eq!(instanced.any_hit(&ray), truth.is_some(), "{ray:?}");
        if truth.is_some() {
            // The square's coordinates where the ray meets its plane, from -1 to 1 inside.
            let (u, v) = (corners[1] - corners[0], corners[3] - corners[0]);
            let (normal, o, d) = (u.cross(v), ray.origin.as_dvec3(), ray.direction.as_dvec3());
            let at = o + d * ((corners[0] - o).dot(normal) / d.dot(normal)) - corners[0];
            let inside = |axis: umbrage_geom::glam::DVec3| {
                (0.0..=1.0).contains(&(at.dot(axis) / axis.length_squared()))
            };
            counts[0] += 1;
            counts[1] += usize::from(!(inside(u) && inside(v)));
        }
    }
    counts
}

/// A turn that no `f32` has exactly.
fn turn() -> Mat3A {
    Mat3A::from_quat(Quat::from_xyzw(0.2, -0.5, 0.3, 0.7).normalize())
}

fn unit(random: &mut RandomStream) -> f32 {
    2.0 * random.next_unit() - 1.0
}

/// Origins far away are rounded in object space by more than the box's own rounding: the slab test is padded for that.
#[test]
fn rays_from_far_away_are_not_lost() {
    let mesh = square(Vec3::ZERO, 1.0);
    let map = Affine3A { matrix3: turn(), translation: Vec3A::new(0.3, 0.1, -0.2) };
    let mut random = RandomStream::new(3, 0);
    let rays = std::iter::repeat_with(|| {
        // Through points near the square's edges.
        let (along, out) = (unit(&mut random), 1.0 + 0.1 * unit(&mut random));
        let [x, y] = if random.next_unit() < 0.5 { [along, out] } else { [out, along] };
        let target = map.transform_point3(Vec3::new(x, y, 0.0));
        let away = Vec3::new(unit(&mut random), unit(&mut random), unit(&mut random));
        let origin = away.normalize_or(Vec3::X) * 1e6;
        Ray::new(origin, target - origin)
    });
    let [hits, by_rounding] = compare(&mesh, map, rays.take(20_000));
    assert!(hits > 1000 && by_rounding > 50, "{hits} {by_rounding}");
}

/// Objects far from their own origin that are moved back: the instance's box is padded for what rounding does to them.
#[test]
fn objects_far_from_their_origin_are_not_lost() {
    let center = Vec3::new(1e6, -5e5, 7e5);
    let mesh = square(center, 2.0);
    let matrix3 = turn();
    let map = Affine3A { matrix3, translation: -(matrix3 * Vec3A::from(center)) };
    let mut random = RandomStream::new(4, 0);
    let rays = std::iter::repeat_with(|| {
        let (along, out) = (2.0 * unit(&mut random), 2.0 + 0.2 * unit(&mut random));
        let [x, y] = if random.next_unit() < 0.5 { [along, out] } else { [out, along] };
        let target = Vec3::from(matrix3 * Vec3A::new(x, y, 0.0));
        let away = Vec3::new(unit(&mut random), unit(&mut random), unit(&mut random));
        let origin = target + away.normalize_or(Vec3::X) * 4.0;
        Ray::new(origin, target - origin)
    });
    let [hits, by_rounding] = compare(&mesh, map, rays.take(20_000));
    assert!(hits > 1000 && by_rounding > 50, "{hits} {by_rounding}");
}
