//! Few large boxes inside of a generator, from its voxels.

use super::{
    boxes::BoxPack,
    voxels::{Voxel, Voxels},
};
use umbrage_geom::{Aabb, Ray, SlabRay, glam::Vec3, sampling::RandomStream};

/// Candidates that are grown.
const CANDIDATES: usize = 512;

/// Lines that candidates are judged by.
const LINES: usize = 2048;

/// Boxes inside of a solid and how much of what crosses its bounds they stop.
#[derive(Clone, Debug, Default)]
pub(crate) struct Carved {
    /// Best first.
    pub(crate) boxes: Vec<Aabb>,
    /// Share of the lines through the bounds that some box stops.
    pub(crate) coverage: f32,
}

/// Sums of inside voxels over all boxes that start at the corner.
struct Sums<'a> {
    voxels: &'a Voxels,
    sums: Vec<u32>,
}

impl<'a> Sums<'a> {
    fn new(voxels: &'a Voxels) -> Self {
        let [nx, ny, nz] = voxels.size;
        let mut sums = vec![0u32; (nx + 1) * (ny + 1) * (nz + 1)];
        let at = |i: usize, j: usize, k: usize| (k * (ny + 1) + j) * (nx + 1) + i;
        for k in 0..nz {
            for j in 0..ny {
                let mut row = 0;
                for i in 0..nx {
                    row += u32::from(voxels.state([i, j, k]) == Voxel::Inside);
                    sums[at(i + 1, j + 1, k + 1)] =
                        row + sums[at(i + 1, j, k + 1)] + sums[at(i + 1, j + 1, k)] - sums[at(i + 1, j, k)];
                }
            }
        }
        Self { voxels, sums }
    }

    /// Whether all voxels of `low .. high` are inside.
    fn full(&self, low: [usize; 3], high: [usize; 3]) -> bool {
        let [nx, ny, _] = self.voxels.size;
        let at = |i: usize, j: usize, k: usize| self.sums[(k * (ny + 1) + j) * (nx + 1) + i];
        let layer = |k: usize| {
            at(high[0], high[1], k) + at(low[0], low[1], k) - at(low[0], high[1], k) - at(high[0], low[1], k)
        };
        let volume: usize = (0..3).map(|axis| high[axis] - low[axis]).product();
        (layer(high[2]) - layer(low[2])) as usize == volume
    }

    /// Moves the face of a box out as far as it goes, at most `limit` voxels; whether it moved.
    fn push(&self, low: &mut [usize; 3], high: &mut [usize; 3], axis: usize, up: bool, limit: usize) -> bool {
        let mut moved = false;
        for _ in 0..limit {
            let (mut l, mut h) = (*low, *high);
            if up {
                h[axis] += 1;
                l[axis] = high[axis];
            } else if low[axis] > 0 {
                l[axis] -= 1;
                h[axis] = low[axis];
            } else {
                break;
            }
            if h[axis] > self.voxels.size[axis] || l[axis] >= h[axis] || !self.full(l, h) {
                break;
            }
            (low[axis], high[axis]) = (low[axis].min(l[axis]), high[axis].max(h[axis]));
            moved = true;
        }
        moved
    }
}

/// Side of the largest cube of inside voxels that ends at each voxel.
fn cubes(voxels: &Voxels) -> Vec<u8> {
    let mut sides = vec![0u8; voxels.size.iter().product()];
    let [nx, ny, nz] = voxels.size;
    // The outermost layer is never inside.
    for k in 1..nz {
        for j in 1..ny {
            for i in 1..nx {
                if voxels.state([i, j, k]) != Voxel::Inside {
                    continue;
                }
                let before = [(1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 0), (1, 0, 1), (0, 1, 1), (1, 1, 1)];
                let least = before.iter().map(|&(a, b, c)| sides[voxels.index([i - a, j - b, k - c])]).min();
                sides[voxels.index([i, j, k])] = least.unwrap_or(0).saturating_add(1);
            }
        }
    }
    sides
}

/// Boxes that can't be grown, around the largest cubes.
fn maximal_boxes(voxels: &Voxels) -> Vec<Aabb> {
    let sums = Sums::new(voxels);
    let sides = cubes(voxels);
    let mut order: Vec<u32> = (0..sides.len() as u32).filter(|&v| sides[v as usize] > 0).collect();
    order.sort_by_key(|&v| std::cmp::Reverse(sides[v as usize]));
    let mut covered = vec![false; sides.len()];
    let mut boxes: Vec<Aabb> = Vec::new();
    for v in order {
        let (v, side) = (v as usize, usize::from(sides[v as usize]));
        let [nx, ny, _] = voxels.size;
        let end = [v % nx, v / nx % ny, v / nx / ny];
        let middle = end.map(|x| x + 1 - side.div_ceil(2));
        if covered[voxels.index(middle)] {
            continue;
        }
        let cube = (end.map(|x| x + 1 - side), end.map(|x| x + 1));
        // Evenly on all sides, and along each axis first.
        for way in 0..4 {
            let (mut low, mut high) = cube;
            if way > 0 {
                for axis in [way - 1, way % 3, (way + 1) % 3] {
                    sums.push(&mut low, &mut high, axis, true, usize::MAX);
                    sums.push(&mut low, &mut high, axis, false, usize::MAX);
                }
            } else {
                while (0..6)
                    .fold(false, |any, face| sums.push(&mut low, &mut high, face / 2, face % 2 == 0, 1) | any)
                {
                }
                // Seeds in it would grow to much the same box.
                for k in low[2]..high[2] {
                    for j in low[1]..high[1] {
                        for i in low[0]..high[0] {
                            covered[voxels.index([i, j, k])] = true;
                        }
                    }
                }
            }
            boxes.push(voxels.aabb(low, high));
        }
        if boxes.len() >= 4 * CANDIDATES {
            break;
        }
    }
    boxes.dedup();
    boxes
}

/// At most `count` random lines through `bounds`, by chords of the sphere around them.
pub(crate) fn lines(bounds: &Aabb, count: usize) -> Vec<SlabRay> {
    let mut random = RandomStream::new(5, 0);
    let (center, radius) = (bounds.center(), 0.5 * bounds.diagonal());
    let mut on_sphere = || {
        let (z, angle) = (2.0 * random.next_unit() - 1.0, std::f32::consts::TAU * random.next_unit());
        let r = (1.0 - z * z).max(0.0).sqrt();
        center + Vec3::new(r * angle.cos(), r * angle.sin(), z) * radius
    };
    let slabs = std::iter::repeat_with(|| SlabRay::new(&Ray::between(on_sphere(), on_sphere())));
    slabs
        .take(3 * count)
        .flatten()
        .filter(|slab| slab.entry(bounds, slab.tfar).is_some())
        .take(count)
        .collect()
}

/// At most `count` boxes, greedily those that stop most lines not stopped so far.
pub(crate) fn carve(voxels: &Voxels, bounds: &Aabb, count: usize) -> Carved {
    let candidates = maximal_boxes(voxels);
    let lines = lines(bounds, LINES);
    if candidates.is_empty() || lines.is_empty() {
        return Carved::default();
    }
    let words = lines.len().div_ceil(64);
    // Which lines each candidate stops.
    let mut stops = vec![vec![0u64; words]; candidates.len()];
    for (chunk, bits) in candidates.chunks(8).zip(stops.chunks_mut(8)) {
        let mut pack = BoxPack::<8>::EMPTY;
        chunk.iter().enumerate().for_each(|(i, aabb)| pack.set(i, aabb));
        for (l, slab) in lines.iter().enumerate() {
            let crossed = pack.surely_crossed(slab);
            bits.iter_mut()
                .enumerate()
                .for_each(|(i, bits)| bits[l / 64] |= u64::from(crossed >> i & 1) << (l % 64));
        }
    }
    let mut open = vec![u64::MAX; words];
    // Gains only shrink, so an old one bounds the new one.
    let mut gains: Vec<u32> = vec![u32::MAX; candidates.len()];
    let mut carved = Carved::default();
    let mut stopped = 0;
    while carved.boxes.len() < count {
        let mut best = (0, usize::MAX);
        for i in 0..candidates.len() {
            if gains[i] > best.0 {
                gains[i] = stops[i].iter().zip(&open).map(|(a, b)| (a & b).count_ones()).sum();
                if gains[i] > best.0 {
                    best = (gains[i], i);
                }
            }
        }
        if best.1 == usize::MAX {
            break;
        }
        stopped += best.0;
        open.iter_mut().zip(&stops[best.1]).for_each(|(open, stops)| *open &= !stops);
        carved.boxes.push(candidates[best.1]);
    }
    carved.coverage = stopped as f32 / lines.len() as f32;
    carved
}
