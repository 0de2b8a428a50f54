//! Pictures whose values are known in closed form, and the same bits for any threads and shards.

use umbrage_geom::{TriangleMesh, glam::Affine3A};
use umbrage_image::{Film, Shard};
use umbrage_query::Occluders;
use umbrage_render::{RenderOptions, render};
use umbrage_scene::{
    Ambient, Camera, Instance, Light, Material, NamedMesh, Radius, Scene, Settings,
    generate::{Parameters, generate},
};

const ALBEDO: f32 = 0.5;

/// A camera above the origin that sees nothing but a spot around it, one pixel, of a large floor at y = 0.
fn floor_scene() -> Scene {
    let floor = TriangleMesh::new(
        // The diagonal stays away from the origin: on it a ray meets both triangles.
        vec![[-9e2, 0.0, -1e3], [-1e3, 0.0, 1e3], [1e3, 0.0, 1e3], [1e3, 0.0, -1e3]],
        vec![[0, 1, 2], [0, 2, 3]],
    )
    .unwrap();
    let mut scene = Scene {
        camera: Camera {
            position: [3.0, 0.5, 0.0],
            target: [0.0; 3],
            up: [0.0, 1.0, 0.0],
            fov: 0.01,
            lens_radius: 0.0,
            focus_distance: None,
        },
        meshes: Vec::new(),
        instances: Vec::new(),
        materials: vec![
            Material { name: "grey".into(), albedo: [ALBEDO; 3], opacity: 1.0 },
            Material { name: "half".into(), albedo: [ALBEDO; 3], opacity: 0.5 },
        ],
        lights: Vec::new(),
        ambient: None,
        background: [0.0; 3],
        settings: Settings { width: 1, height: 1, spp: 4096, ..Settings::default() },
    };
    add(&mut scene, floor, 0);
    scene
}

fn add(scene: &mut Scene, mesh: TriangleMesh, material: usize) {
    let index = scene.meshes.len();
    let materials = vec![material; mesh.objects_or_whole().len()];
    scene.meshes.push(NamedMesh::new(format!("mesh{index}"), mesh));
    let name = format!("instance{index}");
    scene.instances.push(Instance { name, mesh: index, world_from_object: Affine3A::IDENTITY, materials });
}

fn sphere(radius: f32, height: f32) -> TriangleMesh {
    let parameters = Parameters { triangles: Some(20_000), ..Parameters::default() };
    let mut mesh = generate("sphere", &parameters).unwrap().mesh;
    let bounds = mesh.bounds();
    let scale = 2.0 * radius / bounds.size().x;
    for p in &mut mesh.positions {
        let centered = (umbrage_geom::glam::Vec3::from(*p) - bounds.center()) * scale;
        *p = [centered.x, centered.y + height, centered.z];
    }
    mesh
}

fn film(scene: &Scene) -> Film {
    let occluders = Occluders::of_scene(scene, &mut |_| true).unwrap();
    render(scene, &occluders, &RenderOptions::default(), &mut |_| true).unwrap().film
}

fn value(film: &Film, layer: &str) -> f32 {
    film.layer(layer).unwrap().pixel(0)[0]
}

fn close(actual: f32, expected: f32, tolerance: f32) {
    assert!((actual - expected).abs() <= tolerance, "{actual} is not {expected} within {tolerance}");
}

/// The light of the tests: a disc of radius 1 at height 2 facing down; irradiance at the origin is `pi / 5`.
fn disc() -> Light {
    Light::Disc {
        center: [0.0, 2.0, 0.0],
        normal: [0.0, -1.0, 0.0],
        radius: 1.0,
        radiance: [1.0; 3],
        two_sided: false,
    }
}

#[test]
fn a_disc_light_gives_the_irradiance_of_its_form_factor() {
    let mut scene = floor_scene();
    scene.lights.push(disc());
    let film = film(&scene);
    close(value(&film, "beauty"), ALBEDO / 5.0, 1e-4);
    assert_eq!(value(&film, "shadow"), 1.0);
}

#[test]
fn a_half_plane_through_the_axis_hides_half_of_a_disc_light() {
    let half_plane = TriangleMesh::new(
        vec![[0.0, 1.0, -50.0], [0.0, 1.0, 50.0], [-50.0, 1.0, 50.0], [-50.0, 1.0, -50.0]],
        vec![[0, 1, 2], [0, 2, 3]],
    )
    .unwrap();
    let mut scene = floor_scene();
    scene.lights.push(disc());
    add(&mut scene, half_plane.clone(), 0);
    // 4096 stratified samples of a half: an error of 0.2 % would be many standard deviations of random ones.
    let opaque = film(&scene);
    close(value(&opaque, "shadow"), 0.5, 4e-3);
    close(value(&opaque, "beauty"), 0.5 * ALBEDO / 5.0, 4e-4);
    // Half opaque, it hides a quarter.
    scene.instances[1].materials = vec![1];
    close(value(&film(&scene), "shadow"), 0.75, 4e-3);
}

#[test]
fn a_sphere_hides_its_form_factor_of_a_disc_light() {
    // The sphere's cone of half angle asin(0.25 / 1) covers 1/16 of the projected hemisphere, the light 1/5.
    let mut scene = floor_scene();
    scene.lights.push(disc());
    add(&mut scene, sphere(0.25, 1.0), 0);
    let shadow = 1.0 - (1.0 / 16.0) / (1.0 / 5.0);
    close(value(&film(&scene), "shadow"), shadow, 5e-3);
}

#[test]
fn a_sphere_above_a_plane_occludes_its_form_factor() {
    let mut scene = floor_scene();
    add(&mut scene, sphere(0.5, 1.0), 0);
    let sky = |radius| Ambient { radiance: [2.0; 3], radius, falloff: umbrage_geom::Falloff::Constant };
    scene.ambient = Some(sky(Radius::Unbounded));
    let open = film(&scene);
    close(value(&open, "ao"), 0.75, 4e-3);
    close(value(&open, "beauty"), 2.0 * ALBEDO * 0.75, 4e-3);
    // The sphere begins at height 0.5: with a shorter radius nothing is in the way.
    scene.ambient = Some(sky(Radius::Absolute(0.49)));
    assert_eq!(value(&film(&scene), "ao"), 1.0);
    // Seen from the floor's point of view the sphere is dimmed by falloff, which only opens it.
    scene.ambient = Some(Ambient { falloff: umbrage_geom::Falloff::Linear, ..sky(Radius::Absolute(2.0)) });
    let faded = value(&film(&scene), "ao");
    assert!((0.8..0.9).contains(&faded), "{faded}");
}

#[test]
fn a_point_light_falls_off_with_the_square_and_a_blocker_ends_it() {
    let mut scene = floor_scene();
    scene.lights.push(Light::Point { position: [0.0, 2.0, 0.0], intensity: [4.0; 3] });
    close(value(&film(&scene), "beauty"), ALBEDO / std::f32::consts::PI, 1e-4);
    add(&mut scene, sphere(0.1, 1.0), 0);
    let film = film(&scene);
    assert_eq!(value(&film, "beauty"), 0.0);
    assert_eq!(value(&film, "shadow"), 0.0);
}

#[test]
fn semi_transparent_surfaces_show_in_proportion_to_opacity() {
    let mut scene = floor_scene();
    scene.settings.spp = 1 << 14;
    scene.background = [1.0; 3];
    scene.instances[0].materials = vec![1];
    // Black floor, half opaque, before a white background.
    close(value(&film(&scene), "beauty"), 0.5, 0.02);
}

#[test]
fn threads_and_shards_do_not_change_a_bit() {
    let mut scene = floor_scene();
    scene.camera.fov = 60.0;
    scene.settings =
        Settings { width: 100, height: 70, spp: 3, shadow_samples: 2, ao_samples: 2, ..scene.settings };
    scene.lights.push(disc());
    scene.ambient = Some(Ambient {
        radiance: [0.5; 3],
        radius: Radius::OfDiagonal(0.01),
        falloff: umbrage_geom::Falloff::Quadratic,
    });
    add(&mut scene, sphere(0.4, 0.4), 1);
    let occluders = Occluders::of_scene(&scene, &mut |_| true).unwrap();
    let with = |threads: usize, shard: Shard| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let options = RenderOptions::default().with_count_cost(true).with_shard(shard);
        pool.install(|| render(&scene, &occluders, &options, &mut |_| true)).unwrap().film
    };
    let whole = with(1, Shard::WHOLE);
    assert!(whole.same_bits(&with(2, Shard::WHOLE)));
    let grid = umbrage_image::TileGrid::new(100, 70, umbrage_render::TILE).unwrap();
    let mut joined = with(1, "1/3".parse().unwrap());
    for shard in ["2/3", "3/3"] {
        let shard: Shard = shard.parse().unwrap();
        let part = with(2, shard);
        shard.tiles(&grid).unwrap().for_each(|i| joined.copy_tile(&part, &grid.tile(i)));
    }
    assert!(whole.same_bits(&joined));
}

#[test]
fn instances_show_the_same_picture_as_copies() {
    // More than two million triangles in all keep instances apart; fewer are copied.
    let count = 120;
    let mut scene = floor_scene();
    scene.camera = Camera { position: [0.0, 6.0, 9.0], fov: 50.0, ..scene.camera };
    scene.settings = Settings { width: 48, height: 32, spp: 2, ..scene.settings };
    scene.lights.push(disc());
    add(&mut scene, sphere(0.3, 0.3), 0);
    let materials = vec![0];
    for i in 1..count {
        let at = umbrage_geom::glam::Vec3::new((i % 11) as f32 - 5.0, 0.0, (i / 11) as f32 - 5.0);
        let world_from_object = Affine3A::from_translation(at);
        let name = format!("copy{i}");
        scene.instances.push(Instance { name, mesh: 1, world_from_object, materials: materials.clone() });
    }
    let instanced = Occluders::of_scene(&scene, &mut |_| true).unwrap();
    assert!(instanced.is_instanced());
    let mut copied = scene.clone();
    copied.meshes = vec![NamedMesh::new("all", scene.flatten())];
    let objects = copied.meshes[0].mesh.objects.len();
    copied.instances.truncate(1);
    copied.instances[0].materials = vec![0; objects];
    let flat = Occluders::of_scene(&copied, &mut |_| true).unwrap();
    assert!(!flat.is_instanced());
    let film = |scene: &Scene, occluders: &Occluders| {
        render(scene, occluders, &RenderOptions::default(), &mut |_| true).unwrap().film
    };
    let (a, b) = (film(&scene, &instanced), film(&copied, &flat));
    // Rounding of the transforms moves single samples across silhouettes, no more.
    let (a, b) = (a.layer("beauty").unwrap().values(), b.layer("beauty").unwrap().values());
    let different = a.iter().zip(b).filter(|(a, b)| (*a - *b).abs() > 1e-3).count();
    assert!(different * 100 < a.len(), "{different} of {}", a.len());
}

#[test]
fn cancelling_gives_no_picture() {
    let scene = floor_scene();
    let occluders = Occluders::of_scene(&scene, &mut |_| true).unwrap();
    let result = render(&scene, &occluders, &RenderOptions::default(), &mut |_| false);
    assert!(matches!(result, Err(umbrage_render::RenderError::Cancelled)));
}
