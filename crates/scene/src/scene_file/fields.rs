//! Values of a TOML document that know where they stand, so that every error can say so.

use std::cell::RefCell;
use std::ops::{Range, RangeInclusive};
use toml::Spanned;
use toml::de::{DeTable, DeValue};

/// What is wrong, and where in the text.
#[derive(Debug)]
pub(super) struct FieldError {
    pub(super) span: Range<usize>,
    pub(super) message: String,
}

impl FieldError {
    pub(super) fn new(span: Range<usize>, message: impl Into<String>) -> Self {
        Self { span, message: message.into() }
    }
}

/// A table that remembers which keys were asked for: any other key is unknown.
pub(super) struct Fields<'a> {
    /// Such as `light 'sun'`.
    pub(super) what: String,
    pub(super) span: Range<usize>,
    table: &'a DeTable<'a>,
    asked: RefCell<Vec<&'static str>>,
}

/// A value, its key, and whose key it is.
#[derive(Clone)]
pub(super) struct Value<'a> {
    what: String,
    key: String,
    value: &'a Spanned<DeValue<'a>>,
}

impl<'a> Fields<'a> {
    pub(super) fn new(what: impl Into<String>, table: &'a DeTable<'a>, span: Range<usize>) -> Self {
        Self { what: what.into(), span, table, asked: RefCell::default() }
    }

    pub(super) fn value(&self, key: &'static str) -> Option<Value<'a>> {
        self.asked.borrow_mut().push(key);
        let value = self.table.get(key)?;
        Some(Value { what: self.what.clone(), key: key.into(), value })
    }

    pub(super) fn required(&self, key: &'static str) -> Result<Value<'a>, FieldError> {
        self.value(key).ok_or_else(|| {
            // A misspelt key explains a missing one.
            let alike = |other: &str| other.contains(key) || key.contains(other) || prefix(other, key) >= 3;
            match self.others().into_iter().find(|other| alike(&other.key)) {
                Some(other) => {
                    let span = self.key_span(&other.key).unwrap_or_else(|| other.span());
                    let message =
                        format!("{}: unknown key '{}', and '{key}' is missing", self.what, other.key);
                    FieldError::new(span, message)
                }
                None => self.flaw(format!("'{key}' is missing")),
            }
        })
    }

    /// A problem with the table as a whole.
    pub(super) fn flaw(&self, message: impl AsRef<str>) -> FieldError {
        FieldError::new(self.span.clone(), format!("{}: {}", self.what, message.as_ref()))
    }

    pub(super) fn table(&self, key: &'static str) -> Result<Option<Fields<'a>>, FieldError> {
        self.value(key).map(|v| v.table(key)).transpose()
    }

    pub(super) fn whole_into(
        &self,
        key: &'static str,
        range: RangeInclusive<u32>,
        target: &mut u32,
    ) -> Result<(), FieldError> {
        if let Some(value) = self.value(key) {
            *target = value.whole(range)?;
        }
        Ok(())
    }

    /// All entries in the order of the file, whatever their keys.
    pub(super) fn entries(&self) -> Vec<Value<'a>> {
        let mut entries: Vec<_> = self
            .table
            .iter()
            .map(|(key, value)| {
                let entry = Value { what: self.what.clone(), key: key.get_ref().clone().into_owned(), value };
                (key.span().start, entry)
            })
            .collect();
        entries.sort_by_key(|(start, _)| *start);
        entries.into_iter().map(|(_, entry)| entry).collect()
    }

    /// Entries that were not asked for.
    pub(super) fn others(&self) -> Vec<Value<'a>> {
        let asked = self.asked.borrow();
        self.entries().into_iter().filter(|e| !asked.contains(&&e.key[..])).collect()
    }

    /// Where a key stands.
    pub(super) fn key_span(&self, key: &str) -> Option<Range<usize>> {
        self.table.get_key_value(key).map(|(key, _)| key.span())
    }

    /// Refuses keys that were not asked for.
    pub(super) fn finish(&self) -> Result<(), FieldError> {
        let Some(unknown) = self.others().into_iter().next() else { return Ok(()) };
        let mut known = self.asked.borrow().clone();
        known.sort_unstable();
        known.dedup();
        let span = self.key_span(&unknown.key).unwrap_or_else(|| unknown.span());
        let message =
            format!("{}: unknown key '{}', expected one of {}", self.what, unknown.key, known.join(", "));
        Err(FieldError::new(span, message))
    }
}

/// Bytes that both begin with.
fn prefix(a: &str, b: &str) -> usize {
    a.bytes().zip(b.bytes()).take_while(|(a, b)| a == b).count()
}

impl<'a> Value<'a> {
    pub(super) fn key(&self) -> &str {
        &self.key
    }

    pub(super) fn raw(&self) -> &'a DeValue<'a> {
        self.value.get_ref()
    }

    pub(super) fn span(&self) -> Range<usize> {
        self.value.span()
    }

    /// `message` continues "KEY ..".
    pub(super) fn flaw(&self, message: impl AsRef<str>) -> FieldError {
        FieldError::new(self.span(), format!("{}: {} {}", self.what, self.key, message.as_ref()))
    }

    pub(super) fn expected(&self, expected: &str) -> FieldError {
        let found = match self.raw() {
            DeValue::String(text) => format!("\"{text}\""),
            DeValue::Integer(i) => i.to_string(),
            DeValue::Float(x) => x.to_string(),
            DeValue::Boolean(b) => b.to_string(),
            DeValue::Datetime(_) => "a date".into(),
            DeValue::Array(items) => format!("an array of {}", items.len()),
            DeValue::Table(_) => "a table".into(),
        };
        self.flaw(format!("must be {expected}, not {found}"))
    }

    pub(super) fn text(&self) -> Result<&'a str, FieldError> {
        self.raw().as_str().ok_or_else(|| self.expected("text"))
    }

    pub(super) fn flag(&self) -> Result<bool, FieldError> {
        self.raw().as_bool().ok_or_else(|| self.expected("true or false"))
    }

    /// A table; `what` names it in errors.
    pub(super) fn table(&self, what: impl Into<String>) -> Result<Fields<'a>, FieldError> {
        let table = self.raw().as_table().ok_or_else(|| self.expected("a table"))?;
        Ok(Fields::new(what, table, self.span()))
    }

    pub(super) fn items(&self) -> Result<Vec<Value<'a>>, FieldError> {
        let items = self.raw().as_array().ok_or_else(|| self.expected("an array"))?;
        let item = |value| Value { what: self.what.clone(), key: self.key.clone(), value };
        Ok(items.iter().map(item).collect())
    }

    pub(super) fn double(&self) -> Result<f64, FieldError> {
        let number = match self.raw() {
            DeValue::Integer(i) => i64::from_str_radix(i.as_str(), i.radix()).ok().map(|i| i as f64),
            DeValue::Float(x) => x.as_str().parse().ok(),
            _ => None,
        };
        match number {
            Some(number) if (number as f32).is_finite() => Ok(number),
            Some(number) => Err(self.flaw(format!("must be finite, not {number}"))),
            None => Err(self.expected("a number")),
        }
    }

    pub(super) fn number(&self) -> Result<f32, FieldError> {
        Ok(self.double()? as f32)
    }

    pub(super) fn number_in(&self, range: RangeInclusive<f32>) -> Result<f32, FieldError> {
        let number = self.number()?;
        if range.contains(&number) {
            return Ok(number);
        }
        Err(self.flaw(format!("must be between {} and {}, not {number}", range.start(), range.end())))
    }

    /// A length above 0.
    pub(super) fn positive(&self) -> Result<f32, FieldError> {
        let number = self.number()?;
        if number > 0.0 { Ok(number) } else { Err(self.flaw(format!("must be above 0, not {number}"))) }
    }

    pub(super) fn whole(&self, range: RangeInclusive<u32>) -> Result<u32, FieldError> {
        let integer = self.raw().as_integer().and_then(|i| i64::from_str_radix(i.as_str(), i.radix()).ok());
        match integer.and_then(|i| u32::try_from(i).ok()).filter(|i| range.contains(i)) {
            Some(whole) => Ok(whole),
            None => {
                let expected = format!("a whole number from {} to {}", range.start(), range.end());
                Err(self.expected(&expected))
            }
        }
    }

    pub(super) fn numbers<const N: usize>(&self) -> Result<[f64; N], FieldError> {
        let items = self.raw().as_array().map_or(0, |items| items.len());
        if items != N {
            return Err(self.expected(&format!("an array of {N} numbers")));
        }
        let mut numbers = [0.0; N];
        for (number, item) in numbers.iter_mut().zip(self.items()?) {
            *number = item.double()?;
        }
        Ok(numbers)
    }

    /// A point, with coordinates that geometry may have.
    pub(super) fn vector(&self) -> Result<[f32; 3], FieldError> {
        let limit = f64::from(umbrage_geom::mesh::MAX_COORDINATE);
        let vector = self.numbers::<3>()?;
        if vector.iter().any(|x| x.abs() > limit) {
            return Err(self.flaw(format!("must not go beyond {limit:e}")));
        }
        Ok(vector.map(|x| x as f32))
    }

    /// A vector that has a length.
    pub(super) fn direction(&self) -> Result<[f32; 3], FieldError> {
        let vector = self.vector()?;
        if umbrage_geom::glam::Vec3::from(vector).length_squared() > 0.0 {
            return Ok(vector);
        }
        Err(self.flaw("must not have length 0"))
    }

    /// Light: one number or three, not negative.
    pub(super) fn color(&self) -> Result<[f32; 3], FieldError> {
        let color = match self.raw() {
            DeValue::Integer(_) | DeValue::Float(_) => [self.double()?; 3],
            DeValue::Array(_) => self.numbers::<3>()?,
            _ => return Err(self.expected("a number or an array of 3 numbers (linear RGB)")),
        };
        match color.iter().find(|&&x| x < 0.0) {
            Some(x) => Err(self.flaw(format!("must not be negative, but holds {x}"))),
            None => Ok(color.map(|x| x as f32)),
        }
    }
}
