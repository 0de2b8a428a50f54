//! Seeded, reproducible sample patterns, and maps from the unit square to what a renderer samples.
//!
//! Here: hashes and random streams, Owen-scrambled Sobol and jittered points, area-preserving maps, lights by solid angle,
//! turns about a normal. Not here: what is done with them.
//!
//! Everything is a function of its arguments. The same arguments give the same bits on every machine: only additions,
//! multiplications, divisions and square roots are used, which IEEE 754 rounds one way, and series in place of libm.
//! Lengths are world units, angles radians, densities per steradian; numbers "in the unit square" are in `[0, 1)`.

mod hash;
mod lights;
mod maps;
mod rectangle;
mod rotation;
mod sobol;
mod stratified;
mod trig;

#[cfg(test)]
mod tests;

pub use hash::{ONE_MINUS, RandomStream, combine, hash, pixel_seed, unit};
pub use lights::{Cone, LightSample, SphereLight, disc_light, parallelogram_light};
pub use maps::{
    concentric_disc, cosine_hemisphere, lift, parallelogram, triangle, uniform_hemisphere, uniform_sphere,
};
pub use rectangle::SphericalRectangle;
pub use rotation::Rotation;
pub use sobol::{sobol, sobol_2d, sobol_4d};
pub use stratified::stratified;
