//! `[[lights]]`.

use super::fields::{FieldError, Fields, Value};
use crate::scene::Light;
use umbrage_geom::Frame;
use umbrage_geom::glam::Vec3;

const TYPES: &str = "\"rectangle\", \"disc\", \"sphere\", \"point\", \"spot\" or \"directional\"";

/// Reads all lights.
pub(super) fn read(top: &Fields<'_>) -> Result<Vec<Light>, FieldError> {
    let Some(list) = top.value("lights") else { return Ok(Vec::new()) };
    let mut names = Vec::new();
    list.items()?
        .iter()
        .enumerate()
        .map(|(i, item)| {
            let anonymous = item.table(format!("light {}", i + 1))?;
            let mut fields = item.table(anonymous.what.clone())?;
            if let Some(name) = anonymous.value("name") {
                let text = name.text()?;
                if names.contains(&text) {
                    return Err(name.flaw(format!("'{text}' is taken by another light")));
                }
                names.push(text);
                fields.what = format!("light '{text}'");
            }
            fields.value("name");
            let light = light(&fields)?;
            fields.finish()?;
            Ok(light)
        })
        .collect()
}

fn light(fields: &Fields<'_>) -> Result<Light, FieldError> {
    let kind = fields.required("type")?;
    let color = |key| fields.required(key).and_then(|v: Value<'_>| v.color());
    Ok(match kind.text()? {
        "rectangle" => rectangle(fields)?,
        "disc" => {
            let center = fields.required("center")?.vector()?;
            let normal = toward(fields, "normal", center)?;
            let radius = fields.required("radius")?.positive()?;
            Light::Disc {
                center,
                normal,
                radius,
                radiance: color("radiance")?,
                two_sided: two_sided(fields)?,
            }
        }
        "sphere" => Light::Sphere {
            center: fields.required("center")?.vector()?,
            radius: fields.required("radius")?.positive()?,
            radiance: color("radiance")?,
        },
        "point" => {
            Light::Point { position: fields.required("position")?.vector()?, intensity: color("intensity")? }
        }
        "spot" => spot(fields)?,
        "directional" => Light::Directional {
            direction: fields.required("direction")?.direction()?,
            angle: fields.value("angle").map_or(Ok(0.0), |v| v.number_in(0.0..=180.0))?,
            irradiance: color("irradiance")?,
        },
        _ => return Err(kind.expected(TYPES)),
    })
}

fn two_sided(fields: &Fields<'_>) -> Result<bool, FieldError> {
    fields.value("two_sided").map_or(Ok(false), |v| v.flag())
}

/// The direction under `key`, or from `origin` to `target`.
fn toward(fields: &Fields<'_>, key: &'static str, origin: [f32; 3]) -> Result<[f32; 3], FieldError> {
    match (fields.value(key), fields.value("target")) {
        (Some(direction), None) => direction.direction(),
        (None, Some(target)) => {
            let direction = Vec3::from(target.vector()?) - Vec3::from(origin);
            if direction.length_squared() > 0.0 && direction.is_finite() {
                Ok(direction.to_array())
            } else {
                Err(target.flaw("must not be where the light is"))
            }
        }
        _ => Err(fields.flaw(format!("needs either '{key}' or 'target'"))),
    }
}

fn rectangle(fields: &Fields<'_>) -> Result<Light, FieldError> {
    let (corner, u, v) = match (fields.value("corner"), fields.value("center")) {
        (Some(corner), None) => {
            let (u, v) = (fields.required("u")?, fields.required("v")?);
            let (u_edge, v_edge) = (Vec3::from(u.direction()?), Vec3::from(v.direction()?));
            let across = u_edge.normalize_or_zero().cross(v_edge.normalize_or_zero());
            if across.length() < 1e-6 || u_edge.cross(v_edge).length() == 0.0 {
                return Err(v.flaw("must not be parallel to u: the light would have no area"));
            }
            (corner.vector()?, u_edge.to_array(), v_edge.to_array())
        }
        (None, Some(center)) => {
            let center = center.vector()?;
            let normal = Vec3::from(toward(fields, "normal", center)?).normalize_or_zero();
            let size = fields.required("size")?;
            let [width, height] = size.numbers::<2>()?.map(|x| x as f32);
            if !(width > 0.0 && height > 0.0 && width * height > 0.0 && (width * height).is_finite()) {
                return Err(size.flaw(format!("must be two lengths above 0, not {width} and {height}")));
            }
            // u level and v upward where the light doesn't face straight up or down.
            let level = Vec3::Y.cross(normal);
            let u =
                if level.length() > 1e-3 { level.normalize() } else { Frame::from_normal(normal).tangent };
            let v = normal.cross(u);
            let corner = Vec3::from(center) - 0.5 * (width * u + height * v);
            (corner.to_array(), (width * u).to_array(), (height * v).to_array())
        }
        _ => return Err(fields.flaw("needs either 'corner', 'u' and 'v', or 'center', 'size' and 'target'")),
    };
    let radiance = fields.required("radiance")?.color()?;
    Ok(Light::Rectangle { corner, u, v, radiance, two_sided: two_sided(fields)? })
}

fn spot(fields: &Fields<'_>) -> Result<Light, FieldError> {
    let position = fields.required("position")?.vector()?;
    let direction = toward(fields, "direction", position)?;
    let outer = fields.required("outer_angle")?;
    let outer_angle = outer.number()?;
    if !(outer_angle > 0.0 && outer_angle <= 180.0) {
        return Err(outer.flaw(format!("must be above 0 and at most 180 degrees, not {outer_angle}")));
    }
    let inner_angle = match fields.value("inner_angle") {
        None => 0.8 * outer_angle,
        Some(inner) => {
            let angle = inner.number()?;
            if !(0.0..=outer_angle).contains(&angle) {
                let message = format!("must be from 0 to outer_angle ({outer_angle}), not {angle}");
                return Err(inner.flaw(message));
            }
            angle
        }
    };
    let intensity = fields.required("intensity")?.color()?;
    Ok(Light::Spot { position, direction, inner_angle, outer_angle, intensity })
}
