#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

pub mod scene;

pub use scene::{Ambient, Camera, Instance, Light, Material, NamedMesh, Radius, Scene, Settings};
