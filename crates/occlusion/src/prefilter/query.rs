//! From rays with solid angles to what a walk needs of them, several at a time.

use super::{ConeQuery, ConeRay, Directions, published::Blend};
use umbrage_geom::{
    glam::Vec3,
    sampling::{hash, unit},
};

/// Part of a cell that directions are moved by, in all. A whole cell would be bilinear interpolation, which blurs what cells
/// blur already: bamboo under light from above was 1.3 % too bright with it, 0.5 % without, 0.7 % with half a cell.
const JITTER: f32 = 0.25;

/// Up to `N` rays, one a column. Written as loops over columns, so that they become SIMD.
pub(crate) struct Cones<const N: usize> {
    /// A child ends a ray when its squared radius over its squared distance is less than this; 0 for never.
    pub(crate) kappa: [f32; N],
    /// Cell of directions that opacities are looked up in.
    pub(crate) cells: [u32; N],
    direction: [[f32; N]; 3],
}

impl<const N: usize> Cones<N> {
    /// The first `N` of `cones`.
    #[inline(always)]
    pub(crate) fn new(query: &ConeQuery, directions: Directions, cones: &[ConeRay]) -> Self {
        let (mut d, mut angle) = ([[0f32; N]; 3], [0f32; N]);
        let mut bits = [0u32; N];
        for (i, cone) in cones.iter().take(N).enumerate() {
            (d[0][i], d[1][i], d[2][i]) = (cone.ray.direction.x, cone.ray.direction.y, cone.ray.direction.z);
            angle[i] = cone.solid_angle;
            bits[i] = cone.ray.origin.x.to_bits();
        }
        let scale = std::f32::consts::FRAC_1_PI / query.threshold();
        let widest = query.widest * query.widest;
        let random = query.blend == Blend::Random;
        let mut kappa = [0f32; N];
        let jitter = if random { JITTER * directions.cell_size() } else { 0.0 };
        let (mut cells, mut moved) = ([0u32; N], [[0f32; N]; 3]);
        for i in 0..N {
            let seed =
                d[0][i].to_bits() ^ d[1][i].to_bits().rotate_left(11) ^ d[2][i].to_bits().rotate_left(22);
            let bits = hash(seed ^ bits[i]);
            // 2^(2u - 1) to within 4 %.
            let u = unit(bits);
            let spread = if random { 0.5 + u * (0.5 + u) } else { 1.0 };
            let wanted = angle[i] * scale * spread;
            // Comparisons are false for NaN.
            let wanted = if wanted > 0.0 { wanted } else { 0.0 };
            kappa[i] = if wanted < widest { wanted } else { widest };
            let part = |shift: u32| ((bits >> shift & 0xff) as f32 * (1.0 / 256.0) - 0.5) * jitter;
            let [x, y, z] = directions.jittered([d[0][i], d[1][i], d[2][i]], part(0), part(8));
            (moved[0][i], moved[1][i], moved[2][i]) = (x, y, z);
        }
        for i in 0..N {
            cells[i] = directions.cell_of([moved[0][i], moved[1][i], moved[2][i]]);
        }
        Self { kappa, cells, direction: d }
    }

    /// Direction of ray `i`, as given.
    #[inline(always)]
    pub(crate) fn direction(&self, i: usize) -> Vec3 {
        Vec3::new(self.direction[0][i], self.direction[1][i], self.direction[2][i])
    }
}
