//! Directions as cells of three cube faces: a direction and its opposite see the same opacity (`[Lacewell08]`, figure 3).

use umbrage_geom::glam::Vec3;

/// Three faces of `n` x `n` cells, the published cube map.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Directions {
    n: u8,
}

impl Directions {
    /// Most cells along an edge of a face.
    pub const MOST: u8 = 12;

    /// `n` x `n` cells a face; `None` unless `1 <= n <= 12`.
    pub fn new(n: u8) -> Option<Self> {
        (1..=Self::MOST).contains(&n).then_some(Self { n })
    }

    /// Number of cells, `3 n^2`.
    pub fn cells(self) -> usize {
        3 * usize::from(self.n) * usize::from(self.n)
    }

    /// Edge of a cell on a face whose edges are 2.
    pub(crate) fn cell_size(self) -> f32 {
        2.0 / f32::from(self.n)
    }

    /// The cell that `direction` (any length but 0) is in.
    pub fn cell(self, direction: Vec3) -> usize {
        self.cell_of(direction.to_array()) as usize
    }

    /// [`Self::cell`] without branches.
    #[inline(always)]
    pub(crate) fn cell_of(self, [x, y, z]: [f32; 3]) -> u32 {
        let (on_x, on_y) = axis(x, y, z);
        let (axis, m, a, b) = if on_x {
            (0, x, y, z)
        } else if on_y {
            (1, y, z, x)
        } else {
            (2, z, x, y)
        };
        let n = f32::from(self.n);
        let half = 0.5 * n / m;
        // NaN becomes the first cell.
        let place = |x: f32| {
            let at = x * half + 0.5 * n;
            let at = if at > 0.0 { at } else { 0.0 };
            (if at < n - 0.5 { at } else { n - 0.5 }) as i32 as u32
        };
        (axis * u32::from(self.n) + place(a)) * u32::from(self.n) + place(b)
    }

    /// Unit vector at (`u`, `v`) of a cell, its corners being 0 and 1.
    pub fn at(self, cell: usize, u: f32, v: f32) -> Vec3 {
        let n = usize::from(self.n);
        let (axis, i, j) = (cell / (n * n), cell / n % n, cell % n);
        let place = |k: usize, u: f32| (k as f32 + u) * 2.0 / n as f32 - 1.0;
        let mut d = [0.0; 3];
        d[axis % 3] = 1.0;
        d[(axis + 1) % 3] = place(i, u);
        d[(axis + 2) % 3] = place(j, v);
        Vec3::from(d).normalize()
    }

    /// Unit vector through the middle of a cell.
    pub fn center(self, cell: usize) -> Vec3 {
        self.at(cell, 0.5, 0.5)
    }

    /// Solid angle of a cell, steradians: the projected area of its centre, so that all add up to about `2 pi`.
    pub(crate) fn weight(self, cell: usize) -> f32 {
        let d = self.center(cell).abs().max_element();
        let side = 2.0 / f32::from(self.n);
        side * side * d * d * d
    }

    /// Cells and weights of the bilinear interpolation at `direction`, over face edges too: the mean over a cell-sized
    /// square around it.
    pub fn bilinear(self, direction: Vec3) -> [(usize, f32); 4] {
        let size = direction.abs();
        let axis = [size.x, size.y, size.z].iter().position(|&s| s == size.max_element()).unwrap_or(0);
        let d = direction / direction[axis];
        let half = 1.0 / f32::from(self.n);
        let (a, b) = ((axis + 1) % 3, (axis + 2) % 3);
        // How far each corner of the square reaches into its cell.
        let split = |x: f32| {
            let place = (x + 1.0) / (2.0 * half) - 0.5;
            let upper = place - place.floor();
            [1.0 - upper, upper]
        };
        let (wa, wb) = (split(d[a]), split(d[b]));
        let mut out = [(0, 0.0); 4];
        for (k, entry) in out.iter_mut().enumerate() {
            let (i, j) = (k / 2, k % 2);
            let mut corner = d;
            corner[a] += if i == 0 { -half } else { half };
            corner[b] += if j == 0 { -half } else { half };
            *entry = (self.cell(corner), wa[i] * wb[j]);
        }
        out
    }

    /// A direction moved by `u`, `v` on its face, whose edges are 2. For random numbers up to half a cell either way the
    /// cell it is in then has the weights of [`Self::bilinear`].
    #[inline(always)]
    pub(crate) fn jittered(self, [x, y, z]: [f32; 3], u: f32, v: f32) -> [f32; 3] {
        let (on_x, on_y) = axis(x, y, z);
        let size = if on_x {
            x.abs()
        } else if on_y {
            y.abs()
        } else {
            z.abs()
        };
        let (u, v) = (u * size, v * size);
        let (dx, dy, dz) = if on_x {
            (0.0, u, v)
        } else if on_y {
            (v, 0.0, u)
        } else {
            (u, v, 0.0)
        };
        [x + dx, y + dy, z + dz]
    }
}

/// Whether x, and whether y, is the face that a direction meets.
#[inline(always)]
fn axis(x: f32, y: f32, z: f32) -> (bool, bool) {
    let (x, y, z) = (x.abs(), y.abs(), z.abs());
    ((x >= y) & (x >= z), y >= z)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_cell_holds_its_directions(n in 1u8..=12, cell in 0usize..432, u in 0.01f32..0.99, v in 0.01f32..0.99) {
            let directions = Directions::new(n).unwrap();
            let cell = cell % directions.cells();
            let d = directions.at(cell, u, v);
            prop_assert_eq!(directions.cell(d), cell);
            prop_assert_eq!(directions.cell(d * -3.0), cell);
        }

        #[test]
        fn bilinear_weights_add_up(n in 1u8..=12, d in [-1f32..1.0, -1f32..1.0, -1f32..1.0]) {
            prop_assume!(Vec3::from(d).length() > 0.1);
            let directions = Directions::new(n).unwrap();
            let corners = directions.bilinear(d.into());
            let sum: f32 = corners.iter().map(|c| c.1).sum();
            prop_assert!((sum - 1.0).abs() < 1e-5);
            prop_assert!(corners.iter().all(|c| c.0 < directions.cells() && c.1 >= -1e-6));
        }
    }

    #[test]
    fn weights_cover_half_the_sphere() {
        for n in [3, 12] {
            let directions = Directions::new(n).unwrap();
            let sum: f32 = (0..directions.cells()).map(|c| directions.weight(c)).sum();
            assert!((sum / std::f32::consts::TAU - 1.0).abs() < 0.06, "{n}: {sum}");
        }
        assert_eq!(Directions::new(0), None);
        assert_eq!(Directions::new(13), None);
    }
}
