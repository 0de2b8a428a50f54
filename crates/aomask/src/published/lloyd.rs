//! Points of a disc by Lloyd relaxation (`[Laine10]`, section 6).
//!
//! Cells are exact polygons in `f64`: half planes against neighbours from a grid, and tangents of the circle. Only
//! operations that IEEE 754 rounds one way, so the points are the same on every machine.

use umbrage_geom::{
    glam::DVec2,
    sampling::{RandomStream, concentric_disc, sobol_2d},
};

/// Steps that make random points semi-regular.
const RELAX: usize = 12;
/// Steps after each point has moved at random inside its cell.
const RELAX_AGAIN: usize = 3;
/// How far outside the unit circle corners of a cell may lie: tangents 5 degrees apart.
const ROUND: f64 = 1e-3;

/// `n` points of the unit disc: uniform in density, locally irregular.
///
/// # Source
/// `[Laine10]`, section 6: random points, Lloyd relaxation, a random point of each Voronoi cell, a few more steps. Departure:
/// the first points are scrambled Sobol points. Differences in density over long distances, which independent points have,
/// take about as many steps to relax as there are points; from Sobol points a few steps are enough.
pub(crate) fn disc_points(n: usize, seed: u32) -> Vec<DVec2> {
    let square = |i: usize| sobol_2d(i as u32, 0, seed);
    let mut points: Vec<DVec2> = (0..n).map(|i| concentric_disc(square(i)).as_dvec2()).collect();
    let mut cells = Cells::new(n);
    for _ in 0..RELAX {
        cells.step(&mut points, centroid);
    }
    let mut random = RandomStream::new(seed, n as u32);
    cells.step(&mut points, |cell| random_point(cell, &mut random));
    for _ in 0..RELAX_AGAIN {
        cells.step(&mut points, centroid);
    }
    points
}

/// Points sorted into squares, and room for one cell.
struct Cells {
    /// Squares across.
    side: usize,
    /// Where each square's run in `sorted` ends.
    ends: Vec<usize>,
    /// Points square by square.
    sorted: Vec<DVec2>,
    cell: Vec<DVec2>,
    clipped: Vec<DVec2>,
}

impl Cells {
    fn new(n: usize) -> Self {
        // One point a square on average; the disc fills pi / 4 of the grid.
        let side = ((n as f64).sqrt() as usize).max(1);
        Self { side, ends: vec![0; side * side], sorted: Vec::new(), cell: Vec::new(), clipped: Vec::new() }
    }

    fn square(&self, p: DVec2) -> [usize; 2] {
        p.to_array()
            .map(|x| ((x * 0.5 + 0.5) * self.side as f64).max(0.0) as usize)
            .map(|i| i.min(self.side - 1))
    }

    /// Replaces every point by `choose` of its cell.
    fn step(&mut self, points: &mut [DVec2], mut choose: impl FnMut(&[DVec2]) -> DVec2) {
        self.sort(points);
        for point in points {
            self.build(*point);
            *point = choose(&self.cell);
        }
    }

    fn sort(&mut self, points: &[DVec2]) {
        self.ends.fill(0);
        let index = |cells: &Self, p: DVec2| {
            let [x, y] = cells.square(p);
            y * cells.side + x
        };
        for &p in points {
            let at = index(self, p);
            self.ends[at] += 1;
        }
        let mut sum = 0;
        for end in &mut self.ends {
            (*end, sum) = (sum, sum + *end);
        }
        self.sorted.resize(points.len(), DVec2::ZERO);
        for &p in points {
            let at = index(self, p);
            self.sorted[self.ends[at]] = p;
            self.ends[at] += 1;
        }
    }

    /// The Voronoi cell of `site` inside the disc, counter-clockwise, into `self.cell`.
    fn build(&mut self, site: DVec2) {
        self.cell.clear();
        self.cell.extend([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)].map(|(x, y)| DVec2::new(x, y)));
        let [x, y] = self.square(site).map(|i| i as isize);
        let (side, width) = (self.side as isize, 2.0 / self.side as f64);
        for ring in 0..side {
            // Squares of this ring are at least `ring - 1` widths away; a neighbour cuts only if it is nearer than twice
            // the farthest corner.
            let reach = self.cell.iter().fold(0.0, |far: f64, &c| far.max(c.distance_squared(site)));
            let distance = (ring - 1).max(0) as f64 * width;
            if distance * distance > 4.0 * reach {
                break;
            }
            for row in (y - ring).max(0)..=(y + ring).min(side - 1) {
                let whole = (row - y).abs() == ring;
                let step = if whole || ring == 0 { 1 } else { 2 * ring };
                for column in (x - ring..=x + ring).step_by(step as usize).filter(|c| (0..side).contains(c)) {
                    self.cut_by_square(site, (row * side + column) as usize);
                }
            }
        }
        // Tangents where the cell sticks out of the disc.
        while let Some(&outside) =
            self.cell.iter().find(|c| c.length_squared() > (1.0 + ROUND) * (1.0 + ROUND))
        {
            self.cut(outside / outside.length(), 1.0);
        }
    }

    fn cut_by_square(&mut self, site: DVec2, square: usize) {
        let start = if square == 0 { 0 } else { self.ends[square - 1] };
        for i in start..self.ends[square] {
            let other = self.sorted[i];
            if other != site {
                let normal = other - site;
                self.cut(normal, normal.dot(0.5 * (other + site)));
            }
        }
    }

    /// Keeps what has `normal . x <= offset`.
    fn cut(&mut self, normal: DVec2, offset: f64) {
        if self.cell.iter().all(|c| normal.dot(*c) <= offset) {
            return;
        }
        self.clipped.clear();
        for (i, &a) in self.cell.iter().enumerate() {
            let b = self.cell[(i + 1) % self.cell.len()];
            let (da, db) = (normal.dot(a) - offset, normal.dot(b) - offset);
            if da <= 0.0 {
                self.clipped.push(a);
            }
            if (da < 0.0 && db > 0.0) || (da > 0.0 && db < 0.0) {
                self.clipped.push(a + (b - a) * (da / (da - db)));
            }
        }
        std::mem::swap(&mut self.cell, &mut self.clipped);
    }
}

/// The triangles of a convex polygon around its first corner, with twice their areas.
fn fan(cell: &[DVec2]) -> impl Iterator<Item = ([DVec2; 3], f64)> {
    cell.windows(2).skip(1).map(|edge| {
        let corners = [cell[0], edge[0], edge[1]];
        (corners, (edge[0] - cell[0]).perp_dot(edge[1] - cell[0]))
    })
}

fn centroid(cell: &[DVec2]) -> DVec2 {
    let (sum, area) = fan(cell).fold((DVec2::ZERO, 0.0), |(sum, area), ([a, b, c], part)| {
        (sum + (a + b + c) * (part / 3.0), area + part)
    });
    sum / area
}

fn random_point(cell: &[DVec2], random: &mut RandomStream) -> DVec2 {
    let total: f64 = fan(cell).map(|(_, area)| area).sum();
    let mut left = f64::from(random.next_unit()) * total;
    let (x, y) = (f64::from(random.next_unit()), f64::from(random.next_unit()));
    let (u, v) = if x + y > 1.0 { (1.0 - x, 1.0 - y) } else { (x, y) };
    let mut point = centroid(cell);
    for ([a, b, c], area) in fan(cell) {
        point = a + (b - a) * u + (c - a) * v;
        left -= area;
        if left < 0.0 {
            break;
        }
    }
    point
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_tile_the_disc() {
        let points = disc_points(96, 5);
        let mut cells = Cells::new(96);
        cells.sort(&points);
        let mut area = 0.0;
        for &point in &points {
            cells.build(point);
            assert!(
                cells.cell.iter().all(|&c| points.iter().all(|q| q.distance(c) > point.distance(c) - 1e-9))
            );
            area += 0.5 * fan(&cells.cell).map(|(_, a)| a).sum::<f64>();
        }
        let pi = std::f64::consts::PI;
        assert!(area > pi && area < pi * (1.0 + ROUND), "{area}");
    }

    #[test]
    fn density_is_uniform_and_points_keep_apart() {
        for n in [32, 256, 1024] {
            let points = disc_points(n, 0);
            let spacing = (std::f64::consts::PI / n as f64).sqrt();
            for (i, p) in points.iter().enumerate() {
                assert!(p.length() < 1.0 - 0.2 * spacing, "{n}: {p}");
                let nearest = points[..i].iter().map(|q| q.distance(*p)).fold(f64::MAX, f64::min);
                assert!(nearest > 0.45 * spacing, "{n}: {nearest} of {spacing}");
            }
            // Half planes hold their share of the points.
            for (normal, offset) in [(DVec2::X, 0.0), (DVec2::Y, 0.5), (DVec2::new(0.6, -0.8), -0.3)] {
                let inside = points.iter().filter(|p| p.dot(normal) > offset).count() as f64 / n as f64;
                let exact =
                    (f64::acos(offset) - offset * (1.0 - offset * offset).sqrt()) / std::f64::consts::PI;
                assert!(
                    (inside - exact).abs() < 1.2 * spacing / (n as f64).powf(0.25),
                    "{n}: {inside} {exact}"
                );
            }
        }
    }
}
