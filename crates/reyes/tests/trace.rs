//! Rays against surfaces: rates, cracks, caches, bad input.

mod common;

use common::{cube, sheet, zoo};
use proptest::prelude::*;
use std::sync::Arc;
use umbrage_accel::{BuildOptions, Bvh};
use umbrage_geom::{PolygonMesh, Ray, RayDifferential, glam::Vec3};
use umbrage_reyes::{
    Borders, FootprintRule, Rates, Surface, SurfaceError, SurfaceHit, SurfaceOptions, SurfaceTracer,
    TraceOptions, TraceState, camera_differential, published,
};

fn tracer(mesh: &PolygonMesh, options: &TraceOptions) -> SurfaceTracer {
    let surface = Surface::build(mesh, &SurfaceOptions::default()).unwrap();
    SurfaceTracer::new(Arc::new(surface), options).unwrap()
}

/// A ray from `eye` to `target`, with pixels of `spread` at distance 1.
fn camera_ray(eye: Vec3, target: Vec3, spread: f32) -> (Ray, RayDifferential) {
    let forward = (target - eye).normalize();
    let right = forward.any_orthonormal_vector();
    (Ray::new(eye, forward), camera_differential(right * spread, forward.cross(right) * spread))
}

fn wild_tracers(mesh: &PolygonMesh) -> Vec<SurfaceTracer> {
    let rules = [
        FootprintRule::Entry,
        FootprintRule::FinalApproach,
        FootprintRule::ExactFinalApproach,
        FootprintRule::Edges,
        FootprintRule::ProjectedEdges,
        FootprintRule::DiagSplit,
    ];
    rules
        .iter()
        .flat_map(|&rule| {
            [Rates::Equal, Rates::Anisotropic].map(|rates| {
                let options =
                    TraceOptions::default().with_footprint(rule).with_rates(rates).with_max_level(6);
                tracer(mesh, &options)
            })
        })
        .collect()
}

/// From inside a closed surface, towards edges and corners of patches, nothing gets out.
#[test]
fn closed_surfaces_do_not_leak() {
    for (name, mesh) in zoo() {
        if name.contains("sheet") || name == "dart" || name == "one quad" {
            continue;
        }
        for tracer in wild_tracers(&mesh) {
            let mut state = TraceState::new(tracer.options());
            let surface = tracer.surface();
            let center = surface.bounds().center() + 0.08 * surface.bounds().size();
            for patch in 0..surface.patch_count() as u32 {
                for step in 0..28u32 {
                    let s = (step % 7) as f32 / 6.0;
                    let (u, v) = [(s, 0.0), (1.0, s), (s, 1.0), (0.0, s)][step as usize / 7];
                    let target = surface.limit(patch, u, v).position;
                    for spread in [0.02, 0.1, 0.4] {
                        let (ray, differential) = camera_ray(center, target, spread);
                        assert!(
                            tracer.any_hit(&ray, &differential, &mut state),
                            "{name}, {:?}: leak at patch {patch}, {u}, {v}, spread {spread}",
                            tracer.options()
                        );
                        assert!(tracer.closest_hit(&ray, &differential, &mut state).is_some());
                    }
                }
            }
        }
    }
}

/// Without stitching the same rays do find cracks: the test above can fail.
#[test]
fn open_borders_have_cracks() {
    let (_, mesh) = zoo().swap_remove(4);
    let options = TraceOptions::default().with_borders(Borders::Open).with_max_level(6);
    let tracer = tracer(&mesh, &options);
    let mut state = TraceState::new(&options);
    let surface = tracer.surface();
    let eye = surface.bounds().center() + Vec3::new(0.3, 0.2, 0.5);
    let mut leaks = 0;
    for patch in 0..surface.patch_count() as u32 {
        for step in 0..400u32 {
            let s = (step % 100) as f32 / 99.0;
            let (u, v) = [(s, 0.0), (1.0, s), (s, 1.0), (0.0, s)][step as usize / 100];
            for spread in [0.05, 0.1, 0.2] {
                let (ray, differential) = camera_ray(eye, surface.limit(patch, u, v).position, spread);
                leaks += u32::from(!tracer.any_hit(&ray, &differential, &mut state));
            }
        }
    }
    assert!(leaks > 0);
}

/// At a rate that all rays share, the tracer is a loop over all triangles.
#[test]
fn equal_rates_give_the_tessellation() {
    for (name, mesh) in zoo() {
        for level in [1, 4, 5] {
            // Zero differentials ask for the finest rate there is.
            let tracer = tracer(&mesh, &TraceOptions::default().with_max_level(level));
            let (whole, patches) = tracer.surface().tessellate(|_| [level; 2]).unwrap();
            let bvh = Bvh::build(&whole.positions, &whole.triangles, &BuildOptions::default()).unwrap();
            let mut state = TraceState::new(tracer.options());
            let bounds = tracer.surface().bounds();
            let mut hits = 0;
            for i in 0..400u32 {
                let at = |k: u32| {
                    let x = Vec3::new(
                        umbrage_geom::sampling::sobol(i, k, 1),
                        umbrage_geom::sampling::sobol(i, k + 1, 1),
                        umbrage_geom::sampling::sobol(i, k + 2, 1),
                    );
                    bounds.min + (bounds.max - bounds.min) * (1.4 * x - 0.2)
                };
                let ray = Ray::between(at(0), at(3)).with_tfar(if i % 3 == 0 { 0.5 } else { f32::INFINITY });
                let expected = bvh.closest_hit(&ray);
                let hit = tracer.closest_hit(&ray, &RayDifferential::default(), &mut state);
                assert_eq!(hit.map(|h| h.t), expected.map(|h| h.t), "{name}, ray {i}");
                assert_eq!(tracer.any_hit(&ray, &RayDifferential::default(), &mut state), expected.is_some());
                if let (Some(hit), Some(expected)) = (hit, expected) {
                    hits += 1;
                    assert!(hit.front == expected.front && hit.levels == [level; 2]);
                    if bvh.closest_hit(&ray.with_tfar(hit.t)).is_none()
                        && hit.patch != patches[expected.prim_index as usize]
                    {
                        // A tie on an edge between two patches.
                        continue;
                    }
                    let limit = tracer.limit(&hit).position;
                    let off = limit.distance(ray.at(hit.t)) / bounds.diagonal();
                    assert!(off < 0.5 / (1u32 << (2 * level)) as f32 + 2e-3 / level as f32, "{name}: {off}");
                }
            }
            assert!(hits > 20, "{name}: {hits}");
        }
    }
}

/// Whatever the cache holds, whoever asks in whatever order: the same hits.
#[test]
fn eviction_and_order_change_no_hit() {
    let (_, mesh) = zoo().swap_remove(1);
    let options = TraceOptions::default().with_max_level(7);
    let rays: Vec<_> = (0..3000u32)
        .map(|i| {
            let x = umbrage_geom::sampling::sobol_4d(i, 0, 7);
            let eye = 4.0 * (Vec3::new(x[0], x[1], x[2]) - 0.5).normalize_or_zero();
            camera_ray(eye, Vec3::new(x[3] - 0.5, 0.3 * x[0], 0.2), 0.002 + 0.02 * x[1])
        })
        .collect();
    let roomy = tracer(&mesh, &options);
    let mut state = TraceState::new(&options);
    let expected: Vec<Option<SurfaceHit>> =
        rays.iter().map(|(ray, d)| roomy.closest_hit(ray, d, &mut state)).collect();
    assert!(expected.iter().flatten().count() > 1000);
    assert_eq!(roomy.counts().evicted, 0);
    for bytes in [0, 1000, 20_000, 200_000] {
        let options = options.with_cache_bytes(bytes);
        let tight = tracer(&mesh, &options);
        assert!(tight.peak_grid_bytes() <= bytes);
        std::thread::scope(|scope| {
            for thread in 0..2 {
                let (tight, rays, expected) = (&tight, &rays, &expected);
                scope.spawn(move || {
                    let mut state = TraceState::new(&options);
                    for k in 0..rays.len() {
                        let i = if thread == 0 { k } else { rays.len() - 1 - k };
                        let (ray, d) = &rays[i];
                        assert_eq!(tight.closest_hit(ray, d, &mut state), expected[i]);
                        assert_eq!(tight.any_hit(ray, d, &mut state), expected[i].is_some());
                    }
                });
            }
        });
        assert!(tight.peak_grid_bytes() <= bytes, "{} > {bytes}", tight.peak_grid_bytes());
        assert!(tight.counts().dice > roomy.counts().dice);
    }
}

/// Opaque cells answer as the tessellation would, from points on, off and inside the surface; deferred rays do too.
#[test]
fn opaque_cells_change_no_answer() {
    for (name, mesh) in zoo() {
        let options = TraceOptions::default().with_max_level(5);
        let plain = tracer(&mesh, &options);
        let quick = tracer(&mesh, &options.with_occluder_cells(24));
        let closed = !(name.contains("sheet") || name == "dart" || name == "one quad");
        assert_eq!(quick.opaque_cells().0 > 0, closed, "{name}");
        let (mut a, mut b) = (TraceState::new(&options), TraceState::new(&options));
        let bounds = plain.surface().bounds();
        for i in 0..600u32 {
            let x = umbrage_geom::sampling::sobol_4d(i, 0, 11);
            let y = umbrage_geom::sampling::sobol_4d(i, 1, 11);
            let patch = (x[3] * plain.surface().patch_count() as f32) as u32;
            let point = plain.surface().limit(patch, x[0], x[1]).position;
            let from =
                if i % 2 == 0 { point } else { bounds.min + bounds.size() * Vec3::new(x[0], x[1], x[2]) };
            let spread = [Vec3::X * 0.02, Vec3::Y * 0.02];
            let to = bounds.center() + bounds.size() * 1.5 * (Vec3::new(y[0], y[1], y[2]) - 0.5);
            let ray = Ray::between(from, to);
            let differential = umbrage_reyes::light_differential(spread, spread);
            let expected = plain.any_hit(&ray, &differential, &mut a);
            assert_eq!(quick.any_hit(&ray, &differential, &mut b), expected, "{name}, ray {i}");
            assert_eq!(
                published::any_hit_deferred(&plain, &ray, &differential, &mut a),
                expected,
                "{name}, ray {i}"
            );
        }
        assert_eq!(b.occluder_hits() > 0, closed, "{name}");
        assert!(!closed || quick.counts().dice <= plain.counts().dice);
    }
}

#[test]
fn unseen_patches_are_never_diced() {
    let mesh = sheet(8, |_, _| 0.0);
    let options = TraceOptions::default();
    let tracer = tracer(&mesh, &options);
    let mut state = TraceState::new(&options);
    assert_eq!(tracer.counts().dice, 0);
    let (ray, differential) = camera_ray(Vec3::new(3.5, 3.5, 5.0), Vec3::new(3.5, 3.5, 0.0), 0.3);
    let hit = tracer.closest_hit(&ray, &differential, &mut state).unwrap();
    assert_eq!(hit.patch, 3 * 8 + 3);
    // Footprint 1.5 at the sheet: one cell of size 1 has a diagonal within it.
    assert_eq!((tracer.counts().dice, hit.levels), (1, [0, 0]));
}

#[test]
fn strange_footprints_and_rays_have_defined_answers() {
    let options = TraceOptions::default().with_max_level(5);
    let tracer = tracer(&cube(), &options);
    let mut state = TraceState::new(&options);
    let ray = Ray::new([0.1, 0.2, 5.0], [0.0, 0.0, -1.0]);
    for d in [0.0, f32::NAN, -0.0, 1e-45, f32::INFINITY] {
        let differential = camera_differential([d, 0.0, 0.0], [0.0, d, 0.0]);
        let hit = tracer.closest_hit(&ray, &differential, &mut state).unwrap();
        let expected = if d == f32::INFINITY { None } else { Some([5, 5]) };
        assert!(expected.is_none_or(|levels| levels == hit.levels), "{d}: {:?}", hit.levels);
    }
    let differential = camera_differential([0.1, 0.0, 0.0], [0.0, 0.1, 0.0]);
    for bad in [Ray::new([f32::NAN; 3], [0.0, 0.0, 1.0]), Ray::new([0.0; 3], [0.0; 3]), ray.with_tfar(-1.0)] {
        assert_eq!(tracer.closest_hit(&bad, &differential, &mut state), None);
        assert!(!tracer.any_hit(&bad, &differential, &mut state));
    }
    let surface = || Arc::new(Surface::build(&cube(), &SurfaceOptions::default()).unwrap());
    for edge in [0.0, -1.0, f32::NAN, f32::INFINITY] {
        let error = SurfaceTracer::new(surface(), &options.with_edge(edge)).err();
        assert!(matches!(error, Some(SurfaceError::Option { name: "edge", .. })));
    }
    let error = SurfaceTracer::new(surface(), &options.with_occluder_cells(513)).err();
    assert!(matches!(error, Some(SurfaceError::Option { name: "occluder_cells", .. })));
    let error = SurfaceTracer::new(surface(), &options.with_max_level(13)).err();
    assert!(matches!(error, Some(SurfaceError::Option { name: "max_level", .. })));
}

/// Tracing with next to no memory for trees gives the same hits.
#[test]
fn trees_beyond_their_limit_are_made_again() {
    let (_, mesh) = zoo().swap_remove(1);
    let options = TraceOptions::default().with_footprint(FootprintRule::ExactFinalApproach).with_max_level(7);
    let roomy = tracer(&mesh, &options);
    let poor = Surface::build(&mesh, &SurfaceOptions::default().with_tree_bytes(0)).unwrap();
    let before = poor.bytes();
    let poor = SurfaceTracer::new(Arc::new(poor), &options).unwrap();
    let (mut a, mut b) = (TraceState::new(&options), TraceState::new(&options));
    for i in 0..60u32 {
        let x = umbrage_geom::sampling::sobol_4d(i, 0, 3);
        let eye = 5.0 * (Vec3::new(x[0], x[1], x[2]) - 0.5);
        let (ray, d) = camera_ray(eye, Vec3::ZERO, 0.01);
        assert_eq!(roomy.closest_hit(&ray, &d, &mut a), poor.closest_hit(&ray, &d, &mut b));
    }
    assert_eq!(poor.surface().bytes(), before);
    assert!(roomy.surface().bytes() > before);
}

fn footprints() -> impl Strategy<Value = (Ray, RayDifferential)> {
    let vector = |size: f32| prop::array::uniform3(-size..size).prop_map(Vec3::from);
    (vector(4.0), vector(1.0), vector(0.05), vector(0.05), vector(0.02), vector(0.02)).prop_filter_map(
        "rays with a direction",
        |(origin, target, a, b, c, d)| {
            let ray = Ray::new(origin, target - origin);
            let differential = RayDifferential { d_origin: [a, b], d_direction: [c, d] };
            ray.is_valid().then_some((ray, differential))
        },
    )
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(60))]

    /// The Reyes quality threshold: no micropolygon edge is longer than the shortest edge of any footprint that the ray
    /// has inside the patch's box.
    #[test]
    fn edges_are_no_longer_than_the_footprint((ray, differential) in footprints(), which in 0usize..8) {
        let (_, mesh) = zoo().swap_remove(which);
        for rates in [Rates::Equal, Rates::Anisotropic] {
            let options = TraceOptions::default().with_rates(rates).with_max_level(7);
            let tracer = tracer(&mesh, &options);
            let surface = tracer.surface();
            for patch in 0..surface.patch_count() as u32 {
                let Some(levels) = tracer.levels(patch, &ray, &differential) else { continue };
                if levels[0].max(levels[1]) == 7 {
                    continue;
                }
                // Smallest footprint on a fine walk through the box.
                let bounds = surface.patch_bounds(patch);
                let mut width = f64::INFINITY;
                for i in 0..2000 {
                    let t = i as f32 * 0.002;
                    let p = ray.at(t);
                    if p.cmpge(bounds.min).all() && p.cmple(bounds.max).all() {
                        for edge in differential.footprint(t) {
                            width = width.min(edge.as_dvec3().length());
                        }
                    }
                }
                let longest = surface.longest_edge(patch, levels).unwrap();
                prop_assert!(longest <= width * 1.00001, "{} > {} at {:?}", longest, width, levels);
            }
        }
    }

    /// Final approach is never finer than entry, and exact final approach meets the threshold where the ray does meet the
    /// surface, as entry does.
    #[test]
    fn final_approach_is_between_entry_and_the_hit((ray, differential) in footprints(), which in 0usize..8) {
        let (_, mesh) = zoo().swap_remove(which);
        let rules = [FootprintRule::Entry, FootprintRule::FinalApproach, FootprintRule::ExactFinalApproach];
        let tracers = rules.map(|rule| {
            tracer(&mesh, &published::trace_options(rule).with_max_level(7))
        });
        let surface = tracers[0].surface();
        for patch in 0..surface.patch_count() as u32 {
            let [entry, approach, exact] = [0, 1, 2].map(|i| tracers[i].levels(patch, &ray, &differential));
            prop_assert_eq!(entry.is_some(), approach.is_some());
            let (Some(entry), Some(approach), Some(exact)) = (entry, approach, exact) else { continue };
            prop_assert!(approach <= entry && exact <= entry, "{:?} {:?} {:?}", entry, approach, exact);
        }
        for tracer in [&tracers[0], &tracers[2]] {
            let mut state = TraceState::new(tracer.options());
            let Some(hit) = tracer.closest_hit(&ray, &differential, &mut state) else { continue };
            if hit.levels[0] == 7 {
                continue;
            }
            let width = differential.footprint(hit.t).map(|edge| edge.as_dvec3().length());
            let longest = tracer.surface().longest_edge(hit.patch, hit.levels).unwrap();
            prop_assert!(longest <= width[0].min(width[1]) * 1.00001, "{} > {:?}", longest, width);
        }
    }
}

/// Sides that ask for very different rates: grids stay small, and what is hit lies on the sheet.
#[test]
fn long_patches_are_divided_by_any_rule() {
    let mut mesh = sheet(3, |i, j| 0.1 * ((i + 2 * j) % 3) as f32);
    mesh.positions.iter_mut().for_each(|p| p[0] *= 300.0);
    for tracer in wild_tracers(&mesh) {
        let mut state = TraceState::new(tracer.options());
        for patch in 0..9 {
            let target = tracer.surface().limit(patch, 0.4, 0.6).position;
            let (ray, differential) = camera_ray(target + Vec3::new(2.0, 0.5, 20.0), target, 0.02);
            let levels = tracer.levels(patch, &ray, &differential).unwrap();
            assert!(levels[0] > 3 && levels[0] <= levels[1] + 3, "{levels:?}, {:?}", tracer.options());
            let hit = tracer.closest_hit(&ray, &differential, &mut state).unwrap();
            assert!((ray.at(hit.t) - target).truncate().length() < 2.0, "{:?}", tracer.options());
        }
    }
}
