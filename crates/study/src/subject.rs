//! What is studied: a scene with its occluders, and the points that ask.

use super::{Per, StudyError};
use umbrage_aomask::Receiver;
use umbrage_bake::{BakeOptions, NormalSource, Receivers, TexelMap};
use umbrage_geom::{
    RayDifferential, TriangleMesh, offset_origin,
    sampling::{combine, sobol_4d, unit},
};
use umbrage_query::{Occluders, QueryError, engine::Report, subdivide};
use umbrage_render::CameraRays;
use umbrage_scene::{Ground, Scene};

/// A scene or a mesh that is studied, with its wide BVH.
pub struct Subject {
    name: String,
    /// Subdivision surfaces are meshes in it.
    scene: Scene,
    /// As it was given, if it has subdivision surfaces.
    control: Option<Scene>,
    occluders: Occluders,
}

impl Subject {
    /// A mesh, seen by a camera of its own and lit by a square above it. `progress` as for [`Occluders::of_scene`].
    ///
    /// # Errors
    /// [`StudyError::Mesh`], [`StudyError::Query`], [`StudyError::Cancelled`].
    pub fn of_mesh(
        name: &str,
        mesh: TriangleMesh,
        ground: Ground,
        progress: Report<'_>,
    ) -> Result<Self, StudyError> {
        Self::of_scene(name, Scene::around_mesh(name, mesh, ground)?, progress)
    }

    /// A scene. Its subdivision surfaces are meshes for all questions but that of surfaces. `progress` as for
    /// [`Occluders::of_scene`].
    ///
    /// # Errors
    /// [`StudyError::Query`], [`StudyError::Cancelled`].
    pub fn of_scene(name: &str, scene: Scene, progress: Report<'_>) -> Result<Self, StudyError> {
        let has_surfaces = scene.instances.iter().any(|i| scene.meshes[i.mesh].subdivision.is_some());
        let control = has_surfaces.then(|| scene.clone());
        let mut scene = scene;
        scene.settings.surfaces = umbrage_query::SurfaceMode::Mesh.name().into();
        subdivide::refine_all(&mut scene, &mut |_| progress(0.0))?;
        let occluders = Occluders::of_scene(&scene, progress)?;
        if occluders.triangle_count() == 0 {
            return Err(QueryError::NoOccluder.into());
        }
        Ok(Self { name: name.into(), scene, control, occluders })
    }

    /// What it is called in results.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The scene, with meshes in the place of subdivision surfaces.
    pub fn scene(&self) -> &Scene {
        &self.scene
    }

    /// The scene with its control meshes, if it has any.
    pub(crate) fn control(&self) -> Option<&Scene> {
        self.control.as_ref()
    }

    /// What blocks rays.
    pub fn occluders(&self) -> &Occluders {
        &self.occluders
    }

    /// At most `count` of the points that ask, drawn by `seed`.
    pub(crate) fn receivers(&self, per: Per, count: usize, seed: u32) -> Result<Vec<Receiver>, StudyError> {
        let (all, nothing) = match per {
            Per::Camera => return self.seen(count, seed),
            Per::Vertex => {
                let mesh = self.scene.flatten();
                (Receivers::vertices(&mesh, NormalSource::Smooth)?, "no vertex has a direction")
            }
            Per::Texel { size: [width, height], v_axis } => {
                let mesh = self.scene.flatten();
                let map = TexelMap::new(&mesh, width, height, v_axis)?;
                (map.receivers(&mesh, NormalSource::Smooth)?, "no texel is covered")
            }
        };
        let some = drawn(all.len(), count, seed);
        let receivers = all.drawn(&some, &BakeOptions::default().with_seed(seed))?;
        if receivers.is_empty() { Err(StudyError::NoReceiver(nothing)) } else { Ok(receivers) }
    }

    /// Points that the camera sees, in the order of rows of the image.
    fn seen(&self, count: usize, seed: u32) -> Result<Vec<Receiver>, StudyError> {
        let settings = &self.scene.settings;
        let (width, height) = (settings.width, settings.height);
        let camera = CameraRays::new(&self.scene.camera, width, height);
        let mut places: Vec<[f32; 2]> = (0..4 * count as u32)
            .map(|i| {
                let [x, y, ..] = sobol_4d(i, 7, seed);
                [x * width as f32, y * height as f32]
            })
            .collect();
        places.sort_by(|a, b| {
            (a[1] as u32 / 16, a[0])
                .partial_cmp(&(b[1] as u32 / 16, b[0]))
                .unwrap_or(std::cmp::Ordering::Equal)
        });
        let mut receivers = Vec::new();
        for [x, y] in places {
            let ray = camera.ray(x, y, [0.0; 2]);
            let Some(hit) = self.occluders.closest_hit(&ray, &RayDifferential::default(), &mut ()) else {
                continue;
            };
            let n = hit.geometric_normal;
            let origin = offset_origin(hit.point, n, n, hit.magnitude);
            let (point, normal) = (origin.to_array(), hit.shading_normal.to_array());
            let receiver =
                Receiver::new(receivers.len(), point, normal, Receiver::seed_of(point, normal, seed));
            if let Ok(receiver) = receiver {
                receivers.push(receiver.with_face(n.to_array()));
            }
        }
        // Every so many, so that the whole image is asked.
        let step = receivers.len().div_ceil(count).max(1);
        let receivers: Vec<Receiver> = receivers.into_iter().step_by(step).collect();
        if receivers.is_empty() {
            Err(StudyError::NoReceiver("the camera sees no surface"))
        } else {
            Ok(receivers)
        }
    }
}

/// At most `count` of `all` indices in runs of 32 neighbours, which is how bakes ask.
fn drawn(all: usize, count: usize, seed: u32) -> Vec<u32> {
    const RUN: usize = 32;
    if all <= count {
        return (0..all as u32).collect();
    }
    let (runs, wanted) = (all / RUN, (count / RUN).max(1));
    if runs <= wanted {
        return (0..count as u32).collect();
    }
    // One run of each of equally large shares of all runs.
    let start = |i: usize| {
        let within = f64::from(unit(combine(seed, i as u32)));
        ((i as f64 + within) / wanted as f64 * runs as f64) as usize
    };
    (0..wanted).flat_map(|i| (0..RUN).map(move |k| (start(i) * RUN + k) as u32)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn runs_are_spread_over_all() {
        assert_eq!(drawn(10, 20, 1), (0..10).collect::<Vec<_>>());
        let some = drawn(100_000, 2000, 1);
        assert_eq!(some.len(), 1984);
        assert!(some.windows(2).all(|w| w[0] < w[1]) && some[0] < 2000 && some[1983] > 98_000);
        assert_ne!(some, drawn(100_000, 2000, 2));
        assert_eq!(drawn(2001, 2000, 3).len(), 2000);
    }
}
