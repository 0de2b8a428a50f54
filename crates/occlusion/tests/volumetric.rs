//! Whatever occluders there are: every answer is that of the loop over all triangles.

mod solids;

use proptest::prelude::*;
use solids::{Aim, Mesh, Part, aim, cube, mesh, part, segments, sphere};
use std::sync::Arc;
use umbrage_accel::{
    BackEnd, BuildOptions, Bvh, Counters, brute,
    kdtree::{KdOptions, LeafState, Order, Search},
};
use umbrage_geom::{
    Aabb, Ray,
    glam::{DVec3, Vec3},
};
use umbrage_occlusion::OcclusionError;
use umbrage_occlusion::volumetric::{
    Ends, KdQuery, KdVolumetric, KdVolumetricOptions, KdVolumetricScratch, LazySolidBvh, Object, ObjectMesh,
    ShadowRays, SolidBvh, SolidBvhOptions, SolidOptions, published::Classifier,
};

fn orders() -> Vec<Order> {
    let mut orders =
        vec![Order::RAY, Order::EXTENDED, Order::EXTENDED_SPARSE, Order::BREADTH, Order::QUICK, Order::SOLID];
    orders.extend([Search::Breadth, Search::Quick, Search::Solid].map(|s| Order::new(s, 2).with_flush(true)));
    orders
}

fn kd(
    positions: &[[f32; 3]],
    triangles: &[[u32; 3]],
    objects: &[Object],
    options: &KdVolumetricOptions,
) -> KdVolumetric {
    let mesh = ObjectMesh::new(positions, triangles).with_objects(objects);
    KdVolumetric::build(&mesh, options, &mut |_| true).unwrap()
}

fn wide(bvh: Arc<Bvh>, mesh: &Mesh, objects: &[Object]) -> SolidBvh {
    let mesh = ObjectMesh::new(&mesh.0, &mesh.1).with_objects(objects);
    SolidBvh::build(bvh, &mesh, &SolidBvhOptions::default()).unwrap()
}

fn cases() -> impl Strategy<Value = (Vec<Part>, Vec<(Aim, Aim, u8)>)> {
    let aims = prop::collection::vec((aim(), aim(), 0u8..10), 24);
    (prop::collection::vec(part(), 1..5), aims)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(120))]

    #[test]
    fn every_order_gives_the_answers_of_the_predicate(
        (parts, aims) in cases(), apart in any::<bool>(), rays_classify in any::<bool>(),
        traverse in prop::sample::select(vec![0.1f32, 1.0]),
    ) {
        let (mesh, objects) = mesh(&parts);
        let rays = segments(&mesh, &parts, aims);
        let truth: Vec<bool> = rays.iter().map(|ray| brute::any_hit(&mesh.0, &mesh.1, ray)).collect();
        let options = KdVolumetricOptions::default()
            .with_tree(KdOptions::default().with_cost_traverse(traverse))
            .with_classifier(if rays_classify { Classifier::TestRays } else { Classifier::Flood });
        let objects = if apart { &objects[..] } else { &[] };
        let built = kd(&mesh.0, &mesh.1, objects, &options);
        for back_end in [BackEnd::Scalar, BackEnd::Avx2].into_iter().filter(|b| b.is_supported()) {
            let built = built.clone().with_back_end(back_end).unwrap();
            let mut scratch = KdVolumetricScratch::default();
            for order in orders() {
                for (light, guided) in [(None, false), (Some(1), false), (Some(2), true)] {
                    let query = KdQuery::default().with_order(order).with_light(light).with_guide(guided);
                    let single: Vec<bool> = rays.iter().map(|ray| built.any_hit(ray, &query, &mut scratch)).collect();
                    prop_assert_eq!(&single, &truth, "{:?} {:?}", query, back_end);
                    let mut packets = vec![false; rays.len()];
                    built.any_hits(&rays, &mut packets, &query, &mut scratch);
                    prop_assert_eq!(&packets, &truth, "{:?} {:?}", query, back_end);
                    // Where an end is outside for certain, saying so changes nothing.
                    for (ray, &hit) in rays.iter().zip(&truth) {
                        let end = ray.at(ray.tfar);
                        if ray.tfar == f32::INFINITY || built.is_outside(&Aabb { min: end - 1e-3, max: end + 1e-3 }) {
                            prop_assert_eq!(built.any_hit(ray, &query.with_ends(Ends::Outside), &mut scratch), hit);
                        }
                    }
                }
            }
        }
    }

    /// Solid boxes in a wide hierarchy: single rays, and fans of all kinds.
    #[test]
    fn wide_hierarchies_give_the_answers_of_the_predicate((parts, aims) in cases(), apart in any::<bool>(), leaf in 1u8..9) {
        let (mesh, objects) = mesh(&parts);
        let rays = segments(&mesh, &parts, aims);
        let objects = if apart { &objects[..] } else { &[] };
        let bvh = Bvh::build(&mesh.0, &mesh.1, &BuildOptions::default().with_leaf_size(leaf)).unwrap();
        let built = wide(Arc::new(bvh), &mesh, objects);
        // Fans from each origin towards where the other rays go, with lengths and ends of all kinds.
        let fans = rays.iter().flat_map(|from| {
            rays.iter().map(move |to| {
                let target = if to.tfar == f32::INFINITY { to.direction } else { to.origin + to.direction - from.origin };
                Ray { origin: from.origin, direction: target, ..*to }
            })
        });
        let fans: Vec<Ray> = fans.collect();
        let truth = |rays: &[Ray]| -> Vec<bool> { rays.iter().map(|ray| brute::any_hit(&mesh.0, &mesh.1, ray)).collect() };
        let (single_truth, fan_truth) = (truth(&rays), truth(&fans));
        for back_end in [BackEnd::Scalar, BackEnd::Avx2, BackEnd::Avx512].into_iter().filter(|b| b.is_supported()) {
            let built = built.clone().with_back_end(back_end).unwrap();
            let mut scratch = built.scratch();
            for light in [None, Some(1), Some(9)] {
                let single: Vec<bool> =
                    rays.iter().map(|ray| built.any_hit(ray, Ends::Unknown, light, &mut scratch)).collect();
                prop_assert_eq!(&single, &single_truth, "{:?} {:?}", light, back_end);
                let mut hits = vec![false; fans.len()];
                built.any_hits(&fans, &mut hits, Ends::Unknown, light, &mut scratch);
                for i in 0..fans.len() {
                    prop_assert_eq!(hits[i], fan_truth[i], "{:?} {:?} {:?}", light, back_end, fans[i]);
                }
                for (ray, &hit) in rays.iter().zip(&single_truth) {
                    let end = ray.at(ray.tfar);
                    if ray.tfar == f32::INFINITY || built.is_outside(&Aabb { min: end - 1e-3, max: end + 1e-3 }) {
                        prop_assert_eq!(built.any_hit(ray, Ends::Outside, light, &mut scratch), hit);
                    }
                }
            }
        }
    }

    /// Both classifiers mark the same cells, and what the exact winding number says of points in them.
    #[test]
    fn classifiers_agree((parts, _) in cases(), apart in any::<bool>(), at in [0.01f32..0.99, 0.01f32..0.99, 0.01f32..0.99]) {
        let (mesh, objects) = mesh(&parts);
        let objects = if apart { &objects[..] } else { &[] };
        let trees = [Classifier::Flood, Classifier::TestRays].map(|classifier| {
            let tree = KdOptions::default().with_cost_traverse(0.1);
            let options = KdVolumetricOptions::default().with_tree(tree).with_classifier(classifier);
            kd(&mesh.0, &mesh.1, objects, &options)
        });
        prop_assert_eq!(trees[0].occluders(), trees[1].occluders());
        let (mut a, mut b) = (Vec::new(), Vec::new());
        trees[0].tree().for_each_leaf(|leaf| a.push(leaf));
        trees[1].tree().for_each_leaf(|leaf| b.push(leaf));
        prop_assert_eq!(&a, &b);
        for leaf in a {
            let point = leaf.bounds.min + (leaf.bounds.max - leaf.bounds.min) * Vec3::from(at);
            let inside = point.cmpgt(leaf.bounds.min).all() && point.cmplt(leaf.bounds.max).all();
            if leaf.state != LeafState::Boundary && inside && !trees[0].solids().all().is_empty() {
                let winding = trees[0].solids().winding_number_of(&mesh.0, &mesh.1, point);
                prop_assert_eq!(leaf.state == LeafState::Opaque, winding != 0);
            }
        }
    }
}

fn build(parts: &[Part], options: &KdVolumetricOptions) -> (Mesh, KdVolumetric) {
    let (mesh, objects) = mesh(parts);
    let built = kd(&mesh.0, &mesh.1, &objects, options);
    (mesh, built)
}

const BALL: Part = (4, [0.0; 3], [1.0; 3], 11);

#[test]
fn a_ball_is_full_of_occluders_that_end_rays() {
    let (mesh, built) = build(&[BALL], &KdVolumetricOptions::default());
    assert_eq!(built.solids().all().len(), 1);
    let volume: f64 =
        built.occluders().iter().map(|b| (b.max - b.min).as_dvec3()).map(DVec3::element_product).sum();
    assert!(volume > 0.4 * 4.19, "{volume}");
    assert!(built.occurrence_rate() > 0.05 && built.occurrence_rate() < 0.6);
    let (mut counters, mut scratch) = (Counters::default(), KdVolumetricScratch::default());
    let query = KdQuery::default().with_light(Some(0));
    for i in 0..200 {
        let angle = i as f32 * 0.1;
        let from = Vec3::new(3.0 * angle.cos(), 0.3 * (angle * 0.7).sin(), 3.0 * angle.sin());
        let ray = Ray::between(from, -from * 1.1);
        assert!(built.any_hit_with(&ray, &query, &mut scratch, &mut counters));
        assert!(brute::any_hit(&mesh.0, &mesh.1, &ray));
    }
    assert!(counters.cell_hits > 190 && counters.cache_hits > 100, "{counters:?}");
    assert_eq!(counters.cell_hits + counters.triangle_hits + counters.misses, 200);
    assert!(counters.cell_area > 0.0 && counters.cache_lookups == 200);
    // Rays beside it, and rays of a mesh without generators, use ray order and look nothing up.
    let beside = Ray::between([-3.0, 2.0, 0.0], [3.0, 2.0, 0.0]);
    assert!(!built.any_hit_with(&beside, &query, &mut scratch, &mut counters));
    assert_eq!(counters.cache_lookups, 200);
}

#[test]
fn boxes_grow_over_cells_and_stay_inside() {
    let (mesh, built) = build(&[BALL, (4, [3.0, 0.5, 0.0], [1.0; 3], 11)], &KdVolumetricOptions::default());
    let volume =
        |boxes: &[Aabb]| boxes.iter().map(|b| (b.max - b.min).as_dvec3().element_product()).sum::<f64>();
    let largest = |boxes: &[Aabb]| boxes.iter().map(|b| volume(&[*b])).fold(0.0, f64::max);
    assert!(!built.grown().is_empty() && largest(built.grown()) > 1.5 * largest(built.occluders()));
    for aabb in built.grown() {
        for corner in 0..8 {
            let pick = |axis: usize| if corner >> axis & 1 == 1 { aabb.max[axis] } else { aabb.min[axis] };
            let corner = Vec3::new(pick(0), pick(1), pick(2));
            let nearest = corner.length().min((corner - Vec3::new(3.0, 0.5, 0.0)).length());
            // Corners may touch the surface.
            assert!(nearest < 1.0 + 1e-6, "{aabb:?}");
        }
    }
    // Rays that follow each other end at what the light remembers; those that pass look nothing up.
    let (mut counters, mut scratch) = (Counters::default(), KdVolumetricScratch::default());
    let query = KdQuery::default().with_order(Order::SOLID).with_light(Some(0)).with_guide(true);
    for i in 0..200 {
        let ray = Ray::between([0.0, 3.0, 0.0], [0.004 * i as f32 - 0.4, -3.0, 0.1]);
        assert!(built.any_hit_with(&ray, &query, &mut scratch, &mut counters));
        assert!(brute::any_hit(&mesh.0, &mesh.1, &ray));
    }
    assert!(counters.cache_hits > 190, "{counters:?}");
    let lookups = counters.cache_lookups;
    for i in 0..200 {
        let ray = Ray::between([-3.0, 1.45, 0.9 + 0.0004 * i as f32], [5.0, 1.45, 0.95]);
        assert!(!built.any_hit_with(&ray, &query, &mut scratch, &mut counters));
    }
    assert_eq!(counters.cache_lookups, lookups + 1);
}

#[test]
fn segments_inside_of_a_ball_hit_nothing() {
    let (_, built) = build(&[BALL], &KdVolumetricOptions::default());
    let mut scratch = KdVolumetricScratch::default();
    let mut counters = Counters::default();
    for order in orders() {
        let query = KdQuery::default().with_order(order).with_light(Some(0));
        let inside = Ray::between([-0.3, 0.1, 0.0], [0.4, -0.2, 0.1]);
        assert!(!built.any_hit_with(&inside, &query, &mut scratch, &mut counters));
        let out = inside.with_tfar(10.0);
        assert!(built.any_hit(&out, &query, &mut scratch));
        // A light in the middle of the ball, seen from within and without.
        assert!(!built.is_outside(&Aabb { min: Vec3::splat(-0.1), max: Vec3::splat(0.1) }));
        assert!(!built.any_hit(&Ray::between([0.5, 0.0, 0.0], [0.0; 3]), &query, &mut scratch));
        assert!(built.any_hit(&Ray::between([1.5, 0.0, 0.0], [0.0; 3]), &query, &mut scratch));
    }
    assert_eq!(counters.cell_hits, 0);
    assert!(built.is_outside(&Aabb { min: Vec3::splat(0.9), max: Vec3::splat(0.99) }));
    assert!(built.is_outside(&Aabb { min: Vec3::splat(5.0), max: Vec3::splat(6.0) }));
    assert!(!built.is_outside(&Aabb { min: Vec3::splat(-6.0), max: Vec3::splat(6.0) }));
}

/// A bowl: the ball without the triangles above a height.
fn bowl(height: f32) -> Mesh {
    let (positions, mut triangles) = sphere(4);
    triangles.retain(|t| t.iter().any(|&v| positions[v as usize][1] < height));
    (positions, triangles)
}

#[test]
fn an_open_ball_has_occluders_for_rays_that_avoid_its_hole() {
    let mesh = bowl(0.9);
    let closed_only = KdVolumetricOptions::default().with_solids(SolidOptions::default().with_max_holes(0));
    let none = kd(&mesh.0, &mesh.1, &[], &closed_only);
    assert!(none.solids().all().is_empty() && none.occluders().is_empty());
    let built = kd(&mesh.0, &mesh.1, &[], &KdVolumetricOptions::default());
    assert_eq!((built.solids().all()[0].holes, built.solids().guards().len()), (1, 1));
    let (mut scratch, mut counters) = (KdVolumetricScratch::default(), Counters::default());
    let query = KdQuery::default();
    // Across, below the hole.
    assert!(built.any_hit_with(
        &Ray::between([-3.0, -0.1, 0.2], [3.0, 0.0, 0.0]),
        &query,
        &mut scratch,
        &mut counters
    ));
    assert_eq!(counters.cell_hits, 1);
    // From inside through the hole: nothing is in the way.
    let through = Ray::between([0.0, 0.0, 0.0], [0.05, 4.0, 0.0]);
    assert!(!brute::any_hit(&mesh.0, &mesh.1, &through));
    assert!(!built.any_hit(&through, &query, &mut scratch));
    // The other way, into the bottom.
    let down = Ray::between([0.05, 4.0, 0.0], [0.0, -3.0, 0.0]);
    assert!(built.any_hit_with(&down, &query, &mut scratch, &mut counters));
    assert_eq!((counters.cell_hits, counters.triangle_hits), (1, 1));
}

#[test]
fn a_wide_hierarchy_over_a_ball_ends_rays_at_boxes() {
    let (mesh, objects) = mesh(&[BALL]);
    let bvh = Arc::new(Bvh::build(&mesh.0, &mesh.1, &BuildOptions::default()).unwrap());
    let built = wide(bvh, &mesh, &objects);
    assert!(
        built.solid_count() == 1
            && built.coverage(0).is_some_and(|c| c > 0.3)
            && !built.occluders().is_empty()
    );
    for aabb in built.occluders() {
        let farthest = aabb.min.abs().max(aabb.max.abs());
        assert!(farthest.length() < 1.0, "{aabb:?}");
    }
    let (mut scratch, mut counters) = (built.scratch(), Counters::default());
    for i in 0..200 {
        let angle = i as f32 * 0.1;
        let from = Vec3::new(3.0 * angle.cos(), 0.3 * (angle * 0.7).sin(), 3.0 * angle.sin());
        let ray = Ray::between(from, -from * 1.1);
        assert!(built.any_hit_with(&ray, Ends::Unknown, Some(0), &mut scratch, &mut counters));
        let inside = Ray::between(from * 0.1, -from * 0.1);
        assert!(!built.any_hit(&inside, Ends::Unknown, Some(0), &mut scratch));
    }
    assert!(counters.solid_hits == 200 && counters.remembered_hits > 150, "{counters:?}");
    // Once there are many lights none has boxes of its own.
    let (ray, own) = (Ray::between([3.0, 0.0, 0.0], [-3.0, 0.1, 0.0]), counters.remembered_hits);
    for light in [20, 0] {
        assert!(built.any_hit_with(&ray, Ends::Unknown, Some(light), &mut scratch, &mut counters));
    }
    assert!(counters.solid_hits == 202 && counters.remembered_hits == own, "{counters:?}");
    // An open one, from inside through the hole.
    let mesh = bowl(0.9);
    let bvh = Arc::new(Bvh::build(&mesh.0, &mesh.1, &BuildOptions::default()).unwrap());
    let built = wide(bvh, &mesh, &[]);
    assert!(built.solid_count() == 1);
    let mut scratch = built.scratch();
    assert!(!built.any_hit(&Ray::between([0.0; 3], [0.05, 4.0, 0.0]), Ends::Unknown, None, &mut scratch));
}

#[test]
fn boxes_are_built_only_where_they_pay() {
    let light = Vec3::new(3.0, 4.0, 1.0);
    let built = |(positions, triangles): &Mesh, objects: &[Object], together: f64| {
        let bvh = Arc::new(Bvh::build(positions, triangles, &BuildOptions::default()).unwrap());
        let options = SolidBvhOptions::default();
        let parts = ObjectMesh::new(positions, triangles).with_objects(objects);
        let rays = ShadowRays { lights: &[light], count: 1e9, together };
        let built = SolidBvh::build_if_it_pays(&bvh, &parts, &rays, &options).unwrap();
        if let Some(built) = &built {
            let forecast = built.forecast(&[light]);
            assert!(forecast.pays() && forecast.coverage > 0.3 && forecast.occurrence > 0.2, "{forecast:?}");
        }
        // Nothing else holds the hierarchy then: no boxes were put into it.
        (built.is_some(), Arc::strong_count(&bvh))
    };
    let (positions, triangles) = sphere(5);
    let ball = |count: u32| Object { triangles: 0..count, opaque: true };
    let all = triangles.len() as u32;
    assert_eq!(built(&(positions.clone(), triangles.clone()), &[], 16.0), (true, 1));
    // It is too small for rays that come one by one.
    assert_eq!(built(&(positions.clone(), triangles.clone()), &[], 1.0), (false, 1));
    assert_eq!(built(&sphere(6), &[], 1.0), (true, 1));
    // Large triangles block as well as boxes.
    assert_eq!(built(&sphere(2), &[], 16.0), (false, 1));
    // A sheet has no inside worth the name.
    let sheet = positions.iter().map(|p| [p[0], p[1] * 1e-3, p[2]]).collect();
    assert_eq!(built(&(sheet, triangles.clone()), &[], 16.0), (false, 1));
    // Most of the scene is leaves.
    let (mut leaves, mut more) = (positions, triangles);
    for i in 0..9_000u32 {
        let at = Vec3::new((i % 97) as f32, (i % 89) as f32, (i % 83) as f32) * 0.1;
        let first = leaves.len() as u32;
        leaves.extend([at, at + Vec3::X * 0.05, at + Vec3::Y * 0.05].map(|p| p.to_array()));
        more.push([first, first + 1, first + 2]);
    }
    let open = Object { triangles: all..more.len() as u32, opaque: true };
    assert_eq!(built(&(leaves, more), &[ball(all), open], 16.0), (false, 1));
}

#[test]
fn flat_and_hopeless_objects_generate_nothing() {
    let (positions, triangles) = cube();
    let flat: Vec<[f32; 3]> = positions.iter().map(|p| [p[0], p[1], 0.5]).collect();
    let built = kd(&flat, &triangles, &[], &KdVolumetricOptions::default());
    assert!(built.solids().all().is_empty());
    // Half of the cube is missing: the hole is larger than allowed.
    let built = kd(&positions, &triangles[..6], &[], &KdVolumetricOptions::default());
    assert!(built.solids().all().is_empty());
    // Transparent objects never block.
    let clear = Object { triangles: 0..12, opaque: false };
    let built = kd(&positions, &triangles, &[clear], &KdVolumetricOptions::default());
    assert!(built.occluders().is_empty());
}

#[test]
fn scratch_of_another_structure_starts_anew() {
    let apart: Part = (4, [10.0, 0.0, 0.0], [1.0; 3], 11);
    let rays: Vec<Ray> =
        (0..50).map(|i| Ray::between([3.0, 0.01 * i as f32, 0.1], [-3.0, 0.0, 0.0])).collect();
    let [here, there] = [BALL, apart].map(|part| build(&[part], &KdVolumetricOptions::default()));
    let query = KdQuery::default().with_light(Some(0));
    for query in [query, query.with_guide(true)] {
        let mut scratch = KdVolumetricScratch::default();
        for _ in 0..2 {
            assert!(rays.iter().all(|ray| here.1.any_hit(ray, &query, &mut scratch)));
            assert!(!rays.iter().any(|ray| there.1.any_hit(ray, &query, &mut scratch)));
        }
    }
    let [here, there] = [&here.0, &there.0].map(|mesh| {
        let bvh = Arc::new(Bvh::build(&mesh.0, &mesh.1, &BuildOptions::default()).unwrap());
        wide(bvh, mesh, &[])
    });
    let mut scratch = here.scratch();
    for _ in 0..2 {
        assert!(rays.iter().all(|ray| here.any_hit(ray, Ends::Unknown, Some(0), &mut scratch)));
        assert!(!rays.iter().any(|ray| there.any_hit(ray, Ends::Unknown, Some(0), &mut scratch)));
    }
}

#[test]
fn bad_objects_hierarchies_and_settings_are_named() {
    let (positions, triangles) = cube();
    let mesh = ObjectMesh::new(&positions, &triangles);
    let bvh = Arc::new(Bvh::build(&positions, &triangles, &BuildOptions::default()).unwrap());
    let object = |triangles| Object { triangles, opaque: true };
    let beyond = [object(0..4), object(4..13)];
    let start_after_end = Object { triangles: std::ops::Range { start: 5, end: 4 }, opaque: true };
    let turned = [start_after_end];
    let shared = [object(6..12), object(0..7)];
    let missing = [[0, 1, 8]];
    let options = SolidBvhOptions::default();
    let all = |mesh: &ObjectMesh<'_>, options: &SolidBvhOptions| {
        let kd = KdVolumetricOptions::default().with_solids(options.solids);
        let errors = [
            SolidBvh::build(bvh.clone(), mesh, options).err(),
            LazySolidBvh::build(bvh.clone(), mesh, options).err(),
            KdVolumetric::build(mesh, &kd, &mut |_| true).err(),
        ];
        // As text, since NaN differs from itself.
        let [first, second, third] = [0, 1, 2].map(|i| format!("{:?}", errors[i]));
        assert!(first == second && second == third, "{errors:?}");
        errors.into_iter().next().flatten()
    };
    assert_eq!(all(&mesh, &options), None);
    let error = all(&mesh.clone().with_objects(&beyond[..]), &options);
    assert_eq!(error, Some(OcclusionError::Object { object: 1, start: 4, end: 13, triangles: 12 }));
    let error = all(&mesh.clone().with_objects(&turned[..]), &options);
    assert_eq!(error, Some(OcclusionError::Object { object: 0, start: 5, end: 4, triangles: 12 }));
    let error = all(&mesh.clone().with_objects(&shared[..]), &options);
    assert_eq!(error, Some(OcclusionError::Overlap { triangle: 6, objects: [1, 0] }));
    for area in [-1.0, f32::NAN, f32::INFINITY] {
        let options = options.with_solids(SolidOptions::default().with_max_guard_area(area));
        let error = all(&mesh, &options);
        assert!(matches!(error, Some(OcclusionError::Setting { what: "max_guard_area", .. })), "{error:?}");
    }
    let error = KdVolumetric::build(
        &ObjectMesh::new(&positions, &missing),
        &KdVolumetricOptions::default(),
        &mut |_| true,
    );
    assert!(matches!(error, Err(OcclusionError::Mesh(_))));
    let other = SolidBvh::build(bvh, &ObjectMesh::new(&positions, &triangles[..6]), &options);
    assert!(matches!(other, Err(OcclusionError::Triangles { count: 12, triangles: 6 })));
}
