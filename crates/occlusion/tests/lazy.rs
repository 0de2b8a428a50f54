//! Objects are prepared when rays come near them, alone or as instances, and answers are those of the plain hierarchies.

mod solids;

use proptest::prelude::*;
use rayon::prelude::*;
use solids::{Aim, Part, aim, mesh, part, segments};
use std::sync::Arc;
use umbrage_accel::{BuildOptions, Bvh, Counters, InstancedBvh, Placement, brute};
use umbrage_geom::{
    Ray,
    glam::{Affine3A, EulerRot, Mat3A, Quat, Vec3, Vec3A},
};
use umbrage_occlusion::volumetric::{
    Ends, LazySolidBvh, Object, ObjectMesh, SolidBvhOptions, SolidInstances,
};

/// Turned, stretched, sheared, mirrored.
fn transform() -> impl Strategy<Value = Affine3A> {
    let scale = || prop_oneof![3 => Just(1f32), 1 => Just(-1.5), 1 => 0.2f32..2.0];
    let angle = || prop_oneof![Just(0f32), -3f32..3.0];
    let to = || prop_oneof![(-5i8..=5).prop_map(f32::from), -5f32..5.0];
    ([angle(), angle(), angle()], [scale(), scale(), scale()], [to(), to(), to()], -0.5f32..0.5).prop_map(
        |(turn, scale, to, shear)| {
            let turn = Quat::from_euler(EulerRot::XYZ, turn[0], turn[1], turn[2]);
            let shear = Mat3A::from_cols(Vec3A::X, Vec3A::new(shear, 1.0, 0.0), Vec3A::Z);
            let matrix3 = Mat3A::from_quat(turn) * shear * Mat3A::from_diagonal(scale.into());
            Affine3A { matrix3, translation: to.into() }
        },
    )
}

fn lazy<'a>(
    bvh: &Arc<Bvh>,
    (positions, triangles): &'a solids::Mesh,
    objects: &[Object],
) -> LazySolidBvh<'a> {
    let parts = ObjectMesh::new(positions, triangles).with_objects(objects.to_vec());
    LazySolidBvh::build(bvh.clone(), &parts, &SolidBvhOptions::default()).unwrap()
}

fn plain((positions, triangles): &solids::Mesh) -> Arc<Bvh> {
    Arc::new(Bvh::build(positions, triangles, &BuildOptions::default()).unwrap())
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(120))]

    /// Segments between points in, on and around the instances: lights inside of some, both ends inside.
    #[test]
    fn instances_give_the_answers_of_the_plain_ones(
        meshes in prop::collection::vec(prop::collection::vec(part(), 1..4), 1..3),
        maps in prop::collection::vec((any::<usize>(), transform()), 1..6),
        aims in prop::collection::vec((any::<usize>(), any::<usize>(), (aim(), aim(), 0u8..10)), 32),
    ) {
        let built: Vec<_> = meshes.iter().map(|parts| mesh(parts)).collect();
        let bvhs: Vec<Arc<Bvh>> = built.iter().map(|(mesh, _)| plain(mesh)).collect();
        let placements: Vec<Placement> = maps
            .iter()
            .map(|(index, map)| Placement { bvh: (index % built.len()) as u32, world_from_object: *map })
            .collect();
        let top = InstancedBvh::build(bvhs.clone(), &placements).unwrap();
        // A segment from a place in one instance to one in another.
        let segment = |&(from, to, aim): &(usize, usize, (Aim, Aim, u8))| {
            let place = |instance: usize, aim: Aim| {
                let placement = &placements[instance % placements.len()];
                let (mesh, _) = &built[placement.bvh as usize];
                let object = solids::point(mesh, &meshes[placement.bvh as usize], aim);
                placement.world_from_object.transform_point3(object)
            };
            let ray = Ray::between(place(from, aim.0), place(to, aim.1));
            if aim.2 == 0 { ray.with_tfar(f32::INFINITY) } else { ray }
        };
        let rays: Vec<Ray> = aims.iter().map(segment).collect();
        let views: Vec<_> =
            built.iter().map(|((positions, triangles), _)| (&positions[..], &triangles[..])).collect();
        let solid = SolidInstances::build(
            &top,
            built.iter().zip(&bvhs).map(|((mesh, objects), bvh)| lazy(bvh, mesh, objects)).collect(),
        ).unwrap();
        prop_assert_eq!(solid.prepared().prepared, 0);
        let mut counters = Counters::default();
        let mut scratch = solid.scratch();
        // Twice: with boxes that are just being made, and with all of them.
        for _ in 0..2 {
            for ray in &rays {
                let expected = top.any_hit(ray);
                prop_assert_eq!(expected, brute::closest_instance_hit(&views, &placements, ray).is_some());
                prop_assert_eq!(solid.any_hit(ray, &mut scratch), expected, "{:?}", ray);
                prop_assert_eq!(solid.any_hit_with(ray, &mut scratch, &mut counters), expected);
            }
        }
        let prepared = solid.prepared();
        prop_assert!(prepared.generators <= prepared.prepared && prepared.prepared <= prepared.objects);
    }

    #[test]
    fn lazy_objects_give_the_answers_of_the_predicate(
        parts in prop::collection::vec(part(), 1..6),
        aims in prop::collection::vec((aim(), aim(), 0u8..10), 40),
    ) {
        let (mesh, objects) = mesh(&parts);
        let rays = segments(&mesh, &parts, aims);
        let lazy = lazy(&plain(&mesh), &mesh, &objects);
        let mut scratch = lazy.scratch();
        for light in [None, Some(2)] {
            for rays in rays.chunks(7) {
                let mut hits = vec![false; rays.len()];
                lazy.any_hits(rays, &mut hits, Ends::Unknown, light, &mut scratch);
                for (ray, hit) in rays.iter().zip(hits) {
                    prop_assert_eq!(hit, brute::any_hit(&mesh.0, &mesh.1, ray), "{:?}", ray);
                }
            }
        }
    }
}

/// Balls in a row along x, three apart, with holes too large for a generator in every third.
fn row(count: u32) -> (solids::Mesh, Vec<Object>) {
    let ball =
        |i: u32| -> Part { (4, [3.0 * i as f32, 0.0, 0.0], [1.0; 3], if i % 3 == 2 { 4 } else { 11 }) };
    mesh(&(0..count).map(ball).collect::<Vec<_>>())
}

/// Rays down on to ball `i`.
fn on_to(i: u32) -> Vec<Ray> {
    let x = 3.0 * i as f32;
    (0..50).map(|k| Ray::between([x + 0.02 * k as f32 - 0.5, 3.0, 0.1], [x, -3.0, 0.0])).collect()
}

#[test]
fn objects_that_no_ray_reaches_are_not_prepared() {
    let (mesh, objects) = row(12);
    let bvh = plain(&mesh);
    let lazy = lazy(&bvh, &mesh, &objects);
    let mut scratch = lazy.scratch();
    assert_eq!((lazy.prepared().objects, lazy.prepared().prepared), (12, 0));
    let mut counters = Counters::default();
    for i in [4, 7, 5] {
        for ray in on_to(i) {
            let expected = bvh.any_hit(&ray);
            assert_eq!(
                lazy.any_hit_with(&ray, Ends::Unknown, Some(0), &mut scratch, &mut counters),
                expected
            );
        }
    }
    let prepared = lazy.prepared();
    // The last of the three is a bowl.
    assert_eq!((prepared.prepared, prepared.generators), (3, 2));
    assert!(prepared.boxes > 20 && counters.solid_hits > 90, "{prepared:?} {counters:?}");
    // A ray past all of them.
    assert!(!lazy.any_hit_with(
        &Ray::between([-9.0, 2.0, 0.0], [90.0, 2.0, 0.0]),
        Ends::Unknown,
        None,
        &mut scratch,
        &mut counters
    ));
    assert_eq!(lazy.prepared(), prepared);
}

#[test]
fn threads_prepare_each_object_once_and_the_same_ones() {
    let (mesh, objects) = row(30);
    let bvh = plain(&mesh);
    let prepared = [1, 4].map(|threads| {
        let lazy = lazy(&bvh, &mesh, &objects);
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let rays: Vec<Ray> = (0..600u32).flat_map(|i| on_to(i * 8 % 21)).collect();
        pool.install(|| {
            rays.par_chunks(50).for_each_init(
                || lazy.scratch(),
                |scratch, rays| {
                    let mut hits = vec![false; rays.len()];
                    lazy.any_hits(rays, &mut hits, Ends::Unknown, Some(1), scratch);
                    assert!(rays.iter().zip(hits).all(|(ray, hit)| hit == bvh.any_hit(ray)));
                },
            );
        });
        lazy.prepared()
    });
    assert_eq!(prepared[0], prepared[1]);
    assert_eq!((prepared[0].objects, prepared[0].prepared, prepared[0].generators), (30, 21, 14));
}

#[test]
fn instances_share_what_their_mesh_has() {
    let (ball, one) = row(1);
    let (other, two) = row(2);
    let bvhs = vec![plain(&ball), plain(&other)];
    let at = |bvh: u32, x: f32, scale: f32| Placement {
        bvh,
        world_from_object: Affine3A::from_scale_rotation_translation(
            Vec3::splat(scale),
            Quat::from_rotation_z(0.3),
            Vec3::new(x, 0.0, 0.0),
        ),
    };
    let mut placements: Vec<Placement> = (0..20).map(|i| at(0, 4.0 * i as f32, 1.0)).collect();
    placements.push(at(1, 0.0, 0.01));
    placements[20].world_from_object.translation.y = -50.0;
    let top = InstancedBvh::build(bvhs.clone(), &placements).unwrap();
    let solid =
        SolidInstances::build(&top, vec![lazy(&bvhs[0], &ball, &one), lazy(&bvhs[1], &other, &two)]).unwrap();
    let (mut scratch, mut counters) = (solid.scratch(), Counters::default());
    for i in 0..20 {
        let x = 4.0 * i as f32;
        for k in 0..20 {
            let through = Ray::between([x + 0.04 * k as f32 - 0.4, 3.0, 0.1], [x, -3.0, 0.0]);
            assert!(solid.any_hit_with(&through, &mut scratch, &mut counters));
            // A light inside of the instance, seen from inside.
            let inside = Ray::between([x + 0.02 * k as f32 - 0.2, 0.5, 0.1], [x, -0.5, 0.0]);
            assert!(!solid.any_hit_with(&inside, &mut scratch, &mut counters));
        }
    }
    let prepared = solid.prepared();
    assert_eq!((prepared.objects, prepared.prepared, prepared.generators), (3, 1, 1));
    assert!(counters.solid_hits > 380, "{counters:?}");
}

#[test]
fn scratch_of_another_structure_starts_anew() {
    let ball = solids::sphere(4);
    let moved: solids::Mesh = (ball.0.iter().map(|p| [p[0] + 10.0, p[1], p[2]]).collect(), ball.1.clone());
    let [here, there] = [&ball, &moved].map(|mesh| lazy(&plain(mesh), mesh, &[]));
    let through = |i: usize| Ray::between([3.0, 0.01 * i as f32, 0.1], [-3.0, 0.0, 0.0]);
    let mut scratch = here.scratch();
    let mut any_hit = |solid: &LazySolidBvh<'_>, ray: &Ray| {
        let mut hit = [false];
        solid.any_hits(std::slice::from_ref(ray), &mut hit, Ends::Unknown, Some(0), &mut scratch);
        hit[0]
    };
    for i in 0..40 {
        assert!(any_hit(&here, &through(i)));
        assert!(!any_hit(&there, &through(i)));
    }
    // One mesh, then two.
    let at =
        |bvh, x| Placement { bvh, world_from_object: Affine3A::from_translation(Vec3::new(x, 0.0, 0.0)) };
    let bvhs = vec![plain(&ball), plain(&ball)];
    let one = InstancedBvh::build(bvhs[..1].to_vec(), &[at(0, 0.0)]).unwrap();
    let two = InstancedBvh::build(bvhs.clone(), &[at(0, 10.0), at(1, 20.0)]).unwrap();
    let meshes = |count: usize| (0..count).map(|i| lazy(&bvhs[i], &ball, &[])).collect::<Vec<_>>();
    let solids =
        [SolidInstances::build(&one, meshes(1)).unwrap(), SolidInstances::build(&two, meshes(2)).unwrap()];
    let mut scratch = solids[0].scratch();
    for i in 0..40 {
        assert!(solids[0].any_hit(&through(i), &mut scratch));
        assert!(!solids[1].any_hit(&through(i), &mut scratch));
    }
    assert!(SolidInstances::build(&two, meshes(1)).is_err());
}
