//! A few boxes tested together.

use umbrage_geom::{Aabb, SlabRay};

/// `N` boxes, one a lane. Empty places have boxes that no ray crosses.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(32))]
pub struct BoxPack<const N: usize> {
    min: [[f32; N]; 3],
    max: [[f32; N]; 3],
}

impl<const N: usize> BoxPack<N> {
    /// No box.
    pub const EMPTY: Self = Self { min: [[f32::INFINITY; N]; 3], max: [[f32::NEG_INFINITY; N]; 3] };

    /// Puts a box into place `lane`.
    ///
    /// # Panics
    /// If `lane` is not below `N`.
    pub fn set(&mut self, lane: usize, aabb: &Aabb) {
        for axis in 0..3 {
            self.min[axis][lane] = aabb.min[axis];
            self.max[axis][lane] = aabb.max[axis];
        }
    }

    /// Bit `i` is set if [`SlabRay::surely_crosses`] is true for box `i`.
    #[inline(always)]
    pub fn surely_crossed(&self, slab: &SlabRay) -> u32 {
        let start = (slab.tnear * (1.0 + 2f32.powi(-19))).max(2f32.powi(-100));
        let end = slab.tfar * (1.0 - 2f32.powi(-19));
        let (mut entry, mut exit) = ([start; N], [end; N]);
        for axis in 0..3 {
            let forward = slab.inv_near[axis] >= 0.0;
            let (near, far) =
                if forward { (&self.min[axis], &self.max[axis]) } else { (&self.max[axis], &self.min[axis]) };
            for i in 0..N {
                let a = (near[i] - slab.origin_near[axis]) * slab.inv_far[axis];
                let b = (far[i] - slab.origin_far[axis]) * slab.inv_near[axis];
                // A ray in the plane of a face doesn't cross the box: NaN is an entry behind every exit.
                let a = if a.is_nan() { f32::INFINITY } else { a };
                entry[i] = if a > entry[i] { a } else { entry[i] };
                exit[i] = if b < exit[i] { b } else { exit[i] };
            }
        }
        (0..N).fold(0, |mask, i| mask | u32::from(entry[i] < exit[i]) << i)
    }

    /// Bit `i` is set if the segment may touch box `i`; conservative.
    #[inline(always)]
    pub fn touched(&self, slab: &SlabRay) -> u32 {
        let (mut entry, mut exit) = ([slab.tnear; N], [slab.tfar; N]);
        for axis in 0..3 {
            let forward = slab.inv_near[axis] >= 0.0;
            let (near, far) =
                if forward { (&self.min[axis], &self.max[axis]) } else { (&self.max[axis], &self.min[axis]) };
            for i in 0..N {
                let a = (near[i] - slab.origin_near[axis]) * slab.inv_near[axis];
                let b = (far[i] - slab.origin_far[axis]) * slab.inv_far[axis];
                entry[i] = if a > entry[i] { a } else { entry[i] };
                exit[i] = if b < exit[i] { b } else { exit[i] };
            }
        }
        (0..N).fold(0, |mask, i| mask | u32::from(entry[i] <= exit[i]) << i)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use umbrage_geom::{Ray, glam::Vec3};

    fn number() -> impl Strategy<Value = f32> {
        prop_oneof![3 => -2f32..2.0, 2 => (-2i8..=2).prop_map(f32::from), 1 => prop::sample::select(vec![-0.0f32, 1e-40])]
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(2000))]
        #[test]
        fn packs_answer_like_single_boxes(
            o in [number(), number(), number()], d in [number(), number(), number()],
            corners in prop::collection::vec([number(), number(), number()], 8),
            tnear in prop_oneof![Just(0f32), 0f32..1.0], length in prop_oneof![Just(f32::INFINITY), 0f32..3.0],
        ) {
            let ray = Ray { origin: o.into(), direction: Vec3::from(d), tnear, tfar: tnear + length };
            prop_assume!(ray.is_valid());
            let slab = SlabRay::new(&ray).unwrap();
            let mut pack = BoxPack::<4>::EMPTY;
            for lane in 0..3 {
                let aabb = Aabb::from_points(&corners[2 * lane..2 * lane + 2]);
                pack.set(lane, &aabb);
                prop_assert_eq!(pack.surely_crossed(&slab) >> lane & 1 == 1, slab.surely_crosses(&aabb));
                prop_assert_eq!(pack.touched(&slab) >> lane & 1 == 1, slab.entry(&aabb, slab.tfar).is_some());
            }
            prop_assert_eq!((pack.surely_crossed(&slab) | pack.touched(&slab)) >> 3, 0);
        }
    }
}
