//! A growing mesh with named objects, and the shapes many generators share: tubes, leaves, boxes.

use super::random::{rotate, sin_cos};
use std::f32::consts::TAU;
use umbrage_geom::{Frame, MeshObject, TriangleMesh, glam::Vec3};

/// A mesh under construction. Triangles belong to the object begun last.
#[derive(Default)]
pub struct Builder {
    mesh: TriangleMesh,
}

impl Builder {
    /// Room for about that many triangles.
    pub fn with_capacity(triangles: usize) -> Self {
        let mut builder = Self::default();
        builder.mesh.positions.reserve(triangles * 2 / 3);
        builder.mesh.triangles.reserve(triangles + triangles / 64);
        builder
    }

    /// Begins a new object.
    pub fn begin(&mut self, name: &str) {
        let at = self.count() as u32;
        if let Some(last) = self.mesh.objects.last_mut() {
            last.triangles.end = at;
        }
        self.mesh.objects.push(MeshObject { name: name.to_owned(), triangles: at..at, opacity: 1.0 });
    }

    /// Triangles so far.
    pub fn count(&self) -> usize {
        self.mesh.triangles.len()
    }

    /// Adds a vertex.
    pub fn vertex(&mut self, position: Vec3) -> u32 {
        self.mesh.positions.push(position.to_array());
        self.mesh.positions.len() as u32 - 1
    }

    /// Adds a triangle of three vertices.
    pub fn triangle(&mut self, a: u32, b: u32, c: u32) {
        self.mesh.triangles.push([a, b, c]);
    }

    /// Adds a quad as two triangles.
    pub fn quad(&mut self, a: u32, b: u32, c: u32, d: u32) {
        self.triangle(a, b, c);
        self.triangle(a, c, d);
    }

    /// Adds a quad with vertices of its own.
    pub fn face(&mut self, corners: [Vec3; 4]) {
        let [a, b, c, d] = corners.map(|p| self.vertex(p));
        self.quad(a, b, c, d);
    }

    /// Adds a closed box with vertices of its own: 12 triangles.
    pub fn cuboid(&mut self, min: Vec3, max: Vec3) {
        self.hexahedron([
            min,
            Vec3::new(max.x, min.y, min.z),
            Vec3::new(max.x, min.y, max.z),
            Vec3::new(min.x, min.y, max.z),
            Vec3::new(min.x, max.y, min.z),
            Vec3::new(max.x, max.y, min.z),
            max,
            Vec3::new(min.x, max.y, max.z),
        ]);
    }

    /// Adds a closed box given by its lower four corners, clockwise seen from above in x-z with z down, and the four
    /// above them: 12 triangles.
    pub fn hexahedron(&mut self, corners: [Vec3; 8]) {
        let v = corners.map(|p| self.vertex(p));
        self.quad(v[0], v[1], v[2], v[3]);
        self.quad(v[7], v[6], v[5], v[4]);
        for i in 0..4 {
            let j = (i + 1) % 4;
            self.quad(v[i], v[i + 4], v[j + 4], v[j]);
        }
    }

    /// Adds a tube along `points` with a radius at each, open at the start. A last radius of 0 closes the end in a
    /// point; otherwise the end is open too. See [`tube_triangles`] for the count.
    pub fn tube(&mut self, points: &[Vec3], radii: &[f32], sides: usize) {
        let n = points.len();
        let tangent =
            |i: usize| (points[(i + 1).min(n - 1)] - points[i.saturating_sub(1)]).normalize_or_zero();
        let first = self.mesh.positions.len() as u32;
        let mut frame = Frame::from_normal(tangent(0));
        let pointed = radii[n - 1] == 0.0;
        let rings = if pointed { n - 1 } else { n };
        for i in 0..rings {
            frame = transport(&frame, tangent(i));
            for k in 0..sides {
                let (s, c) = sin_cos(TAU * k as f32 / sides as f32);
                self.vertex(points[i] + (frame.tangent * c + frame.bitangent * s) * radii[i]);
            }
        }
        for i in 1..rings {
            self.bridge(first + ((i - 1) * sides) as u32, first + (i * sides) as u32, sides);
        }
        if pointed {
            let tip = self.vertex(points[n - 1]);
            let ring = first + ((rings - 1) * sides) as u32;
            for k in 0..sides {
                self.triangle(ring + k as u32, ring + ((k + 1) % sides) as u32, tip);
            }
        }
    }

    /// Joins two rings of `sides` consecutive vertices, counter-clockwise seen from the second.
    pub fn bridge(&mut self, ring: u32, next: u32, sides: usize) {
        for k in 0..sides {
            let (a, b) = (k as u32, ((k + 1) % sides) as u32);
            self.quad(ring + a, ring + b, next + b, next + a);
        }
    }

    /// Adds a surface of revolution around the vertical through `center`: `profile` gives radius and height, upwards,
    /// and is open at both ends.
    pub fn lathe(&mut self, center: Vec3, profile: &[[f32; 2]], sides: usize) {
        let first = self.mesh.positions.len() as u32;
        for &[radius, height] in profile {
            for k in 0..sides {
                // Backwards, as x-z is left-handed seen from above.
                let (s, c) = sin_cos(-TAU * k as f32 / sides as f32);
                self.vertex(center + Vec3::new(radius * c, height, radius * s));
            }
        }
        for i in 1..profile.len() {
            self.bridge(first + ((i - 1) * sides) as u32, first + (i * sides) as u32, sides);
        }
    }

    /// Sweeps a closed cross-section along `path`: at each point the section's x runs along `side(i)` and its y along
    /// `up(i)`. The ends are open unless `closed` joins them.
    pub fn sweep(
        &mut self,
        path: &[Vec3],
        axes: impl Fn(usize) -> (Vec3, Vec3),
        section: &[[f32; 2]],
        closed: bool,
    ) {
        let first = self.mesh.positions.len() as u32;
        for (i, &p) in path.iter().enumerate() {
            let (x, y) = axes(i);
            for s in section {
                self.vertex(p + x * s[0] + y * s[1]);
            }
        }
        let sides = section.len();
        for i in 1..path.len() {
            self.bridge(first + ((i - 1) * sides) as u32, first + (i * sides) as u32, sides);
        }
        if closed {
            self.bridge(first + ((path.len() - 1) * sides) as u32, first, sides);
        }
    }

    /// Adds a leaf: see [`Leaf`].
    pub fn leaf(&mut self, leaf: &Leaf) {
        let rows = leaf.rows;
        let side = leaf.direction.cross(leaf.normal).normalize_or_zero();
        let (mut point, mut along, mut normal) = (leaf.base, leaf.direction, leaf.normal);
        let step = leaf.length / rows as f32;
        let first = self.vertex(point);
        for i in 1..rows {
            along = rotate(along, side, -leaf.bend / rows as f32);
            normal = rotate(normal, side, -leaf.bend / rows as f32);
            point += along * step;
            // Widest a little below the middle, pointed at both ends.
            let t = i as f32 / rows as f32;
            let half = leaf.width * 0.5 * (4.0 * t * (1.0 - t)).sqrt() * (1.2 - 0.4 * t);
            let rise = normal * (half * leaf.fold);
            self.vertex(point - side * half + rise);
            if leaf.midrib {
                self.vertex(point);
            }
            self.vertex(point + side * half + rise);
        }
        along = rotate(along, side, -leaf.bend / rows as f32);
        let tip = self.vertex(point + along * step);
        let columns = if leaf.midrib { 2 } else { 1 };
        let row = |i: usize| first + 1 + ((i - 1) * (columns + 1)) as u32;
        for c in 0..columns as u32 {
            self.triangle(first, row(1) + c + 1, row(1) + c);
            for i in 1..rows - 1 {
                self.quad(row(i) + c, row(i) + c + 1, row(i + 1) + c + 1, row(i + 1) + c);
            }
            self.triangle(row(rows - 1) + c, row(rows - 1) + c + 1, tip);
        }
    }

    /// Appends all objects of another mesh.
    pub fn append(&mut self, other: Self) {
        self.begin("");
        self.mesh.objects.pop();
        let base = self.mesh.positions.len() as u32;
        let at = self.count() as u32;
        let other = other.finish();
        self.mesh.objects.extend(
            other
                .objects
                .into_iter()
                .map(|o| MeshObject { triangles: o.triangles.start + at..o.triangles.end + at, ..o }),
        );
        self.mesh.positions.extend_from_slice(&other.positions);
        self.mesh.triangles.extend(other.triangles.iter().map(|t| t.map(|v| v + base)));
    }

    /// The finished mesh.
    pub fn finish(mut self) -> TriangleMesh {
        if let Some(last) = self.mesh.objects.last_mut() {
            last.triangles.end = self.mesh.triangles.len() as u32;
        }
        self.mesh.objects.retain(|o| !o.triangles.is_empty());
        self.mesh
    }
}

/// What `build` makes of the degree of detail that comes near `triangles` triangles.
///
/// The search starts at `detail` and assumes that the count grows as its power `exponent`; it ends within 3 % or after a
/// dozen trials, with the best one.
pub fn fit(triangles: usize, detail: f64, exponent: f64, build: impl Fn(f64) -> Builder) -> Builder {
    let target = triangles as f64;
    let (mut low, mut high) = (None, None);
    let mut detail = detail;
    let mut best: Option<(f64, Builder)> = None;
    for _ in 0..12 {
        let built = build(detail);
        let ratio = built.count().max(1) as f64 / target;
        let error = (ratio - 1.0).abs();
        if best.as_ref().is_none_or(|(least, _)| error < *least) {
            best = Some((error, built));
        }
        if error < 0.03 {
            break;
        }
        if ratio < 1.0 {
            low = Some(detail)
        } else {
            high = Some(detail)
        }
        detail *= libm::pow(ratio, -1.0 / exponent).clamp(0.25, 4.0);
        if let (Some(low), Some(high)) = (low, high)
            && !(low < detail && detail < high)
        {
            detail = (low * high).sqrt();
        }
    }
    best.expect("at least one trial").1
}

/// Triangles of [`Builder::tube`] with that many points.
pub fn tube_triangles(points: usize, sides: usize, pointed: bool) -> usize {
    if pointed { (points - 2) * sides * 2 + sides } else { (points - 1) * sides * 2 }
}

/// `frame` with its normal turned to the unit vector `normal`, without twist.
pub fn transport(frame: &Frame, normal: Vec3) -> Frame {
    let tangent = (frame.tangent - normal * frame.tangent.dot(normal)).normalize_or_zero();
    if tangent == Vec3::ZERO {
        return Frame::from_normal(normal);
    }
    Frame { tangent, bitangent: normal.cross(tangent), normal }
}

/// A pointed leaf that may bend along its length and fold along its midrib.
pub struct Leaf {
    /// Where it is attached.
    pub base: Vec3,
    /// Unit vector towards the tip, at the base.
    pub direction: Vec3,
    /// Unit vector out of the upper side, at the base.
    pub normal: Vec3,
    /// Length along the midrib.
    pub length: f32,
    /// Greatest width.
    pub width: f32,
    /// Rise of the edges above the midrib over half the width.
    pub fold: f32,
    /// Angle between the directions at base and tip, radians, towards the lower side.
    pub bend: f32,
    /// Rows of triangles, at least 2.
    pub rows: usize,
    /// Whether there are vertices along the midrib.
    pub midrib: bool,
}

/// Triangles of a leaf.
pub fn leaf_triangles(rows: usize, midrib: bool) -> usize {
    (2 * rows - 2) * if midrib { 2 } else { 1 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_are_as_planned_and_boxes_face_outwards() {
        let points = [Vec3::ZERO, Vec3::Y, Vec3::new(0.3, 2.0, 0.0), Vec3::new(1.0, 3.0, 0.0)];
        for (last, pointed) in [(0.0, true), (0.2, false)] {
            let mut b = Builder::default();
            b.tube(&points, &[0.4, 0.3, 0.2, last], 5);
            assert_eq!(b.count(), tube_triangles(4, 5, pointed));
        }
        for (rows, midrib) in [(2, true), (3, true), (3, false), (5, false)] {
            let mut b = Builder::default();
            b.leaf(&Leaf {
                base: Vec3::ZERO,
                direction: Vec3::X,
                normal: Vec3::Y,
                length: 1.0,
                width: 0.4,
                fold: 0.2,
                bend: 0.3,
                rows,
                midrib,
            });
            assert_eq!(b.count(), leaf_triangles(rows, midrib));
            let mesh = b.finish();
            assert!(mesh.degenerate_triangles().is_empty());
            assert!(mesh.smooth_normals().iter().all(|n| n[1] > 0.0), "{rows} {midrib}");
        }
        let mut b = Builder::default();
        b.cuboid(Vec3::ZERO, Vec3::ONE);
        let mesh = b.finish();
        assert!((super::super::tests::volume(&mesh) - 1.0).abs() < 1e-6);
    }

    #[test]
    fn tubes_and_lathes_face_outwards() {
        let mut b = Builder::default();
        b.tube(&[Vec3::ZERO, Vec3::Y, Vec3::Y * 2.0], &[1.0, 1.0, 1.0], 8);
        b.lathe(Vec3::ZERO, &[[1.0, 0.0], [1.0, 2.0]], 8);
        let mesh = b.finish();
        for (n, p) in mesh.smooth_normals().iter().zip(&mesh.positions) {
            assert!(n[0] * p[0] + n[2] * p[2] > 0.5);
        }
    }
}
