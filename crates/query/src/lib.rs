//! Every way to answer how much light passes, behind one type.
//!
//! - [`ShadowMethod`] and [`AoMethod`] list the methods, with what they promise and what they ask of a scene.
//! - [`Occluders`] owns a scene's triangles and every structure that is made of them.
//! - [`engine`] has one file a method: each answers rays to a light, the sky over receivers, or all receivers of an image.
//! - [`plan`] chooses.
//!
//! A call that the method asked for can't answer is [`QueryError::Unsupported`]; no method answers under another's name.

pub mod engine;
mod error;
mod method;
mod occluders;
pub mod plan;

pub use engine::{Answers, Engine, LightRay, Sky};
pub use error::QueryError;
pub use method::{AoMethod, Exactness, Method, Needs, SceneKind, Selection, ShadowMethod, View};
pub use occluders::{Ground, Made, Occluders, Structure, Surface};
