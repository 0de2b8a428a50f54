//! Method `mask-raster` against the same tables walked through a BVH, and against exact rays.

mod common;

use common::*;
use umbrage_accel::Counters;
use umbrage_aomask::{
    MaskError, MaskOptions, MaskTables, Outputs, Pattern, RasterCall, RasterCamera, RasterLevel,
    RasterOptions, RasterView, Sides, TableOptions,
};
use umbrage_geom::{Falloff, Ray, TriangleMesh, glam::Vec3, offset_origin};

/// A camera with the receivers it sees at the centres of its pixels.
struct Picture {
    camera: RasterCamera,
    size: [u32; 2],
    points: Points,
}

impl Picture {
    fn new(scene: &Scene, eye: Vec3, target: Vec3, size: [u32; 2]) -> Self {
        let forward = (target - eye).normalize();
        let right = forward.cross(Vec3::Y).normalize();
        let up = right.cross(forward) * (size[1] as f32 / size[0] as f32);
        let camera = RasterCamera::new(eye.into(), forward.into(), right.into(), up.into()).unwrap();
        let mut points = (Vec::new(), Vec::new());
        for (y, x) in (0..size[1]).flat_map(|y| (0..size[0]).map(move |x| (y, x))) {
            let u = (x as f32 + 0.5) / size[0] as f32 * 2.0 - 1.0;
            let v = 1.0 - (y as f32 + 0.5) / size[1] as f32 * 2.0;
            let ray = Ray::new(eye, forward + right * u + up * v);
            let receiver = scene.bvh.closest_hit(&ray).and_then(|hit| {
                let [a, b, c] = scene.mesh.triangle(hit.prim_index as usize).map(Vec3::from);
                let n = (b - a).cross(c - a).try_normalize()?;
                let n = if n.dot(ray.direction) > 0.0 { -n } else { n };
                let magnitude = a.abs().max(b.abs()).max(c.abs()).max_element();
                Some((offset_origin(ray.at(hit.t), n, n, magnitude), n))
            });
            let (point, normal) = receiver.unwrap_or((Vec3::NAN, Vec3::ZERO));
            points.0.push(point.into());
            points.1.push(normal.into());
        }
        Self { camera, size, points }
    }

    fn view(&self) -> RasterView<'_> {
        RasterView::new(self.camera, self.size[0], self.size[1], &self.points.0, &self.points.1)
    }

    fn masks(
        &self,
        tables: &MaskTables,
        levels: &[RasterLevel<'_>],
        options: &MaskOptions,
        raster: &RasterOptions,
    ) -> (Vec<u64>, Counters) {
        let mut ao = vec![f32::NAN; self.points.0.len()];
        let mut masks = vec![!0; ao.len() * tables.pattern().words()];
        let outputs = Outputs::new(&mut ao).with_masks(&mut masks);
        let counters = RasterCall::new(tables, levels, &self.view())
            .with_options(*options)
            .with_raster(*raster)
            .run(outputs, &mut |_| true)
            .unwrap();
        (masks, counters)
    }
}

fn exact_level(scene: &Scene) -> [RasterLevel<'_>; 1] {
    [RasterLevel::exact(&scene.mesh.positions, &scene.mesh.triangles)]
}

/// Masks of the pixels that see something, by exact rays and by the BVH.
fn references(
    picture: &Picture,
    scene: &Scene,
    tables: &MaskTables,
    options: &MaskOptions,
    masks: &[u64],
) -> [Vec<u64>; 3] {
    let words = tables.pattern().words();
    let mut out = [Vec::new(), Vec::new(), Vec::new()];
    for i in (0..picture.points.0.len()).filter(|&i| !picture.points.0[i][0].is_nan()) {
        let one = (vec![picture.points.0[i]], vec![picture.points.1[i]]);
        // The seed of pixel `i`, as receiver 0 of a slice with another seed, can't be had: jitter is off in these tests.
        out[0].extend(&masks[i * words..][..words]);
        out[1].extend(exact(scene, tables.pattern(), &one, options));
        let mut ao = [0.0];
        let mut mask = vec![0; words];
        let outputs = Outputs::new(&mut ao).with_masks(&mut mask);
        common::table(tables, &scene.bvh, (&one.0, &one.1), options, outputs, true).unwrap();
        out[2].extend(mask);
    }
    out
}

fn unjittered(rays: u32, falloff: Falloff) -> MaskTables {
    let options = umbrage_aomask::PatternOptions::default().with_rays(rays).with_falloff(falloff).fixed();
    MaskTables::new(Pattern::new(&options).unwrap(), &TableOptions::default().with_resolutions(80, 128))
        .unwrap()
}

#[test]
fn the_image_has_what_the_tables_say() {
    let city = scene("city", 20_000);
    let bush = scene("bush", 5000);
    let size = |scene: &Scene| scene.mesh.bounds().size();
    let at = |scene: &Scene, v: [f32; 3]| scene.mesh.bounds().center() + size(scene) * Vec3::from(v);
    for (scene, eye, target) in [
        (&city, at(&city, [0.6, 0.9, 0.7]), at(&city, [0.0; 3])),
        // Low, between the houses: shapes reach behind the eye.
        (&city, at(&city, [0.03, 0.1, 0.02]), at(&city, [0.2, 0.0, 0.25])),
        (&bush, at(&bush, [0.8, 0.4, 0.7]), at(&bush, [0.0; 3])),
    ] {
        let picture = Picture::new(scene, eye, target, [32, 24]);
        for (radius, sides, falloff) in [
            (0.03, Sides::Both, Falloff::Constant),
            (0.1, Sides::Front, Falloff::Constant),
            (0.1, Sides::Both, Falloff::Linear),
        ] {
            let tables = unjittered(64, falloff);
            let options =
                MaskOptions::default().with_radius(radius * scene.mesh.bounds().diagonal()).with_sides(sides);
            let (masks, counters) =
                picture.masks(&tables, &exact_level(scene), &options, &RasterOptions::default());
            let [masks, exact, walked] = references(&picture, scene, &tables, &options, &masks);
            assert!(exact.len() > 50, "{}", exact.len());
            let against_walk = difference(tables.pattern(), &masks, &walked);
            let against_rays = difference(tables.pattern(), &masks, &exact);
            let text = format!(
                "{radius} {sides:?}: rays {} {}, bias {} {}, {counters:?}",
                against_walk.rays, against_rays.rays, against_walk.bias, against_rays.bias
            );
            // The same triangle masks; the walk leaves out nodes that no ray meets, whose masks may hold a few.
            assert!(against_walk.rays < 3e-3, "{text}");
            assert!(against_rays.rays < 0.03 && against_rays.bias.abs() < 0.015, "{text}");
            assert!(counters.prisms > 0 && counters.billboards > 0, "{text}");
        }
    }
}

#[test]
fn culling_tests_change_the_work_only() {
    let scene = scene("city", 20_000);
    let bounds = scene.mesh.bounds();
    let eye = bounds.center() + bounds.size() * Vec3::new(0.5, 0.8, 0.6);
    let picture = Picture::new(&scene, eye, bounds.center(), [70, 66]);
    let tables = unjittered(32, Falloff::Constant);
    let options = MaskOptions::default().with_radius(0.05 * bounds.diagonal()).with_sides(Sides::Front);
    let all: Vec<_> = (0..=5)
        .map(|tests| {
            let raster = RasterOptions::default().with_culling_tests(tests);
            picture.masks(&tables, &exact_level(&scene), &options, &raster)
        })
        .collect();
    for (tests, (masks, counters)) in all.iter().enumerate() {
        assert_eq!(masks, &all[5].0);
        assert_eq!(counters.fragments, all[5].1.fragments);
        let expected = if tests == 0 { counters.fragments } else { counters.fragments_after[tests - 1] };
        assert_eq!(counters.fragment_masks, expected, "{tests}");
    }
    let after = all[5].1.fragments_after;
    assert!(
        after.windows(2).all(|pair| pair[0] >= pair[1]) && after[4] < all[5].1.fragments / 2,
        "{after:?}"
    );
    // The first five rows of the table are counted whichever tests are used, save where early ones end the work.
    assert_eq!(all[5].1.fragments_after, all[2].1.fragments_after);
}

#[test]
fn levels_hand_over_at_their_distances() {
    // Two walls above a floor: a level that only has the far one, and a scene that only has the near one.
    let quad = |z: f32| {
        let p = vec![[-9.0, -9.0, z], [9.0, -9.0, z], [9.0, 9.0, z], [-9.0, 9.0, z]];
        TriangleMesh::new(p, vec![[0, 1, 2], [0, 2, 3]]).unwrap()
    };
    let (near, far) = (quad(0.5), quad(2.0));
    let floor = from_mesh(quad(0.0));
    let picture = Picture::new(&floor, Vec3::new(0.0, -0.3, 0.3), Vec3::new(0.0, 0.0, 0.0), [8, 8]);
    let tables = unjittered(128, Falloff::Constant);
    let options = MaskOptions::default().with_radius(10.0);
    let blocked = |levels: &[RasterLevel<'_>]| {
        let raster = RasterOptions::default().with_range_factor(1.0);
        let (masks, _) = picture.masks(&tables, levels, &options, &raster);
        masks.iter().map(|w| f64::from(w.count_ones())).sum::<f64>() / (64.0 * 128.0)
    };
    let level = |mesh: &'static TriangleMesh, error| RasterLevel {
        positions: &mesh.positions,
        triangles: &mesh.triangles,
        error,
    };
    let (near, far): (&'static _, &'static _) = (Box::leak(Box::new(near)), Box::leak(Box::new(far)));
    // Hits at a distance of at most 1 count on the near wall: z >= 0.5, a cosine-weighted share of 3/4.
    let only_near = blocked(&[level(near, 0.0), level(far, 1.0)][..1]);
    assert!(only_near > 0.85, "{only_near}");
    let handed_over = blocked(&[level(near, 0.0), level(far, 1.0)]);
    let walls_near_to_1 = 0.75;
    // The far wall, from 1 on, has the rest but what passes beside it: its distance of 2 is within 10 of all but the flattest rays.
    assert!(handed_over > walls_near_to_1 + 0.1, "{handed_over}");
    // A far level that repeats the near wall counts it only from distance 1 on.
    let tiny = Box::leak(Box::new(quad(1e6)));
    let repeated = blocked(&[level(tiny, 0.0), level(near, 1.0)]);
    let expected = only_near - walls_near_to_1;
    assert!((repeated - expected).abs() < 0.05, "{repeated} {expected}");
}

#[test]
fn bad_views_and_levels_are_named() {
    let scene = scene("sphere", 1000);
    let center = scene.mesh.bounds().center();
    let picture = Picture::new(&scene, center + Vec3::new(5.0, 1.0, 0.0), center, [5, 4]);
    let tables = unjittered(32, Falloff::Constant);
    let options = MaskOptions::default().with_radius(1.0);
    let level = exact_level(&scene)[0];
    let mut ao = vec![-1.0; 20];
    let mut call = |levels: &[RasterLevel<'_>], view: &RasterView<'_>, factor: f32, cancel: bool| {
        let raster = RasterOptions::default().with_range_factor(factor);
        RasterCall::new(&tables, levels, view)
            .with_options(options)
            .with_raster(raster)
            .run(Outputs::new(&mut ao), &mut |_| !cancel)
    };
    let view = picture.view();
    let shorter = RasterView::new(picture.camera, 5, 5, view.points, view.normals);
    assert!(matches!(call(&[level], &shorter, 3.0, false), Err(MaskError::Length { what: "points", .. })));
    for factor in [0.0, f32::NAN, f32::INFINITY] {
        assert!(matches!(
            call(&[level], &view, factor, false),
            Err(MaskError::Level { what: "range factor", .. })
        ));
    }
    for footprint in [-1.0, f32::NAN, f32::INFINITY] {
        let wide = view.with_footprint(footprint);
        assert!(matches!(
            call(&[level], &wide, 3.0, false),
            Err(MaskError::Option { name: "footprint", .. })
        ));
    }
    let coarse = RasterLevel { error: 0.1, ..level };
    for levels in
        [&[coarse][..], &[level, coarse, coarse], &[level, RasterLevel { error: f32::NAN, ..level }]]
    {
        assert!(matches!(call(levels, &view, 3.0, false), Err(MaskError::Level { what: "error", .. })));
    }
    let wrong = RasterLevel { triangles: &[[0, 1, 1 << 30]], ..level };
    assert!(matches!(call(&[wrong], &view, 3.0, false), Err(MaskError::Build(_))));
    assert_eq!(call(&[level], &view, 3.0, true), Err(MaskError::Cancelled));
    assert_eq!(ao, [-1.0; 20]);
    // Without geometry all is open.
    let raster = RasterOptions::default();
    RasterCall::new(&tables, &[], &view)
        .with_options(options)
        .with_raster(raster)
        .run(Outputs::new(&mut ao), &mut |_| true)
        .unwrap();
    assert_eq!(ao, [1.0; 20]);
    let none = RasterView::new(picture.camera, 0, 0, &[], &[]);
    let mut nothing = [];
    let counters = RasterCall::new(&tables, &[level], &none)
        .with_options(options)
        .with_raster(raster)
        .run(Outputs::new(&mut nothing), &mut |_| true);
    assert_eq!(counters, Ok(Counters::default()));
}
