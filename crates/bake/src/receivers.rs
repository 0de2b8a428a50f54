//! Points that want to know how open they are.

use super::{BakeError, BakeOptions, NormalSource, lobes};
use umbrage_geom::{
    TriangleMesh,
    glam::{DVec3, Vec3},
    mesh::MAX_COORDINATE,
};

/// Receiver points with the directions they look to.
///
/// A receiver without any direction has nothing to ask and gets `ao` 1: a vertex that no triangle with area uses, or whose
/// normals cancel.
#[derive(Clone, Debug, Default)]
pub struct Receivers {
    pub(super) points: Vec<[f32; 3]>,
    /// Largest coordinate that took part in computing each point, for the offset of origins.
    pub(super) magnitudes: Vec<f32>,
    /// End of each receiver's run in `lobes`.
    ends: Vec<usize>,
    lobes: Vec<Lobe>,
}

/// One hemisphere of rays.
#[derive(Clone, Copy, Debug)]
pub(super) struct Lobe {
    /// Where rays start, before the offset along `face`.
    pub point: Vec3,
    /// Axis of the hemisphere, unit.
    pub normal: Vec3,
    /// Unit normal of the surface: rays leave to this side of it.
    pub face: Vec3,
    /// Share of the receiver's rays that belong to this lobe or to one before it; 1 at the last.
    share: f32,
}

impl Receivers {
    /// Receivers at `points` (world units) facing along `normals` (any length but 0).
    ///
    /// Rays start above the point by a few units in the last place of its largest coordinate, enough for points that are
    /// rounded from a surface of that size.
    ///
    /// # Errors
    /// [`BakeError::Length`], [`BakeError::Point`], [`BakeError::Normal`], [`BakeError::Count`].
    pub fn from_points(points: &[[f32; 3]], normals: &[[f32; 3]]) -> Result<Self, BakeError> {
        if normals.len() != points.len() {
            return Err(BakeError::Length { what: "normals", actual: normals.len(), expected: points.len() });
        }
        check_count(points.len())?;
        let mut receivers = Self::default();
        for (index, (&point, &normal)) in points.iter().zip(normals).enumerate() {
            if !point.iter().all(|x| x.abs() <= MAX_COORDINATE) {
                return Err(BakeError::Point { index, point });
            }
            let unit = Vec3::from(normal).as_dvec3().try_normalize();
            let unit = unit.ok_or(BakeError::Normal { index, normal })?.as_vec3();
            receivers.push(point, 0.0, Lobe::single(point.into(), unit, unit));
        }
        Ok(receivers)
    }

    /// One receiver for each vertex of `mesh`, in order.
    ///
    /// Rays start above the vertex by a few units in the last place of the largest coordinate of its triangles, so that
    /// rounding never makes these shadow it.
    ///
    /// # Errors
    /// [`BakeError::Mesh`] (index 0), [`BakeError::NoNormals`].
    pub fn vertices(mesh: &TriangleMesh, normals: NormalSource) -> Result<Self, BakeError> {
        mesh.validate().map_err(|source| BakeError::Mesh { index: 0, source })?;
        let mut corners = VertexTriangles::new(mesh);
        let means = vertex_normals(mesh, normals)?;
        let mut receivers = Self::default();
        let mut lobes = Vec::new();
        for (vertex, &point) in mesh.positions.iter().enumerate() {
            let (around, magnitude) = corners.of(vertex);
            lobes.clear();
            match &means {
                Some(means) => {
                    let normal = means[vertex].into();
                    lobes.extend(Lobe::single(point.into(), normal, normal));
                }
                None => split(point.into(), magnitude, around, &mut lobes),
            }
            receivers.push(point, magnitude, lobes.iter().copied());
        }
        Ok(receivers)
    }

    pub(super) fn push(&mut self, point: [f32; 3], magnitude: f32, lobes: impl IntoIterator<Item = Lobe>) {
        self.points.push(point);
        self.magnitudes.push(magnitude);
        self.lobes.extend(lobes);
        self.ends.push(self.lobes.len());
    }

    /// How many receivers there are.
    pub fn len(&self) -> usize {
        self.points.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.points.is_empty()
    }

    /// Where they are, world units.
    pub fn points(&self) -> &[[f32; 3]] {
        &self.points
    }

    /// The receivers of indices `some` as methods of ambient occlusion ask for them. Of one that stands for several normals, a single
    /// one is drawn by their shares; receivers without a direction are left out.
    ///
    /// # Errors
    /// [`BakeError::Mask`] for a point or normal that is not usable.
    ///
    /// # Panics
    /// If an index is not below [`Self::len`].
    pub fn drawn(
        &self,
        some: &[u32],
        options: &BakeOptions,
    ) -> Result<Vec<umbrage_aomask::Receiver>, BakeError> {
        lobes::drawn(self, some, options)
    }

    pub(super) fn lobes(&self, index: usize) -> &[Lobe] {
        let start = if index == 0 { 0 } else { self.ends[index - 1] };
        &self.lobes[start..self.ends[index]]
    }
}

impl Lobe {
    /// All rays around `normal` on the outer side of `face`; none if either is zero.
    pub fn single(point: Vec3, normal: Vec3, face: Vec3) -> Option<Self> {
        (normal != Vec3::ZERO && face != Vec3::ZERO).then_some(Self { point, normal, face, share: 1.0 })
    }

    /// Share of the rays that lobe `index` of a receiver's lobes has.
    pub fn share(lobes: &[Self], index: usize) -> f32 {
        lobes[index].share - if index == 0 { 0.0 } else { lobes[index - 1].share }
    }
}

pub(super) fn check_count(count: usize) -> Result<(), BakeError> {
    let limit = umbrage_geom::mesh::MAX_ELEMENTS;
    if count > limit {
        return Err(BakeError::Count {
            what: "number of receivers",
            value: count as u64,
            limit: limit as u64,
        });
    }
    Ok(())
}

/// Unit normal of triangle `index`, zero if it has no area.
pub(super) fn face_normal(mesh: &TriangleMesh, index: usize) -> DVec3 {
    let [a, b, c] = mesh.triangle(index).map(|p| Vec3::from(p).as_dvec3());
    (b - a).cross(c - a).normalize_or_zero()
}

/// Largest absolute coordinate of triangle `index`.
pub(super) fn magnitude(mesh: &TriangleMesh, index: usize) -> f32 {
    mesh.triangle(index).iter().flatten().fold(0.0, |m, x| m.max(x.abs()))
}

/// Moves `point` of a triangle towards its centroid by a few units in the last place of `magnitude`.
///
/// On an edge a point lies in the plane of the neighbour too, and rays that start in a plane don't hit it: a concave edge
/// would be open. The shift, 4 times the rounding that [`umbrage_geom::offset_origin`] allows for, brings it to its own side.
pub(super) fn inward(point: DVec3, corners: [[f32; 3]; 3], magnitude: f32) -> Vec3 {
    let [a, b, c] = corners.map(|p| Vec3::from(p).as_dvec3());
    let to_centroid = (a + b + c) / 3.0 - point;
    let shift = f64::from(magnitude) * (64.0 * f64::from(f32::EPSILON));
    let length = to_centroid.length();
    let share = if length > 0.0 { (shift / length).min(0.5) } else { 0.0 };
    (point + to_centroid * share).as_vec3()
}

/// Angle at corner `i` of a triangle, radians.
fn angle(p: [DVec3; 3], i: usize) -> f64 {
    let a = (p[(i + 1) % 3] - p[i]).normalize_or_zero();
    let b = (p[(i + 2) % 3] - p[i]).normalize_or_zero();
    a.cross(b).length().atan2(a.dot(b))
}

/// One normal a vertex, or `None` where each triangle keeps its own.
pub(super) fn vertex_normals(
    mesh: &TriangleMesh,
    source: NormalSource,
) -> Result<Option<Vec<[f32; 3]>>, BakeError> {
    match source {
        NormalSource::Geometric => Ok(None),
        NormalSource::Smooth => Ok(Some(mesh.smooth_normals())),
        NormalSource::File if mesh.corner_normals.is_empty() => Err(BakeError::NoNormals),
        NormalSource::File => {
            let mut sums = vec![DVec3::ZERO; mesh.positions.len()];
            for (index, (corners, normals)) in mesh.triangles.iter().zip(&mesh.corner_normals).enumerate() {
                let p = mesh.triangle(index).map(|p| Vec3::from(p).as_dvec3());
                for i in 0..3 {
                    let normal = Vec3::from(normals[i]).as_dvec3().normalize_or_zero();
                    sums[corners[i] as usize] += normal * angle(p, i);
                }
            }
            let smooth = mesh.smooth_normals();
            let normals = sums.into_iter().zip(smooth);
            let choose = |(sum, smooth): (DVec3, [f32; 3])| {
                sum.try_normalize().map_or(smooth, |n| n.as_vec3().to_array())
            };
            Ok(Some(normals.map(choose).collect()))
        }
    }
}

/// Triangles around each vertex.
struct VertexTriangles<'a> {
    mesh: &'a TriangleMesh,
    /// Triangles in order of vertex; `ends[v]` is where those of `v` end.
    triangles: Vec<(u32, u8)>,
    ends: Vec<usize>,
    around: Vec<VertexTriangle>,
}

/// A triangle with area at a vertex.
struct VertexTriangle {
    corners: [[f32; 3]; 3],
    normal: DVec3,
    /// At the vertex, radians.
    angle: f64,
}

impl<'a> VertexTriangles<'a> {
    fn new(mesh: &'a TriangleMesh) -> Self {
        let mut ends = vec![0; mesh.positions.len()];
        mesh.triangles.iter().flatten().for_each(|&v| ends[v as usize] += 1);
        let mut sum = 0;
        for end in &mut ends {
            // Starts for now; filling moves each one to the end of its run.
            (*end, sum) = (sum, sum + *end);
        }
        let mut triangles = vec![(0, 0); sum];
        for (index, corners) in mesh.triangles.iter().enumerate() {
            for (i, &v) in corners.iter().enumerate() {
                triangles[ends[v as usize]] = (index as u32, i as u8);
                ends[v as usize] += 1;
            }
        }
        Self { mesh, triangles, ends, around: Vec::new() }
    }

    /// Triangles with area around `vertex`, and the largest coordinate of all its triangles.
    fn of(&mut self, vertex: usize) -> (&[VertexTriangle], f32) {
        let start = if vertex == 0 { 0 } else { self.ends[vertex - 1] };
        let mut largest = 0f32;
        self.around.clear();
        for &(index, corner) in &self.triangles[start..self.ends[vertex]] {
            let index = index as usize;
            largest = largest.max(magnitude(self.mesh, index));
            let normal = face_normal(self.mesh, index);
            if normal != DVec3::ZERO {
                let corners = self.mesh.triangle(index);
                let angle = angle(corners.map(|p| Vec3::from(p).as_dvec3()), corner.into());
                self.around.push(VertexTriangle { corners, normal, angle });
            }
        }
        (&self.around, largest)
    }
}

/// One lobe for each triangle around a vertex, its share the triangle's angle.
fn split(point: Vec3, magnitude: f32, around: &[VertexTriangle], lobes: &mut Vec<Lobe>) {
    let total: f64 = around.iter().map(|a| a.angle).sum();
    let mut sum = 0.0;
    for triangle in around.iter().filter(|a| a.angle > 0.0) {
        sum += triangle.angle;
        let point = inward(point.as_dvec3(), triangle.corners, magnitude);
        let normal = triangle.normal.as_vec3();
        lobes.push(Lobe { point, normal, face: normal, share: (sum / total) as f32 });
    }
}
