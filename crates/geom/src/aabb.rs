//! Axis-aligned boxes and a ray-slab test that cannot miss.

use crate::Ray;
use glam::{Vec3, Vec3A};

/// An axis-aligned box, faces included. Empty when `min > max` on some axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Aabb {
    /// Smallest coordinates.
    pub min: Vec3,
    /// Largest coordinates.
    pub max: Vec3,
}

impl Aabb {
    /// The box that holds nothing; the neutral element of [`Self::union`].
    pub const EMPTY: Self = Self { min: Vec3::INFINITY, max: Vec3::NEG_INFINITY };

    /// Smallest box around `points`.
    pub fn from_points(points: &[[f32; 3]]) -> Self {
        points.iter().fold(Self::EMPTY, |b, &p| b.with_point(p))
    }

    /// Smallest box around this one and `point`.
    #[must_use]
    #[inline]
    pub fn with_point(self, point: impl Into<Vec3>) -> Self {
        let point = point.into();
        Self { min: self.min.min(point), max: self.max.max(point) }
    }

    /// Smallest box around both.
    #[must_use]
    #[inline]
    pub fn union(self, other: Self) -> Self {
        Self { min: self.min.min(other.min), max: self.max.max(other.max) }
    }

    /// Whether no point is inside.
    #[inline]
    pub fn is_empty(&self) -> bool {
        !self.min.cmple(self.max).all()
    }

    /// Size along each axis; 0 for an empty box.
    #[inline]
    pub fn size(&self) -> Vec3 {
        if self.is_empty() { Vec3::ZERO } else { self.max - self.min }
    }

    /// Length of the diagonal; 0 for an empty box.
    pub fn diagonal(&self) -> f32 {
        self.size().as_dvec3().length() as f32
    }

    /// The middle of the box.
    pub fn center(&self) -> Vec3 {
        self.min + 0.5 * (self.max - self.min)
    }

    /// Surface area; 0 for an empty box.
    #[inline]
    pub fn area(&self) -> f32 {
        let s = self.size();
        2.0 * (s.x * s.y + s.y * s.z + s.z * s.x)
    }

    /// Whether some point of the ray's closed segment may be in the box. See [`SlabRay`].
    pub fn may_hit(&self, ray: &Ray) -> bool {
        SlabRay::new(ray).is_some_and(|slab| slab.entry(self, slab.tfar).is_some())
    }
}

/// A ray prepared for slab tests against boxes, scaled so that no rounding loses a box.
///
/// With `s` a power of two, `t` here is `s` times the ray's `t`. A box that the exact segment touches is always reported;
/// a box passed within a few units in the last place may be reported too.
///
/// # Why it can't miss (after Ize, Robust BVH Ray Traversal, JCGT 2(2), 2013)
/// Coordinates are at most [`MAX_COORDINATE`](crate::mesh::MAX_COORDINATE) and the largest direction component is
/// scaled into `[2^-40, 2^-39)`, so every `t` is 0 or at least `2^-149 * 2^39`, normal, and finite wherever the exact
/// one is below `2^127`. The computed `(plane - origin) * inv` then carries three relative roundings of at most `2^-24`
/// (difference, reciprocal, product); `inv_near` is shrunk and `inv_far` grown by `2^-21`, which is more than their
/// sum. Reciprocals of components below `2^-120` are bounded towards the safe side: `inv_near` stays finite, `inv_far`
/// becomes infinite. `0 * infinity` (a ray in the plane of a face) gives NaN, which `min` and `max` drop: the box stays.
#[derive(Clone, Copy, Debug)]
pub struct SlabRay {
    /// Origin seen by near planes: the ray's, moved forward by the padding.
    pub origin_near: Vec3,
    /// Origin seen by far planes: the ray's, moved back by the padding.
    pub origin_far: Vec3,
    /// Reciprocal direction for near planes, rounded towards 0.
    pub inv_near: Vec3,
    /// Reciprocal direction for far planes, rounded away from 0.
    pub inv_far: Vec3,
    /// Start of the segment in scaled `t`, rounded down.
    pub tnear: f32,
    /// End of the segment in scaled `t`, rounded up.
    pub tfar: f32,
    /// What the ray's `t` is multiplied by, as two powers of two.
    scale: [f32; 2],
}

impl SlabRay {
    /// Prepares `ray`; `None` if it is not [valid](Ray::is_valid), which is a miss.
    #[inline(always)]
    pub fn new(ray: &Ray) -> Option<Self> {
        Self::with_padding(ray, Vec3::ZERO)
    }

    /// Like [`Self::new`], with every box grown by `padding` (world units, at least 0) on each side.
    #[inline(always)]
    pub fn with_padding(ray: &Ray, padding: Vec3) -> Option<Self> {
        if !ray.is_valid() {
            return None;
        }
        let largest = ray.direction.abs().max_element();
        let exponent = (largest.to_bits() >> 23) as i32 - 127;
        let (d, scale) = if (-86..=86).contains(&exponent) {
            (ray.direction * power_of_two(-40 - exponent), [power_of_two(40 + exponent), 1.0])
        } else {
            scale_extreme(ray.direction, largest)
        };
        let tnear = (ray.tnear * scale[0] * scale[1]).min(f32::MAX) * (1.0 - 2f32.powi(-21));
        let d = Vec3A::from(d);
        let magnitude = d.abs();
        let inverse = magnitude.recip();
        let near = inverse.min(Vec3A::splat(2f32.powi(119))) * (1.0 - 2f32.powi(-21));
        let tiny = magnitude.cmplt(Vec3A::splat(2f32.powi(-120)));
        let far = Vec3A::select(tiny, Vec3A::INFINITY, inverse * (1.0 + 2f32.powi(-21)));
        let origin = Vec3A::from(ray.origin);
        let (mut origin_near, mut origin_far) = (origin, origin);
        if padding != Vec3::ZERO {
            // Rounded outwards by one more unit in the last place of the larger term.
            let pad = Vec3A::from(padding) + origin.abs() * f32::EPSILON;
            let pad = Vec3A::select(Vec3A::from(padding).cmpgt(Vec3A::ZERO), pad, Vec3A::ZERO).copysign(d);
            origin_near += pad;
            origin_far -= pad;
        }
        let mut slab = Self {
            origin_near: origin_near.into(),
            origin_far: origin_far.into(),
            inv_near: near.copysign(d).into(),
            inv_far: far.copysign(d).into(),
            tnear: if tnear < f32::MIN_POSITIVE { 0.0 } else { tnear },
            tfar: 0.0,
            scale,
        };
        slab.tfar = slab.scaled_tfar(ray.tfar);
        Some(slab)
    }

    /// The ray's `t` as an end of the segment in scaled `t`, rounded up.
    #[inline]
    pub fn scaled_tfar(&self, t: f32) -> f32 {
        (t * self.scale[0] * self.scale[1] * (1.0 + 2f32.powi(-21))).max(f32::MIN_POSITIVE)
    }

    /// Scaled `t` where the segment up to `tfar` (scaled) enters `aabb`, at least `self.tnear` and never too large;
    /// `None` if it surely stays outside.
    #[inline]
    pub fn entry(&self, aabb: &Aabb, tfar: f32) -> Option<f32> {
        let (mut t0, mut t1) = (self.tnear, tfar);
        for axis in 0..3 {
            let forward = self.inv_near[axis] >= 0.0;
            let (near, far) =
                if forward { (aabb.min[axis], aabb.max[axis]) } else { (aabb.max[axis], aabb.min[axis]) };
            // `max` and `min` return the other operand for NaN.
            t0 = t0.max((near - self.origin_near[axis]) * self.inv_near[axis]);
            t1 = t1.min((far - self.origin_far[axis]) * self.inv_far[axis]);
        }
        (t0 <= t1).then_some(t0)
    }

    /// Whether the open segment surely has a point strictly inside `aabb`: never true without one, false for some that have
    /// one by a few units in the last place.
    ///
    /// The bounds of [`Self::entry`] the other way round: near planes with the reciprocal that is too large, far planes with
    /// the one that is too small. A ray in the plane of a face gives NaN, which is no crossing.
    #[inline]
    pub fn surely_crosses(&self, aabb: &Aabb) -> bool {
        // What scaling rounded off the ends, and what it flushed to 0.
        let mut entries = [0.0; 3];
        let mut exits = [0.0; 3];
        for axis in 0..3 {
            let forward = self.inv_near[axis] >= 0.0;
            let (near, far) =
                if forward { (aabb.min[axis], aabb.max[axis]) } else { (aabb.max[axis], aabb.min[axis]) };
            entries[axis] = (near - self.origin_near[axis]) * self.inv_far[axis];
            exits[axis] = (far - self.origin_far[axis]) * self.inv_near[axis];
        }
        let t0 = (self.tnear * (1.0 + 2f32.powi(-19))).max(2f32.powi(-100));
        let t1 = self.tfar * (1.0 - 2f32.powi(-19));
        let before = |t: f32| entries[0] < t && entries[1] < t && entries[2] < t;
        t0 < t1 && before(t1) && exits.iter().all(|&exit| t0 < exit && before(exit))
    }
}

/// `2^exponent`, for exponents of normal numbers.
#[inline(always)]
fn power_of_two(exponent: i32) -> f32 {
    f32::from_bits(((exponent + 127) as u32) << 23)
}

/// The direction scaled so that its `largest` component is in `[2^-40, 2^-39)`, and what `t` is multiplied by, in two
/// factors: one power of two can't carry a denormal direction, or one of `2^127`, so far. All steps are exact.
#[cold]
fn scale_extreme(direction: Vec3, largest: f32) -> (Vec3, [f32; 2]) {
    let lift = if largest < f32::MIN_POSITIVE { 64 } else { 0 };
    let exponent = ((largest * power_of_two(lift)).to_bits() >> 23) as i32 - 127;
    let shift = (-40 - exponent).clamp(-126, 126);
    let rest = -40 - exponent - shift;
    let scaled = direction * power_of_two(lift) * power_of_two(shift) * power_of_two(rest);
    (scaled, [power_of_two(-lift - shift), power_of_two(-rest)])
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use umbrage_testkit::{Segment, segment_meets_interior, segment_touches_box};

    fn segment(ray: &Ray) -> Segment {
        Segment {
            origin: ray.origin.to_array(),
            direction: ray.direction.to_array(),
            ends: [ray.tnear, ray.tfar],
        }
    }

    fn touches_exactly(ray: &Ray, aabb: &Aabb) -> bool {
        segment_touches_box(&segment(ray), [aabb.min, aabb.max].map(|v| v.to_array()))
    }

    fn crosses_exactly(ray: &Ray, aabb: &Aabb) -> bool {
        segment_meets_interior(&segment(ray), [aabb.min, aabb.max].map(|v| v.to_array()))
    }

    fn nasty() -> impl Strategy<Value = f32> {
        prop_oneof![
            4 => -2f32..2.0,
            1 => prop::sample::select(vec![0.0, -0.0, 1.0, -1.0, 0.5, 1e-30, -1e-30, 1e-45, 3e-39, 1e12, -1e20]),
            1 => (-4i8..5).prop_map(|i| f32::from(i) * 0.25),
        ]
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(4000))]
        #[test]
        fn a_touched_box_is_never_missed(
            o in [nasty(), nasty(), nasty()], d in [nasty(), nasty(), nasty()],
            a in [nasty(), nasty(), nasty()], b in [nasty(), nasty(), nasty()],
            tnear in prop_oneof![Just(0f32), 0f32..2.0],
            length in prop_oneof![Just(f32::INFINITY), 0f32..4.0, Just(1e-42f32), Just(1e30f32)],
            scale in prop::sample::select(vec![1f32, 1e-38, 1e-44, 1e30, 1e18]),
        ) {
            let direction = Vec3::from(d) * scale;
            let ray = Ray { origin: o.into(), direction, tnear, tfar: tnear + length };
            let aabb = Aabb::EMPTY.with_point(a).with_point(b);
            prop_assume!(ray.is_valid());
            prop_assert!(aabb.may_hit(&ray) || !touches_exactly(&ray, &aabb));
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(6000))]
        #[test]
        fn a_sure_crossing_is_one(
            o in [nasty(), nasty(), nasty()], d in [nasty(), nasty(), nasty()],
            a in [nasty(), nasty(), nasty()], b in [nasty(), nasty(), nasty()],
            tnear in prop_oneof![Just(0f32), 0f32..2.0, Just(1e-40f32)],
            length in prop_oneof![Just(f32::INFINITY), 0f32..4.0, Just(1e-42f32), Just(1e30f32)],
            scale in prop::sample::select(vec![1f32, 1e-38, 1e-44, 1e30, 1e18]),
        ) {
            let ray = Ray { origin: o.into(), direction: Vec3::from(d) * scale, tnear, tfar: tnear + length };
            let aabb = Aabb::EMPTY.with_point(a).with_point(b);
            prop_assume!(ray.is_valid());
            let slab = SlabRay::new(&ray).unwrap();
            prop_assert!(!slab.surely_crosses(&aabb) || crosses_exactly(&ray, &aabb));
            // Sure crossings are most crossings: those by more than rounding are found.
            let size = aabb.max - aabb.min;
            let core = Aabb { min: aabb.min + size * 0.01, max: aabb.max - size * 0.01 };
            let sane = size.min_element() > 1e-3 && scale == 1.0 && Vec3::from(d).abs().max_element() > 1e-3
                && Vec3::from(o).abs().max_element() < 1e3 && length > 1e-3;
            let shorter = Ray { tnear: tnear + 1e-5, tfar: ray.tfar * 0.999_99, ..ray };
            if sane && shorter.is_valid() && crosses_exactly(&shorter, &core) {
                prop_assert!(slab.surely_crosses(&aabb));
            }
        }
    }

    proptest! {
        /// What the proof takes for granted: how far ends and reciprocals are rounded, and to which side.
        #[test]
        fn numbers_are_rounded_to_the_safe_side(
            d in [nasty(), nasty(), nasty()], tnear in prop_oneof![Just(0f32), 1e-3f32..2.0], length in 1e-3f32..4.0,
            scale in prop::sample::select(vec![1f32, 1e-30, 1e18]),
        ) {
            let ray = Ray { origin: Vec3::ZERO, direction: Vec3::from(d) * scale, tnear, tfar: tnear + length };
            prop_assume!(ray.is_valid());
            let slab = SlabRay::new(&ray).unwrap();
            // Exact: powers of two.
            let scale = f64::from(slab.scale[0]) * f64::from(slab.scale[1]);
            // Margins between a quarter of `2^-21` and twice that.
            let below = |x: f32, exact: f64| {
                let share = (exact - f64::from(x)) / exact;
                (2f64.powi(-23)..2f64.powi(-20)).contains(&share)
            };
            let above = |x: f32, exact: f64| {
                let share = (f64::from(x) - exact) / exact;
                (2f64.powi(-23)..2f64.powi(-20)).contains(&share)
            };
            // Ends beyond the range of numbers stay at its ends.
            let usual = |end: f64| (2f64.powi(-100)..2f64.powi(126)).contains(&end);
            let (start, end) = (f64::from(tnear) * scale, f64::from(ray.tfar) * scale);
            prop_assert!(!usual(start) || below(slab.tnear, start), "{} {}", slab.tnear, start);
            prop_assert!(tnear > 0.0 || slab.tnear == 0.0);
            prop_assert!(!usual(end) || above(slab.tfar, end), "{} {}", slab.tfar, end);
            for axis in 0..3 {
                let size = f64::from(ray.direction[axis].abs()) / scale;
                let (near, far) = (slab.inv_near[axis].abs(), slab.inv_far[axis].abs());
                prop_assert!(near.is_finite() && near < far);
                if size >= 2f64.powi(-118) {
                    prop_assert!(below(near, 1.0 / size) && above(far, 1.0 / size), "{} {} {}", near, far, 1.0 / size);
                }
            }
        }

        /// Boxes that end where the segment starts, and boxes that start where it ends: nothing but rounding to the safe side
        /// finds them.
        #[test]
        fn boxes_that_meet_an_end_are_found(
            direction in (1u32..1 << 12).prop_map(|x| x as f32), t in (1u32..1 << 12).prop_map(|x| x as f32), axis in 0usize..3,
            across in prop::array::uniform2(-1e-3f32..1e-3),
        ) {
            let mut d = [across[0], across[1], 0.0];
            d.swap(2, axis);
            d[axis] = direction;
            // A product of 24 bits, exact.
            let face = direction * t;
            let ray = Ray::new([0.0; 3], d);
            let side = |low: f32, high: f32| {
                let (mut min, mut max) = ([-1e30; 3], [1e30; 3]);
                (min[axis], max[axis]) = (low, high);
                Aabb { min: min.into(), max: max.into() }
            };
            let after = Ray { tnear: t, ..ray };
            prop_assert!(side(-1.0, face).may_hit(&after) && side(face, face).may_hit(&after));
            let before = ray.with_tfar(t);
            prop_assert!(side(face, 1e30).may_hit(&before) && side(face, face).may_hit(&before));
        }
    }

    #[test]
    fn far_away_and_empty_boxes_are_missed() {
        let unit = Aabb::from_points(&[[0.0; 3], [1.0; 3]]);
        assert!(!unit.may_hit(&Ray::new([2.0, 2.0, 2.0], [1.0, 1.0, 1.0])));
        assert!(!unit.may_hit(&Ray::new([-1.0, 0.5, 0.5], [1.0, 0.0, 0.0]).with_tfar(0.5)));
        assert!(unit.may_hit(&Ray::new([-1.0, 0.5, 0.5], [1.0, 0.0, 0.0]).with_tfar(1.0)));
        assert!(!Aabb::EMPTY.may_hit(&Ray::new([0.0; 3], [1.0, 1.0, 1.0])));
        assert!(!unit.may_hit(&Ray::new([f32::NAN; 3], [1.0, 1.0, 1.0])));
        assert!(!unit.may_hit(&Ray::new([-1.0, 2.0, 0.5], [1.0, 0.0, 0.0])));
    }

    #[test]
    fn padding_grows_boxes() {
        let unit = Aabb::from_points(&[[0.0; 3], [1.0; 3]]);
        let ray = Ray::new([-1.0, 1.05, 0.5], [1.0, 0.0, 0.0]);
        let entry =
            |pad: f32| SlabRay::with_padding(&ray, Vec3::splat(pad)).unwrap().entry(&unit, f32::INFINITY);
        assert!(entry(0.0).is_none());
        assert!(entry(0.1).is_some());
    }
}
