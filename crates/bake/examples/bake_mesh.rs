//! Bakes ambient occlusion on to a mesh and writes it as a PLY with vertex colours.
//!
//! ```sh
//! cargo run --release -p umbrage-bake --example bake_mesh -- bunny.obj bunny-ao.ply
//! ```
//! Without arguments it bakes a generated dragon and writes nothing.

use umbrage_bake::{
    Bake, BakeOptions, NormalSource, Receivers,
    baked::{BakeTarget, Baked},
};
use umbrage_query::{Ground, Occluders};
use umbrage_scene::{
    Radius,
    generate::{Parameters, generate},
    read_mesh,
};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<_> = std::env::args_os().skip(1).collect();
    let mesh = match arguments.first() {
        Some(path) => read_mesh(path.as_ref())?,
        None => generate("dragonish", &Parameters { triangles: Some(20_000), ..Parameters::default() })?.mesh,
    };
    let occluders = Occluders::of_meshes(&[&mesh], Ground::Absent, &mut |_| true)?;
    let receivers = Receivers::vertices(&mesh, NormalSource::Smooth)?;
    let options = BakeOptions::default().with_rays(256).with_radius(Radius::OfDiagonal(0.1));
    let mut ao = vec![0.0; receivers.len()];
    Bake::new(&occluders, &receivers, &options).run(&mut ao, &mut |_fraction| true)?;
    let mean = ao.iter().map(|&a| f64::from(a)).sum::<f64>() / ao.len() as f64;
    println!("{} vertices, mean ao {mean:.4} (1 is open)", ao.len());
    if let Some(output) = arguments.get(1) {
        Baked { target: BakeTarget::Vertices(mesh), ao, bent_normals: None }.write(output.as_ref())?;
    }
    Ok(())
}
