//! Amounts of memory as people write them.

use std::{fmt, str::FromStr};

/// A number of bytes, at least 1 and at most 1 TiB. As text a whole number with a unit: `B`, `KiB`, `MiB` or `GiB`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ByteSize(u64);

/// A text is no [`ByteSize`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("expected a size of 1B to 1024GiB as a whole number and B, KiB, MiB or GiB, such as 64MiB")]
pub struct ByteSizeError;

/// Units, largest first.
const UNITS: [(&str, u64); 4] = [("GiB", 1 << 30), ("MiB", 1 << 20), ("KiB", 1 << 10), ("B", 1)];

impl ByteSize {
    /// The largest size.
    pub const MAX: Self = Self(1 << 40);

    /// So many bytes.
    ///
    /// # Errors
    /// [`ByteSizeError`] for 0 and beyond [`Self::MAX`].
    pub fn new(bytes: u64) -> Result<Self, ByteSizeError> {
        if (1..=Self::MAX.0).contains(&bytes) { Ok(Self(bytes)) } else { Err(ByteSizeError) }
    }

    /// So many MiB, at least 1 and at most 2^20.
    pub(crate) const fn mebibytes(count: u64) -> Self {
        assert!(1 <= count && count <= 1 << 20);
        Self(count << 20)
    }

    /// The number of bytes.
    pub fn bytes(self) -> u64 {
        self.0
    }
}

impl FromStr for ByteSize {
    type Err = ByteSizeError;

    fn from_str(text: &str) -> Result<Self, ByteSizeError> {
        let text = text.trim();
        let (number, unit) = UNITS
            .iter()
            .find_map(|&(name, unit)| Some((text.strip_suffix(name)?, unit)))
            .ok_or(ByteSizeError)?;
        let number: u64 = number.trim_end().parse().map_err(|_| ByteSizeError)?;
        Self::new(number.checked_mul(unit).ok_or(ByteSizeError)?)
    }
}

impl fmt::Display for ByteSize {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (name, unit) =
            UNITS.into_iter().find(|(_, unit)| self.0.is_multiple_of(*unit)).unwrap_or(UNITS[3]);
        write!(f, "{}{name}", self.0 / unit)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_read_back_and_bad_ones_are_errors() {
        for (text, bytes) in [("1B", 1), ("4KiB", 4096), ("64MiB", 64 << 20), ("1024GiB", 1 << 40)] {
            let size: ByteSize = text.parse().unwrap();
            assert_eq!((size.bytes(), size.to_string().as_str()), (bytes, text));
        }
        assert_eq!("1536 KiB".parse::<ByteSize>().unwrap().to_string(), "1536KiB");
        let bad = ["", "64", "0B", "-1MiB", "1.5GiB", "64MB", "1025GiB", "18446744073709551615GiB", "MiB"];
        for text in bad {
            assert_eq!(text.parse::<ByteSize>(), Err(ByteSizeError), "{text}");
        }
    }
}
