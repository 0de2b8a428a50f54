//! Prefiltered occlusion: a ray with a solid angle ends at nodes that fit inside its cone, and composites their stored
//! opacities (`[Lacewell08]`). Approximate; `docs/prefilter.md` has the measured errors.
//!
//! Here: [`Prefiltered`], the 8-wide form that rays should use; [`published`], the algorithm exactly as published, to compare
//! with. Not here: sampling of lights and skies (`umbrage-render`).
//!
//! ```
//! use umbrage_geom::Ray;
//! use umbrage_occlusion::prefilter::{ConeRay, Prefiltered, PrefilterOptions, ConeQuery};
//!
//! // Loose flakes, one above the other, each of which blocks half of the light.
//! let positions: Vec<[f32; 3]> = (0..300)
//!     .flat_map(|i| {
//!         let (x, y) = ((i * 7 % 10) as f32, (i * 3 % 30) as f32);
//!         [[x, y, i as f32], [x + 1.0, y, i as f32], [x, y + 1.0, i as f32]]
//!     })
//!     .collect();
//! let triangles: Vec<[u32; 3]> = (0..300).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
//! let scene = Prefiltered::build(&positions, &triangles, &[0.5], &PrefilterOptions::default(), &mut |_| true)?;
//! let ray = ConeRay { ray: Ray::new([5.0, 15.0, -900.0], [0.0, 0.0, 1.0]), solid_angle: 0.01 };
//! let passed = scene.transmittance(&ray, &ConeQuery::new(0.2)?);
//! assert!((0.0..=1.0).contains(&passed));
//! # Ok::<(), umbrage_occlusion::OcclusionError>(())
//! ```

pub mod published;

mod control;
mod correlation;
mod depths;
mod directions;
mod fan;
mod instances;
mod opacity;
mod options;
mod prefiltered;
mod query;
mod storage;

pub use control::RayPlan;
pub use directions::Directions;
pub use instances::PrefilteredInstances;
pub use options::{ConeQuery, PrefilterOptions};
pub use prefiltered::{ConeRay, Prefiltered, PrefilteredBytes};
