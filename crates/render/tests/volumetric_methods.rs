//! Methods that end rays inside of solids change no picture.

use umbrage_geom::{MeshObject, TriangleMesh, glam::Affine3A};
use umbrage_image::{Shard, TileGrid};
use umbrage_query::{Exactness, Occluders, QueryError, ShadowMethod};
use umbrage_render::{RenderError, RenderOptions, TILE, render};
use umbrage_scene::{
    Camera, Instance, Light, Material, NamedMesh, Scene, Settings,
    generate::{Parameters, generate},
};

/// A body on a plane under a square, a point inside of the body, and a sun; `opacity` of the body.
fn scene(opacity: f32) -> Scene {
    let parameters = Parameters { triangles: Some(6_000), ..Parameters::default() };
    let mut mesh: TriangleMesh = generate("blob", &parameters).unwrap().mesh;
    let bounds = mesh.bounds();
    let (center, size) = (bounds.center(), bounds.diagonal());
    let y = bounds.min.y;
    let ground =
        [[-9.0, -9.0], [9.0, -9.0], [9.0, 9.0], [-9.0, 9.0]].map(|[x, z]: [f32; 2]| [x * size, y, z * size]);
    let solid = mesh.triangles.len() as u32;
    let plane = TriangleMesh::new(ground.to_vec(), vec![[0, 2, 1], [0, 3, 2]]).unwrap();
    mesh.corner_normals.clear();
    mesh.corner_uvs.clear();
    mesh.append(&plane);
    let object = |name: &str, triangles| MeshObject { name: name.into(), triangles, opacity: 1.0 };
    mesh.objects = vec![object("body", 0..solid), object("ground", solid..solid + 2)];
    let material = |name: &str, opacity| Material { name: name.into(), albedo: [0.7; 3], opacity };
    let corner = (center + glam(0.2, 0.6, -0.4) * size).to_array();
    Scene {
        camera: Camera {
            position: (center + glam(0.9, 0.8, 1.1) * size).to_array(),
            target: center.to_array(),
            up: [0.0, 1.0, 0.0],
            fov: 45.0,
            lens_radius: 0.0,
            focus_distance: None,
        },
        meshes: vec![NamedMesh::new("all", mesh)],
        instances: vec![Instance {
            name: "all".into(),
            mesh: 0,
            world_from_object: Affine3A::IDENTITY,
            materials: vec![0, 1],
        }],
        materials: vec![material("clay", opacity), material("floor", 1.0)],
        lights: vec![
            Light::Rectangle {
                corner,
                u: [0.4 * size, 0.0, 0.0],
                v: [0.0, 0.0, 0.4 * size],
                radiance: [9.0; 3],
                two_sided: true,
            },
            Light::Point { position: center.to_array(), intensity: [5.0; 3] },
            Light::Directional { direction: [0.5, -1.0, -0.3], irradiance: [1.0; 3], angle: 2.0 },
        ],
        ambient: None,
        background: [0.1; 3],
        settings: Settings { width: 48, height: 40, spp: 2, shadow_samples: 9, ..Settings::default() },
    }
}

fn glam(x: f32, y: f32, z: f32) -> umbrage_geom::glam::Vec3 {
    umbrage_geom::glam::Vec3::new(x, y, z)
}

#[test]
fn pictures_are_those_of_the_plain_hierarchy() {
    for opacity in [1.0, 0.5] {
        let mut scene = scene(opacity);
        let occluders = Occluders::of_scene(&scene, &mut |_| true).unwrap();
        let mut picture = |method: ShadowMethod, count_cost| {
            scene.settings.shadows = method.to_string();
            let options = RenderOptions::default().with_count_cost(count_cost);
            let rendered = render(&scene, &occluders, &options, &mut |_| true)?;
            assert_eq!(rendered.shadows.name, Some(method.name()));
            let layers = rendered.film.layers().iter().filter(|layer| layer.name() != "cost");
            Ok::<Vec<u32>, RenderError>(
                layers.flat_map(|layer| layer.values().iter().map(|v| v.to_bits())).collect(),
            )
        };
        let expected = picture(ShadowMethod::Bvh, false).unwrap();
        let shadowed = picture(ShadowMethod::Bvh, true).unwrap();
        assert_eq!(expected, shadowed);
        let mut compared = 0;
        for &method in ShadowMethod::ALL.iter().filter(|method| method.exactness() == Exactness::Exact) {
            for count_cost in [false, true] {
                match picture(method, count_cost) {
                    Ok(picture) => assert_eq!(picture, expected, "{method}, counted: {count_cost}"),
                    Err(RenderError::Query(QueryError::Unsupported { method: name, reason })) => {
                        assert!(opacity < 1.0 && name == method.name(), "{method}: {reason}");
                        continue;
                    }
                    Err(other) => panic!("{method}: {other}"),
                }
                compared += 1;
            }
        }
        // Only the plain hierarchy sums what semi-transparent triangles let through.
        assert_eq!(compared, if opacity < 1.0 { 2 } else { 18 });
    }
}

/// So many bodies that instances are kept apart, and one of another mesh far below, which no shadow ray comes near.
fn crowd() -> Scene {
    let mut scene = scene(1.0);
    let size = scene.meshes[0].mesh.bounds().diagonal();
    let mut hidden = scene.meshes[0].mesh.clone();
    hidden.objects[0].name = "hidden".into();
    scene.meshes.push(NamedMesh::new("hidden", hidden));
    let first = scene.instances[0].clone();
    let at = |mesh, x: f32, y: f32, z: f32, turn: f32| Instance {
        mesh,
        world_from_object: Affine3A::from_translation(glam(x, y, z) * size) * Affine3A::from_rotation_y(turn),
        ..first.clone()
    };
    let place = |i: u32| ((i % 20) as f32 * 0.6, (i / 20) as f32 * 0.6);
    scene.instances = (0..400).map(|i| at(0, -place(i).0, 0.0, -place(i).1, i as f32)).collect();
    scene.instances.push(at(1, 0.0, -1000.0, 0.0, 0.0));
    scene
}

#[test]
fn instances_kept_apart_share_occluders_and_pictures_stay() {
    let mut scene = crowd();
    let occluders = Occluders::of_scene(&scene, &mut |_| true).unwrap();
    assert!(occluders.is_instanced());
    let mut picture = |method: &str, count_cost, threads| {
        scene.settings.shadows = method.into();
        let options = RenderOptions::default().with_count_cost(count_cost);
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let rendered = pool.install(|| render(&scene, &occluders, &options, &mut |_| true)).unwrap();
        let layers = rendered.film.layers().iter().filter(|layer| layer.name() != "cost");
        let bits = layers.flat_map(|layer| layer.values().iter().map(|v| v.to_bits())).collect::<Vec<u32>>();
        (bits, rendered.occluders)
    };
    let (expected, none) = picture("bvh", false, 1);
    assert_eq!(none, None);
    for (count_cost, threads) in [(false, 1), (true, 1), (false, 3)] {
        let (bits, occluders) = picture("bvh-volumetric", count_cost, threads);
        assert_eq!(bits, expected);
        let occluders = occluders.unwrap();
        // Of each mesh the body could; planes are flat. Where work is counted, all are prepared before the first ray.
        let prepared = if count_cost { 2 } else { 1 };
        assert_eq!((occluders.objects, occluders.prepared, occluders.generators), (2, prepared, prepared));
        assert!(occluders.boxes > 10, "{occluders:?}");
    }
}

#[test]
fn work_counted_depends_on_neither_threads_nor_shards() {
    for mut scene in [scene(1.0), crowd()] {
        // Several tiles, so that threads and shards share them.
        scene.settings = Settings { width: 90, height: 70, spp: 1, shadow_samples: 4, ..scene.settings };
        let occluders = Occluders::of_scene(&scene, &mut |_| true).unwrap();
        for &method in ShadowMethod::ALL {
            scene.settings.shadows = method.to_string();
            let picture = |threads, shard| {
                let options = RenderOptions::default().with_count_cost(true).with_shard(shard);
                let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
                let rendered = pool.install(|| render(&scene, &occluders, &options, &mut |_| true))?;
                Ok::<Vec<u32>, RenderError>(
                    rendered.film.require("cost").unwrap().values().iter().map(|v| v.to_bits()).collect(),
                )
            };
            let whole = match picture(1, Shard::WHOLE) {
                Err(RenderError::Query(QueryError::Unsupported { .. })) if scene.instances.len() > 1 => {
                    continue;
                }
                whole => whole.unwrap(),
            };
            assert!(whole.iter().any(|&bits| bits != 0));
            for _ in 0..3 {
                assert!(picture(3, Shard::WHOLE).unwrap() == whole, "{method} with three threads");
            }
            let grid = TileGrid::new(scene.settings.width, scene.settings.height, TILE).unwrap();
            for shard in [Shard::new(1, 2).unwrap(), Shard::new(2, 2).unwrap()] {
                let part = picture(2, shard).unwrap();
                for tile in shard.tiles(&grid).unwrap().map(|index| grid.tile(index)) {
                    for (x, y) in (tile.y..tile.y_end).flat_map(|y| (tile.x..tile.x_end).map(move |x| (x, y)))
                    {
                        let pixel = (y * scene.settings.width + x) as usize;
                        assert_eq!(part[pixel], whole[pixel], "{method}, shard {shard}, pixel {x} {y}");
                    }
                }
            }
        }
    }
}
