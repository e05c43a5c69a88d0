//! The unique number of a board.

use std::borrow::Cow;
use std::fmt;
use std::str::FromStr;

use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::{Serialize, Serializer};
use thiserror::Error;

/// The unique number of a board, 24 hexadecimal digits: in its hello, and its USB serial number.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct DeviceId(pub [u8; 12]);

impl fmt::Display for DeviceId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.with_digits(|digits| f.write_str(digits))
    }
}

impl DeviceId {
    /// Passes the digits on. Every pose has them: byte by byte formatting would take a sixth of the time of its line.
    fn with_digits<T>(self, with: impl FnOnce(&str) -> T) -> T {
        let mut digits = [0; 24];
        for (pair, byte) in digits.chunks_exact_mut(2).zip(self.0) {
            pair.copy_from_slice(&[byte >> 4, byte & 15].map(|digit| b"0123456789abcdef"[usize::from(digit)]));
        }
        with(str::from_utf8(&digits).expect("ASCII"))
    }
}

impl Serialize for DeviceId {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        self.with_digits(|digits| serializer.serialize_str(digits))
    }
}

impl JsonSchema for DeviceId {
    fn schema_name() -> Cow<'static, str> {
        "DeviceId".into()
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        json_schema!({ "type": "string", "pattern": "^[0-9a-f]{24}$" })
    }
}

/// A text that is not a [`DeviceId`].
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("`{text}` is no serial number of a board; give 24 hexadecimal digits, as `slitpose device list` shows them")]
pub struct DeviceIdError {
    /// The text.
    pub text: String,
}

impl FromStr for DeviceId {
    type Err = DeviceIdError;

    /// Digits above 9 may be upper or lower case.
    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let error = || DeviceIdError { text: text.to_owned() };
        if text.len() != 24 || !text.bytes().all(|byte| byte.is_ascii_hexdigit()) {
            return Err(error());
        }
        let mut id = [0; 12];
        for (byte, at) in id.iter_mut().zip((0..).step_by(2)) {
            *byte = u8::from_str_radix(&text[at..at + 2], 16).map_err(|_| error())?;
        }
        Ok(Self(id))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ids_are_read_as_they_are_written() {
        let id = DeviceId(*b"\x00\x36\xffsimulated");
        assert_eq!(id.to_string().parse(), Ok(id));
        assert_eq!(id.to_string().to_uppercase().parse(), Ok(id));
        for text in ["", "00", "0036ff73696d756c617465", "0036ff73696d756c61746g65", "+036ff73696d756c6174650a"] {
            assert!(text.parse::<DeviceId>().is_err(), "{text}");
        }
    }
}
