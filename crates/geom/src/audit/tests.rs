use super::*;
use proptest::prelude::*;

type Mesh = (Vec<[f32; 3]>, Vec<[u32; 3]>);

fn cube(at: [f32; 3], size: f32) -> Mesh {
    let positions = (0..8).map(|i| [0, 1, 2].map(|axis| at[axis] + (i >> axis & 1) as f32 * size)).collect();
    let quads = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    (positions, quads.iter().flat_map(|q| [[q[0], q[1], q[2]], [q[0], q[2], q[3]]]).collect())
}

fn joined(meshes: &[Mesh]) -> Mesh {
    let (mut positions, mut triangles) = (Vec::new(), Vec::new());
    for (p, t) in meshes {
        let first = positions.len() as u32;
        positions.extend(p);
        triangles.extend(t.iter().map(|t| t.map(|v| v + first)));
    }
    (positions, triangles)
}

fn check((positions, triangles): &Mesh) -> Audit {
    audit(positions, triangles)
}

#[test]
fn a_cube_is_well_behaved_inside_out_or_not() {
    let mut mesh = cube([0.0; 3], 1.0);
    let audit = check(&mesh);
    assert!(audit.well_behaved() && audit.encloses());
    assert_eq!((audit.edges.edges, audit.orientation.components, audit.orientation.inwards), (18, 1, 0));
    mesh.1.iter_mut().for_each(|t| t.swap(0, 1));
    let audit = check(&mesh);
    assert!(audit.well_behaved() && audit.encloses());
    assert_eq!((audit.orientation.inwards, &audit.orientation.turns[..]), (1, &[-1i8; 12][..]));
}

#[test]
fn a_hole_is_found_and_named() {
    let mut mesh = cube([0.0; 3], 1.0);
    mesh.1.remove(0);
    let audit = check(&mesh);
    assert!(!audit.well_behaved() && !audit.encloses());
    assert_eq!((audit.edges.boundary.count, audit.orientation.open.len()), (3, 3));
    assert_eq!(audit.edges.boundary.examples, [[0, 2], [0, 3], [2, 3]]);
    // The edges left open run around the hole, against its triangle.
    let mut open = audit.orientation.open;
    open.sort_unstable();
    assert_eq!(open, [[0, 3], [2, 0], [3, 2]]);
}

#[test]
fn a_flipped_face_is_turned_back() {
    let mut mesh = cube([0.0; 3], 1.0);
    mesh.1[5].swap(0, 1);
    let audit = check(&mesh);
    assert_eq!(audit.edges.inconsistent.count, 3);
    assert!(!audit.well_behaved() && audit.encloses());
    let turned: Vec<usize> = (0..12).filter(|&t| audit.orientation.turns[t] < 0).collect();
    assert_eq!(turned, [5]);
}

#[test]
fn duplicate_faces_are_no_boundary_of_a_solid() {
    let mut mesh = cube([0.0; 3], 1.0);
    mesh.1.push(mesh.1[3]);
    let audit = check(&mesh);
    assert_eq!((audit.edges.non_manifold.count, audit.self_intersections.count), (3, 1));
    assert_eq!(audit.self_intersections.examples, [[3, 12]]);
    assert!(!audit.well_behaved());
    // A pair of opposite copies balances, and encloses nothing more.
    let [a, b, c] = mesh.1[3];
    mesh.1.push([c, b, a]);
    assert!(!check(&mesh).well_behaved());
}

#[test]
fn a_moebius_strip_has_one_side() {
    let n = 12;
    let positions: Vec<[f32; 3]> = (0..n)
        .flat_map(|i| {
            let (angle, twist) =
                (i as f32 / n as f32 * std::f32::consts::TAU, i as f32 / n as f32 * std::f32::consts::PI);
            [-0.3f32, 0.3].map(|w| {
                let r = 1.0 + w * twist.cos();
                [r * angle.cos(), r * angle.sin(), w * twist.sin()]
            })
        })
        .collect();
    let mut triangles = Vec::new();
    for i in 0..n {
        let (a, b) = (2 * i, 2 * i + 1);
        let (c, d) = if i + 1 == n { (1, 0) } else { (2 * i + 2, 2 * i + 3) };
        triangles.extend([[a, b, c], [b, d, c]]);
    }
    let audit = check(&(positions, triangles));
    assert_eq!((audit.orientation.one_sided, audit.orientation.components), (1, 1));
    assert!(!audit.well_behaved() && !audit.encloses());
    assert!(audit.orientation.turns.iter().all(|&turn| turn == 0));
}

#[test]
fn nested_shells_both_face_outwards() {
    let mut inner = cube([0.25; 3], 0.5);
    inner.1.iter_mut().for_each(|t| t.swap(1, 2));
    let audit = check(&joined(&[cube([0.0; 3], 1.0), inner]));
    assert!(audit.well_behaved() && audit.encloses());
    assert_eq!((audit.orientation.components, audit.orientation.inwards), (2, 1));
}

#[test]
fn touching_and_cutting_shells_enclose_but_are_not_well_behaved() {
    // Along an edge, in a point, face to face, through each other.
    for (at, non_manifold) in
        [([1.0, 1.0, 0.0], 1), ([1.0, 1.0, 1.0], 0), ([1.0, 0.25, 0.5], 0), ([0.5, 0.4, 0.3], 0)]
    {
        let audit = check(&joined(&[cube([0.0; 3], 1.0), cube(at, 1.0)]));
        assert!(audit.encloses(), "{at:?}");
        assert_eq!(audit.edges.non_manifold.count, non_manifold, "{at:?}");
        let touches_only_in_a_corner = at == [1.0; 3];
        assert_eq!(audit.well_behaved(), touches_only_in_a_corner, "{at:?}");
    }
}

#[test]
fn a_fold_and_a_crossing_are_intersections() {
    let positions = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.2, 0.2, 0.0], [0.2, 0.2, 1.0]];
    let found = |triangles: &[[u32; 3]]| self_intersections(&positions, triangles, &weld(&positions)).count;
    assert_eq!(found(&[[0, 1, 2], [0, 1, 3]]), 1);
    assert_eq!(found(&[[0, 1, 2], [0, 1, 4]]), 0);
    assert_eq!(found(&[[0, 1, 2], [0, 3, 4]]), 1);
    assert_eq!(found(&[[0, 1, 3], [0, 3, 2]]), 0);
    assert_eq!(found(&[[0, 1, 2], [0, 0, 4]]), 0);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]
    /// Pairs are the same in any order of triangles, and those of the loop over all.
    #[test]
    fn pairs_do_not_depend_on_the_order(
        points in prop::collection::vec(((-2i8..=2).prop_map(f32::from), (-2i8..=2).prop_map(f32::from), -2f32..2.0).prop_map(<[f32; 3]>::from), 3..12),
        indices in prop::collection::vec(any::<[u8; 3]>(), 1..24),
    ) {
        let count = points.len();
        let triangles: Vec<[u32; 3]> = indices.iter().map(|t| t.map(|i| u32::from(i) % count as u32)).collect();
        let welded = weld(&points);
        let all = self_intersections(&points, &triangles, &welded);
        let mut single = 0;
        for i in 0..triangles.len() {
            for j in 0..i {
                // Turned and swapped, too.
                let [a, b, c] = triangles[i];
                single += self_intersections(&points, &[[c, a, b], triangles[j]], &welded).count;
            }
        }
        prop_assert_eq!(all.count, single);
    }

    /// Unbalanced edges plus the turned triangles always make a closed surface.
    #[test]
    fn open_edges_are_what_is_missing(indices in prop::collection::vec([0u32..7, 0u32..7, 0u32..7], 1..30)) {
        let points: Vec<[f32; 3]> = (0..7u8).map(|i| [f32::from(i), f32::from(i * i), f32::from(i * i * i)]).collect();
        let orientation = orient(&points, &indices, &weld(&points));
        let mut balance = [[0i32; 7]; 7];
        let mut add = |from: u32, to: u32, by: i32| {
            balance[from as usize][to as usize] += by;
            balance[to as usize][from as usize] -= by;
        };
        for (t, &turn) in indices.iter().zip(&orientation.turns) {
            (0..3).for_each(|i| add(t[i], t[(i + 1) % 3], turn.into()));
        }
        orientation.open.iter().for_each(|&[from, to]| add(from, to, -1));
        prop_assert_eq!(balance, [[0; 7]; 7]);
    }
}
