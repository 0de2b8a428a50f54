//! Which empty cells are inside (Djeu11, section 3.3).

use super::Solids;
use umbrage_accel::{
    KdTree,
    kdtree::{Leaf, LeafState},
};
use umbrage_geom::{Aabb, glam::Vec3};

/// How cells are classified. All ways find the same.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum Classifier {
    /// A test ray from the middle of each cell that is in the box of a generator (Djeu11, sections 3.3 and 4.7.8).
    TestRays,
    /// One test ray for all cells that are connected through faces: no triangle lies between their insides
    /// ([`KdTree::for_each_empty_pair`]), so their winding numbers are the same.
    #[default]
    Flood,
}

/// Marks every empty leaf of `tree` as opaque or clear, or takes it out of use where rounding leaves no point in its inside to
/// ask about. Returns the cells of opaque leaves; a leaf's slot is its place among them.
///
/// `tree` must hold the mesh that `solids` was found in, and its caps as guards.
pub fn classify(tree: &mut KdTree, solids: &Solids, classifier: Classifier) -> Vec<Aabb> {
    let mut leaves = Vec::new();
    tree.for_each_leaf(|leaf| {
        if leaf.state != LeafState::Boundary {
            leaves.push(leaf);
        }
    });
    let states = match classifier {
        Classifier::TestRays => leaves.iter().map(|leaf| test_ray(tree, solids, leaf)).collect(),
        Classifier::Flood => flood(tree, solids, &leaves),
    };
    let mut boxes = Vec::new();
    for (leaf, state) in leaves.iter().zip(states) {
        tree.set_state(leaf.index, state, boxes.len() as u32);
        if state == LeafState::Opaque {
            boxes.push(leaf.bounds);
        }
    }
    tree.prefer_opaque();
    boxes
}

/// A point strictly inside, if `f32` has one.
fn inside(aabb: &Aabb) -> Option<Vec3> {
    let point = aabb.min * 0.5 + aabb.max * 0.5;
    (point.cmpgt(aabb.min).all() && point.cmplt(aabb.max).all()).then_some(point)
}

fn test_ray(tree: &KdTree, solids: &Solids, leaf: &Leaf) -> LeafState {
    let Some(point) = inside(&leaf.bounds) else { return LeafState::Boundary };
    if !solids.may_enclose(&Aabb { min: point, max: point }) || solids.winding_number(tree, point) == 0 {
        LeafState::Clear
    } else {
        LeafState::Opaque
    }
}

fn flood(tree: &KdTree, solids: &Solids, leaves: &[Leaf]) -> Vec<LeafState> {
    let place: Vec<u32> = {
        let mut place = vec![u32::MAX; tree.node_count()];
        leaves.iter().enumerate().for_each(|(i, leaf)| place[leaf.index as usize] = i as u32);
        place
    };
    let mut parent: Vec<u32> = (0..leaves.len() as u32).collect();
    fn root(parent: &mut [u32], mut i: u32) -> u32 {
        while parent[i as usize] != i {
            parent[i as usize] = parent[parent[i as usize] as usize];
            i = parent[i as usize];
        }
        i
    }
    tree.for_each_empty_pair(|a, b| {
        let (a, b) = (root(&mut parent, place[a as usize]), root(&mut parent, place[b as usize]));
        parent[a.max(b) as usize] = a.min(b);
    });
    // The largest cell of each region speaks for it.
    let mut largest: Vec<Option<u32>> = vec![None; leaves.len()];
    for (i, leaf) in leaves.iter().enumerate().filter(|(_, leaf)| inside(&leaf.bounds).is_some()) {
        let best = &mut largest[root(&mut parent, i as u32) as usize];
        if best.is_none_or(|best| leaves[best as usize].bounds.area() < leaf.bounds.area()) {
            *best = Some(i as u32);
        }
    }
    let mut regions: Vec<Option<LeafState>> = vec![None; leaves.len()];
    (0..leaves.len())
        .map(|i| {
            let root = root(&mut parent, i as u32) as usize;
            let state = *regions[root].get_or_insert_with(|| match largest[root] {
                Some(best) => test_ray(tree, solids, &leaves[best as usize]),
                None => LeafState::Boundary,
            });
            // As test rays would: cells without a point inside are of no use.
            if inside(&leaves[i].bounds).is_some() { state } else { LeafState::Boundary }
        })
        .collect()
}
