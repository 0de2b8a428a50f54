//! Transforms of objects: `translate`, `rotate`, `scale`, `matrix`, `transforms` and `scatter`.
//!
//! Computed in double precision with `libm`, so that a scene is the same to the bit on every machine.

use super::fields::{FieldError, Fields, Value};
use rand_pcg::Pcg32;
use rand_pcg::rand_core::Rng;
use toml::de::DeValue;
use umbrage_geom::glam::{Affine3A, DAffine3, DMat3, DVec3};

/// Most instances that one object may have.
pub(super) const MAX_INSTANCES: u32 = 1_000_000;

/// The transforms of an object's instances, at least one, each invertible.
pub(super) fn read(fields: &Fields<'_>) -> Result<Vec<Affine3A>, FieldError> {
    let object = transform(fields)?;
    let mut all = Vec::new();
    match (fields.value("transforms"), fields.value("scatter")) {
        (None, None) => all.push(rounded(object).ok_or_else(|| singular(fields))?),
        (Some(list), None) => {
            let items = list.items()?;
            if items.is_empty() || items.len() > MAX_INSTANCES as usize {
                return Err(list.flaw(format!("must have 1 to {MAX_INSTANCES} entries, not {}", items.len())));
            }
            for (i, item) in items.iter().enumerate() {
                let entry = item.table(format!("{} transform {}", fields.what, i + 1))?;
                let local = transform(&entry)?;
                entry.finish()?;
                all.push(rounded(object * local).ok_or_else(|| singular(&entry))?);
            }
        }
        (None, Some(value)) => {
            let scatter = value.table(format!("{} scatter", fields.what))?;
            for local in scattered(&scatter)? {
                all.push(rounded(object * local).ok_or_else(|| singular(fields))?);
            }
            scatter.finish()?;
        }
        (Some(_), Some(scatter)) => return Err(scatter.flaw("can't stand beside 'transforms'")),
    }
    Ok(all)
}

fn singular(fields: &Fields<'_>) -> FieldError {
    fields.flaw("its transform can't be inverted (a scale or a matrix flattens it, or is too large or small)")
}

/// Largest condition number of a transform (in the maximum norm): beyond it single precision can't tell the transform from
/// one that flattens, and instanced hierarchies refuse it.
const MAX_CONDITION: f64 = (1u32 << 24) as f64;

/// In single precision; `None` if that has no usable inverse.
fn rounded(transform: DAffine3) -> Option<Affine3A> {
    let single =
        Affine3A::from_mat3_translation(transform.matrix3.as_mat3(), transform.translation.as_vec3());
    if !single.is_finite() || !single.inverse().is_finite() {
        return None;
    }
    let matrix = DMat3::from_cols_array(&single.matrix3.to_cols_array().map(f64::from));
    let row_sum = |m: &DMat3| (m.x_axis.abs() + m.y_axis.abs() + m.z_axis.abs()).max_element();
    let condition = row_sum(&matrix) * row_sum(&matrix.inverse());
    (condition < MAX_CONDITION).then_some(single)
}

/// `translate * rotate * scale`, or `matrix`.
fn transform(fields: &Fields<'_>) -> Result<DAffine3, FieldError> {
    let (translate, rotate, scale) =
        (fields.value("translate"), fields.value("rotate"), fields.value("scale"));
    if let Some(matrix) = fields.value("matrix") {
        if translate.is_some() || rotate.is_some() || scale.is_some() {
            return Err(matrix.flaw("can't stand beside 'translate', 'rotate' or 'scale'"));
        }
        return read_matrix(&matrix);
    }
    let translation = translate.map_or(Ok([0.0; 3]), |v| v.numbers::<3>())?;
    let rotation = rotate.map_or(Ok(DMat3::IDENTITY), |v| rotation(&v))?;
    let scale = scale.map_or(Ok([1.0; 3]), |v| read_scale(&v))?;
    let matrix3 = rotation * DMat3::from_diagonal(scale.into());
    Ok(DAffine3::from_mat3_translation(matrix3, translation.into()))
}

/// Three rows of four: `world = rows * (x, y, z, 1)`.
fn read_matrix(matrix: &Value<'_>) -> Result<DAffine3, FieldError> {
    const EXPECTED: &str = "three rows of four numbers";
    let rows = match matrix.raw() {
        DeValue::Array(rows) if rows.len() == 3 => matrix.items()?,
        _ => return Err(matrix.expected(EXPECTED)),
    };
    let mut columns = [DVec3::ZERO; 4];
    for (r, row) in rows.iter().enumerate() {
        for (column, number) in columns.iter_mut().zip(row.numbers::<4>()?) {
            column[r] = number;
        }
    }
    let [x, y, z, translation] = columns;
    Ok(DAffine3::from_mat3_translation(DMat3::from_cols(x, y, z), translation))
}

fn read_scale(value: &Value<'_>) -> Result<[f64; 3], FieldError> {
    let scale = match value.raw() {
        DeValue::Array(_) => value.numbers::<3>()?,
        _ => [value.double().map_err(|_| value.expected("a number or an array of 3 numbers"))?; 3],
    };
    if scale.contains(&0.0) { Err(value.flaw("must not be 0")) } else { Ok(scale) }
}

/// Degrees about x, then y, then z; or an axis and degrees about it.
fn rotation(value: &Value<'_>) -> Result<DMat3, FieldError> {
    match value.raw() {
        DeValue::Array(_) => {
            let [x, y, z] = value.numbers::<3>()?;
            Ok(about(DVec3::Z, z) * about(DVec3::Y, y) * about(DVec3::X, x))
        }
        DeValue::Table(_) => {
            let fields = value.table("rotate")?;
            let axis: DVec3 = fields.required("axis")?.direction()?.map(f64::from).into();
            let angle = fields.required("angle")?.double()?;
            fields.finish()?;
            Ok(about(axis.normalize(), angle))
        }
        _ => Err(value.expected("three angles in degrees, or { axis = [x, y, z], angle = degrees }")),
    }
}

/// Rodrigues' rotation. Multiples of 90 degrees about a coordinate axis are exact.
fn about(axis: DVec3, degrees: f64) -> DMat3 {
    let turn = degrees.rem_euclid(360.0);
    let (sin, cos) = match turn {
        90.0 => (1.0, 0.0),
        180.0 => (0.0, -1.0),
        270.0 => (-1.0, 0.0),
        _ => libm::sincos(turn.to_radians()),
    };
    let column = |e: DVec3| cos * e + sin * axis.cross(e) + (1.0 - cos) * axis.dot(e) * axis;
    DMat3::from_cols(column(DVec3::X), column(DVec3::Y), column(DVec3::Z))
}

/// Places on the level rectangle `area` with a random turn about y and a random scale.
///
/// Places follow the additive sequence of the plastic number (Roberts 2018) from a random start: they keep their
/// distance from each other for any count, which independent points don't.
fn scattered(fields: &Fields<'_>) -> Result<Vec<DAffine3>, FieldError> {
    const PLASTIC: f64 = 1.324_717_957_244_746;
    let count = fields.required("count")?.whole(1..=MAX_INSTANCES)?;
    let area = fields.required("area")?;
    let [x0, z0, x1, z1] = area.numbers::<4>()?;
    if x1 < x0 || z1 < z0 {
        return Err(area.flaw("must be [x_min, z_min, x_max, z_max]"));
    }
    let mut seed = 0;
    fields.whole_into("seed", 0..=u32::MAX, &mut seed)?;
    let scale = fields.value("scale");
    let [smallest, largest] = scale.as_ref().map_or(Ok([1.0; 2]), |v| v.numbers::<2>())?;
    if let Some(scale) = scale.filter(|_| !(smallest > 0.0 && largest >= smallest)) {
        return Err(scale.flaw("must be [smallest, largest], both above 0"));
    }
    let mut random = Pcg32::new(u64::from(seed), 0x5ca7_7e12);
    let mut unit = || f64::from(random.next_u32()) / 4_294_967_296.0;
    let start = [unit(), unit()];
    let place = |i: u32| {
        let [u, v] = [
            (start[0] + f64::from(i) / PLASTIC).fract(),
            (start[1] + f64::from(i) / (PLASTIC * PLASTIC)).fract(),
        ];
        DVec3::new(x0 + u * (x1 - x0), 0.0, z0 + v * (z1 - z0))
    };
    Ok((0..count)
        .map(|i| {
            let matrix = about(DVec3::Y, 360.0 * unit()) * (smallest + unit() * (largest - smallest));
            DAffine3::from_mat3_translation(matrix, place(i))
        })
        .collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quarter_turns_are_exact() {
        assert_eq!(about(DVec3::Y, 90.0) * DVec3::X, DVec3::NEG_Z);
        assert_eq!(about(DVec3::Z, -270.0) * DVec3::X, DVec3::Y);
        assert_eq!(about(DVec3::X, 720.0), DMat3::IDENTITY);
    }
}
