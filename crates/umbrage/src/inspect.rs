//! What is in a mesh or a scene: counts, bounds, memory, and what may be wrong with it.
//!
//! Edges and duplicates are judged by position: vertices at exactly the same place count as one, because many files
//! split vertices along seams. Costs a few sorts of the vertices, triangles and edges.

mod methods;
mod text;

pub use methods::{
    Inspection, MethodReport, MethodReports, inspect_mesh_for_methods, inspect_scene_for_methods,
};

use rayon::prelude::*;
use serde::Serialize;
use std::ops::Range;
use umbrage_geom::{
    Aabb, TriangleMesh,
    audit::{self, Audit, Edges},
    is_degenerate,
};
use umbrage_scene::{Light, Scene};

/// Most examples that a report lists.
const MAX_EXAMPLES: usize = 8;

/// An axis-parallel box; all zero if there is nothing inside.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct BoundsReport {
    /// Smallest coordinates.
    pub min: [f32; 3],
    /// Largest coordinates.
    pub max: [f32; 3],
    /// Length of the diagonal.
    pub diagonal: f64,
}

impl From<Aabb> for BoundsReport {
    fn from(aabb: Aabb) -> Self {
        if aabb.is_empty() {
            return Self::default();
        }
        // In `f32` the squares of large coordinates overflow.
        let diagonal = (aabb.max.as_dvec3() - aabb.min.as_dvec3()).length();
        Self { min: aabb.min.to_array(), max: aabb.max.to_array(), diagonal }
    }
}

/// How the triangles of a mesh or object meet, degenerate triangles with two corners at one place left out.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct EdgeReport {
    /// Different edges.
    pub edges: u64,
    /// Edges of one triangle.
    pub boundary: u64,
    /// Edges of more than two triangles.
    pub non_manifold: u64,
    /// Edges whose two triangles run along them in the same direction, so that one has its outside where the other has
    /// its inside.
    pub inconsistent: u64,
}

impl From<&Edges> for EdgeReport {
    fn from(edges: &Edges) -> Self {
        Self {
            edges: edges.edges,
            boundary: edges.boundary.count,
            non_manifold: edges.non_manifold.count,
            inconsistent: edges.inconsistent.count,
        }
    }
}

/// Whether an object is the boundary of a solid, see [`umbrage_geom::audit`]; examples are the first few.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct SolidReport {
    /// Whether it is closed, consistent and doesn't cut itself (Djeu11, section 3.1).
    pub well_behaved: bool,
    /// Whether its triangles, some turned, are a closed surface: then it can generate occluders.
    pub encloses: bool,
    /// Sets of triangles connected through edges of two triangles.
    pub components: u32,
    /// Of these, how many face inwards.
    pub inwards: u32,
    /// Of these, how many have only one side, like a Moebius strip.
    pub one_sided: u32,
    /// Pairs of triangles that meet elsewhere than in a common corner or edge.
    pub self_intersections: u64,
    /// Such pairs.
    pub intersection_examples: Vec<[u32; 2]>,
    /// Vertices of edges of one triangle.
    pub boundary_examples: Vec<[u32; 2]>,
    /// Vertices of edges of more than two triangles.
    pub non_manifold_examples: Vec<[u32; 2]>,
    /// Vertices of edges along which two triangles run in the same direction.
    pub inconsistent_examples: Vec<[u32; 2]>,
}

impl SolidReport {
    /// `first` is what the triangles of `audit` are counted from.
    fn new(audit: Audit, first: u32) -> Self {
        Self {
            well_behaved: audit.well_behaved(),
            encloses: audit.encloses(),
            components: audit.orientation.components,
            inwards: audit.orientation.inwards,
            one_sided: audit.orientation.one_sided,
            self_intersections: audit.self_intersections.count,
            intersection_examples: audit
                .self_intersections
                .examples
                .iter()
                .map(|[a, b]| [a + first, b + first])
                .collect(),
            boundary_examples: audit.edges.boundary.examples,
            non_manifold_examples: audit.edges.non_manifold.examples,
            inconsistent_examples: audit.edges.inconsistent.examples,
        }
    }
}

impl EdgeReport {
    /// Whether every edge has two triangles that agree on what is outside. (Triangles may still cut through each other.)
    pub fn closed(&self) -> bool {
        self.edges > 0 && self.boundary + self.non_manifold + self.inconsistent == 0
    }
}

/// One object of a mesh.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ObjectReport {
    /// Name as the source gives it; may be empty.
    pub name: String,
    /// How many triangles it has.
    pub triangles: u64,
    /// Fraction of light that one crossing blocks.
    pub opacity: f32,
    /// Where it is.
    pub bounds: BoundsReport,
    /// Triangles without area.
    pub degenerate_triangles: u64,
    /// How its triangles meet; those of other objects don't count.
    pub edges: EdgeReport,
    /// Whether it is closed, see [`EdgeReport::closed`].
    pub closed: bool,
    /// Whether it bounds a solid.
    pub solid: SolidReport,
}

/// What is in a mesh. As JSON: the names of the fields.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct MeshReport {
    /// Vertices, used or not.
    pub vertices: u64,
    /// Triangles.
    pub triangles: u64,
    /// Bounds of the used vertices.
    pub bounds: BoundsReport,
    /// Bytes of the mesh in memory.
    pub bytes: u64,
    /// Whether corners have normals.
    pub normals: bool,
    /// Whether corners have texture coordinates.
    pub uvs: bool,
    /// Triangles without area, which no ray ever hits.
    pub degenerate_triangles: u64,
    /// The first few of them.
    pub degenerate_examples: Vec<u32>,
    /// Triangles with the same three positions as an earlier one, in whatever order.
    pub duplicate_triangles: u64,
    /// The first few of them, each after the earliest triangle that it repeats.
    pub duplicate_examples: Vec<[u32; 2]>,
    /// Vertices that no triangle uses.
    pub unused_vertices: u64,
    /// Vertices at exactly the position of an earlier one.
    pub duplicate_vertices: u64,
    /// Length of the shortest edge of triangles with area; `None` (null) if there are none.
    pub shortest_edge: Option<f64>,
    /// Length of the longest edge of triangles with area.
    pub longest_edge: Option<f64>,
    /// How triangles meet, across objects.
    pub edges: EdgeReport,
    /// Whether the mesh as a whole is closed, see [`EdgeReport::closed`].
    pub closed: bool,
    /// The objects, at least one.
    pub objects: Vec<ObjectReport>,
}

/// A mesh of a scene.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct NamedMeshReport {
    /// Name in the scene.
    pub name: String,
    /// What is in it.
    #[serde(flatten)]
    pub mesh: MeshReport,
}

/// A placed mesh of a scene.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct InstanceReport {
    /// Name in the scene.
    pub name: String,
    /// Name of the mesh.
    pub mesh: String,
    /// How many triangles it has.
    pub triangles: u64,
    /// Box around the mesh's transformed bounds, world units; not the tightest if the mesh is rotated.
    pub bounds: BoundsReport,
    /// Whether the transform turns the mesh inside out like a mirror.
    pub mirrored: bool,
    /// Names of the materials of the mesh's objects.
    pub materials: Vec<String>,
}

/// Lights of a scene by kind.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct LightReport {
    /// Lights with a surface: rectangles, discs, spheres.
    pub area: u64,
    /// Points and spots.
    pub point: u64,
    /// Lights from infinitely far away.
    pub directional: u64,
    /// Whether there is constant sky light.
    pub ambient: bool,
}

/// What is in a scene. As JSON: the names of the fields; meshes have the fields of [`MeshReport`] after their name.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SceneReport {
    /// Around all instances, as [`InstanceReport::bounds`], world units.
    pub bounds: BoundsReport,
    /// Triangles stored: each mesh once.
    pub triangles: u64,
    /// Triangles seen: each instance.
    pub instanced_triangles: u64,
    /// Vertices stored.
    pub vertices: u64,
    /// Bytes of all meshes in memory.
    pub bytes: u64,
    /// How many materials there are.
    pub materials: u64,
    /// How many lights there are.
    pub lights: LightReport,
    /// Each mesh, once.
    pub meshes: Vec<NamedMeshReport>,
    /// Each placed mesh.
    pub instances: Vec<InstanceReport>,
}

/// Why audits of a mesh that may be looked through don't fail.
const VALID: &str = "the caller promises that all vertices exist";

/// Looks through a mesh. An invalid mesh (see [`TriangleMesh::validate`]) has no report.
///
/// # Panics
/// If a triangle names a vertex that does not exist, or an object triangles that don't.
pub fn inspect_mesh(mesh: &TriangleMesh) -> MeshReport {
    let degenerate = mesh.degenerate_triangles();
    let welded = audit::weld(&mesh.positions);
    let (duplicate_triangles, duplicate_examples) = duplicate_triangles(mesh, &welded);
    let mut used = vec![false; mesh.positions.len()];
    mesh.triangles.iter().flatten().for_each(|&v| used[v as usize] = true);
    let count = |flags: &mut dyn Iterator<Item = bool>| flags.filter(|f| *f).count() as u64;
    let duplicate = |(i, &first): (usize, &u32)| first as usize != i;
    let (shortest_edge, longest_edge) = edge_lengths(mesh).map_or((None, None), |(a, b)| (Some(a), Some(b)));
    let slice = |range: &Range<u32>| &mesh.triangles[range.start as usize..range.end as usize];
    let edges = EdgeReport::from(&audit::edges(&mesh.triangles, &welded).expect(VALID));
    let objects = mesh.objects_or_whole().into_iter().map(|object| {
        let range = object.triangles;
        let own = slice(&range);
        let audit = Audit {
            edges: audit::edges(own, &welded).expect(VALID),
            orientation: audit::orient(&mesh.positions, own, &welded).expect(VALID),
            self_intersections: audit::self_intersections(&mesh.positions, own, &welded).expect(VALID),
        };
        let edges = EdgeReport::from(&audit.edges);
        let below = |end: u32| degenerate.partition_point(|&t| t < end) as u64;
        let corners = own.iter().flatten();
        let bounds = corners.fold(Aabb::EMPTY, |b, &v| b.with_point(mesh.positions[v as usize]));
        ObjectReport {
            name: object.name,
            triangles: range.len() as u64,
            opacity: object.opacity,
            bounds: bounds.into(),
            degenerate_triangles: below(range.end) - below(range.start),
            edges,
            closed: edges.closed(),
            solid: SolidReport::new(audit, range.start),
        }
    });
    MeshReport {
        vertices: mesh.positions.len() as u64,
        triangles: mesh.triangles.len() as u64,
        bounds: mesh.bounds().into(),
        bytes: mesh.bytes() as u64,
        normals: !mesh.corner_normals.is_empty(),
        uvs: !mesh.corner_uvs.is_empty(),
        degenerate_triangles: degenerate.len() as u64,
        degenerate_examples: degenerate.iter().copied().take(MAX_EXAMPLES).collect(),
        duplicate_triangles,
        duplicate_examples,
        unused_vertices: count(&mut used.iter().map(|u| !u)),
        duplicate_vertices: count(&mut welded.iter().enumerate().map(duplicate)),
        shortest_edge,
        longest_edge,
        edges,
        closed: edges.closed(),
        objects: objects.collect(),
    }
}

/// Looks through a scene and its meshes.
///
/// # Panics
/// As [`inspect_mesh`], or if an instance names a mesh or material that does not exist.
pub fn inspect_scene(scene: &Scene) -> SceneReport {
    let report = |named: &umbrage_scene::NamedMesh| NamedMeshReport {
        name: named.name.clone(),
        mesh: inspect_mesh(&named.mesh),
    };
    let meshes: Vec<NamedMeshReport> = scene.meshes.iter().map(report).collect();
    let local: Vec<Aabb> = scene.meshes.iter().map(|named| named.mesh.bounds()).collect();
    let mut bounds = Aabb::EMPTY;
    let instances = scene.instances.iter().map(|instance| {
        let mut placed = Aabb::EMPTY;
        if !local[instance.mesh].is_empty() {
            let [min, max] = [local[instance.mesh].min, local[instance.mesh].max].map(|p| p.to_array());
            for corner in 0..8 {
                let point =
                    std::array::from_fn(|axis| if corner >> axis & 1 == 0 { min[axis] } else { max[axis] });
                placed =
                    placed.with_point(instance.world_from_object.transform_point3(<[f32; 3]>::into(point)));
            }
        }
        bounds = bounds.union(placed);
        InstanceReport {
            name: instance.name.clone(),
            mesh: meshes[instance.mesh].name.clone(),
            triangles: meshes[instance.mesh].mesh.triangles,
            bounds: placed.into(),
            mirrored: instance.world_from_object.matrix3.determinant() < 0.0,
            materials: instance.materials.iter().map(|&m| scene.materials[m].name.clone()).collect(),
        }
    });
    let instances: Vec<InstanceReport> = instances.collect();
    let sum = |value: fn(&MeshReport) -> u64| meshes.iter().map(|m| value(&m.mesh)).sum();
    SceneReport {
        bounds: bounds.into(),
        triangles: sum(|m| m.triangles),
        instanced_triangles: instances.iter().map(|i| i.triangles).sum(),
        vertices: sum(|m| m.vertices),
        bytes: sum(|m| m.bytes),
        materials: scene.materials.len() as u64,
        lights: light_report(scene),
        meshes,
        instances,
    }
}

fn light_report(scene: &Scene) -> LightReport {
    let mut lights = LightReport { ambient: scene.ambient.is_some(), ..LightReport::default() };
    for light in &scene.lights {
        match light {
            Light::Point { .. } | Light::Spot { .. } => lights.point += 1,
            Light::Directional { .. } => lights.directional += 1,
            _ => lights.area += 1,
        }
    }
    lights
}

/// How many triangles repeat an earlier one, and examples of (earliest, repeating).
fn duplicate_triangles(mesh: &TriangleMesh, welded: &[u32]) -> (u64, Vec<[u32; 2]>) {
    let key = |t: u32| {
        let mut corners = mesh.triangles[t as usize].map(|v| welded[v as usize]);
        corners.sort_unstable();
        corners
    };
    let mut order: Vec<([u32; 3], u32)> =
        (0..mesh.triangles.len() as u32).into_par_iter().map(|t| (key(t), t)).collect();
    order.par_sort_unstable();
    let mut repeating = Vec::new();
    for group in order.chunk_by(|a, b| a.0 == b.0) {
        repeating.extend(group[1..].iter().map(|(_, t)| [group[0].1, *t]));
    }
    let count = repeating.len() as u64;
    repeating.sort_unstable_by_key(|pair| pair[1]);
    repeating.truncate(MAX_EXAMPLES);
    (count, repeating)
}

/// Shortest and longest edge of triangles with area.
fn edge_lengths(mesh: &TriangleMesh) -> Option<(f64, f64)> {
    let squares = |t: usize| {
        let corners = mesh.triangle(t);
        if is_degenerate(corners) {
            return None;
        }
        let edge = |i: usize| -> f64 {
            let (a, b) = (corners[i], corners[(i + 1) % 3]);
            a.iter().zip(b).map(|(&a, b)| (f64::from(b) - f64::from(a)).powi(2)).sum()
        };
        let [x, y, z] = [edge(0), edge(1), edge(2)];
        Some((x.min(y).min(z), x.max(y).max(z)))
    };
    let widen = |a: (f64, f64), b: (f64, f64)| (a.0.min(b.0), a.1.max(b.1));
    let (shortest, longest) =
        (0..mesh.triangles.len()).into_par_iter().filter_map(squares).reduce_with(widen)?;
    Some((shortest.sqrt(), longest.sqrt()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use umbrage_geom::{MeshObject, glam::Affine3A, glam::Vec3};
    use umbrage_scene::{Camera, Instance, Material, NamedMesh, Settings};

    fn cube() -> TriangleMesh {
        let positions = (0..8).map(|i| [i & 1, i >> 1 & 1, i >> 2].map(|b| b as f32)).collect();
        let quads = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
        let triangles = quads.iter().flat_map(|q| [[q[0], q[1], q[2]], [q[0], q[2], q[3]]]).collect();
        TriangleMesh::new(positions, triangles).unwrap()
    }

    #[test]
    fn a_cube_is_closed_even_when_split_into_single_triangles() {
        let report = inspect_mesh(&cube());
        assert_eq!((report.vertices, report.triangles, report.edges.edges), (8, 12, 18));
        assert!(report.closed && report.objects[0].closed);
        assert_eq!((report.duplicate_vertices, report.unused_vertices), (0, 0));
        assert_eq!(report.shortest_edge, Some(1.0));
        assert_eq!(report.longest_edge, Some(2f64.sqrt()));
        assert_eq!(report.bounds, BoundsReport { min: [0.0; 3], max: [1.0; 3], diagonal: 3f64.sqrt() });

        let cube = cube();
        let mut soup: Vec<[f32; 3]> = (0..12).flat_map(|t| cube.triangle(t)).collect();
        soup.iter_mut().flatten().filter(|x| **x == 0.0).step_by(2).for_each(|x| *x = -0.0);
        let triangles = (0..12).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect();
        let report = inspect_mesh(&TriangleMesh::new(soup, triangles).unwrap());
        assert!(report.closed);
        assert_eq!((report.edges.edges, report.duplicate_vertices), (18, 28));
    }

    #[test]
    fn faults_are_counted() {
        let mut mesh = cube();
        mesh.triangles.swap_remove(0);
        let open = inspect_mesh(&mesh).edges;
        assert_eq!(open, EdgeReport { edges: 18, boundary: 3, non_manifold: 0, inconsistent: 0 });

        let mut mesh = cube();
        mesh.triangles[5].swap(0, 1);
        let turned = inspect_mesh(&mesh).edges;
        assert_eq!(turned, EdgeReport { edges: 18, boundary: 0, non_manifold: 0, inconsistent: 3 });

        // A rotated and a reversed copy of triangle 3, one without area, and two vertices that nothing uses.
        let mut mesh = cube();
        let [a, b, c] = mesh.triangles[3];
        mesh.triangles.extend([[b, c, a], [c, b, a], [a, a, b]]);
        mesh.positions.extend([[0.0; 3], [9.0; 3]]);
        let report = inspect_mesh(&mesh);
        assert_eq!(
            (report.duplicate_triangles, &report.duplicate_examples[..]),
            (2, &[[3, 12], [3, 13]][..])
        );
        assert_eq!((report.degenerate_triangles, &report.degenerate_examples[..]), (1, &[14][..]));
        assert_eq!((report.unused_vertices, report.duplicate_vertices), (2, 1));
        assert_eq!(report.edges, EdgeReport { edges: 18, boundary: 0, non_manifold: 3, inconsistent: 0 });
        assert_eq!(report.bounds.max, [1.0; 3]);
        assert!(!report.closed);
    }

    #[test]
    fn self_intersections_are_named_by_triangles_of_the_mesh() {
        let mut mesh = cube();
        let mut other = cube();
        other.positions.iter_mut().flatten().for_each(|x| *x += 0.5);
        mesh.append(&other);
        let part = |name: &str, triangles| MeshObject { name: name.into(), triangles, opacity: 1.0 };
        mesh.objects = vec![part("one", 0..12), part("two", 12..24)];
        assert!(inspect_mesh(&mesh).objects.iter().all(|o| o.solid.well_behaved));
        mesh.objects = vec![part("none", 0..0), part("both", 0..24)];
        let both = &inspect_mesh(&mesh).objects[1].solid;
        assert!(both.encloses && !both.well_behaved && both.self_intersections > 0);
        assert!(both.intersection_examples.iter().all(|&[a, b]| a < 12 && (12..24).contains(&b)));
        assert!(inspect_mesh(&mesh).to_string().contains("encloses space, but cuts itself"));
    }

    #[test]
    fn only_degenerate_triangles_have_no_edges() {
        let mesh = TriangleMesh::new(vec![[1.0; 3]], vec![[0, 0, 0]]).unwrap();
        let report = inspect_mesh(&mesh);
        assert_eq!((report.shortest_edge, report.edges, report.closed), (None, EdgeReport::default(), false));
        assert!(!report.to_string().contains("long"));
    }

    #[test]
    fn objects_are_judged_alone() {
        let mut mesh = cube();
        mesh.append(&cube());
        mesh.triangles[23] = [8, 8, 9];
        let part = |name: &str, triangles| MeshObject { name: name.into(), triangles, opacity: 0.5 };
        mesh.objects = vec![part("whole", 0..12), part("half", 12..24), part("none", 24..24)];
        let objects = inspect_mesh(&mesh).objects;
        assert_eq!(objects.iter().map(|o| o.closed).collect::<Vec<_>>(), [true, false, false]);
        assert_eq!(objects.iter().map(|o| o.degenerate_triangles).collect::<Vec<_>>(), [0, 1, 0]);
        assert_eq!(objects[2].bounds, BoundsReport::default());
        let solid = |o: &ObjectReport| (o.solid.well_behaved, o.solid.encloses, o.solid.components);
        assert_eq!(
            objects.iter().map(solid).collect::<Vec<_>>(),
            [(true, true, 1), (false, false, 1), (false, false, 0)]
        );
        assert_eq!(objects[1].solid.boundary_examples.len(), objects[1].edges.boundary.min(8) as usize);
        assert!(inspect_mesh(&mesh).to_string().contains("\n  half: 12 triangles, opacity 0.5, not closed"));
    }

    #[test]
    fn scenes_count_meshes_once_and_instances_each() {
        let instance = |name: &str, world_from_object| Instance {
            name: name.into(),
            mesh: 0,
            world_from_object,
            materials: vec![0],
        };
        let camera = Camera {
            position: [0.0; 3],
            target: [1.0; 3],
            up: [0.0, 1.0, 0.0],
            fov: 40.0,
            lens_radius: 0.0,
            focus_distance: None,
        };
        let point = Light::Point { position: [0.0; 3], intensity: [1.0; 3] };
        let scene = Scene {
            camera,
            meshes: vec![NamedMesh::new("cube", cube())],
            instances: vec![
                instance("here", Affine3A::IDENTITY),
                instance("there", Affine3A::from_translation(Vec3::splat(4.0))),
                instance("mirrored", Affine3A::from_scale(Vec3::new(-2.0, 1.0, 1.0))),
            ],
            materials: vec![Material { name: "clay".into(), albedo: [0.5; 3], opacity: 1.0 }],
            lights: vec![point],
            ambient: None,
            background: [0.0; 3],
            settings: Settings::default(),
        };
        let report = inspect_scene(&scene);
        assert_eq!((report.triangles, report.instanced_triangles, report.lights.point), (12, 36, 1));
        assert_eq!((report.bounds.min, report.bounds.max), ([-2.0, 0.0, 0.0], [5.0; 3]));
        assert_eq!(report.instances.iter().map(|i| i.mirrored).collect::<Vec<_>>(), [false, false, true]);
        let text = report.to_string();
        assert!(text.contains("12 stored, 36 with instances") && text.contains("materials clay"), "{text}");
        let json = serde_json::to_value(&report).unwrap();
        assert_eq!(json["meshes"][0]["closed"], true);
        assert_eq!(json["instances"][1]["bounds"]["min"][0], 4.0);
    }

    #[test]
    fn json_keys_are_stable() {
        let json = serde_json::to_string(&inspect_mesh(&cube())).unwrap();
        let expected = concat!(
            r#"{"vertices":8,"triangles":12,"bounds":{"min":[0.0,0.0,0.0],"max":[1.0,1.0,1.0],"diagonal":1.7320508075688772},"#,
            r#""bytes":240,"normals":false,"uvs":false,"degenerate_triangles":0,"degenerate_examples":[],"#,
            r#""duplicate_triangles":0,"duplicate_examples":[],"unused_vertices":0,"duplicate_vertices":0,"#,
            r#""shortest_edge":1.0,"longest_edge":1.4142135623730951,"#,
            r#""edges":{"edges":18,"boundary":0,"non_manifold":0,"inconsistent":0},"closed":true,"objects":["#
        );
        assert!(json.starts_with(expected), "{json}");
    }
}
