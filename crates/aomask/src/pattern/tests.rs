use super::*;
use proptest::prelude::*;

fn pattern(rays: u32) -> Pattern {
    Pattern::new(&PatternOptions::default().with_rays(rays)).unwrap()
}

#[test]
fn sizes_jitters_and_tables_are_checked() {
    let options = PatternOptions::default();
    for rays in [0, 1, 33, 1056, u32::MAX] {
        assert_eq!(Pattern::new(&options.clone().with_rays(rays)), Err(MaskError::Rays(rays)));
    }
    for (rotation, tilt, what) in [
        (-0.1, 0.0, "rotation"),
        (f32::NAN, 0.0, "rotation"),
        (0.0, 1.0, "tilt"),
        (0.0, f32::INFINITY, "tilt"),
    ] {
        let error = Pattern::new(&options.clone().with_jitter(rotation, tilt)).unwrap_err();
        assert!(matches!(error, MaskError::Jitter { what: w, .. } if w == what), "{error}");
    }
    for bad in [vec![0.2, 0.4], vec![1.0, f32::NAN], vec![1.0]] {
        let error = Pattern::new(&options.clone().with_falloff(Falloff::Table(bad))).unwrap_err();
        assert!(matches!(error, MaskError::Falloff(_)));
    }
}

#[test]
fn directions_are_cosine_weighted() {
    for rays in [32, 96, 128, 1024] {
        let pattern = pattern(rays);
        assert_eq!(pattern.len(), rays as usize);
        let n = rays as f32;
        let mean = pattern.directions().iter().sum::<Vec3>() / n;
        // Mean of the cosine, weighted by the cosine: 2/3.
        assert!((mean - Vec3::Z * (2.0 / 3.0)).length() < 4.0 / n, "{rays}: {mean}");
        let squares = pattern.directions().iter().map(|d| *d * *d).sum::<Vec3>() / n;
        assert!((squares - Vec3::new(0.25, 0.25, 0.5)).length() < 3.0 / n, "{rays}: {squares}");
    }
}

#[test]
fn groups_are_compact() {
    for (rays, group) in [(128, 8), (256, 8), (1024, 16), (1024, 32)] {
        let pattern = pattern(rays);
        for run in pattern.directions().chunks(group) {
            let mean = run.iter().sum::<Vec3>().normalize();
            // A round patch that holds the group's share of the disc, times 2.5 for shape and the slope at the rim.
            let radius = 2.5 * (group as f32 / rays as f32).sqrt();
            assert!(run.iter().all(|d| d.distance(mean) < radius), "{rays} in groups of {group}");
        }
    }
}

#[test]
fn lengths_follow_the_falloff() {
    for falloff in ["linear", "quadratic", "exponential", "1,0.7,0.7,0.1,0", "0.5,0.25"] {
        let falloff: Falloff = falloff.parse().unwrap();
        let pattern =
            Pattern::new(&PatternOptions::default().with_rays(96).with_falloff(falloff.clone())).unwrap();
        assert!(!pattern.has_equal_lengths());
        for x in [0.01, 0.1, 0.33, 0.5, 0.77, 0.99] {
            let longer = pattern.lengths().iter().filter(|&&l| l > x).count() as f32 / 96.0;
            assert!((longer - falloff.weight(x)).abs() < 0.6 / 96.0, "{falloff:?} at {x}: {longer}");
        }
        // Neighbours differ: each group of 8 has both halves of the distribution.
        let mut sorted = pattern.lengths().to_vec();
        sorted.sort_by(f32::total_cmp);
        for group in pattern.lengths().chunks(8) {
            assert!(group.iter().filter(|&&l| l <= sorted[47]).count() >= 3);
        }
    }
    assert!(pattern(64).has_equal_lengths());
}

#[test]
fn the_same_options_give_the_same_pattern() {
    let options = PatternOptions::default().with_rays(64);
    assert_eq!(Pattern::new(&options), Pattern::new(&options));
    assert_ne!(Pattern::new(&options), Pattern::new(&options.with_seed(1)));
}

proptest! {
    #[test]
    fn rays_stay_above_the_tangent_plane(
        normal in prop::array::uniform3(-1f32..1.0), seed: u32, rays in prop::sample::select(vec![32u32, 128]),
    ) {
        prop_assume!(Vec3::from(normal).length() > 1e-3);
        let receiver = Receiver::new(0, [1.0, 2.0, 3.0], normal, seed).unwrap();
        let pattern = pattern(rays);
        let frame = pattern.frame_of(&receiver);
        for (a, b) in [
            (frame.tangent, frame.bitangent),
            (frame.bitangent, frame.normal),
            (frame.normal, frame.tangent),
        ] {
            prop_assert!(a.dot(b).abs() < 1e-6 && (a.length() - 1.0).abs() < 1e-6);
        }
        for ray in pattern.rays_of(&receiver, 2.5) {
            prop_assert!(ray.direction.dot(receiver.normal()) > 1e-3);
            prop_assert!((ray.direction.length() - 1.0).abs() < 1e-6);
            prop_assert!(ray.is_valid() && ray.tfar == 2.5 && ray.origin == receiver.point());
        }
    }
}

#[test]
fn jitters_differ_between_receivers_and_can_be_off() {
    let frames = |pattern: &Pattern| -> Vec<Frame> {
        (0..64)
            .map(|seed| pattern.frame_of(&Receiver::new(0, [0.0; 3], [0.0, 0.0, 1.0], seed).unwrap()))
            .collect()
    };
    let jittered = frames(&pattern(128));
    let turned = jittered.iter().filter(|f| f.tangent.y.abs() > 0.1).count();
    assert!(turned > 10 && jittered.iter().all(|f| f.normal.z > 0.9 && f.normal.z < 1.0));
    let off = frames(&Pattern::new(&PatternOptions::default().with_jitter(0.0, 0.0)).unwrap());
    assert!(off.iter().all(|f| f.normal == Vec3::Z && f.tangent == Vec3::X));
    // Signs of zero choose a frame: they must not come from the jitter.
    let off = Pattern::new(&PatternOptions::default().with_jitter(0.0, 0.0)).unwrap();
    for normal in [[-1.0, 0.0, -0.0], [0.0, -1.0, -0.0], [-0.0, -0.0, -1.0]] {
        let frame = |seed| off.frame_of(&Receiver::new(0, [0.0; 3], normal, seed).unwrap());
        assert!((1..64).all(|seed| frame(seed) == frame(0)));
    }
}
