//! `particles`: flat discs in a ball, all facing one direction (the directional case of `[Lacewell08]`, figure 10).

use super::{
    Generated, Inputs,
    builder::Builder,
    random::{Stream, rotate},
};
use std::f32::consts::TAU;
use umbrage_geom::{Frame, glam::Vec3};

/// Direction that light travels in for the modes of `particles`: `block` shows it the faces of the discs, `transmit`
/// their edges.
pub const PARTICLES_LIGHT: [f32; 3] = [0.0, -1.0, 0.0];

const SIDES: usize = 6;
const TRIANGLES: usize = SIDES - 2;

pub fn particles(inputs: &Inputs) -> Generated {
    let normal = match inputs.choice("mode") {
        "block" => -Vec3::from(PARTICLES_LIGHT),
        _ => Vec3::X,
    };
    let count = (inputs.triangles / TRIANGLES).max(1);
    // The discs' area over the ball's silhouette.
    let radius = (inputs.number("coverage") as f32 / count as f32).sqrt();
    let mut builder = Builder::with_capacity(count * TRIANGLES);
    builder.begin("particles");
    let frame = Frame::from_normal(normal);
    for i in 0..count {
        let mut random = Stream::new(inputs.seed, 0, i);
        let center = random.in_ball() + Vec3::Y * 1.5;
        let first = rotate(frame.tangent, normal, TAU * random.unit()) * radius;
        let corners: [u32; SIDES] = std::array::from_fn(|k| {
            builder.vertex(center + rotate(first, normal, TAU * k as f32 / SIDES as f32))
        });
        for k in 2..SIDES {
            builder.triangle(corners[0], corners[k - 1], corners[k]);
        }
    }
    builder.finish().into()
}

#[cfg(test)]
mod tests {
    use super::super::{ParameterValue, Parameters, generate};
    use super::*;

    /// Area of the discs as the light sees it.
    fn projected_area(mode: &str) -> f32 {
        let values = [("mode".to_owned(), ParameterValue::Text(mode.into()))].into();
        let parameters = Parameters { triangles: Some(4000), values, ..Parameters::default() };
        let mesh = generate("particles", &parameters).unwrap().mesh;
        let double_area = |t: usize| {
            let [a, b, c] = mesh.triangle(t).map(Vec3::from);
            (b - a).cross(c - a).dot(Vec3::from(PARTICLES_LIGHT)).abs()
        };
        (0..mesh.triangles.len()).map(double_area).sum::<f32>() / 2.0
    }

    #[test]
    fn modes_face_the_light_or_not() {
        assert!(projected_area("transmit") < 1e-4);
        // Hexagons cover 0.83 of their discs; the default coverage is 2.
        let block = projected_area("block") / std::f32::consts::PI;
        assert!((block - 2.0 * 0.827).abs() < 0.01, "{block}");
    }
}
