//! The truth: signs of the predicate's determinants in big integers, sharing nothing with the predicate's own arithmetic.
//!
//! Here: hits as the theorem of [`umbrage_geom::triangle`] defines them, winding numbers along generic rays, convexity. Not
//! here: what is compared with them (`check.rs`).

use num_bigint::{BigInt, Sign};
use umbrage_geom::{
    Ray, TriangleMesh,
    glam::{DVec3, Vec3},
};

/// A finite `f32` as `mantissa * 2^exponent`.
fn parts(x: f32) -> (i64, i32) {
    let bits = x.to_bits();
    let (biased, fraction) = ((bits >> 23 & 0xff) as i32, i64::from(bits & 0x7f_ffff));
    let magnitude = if biased == 0 { fraction } else { fraction | 0x80_0000 };
    (if x < 0.0 { -magnitude } else { magnitude }, biased.max(1) - 150)
}

/// Vectors as integers in units of `2^exponent`, which is returned too.
fn integers<const N: usize>(vectors: [[f32; 3]; N]) -> ([[BigInt; 3]; N], i32) {
    let used = vectors.iter().flatten().filter(|&&x| x != 0.0).map(|&x| parts(x).1);
    let unit = used.min().unwrap_or(0);
    let integer = |x: f32| {
        let (mantissa, exponent) = parts(x);
        if mantissa == 0 { BigInt::ZERO } else { BigInt::from(mantissa) << (exponent - unit) as usize }
    };
    (vectors.map(|v| v.map(integer)), unit)
}

fn sub(p: &[BigInt; 3], q: &[BigInt; 3]) -> [BigInt; 3] {
    [&p[0] - &q[0], &p[1] - &q[1], &p[2] - &q[2]]
}

fn det(x: &[BigInt; 3], y: &[BigInt; 3], z: &[BigInt; 3]) -> BigInt {
    &x[0] * (&y[1] * &z[2] - &y[2] * &z[1])
        + &x[1] * (&y[2] * &z[0] - &y[0] * &z[2])
        + &x[2] * (&y[0] * &z[1] - &y[1] * &z[0])
}

fn sign(x: &BigInt) -> i32 {
    match x.sign() {
        Sign::Minus => -1,
        Sign::NoSign => 0,
        Sign::Plus => 1,
    }
}

/// Exact signs for one ray and triangle, in the notation of [`umbrage_geom::triangle`].
struct Signs {
    /// Of `U`, `V`, `W`.
    edges: [i32; 3],
    /// Of `D`.
    side: i32,
    /// Of `T - tnear D` and `T - tfar D`; the latter is that of `-D` for an infinite end.
    ends: [i32; 2],
}

impl Signs {
    fn new(ray: &Ray, [a, b, c]: [[f32; 3]; 3]) -> Self {
        let ([o, a, b, c], unit) = integers([ray.origin.to_array(), a, b, c]);
        let ([d], direction_unit) = integers([ray.direction.to_array()]);
        let [a, b, c] = [sub(&a, &o), sub(&b, &o), sub(&c, &o)];
        let edges = [det(&d, &c, &b), det(&d, &a, &c), det(&d, &b, &a)];
        let total: BigInt = edges.iter().sum();
        let volume = -det(&a, &b, &c);
        let end = |t: f32| {
            if t == f32::INFINITY {
                return -sign(&total);
            }
            // `volume` counts units of 2^(3 unit), `t * total` of 2^(exponent + 2 unit + direction_unit).
            let (mantissa, exponent) = parts(t);
            let moved = BigInt::from(mantissa) * &total;
            let shift = exponent + direction_unit - unit;
            sign(&if shift >= 0 {
                &volume - (moved << shift as usize)
            } else {
                (&volume << -shift as usize) - moved
            })
        };
        Self { ends: [end(ray.tnear), end(ray.tfar)], side: sign(&total), edges: edges.each_ref().map(sign) }
    }

    fn hit(&self) -> bool {
        self.side != 0
            && !self.edges.contains(&-self.side)
            && self.ends[0] == self.side
            && self.ends[1] == -self.side
    }

    /// What the triangle adds to the winding number around the origin; `None` if the ray is not generic to it.
    fn winding(&self) -> Option<i32> {
        let [positive, negative] = [1, -1].map(|s| self.edges.contains(&s));
        if positive && negative {
            return Some(0);
        }
        if self.edges.contains(&0) || self.ends.contains(&0) {
            return None;
        }
        Some(if self.hit() { -self.side } else { 0 })
    }
}

/// Whether the open segment meets the closed triangle.
pub fn hits(ray: &Ray, corners: [[f32; 3]; 3]) -> bool {
    Signs::new(ray, corners).hit()
}

/// Spheres around a mesh's triangles, which spare most exact tests.
pub struct Oracle<'a> {
    pub mesh: &'a TriangleMesh,
    spheres: Vec<(DVec3, f64)>,
}

impl<'a> Oracle<'a> {
    pub fn new(mesh: &'a TriangleMesh) -> Self {
        let sphere = |i| {
            let corners = mesh.triangle(i).map(|p| Vec3::from(p).as_dvec3());
            let center = (corners[0] + corners[1] + corners[2]) / 3.0;
            (center, corners.iter().map(|p| p.distance(center)).fold(0.0, f64::max))
        };
        Self { mesh, spheres: (0..mesh.triangles.len()).map(sphere).collect() }
    }

    /// Triangles that the line of `ray` may meet: those left out are away from it by a million roundings of `f64`.
    pub fn candidates(&self, ray: &Ray) -> impl Iterator<Item = usize> + '_ {
        let (o, d) = (ray.origin.as_dvec3(), ray.direction.as_dvec3());
        let d = d / d.abs().max_element();
        let size = o.abs().max_element();
        self.spheres.iter().enumerate().filter_map(move |(i, &(center, radius))| {
            let slack = 1e-9 * (size + center.abs().max_element() + radius);
            let reach = (radius + slack) * d.length();
            ((center - o).cross(d).length() <= reach * 1.000_001).then_some(i)
        })
    }

    /// Winding number around the ray's origin; `None` if the ray meets an edge, or the origin is on the surface.
    pub fn winding(&self, ray: &Ray) -> Option<i32> {
        let mut sum = 0;
        for i in self.candidates(ray) {
            sum += Signs::new(ray, self.mesh.triangle(i)).winding()?;
        }
        Some(sum)
    }

    /// Whether no vertex lies above any triangle and no triangle is degenerate: a closed mesh is then convex.
    pub fn is_convex(&self) -> bool {
        let mesh = self.mesh;
        (0..mesh.triangles.len()).all(|i| {
            let corners = mesh.triangle(i);
            let [a, b, c] = corners.map(|p| Vec3::from(p).as_dvec3());
            let normal = (b - a).cross(c - a);
            let size = (b - a).abs().max_element() * (c - a).abs().max_element();
            mesh.positions.iter().all(|&p| {
                let offset = Vec3::from(p).as_dvec3() - a;
                let certainly_below = normal.dot(offset) < -1e-13 * size * offset.abs().max_element();
                certainly_below || orientation(corners, p) <= 0
            }) && !umbrage_geom::is_degenerate(corners)
        })
    }
}

/// Sign of the height of `p` above a triangle.
fn orientation([a, b, c]: [[f32; 3]; 3], p: [f32; 3]) -> i32 {
    let ([a, b, c, p], _) = integers([a, b, c, p]);
    sign(&det(&sub(&b, &a), &sub(&c, &a), &sub(&p, &a)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use umbrage_geom::{sampling::RandomStream, segment_hits_triangle};

    #[test]
    fn agrees_with_the_predicate_on_exact_contacts_and_any_scale() {
        let mut random = RandomStream::new(5, 0);
        let mut hit_count = 0;
        for i in 0..4000 {
            let scale = [1.0, 1e-20, 3e11][i % 3];
            let mut point = || [0; 3].map(|_| (random.next_below(7) as f32 - 3.0) * scale);
            let corners = [point(), point(), point()];
            let ray = Ray { tnear: 0.25, tfar: [2.0, f32::INFINITY][i % 2], ..Ray::new(point(), point()) };
            if !ray.is_valid() {
                continue;
            }
            let hit = hits(&ray, corners);
            assert_eq!(hit, segment_hits_triangle(&ray, corners), "{ray:?} {corners:?}");
            hit_count += usize::from(hit);
        }
        assert!(hit_count > 100, "{hit_count}");
    }

    #[test]
    fn winding_and_convexity_of_a_tetrahedron() {
        let positions = vec![[0.0, 0.0, 0.0], [4.0, 0.0, 0.0], [0.0, 4.0, 0.0], [0.0, 0.0, 4.0]];
        let triangles = vec![[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]];
        let mesh = TriangleMesh::new(positions, triangles).unwrap();
        let oracle = Oracle::new(&mesh);
        assert!(oracle.is_convex());
        let winding = |o: [f32; 3], d: [f32; 3]| oracle.winding(&Ray::new(o, d));
        assert_eq!(winding([1.0, 1.0, 1.0], [0.3, 0.5, -0.7]), Some(1));
        assert_eq!(winding([3.0, 3.0, 3.0], [-0.31, -0.5, -0.42]), Some(0));
        assert_eq!(winding([1.0, 1.0, 1.0], [-1.0, -1.0, -1.0]), None, "through a vertex");
        assert_eq!(winding([1.0, 1.0, 0.0], [0.3, 0.5, 0.7]), None, "on the surface");
    }
}
