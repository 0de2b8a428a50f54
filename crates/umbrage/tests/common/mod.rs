//! A small scene and a mesh, in a folder where the program runs.

use umbrage_testkit::ProgramFolder;

/// A blob on a ground under a round light and a sky.
pub const SCENE: &str = r#"
[image]
width = 70
height = 40
spp = 2
[camera]
position = [3, 2, 4]
target = [0, 0.3, 0]
[ambient]
radiance = 0.4
radius = 1.0
[[objects]]
mesh = { generator = "plane", width = 8, depth = 8 }
[[objects]]
mesh = { generator = "blob", triangles = 500 }
translate = [0, 0.5, 0]
[[lights]]
type = "sphere"
center = [2, 4, 1]
radius = 0.4
radiance = 30
"#;

/// A tetrahedron with texture coordinates.
pub const OBJ: &str = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nvt 0 0\nvt 1 0\nvt 0 1\n\
    f 1/1 3/2 2/3\nf 1/1 2/2 4/3\nf 1/1 4/2 3/3\nf 2/1 3/2 4/3\n";

/// A folder with `scene.toml` and `mesh.obj`.
pub fn folder() -> ProgramFolder {
    ProgramFolder::new(env!("CARGO_BIN_EXE_umbrage"), &[("scene.toml", SCENE), ("mesh.obj", OBJ)])
}
