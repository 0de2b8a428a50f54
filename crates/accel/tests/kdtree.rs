//! The kd-tree in every order against the loop over all triangles, and what its empty cells promise.

use proptest::prelude::*;
use umbrage_accel::{
    BackEnd, BuildError, Counters, KdTree, brute,
    kdtree::{KdOptions, KdScratch, LeafState, Location, Order, Search},
};
use umbrage_geom::{Ray, crosses_triangle, glam::Vec3, segment_hits_triangle};

type Soup = (Vec<[f32; 3]>, Vec<[u32; 3]>);

/// Integers meet planes, edges and vertices exactly.
fn coordinate() -> impl Strategy<Value = f32> {
    prop_oneof![
        8 => (-3i8..=3).prop_map(f32::from),
        8 => -3f32..3.0,
        1 => prop::sample::select(vec![-0.0f32, 1e-40, 1e-12, 1_000.0, 1.000_000_1]),
    ]
}

fn point() -> impl Strategy<Value = [f32; 3]> {
    [coordinate(), coordinate(), coordinate()]
}

fn soup() -> impl Strategy<Value = Soup> {
    let scale = prop::sample::select(vec![1f32, 1.0, 1.0, 1e-12, 1e12, 1e20]);
    (prop::collection::vec(point(), 1..40), prop::collection::vec(any::<[u16; 3]>(), 1..100), scale).prop_map(
        |(mut positions, indices, scale)| {
            positions.iter_mut().flatten().for_each(|x| *x *= scale);
            let count = positions.len();
            let triangles = indices.iter().map(|t| t.map(|i| u32::from(i) % count as u32)).collect();
            (positions, triangles)
        },
    )
}

fn ray() -> impl Strategy<Value = Ray> {
    let end = prop_oneof![Just(f32::INFINITY), Just(1.0), 0f32..3.0, Just(f32::NAN)];
    (point(), point(), 0u8..6, end, prop_oneof![3 => Just(0f32), 1 => 0f32..0.5]).prop_map(
        |(origin, mut target, kind, tfar, tnear)| {
            let origin = Vec3::from(origin);
            if kind < 3 {
                // Along an axis, or in a plane.
                target[usize::from(kind)] = origin[usize::from(kind)];
                if kind == 0 {
                    target[1] = origin[1];
                }
            }
            Ray { origin, direction: Vec3::from(target) - origin, tnear, tfar }
        },
    )
}

fn orders() -> Vec<Order> {
    let mut orders =
        vec![Order::RAY, Order::EXTENDED, Order::EXTENDED_SPARSE, Order::BREADTH, Order::QUICK, Order::SOLID];
    orders.extend([Search::Breadth, Search::Quick, Search::Solid].map(|s| Order::new(s, 3).with_flush(true)));
    orders
}

fn scaled((positions, _): &Soup, rays: &[Ray]) -> Vec<Ray> {
    let size = positions.iter().flatten().fold(0f32, |m, x| m.max(x.abs())) / 3.0;
    let scale = if (0.3..1e3).contains(&size) { 1.0 } else { size };
    rays.iter().map(|r| Ray { origin: r.origin * scale, direction: r.direction * scale, ..*r }).collect()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(1000))]

    #[test]
    fn every_order_agrees_with_brute_force(
        soup in soup(), rays in prop::collection::vec(ray(), 8),
        intersect in prop::sample::select(vec![0.5f32, 3.0, 40.0]), packet in any::<bool>(),
    ) {
        let rays = scaled(&soup, &rays);
        let options = KdOptions::default().with_cost_intersect(intersect);
        let tree = KdTree::build(&soup.0, &soup.1, &options).unwrap();
        let truth: Vec<bool> = rays.iter().map(|ray| brute::any_hit(&soup.0, &soup.1, ray)).collect();
        for back_end in [BackEnd::Scalar, BackEnd::Avx2].into_iter().filter(|b| b.is_supported()) {
            let mut tree = tree.clone().with_back_end(back_end).unwrap();
            tree.prefer_opaque();
            for order in orders() {
                let (mut one, mut four) = (KdScratch::default(), KdScratch::default());
                let found: Vec<bool> = if packet {
                    rays.chunks(4).flat_map(|r| {
                        let r = [&r[0], &r[1], &r[2], &r[3]];
                        tree.blockers_with(r, order, &mut (), &mut four, &mut ()).map(|b| b.any())
                    }).collect()
                } else {
                    rays.iter().map(|r| tree.blocker_with(r, order, &mut (), &mut one, &mut ()).any()).collect()
                };
                prop_assert_eq!(&found, &truth, "{:?} {:?}", order, back_end);
            }
        }
    }

    /// Leaves fill the bounds without overlap, empty ones hold no triangle, neighbours see no triangle between them, and
    /// points are found where they are.
    #[test]
    fn empty_cells_are_empty(soup in soup(), a in [0f32..1.0, 0f32..1.0, 0f32..1.0], b in [0f32..1.0, 0f32..1.0, 0f32..1.0]) {
        let (positions, triangles) = &soup;
        let tree = KdTree::build(positions, triangles, &KdOptions::default()).unwrap();
        let mut leaves = Vec::new();
        tree.for_each_leaf(|leaf| leaves.push(leaf));
        let volume = |b: &umbrage_geom::Aabb| (b.max.as_dvec3() - b.min.as_dvec3()).element_product();
        let sum: f64 = leaves.iter().map(|leaf| volume(&leaf.bounds)).sum();
        prop_assert!((sum - volume(&tree.bounds())).abs() <= 1e-6 * volume(&tree.bounds()));
        let corners = |t: &[u32; 3]| t.map(|v| positions[v as usize]);
        let inside = |b: &umbrage_geom::Aabb, w: [f32; 3]| {
            let p = b.min + (b.max - b.min) * Vec3::from(w);
            (p.cmpgt(b.min).all() && p.cmplt(b.max).all()).then_some(p)
        };
        for leaf in &leaves {
            let (p, q) = (inside(&leaf.bounds, a), inside(&leaf.bounds, b));
            if let Some(p) = p {
                prop_assert_eq!(tree.locate(p.as_dvec3(), 0.0), Location::Inside(leaf.state));
                let point = umbrage_geom::Aabb { min: p, max: p };
                prop_assert!(tree.all_in(&point, leaf.state));
            }
            if let (LeafState::Clear, Some(p), Some(q)) = (leaf.state, p, q) {
                let ray = Ray::between(p, q);
                // The end as rounded may be outside, hence a little short of it.
                let ray = ray.with_tfar(0.999);
                prop_assert!(triangles.iter().all(|t| !segment_hits_triangle(&ray, corners(t))));
            }
        }
        let find = |index: u32| leaves.iter().find(|leaf| leaf.index == index).unwrap();
        let mut pairs = Vec::new();
        tree.for_each_empty_pair(|left, right| pairs.push((left, right)));
        for (left, right) in pairs {
            let (l, r) = (find(left), find(right));
            prop_assert!(l.state == LeafState::Clear && r.state == LeafState::Clear);
            let axis = (0..3).find(|&axis| l.bounds.max[axis] == r.bounds.min[axis]).unwrap();
            let shared = umbrage_geom::Aabb { min: l.bounds.min.max(r.bounds.min), max: l.bounds.max.min(r.bounds.max) };
            let middle = shared.min * 0.5 + shared.max * 0.5;
            // A face one unit in the last place wide has no point inside that could be written.
            let strictly = |i: usize| i == axis || shared.min[i] < middle[i] && middle[i] < shared.max[i];
            if !(0..3).all(strictly) {
                continue;
            }
            let (mut from, mut to) = (middle, middle);
            from[axis] = l.bounds.center()[axis];
            to[axis] = r.bounds.center()[axis];
            let ray = Ray::between(from, to).with_tfar(0.999);
            prop_assert!(triangles.iter().all(|t| !segment_hits_triangle(&ray, corners(t))));
        }
    }

    #[test]
    fn windings_are_those_of_a_loop(soup in soup(), ray in ray(), turn in any::<u32>()) {
        let rays = scaled(&soup, &[ray]);
        let tree = KdTree::build(&soup.0, &soup.1, &KdOptions::default()).unwrap();
        let weight = |prim: u32| (prim ^ turn) as i32 % 3 - 1;
        let expected: i32 = soup.1.iter().enumerate().filter_map(|(i, t)| {
            let crossing = crosses_triangle(&rays[0], t.map(|v| soup.0[v as usize]))?;
            Some(crossing.winding() * weight(i as u32))
        }).sum();
        prop_assert_eq!(tree.winding_number(&rays[0], weight), expected);
    }
}

/// A grid of `n` x `n` quads, waves across.
fn waves(n: u32) -> Soup {
    let at = |i: u32, j: u32| {
        let (x, y) = (i as f32 / n as f32, j as f32 / n as f32);
        [x, 0.1 * (9.0 * x).sin() * (7.0 * y).cos(), y]
    };
    let positions = (0..=n).flat_map(|j| (0..=n).map(move |i| at(i, j))).collect();
    let quad = |i: u32, j: u32| {
        let a = j * (n + 1) + i;
        [[a, a + n + 1, a + 1], [a + 1, a + n + 1, a + n + 2]]
    };
    (positions, (0..n).flat_map(|j| (0..n).flat_map(move |i| quad(i, j))).collect())
}

#[test]
fn progress_grows_to_one_and_cancels() {
    let (positions, triangles) = waves(40);
    let mut seen = Vec::new();
    let mut report = |f| {
        seen.push(f);
        true
    };
    KdTree::build_guarded(&positions, &triangles, &[], &KdOptions::default(), &mut report).unwrap();
    assert!(seen.is_sorted() && seen.last() == Some(&1.0) && seen.len() > 10);
    let cancelled =
        KdTree::build_guarded(&positions, &triangles, &[], &KdOptions::default(), &mut |f| f < 0.5);
    assert!(matches!(cancelled, Err(BuildError::Cancelled(_))));
}

#[test]
fn work_is_logarithmic_and_counted() {
    let (positions, triangles) = waves(100);
    let tree = KdTree::build(&positions, &triangles, &KdOptions::default()).unwrap();
    assert!(tree.node_count() < 2 * triangles.len());
    let mut counters = Counters::default();
    let mut scratch = KdScratch::default();
    for i in 0..100 {
        let x = (i as f32 + 0.5) / 100.0;
        let ray = Ray::new([x, 1.0, 0.4], [0.0, -1.0, 0.0]);
        assert!(tree.blocker_with(&ray, Order::RAY, &mut (), &mut scratch, &mut counters).any());
    }
    assert!(counters.nodes < 100 * 40 && counters.triangle_tests < 100 * 32, "{counters:?}");
    assert_eq!((counters.rays_at_nodes, counters.lanes), (counters.nodes, counters.nodes));
}

#[test]
fn guards_block_nothing_but_keep_cells_apart() {
    let (positions, triangles) = waves(4);
    let guard = [[0.1f32, 0.6, 0.1], [0.9, 0.6, 0.1], [0.5, 0.6, 0.9]];
    let tree = KdTree::build_guarded(&positions, &triangles, &[guard], &KdOptions::default(), &mut |_| true)
        .unwrap();
    assert!(!tree.any_hit(&Ray::new([0.5, 0.9, 0.4], [0.0, -1.0, 0.0]).with_tfar(0.7)));
    assert!(tree.any_hit(&Ray::new([0.5, 0.9, 0.4], [0.0, -1.0, 0.0])));
    assert_ne!(tree.locate(Vec3::new(0.5, 0.6, 0.4).as_dvec3(), 0.0), Location::Inside(LeafState::Clear));
}
