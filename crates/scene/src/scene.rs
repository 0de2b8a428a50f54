//! What a scene is, once read: plain data that the renderer turns into acceleration structures.

use crate::ByteSize;
use umbrage_geom::{Falloff, PolygonMesh, TriangleMesh, glam::Affine3A};

/// A scene: geometry, lights, a camera and settings.
#[derive(Clone, Debug)]
pub struct Scene {
    /// Where the picture is taken from.
    pub camera: Camera,
    /// Meshes in object space, each stored once.
    pub meshes: Vec<NamedMesh>,
    /// Placed meshes.
    pub instances: Vec<Instance>,
    /// Surfaces.
    pub materials: Vec<Material>,
    /// Light sources, in the file's order.
    pub lights: Vec<Light>,
    /// Constant sky for ambient occlusion; `None` draws no ambient light.
    pub ambient: Option<Ambient>,
    /// Radiance of rays that leave the scene, linear RGB.
    pub background: [f32; 3],
    /// Image size, sample counts and methods.
    pub settings: Settings,
}

/// A mesh and its name in the scene file.
#[derive(Clone, Debug)]
pub struct NamedMesh {
    /// Name of the mesh, unique in the scene.
    pub name: String,
    /// The triangles, validated.
    pub mesh: TriangleMesh,
    /// The surface whose control mesh's polygons [`Self::mesh`] holds, until a renderer puts micropolygons in their place
    /// and takes this away.
    pub subdivision: Option<Subdivision>,
}

impl NamedMesh {
    /// A mesh that is shown as it is.
    pub fn new(name: impl Into<String>, mesh: TriangleMesh) -> Self {
        Self { name: name.into(), mesh, subdivision: None }
    }
}

/// A Catmull-Clark surface, and how finely it is divided.
#[derive(Clone, Debug, Default, PartialEq)]
#[non_exhaustive]
pub struct Subdivision {
    /// The control mesh, with its boundary rule and its crease method.
    pub control: PolygonMesh,
    /// How finely.
    pub rate: SubdivisionRate,
}

impl Subdivision {
    /// The surface of a control mesh at a rate.
    pub fn new(control: PolygonMesh, rate: SubdivisionRate) -> Self {
        Self { control, rate }
    }
}

/// How finely a surface is divided.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum SubdivisionRate {
    /// Edges of micropolygons are about so many pixels long as the scene's camera sees them, above 0.
    Pixels(f32),
    /// Every face of four corners in `2^level` by `2^level` cells, at most 12; other faces are one such quadrilateral a
    /// corner.
    Level(u8),
}

impl Default for SubdivisionRate {
    fn default() -> Self {
        Self::Pixels(1.0)
    }
}

/// A mesh placed in the world.
#[derive(Clone, Debug)]
pub struct Instance {
    /// Name, unique in the scene.
    pub name: String,
    /// Index into [`Scene::meshes`].
    pub mesh: usize,
    /// Invertible.
    pub world_from_object: Affine3A,
    /// One index into [`Scene::materials`] for each object of the mesh, in the order of
    /// [`TriangleMesh::objects_or_whole`].
    pub materials: Vec<usize>,
}

/// A diffuse surface.
#[derive(Clone, Debug, PartialEq)]
pub struct Material {
    /// Name, unique in the scene.
    pub name: String,
    /// Fraction of light reflected, linear RGB in `[0, 1]`.
    pub albedo: [f32; 3],
    /// Fraction of light that one crossing blocks, in `[0, 1]`; multiplies the opacity of the mesh's object.
    pub opacity: f32,
}

/// A camera that looks along `target - position`; validated: not at itself, `up` not along the view.
#[derive(Clone, Debug, PartialEq)]
pub struct Camera {
    /// Centre of the lens, world units.
    pub position: [f32; 3],
    /// A point in the middle of the image.
    pub target: [f32; 3],
    /// Roughly up.
    pub up: [f32; 3],
    /// Vertical field of view, degrees, in (0, 180).
    pub fov: f32,
    /// Radius of a thin lens, world units; 0 is a pinhole.
    pub lens_radius: f32,
    /// Distance that is sharp with a lens, world units along the view; `None` is the target's distance.
    pub focus_distance: Option<f32>,
}

/// A light source. Directions need no unit length; colours are linear RGB.
#[derive(Clone, Debug, PartialEq)]
pub enum Light {
    /// A parallelogram with edges `u` and `v` from `corner`, emitting towards `u x v`.
    Rectangle {
        /// One corner.
        corner: [f32; 3],
        /// First edge.
        u: [f32; 3],
        /// Second edge.
        v: [f32; 3],
        /// Radiance, the same in all directions.
        radiance: [f32; 3],
        /// Whether the back side emits too.
        two_sided: bool,
    },
    /// A disc emitting towards `normal`.
    Disc {
        /// Centre.
        center: [f32; 3],
        /// Axis.
        normal: [f32; 3],
        /// Radius, world units.
        radius: f32,
        /// Radiance.
        radiance: [f32; 3],
        /// Whether the back side emits too.
        two_sided: bool,
    },
    /// A sphere emitting outwards.
    Sphere {
        /// Centre.
        center: [f32; 3],
        /// Radius, world units.
        radius: f32,
        /// Radiance.
        radiance: [f32; 3],
    },
    /// A point with the same intensity in all directions.
    Point {
        /// Where.
        position: [f32; 3],
        /// Radiant intensity (power per solid angle).
        intensity: [f32; 3],
    },
    /// A point that emits into a cone.
    Spot {
        /// Where.
        position: [f32; 3],
        /// Axis of the cone.
        direction: [f32; 3],
        /// Full intensity up to this angle from the axis, degrees.
        inner_angle: f32,
        /// No intensity from this angle on, degrees; smooth between.
        outer_angle: f32,
        /// Radiant intensity on the axis.
        intensity: [f32; 3],
    },
    /// Light from infinitely far away, travelling along `direction`; a positive `angle` makes a disc like the sun's.
    Directional {
        /// Where light travels to.
        direction: [f32; 3],
        /// Angular diameter, degrees.
        angle: f32,
        /// Irradiance on a surface facing the light.
        irradiance: [f32; 3],
    },
}

/// Constant sky light, blocked by geometry within a radius.
#[derive(Clone, Debug, PartialEq)]
pub struct Ambient {
    /// Radiance of the sky, linear RGB.
    pub radiance: [f32; 3],
    /// How far occluders count.
    pub radius: Radius,
    /// How occluders fade with distance.
    pub falloff: Falloff,
}

/// A distance, as a length or in proportion to the scene.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[non_exhaustive]
pub enum Radius {
    /// No limit.
    #[default]
    Unbounded,
    /// World units, above 0.
    Absolute(f32),
    /// Fraction of the diagonal of the scene's bounds, above 0.
    OfDiagonal(f32),
}

impl Radius {
    /// World units, for a scene whose bounds have the given diagonal.
    pub fn resolve(self, diagonal: f32) -> f32 {
        match self {
            Self::Unbounded => f32::INFINITY,
            Self::Absolute(length) => length,
            Self::OfDiagonal(fraction) => fraction * diagonal,
        }
    }
}

/// Image size, sample counts and methods; the command line overrides them.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    /// Pixels across, at least 1.
    pub width: u32,
    /// Pixels down, at least 1.
    pub height: u32,
    /// Camera samples a pixel, at least 1.
    pub spp: u32,
    /// Shadow rays to each area light from each camera sample, at least 1.
    pub shadow_samples: u32,
    /// Ambient occlusion rays from each camera sample, at least 1.
    pub ao_samples: u32,
    /// Name of the method that traces shadows; `auto` chooses.
    pub shadows: String,
    /// Name of the method that computes ambient occlusion; `auto` chooses.
    pub ao: String,
    /// How subdivision surfaces are traced: `mesh`, `once` or `footprint`.
    pub surfaces: String,
    /// Bytes of grids that are kept for each control mesh where surfaces are traced by `footprint`. Pictures don't depend on it.
    pub grid_cache: ByteSize,
    /// Seed of all random choices.
    pub seed: u32,
    /// Stops of brightness added before the image is written as PNG.
    pub exposure: f32,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            width: 640,
            height: 480,
            spp: 16,
            shadow_samples: 1,
            ao_samples: 1,
            shadows: "auto".into(),
            ao: "auto".into(),
            surfaces: "mesh".into(),
            grid_cache: ByteSize::mebibytes(256),
            seed: 0,
            exposure: 0.0,
        }
    }
}
