//! A subdivision surface: its patches, how they meet, and points of the limit surface.

mod build;

use crate::{
    SurfaceError,
    patch::kernel::Kernel,
    patch::{Kind, Lattice, Node, TreeContext},
    rate::length::Lengths,
    subdiv::{NONE, SubdivisionMesh},
    surface::build::{Builder, check_objects, uv_control},
};
use std::sync::{OnceLock, atomic::Ordering::Relaxed};
use umbrage_accel::BackEnd;
use umbrage_geom::{
    Aabb, FaceObject, PolygonMesh,
    glam::{DVec3, Vec2, Vec3},
};

/// Parameters of patches are integers from 0 to this in grids, so that equal points have equal parameters.
pub(crate) const PARAMETER_END: u32 = 1 << 16;

/// Options of [`Surface::build`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct SurfaceOptions {
    /// How patches are bounded.
    pub bounds: PatchBounds,
    /// Levels of preemptive subdivision that tighten the bounds of patches (Djeu 2011, section 6.13.5), at most 6.
    pub tight_levels: u32,
    /// Bytes that parts of patches may take in all, those of the control mesh left out; what does not fit is computed
    /// again each time.
    pub tree_bytes: usize,
    /// Instruction set used to evaluate points; results are identical. Falls back to portable code if the processor lacks
    /// it.
    pub back_end: BackEnd,
}

impl Default for SurfaceOptions {
    fn default() -> Self {
        Self {
            bounds: PatchBounds::default(),
            tight_levels: 1,
            tree_bytes: 256 << 20,
            // AVX-512 code is slower here: see `docs/reyes.md`, Evaluation.
            back_end: BackEnd::Avx2.unless_forced(),
        }
    }
}

impl SurfaceOptions {
    /// With another [`Self::bounds`].
    #[must_use]
    pub fn with_bounds(self, bounds: PatchBounds) -> Self {
        Self { bounds, ..self }
    }

    /// With another [`Self::tight_levels`].
    #[must_use]
    pub fn with_tight_levels(self, tight_levels: u32) -> Self {
        Self { tight_levels, ..self }
    }

    /// With another [`Self::tree_bytes`].
    #[must_use]
    pub fn with_tree_bytes(self, tree_bytes: usize) -> Self {
        Self { tree_bytes, ..self }
    }

    /// With another [`Self::back_end`].
    #[must_use]
    pub fn with_back_end(self, back_end: BackEnd) -> Self {
        Self { back_end, ..self }
    }
}

/// How a patch is bounded.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum PatchBounds {
    /// Box of all control points (Djeu 2011, section 6.4).
    Hull,
    /// Box of the Bezier control points where a patch is regular.
    #[default]
    Bezier,
}

/// A point of the limit surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LimitPoint {
    /// World units.
    pub position: Vec3,
    /// Derivative by `u`, world units a patch. At corners of irregular patches only its direction means anything.
    pub du: DVec3,
    /// Derivative by `v`.
    pub dv: DVec3,
    /// Unit normal, to the side from which the control mesh's faces run counter-clockwise; zero where there is none.
    pub normal: Vec3,
}

impl LimitPoint {
    pub(crate) fn new(position: Vec3, [du, dv]: [DVec3; 2]) -> Self {
        Self { position, du, dv, normal: Vec3::ZERO }
            .with_normal(du.normalize_or_zero().cross(dv.normalize_or_zero()))
    }

    pub(crate) fn with_normal(self, normal: DVec3) -> Self {
        Self { normal: normal.normalize_or_zero().as_vec3(), ..self }
    }
}

/// How an edge of a patch, or half of it, meets a neighbour.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Meeting {
    /// Both edges are the same curve.
    Whole,
    /// The neighbour's edge is this half of the own one.
    OtherIsHalf,
    /// The own edge is the lower or upper half of the neighbour's.
    OwnIsHalf { upper: bool },
}

#[derive(Clone, Copy, Debug)]
pub(crate) struct Link {
    /// [`NONE`] at a boundary.
    pub(crate) patch: u32,
    pub(crate) edge: u8,
    pub(crate) meeting: Meeting,
}

#[derive(Debug)]
pub(crate) struct Patch {
    pub(crate) root: Node,
    /// Face of the control mesh.
    pub(crate) face: u32,
    /// Corner of the face that a part of a face with other than four corners belongs to.
    pub(crate) part: Option<u32>,
    /// Indices of limit positions.
    pub(crate) corners: [u32; 4],
    /// For each edge, from corner `k` to the next, its first and its second half.
    pub(crate) links: [[Link; 2]; 4],
    pub(crate) lengths: Lengths,
    pub(crate) bounds: Aabb,
    /// See [`Surface::edge_points`].
    pub(crate) edge_points: [OnceLock<Box<[Vec3; 5]>>; 4],
}

/// Numbers of Reyes operations done on a surface (Djeu 2011, section 5.4); see also [`crate::TraceCounts`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SurfaceCounts {
    /// Patches and parts of patches bounded.
    pub bound: u64,
    /// Patches and parts split into four.
    pub split: u64,
}

/// A Catmull-Clark surface as patches, one for each quadrilateral of the control mesh and `n` for each other face.
///
/// Patches are refined where somebody asks, and keep what was made. Points depend on patch and parameters alone.
#[derive(Debug)]
pub struct Surface {
    pub(crate) patches: Vec<Patch>,
    corner_limits: Vec<Vec3>,
    pub(crate) context: TreeContext,
    /// Named runs of faces, checked.
    pub(crate) objects: Vec<FaceObject>,
    uvs: Option<Box<Surface>>,
    bounds: Aabb,
}

/// Where `edge` of a patch is at `s` from its start, in units of [`PARAMETER_END`].
pub(crate) fn on_edge(edge: usize, s: u32) -> (u32, u32) {
    match edge {
        0 => (s, 0),
        1 => (PARAMETER_END, s),
        2 => (PARAMETER_END - s, PARAMETER_END),
        _ => (0, PARAMETER_END - s),
    }
}

impl Surface {
    /// Checks the control mesh and makes its patches; takes linear time.
    ///
    /// Texture coordinates become a surface of their own, smooth inside and with seams as boundary curves.
    ///
    /// # Errors
    /// [`SurfaceError`]; of options [`SurfaceOptions::tight_levels`] beyond 6.
    pub fn build(control: &PolygonMesh, options: &SurfaceOptions) -> Result<Self, SurfaceError> {
        if options.tight_levels > 6 {
            let value = options.tight_levels.into();
            return Err(SurfaceError::Option { name: "tight_levels", value, expected: "0 to 6" });
        }
        let mesh = SubdivisionMesh::new(control)?;
        check_objects(control)?;
        let mut surface = Self::from_mesh(&mesh, options);
        if !control.corner_uvs.is_empty() {
            let uv_options =
                SurfaceOptions { tight_levels: 0, tree_bytes: options.tree_bytes / 4, ..*options };
            let uv_mesh = SubdivisionMesh::new(&uv_control(control)?)?;
            surface.uvs = Some(Box::new(Self::from_mesh(&uv_mesh, &uv_options)));
        }
        surface.objects.clone_from(&control.objects);
        Ok(surface)
    }

    fn from_mesh(mesh: &SubdivisionMesh, options: &SurfaceOptions) -> Self {
        let context = TreeContext {
            method: mesh.crease_method(),
            kernel: Kernel::new(options.back_end),
            bezier_bounds: options.bounds == PatchBounds::Bezier,
            limit: options.tree_bytes,
            bytes: 0.into(),
            bounds: 0.into(),
            splits: 0.into(),
        };
        let builder = Builder::new(mesh, &context);
        let (mut patches, corner_limits) = builder.build();
        let mut bounds = Aabb::EMPTY;
        for patch in &mut patches {
            patch.bounds = patch.root.tight_bounds(options.tight_levels, &context);
            bounds = bounds.union(patch.bounds);
        }
        Self { patches, corner_limits, context, objects: Vec::new(), uvs: None, bounds }
    }

    /// Number of patches.
    pub fn patch_count(&self) -> usize {
        self.patches.len()
    }

    /// The face of the control mesh that a patch belongs to, and its corner if the face has other than four.
    ///
    /// # Panics
    /// If `patch` is out of range.
    pub fn face_of(&self, patch: u32) -> (u32, Option<u32>) {
        let patch = &self.patches[patch as usize];
        (patch.face, patch.part)
    }

    /// Whether a patch is one bicubic B-spline, and which.
    ///
    /// # Panics
    /// If `patch` is out of range.
    pub fn bicubic(&self, patch: u32) -> Option<&crate::Bicubic> {
        match &self.patches[patch as usize].root.kind {
            Kind::Regular(bicubic) => Some(bicubic),
            _ => None,
        }
    }

    /// The Reyes operation bound: a box that holds every micropolygon of the patch at any rate.
    ///
    /// # Panics
    /// If `patch` is out of range.
    pub fn patch_bounds(&self, patch: u32) -> Aabb {
        self.patches[patch as usize].bounds
    }

    /// A box around all patches.
    pub fn bounds(&self) -> Aabb {
        self.bounds
    }

    /// The limit surface at `u`, `v`, clamped to `[0, 1]`; corner `k` of the face is at (0, 0), (1, 0), (1, 1), (0, 1).
    ///
    /// # Panics
    /// If `patch` is out of range.
    pub fn limit(&self, patch: u32, u: f32, v: f32) -> LimitPoint {
        let [u, v] = [u, v].map(|x| f64::from(if x.is_nan() { 0.0 } else { x.clamp(0.0, 1.0) }));
        self.patches[patch as usize].root.limit(u, v, &self.context)
    }

    /// Texture coordinates at `u`, `v` of a patch, if the control mesh had any.
    ///
    /// # Panics
    /// If `patch` is out of range.
    pub fn uv(&self, patch: u32, u: f32, v: f32) -> Option<Vec2> {
        let point = self.uvs.as_ref()?.limit(patch, u, v);
        Some(Vec2::new(point.position.x, point.position.y))
    }

    /// Operations done so far, by building and by all that looked.
    pub fn counts(&self) -> SurfaceCounts {
        SurfaceCounts { bound: self.context.bounds.load(Relaxed), split: self.context.splits.load(Relaxed) }
    }

    /// Bytes of the surface as refined so far.
    pub fn bytes(&self) -> usize {
        let nodes: usize = self.patches.iter().map(|p| p.root.total_bytes()).sum();
        nodes
            + size_of_val(&self.corner_limits[..])
            + self.patches.len() * (size_of::<Patch>() - size_of::<Node>())
            + self.uvs.as_ref().map_or(0, |uvs| uvs.bytes())
    }

    /// The limit position of corner `k` of a patch.
    pub(crate) fn corner(&self, patch: u32, k: usize) -> Vec3 {
        self.corner_limits[self.patches[patch as usize].corners[k % 4] as usize]
    }

    /// Points at quarters of an edge.
    pub(crate) fn edge_points(&self, patch: u32, edge: usize) -> [Vec3; 5] {
        let known = &self.patches[patch as usize].edge_points[edge];
        **known.get_or_init(|| {
            Box::new([0, 1, 2, 3, 4].map(|i| self.edge_position(patch, edge, i * (PARAMETER_END / 4))))
        })
    }

    /// The point at `s` of [`PARAMETER_END`] along an edge: the same bits from both sides.
    pub(crate) fn edge_position(&self, patch: u32, edge: usize, s: u32) -> Vec3 {
        let own = &self.patches[patch as usize];
        if s == 0 || s == PARAMETER_END {
            return self.corner(patch, edge + usize::from(s == PARAMETER_END));
        }
        let link = own.links[edge][usize::from(2 * s >= PARAMETER_END)];
        let (owner, edge, s) = match link.meeting {
            Meeting::OtherIsHalf if 2 * s == PARAMETER_END => {
                return self.corner(own.links[edge][0].patch, 3);
            }
            Meeting::OwnIsHalf { upper } if link.patch != NONE => (
                link.patch,
                usize::from(link.edge),
                if upper { PARAMETER_END } else { PARAMETER_END / 2 } - s / 2,
            ),
            Meeting::Whole if link.patch < patch => (link.patch, usize::from(link.edge), PARAMETER_END - s),
            _ => (patch, edge, s),
        };
        let (u, v) = on_edge(edge, s);
        self.patches[owner as usize].root.position(u, v, PARAMETER_END, &self.context)
    }
}

impl Surface {
    /// The points of an edge cut into `2^level`, by increasing parameter, with the bits of [`Self::edge_position`]. `own` are
    /// those that the patch itself has there.
    pub(crate) fn edge_row(
        &self,
        patch: u32,
        edge: usize,
        level: u8,
        own: impl Fn(usize) -> Vec3,
    ) -> Vec<Vec3> {
        let (count, step) = (1usize << level, PARAMETER_END >> level);
        let mut row = vec![Vec3::ZERO; count + 1];
        // From the start of the edge; edges 2 and 3 run against the parameters.
        row[0] = self.corner(patch, edge);
        row[count] = self.corner(patch, edge + 1);
        let middle = count.div_ceil(2);
        for (half, places) in [1..middle, middle..count].into_iter().enumerate() {
            let link = self.patches[patch as usize].links[edge][half];
            let foreign = link.patch != NONE;
            // Where the owner has place `i`: from `base` downwards.
            let (base, stride) = match link.meeting {
                Meeting::OwnIsHalf { upper } if foreign => {
                    (if upper { PARAMETER_END } else { PARAMETER_END / 2 }, step / 2)
                }
                Meeting::Whole if foreign && link.patch < patch => (PARAMETER_END, step),
                _ => {
                    for i in places {
                        row[i] = own(if edge < 2 { i } else { count - i });
                    }
                    continue;
                }
            };
            if places.is_empty() {
                continue;
            }
            let first = base - (places.end - 1) as u32 * stride;
            let last = base - places.start as u32 * stride;
            let against = link.edge >= 2;
            let (start, points) = (if against { PARAMETER_END - last } else { first }, &mut row[places]);
            let fixed = if link.edge == 1 || link.edge == 2 { PARAMETER_END } else { 0 };
            let (u0, v0, counts) = if link.edge.is_multiple_of(2) {
                (start, fixed, [points.len(), 1])
            } else {
                (fixed, start, [1, points.len()])
            };
            let lattice = Lattice { u0, v0, step_u: stride, step_v: stride, stride: counts[0] };
            self.patches[link.patch as usize].root.fill(
                PARAMETER_END,
                &lattice,
                counts,
                points,
                &self.context,
            );
            // Places run downwards along the owner's edge.
            if !against {
                points.reverse();
            }
        }
        let link = self.patches[patch as usize].links[edge][0];
        if count > 1 && link.patch != NONE && link.meeting == Meeting::OtherIsHalf {
            row[count / 2] = self.corner(link.patch, 3);
        }
        if edge >= 2 {
            row.reverse();
        }
        row
    }
}
