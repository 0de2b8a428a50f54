//! As many rays as the error asks for.

mod common;

use common::{Scene, pattern, receivers, scene, soup};
use umbrage_aomask::{
    BackEnd, MaskError, MaskOptions, Outputs, PatternOptions,
    exact::{self, adaptive::Adaptive},
};
use umbrage_geom::Falloff;

/// Mean over several patterns of many rays.
fn truth(scene: &Scene, points: &common::Points, options: &MaskOptions) -> Vec<f64> {
    let mut sums = vec![0.0; points.0.len()];
    for seed in 0..4 {
        let many = PatternOptions::default().with_rays(1024).with_seed(seed);
        let pattern = umbrage_aomask::Pattern::new(&many).unwrap();
        let mut ao = vec![0.0; sums.len()];
        let outputs = Outputs::new(&mut ao);
        exact::answer(
            &scene.bvh,
            &pattern,
            &points.0,
            &points.1,
            &options.with_seed(seed),
            BackEnd::best(),
            outputs,
            &mut |_| true,
        )
        .unwrap();
        sums.iter_mut().zip(ao).for_each(|(sum, ao)| *sum += f64::from(ao) / 4.0);
    }
    sums
}

fn radius(scene: &Scene) -> f32 {
    0.1 * scene.mesh.bounds().diagonal()
}

fn options_of(seed: u32, radius: f32) -> MaskOptions {
    MaskOptions::default().with_radius(radius).with_seed(seed)
}

#[test]
fn the_target_is_met_with_fewer_rays_than_everywhere() {
    for (name, triangles) in [("bush", 6_000), ("city", 20_000), ("hairball", 6_000)] {
        let scene = scene(name, triangles);
        let points = receivers(&scene.mesh, 300, 7);
        let options = options_of(99, radius(&scene));
        let truth = truth(&scene, &points, &options);
        let adaptive = Adaptive::new(&PatternOptions::default().with_rays(1024)).unwrap();
        let mut last = 0;
        for target in [0.04, 0.02, 0.01] {
            let (mut ao, mut used) = (vec![0.0; 300], vec![0; 300]);
            let outputs = Outputs::new(&mut ao);
            adaptive
                .answer(
                    &scene.bvh,
                    &points.0,
                    &points.1,
                    &options,
                    target,
                    BackEnd::best(),
                    outputs,
                    &mut used,
                    &mut |_| true,
                )
                .unwrap();
            let rms = |values: &[f32]| {
                let squares = values.iter().zip(&truth).map(|(&a, b)| (f64::from(a) - b).powi(2));
                (squares.sum::<f64>() / 300.0).sqrt()
            };
            let total: u32 = used.iter().sum();
            println!("{name} {target}: rms {:.4}, {} rays on average", rms(&ao), total / 300);
            assert!(rms(&ao) < 1.2 * f64::from(target), "{name} {target}: {}", rms(&ao));
            assert!(total > last && total < 300 * 1024);
            last = total;
        }
    }
}

#[test]
fn settings_are_checked_and_sizes_may_be_odd() {
    let scene = soup(&[[[-1.0, 1.0, -1.0], [1.0, 1.0, -1.0], [0.0, 1.0, 2.0]]]);
    for rays in [32, 96, 1024] {
        let adaptive = Adaptive::new(&PatternOptions::default().with_rays(rays)).unwrap();
        let (points, normals) = ([[0.0; 3], [50.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]; 2]);
        let call = |target, outputs: Outputs<'_>, used: &mut [u32], go_on: bool| {
            let options = MaskOptions::default();
            adaptive.answer(
                &scene.bvh,
                &points,
                &normals,
                &options,
                target,
                BackEnd::best(),
                outputs,
                used,
                &mut |_| go_on,
            )
        };
        let (mut ao, mut used, mut bent, mut sectors) = ([-1.0; 2], [0; 2], [[0.0; 3]; 2], [0.0; 6]);
        let outputs = Outputs::new(&mut ao).with_bent_normals(&mut bent).with_sectors(3, &mut sectors);
        call(1e-9, outputs, &mut used, true).unwrap();
        assert_eq!(used, [rays; 2]);
        assert!(ao[0] < 0.8 && ao[1] == 1.0 && sectors.iter().all(|s| (0.0..=1.0).contains(s)));
        let mut plain = [0.0; 2];
        let pattern = pattern(rays, Falloff::Constant);
        exact::answer(
            &scene.bvh,
            &pattern,
            &points,
            &normals,
            &MaskOptions::default(),
            BackEnd::best(),
            Outputs::new(&mut plain),
            &mut |_| true,
        )
        .unwrap();
        assert_eq!(ao, plain);
        let before = ao;
        for target in [0.0, -1.0, f32::NAN] {
            let refused = call(target, Outputs::new(&mut ao), &mut used, true);
            assert!(matches!(refused, Err(MaskError::TargetError(_))));
        }
        assert_eq!(call(0.1, Outputs::new(&mut ao), &mut used, false), Err(MaskError::Cancelled));
        let masks = call(0.1, Outputs::new(&mut ao).with_masks(&mut [0; 2]), &mut used, true);
        assert!(matches!(masks, Err(MaskError::Unsupported(_))));
        let short = call(0.1, Outputs::new(&mut ao), &mut used[..1], true);
        assert!(matches!(short, Err(MaskError::Length { what: "used", .. })));
        assert_eq!(ao, before);
    }
}
