//! Rays that are hard on purpose, each with what must be true of it.

use super::oracle::Oracle;
use umbrage_geom::{
    Ray, TriangleMesh,
    glam::{Vec2, Vec3},
    is_degenerate, offset_origin,
    sampling::{RandomStream, triangle, uniform_sphere},
};

/// A point strictly inside a closed mesh.
#[derive(Clone, Copy)]
pub struct Origin {
    pub point: Vec3,
    /// Winding number around it, not 0.
    pub winding: i32,
    /// The triangle that it was put under.
    beneath: usize,
}

/// A ray and what is known about it.
pub struct Shot {
    pub ray: Ray,
    /// Winding number around its origin, if it starts inside.
    pub winding: Option<i32>,
    /// The triangle that it leaves.
    pub left: Option<usize>,
}

/// What must be true of the rays of an [`Aim`].
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Expect {
    /// They start inside a closed surface: a miss is a leak.
    Hit,
    /// They leave a convex surface: a hit is a self-shadow.
    Miss,
    /// They leave a surface: a hit on the triangle they left is a self-shadow.
    MissOwn,
    /// Only the exact answer tells.
    Unknown,
}

/// Where rays go.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Aim {
    /// From inside in all directions.
    Anywhere,
    /// From inside at vertices.
    Vertex,
    /// From inside at points of edges; at midpoints if these are representable.
    Edge,
    /// From inside a hair beside a vertex, into the fan of triangles around it.
    Fan,
    /// From just under a triangle nearly along it.
    Grazing,
    /// From inside along an axis, other components 0 or -0.
    Axis,
    /// From inside at vertices, direction in denormal numbers.
    Denormal,
    /// From the front of a triangle outwards, origin moved by `offset_origin`.
    Leaving,
    /// From exactly on the surface straight away from a point inside; needs a convex lattice mesh.
    Outward,
    /// From exactly on the surface through a point inside; needs a lattice mesh.
    Inward,
    /// Segments between vertices and points around the mesh, in planes of faces, starting and ending on the surface.
    Passing,
}

impl Aim {
    pub fn name(self) -> &'static str {
        match self {
            Self::Anywhere => "anywhere",
            Self::Vertex => "vertex",
            Self::Edge => "edge",
            Self::Fan => "fan",
            Self::Grazing => "grazing",
            Self::Axis => "axis",
            Self::Denormal => "denormal",
            Self::Leaving => "leaving",
            Self::Outward => "outward",
            Self::Inward => "inward",
            Self::Passing => "passing",
        }
    }

    pub fn expect(self, convex: bool) -> Expect {
        match self {
            Self::Leaving if convex => Expect::Miss,
            Self::Leaving => Expect::MissOwn,
            Self::Outward => Expect::Miss,
            Self::Passing => Expect::Unknown,
            _ => Expect::Hit,
        }
    }
}

/// What rays are shot at, and from.
pub struct Target<'a> {
    pub mesh: &'a TriangleMesh,
    /// Whether positions, midpoints of edges and origins are small integers, so that their differences are exact.
    pub lattice: bool,
    pub convex: bool,
    pub origins: Vec<Origin>,
}

impl<'a> Target<'a> {
    /// Finds up to `count` origins inside `oracle`'s mesh; fewer if there is hardly any inside to be found.
    pub fn new(oracle: &Oracle<'a>, lattice: bool, convex: bool, count: usize) -> Self {
        let mesh = oracle.mesh;
        let mut random = RandomStream::new(17, 0);
        let mut origins = Vec::new();
        for attempt in 0..30 * count {
            let beneath = random.next_below(mesh.triangles.len() as u32) as usize;
            let corners = mesh.triangle(beneath);
            let point = if attempt % 3 == 0 {
                let bounds = mesh.bounds();
                let unit = Vec3::new(random.next_unit(), random.next_unit(), random.next_unit());
                bounds.min + bounds.size() * unit
            } else {
                let [a, b, c] = corners.map(Vec3::from);
                let depth = (b - a).length() * 10f32.powf(-5.0 * random.next_unit());
                point_on(corners, &mut random) - normal(corners) * depth.max((c - a).length() * 1e-6)
            };
            let point = if lattice { point.round() } else { point };
            let winding = oracle.winding(&Ray::new(point, direction(&mut random)));
            if let Some(winding) = winding.filter(|&w| w != 0) {
                origins.push(Origin { point, winding, beneath });
            }
            if origins.len() == count {
                break;
            }
        }
        Self { mesh, lattice, convex, origins }
    }

    /// The kinds of rays that make sense here.
    pub fn aims(&self) -> Vec<Aim> {
        let mut aims = vec![Aim::Passing];
        if (0..self.mesh.triangles.len()).any(|i| !is_degenerate(self.mesh.triangle(i))) {
            aims.push(Aim::Leaving);
        }
        if !self.origins.is_empty() {
            aims.extend([Aim::Anywhere, Aim::Vertex, Aim::Edge, Aim::Axis, Aim::Denormal]);
            if self.lattice {
                aims.push(Aim::Inward);
                if self.convex {
                    aims.push(Aim::Outward);
                }
            } else {
                aims.extend([Aim::Fan, Aim::Grazing]);
            }
        }
        aims
    }

    fn vertex(&self, random: &mut RandomStream) -> Vec3 {
        self.mesh.positions[random.next_below(self.mesh.positions.len() as u32) as usize].into()
    }

    fn edge_point(&self, random: &mut RandomStream) -> Vec3 {
        let corners = self.mesh.triangle(random.next_below(self.mesh.triangles.len() as u32) as usize);
        let k = random.next_below(3) as usize;
        let (a, b) = (Vec3::from(corners[k]), Vec3::from(corners[(k + 1) % 3]));
        a + (b - a) * if self.lattice { 0.5 } else { random.next_unit() }
    }

    /// A ray of kind `aim`.
    pub fn shoot(&self, aim: Aim, random: &mut RandomStream) -> Shot {
        match aim {
            Aim::Leaving => return self.leaving(random),
            Aim::Passing => return free(self.passing(random)),
            _ => {}
        }
        let origin = self.origins[random.next_below(self.origins.len() as u32) as usize];
        let from = origin.point;
        let on_surface = match random.next_below(2) {
            0 => self.vertex(random),
            _ => self.edge_point(random),
        };
        let direction = match aim {
            Aim::Vertex => self.vertex(random) - from,
            Aim::Edge => self.edge_point(random) - from,
            Aim::Fan => {
                let corners =
                    self.mesh.triangle(random.next_below(self.mesh.triangles.len() as u32) as usize);
                let tip = Vec3::from(corners[0]);
                let hair = 2f32.powi(-8 - random.next_below(16) as i32);
                tip + (point_on(corners, random) - tip) * hair - from
            }
            Aim::Grazing => {
                let [a, b, c] = self.mesh.triangle(origin.beneath).map(Vec3::from);
                [b - a, c - b, a - c, a - from, b - from, c - from][random.next_below(6) as usize]
            }
            Aim::Axis => axis(random),
            Aim::Denormal => denormal(on_surface - from, self.lattice),
            Aim::Outward => return free(Ray::new(on_surface, nonzero(on_surface - from))),
            Aim::Inward => return free(Ray::new(on_surface, nonzero(from - on_surface))),
            Aim::Anywhere | Aim::Leaving | Aim::Passing => direction(random),
        };
        Shot { ray: Ray::new(from, nonzero(direction)), winding: Some(origin.winding), left: None }
    }

    fn passing(&self, random: &mut RandomStream) -> Ray {
        let bounds = self.mesh.bounds();
        let unit = Vec3::new(random.next_unit(), random.next_unit(), random.next_unit());
        let around = bounds.center() + (unit - 0.5) * 2.0 * bounds.size();
        let ends = [self.vertex(random), self.edge_point(random), self.vertex(random), around];
        let (from, to) = (ends[random.next_below(4) as usize], ends[random.next_below(4) as usize]);
        let ray = Ray::new(from, nonzero(to - from));
        match random.next_below(3) {
            0 => ray,
            1 => ray.with_tfar(1.0),
            _ => Ray { tnear: 0.5, ..ray },
        }
    }

    /// From the surface, moved off it, into the hemisphere around the normal, often nearly along the surface.
    fn leaving(&self, random: &mut RandomStream) -> Shot {
        let mut index = random.next_below(self.mesh.triangles.len() as u32) as usize;
        while is_degenerate(self.mesh.triangle(index)) {
            index = (index + 1) % self.mesh.triangles.len();
        }
        let corners = self.mesh.triangle(index);
        let normal = normal(corners);
        let magnitude = corners.as_flattened().iter().fold(0f32, |m, x| m.max(x.abs()));
        let origin = offset_origin(point_on(corners, random), normal, normal, magnitude);
        let lift = 10f32.powf(-7.0 * random.next_unit());
        let mut direction = direction(random);
        direction += normal * (lift - direction.dot(normal));
        // The sign in `f64`, which is that of the numbers given.
        if direction.as_dvec3().dot(normal.as_dvec3()) <= 0.0 {
            direction = normal;
        }
        Shot { ray: Ray::new(origin, direction), winding: None, left: Some(index) }
    }
}

fn free(ray: Ray) -> Shot {
    Shot { ray, winding: None, left: None }
}

fn direction(random: &mut RandomStream) -> Vec3 {
    uniform_sphere(Vec2::new(random.next_unit(), random.next_unit()))
}

fn nonzero(direction: Vec3) -> Vec3 {
    if direction == Vec3::ZERO { Vec3::new(0.3, -0.5, 0.7) } else { direction }
}

/// Along an axis; the other components are zeros of either sign.
fn axis(random: &mut RandomStream) -> Vec3 {
    let mut zero = || if random.next_below(2) == 0 { 0.0 } else { -0.0 };
    let mut direction = [zero(), zero(), zero()];
    direction[random.next_below(3) as usize] = if random.next_below(2) == 0 { 1.0 } else { -1.0 };
    direction.into()
}

/// `direction` in multiples of the least number, exactly if its components are small integers.
fn denormal(direction: Vec3, integer: bool) -> Vec3 {
    let least = f32::from_bits(1);
    let scale = if integer { 1.0 } else { 1000.0 / direction.abs().max_element().max(f32::MIN_POSITIVE) };
    (direction * scale).round() * least
}

/// Unit normal, rounded; zero for a degenerate triangle.
fn normal(corners: [[f32; 3]; 3]) -> Vec3 {
    let [a, b, c] = corners.map(|p| Vec3::from(p).as_dvec3());
    // Scaled first, so that a product of tiny edges can't vanish.
    let size = (b - a).abs().max_element().max((c - a).abs().max_element());
    ((b - a) / size).cross((c - a) / size).normalize_or_zero().as_vec3()
}

fn point_on(corners: [[f32; 3]; 3], random: &mut RandomStream) -> Vec3 {
    let [a, b, c] = corners.map(Vec3::from);
    let uv = triangle(Vec2::new(random.next_unit(), random.next_unit()));
    a + (b - a) * uv.x + (c - a) * uv.y
}
