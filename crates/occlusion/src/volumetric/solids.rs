//! Which objects are solid: occluder generators (Djeu11, section 4.2), with caps over their holes.

use super::ObjectMesh;
use crate::OcclusionError;
use std::ops::Range;
use umbrage_accel::KdTree;
use umbrage_geom::{
    Aabb, Ray,
    audit::{self, Orientation},
    crosses_triangle,
    glam::{DVec3, Vec3},
};

/// Which objects may become generators.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct SolidOptions {
    /// Most holes of an object that are capped; 0 takes closed objects only.
    pub max_holes: u32,
    /// Most surface area of the boxes around an object's caps, relative to the object's own box.
    pub max_guard_area: f32,
}

impl Default for SolidOptions {
    fn default() -> Self {
        Self { max_holes: 8, max_guard_area: 0.3 }
    }
}

impl SolidOptions {
    /// With another [`Self::max_holes`].
    #[must_use]
    pub fn with_max_holes(self, max_holes: u32) -> Self {
        Self { max_holes, ..self }
    }

    /// With another [`Self::max_guard_area`].
    #[must_use]
    pub fn with_max_guard_area(self, max_guard_area: f32) -> Self {
        Self { max_guard_area, ..self }
    }

    pub(super) fn validate(&self) -> Result<(), OcclusionError> {
        let (value, most) = (f64::from(self.max_guard_area), f64::MAX);
        if (0.0..=most).contains(&value) {
            Ok(())
        } else {
            Err(OcclusionError::Setting { what: "max_guard_area", value, least: 0.0, most })
        }
    }
}

/// An object that encloses space.
#[derive(Clone, Debug, PartialEq)]
pub struct Solid {
    /// Index of the object.
    pub object: u32,
    /// Box around its turned triangles.
    pub bounds: Aabb,
    /// How many there are.
    pub triangles: u32,
    /// Holes that were capped.
    pub holes: u32,
    /// Its triangles, turned or not.
    range: Range<u32>,
    /// Its caps among all.
    caps: Range<usize>,
}

/// The generators of a mesh as one closed surface.
#[derive(Clone, Debug, Default)]
pub struct Solids {
    turns: Vec<i8>,
    caps: Vec<[[f32; 3]; 3]>,
    guards: Vec<Aabb>,
    all: Vec<Solid>,
}

/// Direction of test rays. Any will do: crossings are counted exactly ([`umbrage_geom::crosses_triangle`]), so that
/// Djeu11, section 3.3's second ray after an edge-on hit isn't needed.
const TEST_DIRECTION: Vec3 = Vec3::new(0.537_7, 0.833_9, -0.125_9);

impl Solids {
    /// Finds the generators among the objects of `mesh`.
    ///
    /// An object generates if its edges balance once its triangles are turned ([`audit::orient`]), or if caps over a few
    /// small holes make them.
    ///
    /// # Errors
    /// Those of [`ObjectMesh::validate`]; [`OcclusionError::Setting`].
    pub fn find(mesh: &ObjectMesh<'_>, options: &SolidOptions) -> Result<Self, OcclusionError> {
        mesh.validate()?;
        options.validate()?;
        let &ObjectMesh { positions, triangles, .. } = mesh;
        let mut solids = Self { turns: vec![0; triangles.len()], ..Self::default() };
        let objects = mesh.objects_or_whole();
        let welded = audit::weld(positions);
        for (index, object) in objects.iter().enumerate().filter(|(_, object)| object.opaque) {
            let range = object.triangles.start as usize..object.triangles.end as usize;
            let own = &triangles[range.clone()];
            let orientation = audit::orient(positions, own, &welded)?;
            let turned =
                || own.iter().zip(&orientation.turns).filter(|(_, turn)| **turn != 0).map(|(t, _)| t);
            let corners = turned().flatten().map(|&v| positions[v as usize]);
            let bounds = corners.fold(Aabb::EMPTY, Aabb::with_point);
            let volume: f64 = turned_volume(positions, own, &orientation, &bounds);
            let Some(caps) = Caps::over(positions, &orientation.open, options, &bounds) else { continue };
            // Flat and degenerate objects enclose nothing.
            if bounds.is_empty() || volume <= 0.0 {
                continue;
            }
            let first = solids.caps.len();
            solids.all.push(Solid {
                object: index as u32,
                bounds,
                triangles: turned().count() as u32,
                holes: caps.guards.len() as u32,
                range: object.triangles.clone(),
                caps: first..first + caps.triangles.len(),
            });
            solids.turns[range].copy_from_slice(&orientation.turns);
            solids.caps.extend(caps.triangles);
            solids.guards.extend(caps.guards);
        }
        Ok(solids)
    }

    /// The objects that generate.
    pub fn all(&self) -> &[Solid] {
        &self.all
    }

    /// Triangles over holes: they block nothing, but no cell that is used may touch one.
    pub fn caps(&self) -> &[[[f32; 3]; 3]] {
        &self.caps
    }

    /// A box around the caps of each hole. What cells say holds for segments that meet none of them.
    pub fn guards(&self) -> &[Aabb] {
        &self.guards
    }

    /// Turn of a triangle in the surface, see [`Orientation::turns`].
    pub fn turn(&self, prim: u32) -> i32 {
        self.turns[prim as usize].into()
    }

    /// How many triangles the mesh has.
    pub(super) fn triangle_count(&self) -> usize {
        self.turns.len()
    }

    /// The closed surface of one generator.
    pub(crate) fn surface<'a>(
        &'a self,
        generator: usize,
        positions: &'a [[f32; 3]],
        triangles: &'a [[u32; 3]],
    ) -> Surface<'a> {
        let Solid { range, caps, .. } = &self.all[generator];
        let range = range.start as usize..range.end as usize;
        let first: u32 = self.all[..generator].iter().map(|g| g.holes).sum();
        let guards = first as usize..(first + self.all[generator].holes) as usize;
        Surface {
            positions,
            triangles: &triangles[range.clone()],
            turns: &self.turns[range],
            caps: &self.caps[caps.clone()],
            guards: &self.guards[guards],
        }
    }

    /// Whether a point of the closed `region` may be inside of anything.
    pub fn may_enclose(&self, region: &Aabb) -> bool {
        self.all.iter().any(|g| g.bounds.min.cmple(region.max).all() && region.min.cmple(g.bounds.max).all())
    }

    /// Winding number of the surface around `point`, exact; `tree` holds the mesh.
    pub fn winding_number(&self, tree: &KdTree, point: Vec3) -> i32 {
        let ray = Ray::new(point, TEST_DIRECTION);
        let caps = self.caps.iter().filter_map(|&cap| crosses_triangle(&ray, cap)).map(|c| c.winding());
        tree.winding_number(&ray, |prim| self.turn(prim)) + caps.sum::<i32>()
    }

    /// [`Self::winding_number`] by a loop over all triangles.
    pub fn winding_number_of(&self, positions: &[[f32; 3]], triangles: &[[u32; 3]], point: Vec3) -> i32 {
        let (turns, caps, guards) = (&self.turns[..], &self.caps[..], &self.guards[..]);
        Surface { positions, triangles, turns, caps, guards }.winding_number(point)
    }
}

/// A closed surface: turned triangles and caps.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Surface<'a> {
    positions: &'a [[f32; 3]],
    triangles: &'a [[u32; 3]],
    turns: &'a [i8],
    caps: &'a [[[f32; 3]; 3]],
    guards: &'a [Aabb],
}

impl<'a> Surface<'a> {
    /// A box around the caps of each hole.
    pub(crate) fn guards(&self) -> &'a [Aabb] {
        self.guards
    }

    /// All triangles that no box may touch: those that are turned, and caps.
    pub(crate) fn triangles(self) -> impl Iterator<Item = [[f32; 3]; 3]> + 'a {
        let turned = self.triangles.iter().zip(self.turns).filter(|(_, turn)| **turn != 0);
        turned.map(move |(t, _)| t.map(|v| self.positions[v as usize])).chain(self.caps.iter().copied())
    }

    /// Winding number around `point` by a loop, exact.
    pub(crate) fn winding_number(&self, point: Vec3) -> i32 {
        let ray = Ray::new(point, TEST_DIRECTION);
        let crossing = |corners| crosses_triangle(&ray, corners).map_or(0, |c| c.winding());
        let turned = self.triangles.iter().zip(self.turns).filter(|(_, turn)| **turn != 0);
        let own = turned.map(|(t, &turn)| i32::from(turn) * crossing(t.map(|v| self.positions[v as usize])));
        own.sum::<i32>() + self.caps.iter().map(|&cap| crossing(cap)).sum::<i32>()
    }
}

/// Six times the signed volume of turned triangles, relative to that of their box; about 0 for flat ones.
fn turned_volume(
    positions: &[[f32; 3]],
    triangles: &[[u32; 3]],
    orientation: &Orientation,
    bounds: &Aabb,
) -> f64 {
    let size = (bounds.max.as_dvec3() - bounds.min.as_dvec3()).max(DVec3::splat(f64::MIN_POSITIVE));
    let origin = bounds.min.as_dvec3();
    let part = |(t, turn): (&[u32; 3], &i8)| {
        let [a, b, c] = t.map(|v| (DVec3::from(positions[v as usize].map(f64::from)) - origin) / size);
        f64::from(*turn) * a.dot(b.cross(c))
    };
    let sum: f64 = triangles.iter().zip(&orientation.turns).filter(|(_, turn)| **turn != 0).map(part).sum();
    // Less than rounding could make of a flat one.
    if sum.abs() < 1e-9 { 0.0 } else { sum.abs() }
}

/// Triangles that close holes.
#[derive(Default)]
struct Caps {
    triangles: Vec<[[f32; 3]; 3]>,
    guards: Vec<Aabb>,
}

impl Caps {
    /// A fan from the middle of each connected set of open edges; `None` if the options don't allow that many or that large
    /// ones.
    fn over(
        positions: &[[f32; 3]],
        open: &[[u32; 2]],
        options: &SolidOptions,
        bounds: &Aabb,
    ) -> Option<Self> {
        let mut caps = Self::default();
        if open.is_empty() {
            return Some(caps);
        }
        if options.max_holes == 0 {
            return None;
        }
        // Edges of one hole: connected through vertices.
        let mut vertices: Vec<u32> = open.iter().flatten().copied().collect();
        vertices.sort_unstable();
        vertices.dedup();
        let place = |v: u32| vertices.partition_point(|&other| other < v);
        let mut parent: Vec<usize> = (0..vertices.len()).collect();
        fn root(parent: &mut [usize], mut v: usize) -> usize {
            while parent[v] != v {
                parent[v] = parent[parent[v]];
                v = parent[v];
            }
            v
        }
        for &[a, b] in open {
            let (a, b) = (root(&mut parent, place(a)), root(&mut parent, place(b)));
            parent[a.max(b)] = a.min(b);
        }
        let mut holes = vec![(Aabb::EMPTY, DVec3::ZERO, 0u32); vertices.len()];
        for (i, &v) in vertices.iter().enumerate() {
            let hole = &mut holes[root(&mut parent, i)];
            hole.0 = hole.0.with_point(positions[v as usize]);
            hole.1 += DVec3::from(positions[v as usize].map(f64::from));
            hole.2 += 1;
        }
        caps.guards = holes.iter().filter(|hole| hole.2 > 0).map(|hole| hole.0).collect();
        let area: f32 = caps.guards.iter().map(Aabb::area).sum();
        if caps.guards.len() > options.max_holes as usize || area > options.max_guard_area * bounds.area() {
            return None;
        }
        for &[a, b] in open {
            let (aabb, sum, count) = holes[root(&mut parent, place(a))];
            let apex = (sum / f64::from(count)).as_vec3().clamp(aabb.min, aabb.max);
            // The edge once more, the other way.
            caps.triangles.push([positions[b as usize], positions[a as usize], apex.into()]);
        }
        Some(caps)
    }
}
