//! The methods: the only list of them.
//!
//! Command line help, checks of scene files, error messages, `inspect`, the table in `docs/command-line.md` and the benches read
//! [`ShadowMethod::ALL`] and [`AoMethod::ALL`]. A new method is one variant here and one file in `engine`.

use super::QueryError;
use std::{fmt, str::FromStr};

/// Whether a method returns the answers of testing every triangle with the one predicate.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Exactness {
    /// Every ray has the answer of a loop over all triangles, bit for bit.
    Exact,
    /// Answers differ from those of exact rays; the sentence says where the error comes from.
    Approximate(&'static str),
}

impl fmt::Display for Exactness {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Exact => "exact",
            Self::Approximate(_) => "approximate",
        })
    }
}

/// What a method asks of a scene. [`Needs::NOTHING`] serves every scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct Needs {
    /// Every triangle blocks all light.
    pub opaque: bool,
    /// Instances are copied into one mesh.
    pub one_mesh: bool,
    /// Receivers are what a pinhole camera sees.
    pub pinhole: bool,
    /// Subdivision surfaces are meshes of triangles.
    pub triangles: bool,
    /// Each receiver has a multiple of 8 rays up to 1024.
    pub mask_rays: bool,
}

impl Needs {
    /// No condition.
    pub const NOTHING: Self =
        Self { opaque: false, one_mesh: false, pinhole: false, triangles: false, mask_rays: false };
    const TRIANGLES: Self = Self { triangles: true, ..Self::NOTHING };
    const OPAQUE: Self = Self { opaque: true, ..Self::TRIANGLES };
    const MASK: Self = Self { one_mesh: true, mask_rays: true, ..Self::TRIANGLES };

    const fn and_opaque(self) -> Self {
        Self { opaque: true, ..self }
    }

    const fn and_one_mesh(self) -> Self {
        Self { one_mesh: true, ..self }
    }

    const fn and_pinhole(self) -> Self {
        Self { pinhole: true, ..self }
    }

    /// Why `scene` does not meet the needs; `None` if it does.
    pub fn unmet(&self, scene: &SceneKind) -> Option<&'static str> {
        if self.triangles && scene.surfaces {
            return Some("subdivision surfaces are traced as such, and the method needs surfaces = \"mesh\"");
        }
        match (self.pinhole, scene.view) {
            (true, View::Lens) => return Some("the camera has a lens, and the method needs lens_radius 0"),
            (true, View::NoCamera) => {
                return Some("the method answers what a camera sees, and there is no camera");
            }
            _ => {}
        }
        if self.opaque && !scene.opaque {
            return Some("some triangles are semi-transparent, and the method needs opaque ones");
        }
        if self.one_mesh && scene.instances_apart {
            return Some("instances are kept apart to save memory, and the method needs them in one mesh");
        }
        None
    }
}

impl fmt::Display for Needs {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let needs = [
            (self.opaque, "opaque triangles"),
            (self.one_mesh, "instances in one mesh"),
            (self.pinhole, "a pinhole camera"),
            (self.triangles, "surfaces as meshes"),
            (self.mask_rays, "a multiple of 8 rays up to 1024"),
        ];
        let needed: Vec<&str> =
            needs.into_iter().filter_map(|(is_needed, text)| is_needed.then_some(text)).collect();
        match &needed[..] {
            [] => f.write_str("nothing"),
            needed => f.write_str(&needed.join("; ")),
        }
    }
}

/// From where receivers are seen.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum View {
    /// Receivers are given as points.
    #[default]
    NoCamera,
    /// By a camera whose rays leave one point.
    Pinhole,
    /// By a camera with a lens.
    Lens,
}

/// The properties of a scene that decide which methods can answer it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SceneKind {
    /// Whether every triangle blocks all light.
    pub opaque: bool,
    /// Whether instances are kept apart instead of being copied into one mesh.
    pub instances_apart: bool,
    /// Whether there are subdivision surfaces that are traced as such.
    pub surfaces: bool,
    /// From where receivers are seen.
    pub view: View,
}

/// Defines an enum of methods and what there is to say of each, so that a variant can't lack any of it.
macro_rules! methods {
    (
        $(#[$meta:meta])* $name:ident, $purpose:literal, $($variant:ident {
            name: $text:literal, $(alias: $alias:literal,)? exactness: $exactness:expr, needs: $needs:expr,
            summary: $summary:literal,
        })+
    ) => {
        $(#[$meta])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
        pub enum $name {
            $(#[doc = $summary] $variant,)+
        }

        impl $name {
            /// Every method.
            pub const ALL: &'static [Self] = &[$(Self::$variant),+];

            /// The name that users know it by.
            pub const fn name(self) -> &'static str {
                match self { $(Self::$variant => $text),+ }
            }

            /// Another name that is accepted.
            pub const fn alias(self) -> Option<&'static str> {
                match self { $(Self::$variant => {
                    #[allow(unused_mut, unused_assignments)]
                    let mut alias = None;
                    $(alias = Some($alias);)?
                    alias
                }),+ }
            }

            /// One sentence for people.
            pub const fn summary(self) -> &'static str {
                match self { $(Self::$variant => $summary),+ }
            }

            /// Whether answers are those of exact rays, and what kind of error they have if not.
            pub const fn exactness(self) -> Exactness {
                match self { $(Self::$variant => $exactness),+ }
            }

            /// What it asks of a scene.
            pub const fn needs(self) -> Needs {
                match self { $(Self::$variant => $needs),+ }
            }

            /// Checks that `scene` is of a kind that the method can do.
            ///
            /// # Errors
            /// [`QueryError::Unsupported`] with the reason.
            pub fn check(self, scene: &SceneKind) -> Result<(), QueryError> {
                match self.needs().unmet(scene) {
                    None => Ok(()),
                    Some(reason) => Err(QueryError::Unsupported { method: self.name(), reason }),
                }
            }
        }

        impl Method for $name {
            const PURPOSE: &'static str = $purpose;

            fn all() -> &'static [Self] {
                Self::ALL
            }

            fn name(self) -> &'static str {
                self.name()
            }

            fn alias(self) -> Option<&'static str> {
                self.alias()
            }

            fn summary(self) -> &'static str {
                self.summary()
            }

            fn exactness(self) -> Exactness {
                self.exactness()
            }

            fn needs(self) -> Needs {
                self.needs()
            }
        }

        impl fmt::Display for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.pad(self.name())
            }
        }

        impl FromStr for $name {
            type Err = QueryError;

            fn from_str(text: &str) -> Result<Self, QueryError> {
                let named = |method: &&Self| method.name() == text || method.alias() == Some(text);
                Self::ALL.iter().find(named).copied().ok_or_else(|| QueryError::UnknownMethod {
                    name: text.into(),
                    purpose: $purpose,
                    known: Self::ALL.iter().map(|method| method.name()).collect(),
                })
            }
        }
    };
}

/// What both enums of methods have in common.
pub trait Method: Copy + fmt::Display + FromStr<Err = QueryError> + PartialEq + 'static {
    /// `shadow` or `ambient occlusion`.
    const PURPOSE: &'static str;

    /// Every method.
    fn all() -> &'static [Self];
    /// The name that users know it by.
    fn name(self) -> &'static str;
    /// Another name that is accepted.
    fn alias(self) -> Option<&'static str>;
    /// One sentence for people.
    fn summary(self) -> &'static str;
    /// Whether answers are those of exact rays.
    fn exactness(self) -> Exactness;
    /// What it asks of a scene.
    fn needs(self) -> Needs;
}

methods! {
    /// Ways to answer rays to lights.
    ShadowMethod, "shadow",
    Bvh {
        name: "bvh",
        exactness: Exactness::Exact,
        needs: Needs::NOTHING,
        summary: "Rays through the wide BVH, or through two levels where instances are kept apart.",
    }
    Kd {
        name: "kd",
        exactness: Exactness::Exact,
        needs: Needs::OPAQUE.and_one_mesh(),
        summary: "Rays through a kd-tree, nearest cells first.",
    }
    KdVolumetric {
        name: "kd-volumetric",
        alias: "kd-volumetric:guided",
        exactness: Exactness::Exact,
        needs: Needs::OPAQUE.and_one_mesh(),
        summary: "Kd-tree whose opaque cells inside solids end rays; the light's last ray decides how the next one walks.",
    }
    KdVolumetricRay {
        name: "kd-volumetric:ray",
        exactness: Exactness::Exact,
        needs: Needs::OPAQUE.and_one_mesh(),
        summary: "Opaque cells of a kd-tree, nearest cells first.",
    }
    KdVolumetricExtended {
        name: "kd-volumetric:extended",
        exactness: Exactness::Exact,
        needs: Needs::OPAQUE.and_one_mesh(),
        summary: "Opaque cells of a kd-tree, nearest cells first; leaves with triangles wait until opaque cells were looked for.",
    }
    KdVolumetricBreadth {
        name: "kd-volumetric:bfs",
        exactness: Exactness::Exact,
        needs: Needs::OPAQUE.and_one_mesh(),
        summary: "Opaque cells of a kd-tree, breadth first.",
    }
    KdVolumetricQuick {
        name: "kd-volumetric:qdbfs",
        exactness: Exactness::Exact,
        needs: Needs::OPAQUE.and_one_mesh(),
        summary: "Opaque cells of a kd-tree, breadth first with quick descent: a single child is entered at once.",
    }
    KdVolumetricSolid {
        name: "kd-volumetric:solid",
        exactness: Exactness::Exact,
        needs: Needs::OPAQUE.and_one_mesh(),
        summary: "Opaque cells of a kd-tree, the child with more opaque area first, leaves with triangles last.",
    }
    BvhVolumetric {
        name: "bvh-volumetric",
        exactness: Exactness::Exact,
        needs: Needs::OPAQUE,
        summary: "Rays through the wide BVH that also end at boxes inside solids, made when rays come near an object.",
    }
    Prefilter {
        name: "prefilter",
        exactness: Exactness::Approximate(
            "a node that fits inside a ray's cone blocks by its stored mean opacity, so contacts and thin gaps are blurred."
        ),
        needs: Needs::TRIANGLES,
        summary: "Rays as cones that end at nodes with stored opacity; for foliage and hair.",
    }
}

methods! {
    /// Ways to answer how open the sky is.
    AoMethod, "ambient occlusion",
    Rays {
        name: "rays",
        exactness: Exactness::Exact,
        needs: Needs::NOTHING,
        summary: "Rays through the wide BVH, or through two levels where instances are kept apart.",
    }
    Mask {
        name: "mask",
        exactness: Exactness::Exact,
        needs: Needs::MASK,
        summary: "All rays of a receiver walk the wide BVH together as one bit mask.",
    }
    MaskPrefilter {
        name: "mask-prefilter",
        exactness: Exactness::Approximate(
            "beyond a distance that a sample of the receivers chooses, a grid of stored opacity answers instead of triangles."
        ),
        needs: Needs::MASK,
        summary: "Masks for what is near, stored opacity for what is far; for foliage and hair.",
    }
    MaskTable {
        name: "mask-table",
        exactness: Exactness::Approximate(
            "masks of triangles are composed of tabulated masks of planes, whose resolution moves silhouettes."
        ),
        needs: Needs::MASK.and_opaque(),
        summary: "Masks looked up in tables, triangle by triangle.",
    }
    MaskRaster {
        name: "mask-raster",
        exactness: Exactness::Approximate(
            "masks of triangles are composed of tabulated masks of planes, whose resolution moves silhouettes."
        ),
        needs: Needs::MASK.and_opaque().and_pinhole(),
        summary: "Masks looked up in tables for all pixels that a rasterized triangle may occlude.",
    }
    Prefilter {
        name: "prefilter",
        exactness: Exactness::Approximate(
            "a node that fits inside a ray's cone blocks by its stored mean opacity, so contacts and thin gaps are blurred."
        ),
        needs: Needs::TRIANGLES,
        summary: "Rays as cones that end at nodes with stored opacity; for foliage and hair.",
    }
}

methods! {
    /// Ways to trace subdivision surfaces.
    SurfaceMode, "surface",
    Mesh {
        name: "mesh",
        exactness: Exactness::Approximate("micropolygons have the size that the camera asks for."),
        needs: Needs::NOTHING,
        summary: "Micropolygons as a mesh of triangles, which every other method can take.",
    }
    Once {
        name: "once",
        exactness: Exactness::Approximate("micropolygons have the size that the camera asks for."),
        needs: Needs::NOTHING,
        summary: "Micropolygons of the same rates in 15 bytes each, without a mesh; opaque surfaces.",
    }
    Footprint {
        name: "footprint",
        exactness: Exactness::Approximate("micropolygons have the size that each ray's footprint asks for."),
        needs: Needs::NOTHING,
        summary: "Rates by each ray's footprint, grids made when a ray reaches them; opaque surfaces.",
    }
}

impl SurfaceMode {
    /// The mode that a scene's settings name.
    ///
    /// # Errors
    /// [`QueryError::UnknownMethod`].
    pub fn of_scene(scene: &umbrage_scene::Scene) -> Result<Self, QueryError> {
        scene.settings.surfaces.parse()
    }
}

impl AoMethod {
    /// Whether it looks at its errors on a sample of the receivers before it answers ([`super::Sky::pilot`]).
    pub fn wants_pilot(self) -> bool {
        self == Self::MaskPrefilter
    }
}

impl ShadowMethod {
    /// Whether the insides of closed objects end rays, so that scenes without any gain nothing.
    pub fn ends_rays_in_solids(self) -> bool {
        !matches!(self, Self::Bvh | Self::Kd | Self::Prefilter)
    }
}

/// A method, or the wish that [`super::plan`] takes one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Selection<M> {
    /// The fastest exact method that can do the scene.
    #[default]
    Auto,
    /// This method, or an error if it can't do the scene.
    Method(M),
}

impl<M: Method> Selection<M> {
    /// The word for [`Self::Auto`].
    pub const AUTO: &'static str = "auto";
}

impl<M: Method> fmt::Display for Selection<M> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Auto => f.write_str(Self::AUTO),
            Self::Method(method) => method.fmt(f),
        }
    }
}

impl<M: Method> FromStr for Selection<M> {
    type Err = QueryError;

    fn from_str(text: &str) -> Result<Self, QueryError> {
        if text == Self::AUTO {
            return Ok(Self::Auto);
        }
        text.parse().map(Self::Method).map_err(|error| match error {
            QueryError::UnknownMethod { name, purpose, mut known } => {
                known.insert(0, Self::AUTO);
                QueryError::UnknownMethod { name, purpose, known }
            }
            other => other,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn check_list<M: Method + fmt::Debug>() {
        for (i, &method) in M::all().iter().enumerate() {
            assert_eq!(method.to_string().parse::<M>().unwrap(), method);
            assert!(method.summary().ends_with('.'), "{method}");
            assert!(M::all()[..i].iter().all(|other| other.name() != method.name()));
            if let Some(alias) = method.alias() {
                assert_eq!(alias.parse::<M>().unwrap(), method);
                assert!(M::all().iter().all(|other| other.name() != alias));
            }
            assert_eq!(method.name().parse::<Selection<M>>().unwrap(), Selection::Method(method));
        }
        assert_eq!("auto".parse::<Selection<M>>().unwrap(), Selection::Auto);
        let error = "none".parse::<Selection<M>>().unwrap_err().to_string();
        assert!(error.contains("'none'") && error.contains("auto, "), "{error}");
        assert!(M::all().iter().all(|method| error.contains(method.name())), "{error}");
    }

    #[test]
    fn names_are_unique_and_read_back() {
        check_list::<ShadowMethod>();
        check_list::<SurfaceMode>();
        check_list::<AoMethod>();
    }

    #[test]
    fn needs_are_checked_with_a_reason() {
        let plain = SceneKind { opaque: true, instances_apart: false, surfaces: false, view: View::Pinhole };
        for &method in ShadowMethod::ALL {
            assert!(method.check(&plain).is_ok(), "{method}");
        }
        for &method in AoMethod::ALL {
            assert!(method.check(&plain).is_ok(), "{method}");
            let lens = method.check(&SceneKind { view: View::Lens, ..plain });
            assert_eq!(lens.is_err(), method == AoMethod::MaskRaster);
        }
        let foliage = SceneKind { opaque: false, ..plain };
        let error = ShadowMethod::Kd.check(&foliage).unwrap_err().to_string();
        assert!(error.contains("kd") && error.contains("semi-transparent"), "{error}");
        assert!(ShadowMethod::Prefilter.check(&foliage).is_ok() && AoMethod::Mask.check(&foliage).is_ok());
        let apart = SceneKind { instances_apart: true, ..plain };
        assert!(AoMethod::Mask.check(&apart).unwrap_err().to_string().contains("instances"));
        assert!(ShadowMethod::BvhVolumetric.check(&apart).is_ok());
        let surfaces = SceneKind { surfaces: true, ..plain };
        for &method in ShadowMethod::ALL {
            assert_eq!(method.check(&surfaces).is_ok(), method == ShadowMethod::Bvh);
        }
        for &method in AoMethod::ALL {
            assert_eq!(method.check(&surfaces).is_ok(), method == AoMethod::Rays);
        }
    }
}
