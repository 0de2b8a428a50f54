//! Boxes grown over many opaque cells: what a light remembers ends more rays the larger it is.
//!
//! Not from the dissertation, whose cache has single cells (Djeu11, section 3.5). Neighbouring empty cells have one winding
//! number ([`KdTree::for_each_empty_pair`]), so the inside of a box that opaque cells fill is as good as that of a cell:
//! triangles could only touch the rims of faces in it, where they have no area, so that the theorem of this module holds.

use umbrage_accel::{KdTree, kdtree::LeafState};
use umbrage_geom::Aabb;

/// Most boxes that are grown.
const MAX_GROWN_BOXES: usize = 256;

/// Opaque cells for each box that is grown, which takes about as long as classifying four.
const CELLS_PER_BOX: usize = 32;

/// Cells that are tried for each box, the largest first.
const TRIED_CELLS_PER_BOX: usize = 16;

/// Least area of a cell that is tried, relative to the largest.
const MIN_CELL_AREA: f32 = 1e-3;

/// Orders of axes in which a box grows; the largest result counts.
const AXES: [[usize; 3]; 3] = [[0, 1, 2], [1, 2, 0], [2, 0, 1]];

/// `cells` of opaque leaves, by slot, and behind them boxes grown from the largest; and for each slot the place of the box to
/// remember: a grown one around the cell, or the cell.
pub(super) fn grow(tree: &KdTree, mut cells: Vec<Aabb>) -> (Vec<Aabb>, Vec<u32>) {
    let count = cells.len();
    let mut remembered: Vec<u32> = (0..count as u32).collect();
    let mut order = remembered.clone();
    let most = (count / CELLS_PER_BOX).min(MAX_GROWN_BOXES);
    let tried = TRIED_CELLS_PER_BOX * most;
    let by_area = |a: &u32, b: &u32| cells[*b as usize].area().total_cmp(&cells[*a as usize].area());
    if count > tried {
        order.select_nth_unstable_by(tried, by_area);
        order.truncate(tried);
    }
    order.sort_unstable_by(by_area);
    let least = order.first().map_or(0.0, |&slot| MIN_CELL_AREA * cells[slot as usize].area());
    for slot in order {
        if cells.len() - count == most || cells[slot as usize].area() < least {
            break;
        }
        if remembered[slot as usize] != slot {
            continue;
        }
        let from = cells[slot as usize];
        let grown = AXES.map(|axes| pushed(tree, from, axes));
        let best = grown.into_iter().max_by(|a, b| a.area().total_cmp(&b.area())).unwrap_or(from);
        if best == from {
            continue;
        }
        let place = cells.len() as u32;
        tree.for_each_opaque_in(&best, |inner| {
            let cell = cells[inner as usize];
            if best.min.cmple(cell.min).all() && cell.max.cmple(best.max).all() {
                let now = &mut remembered[inner as usize];
                // The larger of two.
                if *now == inner || cells[*now as usize].area() < best.area() {
                    *now = place;
                }
            }
        });
        cells.push(best);
    }
    (cells, remembered)
}

/// The faces of a box moved out one after the other, as far as opaque cells go.
fn pushed(tree: &KdTree, mut aabb: Aabb, axes: [usize; 3]) -> Aabb {
    for axis in axes {
        aabb.max[axis] = tree.reach(&aabb, axis, true, LeafState::Opaque);
        aabb.min[axis] = tree.reach(&aabb, axis, false, LeafState::Opaque);
    }
    aabb
}
