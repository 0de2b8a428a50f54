use super::*;
use proptest::prelude::*;

fn pattern(rays: u32) -> Pattern {
    Pattern::new(&PatternOptions::default().with_rays(rays)).unwrap()
}

#[test]
fn sizes_jitters_and_tables_are_checked() {
    let options = PatternOptions::default();
    for rays in [0, Pattern::MAX_RAYS + 1, u32::MAX] {
        let refused = Pattern::new(&options.clone().with_rays(rays));
        assert!(matches!(refused, Err(MaskError::Rays { rays: r, .. }) if r == rays));
    }
    for rays in [0, 1, 33, 1056] {
        let refused = Pattern::new(&crate::published::relaxed(rays));
        assert!(matches!(refused, Err(MaskError::Rays { multiple: 32, .. })));
    }
    for (rotation, tilt, what) in [
        (-0.1, 0.0, "rotation"),
        (f32::NAN, 0.0, "rotation"),
        (0.0, 0.1, "tilt"),
        (0.0, f32::INFINITY, "tilt"),
    ] {
        let error = Pattern::new(&options.clone().with_jitter(rotation, tilt)).unwrap_err();
        assert!(matches!(error, MaskError::Jitter { what: w, .. } if w == what), "{error}");
    }
    for bad in [vec![0.2, 0.4], vec![1.0, f32::NAN], vec![1.0]] {
        let error = Pattern::new(&options.clone().with_falloff(Falloff::Table(bad))).unwrap_err();
        assert!(matches!(error, MaskError::Falloff(_)));
    }
    for members in [vec![], vec![vec![Vec3::Z]; 3], vec![vec![Vec3::Z], vec![Vec3::Z; 2]]] {
        assert!(matches!(Pattern::from_directions(members, &options), Err(MaskError::Members(_))));
    }
}

/// Largest distance of the numbers from a uniform distribution over `[0, 1]` (Kolmogorov and Smirnov).
fn distance_from_uniform(mut numbers: Vec<f64>) -> f64 {
    numbers.sort_by(f64::total_cmp);
    let n = numbers.len() as f64;
    let gap = |(i, x): (usize, f64)| (x - i as f64 / n).abs().max((x - (i + 1) as f64 / n).abs());
    numbers.into_iter().enumerate().map(gap).fold(0.0, f64::max)
}

/// What `z^2` and azimuth (in turns) of one ray after the other are, for many seeds, one ray a seed.
fn disc_of_seeds(pattern: &Pattern, seeds: u32) -> (Vec<f64>, Vec<f64>) {
    let of = |seed| {
        let receiver = Receiver::new(0, [0.0; 3], [0.0, 0.0, 1.0], seed).unwrap();
        let ray = pattern.rays_of(&receiver, 1.0).nth(seed as usize % pattern.len()).unwrap();
        let d = ray.direction.as_dvec3();
        (d.z * d.z, (d.y.atan2(d.x) / std::f64::consts::TAU).rem_euclid(1.0))
    };
    (0..seeds).map(of).unzip()
}

#[test]
fn over_seeds_every_ray_is_uniform_on_the_disc() {
    // The chance that uniform numbers are farther from uniform is 1 in 1000.
    let limit = |n: usize| 1.95 / (n as f64).sqrt();
    for rays in [1, 7, 8, 32, 100, 128, 1024] {
        let (z2, azimuth) = disc_of_seeds(&pattern(rays), 20_000);
        for (what, numbers) in [("z^2", z2), ("azimuth", azimuth)] {
            let n = numbers.len();
            let distance = distance_from_uniform(numbers);
            assert!(distance < limit(n), "{rays} rays: {what} is off by {distance}, expected {}", limit(n));
        }
    }
    // The test notices the published pattern, whose rays keep away from the horizon.
    let relaxed = Pattern::new(&crate::published::relaxed(128)).unwrap();
    assert!(distance_from_uniform(disc_of_seeds(&relaxed, 20_000).0) > 2.0 * limit(20_000));
}

#[test]
fn every_stratum_holds_one_ray() {
    for rays in [1, 8, 100, 128, 1024, 4096] {
        let pattern = pattern(rays);
        assert_eq!(pattern.len(), rays as usize);
        for member in 0..pattern.members() {
            let ring =
                |d: &Vec3| ((f64::from(d.z).powi(2) * f64::from(rays)) as usize).min(pattern.len() - 1);
            let mut rings: Vec<usize> = pattern.directions(member).iter().map(ring).collect();
            rings.sort_unstable();
            // `z` is rounded: a ray at the very edge of a ring may count to its neighbour.
            let misplaced = rings.iter().enumerate().filter(|&(i, &ring)| i != ring).count();
            assert!(misplaced <= pattern.len() / 256, "{rays} rays, member {member}: {misplaced}");
        }
    }
}

#[test]
fn over_members_every_ray_takes_places_all_over_its_ring_and_all_lengths() {
    let falloff: Falloff = "linear".parse().unwrap();
    let pattern =
        Pattern::new(&PatternOptions::default().with_rays(32).with_falloff(falloff.clone())).unwrap();
    let members = pattern.members();
    assert!(members * pattern.len() >= 8192);
    // Members differ in the order of their rays: rings are told by `z`.
    let mut places = vec![Vec::new(); 32];
    let mut lengths = vec![Vec::new(); 32];
    for member in 0..members {
        for (d, &length) in pattern.directions(member).iter().zip(pattern.lengths(member)) {
            let z2 = f64::from(d.z).powi(2) * 32.0;
            let ring = (z2 as usize).min(31);
            places[ring].push(z2 - ring as f64);
            lengths[ring].push(1.0 - f64::from(falloff.weight(length)));
        }
    }
    for (places, lengths) in places.into_iter().zip(lengths) {
        assert!(distance_from_uniform(places) < 2.5 / members as f64);
        assert!(distance_from_uniform(lengths) < 2.0 / (members as f64).sqrt());
    }
}

#[test]
fn directions_are_cosine_weighted() {
    for rays in [32, 96, 128, 1024] {
        let pattern = pattern(rays);
        let n = rays as f32;
        for member in 0..pattern.members() {
            let directions = pattern.directions(member);
            let mean = directions.iter().sum::<Vec3>() / n;
            // Mean of the cosine, weighted by the cosine: 2/3.
            assert!((mean - Vec3::Z * (2.0 / 3.0)).length() < 4.0 / n, "{rays}: {mean}");
            let squares = directions.iter().map(|d| *d * *d).sum::<Vec3>() / n;
            assert!((squares - Vec3::new(0.25, 0.25, 0.5)).length() < 3.0 / n, "{rays}: {squares}");
        }
    }
}

#[test]
fn groups_are_compact() {
    // As compact as those of the relaxed points, to within a tenth: mean distance of directions from their group's middle.
    let spread = |pattern: &Pattern, group: usize| {
        let mut sum = 0.0;
        for run in pattern.directions(0).chunks(group) {
            let mean = run.iter().sum::<Vec3>().normalize();
            sum += run.iter().map(|d| d.distance(mean)).sum::<f32>();
        }
        sum / pattern.len() as f32
    };
    for rays in [32, 128, 256, 1024] {
        let relaxed = Pattern::new(&crate::published::relaxed(rays)).unwrap();
        for group in [8, 16, 32] {
            let [ours, theirs] = [spread(&pattern(rays), group), spread(&relaxed, group)];
            assert!(ours < 1.1 * theirs, "{rays} in groups of {group}: {ours} and {theirs}");
        }
    }
}

#[test]
fn a_step_is_seen_by_every_number_of_rays() {
    // A wall 0.2 high all around at distance 1 hides z below sin(atan(0.2)): 1/26 of the projected solid angle.
    let hidden = 1.0 / 26.0;
    for rays in [8, 32, 64, 256, 1024] {
        let pattern = pattern(rays);
        let low = |member: usize| {
            pattern.directions(member).iter().filter(|d| d.z * d.z < hidden).count() as f64 / f64::from(rays)
        };
        let mean = (0..pattern.members()).map(low).sum::<f64>() / pattern.members() as f64;
        assert!((mean - f64::from(hidden)).abs() < 2e-4, "{rays} rays: {mean}");
    }
}

#[test]
fn lengths_follow_the_falloff() {
    for falloff in ["linear", "quadratic", "exponential", "1,0.7,0.7,0.1,0", "0.5,0.25"] {
        let falloff: Falloff = falloff.parse().unwrap();
        let pattern =
            Pattern::new(&PatternOptions::default().with_rays(96).with_falloff(falloff.clone())).unwrap();
        assert!(!pattern.has_equal_lengths());
        for member in 0..pattern.members() {
            let lengths = pattern.lengths(member);
            for x in [0.01, 0.1, 0.33, 0.5, 0.77, 0.99] {
                let longer = lengths.iter().filter(|&&l| l > x).count() as f32 / 96.0;
                assert!((longer - falloff.weight(x)).abs() < 1.1 / 96.0, "{falloff:?} at {x}: {longer}");
            }
            // Neighbours differ: each group of 8 has both halves of the distribution.
            let mut sorted = lengths.to_vec();
            sorted.sort_by(f32::total_cmp);
            for group in lengths.chunks(8) {
                assert!(group.iter().filter(|&&l| l <= sorted[47]).count() >= 3);
            }
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
            prop_assert!(ray.direction.dot(receiver.normal()) > 9.9e-4);
            prop_assert!((ray.direction.length() - 1.0).abs() < 1e-6);
            prop_assert!(ray.is_valid() && ray.tfar == 2.5 && ray.origin == receiver.point());
        }
    }
}

#[test]
fn turns_differ_between_receivers_and_can_be_off() {
    let frames = |pattern: &Pattern| -> Vec<Frame> {
        (0..64)
            .map(|seed| pattern.frame_of(&Receiver::new(0, [0.0; 3], [0.0, 0.0, 1.0], seed).unwrap()))
            .collect()
    };
    let turned = frames(&pattern(128));
    for quadrant in [Vec3::X, Vec3::Y, -Vec3::X, -Vec3::Y] {
        assert!(turned.iter().filter(|f| f.tangent.dot(quadrant) > 0.7).count() > 6);
    }
    assert!(turned.iter().all(|f| f.normal == Vec3::Z));
    let fixed = Pattern::new(&PatternOptions::default().fixed()).unwrap();
    assert!(
        fixed.members() == 1 && frames(&fixed).iter().all(|f| f.normal == Vec3::Z && f.tangent == Vec3::X)
    );
    // The published pattern is turned a little and tilted.
    let published = frames(&Pattern::new(&crate::published::relaxed(128)).unwrap());
    assert!(published.iter().all(|f| f.normal.z > 0.9 && f.normal.z < 1.0 && f.tangent.x > 0.8));
    // Signs of zero choose a frame: they must not come from the jitter.
    for normal in [[-1.0, 0.0, -0.0], [0.0, -1.0, -0.0], [-0.0, -0.0, -1.0]] {
        let frame = |seed| fixed.frame_of(&Receiver::new(0, [0.0; 3], normal, seed).unwrap());
        assert!((1..64).all(|seed| frame(seed) == frame(0)));
    }
}

#[test]
fn successive_samples_of_a_receiver_spread_members_and_turns() {
    let pattern = pattern(32);
    let receiver = Receiver::new(0, [0.0; 3], [0.0, 0.0, 1.0], 7).unwrap();
    let mut members = Vec::new();
    let mut angles = Vec::new();
    for sample in 0..64 {
        let receiver = receiver.with_sample(sample);
        members.push(pattern.member_of(&receiver));
        let tangent = pattern.frame_of(&receiver).tangent;
        angles.push(f64::from(tangent.y.atan2(tangent.x)) / std::f64::consts::TAU + 0.5);
    }
    members.sort_unstable();
    members.dedup();
    assert_eq!(members.len(), 64);
    assert!(distance_from_uniform(angles) < 0.05);
}

#[test]
fn one_place_with_one_normal_has_one_seed() {
    let seed = |point: [f32; 3], normal: [f32; 3]| Receiver::seed_of(point, normal, 3);
    let (point, normal) = ([1.0, 0.0, 2.0], [0.0, 0.0, 1.0]);
    assert_eq!(seed(point, normal), seed([1.0, -0.0, 2.0], [-0.0, 0.0, 1.0]));
    assert_ne!(seed(point, normal), seed([1.0, 0.0, 2.0f32.next_up()], normal));
    assert_ne!(seed(point, normal), seed(point, [0.0, 1.0, 0.0]));
    assert_ne!(seed(point, normal), Receiver::seed_of(point, normal, 4));
}
