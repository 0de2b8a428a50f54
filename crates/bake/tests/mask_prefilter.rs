//! Method `mask-prefilter` on semi-transparent foliage over a ground: its stated bound, and shards.

use umbrage_bake::{Bake, BakeOptions, NormalSource, Receivers, Shard};
use umbrage_geom::{TriangleMesh, glam::Vec3};
use umbrage_query::{AoMethod, Ground, Occluders};
use umbrage_scene::{
    Radius,
    generate::{Parameters, generate},
};

/// What `mask-prefilter` may add to the mean over receivers on the ground, and to that over all others.
const MOST_BIAS: f64 = 0.005;

/// A bush of which every triangle blocks half of the light.
fn veil(triangles: usize) -> TriangleMesh {
    let parameters = Parameters { triangles: Some(triangles), ..Parameters::default() };
    let mut mesh = generate("bush", &parameters).unwrap().mesh;
    let mut objects = mesh.objects_or_whole();
    objects.iter_mut().for_each(|object| object.opacity = 0.5);
    mesh.objects = objects;
    mesh
}

/// Points on the ground below `mesh`, around its middle.
fn on_the_ground(mesh: &TriangleMesh) -> Receivers {
    let bounds = mesh.bounds();
    let size = bounds.max - bounds.min;
    let place = |i: usize| (i as f32 + 0.5) / 50.0 * 2.0 - 0.5;
    let points: Vec<[f32; 3]> = (0..2500)
        .map(|i| {
            let at = Vec3::new(place(i % 50), 0.0, place(i / 50));
            (bounds.min + size * at).to_array()
        })
        .collect();
    Receivers::from_points(&points, &vec![[0.0, 1.0, 0.0]; points.len()]).unwrap()
}

fn baked(occluders: &Occluders, receivers: &Receivers, options: &BakeOptions) -> Vec<f32> {
    let mut ao = vec![f32::NAN; receivers.len()];
    Bake::new(occluders, receivers, options).run(&mut ao, &mut |_| true).unwrap();
    ao
}

fn mean(ao: &[f32]) -> f64 {
    ao.iter().map(|&x| f64::from(x)).sum::<f64>() / ao.len() as f64
}

#[test]
fn veils_and_their_ground_keep_the_stated_bound() {
    let mesh = veil(30_000);
    let occluders = Occluders::of_meshes(&[&mesh], Ground::Below, &mut |_| true).unwrap();
    let vertices = Receivers::vertices(&mesh, NormalSource::Smooth).unwrap();
    for radius in [Radius::OfDiagonal(0.1), Radius::Unbounded] {
        let options = BakeOptions::default().with_rays(64).with_radius(radius);
        for (receivers, what) in [(&vertices, "bush"), (&on_the_ground(&mesh), "ground")] {
            let exact = baked(&occluders, receivers, &options.clone().with_method(AoMethod::Mask));
            let ours = baked(&occluders, receivers, &options.clone().with_method(AoMethod::MaskPrefilter));
            let bias = mean(&ours) - mean(&exact);
            assert!(bias.abs() < MOST_BIAS, "{what}, {radius:?}: {bias}");
            assert!(
                mean(&exact) > 0.05 && mean(&exact) < 0.97,
                "{what} has nothing to ask: {}",
                mean(&exact)
            );
        }
    }
}

#[test]
fn shards_are_the_whole() {
    let mesh = veil(6_000);
    let occluders = Occluders::of_meshes(&[&mesh], Ground::Below, &mut |_| true).unwrap();
    let receivers = Receivers::vertices(&mesh, NormalSource::Smooth).unwrap();
    let options = BakeOptions::default()
        .with_rays(64)
        .with_radius(Radius::OfDiagonal(0.1))
        .with_method(AoMethod::MaskPrefilter);
    let whole = baked(&occluders, &receivers, &options);
    let mut parts = vec![f32::NAN; receivers.len()];
    for i in 1..=3 {
        let shard: Shard = format!("{i}/3").parse().unwrap();
        Bake::new(&occluders, &receivers, &options).with_shard(shard).run(&mut parts, &mut |_| true).unwrap();
    }
    assert!(whole.iter().zip(&parts).all(|(a, b)| a.to_bits() == b.to_bits()));
    // Stored opacity takes part: the answers are not those of masks alone.
    let exact = baked(&occluders, &receivers, &options.with_method(AoMethod::Mask));
    assert_ne!(whole, exact);
}
