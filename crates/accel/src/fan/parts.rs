//! Which rays of a slice walk together, and whether they need to walk at all.

use crate::{kernel::FAN, packet::PACKET};
use std::ops::Range;
use umbrage_geom::{
    Aabb, Ray,
    kernel::{larger, smaller},
};

/// A part of a slice of rays that is answered in one go.
pub(super) enum Part {
    /// Rays of one origin, [`FAN`] at most.
    Fan(Range<usize>),
    /// Rays of any origins, [`PACKET`] at most.
    Packet(Range<usize>),
}

/// Cuts a slice of rays into fans and packets.
pub(super) struct Parts<'a> {
    rays: &'a [Ray],
    at: usize,
    /// Rays of the fan that ended the last packet.
    fan: usize,
    /// Fewest rays of a fan.
    smallest: usize,
}

impl<'a> Parts<'a> {
    pub(super) fn new(rays: &'a [Ray], smallest: usize) -> Self {
        Self { rays, at: 0, fan: 0, smallest }
    }

    /// Rays from `at` whose origins have the same bits, up to [`FAN`].
    #[inline]
    fn same_origin(&self, at: usize) -> usize {
        let rays = &self.rays[at..self.rays.len().min(at + FAN)];
        let Some(first) = rays.first() else { return 0 };
        let differs = |ray: &Ray| {
            let bits = |axis: usize| ray.origin[axis].to_bits() ^ first.origin[axis].to_bits();
            bits(0) | bits(1) | bits(2)
        };
        let mut same = 0;
        // Eight at once while all are the same, without a branch for each.
        for eight in rays.chunks_exact(8) {
            if eight.iter().fold(0, |any, ray| any | differs(ray)) != 0 {
                break;
            }
            same += 8;
        }
        same + rays[same..].iter().take_while(|ray| differs(ray) == 0).count()
    }
}

impl Iterator for Parts<'_> {
    type Item = Part;

    #[inline]
    fn next(&mut self) -> Option<Part> {
        let start = self.at;
        let mut end = start;
        while self.fan == 0 && end < self.rays.len() && end - start < PACKET {
            let same = self.same_origin(end);
            if same >= self.smallest {
                self.fan = same;
            } else {
                end += same.min(PACKET - (end - start));
            }
        }
        if end > start {
            self.at = end;
            return Some(Part::Packet(start..end));
        }
        let fan = std::mem::take(&mut self.fan);
        self.at += fan;
        (fan > 0).then_some(Part::Fan(start..start + fan))
    }
}

/// Whether some ray of one origin may enter `bounds`; cheap, and asked only from outside.
///
/// A point that a ray reaches after `t` lies, on each axis, between `t` times the least and `t` times the greatest
/// direction. In `f64`, where nothing over- or underflows, with room for its roundings. NaN, in rays that miss anyway,
/// drops out or makes the answer true.
#[inline(always)]
pub(super) fn may_enter(rays: &[Ray], bounds: &Aabb) -> bool {
    let origin = rays[0].origin;
    if origin.cmpge(bounds.min).all() && origin.cmple(bounds.max).all() {
        return true;
    }
    let (mut least, mut most) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
    let mut far = 0.0;
    for ray in rays {
        let direction = ray.direction.to_array();
        for axis in 0..3 {
            least[axis] = smaller(direction[axis], least[axis]);
            most[axis] = larger(direction[axis], most[axis]);
        }
        far = larger(ray.tfar, far);
    }
    let (mut start, mut end) = (0.0, f64::from(far));
    for axis in 0..3 {
        let at = f64::from(origin[axis]);
        let (low, high) = (f64::from(bounds.min[axis]) - at, f64::from(bounds.max[axis]) - at);
        // Towards positive coordinates, and mirrored.
        for (low, most) in [(low, f64::from(most[axis])), (-high, -f64::from(least[axis]))] {
            // t * most >= low
            if most > 0.0 {
                start = f64::max(start, low / most * (1.0 - 1e-12));
            } else if low > 0.0 {
                return false;
            } else if most < 0.0 {
                end = f64::min(end, low / most * (1.0 + 1e-12));
            }
        }
    }
    start <= end
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use umbrage_geom::glam::Vec3;

    fn vector() -> impl Strategy<Value = Vec3> {
        let x = prop_oneof![4 => -1f32..1.0, 1 => (-2i8..3).prop_map(f32::from), 1 => Just(-0.0f32)];
        [x.clone(), x.clone(), x].prop_map(Vec3::from)
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(4000))]
        #[test]
        fn fans_that_reach_a_point_of_the_box_may_enter(
            origin in vector(),
            (a, b) in (vector(), vector()),
            others in prop::collection::vec(vector(), 0..9),
            at in [0f32..=1.0, 0f32..=1.0, 0f32..=1.0],
            (scale, extreme) in (prop::sample::select(vec![1f32, 2f32.powi(-60), 2f32.powi(60)]), prop::sample::select(vec![f32::NAN, 1e38, 1e-45])),
        ) {
            let bounds = Aabb { min: a.min(b), max: a.max(b) };
            // Exactly the point where the segment ends, which rounding may have moved out of the box.
            let direction = a.lerp(b, 0.5).with_x(a.x + (b.x - a.x) * at[0]) * (1.0 + at[1] + at[2]) - origin;
            let end = origin.as_dvec3() + direction.as_dvec3();
            let inside = end.cmpge(bounds.min.as_dvec3()).all() && end.cmple(bounds.max.as_dvec3()).all();
            // By a power of two, so that it still ends there.
            let mut rays = vec![Ray { origin, direction: direction * scale, tnear: 0.0, tfar: 1.001 / scale }];
            rays.extend(others.iter().map(|&d| Ray::new(origin, d)));
            rays.push(Ray::new(origin, Vec3::splat(extreme)).with_tfar(extreme));
            prop_assert!(!inside || may_enter(&rays, &bounds));
        }
    }

    #[test]
    fn fans_that_look_away_or_end_early_do_not_enter() {
        let bounds = Aabb { min: Vec3::ONE, max: Vec3::splat(2.0) };
        let fan = |towards: [f32; 3], tfar: f32| {
            let rays = [0f32, 0.1, 0.2]
                .map(|x| Ray::new(Vec3::ZERO, Vec3::from(towards) + Vec3::X * x).with_tfar(tfar));
            may_enter(&rays, &bounds)
        };
        assert!(fan([1.0; 3], 1.1));
        assert!(!fan([1.0; 3], 0.7));
        assert!(!fan([-1.0, 1.0, 1.0], f32::INFINITY));
        assert!(!fan([1.0, 0.0, 1.0], f32::INFINITY));
        assert!(!fan([1.0, 1.0, 0.3], f32::INFINITY));
        assert!(may_enter(&[Ray::new(Vec3::splat(1.5), Vec3::X)], &bounds));
    }
}
