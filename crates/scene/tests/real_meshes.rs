//! Real meshes have the counts and bounds that their collection's README states. Skipped, and said so, without them.

mod common;

use std::time::Instant;
use umbrage_scene::{read_mesh, read_polygons};

#[test]
fn counts_and_bounds() {
    let Some(folder) = common::real_meshes() else { return };
    // Vertices, triangles, objects, and two coordinates of the bounds.
    let cases = [
        ("closed/bunny_60k.obj", 29_834, 59_664, 1, (-0.7702, 0.7699)),
        ("closed/spot.obj", 2_930, 5_856, 1, (-0.4716, 0.9536)),
        ("scenes/sibenik.obj", 40_979, 75_284, 1, (-20.14, 15.3)),
        ("scenes/crytek_sponza_part.obj", 20_416, 33_663, 124, (-1432.0, 1314.0)),
        ("scenes/legocar.obj", 5_968, 10_992, 26, (-0.108, 0.1294)),
        ("scenes/cornell_box.obj", 64, 32, 8, (-1.02, 1.99)),
    ];
    for (name, vertices, triangles, objects, (min_x, max_y)) in cases {
        let mesh = read_mesh(&folder.join(name)).unwrap();
        assert_eq!(mesh.positions.len(), vertices, "{name}");
        assert_eq!(mesh.triangles.len(), triangles, "{name}");
        assert_eq!(mesh.objects_or_whole().len(), objects, "{name}");
        let bounds = mesh.bounds();
        // The README gives four digits.
        let near = |a: f32, b: f32| (a - b).abs() <= 5e-4 * b.abs();
        assert!(near(bounds.min.x, min_x) && near(bounds.max.y, max_y), "{name}: {bounds:?}");
    }
}

#[test]
fn polygons_and_tags() {
    let Some(folder) = common::real_meshes() else { return };
    let sponza = read_polygons(&folder.join("scenes/crytek_sponza_part.obj")).unwrap();
    assert_eq!(sponza.faces().filter(|f| f.len() == 3).count(), 2_273);
    assert_eq!(sponza.faces().filter(|f| f.len() == 4).count(), 15_695);
    let tent = read_polygons(&folder.join("opensubdiv/catmark_tent_creases0_control.obj")).unwrap();
    assert_eq!(tent.creases, [([2, 6], 2.0), ([6, 10], 2.0)]);
    let corner = read_polygons(&folder.join("opensubdiv/catmark_cube_corner2_control.obj")).unwrap();
    assert_eq!(corner.sharp_vertices.iter().map(|(_, s)| *s).collect::<Vec<_>>(), [2.8]);
    let chaikin = read_polygons(&folder.join("opensubdiv/catmark_chaikin0_control.obj")).unwrap();
    assert_eq!(chaikin.creases.len(), 28);
}

#[test]
fn a_large_mesh_takes_no_longer_than_it_should() {
    let Some(folder) = common::real_meshes() else { return };
    let start = Instant::now();
    let mesh = read_mesh(&folder.join("closed/dragon_871k.obj")).unwrap();
    let seconds = start.elapsed().as_secs_f64();
    assert_eq!((mesh.positions.len(), mesh.triangles.len()), (435_545, 871_306));
    // A tenth of that in a release build; the limit is for machines that do other things too.
    assert!(seconds < 10.0, "{seconds:.2} s for 33 MB");
    eprintln!("33 MB of OBJ in {seconds:.2} s");
}
