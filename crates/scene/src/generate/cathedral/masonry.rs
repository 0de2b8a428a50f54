//! Walls with openings, arches, vault webs, ribs and tracery.

use super::super::builder::Builder;
use umbrage_geom::glam::{Vec2, Vec3, vec2};

/// How finely bars and arches are made.
#[derive(Clone, Copy)]
pub struct Fineness {
    /// Segments of an arch from springing to apex.
    pub arc: usize,
    /// Segments of a small circle.
    pub ring: usize,
    /// Whether bars have bevelled edges and lancets are cusped.
    pub rich: bool,
}

/// Height of a pointed arch above its springing at `t` in `[-1, 1]` across it, 1 at the apex.
///
/// Both halves are arcs around the opposite springer (an equilateral arch), scaled to a rise of 1.
pub fn pointed_height(t: f32) -> f32 {
    let reach = 1.0 + t.abs();
    ((4.0 - reach * reach).max(0.0) / 3.0).sqrt()
}

/// A wall's middle plane: points are given across it and up.
pub struct WallFrame {
    origin: Vec3,
    along: Vec3,
    /// Unit vector out of the front.
    pub normal: Vec3,
    thickness: f32,
}

impl WallFrame {
    /// A wall whose foot has its middle at `origin`, with the front towards `normal`.
    pub fn new(origin: Vec3, normal: Vec3, thickness: f32) -> Self {
        Self { origin, along: Vec3::Y.cross(normal), normal, thickness }
    }

    /// The point `p` of the plane, moved out of the front by `out`.
    pub fn point(&self, p: Vec2, out: f32) -> Vec3 {
        self.origin + self.along * p.x + Vec3::Y * p.y + self.normal * out
    }

    /// [`Self::point`] of each.
    pub fn path(&self, points: &[Vec2], out: f32) -> Vec<Vec3> {
        points.iter().map(|&p| self.point(p, out)).collect()
    }
}

/// A closed outline of an opening, counter-clockwise, every point of which is seen from `center`.
pub struct Outline {
    /// Corners; the last joins the first.
    pub points: Vec<Vec2>,
    center: Vec2,
}

impl Outline {
    /// An opening with upright sides from `sill` to `spring` and an equilateral pointed arch above. The arch starts at
    /// the sill if the two are equal.
    pub fn pointed(half: f32, sill: f32, spring: f32, arc: usize) -> Self {
        let mut points = vec![];
        if sill < spring {
            points.push(vec2(half, sill));
        }
        points.extend(arch(half, spring, arc));
        if sill < spring {
            points.push(vec2(-half, sill));
        }
        Self { points, center: vec2(0.0, (sill + spring) / 2.0 + half * 0.5) }
    }

    /// A regular polygon in a circle.
    pub fn circle(center: [f32; 2], radius: f32, sides: usize) -> Self {
        let center = Vec2::from(center);
        Self { points: circle(center, radius, sides), center }
    }
}

/// An equilateral arch over `2 half`, from right to left.
fn arch(half: f32, spring: f32, arc: usize) -> Vec<Vec2> {
    // Equal angles: 60 degrees around the opposite springer.
    let right = (0..=arc).map(|k| {
        let (s, c) = libm::sincosf(std::f32::consts::FRAC_PI_3 * k as f32 / arc as f32);
        vec2((2.0 * c - 1.0) * half, spring + 2.0 * s * half)
    });
    let right: Vec<Vec2> = right.map(|p| vec2(p.x.max(0.0), p.y)).collect();
    let left: Vec<Vec2> = right[..arc].iter().rev().map(|p| vec2(-p.x, p.y)).collect();
    [right, left].concat()
}

fn circle(center: Vec2, radius: f32, sides: usize) -> Vec<Vec2> {
    (0..sides)
        .map(|k| {
            let (s, c) = libm::sincosf(std::f32::consts::TAU * k as f32 / sides as f32);
            center + vec2(c, s) * radius
        })
        .collect()
}

/// A rectangular piece of wall from `low` to `high` with an opening: both faces and the reveal between them.
pub fn wall_with_opening(
    out: &mut Builder,
    frame: &WallFrame,
    low: [f32; 2],
    high: [f32; 2],
    hole: &Outline,
) {
    let (low, high) = (Vec2::from(low), Vec2::from(high));
    let center = hole.center;
    // Rays from the centre through the corners of both outlines cut the wall into quads.
    let mut cuts: Vec<(f32, Vec2, Vec2)> = Vec::new();
    let mut add = |toward: Vec2, on_hole: Vec2, on_wall: Vec2| {
        cuts.push((libm::atan2f(toward.y, toward.x), on_hole, on_wall))
    };
    for &p in &hole.points {
        add(p - center, p, to_rectangle(center, p - center, low, high));
    }
    for corner in [low, vec2(high.x, low.y), high, vec2(low.x, high.y)] {
        if let Some(p) = to_outline(center, corner - center, &hole.points) {
            add(corner - center, p, corner);
        }
    }
    cuts.sort_by(|a, b| a.0.total_cmp(&b.0));
    let half = frame.thickness / 2.0;
    for i in 0..cuts.len() {
        let ((_, h0, w0), (_, h1, w1)) = (cuts[i], cuts[(i + 1) % cuts.len()]);
        let front = [w0, w1, h1, h0];
        polygon(out, front.map(|p| frame.point(p, half)));
        let back = [w1, w0, h0, h1];
        polygon(out, back.map(|p| frame.point(p, -half)));
        // No sill where the opening reaches down to the edge of the wall.
        if h0.y.max(h1.y) > low.y + 1e-4 {
            polygon(
                out,
                [
                    frame.point(h0, -half),
                    frame.point(h0, half),
                    frame.point(h1, half),
                    frame.point(h1, -half),
                ],
            );
        }
    }
}

/// Adds a quad without the sides of no length.
fn polygon(out: &mut Builder, corners: [Vec3; 4]) {
    let kept: Vec<Vec3> =
        (0..4).filter(|&i| corners[i].distance(corners[(i + 1) % 4]) > 1e-4).map(|i| corners[i]).collect();
    if kept.len() < 3 {
        return;
    }
    let v: Vec<u32> = kept.iter().map(|&p| out.vertex(p)).collect();
    (2..v.len()).for_each(|i| out.triangle(v[0], v[i - 1], v[i]));
}

/// Where the ray leaves a rectangle that holds its origin.
fn to_rectangle(origin: Vec2, direction: Vec2, low: Vec2, high: Vec2) -> Vec2 {
    let bound = |o: f32, d: f32, low: f32, high: f32| match d {
        d if d > 1e-9 => (high - o) / d,
        d if d < -1e-9 => (low - o) / d,
        _ => f32::INFINITY,
    };
    let t = [bound(origin.x, direction.x, low.x, high.x), bound(origin.y, direction.y, low.y, high.y)];
    (origin + direction * t[0].min(t[1])).clamp(low, high)
}

/// Where the ray meets a closed outline around its origin.
fn to_outline(origin: Vec2, direction: Vec2, points: &[Vec2]) -> Option<Vec2> {
    (0..points.len()).find_map(|i| {
        let (a, b) = (points[i], points[(i + 1) % points.len()]);
        let edge = b - a;
        let turn = direction.perp_dot(edge);
        if turn.abs() < 1e-9 {
            return None;
        }
        let t = (a - origin).perp_dot(edge) / turn;
        let s = (a - origin).perp_dot(direction) / turn;
        (t > 0.0 && (0.0..=1.0).contains(&s)).then(|| a + edge * s)
    })
}

/// Sweeps a bar along `path`: as wide as twice `half[1]` along `across`, as thick as twice `half[0]`.
pub fn rib(out: &mut Builder, path: &[Vec3], across: Vec3, half: [f32; 2], closed: bool, rich: bool) {
    let n = path.len();
    let axes = |i: usize| {
        let (before, after) = if closed {
            (path[(i + n - 1) % n], path[(i + 1) % n])
        } else {
            (path[i.saturating_sub(1)], path[(i + 1).min(n - 1)])
        };
        let tangent = (after - before).normalize_or_zero();
        (across.cross(tangent).normalize_or_zero(), across)
    };
    let [a, b] = half;
    if rich {
        let bevelled = [[a, -b * 0.4], [a, b * 0.4], [0.0, b], [-a, b * 0.4], [-a, -b * 0.4], [0.0, -b]];
        out.sweep(path, axes, &bevelled, closed);
    } else {
        out.sweep(path, axes, &[[a, 0.0], [0.0, b], [-a, 0.0], [0.0, -b]], closed);
    }
}

/// The web of a groin vault: two pointed barrels that cross, springing at the height of `center`.
pub fn vault(out: &mut Builder, center: Vec3, reach: [f32; 2], rise: f32, cells: usize) {
    let at = |i: usize, j: usize| {
        let [u, v] = [i, j].map(|k| 2.0 * k as f32 / cells as f32 - 1.0);
        let height = pointed_height(u).max(pointed_height(v));
        center + Vec3::new(reach[0] * u, rise * height, reach[1] * v)
    };
    let side = cells as u32 + 1;
    let first = out.vertex(at(0, 0));
    (1..(cells + 1) * (cells + 1)).for_each(|k| {
        out.vertex(at(k % (cells + 1), k / (cells + 1)));
    });
    for j in 0..side - 1 {
        for i in 0..side - 1 {
            let a = first + j * side + i;
            let [b, c, d] = [a + 1, a + side + 1, a + side];
            // Seen from below; diagonals run along the groins.
            if (2 * i + 1 < side - 1) == (2 * j + 1 < side - 1) {
                out.quad(a, b, c, d);
            } else {
                out.quad(b, c, d, a);
            }
        }
    }
}

/// Tracery of a pointed window: frame, mullion, two lancets, a circle with a quatrefoil.
///
/// The circle touches the lancets and the arch: for half width 1 its centre is `sqrt(1.25)` above the springing and its
/// radius 1/2.
pub fn tracery(out: &mut Builder, frame: &WallFrame, half: f32, [sill, spring]: [f32; 2], fine: Fineness) {
    let Fineness { arc, ring, rich } = fine;
    let bar = [0.055 * half.max(0.8), 0.1];
    let mut bars = |points: &[Vec2], scale: f32, closed: bool| {
        rib(out, &frame.path(points, 0.0), frame.normal, bar.map(|b| b * scale), closed, rich);
    };
    bars(&Outline::pointed(half, sill, spring, arc).points, 1.4, true);
    bars(&[vec2(0.0, sill), vec2(0.0, spring)], 1.0, false);
    for side in [-0.5, 0.5] {
        let lancet: Vec<Vec2> =
            arch(half * 0.5, spring, arc).iter().map(|p| *p + vec2(side * half, 0.0)).collect();
        bars(&lancet, 1.0, false);
        if rich {
            // A cusped head inside the lancet.
            let center = vec2(side * half, spring + 0.3 * half);
            bars(&circle(center, 0.2 * half, ring), 0.6, true);
        }
    }
    for k in 1..4 {
        // Iron bars that hold the glass.
        let y = sill + (spring - sill) * k as f32 / 4.0;
        bars(&[vec2(-half, y), vec2(half, y)], 0.35, false);
    }
    let eye = vec2(0.0, spring + 1.25f32.sqrt() * half);
    bars(&circle(eye, 0.46 * half, ring + ring / 2), 1.0, true);
    for k in 0..4 {
        let (s, c) = libm::sincosf(std::f32::consts::FRAC_PI_2 * k as f32);
        bars(&circle(eye + vec2(c, s) * (0.2 * half), 0.2 * half, ring), 0.6, true);
    }
}

/// A rose window: hub, spokes, lancet heads and a wreath of circles.
pub fn rose(
    out: &mut Builder,
    frame: &WallFrame,
    center: [f32; 2],
    radius: f32,
    petals: usize,
    fine: Fineness,
) {
    let Fineness { ring, rich, .. } = fine;
    let center = Vec2::from(center);
    let mut bars = |points: &[Vec2], scale: f32, closed: bool| {
        rib(out, &frame.path(points, 0.0), frame.normal, [0.06 * scale, 0.12 * scale], closed, rich);
    };
    for (r, scale) in [(radius, 2.0), (radius * 0.64, 1.0), (radius * 0.2, 1.2)] {
        bars(&circle(center, r, 3 * ring), scale, true);
    }
    let step = std::f32::consts::TAU / petals as f32;
    for k in 0..petals {
        let direction = |angle: f32| {
            let (s, c) = libm::sincosf(angle);
            vec2(c, s)
        };
        let spoke = direction(step * k as f32);
        bars(&[center + spoke * (radius * 0.2), center + spoke * (radius * 0.64)], 0.8, false);
        let between = direction(step * (k as f32 + 0.5));
        bars(&circle(center + between * (radius * 0.815), radius * 0.165, ring), 0.8, true);
        bars(&circle(center + between * (radius * 0.53), radius * 0.1, ring), 0.6, true);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_wall_with_an_opening_has_the_right_area() {
        let mut out = Builder::default();
        let frame = WallFrame::new(Vec3::ZERO, Vec3::Z, 0.5);
        let hole = Outline::pointed(1.0, 1.0, 3.0, 40);
        wall_with_opening(&mut out, &frame, [-2.0, 0.0], [2.0, 6.0], &hole);
        let mesh = out.finish();
        let (mut front, mut back) = (0.0, 0.0);
        for t in 0..mesh.triangles.len() {
            let [a, b, c] = mesh.triangle(t).map(Vec3::from);
            let area = (b - a).cross(c - a).z / 2.0;
            if area > 0.0 { front += area } else { back -= area }
        }
        // An equilateral arch over 2 has the area 4 pi / 3 - sqrt 3.
        let expected = 24.0 - 4.0 - (4.0 * std::f32::consts::PI / 3.0 - 3f32.sqrt());
        assert!(
            (front - expected).abs() < 0.01 && (back - expected).abs() < 0.01,
            "{front} {back} {expected}"
        );
        // With the edges of the wall left out, its inside is closed only by the neighbours; the reveal looks inwards.
        let reveal = mesh.triangles.iter().any(|t| {
            let [a, b, c] = t.map(|v| Vec3::from(mesh.positions[v as usize]));
            (b - a).cross(c - a).normalize().dot(Vec3::Y) > 0.99
        });
        assert!(reveal);
    }

    #[test]
    fn arches_touch_where_they_should() {
        assert_eq!((pointed_height(1.0), pointed_height(0.0)), (0.0, 1.0));
        let points = arch(1.0, 2.0, 6);
        assert_eq!(points.len(), 13);
        let apex = points[6];
        assert!(apex.x.abs() < 1e-6 && (apex.y - 2.0 - 3f32.sqrt()).abs() < 1e-6);
    }
}
