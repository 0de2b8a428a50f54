#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

pub mod engine;
mod error;
mod far;
mod method;
mod occluders;
pub mod plan;
pub mod subdivide;

pub(crate) use engine::share_of;
pub use engine::{Answers, Engine, LightRay, Sky};
pub use error::QueryError;
pub use far::Pilot;
pub use method::{AoMethod, Exactness, Method, Needs, SceneKind, Selection, ShadowMethod, SurfaceMode, View};
pub use occluders::{BuildCost, Occluders, ShadingPoint, Structure, SurfaceWork};
pub use umbrage_scene::Ground;
