//! The hierarchy over boxes against loops over all of them.

use proptest::prelude::*;
use std::ops::ControlFlow;
use umbrage_accel::{BoxBvh, BoxFanVisitor, BoxVisitor, BuildError, BuildQuality, FAN};
use umbrage_geom::{Aabb, Ray, SlabRay, kernel::fan::FanRays};
use umbrage_testkit::{Segment, segment_touches_box};

const QUALITIES: [BuildQuality; 2] = [BuildQuality::Fast, BuildQuality::High];

fn coordinate() -> impl Strategy<Value = f32> {
    prop_oneof![
        8 => -1f32..1.0,
        2 => prop::sample::select(vec![0.0, -0.0, 0.25, 0.5, 1.0, -1.0]),
        1 => prop::sample::select(vec![1e-40, -1e-30, 1e20, -1e12, 7e5]),
    ]
}

fn vector() -> impl Strategy<Value = [f32; 3]> {
    [coordinate(), coordinate(), coordinate()]
}

/// Random, flat, in one point, many times the same.
fn boxes(most: usize) -> impl Strategy<Value = Vec<Aabb>> {
    let one = (vector(), vector(), 0u8..8).prop_map(|(a, b, flat)| {
        let b = [0, 1, 2].map(|axis| if flat >> axis & 1 == 1 { a[axis] } else { b[axis] });
        Aabb::EMPTY.with_point(a).with_point(b)
    });
    (prop::collection::vec(one, 0..most), 1usize..4)
        .prop_map(|(boxes, copies)| boxes.iter().flat_map(|&b| std::iter::repeat_n(b, copies)).collect())
}

fn rays() -> impl Strategy<Value = Ray> {
    let ends = prop_oneof![Just((0f32, f32::INFINITY)), (0f32..1.0, 0f32..3.0).prop_map(|(a, b)| (a, a + b))];
    (vector(), vector(), ends).prop_map(|(o, d, (tnear, tfar))| Ray { tnear, tfar, ..Ray::new(o, d) })
}

struct Collect(Vec<u32>);

impl BoxVisitor for Collect {
    fn visit(&mut self, index: u32) -> ControlFlow<(), f32> {
        self.0.push(index);
        ControlFlow::Continue(f32::INFINITY)
    }
}

/// Boxes that the walk visits, each at most once.
fn visited(bvh: &BoxBvh, ray: &Ray, sorted: bool) -> Vec<u32> {
    let mut seen = Collect(Vec::new());
    let flow = if sorted { bvh.walk_with(ray, &mut seen) } else { bvh.walk_unsorted(ray, &mut seen) };
    assert!(flow.is_continue());
    seen.0.sort_unstable();
    let count = seen.0.len();
    seen.0.dedup();
    assert_eq!(seen.0.len(), count, "a box came twice");
    seen.0
}

/// Boxes that each ray of a fan may enter, until `limit` of them.
struct CollectFan {
    seen: Vec<Vec<u32>>,
    limit: usize,
}

impl BoxFanVisitor for CollectFan {
    fn visit(&mut self, index: u32, rays: u32, fan: &FanRays<FAN>) -> u32 {
        assert!(rays != 0 && fan.far.len() == FAN);
        let mut done = 0;
        for (r, seen) in self.seen.iter_mut().enumerate().filter(|(r, _)| rays >> r & 1 == 1) {
            seen.push(index);
            done |= u32::from(seen.len() == self.limit) << r;
        }
        done
    }
}

/// Whether the ray's closed segment touches the box, in exact arithmetic: a triangle in the box can be hit only then.
fn touches(ray: &Ray, slab: &SlabRay, aabb: &Aabb) -> bool {
    let segment = Segment {
        origin: ray.origin.to_array(),
        direction: ray.direction.to_array(),
        ends: [ray.tnear, ray.tfar],
    };
    // The slab test is quick, and proven by the tests of `umbrage-geom` to miss no box that is touched.
    slab.entry(aabb, slab.tfar).is_some()
        && segment_touches_box(&segment, [aabb.min, aabb.max].map(|v| v.to_array()))
}

/// Checks what [`BoxBvh::walk_fan`] promises, with a visitor that gives each ray up after `limit` boxes.
fn check_fan(boxes: &[Aabb], all: &[Ray], limit: usize) -> Result<(), TestCaseError> {
    let bvh = BoxBvh::build(boxes, BuildQuality::High).unwrap();
    let mut fan = CollectFan { seen: vec![Vec::new(); all.len()], limit };
    let answered = bvh.walk_fan(all, &mut fan);
    for (r, ray) in all.iter().enumerate() {
        let seen = &mut fan.seen[r];
        prop_assert!(seen.len() <= limit, "a ray that needs no more was given more");
        if answered >> r & 1 == 0 {
            prop_assert!(seen.is_empty(), "a ray that is not answered was given a box");
            continue;
        }
        let done = seen.len() == limit;
        seen.sort_unstable();
        prop_assert!(seen.windows(2).all(|pair| pair[0] != pair[1]), "a box came twice");
        let slab = SlabRay::new(ray);
        prop_assert!(slab.is_some(), "a ray that is not valid was answered");
        for (index, aabb) in boxes.iter().enumerate().filter(|_| !done) {
            let seen = seen.binary_search(&(index as u32)).is_ok();
            prop_assert!(seen || !touches(ray, &slab.unwrap(), aabb), "ray {} missed box {}", r, index);
        }
    }
    Ok(())
}

/// Where the segment enters the box, rounded in `f64`; `None` if it does not.
fn entry(ray: &Ray, aabb: &Aabb) -> Option<f64> {
    let (mut start, mut end) = (f64::from(ray.tnear), f64::from(ray.tfar));
    for axis in 0..3 {
        let [o, d, low, high] =
            [ray.origin[axis], ray.direction[axis], aabb.min[axis], aabb.max[axis]].map(f64::from);
        if d == 0.0 {
            // All of the line is between the planes, or none of it.
            if o < low || o > high {
                return None;
            }
        } else {
            let (a, b) = ((low - o) / d, (high - o) / d);
            (start, end) = (start.max(a.min(b)), end.min(a.max(b)));
        }
    }
    (start <= end).then_some(start)
}

/// Checks that ends which the visitor gives cut the walk, and that the box that the segment enters first is not among what is
/// cut. Hits are where boxes start.
fn check_ends(boxes: &[Aabb], ray: &Ray) -> Result<(), TestCaseError> {
    for quality in QUALITIES {
        let bvh = BoxBvh::build(boxes, quality).unwrap();
        let all = visited(&bvh, ray, true);
        let nearest = |some: &[u32]| {
            let entries = some.iter().filter_map(|&i| entry(ray, &boxes[i as usize]));
            entries.fold(f64::INFINITY, f64::min)
        };
        let (mut tfar, mut seen) = (ray.tfar, Vec::new());
        let _ = bvh.walk(ray, |index| {
            seen.push(index);
            if let Some(entry) = entry(ray, &boxes[index as usize]) {
                tfar = tfar.min(entry as f32);
            }
            ControlFlow::Continue(tfar)
        });
        prop_assert!(seen.len() <= all.len());
        prop_assert!(seen.iter().all(|index| all.contains(index)));
        let (found, best) = (nearest(&seen), nearest(&all));
        prop_assert!(found <= best * (1.0 + 1e-5) + 1e-30, "{} {}", found, best);
    }
    Ok(())
}

/// The box as wide as nodes may store it: to 8 bits of the largest thing around it.
fn grown(aabb: &Aabb, whole: &Aabb) -> Aabb {
    let room = whole.size() / 100.0 + whole.min.abs().max(whole.max.abs()) * 1e-5;
    Aabb { min: aabb.min - room, max: aabb.max + room }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]

    #[test]
    fn no_box_that_a_segment_enters_is_missed(boxes in boxes(60), ray in rays()) {
        for quality in QUALITIES {
            let bvh = BoxBvh::build(&boxes, quality).unwrap();
            let [sorted, unsorted] = [true, false].map(|sorted| visited(&bvh, &ray, sorted));
            prop_assert_eq!(&sorted, &unsorted);
            let mut by_closure = Vec::new();
            let _ = bvh.walk(&ray, |index| {
                by_closure.push(index);
                ControlFlow::Continue(ray.tfar)
            });
            by_closure.sort_unstable();
            prop_assert_eq!(&sorted, &by_closure);
            let Some(slab) = SlabRay::new(&ray) else {
                prop_assert!(sorted.is_empty());
                continue;
            };
            let whole = boxes.iter().fold(Aabb::EMPTY, |all, b| all.union(*b));
            for (index, aabb) in boxes.iter().enumerate() {
                let seen = sorted.binary_search(&(index as u32)).is_ok();
                prop_assert!(seen || !touches(&ray, &slab, aabb), "box {} was missed", index);
                // And few others are visited.
                let near = slab.entry(&grown(aabb, &whole), slab.tfar).is_some();
                prop_assert!(near || !seen, "box {} is far from the ray", index);
            }
        }
    }

    #[test]
    fn walks_end_where_the_visitor_says(boxes in boxes(60), ray in rays()) {
        check_ends(&boxes, &ray)?;
    }

    #[test]
    fn fans_enter_what_their_rays_enter(
        boxes in boxes(60), all in prop::collection::vec(rays(), 1..=FAN), limit in 1usize..6,
    ) {
        let all: Vec<Ray> = all.iter().map(|&ray| Ray { origin: all[0].origin, ..ray }).collect();
        check_fan(&boxes, &all, usize::MAX)?;
        check_fan(&boxes, &all, limit)?;
    }

    #[test]
    fn visitors_can_stop(boxes in boxes(40), ray in rays(), after in 1usize..5) {
        let bvh = BoxBvh::build(&boxes, BuildQuality::High).unwrap();
        let count = visited(&bvh, &ray, true).len();
        let mut seen = 0;
        let flow = bvh.walk(&ray, |_| {
            seen += 1;
            if seen == after { ControlFlow::Break(()) } else { ControlFlow::Continue(ray.tfar) }
        });
        prop_assert_eq!(flow.is_break(), count >= after);
        prop_assert_eq!(seen, count.min(after));
    }

    #[test]
    fn bounds_hold_all_boxes(boxes in boxes(40)) {
        for quality in QUALITIES {
            let bounds = BoxBvh::build(&boxes, quality).unwrap().bounds();
            prop_assert_eq!(bounds.is_empty(), boxes.is_empty());
            for b in &boxes {
                prop_assert!(bounds.min.cmple(b.min).all() && bounds.max.cmpge(b.max).all());
            }
        }
    }
}

/// So many of each box.
fn repeated(spans: &[(usize, [f32; 3], [f32; 3])]) -> Vec<Aabb> {
    let copies = |&(count, min, max): &(usize, [f32; 3], [f32; 3])| {
        std::iter::repeat_n(Aabb { min: min.into(), max: max.into() }, count)
    };
    spans.iter().flat_map(copies).collect()
}

/// Cases that a test which asked for more failed on: how many boxes a ray is given depends on which others still look.
#[test]
fn fans_whose_rays_end_miss_nothing() {
    let ray =
        |direction: [f32; 3], [tnear, tfar]: [f32; 2]| Ray { tnear, tfar, ..Ray::new([0.0; 3], direction) };
    let point = Aabb::EMPTY.with_point([0.0; 3]);
    check_fan(&[point], &[ray([0.0, 0.0, 0.822_886_9], [0.841_006_34, 1.365_345])], 1).unwrap();

    let spans: [(usize, [f32; 3], [f32; 3]); 17] = [
        (3, [0.0; 3], [0.0; 3]),
        (3, [0.0, 1e20, 0.0], [0.0, 1e20, 0.0]),
        (72, [0.0; 3], [0.0; 3]),
        (3, [-1e12, 0.0, 0.0], [0.0; 3]),
        (9, [0.0; 3], [0.0; 3]),
        (3, [1e20, 0.0, 0.0], [1e20, 0.0, 0.0]),
        (12, [0.0; 3], [0.0; 3]),
        (3, [0.0; 3], [1e20, 0.041_961_107, 0.0]),
        (3, [0.0; 3], [0.0; 3]),
        (3, [-0.662_704_5, 0.0, 0.0], [0.0, 1e20, 0.0]),
        (3, [0.0; 3], [0.0; 3]),
        (3, [0.0; 3], [0.0, 0.0, 1e20]),
        (18, [0.0; 3], [0.0; 3]),
        (3, [0.0, -0.125_416_34, 0.0], [0.0; 3]),
        (9, [0.0; 3], [0.0; 3]),
        (3, [0.0, 0.0, -0.077_063_2], [0.0; 3]),
        (3, [0.0, 0.0, 1e20], [0.0, 0.0, 1e20]),
    ];
    let boxes = repeated(&spans);
    let endless = [0.0, f32::INFINITY];
    let all = [
        ray([-0.479_019_76, 0.0, 0.0], endless),
        ray([-1e12, 0.0, 0.0], endless),
        ray([-0.063_267_514, 0.0, 0.25], endless),
        ray([-1e12, 0.0, 1e20], [0.256_060_93, 2.110_235_2]),
    ];
    for limit in [1, 2, 3, 4, 5, usize::MAX] {
        check_fan(&boxes, &all, limit).unwrap();
    }
}

/// A case on which an earlier form of the test failed: the ray runs in the plane of a flat box.
#[test]
fn a_ray_in_the_plane_of_a_box_does_not_end_early() {
    let spans: [(usize, [f32; 3], [f32; 3]); 13] = [
        (24, [0.0; 3], [0.0; 3]),
        (2, [0.0; 3], [0.833_767_6, 0.0, 0.483_110_3]),
        (6, [0.0; 3], [0.0; 3]),
        (2, [0.0; 3], [0.0, 0.0, 1e20]),
        (12, [0.0; 3], [0.0; 3]),
        (2, [0.0; 3], [0.0, 1e20, 0.0]),
        (2, [0.0; 3], [0.0; 3]),
        (2, [0.0; 3], [7e5, 0.0, 0.0]),
        (2, [0.0; 3], [0.0; 3]),
        (2, [0.0, 0.922_136_55, 0.25], [0.348_573_12, 0.922_136_55, 0.25]),
        (2, [0.0; 3], [0.0; 3]),
        (2, [-0.094_145_84, 0.0, 0.0], [0.0; 3]),
        (4, [0.0; 3], [0.0; 3]),
    ];
    check_ends(&repeated(&spans), &Ray::new([0.0, -0.300_008_4, 0.25], [0.758_153_86, 0.044_859_97, 0.0]))
        .unwrap();
    let flat = repeated(&[(1, [1.0, -1.0, 0.25], [2.0, 1.0, 0.25]), (1, [3.0, -1.0, 0.0], [4.0, 1.0, 1.0])]);
    check_ends(&flat, &Ray::new([0.0, 0.0, 0.25], [1.0, 0.0, 0.0])).unwrap();
}

#[test]
fn bad_boxes_are_named_and_bad_rays_miss() {
    let unit = Aabb::EMPTY.with_point([0.0; 3]).with_point([1.0; 3]);
    let nan = Aabb { min: [f32::NAN; 3].into(), ..unit };
    let endless = Aabb { max: [f32::INFINITY; 3].into(), ..unit };
    for bad in [Aabb::EMPTY, nan, endless] {
        let error = BoxBvh::build(&[unit, unit, bad], BuildQuality::Fast).unwrap_err();
        assert!(matches!(error, BuildError::Box { index: 2 }), "{error}");
    }
    let none = BoxBvh::build(&[], BuildQuality::High).unwrap();
    let ray = Ray::new([0.5, 0.5, -1.0], [0.0, 0.0, 1.0]);
    assert!(visited(&none, &ray, true).is_empty() && visited(&none, &ray, false).is_empty());
    let one = BoxBvh::build(&[unit], BuildQuality::High).unwrap();
    assert_eq!(visited(&one, &ray, true), [0]);
    assert!(one.bytes() > 0);
    for bad in [
        Ray::new([f32::NAN; 3], [0.0, 0.0, 1.0]),
        Ray::new([0.5; 3], [0.0; 3]),
        Ray::new([0.5; 3], [f32::INFINITY, 0.0, 0.0]),
        ray.with_tfar(-1.0),
    ] {
        assert!(visited(&one, &bad, true).is_empty() && visited(&one, &bad, false).is_empty());
    }
}
