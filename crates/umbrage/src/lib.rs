#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

pub mod inspect;

pub use umbrage_accel as accel;
pub use umbrage_aomask as aomask;
pub use umbrage_bake as bake;
pub use umbrage_geom as geom;
pub use umbrage_image as image;
pub use umbrage_occlusion as occlusion;
pub use umbrage_query as query;
pub use umbrage_render as render;
pub use umbrage_reyes as reyes;
pub use umbrage_scene as scene;
pub use umbrage_study as study;
