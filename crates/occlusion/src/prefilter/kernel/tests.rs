//! Back ends agree, bit for bit.

use super::*;
use proptest::prelude::*;
use umbrage_geom::Aabb;

fn coordinate() -> impl Strategy<Value = f32> {
    prop_oneof![4 => -2f32..2.0, 2 => (-4i8..5).prop_map(|i| f32::from(i) * 0.5), 1 => prop::sample::select(vec![-0.0, 1e-30f32, 1e12])]
}

fn point() -> impl Strategy<Value = [f32; 3]> {
    [coordinate(), coordinate(), coordinate()]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2000))]
    #[test]
    fn back_ends_agree(
        boxes in prop::collection::vec((point(), point()), 0..=8), o in point(), d in point(),
        reach in prop::sample::select(vec![0f32, 0.1, 4.0, f32::INFINITY]), whole in any::<bool>(),
        kappa in prop::sample::select(vec![0f32, 0.01, 1.0, f32::INFINITY]),
        tfar in prop::sample::select(vec![0.5f32, 1.0, f32::INFINITY]),
    ) {
        let aabbs: Vec<Aabb> = boxes.iter().map(|&(a, b)| Aabb::from_points(&[a, b])).collect();
        let node = Node::with_children(&aabbs, reach);
        let raise = if whole { Prepared::WHOLE } else { Prepared::FRACTION };
        if let Some(ray) = Prepared::new(&Ray::new(o, d).with_tfar(tfar), kappa, raise) {
            let sizes = Scalar.sizes(&node, ray.origin);
            let scalar = Scalar.step(&node, &ray, &sizes);
            prop_assert_eq!(scalar.stop & scalar.descend, 0);
            prop_assert!((scalar.stop | scalar.descend) >> aabbs.len() == 0);
            prop_assert!(scalar.fraction.iter().all(|f| (0.0..=1.0).contains(f)), "{:?}", scalar.fraction);
            #[cfg(target_arch = "x86_64")]
            if let Some(avx2) = umbrage_geom::kernel::x86::Avx2::detect() {
                let same = avx2.sizes(&node, ray.origin);
                prop_assert!((0..aabbs.len()).all(|i| same[i] == sizes[i] || same[i].is_nan() == sizes[i].is_nan()));
                let wide = avx2.step(&node, &ray, &same);
                prop_assert_eq!((wide.stop, wide.descend), (scalar.stop, scalar.descend));
                prop_assert_eq!(wide.fraction.map(f32::to_bits), scalar.fraction.map(f32::to_bits));
            }
        }
    }
}
