//! Why mask ambient occlusion failed.

use crate::BackEnd;
use umbrage_accel::BuildError;
use umbrage_geom::FalloffError;

/// Why a pattern could not be made or receivers could not be answered. Nothing has been written to the caller's slices.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum MaskError {
    /// The number of rays can't be had.
    #[error("{rays} rays: expected a multiple of {multiple} up to {most}")]
    Rays {
        /// How many were asked for.
        rays: u32,
        /// Largest possible number.
        most: u32,
        /// What the number has to be a multiple of.
        multiple: u32,
    },
    /// The number of members is not a power of two, or they differ in their number of directions.
    #[error("{0} sets of directions: expected a power of two, all of the same size")]
    Members(usize),
    /// A table belongs to one set of directions, not to a family.
    #[error("tables need a pattern with one member, this one has {0}: see PatternOptions::with_points")]
    Family(usize),
    /// A jitter is NaN or out of range.
    #[error("{what} is {value}, expected 0 to {limit}")]
    Jitter {
        /// `rotation` or `tilt`.
        what: &'static str,
        /// Its value.
        value: f32,
        /// Largest possible value.
        limit: f32,
    },
    /// The falloff can't be used.
    #[error(transparent)]
    Falloff(#[from] FalloffError),
    /// The radius is 0, negative or NaN.
    #[error("radius is {0}, expected more than 0")]
    Radius(f32),
    /// Rays of different lengths need a finite radius that they refer to.
    #[error("a falloff other than constant needs a finite radius")]
    FalloffWithoutRadius,
    /// A table or field can't have that many cells.
    #[error("{value} cells along the table of {what}: expected 8 to {limit}")]
    Resolution {
        /// `planes`, `edges` or `far opacity`.
        what: &'static str,
        /// The resolution.
        value: u32,
        /// Largest possible value.
        limit: u32,
    },
    /// Cells of a field can't have that shape.
    #[error("cells {0} times as long as wide: expected 0.25 to 16")]
    Elongation(f32),
    /// The back end needs instructions that this processor lacks.
    #[error("this processor has no support for the back end {0:?}")]
    BackEnd(BackEnd),
    /// A slice is not as long as there are receivers.
    #[error("{what}: {actual} values for {points} receivers, expected {expected}")]
    Length {
        /// `normals`, `ao`, ..
        what: &'static str,
        /// How many there are.
        actual: usize,
        /// How many there should be.
        expected: usize,
        /// How many receivers there are.
        points: usize,
    },
    /// Rays can't be cut into fans of that size.
    #[error("{rays} rays in fans of {per_fan}: a fan has 1 to 1024 rays, and no ray may be left over")]
    Fan {
        /// Rays of a fan.
        per_fan: usize,
        /// All rays.
        rays: usize,
    },
    /// The error to reach is 0, negative or NaN.
    #[error("target error is {0}, expected more than 0")]
    TargetError(f32),
    /// Azimuth can't be cut into that many sectors.
    #[error("{0} sectors: expected 1 to 64")]
    Sectors(u32),
    /// The method can't do that.
    #[error("this method can't tell {0}")]
    Unsupported(&'static str),
    /// The rays of a fan have different origins.
    #[error("the rays of fan {fan} don't share an origin")]
    FanOrigin {
        /// Index of the fan, from 0.
        fan: usize,
    },
    /// There are not as many opacities as triangles.
    #[error("{actual} opacities for {triangles} triangles")]
    Opacities {
        /// How many opacities there are.
        actual: usize,
        /// How many triangles there are.
        triangles: usize,
    },
    /// There are not as many answers as rays.
    #[error("{answers} answers for {rays} rays")]
    Answers {
        /// Length of the slice of answers.
        answers: usize,
        /// Number of rays.
        rays: usize,
    },
    /// A receiver point is NaN, infinite or farther out than geometry may be.
    #[error("receiver point {index} is not usable: ({}, {}, {})", .point[0], .point[1], .point[2])]
    Point {
        /// Index of the receiver, from 0.
        index: usize,
        /// The point.
        point: [f32; 3],
    },
    /// A receiver's normal is zero or not finite.
    #[error("the normal of receiver {index} is zero or not finite: ({}, {}, {})", .normal[0], .normal[1], .normal[2])]
    Normal {
        /// Index of the receiver, from 0.
        index: usize,
        /// The normal.
        normal: [f32; 3],
    },
    /// A camera is not finite or flat.
    #[error("the camera's eye or axes are not finite, or its axes don't span space")]
    Camera,
    /// A level of detail can't be used: errors start at 0 and grow, and the range factor is positive.
    #[error("level of detail {level}: {what} is {value}")]
    Level {
        /// Index of the level, from 0.
        level: usize,
        /// `error` or `range factor`.
        what: &'static str,
        /// Its value.
        value: f32,
    },
    /// An option is out of its range.
    #[error("{name} is {value}, expected {expected}")]
    Option {
        /// Name of the option.
        name: &'static str,
        /// Its value.
        value: f32,
        /// What it may be.
        expected: &'static str,
    },
    /// The geometry could not be put into a hierarchy, or can't be used.
    #[error(transparent)]
    Build(#[from] BuildError),
    /// The progress callback returned `false`.
    #[error("cancelled")]
    Cancelled,
}

impl From<umbrage_geom::Cancelled> for MaskError {
    fn from(_: umbrage_geom::Cancelled) -> Self {
        Self::Cancelled
    }
}
