//! The quick form of suite `stability`: rays at vertices and edges, along surfaces and axes, on meshes far away, tiny, huge
//! and of slivers, against exact integer arithmetic. The rays and the arithmetic are the suite's own.

#[path = "../../benches/src/stability/oracle.rs"]
mod oracle;
#[path = "../../benches/src/stability/rays.rs"]
mod rays;

use oracle::Oracle;
use rays::{Expect, Target};
use umbrage_accel::{BackEnd, BuildOptions, Bvh, brute};
use umbrage_geom::{
    Ray, TriangleMesh,
    glam::{Affine3A, Vec3},
    sampling::RandomStream,
    segment_hits_triangle, winding_number,
};
use umbrage_scene::generate::{Parameters, generate};

fn generated(name: &str, triangles: usize) -> TriangleMesh {
    generate(name, &Parameters { triangles: Some(triangles), ..Parameters::default() }).unwrap().mesh
}

fn placed(mesh: &TriangleMesh, scale: Vec3, by: Vec3) -> TriangleMesh {
    let mut mesh = mesh.clone();
    mesh.transform(&Affine3A::from_scale(scale));
    mesh.transform(&Affine3A::from_translation(by));
    mesh
}

/// Name, mesh, and whether vertices and midpoints of edges are integers.
fn scenes() -> Vec<(&'static str, TriangleMesh, bool)> {
    let cube = placed(&generated("box", 192), Vec3::splat(8.0), Vec3::new(4.0, 0.0, 4.0));
    let mut coplanar = cube.clone();
    coplanar.append(&placed(&cube, Vec3::ONE, Vec3::new(3.0, 0.0, 1.0)));
    let sphere = generated("sphere", 300);
    let centered = placed(&sphere, Vec3::ONE, Vec3::NEG_Y);
    let knots = generated("knots", 6000);
    let mut mixed = placed(&generated("blob", 600), Vec3::splat(1e4), Vec3::new(0.0, -5e3, 0.0));
    mixed.append(&placed(&centered, Vec3::splat(1e-5), Vec3::ZERO));
    vec![
        ("cube", cube, true),
        ("coplanar", placed(&coplanar, Vec3::splat(0.1), Vec3::ZERO), false),
        ("sphere", sphere.clone(), false),
        ("sphere, far", placed(&sphere, Vec3::ONE, Vec3::new(2e6, -1.4e6, 8e5)), false),
        ("sphere, tiny", placed(&sphere, Vec3::splat(1e-12), Vec3::ZERO), false),
        ("sphere, huge", placed(&sphere, Vec3::splat(1e12), Vec3::ZERO), false),
        ("needle", placed(&centered, Vec3::new(1e4, 1e-4, 1e-4), Vec3::ZERO), false),
        ("mixed", mixed, false),
        ("knots", knots, false),
    ]
}

/// What is wrong in words, one line for each kind of ray.
struct Faults(Vec<String>);

impl Faults {
    fn note(&mut self, scene: &str, aim: rays::Aim, what: &str, ray: &Ray) {
        self.0.push(format!("{scene}, {}: {what}: {ray:?}", aim.name()));
    }
}

/// A way to tell whether a ray hits a triangle.
type Test = fn(&Ray, [[f32; 3]; 3]) -> bool;

/// Shoots `per_aim` rays of every kind: what must be true of them, and what is exactly true.
fn check(
    name: &str,
    target: &Target,
    oracle: &Oracle,
    per_aim: u32,
    any_hit: &dyn Fn(&Ray) -> bool,
    test: Test,
) -> Faults {
    let mut faults = Faults(Vec::new());
    for aim in target.aims() {
        for k in 0..per_aim {
            let shot = target.shoot(aim, &mut RandomStream::new(k, 3));
            let ray = &shot.ray;
            let hit = any_hit(ray);
            let own = || shot.left.is_some_and(|i| test(ray, target.mesh.triangle(i)));
            match aim.expect(target.convex) {
                Expect::Hit if !hit => faults.note(name, aim, "leak", ray),
                Expect::Miss if hit => faults.note(name, aim, "self-shadow", ray),
                Expect::MissOwn if own() => faults.note(name, aim, "hits its own triangle", ray),
                _ => {}
            }
            let mut truth = false;
            for corners in oracle.candidates(ray).map(|i| target.mesh.triangle(i)) {
                let exact = oracle::hits(ray, corners);
                truth |= exact;
                if test(ray, corners) != exact {
                    faults.note(name, aim, "wrong on a triangle", ray);
                }
            }
            if hit != truth {
                faults.note(name, aim, "wrong on the mesh", ray);
            }
        }
    }
    faults
}

fn target<'a>(oracle: &Oracle<'a>, lattice: bool) -> Target<'a> {
    let convex = oracle.mesh.triangles.len() <= 500 && oracle.is_convex();
    Target::new(oracle, lattice, convex, 30)
}

#[test]
fn nothing_leaks_shadows_itself_or_differs_from_exact_arithmetic() {
    for (name, mesh, lattice) in scenes() {
        let oracle = Oracle::new(&mesh);
        let target = target(&oracle, lattice);
        assert!(target.origins.len() == 30, "{name}: {} points inside", target.origins.len());
        let bvh = Bvh::build(&mesh.positions, &mesh.triangles, &BuildOptions::default()).unwrap();
        let scalar = bvh.clone().with_back_end(BackEnd::Scalar).unwrap();
        for (bvh, per_aim) in [(bvh, 60), (scalar, 20)] {
            let faults =
                check(name, &target, &oracle, per_aim, &|ray| bvh.any_hit(ray), segment_hits_triangle);
            assert!(faults.0.is_empty(), "{} faults, such as {}", faults.0.len(), faults.0[0]);
        }
    }
}

#[test]
fn hierarchies_answer_like_loops_and_crossings_give_the_winding_number() {
    for (name, mesh, lattice) in scenes() {
        let oracle = Oracle::new(&mesh);
        let target = target(&oracle, lattice);
        let bvh = Bvh::build(&mesh.positions, &mesh.triangles, &BuildOptions::default()).unwrap();
        for aim in target.aims() {
            let shots: Vec<_> = (0..10).map(|k| target.shoot(aim, &mut RandomStream::new(k, 4))).collect();
            let rays: Vec<_> = shots.iter().map(|shot| shot.ray).collect();
            let different = brute::first_difference(&bvh, &mesh.positions, &mesh.triangles, &rays);
            assert_eq!(different, None, "{name}, {}", aim.name());
            for shot in &shots {
                let Some(winding) = shot.winding else { continue };
                let triangles = (0..mesh.triangles.len()).map(|i| mesh.triangle(i));
                assert_eq!(
                    winding_number(&shot.ray, triangles),
                    winding,
                    "{name}, {}: {:?}",
                    aim.name(),
                    shot.ray
                );
            }
        }
    }
}

/// The test on the triangle scaled about its center.
fn scaled_about_center(ray: &Ray, corners: [[f32; 3]; 3], scale: f32) -> bool {
    let [a, b, c] = corners.map(Vec3::from);
    let center = (a + b + c) / 3.0;
    segment_hits_triangle(ray, [a, b, c].map(|p| (center + (p - center) * scale).to_array()))
}

/// The check above must be able to fail: slightly wrong predicates don't pass it.
#[test]
fn epsilons_are_noticed() {
    let epsilons: [(&str, Test); 3] = [
        ("smaller triangles", |ray, corners| scaled_about_center(ray, corners, 1.0 - 3e-7)),
        ("larger triangles", |ray, corners| scaled_about_center(ray, corners, 1.0 + 3e-7)),
        ("a late start", |ray, corners| {
            segment_hits_triangle(&Ray { tnear: ray.tnear.max(1e-4), ..*ray }, corners)
        }),
    ];
    for (name, mesh, lattice) in scenes().into_iter().take(3) {
        let oracle = Oracle::new(&mesh);
        let target = target(&oracle, lattice);
        for (kind, test) in epsilons {
            // On a lattice nothing comes so near to a start without being there.
            if lattice && kind == "a late start" {
                continue;
            }
            let any_hit = |ray: &Ray| (0..mesh.triangles.len()).any(|i| test(ray, mesh.triangle(i)));
            let faults = check(name, &target, &oracle, 20, &any_hit, test);
            assert!(!faults.0.is_empty(), "{name}: a predicate with {kind} passed");
        }
    }
}
