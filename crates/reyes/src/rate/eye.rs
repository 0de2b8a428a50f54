//! Rates for a picture: how finely each patch is divided, seen from a point.

use crate::{
    Surface, SurfaceError,
    patch::Lattice,
    rate::length::{MAX_LEVEL, cell},
    surface::PARAMETER_END,
};
use umbrage_geom::glam::{Affine3A, DVec3, Vec3};

/// Segments of an edge or middle line by which its length and its turn are measured.
const SEGMENTS: usize = 2;

/// Points of such a line.
const LINE_POINTS: usize = SEGMENTS + 1;

/// Most that edges are lengthened or shortened by.
const MAX_BEND_FACTOR: f64 = 4.0;

/// How long the edges of micropolygons shall be, seen from a point: what [`crate::RatedSurface::for_eye`] goes by.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct EyeRates {
    /// Where the surface is seen from.
    pub eye: Vec3,
    /// Length of an edge at distance 1, more than 0.
    pub width: f32,
    /// Most halvings of a patch, also where the eye is on the surface; at most [`MAX_LEVEL`].
    pub max_level: u8,
    /// Turn of the surface, radians, along an edge that is as long as [`Self::width`] says. Edges are longer where it turns less and
    /// shorter where it turns more, by the cube root of the ratio and at most four times. 0 makes all alike.
    ///
    /// Where facets stand for a surface, a light that sets turns dark a facet at a time: pixels are wrong in proportion to the
    /// length of edges and to how often lights set, that is, to curvature, while edges of length `h` cost `1 / h^2`. At a
    /// given cost the sum of errors is least if `h` goes with the inverse cube root of the curvature.
    pub bend: f32,
}

impl EyeRates {
    /// Edges of length `width` at distance 1 from `eye` where the surface turns by 0.02 along them; at most 10 halvings.
    pub fn new(eye: Vec3, width: f32) -> Self {
        Self { eye, width, max_level: 10, bend: 0.02 }
    }

    /// Sets the number of halvings.
    #[must_use]
    pub fn with_max_level(self, max_level: u8) -> Self {
        Self { max_level, ..self }
    }

    /// Sets the turn.
    #[must_use]
    pub fn with_bend(self, bend: f32) -> Self {
        Self { bend, ..self }
    }

    /// # Errors
    /// [`SurfaceError::Option`].
    pub(crate) fn validate(&self) -> Result<(), SurfaceError> {
        let error = |name, value, expected| Err(SurfaceError::Option { name, value, expected });
        if !(self.width > 0.0 && self.width.is_finite() && self.eye.is_finite()) {
            return error("width", self.width.into(), "a positive number");
        }
        if self.max_level > MAX_LEVEL {
            return error("max_level", self.max_level.into(), "0 to 12");
        }
        if !(self.bend >= 0.0 && self.bend.is_finite()) {
            return error("bend", self.bend.into(), "0 or a positive number");
        }
        Ok(())
    }

    /// What edges along a line of `length` that turns by `turn` are multiplied by, if it has `edges` of the usual length.
    fn factor(&self, turn: f64, edges: f64) -> f64 {
        if self.bend == 0.0 {
            return 1.0;
        }
        let ratio = f64::from(self.bend) * edges / turn;
        if ratio.is_nan() { 1.0 } else { ratio.cbrt().clamp(MAX_BEND_FACTOR.recip(), MAX_BEND_FACTOR) }
    }

    /// Level, from `least` to `most`, at which edges along a line are as long as they shall be, or shorter by less than a half.
    fn level(&self, line: [DVec3; LINE_POINTS], least: u8, most: u8) -> u8 {
        let eye = self.eye.as_dvec3();
        let [before, after] = [line[1] - line[0], line[2] - line[1]];
        let nearest = line.map(|p| p.distance(eye)).into_iter().fold(f64::INFINITY, f64::min);
        let length = before.length().max(after.length()) * SEGMENTS as f64;
        // The chords' directions are those of the middles of both halves.
        let turn = 2.0
            * before
                .normalize_or_zero()
                .cross(after.normalize_or_zero())
                .length()
                .atan2(before.normalize_or_zero().dot(after.normalize_or_zero()));
        let usual = nearest * f64::from(self.width);
        let edge = usual * self.factor(turn, length / usual);
        // To the nearest power of two.
        let fits = |&l: &u8| length * std::f64::consts::FRAC_1_SQRT_2 * cell(l) <= edge;
        (least..most).find(fits).unwrap_or(most)
    }
}

impl Surface {
    /// Levels of a patch at which `rates` are met wherever the surface stands.
    pub(crate) fn levels_for_eye(&self, patch: u32, places: &[Affine3A], rates: &EyeRates) -> [u8; 2] {
        let least = self.least_level(patch);
        let most = rates.max_level.max(least);
        let mut points = [Vec3::ZERO; LINE_POINTS * LINE_POINTS];
        let step = PARAMETER_END / SEGMENTS as u32;
        let lattice = Lattice { u0: 0, v0: 0, step_u: step, step_v: step, stride: LINE_POINTS };
        self.patches[patch as usize].root.fill(
            PARAMETER_END,
            &lattice,
            [LINE_POINTS; 2],
            &mut points,
            &self.context,
        );
        let mut levels = [least; 2];
        for world_from_object in places {
            let placed = points.map(|p| world_from_object.transform_point3(p).as_dvec3());
            for (axis, line) in (0..2).flat_map(|axis| (0..LINE_POINTS).map(move |line| (axis, line))) {
                let point = |i: usize| {
                    placed[if axis == 0 { line * LINE_POINTS + i } else { i * LINE_POINTS + line }]
                };
                levels[axis] = levels[axis].max(rates.level([0, 1, 2].map(point), least, most));
            }
        }
        levels
    }
}
