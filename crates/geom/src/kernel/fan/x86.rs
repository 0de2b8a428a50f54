//! The fan filter on AVX2 and FMA, eight lanes at once.

use super::{
    super::{BlockMask, DEPTH_UNDERFLOW, LANES, LARGEST, Lanes as Triangles},
    DEPTH_ERROR, EDGE_ERROR, REACH, VOLUME_ERROR, scalar,
};
use crate::simd::{
    Avx2,
    x86::{load, store},
};
use std::arch::x86_64::*;

/// A block of triangles seen from one origin.
#[derive(Clone, Copy, Debug)]
pub struct Planes {
    normals: [[__m256; 3]; 3],
    error: __m256,
    volume: __m256,
    volume_error: __m256,
    side: __m256,
    reach: __m256,
    used: u8,
}

#[inline]
#[target_feature(enable = "avx2,fma")]
fn cross(a: [__m256; 3], b: [__m256; 3]) -> [__m256; 3] {
    let minor = |i: usize, j: usize| _mm256_fmsub_ps(a[i], b[j], _mm256_mul_ps(a[j], b[i]));
    [minor(1, 2), minor(2, 0), minor(0, 1)]
}

#[inline]
#[target_feature(enable = "avx2,fma")]
fn dot(a: [__m256; 3], b: [__m256; 3]) -> __m256 {
    _mm256_fmadd_ps(a[0], b[0], _mm256_fmadd_ps(a[1], b[1], _mm256_mul_ps(a[2], b[2])))
}

#[inline]
#[target_feature(enable = "avx2,fma")]
fn minus(a: [__m256; 3], b: [__m256; 3]) -> [__m256; 3] {
    [_mm256_sub_ps(a[0], b[0]), _mm256_sub_ps(a[1], b[1]), _mm256_sub_ps(a[2], b[2])]
}

#[inline]
#[target_feature(enable = "avx2,fma")]
fn largest(v: [[__m256; 3]; 3]) -> __m256 {
    let absolute = |x: __m256| _mm256_andnot_ps(_mm256_set1_ps(-0.0), x);
    let of = |p: [__m256; 3]| _mm256_max_ps(_mm256_max_ps(absolute(p[0]), absolute(p[1])), absolute(p[2]));
    _mm256_max_ps(_mm256_max_ps(of(v[0]), of(v[1])), of(v[2]))
}

#[inline]
#[target_feature(enable = "avx2,fma")]
fn planes(block: &impl Triangles, origin: [f32; 3]) -> Planes {
    // SAFETY: this function's target features.
    let corner = |c: usize, axis: usize| unsafe { block.corner(c, axis) };
    let at = |c: usize| [corner(c, 0), corner(c, 1), corner(c, 2)];
    let corners = [at(0), at(1), at(2)];
    let origin = [_mm256_set1_ps(origin[0]), _mm256_set1_ps(origin[1]), _mm256_set1_ps(origin[2])];
    let [a, b, c] = [minus(corners[0], origin), minus(corners[1], origin), minus(corners[2], origin)];
    let [ea, eb, ec] =
        [minus(corners[1], corners[2]), minus(corners[2], corners[0]), minus(corners[0], corners[1])];
    let (far, long) = (largest([a, b, c]), largest([ea, eb, ec]));
    let sane = _mm256_cmp_ps::<_CMP_LT_OQ>(far, _mm256_set1_ps(LARGEST));
    let spread = _mm256_mul_ps(far, long);
    let error = _mm256_fmadd_ps(_mm256_set1_ps(EDGE_ERROR), spread, _mm256_set1_ps(f32::MIN_POSITIVE));
    let volume = _mm256_xor_ps(dot(a, cross(eb, ec)), _mm256_set1_ps(-0.0));
    Planes {
        normals: [cross(c, ea), cross(a, eb), cross(b, ec)],
        error: _mm256_blendv_ps(_mm256_set1_ps(f32::INFINITY), error, sane),
        volume,
        volume_error: _mm256_fmadd_ps(
            _mm256_set1_ps(VOLUME_ERROR),
            _mm256_mul_ps(spread, long),
            _mm256_set1_ps(DEPTH_UNDERFLOW),
        ),
        side: volume,
        reach: _mm256_mul_ps(_mm256_set1_ps(REACH), far),
        used: block.used(),
    }
}

/// What the filter compares, a triangle or a ray a lane.
struct Lanes {
    edges: [__m256; 3],
    error: __m256,
    volume: __m256,
    volume_error: __m256,
    side: __m256,
    reach: __m256,
    near: __m256,
    far: __m256,
}

#[inline]
#[target_feature(enable = "avx2,fma")]
fn decide(lanes: &Lanes, used: u8) -> BlockMask {
    let [u, v, w] = lanes.edges;
    let lowest = _mm256_min_ps(_mm256_min_ps(u, v), w);
    let highest = _mm256_max_ps(_mm256_max_ps(u, v), w);
    let minus_error = _mm256_xor_ps(lanes.error, _mm256_set1_ps(-0.0));
    let any_positive = _mm256_cmp_ps::<_CMP_GT_OQ>(highest, lanes.error);
    let any_negative = _mm256_cmp_ps::<_CMP_LT_OQ>(lowest, minus_error);
    let open = used & !(_mm256_movemask_ps(_mm256_and_ps(any_positive, any_negative)) as u8);
    if open == 0 {
        return BlockMask::default();
    }
    // A NaN among the edges, dropped by `min` and `max`, can't be: they are finite where the error is.
    let all_positive = _mm256_cmp_ps::<_CMP_GT_OQ>(lowest, lanes.error);
    let all_negative = _mm256_cmp_ps::<_CMP_LT_OQ>(highest, minus_error);
    let inside = open & _mm256_movemask_ps(_mm256_or_ps(all_positive, all_negative)) as u8;
    if inside == 0 {
        return BlockMask { certain: 0, uncertain: open };
    }
    // Edges of one sign: make it positive.
    let flip = _mm256_and_ps(all_negative, _mm256_set1_ps(-0.0));
    let sum = _mm256_xor_ps(_mm256_add_ps(_mm256_add_ps(u, v), w), flip);
    let relative =
        _mm256_fmadd_ps(_mm256_set1_ps(3.1), lanes.error, _mm256_mul_ps(_mm256_set1_ps(DEPTH_ERROR), sum));
    // Masks of lanes surely beyond and surely before the depth `z`; NaN is neither.
    let compare = |volume: __m256, z: __m256| {
        let bound = _mm256_fmadd_ps(z, relative, lanes.volume_error);
        let difference = _mm256_fnmadd_ps(z, sum, _mm256_xor_ps(volume, flip));
        let beyond = _mm256_cmp_ps::<_CMP_GT_OQ>(difference, bound);
        let before = _mm256_cmp_ps::<_CMP_LT_OQ>(difference, _mm256_xor_ps(bound, _mm256_set1_ps(-0.0)));
        (_mm256_movemask_ps(beyond) as u8, _mm256_movemask_ps(before) as u8)
    };
    let (after_near, before_near) = compare(lanes.side, lanes.near);
    let clear = _mm256_movemask_ps(_mm256_cmp_ps::<_CMP_LT_OQ>(lanes.reach, lanes.far)) as u8;
    let (after_far, before_far) = compare(lanes.volume, lanes.far);
    let (after_far, before_far) = (after_far & !clear, before_far | clear);
    let missed = inside & (before_near | after_far);
    let certain = inside & after_near & before_far;
    BlockMask { certain, uncertain: open & !certain & !missed }
}

#[inline]
#[target_feature(enable = "avx2,fma")]
fn filter(planes: &Planes, direction: [f32; 3], near: f32, far: f32) -> BlockMask {
    let d = [_mm256_set1_ps(direction[0]), _mm256_set1_ps(direction[1]), _mm256_set1_ps(direction[2])];
    let lanes = Lanes {
        edges: [dot(planes.normals[0], d), dot(planes.normals[1], d), dot(planes.normals[2], d)],
        error: planes.error,
        volume: planes.volume,
        volume_error: planes.volume_error,
        side: planes.side,
        reach: planes.reach,
        near: _mm256_set1_ps(near),
        far: _mm256_set1_ps(far),
    };
    decide(&lanes, planes.used)
}

#[inline]
#[target_feature(enable = "avx2,fma")]
fn filter_rays(
    planes: &scalar::Planes,
    lane: usize,
    direction: [&[f32; LANES]; 3],
    far: &[f32; LANES],
) -> BlockMask {
    let lane = lane % LANES;
    let d = [load(direction[0]), load(direction[1]), load(direction[2])];
    let edge = |k: usize| {
        let [x, y, z] = &planes.normals[k];
        dot([_mm256_set1_ps(x[lane]), _mm256_set1_ps(y[lane]), _mm256_set1_ps(z[lane])], d)
    };
    let lanes = Lanes {
        edges: [edge(0), edge(1), edge(2)],
        error: _mm256_set1_ps(planes.error[lane]),
        volume: _mm256_set1_ps(planes.volume[lane]),
        volume_error: _mm256_set1_ps(planes.volume_error[lane]),
        side: _mm256_set1_ps(planes.side[lane]),
        reach: _mm256_set1_ps(planes.reach[lane]),
        near: _mm256_setzero_ps(),
        far: load(far),
    };
    decide(&lanes, u8::MAX)
}

#[inline]
#[target_feature(enable = "avx2,fma")]
fn store_planes(planes: &Planes) -> scalar::Planes {
    let mut rows = scalar::Planes::EMPTY;
    for k in 0..3 {
        for axis in 0..3 {
            store(&mut rows.normals[k][axis], planes.normals[k][axis]);
        }
    }
    store(&mut rows.error, planes.error);
    store(&mut rows.volume, planes.volume);
    store(&mut rows.volume_error, planes.volume_error);
    store(&mut rows.side, planes.side);
    store(&mut rows.reach, planes.reach);
    rows.used = planes.used;
    rows
}

#[inline]
#[target_feature(enable = "avx2,fma")]
fn ask_sides(planes: &mut Planes, block: &impl Triangles, origin: [f32; 3], lanes: u8) {
    let mut row = [0.0; LANES];
    store(&mut row, planes.side);
    let (row, on) = scalar::sides(row, block, origin, lanes);
    planes.side = load(&row);
    planes.used &= !on;
}

impl Avx2 {
    /// Looks at `block` from the finite point `origin`.
    ///
    /// Fast only when inlined into a function with these target features.
    #[inline(always)]
    pub fn planes(self, block: &impl Triangles, origin: [f32; 3]) -> Planes {
        // SAFETY: `self` proves the target features.
        unsafe { planes(block, origin) }
    }

    /// See [`scalar::Planes::ask_sides`].
    #[inline(always)]
    pub fn ask_sides(self, planes: &mut Planes, block: &impl Triangles, origin: [f32; 3], lanes: u8) {
        // SAFETY: `self` proves the target features.
        unsafe { ask_sides(planes, block, origin, lanes) }
    }

    /// Filters a block for one prepared ray from the same origin; see the [module](super).
    ///
    /// Fast only when inlined into a function with these target features.
    #[inline(always)]
    pub fn fan_filter(self, planes: &Planes, direction: [f32; 3], near: f32, far: f32) -> BlockMask {
        // SAFETY: `self` proves the target features.
        unsafe { filter(planes, direction, near, far) }
    }

    /// The planes a row each, for [`Self::fan_rays`].
    #[inline(always)]
    pub fn store_planes(self, planes: &Planes) -> scalar::Planes {
        // SAFETY: `self` proves the target features.
        unsafe { store_planes(planes) }
    }

    /// As [`scalar::Planes::filter_rays`].
    ///
    /// Fast only when inlined into a function with these target features.
    #[inline(always)]
    pub fn fan_rays(
        self,
        planes: &scalar::Planes,
        lane: usize,
        direction: [&[f32; LANES]; 3],
        far: &[f32; LANES],
    ) -> BlockMask {
        // SAFETY: `self` proves the target features.
        unsafe { filter_rays(planes, lane, direction, far) }
    }
}
