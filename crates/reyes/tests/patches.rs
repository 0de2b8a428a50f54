//! Laws of patches on random control points: convex hull, and splitting that changes no point.

mod common;

use common::{sheet, zoo};
use proptest::prelude::*;
use umbrage_geom::{
    PolygonMesh,
    glam::Vec3,
    sampling::{hash, unit},
};
use umbrage_reyes::{Bicubic, Surface, SurfaceError, SurfaceOptions};

fn bicubics() -> impl Strategy<Value = Bicubic> {
    (
        prop::collection::vec(prop::array::uniform3(-1f32..1.0), 16),
        prop::sample::select(vec![1f32, 1e-6, 1e9]),
    )
        .prop_map(|(p, scale)| Bicubic {
            points: [0, 1, 2, 3].map(|j| [0, 1, 2, 3].map(|i| Vec3::from(p[4 * j + i]) * scale)),
        })
}

/// A mesh with its vertices moved at random.
fn shaken(mesh: &PolygonMesh, seed: u32) -> PolygonMesh {
    let mut mesh = mesh.clone();
    for (i, x) in mesh.positions.iter_mut().flatten().enumerate() {
        *x += 0.3 * (unit(hash(seed ^ i as u32)) - 0.5);
    }
    mesh
}

fn size(points: &[Vec3]) -> f32 {
    points.iter().fold(0.0, |m, p| m.max(p.abs().max_element()))
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]

    /// No direction reaches further on the patch than on its control points.
    #[test]
    fn bicubic_patches_lie_in_the_hull_of_their_control_points(
        patch in bicubics(), direction in prop::array::uniform3(-1f32..1.0), u in 0f64..=1.0, v in 0f64..=1.0,
    ) {
        let (d, control) = (Vec3::from(direction).as_dvec3(), patch.points.as_flattened());
        let reach = control.iter().map(|p| p.as_dvec3().dot(d)).fold(f64::NEG_INFINITY, f64::max);
        let p = patch.position(u, v);
        let room = 1e-6 * f64::from(size(control));
        prop_assert!(p.as_dvec3().dot(d) <= reach + room);
        let hull = patch.bezier_hull();
        prop_assert!((p.cmpge(hull.min - room as f32) & p.cmple(hull.max + room as f32)).all());
    }

    /// Split, then dice: the halves' points are the whole's.
    #[test]
    fn halves_have_the_points_of_the_whole(patch in bicubics(), u in 0f64..=1.0, v in 0f64..=1.0) {
        let room = 2e-6 * size(patch.points.as_flattened());
        let whole = patch.position(u, v);
        let fold = |x: f64| if x < 0.5 { (0, 2.0 * x) } else { (1, 2.0 * x - 1.0) };
        let ((i, s), (j, t)) = (fold(u), fold(v));
        prop_assert!(patch.split_u()[i].position(s, v).abs_diff_eq(whole, room));
        prop_assert!(patch.split_v()[j].position(u, t).abs_diff_eq(whole, room));
        prop_assert!(patch.split_v()[j].split_u()[i].position(s, t).abs_diff_eq(whole, room));
    }
}

/// A finer dice has the points of a coarser one, bit for bit, and all lie in the patch's bounds: regular patches, extraordinary
/// vertices and creases alike, whatever trees may keep.
#[test]
fn finer_grids_hold_coarser_ones() {
    for (name, mesh) in zoo().into_iter().chain([("waves", sheet(4, |i, j| ((i * 3 + j * 5) % 4) as f32))]) {
        for seed in 0..2 {
            let mesh = shaken(&mesh, seed);
            let options = SurfaceOptions::default().with_tight_levels(2 * seed);
            let kept = Surface::build(&mesh, &options).unwrap();
            let poor = Surface::build(&mesh, &options.with_tree_bytes(0)).unwrap();
            for patch in 0..kept.patch_count() as u32 {
                let bounds = kept.patch_bounds(patch);
                let (mut fine, mut coarse) = (Vec::new(), Vec::new());
                kept.dice_patch(patch, [5, 4], &mut fine).unwrap();
                assert!(
                    fine.iter().all(|p| p.cmpge(bounds.min).all() && p.cmple(bounds.max).all()),
                    "{name}"
                );
                for (a, b) in [(4, 4), (5, 2), (2, 0), (0, 0)] {
                    poor.dice_patch(patch, [a, b], &mut coarse).unwrap();
                    for (index, p) in coarse.iter().enumerate() {
                        let (i, j) = (index % ((1 << a) + 1), index / ((1 << a) + 1));
                        let same = fine[(j << (4 - b)) * 33 + (i << (5 - a))];
                        assert_eq!(p.to_array(), same.to_array(), "{name}, patch {patch} at {a}, {b}");
                    }
                }
            }
        }
    }
}

#[test]
fn bad_dice_are_named() {
    let surface = Surface::build(&sheet(1, |_, _| 0.0), &SurfaceOptions::default()).unwrap();
    let mut points = Vec::new();
    let mut name = |patch, levels| match surface.dice_patch(patch, levels, &mut points) {
        Err(SurfaceError::Option { name, .. }) => name,
        other => panic!("{other:?}"),
    };
    assert_eq!(name(1, [0, 0]), "patch");
    assert_eq!(name(0, [0, 13]), "level");
}
