//! Lengths and sizes on the command line.

use std::str::FromStr;
use umbrage_scene::Radius;

/// How far occluders count.
#[derive(Clone, Copy)]
pub struct RadiusArgument(pub Radius);

impl FromStr for RadiusArgument {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let positive = |digits: &str| digits.trim().parse::<f32>().ok().filter(|&r| r > 0.0);
        let radius = match text.strip_suffix('%') {
            Some(percent) => {
                positive(percent).filter(|r| r.is_finite()).map(|r| Radius::OfDiagonal(r / 100.0))
            }
            None => {
                positive(text).map(|r| if r.is_finite() { Radius::Absolute(r) } else { Radius::Unbounded })
            }
        };
        radius.map(Self).ok_or_else(|| "expected a length above 0, a percentage as in 10%, or inf".into())
    }
}

/// Width and height of an image.
#[derive(Clone, Copy)]
pub struct SizeArgument(pub [u32; 2]);

impl FromStr for SizeArgument {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (w, h) = text.split_once(['x', 'X']).unwrap_or((text, text));
        match (w.parse(), h.parse()) {
            (Ok(w), Ok(h)) if w > 0 && h > 0 => Ok(Self([w, h])),
            _ => Err("expected N or WIDTHxHEIGHT, at least 1".into()),
        }
    }
}
