//! The occluder cache: the last opaque cells that ended rays to a light (Djeu11, section 3.5).

use super::boxes::BoxPack;
use umbrage_geom::{Aabb, SlabRay};

/// Boxes that a light keeps (Djeu11, section 3.5).
const PLACES: usize = 4;

/// The most recently used occluders of one light, for one thread.
#[derive(Clone, Debug)]
pub struct OccluderCache {
    boxes: BoxPack<PLACES>,
    slots: [u32; PLACES],
    /// When each place was last used.
    used: [u32; PLACES],
    clock: u32,
    /// Whether something blocked the light's last ray: the next one is likely to fare the same.
    pub(super) blocked: bool,
}

impl Default for OccluderCache {
    fn default() -> Self {
        Self { boxes: BoxPack::EMPTY, slots: [u32::MAX; PLACES], used: [0; PLACES], clock: 0, blocked: false }
    }
}

impl OccluderCache {
    /// The slot of an occluder that the segment surely crosses, if there is one.
    #[inline(always)]
    pub fn find(&mut self, slab: &SlabRay) -> Option<u32> {
        let crossed = self.boxes.surely_crossed(slab);
        if crossed == 0 {
            return None;
        }
        let place = crossed.trailing_zeros() as usize % PLACES;
        self.touch(place);
        Some(self.slots[place])
    }

    /// Remembers the occluder in `slot` in place of the one that wasn't used for longest.
    #[inline]
    pub fn insert(&mut self, slot: u32, aabb: &Aabb) {
        let known = self.slots.iter().position(|&s| s == slot);
        let place = known.unwrap_or_else(|| {
            (1..PLACES)
                .fold(0, |oldest, place| if self.used[place] < self.used[oldest] { place } else { oldest })
        });
        self.slots[place] = slot;
        self.boxes.set(place, aabb);
        self.touch(place);
    }

    #[inline(always)]
    fn touch(&mut self, place: usize) {
        // A wrap of the clock makes the order wrong for a while, which costs time only.
        self.clock = self.clock.wrapping_add(1);
        self.used[place] = self.clock;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use umbrage_geom::{Ray, glam::Vec3};

    #[test]
    fn the_least_recently_used_occluder_goes() {
        let aabb =
            |i: u32| Aabb { min: Vec3::new(i as f32, 0.0, 0.0), max: Vec3::new(i as f32 + 1.0, 1.0, 1.0) };
        let through = |i: u32| SlabRay::new(&Ray::new([i as f32 + 0.5, 0.5, -1.0], [0.0, 0.0, 1.0])).unwrap();
        let mut cache = OccluderCache::default();
        assert_eq!(cache.find(&through(0)), None);
        (0..4).for_each(|i| cache.insert(i, &aabb(i)));
        assert_eq!(cache.find(&through(0)), Some(0));
        cache.insert(2, &aabb(2));
        cache.insert(4, &aabb(4));
        assert_eq!(
            [0, 1, 2, 3, 4].map(|i| cache.find(&through(i))),
            [Some(0), None, Some(2), Some(3), Some(4)]
        );
    }
}
