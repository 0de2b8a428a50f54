//! AVX2: eight children, rays or triangles at once.
#![allow(unsafe_code)]

use super::{
    Hull, INTERVAL_WIDENING, Kernel, LANES, LeafRows, MIN_SQUARED_LENGTH, Rows, Spheres, Stack, ray_of,
};
use crate::exact::rays::{GROUP, GROUPS, RAYS, RaySet};
use std::arch::x86_64::*;
use umbrage_accel::NodeView;
use umbrage_geom::{
    kernel::{
        BlockMask, TriangleBlock,
        fan::{self, x86::Planes},
    },
    simd::{
        Avx2,
        x86::{count_ones, load, planes, sorted, store},
    },
};

/// The group's eight numbers of a row.
#[inline]
#[target_feature(enable = "avx2")]
fn group_of(row: &[f32; RAYS], group: usize) -> __m256 {
    // SAFETY: a group below `GROUPS` ends inside the row.
    unsafe { _mm256_loadu_ps(row.as_ptr().add(group % GROUPS * GROUP)) }
}

#[inline]
#[target_feature(enable = "avx2,fma")]
fn rows(node: NodeView<'_>, origin: [f32; 3]) -> Rows {
    let (base, step) = (node.base(), node.step());
    let mut rows = Rows([[0.0; LANES]; 6]);
    for (i, (row, numbers)) in rows.0.iter_mut().zip(node.grid()).enumerate() {
        let axis = i / 2;
        let plane = planes(numbers, step[axis], base[axis]);
        store(row, _mm256_sub_ps(plane, _mm256_set1_ps(origin[axis])));
    }
    rows
}

#[inline]
#[target_feature(enable = "avx2,fma")]
fn inside(rows: &Rows, hull: &Hull) -> u32 {
    let sign = _mm256_set1_ps(-0.0);
    let mut gap2 = _mm256_setzero_ps();
    let mut height = _mm256_set1_ps(1e-30);
    for axis in 0..3 {
        let (low, high) = (load(&rows.0[2 * axis]), load(&rows.0[2 * axis + 1]));
        let gap = _mm256_max_ps(_mm256_max_ps(low, _mm256_xor_ps(high, sign)), _mm256_setzero_ps());
        gap2 = _mm256_fmadd_ps(gap, gap, gap2);
        let top = load(&rows.0[(2 * axis + 1 - hull.down[axis]) % 6]);
        height = _mm256_fmadd_ps(top, _mm256_set1_ps(hull.up[axis]), height);
        height = _mm256_fmadd_ps(_mm256_andnot_ps(sign, top), _mm256_set1_ps(1e-5), height);
    }
    let near = _mm256_cmp_ps::<_CMP_LE_OQ>(gap2, _mm256_set1_ps(hull.radius2));
    let above = _mm256_cmp_ps::<_CMP_GE_OQ>(height, _mm256_setzero_ps());
    _mm256_movemask_ps(_mm256_and_ps(near, above)) as u32
}

#[inline]
#[target_feature(enable = "avx2")]
fn around(rows: &Rows) -> u32 {
    let (mut lowest, mut highest) = (load(&rows.0[0]), load(&rows.0[1]));
    for axis in 1..3 {
        lowest = _mm256_max_ps(lowest, load(&rows.0[2 * axis]));
        highest = _mm256_min_ps(highest, load(&rows.0[2 * axis + 1]));
    }
    let zero = _mm256_setzero_ps();
    let below = _mm256_cmp_ps::<_CMP_LE_OQ>(lowest, zero);
    let above = _mm256_cmp_ps::<_CMP_GE_OQ>(highest, zero);
    _mm256_movemask_ps(_mm256_and_ps(below, above)) as u32
}

#[inline]
#[target_feature(enable = "avx2,fma")]
fn spheres(rows: &Rows) -> Spheres {
    let row = [0.0; LANES];
    let mut spheres = Spheres { center: [row; 3], slack: row, tangent: row, radius: row };
    let (mut distance2, mut radius2) = (_mm256_setzero_ps(), _mm256_setzero_ps());
    let half = _mm256_set1_ps(0.5);
    for axis in 0..3 {
        let (low, high) = (load(&rows.0[2 * axis]), load(&rows.0[2 * axis + 1]));
        let center = _mm256_mul_ps(_mm256_add_ps(low, high), half);
        let extent = _mm256_mul_ps(_mm256_sub_ps(high, low), half);
        store(&mut spheres.center[axis], center);
        distance2 = _mm256_fmadd_ps(center, center, distance2);
        radius2 = _mm256_fmadd_ps(extent, extent, radius2);
    }
    let shrunk = _mm256_mul_ps(distance2, _mm256_set1_ps(0.999));
    let outside = _mm256_and_ps(
        _mm256_cmp_ps::<_CMP_LT_OQ>(radius2, shrunk),
        _mm256_and_ps(
            _mm256_cmp_ps::<_CMP_GT_OQ>(distance2, _mm256_set1_ps(1e-30)),
            _mm256_cmp_ps::<_CMP_LT_OQ>(distance2, _mm256_set1_ps(f32::INFINITY)),
        ),
    );
    let tangent = _mm256_and_ps(_mm256_sqrt_ps(_mm256_sub_ps(distance2, radius2)), outside);
    let radius = _mm256_blendv_ps(_mm256_set1_ps(f32::INFINITY), _mm256_sqrt_ps(radius2), outside);
    store(&mut spheres.tangent, tangent);
    store(&mut spheres.radius, radius);
    store(&mut spheres.slack, _mm256_mul_ps(_mm256_add_ps(tangent, radius), _mm256_set1_ps(4e-6)));
    spheres
}

#[inline]
#[target_feature(enable = "avx2,fma")]
fn cones(spheres: &Spheres, child: usize, rays: &RaySet) -> u32 {
    let at = |row: &[f32; LANES]| _mm256_set1_ps(row[child % LANES]);
    let [x, y, z] = &spheres.center;
    let center = [at(x), at(y), at(z)];
    let (slack, tangent, radius) = (at(&spheres.slack), at(&spheres.tangent), at(&spheres.radius));
    let mut mask = 0;
    for first in (0..rays.groups).step_by(LANES) {
        // SAFETY: rows have `GROUPS` numbers, a multiple of `LANES`.
        let of = |row: &[f32; GROUPS]| unsafe { _mm256_loadu_ps(row.as_ptr().add(first % GROUPS)) };
        let mut test = slack;
        for (axis, &center) in rays.axis.iter().zip(&center) {
            test = _mm256_fmadd_ps(of(axis), center, test);
        }
        test = _mm256_fmadd_ps(of(&rays.sin), radius, test);
        test = _mm256_fnmadd_ps(of(&rays.cos), tangent, test);
        let met = _mm256_cmp_ps::<_CMP_NLT_UQ>(test, _mm256_setzero_ps());
        mask |= (_mm256_movemask_ps(met) as u32) << first;
    }
    mask
}

#[inline]
#[target_feature(enable = "avx2,fma")]
fn box_groups(rows: &Rows, child: usize, rays: &RaySet, hull: &Hull) -> u32 {
    let mut mask = 0;
    for first in (0..rays.groups).step_by(LANES) {
        // SAFETY: rows have `GROUPS` numbers, a multiple of `LANES`.
        let of = |row: &[f32; GROUPS]| unsafe { _mm256_loadu_ps(row.as_ptr().add(first % GROUPS)) };
        let (mut entry, mut exit) = (_mm256_setzero_ps(), _mm256_set1_ps(hull.radius));
        for axis in 0..3 {
            let low = _mm256_set1_ps(rows.0[2 * axis][child % LANES]);
            let high = _mm256_set1_ps(rows.0[2 * axis + 1][child % LANES]);
            let (a, b) = (of(&rays.ends[axis][0]), of(&rays.ends[axis][1]));
            let (la, lb) = (_mm256_mul_ps(low, a), _mm256_mul_ps(low, b));
            let (ha, hb) = (_mm256_mul_ps(high, a), _mm256_mul_ps(high, b));
            let least = _mm256_min_ps(_mm256_min_ps(la, lb), _mm256_min_ps(ha, hb));
            let most = _mm256_max_ps(_mm256_max_ps(la, lb), _mm256_max_ps(ha, hb));
            // `max` and `min` return the second operand for NaN, which drops it.
            entry = _mm256_max_ps(least, entry);
            exit = _mm256_min_ps(most, exit);
        }
        let exit = _mm256_fmadd_ps(exit, _mm256_set1_ps(1.0 + 1e-5), _mm256_set1_ps(f32::MIN_POSITIVE));
        mask |= (_mm256_movemask_ps(_mm256_cmp_ps::<_CMP_NGT_UQ>(entry, exit)) as u32) << first;
    }
    mask
}

#[inline]
#[target_feature(enable = "avx2,fma")]
fn widened(exit: __m256) -> __m256 {
    _mm256_fmadd_ps(exit, _mm256_set1_ps(INTERVAL_WIDENING), _mm256_set1_ps(f32::MIN_POSITIVE))
}

#[inline]
#[target_feature(enable = "avx2,fma")]
fn box_rays(rows: &Rows, child: usize, rays: &RaySet, group: usize) -> u32 {
    let (mut entry, mut exit) = (_mm256_setzero_ps(), group_of(&rays.far, group));
    for axis in 0..3 {
        let inverse = group_of(&rays.inverse[axis], group);
        let low = _mm256_set1_ps(rows.0[2 * axis][child % LANES]);
        let high = _mm256_set1_ps(rows.0[2 * axis + 1][child % LANES]);
        let near = _mm256_blendv_ps(low, high, inverse);
        let far = _mm256_blendv_ps(high, low, inverse);
        // `max` and `min` return the second operand for NaN, which drops it.
        entry = _mm256_max_ps(_mm256_mul_ps(near, inverse), entry);
        exit = _mm256_min_ps(_mm256_mul_ps(far, inverse), exit);
    }
    _mm256_movemask_ps(_mm256_cmp_ps::<_CMP_LE_OQ>(entry, widened(exit))) as u32
}

/// All bits set for the children that ray number `ray` may enter.
#[inline]
#[target_feature(enable = "avx2,fma")]
fn ray_boxes(rows: &Rows, rays: &RaySet, ray: usize) -> __m256 {
    let ray = ray % RAYS;
    let (mut entry, mut exit) = (_mm256_setzero_ps(), _mm256_set1_ps(rays.far[ray]));
    for axis in 0..3 {
        let inverse = rays.inverse[axis][ray];
        let row = 2 * axis + (inverse.to_bits() >> 31) as usize;
        let inverse = _mm256_set1_ps(inverse);
        let (near, far) = (load(&rows.0[row]), load(&rows.0[row ^ 1]));
        entry = _mm256_max_ps(_mm256_mul_ps(near, inverse), entry);
        exit = _mm256_min_ps(_mm256_mul_ps(far, inverse), exit);
    }
    _mm256_cmp_ps::<_CMP_LE_OQ>(entry, widened(exit))
}

/// Squared distances of the boxes.
#[inline]
#[target_feature(enable = "avx2,fma")]
fn gaps(rows: &Rows) -> __m256 {
    let mut gap2 = _mm256_setzero_ps();
    for axis in 0..3 {
        let (low, high) = (load(&rows.0[2 * axis]), load(&rows.0[2 * axis + 1]));
        let gap = _mm256_max_ps(low, _mm256_xor_ps(high, _mm256_set1_ps(-0.0)));
        let gap = _mm256_max_ps(gap, _mm256_setzero_ps());
        gap2 = _mm256_fmadd_ps(gap, gap, gap2);
    }
    gap2
}

#[inline]
#[target_feature(enable = "avx2,fma,bmi1,popcnt")]
#[allow(clippy::too_many_arguments)] // the state of one loop
fn push_rays(
    children: &[u32; LANES],
    rows: &Rows,
    rays: &RaySet,
    ids: u32,
    mut left: u32,
    wanted: u32,
    stack: &mut Stack,
    top: usize,
) -> usize {
    let mut columns = _mm256_setzero_si256();
    while left != 0 {
        let ray = ray_of(ids, left.trailing_zeros());
        let bit = _mm256_set1_epi32((left & left.wrapping_neg()) as i32);
        left &= left - 1;
        let entered = _mm256_castps_si256(ray_boxes(rows, rays, ray));
        columns = _mm256_or_si256(columns, _mm256_and_si256(entered, bit));
    }
    let missed = _mm256_cmpeq_epi32(columns, _mm256_setzero_si256());
    let mask = !(_mm256_movemask_ps(_mm256_castsi256_ps(missed)) as u32) & (wanted % 256);
    assert!(top + LANES <= stack.rays.len(), "the tree has no more levels than the stack");
    // Fewest rays first, and of those as many the farthest, by the upper bits of the distance; lanes that aren't wanted last.
    let numbers = _mm256_setr_epi32(8, 9, 10, 11, 12, 13, 14, 15);
    let fewer = _mm256_sub_epi32(_mm256_set1_epi32(32), count_ones(columns));
    let distance = _mm256_srli_epi32::<7>(_mm256_castps_si256(gaps(rows)));
    let distance = _mm256_and_si256(distance, _mm256_set1_epi32(!15));
    let distance = _mm256_or_si256(_mm256_slli_epi32::<25>(fewer), distance);
    let bits = _mm256_setr_epi32(1, 2, 4, 8, 16, 32, 64, 128);
    let taken = _mm256_cmpeq_epi32(_mm256_and_si256(_mm256_set1_epi32(mask as i32), bits), bits);
    let order = sorted::<true>(_mm256_and_si256(_mm256_or_si256(distance, numbers), taken));
    // SAFETY: eight entries from `top` are in the stack.
    unsafe {
        let children = _mm256_loadu_si256(children.as_ptr().cast());
        let children = _mm256_permutevar8x32_epi32(children, order);
        let columns = _mm256_permutevar8x32_epi32(columns, order);
        _mm256_storeu_si256(stack.children.as_mut_ptr().add(top).cast(), children);
        _mm256_storeu_si256(stack.groups.as_mut_ptr().add(top).cast(), _mm256_set1_epi32(ids as i32));
        _mm256_storeu_si256(stack.rays.as_mut_ptr().add(top).cast(), columns);
    }
    top + mask.count_ones() as usize
}

#[inline]
#[target_feature(enable = "avx2,fma")]
fn lengths(planes: &fan::scalar::Planes) -> [[f32; LANES]; 3] {
    let mut lengths = [[0.0; LANES]; 3];
    for (row, [x, y, z]) in lengths.iter_mut().zip(planes.normals()) {
        let (x, y, z) = (load(x), load(y), load(z));
        let square = _mm256_fmadd_ps(
            x,
            x,
            _mm256_fmadd_ps(y, y, _mm256_fmadd_ps(z, z, _mm256_set1_ps(MIN_SQUARED_LENGTH))),
        );
        store(row, _mm256_sqrt_ps(square));
    }
    lengths
}

#[inline]
#[target_feature(enable = "avx2,fma")]
fn near(rows: &LeafRows, hull: &Hull) -> u32 {
    let planes = &rows.planes;
    let [a, b, c] = planes.normals();
    let mut square = _mm256_set1_ps(MIN_SQUARED_LENGTH);
    for axis in 0..3 {
        let sum = _mm256_add_ps(_mm256_add_ps(load(&a[axis]), load(&b[axis])), load(&c[axis]));
        square = _mm256_fmadd_ps(sum, sum, square);
    }
    let error = _mm256_mul_ps(load(planes.error()), _mm256_set1_ps(8.0));
    let size = _mm256_fmadd_ps(_mm256_sqrt_ps(square), _mm256_set1_ps(1.0 + 1e-5), error);
    let reach = _mm256_mul_ps(size, _mm256_set1_ps(hull.radius));
    let height = _mm256_andnot_ps(_mm256_set1_ps(-0.0), load(planes.volume()));
    let height = _mm256_sub_ps(height, load(planes.volume_error()));
    // NaN counts as near.
    _mm256_movemask_ps(_mm256_cmp_ps::<_CMP_NGT_UQ>(height, reach)) as u32
}

#[inline]
#[target_feature(enable = "avx2,fma")]
fn lane_groups(rows: &LeafRows, lane: usize, rays: &RaySet) -> u32 {
    let lane = lane % LANES;
    let error = _mm256_set1_ps(rows.planes.error()[lane] * 4.0);
    let zero = _mm256_setzero_ps();
    let mut mask = 0;
    for first in (0..rays.groups).step_by(LANES) {
        // SAFETY: rows have `GROUPS` numbers, a multiple of `LANES`.
        let of = |row: &[f32; GROUPS]| unsafe { _mm256_loadu_ps(row.as_ptr().add(first % GROUPS)) };
        let axis = [of(&rays.axis[0]), of(&rays.axis[1]), of(&rays.axis[2])];
        let chord = of(&rays.chord);
        let (mut lowest, mut highest) = (_mm256_set1_ps(f32::INFINITY), _mm256_set1_ps(f32::NEG_INFINITY));
        for k in 0..3 {
            let [x, y, z] = &rows.planes.normals()[k];
            let middle = _mm256_fmadd_ps(
                axis[0],
                _mm256_set1_ps(x[lane]),
                _mm256_fmadd_ps(
                    axis[1],
                    _mm256_set1_ps(y[lane]),
                    _mm256_mul_ps(axis[2], _mm256_set1_ps(z[lane])),
                ),
            );
            let reach = _mm256_fmadd_ps(chord, _mm256_set1_ps(rows.lengths[k][lane]), error);
            lowest = _mm256_min_ps(_mm256_add_ps(middle, reach), lowest);
            highest = _mm256_max_ps(_mm256_sub_ps(middle, reach), highest);
        }
        let below = _mm256_cmp_ps::<_CMP_LT_OQ>(lowest, zero);
        let above = _mm256_cmp_ps::<_CMP_GT_OQ>(highest, zero);
        mask |= (!_mm256_movemask_ps(_mm256_and_ps(below, above)) as u32 & 0xff) << first;
    }
    mask
}

#[inline]
#[target_feature(enable = "avx2,fma")]
fn ahead(spheres: &Spheres, hull: &Hull) -> u32 {
    let mut test = load(&spheres.slack);
    for axis in 0..3 {
        test = _mm256_fmadd_ps(load(&spheres.center[axis]), _mm256_set1_ps(hull.axis[axis]), test);
    }
    test = _mm256_fmadd_ps(_mm256_set1_ps(hull.angle[1]), load(&spheres.radius), test);
    test = _mm256_fnmadd_ps(_mm256_set1_ps(hull.angle[0]), load(&spheres.tangent), test);
    _mm256_movemask_ps(_mm256_cmp_ps::<_CMP_NLT_UQ>(test, _mm256_setzero_ps())) as u32
}

impl Kernel for Avx2 {
    type Planes = Planes;

    #[inline(always)]
    fn rows(self, node: NodeView<'_>, origin: [f32; 3]) -> Rows {
        // SAFETY: `self` proves the target features.
        unsafe { rows(node, origin) }
    }

    #[inline(always)]
    fn inside(self, rows: &Rows, hull: &Hull) -> u32 {
        // SAFETY: `self` proves the target features.
        unsafe { inside(rows, hull) }
    }

    #[inline(always)]
    fn around(self, rows: &Rows) -> u32 {
        // SAFETY: `self` proves the target features.
        unsafe { around(rows) }
    }

    #[inline(always)]
    fn spheres(self, rows: &Rows) -> Spheres {
        // SAFETY: `self` proves the target features.
        unsafe { spheres(rows) }
    }

    #[inline(always)]
    fn ahead(self, spheres: &Spheres, hull: &Hull) -> u32 {
        // SAFETY: `self` proves the target features.
        unsafe { ahead(spheres, hull) }
    }

    #[inline(always)]
    fn cones(self, spheres: &Spheres, child: usize, rays: &RaySet) -> u32 {
        // SAFETY: `self` proves the target features.
        unsafe { cones(spheres, child, rays) }
    }

    #[inline(always)]
    fn box_groups(self, rows: &Rows, child: usize, rays: &RaySet, hull: &Hull) -> u32 {
        // SAFETY: `self` proves the target features.
        unsafe { box_groups(rows, child, rays, hull) }
    }

    #[inline(always)]
    fn box_rays(self, rows: &Rows, child: usize, rays: &RaySet, group: usize) -> u32 {
        // SAFETY: `self` proves the target features.
        unsafe { box_rays(rows, child, rays, group) }
    }

    #[inline(always)]
    fn push_rays(
        self,
        children: &[u32; LANES],
        rows: &Rows,
        rays: &RaySet,
        ids: u32,
        left: u32,
        wanted: u32,
        stack: &mut Stack,
        top: usize,
    ) -> usize {
        // SAFETY: `self` proves the target features.
        unsafe { push_rays(children, rows, rays, ids, left, wanted, stack, top) }
    }

    #[inline(always)]
    fn planes(self, block: &TriangleBlock, origin: [f32; 3]) -> Planes {
        Avx2::planes(self, block, origin)
    }

    #[inline(always)]
    fn ask_sides(self, planes: &mut Planes, block: &TriangleBlock, origin: [f32; 3], lanes: u8) {
        Avx2::ask_sides(self, planes, block, origin, lanes);
    }

    #[inline(always)]
    fn leaf_rows(self, planes: &Planes) -> LeafRows {
        let planes = self.store_planes(planes);
        // SAFETY: `self` proves the target features.
        LeafRows { lengths: unsafe { lengths(&planes) }, planes }
    }

    #[inline(always)]
    fn ray_lanes(self, planes: &Planes, rays: &RaySet, ray: usize) -> BlockMask {
        let ray = ray % RAYS;
        let [x, y, z] = &rays.direction;
        self.fan_filter(planes, [x[ray], y[ray], z[ray]], 0.0, rays.far[ray])
    }

    #[inline(always)]
    fn above(self, block: &TriangleBlock, origin: [f32; 3], hull: &Hull) -> u32 {
        Avx2::above(self, block, origin, hull.up).into()
    }

    #[inline(always)]
    fn near(self, rows: &LeafRows, hull: &Hull) -> u32 {
        // SAFETY: `self` proves the target features.
        unsafe { near(rows, hull) }
    }

    #[inline(always)]
    fn lane_groups(self, rows: &LeafRows, lane: usize, rays: &RaySet) -> u32 {
        // SAFETY: `self` proves the target features.
        unsafe { lane_groups(rows, lane, rays) }
    }

    #[inline(always)]
    fn lane_rays(self, rows: &LeafRows, lane: usize, rays: &RaySet, group: usize) -> BlockMask {
        let [x, y, z] = &rays.direction;
        let direction = [rays.of_group(x, group), rays.of_group(y, group), rays.of_group(z, group)];
        self.fan_rays(&rows.planes, lane, direction, rays.of_group(&rays.far, group))
    }

    #[inline(always)]
    fn prefetch(self, target: *const u8, bytes: usize) {
        Avx2::prefetch(self, target, bytes);
    }
}
