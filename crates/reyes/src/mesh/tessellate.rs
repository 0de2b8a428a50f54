//! The whole surface as one watertight triangle mesh, at rates that the caller chooses.

use crate::{
    MAX_LEVEL, Surface, SurfaceError,
    mesh::dice::{GridKey, Stitch},
    patch::{Children, quarter_at},
    subdiv::NONE,
    surface::{Meeting, PARAMETER_END},
};
use umbrage_geom::{Aabb, MeshError, TriangleMesh, mesh::MAX_ELEMENTS};

impl Surface {
    /// Levels of all patches, raised to what quadrilaterals beside other faces need.
    ///
    /// # Errors
    /// [`SurfaceError::Option`] for a level beyond [`MAX_LEVEL`]; [`SurfaceError::Mesh`] for more vertices than indices.
    pub(crate) fn checked_levels(
        &self,
        levels_of: impl Fn(u32) -> [u8; 2],
    ) -> Result<Vec<[u8; 2]>, SurfaceError> {
        let levels: Vec<[u8; 2]> = (0..self.patch_count() as u32)
            .map(|i| levels_of(i).map(|l| l.max(self.least_level(i))))
            .collect();
        if let Some(&level) = levels.as_flattened().iter().find(|&&l| l > MAX_LEVEL) {
            let value = level.into();
            return Err(SurfaceError::Option { name: "level", value, expected: "0 to 12" });
        }
        let count: usize = levels.iter().map(|l| ((1usize << l[0]) + 1) * ((1usize << l[1]) + 1)).sum();
        if count > MAX_ELEMENTS / 2 {
            return Err(MeshError::TooMany { what: "vertices", count }.into());
        }
        Ok(levels)
    }

    /// The surface as triangles, each patch divided into `2^levels` cells along `u` and `v`, `levels` from `levels_of` and
    /// raised to what quadrilaterals beside other faces need; shared edges follow the coarser side. Positions on shared
    /// edges are equal bit for bit, vertices are not shared. The patch of each triangle comes second.
    ///
    /// # Errors
    /// [`SurfaceError::Option`] for a level beyond [`MAX_LEVEL`]; [`SurfaceError::Mesh`] for more vertices than indices.
    pub fn tessellate(
        &self,
        levels_of: impl Fn(u32) -> [u8; 2],
    ) -> Result<(TriangleMesh, Vec<u32>), SurfaceError> {
        let levels = self.checked_levels(levels_of)?;
        let mut mesh = TriangleMesh::default();
        let mut patches = Vec::new();
        let all = 0..self.patch_count() as u32;
        for key in all.flat_map(|patch| self.parts_of(patch, &levels)) {
            let grid = self.dice(&key);
            let base = mesh.positions.len() as u32;
            mesh.positions.extend(grid.positions().iter().map(|p| p.to_array()));
            for triangle in 0..grid.triangle_count() {
                mesh.triangles.push(grid.triangle(triangle).map(|v| base + v as u32));
                patches.push(key.patch);
            }
        }
        Ok((mesh, patches))
    }

    /// Keys of the grids of a patch when all patches have the given levels, borders stitched.
    pub(crate) fn parts_of(&self, patch: u32, levels: &[[u8; 2]]) -> impl Iterator<Item = GridKey> + use<> {
        let own = levels[patch as usize];
        let shifts = [0, 1, 2, 3].map(|edge| self.static_shifts(patch as usize, edge, levels));
        let depth = GridKey::depth_for(own);
        let side = 1u16 << depth;
        (0..side).flat_map(move |y| (0..side).map(move |x| [x, y])).map(move |place| {
            let mut key = GridKey { patch, depth, levels: own, place, stitch: Stitch::default() };
            for (edge, shifts) in shifts.iter().enumerate() {
                if key.touches(edge) {
                    key.stitch = key.stitch.with(edge, key.half_of(edge, *shifts));
                }
            }
            key
        })
    }

    pub(crate) fn least_level(&self, patch: u32) -> u8 {
        self.patches[patch as usize].least_level()
    }

    /// Anisotropic levels at which no edge is longer than `width`.
    pub(crate) fn levels_for(&self, patch: u32, width: f64, max_level: u8) -> [u8; 2] {
        self.patches[patch as usize].levels_for(width, max_level, false, &self.context)
    }

    /// A box around the grid of `key`.
    pub(crate) fn part_bounds(&self, key: &GridKey) -> Aabb {
        let mut place = (&self.patches[key.patch as usize].root, key.depth);
        let mut bounds = place.0.bounds;
        // Down the tree; a part made for the occasion can't be followed, so its parent's box stands in.
        while place.1 > 0 {
            let shift = place.1 - 1;
            let [a, b] = key.place.map(|x| x >> shift & 1 == 1);
            let Children::Stored(children) = place.0.split(&self.context) else { break };
            place = (&children[quarter_at(a, b)], shift);
            bounds = place.0.bounds;
        }
        for edge in 0..4 {
            let shift = key.stitch.get(edge).into_iter().max().unwrap_or(0);
            if shift + key.depth > key.levels[edge % 2] {
                bounds = bounds.union(self.stitched_ends(key, edge, shift));
            }
        }
        bounds
    }

    /// The box around the two vertices between which the border of a part lies when its edge is coarser by `shift` levels.
    pub(crate) fn stitched_ends(&self, part: &GridKey, edge: usize, shift: u8) -> Aabb {
        let axis = edge % 2;
        let (corner, size) = part.corner();
        let step = PARAMETER_END >> (part.levels[axis] - shift);
        let ends = [corner[axis] / step * step, (corner[axis] + size).div_ceil(step) * step];
        ends.into_iter()
            .fold(Aabb::EMPTY, |bounds, at| bounds.with_point(self.border_position(part, edge, at)))
    }

    pub(crate) fn static_shifts(&self, patch: usize, edge: usize, levels: &[[u8; 2]]) -> [u8; 2] {
        let links = self.patches[patch].links[edge];
        let mut shifts = links.map(|link| {
            if link.patch == NONE {
                return 0;
            }
            let theirs = levels[link.patch as usize][usize::from(link.edge) % 2];
            levels[patch][edge % 2].saturating_sub(link.meeting.in_own_units(theirs))
        });
        if edge >= 2 {
            // These edges run against the parameters.
            shifts.reverse();
        }
        shifts
    }
}

impl Meeting {
    /// The neighbour's level on the shared edge as a level of the own edge.
    pub(crate) fn in_own_units(self, theirs: u8) -> u8 {
        match self {
            Self::Whole => theirs,
            Self::OtherIsHalf => theirs + 1,
            Self::OwnIsHalf { .. } => theirs - 1,
        }
    }
}

impl Surface {
    /// The longest edge of a patch's micropolygons, diagonals of cells both ways included, when diced at `levels` without
    /// neighbours; world units.
    ///
    /// # Errors
    /// [`SurfaceError::Option`] for a patch that does not exist or a level beyond [`MAX_LEVEL`].
    pub fn longest_edge(&self, patch: u32, levels: [u8; 2]) -> Result<f64, SurfaceError> {
        if patch as usize >= self.patch_count() {
            let value = patch.into();
            return Err(SurfaceError::Option {
                name: "patch",
                value,
                expected: "less than the number of patches",
            });
        }
        let level = levels[0].max(levels[1]);
        if level > MAX_LEVEL {
            let value = level.into();
            return Err(SurfaceError::Option { name: "level", value, expected: "0 to 12" });
        }
        let depth = GridKey::depth_for(levels);
        let side = 1u16 << depth;
        let keys = (0..side).flat_map(|y| (0..side).map(move |x| [x, y])).map(|place| GridKey {
            patch,
            depth,
            levels,
            place,
            stitch: Stitch::default(),
        });
        Ok(keys.map(|key| self.dice(&key).longest_edge()).fold(0.0, f64::max))
    }
}
