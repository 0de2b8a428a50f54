//! The Reyes operation dice: a part of a patch becomes a grid, its borders fit for its neighbours.
//!
//! A border whose neighbour is coarser is stitched: its vertices move along the edge to the nearest one that the neighbour
//! has too. Cells there degenerate, the grid keeps its shape, and both sides have the same segments, bit for bit.

use crate::{
    Surface, SurfaceError,
    mesh::grid::{GRID_LEVEL, Grid, MAX_VERTICES},
    patch::Lattice,
    rate::length::{MAX_LEVEL, cell},
    surface::PARAMETER_END,
};
use umbrage_geom::glam::Vec3;

/// Which grid: a part of a patch, its rates, and how its borders are stitched.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) struct GridKey {
    pub(crate) patch: u32,
    /// Splits from the patch to this part.
    pub(crate) depth: u8,
    /// Levels of the whole patch, along `u` and `v`.
    pub(crate) levels: [u8; 2],
    /// Index of the part along `u` and `v`, below `2^depth`.
    pub(crate) place: [u16; 2],
    pub(crate) stitch: Stitch,
}

/// How much coarser than the grid its borders are: for the edges of the part, bottom, right, top, left, each its half at
/// smaller and at larger parameters; levels in steps of 4 bits. For lines inside a patch that end at coarser borders, further
/// the splits from the patch to the line.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub(crate) struct Stitch {
    shifts: u32,
    /// One more than the splits, 0 for none; 4 bits an edge.
    lines: u16,
}

impl Stitch {
    pub(crate) fn with(self, edge: usize, halves: [u8; 2]) -> Self {
        let bits = u32::from(halves[0] & 15) | u32::from(halves[1] & 15) << 4;
        Self { shifts: self.shifts & !(255 << (8 * edge)) | bits << (8 * edge), ..self }
    }

    pub(crate) fn get(self, edge: usize) -> [u8; 2] {
        let bits = self.shifts >> (8 * edge);
        [(bits & 15) as u8, (bits >> 4 & 15) as u8]
    }

    /// The edge is (part of) a line inside the patch, of a part after `depth` splits.
    pub(crate) fn with_line(self, edge: usize, depth: u8) -> Self {
        Self { lines: self.lines | (u16::from(depth + 1) & 15) << (4 * edge), ..self }
    }

    fn line(self, edge: usize) -> Option<u8> {
        ((self.lines >> (4 * edge) & 15) as u8).checked_sub(1)
    }

    pub(crate) fn is_none(self) -> bool {
        self.shifts == 0
    }
}

/// The vertex that vertex `i` of `2^level` is moved to on an edge whose halves are coarser by `shifts` levels: the nearest
/// multiple, ties going up or down.
///
/// The ends of a line inside a patch may have moved along the borders that it ends at, so nothing moves there: such a line
/// has a vertex between its ends.
fn snap(i: u32, level: u8, shifts: [u8; 2], ties_up: bool, line: Option<u8>) -> u32 {
    let middle = (1u32 << level) / 2;
    let shift = shifts[usize::from(i > middle)];
    let step = 1u32 << shift;
    let below = i / step * step;
    if below == i {
        return i;
    }
    if let Some(depth) = line {
        let length = 1u32 << (level - depth);
        let start = i / length * length;
        if below == start {
            return below + step;
        }
        if below + step == start + length {
            return below;
        }
    }
    let half = if ties_up { step / 2 } else { step / 2 - 1 };
    (i + half) / step * step
}

impl GridKey {
    /// Splits that leave grids of at most `2^GRID_LEVEL` cells a side.
    pub(crate) fn depth_for(levels: [u8; 2]) -> u8 {
        levels[0].max(levels[1]).saturating_sub(GRID_LEVEL)
    }

    /// First parameters and size in units of [`PARAMETER_END`].
    pub(crate) fn corner(&self) -> ([u32; 2], u32) {
        let size = PARAMETER_END >> self.depth;
        (self.place.map(|x| u32::from(x) * size), size)
    }

    /// What the halves of an edge of the patch, both given, are on the part: it may lie in one of them.
    pub(crate) fn half_of(&self, edge: usize, halves: [u8; 2]) -> [u8; 2] {
        if self.depth == 0 {
            return halves;
        }
        let upper = self.place[edge % 2] >> (self.depth - 1) & 1;
        [halves[usize::from(upper)]; 2]
    }

    /// Parameters of a vertex of a whole patch, column and row given, once borders are stitched.
    pub(crate) fn moved(&self, [i, j]: [usize; 2]) -> [f32; 2] {
        let last = self.levels.map(|l| 1u32 << l);
        let mut at = [i as u32, j as u32];
        for edge in 0..4 {
            let (axis, far) = (edge % 2, edge == 1 || edge == 2);
            let fixed = if far { last[1 - axis] } else { 0 };
            if [i as u32, j as u32][1 - axis] == fixed {
                at[axis] = snap(at[axis], self.levels[axis], self.stitch.get(edge), !far, None);
            }
        }
        [at[0] as f32 * cell(self.levels[0]) as f32, at[1] as f32 * cell(self.levels[1]) as f32]
    }

    /// Whether the part touches edge `edge` of the patch.
    pub(crate) fn touches(&self, edge: usize) -> bool {
        let last = (1u16 << self.depth) - 1;
        match edge {
            0 => self.place[1] == 0,
            1 => self.place[0] == last,
            2 => self.place[1] == last,
            _ => self.place[0] == 0,
        }
    }
}

impl Surface {
    /// The Reyes operation dice of a whole patch without neighbours: `2^levels` cells along `u` and `v`, points of the limit
    /// surface row by row, written over `points`.
    ///
    /// # Errors
    /// [`SurfaceError::Option`] for a patch that does not exist or a level beyond [`MAX_LEVEL`].
    pub fn dice_patch(
        &self,
        patch: u32,
        levels: [u8; 2],
        points: &mut Vec<Vec3>,
    ) -> Result<(), SurfaceError> {
        let option = |name, value, expected| Err(SurfaceError::Option { name, value, expected });
        if patch as usize >= self.patch_count() {
            return option("patch", patch.into(), "less than the number of patches");
        }
        if let Some(&level) = levels.iter().find(|&&l| l > MAX_LEVEL) {
            return option("level", level.into(), "0 to 12");
        }
        let counts = levels.map(|l| (1usize << l) + 1);
        let [step_u, step_v] = levels.map(|l| PARAMETER_END >> l);
        points.resize(counts[0] * counts[1], Vec3::ZERO);
        let lattice = Lattice { u0: 0, v0: 0, step_u, step_v, stride: counts[0] };
        self.patches[patch as usize].root.fill(PARAMETER_END, &lattice, counts, points, &self.context);
        Ok(())
    }

    /// The Reyes operation dice. The same bits for the same key, at any time.
    pub(crate) fn dice(&self, key: &GridKey) -> Grid {
        let ([u0, v0], size) = key.corner();
        let [step_u, step_v] = key.levels.map(|l| PARAMETER_END >> l);
        let counts = [(size / step_u) as usize + 1, (size / step_v) as usize + 1];
        let mut positions = [Vec3::ZERO; MAX_VERTICES];
        let positions = &mut positions[..counts[0] * counts[1]];
        let mut parameters = [[0f32; 2]; MAX_VERTICES];
        self.place_vertices(key, counts, positions, &mut parameters);
        let unit = 1.0 / PARAMETER_END as f32;
        let levels = key.levels.map(|l| l - key.depth);
        let moved = (!key.stitch.is_none()).then(|| &parameters[..positions.len()]);
        let start = [u0, v0].map(|x| x as f32 * unit);
        let step = [step_u, step_v].map(|x| x as f32 * unit);
        Grid::new(levels, positions, start, step, moved)
    }

    /// Writes the vertices of a part and, if it is stitched, their parameters.
    pub(crate) fn place_vertices(
        &self,
        key: &GridKey,
        counts: [usize; 2],
        positions: &mut [Vec3],
        parameters: &mut [[f32; 2]],
    ) {
        let ([u0, v0], _) = key.corner();
        let [step_u, step_v] = key.levels.map(|l| PARAMETER_END >> l);
        let lattice = Lattice { u0, v0, step_u, step_v, stride: counts[0] };
        self.patches[key.patch as usize].root.fill(PARAMETER_END, &lattice, counts, positions, &self.context);
        if !key.stitch.is_none() {
            for (i, p) in parameters[..positions.len()].iter_mut().enumerate() {
                *p = [u0 + (i % counts[0]) as u32 * step_u, v0 + (i / counts[0]) as u32 * step_v]
                    .map(|x| x as f32 / PARAMETER_END as f32);
            }
        }
        for edge in 0..4 {
            self.border(key, edge, counts, positions, parameters);
        }
    }

    /// Puts the vertices of one border where the neighbour has them too.
    fn border(
        &self,
        key: &GridKey,
        edge: usize,
        counts: [usize; 2],
        positions: &mut [Vec3],
        parameters: &mut [[f32; 2]],
    ) {
        let shifts = key.stitch.get(edge);
        let outer = key.touches(edge);
        if !outer && shifts == [0, 0] {
            return;
        }
        let axis = edge % 2;
        let ([u0, v0], size) = key.corner();
        let (start, level) = ([u0, v0][axis], key.levels[axis]);
        let step = PARAMETER_END >> level;
        // The fixed parameter.
        let far = edge == 1 || edge == 2;
        let fixed = [u0, v0][1 - axis] + if far { size } else { 0 };
        let index = |i: usize| match edge {
            0 => i,
            1 => i * counts[0] + counts[0] - 1,
            2 => (counts[1] - 1) * counts[0] + i,
            _ => i * counts[0],
        };
        // A whole edge at once: around extraordinary vertices each point alone costs a way down the tree.
        let row = (key.depth == 0).then(|| self.edge_row(key.patch, edge, level, |i| positions[index(i)]));
        for i in 0..counts[axis] {
            // With the diagonal that cells have, ties go to where triangles stay short.
            let at = snap((start / step) + i as u32, level, shifts, !far, key.stitch.line(edge)) * step;
            let (u, v) = if axis == 0 { (at, fixed) } else { (fixed, at) };
            let is_corner = i == 0 || i + 1 == counts[axis];
            let stays = at == start + i as u32 * step;
            let moved = [u, v].map(|x| x as f32 / PARAMETER_END as f32);
            if is_corner && stays && !key.stitch.is_none() && parameters[index(i)] != moved {
                // The other border at this corner has moved it.
                continue;
            }
            positions[index(i)] = match &row {
                Some(row) => row[(at / step) as usize],
                None => self.border_position(key, edge, at),
            };
            parameters[index(i)] = moved;
        }
    }

    /// The point of border `edge` of a part where the parameter along it is `at`, in units of [`PARAMETER_END`].
    pub(crate) fn border_position(&self, key: &GridKey, edge: usize, at: u32) -> Vec3 {
        if key.touches(edge) {
            // Edges 2 and 3 run against the parameters.
            let s = if edge < 2 { at } else { PARAMETER_END - at };
            return self.edge_position(key.patch, edge, s);
        }
        let (corner, size) = key.corner();
        let far = edge == 1 || edge == 2;
        let fixed = corner[1 - edge % 2] + if far { size } else { 0 };
        let (u, v) = if edge.is_multiple_of(2) { (at, fixed) } else { (fixed, at) };
        self.patches[key.patch as usize].root.position(u, v, PARAMETER_END, &self.context)
    }
}
