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
    audit(positions, triangles).expect("valid indices")
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

/// What is wrong with a set of triangles is still wrong once the set joins a triangle of a smaller index.
#[test]
fn a_moebius_strip_stays_one_sided_when_it_grows() {
    let positions: Vec<[f32; 3]> = (0..6u8)
        .map(|i| {
            let angle = f32::from(i) * 1.1;
            [angle.cos(), angle.sin(), f32::from(i * i) * 0.1]
        })
        .collect();
    // A strip of five triangles over five vertices. The edge from 3 to 4 is on its border, and comes last.
    let strip = [0, 1, 3, 2, 4];
    let mut triangles = vec![[3, 4, 5]];
    triangles.extend((0..5).map(|i| [0, 1, 2].map(|k| strip[(i + k) % 5])));
    let audit = check(&(positions, triangles));
    assert_eq!((audit.orientation.components, audit.orientation.one_sided), (1, 1));
    assert!(audit.orientation.turns.iter().all(|&turn| turn == 0));
    assert!(!audit.encloses());
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
    let found =
        |triangles: &[[u32; 3]]| self_intersections(&positions, triangles, &weld(&positions)).unwrap().count;
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
        let all = self_intersections(&points, &triangles, &welded).unwrap();
        let mut single = 0;
        for i in 0..triangles.len() {
            for j in 0..i {
                // Turned and swapped, too.
                let [a, b, c] = triangles[i];
                single += self_intersections(&points, &[[c, a, b], triangles[j]], &welded).unwrap().count;
            }
        }
        prop_assert_eq!(all.count, single);
    }

    /// Unbalanced edges plus the turned triangles always make a closed surface.
    #[test]
    fn open_edges_are_what_is_missing(indices in prop::collection::vec([0u32..7, 0u32..7, 0u32..7], 1..30)) {
        let points: Vec<[f32; 3]> = (0..7u8).map(|i| [f32::from(i), f32::from(i * i), f32::from(i * i * i)]).collect();
        let orientation = orient(&points, &indices, &weld(&points)).unwrap();
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

/// Meshes on a small grid, where triangles without area and edges of many triangles are common.
fn crowded() -> impl Strategy<Value = Mesh> {
    let point = prop::array::uniform3((0u8..2).prop_map(f32::from));
    // Three points in a row, so that triangles without area have three different corners.
    let positions = prop::collection::vec(point, 3..6).prop_map(|mut positions| {
        positions.extend([
            [0.0, 0.0, 0.0],
            [0.5, 0.0, 0.0],
            [1.0, 0.0, 0.0],
            [0.0, 0.5, 0.0],
            [0.0, 1.0, 0.0],
        ]);
        positions
    });
    (
        positions,
        prop::collection::vec(prop::array::uniform3(any::<prop::sample::Index>()), 1..14),
        any::<bool>(),
    )
        .prop_map(|(positions, corners, doubled)| {
            let count = positions.len();
            let mut triangles: Vec<[u32; 3]> =
                corners.iter().map(|t| [0, 1, 2].map(|i| t[i].index(count) as u32)).collect();
            if doubled {
                // Both sides of every triangle, so that all that has area balances.
                triangles.extend(triangles.clone().iter().map(|&[a, b, c]| [c, b, a]));
            }
            (positions, triangles)
        })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(4000))]
    #[test]
    fn the_order_of_corners_without_area_changes_nothing(mesh in crowded(), order in any::<u32>()) {
        let mut other = mesh.clone();
        let mut changed = false;
        for (i, triangle) in other.1.iter_mut().enumerate() {
            if is_degenerate(triangle.map(|v| mesh.0[v as usize])) && order >> (i % 32) & 1 == 1 {
                triangle.swap(i % 3, (i + 1) % 3);
                changed = true;
            }
        }
        prop_assume!(changed);
        let (a, b) = (check(&mesh).orientation, check(&other).orientation);
        prop_assert_eq!(a.closed(), b.closed());
        prop_assert_eq!((a.components, a.inwards, a.one_sided), (b.components, b.inwards, b.one_sided));
        prop_assert_eq!(&a.open, &b.open);
        for (t, triangle) in mesh.1.iter().enumerate() {
            let flat = is_degenerate(triangle.map(|v| mesh.0[v as usize]));
            prop_assert!(flat || a.turns[t] == b.turns[t]);
        }
    }
}

/// A hole along a line that only a triangle without area closes, twice: along the line there are four triangles.
#[test]
fn triangles_without_area_close_what_they_can() {
    // Two tetrahedra on either side of the edge from 0 to 1, which one of them has split at 2.
    let positions = vec![
        [0.0, 0.0, 0.0],
        [1.0, 0.0, 0.0],
        [0.5, 0.0, 0.0],
        [0.5, 1.0, 0.0],
        [0.5, 0.5, 1.0],
        [0.5, -1.0, 0.0],
        [0.5, -0.5, 1.0],
    ];
    let whole = [[0, 3, 1], [0, 1, 4], [1, 3, 4], [0, 4, 3]];
    let split = [[0, 2, 5], [2, 1, 5], [0, 6, 2], [2, 6, 1], [1, 6, 5], [0, 5, 6]];
    let mut triangles: Vec<[u32; 3]> = whole.into_iter().chain(split).collect();
    let closed = check(&(positions.clone(), triangles.clone()));
    assert!(closed.encloses());
    // The upper one opened along the split edge and closed again by a triangle without area, in any order of corners.
    triangles[0] = [0, 3, 2];
    triangles.push([2, 3, 1]);
    assert!(!check(&(positions.clone(), triangles.clone())).encloses());
    for flat in [[0, 1, 2], [1, 0, 2], [2, 0, 1], [2, 1, 0], [0, 2, 1], [1, 2, 0]] {
        let mut triangles = triangles.clone();
        triangles.push(flat);
        assert!(check(&(positions.clone(), triangles)).encloses(), "{flat:?}");
    }
}

#[test]
fn missing_vertices_are_named() {
    let positions = [[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];
    let named = Err(MeshError::Index { triangle: 1, vertex: 3, vertices: 3 });
    assert_eq!(audit(&positions, &[[0, 1, 2], [0, 1, 3]]).map(|_| ()), named);
}
