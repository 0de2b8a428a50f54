//! Texels of light maps.

use super::*;

#[test]
fn texels_belong_to_the_first_triangle_and_leave_no_gap() {
    let mut mesh = quad([0.0; 3], [0.0, 0.0, 2.0], [3.0, 0.0, 0.0]);
    for (width, height) in [(1, 1), (7, 5), (64, 64)] {
        let map = TexelMap::new(&mesh, width, height, VAxis::Up).unwrap();
        let receivers = map.receivers(&mesh, NormalSource::Geometric).unwrap();
        assert_eq!(receivers.len(), (width * height) as usize);
        // Top left is u = 0, v = 1: the far end of the second edge.
        let [x, y, z] = receivers.points()[0];
        let (u, v) = (0.5 / width as f32, 1.0 - 0.5 / height as f32);
        assert!((x - 3.0 * v).abs() < 1e-4 && y == 0.0 && (z - 2.0 * u).abs() < 1e-4);
        let flipped = TexelMap::new(&mesh, width, height, VAxis::Down).unwrap();
        let [x, _, _] = flipped.receivers(&mesh, NormalSource::Geometric).unwrap().points()[0];
        assert!((x - 1.5 / height as f32).abs() < 1e-4);
    }
    // A second chart on top of the first changes nothing, one repeat further neither.
    let before = TexelMap::new(&mesh, 16, 16, VAxis::Up).unwrap();
    let mut other = quad([0.0, 5.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]);
    mesh.append(&other);
    assert_eq!(TexelMap::new(&mesh, 16, 16, VAxis::Up).unwrap(), before);
    other.corner_uvs.iter_mut().flatten().for_each(|uv| *uv = [uv[0] - 3.0, uv[1] + 2.0]);
    assert_eq!(TexelMap::new(&other, 16, 16, VAxis::Up).unwrap(), before);
}

#[test]
fn texels_bake_and_dilate() {
    // A floor under a ceiling, on the middle of the image.
    let mut mesh = quad([-1.0, 0.0, -1.0], [0.0, 0.0, 2.0], [2.0, 0.0, 0.0]);
    mesh.corner_uvs.iter_mut().flatten().for_each(|uv| *uv = uv.map(|x| 0.25 + 0.5 * x));
    let map = TexelMap::new(&mesh, 16, 16, VAxis::Up).unwrap();
    let receivers = map.receivers(&mesh, NormalSource::Smooth).unwrap();
    assert_eq!(receivers.len(), 64);
    mesh.append(&ceiling(0.5, 50.0));
    let ao = bake_all(&mesh, &receivers, &BakeOptions::default());
    assert!(ao.iter().all(|&x| x < 0.01));
    assert!(matches!(map.image(&ao[1..]), Err(BakeError::Length { .. })));
    let mut image = map.image(&ao).unwrap();
    let dark = |image: &TexelImage| image.ao.iter().filter(|&&x| x < 0.01).count();
    assert_eq!(dark(&image), 64);
    image.dilate(2);
    assert_eq!(dark(&image), 144);
    assert_eq!(image.ao[0], 1.0);
    assert_eq!(image.covered.iter().filter(|&&c| c).count(), 64);
    image.dilate(0);
    assert_eq!(dark(&image), 144);
    // Beside one filled texel of each of two values: their mean.
    let mut line =
        TexelImage { width: 3, height: 1, ao: vec![0.2, 1.0, 0.6], covered: vec![true, false, true] };
    line.dilate(9);
    assert!((line.ao[1] - 0.4).abs() < 1e-6);
    assert!(line.ao[0] == 0.2 && line.ao[2] == 0.6);
}

#[test]
fn texels_on_a_concave_edge_are_half_open() {
    // A floor and a wall, each on one half of a strip of 5 x 1 texels: the middle of the third is the shared edge.
    let l = 1e3;
    let floor = quad([l, 0.0, -l], [-l, 0.0, 0.0], [0.0, 0.0, 2.0 * l]);
    let mut wall = quad([0.0, 0.0, -l], [0.0, l, 0.0], [0.0, 0.0, 2.0 * l]);
    let mut mesh = floor;
    mesh.corner_uvs.iter_mut().flatten().for_each(|uv| uv[0] *= 0.5);
    wall.corner_uvs.iter_mut().flatten().for_each(|uv| uv[0] = 0.5 + 0.5 * uv[0]);
    mesh.append(&wall);
    for reversed in [false, true] {
        if reversed {
            mesh.triangles.rotate_left(2);
            mesh.corner_uvs.rotate_left(2);
            mesh.objects.clear();
        }
        let map = TexelMap::new(&mesh, 5, 1, VAxis::Up).unwrap();
        let receivers = map.receivers(&mesh, NormalSource::Geometric).unwrap();
        let ao = bake_all(&mesh, &receivers, &many_rays());
        assert!((ao[2] - 0.5).abs() < 2e-3, "{ao:?}");
        assert!(ao[1] > 0.7 && ao[3] > 0.7);
    }
}

#[test]
fn bad_texture_coordinates_are_named() {
    let mut mesh = ceiling(1.0, 1.0);
    let map = |mesh: &TriangleMesh, width| TexelMap::new(mesh, width, 8, VAxis::Up).unwrap_err();
    assert!(matches!(map(&mesh, 0), BakeError::Count { what: "image width", .. }));
    assert!(matches!(map(&mesh, 1 << 20), BakeError::Count { .. }));
    for bad in [f32::NAN, f32::INFINITY, 1e20, 10.0] {
        mesh.corner_uvs[1][2] = [bad, 0.0];
        assert!(matches!(map(&mesh, 8), BakeError::Uv { triangle: 1, .. }));
    }
    mesh.corner_uvs = vec![[[0.5, 0.5]; 3]; 2];
    assert!(matches!(map(&mesh, 8), BakeError::NoTexel { .. }));
    mesh.corner_uvs.clear();
    assert!(matches!(map(&mesh, 8), BakeError::NoUvs));
    // No receivers at all is a bake of nothing.
    let occluders = Occluders::of_meshes(&[&mesh], Ground::Absent, &mut |_| true).unwrap();
    bake_points(&occluders, &[], &[], &BakeOptions::default(), &mut []).unwrap();
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    #[test]
    fn ao_is_always_a_fraction(
        corners in prop::collection::vec(prop::array::uniform3(-2f32..2.0), 3..30),
        point in prop::array::uniform3(-1f32..1.0), normal in prop::array::uniform3(-1f32..1.0), seed: u32,
        opacity in 0f32..=1.0, which in 0usize..4, scale in prop::sample::select(vec![1e-12f32, 1.0, 1e12]),
    ) {
        prop_assume!(Vec3::from(normal).length() > 1e-3);
        let positions: Vec<_> = corners.iter().map(|p| p.map(|x| x * scale)).collect();
        let triangles = (0..positions.len() as u32 / 3).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
        let mesh = transparent(TriangleMesh::new(positions, triangles).unwrap(), opacity);
        let options = BakeOptions::default()
            .with_rays(9)
            .with_seed(seed)
            .with_sides(if which % 2 == 0 { Sides::Both } else { Sides::Front })
            .with_radius(Radius::OfDiagonal(0.5))
            .with_falloff(if which < 2 { Falloff::Exponential } else { Falloff::Constant });
        for normals in [NormalSource::Geometric, NormalSource::Smooth] {
            let receivers = Receivers::vertices(&mesh, normals).unwrap();
            let ao = bake_all(&mesh, &receivers, &options);
            prop_assert!(ao.iter().all(|x| (0.0..=1.0).contains(x)), "{:?}", ao);
        }
        let one = occlusion(&[&mesh], point.map(|x| x * scale), normal, &options);
        prop_assert!((0.0..=1.0).contains(&one));
        // What both sides block, the front alone can't block more of.
        let both = occlusion(&[&mesh], point.map(|x| x * scale), normal, &options.with_sides(Sides::Both));
        prop_assert!(one <= both + 1e-6);
    }
}
