//! Control meshes as Catmull-Clark surfaces: watertight meshes of micropolygons, for all methods.
//!
//! A picture's rates are those of its camera, so shadows and ambient rays see the surface that the camera sees. A bake of a bare
//! mesh has no camera and divides all faces alike.

use crate::{QueryError, SurfaceMode, engine::Report, share_of};
use std::sync::Arc;
use umbrage_geom::{PolygonMesh, TriangleMesh, glam::Vec3};
use umbrage_reyes::{EyeRates, RatedSurface, Surface, SurfaceError, SurfaceOptions};
use umbrage_scene::{Ground, Scene, Settings, Subdivision, SubdivisionRate};

/// Level of the mesh around which a camera is placed.
const FRAMING_LEVEL: u8 = 2;

/// Most times that a face is halved for a camera, however near.
pub(crate) const MAX_LEVEL: u8 = 8;

/// The surface for rays that divide patches as they need.
pub(crate) fn traced_surface(subdivision: &Subdivision) -> Result<Arc<Surface>, SurfaceError> {
    Ok(Arc::new(Surface::build(&subdivision.control, &SurfaceOptions::default())?))
}

fn surface(subdivision: &Subdivision) -> Result<Arc<Surface>, SurfaceError> {
    // Patches are divided once, so nothing of their trees has to be kept.
    let options = SurfaceOptions::default().with_tight_levels(0).with_tree_bytes(0);
    Ok(Arc::new(Surface::build(&subdivision.control, &options)?))
}

/// The limit surface with every face of four corners cut into `2^level` by `2^level` cells (other faces become one such
/// quadrilateral a corner), two triangles each, with normals, texture coordinates and objects. `progress` gets growing fractions
/// that end at exactly 1, and returns `false` to cancel.
///
/// # Errors
/// [`SurfaceError`] for what is wrong with the control mesh, or a level beyond 12; [`SurfaceError::Cancelled`].
pub fn mesh_at_level(
    control: &PolygonMesh,
    level: u8,
    progress: Report<'_>,
) -> Result<TriangleMesh, SurfaceError> {
    let subdivision = Subdivision::new(control.clone(), SubdivisionRate::Level(level));
    Ok(RatedSurface::build(surface(&subdivision)?, |_| [level; 2], progress)?.to_mesh())
}

/// Puts micropolygons in the place of all control meshes of a scene whose settings ask for surfaces as meshes, at rates for its
/// camera and image height. Objects keep their order. Does nothing to other meshes, nor a second time; nor to a scene whose
/// surfaces are traced as such. `progress` gets growing fractions that end at exactly 1, and returns `false` to cancel; what was
/// refined by then stays.
///
/// # Errors
/// [`QueryError::Surface`] for what is wrong with a control mesh or its rate; [`QueryError::UnknownMethod`],
/// [`QueryError::Cancelled`].
pub fn refine(scene: &mut Scene, progress: Report<'_>) -> Result<(), QueryError> {
    match SurfaceMode::of_scene(scene)? {
        SurfaceMode::Mesh => refine_all(scene, progress),
        SurfaceMode::Once | SurfaceMode::Footprint => Ok(()),
    }
}

/// [`refine`] whatever the settings say: for uses that need triangles.
///
/// # Errors
/// [`QueryError::Surface`], [`QueryError::Cancelled`].
pub fn refine_all(scene: &mut Scene, progress: Report<'_>) -> Result<(), QueryError> {
    let has_control = |index: &usize| scene.meshes[*index].subdivision.is_some();
    let indices: Vec<usize> = (0..scene.meshes.len()).filter(has_control).collect();
    for (number, &index) in indices.iter().enumerate() {
        let Some(subdivision) = scene.meshes[index].subdivision.take() else { continue };
        let mut progress = share_of(progress, number, indices.len());
        let mesh = rated(scene, index, &subdivision, &mut progress).map(|rated| rated.to_mesh());
        let named = &mut scene.meshes[index];
        named.mesh = mesh.map_err(|source| QueryError::from_surface(&named.name, source))?;
    }
    Ok(())
}

/// The surface whose control mesh is mesh `index`, at rates chosen once.
pub(crate) fn rated(
    scene: &Scene,
    index: usize,
    subdivision: &Subdivision,
    progress: Report<'_>,
) -> Result<RatedSurface, SurfaceError> {
    let surface = surface(subdivision)?;
    match subdivision.rate {
        SubdivisionRate::Pixels(pixels) => {
            let half = (0.5 * scene.camera.fov).to_radians().tan();
            let width = 2.0 * half / scene.settings.height.max(1) as f32 * pixels;
            let eye = Vec3::from(scene.camera.position);
            let instances = scene.instances.iter().filter(|i| i.mesh == index);
            let places: Vec<_> = instances.map(|i| i.world_from_object).collect();
            // Pixels are what the user asked for, wherever the surface bends.
            let rates = EyeRates::new(eye, width).with_max_level(MAX_LEVEL).with_bend(0.0);
            RatedSurface::for_eye_on(surface, &places, &rates, progress)
        }
        SubdivisionRate::Level(level) => RatedSurface::build(surface, |_| [level; 2], progress),
    }
}

/// [`Scene::around_mesh`] with a surface whose micropolygons are about `pixels` pixels long as the scene's camera sees them.
/// `settings` changes the scene's settings before rates are chosen; `progress` as in [`refine`].
///
/// # Errors
/// [`QueryError::Surface`] for what is wrong with the control mesh, or an edge length that is not positive;
/// [`QueryError::Cancelled`].
pub fn scene_around(
    name: &str,
    control: &PolygonMesh,
    pixels: f32,
    settings: impl FnOnce(&mut Settings),
    progress: Report<'_>,
) -> Result<Scene, QueryError> {
    let failed = |source| QueryError::from_surface(name, source);
    let rough = mesh_at_level(control, FRAMING_LEVEL, &mut share_of(progress, 0, 2)).map_err(failed)?;
    let mut scene = Scene::around_mesh(name, rough, Ground::Below).map_err(|e| failed(e.into()))?;
    settings(&mut scene.settings);
    let rate = SubdivisionRate::Pixels(pixels);
    scene.meshes[0].subdivision = Some(Subdivision::new(control.clone(), rate));
    refine(&mut scene, &mut share_of(progress, 1, 2))?;
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
            scene_around("cube", &cube(), pixels, change, &mut |_| true).unwrap().meshes[0]
                .mesh
                .triangles
                .len()
        };
        assert_eq!(at(200, 2.0), at(400, 4.0));
        assert!(at(400, 2.0) > 2 * at(200, 2.0));
        assert!(scene_around("cube", &cube(), 0.0, |_| (), &mut |_| true).is_err());
    }

    #[test]
    fn scenes_divide_what_they_name() {
        let text = r#"
            camera = { position = [0, 2, 9], target = [0, 1, 0] }
            image = { width = 60, height = 60 }
            meshes.far = { generator = "cube-sphere", subdivide = 2 }
            meshes.near = { generator = "cube-sphere", subdivide = { pixels = 2 } }
            meshes.plain = { generator = "cube-sphere" }
            meshes.unused = { generator = "cube-sphere", subdivide = 0.1 }
            [[objects]]
            mesh = "far"
            translate = [0, 0, -40]
            [[objects]]
            mesh = "near"
            transforms = [{ translate = [0, 0, -40] }, { translate = [2, 0, 0], scale = [1, 2, 0.5] }]
            [[objects]]
            mesh = "plain"
            [[objects]]
            mesh = { generator = "open-patch", subdivide = { level = 2, boundary = "edge-and-corner" } }
        "#;
        let mut scene = Scene::parse(text, "".as_ref()).unwrap();
        let before = scene.meshes[2].mesh.clone();
        refine(&mut scene, &mut |_| true).unwrap();
        assert!(scene.meshes.iter().all(|m| m.subdivision.is_none()));
        let count = |i: usize| scene.meshes[i].mesh.triangles.len();
        assert!(count(1) > 4 * count(0) && count(0) >= 12, "{} {}", count(1), count(0));
        assert_eq!((&scene.meshes[2].mesh, count(3), count(4)), (&before, 12, 15 * 16 * 2));
        assert!(scene.meshes[4].mesh.positions.contains(&[-1.0, 0.5, 1.0]), "a corner that keeps its place");
        let again = scene.meshes[0].mesh.clone();
        refine(&mut scene, &mut |_| true).unwrap();
        assert_eq!(scene.meshes[0].mesh, again);
        scene.meshes[1].subdivision = Some(Subdivision::default());
        let error = refine(&mut scene, &mut |_| true).unwrap_err().to_string();
        assert!(error.starts_with("near: "), "{error}");
    }

    #[test]
    fn levels_cut_faces_alike() {
        assert_eq!(mesh_at_level(&cube(), 3, &mut |_| true).unwrap().triangles.len(), 6 * 64 * 2);
        assert!(mesh_at_level(&cube(), 13, &mut |_| true).is_err());
        assert!(mesh_at_level(&PolygonMesh::default(), 1, &mut |_| true).is_err());
    }
}
