//! Control meshes as Catmull-Clark surfaces: watertight meshes of micropolygons, for all methods.
//!
//! A picture's rates are those of its camera, so shadows and ambient rays see the surface that the camera sees. A bake has no
//! camera and divides all faces alike.

use std::sync::Arc;
use umbrage_geom::{PolygonMesh, TriangleMesh, glam::Vec3};
use umbrage_reyes::{RatedSurface, Surface, SurfaceError, SurfaceOptions};
use umbrage_scene::{Ground, Scene, Settings};

/// Level of the mesh around which a camera is placed.
const ROUGH_LEVEL: u8 = 2;

/// Most times that a face is halved for a camera, however near.
const MAX_LEVEL: u8 = 8;

fn surface(control: &PolygonMesh) -> Result<Arc<Surface>, SurfaceError> {
    // Patches are divided once, so nothing of their trees has to be kept.
    let options = SurfaceOptions::default().with_tight_levels(0).with_tree_bytes(0);
    Ok(Arc::new(Surface::build(control, &options)?))
}

/// The limit surface with every face of four corners cut into `2^level` by `2^level` cells (other faces become one such
/// quadrilateral a corner), two triangles each, with normals and texture coordinates.
///
/// # Errors
/// [`SurfaceError`] for what is wrong with the control mesh, or a level beyond 12.
pub fn mesh_at_level(control: &PolygonMesh, level: u8) -> Result<TriangleMesh, SurfaceError> {
    Ok(RatedSurface::new(surface(control)?, |_| [level; 2])?.to_mesh())
}

/// [`Scene::around_mesh`] with a surface whose micropolygons are about `pixels` pixels long as the scene's camera sees them.
/// `settings` changes the scene's settings before rates are chosen.
///
/// # Errors
/// [`SurfaceError`] for what is wrong with the control mesh, or an edge length that is not positive.
pub fn scene_around(
    name: &str,
    control: &PolygonMesh,
    pixels: f32,
    settings: impl FnOnce(&mut Settings),
) -> Result<Scene, SurfaceError> {
    let mut scene = Scene::around_mesh(name, mesh_at_level(control, ROUGH_LEVEL)?, Ground::Plane)?;
    settings(&mut scene.settings);
    let half = (0.5 * scene.camera.fov).to_radians().tan();
    let width = 2.0 * half / scene.settings.height.max(1) as f32 * pixels;
    let eye = Vec3::from(scene.camera.position);
    scene.meshes[0].mesh = RatedSurface::for_eye(surface(control)?, eye, width, MAX_LEVEL)?.to_mesh();
    Ok(scene)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cube() -> PolygonMesh {
        let side = |i: u32, bit: u32| if i >> bit & 1 == 1 { 1.0 } else { -1.0 };
        PolygonMesh {
            positions: (0..8).map(|i| [side(i, 0), side(i, 1), side(i, 2)]).collect(),
            face_sizes: vec![4; 6],
            corners: vec![1, 3, 7, 5, 0, 4, 6, 2, 2, 6, 7, 3, 0, 1, 5, 4, 4, 5, 7, 6, 0, 2, 3, 1],
            ..PolygonMesh::default()
        }
    }

    #[test]
    fn rates_follow_the_picture() {
        let at = |height: u32, pixels: f32| {
            let change = |settings: &mut Settings| settings.height = height;
            scene_around("cube", &cube(), pixels, change).unwrap().meshes[0].mesh.triangles.len()
        };
        assert_eq!(at(200, 2.0), at(400, 4.0));
        assert!(at(400, 2.0) > 2 * at(200, 2.0));
        assert!(scene_around("cube", &cube(), 0.0, |_| ()).is_err());
    }

    #[test]
    fn levels_cut_faces_alike() {
        assert_eq!(mesh_at_level(&cube(), 3).unwrap().triangles.len(), 6 * 64 * 2);
        assert!(mesh_at_level(&cube(), 13).is_err());
        assert!(mesh_at_level(&PolygonMesh::default(), 1).is_err());
    }
}
