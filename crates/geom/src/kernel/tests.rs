//! What a filter calls certain, against the exact predicate.

use super::{
    fan::{CHUNK, FanRays},
    *,
};
use crate::segment_hits_triangle;
use glam::Vec3;
use proptest::prelude::*;

fn check_mask(
    block: &TriangleBlock,
    ray: &Ray,
    used: usize,
    mask: BlockMask,
    name: &str,
) -> Result<(), TestCaseError> {
    prop_assert_eq!(mask.certain & mask.uncertain, 0);
    prop_assert_eq!(u32::from(mask.certain | mask.uncertain) >> used, 0, "{}: an unused lane", name);
    for lane in 0..used {
        if mask.uncertain >> lane & 1 == 0 {
            let truth = segment_hits_triangle(ray, block.get(lane));
            prop_assert_eq!(mask.certain >> lane & 1 == 1, truth, "{} lane {}", name, lane);
        }
    }
    Ok(())
}

fn check(vertices: &[[f32; 3]], triangles: &[[u8; 3]], ray: &Ray) -> Result<(), TestCaseError> {
    let Some(prepared) = BlockRay::new(ray) else { return Ok(()) };
    let block = TriangleBlock::new(vertices, triangles).expect("few enough");
    check_mask(&block, ray, triangles.len(), scalar::filter(&block, &prepared), "scalar")?;
    #[cfg(target_arch = "x86_64")]
    if let Some(avx2) = crate::simd::Avx2::detect() {
        check_mask(&block, ray, triangles.len(), avx2.filter(&block, &prepared), "avx2")?;
    }
    let mut rays = FanRays::<CHUNK>::default();
    if rays.prepare(0, &[*ray]) == 1 {
        let (origin, d) = (ray.origin.to_array(), rays.direction.map(|row| row[0]));
        let planes = fan::scalar::Planes::new(&block, origin);
        let mask = planes.filter(d, rays.near[0], rays.far[0]);
        check_mask(&block, ray, triangles.len(), mask, "fan scalar")?;
        let transposed = |filter: &dyn Fn(usize) -> BlockMask| {
            let mut mask = BlockMask::default();
            for lane in 0..triangles.len() {
                let BlockMask { certain, uncertain } = filter(lane);
                // The ray is in all eight places.
                assert!([0, 255].contains(&certain) && [0, 255].contains(&uncertain));
                mask.certain |= (certain & 1) << lane;
                mask.uncertain |= (uncertain & 1) << lane;
            }
            mask
        };
        let (rows, far) = (d.map(|x| [x; LANES]), [rays.far[0]; LANES]);
        let rows = [&rows[0], &rows[1], &rows[2]];
        if ray.tnear == 0.0 {
            let mask = transposed(&|lane| planes.filter_rays(lane, rows, &far));
            check_mask(&block, ray, triangles.len(), mask, "rays scalar")?;
        }
        let all = (1u32 << triangles.len()).wrapping_sub(1) as u8;
        if ray.tnear == 0.0 {
            let mut asked = planes;
            asked.ask_sides(&block, origin, all);
            check_mask(&block, ray, triangles.len(), asked.filter(d, 0.0, rays.far[0]), "sides scalar")?;
        }
        let (front, back) = planes.sides();
        for lane in 0..triangles.len() {
            if let Some(hit) =
                crate::intersect_triangle(&Ray { tnear: 0.0, tfar: f32::INFINITY, ..*ray }, block.get(lane))
            {
                prop_assert_eq!(
                    (if hit.front { back } else { front }) >> lane & 1,
                    0,
                    "side of lane {}",
                    lane
                );
            }
        }
        #[cfg(target_arch = "x86_64")]
        if let Some(avx2) = crate::simd::Avx2::detect() {
            let mask = avx2.fan_filter(&avx2.planes(&block, origin), d, rays.near[0], rays.far[0]);
            check_mask(&block, ray, triangles.len(), mask, "fan avx2")?;
            if ray.tnear == 0.0 {
                let mut asked = avx2.planes(&block, origin);
                avx2.ask_sides(&mut asked, &block, origin, all);
                let mask = avx2.fan_filter(&asked, d, 0.0, rays.far[0]);
                check_mask(&block, ray, triangles.len(), mask, "sides avx2")?;
                let planes = avx2.store_planes(&avx2.planes(&block, origin));
                let mask = transposed(&|lane| avx2.fan_rays(&planes, lane, rows, &far));
                check_mask(&block, ray, triangles.len(), mask, "rays avx2")?;
            }
        }
    }
    Ok(())
}

fn coordinate() -> impl Strategy<Value = f32> {
    prop_oneof![
        6 => (-4i8..=4).prop_map(f32::from),
        4 => -1f32..1.0,
        1 => prop::sample::select(vec![
            1e-40f32, -1e-45, 1e12, -1e12, 1e-12, 1e20, 1e24, -1e24, -0.0, 16_777_216.0, 1.000_000_1,
        ]),
    ]
}

fn point() -> impl Strategy<Value = [f32; 3]> {
    [coordinate(), coordinate(), coordinate()]
}

fn ends() -> impl Strategy<Value = (f32, f32)> {
    let near = prop::sample::select(vec![0f32, 0.5, 1.0, 1e-42, 1e-30]);
    let far =
        prop::sample::select(vec![f32::INFINITY, 1.0, 2.0, 1.000_000_1, 0.999_999_94, 1e-3, 1e-44, 1e35]);
    (near, far)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(8000))]
    #[test]
    fn certain_answers_are_right(
        vertices in prop::collection::vec(point(), 8..=8),
        triangles in prop::collection::vec([0u8..8, 0u8..8, 0u8..8], 0..=8), o in point(), d in point(),
        (tnear, tfar) in ends(), scale in prop::sample::select(vec![1f32, 1e-40, 1e-38, 1e-20, 1e14]),
    ) {
        let direction = Vec3::from(d) * scale;
        check(&vertices, &triangles, &Ray { origin: o.into(), direction, tnear, tfar })?;
    }

    #[test]
    fn certain_answers_are_right_near_edges_and_ends(
        corners in [point(), point(), point()], o in point(), (u, v) in (-0.1f32..1.1, -0.1f32..1.1),
        onto in 0..4, (tnear, tfar) in ends(), nudge in -4i32..=4, far_away in prop::sample::select(vec![0f32, 1e3, 1e6]),
        size in prop::sample::select(vec![1f32, 1e-3, 1e9]),
    ) {
        // Aimed inside, at an edge, at a corner, or at the far edge, `far_away` from the origin, missed by a few roundings.
        let (u, v) = match onto { 0 => (u, v), 1 => (u, 0.0), 2 => (0.0, 0.0), _ => (u, 1.0 - u) };
        let shifted = corners.map(|p| p.map(|x| (x + far_away) * size));
        let [a, b, c] = shifted.map(Vec3::from);
        let o = (Vec3::from(o) + far_away) * size;
        let mut direction = a + (b - a) * u + (c - a) * v - o;
        direction.x += nudge as f32 * direction.x.abs() * f32::EPSILON;
        check(&shifted, &[[0, 1, 2]], &Ray { origin: o, direction, tnear, tfar })?;
    }
}

/// Share of lanes that the filters leave open when a triangle of size 0.01 is seen from a distance of 1.
#[test]
fn few_lanes_stay_open() {
    use rand_pcg::rand_core::Rng;
    let mut random = rand_pcg::Pcg32::new(1, 2);
    let mut uniform = || random.next_u32() as f32 / u32::MAX as f32 - 0.5;
    let (mut open, mut hits) = ([0; 2], [0; 2]);
    let mut rays = FanRays::<CHUNK>::default();
    for _ in 0..20_000 {
        let vertices = [0; LANES].map(|_| [uniform() * 0.01, uniform() * 0.01, 1.0 + uniform() * 0.01]);
        let triangles = [0, 1, 2, 3, 4, 5, 6, 7].map(|i| [i, (i + 1) % 8, (i + 3) % 8]);
        let block = TriangleBlock::new(&vertices, &triangles).unwrap();
        let ray = Ray::new([0.0; 3], [uniform() * 0.01, uniform() * 0.01, 1.0]);
        assert_eq!(rays.prepare(0, &[ray]), 1);
        let direction = rays.direction.map(|row| row[0]);
        let planes = fan::scalar::Planes::new(&block, [0.0; 3]);
        let masks = [
            scalar::filter(&block, &BlockRay::new(&ray).unwrap()),
            planes.filter(direction, rays.near[0], rays.far[0]),
        ];
        for (i, mask) in masks.into_iter().enumerate() {
            open[i] += mask.uncertain.count_ones();
            hits[i] += mask.certain.count_ones();
        }
    }
    assert!(hits.iter().all(|&hits| hits > 5000), "{hits:?}");
    assert!(open.iter().all(|&open| open < 800), "{open:?} of 160000");
}

#[test]
fn a_fan_takes_rays_it_can_scale_exactly() {
    let rays = [
        Ray::new([1.0; 3], [1.0, 2.0, -3.0]).with_tfar(7.0),
        Ray::new([1.0; 3], [f32::NAN, 2.0, -3.0]),
        Ray::new([1.0; 3], [0.0; 3]),
        Ray::new([1.0; 3], [1e-30, 0.0, 0.0]),
        Ray::new([1.0; 3], [0.0, 1e20, 0.0]).with_tfar(0.0),
        Ray { tnear: 1e-38, ..Ray::new([1.0; 3], [0.0, 1e-20, 0.0]) },
        Ray { tnear: f32::NAN, ..Ray::new([1.0; 3], [0.0, 1e-20, 0.0]) },
        Ray::new([1.0; 3], [f32::MAX, 0.0, 0.0]),
        Ray { tnear: 1.0, ..Ray::new([1.0; 3], [-0.0, -1.0, 0.0]) },
    ];
    let mut fan = FanRays::<CHUNK>::default();
    assert_eq!(fan.prepare(0, &rays), 0b1_0000_0001);
    assert_eq!((fan.direction[0][0], fan.direction[2][0], fan.far[0]), (0.125, -0.375, 56.0));
    assert_eq!(fan.negative.map(|row| row[8]), [1, 1, 0]);
}
