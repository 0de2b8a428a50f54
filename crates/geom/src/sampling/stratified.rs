//! Jittered points in the unit square.

use super::hash::{ONE_MINUS, RandomStream};
use glam::Vec2;

/// `n` points in the half-open unit square, one at a random place in each of `n` cells of equal area, row by row.
///
/// Cells are as square as `n` allows: `round(sqrt(n))` rows whose numbers of cells differ by at most one, each row as high
/// as its share of the points. Any `n`; 0 gives none. The order makes successive points neighbours.
pub fn stratified(n: u32, seed: u32) -> Vec<Vec2> {
    let mut random = RandomStream::new(seed, 0x57a7);
    let rows = (f64::from(n).sqrt().round() as u32).max(1);
    let first_of = |row: u32| (u64::from(row) * u64::from(n) / u64::from(rows)) as u32;
    let mut points = Vec::with_capacity(n as usize);
    for row in 0..rows {
        let (start, end) = (first_of(row), first_of(row + 1));
        let columns = end - start;
        for column in 0..columns {
            let (jx, jy) = (f64::from(random.next_unit()), f64::from(random.next_unit()));
            let x = (f64::from(column) + jx) / f64::from(columns);
            let y = (f64::from(start) + jy * f64::from(columns)) / f64::from(n);
            points.push(Vec2::new(x as f32, y as f32).min(Vec2::splat(ONE_MINUS)));
        }
    }
    points
}
