//! AVX2: eight children at once. Same operations in the same order as `scalar.rs`, nothing fused, hence the same masks.

use super::{
    Ahead, Columns, FAN, Fan, Kernel, NodeRay, Rows, SHARE_OF_MARK_1, SHORTEST_WAY, Sizes, Stack, surely,
};
use crate::{
    node::{Node, NodeNote, WIDTH},
    solid::SolidPack,
};
use std::arch::x86_64::*;
use umbrage_geom::{
    kernel::{
        BlockMask, BlockRay, TriangleBlock,
        fan::{self, FanRays},
    },
    simd::{
        Avx2,
        x86::{self, count_ones, load, sorted, store},
    },
};

/// The planes of row `row` of axis `axis`.
#[inline]
#[target_feature(enable = "avx2,fma")]
fn planes(node: &Node, row: usize, axis: usize) -> __m256 {
    x86::planes(&node.grid[row % 6], node.step[axis], node.base[axis])
}

/// Entry and exit of each child.
#[inline]
#[target_feature(enable = "avx2,fma")]
fn slabs(node: &Node, ray: &NodeRay, tfar: f32) -> (__m256, __m256) {
    let (mut entry, mut exit) = (_mm256_set1_ps(ray.slab.tnear), _mm256_set1_ps(tfar));
    for axis in 0..3 {
        let row = ray.near_row[axis];
        let near = _mm256_sub_ps(planes(node, row, axis), _mm256_set1_ps(ray.slab.origin_near[axis]));
        let far = _mm256_sub_ps(planes(node, row ^ 1, axis), _mm256_set1_ps(ray.slab.origin_far[axis]));
        // `max` and `min` return the second operand for NaN, which drops it.
        entry = _mm256_max_ps(_mm256_mul_ps(near, _mm256_set1_ps(ray.slab.inv_near[axis])), entry);
        exit = _mm256_min_ps(_mm256_mul_ps(far, _mm256_set1_ps(ray.slab.inv_far[axis])), exit);
    }
    (entry, exit)
}

/// Row `row` of a pack.
#[inline]
#[target_feature(enable = "avx2")]
fn pack_row(pack: &SolidPack, row: usize) -> __m256 {
    load(&pack.rows[row % 6])
}

/// Lanes of which the ends of the segment and the planes of all axes leave something.
#[inline]
#[target_feature(enable = "avx2")]
fn sure([start, end]: [f32; 2], entries: [__m256; 3], exits: [__m256; 3]) -> u32 {
    let exit = _mm256_min_ps(_mm256_min_ps(exits[0], exits[1]), _mm256_min_ps(exits[2], _mm256_set1_ps(end)));
    // False for NaN, which only entries can be.
    let mut all = _mm256_cmp_ps::<_CMP_LT_OQ>(_mm256_set1_ps(start), exit);
    for entry in entries {
        all = _mm256_and_ps(all, _mm256_cmp_ps::<_CMP_LT_OQ>(entry, exit));
    }
    _mm256_movemask_ps(all) as u32
}

#[inline]
#[target_feature(enable = "avx2")]
fn crossed(pack: &SolidPack, ray: &NodeRay) -> u32 {
    let (mut entries, mut exits) = ([_mm256_setzero_ps(); 3], [_mm256_setzero_ps(); 3]);
    for axis in 0..3 {
        let row = ray.near_row[axis];
        let near = _mm256_sub_ps(pack_row(pack, row), _mm256_set1_ps(ray.slab.origin_near[axis]));
        let far = _mm256_sub_ps(pack_row(pack, row ^ 1), _mm256_set1_ps(ray.slab.origin_far[axis]));
        entries[axis] = _mm256_mul_ps(near, _mm256_set1_ps(ray.slab.inv_far[axis]));
        exits[axis] = _mm256_mul_ps(far, _mm256_set1_ps(ray.slab.inv_near[axis]));
    }
    sure(surely(ray.slab.tnear, ray.slab.tfar), entries, exits)
}

#[inline]
#[target_feature(enable = "avx2")]
fn pack_rows(pack: &SolidPack, origin: [f32; 3]) -> Rows {
    let mut rows = Rows([[0.0; WIDTH]; 6]);
    for (i, row) in rows.0.iter_mut().enumerate() {
        let relative = _mm256_sub_ps(pack_row(pack, i), _mm256_set1_ps(origin[i / 2]));
        store(row, relative);
    }
    rows
}

#[inline]
#[target_feature(enable = "avx2")]
fn fan_crossed(rows: &Rows, rays: &FanRays<FAN>, r: usize) -> u32 {
    let (mut entries, mut exits) = ([_mm256_setzero_ps(); 3], [_mm256_setzero_ps(); 3]);
    for (axis, [near, far]) in ends_of(rows, rays, r).into_iter().enumerate() {
        entries[axis] = _mm256_mul_ps(near, _mm256_set1_ps(rays.inv_far[axis][r]));
        exits[axis] = _mm256_mul_ps(far, _mm256_set1_ps(rays.inv_near[axis][r]));
    }
    sure(surely(rays.slab_near[r], rays.slab_far[r]), entries, exits)
}

#[inline]
#[target_feature(enable = "avx2,fma")]
fn rows(node: &Node, origin: [f32; 3]) -> Rows {
    let mut rows = Rows([[0.0; WIDTH]; 6]);
    for (i, row) in rows.0.iter_mut().enumerate() {
        let relative = _mm256_sub_ps(planes(node, i, i / 2), _mm256_set1_ps(origin[i / 2]));
        store(row, relative);
    }
    rows
}

/// The near and the far planes of an axis, for rays in its negative direction or not.
#[inline]
#[target_feature(enable = "avx2")]
fn ends(rows: &Rows, axis: usize, negative: u32) -> [__m256; 2] {
    let row = 2 * axis + (negative as usize & 1);
    [load(&rows.0[row]), load(&rows.0[row ^ 1])]
}

/// Later entry and earlier exit of each child for ray `r`, from those given, by [`ends`] of each axis.
#[inline]
#[target_feature(enable = "avx2")]
fn fan_entries<const N: usize>(
    ends: [[__m256; 2]; 3],
    rays: &FanRays<N>,
    r: usize,
    (mut entry, mut exit): (__m256, __m256),
) -> (__m256, __m256) {
    for (axis, [near, far]) in ends.into_iter().enumerate() {
        // `max` and `min` return the second operand for NaN, which drops it.
        entry = _mm256_max_ps(_mm256_mul_ps(near, _mm256_set1_ps(rays.inv_near[axis][r])), entry);
        exit = _mm256_min_ps(_mm256_mul_ps(far, _mm256_set1_ps(rays.inv_far[axis][r])), exit);
    }
    (entry, exit)
}

/// All bits set for the children that ray `r` may enter.
#[inline]
#[target_feature(enable = "avx2")]
fn fan_slabs<const N: usize>(ends: [[__m256; 2]; 3], rays: &FanRays<N>, r: usize) -> __m256 {
    let segment = (_mm256_set1_ps(rays.slab_near[r]), _mm256_set1_ps(rays.slab_far[r]));
    let (entry, exit) = fan_entries(ends, rays, r, segment);
    _mm256_cmp_ps::<_CMP_LE_OQ>(entry, exit)
}

/// [`ends`] for ray `r`.
#[inline]
#[target_feature(enable = "avx2")]
fn ends_of<const N: usize>(rows: &Rows, rays: &FanRays<N>, r: usize) -> [[__m256; 2]; 3] {
    let of = |axis: usize| ends(rows, axis, rays.negative[axis][r]);
    [of(0), of(1), of(2)]
}

/// Children that the rays in `left` may enter: for each child one bit a ray.
#[inline]
#[target_feature(enable = "avx2,bmi1")]
fn columns(rows: &Rows, fan: &Fan, mut left: u32) -> __m256i {
    let mut columns = _mm256_setzero_si256();
    let mut add = |r: usize, entered: __m256| {
        let bit = _mm256_set1_epi32(1 << r);
        columns = _mm256_or_si256(columns, _mm256_and_si256(_mm256_castps_si256(entered), bit));
    };
    if let Some([x, y, z]) = fan.signs {
        // Planes are loaded once for all rays.
        let ends = [ends(rows, 0, x), ends(rows, 1, y), ends(rows, 2, z)];
        while left != 0 {
            let r = left.trailing_zeros() as usize % FAN;
            left &= left - 1;
            add(r, fan_slabs(ends, &fan.rays, r));
        }
    } else {
        while left != 0 {
            let r = left.trailing_zeros() as usize % FAN;
            left &= left - 1;
            add(r, fan_slabs(ends_of(rows, &fan.rays, r), &fan.rays, r));
        }
    }
    columns
}

#[inline]
#[target_feature(enable = "avx2")]
fn sizes(rows: &Rows, note: &NodeNote) -> Sizes {
    let (mut square, mut distance) = (_mm256_setzero_ps(), _mm256_setzero_ps());
    for axis in 0..3 {
        let (low, high) = (load(&rows.0[2 * axis]), load(&rows.0[2 * axis + 1]));
        let (size, middle) = (_mm256_sub_ps(high, low), _mm256_add_ps(low, high));
        square = _mm256_add_ps(square, _mm256_mul_ps(size, size));
        distance = _mm256_add_ps(distance, _mm256_mul_ps(middle, middle));
    }
    let mut sizes = Sizes([0.0; WIDTH]);
    // SAFETY: there are eight marks; sizes are eight aligned floats.
    unsafe {
        let marks = _mm256_cvtepu8_epi32(_mm_loadl_epi64(note.marks.as_ptr().cast()));
        let share = _mm256_mul_ps(_mm256_cvtepi32_ps(marks), _mm256_set1_ps(SHARE_OF_MARK_1));
        let never = _mm256_castsi256_ps(_mm256_cmpeq_epi32(marks, _mm256_setzero_si256()));
        let seen = _mm256_div_ps(_mm256_mul_ps(square, share), distance);
        let seen = _mm256_blendv_ps(seen, _mm256_set1_ps(f32::INFINITY), never);
        _mm256_store_ps(sizes.0.as_mut_ptr(), seen);
    }
    sizes
}

#[inline]
#[target_feature(enable = "avx2")]
fn enter_or_end(
    rows: &Rows,
    sizes: &Sizes,
    rays: &FanRays<FAN>,
    r: usize,
    limit: f32,
    columns: &mut Columns,
    covered: &mut [f32; WIDTH],
) -> u32 {
    let line = (_mm256_set1_ps(f32::NEG_INFINITY), _mm256_set1_ps(f32::INFINITY));
    let (entry, exit) = fan_entries(ends_of(rows, rays, r), rays, r, line);
    let t0 = _mm256_max_ps(entry, _mm256_set1_ps(rays.slab_near[r]));
    let t1 = _mm256_min_ps(exit, _mm256_set1_ps(rays.slab_far[r]));
    let hit = _mm256_cmp_ps::<_CMP_LE_OQ>(t0, t1);
    // SAFETY: sizes and columns are eight floats and integers, aligned; so many can be stored in `covered`.
    unsafe {
        let fits = _mm256_cmp_ps::<_CMP_LT_OQ>(_mm256_load_ps(sizes.0.as_ptr()), _mm256_set1_ps(limit));
        let entered = _mm256_castps_si256(_mm256_andnot_ps(fits, hit));
        let at = columns.0.as_mut_ptr().cast();
        let bits = _mm256_and_si256(entered, _mm256_set1_epi32(1 << r));
        _mm256_store_si256(at, _mm256_or_si256(_mm256_load_si256(at), bits));
        let stops = _mm256_and_ps(hit, fits);
        let ends = _mm256_movemask_ps(stops) as u32;
        if ends != 0 {
            let raise = _mm256_set1_ps(SHORTEST_WAY);
            let inside = _mm256_add_ps(_mm256_sub_ps(t1, t0), raise);
            let way = _mm256_add_ps(_mm256_sub_ps(exit, entry), raise);
            _mm256_storeu_ps(covered.as_mut_ptr(), _mm256_and_ps(stops, _mm256_div_ps(inside, way)));
        }
        ends
    }
}

#[inline]
#[target_feature(enable = "avx2")]
fn overlap(rows: &Rows, low: [f32; 3], high: [f32; 3]) -> u32 {
    let mut reaches = _mm256_castsi256_ps(_mm256_set1_epi32(-1));
    for axis in 0..3 {
        let (least, greatest) = (load(&rows.0[2 * axis]), load(&rows.0[2 * axis + 1]));
        let below = _mm256_cmp_ps::<_CMP_LE_OQ>(least, _mm256_set1_ps(high[axis]));
        let above = _mm256_cmp_ps::<_CMP_GE_OQ>(greatest, _mm256_set1_ps(low[axis]));
        reaches = _mm256_and_ps(reaches, _mm256_and_ps(below, above));
    }
    _mm256_movemask_ps(reaches) as u32
}

#[inline]
#[target_feature(enable = "avx2,fma,bmi1,popcnt")]
#[allow(clippy::too_many_arguments)] // the state of one loop
fn fan_push(
    node: &Node,
    rows: &Rows,
    fan: &Fan,
    left: u32,
    wanted: u32,
    stack: &mut Stack,
    top: usize,
) -> usize {
    push(node, rows, fan, columns(rows, fan, left), wanted, stack, top)
}

/// Pushes the `wanted` children, `columns` being the rays that enter each.
#[inline]
#[target_feature(enable = "avx2,fma,bmi1,popcnt")]
fn push(
    node: &Node,
    rows: &Rows,
    fan: &Fan,
    columns: __m256i,
    wanted: u32,
    stack: &mut Stack,
    top: usize,
) -> usize {
    let lanes = _mm256_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7);
    let asked =
        _mm256_and_si256(_mm256_srlv_epi32(_mm256_set1_epi32(wanted as i32), lanes), _mm256_set1_epi32(1));
    let dropped = _mm256_or_si256(
        _mm256_cmpeq_epi32(columns, _mm256_setzero_si256()),
        _mm256_cmpeq_epi32(asked, _mm256_setzero_si256()),
    );
    // SAFETY: eight bytes.
    let merits = unsafe { _mm_loadl_epi64(node.merits.as_ptr().cast()) };
    let merits = _mm256_add_epi32(_mm256_cvtepu8_epi32(merits), _mm256_set1_epi32(Node::LEAST_MERIT as i32));
    let merits = _mm256_castsi256_ps(_mm256_slli_epi32::<20>(merits));
    let mut way = _mm256_set1_ps(fan.ahead.offset);
    for axis in 0..3 {
        let (low, high) = (load(&rows.0[2 * axis]), load(&rows.0[2 * axis + 1]));
        way = _mm256_fmadd_ps(_mm256_add_ps(low, high), _mm256_set1_ps(fan.ahead.direction[axis]), way);
    }
    let way = _mm256_min_ps(_mm256_max_ps(way, _mm256_setzero_ps()), _mm256_set1_ps(Ahead::MOST));
    // Bits of positive floats sort as integers; the lane takes the place of the lowest ones, what is dropped comes last.
    let key = _mm256_castps_si256(_mm256_mul_ps(
        _mm256_sub_ps(_mm256_cvtepi32_ps(count_ones(columns)), way),
        merits,
    ));
    let key = _mm256_or_si256(_mm256_andnot_si256(_mm256_set1_epi32(7), key), lanes);
    let order = sorted::<false>(_mm256_or_si256(key, dropped));
    assert!(top + WIDTH <= stack.rays.len(), "the tree has no more levels than the stack");
    // SAFETY: eight entries from `top` are in the stack, and there are eight children.
    unsafe {
        let children = _mm256_loadu_si256(node.children.as_ptr().cast());
        let children = _mm256_permutevar8x32_epi32(children, order);
        let columns = _mm256_permutevar8x32_epi32(columns, order);
        _mm256_storeu_si256(stack.children.as_mut_ptr().add(top).cast(), children);
        _mm256_storeu_si256(stack.rays.as_mut_ptr().add(top).cast(), columns);
    }
    let dropped = _mm256_movemask_ps(_mm256_castsi256_ps(dropped)) as u32;
    top + WIDTH - dropped.count_ones() as usize
}

impl Kernel for Avx2 {
    #[inline(always)]
    fn mask(self, node: &Node, ray: &NodeRay, tfar: f32) -> u32 {
        // SAFETY: `self` proves the target features.
        unsafe {
            let (entry, exit) = slabs(node, ray, tfar);
            _mm256_movemask_ps(_mm256_cmp_ps::<_CMP_LE_OQ>(entry, exit)) as u32 & node.used
        }
    }

    #[inline(always)]
    fn entries(self, node: &Node, ray: &NodeRay, tfar: f32, entries: &mut [f32; WIDTH]) -> u32 {
        // SAFETY: `self` proves the target features; the store fills the whole array.
        unsafe {
            let (entry, exit) = slabs(node, ray, tfar);
            _mm256_storeu_ps(entries.as_mut_ptr(), entry);
            _mm256_movemask_ps(_mm256_cmp_ps::<_CMP_LE_OQ>(entry, exit)) as u32 & node.used
        }
    }

    #[inline(always)]
    fn crossed(self, pack: &SolidPack, ray: &NodeRay) -> u32 {
        // SAFETY: `self` proves the target features.
        unsafe { crossed(pack, ray) }
    }

    #[inline(always)]
    fn pack_rows(self, pack: &SolidPack, origin: [f32; 3]) -> Rows {
        // SAFETY: `self` proves the target features.
        unsafe { pack_rows(pack, origin) }
    }

    #[inline(always)]
    fn fan_crossed(self, rows: &Rows, rays: &FanRays<FAN>, r: usize) -> u32 {
        // SAFETY: `self` proves the target features.
        unsafe { fan_crossed(rows, rays, r % FAN) }
    }

    #[inline(always)]
    fn filter(self, block: &TriangleBlock, ray: &BlockRay) -> BlockMask {
        Avx2::filter(self, block, ray)
    }

    #[inline(always)]
    fn rows(self, node: &Node, origin: [f32; 3]) -> Rows {
        // SAFETY: `self` proves the target features.
        unsafe { rows(node, origin) }
    }

    #[inline(always)]
    fn fan_mask<const N: usize>(self, rows: &Rows, rays: &FanRays<N>, r: usize) -> u32 {
        // SAFETY: `self` proves the target features.
        unsafe { _mm256_movemask_ps(fan_slabs(ends_of(rows, rays, r % N), rays, r % N)) as u32 }
    }

    #[inline(always)]
    fn overlap(self, rows: &Rows, low: [f32; 3], high: [f32; 3]) -> u32 {
        // SAFETY: `self` proves the target features.
        unsafe { overlap(rows, low, high) }
    }

    type Planes = fan::x86::Planes;

    #[inline(always)]
    fn prefetch(self, target: *const u8, bytes: usize) {
        Avx2::prefetch(self, target, bytes);
    }

    #[inline(always)]
    fn planes(self, block: &TriangleBlock, origin: [f32; 3]) -> Self::Planes {
        Avx2::planes(self, block, origin)
    }

    #[inline(always)]
    fn ask_sides(self, planes: &mut Self::Planes, block: &TriangleBlock, origin: [f32; 3], lanes: u8) {
        Avx2::ask_sides(self, planes, block, origin, lanes);
    }

    #[inline(always)]
    fn fan_filter(self, planes: &Self::Planes, rays: &FanRays<FAN>, r: usize) -> BlockMask {
        let r = r % FAN;
        let [x, y, z] = &rays.direction;
        Avx2::fan_filter(self, planes, [x[r], y[r], z[r]], rays.near[r], rays.far[r])
    }

    #[inline(always)]
    fn fan_push(
        self,
        node: &Node,
        rows: &Rows,
        fan: &Fan,
        left: u32,
        wanted: u32,
        stack: &mut Stack,
        top: usize,
    ) -> usize {
        // SAFETY: `self` proves the target features.
        unsafe { fan_push(node, rows, fan, left, wanted, stack, top) }
    }

    #[inline(always)]
    fn push(
        self,
        node: &Node,
        rows: &Rows,
        fan: &Fan,
        columns: &Columns,
        wanted: u32,
        stack: &mut Stack,
        top: usize,
    ) -> usize {
        // SAFETY: `self` proves the target features; columns are eight aligned integers.
        unsafe {
            let columns = _mm256_load_si256(columns.0.as_ptr().cast());
            push(node, rows, fan, columns, wanted, stack, top)
        }
    }

    #[inline(always)]
    fn sizes(self, rows: &Rows, note: &NodeNote) -> Sizes {
        // SAFETY: `self` proves the target features.
        unsafe { sizes(rows, note) }
    }

    #[inline(always)]
    fn smaller(self, sizes: &Sizes, limit: f32) -> u32 {
        // SAFETY: `self` proves the target features; sizes are eight aligned floats.
        unsafe {
            let sizes = _mm256_load_ps(sizes.0.as_ptr());
            _mm256_movemask_ps(_mm256_cmp_ps::<_CMP_LT_OQ>(sizes, _mm256_set1_ps(limit))) as u32
        }
    }

    #[inline(always)]
    fn enter_or_end(
        self,
        rows: &Rows,
        sizes: &Sizes,
        rays: &FanRays<FAN>,
        r: usize,
        limit: f32,
        columns: &mut Columns,
        covered: &mut [f32; WIDTH],
    ) -> u32 {
        // SAFETY: `self` proves the target features.
        unsafe { enter_or_end(rows, sizes, rays, r % FAN, limit, columns, covered) }
    }
}
