//! Meshes and what is done to them.

use crate::{rows::note, scenes};
use anyhow::Result;
use umbrage_geom::{
    TriangleMesh,
    glam::{Affine3A, Quat, Vec3},
};
use umbrage_scene::read_mesh;

/// A mesh as a row shows it.
pub struct Scene {
    pub name: &'static str,
    /// What was done to it.
    pub case: &'static str,
    pub mesh: TriangleMesh,
    /// Whether positions and midpoints of edges are small integers.
    pub lattice: bool,
}

/// Real meshes taken as they are, and only in the full form.
const QUICK_MESHES: [&str; 6] = ["bunny_6k", "fandisk", "spot", "sphere_1280", "torus_4608", "skull_10k"];
const FULL_MESHES: [&str; 6] = ["fertility", "rocker_arm", "cow", "goathead", "bunny_60k", "armadillo_86k"];

/// All scenes, smallest first within a kind.
pub fn all(quick: bool) -> Result<Vec<Scene>> {
    let mut all = lattices()?;
    for (name, triangles) in
        [("box", 1200), ("sphere", 1200), ("rocks", 4000), ("blob", 5000), ("knots", 6000)]
    {
        let mesh = scenes::generated(name, triangles)?;
        all.extend(placements(name, &mesh));
    }
    all.extend([mixed_scales()?, coplanar()?]);
    all.extend(slivers()?);
    match scenes::mesh_folder() {
        None => {
            eprintln!("no folder ../shared/meshes and no UMBRAGE_MESHES: rows of real meshes are skipped")
        }
        Some(folder) => {
            let full: &[&str] = if quick { &[] } else { &FULL_MESHES };
            for &name in QUICK_MESHES.iter().chain(full) {
                note(&format!("reading {name}"));
                let mesh = read_mesh(&folder.join("closed").join(name).with_extension("obj"))?;
                all.push(Scene { name, case: "as-is", mesh, lattice: false });
            }
        }
    }
    Ok(all)
}

fn transformed(mesh: &TriangleMesh, by: Affine3A) -> TriangleMesh {
    let mut mesh = mesh.clone();
    mesh.transform(&by);
    mesh
}

/// The mesh as it is, moved away to 10^6 times its size, and scaled by 10^-12 and 10^12.
fn placements(name: &'static str, mesh: &TriangleMesh) -> impl Iterator<Item = Scene> {
    let far = Vec3::new(1.0, -0.7, 0.4) * (1e6 * mesh.bounds().diagonal());
    [
        ("as-is", Affine3A::IDENTITY),
        ("far", Affine3A::from_translation(far)),
        ("tiny", Affine3A::from_scale(Vec3::splat(1e-12))),
        ("huge", Affine3A::from_scale(Vec3::splat(1e12))),
    ]
    .map(|(case, by)| Scene { name, case, mesh: transformed(mesh, by), lattice: false })
    .into_iter()
}

/// A cube of side `2 n` in squares of side 2, its lowest corner at 0.
fn integer_cube(n: usize) -> Result<TriangleMesh> {
    let side = 2.0 * n as f32;
    let unit = scenes::generated("box", 12 * n * n)?;
    let cube = Affine3A::from_scale(Vec3::splat(side)) * Affine3A::from_translation(Vec3::new(0.5, 0.0, 0.5));
    let mut mesh = transformed(&unit, cube);
    // The box's own coordinates are rounded where `n` is no power of two.
    mesh.positions.as_flattened_mut().iter_mut().for_each(|x| *x = x.round());
    Ok(mesh)
}

fn octahedron(radius: f32) -> Result<TriangleMesh> {
    let r = radius;
    let positions =
        vec![[r, 0.0, 0.0], [-r, 0.0, 0.0], [0.0, r, 0.0], [0.0, -r, 0.0], [0.0, 0.0, r], [0.0, 0.0, -r]];
    let triangles =
        vec![[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]];
    Ok(TriangleMesh::new(positions, triangles)?)
}

/// Meshes on which rays through edges and vertices are exact.
fn lattices() -> Result<Vec<Scene>> {
    let scene = |name, mesh| Scene { name, case: "lattice", mesh, lattice: true };
    let mut pair = integer_cube(4)?;
    pair.append(&transformed(&octahedron(8.0)?, Affine3A::from_translation(Vec3::new(4.0, 8.0, 4.0))));
    Ok(vec![scene("octahedron", octahedron(8.0)?), scene("box", integer_cube(5)?), scene("union", pair)])
}

/// A sphere 10^9 times smaller than the knot around it, and one in between.
fn mixed_scales() -> Result<Scene> {
    let mut mesh = scenes::generated("blob", 3000)?;
    let sphere = scenes::generated("sphere", 600)?;
    let center = mesh.bounds().center();
    let size = mesh.bounds().diagonal();
    mesh = transformed(&mesh, Affine3A::from_translation(-center));
    mesh = transformed(&mesh, Affine3A::from_scale(Vec3::splat(1e4 / size)));
    for scale in [1e-5, 1e-1] {
        mesh.append(&transformed(&sphere, Affine3A::from_scale(Vec3::splat(scale))));
    }
    Ok(Scene { name: "blob+spheres", case: "mixed", mesh, lattice: false })
}

/// Boxes that share planes: overlapping, nested in a corner, and one twice.
fn coplanar() -> Result<Scene> {
    let cube = integer_cube(4)?;
    let mut mesh = cube.clone();
    let half = Affine3A::from_scale(Vec3::splat(0.5));
    for by in [Affine3A::IDENTITY, Affine3A::from_translation(Vec3::new(3.0, 0.0, 1.0)), half] {
        mesh.append(&transformed(&cube, by));
    }
    // Off the lattice by a number that no coordinate is a multiple of.
    let mesh = transformed(&mesh, Affine3A::from_scale(Vec3::splat(0.1)));
    Ok(Scene { name: "boxes", case: "coplanar", mesh, lattice: false })
}

/// A sphere pulled to a needle of triangles 10^8 times as long as wide, along an axis and askew, where rounding makes many
/// triangles degenerate.
fn slivers() -> Result<[Scene; 2]> {
    let sphere = scenes::generated("sphere", 1200)?;
    let center = Affine3A::from_translation(-sphere.bounds().center());
    let needle = transformed(&sphere, Affine3A::from_scale(Vec3::new(1e4, 1e-4, 1e-4)) * center);
    let askew = transformed(&needle, Affine3A::from_quat(Quat::from_rotation_z(0.6)));
    let scene = |case, mesh| Scene { name: "needle", case, mesh, lattice: false };
    Ok([scene("slivers", needle), scene("slivers-askew", askew)])
}
