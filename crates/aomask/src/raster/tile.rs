//! Fragments of a tile: the inverted depth test, the five culling tests and the masks (`[Laine10]`, section 4.2).

use super::{
    camera::RasterCamera,
    outline::Hull,
    shape::{Influence, Shape},
};
use crate::{
    Pattern, Receiver, Sides,
    table::{F8, TriangleTables, Triangles, V8},
};
use umbrage_accel::Counters;
use umbrage_geom::{
    glam::{DVec3, Vec3},
    simd::Job,
};

/// Pixels along each side of a tile.
pub(super) const TILE: usize = 64;

/// Part of the image with its receivers, coordinate by coordinate; rows are padded to whole eights. Pixels without a
/// receiver are not a number.
pub(super) struct Tile {
    pub(super) x: usize,
    pub(super) y: usize,
    pub(super) width: usize,
    pub(super) height: usize,
    stride: usize,
    /// Least depth of a receiver; infinite if there is none.
    pub(super) near: f64,
    points: Rows,
    /// Tangent, bitangent and normal.
    axes: [Rows; 3],
    depths: Vec<f32>,
}

/// Three coordinates of many vectors.
type Rows = [Vec<f32>; 3];

#[inline(always)]
fn load(rows: &Rows, at: usize) -> V8 {
    V8::new(load8(&rows[0], at), load8(&rows[1], at), load8(&rows[2], at))
}

#[inline(always)]
fn load8(row: &[f32], at: usize) -> F8 {
    let mut out = [0.0; 8];
    out.copy_from_slice(&row[at..at + 8]);
    F8(out)
}

impl Tile {
    /// The tile with its upper left pixel at (`x`, `y`), of an image of `size`.
    pub(super) fn new(
        [x, y]: [usize; 2],
        size: [usize; 2],
        receivers: &[Option<Receiver>],
        pattern: &Pattern,
        camera: &RasterCamera,
    ) -> Self {
        let (width, height) = (TILE.min(size[0] - x), TILE.min(size[1] - y));
        let stride = width.next_multiple_of(8);
        let rows = || [0, 1, 2].map(|_| vec![f32::NAN; stride * height]);
        let mut tile = Self {
            x,
            y,
            width,
            height,
            stride,
            near: f64::INFINITY,
            points: rows(),
            axes: [rows(), rows(), rows()],
            depths: vec![f32::NAN; stride * height],
        };
        for row in 0..height {
            for column in 0..width {
                let Some(receiver) = &receivers[(y + row) * size[0] + x + column] else { continue };
                let depth = camera.project(receiver.point().as_dvec3()).depth;
                // Behind the eye nothing is seen.
                if depth <= 0.0 {
                    continue;
                }
                let at = row * stride + column;
                let frame = pattern.frame_of(receiver);
                for axis in 0..3 {
                    tile.points[axis][at] = receiver.point()[axis];
                    for (rows, v) in tile.axes.iter_mut().zip([frame.tangent, frame.bitangent, frame.normal])
                    {
                        rows[axis][at] = v[axis];
                    }
                }
                tile.depths[at] = depth as f32;
                tile.near = tile.near.min(depth);
            }
        }
        tile
    }
}

/// Triangles with one radius of influence.
pub(super) struct Level<'a> {
    pub(super) positions: &'a [[f32; 3]],
    pub(super) triangles: &'a [[u32; 3]],
    /// World units within which the triangles occlude.
    pub(super) reach: f32,
    /// World units that are 1 in the tables.
    pub(super) unit: f32,
    /// Hits nearer than this don't count, world units.
    pub(super) near: f32,
}

impl Level<'_> {
    pub(super) fn corners(&self, triangle: usize) -> [[f32; 3]; 3] {
        self.triangles[triangle].map(|v| self.positions[v as usize])
    }
}

/// What all tiles share.
pub(super) struct Setting<'a, const W: usize> {
    pub(super) camera: RasterCamera,
    pub(super) size: [usize; 2],
    /// How far from the centre of its pixel a receiver may be seen, pixels.
    pub(super) footprint: f64,
    pub(super) sides: Sides,
    /// Culling tests in use, 0 to 5.
    pub(super) tests: usize,
    pub(super) tables: TriangleTables<'a, W>,
}

impl<const W: usize> Setting<'_, W> {
    /// Image coordinates of `u` and `v`, in pixels from the upper left corner.
    pub(super) fn pixels(&self, [u, v]: [f64; 2]) -> [f64; 2] {
        [(u + 1.0) * 0.5 * self.size[0] as f64, (1.0 - v) * 0.5 * self.size[1] as f64]
    }
}

/// Room for setting up triangles.
#[derive(Default)]
pub(super) struct Scratch {
    shape: Shape,
}

/// Draws `triangles` of `level` into the masks of a tile.
pub(super) struct Draw<'a, 's, const W: usize> {
    pub(super) setting: &'a Setting<'s, W>,
    pub(super) tile: &'a Tile,
    pub(super) level: &'a Level<'s>,
    pub(super) triangles: &'a mut dyn Iterator<Item = usize>,
    /// Row by row of `stride` pixels.
    pub(super) masks: &'a mut [[u64; W]],
    pub(super) scratch: &'a mut Scratch,
    pub(super) counters: &'a mut Counters,
}

impl<const W: usize> Job for Draw<'_, '_, W> {
    type Output = ();

    #[inline(always)]
    fn run(mut self) {
        while let Some(triangle) = self.triangles.next() {
            self.draw(self.level.corners(triangle));
        }
    }
}

/// A triangle as fragments need it.
struct Drawn {
    corners: [[f32; 3]; 3],
    center: [f32; 3],
    /// Squared radius of the bounding sphere of the region of influence.
    reach2: f32,
    nearest: f32,
    /// Far planes, at most as many as a prism has faces.
    far: [([f32; 3], f32); 8],
    far_count: usize,
}

impl<const W: usize> Draw<'_, '_, W> {
    #[inline(always)]
    fn draw(&mut self, corners: [[f32; 3]; 3]) {
        let (setting, tile, level) = (self.setting, self.tile, self.level);
        let wide = corners.map(|c| Vec3::from(c).as_dvec3());
        let Some(influence) = Influence::new(wide, level.reach.into(), setting.sides) else { return };
        let shape = &mut self.scratch.shape;
        influence.shape(&setting.camera, 0.5 * tile.near, shape);
        if influence.takes_prism(&setting.camera) {
            self.counters.prisms += 1;
        } else {
            self.counters.billboards += 1;
        }
        for p in &mut shape.outline {
            *p = setting.pixels(*p);
        }
        let hull = Hull::new(&mut shape.outline);
        let reach = influence.bound + f64::from(level.reach);
        let mut drawn = Drawn {
            corners,
            center: influence.center.as_vec3().to_array(),
            reach2: (reach * reach * (1.0 + 1e-5)) as f32,
            nearest: (shape.nearest - shape.nearest.abs() * 1e-6) as f32,
            far: [([0.0; 3], 0.0); 8],
            far_count: shape.far.len().min(8),
        };
        for (to, (normal, offset)) in drawn.far.iter_mut().zip(&shape.far) {
            *to = (normal.as_vec3().to_array(), *offset as f32);
        }
        let margin = setting.footprint;
        let [low, high] = hull.rows();
        let rows = pixel_range(low, high, margin, tile.y, tile.height);
        for row in rows {
            let y = (tile.y + row) as f64 + 0.5;
            let Some([left, right]) = hull.span(y - margin, y + margin) else { continue };
            let columns = pixel_range(left, right, margin, tile.x, tile.width);
            let start = columns.start / 8 * 8;
            for at in (start..columns.end).step_by(8) {
                let mut bits = 0xff;
                if at < columns.start {
                    bits &= 0xff << (columns.start - at);
                }
                if columns.end - at < 8 {
                    bits &= (1 << (columns.end - at)) - 1;
                }
                self.fragments(&drawn, row * tile.stride + at, bits);
            }
        }
    }

    /// Eight pixels from `at`, those in `bits`.
    #[inline(always)]
    fn fragments(&mut self, drawn: &Drawn, at: usize, bits: u32) {
        let (setting, tile, level) = (self.setting, self.tile, self.level);
        let p = load(&tile.points, at);
        // The inverted depth test. Comparisons with pixels without a receiver are false.
        let mut alive = bits & p.x.le(F8::splat(f32::INFINITY));
        for &(normal, offset) in &drawn.far[..drawn.far_count] {
            alive &= V8::splat(normal).dot(p).le(F8::splat(offset));
        }
        if alive == 0 {
            return;
        }
        self.counters.fragments += u64::from(alive.count_ones());
        let from_center = p - V8::splat(drawn.center);
        // 1. Far depth: the receiver is in front of the whole shape.
        let far_depth = F8::splat(drawn.nearest).le(load8(&tile.depths, at));
        // 2. Bounding sphere.
        let sphere = from_center.dot(from_center).le(F8::splat(drawn.reach2));
        let early =
            if setting.tests > 0 { far_depth } else { !0 } & if setting.tests > 1 { sphere } else { !0 };
        if alive & early == 0 {
            self.counters.fragments_after[0] += u64::from((alive & far_depth).count_ones());
            self.counters.fragments_after[1] += u64::from((alive & far_depth & sphere).count_ones());
            return;
        }
        let inverse = F8::splat(1.0 / level.unit);
        let around = |corner: [f32; 3]| (V8::splat(corner) - p).scale(inverse);
        let [a, b, c] = drawn.corners;
        let axes = [load(&tile.axes[0], at), load(&tile.axes[1], at), load(&tile.axes[2], at)];
        let mut triangles = Triangles::new([around(a), around(b), around(c)], axes[2], setting.sides);
        let large = triangles.large & alive;
        for i in (0..8).filter(|i| large >> i & 1 == 1) {
            let wide = |v: [f32; 3]| Vec3::from(v).as_dvec3();
            let around = |v: [f32; 3]| (wide(v) - wide(p.lane(i))) / f64::from(level.unit);
            let corners: [DVec3; 3] = drawn.corners.map(around);
            triangles.redo_large(i, corners, axes[2].lane(i).into(), setting.sides);
        }
        // 3. Facing. 4. Distance of the plane. 5. Hemisphere.
        let tests = [far_depth, sphere, triangles.facing, triangles.close, triangles.above];
        let mut all = alive;
        let mut looked_up = alive;
        for (i, test) in tests.into_iter().enumerate() {
            all &= test;
            self.counters.fragments_after[i] += u64::from(all.count_ones());
            if i < setting.tests {
                looked_up = all;
            }
        }
        self.counters.fragment_masks += u64::from(looked_up.count_ones());
        let turn = |v: V8| V8::new(axes[0].dot(v), axes[1].dot(v), axes[2].dot(v));
        let masks = &mut self.masks[at..at + 8];
        triangles.masks(looked_up, setting.tables, turn, level.near / level.unit, |i, mask| {
            // Without branches: a fragment that a test not in use would have ended costs its whole mask.
            let counts = u64::from(all >> i & 1).wrapping_neg();
            for w in 0..W {
                masks[i][w] |= mask[w] & counts;
            }
        });
    }
}

/// Pixels of `start..start + count`, counted from `start`, whose centre is within `margin` of `[low, high]`.
fn pixel_range(low: f64, high: f64, margin: f64, start: usize, count: usize) -> std::ops::Range<usize> {
    // Casts saturate, and NaN gives 0.
    let first = (low - margin - 0.5 - start as f64).ceil().max(0.0) as usize;
    let end = (high + margin - 0.5 - start as f64).floor() + 1.0;
    let end = (end.max(0.0) as usize).min(count);
    first.min(end)..end
}

impl Tile {
    pub(super) fn stride(&self) -> usize {
        self.stride
    }
}
