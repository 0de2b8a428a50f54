//! As many rays as the error asks for, measured against the reference.

mod common;

use common::{Points, Scene, receivers, scene, soup};
use umbrage_aomask::{
    MaskCall, MaskError, MaskOptions, Outputs, Pattern, PatternOptions, Receiver,
    exact::adaptive::{Adaptive, Spent},
};
use umbrage_geom::{Falloff, OpticalDepth};
use umbrage_reference::Question;

fn asked((points, normals): &Points) -> Vec<Receiver> {
    let receiver = |(i, (&p, &n)): (usize, (&[f32; 3], &[f32; 3]))| {
        Receiver::new(i, p, n, Receiver::seed_of(p, n, 99)).unwrap()
    };
    points.iter().zip(normals).enumerate().map(receiver).collect()
}

/// `ao` of all receivers and what it took.
fn answer(
    scene: &Scene,
    receivers: &[Receiver],
    radius: f32,
    target: f32,
    depth: Option<OpticalDepth>,
) -> (Vec<f32>, Spent) {
    let adaptive = Adaptive::new(&PatternOptions::default().with_rays(1024)).unwrap();
    let options = MaskOptions::default().with_radius(radius);
    let mut ao = vec![0.0; receivers.len()];
    let mut ask = |pattern: &Pattern,
                   receivers: &[Receiver],
                   outputs: Outputs<'_>,
                   progress: &mut (dyn FnMut(f32) -> bool + Send)| {
        let bvh = &scene.bvh;
        match depth {
            None => MaskCall::new(bvh, pattern, receivers, &options).answer(outputs, progress),
            Some(depth) => {
                MaskCall::new(bvh, pattern, receivers, &options).transmit(|_| depth, outputs, progress)
            }
        }
    };
    let spent = adaptive.answer(receivers, target, &mut ask, Outputs::new(&mut ao), &mut |_| true).unwrap();
    (ao, spent)
}

#[test]
fn targets_are_met_and_not_by_far() {
    for (name, triangles, share, opacity) in [
        ("bush", 6_000, 0.1, None),
        ("city", 20_000, 0.1, None),
        ("hairball", 6_000, f32::INFINITY, None),
        ("bush", 6_000, f32::INFINITY, Some(0.4)),
    ] {
        let scene = scene(name, triangles);
        let points = receivers(&scene.mesh, 1500, 7);
        let radius = share * scene.mesh.bounds().diagonal();
        let depth = opacity.map(OpticalDepth::from_opacity);
        let depths = depth.map_or(Vec::new(), |depth| vec![depth; scene.mesh.triangles.len()]);
        let question = Question {
            mesh: &scene.mesh,
            depths: &depths,
            points: &points.0,
            normals: &points.1,
            radius,
            falloff: &Falloff::Constant,
        };
        let reference = question.answer(3000, 1).unwrap();
        let receivers = asked(&points);
        let mut last = 0;
        for target in [0.04, 0.02] {
            let (ao, spent) = answer(&scene, &receivers, radius, target, depth);
            let rmse = reference.rmse(ao.iter().map(|&x| f64::from(x)));
            let bias = reference.bias(ao.iter().map(|&x| f64::from(x)));
            let per_receiver = spent.rays / 1500;
            println!(
                "{name} {share} {opacity:?} {target}: rmse {rmse:.4}, bias {bias:+.4}, {spent:?}, {per_receiver}"
            );
            let target = f64::from(target);
            assert!(rmse < target && rmse > 0.55 * target, "{name} {target}: {rmse}");
            let estimate = spent.estimated_error.unwrap();
            assert!((estimate / rmse - 1.0).abs() < 0.4, "{estimate}");
            // 1500 independent errors.
            let limit = 4.0 * target / 1500f64.sqrt() + 3.0 * reference.standard_error_of_mean();
            assert!(bias.abs() < limit, "{name} {target}: {bias}");
            assert!(spent.rays > last && spent.rays < 1500 * 1024);
            assert_eq!(spent.receivers.iter().map(|r| r.1).sum::<u64>(), 1500);
            last = spent.rays;
        }
    }
}

#[test]
fn settings_are_checked_and_sizes_may_be_odd() {
    let scene = soup(&[[[-1.0, 1.0, -1.0], [1.0, 1.0, -1.0], [0.0, 1.0, 2.0]]]);
    let receivers = asked(&(vec![[0.0; 3], [50.0, 0.0, 0.0]], vec![[0.0, 1.0, 0.0]; 2]));
    for rays in [8, 32, 96, 1024] {
        let adaptive = Adaptive::new(&PatternOptions::default().with_rays(rays)).unwrap();
        let call = |target, outputs: Outputs<'_>, go_on: bool| {
            let mut ask = |pattern: &Pattern,
                           receivers: &[Receiver],
                           outputs: Outputs<'_>,
                           progress: &mut (dyn FnMut(f32) -> bool + Send)| {
                let options = MaskOptions::default();
                MaskCall::new(&scene.bvh, pattern, receivers, &options).answer(outputs, progress)
            };
            let mut fractions = Vec::new();
            let spent = adaptive.answer(&receivers, target, &mut ask, outputs, &mut |fraction| {
                fractions.push(fraction);
                go_on
            });
            assert!(fractions.is_sorted() && (spent.is_err() || fractions.last() == Some(&1.0)));
            spent
        };
        let (mut ao, mut bent, mut sectors) = ([-1.0; 2], [[0.0; 3]; 2], [0.0; 6]);
        let outputs = Outputs::new(&mut ao).with_bent_normals(&mut bent).with_sectors(3, &mut sectors);
        let spent = call(1e-9, outputs, true).unwrap();
        assert_eq!(spent.receivers.last().unwrap().0, rays, "{spent:?}");
        assert!(ao[0] < 0.8 && ao[1] == 1.0 && sectors.iter().all(|s| (0.0..=1.0).contains(s)));
        let before = ao;
        for target in [0.0, -1.0, f32::NAN] {
            let refused = call(target, Outputs::new(&mut ao), true);
            assert!(matches!(refused, Err(MaskError::TargetError(_))));
        }
        assert_eq!(call(0.1, Outputs::new(&mut ao), false), Err(MaskError::Cancelled));
        let masks = call(0.1, Outputs::new(&mut ao).with_masks(&mut [0; 2]), true);
        assert!(matches!(masks, Err(MaskError::Unsupported(_))));
        assert_eq!(ao, before);
    }
    for rays in [4, 100, 2048] {
        let refused = Adaptive::new(&PatternOptions::default().with_rays(rays));
        assert!(matches!(refused, Err(MaskError::Rays { .. })));
    }
}
